//! Inertia, viscous and Coulomb friction of a knob, from what it did under known torques.
//!
//! The model is the exact plant, m ẍ + b ẋ + c sgn ẋ = F (1), F held between ticks, seen through an
//! encoder of counts n = ⌊x/Δ⌋. A [`Recording`] is cut where the knob rests; each [push](experiment) from rest
//! to rest is followed by [`Hold`](crate::hold::Hold), without a step size. Least squares
//! (Levenberg–Marquardt) find the value; the interval is the set of all m, b, c that explain **every** count,
//! found by linear programs (see `bounds`): a count is a bound on the angle, so as long as the model
//! holds, the true values lie inside with certainty, not with some probability.
//!
//! # Where the model does not quite hold
//! If even the best m, b and c leave some angle outside its count, by e counts, all counts are taken
//! as wider by [`WIDENING`]·e at either side, and the intervals widen with them. Beyond
//! [`MOST_MISFIT_COUNTS`] and [`MOST_MISFIT_SHARE`] there is no answer, but a [`Refusal`] with what is
//! likely wrong.
//!
//! # Assumes
//! Torque and count as they are said to be. A wrong count size or a wrong torque constant is invisible in any
//! recording: counts k times too large make m and b k times too small, torques k times too large make
//! all three k times too large, and both fit as well as the truth. So does a hand that only adds mass
//! and friction. No delay between tick and torque, no lag: those show as misfit.

mod bounds;
pub mod experiment;
mod model;
mod recording;
mod refusal;

use control::config::{Believed, Interval};
use control::criterion::Device;

use model::{Extra, Model, Theta};
use recording::Push;
pub use recording::{REST_S, Recording, Sample};
pub use refusal::Refusal;

/// The largest misfit with an answer, counts, or
pub const MOST_MISFIT_COUNTS: f64 = 1.0;

/// this share of the longest push, whichever is more.
pub const MOST_MISFIT_SHARE: f64 = 0.003;

/// Counts are taken as wider by so many counts at either side, even if all are explained,
const LEAST_MISFIT_COUNTS: f64 = 0.25;

/// and by this share of the longest push: no clock, no torque and no model is better.
const LEAST_MISFIT_SHARE: f64 = 1e-4;

/// By how many times the misfit counts are taken as wider.
///
/// Chosen on motors with cogging, stiction, delays and converter steps of up to a tenth of friction or of a
/// period, so that of those with an answer 95 % or more hold the truth.
pub const WIDENING: f64 = 6.0;

/// An interval for m or c whose ends have a larger ratio is no answer.
const MOST_RATIO: f64 = 2.0;

/// A quantity, and the interval in which it lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The least squares', within the interval.
    pub value: f64,
    /// The least it can be.
    pub low: f64,
    /// The most.
    pub high: f64,
}

impl Estimate {
    /// Half the interval in units of the value.
    #[must_use]
    pub fn half_width(&self) -> f64 {
        (self.high - self.low) / (2.0 * self.value)
    }

    /// Whether the interval holds a value.
    #[must_use]
    pub fn holds(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// What a recording says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Identified {
    /// m, kg m².
    pub inertia_kg_m2: Estimate,
    /// b, Nm s/rad. The interval may begin at 0.
    pub viscous_nm_s_rad: Estimate,
    /// c, Nm.
    pub coulomb_nm: Estimate,
    /// By how much the angle lies outside its count, with the m, b and c for which that is least, at the
    /// worst sample, counts; 0: all counts are explained.
    pub misfit_counts: f64,
    /// Pushes from rest to rest.
    pub pushes: usize,
}

impl Identified {
    /// What a controller is to believe.
    #[must_use]
    pub fn believed(&self) -> Believed {
        let interval = |of: &Estimate| Interval {
            low: of.low,
            high: of.high,
        };
        Believed {
            inertia_kg_m2: interval(&self.inertia_kg_m2),
            viscous_nm_s_rad: interval(&self.viscous_nm_s_rad),
            coulomb_nm: interval(&self.coulomb_nm),
        }
    }
}

/// m, b and c from a recording.
///
/// # Errors
/// A recording that does not support an answer, with the reason.
pub fn identify(recording: &Recording) -> Result<Identified, Refusal> {
    let pushes = recording.pushes()?;
    let Recording {
        period_s,
        count_rad,
        ..
    } = *recording;
    let Some((model, near)) = Model::near(&pushes, period_s, count_rad) else {
        // Not so: some push moved it in either direction.
        return Err(Refusal::OneDirection { missing: "counts" });
    };
    let (mut fit, _) = model.fit(&near, Extra::Nothing, 0.0);
    if !bounds::range(&model, &fit).is_finite() {
        // Led astray by counts that nothing explains: where it began is nearer.
        fit = near;
    }
    let (best, range) = bounds::least_range(&model, &fit);
    let misfit_counts = (0.5 * (range - 1.0)).max(0.0);
    let longest = pushes
        .iter()
        .map(|push| push.furthest().abs())
        .fold(0.0, f64::max);
    let accepted_counts = MOST_MISFIT_COUNTS.max(MOST_MISFIT_SHARE * longest);
    if misfit_counts > 0.5
        && let Some(slip) = slip(recording, &model, &fit)
    {
        return Err(slip);
    }
    if misfit_counts.is_nan() || misfit_counts > accepted_counts {
        return Err(beside(&model, &near, accepted_counts).unwrap_or_else(|| {
            Refusal::Unexplained {
                misfit_counts,
                time_s: recording.time_s(worst(&model, &best)),
                accepted_counts,
            }
        }));
    }
    let least = LEAST_MISFIT_COUNTS + LEAST_MISFIT_SHARE * longest;
    let within = 1.0 + 2.0 * (WIDENING * misfit_counts + least);
    let interval = |which: usize| -> Option<[f64; 2]> {
        let low = bounds::end(&model, &best, which, -1.0, within)?;
        let high = bounds::end(&model, &best, which, 1.0, within)?;
        Some([low, high])
    };
    let ends = [0, 1, 2].map(interval);
    let at = |which: usize, end: usize| {
        let mut theta = fit;
        theta[which] = ends[which].map_or([f64::NEG_INFINITY, f64::INFINITY], |ends| ends)[end];
        model.device(&theta)
    };
    let value = model.device(&fit);
    let estimate = |which: usize, of: fn(&Device<f64>) -> f64| {
        let (low, high) = (of(&at(which, 0)), of(&at(which, 1)));
        Estimate {
            value: of(&value).max(low).min(high),
            low,
            high,
        }
    };
    let identified = Identified {
        inertia_kg_m2: estimate(0, |device| device.inertia_kg_m2),
        viscous_nm_s_rad: estimate(1, |device| device.viscous_nm_s_rad),
        coulomb_nm: estimate(2, |device| device.coulomb_nm),
        misfit_counts,
        pushes: pushes.len(),
    };
    for (name, Estimate { low, high, .. }) in [
        ("inertia (kg m²)", identified.inertia_kg_m2),
        ("Coulomb friction (Nm)", identified.coulomb_nm),
    ] {
        if high > MOST_RATIO * low {
            return Err(Refusal::Vague { name, low, high });
        }
    }
    let viscous = identified.viscous_nm_s_rad;
    if !viscous.high.is_finite() {
        let name = "viscous friction (Nm s/rad)";
        let (low, high) = (viscous.low, viscous.high);
        return Err(Refusal::Vague { name, low, high });
    }
    Ok(identified)
}

/// The sample of the recording whose count is furthest from the angle.
fn worst(model: &Model<'_>, theta: &Theta) -> usize {
    let Some(angles) = model.follow(theta, Extra::Nothing, 0.0) else {
        return 0;
    };
    let mut worst = (0.0, 0);
    for (push, beyond) in model.pushes.iter().zip(model.beyond(&angles)) {
        let mean = beyond.iter().sum::<f64>() / beyond.len() as f64;
        for (place, beyond) in beyond.iter().enumerate() {
            let off = (beyond - mean).abs();
            if off > worst.0 {
                worst = (off, push.range.start + place);
            }
        }
    }
    worst.1
}

/// A count that leaps beyond the motion.
fn slip(recording: &Recording, model: &Model<'_>, fit: &Theta) -> Option<Refusal> {
    let angles = model.follow(fit, Extra::Nothing, 0.0)?;
    for (push, beyond) in model.pushes.iter().zip(model.beyond(&angles)) {
        for (place, four) in beyond.windows(4).enumerate() {
            let [a, b, c, d] = four else { continue };
            // What a fit leaves changes little from tick to tick: the middle step against its neighbours.
            let (before, jump, after) = (b - a, c - b, d - c);
            let usual = before.abs().max(after.abs());
            if jump.abs() > LEAST_SLIP_COUNTS + 2.0 * usual {
                return Some(Refusal::Slips {
                    jump,
                    time_s: recording.time_s(push.range.start + place + 2),
                });
            }
        }
    }
    None
}

/// A jump of more counts is a slip: two that lie a tick apart can be off by one either way.
const LEAST_SLIP_COUNTS: f64 = 2.5;

/// Torques beside the commanded one below this share of friction do not explain a misfit.
const LEAST_PUSH: f64 = 0.005;

/// A torque that acts beside the commanded one, or a limit of it, if that explains the counts.
fn beside(model: &Model<'_>, near: &Theta, accepted_counts: f64) -> Option<Refusal> {
    let unit = model.unit.coulomb_nm;
    let heights = model.pushes.iter().map(Push::height_nm);
    let commanded_nm = heights.map(f64::abs).fold(0.0, f64::max);
    let explains = |extra: Extra, start: f64| {
        let (theta, size) = model.fit(near, extra, start);
        let angles = model.follow(&theta, extra, size)?;
        let misfit = 0.5 * (bounds::largest_range(&model.beyond(&angles)) - 1.0);
        // Least squares do not give the least misfit.
        (misfit <= 3.0 * accepted_counts).then_some(size * unit)
    };
    for share in [0.0, 0.3, -0.3] {
        if let Some(torque_nm) = explains(Extra::Push, share)
            && torque_nm.abs() >= LEAST_PUSH * unit
        {
            return Some(Refusal::Pushed { torque_nm });
        }
    }
    for share in [0.9, 0.7, 0.5] {
        if let Some(limit_nm) = explains(Extra::Limit, share * commanded_nm / unit)
            && limit_nm.abs() < 0.98 * commanded_nm
        {
            return Some(Refusal::Saturates {
                limit_nm: limit_nm.abs(),
                commanded_nm,
            });
        }
    }
    None
}
