//! A powered knob with the firmware of a power stage on it, all of it but the chip.

use std::collections::VecDeque;

use acceptance::{answers, request_frame};
use control::criterion::Device;
use control::torque::{BrushedMotor, ThreePhaseMotor};
use firmware::board::Housekeeping;
use firmware::current_tick::CurrentTick;
use firmware::desk::{Desk, Identity};
use firmware::guard::Limits;
use firmware::power::{Bridge, ODRIVE_V3_24V, Sensed};
use firmware::settings::{self, BoardKind};
use firmware::store::{Keep, NoStore};
use firmware::ticker::Ticker;
use firmware::upkeep::{PERIODS, Upkeep};
use firmware::{Commands, Link, Measurements, Moves, Records};
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding};
use plant_sim::hand::Hand;
use plant_sim::hold::State as Motion;
use plant_sim::motor::Motor as Extras;
use plant_sim::powered::{EncoderSetup, Powered, Setup};
use protocol::{
    Changes, Drive, Event, Excitation, ExcitationEnd, Fields, Frames, Interval, Law, Message,
    Motor, MotorChanges, Push, Refusal, Request, ResetReason, Snapshot, State, Status,
    Subscription,
};

/// Random numbers.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0xD1B5_4A32_D192_ED03)
    }

    fn next(&mut self) -> u64 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    pub fn log(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }
}

/// What the hand does.
#[derive(Clone, Copy, PartialEq)]
pub enum Knob {
    /// It leans on the knob and shakes it.
    Pushed,
    /// It turns the knob against all the torque there is.
    Turned,
    /// There is none.
    Free,
}

/// An answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Told {
    Done,
    Refused(Refusal),
    Status(Status),
    Snapshot(Option<Snapshot>),
}

impl Told {
    fn of(message: &Message<'_>) -> Option<Self> {
        match message {
            Message::Done { .. } => Some(Self::Done),
            Message::Refused(refusal) => Some(Self::Refused(*refusal)),
            Message::Status(status) => Some(Self::Status(*status)),
            Message::Snapshot(snapshot) => Some(Self::Snapshot(*snapshot)),
            _ => None,
        }
    }
}

/// The slow side of the board.
pub struct FakeBoard {
    pub temperature_c: f32,
    pub gate_driver: Result<(), [u16; 2]>,
    /// What a restart leads to.
    pub restart: Result<(), [u16; 2]>,
    pub fed: u32,
}

impl Housekeeping for FakeBoard {
    fn temperature_c(&mut self) -> f32 {
        self.temperature_c
    }

    fn gate_driver(&mut self) -> Result<(), [u16; 2]> {
        self.gate_driver
    }

    fn restart_gate_driver(&mut self) -> Result<(), [u16; 2]> {
        if self.restart.is_ok() {
            self.gate_driver = Ok(());
        }
        self.gate_driver
    }

    fn feed_watchdog(&mut self) {
        self.fed += 1;
    }

    fn reset_reason(&self) -> ResetReason {
        ResetReason::Watchdog
    }
}

/// What was sampled in the period in which the bridge went off.
#[derive(Clone, Copy)]
pub struct FirstOff {
    pub currents_a: [f64; 2],
    pub bus_v: f32,
    pub tick: u32,
}

pub struct Rig {
    pub plant: Powered,
    current: CurrentTick<'static>,
    desk: Desk<'static, NoStore>,
    upkeep: Upkeep<'static>,
    pub board: FakeBoard,
    pub random: Random,
    /// PWM periods of a haptic tick.
    pub every: u32,
    motor: Motor,
    changes: Changes,
    limits: Limits,
    inductance_h: f64,
    inbox: VecDeque<u8>,
    outbox: Vec<u8>,
    frames: Frames,
    /// What was asked, and the answer to it.
    asked: u16,
    answered: Option<Told>,
    ended: Option<ExcitationEnd>,
    ticks: u32,
    slow_in: u32,
    commanded_nm: f64,
    pub loudest_nm: f64,
    // What is injected.
    pub overran: bool,
    gate_fault: bool,
    pub add_codes: [i32; 2],
    pub add_counts_a_period: i32,
    added_counts: i32,
    pub bus_v: Option<f32>,
    pub slow_runs: bool,
    pub desk_runs: bool,
    pub ticks_run: bool,
    // What was seen.
    pub first_off: Option<FirstOff>,
    /// Periods in which the bridge was on since the start, and since it went off.
    pub ons: u32,
    pub on_since_off: u32,
}

impl Rig {
    /// A random motor on a board that has just started, told of all its values.
    pub fn new(drive: Drive, seed: u64, knob: Knob) -> Self {
        let mut random = Random::new(seed);
        let stage = ODRIVE_V3_24V;
        let resistance = match drive {
            Drive::Voltage => random.log(3.0, 15.0),
            _ => random.log(0.2, 2.0),
        };
        let inductance = resistance * random.log(3e-4, 2e-3);
        let constant = random.log(0.02, 0.1);
        // As much as half the bus drives.
        let current_max = random.log(2.0, 10.0).min(10.0 / resistance);
        let pole_pairs = random.between(3.0, 14.0) as u32;
        let counts_per_rev = [4096, 8192, 16_384][(random.uniform() * 3.0) as usize % 3];
        let reversed = random.chance(0.5);
        let zero_turns = random.between(-0.5, 0.5);
        let offsets_a = [random.between(-3.0, 3.0), random.between(-3.0, 3.0)];
        let offset_codes = offsets_a.map(|a| (2048.0 + a / stage.current_step_a) as f32);
        let winding = match drive {
            Drive::Brushed => Winding::Brushed(BrushedMotor {
                resistance_ohm: resistance,
                inductance_h: inductance,
                torque_constant_nm_a: constant,
            }),
            _ => Winding::ThreePhase(ThreePhaseMotor {
                resistance_ohm: resistance,
                d_inductance_h: inductance,
                q_inductance_h: inductance,
                flux_wb: constant / 1.5 / f64::from(pole_pairs),
                pole_pairs,
            }),
        };
        let device = Device {
            inertia_kg_m2: random.log(1e-5, 1e-4),
            viscous_nm_s_rad: random.log(1e-5, 1e-4),
            coulomb_nm: random.log(1e-3, 5e-3),
        };
        let torque_max = constant * current_max;
        let hand = match knob {
            Knob::Pushed => Hand {
                inertia_kg_m2: 1e-5,
                damping_nm_s_rad: torque_max / 100.0,
                push_nm: random.between(-0.7, 0.7) * torque_max,
                shake_nm: random.between(0.2, 0.5) * torque_max,
                shake_hz: random.log(0.5, 8.0),
                ..Hand::default()
            },
            Knob::Free => Hand::default(),
            Knob::Turned => {
                let push_nm = 2.0 * torque_max + 3.0 * device.coulomb_nm;
                Hand {
                    inertia_kg_m2: 1e-5,
                    damping_nm_s_rad: push_nm / 200.0,
                    push_nm: if random.chance(0.5) {
                        push_nm
                    } else {
                        -push_nm
                    },
                    ..Hand::default()
                }
            }
        };
        let plant = Powered::new(&Setup {
            device,
            motor: Extras::default(),
            hand,
            winding,
            inverter: Inverter {
                pwm_period_s: stage.pwm_period_s,
                pwm_steps: stage.pwm_steps,
                dead_time_s: stage.dead_time_s,
                dead_time_edge_a: stage.dead_time_edge_a,
                late: true,
            },
            sensing: CurrentSensing {
                step_a: stage.current_step_a,
                noise_a: 0.3,
                offset_a: offsets_a,
                seed,
            },
            supply: Supply {
                source_v: 24.0,
                source_ohm: 0.1,
                capacitance_f: 2e-3,
                takes_back: true,
            },
            encoder: EncoderSetup {
                counts_per_rev,
                reversed,
                zero_turns,
            },
            start: Motion {
                position: 0.0,
                velocity: 0.0,
            },
        })
        .unwrap();
        // Within a tenth of the truth.
        let mut near = |value: f64| (value * random.between(0.9, 1.1)) as f32;
        let (near_ohm, near_h) = (near(resistance), near(inductance));
        let motor = MotorChanges {
            drive: Some(drive),
            pole_pairs: Some(pole_pairs),
            resistance_ohm: Some(near_ohm),
            d_inductance_h: Some(near_h),
            q_inductance_h: Some(near_h),
            torque_constant_nm_a: Some(constant as f32),
            current_max_a: Some(current_max as f32),
            reversed: Some(reversed),
            zero_turns: Some(zero_turns as f32),
            offset_b_codes: Some(offset_codes[0]),
            offset_c_codes: Some(offset_codes[1]),
        };
        let every = [12, 24, 30][(random.uniform() * 3.0) as usize % 3];
        let known = |value: f64| {
            Some(Interval {
                low: (0.9 * value) as f32,
                high: (1.1 * value) as f32,
            })
        };
        let changes = Changes {
            sample_period_s: Some((f64::from(every) * stage.pwm_period_s) as f32),
            counts_per_rev: Some(counts_per_rev),
            law: Some([Law::Ledger, Law::Auto][usize::from(random.chance(0.5))]),
            stiffness_nm_rad: Some(random.log(0.05, 1.0) as f32),
            torque_max_nm: Some(10.0),
            speed_max_rad_s: Some(300.0),
            inertia_kg_m2: known(device.inertia_kg_m2),
            viscous_nm_s_rad: known(device.viscous_nm_s_rad),
            coulomb_nm: known(device.coulomb_nm),
            ..Changes::default()
        };
        Self::on(plant, motor, changes, every, inductance, random)
    }

    fn on(
        mut plant: Powered,
        motor: MotorChanges,
        changes: Changes,
        every: u32,
        inductance_h: f64,
        random: Random,
    ) -> Self {
        let link: &'static Link = Box::leak(Box::new(Link::new()));
        let (command_sender, command_receiver) = Box::leak(Box::new(Commands::new())).split();
        let (record_sender, record_receiver) = Box::leak(Box::new(Records::new())).split();
        let (move_sender, move_receiver) = Box::leak(Box::new(Moves::new())).split();
        let (told_sender, told_receiver) = Box::leak(Box::new(Measurements::new())).split();
        let board = FakeBoard {
            temperature_c: 40.0,
            gate_driver: Ok(()),
            restart: Err([0x0400, 0x0001]),
            fed: 0,
        };
        let kind = BoardKind::Stage(ODRIVE_V3_24V);
        let start = settings::start(&NoStore.load(), &kind).expect("the defaults settle");
        let counter = plant.sensed().counter;
        let ticker = Ticker::new(
            &start.settled,
            counter,
            link,
            command_receiver,
            record_sender,
            move_sender,
        );
        let power = start.settled.power.expect("a power stage");
        let identity = Identity {
            firmware: "0",
            git_hash: "test",
            board: "powered",
            kind,
            reset: board.reset_reason(),
        };
        let told = start.settings.motor.with(&motor);
        let mut rig = Self {
            current: CurrentTick::new(ticker, power, 32, counter, told_sender),
            desk: Desk::new(
                identity,
                &start,
                NoStore,
                link,
                command_sender,
                record_receiver,
                move_receiver,
            )
            .told(told_receiver),
            upkeep: Upkeep::new(link),
            plant,
            board,
            random,
            every,
            limits: Limits::new(
                &told,
                changes.counts_per_rev.expect("counts"),
                changes.speed_max_rad_s.expect("a speed"),
                &ODRIVE_V3_24V,
            ),
            motor: told,
            changes,
            inductance_h,
            inbox: VecDeque::new(),
            outbox: Vec::new(),
            frames: Frames::new(),
            asked: 0,
            answered: None,
            ended: None,
            ticks: 0,
            slow_in: PERIODS,
            commanded_nm: 0.0,
            loudest_nm: 0.0,
            overran: false,
            gate_fault: false,
            add_codes: [0; 2],
            add_counts_a_period: 0,
            added_counts: 0,
            bus_v: None,
            slow_runs: true,
            desk_runs: true,
            ticks_run: true,
            first_off: None,
            ons: 0,
            on_since_off: 0,
        };
        for request in [
            Request::SetMotor(motor),
            Request::Set(rig.changes),
            Request::Subscribe(Subscription {
                every_ticks: 1,
                fields: Fields::TORQUE,
                clamp_events: false,
            }),
        ] {
            let answer = rig.ask(request);
            assert!(answer == Told::Done, "{answer:?}");
        }
        rig
    }

    /// One that renders under a hand, at full torque.
    pub fn armed(drive: Drive, seed: u64) -> Self {
        let mut rig = Self::new(drive, seed, Knob::Pushed);
        rig.arm();
        rig.run(2_400);
        rig
    }

    pub fn arm(&mut self) {
        let answer = self.ask(Request::Arm);
        assert!(answer == Told::Done, "{answer:?}");
    }

    /// An excitation of 1.25 s along B to C, of a current below half of the largest.
    pub fn excitation(&self) -> Excitation {
        let motor = &self.motor;
        Excitation {
            angle: 1 << 30,
            turn: 0,
            back: false,
            steady_v: (0.4 * motor.current_max_a * motor.resistance_ohm).min(6.0),
            steady_a: [0.0; 2],
            along_v: 0.0,
            across_v: 0.0,
            quarter: 0,
            rise: 1_500,
            settle: 1_000,
            window: 1_300,
            windows: 20,
            zero_codes: [motor.offset_b_codes, motor.offset_c_codes],
            current_max_a: 2.0 * motor.current_max_a + 2.0,
            way_max: 1_000_000,
        }
    }

    /// A push of nearly a second below what friction holds.
    pub fn push(&self) -> Push {
        let ticks = (0.9 * 24e3 / f64::from(self.every)) as u32;
        Push {
            from_nm: 1e-4,
            to_nm: 5e-4,
            rise_ticks: 10,
            most_ticks: ticks,
            way_counts: 1_000_000,
            speed_counts: 1_000_000,
            rest_ticks: 10,
            coast_ticks: 100,
            guard_counts: 1_000_000,
        }
    }

    /// One that is being pushed.
    pub fn pushing(drive: Drive, seed: u64) -> Self {
        let mut rig = Self::new(drive, seed, Knob::Free);
        let answer = rig.ask(Request::Push(rig.push()));
        assert!(answer == Told::Done, "{answer:?}");
        rig.run(100);
        assert!(rig.on_since_off >= 100);
        rig
    }

    /// One that is being measured, at full voltage.
    pub fn calibrating(drive: Drive, seed: u64) -> Self {
        let mut rig = Self::new(drive, seed, Knob::Free);
        let answer = rig.ask(Request::Calibrate(rig.excitation()));
        assert!(answer == Told::Done, "{answer:?}");
        rig.run(1_800);
        assert!(rig.on_since_off > 1_700);
        rig
    }

    /// How the excitation ended, once that is told.
    pub fn excitation_end(&mut self) -> Option<ExcitationEnd> {
        self.ended.take()
    }

    /// One PWM period.
    pub fn period(&mut self) {
        let sensed = self.plant.sensed();
        self.added_counts += self.add_counts_a_period;
        let mut codes = sensed.codes;
        for (code, add) in codes.iter_mut().zip(self.add_codes) {
            *code = (i32::from(*code) + add).clamp(0, 4095) as u16;
        }
        let sensed = Sensed {
            currents: codes,
            bus_v: self.bus_v.unwrap_or(sensed.bus_v as f32),
            counter: sensed
                .counter
                .wrapping_add(self.added_counts.cast_unsigned()),
        };
        if !self.ticks_run {
            self.slow_and_desk();
            self.plant.cut();
            self.plant.period(None);
            return;
        }
        let gate_fault = std::mem::take(&mut self.gate_fault);
        let bridge = self.current.tick(&sensed, gate_fault, self.overran);
        let duties = match bridge {
            Bridge::Off => None,
            Bridge::On(duties) => Some(duties.parts().map(f64::from)),
        };
        if self.current.was_haptic() {
            self.ticks += 1;
        }
        match duties {
            Some(_) => {
                self.ons += 1;
                self.on_since_off += 1;
            }
            None => {
                if self.ons > 0 && self.first_off.is_none() {
                    let step = ODRIVE_V3_24V.current_step_a;
                    let current =
                        |code: u16, offset: f32| (f64::from(code) - f64::from(offset)) * step;
                    self.first_off = Some(FirstOff {
                        currents_a: [
                            current(codes[0], self.motor.offset_b_codes),
                            current(codes[1], self.motor.offset_c_codes),
                        ],
                        bus_v: sensed.bus_v,
                        tick: self.ticks,
                    });
                    self.on_since_off = 0;
                }
                self.plant.cut();
            }
        }
        self.plant.period(duties);
        self.loudest_nm = self.loudest_nm.max(self.torque_nm().abs());
        if self.current.was_haptic() {
            self.serve();
        }
        self.slow_and_desk();
    }

    fn slow_and_desk(&mut self) {
        if !self.ticks_run {
            self.serve();
        }
        self.slow_in -= 1;
        if self.slow_in == 0 {
            self.slow_in = PERIODS;
            if self.slow_runs {
                self.upkeep.run(&mut self.board);
            }
        }
    }

    fn serve(&mut self) {
        if !self.desk_runs {
            return;
        }
        let (inbox, outbox) = (&mut self.inbox, &mut self.outbox);
        self.desk.serve(
            || inbox.pop_front(),
            |frame| outbox.extend_from_slice(frame),
        );
        let bytes = std::mem::take(&mut self.outbox);
        for answer in answers(&mut self.frames, &bytes) {
            answer.read(|sequence, message| match message {
                Message::Telemetry(it) => self.commanded_nm = it.torque_nm.map_or(0.0, f64::from),
                Message::Event(Event::Calibrated { end }) => self.ended = Some(*end),
                Message::Event(_) => {}
                message if sequence == self.asked => self.answered = Told::of(message),
                _ => {}
            });
        }
    }

    pub fn run(&mut self, periods: u32) {
        for _ in 0..periods {
            self.period();
        }
    }

    /// Periods until the bridge went off, at most so many.
    pub fn run_until_off(&mut self, most: u32) -> u32 {
        self.first_off = None;
        for passed in 1..=most {
            self.period();
            if self.first_off.is_some() {
                return passed;
            }
        }
        most + 1
    }

    /// Periods until there is no torque, at most so many.
    pub fn run_until_no_torque(&mut self, most: u32) -> u32 {
        for passed in 0..most {
            if self.torque_nm() == 0.0 {
                return passed;
            }
            self.period();
        }
        most
    }

    /// As the page says: the current goes within L·I/(bus − back-EMF), and the two periods of its beginning and end.
    pub fn decay_periods(&self) -> u32 {
        let current_a = self.plant.phase_currents().map(f64::abs);
        let most_a = current_a.into_iter().fold(0.0, f64::max);
        let left_v = self.plant.electrical().bus_v() - 2.0 * self.back_emf_v().abs();
        assert!(left_v > 0.0, "faster than the bus");
        (1.5 * self.inductance_h * most_a / left_v * 24e3) as u32 + 2
    }

    /// Asks, and runs until it is answered.
    pub fn ask(&mut self, request: Request) -> Told {
        self.asked = self.asked.wrapping_add(1) | 0x8000;
        self.answered = None;
        self.inbox.extend(request_frame(self.asked, request));
        for _ in 0..20_000 {
            self.period();
            if let Some(answer) = self.answered.take() {
                return answer;
            }
        }
        panic!("no answer to {request:?}");
    }

    pub fn state(&mut self) -> State {
        let Told::Status(status) = self.ask(Request::Status) else {
            panic!("no status");
        };
        status.state
    }

    pub fn snapshot(&mut self) -> Option<Snapshot> {
        let Told::Snapshot(snapshot) = self.ask(Request::LastFault) else {
            panic!("no snapshot");
        };
        snapshot
    }

    /// The gate driver shuts down and pulls its line: the interrupt puts the outputs off at once.
    pub fn gate_line_falls(&mut self) {
        self.gate_fault = true;
        self.plant.cut();
    }

    /// The counter runs at a part of the largest speed more than the knob.
    pub fn run_away(&mut self, part: f64) {
        let counts_s = part * 300.0 * f64::from(self.changes.counts_per_rev.expect("counts"))
            / std::f64::consts::TAU;
        self.add_counts_a_period = (counts_s / 24e3).ceil() as i32;
    }

    /// The true torque of the windings, Nm.
    pub fn torque_nm(&self) -> f64 {
        self.plant.electrical().torque_nm()
    }

    /// The torque that the last haptic tick told of, Nm.
    pub fn commanded_nm(&self) -> f64 {
        self.commanded_nm
    }

    pub fn torque_max_nm(&self) -> f64 {
        f64::from(self.motor.torque_constant_nm_a) * f64::from(self.motor.current_max_a)
    }

    pub fn tick(&self) -> u32 {
        self.ticks
    }

    /// Of a phase, or between a brushed motor's brushes, V.
    pub fn back_emf_v(&self) -> f64 {
        let per_speed = match self.motor.drive {
            Drive::Brushed => f64::from(self.motor.torque_constant_nm_a),
            _ => f64::from(self.motor.torque_constant_nm_a) / 1.5,
        };
        per_speed * self.plant.state().velocity
    }

    /// More than anything else explains at a count that stands, V.
    pub fn unexplained_limit_v(&self) -> f64 {
        let motor = &self.motor;
        f64::from(self.limits.unexplained_v)
            + f64::from(motor.resistance_ohm) * (0.75 * f64::from(motor.current_max_a) + 0.5)
            + 0.5
    }
}
