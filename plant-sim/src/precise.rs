//! The dimensionless display (6) in arithmetic of 77 digits: what the exact map, and every other
//! method, is measured against.
//!
//! The same closed form as [`crate::hold`], each function by its power series below 1/16 and as it
//! stands above, in 256 bits (crate `dashu-float`). At most a few digits are lost per sample; 50
//! are left after thousands.

use control::ConfigError;
use control::criterion::Dimensionless;
use dashu_float::FBig;
use dashu_float::round::mode::HalfEven;

use crate::hold::{Hold, State};
use crate::methods::Method;

/// A number of 256 bits.
pub type Number = FBig<HalfEven, 2>;

/// Digits of a [`Number`], bits.
const PRECISION: usize = 256;

/// ξ and ξ̇.
#[derive(Debug, Clone, PartialEq)]
pub struct PreciseState {
    /// ξ, counts.
    pub position: Number,
    /// ξ̇, counts per sample.
    pub velocity: Number,
}

/// A display (6), its inputs exact doubles.
#[derive(Debug, Clone)]
pub struct PreciseDisplay {
    mu: Number,
    beta: Number,
    sigma: Number,
    /// β/μ.
    rate: Number,
    /// φ₁, φ₂ of a whole interval.
    phi: [Number; 2],
}

/// A double as a [`Number`], exactly.
///
/// # Panics
/// If it is not finite.
#[must_use]
pub fn number(value: f64) -> Number {
    Number::try_from(value)
        .expect("a finite double")
        .with_precision(PRECISION)
        .value()
}

/// The double nearest to a [`Number`].
#[must_use]
pub fn double(value: &Number) -> f64 {
    value.to_f64().value()
}

impl From<State> for PreciseState {
    fn from(state: State) -> Self {
        Self {
            position: number(state.position),
            velocity: number(state.velocity),
        }
    }
}

impl PreciseDisplay {
    /// A display with the parameters of (7).
    ///
    /// # Errors
    /// As [`Hold::dimensionless`].
    pub fn new(parameters: Dimensionless<f64>) -> Result<Self, ConfigError> {
        let Dimensionless { mu, beta, sigma } = parameters;
        Hold::dimensionless(mu, beta, sigma)?;
        let [mu, beta, sigma] = [mu, beta, sigma].map(number);
        let rate = &beta / &mu;
        Ok(Self {
            phi: phi(&rate),
            mu,
            beta,
            sigma,
            rate,
        })
    }

    /// The state one sample later.
    ///
    /// ```
    /// use control::criterion::Dimensionless;
    /// use plant_sim::{hold::State, precise::{PreciseDisplay, double}};
    /// // ½t² against φ = −½ and σ = ½, from ξ̇ = 2: ξ = 2 − ½, ξ̇ = 1.
    /// let display = PreciseDisplay::new(Dimensionless { mu: 1.0, beta: 0.0, sigma: 0.5 })?;
    /// let end = display.sample(&State { position: 0.0, velocity: 2.0 }.into());
    /// assert_eq!((double(&end.position), double(&end.velocity)), (1.5, 1.0));
    /// # Ok::<(), control::ConfigError>(())
    /// ```
    #[must_use]
    pub fn sample(&self, state: &PreciseState) -> PreciseState {
        let PreciseState {
            position: x,
            velocity: v,
        } = state;
        let force = -(x.floor() + number(0.5));
        let zero = number(0.0);
        let d = if *v > zero {
            &force - &self.sigma
        } else if *v < zero {
            &force + &self.sigma
        } else {
            self.breakaway(&force)
        };
        let [one, two] = &self.phi;
        let velocity = v - v * (&self.rate * one) + &d / &self.mu * one;
        if (*v > zero && velocity < zero) || (*v < zero && velocity > zero) {
            return self.sample_with_turn(state, &force, &d);
        }
        PreciseState {
            position: x + v * one + &d / &self.mu * two,
            velocity,
        }
    }

    fn sample_with_turn(&self, state: &PreciseState, force: &Number, d: &Number) -> PreciseState {
        let v = &state.velocity;
        let z = -(&self.beta * v) / d;
        let q = -(&self.mu * v) / d;
        let [log, distance] = log_terms(&z);
        let left = number(1.0) - &q * log;
        let turn = &state.position + &q * v * distance;
        let gain = self.breakaway(force) * &left / &self.mu;
        let [one, two] = phi(&(&self.rate * &left));
        PreciseState {
            position: turn + &gain * left * two,
            velocity: gain * one,
        }
    }

    /// F − clamp(F, ±σ).
    fn breakaway(&self, force: &Number) -> Number {
        if *force > self.sigma {
            force - &self.sigma
        } else if *force < -&self.sigma {
            force + &self.sigma
        } else {
            number(0.0)
        }
    }

    /// The state `samples` samples later.
    #[must_use]
    pub fn follow(&self, start: State, samples: u64) -> PreciseState {
        (0..samples).fold(start.into(), |state, _| self.sample(&state))
    }

    /// H_T (17): ½μξ̇² + ½n² + (n + ½)(ξ − n), n = ⌊ξ⌋; units of K Δ².
    #[must_use]
    pub fn stored_energy(&self, state: &PreciseState) -> Number {
        let half = number(0.5);
        let n = state.position.floor();
        &half * &self.mu * &state.velocity * &state.velocity
            + &half * &n * &n
            + (&n + &half) * (&state.position - &n)
    }

    /// Energy that `method` adds to the display by itself within `samples` intervals: the sum,
    /// over its own states, of H_T (17) after its interval less that after the true one. Units
    /// of K Δ²; NaN from where the method gives no number.
    #[must_use]
    pub fn added_energy(
        &self,
        method: &(impl Method + ?Sized),
        hold: &Hold,
        start: State,
        samples: u64,
    ) -> f64 {
        let (mut state, mut added) = (start, number(0.0));
        for _ in 0..samples {
            let truth = self.sample(&state.into());
            let force = crate::display::quantised_force(state.position);
            state = method.sample(hold, state, force);
            if !(state.position.is_finite() && state.velocity.is_finite()) {
                return f64::NAN;
            }
            added += self.stored_energy(&state.into()) - self.stored_energy(&truth);
        }
        double(&added)
    }
}

/// Below this the power series are used: above it the closed forms lose a digit or two of 77.
const SERIES_BELOW: f64 = 1.0 / 16.0;

/// Terms of a series in y ≤ 1/16 that has no factorials, for 77 digits.
const TERMS: u32 = 66;

/// φ₁(y) = (1 − e⁻ʸ)/y and φ₂(y) = (y − 1 + e⁻ʸ)/y², y ≥ 0.
fn phi(y: &Number) -> [Number; 2] {
    let one = number(1.0);
    if *y >= number(SERIES_BELOW) {
        let first = -(-y).exp_m1() / y;
        let second = (&one - &first) / y;
        return [first, second];
    }
    // φ₂ = Σ (−y)ᵏ/(k + 2)!, by Horner's rule.
    let mut sum = number(0.0);
    for k in (0..TERMS).rev() {
        sum = (&one - y * sum) / number(f64::from(k + 2));
    }
    [&one - y * &sum, sum]
}

/// log1p(z)/z and (1 − log1p(z)/z)/z, z ≥ 0.
fn log_terms(z: &Number) -> [Number; 2] {
    let one = number(1.0);
    if *z >= number(SERIES_BELOW) {
        let log = z.ln_1p() / z;
        let second = (&one - &log) / z;
        return [log, second];
    }
    // (1 − log1p(z)/z)/z = Σ (−z)ᵏ/(k + 2).
    let mut sum = number(0.0);
    for k in (0..TERMS).rev() {
        sum = &one / number(f64::from(k + 2)) - z * sum;
    }
    [&one - z * &sum, sum]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both sides of every switch agree to 70 digits.
    #[test]
    fn series_meet_their_closed_forms() {
        let at = number(SERIES_BELOW);
        let below = &at - number(1e-75);
        let near = |a: &Number, b: &Number| {
            let gap = double(&(a - b)).abs();
            assert!(gap < 1e-70, "{a} and {b}: {gap}");
        };
        for (a, b) in phi(&at).iter().zip(&phi(&below)) {
            near(a, b);
        }
        for (a, b) in log_terms(&at).iter().zip(&log_terms(&below)) {
            near(a, b);
        }
    }
}
