//! sin 2πφ and cos 2πφ, for profiles that repeat and for coordinates that turn.

/// sin 2πφ for |φ| ≤ ½ (in turns), to 2e-7: folded into a quarter turn, then the Taylor
/// series to the 11th power, whose next term is 6e-8 at the quarter.
///
/// ```
/// use control::sine::sine_of_turns;
/// assert_eq!(sine_of_turns(0.0), 0.0);
/// assert!((sine_of_turns(0.25) - 1.0).abs() < 2e-7);
/// assert!((sine_of_turns(-1.0 / 12.0) + 0.5).abs() < 2e-7);
/// ```
#[must_use]
#[inline(never)]
pub fn sine_of_turns(phase: f32) -> f32 {
    let folded = if phase > 0.25 {
        0.5 - phase
    } else if phase < -0.25 {
        -0.5 - phase
    } else {
        phase
    };
    let y = core::f32::consts::TAU * folded;
    let z = y * y;
    let series = -1.0 / 6.0
        + z * (1.0 / 120.0
            + z * (-1.0 / 5_040.0 + z * (1.0 / 362_880.0 - z * (1.0 / 39_916_800.0))));
    y + y * z * series
}

/// sin 2πφ and cos 2πφ for |φ| ≤ ½ (in turns), each to 2e-7: cos 2πφ = sin 2π(¼ − |φ|), which
/// needs no folding.
///
/// ```
/// use control::sine::sine_and_cosine_of_turns;
/// let (sine, cosine) = sine_and_cosine_of_turns(1.0 / 6.0);
/// assert!((sine - 0.866_025_4).abs() < 2e-7 && (cosine - 0.5).abs() < 2e-7);
/// ```
#[must_use]
#[inline]
pub fn sine_and_cosine_of_turns(phase: f32) -> (f32, f32) {
    (sine_of_turns(phase), sine_of_turns(0.25 - phase.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_errs_by_less_than_two_in_ten_million_over_the_turn() {
        for i in -500_000..=500_000 {
            let phase = i as f32 * 1e-6;
            let (exact, exact_cosine) = (core::f64::consts::TAU * f64::from(phase)).sin_cos();
            let (sine, cosine) = sine_and_cosine_of_turns(phase);
            assert!((f64::from(sine) - exact).abs() < 2e-7, "{phase}");
            assert!((f64::from(cosine) - exact_cosine).abs() < 2e-7, "{phase}");
        }
    }
}
