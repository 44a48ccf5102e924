//! Supervision of a power stage, once in each PWM period: what must put torque to zero sooner than the haptic tick comes.
//!
//! Each check compares what was sampled with a limit that a healthy motor cannot reach, and counts how
//! often in a row it was beyond: noise of hundreds of mA must not trip, and a fault must be seen in a stated number of
//! periods. `docs/safety.md` has them all in one table.
//!
//! | seen | beyond | in a row |
//! |---|---|---|
//! | a phase current, A's as −(B + C) | 1.5 times the motor's largest and 2 A; at the most what the converters measure | [`CURRENT_PERIODS`] |
//! | B + C of a brushed motor | 2 A and 15 % of that | [`SUM_PERIODS`] |
//! | bus voltage too high, too low | the stage's limits | [`HIGH_PERIODS`], [`LOW_PERIODS`] |
//! | the count in one period | twice the way at the largest speed, and 2 | 1 |
//! | the speed of its window, a count less | the largest | 1 |
//! | voltage that the motor's equation does not explain | [`Limits::unexplained_v`] | [`BLIND_PERIODS`], counted down where it is explained |
//! | mean current while the bridge is off | [`OFFSET_A`] | |
//!
//! All are written so that a number that is none counts as beyond.

use control::torque::sense::PhaseCurrents;
use protocol::{Drive, Fault, Motor};

use crate::power::StageFacts;

/// Periods in a row of a current beyond its limit.
pub const CURRENT_PERIODS: u8 = 2;
/// Of currents that do not add up.
pub const SUM_PERIODS: u8 = 4;
/// Of too high a bus.
pub const HIGH_PERIODS: u8 = 4;
/// Of too low a bus.
pub const LOW_PERIODS: u8 = 24;
/// More periods with an unexplained voltage than without.
pub const BLIND_PERIODS: u8 = 96;
/// The mean current of a bridge that is off, over some [`OFF_PERIODS`], A.
pub const OFFSET_A: f32 = 0.5;
/// Periods of that mean, and from the bridge's turning off until it counts.
pub const OFF_PERIODS: u16 = 256;

/// Noise and ripple beyond the motor's largest current, A.
const HEADROOM_A: f64 = 2.0;
/// The loop's overshoot where the motor is not as believed, and as much again.
const HEADROOM: f64 = 1.5;
/// Parts of the way to the nearer end of the converters' range up to which a current is one.
const RANGE: f64 = 0.95;
/// The difference of two amplifiers' gains, which may each be off by 6 %, in parts.
const GAINS: f64 = 0.15;
/// Of the back-EMF that the count tells, this part is not believed.
const EMF_SPREAD: f64 = 0.3;
/// What a loop may need without reason, V: dead time and ripple.
const UNEXPLAINED_V: f64 = 0.5;
/// The same for an error of the measured current, A.
const UNEXPLAINED_A: f64 = 1.0;

/// What the supervision compares with. Made from checked settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// A phase current, A.
    pub current_a: f32,
    /// |B + C| of a brushed motor, A; no limit where three phases are free.
    pub sum_a: f32,
    /// Bus voltage, V.
    pub bus_least_v: f32,
    /// The same.
    pub bus_most_v: f32,
    /// The most counts in one period.
    pub jump_counts: u32,
    /// The largest speed, rad/s.
    pub speed_rad_s: f32,
    /// What the drive may need beyond the motor's equation at rest, V.
    pub unexplained_v: f32,
    /// The same per speed, V s/rad.
    pub unexplained_v_s_rad: f32,
    /// There is a motor, so that the codes of no current are known.
    pub calibrated: bool,
}

impl Limits {
    /// For a motor and an encoder of checked values.
    #[must_use]
    pub fn new(
        motor: &Motor,
        counts_per_rev: u32,
        speed_max_rad_s: f32,
        stage: &StageFacts,
    ) -> Self {
        let count_rad = core::f64::consts::TAU / f64::from(counts_per_rev);
        let speed = f64::from(speed_max_rad_s);
        let way_counts = speed * stage.pwm_period_s / count_rad;
        let current_a = trip_a(motor, stage);
        let resistance = f64::from(motor.resistance_ohm);
        let emf = match motor.drive {
            Drive::Brushed => f64::from(motor.torque_constant_nm_a),
            _ => f64::from(motor.torque_constant_nm_a) / 1.5,
        };
        Self {
            current_a: current_a as f32,
            sum_a: match motor.drive {
                Drive::Brushed => (HEADROOM_A + GAINS * current_a) as f32,
                _ => f32::INFINITY,
            },
            bus_least_v: stage.bus_least_v as f32,
            bus_most_v: stage.bus_most_v as f32,
            jump_counts: (2.0 * way_counts) as u32 + 2,
            speed_rad_s: speed_max_rad_s,
            unexplained_v: (UNEXPLAINED_V + UNEXPLAINED_A * resistance) as f32,
            unexplained_v_s_rad: (EMF_SPREAD * emf) as f32,
            calibrated: motor.drive != Drive::None,
        }
    }
}

/// The current at which torque goes to zero, A.
fn trip_a(motor: &Motor, stage: &StageFacts) -> f64 {
    let wanted = HEADROOM * f64::from(motor.current_max_a) + HEADROOM_A;
    wanted.min(range_a(motor, stage))
}

/// The largest current that both converters measure either way, A.
fn range_a(motor: &Motor, stage: &StageFacts) -> f64 {
    let shift =
        |offset: f32| (f64::from(offset) - stage.current_zero_code).abs() * stage.current_step_a;
    let shift_a = shift(motor.offset_b_codes).max(shift(motor.offset_c_codes));
    RANGE * (stage.current_linear_a - shift_a)
}

/// The largest current that may be asked of a motor on this stage, A: below the trip by the same headroom, however
/// little the offsets leave of the converters' range.
#[must_use]
pub fn largest_current_a(motor: &Motor, stage: &StageFacts) -> f64 {
    (range_a(motor, stage) - HEADROOM_A) / HEADROOM
}

/// What is seen of one period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Currents as sampled.
    pub currents: PhaseCurrents,
    /// Bus voltage, V.
    pub bus_v: f32,
    /// Counts since the last period.
    pub moved: i32,
    /// Speed over its window, rad/s.
    pub speed_rad_s: f32,
    /// What the drive needed beyond the motor's equation, V; 0 where it does not know.
    pub unexplained_v: f32,
    /// The bridge may be on in this state.
    pub active: bool,
}

/// The supervision's memory.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Guard {
    over_current: u8,
    sum: u8,
    high: u8,
    low: u8,
    blind: u8,
    /// Anything of the above is above 0.
    alert: bool,
    /// Periods since the bridge went off, at most [`OFF_PERIODS`].
    off: u16,
    /// Mean of the currents while it is off, A.
    offsets: [f32; 2],
    /// The bus as last seen, V.
    bus_v: f32,
}

impl Guard {
    /// Nothing was seen yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// One period; what is wrong, where the bridge may be on.
    #[must_use]
    #[inline]
    pub fn look(&mut self, limits: &Limits, seen: &Seen) -> Option<Fault> {
        if !seen.active {
            self.rest(limits, seen);
            return None;
        }
        self.off = 0;
        let PhaseCurrents { b_a, c_a } = seen.currents;
        let sum_a = (b_a + c_a).abs();
        let speed_rad_s = seen.speed_rad_s.abs();
        let well = b_a.abs() <= limits.current_a
            && c_a.abs() <= limits.current_a
            && sum_a <= smaller(limits.current_a, limits.sum_a)
            && seen.bus_v >= limits.bus_least_v
            && seen.bus_v <= limits.bus_most_v
            && seen.moved.unsigned_abs() <= limits.jump_counts
            && speed_rad_s <= limits.speed_rad_s
            && seen.unexplained_v
                <= limits.unexplained_v + limits.unexplained_v_s_rad * speed_rad_s;
        if !well {
            return self.count(limits, seen);
        }
        if self.alert {
            (self.over_current, self.sum, self.high, self.low) = (0, 0, 0, 0);
            self.blind = self.blind.saturating_sub(1);
            self.alert = self.blind != 0;
        }
        None
    }

    /// One period of a bridge that is on without a known motor: only the bus is looked at.
    #[must_use]
    #[inline(never)]
    pub fn look_at_bus(&mut self, limits: &Limits, bus_v: f32) -> Option<Fault> {
        (self.over_current, self.sum, self.blind, self.off) = (0, 0, 0, 0);
        self.count_bus(limits, bus_v);
        self.alert = (self.high | self.low) != 0;
        self.bus_fault()
    }

    /// Where anything is beyond its limit.
    #[cold]
    #[inline(never)]
    fn count(&mut self, limits: &Limits, seen: &Seen) -> Option<Fault> {
        let PhaseCurrents { b_a, c_a } = seen.currents;
        let a_a = -(b_a + c_a);
        let largest_a = larger(larger(b_a.abs(), c_a.abs()), a_a.abs());
        self.over_current = in_a_row(self.over_current, largest_a <= limits.current_a);
        self.sum = in_a_row(self.sum, a_a.abs() <= limits.sum_a);
        self.count_bus(limits, seen.bus_v);
        let speed_rad_s = seen.speed_rad_s.abs();
        let explained =
            seen.unexplained_v <= limits.unexplained_v + limits.unexplained_v_s_rad * speed_rad_s;
        self.blind = if explained {
            self.blind.saturating_sub(1)
        } else {
            self.blind.saturating_add(1)
        };
        self.alert = (self.over_current | self.sum | self.high | self.low | self.blind) != 0;
        if seen.moved.unsigned_abs() > limits.jump_counts {
            return Some(Fault::EncoderJump { counts: seen.moved });
        }
        if self.sum >= SUM_PERIODS {
            return Some(Fault::CurrentSense);
        }
        if self.over_current >= CURRENT_PERIODS && self.sum == 0 {
            return Some(Fault::OverCurrent {
                current_a: largest_a,
            });
        }
        if self.high >= HIGH_PERIODS || self.low >= LOW_PERIODS {
            return self.bus_fault();
        }
        if speed_rad_s > limits.speed_rad_s {
            return Some(Fault::OverSpeed {
                speed_rad_s: seen.speed_rad_s,
            });
        }
        (self.blind >= BLIND_PERIODS).then_some(Fault::Encoder)
    }

    /// While the bridge is off.
    #[inline(never)]
    fn rest(&mut self, limits: &Limits, seen: &Seen) {
        (self.over_current, self.sum, self.blind) = (0, 0, 0);
        self.count_bus(limits, seen.bus_v);
        self.alert = (self.high | self.low) != 0;
        if self.off < OFF_PERIODS {
            self.off += 1;
            self.offsets = [0.0; 2];
            return;
        }
        let part = 1.0 / f32::from(OFF_PERIODS);
        let PhaseCurrents { b_a, c_a } = seen.currents;
        let [b, c] = &mut self.offsets;
        *b += (b_a - *b) * part;
        *c += (c_a - *c) * part;
    }

    #[inline]
    fn count_bus(&mut self, limits: &Limits, bus_v: f32) {
        self.bus_v = bus_v;
        self.high = in_a_row(self.high, bus_v <= limits.bus_most_v);
        // What is no number is not above the limit either, and was counted.
        self.low = in_a_row(
            self.low,
            bus_v >= limits.bus_least_v || bus_v > limits.bus_most_v,
        );
    }

    fn bus_fault(&self) -> Option<Fault> {
        let bus_v = self.bus_v;
        if self.high >= HIGH_PERIODS {
            return Some(Fault::OverVoltage { bus_v });
        }
        (self.low >= LOW_PERIODS).then_some(Fault::UnderVoltage { bus_v })
    }

    /// What stands in the way of leaving a fault.
    #[must_use]
    pub fn against_clearing(&self) -> Option<Fault> {
        self.bus_fault()
    }

    /// What stands in the way of arming.
    #[must_use]
    pub fn against_arming(&self, limits: &Limits) -> Option<Fault> {
        let [b_a, c_a] = self.offsets;
        let there = b_a.abs() <= OFFSET_A && c_a.abs() <= OFFSET_A;
        if limits.calibrated && !there {
            return Some(Fault::CurrentSense);
        }
        self.bus_fault()
    }
}

/// How often in a row something was not well.
#[inline(always)]
fn in_a_row(before: u8, well: bool) -> u8 {
    if well { 0 } else { before.saturating_add(1) }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}
