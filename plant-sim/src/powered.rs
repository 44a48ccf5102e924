//! A knob turned by windings behind an inverter: the mechanics of [`knob`](crate::knob) and the currents of
//! [`electrical`](crate::electrical), one PWM period at a time, with the sensors that a board has.
//!
//! In each period the windings see the speed of its start, and the knob gets the period's mean torque. Between
//! them that is of first order in the period h: with an acceleration a, the back-EMF is off by k·a·h/2 (k the torque
//! constant), and motor work is off by torque·a·h²/2 in a period. At 24 kHz and 10⁴ rad/s² that is 0.2 rad/s of
//! speed. Each of the two is exact by itself, as it says.
//!
//! At the start of period k: [`Powered::sensed`], then [`Powered::period`] with what was decided. With
//! [`Inverter::late`] that is in force in period k + 1, as a board has it.
//!
//! # What can be broken
//! [`Wiring`] disconnects or swaps phases; [`EncoderFault`], [`Powered::slip`] and [`Powered::stick`] spoil
//! the sensors. A shorted winding is one of little resistance, an encoder of another resolution one of other
//! counts, from the start.

use std::f64::consts::TAU;

use control::ConfigError;
use control::criterion::Device;

use crate::drive::Drive;
use crate::electrical::{CurrentSensing, Electrical, Inverter, Period, Supply, Winding, Wiring};
use crate::hand::Hand;
use crate::hold::State;
use crate::knob::{Interval, Knob, KnobError};
use crate::motor::Motor;

/// The converters' code of no current, where amplifiers have no offset.
pub const ZERO_CODE: f64 = 2048.0;

/// The largest code.
pub const TOP_CODE: u16 = 4095;

/// How the encoder sits on the shaft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderSetup {
    /// Counts in a turn; count n lies from n to n + 1 times 2π/counts, rad.
    pub counts_per_rev: u32,
    /// The counter is −n.
    pub reversed: bool,
    /// The electrical angle at the middle of count 0, turns. A brushed motor has none.
    pub zero_turns: f64,
}

/// All that makes a powered knob.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setup {
    /// Inertia and friction.
    pub device: Device<f64>,
    /// Cogging and stiction.
    pub motor: Motor,
    /// The hand on the knob.
    pub hand: Hand,
    /// What the bridge drives.
    pub winding: Winding,
    /// The bridge.
    pub inverter: Inverter,
    /// Of the currents; its step is above 0.
    pub sensing: CurrentSensing,
    /// What feeds the bus.
    pub supply: Supply,
    /// The encoder.
    pub encoder: EncoderSetup,
    /// Angle and velocity.
    pub start: State,
}

/// How an encoder may fail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EncoderFault {
    /// It follows only a part of the motion, 0 to 1.
    Slipping {
        /// That part.
        follows: f64,
    },
    /// The counter stands.
    Stuck,
    /// Channel B is dead: the counter goes one up and one down again as A changes.
    DeadChannel,
}

/// What a board reads at the start of a period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensed {
    /// Codes of the converters of B and C: [`ZERO_CODE`] + (current + offset + noise)/step, to the nearest
    /// from 0 to [`TOP_CODE`].
    pub codes: [u16; 2],
    /// The bus voltage, V.
    pub bus_v: f64,
    /// The encoder's counter, which wraps.
    pub counter: u32,
}

/// What a period did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turned {
    /// To the windings.
    pub electrical: Period,
    /// To the knob.
    pub mechanical: Interval,
}

/// A powered knob between two PWM periods.
///
/// ```
/// use control::criterion::Device;
/// use control::torque::BrushedMotor;
/// use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding};
/// use plant_sim::hand::Hand;
/// use plant_sim::hold::State;
/// use plant_sim::motor::Motor;
/// use plant_sim::powered::{EncoderSetup, Powered, Setup};
/// let mut knob = Powered::new(&Setup {
///     device: Device { inertia_kg_m2: 1e-5, viscous_nm_s_rad: 0.0, coulomb_nm: 0.0 },
///     motor: Motor::default(),
///     hand: Hand::default(),
///     winding: Winding::Brushed(BrushedMotor {
///         resistance_ohm: 2.0,
///         inductance_h: 1e-3,
///         torque_constant_nm_a: 0.05,
///     }),
///     inverter: Inverter::ideal(1.0 / 24e3),
///     sensing: CurrentSensing { step_a: 0.02, ..CurrentSensing::default() },
///     supply: Supply::stiff(24.0),
///     encoder: EncoderSetup { counts_per_rev: 8192, reversed: false, zero_turns: 0.0 },
///     start: State { position: 0.0, velocity: 0.0 },
/// })?;
/// for _ in 0..24_000 {
///     knob.period(Some([0.0, 0.6, 0.4]));
/// }
/// // 4.8 V against 50 mV s/rad.
/// assert!((knob.state().velocity - 96.0).abs() < 1e-6);
/// # Ok::<(), plant_sim::knob::KnobError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Powered {
    knob: Knob,
    electrical: Electrical,
    encoder: Encoder,
    step_a: f64,
    pwm_period_s: f64,
    /// From the knob's angle to one whose multiple is the electrical angle, rad.
    ahead_rad: f64,
    stuck: [Option<u16>; 2],
}

impl Powered {
    /// Without current, all switches off, the counter at its count.
    ///
    /// # Errors
    /// Refuses what [`Knob::new`] and [`Electrical::new`] do, a step of the current converters that is not
    /// above 0, and an encoder without counts or with a zero that is not finite.
    pub fn new(setup: &Setup) -> Result<Self, KnobError> {
        let encoder = setup.encoder;
        for (name, value) in [
            ("current step (A)", setup.sensing.step_a),
            ("counts in a turn", f64::from(encoder.counts_per_rev)),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ConfigError::NotPositive { name, value }.into());
            }
        }
        if !encoder.zero_turns.is_finite() {
            return Err(KnobError::NotFinite {
                name: "electrical angle at count 0 (turns)",
                value: encoder.zero_turns,
            });
        }
        // Codes are rounded here, as they may saturate.
        let sensing = CurrentSensing {
            step_a: 0.0,
            ..setup.sensing
        };
        let electrical = Electrical::new(setup.winding, setup.inverter, sensing, setup.supply)?;
        let pwm_period_s = setup.inverter.pwm_period_s;
        let knob = Knob::new(
            &setup.device,
            &setup.motor,
            &setup.hand,
            &Drive::default(),
            pwm_period_s,
            setup.start,
        )?;
        let count_rad = TAU / f64::from(encoder.counts_per_rev);
        let ahead_rad = match setup.winding {
            Winding::ThreePhase(motor) => {
                TAU * encoder.zero_turns / f64::from(motor.pole_pairs) - 0.5 * count_rad
            }
            Winding::Brushed(_) => 0.0,
        };
        Ok(Self {
            knob,
            electrical,
            encoder: Encoder {
                count_rad,
                reversed: encoder.reversed,
                follows: 1.0,
                at_rad: 0.0,
                fault: None,
                fault_count: 0,
                slipped: 0,
            },
            step_a: setup.sensing.step_a,
            pwm_period_s,
            ahead_rad,
            stuck: [None; 2],
        })
    }

    /// What the board reads now. The noise is another one at each call.
    pub fn sensed(&mut self) -> Sensed {
        let currents = self.electrical.measure(self.motor_angle_rad());
        let mut codes = currents.map(|current| {
            let code = (ZERO_CODE + current / self.step_a).round();
            code.clamp(0.0, f64::from(TOP_CODE)) as u16
        });
        for (code, stuck) in codes.iter_mut().zip(self.stuck) {
            *code = stuck.unwrap_or(*code);
        }
        Sensed {
            codes,
            bus_v: self.electrical.bus_v(),
            counter: self.encoder.counter(self.knob.state().position),
        }
    }

    /// A PWM period under duties of A, B, C, or with all switches off.
    pub fn period(&mut self, bridge: Option<[f64; 3]>) -> Turned {
        let angle_rad = self.motor_angle_rad();
        let electrical = self
            .electrical
            .period(bridge, angle_rad, self.knob.state().velocity);
        Turned {
            electrical,
            mechanical: self.knob.hold(electrical.torque_nm, self.pwm_period_s),
        }
    }

    /// All switches off at once, as by an interrupt; what is on its way is lost.
    pub fn cut(&mut self) {
        self.electrical.cut();
    }

    /// Angle (rad) and velocity (rad/s), as they truly are.
    #[must_use]
    pub fn state(&self) -> State {
        self.knob.state()
    }

    /// The windings: torque, currents along d and q, bus voltage, as they truly are.
    #[must_use]
    pub fn electrical(&self) -> &Electrical {
        &self.electrical
    }

    /// The true currents of the bridge's A, B, C, A.
    #[must_use]
    pub fn phase_currents(&self) -> [f64; 3] {
        self.electrical.phase_currents(self.motor_angle_rad())
    }

    /// Wires the motor otherwise from now on.
    ///
    /// # Errors
    /// Refuses what is not a permutation, or a phase beyond C.
    pub fn wire(&mut self, wiring: Wiring) -> Result<(), KnobError> {
        self.electrical.wire(wiring)
    }

    /// The encoder fails from now on in this way, or goes on as it should from where it stands.
    pub fn fault_encoder(&mut self, fault: Option<EncoderFault>) {
        self.encoder.fail(fault, self.knob.state().position);
    }

    /// The encoder jumps by so many counts.
    pub fn slip(&mut self, counts: i32) {
        self.encoder.slipped += i64::from(counts);
    }

    /// The converters of B and C stand at these codes from now on, where there is one.
    pub fn stick(&mut self, codes: [Option<u16>; 2]) {
        self.stuck = codes;
    }

    /// The angle whose multiple is the electrical one, rad.
    fn motor_angle_rad(&self) -> f64 {
        self.knob.state().position + self.ahead_rad
    }
}

/// An encoder that may fail: it sees the angle `at_rad` + `follows`·angle.
#[derive(Debug, Clone)]
struct Encoder {
    count_rad: f64,
    reversed: bool,
    follows: f64,
    at_rad: f64,
    fault: Option<EncoderFault>,
    /// Where the fault began.
    fault_count: i64,
    slipped: i64,
}

impl Encoder {
    fn seen(&self, angle_rad: f64) -> i64 {
        ((self.at_rad + self.follows * angle_rad) / self.count_rad).floor() as i64
    }

    fn count(&self, angle_rad: f64) -> i64 {
        // Channel A is high in the second and third of four counts.
        let a = |count: i64| i64::from(matches!(count.rem_euclid(4), 1 | 2));
        match self.fault {
            Some(EncoderFault::Stuck) => self.fault_count,
            Some(EncoderFault::DeadChannel) => {
                self.fault_count + a(self.seen(angle_rad)) - a(self.fault_count)
            }
            Some(EncoderFault::Slipping { .. }) | None => self.seen(angle_rad),
        }
    }

    fn counter(&self, angle_rad: f64) -> u32 {
        let count = self.count(angle_rad) + self.slipped;
        (if self.reversed { -count } else { count }) as u32
    }

    fn fail(&mut self, fault: Option<EncoderFault>, angle_rad: f64) {
        let standing = self.count(angle_rad);
        self.slipped += standing - self.seen(angle_rad);
        self.fault_count = self.seen(angle_rad);
        let follows = match fault {
            Some(EncoderFault::Slipping { follows }) => follows,
            _ => 1.0,
        };
        self.at_rad += (self.follows - follows) * angle_rad;
        self.follows = follows;
        self.fault = fault;
    }
}
