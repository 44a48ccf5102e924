//! A square root of + × ÷ alone, for the tick.

/// √x or a little more, for finite x ≥ 0: at most 6e-7 of it too large, and at most one
/// rounding too small.
///
/// Halving the exponent guesses √x to 4 %; each step of Heron's, g ← ½(g + x/g), halves
/// the square of that error and stays above √x, since ½(g + x/g) − √x = (g − √x)²/(2g) ≥ 0.
/// The guess is above zero, so nothing is divided by zero; √0 comes out as 1e-20.
///
/// ```
/// use control::root::root;
/// assert!((root(2.0) - 1.414_213_6).abs() < 1e-6);
/// assert!(root(0.0) < 1e-19);
/// ```
#[must_use]
#[inline]
pub fn root(x: f32) -> f32 {
    let guess = f32::from_bits((x.to_bits() >> 1) + 0x1FBD_1DF5);
    let near = 0.5 * (guess + x / guess);
    0.5 * (near + x / near)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn it_is_the_root_from_above(x in (-80.0..80.0f64).prop_map(f64::exp)) {
            let x = x as f32;
            let exact = f64::from(x).sqrt();
            let error = (f64::from(root(x)) - exact) / exact;
            prop_assert!((-1.2e-7..6e-7).contains(&error), "{x}: {error:e}");
        }
    }
}
