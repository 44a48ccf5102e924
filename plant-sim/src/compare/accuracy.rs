use std::cell::RefCell;
use std::sync::atomic::{AtomicBool, Ordering};

use control::ConfigError;
use control::criterion::Dimensionless;
use rayon::prelude::*;

use super::Contestant;
use crate::campaign::{Draw, Kind};
use crate::display::Display;
use crate::hold::State;
use crate::kernel;
use crate::map::{Map, MapError, Span};
use crate::methods::{Exact, Method};
use crate::outcome::{Class, WINDOW_RULE_SAMPLES};
use crate::precise::{Number, PreciseDisplay, PreciseState, double, number};

/// Samples after which the position is compared.
pub const AFTER: [u64; 4] = [1, 10, 100, 1000];

/// Samples over which the energy is summed that a method adds.
pub const ADDED_OVER: u64 = 100;

/// μ of all displays that are compared.
const MU: f64 = 50.0;

/// Displays that the vector kernel gets at a time, as in a sweep.
const PIECE: usize = 512;

/// Which random displays.
const SEED: u64 = 1;

/// A display of μ = 50 that still moves after 1,000 samples, and where it truly is.
pub struct Trajectory {
    display: Display,
    precise: PreciseDisplay,
    start: State,
    /// ξ after [`AFTER`], in 77 digits.
    truth: Vec<Number>,
}

impl Trajectory {
    /// Number `number` of the random displays: σ in 0 to ½, so that friction never holds it, β in
    /// 0 to 1, or μ times the rate β/μ that is given; from −5 to 5 counts at 0.1 to 30 counts per
    /// sample, log-uniform. Oscillations that grow or fade, and limit cycles.
    ///
    /// # Errors
    /// Refuses a rate that gives no display.
    pub fn random(number: u64, rate: Option<f64>) -> Result<Self, ConfigError> {
        let mut draw = Draw::new(SEED, Kind::Spring, number);
        let parameters = Dimensionless {
            mu: MU,
            beta: rate.map_or(draw.between(0.0, 1.0), |rate| rate * MU),
            sigma: draw.between(0.0, 0.5),
        };
        let start = State {
            position: draw.between(-5.0, 5.0),
            velocity: draw.log(0.1, 30.0),
        };
        let precise = PreciseDisplay::new(parameters)?;
        let mut state = PreciseState::from(start);
        let mut truth = Vec::new();
        let mut sample = 0;
        for after in AFTER {
            while sample < after {
                state = precise.sample(&state);
                sample += 1;
            }
            truth.push(state.position.clone());
        }
        Ok(Self {
            display: Display::new(parameters)?,
            precise,
            start,
            truth,
        })
    }

    /// |ξ − truth| after [`AFTER`], counts. Infinite where the method gives no number.
    #[must_use]
    pub fn position_errors(&self, contestant: &Contestant) -> [f64; 4] {
        let mut errors = [f64::INFINITY; 4];
        let (mut state, mut sample) = (self.start, 0);
        for ((error, after), truth) in errors.iter_mut().zip(AFTER).zip(&self.truth) {
            state = contestant
                .method()
                .follow(&self.display, state, after - sample);
            sample = after;
            if !state.position.is_finite() {
                break;
            }
            *error = double(&(number(state.position) - truth)).abs();
        }
        errors
    }

    /// Energy that the method adds or takes by itself, in magnitude, per sample of the first
    /// [`ADDED_OVER`]: see [`PreciseDisplay::added_energy`]. K Δ².
    #[must_use]
    pub fn added_energy(&self, contestant: &Contestant) -> f64 {
        let (method, hold) = (contestant.method(), self.display.hold());
        let added = self
            .precise
            .added_energy(method, hold, self.start, ADDED_OVER);
        added.abs() / ADDED_OVER as f64
    }
}

/// The displays of a `grid` × `grid` of the (β, σ) plane over [0, 1]², μ = 50, from ξ(0) = 0 at 10
/// counts per sample, and what becomes of each within the fewest samples of the window rule.
pub struct Plane {
    /// Display and start of each cell.
    pub runs: Vec<(Display, State)>,
    /// Class of each by the exact map.
    pub classes: Vec<Class>,
    /// Samples until each rests or diverges, by the exact map.
    pub lengths: Vec<u64>,
}

impl Plane {
    /// The start, counts per sample.
    pub const V0: f64 = 10.0;

    /// Samples of each run.
    pub const SAMPLES: u64 = WINDOW_RULE_SAMPLES;

    /// With `grid` cells along a side.
    ///
    /// # Errors
    /// Refuses a grid without cells, or with too many.
    pub fn new(grid: usize) -> Result<Self, MapError> {
        let v0 = vec![Self::V0];
        let map = Map::new(MU, Self::SAMPLES, grid, Span::UNIT, Span::UNIT, v0)?;
        let run = |cell| {
            let (parameters, velocity) = map.point(cell);
            let start = State {
                position: 0.0,
                velocity,
            };
            Ok((Display::new(parameters)?, start))
        };
        let runs: Vec<(Display, State)> = (0..map.cells())
            .map(run)
            .collect::<Result<_, ConfigError>>()?;
        let ended = |(display, start): &(Display, State)| {
            let run = Exact.run(display, *start, Self::SAMPLES);
            (run.classes.window, run.samples)
        };
        let (classes, lengths) = runs.par_iter().map(ended).unzip();
        Ok(Self {
            runs,
            classes,
            lengths,
        })
    }

    /// The classes that a contestant finds, on every core. `progress` is told of cells that
    /// are done; `None` if `stop` was raised.
    #[must_use]
    pub fn classes_by(
        &self,
        contestant: &Contestant,
        stop: &AtomicBool,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Option<Vec<Class>> {
        let go_on = || !stop.load(Ordering::Relaxed);
        match contestant {
            Contestant::Scalar(method) => {
                let class = |(display, start): &(Display, State)| {
                    go_on().then(|| {
                        let run = method.run(display, *start, Self::SAMPLES);
                        progress(1);
                        run.classes.window
                    })
                };
                self.runs.par_iter().map(class).collect()
            }
            Contestant::Vector(set) => {
                let mut classes = Vec::new();
                for piece in self.runs.chunks(PIECE) {
                    let found = kernel::classify(*set, piece, Self::SAMPLES, |_| go_on())?;
                    classes.extend(found.into_iter().map(|classes| classes.window));
                    progress(piece.len());
                }
                Some(classes)
            }
        }
    }

    /// The classes in arithmetic of 77 digits; `progress` and `stop` as in
    /// [`Plane::classes_by`].
    ///
    /// # Errors
    /// None for a plane that there is.
    pub fn precise_classes(
        &self,
        stop: &AtomicBool,
        progress: &(dyn Fn(usize) + Sync),
    ) -> Result<Option<Vec<Class>>, ConfigError> {
        let class = |(display, start): &(Display, State)| {
            let precise = PreciseDisplay::new(display.parameters())?;
            let state = RefCell::new(PreciseState::from(*start));
            let step = |_, _| {
                let next = precise.sample(&state.borrow());
                let rounded = State {
                    position: double(&next.position),
                    velocity: double(&next.velocity),
                };
                state.replace(next);
                rounded
            };
            let go_on = |_, _| !stop.load(Ordering::Relaxed);
            let run = display.run_by(step, *start, Self::SAMPLES, go_on);
            progress(1);
            Ok(run.classes.window)
        };
        let classes = self.runs.par_iter().map(class).collect::<Result<_, _>>()?;
        Ok((!stop.load(Ordering::Relaxed)).then_some(classes))
    }
}

/// How many classes are not the true ones.
#[must_use]
pub fn wrong(classes: &[Class], truth: &[Class]) -> usize {
    let pairs = classes.iter().zip(truth);
    pairs.filter(|(class, truth)| class != truth).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::InstructionSet;
    use crate::methods::named;

    fn scalar(name: &str) -> Contestant {
        Contestant::Scalar(named(name).unwrap())
    }

    #[test]
    fn random_displays_move_and_stay_within_reach_and_the_exact_map_follows_them() {
        let contestants = [
            scalar("exact"),
            Contestant::Vector(InstructionSet::best()),
            scalar("euler:10"),
            scalar("euler:100"),
        ];
        for number in 0..20 {
            let trajectory = Trajectory::random(number, None).unwrap();
            let Trajectory { display, start, .. } = &trajectory;
            let before = Exact.follow(display, *start, 999);
            let end = Exact.follow(display, before, 1);
            assert_ne!(before, end, "{number} rests");
            assert!(end.position.abs() < 1e5, "{number}: {end:?}");
            let errors = contestants
                .each_ref()
                .map(|c| trajectory.position_errors(c));
            assert!(errors[0][3] < 1e-9 && errors[1][3] < 1e-9, "{errors:?}");
            assert!(errors[3][1] > 1e-7, "{errors:?}");
            let added = contestants.each_ref().map(|c| trajectory.added_energy(c));
            assert!(added[0] < 1e-11 && added[1] < 1e-11, "{added:?}");
            assert!(added[3] > 1e-6, "{added:?}");
        }
    }

    #[test]
    fn a_rate_is_beta_over_mu() {
        let trajectory = Trajectory::random(3, Some(1e-6)).unwrap();
        assert!((trajectory.display.parameters().beta - 5e-5).abs() < 1e-18);
    }

    #[test]
    fn classes_differ_where_a_method_errs_and_77_digits_agree_with_the_exact_map() {
        let plane = Plane::new(6).unwrap();
        let stop = AtomicBool::new(false);
        let error = |contestant: &Contestant| {
            let classes = plane.classes_by(contestant, &stop, &|_| ()).unwrap();
            wrong(&classes, &plane.classes)
        };
        assert_eq!(error(&scalar("exact")), 0);
        assert_eq!(error(&Contestant::Vector(InstructionSet::best())), 0);
        assert!(error(&scalar("euler:1")) > 18);
        let precise = plane.precise_classes(&stop, &|_| ()).unwrap().unwrap();
        assert_eq!(precise, plane.classes);
        for class in super::super::CLASSES {
            assert!(precise.contains(&class), "no {class}");
        }
        assert_eq!(
            wrong(
                &[Class::Rest, Class::Unstable, Class::LimitCycle],
                &[Class::Rest, Class::LimitCycle, Class::Unstable]
            ),
            2
        );
    }

    #[test]
    fn what_is_stopped_gives_nothing() {
        let plane = Plane::new(3).unwrap();
        let stop = AtomicBool::new(true);
        for contestant in [
            scalar("euler:1"),
            Contestant::Vector(InstructionSet::best()),
        ] {
            assert_eq!(plane.classes_by(&contestant, &stop, &|_| ()), None);
        }
        assert_eq!(plane.precise_classes(&stop, &|_| ()).unwrap(), None);
    }
}
