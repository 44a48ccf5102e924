//! The passivity margin of a real loop: (11) with every term that the paper leaves out.
//!
//! M(v) = (b − B − K·Te/2)·|v| + (c − q/2 − B·Δ/T − K·s/2), Nm: the power that friction takes
//! beyond what sampling makes, over the speed. The display is passive at v while M(v) ≥ 0.
//!
//! | term | what it stands for |
//! |---|---|
//! | b, c | the least friction believed |
//! | Te = T_max + 2·delay + 2τ | the longest interval between ticks (jitter, a missed tick), the delay to the torque's change, the amplifier's time constant |
//! | s = Δ·max(2ρ₁, 1) | the largest step of the torque over the stiffness: Δ, or for a wall off a count edge twice its first deflection ρ₁Δ |
//! | q | the DAC's step where the torque is rounded to the nearest; 0 where it is cut towards zero |
//! | B | virtual damping: on a torque from the mean speed of the last period, wrong by up to Δ/T, and of the wrong sign after a reversal |
//! | K | the largest slope of the profile |
//! | v | at a start under load √(v² + K·q²/m), the speed that it can turn into |
//!
//! Without delay, lag, jitter, steps and damping, on a count edge, it is (11).
//! It has the form of (11), so a [`Criterion`] with the period Te, the count s and the
//! Coulomb friction c − q/2 computes it.

use crate::config::Config;
use crate::criterion::{Criterion, Device, Sampling};
use crate::error::{ConfigError, interval, not_negative, positive};
use crate::root::root;
use crate::shape::Profile;

/// The criterion of a configuration, with all terms but virtual damping. `torque_step_nm` is
/// q, the DAC's step where it rounds to the nearest.
///
/// ```
/// use control::config::{Believed, Config, Law, Timing};
/// use control::criterion::Device;
/// use control::{encoder::EncoderConfig, margin::effective_criterion, shape::{Profile, Shape}};
/// let re35 = Device { inertia_kg_m2: 6.28e-6, viscous_nm_s_rad: 9e-6, coulomb_nm: 2e-3 };
/// let shape = Shape::Spring { centre_rad: 0.0 };
/// let mut config = Config {
///     believed: Believed::exactly(&re35),
///     timing: Timing::ideal(1e-3),
///     torque_step_nm: 0.0,
///     hardware_count_rad: core::f64::consts::TAU / 8192.0,
///     encoder: EncoderConfig::new(32, 1)?,
///     shape,
///     stiffness_nm_rad: 1.0,
///     damping_nm_s_rad: 0.0,
///     law: Law::Raw,
///     torque_max_nm: 0.5,
/// };
/// let profile = Profile::new(&shape, config.count_rad())?;
/// let ideal = effective_criterion(&config, &profile, 0.0)?; // the paper's: 0.388 Nm/rad at 10 rad/s
/// assert!((ideal.largest_stiffness_at(10.0) - 0.388).abs() < 1e-3);
/// config.timing.delay_s = 0.5e-3; // half a period of delay leaves hardly more than half
/// let late = effective_criterion(&config, &profile, 0.0)?;
/// assert!((late.largest_stiffness_at(10.0) - 0.201).abs() < 1e-3);
/// # Ok::<(), control::ConfigError>(())
/// ```
///
/// # Errors
/// Refuses what is not finite or has the wrong sign, and an interval that is reversed.
pub fn effective_criterion(
    config: &Config,
    profile: &Profile,
    torque_step_nm: f64,
) -> Result<Criterion<f32>, ConfigError> {
    let believed = &config.believed;
    let timing = &config.timing;
    let inertia = interval("inertia (kg m²)", &believed.inertia_kg_m2)?;
    let viscous = interval("viscous friction (Nm s/rad)", &believed.viscous_nm_s_rad)?;
    let coulomb = interval("Coulomb friction (Nm)", &believed.coulomb_nm)?;
    positive("sample period (s)", timing.period_s)?;
    not_negative("jitter (s)", timing.jitter_s)?;
    positive("sample period less jitter (s)", timing.shortest_s())?;
    not_negative("delay (s)", timing.delay_s as f32)?;
    not_negative("amplifier time constant (s)", timing.amplifier_tau_s as f32)?;
    not_negative("torque step (Nm)", torque_step_nm)?;
    positive("count size (rad)", config.count_rad())?;
    let left_nm = coulomb.low - 0.5 * torque_step_nm;
    Criterion::new(
        Device {
            inertia_kg_m2: inertia.low as f32,
            viscous_nm_s_rad: viscous.low as f32,
            coulomb_nm: if left_nm > 0.0 { left_nm as f32 } else { 0.0 },
        },
        Sampling {
            period_s: timing.effective_s() as f32,
            count_rad: (config.count_rad() * profile.step_counts()) as f32,
        },
    )
}

/// √(v² + K·q²/m), rad/s: the speed that a state can turn into, for K in Nm/rad, v in rad/s, a
/// deflection in rad and `mobility` = 1/m.
#[must_use]
#[inline]
pub fn reachable_speed_rad_s(speed: f32, stiffness: f32, deflection: f32, mobility: f32) -> f32 {
    root(speed * speed + stiffness * mobility * (deflection * deflection))
}
