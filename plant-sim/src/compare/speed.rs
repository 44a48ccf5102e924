use std::hint::black_box;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::{Contestant, Plane, Spread};
use crate::display::Display;
use crate::hold::State;
use crate::kernel;
use crate::outcome::Class;

/// The classes that a plane is sorted by.
pub const CLASSES: [Class; 3] = [Class::Rest, Class::LimitCycle, Class::Unstable];

/// Displays that the vector kernel gets at a time, as in a sweep: the plane's, over and over.
const LANES: usize = 512;

/// As long as a batch lasts at least, s: long against the clock's step and an interrupt.
const BATCH_S: f64 = 0.01;

/// Times of a contestant, ns per simulated sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Times {
    /// All displays of the plane.
    pub all: Spread,
    /// Those of each of [`CLASSES`] alone; `None` where a class has no display.
    pub by_class: [Option<Spread>; 3],
}

/// Displays that one contestant runs in one go, timed as a whole.
struct Part {
    runs: Vec<(Display, State)>,
    /// Samples of all runs, for the vector kernel, which does not count them.
    samples: u64,
}

impl Part {
    fn new(plane: &Plane, wanted: impl Fn(Class) -> bool) -> Self {
        let cells = (0..plane.runs.len()).filter(|cell| wanted(plane.classes[*cell]));
        let cells: Vec<usize> = cells.collect();
        Self {
            runs: cells.iter().map(|cell| plane.runs[*cell]).collect(),
            samples: cells.iter().map(|cell| plane.lengths[*cell]).sum(),
        }
    }

    /// Over and over, for at least so many lanes.
    fn repeated(&self, lanes: usize) -> Self {
        let times = lanes.div_ceil(self.runs.len().max(1));
        Self {
            runs: self.runs.repeat(times),
            samples: self.samples * times as u64,
        }
    }

    /// Seconds and simulated samples of all runs, `repeats` times over; `None` if stopped.
    fn time(&self, contestant: &Contestant, repeats: u32, stop: &AtomicBool) -> Option<(f64, u64)> {
        let go_on = || !stop.load(Ordering::Relaxed);
        let mut samples = 0;
        let began = Instant::now();
        for _ in 0..repeats {
            match contestant {
                Contestant::Scalar(method) => {
                    for (display, start) in &self.runs {
                        if !go_on() {
                            return None;
                        }
                        let run = method.run(black_box(display), *start, Plane::SAMPLES);
                        samples += black_box(run).samples;
                    }
                }
                Contestant::Vector(set) => {
                    let runs = black_box(&self.runs);
                    black_box(kernel::classify(*set, runs, Plane::SAMPLES, |_| go_on())?);
                    samples += self.samples;
                }
            }
        }
        Some((began.elapsed().as_secs_f64(), samples))
    }
}

/// What a contestant runs in a round.
struct Batch<'a> {
    contestant: &'a Contestant,
    by_class: [Part; 3],
    /// All displays at once, for the vector kernel. One display at a time the order does not matter,
    /// and the whole is the sum of its parts.
    whole: Option<Part>,
    repeats: u32,
}

impl<'a> Batch<'a> {
    fn new(contestant: &'a Contestant, plane: &Plane) -> Self {
        let by_class = CLASSES.map(|class| Part::new(plane, |own| own == class));
        let (by_class, whole) = match contestant {
            Contestant::Scalar(_) => (by_class, None),
            Contestant::Vector(_) => (
                by_class.map(|part| part.repeated(LANES)),
                Some(Part::new(plane, |_| true).repeated(LANES)),
            ),
        };
        Self {
            contestant,
            by_class,
            whole,
            repeats: 1,
        }
    }

    /// Seconds of one pass, and ns per sample: of all, and by class (NaN without displays).
    fn run(&self, stop: &AtomicBool) -> Option<(f64, [f64; 4])> {
        let time = |part: &Part| part.time(self.contestant, self.repeats, stop);
        let (mut seconds, mut samples) = (0.0, 0);
        let mut ns = [f64::NAN; 4];
        for (ns, part) in ns[1..].iter_mut().zip(&self.by_class) {
            let (part_s, part_samples) = time(part)?;
            *ns = 1e9 * part_s / part_samples as f64;
            seconds += part_s;
            samples += part_samples;
        }
        if let Some(whole) = &self.whole {
            (seconds, samples) = time(whole)?;
        }
        ns[0] = 1e9 * seconds / samples as f64;
        Some((seconds, ns))
    }
}

/// Nanoseconds per simulated sample of every contestant on a plane, with the rules for the outcome, as
/// [`Method::run`](crate::methods::Method::run) and [`kernel::classify`] have them.
///
/// One thread. After one pass to warm up, `rounds` rounds; in each every contestant runs a batch of
/// 10 ms or more of the same displays, one after the other, so that a disturbance of the machine meets
/// all alike. Median and quartiles are over the rounds. What is not simulated, since a display
/// rests or has diverged, is not counted; of the vector kernel those samples count that the scalar map
/// runs. `progress` is told after each batch, contestants × (rounds + 1) times. `None` if `stop` was
/// raised.
#[must_use]
pub fn times(
    contestants: &[Contestant],
    plane: &Plane,
    rounds: usize,
    stop: &AtomicBool,
    progress: &dyn Fn(),
) -> Option<Vec<Times>> {
    let mut batches = Vec::new();
    for contestant in contestants {
        let mut batch = Batch::new(contestant, plane);
        let (seconds, _) = batch.run(stop)?;
        batch.repeats = (BATCH_S / seconds).ceil().clamp(1.0, 1e6) as u32;
        batches.push((batch, Vec::new()));
        progress();
    }
    for _ in 0..rounds {
        for (batch, measured) in &mut batches {
            measured.push(batch.run(stop)?.1);
            progress();
        }
    }
    let spread = |measured: &[[f64; 4]], place: usize| {
        let spread = Spread::of(measured.iter().map(|ns| ns[place]))?;
        spread.median.is_finite().then_some(spread)
    };
    let times = batches.iter().map(|(_, measured)| {
        Some(Times {
            all: spread(measured, 0)?,
            by_class: [1, 2, 3].map(|place| spread(measured, place)),
        })
    });
    times.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::InstructionSet;
    use crate::methods::named;
    use std::cell::Cell;

    #[test]
    fn every_contestant_is_timed_in_every_round_on_every_class() {
        let plane = Plane::new(4).unwrap();
        let contestants = [
            Contestant::Scalar(named("exact").unwrap()),
            Contestant::Vector(InstructionSet::best()),
        ];
        let told = Cell::new(0);
        let all = times(&contestants, &plane, 2, &AtomicBool::new(false), &|| {
            told.set(told.get() + 1);
        });
        assert_eq!(told.get(), 6);
        for times in all.unwrap() {
            for spread in times
                .by_class
                .map(Option::unwrap)
                .iter()
                .chain([&times.all])
            {
                assert!(spread.low > 0.0, "{times:?}");
                assert!(spread.low <= spread.median && spread.median <= spread.high);
            }
        }
        let stopped = times(&contestants, &plane, 2, &AtomicBool::new(true), &|| ());
        assert_eq!(stopped, None);
    }

    #[test]
    fn a_part_holds_the_displays_of_its_class_and_their_samples() {
        let plane = Plane::new(4).unwrap();
        let parts = CLASSES.map(|class| Part::new(&plane, |own| own == class));
        let displays: usize = parts.iter().map(|part| part.runs.len()).sum();
        assert_eq!(displays, 16);
        let exact = Contestant::Scalar(named("exact").unwrap());
        for part in &parts {
            let (_, samples) = part.time(&exact, 3, &AtomicBool::new(false)).unwrap();
            assert_eq!(samples, 3 * part.samples);
            let repeated = part.repeated(100);
            assert!(repeated.runs.len() >= 100 && repeated.runs.len() < 100 + part.runs.len());
            assert_eq!(
                repeated.samples / part.samples,
                (repeated.runs.len() / part.runs.len()) as u64
            );
        }
    }
}
