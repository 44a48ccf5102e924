//! A configuration that was checked, in the form that the tick uses.

use crate::config::{Config, Law};
use crate::criterion::Criterion;
use crate::encoder::EncoderConfig;
use crate::error::{ConfigError, not_negative, positive};
use crate::margin::effective_criterion;
use crate::real::smaller;
use crate::shape::{Profile, Reading};
use crate::tick::Reason;
use crate::tuning::Tuning;

/// The device and the loop as the estimator and the ledger use them: each quantity at the end
/// of its interval that is the worse one there. SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mechanics {
    /// Δ.
    pub count_rad: f32,
    /// Δ/2.
    pub half_count_rad: f32,
    /// 1/m, m at its least.
    pub mobility: f32,
    /// 1.05·b, b at its most.
    pub viscous_high: f32,
    /// c at its least.
    pub coulomb_low: f32,
    /// c at its most.
    pub coulomb_high: f32,
}

/// What the ledger may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LedgerPlan {
    pub mechanics: Mechanics,
    /// K, after its cap.
    pub stiffness: f32,
    /// 1/K, or 0 where K is next to 0.
    pub compliance: f32,
    /// K_h = m/Te².
    pub holding: f32,
    /// Te²/m.
    pub holding_compliance: f32,
    /// B, after its limit.
    pub damping: f32,
    /// T_max.
    pub longest_s: f32,
    /// η·c and η·b.
    pub credited_coulomb: f32,
    pub credited_viscous: f32,
    /// There is a delay or a lag.
    pub late: bool,
    /// From the encoder's reading to the torque's change.
    pub delay_s: f32,
    /// τ.
    pub tau_s: f32,
    /// τ·(1 − e^(−T/τ)) ≤ τ: for how long the old torque goes on.
    pub lag_s: f32,
    /// What is left of the old torque after a period, e^(−T/τ), about.
    pub lag_left: f32,
    /// q and 1/q; 0 without steps.
    pub step_nm: f32,
    pub steps_per_nm: f32,
    pub torque_max_nm: f32,
    /// Why K is less than demanded.
    pub reason: Reason,
}

impl LedgerPlan {
    /// A torque cut towards zero to whole steps of the DAC, which then has nothing to round.
    #[inline]
    pub fn cut(&self, torque_nm: f32) -> f32 {
        if self.step_nm > 0.0 {
            let steps = torque_nm * self.steps_per_nm;
            // Beyond 2²⁴ steps an f32 is coarser than they are.
            if steps.abs() < 16_777_216.0 {
                return steps as i32 as f32 * self.step_nm;
            }
        }
        torque_nm
    }
}

/// A configuration that was checked. Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    pub(crate) criterion: Criterion<f32>,
    pub(crate) profile: Profile,
    encoder: EncoderConfig,
    pub(crate) law: Law,
    demanded_nm_rad: f32,
    pub(crate) demanded_damping: f32,
    /// What the law allows at every speed, and why not more.
    pub(crate) limit_nm_rad: f32,
    pub(crate) limit_reason: Reason,
    pub(crate) torque_max_nm: f32,
    /// Torques up to this need no more done to them, Nm: the limit, or −1 with virtual damping
    /// or torque steps.
    pub(crate) bare_up_to_nm: f32,
    /// T, s.
    period_s: f32,
    /// Δ/T, rad/s: the speed of one count per sample.
    count_speed_rad_s: f32,
    /// T/Δ, s/rad.
    periods_per_rad: f32,
    /// The demand is passive at rest and within m/Te², so that the episode may apply it while slow.
    pub(crate) episode_may_do: bool,
    pub(crate) ledger: LedgerPlan,
    #[cfg(feature = "tuning")]
    tuning: Tuning,
}

impl Plan {
    /// Checks a configuration.
    ///
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, by name and value, an interval
    /// that is reversed, and with [`Law::Ledger`] and [`Law::Auto`] a delay longer than the
    /// shortest interval between ticks.
    pub fn new(config: &Config) -> Result<Self, ConfigError> {
        Self::tuned(config, Tuning::DEFAULT)
    }

    /// The same with other constants of the ledger, for studies.
    ///
    /// # Errors
    /// As [`Plan::new`].
    #[cfg(feature = "tuning")]
    pub fn with_tuning(config: &Config, tuning: Tuning) -> Result<Self, ConfigError> {
        Self::tuned(config, tuning)
    }

    fn tuned(config: &Config, tuning: Tuning) -> Result<Self, ConfigError> {
        positive("count size (rad)", config.count_rad())?;
        let profile = Profile::new(&config.shape, config.count_rad())?;
        not_negative("torque step (Nm)", config.torque_step_nm as f32)?;
        // Raw hands its torque to the DAC, which rounds; the other laws cut it towards zero.
        let rounding = match config.law {
            Law::Raw => config.torque_step_nm,
            _ => 0.0,
        };
        let criterion = effective_criterion(config, &profile, rounding)?;
        let demanded = not_negative("stiffness (Nm/rad)", config.stiffness_nm_rad as f32)?;
        let damping = not_negative("damping (Nm s/rad)", config.damping_nm_s_rad as f32)?;
        let torque_max_nm = not_negative("torque limit (Nm)", config.torque_max_nm as f32)?;
        // A little down: a limit that f32 has rounded up would be none.
        let down = 1.0 - 4.0 * f32::EPSILON;
        let (viscous_limit, coulomb_limit) = (
            down * criterion.viscous_limit(),
            down * criterion.coulomb_limit(),
        );
        let ledger = ledger_plan(config, &criterion, &tuning)?;
        // An episode's spring must not throw the knob past its zero within a tick.
        let (episode_limit, episode_reason) = if ledger.holding < coulomb_limit {
            (ledger.holding, Reason::Inertia)
        } else {
            (coulomb_limit, Reason::Coulomb)
        };
        let (limit, limit_reason) = match config.law {
            Law::Raw => (demanded, Reason::None),
            Law::Episode => (episode_limit, episode_reason),
            _ if viscous_limit < coulomb_limit => (viscous_limit, Reason::Viscous),
            _ => (coulomb_limit, Reason::Coulomb),
        };
        let timing = &config.timing;
        let count_rad = config.count_rad();
        Ok(Self {
            ledger,
            profile,
            encoder: config.encoder,
            law: config.law,
            demanded_nm_rad: demanded,
            demanded_damping: damping,
            limit_nm_rad: smaller(demanded, limit),
            limit_reason: if demanded > limit {
                limit_reason
            } else {
                Reason::None
            },
            torque_max_nm,
            bare_up_to_nm: if damping == 0.0 && config.torque_step_nm == 0.0 {
                torque_max_nm
            } else {
                -1.0
            },
            period_s: timing.period_s as f32,
            periods_per_rad: positive(
                "sample period / count (s/rad)",
                (timing.shortest_s() / count_rad) as f32,
            )?,
            episode_may_do: demanded <= episode_limit,
            count_speed_rad_s: positive(
                "count / sample period (rad/s)",
                (count_rad / timing.period_s) as f32,
            )?,
            criterion,
            #[cfg(feature = "tuning")]
            tuning,
        })
    }

    /// The same with another torque limit, Nm, 0 or more.
    pub(crate) fn limit_torque(&mut self, most_nm: f32) {
        self.torque_max_nm = most_nm;
        self.ledger.torque_max_nm = most_nm;
        if self.bare_up_to_nm >= 0.0 {
            self.bare_up_to_nm = most_nm;
        }
    }

    /// The constants of the ledger.
    #[must_use]
    #[inline]
    pub fn tuning(&self) -> Tuning {
        #[cfg(feature = "tuning")]
        return self.tuning;
        #[cfg(not(feature = "tuning"))]
        Tuning::DEFAULT
    }

    /// The demanded stiffness, Nm/rad.
    #[must_use]
    pub fn demanded_nm_rad(&self) -> f32 {
        self.demanded_nm_rad
    }

    /// The most stiffness that the law applies whatever happens, Nm/rad: the demand or its cap.
    #[must_use]
    pub fn applied_limit_nm_rad(&self) -> f64 {
        f64::from(match self.law {
            Law::Ledger | Law::Auto => self.ledger.stiffness,
            Law::Raw | Law::Static | Law::Episode => self.limit_nm_rad,
        })
    }

    /// T, s.
    #[must_use]
    pub fn period_s(&self) -> f32 {
        self.period_s
    }

    /// Δ/T: the speed of one count per sample, rad/s.
    #[must_use]
    pub fn count_speed_rad_s(&self) -> f32 {
        self.count_speed_rad_s
    }

    /// On the free side of a wall, or in a cell that touches the zero.
    #[inline(always)]
    pub(crate) fn at_zero_force(&self, reading: &Reading) -> bool {
        reading.free || reading.deflection_rad.abs() <= self.ledger.mechanics.half_count_rad
    }

    /// The most virtual damping beside a stiffness, Nm s/rad: what leaves the margin at 0 or
    /// more at every speed, B ≤ b − K·Te/2 and B·Δ/T ≤ c − K·s/2.
    #[must_use]
    #[inline]
    pub fn damping_limit(&self, stiffness: f32) -> f32 {
        let (device, sampling) = (self.criterion.device(), self.criterion.sampling());
        let half = 0.5 * stiffness;
        let fast = device.viscous_nm_s_rad - half * sampling.period_s;
        let slow = (device.coulomb_nm - half * sampling.count_rad) * self.periods_per_rad;
        let limit = smaller(fast, slow);
        if limit > 0.0 { limit } else { 0.0 }
    }

    /// How the hardware counter is read.
    #[must_use]
    pub fn encoder(&self) -> EncoderConfig {
        self.encoder
    }
}

/// K ≤ max(min(m/Te², 3c/Δ), min(2b/Te, 2c/s)), B ≤ min(m/Te, c·T/Δ).
fn ledger_plan(
    config: &Config,
    criterion: &Criterion<f32>,
    tuning: &Tuning,
) -> Result<LedgerPlan, ConfigError> {
    let believed = &config.believed;
    let timing = &config.timing;
    if matches!(config.law, Law::Ledger | Law::Auto) && timing.delay_s > timing.shortest_s() {
        return Err(ConfigError::Delay {
            delay: timing.delay_s,
            limit: timing.shortest_s(),
        });
    }
    let inertia = believed.inertia_kg_m2.low;
    let coulomb = believed.coulomb_nm.low;
    let (effective_s, count_rad) = (timing.effective_s(), config.count_rad());
    let holding = positive(
        "inertia / sample period² (Nm/rad)",
        (inertia / (effective_s * effective_s)) as f32,
    )?;
    let coarse = not_negative(
        "3 × Coulomb friction / count (Nm/rad)",
        (f64::from(tuning.coulomb_cap) * coulomb / count_rad) as f32,
    )?;
    let slow = tuning.inertia_cap * holding;
    let (mut cap, mut reason) = if slow < coarse {
        (slow, Reason::Inertia)
    } else {
        (coarse, Reason::Coarse)
    };
    if criterion.largest_stiffness() > cap {
        cap = criterion.largest_stiffness();
        reason = if criterion.viscous_limit() < criterion.coulomb_limit() {
            Reason::Viscous
        } else {
            Reason::Coulomb
        };
    }
    let demanded = config.stiffness_nm_rad as f32;
    let stiffness = if tuning.cap {
        smaller(demanded, cap)
    } else {
        demanded
    };
    let damping_limit = smaller(
        (inertia / effective_s) as f32,
        (coulomb * timing.period_s / count_rad) as f32,
    );
    let lag = timing.amplifier_tau_s;
    let lag_left = exponential_decay(timing.period_s, lag);
    let step_nm = config.torque_step_nm as f32;
    Ok(LedgerPlan {
        mechanics: Mechanics {
            count_rad: count_rad as f32,
            half_count_rad: 0.5 * count_rad as f32,
            mobility: positive("1 / inertia (1/kg m²)", (1.0 / inertia) as f32)?,
            viscous_high: not_negative(
                "viscous friction (Nm s/rad)",
                (1.05 * believed.viscous_nm_s_rad.high) as f32,
            )?,
            coulomb_low: coulomb as f32,
            coulomb_high: not_negative("Coulomb friction (Nm)", believed.coulomb_nm.high as f32)?,
        },
        stiffness,
        // Of next to no stiffness 1/K is no number, and does not matter.
        compliance: if stiffness > 1e-30 {
            1.0 / stiffness
        } else {
            0.0
        },
        holding,
        holding_compliance: 1.0 / holding,
        damping: smaller(config.damping_nm_s_rad as f32, damping_limit),
        longest_s: timing.longest_s() as f32,
        credited_coulomb: tuning.credit * coulomb as f32,
        credited_viscous: tuning.credit * believed.viscous_nm_s_rad.low as f32,
        late: timing.delay_s > 0.0 || lag > 0.0,
        delay_s: timing.delay_s as f32,
        tau_s: lag as f32,
        lag_s: (lag * (1.0 - lag_left)) as f32,
        lag_left: lag_left as f32,
        step_nm,
        steps_per_nm: if step_nm > 0.0 { 1.0 / step_nm } else { 0.0 },
        torque_max_nm: config.torque_max_nm as f32,
        reason: if demanded > stiffness {
            reason
        } else {
            Reason::None
        },
    })
}

/// e^(−time/constant), 0 for constant = 0; `core` has no exponential.
pub(crate) fn exponential_decay(time: f64, constant: f64) -> f64 {
    if time >= 40.0 * constant {
        return 0.0;
    }
    // e^(−y) = (e^(−y/64))^64, the Taylor series of the root: y/64 < 0.7.
    let y = time / constant / 64.0;
    let mut term = 1.0;
    let mut sum = 1.0;
    for k in 1..16 {
        term *= -y / f64::from(k);
        sum += term;
    }
    for _ in 0..6 {
        sum *= sum;
    }
    sum
}
