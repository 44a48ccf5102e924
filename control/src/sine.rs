//! sin 2πφ, for profiles that repeat.

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_errs_by_less_than_two_in_ten_million_over_the_turn() {
        for i in -500_000..=500_000 {
            let phase = i as f32 * 1e-6;
            let exact = (core::f64::consts::TAU * f64::from(phase)).sin();
            assert!(
                (f64::from(sine_of_turns(phase)) - exact).abs() < 2e-7,
                "{phase}"
            );
        }
    }
}
