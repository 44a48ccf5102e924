//! The dimensionless haptic display (6): μ ξ̈ + β ξ̇ + σ sgn ξ̇ = φ, with the quantised
//! spring φ = −(⌊ξ(h)⌋ + ½) (5) held over every interval [h, h+1).

use control::ConfigError;
use control::criterion::Dimensionless;

use crate::energy::{self, Exchange, Ledger};
use crate::hold::{Hold, State};
use crate::outcome::{Class, Classes, DIVERGED_COUNTS, Peaks};

/// φ = −(⌊ξ⌋ + ½) (5).
///
/// Below 2⁵¹ without a call to `floor`: adding and taking away 1.5·2⁵² rounds ξ to the
/// nearest whole number, which lies half a count from the middle of the cell, on the
/// side that the rest (its sign; + 0.0 so that −0 has none) tells.
#[must_use]
#[inline]
pub fn quantised_force(xi: f64) -> f64 {
    if xi.abs() < ROUNDER / 3.0 {
        let nearest = (xi + ROUNDER) - ROUNDER;
        let rest = (xi + 0.0) - nearest;
        -(nearest + 0.5_f64.copysign(rest))
    } else {
        -(xi.floor() + 0.5)
    }
}

/// 1.5·2⁵²: see [`quantised_force`].
pub(crate) const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// As far as [`Display::run_audited`] follows a display, counts: the energy there, of the
/// order of its square, is finite.
const FURTHEST_COUNTS: f64 = 1e150;

/// A display, solved exactly. Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Display {
    hold: Hold,
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// ξ and ξ̇ at the last sample.
    pub end: State,
    /// Samples run: as many as asked for, or fewer if the display came to rest or
    /// diverged before.
    pub samples: u64,
    /// What became of it, by both rules.
    pub classes: Classes,
}

impl Display {
    /// A display with the parameters of (7).
    ///
    /// # Errors
    /// Refuses a μ that is not finite and above zero, a β or σ that is not finite or below
    /// zero, and values beyond 1e100, or a μ below 1e-100, whose squares overflow.
    pub fn new(parameters: Dimensionless<f64>) -> Result<Self, ConfigError> {
        let Dimensionless { mu, beta, sigma } = parameters;
        Ok(Self {
            hold: Hold::dimensionless(mu, beta, sigma)?,
        })
    }

    /// The display that repeats an interval of [`Hold::dimensionless`].
    pub(crate) fn of(hold: Hold) -> Self {
        Self { hold }
    }

    /// The interval that this display repeats.
    #[must_use]
    pub fn hold(&self) -> &Hold {
        &self.hold
    }

    /// μ, β, σ.
    #[must_use]
    pub fn parameters(&self) -> Dimensionless<f64> {
        Dimensionless {
            mu: self.hold.inertia(),
            beta: self.hold.viscous(),
            sigma: self.hold.coulomb(),
        }
    }

    /// True if the state never changes again: at rest, and friction holds the force of
    /// its own count.
    #[must_use]
    #[inline]
    pub fn rests(&self, state: State) -> bool {
        state.velocity == 0.0 && self.hold.breakaway(quantised_force(state.position)) == 0.0
    }

    /// H_T (17): ½μξ̇² + H_e(ξ), units of K Δ².
    #[must_use]
    pub fn stored_energy(&self, state: State) -> f64 {
        energy::kinetic(self.hold.inertia(), state.velocity)
            + energy::quantised_potential(state.position)
    }

    /// The displacement at rest that stores the same energy (17) as a velocity at
    /// ξ = 0 (Sec. V: "the initial velocity has been converted into an initial
    /// displacement").
    ///
    /// ```
    /// use control::criterion::Dimensionless;
    /// use plant_sim::{display::Display, hold::State};
    /// let display = Display::new(Dimensionless { mu: 50.0, beta: 0.3, sigma: 0.7 })?;
    /// let xi = display.displacement_of_equal_energy(2.0); // ½·50·2² = 100 = H_e(ξ)
    /// let at_rest = State { position: xi, velocity: 0.0 };
    /// assert!((display.stored_energy(at_rest) - 100.0).abs() < 1e-12);
    /// # Ok::<(), control::ConfigError>(())
    /// ```
    #[must_use]
    pub fn displacement_of_equal_energy(&self, velocity: f64) -> f64 {
        energy::displacement_storing(energy::kinetic(self.hold.inertia(), velocity))
    }

    /// Runs `samples` intervals from `start`, or fewer if the display comes to rest or
    /// leaves 1e9 counts behind, and says what became of it. Memory does not depend on
    /// `samples`. `observe` sees every sample, the start as sample 0; it may end the run
    /// by returning false.
    pub fn run(&self, start: State, samples: u64, observe: impl FnMut(u64, State) -> bool) -> Run {
        let step = |state, force| self.hold.step(state, force).end;
        self.run_by(step, start, samples, observe)
    }

    /// [`Display::run`], moved over every interval by `step`, which takes the state and the held
    /// force: see [`crate::methods`].
    pub(crate) fn run_by(
        &self,
        step: impl Fn(State, f64) -> State,
        start: State,
        samples: u64,
        mut observe: impl FnMut(u64, State) -> bool,
    ) -> Run {
        let mut state = start;
        let mut peaks = Peaks::new(samples);
        let mut sample = 0;
        // The peak speed of the samples that lie in the same windows as this one.
        let mut peak: f64 = 0.0;
        let mut alike = peaks.last_alike(0);
        let classes = loop {
            if sample > alike {
                peaks.enter(alike, peak);
                peak = 0.0;
                alike = peaks.last_alike(sample);
            }
            let speed = state.velocity.abs();
            if speed > peak {
                peak = speed;
            }
            let go_on = observe(sample, state);
            if self.rests(state) {
                break both(Class::Rest);
            }
            if state.position.abs() > DIVERGED_COUNTS || state.position.is_nan() {
                break both(Class::Unstable);
            }
            if sample == samples {
                peaks.enter(sample, peak);
                break peaks.classes(speed);
            }
            if !go_on {
                break both(Class::Undecided);
            }
            state = step(state, quantised_force(state.position));
            sample += 1;
        };
        Run {
            end: state,
            samples: sample,
            classes,
        }
    }

    /// Runs exactly `samples` intervals from `start`, or fewer if the display comes to rest,
    /// and audits every one. Other than [`Display::run`] it goes on where it has diverged,
    /// up to 1e150 counts, beyond which an energy has no place in an `f64`. `go_on` is
    /// asked at every sample; the run ends where it returns false.
    pub fn run_audited(
        &self,
        start: State,
        samples: u64,
        mut go_on: impl FnMut(u64) -> bool,
    ) -> (Run, Ledger) {
        let mut state = start;
        let mut ledger = Ledger::default();
        let mut peaks = Peaks::new(samples);
        let mut diverged = false;
        let mut sample = 0;
        let classes = loop {
            let speed = state.velocity.abs();
            peaks.enter(sample, speed);
            diverged |= state.position.abs() > DIVERGED_COUNTS;
            let classes = if self.rests(state) {
                both(Class::Rest)
            } else if sample == samples {
                peaks.classes(speed)
            } else if go_on(sample) {
                let (next, exchange) = self.audited_step(state, 0.0);
                if next.position.abs().max(next.velocity.abs()) < FURTHEST_COUNTS {
                    ledger.enter(exchange);
                    state = next;
                    sample += 1;
                    continue;
                }
                both(Class::Unstable)
            } else {
                both(Class::Undecided)
            };
            break if diverged {
                both(Class::Unstable)
            } else {
                classes
            };
        };
        let run = Run {
            end: state,
            samples: sample,
            classes,
        };
        (run, ledger)
    }

    /// One interval under the display's own force and a hand that pushes with `push`
    /// (units of K Δ): the state after it, and what it generated and dissipated.
    #[must_use]
    pub fn audited_step(&self, state: State, push: f64) -> (State, Exchange) {
        let force = quantised_force(state.position) + push;
        let step = self.hold.step(state, force);
        let exchange = Exchange {
            generated: energy::generated(state.position, step.end.position),
            dissipated: energy::dissipated(&self.hold, state, force, &step),
        };
        (step.end, exchange)
    }
}

/// Where both rules agree.
fn both(class: Class) -> Classes {
    Classes {
        window: class,
        paper: class,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_audited_run_goes_on_after_divergence_and_is_else_the_same() {
        let from = |velocity| State {
            position: 0.0,
            velocity,
        };
        for (mu, beta, sigma, v0, samples) in [
            (50.0, 0.3, 0.7, 10.0, 20_000),
            (50.0, 0.6, 0.3, 10.0, 20_000),
            (50.0, 0.6, 0.3, 10.0, 500),
            (50.0, 0.2, 0.4, 3.0, 9_000),
        ] {
            let display = Display::new(Dimensionless { mu, beta, sigma }).unwrap();
            let run = display.run(from(v0), samples, |_, _| true);
            let (audited, ledger) = display.run_audited(from(v0), samples, |_| true);
            if run.end.position.abs() > DIVERGED_COUNTS {
                assert!(run.samples < samples);
                assert_eq!(audited.samples, samples);
                assert!(audited.end.position.abs().max(audited.end.velocity.abs()) > 1e9);
                assert_eq!(audited.classes, both(Class::Unstable));
            } else {
                assert_eq!(audited, run);
            }
            let stored = display.stored_energy(audited.end) - display.stored_energy(from(v0));
            let balance = ledger.generated - ledger.dissipated;
            let scale = ledger.generated.abs().max(ledger.dissipated);
            assert!((stored - balance).abs() <= 1e-9 * scale);
        }
        // Far beyond what an f64 can hold: the last state that it can.
        let wild = Display::new(Dimensionless {
            mu: 0.1,
            beta: 0.0,
            sigma: 0.0,
        })
        .unwrap();
        let (run, ledger) = wild.run_audited(from(1e9), 50_000, |_| true);
        assert!(run.samples < 50_000 && run.end.position.abs() > 1e100);
        assert!(ledger.generated.is_finite() && ledger.given_out.is_finite());
    }

    #[test]
    fn the_force_is_that_of_the_floor_also_on_edges_and_far_out() {
        let far = [2.0_f64.powi(50), 2.0_f64.powi(51), 1e17, -1e17, 1e300];
        let edges = (-1000..1000).map(f64::from);
        let beside = edges
            .clone()
            .flat_map(|n| [n.next_up(), n.next_down(), n + 0.5, n + 0.3]);
        for xi in
            edges
                .chain(beside)
                .chain(far)
                .chain([-0.0, f64::MIN_POSITIVE, -f64::MIN_POSITIVE])
        {
            assert_eq!(quantised_force(xi), -(xi.floor() + 0.5), "ξ = {xi:?}");
        }
    }
}
