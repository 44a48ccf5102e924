//! From a voltage to duties: space-vector modulation, dead-time compensation, voltage limit.

use super::frames::{Rotating, Stationary};
use super::{InverterConfig, TorqueError, at_most, within};
use crate::error::{not_negative, positive};
use crate::real::{larger, smaller};
use crate::root::root;

/// 1/√3.
const THIRD_ROOT: f64 = 0.577_350_269_189_625_8;

/// The parts of a period in which the high sides of A, B, C are on, each from 0 to the largest
/// duty of the inverter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Duties([f32; 3]);

impl Duties {
    /// Of A, B, C.
    #[must_use]
    #[inline]
    pub fn parts(self) -> [f32; 3] {
        self.0
    }

    /// The nearest whole numbers of steps, of which a duty of 1 has `steps`.
    #[must_use]
    #[inline]
    pub fn in_steps(self, steps: u16) -> [u16; 3] {
        self.0.map(|part| (part * f32::from(steps) + 0.5) as u16)
    }
}

/// A bus voltage that can be divided by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bus {
    volts: f32,
    per_volt: f32,
}

/// How voltages become duties. Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Modulator {
    duty_max: f32,
    bus_least_v: f32,
    /// δ, the dead time's part of the period.
    dead: f32,
    /// 1/(the current from which all of it is lost), 1/A.
    dead_edge_per_a: f32,
    /// The longest voltage vector of a three-phase motor, and the largest voltage between two phases,
    /// in units of the bus voltage.
    vector_reach: f32,
    line_reach: f32,
}

impl Modulator {
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, a largest duty above 1, two dead
    /// times that leave nothing of it, and a least bus voltage above the most.
    pub fn new(config: &InverterConfig) -> Result<Self, TorqueError> {
        positive("PWM period (s)", config.pwm_period_s as f32)?;
        positive("PWM steps", f64::from(config.pwm_steps))?;
        not_negative("dead time (s)", config.dead_time_s)?;
        positive("current step (A)", config.current_step_a as f32)?;
        positive("largest duty", config.duty_max)?;
        at_most("largest duty", config.duty_max, 1.0)?;
        positive("most bus voltage (V)", config.bus_most_v as f32)?;
        at_most(
            "least bus voltage (V)",
            config.bus_least_v,
            config.bus_most_v,
        )?;
        let dead = config.dead_time_s / config.pwm_period_s;
        let line_reach = config.duty_max - 2.0 * dead;
        let edge_a = positive(
            "current of the whole dead time (A)",
            config.dead_time_edge_a,
        )?;
        Ok(Self {
            duty_max: config.duty_max as f32,
            bus_least_v: positive("least bus voltage (V)", config.bus_least_v as f32)?,
            dead: dead as f32,
            dead_edge_per_a: positive("1 / current of the whole dead time", (1.0 / edge_a) as f32)?,
            vector_reach: (line_reach * THIRD_ROOT) as f32,
            line_reach: positive("largest duty − 2 dead times / period", line_reach as f32)?,
        })
    }

    /// A measured bus voltage (V), at least the least to reckon with: the tick's only division.
    #[must_use]
    #[inline]
    pub fn bus(&self, measured_v: f32) -> Bus {
        let volts = larger(self.bus_least_v, measured_v);
        Bus {
            volts,
            per_volt: 1.0 / volts,
        }
    }

    /// A voltage vector, cut to the circle of (duty_max − 2δ)·bus/√3 that fits into the hexagon of all
    /// that can be modulated: d keeps what it asks for, q gets what is left.
    #[must_use]
    #[inline]
    pub fn limited(&self, volts: Rotating, bus: Bus) -> Rotating {
        let most = self.vector_reach * bus.volts;
        let square = most * most;
        if volts.d * volts.d + volts.q * volts.q <= square {
            return volts;
        }
        let d = within(volts.d, most);
        Rotating {
            d,
            q: within(volts.q, root(larger(0.0, square - d * d))),
        }
    }

    /// A voltage between two phases, cut to ±(duty_max − 2δ)·bus.
    #[must_use]
    #[inline]
    pub fn limited_line(&self, volts: f32, bus: Bus) -> f32 {
        within(volts, self.line_reach * bus.volts)
    }

    /// The duties that give a three-phase motor a voltage vector on the mean of the period, where
    /// `currents` (A) flow. Space-vector modulation, by its equivalent: the middle of the
    /// largest and the smallest phase voltage lies in the middle of the duties.
    ///
    /// With dead time a phase changes over late: it loses δ of its duty while current flows out of
    /// it, and gains δ while it flows in. That is put back, in proportion below the edge current.
    #[must_use]
    #[inline]
    pub fn three_phase(&self, volts: Stationary, currents: Stationary, bus: Bus) -> Duties {
        let [a, b, c] = volts.phases();
        let [i_a, i_b, i_c] = currents.phases();
        let a = a * bus.per_volt + self.lost(i_a);
        let b = b * bus.per_volt + self.lost(i_b);
        let c = c * bus.per_volt + self.lost(i_c);
        let most = larger(a, larger(b, c));
        let least = smaller(a, smaller(b, c));
        let middle = 0.5 * (self.duty_max - most - least);
        Duties([a + middle, b + middle, c + middle].map(|duty| self.possible(duty)))
    }

    /// The duties that give a motor between B and C a voltage (V) where a current (A) flows from B to
    /// C through it. A is not connected, its low side on.
    #[must_use]
    #[inline]
    pub fn two_phase(&self, volts: f32, current_a: f32, bus: Bus) -> Duties {
        let lead = 0.5 * volts * bus.per_volt + self.lost(current_a);
        let middle = 0.5 * self.duty_max;
        Duties([
            0.0,
            self.possible(middle + lead),
            self.possible(middle - lead),
        ])
    }

    /// What a phase loses of its duty.
    #[inline(always)]
    fn lost(&self, current_a: f32) -> f32 {
        self.dead * within(current_a * self.dead_edge_per_a, 1.0)
    }

    /// The nearest duty; 0 for what is not a number.
    #[inline(always)]
    fn possible(&self, duty: f32) -> f32 {
        if duty >= self.duty_max {
            self.duty_max
        } else if duty > 0.0 {
            duty
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CONFIG: InverterConfig = InverterConfig {
        pwm_period_s: 1.0 / 24e3,
        pwm_steps: 3500,
        dead_time_s: 0.0,
        dead_time_edge_a: 0.2,
        duty_max: 0.85,
        bus_least_v: 8.0,
        bus_most_v: 56.0,
        current_step_a: 0.020_14,
    };

    const NONE: Stationary = Stationary {
        alpha: 0.0,
        beta: 0.0,
    };

    /// The vector that duties give, V.
    fn vector(duties: Duties, bus_v: f32) -> Stationary {
        let [a, b, c] = duties.parts().map(|part| part * bus_v);
        let star = (a + b + c) / 3.0;
        Stationary::from_two_phases(b - star, c - star)
    }

    fn finite_or_not() -> impl Strategy<Value = f32> {
        prop_oneof![
            8 => -1e3..1e3f32,
            1 => prop_oneof![Just(f32::NAN), Just(f32::INFINITY), Just(f32::NEG_INFINITY), Just(f32::MAX)],
        ]
    }

    proptest! {
        /// Whatever is asked for, duties are possible ones.
        #[test]
        fn duties_are_from_zero_to_the_largest(
            alpha in finite_or_not(), beta in finite_or_not(),
            i_alpha in finite_or_not(), i_beta in finite_or_not(), bus_v in finite_or_not(),
            dead_time_s in 0.0..1e-6f64,
        ) {
            let modulator = Modulator::new(&InverterConfig { dead_time_s, ..CONFIG }).unwrap();
            let bus = modulator.bus(bus_v);
            let currents = Stationary { alpha: i_alpha, beta: i_beta };
            let three = modulator.three_phase(Stationary { alpha, beta }, currents, bus);
            let two = modulator.two_phase(alpha, i_alpha, bus);
            for part in three.parts().into_iter().chain(two.parts()) {
                prop_assert!((0.0..=0.85).contains(&part), "{part}");
            }
        }

        /// All of the hexagon is modulated without error: vectors whose phases differ by up to
        /// duty_max·bus. Without the shift of the middle an eighth of the circle's reach would be lost.
        #[test]
        fn within_the_hexagon_the_vector_is_the_one_wanted(
            angle in 0.0..core::f64::consts::TAU, part in 0.0..0.999_999f64, bus_v in 8.0..56.0f32,
        ) {
            let (sine, cosine) = angle.sin_cos();
            let unit = Stationary { alpha: cosine as f32, beta: sine as f32 };
            let [a, b, c] = unit.phases();
            let span = a.max(b).max(c) - a.min(b).min(c);
            let length = part as f32 * 0.85 * bus_v / span;
            let wanted = Stationary { alpha: length * unit.alpha, beta: length * unit.beta };
            let modulator = Modulator::new(&CONFIG).unwrap();
            let got = vector(modulator.three_phase(wanted, NONE, modulator.bus(bus_v)), bus_v);
            prop_assert!((got.alpha - wanted.alpha).abs() < 2e-6 * bus_v, "{got:?} for {wanted:?}");
            prop_assert!((got.beta - wanted.beta).abs() < 2e-6 * bus_v, "{got:?} for {wanted:?}");
        }

        /// After the limit, and with dead time put back whichever way the currents flow, no duty is cut: phases
        /// differ by what was wanted and what is lost.
        #[test]
        fn the_limit_leaves_room_for_the_dead_time(
            d in -60.0..60.0f32, q in -60.0..60.0f32, angle in any::<u32>(),
            i_alpha in -30.0..30.0f32, i_beta in -30.0..30.0f32, bus_v in 8.0..56.0f32,
        ) {
            let modulator = Modulator::new(&InverterConfig { dead_time_s: 0.36e-6, ..CONFIG }).unwrap();
            let bus = modulator.bus(bus_v);
            let limited = modulator.limited(Rotating { d, q }, bus);
            let most = (0.85 - 2.0 * 0.36e-6 * 24e3) / 3.0_f64.sqrt() * f64::from(bus_v);
            let length = f64::from(limited.d).hypot(f64::from(limited.q));
            prop_assert!(length <= most * (1.0 + 1e-6));
            if f64::from(d).hypot(f64::from(q)) < most {
                prop_assert_eq!(limited, Rotating { d, q });
            }
            let rotor = super::super::angle::Phase::from_bits(angle).rotation();
            let wanted = limited.turned(rotor);
            let currents = Stationary { alpha: i_alpha, beta: i_beta };
            let duties = modulator.three_phase(wanted, currents, bus);
            // What the phases lose again.
            let signs = currents.phases().map(|i| (i / 0.2).clamp(-1.0, 1.0));
            let mut left = duties;
            for (part, sign) in left.0.iter_mut().zip(signs) {
                *part -= sign * (0.36e-6 * 24e3) as f32;
            }
            let got = vector(left, bus_v);
            prop_assert!((got.alpha - wanted.alpha).abs() < 3e-6 * bus_v, "{got:?} for {wanted:?}");
            prop_assert!((got.beta - wanted.beta).abs() < 3e-6 * bus_v, "{got:?} for {wanted:?}");
        }

        #[test]
        fn between_two_phases_lies_the_voltage_wanted(volts in -60.0..60.0f32, bus_v in 8.0..56.0f32) {
            let modulator = Modulator::new(&CONFIG).unwrap();
            let bus = modulator.bus(bus_v);
            let limited = modulator.limited_line(volts, bus);
            let [a, b, c] = modulator.two_phase(limited, 0.0, bus).parts();
            prop_assert_eq!(a, 0.0);
            prop_assert!(((b - c) * bus_v - limited).abs() < 1e-6 * bus_v);
        }
    }

    #[test]
    fn an_inverter_that_can_give_nothing_is_refused() {
        for config in [
            InverterConfig {
                duty_max: 1.01,
                ..CONFIG
            },
            InverterConfig {
                duty_max: 0.0,
                ..CONFIG
            },
            InverterConfig {
                dead_time_s: 0.43 / 24e3,
                ..CONFIG
            },
            InverterConfig {
                bus_least_v: 57.0,
                ..CONFIG
            },
            InverterConfig {
                bus_least_v: f64::NAN,
                ..CONFIG
            },
            InverterConfig {
                bus_least_v: 0.0,
                ..CONFIG
            },
            InverterConfig {
                pwm_period_s: f64::NAN,
                ..CONFIG
            },
            InverterConfig {
                dead_time_edge_a: 0.0,
                ..CONFIG
            },
            InverterConfig {
                pwm_steps: 0,
                ..CONFIG
            },
        ] {
            assert!(Modulator::new(&config).is_err(), "{config:?}");
        }
    }

    #[test]
    fn duties_become_the_nearest_steps() {
        assert_eq!(Duties([0.0, 0.85, 0.500_2]).in_steps(3500), [0, 2975, 1751]);
    }
}
