//! A PI controller of a current, which cannot wind up.

use super::{TorqueError, within};
use crate::error::positive;
use crate::plan::exponential_decay;

/// Gains by internal model control for a winding R, L under a voltage that is held for T and comes T late.
///
/// The winding is i⁺ = a i + (1 − a)/R · v with a = e^(−RT/L). With k = ω_c T,
///
/// v = K_p e + I,  K_p = k R/(1 − a),  I⁺ = I + (1 − a)(u − I),
///
/// u the voltage that was delivered, not the one wanted. Where they are the same this is
/// I⁺ = I + kR·e: the zero of the controller cancels the winding's pole a, and with the delay of a period the
/// loop is z² − z + k = 0. Where the voltage was limited the integral goes to what was delivered
/// with the winding's own time constant, and never beyond: automatic reset, by Åström and Hägglund.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gains {
    /// K_p, V/A.
    proportional: f32,
    /// 1 − a.
    reset: f32,
}

impl Gains {
    /// For R (Ω), L (H), ω_c (rad/s) and T (s).
    ///
    /// # Errors
    /// Refuses what is not finite and above 0, and values whose ratios are not.
    pub fn new(
        resistance_ohm: f64,
        inductance_h: f64,
        bandwidth_rad_s: f64,
        period_s: f64,
    ) -> Result<Self, TorqueError> {
        positive("resistance (Ω)", resistance_ohm)?;
        positive("inductance (H)", inductance_h)?;
        positive("bandwidth (rad/s)", bandwidth_rad_s)?;
        positive("PWM period (s)", period_s)?;
        let time_constant_s =
            positive("inductance / resistance (s)", inductance_h / resistance_ohm)?;
        let reset = 1.0 - exponential_decay(period_s, time_constant_s);
        positive(
            "1 − e^(−PWM period · resistance / inductance)",
            reset as f32,
        )?;
        let gain = bandwidth_rad_s * period_s * resistance_ohm / reset;
        Ok(Self {
            proportional: positive("proportional gain (V/A)", gain as f32)?,
            reset: reset as f32,
        })
    }
}

/// A PI controller at work.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Regulator {
    gains: Gains,
    /// The largest |I|, V.
    most_v: f32,
    /// I, V.
    integral_v: f32,
}

impl Regulator {
    /// With nothing in its integral, and never more than ±`most_v` (V), which is for the most that the bus
    /// can give: so that an absurd measurement is forgotten as fast as a wrong voltage.
    ///
    /// # Errors
    /// Refuses a `most_v` that is not finite and above 0.
    pub fn new(gains: Gains, most_v: f64) -> Result<Self, TorqueError> {
        Ok(Self {
            gains,
            most_v: positive("largest integral (V)", most_v as f32)?,
            integral_v: 0.0,
        })
    }

    /// K_p e + I, V.
    #[must_use]
    #[inline]
    pub fn volts(&self, error_a: f32) -> f32 {
        self.gains.proportional * error_a + self.integral_v
    }

    /// Once in a period: `delivered_v` is what was left of [`Self::volts`] by the voltage limit. What
    /// is not a number clears the integral.
    #[inline]
    pub fn follow(&mut self, delivered_v: f32) {
        let next = self.integral_v + self.gains.reset * (delivered_v - self.integral_v);
        self.integral_v = within(next, self.most_v);
    }

    /// I, V: R·i of the winding where it is as believed, and what else it takes to bring the current.
    #[must_use]
    #[inline]
    pub fn integral_v(&self) -> f32 {
        self.integral_v
    }

    /// Forgets.
    pub fn clear(&mut self) {
        self.integral_v = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// What anti-windup is: however long an error that no voltage can mend lasts, the integral never
        /// leaves what was delivered, and the voltage comes off its limit in the tick in which
        /// the error turns.
        #[test]
        fn the_integral_stays_within_what_was_delivered(
            resistance in 0.05..20.0f64,
            time_constant in 5e-5..5e-3f64,
            limit in 1.0..40.0f32,
            error in 0.1..30.0f32,
            ticks in 1..5_000_u32,
        ) {
            let period = 1.0 / 24e3;
            let gains = Gains::new(resistance, resistance * time_constant, 0.29 / period, period).unwrap();
            let mut regulator = Regulator::new(gains, 50.0).unwrap();
            for _ in 0..ticks {
                let volts = regulator.volts(error);
                regulator.follow(volts.clamp(-limit, limit));
                prop_assert!(regulator.integral_v.abs() <= limit);
            }
            prop_assert!(regulator.volts(-1e-3 * error) < limit);
        }

        /// Without a limit it is I⁺ = I + kR·e.
        #[test]
        fn without_a_limit_it_is_a_pi_controller(
            resistance in 0.05..20.0f64, time_constant in 5e-5..5e-3f64, error in -30.0..30.0f32,
        ) {
            let (period, k) = (1.0 / 24e3, 0.2);
            let gains = Gains::new(resistance, resistance * time_constant, k / period, period).unwrap();
            let mut regulator = Regulator::new(gains, 1e9).unwrap();
            for tick in 0..50 {
                let expected = k * resistance * f64::from(error) * f64::from(tick);
                let scale = f64::from((gains.proportional * error).abs()) + expected.abs();
                prop_assert!((f64::from(regulator.integral_v) - expected).abs() <= 1e-5 * scale);
                regulator.follow(regulator.volts(error));
            }
        }
    }

    #[test]
    fn nothing_absurd_stays_in_the_integral() {
        let gains = Gains::new(1.0, 1e-3, 5_000.0, 1.0 / 24e3).unwrap();
        let mut regulator = Regulator::new(gains, 25.0).unwrap();
        for (absurd, left) in [
            (f32::MAX, 25.0),
            (f32::NEG_INFINITY, -25.0),
            (f32::NAN, 0.0),
        ] {
            regulator.follow(absurd);
            assert_eq!(regulator.integral_v, left);
        }
    }
}
