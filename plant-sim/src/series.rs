//! The functions that the closed form of a held interval is made of, in forms that
//! keep their digits for every argument ≥ 0.

/// 1/(k+2)!: φ₂(y) = Σ (−y)ᵏ/(k+2)!.
const PHI2: [f64; 16] = factorial_tail();

/// As many terms of it as suffice for y ≤ 1/32 (the next is below 1e-17 of the sum).
pub(crate) const PHI2_SMALL: [f64; 8] = factorial_tail();

/// Below this the power series are used.
const SERIES_BELOW: f64 = 0.5;

/// The largest y for which [`PHI2_SMALL`] suffices.
pub(crate) const SMALL: f64 = 1.0 / 32.0;

/// 1/(k+2)! for k = 0, 1, …
const fn factorial_tail<const N: usize>() -> [f64; N] {
    let mut terms = [0.0; N];
    let mut factorial = 2.0;
    let mut k = 0;
    while k < N {
        terms[k] = 1.0 / factorial;
        factorial *= (k + 3) as f64;
        k += 1;
    }
    terms
}

/// Σ coefficients[k]·xᵏ, even and odd powers side by side: half as long a chain of
/// operations that wait for each other as in Horner's form.
#[inline]
pub(crate) fn polynomial<const N: usize>(coefficients: &[f64; N], x: f64) -> f64 {
    let square = x * x;
    let (mut even, mut odd) = (0.0, 0.0);
    for (k, c) in coefficients.iter().enumerate().rev() {
        if k % 2 == 0 {
            even = even * square + c;
        } else {
            odd = odd * square + c;
        }
    }
    even + x * odd
}

/// φ₂(y) = (y − 1 + e⁻ʸ)/y², y ≥ 0.
#[inline]
pub(crate) fn phi2(y: f64) -> f64 {
    if y <= SMALL {
        polynomial(&PHI2_SMALL, -y)
    } else if y < SERIES_BELOW {
        polynomial(&PHI2, -y)
    } else {
        // Two divisions, not one by y²: y² may overflow.
        (y + (-y).exp_m1()) / y / y
    }
}

/// φ₁(y) = (1 − e⁻ʸ)/y from y and φ₂(y).
#[inline]
pub(crate) fn phi1(y: f64, phi2: f64) -> f64 {
    if y < SERIES_BELOW {
        1.0 - y * phi2
    } else {
        -(-y).exp_m1() / y
    }
}

/// χ(y) = (1 − 2φ₁(y) + φ₁(2y))/y²: the mean square of ∫₀ᵗ e^(−as) ds over a held
/// interval, in units of its length.
pub(crate) fn chi(y: f64) -> f64 {
    /// (2^(k+2) − 2)/(k+3)!.
    const CHI: [f64; 20] = {
        let mut terms = [0.0; 20];
        let mut factorial = 6.0;
        let mut power = 4.0;
        let mut k = 0;
        while k < terms.len() {
            terms[k] = (power - 2.0) / factorial;
            power *= 2.0;
            factorial *= (k + 4) as f64;
            k += 1;
        }
        terms
    };
    if y < SERIES_BELOW {
        polynomial(&CHI, -y)
    } else {
        let phi1 = |y: f64| -(-y).exp_m1() / y;
        (1.0 - 2.0 * phi1(y) + phi1(2.0 * y)) / y / y
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// φ₁, φ₂, χ from their integrals, by Gauss–Legendre with 12 nodes on 64 panels: an
    /// independent way that is good to 1e-15 for moderate y.
    fn integral(f: impl Fn(f64) -> f64) -> f64 {
        const NODES: [(f64, f64); 6] = [
            (0.125_233_408_511_468_9, 0.249_147_045_813_402_8),
            (0.367_831_498_998_180_2, 0.233_492_536_538_354_8),
            (0.587_317_954_286_617_5, 0.203_167_426_723_065_9),
            (0.769_902_674_194_304_7, 0.160_078_328_543_346_2),
            (0.904_117_256_370_474_9, 0.106_939_325_995_318_4),
            (0.981_560_634_246_719_3, 0.047_175_336_386_511_8),
        ];
        let panels = 64;
        let half = 0.5 / f64::from(panels);
        (0..panels)
            .map(|panel| {
                let middle = (2.0 * f64::from(panel) + 1.0) * half;
                NODES
                    .iter()
                    .map(|(x, w)| w * half * (f(middle + half * x) + f(middle - half * x)))
                    .sum::<f64>()
            })
            .sum()
    }

    #[test]
    fn series_agree_with_their_integrals_on_both_sides_of_every_switch() {
        for y in [
            0.0,
            1e-300,
            1e-12,
            1e-3,
            SMALL,
            SMALL * 1.000_001,
            0.1,
            0.499_999,
            0.5,
            0.500_001,
            0.75,
            2.0,
            10.0,
            40.0,
        ] {
            let two = phi2(y);
            let one = phi1(y, two);
            let expected = integral(|s| (-y * s).exp());
            assert!(
                (one - expected).abs() <= 4e-15 * expected,
                "φ₁({y}) = {one}, not {expected}"
            );
            let expected = integral(|s| (1.0 - s) * (-y * s).exp());
            assert!(
                (two - expected).abs() <= 4e-15 * expected,
                "φ₂({y}) = {two}, not {expected}"
            );
            let expected = integral(|s| {
                let reach = if y * s == 0.0 {
                    s
                } else {
                    -(-y * s).exp_m1() / y
                };
                reach * reach
            });
            assert!(
                (chi(y) - expected).abs() <= 4e-15 * expected,
                "χ({y}) = {}, not {expected}",
                chi(y)
            );
        }
    }

    #[test]
    fn huge_arguments_give_finite_limits() {
        for y in [1e6, 1e154, 1e160, 1e300] {
            assert!((phi2(y) * y - 1.0).abs() < 2e-6, "{y}");
            assert!((phi1(y, phi2(y)) * y - 1.0).abs() < 1e-15, "{y}");
            assert!((chi(y) * y * y - 1.0).abs() < 2e-6 || y > 1e150, "{y}");
        }
    }
}
