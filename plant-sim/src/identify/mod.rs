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
//! as wider by [`WIDENING`]·e, and the intervals widen with them. Beyond [`MOST_MISFIT_COUNTS`]
//! there is no answer, but a [`Refusal`] with what is likely wrong.
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

/// The largest misfit with an answer, counts.
pub const MOST_MISFIT_COUNTS: f64 = 1.0;

/// By how many times the misfit counts are taken as wider.
pub const WIDENING: f64 = 4.0;

/// An interval for m or c whose ends have a larger ratio is no answer.
const MOST_RATIO: f64 = 2.0;

/// Beyond rounding: ranges of the exact plant are good to some 1e-9 counts.
const ROUNDING: f64 = 1e-5;

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
    let unexplained = |misfit_counts: f64, place: usize| Refusal::Unexplained {
        misfit_counts,
        time_s: recording.time_s(place),
        accepted_counts: MOST_MISFIT_COUNTS,
    };
    let Recording {
        period_s,
        count_rad,
        ..
    } = *recording;
    let Some((model, near)) = Model::near(&pushes, period_s, count_rad) else {
        return Err(unexplained(f64::INFINITY, 0));
    };
    let (fit, _) = model.fit(&near, Extra::Nothing, 0.0);
    let (best, range) = bounds::least_range(&model, &fit);
    let misfit_counts = (0.5 * (range - 1.0)).max(0.0);
    // NaN is none.
    if !(misfit_counts <= MOST_MISFIT_COUNTS) {
        return Err(cause(recording, &model, &fit)
            .unwrap_or_else(|| unexplained(misfit_counts, worst(&model, &best))));
    }
    let within = 1.0 + 2.0 * WIDENING * misfit_counts + ROUNDING;
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
            value: of(&value).clamp(low, high),
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
        if !(high <= MOST_RATIO * low) {
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

/// What one more cause would explain, tried one after the other.
fn cause(recording: &Recording, model: &Model<'_>, fit: &Theta) -> Option<Refusal> {
    slip(recording, model, fit).or_else(|| beside(model, fit))
}

/// A count that leaps beyond the motion.
fn slip(recording: &Recording, model: &Model<'_>, fit: &Theta) -> Option<Refusal> {
    let _ = fit;
    for push in model.pushes {
        let counts: &Vec<f64> = &push.counts;
        for (place, four) in counts.windows(4).enumerate() {
            let [a, b, c, d] = four else { continue };
            // A motion's steps change little from tick to tick: the middle one against its neighbours.
            let (before, jump, after) = (b - a, c - b, d - c);
            let (least, most) = (before.min(after), before.max(after));
            let beyond = (jump - most).max(least - jump);
            if beyond > 3.0 + 0.5 * (most - least) + 0.1 * most.abs().max(least.abs()) {
                return Some(Refusal::Slips {
                    jump: if jump > most {
                        jump - most
                    } else {
                        jump - least
                    },
                    time_s: recording.time_s(push.range.start + place + 2),
                });
            }
        }
    }
    None
}

/// A torque that acts beside the commanded one, or a limit of it.
fn beside(model: &Model<'_>, fit: &Theta) -> Option<Refusal> {
    let unit = model.unit.coulomb_nm;
    let heights = model.pushes.iter().map(Push::height_nm);
    let commanded_nm = heights.map(f64::abs).fold(0.0, f64::max);
    let good = |extra: Extra, start: f64| {
        let (theta, size) = model.fit(fit, extra, start);
        let angles = model.follow(&theta, extra, size)?;
        let misfit = 0.5 * (bounds::largest_range(&model.beyond(&angles)) - 1.0);
        (misfit <= 2.0 * MOST_MISFIT_COUNTS).then_some(size * unit)
    };
    if let Some(torque_nm) = good(Extra::Push, 0.0) {
        return Some(Refusal::Pushed { torque_nm });
    }
    for share in [0.9, 0.7, 0.5] {
        if let Some(limit_nm) = good(Extra::Limit, share * commanded_nm / unit) {
            return Some(Refusal::Saturates {
                limit_nm: limit_nm.abs(),
                commanded_nm,
            });
        }
    }
    None
}
