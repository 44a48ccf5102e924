//! When ticks come: a period that varies, and ticks that do not run.

use control::ConfigError;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

/// Nominal ticks are `period_s` + u apart, u independent and uniform in ±`jitter_s`; of
/// these a share of `missed_ticks` does not run, never two in a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clock {
    /// The mean distance of nominal ticks, s.
    pub period_s: f64,
    /// The largest deviation from it, s; 0: none.
    pub jitter_s: f64,
    /// Share of nominal ticks that do not run, 0 to ½; 0: none.
    pub missed_ticks: f64,
}

/// Why there is no such clock.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ClockError {
    /// A quantity is not one.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The period could shrink to nothing.
    #[error("jitter is {jitter_s} s; accepted: below the sample period, {period_s} s")]
    Jitter {
        /// What was given.
        jitter_s: f64,
        /// What it has to stay below.
        period_s: f64,
    },
    /// A share of missed ticks that cannot be had without two in a row.
    #[error("the share of missed ticks is {0}; accepted: 0 to 0.5, as no two in a row are missed")]
    MissedTicks(f64),
}

impl Clock {
    /// A tick every `period_s`.
    #[must_use]
    pub fn even(period_s: f64) -> Self {
        Self {
            period_s,
            jitter_s: 0.0,
            missed_ticks: 0.0,
        }
    }

    /// # Errors
    /// Refuses a period not finite and above 0, a jitter negative or not below the period,
    /// and a share of missed ticks outside 0 to ½.
    pub fn check(&self) -> Result<(), ClockError> {
        let Self {
            period_s,
            jitter_s,
            missed_ticks,
        } = *self;
        if !(period_s > 0.0 && period_s.is_finite()) {
            let name = "sample period (s)";
            let value = period_s;
            return Err(ConfigError::NotPositive { name, value }.into());
        }
        if !(jitter_s >= 0.0 && jitter_s.is_finite()) {
            let name = "jitter (s)";
            let value = jitter_s;
            return Err(ConfigError::Negative { name, value }.into());
        }
        if jitter_s >= period_s {
            return Err(ClockError::Jitter { jitter_s, period_s });
        }
        if !(0.0..=0.5).contains(&missed_ticks) {
            return Err(ClockError::MissedTicks(missed_ticks));
        }
        Ok(())
    }

    /// The longest interval between ticks that run, s: `period_s` + `jitter_s`, twice that if
    /// ticks can be missed.
    #[must_use]
    pub fn longest_s(&self) -> f64 {
        let nominal = self.period_s + self.jitter_s;
        if self.missed_ticks > 0.0 {
            2.0 * nominal
        } else {
            nominal
        }
    }

    /// The intervals between ticks that run, the same for the same seed on every machine.
    ///
    /// # Assumes
    /// [`Clock::check`] is content.
    #[must_use]
    pub fn ticks(&self, seed: u64) -> Ticks {
        Ticks {
            clock: *self,
            miss: self.missed_ticks / (1.0 - self.missed_ticks),
            random: Pcg64::seed_from_u64(seed),
        }
    }
}

/// Intervals between ticks that run, s, without end. See [`Clock::ticks`].
#[derive(Debug, Clone)]
pub struct Ticks {
    clock: Clock,
    /// Probability that the tick after one that ran is missed, p/(1 − p): with no two in a
    /// row, a share p of all.
    miss: f64,
    random: Pcg64,
}

impl Ticks {
    /// Uniform in 0 (included) to 1 (not), in steps of 2⁻⁵³.
    fn uniform(&mut self) -> f64 {
        const STEP: f64 = 1.0 / (1_u64 << 53) as f64;
        (self.random.next_u64() >> 11) as f64 * STEP
    }

    /// From one nominal tick to the next.
    fn nominal(&mut self) -> f64 {
        let Clock {
            period_s, jitter_s, ..
        } = self.clock;
        if jitter_s == 0.0 {
            period_s
        } else {
            period_s + jitter_s * (2.0 * self.uniform() - 1.0)
        }
    }
}

impl Iterator for Ticks {
    type Item = f64;

    fn next(&mut self) -> Option<f64> {
        let interval = self.nominal();
        if self.miss > 0.0 && self.uniform() < self.miss {
            Some(interval + self.nominal())
        } else {
            Some(interval)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn an_even_clock_is_even_to_the_bit() {
        let clock = Clock {
            period_s: 1e-3,
            jitter_s: 0.0,
            missed_ticks: 0.0,
        };
        assert!(clock.ticks(7).take(1000).all(|interval| interval == 1e-3));
        assert_eq!(clock.longest_s(), 1e-3);
    }

    /// The generator's own numbers, so that a new version of it cannot change runs unseen.
    #[test]
    fn a_seed_gives_the_same_ticks_for_ever() {
        let clock = Clock {
            period_s: 1.0,
            jitter_s: 0.5,
            missed_ticks: 0.25,
        };
        let ticks: Vec<f64> = clock.ticks(1).take(4).collect();
        let expected = [
            1.953_775_368_730_091_4,
            1.483_015_881_309_441,
            1.864_108_215_192_362_3,
            1.051_208_683_542_683_7,
        ];
        assert_eq!(ticks, expected);
        assert_ne!(clock.ticks(2).take(4).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn half_of_all_can_be_missed_and_no_more() {
        let clock = Clock {
            period_s: 1e-3,
            jitter_s: 0.0,
            missed_ticks: 0.5,
        };
        assert!(clock.ticks(3).take(1000).all(|interval| interval == 2e-3));
    }

    proptest! {
        #[test]
        fn intervals_keep_their_range_mean_and_share(
            jitter in 0.0..0.99_f64,
            missed in 0.0..0.5_f64,
            seed: u64,
        ) {
            let clock = Clock { period_s: 1e-3, jitter_s: jitter * 1e-3, missed_ticks: missed };
            prop_assert!(clock.check().is_ok());
            let n = 100_000;
            let ticks: Vec<f64> = clock.ticks(seed).take(n).collect();
            let (mut least, mut most, mut sum) = (f64::INFINITY, 0.0_f64, 0.0);
            for interval in ticks {
                least = least.min(interval);
                most = most.max(interval);
                sum += interval;
            }
            prop_assert!(least >= clock.period_s - clock.jitter_s);
            prop_assert!(most <= clock.longest_s());
            // Of n/(1 − p) nominal ticks n ran: 5 standard deviations of what is missing.
            let nominal = sum / clock.period_s;
            let expected = n as f64 / (1.0 - missed);
            prop_assert!((nominal - expected).abs() < 5.0 * 0.9 * (n as f64).sqrt(),
                "{nominal}, not {expected}");
        }
    }

    #[test]
    fn what_is_no_clock_is_refused_with_its_value_and_what_would_do() {
        let good = Clock {
            period_s: 1e-3,
            jitter_s: 1e-4,
            missed_ticks: 0.1,
        };
        assert_eq!(good.check(), Ok(()));
        let refused = |clock: Clock| clock.check().unwrap_err().to_string();
        for period_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let message = refused(Clock { period_s, ..good });
            let wanted = "accepted: a finite number above 0";
            assert_eq!(
                message,
                format!("sample period (s) is {period_s}; {wanted}")
            );
        }
        for jitter_s in [-1e-9, f64::NAN, f64::INFINITY] {
            let message = refused(Clock { jitter_s, ..good });
            let wanted = "accepted: a finite number, 0 or more";
            assert_eq!(message, format!("jitter (s) is {jitter_s}; {wanted}"));
        }
        assert_eq!(
            refused(Clock {
                jitter_s: 1e-3,
                ..good
            }),
            "jitter is 0.001 s; accepted: below the sample period, 0.001 s"
        );
        for missed_ticks in [-0.1, 0.51, f64::NAN] {
            assert_eq!(
                refused(Clock {
                    missed_ticks,
                    ..good
                }),
                format!(
                    "the share of missed ticks is {missed_ticks}; accepted: 0 to 0.5, \
                     as no two in a row are missed"
                )
            );
        }
    }
}
