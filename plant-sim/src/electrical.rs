//! The electrical side of a motor: windings behind an inverter, one PWM period at a time.
//!
//! The shaft's motion is given, at constant speed over the period; what comes back is the torque.
//! A scene that does not ask for it has none of this: its motor is a [`drive`](crate::drive).
//!
//! In the rotor's frame, with ω = p·speed and the voltages of the bridge at rest in the windings',
//!
//! L_d i_d' = −R i_d + ω L_q i_q + u_d,  L_q i_q' = −R i_q − ω (L_d i_d + ψ) + u_q,
//! u_d' = ω u_q,  u_q' = −ω u_d,
//!
//! and for a brushed motor L i' = −R i − k·speed + u. Both are linear with constant coefficients, so a
//! period is an exponential of their matrix, summed as its series to rounding: there is no step
//! size in the currents. Their mean torque is Simpson's over pieces of at most 1/32 of the fastest
//! time constant: an error below 1e-6 of the torque's change within the period.
//!
//! # A phase that is open
//! With phase X disconnected, i flows from Y to Z, the phases after it. δ is the angle from the rotor's d axis
//! to their common axis, square to X's:
//!
//! λ' = u_Y − u_Z − 2R i,  λ = 2(L_d cos² δ + L_q sin² δ) i + √3 ψ cos δ,  i_d = 2/√3 i cos δ,  i_q = 2/√3 i sin δ,
//!
//! by classical Runge–Kutta on the same pieces: an error below 1e-8 of λ. A phase that is
//! cut off while it carries current leaves λ as it is; an arc takes the rest.
//!
//! # All switches off
//! Current goes on through the diodes: a phase whose current flows out of the bridge is at 0 V, one whose current flows
//! into it at the bus voltage. Where a phase's current ends, which is found to rounding, it stays 0 until the bridge
//! switches again, and the other two go on as above until they end too.
//!
//! What a real inverter adds is opt-in, each by a number that is 0 where it is not wanted: see
//! [`Inverter`], [`CurrentSensing`], [`Supply`]. Cogging is the [`motor`](crate::motor)'s.
//!
//! # Assumed
//! The inverter is its average over the period: no switching ripple, switches and diodes without
//! resistance or forward voltage. Iron does not saturate and the back-EMF is a sine. With all switches
//! off, the back-EMF does not make a phase conduct again: true while between two phases it is less than the bus.

mod windings;

use std::f64::consts::TAU;

use control::ConfigError;
use control::torque::{BrushedMotor, ThreePhaseMotor};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

use crate::knob::KnobError;
use windings::{Carrying, Done, Run};

/// What the bridge drives. The electrical angle of three phases is p times the shaft's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Winding {
    /// Three phases.
    ThreePhase(ThreePhaseMotor),
    /// A brushed motor from phase B to C.
    Brushed(BrushedMotor),
}

/// The bridge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inverter {
    /// The PWM period, s.
    pub pwm_period_s: f64,
    /// Steps of a duty from 0 to 1, to the nearest of which it is rounded; 0: none.
    pub pwm_steps: u16,
    /// Both switches of a phase are off for so long at each change, s; 0: none. A phase gets
    /// (duty − sgn(i)·dead time/period)·bus, i its current at the period's start.
    pub dead_time_s: f64,
    /// Below this current the loss is in proportion to it, A, as ripple and the switches' capacitance
    /// have it; 0: the whole loss from any current on.
    pub dead_time_edge_a: f64,
    /// What the bridge is told acts one period later.
    pub late: bool,
}

impl Inverter {
    /// Nothing but an average.
    #[must_use]
    pub fn ideal(pwm_period_s: f64) -> Self {
        Self {
            pwm_period_s,
            pwm_steps: 0,
            dead_time_s: 0.0,
            dead_time_edge_a: 0.0,
            late: false,
        }
    }
}

/// How the currents of B and C are measured: (i + offset + noise) rounded to a step. All 0, the
/// default, is ideal.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CurrentSensing {
    /// The converter's step, A; 0: none.
    pub step_a: f64,
    /// Standard deviation of normal noise, A.
    pub noise_a: f64,
    /// Of B and C, A.
    pub offset_a: [f64; 2],
    /// Of the noise.
    pub seed: u64,
}

/// What feeds the bus: a source behind a resistance, with a capacitor on the bus,
///
/// C v' = (source − v)/R_s − power of the bridge/v.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supply {
    /// Without load, V.
    pub source_v: f64,
    /// R_s, Ω; 0: the bus stays at `source_v`.
    pub source_ohm: f64,
    /// C, F.
    pub capacitance_f: f64,
    /// The source takes current back; else the bus rises while the motor brakes.
    pub takes_back: bool,
}

impl Supply {
    /// A bus that stays where it is.
    #[must_use]
    pub fn stiff(source_v: f64) -> Self {
        Self {
            source_v,
            source_ohm: 0.0,
            capacitance_f: 0.0,
            takes_back: true,
        }
    }
}

/// How the bridge's phases A, B, C are connected to the motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wiring {
    /// The motor's terminal, 0 to 2 for A to C, at each phase of the bridge: a permutation. A brushed motor
    /// has its ends at B and C; with `[1, 2, 0]` it is between the bridge's A and B.
    pub terminals: [usize; 3],
    /// The phase of the bridge that is not connected.
    pub open: Option<usize>,
}

impl Default for Wiring {
    /// As it should be.
    fn default() -> Self {
        Self {
            terminals: [0, 1, 2],
            open: None,
        }
    }
}

impl Wiring {
    fn check(&self) -> Result<(), KnobError> {
        let mut terminals = self.terminals;
        terminals.sort_unstable();
        if terminals != [0, 1, 2] || self.open.is_some_and(|phase| phase > 2) {
            return Err(KnobError::Wiring(*self));
        }
        Ok(())
    }

    /// From the order of the motor's terminals to that of the bridge's phases.
    fn at_bridge(&self, of_terminals: [f64; 3]) -> [f64; 3] {
        self.terminals.map(|terminal| of_terminals[terminal])
    }

    /// And back.
    fn at_motor(&self, of_phases: [f64; 3]) -> [f64; 3] {
        let mut of_terminals = [0.0; 3];
        for (terminal, value) in self.terminals.into_iter().zip(of_phases) {
            of_terminals[terminal] = value;
        }
        of_terminals
    }
}

/// What one PWM period did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    /// The mean torque on the shaft, Nm.
    pub torque_nm: f64,
    /// The energy that the bridge took from the bus, J.
    pub drawn_j: f64,
}

/// Windings, bridge, bus and sensing, between two PWM periods.
///
/// ```
/// use control::torque::BrushedMotor;
/// use plant_sim::electrical::{CurrentSensing, Electrical, Inverter, Supply, Winding};
/// let motor = BrushedMotor { resistance_ohm: 2.0, inductance_h: 1e-3, torque_constant_nm_a: 0.05 };
/// let mut windings = Electrical::new(
///     Winding::Brushed(motor),
///     Inverter::ideal(1e-3),
///     CurrentSensing::default(),
///     Supply::stiff(10.0),
/// )?;
/// // 4 V for 2 L/R: 2 A · (1 − e⁻²).
/// windings.period(Some([0.0, 0.7, 0.3]), 0.0, 0.0);
/// assert!((windings.torque_nm() - 0.1 * (1.0 - (-2.0_f64).exp())).abs() < 1e-15);
/// # Ok::<(), plant_sim::knob::KnobError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Electrical {
    winding: Winding,
    inverter: Inverter,
    sensing: CurrentSensing,
    supply: Supply,
    wiring: Wiring,
    carrying: Carrying,
    /// i_d, i_q; or the brushed motor's current and 0. A.
    currents: [f64; 2],
    bus_v: f64,
    /// Duties on their way; none: all switches off.
    waiting: Option<[f64; 3]>,
    random: Pcg64,
}

/// The most time constants R/L in a period: far beyond any motor.
const FASTEST: f64 = 100.0;

impl Electrical {
    /// Without current, the bus at its source's voltage, all switches off until the first duties act, wired as it
    /// should be.
    ///
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, a supply with a resistance and no
    /// capacitance, and windings with R/L beyond 100 per period.
    pub fn new(
        winding: Winding,
        inverter: Inverter,
        sensing: CurrentSensing,
        supply: Supply,
    ) -> Result<Self, KnobError> {
        let above_zero = [
            ("PWM period (s)", inverter.pwm_period_s),
            ("source voltage (V)", supply.source_v),
        ];
        let windings = match winding {
            Winding::ThreePhase(motor) => [
                ("phase resistance (Ω)", motor.resistance_ohm),
                ("d inductance (H)", motor.d_inductance_h),
                ("q inductance (H)", motor.q_inductance_h),
                ("flux (Wb)", motor.flux_wb),
                ("pole pairs", f64::from(motor.pole_pairs)),
            ],
            Winding::Brushed(motor) => [
                ("resistance (Ω)", motor.resistance_ohm),
                ("inductance (H)", motor.inductance_h),
                ("inductance (H)", motor.inductance_h),
                ("torque constant (Nm/A)", motor.torque_constant_nm_a),
                ("torque constant (Nm/A)", motor.torque_constant_nm_a),
            ],
        };
        for (name, value) in above_zero.into_iter().chain(windings) {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ConfigError::NotPositive { name, value }.into());
            }
        }
        for (name, value) in [
            ("dead time (s)", inverter.dead_time_s),
            (
                "current of the whole dead time (A)",
                inverter.dead_time_edge_a,
            ),
            ("current step (A)", sensing.step_a),
            ("current noise (A)", sensing.noise_a),
            ("source resistance (Ω)", supply.source_ohm),
            ("bus capacitance (F)", supply.capacitance_f),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(ConfigError::Negative { name, value }.into());
            }
        }
        if supply.source_ohm > 0.0 && supply.capacitance_f == 0.0 {
            let (name, value) = ("bus capacitance (F)", supply.capacitance_f);
            return Err(ConfigError::NotPositive { name, value }.into());
        }
        for value in sensing.offset_a {
            if !value.is_finite() {
                let name = "current offset (A)";
                return Err(KnobError::NotFinite { name, value });
            }
        }
        let electrical = Self {
            winding,
            inverter,
            sensing,
            supply,
            wiring: Wiring::default(),
            carrying: Carrying::None,
            currents: [0.0; 2],
            bus_v: supply.source_v,
            waiting: None,
            random: Pcg64::seed_from_u64(sensing.seed),
        };
        let value = winding.rate(0.0) * inverter.pwm_period_s;
        if value > FASTEST {
            return Err(KnobError::Above {
                name: "resistance / inductance × PWM period",
                value,
                limit: FASTEST,
                reason: "far beyond any motor",
            });
        }
        Ok(electrical)
    }

    /// The bus voltage, V.
    #[must_use]
    pub fn bus_v(&self) -> f64 {
        self.bus_v
    }

    /// The torque at this moment, Nm.
    #[must_use]
    pub fn torque_nm(&self) -> f64 {
        self.winding.torque_nm(self.currents)
    }

    /// i_d and i_q, or a brushed motor's current and 0, A.
    #[must_use]
    pub fn rotor_currents(&self) -> [f64; 2] {
        self.currents
    }

    /// Wires the motor otherwise from now on.
    ///
    /// # Errors
    /// Refuses what is not a permutation, or a phase beyond C.
    pub fn wire(&mut self, wiring: Wiring) -> Result<(), KnobError> {
        wiring.check()?;
        self.wiring = wiring;
        self.carrying = match (self.carrying, self.connected()) {
            (Carrying::All, connected) => connected,
            (Carrying::AllBut(phase), Carrying::AllBut(open)) if phase != open => Carrying::None,
            (carrying, _) => carrying,
        };
        self.drop_what_is_not_carried();
        Ok(())
    }

    /// All switches off at once, also for what is on its way.
    pub fn cut(&mut self) {
        self.waiting = None;
    }

    /// The currents of A, B, C of the bridge with the shaft at an angle (rad), A.
    #[must_use]
    pub fn phase_currents(&self, angle_rad: f64) -> [f64; 3] {
        let angle = self.winding.electrical(angle_rad);
        let terminals = self.winding.phases(self.carrying, self.currents, angle);
        self.wiring.at_bridge(terminals)
    }

    /// The currents of B and C as measured with the shaft at an angle (rad), A.
    pub fn measure(&mut self, angle_rad: f64) -> [f64; 2] {
        let [_, b, c] = self.phase_currents(angle_rad);
        let CurrentSensing {
            step_a,
            noise_a,
            offset_a,
            ..
        } = self.sensing;
        let mut measured = [b + offset_a[0], c + offset_a[1]];
        for current in &mut measured {
            if noise_a > 0.0 {
                *current += noise_a * self.normal();
            }
            if step_a > 0.0 {
                *current = (*current / step_a).round() * step_a;
            }
        }
        measured
    }

    /// One period under duties of A, B, C, or with all switches off, the shaft at `angle_rad` at its start and at
    /// a constant speed (rad/s).
    pub fn period(
        &mut self,
        bridge: Option<[f64; 3]>,
        angle_rad: f64,
        velocity_rad_s: f64,
    ) -> Period {
        let bridge = if self.inverter.late {
            std::mem::replace(&mut self.waiting, bridge)
        } else {
            bridge
        };
        let period_s = self.inverter.pwm_period_s;
        let mut done = Done::default();
        match bridge {
            Some(duties) => {
                let volts = self.given(duties, self.phase_currents(angle_rad));
                self.carrying = self.connected();
                self.drop_what_is_not_carried();
                if self.carrying != Carrying::None {
                    let volts = self.wiring.at_motor(volts);
                    let run = self.run(volts, angle_rad, velocity_rad_s);
                    self.currents = run.through(period_s, &mut done);
                }
            }
            None => self.coast(angle_rad, velocity_rad_s, &mut done),
        }
        self.feed(done.drawn_j);
        Period {
            torque_nm: done.torque_nm_s / period_s,
            drawn_j: done.drawn_j,
        }
    }

    /// A period with all switches off.
    fn coast(&mut self, mut angle_rad: f64, velocity_rad_s: f64, done: &mut Done) {
        let mut left_s = self.inverter.pwm_period_s;
        while left_s > 0.0 && self.carrying != Carrying::None {
            let angle = self.winding.electrical(angle_rad);
            let currents = self.winding.phases(self.carrying, self.currents, angle);
            let volts = currents.map(|current| if current < 0.0 { self.bus_v } else { 0.0 });
            let signs = currents.map(f64::signum);
            let run = self.run(volts, angle_rad, velocity_rad_s);
            let (took_s, currents, ended) = run.until_one_ends(signs, left_s, done);
            self.currents = currents;
            left_s -= took_s;
            angle_rad += velocity_rad_s * took_s;
            if let Some(phase) = ended {
                self.carrying = match (self.carrying, self.winding) {
                    (Carrying::All, Winding::ThreePhase(_)) => Carrying::AllBut(phase),
                    _ => Carrying::None,
                };
                self.drop_what_is_not_carried();
            }
        }
    }

    fn run(&self, volts: [f64; 3], angle_rad: f64, velocity_rad_s: f64) -> Run<'_> {
        Run::new(
            &self.winding,
            self.carrying,
            self.currents,
            volts,
            angle_rad,
            velocity_rad_s,
        )
    }

    /// Which terminals may carry current while the bridge switches.
    fn connected(&self) -> Carrying {
        let open = self.wiring.open.map(|phase| self.wiring.terminals[phase]);
        match (open, self.winding) {
            (None, _) | (Some(0), Winding::Brushed(_)) => Carrying::All,
            (Some(open), Winding::ThreePhase(_)) => Carrying::AllBut(open),
            (Some(_), Winding::Brushed(_)) => Carrying::None,
        }
    }

    fn drop_what_is_not_carried(&mut self) {
        if self.carrying == Carrying::None {
            self.currents = [0.0; 2];
        }
    }

    /// The phase voltages that duties give, V.
    fn given(&self, duties: [f64; 3], currents: [f64; 3]) -> [f64; 3] {
        let Inverter {
            pwm_period_s,
            pwm_steps,
            dead_time_s,
            dead_time_edge_a,
            ..
        } = self.inverter;
        let steps = f64::from(pwm_steps);
        let mut volts = [0.0; 3];
        for ((volt, duty), current) in volts.iter_mut().zip(duties).zip(currents) {
            let mut part = duty;
            if pwm_steps > 0 {
                part = (duty * steps).round() / steps;
            }
            if dead_time_s > 0.0 && current != 0.0 {
                let sign = if current.abs() < dead_time_edge_a {
                    current / dead_time_edge_a
                } else {
                    current.signum()
                };
                part -= sign * dead_time_s / pwm_period_s;
            }
            *volt = part * self.bus_v;
        }
        volts
    }

    /// The bus after a period in which the bridge took `drawn_j`: exactly, for a current of that much
    /// charge held over the period.
    fn feed(&mut self, drawn_j: f64) {
        let Supply {
            source_v,
            source_ohm,
            capacitance_f,
            takes_back,
        } = self.supply;
        if source_ohm == 0.0 {
            return;
        }
        let period_s = self.inverter.pwm_period_s;
        let current_a = drawn_j / period_s / self.bus_v;
        if self.bus_v > source_v && !takes_back {
            self.bus_v -= current_a * period_s / capacitance_f;
        } else {
            let goal_v = source_v - source_ohm * current_a;
            let left = (-period_s / (source_ohm * capacitance_f)).exp();
            self.bus_v = goal_v + (self.bus_v - goal_v) * left;
        }
        // A load that takes all of it stalls the bridge; it does not turn the bus round.
        self.bus_v = self.bus_v.max(1e-3 * source_v);
    }

    /// A standard normal number, by Box and Muller.
    fn normal(&mut self) -> f64 {
        let mut uniform = || ((self.random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
        let radius = (-2.0 * uniform().ln()).sqrt();
        radius * (TAU * uniform()).cos()
    }
}
