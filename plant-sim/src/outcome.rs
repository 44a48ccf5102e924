//! What became of a run: rest, limit cycle or divergence, by two rules side by side.
//!
//! *The paper's rule* (Sec. III) reads the last sample alone: slower than 0.01 counts per
//! sample counts as converged. A limit cycle that happens to be slow at that sample
//! is mistaken for rest.
//!
//! *The window rule* compares peak speeds in three windows of 2,000 samples: the
//! first, the one in the middle of the run, and the last.

use std::fmt;

/// Length of a window, samples.
const WINDOW: u64 = 2_000;

/// Fewest samples for which the three windows do not overlap.
pub const WINDOW_RULE_SAMPLES: u64 = 4 * WINDOW;

/// A run that leaves this many counts behind has diverged.
pub const DIVERGED_COUNTS: f64 = 1e9;

/// Slower than this at the end counts as converged, counts per sample (Sec. III).
const CONVERGED_SPEED: f64 = 0.01;

/// Growth of the peak speed that counts as growth.
const GROWTH: f64 = 1.02;

/// What became of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Class {
    /// Came to rest, or slower than 0.01 counts per sample.
    Rest,
    /// A sustained oscillation.
    LimitCycle,
    /// Grows without bound.
    Unstable,
    /// The run is too short to tell, which only the window rule says, or was ended.
    Undecided,
}

impl fmt::Display for Class {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Rest => "rest",
            Self::LimitCycle => "limit-cycle",
            Self::Unstable => "unstable",
            Self::Undecided => "undecided",
        })
    }
}

/// The class of one run by each rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Classes {
    /// By the window rule.
    pub window: Class,
    /// By the paper's rule; divergence, for which the paper gives no rule, as in
    /// the window rule.
    pub paper: Class,
}

/// Peak speeds seen in the three windows, counts per sample. All that the window rule
/// needs of a run, whatever its length. Sample k is the state after k intervals, the
/// start is sample 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Peaks {
    samples: u64,
    peak: [f64; 3],
}

/// First and last sample of the first, the middle and the last window of a run.
fn windows(samples: u64) -> [(u64, u64); 3] {
    [
        (0, WINDOW),
        (samples / 2, samples / 2 + WINDOW),
        (samples.saturating_sub(WINDOW) + 1, samples),
    ]
}

impl Peaks {
    pub(crate) fn new(samples: u64) -> Self {
        Self {
            samples,
            peak: [0.0; 3],
        }
    }

    /// The last sample for which, with all from `sample` on, one peak can be entered: up
    /// to it no window begins or ends.
    pub(crate) fn last_alike(&self, sample: u64) -> u64 {
        windows(self.samples)
            .into_iter()
            .flat_map(|(first, last)| [first, last + 1])
            .filter(|border| *border > sample)
            .min()
            .map_or(u64::MAX, |border| border - 1)
    }

    /// Enters the peak speed of the samples that end with `sample` and lie in the same windows.
    pub(crate) fn enter(&mut self, sample: u64, speed: f64) {
        for (peak, (first, last)) in self.peak.iter_mut().zip(windows(self.samples)) {
            if first <= sample && sample <= last && speed > *peak {
                *peak = speed;
            }
        }
    }

    /// The classes of a run that went on to its last sample without coming to rest or
    /// diverging, and is at `speed` there.
    pub(crate) fn classes(&self, speed: f64) -> Classes {
        let decided = self.samples >= WINDOW_RULE_SAMPLES;
        let [first, middle, last] = self.peak;
        let window = if !decided {
            Class::Undecided
        } else if last > GROWTH * middle && last > GROWTH * first {
            Class::Unstable
        } else if last < CONVERGED_SPEED {
            Class::Rest
        } else {
            Class::LimitCycle
        };
        let paper = match window {
            Class::Unstable => Class::Unstable,
            _ if speed < CONVERGED_SPEED => Class::Rest,
            _ => Class::LimitCycle,
        };
        Classes { window, paper }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peaks_entered_in_stretches_are_those_of_every_sample() {
        for samples in [1, 1_999, 2_000, 2_001, 5_000, 8_000, 8_001, 12_345] {
            // A speed that is largest at the borders of windows.
            let speed = |sample: u64| ((sample * 7919) % 1009) as f64 + (sample % 2000) as f64;
            let mut each = Peaks::new(samples);
            let mut stretches = Peaks::new(samples);
            let mut first = 0;
            for sample in 0..=samples {
                each.enter(sample, speed(sample));
            }
            while first <= samples {
                let last = stretches.last_alike(first).min(samples);
                let peak = (first..=last).map(speed).fold(0.0, f64::max);
                stretches.enter(last, peak);
                first = last + 1;
            }
            assert_eq!(each, stretches, "{samples} samples");
        }
    }

    #[test]
    fn the_rules_differ_where_they_should() {
        let classes = |first: f64, middle: f64, last: f64, end: f64| {
            let mut peaks = Peaks::new(50_000);
            peaks.enter(0, first);
            peaks.enter(26_000, middle);
            peaks.enter(49_000, last);
            let Classes { window, paper } = peaks.classes(end);
            (window, paper)
        };
        use Class::{LimitCycle, Rest, Unstable};
        assert_eq!(classes(10.0, 20.0, 40.0, 0.001), (Unstable, Unstable));
        // Growing, but not beyond the start: a cycle that is being approached from above.
        assert_eq!(classes(10.0, 1.0, 1.1, 1.0), (LimitCycle, LimitCycle));
        assert_eq!(classes(10.0, 1.0, 1.0, 0.001), (LimitCycle, Rest));
        assert_eq!(classes(10.0, 1.0, 0.009, 0.009), (Rest, Rest));
        assert_eq!(classes(10.0, 20.0, 20.3, 5.0), (LimitCycle, LimitCycle));
        // Too short for three windows; the paper's rule reads the last sample alone.
        let short = Peaks::new(7_999).classes(1.0);
        assert_eq!((short.window, short.paper), (Class::Undecided, LimitCycle));
        assert_eq!(Peaks::new(7_999).classes(0.001).paper, Rest);
    }
}
