use std::hint::black_box;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::Spread;
use crate::closed_loop::SceneError;
use crate::suite::{Contender, SuiteError, runs};
use crate::trial::{Sampled, Trial};

/// Ticks of a run that are recorded at most.
const RECORDED: usize = 1_000;

/// What the ticks of a law saw in the runs of the [`suite`](crate::suite), so that it can be
/// ticked again without a plant.
pub struct Replay {
    law: Contender,
    sampled: Sampled,
    runs: Vec<Recorded>,
}

struct Recorded {
    trial: Trial,
    /// Counter, and time since the last tick (s).
    ticks: Vec<(u32, f32)>,
}

impl Replay {
    /// Records the first 1,000 ticks of each run of the suite under a law that is asked for a
    /// stiffness.
    ///
    /// # Errors
    /// Refuses what is no device, and ends when `stop` is raised.
    pub fn record(
        law: Contender,
        sampled: &Sampled,
        demand_nm_rad: f64,
        stop: &AtomicBool,
    ) -> Result<Self, SuiteError> {
        let mut recorded = Vec::new();
        for run in runs(sampled, law.law(), demand_nm_rad) {
            if stop.load(Ordering::Relaxed) {
                return Err(SuiteError::Stopped);
            }
            let mut ticks = Vec::new();
            let mut control = law.control(&run.trial, sampled)?;
            let record = |counter, duration_s| {
                ticks.push((counter, duration_s));
                control(counter, duration_s)
            };
            let mut sample = 0;
            run.trial.watch_under(record, 0.0, |_| {
                sample += 1;
                sample < RECORDED
            })?;
            let trial = run.trial;
            recorded.push(Recorded { trial, ticks });
        }
        Ok(Self {
            law,
            sampled: *sampled,
            runs: recorded,
        })
    }

    /// Which law.
    #[must_use]
    pub fn law(&self) -> Contender {
        self.law
    }

    /// Ticks of all runs.
    #[must_use]
    pub fn ticks(&self) -> usize {
        self.runs.iter().map(|run| run.ticks.len()).sum()
    }

    /// Ticks through all runs, each with a fresh controller: ns per tick.
    fn play(&self) -> Result<f64, SceneError> {
        let control = |run: &Recorded| self.law.control(&run.trial, &self.sampled);
        let mut controls = self
            .runs
            .iter()
            .map(control)
            .collect::<Result<Vec<_>, _>>()?;
        let began = Instant::now();
        for (run, control) in self.runs.iter().zip(&mut controls) {
            for (counter, duration_s) in &run.ticks {
                black_box(control(*counter, *duration_s));
            }
        }
        Ok(1e9 * began.elapsed().as_secs_f64() / self.ticks() as f64)
    }
}

/// Nanoseconds per tick of each law on this machine: what its controller, or its
/// [`Rendered`](crate::rivals::Rendered) stand-in, computes from counter to torque, and a call
/// through a pointer. One thread; one pass to warm up, then `rounds` rounds of all laws in turn, of which
/// median and quartiles are taken.
///
/// # Errors
/// As [`Replay::record`].
pub fn tick_times(
    replays: &[Replay],
    rounds: usize,
    stop: &AtomicBool,
) -> Result<Vec<Spread>, SuiteError> {
    let mut measured = vec![Vec::new(); replays.len()];
    for round in 0..=rounds {
        for (replay, ns) in replays.iter().zip(&mut measured) {
            if stop.load(Ordering::Relaxed) {
                return Err(SuiteError::Stopped);
            }
            let once = replay.play()?;
            if round > 0 {
                ns.push(once);
            }
        }
    }
    Ok(measured.into_iter().filter_map(Spread::of).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preset::PRESETS;
    use crate::suite::ANY_STIFFNESS;

    #[test]
    fn a_replay_ticks_what_the_runs_ticked() {
        let re35 = &PRESETS[0];
        let sampled = Sampled {
            device: re35.device,
            count_rad: re35.count_rad(),
            period_s: re35.period_s,
        };
        let stop = AtomicBool::new(false);
        let laws = [Contender::Ledger, Contender::EnergyBounding];
        let replays = laws.map(|law| Replay::record(law, &sampled, ANY_STIFFNESS, &stop).unwrap());
        for replay in &replays {
            assert_eq!(replay.runs.len(), 240);
            assert!(replay.ticks() > 10_000);
            // Played back, the torque at the last recorded tick of a leaning hand holds the push.
            let leaning = &replay.runs[239];
            let mut control = replay.law.control(&leaning.trial, &sampled).unwrap();
            let torques = leaning.ticks.iter().map(|(c, s)| control(*c, *s).torque_nm);
            let last = f64::from(torques.last().unwrap());
            let push = leaning.trial.scene.hand.push_nm;
            assert!(
                last < 0.0 && (push + last).abs() <= 2.1 * sampled.device.coulomb_nm,
                "{last}"
            );
        }
        assert_eq!(tick_times(&replays, 3, &stop).unwrap().len(), 2);
        let stopped = tick_times(&replays, 3, &AtomicBool::new(true));
        assert_eq!(stopped, Err(SuiteError::Stopped));
    }
}
