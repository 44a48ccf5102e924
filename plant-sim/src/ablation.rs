//! The energy ledger without one of its parts: how stiff it is, and what breaks.

use std::sync::atomic::{AtomicBool, Ordering};

use control::config::Law;
use control::tuning::Tuning;
use rayon::prelude::*;

use crate::campaign::{Campaign, Kind, Tally};
use crate::closed_loop::SceneError;
use crate::suite;
use crate::trial::{EXTENSION, Sampled, Trial, abbott_okamura};

/// Runs of the suite are extended up to this many times their 4,000 samples, and random ones without a
/// hand: those without an end are many, and what ends does so sooner.
const SUITE_EXTENSION: u64 = 64;
const FREE_EXTENSION: u64 = 64;

/// Runs of a kind made between two looks at how many were bad.
const CHUNK: u64 = 250;

/// Bad runs after which a kind has shown enough.
const ENOUGH: usize = 100;

/// A variant of the ledger.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variant {
    /// What was done to it.
    pub name: &'static str,
    /// What the part is for.
    pub purpose: &'static str,
    /// The constants.
    pub tuning: Tuning,
}

/// The ledger as it is built, and without each of its parts in turn.
#[must_use]
pub fn variants() -> Vec<Variant> {
    let built = Tuning::DEFAULT;
    let variant = |name, purpose, tuning| Variant {
        name,
        purpose,
        tuning,
    };
    vec![
        variant("as built", "", built),
        variant(
            "no limit",
            "the torque L that the energy there can pay for: everything rests on it",
            Tuning {
                limit: false,
                ..built
            },
        ),
        variant(
            "no position",
            "where in its cell the knob can be: less is charged and held back for what is not known",
            Tuning {
                position: false,
                ..built
            },
        ),
        variant(
            "no charge",
            "a change of torque at a place not known may cost energy",
            Tuning {
                charge: false,
                ..built
            },
        ),
        variant(
            "no step 3",
            "credit from one contact must not be spent in the next",
            Tuning {
                no_carry: false,
                ..built
            },
        ),
        variant(
            "no count margin",
            "the count in d − Δ: else a leaning hand ratchets",
            Tuning {
                count_margin: false,
                ..built
            },
        ),
        variant(
            "no cap",
            "K ≤ max(min(m/Te², 3c/Δ), AO): beyond, a leaning hand is thrown back within a tick",
            Tuning {
                cap: false,
                ..built
            },
        ),
        variant(
            "no friction",
            "η of what friction surely took may be given back",
            Tuning {
                friction: false,
                ..built
            },
        ),
        variant(
            "no holding",
            "a torque that holds the knob may stay",
            Tuning {
                holding: false,
                ..built
            },
        ),
        variant(
            "no hand",
            "accelerations that nobody told, of a hand, widen the intervals",
            Tuning {
                hand: false,
                ..built
            },
        ),
        variant(
            "J = 4",
            "a longer look back narrows the velocity",
            Tuning {
                ticks_back: 4,
                ..built
            },
        ),
        variant(
            "J = 2",
            "the same",
            Tuning {
                ticks_back: 2,
                ..built
            },
        ),
        variant(
            "J = 1",
            "the same",
            Tuning {
                ticks_back: 1,
                ..built
            },
        ),
        variant(
            "η = ½",
            "more of the friction credited is stiffer, less tolerates more error in c",
            Tuning {
                credit: 0.5,
                ..built
            },
        ),
        variant(
            "η = 0.9",
            "the same",
            Tuning {
                credit: 0.9,
                ..built
            },
        ),
        variant(
            "2m/Te², 4c/Δ, η = 0.9",
            "the caps at which no leaning hand ratchets",
            Tuning {
                credit: 0.9,
                inertia_cap: 2.0,
                coulomb_cap: 4.0,
                ..built
            },
        ),
    ]
}

/// What became of a variant.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Geometric mean over the devices of the static stiffness under a push of 30 c, over
    /// [`abbott_okamura`].
    pub stiffness: f64,
    /// Runs of the suite.
    pub suite_runs: usize,
    /// Bad ones: hits of a wall, flights into a spring, leaning hands.
    pub suite_bad: [usize; 3],
    /// Random runs by kind.
    pub random: Vec<(Kind, Tally)>,
}

impl Outcome {
    /// Share of runs of a kind that are bad.
    #[must_use]
    pub fn rate(&self, kind: Kind) -> f64 {
        self.random
            .iter()
            .find(|(of, _)| *of == kind)
            .map_or(0.0, |(_, tally)| {
                tally.bad.len() as f64 / tally.runs.max(1) as f64
            })
    }
}

/// Measures a variant in all threads: the suite on the devices, and up to `runs` random runs of each kind, fewer where
/// a hundred bad ones have shown enough. None if `stop` was set.
///
/// # Errors
/// See [`SceneError`]; nothing of it is refused.
pub fn measure(
    variant: &Variant,
    devices: &[Sampled],
    runs: u64,
    seed: u64,
    stop: &AtomicBool,
    seen: &(dyn Fn() + Sync),
) -> Result<Option<Outcome>, SceneError> {
    let mut suite_runs = 0;
    let mut suite_bad = [0; 3];
    let mut logarithm = 0.0;
    for sampled in devices {
        let ended = suite::runs(sampled, Law::Ledger, DEMAND_NM_RAD)
            .par_iter()
            .with_max_len(4)
            .map(|run| {
                if stop.load(Ordering::Relaxed) {
                    return Ok(None);
                }
                let trial = Trial {
                    extension: SUITE_EXTENSION,
                    hasty: true,
                    ..run.trial
                };
                let verdict = trial.run_tuned(variant.tuning)?;
                let depth = verdict.report.end.position - trial.scene.config.shape.zero_rad();
                seen();
                Ok(Some((
                    *run,
                    verdict.fault.is_some(),
                    verdict.end_torque_nm.abs() / depth,
                )))
            })
            .collect::<Result<Option<Vec<_>>, SceneError>>()?;
        let Some(ended) = ended else { return Ok(None) };
        suite_runs += ended.len();
        let (mut sum, mut hardest) = (0.0, 0.0);
        for (run, bad, stiffness) in ended {
            suite_bad[match run.kind {
                suite::Kind::Hit => 0,
                suite::Kind::Spring => 1,
                suite::Kind::Lean => 2,
            }] += usize::from(bad);
            if run.leans_hardest {
                // Where it has bounced off there is none.
                sum += stiffness.max(1e-9).ln();
                hardest += 1.0;
            }
        }
        logarithm += sum / hardest - abbott_okamura(sampled)?.ln();
    }
    let mut random = Vec::new();
    for kind in Kind::ALL {
        let campaign = Campaign {
            tuning: variant.tuning,
            extension: if kind.is_free() {
                FREE_EXTENSION
            } else {
                EXTENSION
            },
            hasty: true,
            ..Campaign::new(seed, Law::Ledger)
        };
        let mut tally = Tally::default();
        while tally.runs < runs && tally.bad.len() < ENOUGH {
            let until = (tally.runs + CHUNK).min(runs);
            if !campaign.go_on(kind, &mut tally, until, stop, &|_| seen())? {
                return Ok(None);
            }
        }
        random.push((kind, tally));
    }
    Ok(Some(Outcome {
        stiffness: (logarithm / devices.len() as f64).exp(),
        suite_runs,
        suite_bad,
        random,
    }))
}

/// Demanded of every run of the suite, Nm/rad: more than any device can have.
const DEMAND_NM_RAD: f64 = 1e6;
