//! The outcome over a grid of the (β, σ) plane: the paper's Fig. 5.

use std::f64::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};

use control::ConfigError;
use control::criterion::Dimensionless;
use rayon::prelude::*;

use crate::display::Display;
use crate::hold::State;
use crate::kernel::{self, InstructionSet};
use crate::outcome::{Classes, DIVERGED_COUNTS};

/// Cells that one piece of work holds: enough to keep the vector kernel full while its
/// lanes finish one by one, few enough for many pieces.
const PIECE: usize = 512;

/// The most cells along one side of a grid.
pub const LARGEST_GRID: usize = 10_000;

/// A range of β or σ, from < to, both finite and not below zero. Valid by construction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    from: f64,
    to: f64,
}

impl Span {
    /// The range the paper draws.
    pub const UNIT: Self = Self { from: 0.0, to: 1.0 };

    /// A range, or None if it is empty, reversed, negative or not finite.
    #[must_use]
    pub fn new(from: f64, to: f64) -> Option<Self> {
        (0.0 <= from && from < to && to.is_finite()).then_some(Self { from, to })
    }

    /// Its lower end.
    #[must_use]
    pub fn from(&self) -> f64 {
        self.from
    }

    /// Its upper end.
    #[must_use]
    pub fn to(&self) -> f64 {
        self.to
    }

    /// The middle of cell `index` of `grid` equal cells.
    #[must_use]
    pub fn centre(&self, index: usize, grid: usize) -> f64 {
        self.from + (self.to - self.from) * ((index as f64 + 0.5) / grid as f64)
    }
}

/// What to sweep. Valid by construction.
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    mu: f64,
    samples: u64,
    grid: usize,
    beta: Span,
    sigma: Span,
    v0: Vec<f64>,
}

/// Why a map cannot be swept.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapError {
    /// The grid has no cells, or too many.
    #[error("a grid of {0}; accepted: 1 to {LARGEST_GRID} cells a side")]
    Grid(usize),
    /// No samples to run.
    #[error("0 samples; accepted: 1 or more")]
    Samples,
    /// No initial velocity.
    #[error("no initial velocity; accepted: one or more")]
    NoVelocity,
    /// An initial velocity that no run can start with.
    #[error("initial velocity {0}; accepted: a finite number of at most 1e9 counts per sample")]
    Velocity(f64),
    /// A display that cannot be.
    #[error(transparent)]
    Display(#[from] ConfigError),
}

impl Map {
    /// Displays of one μ over a `grid` × `grid` of cell centres, from ξ(0) = 0 with each of
    /// the initial velocities `v0` (counts per sample).
    ///
    /// # Errors
    /// See [`MapError`].
    pub fn new(
        mu: f64,
        samples: u64,
        grid: usize,
        beta: Span,
        sigma: Span,
        v0: Vec<f64>,
    ) -> Result<Self, MapError> {
        if !(1..=LARGEST_GRID).contains(&grid) {
            return Err(MapError::Grid(grid));
        }
        if samples == 0 {
            return Err(MapError::Samples);
        }
        if v0.is_empty() {
            return Err(MapError::NoVelocity);
        }
        if let Some(bad) = v0.iter().find(|v| v.is_nan() || v.abs() > DIVERGED_COUNTS) {
            return Err(MapError::Velocity(*bad));
        }
        let map = Self {
            mu,
            samples,
            grid,
            beta,
            sigma,
            v0,
        };
        // The corner with the most damping is the one whose ratios may overflow.
        Display::new(Dimensionless {
            mu,
            beta: beta.to,
            sigma: sigma.to,
        })?;
        Ok(map)
    }

    /// Cells of all panels.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.v0.len() * self.grid * self.grid
    }

    /// Cells along one side of a panel.
    #[must_use]
    pub fn grid(&self) -> usize {
        self.grid
    }

    /// The range of β.
    #[must_use]
    pub fn beta(&self) -> Span {
        self.beta
    }

    /// The range of σ.
    #[must_use]
    pub fn sigma(&self) -> Span {
        self.sigma
    }

    /// Samples of each run.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// The initial velocities, one per panel.
    #[must_use]
    pub fn v0(&self) -> &[f64] {
        &self.v0
    }

    /// Panel, β index and σ index of a cell: σ runs fastest, then β, then the panel.
    #[must_use]
    pub fn place(&self, cell: usize) -> (usize, usize, usize) {
        let panel = self.grid * self.grid;
        (cell / panel, cell % panel / self.grid, cell % self.grid)
    }

    /// β, σ and the initial velocity of a cell.
    #[must_use]
    pub fn point(&self, cell: usize) -> (Dimensionless<f64>, f64) {
        let (panel, i, j) = self.place(cell);
        let parameters = Dimensionless {
            mu: self.mu,
            beta: self.beta.centre(i, self.grid),
            sigma: self.sigma.centre(j, self.grid),
        };
        (parameters, self.v0[panel])
    }

    /// Runs the cells of one shard on every core and returns their classes in order.
    /// `progress` is told of display-samples as they are settled, cells × samples in
    /// all. Returns None if `stop` was set on the way.
    #[must_use]
    pub fn sweep(
        &self,
        shard: Shard,
        set: InstructionSet,
        stop: &AtomicBool,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Option<Vec<Classes>> {
        let cells: Vec<usize> = shard.cells(self.cells()).collect();
        let told = |settled| {
            progress(settled);
            !stop.load(Ordering::Relaxed)
        };
        let pieces: Option<Vec<Vec<Classes>>> = cells
            .par_chunks(PIECE)
            .map(|piece| self.sweep_piece(piece, set, &told))
            .collect();
        Some(pieces?.concat())
    }

    fn sweep_piece(
        &self,
        cells: &[usize],
        set: InstructionSet,
        told: &dyn Fn(u64) -> bool,
    ) -> Option<Vec<Classes>> {
        if !told(0) {
            return None;
        }
        let runs = cells.iter().map(|cell| {
            let (parameters, velocity) = self.point(*cell);
            let display = Display::new(parameters).ok()?;
            Some((
                display,
                State {
                    position: 0.0,
                    velocity,
                },
            ))
        });
        let runs: Vec<(Display, State)> = runs.collect::<Option<_>>()?;
        let (light, heavy): (Vec<usize>, Vec<usize>) =
            (0..runs.len()).partition(|i| kernel::serves(&runs[*i].0));
        let lanes: Vec<_> = light.iter().map(|i| runs[*i]).collect();
        let mut classes = vec![None; runs.len()];
        for (i, class) in light
            .iter()
            .zip(kernel::classify(set, &lanes, self.samples, told)?)
        {
            classes[*i] = Some(class);
        }
        for i in heavy {
            let (display, start) = runs[i];
            let mut settled = 0;
            let mut go_on = true;
            let run = display.run(start, self.samples, |sample, _| {
                if sample % 65_536 == 65_535 {
                    go_on = told(65_536);
                    settled += 65_536;
                }
                go_on
            });
            if !(told(self.samples.saturating_sub(settled)) && go_on) {
                return None;
            }
            classes[i] = Some(run.classes);
        }
        classes.into_iter().collect()
    }
}

/// One of `of` equal parts of a map: the cells whose number leaves the rest `index` when
/// divided by `of`, so that every shard holds a like share of slow cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    of: usize,
}

impl Shard {
    /// The whole map.
    pub const WHOLE: Self = Self { index: 0, of: 1 };

    /// Part `number` of `of`, counted from 1; None unless 1 ≤ number ≤ of.
    #[must_use]
    pub fn new(number: usize, of: usize) -> Option<Self> {
        (1 <= number && number <= of).then(|| Self {
            index: number - 1,
            of,
        })
    }

    /// Its number, from 1.
    #[must_use]
    pub fn number(&self) -> usize {
        self.index + 1
    }

    /// How many parts there are.
    #[must_use]
    pub fn of(&self) -> usize {
        self.of
    }

    /// Its cells, of `cells` in all.
    pub fn cells(&self, cells: usize) -> impl Iterator<Item = usize> {
        (self.index..cells).step_by(self.of)
    }
}

/// The left side of the describing-function condition β + 4σ/(π v₀) < ½: below ½, the
/// oscillation that a start at ξ(0) = 0 with velocity v₀ begins grows.
///
/// Not in the paper; an estimate of the true edge that the criterion (10) is the safe
/// side of, not a guarantee. Infinite at v₀ = 0 (zero with σ = 0).
///
/// Assumes an oscillation much slower than the sampling, μ ≫ 1/π², and larger than a count.
#[must_use]
pub fn describing_function(beta: f64, sigma: f64, v0: f64) -> f64 {
    beta + if sigma > 0.0 {
        4.0 * sigma / (PI * v0.abs())
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::Class;

    #[test]
    fn shards_hold_every_cell_once_and_give_what_the_whole_gives() {
        let map = Map::new(50.0, 8_000, 13, Span::UNIT, Span::UNIT, vec![2.0, 30.0]).unwrap();
        let stop = AtomicBool::new(false);
        let set = InstructionSet::best();
        let whole = map.sweep(Shard::WHOLE, set, &stop, &|_| ()).unwrap();
        assert_eq!(whole.len(), map.cells());
        for of in [2, 3, 7, 500] {
            let mut merged = vec![None; map.cells()];
            for number in 1..=of {
                let shard = Shard::new(number, of).unwrap();
                let part = map.sweep(shard, set, &stop, &|_| ()).unwrap();
                for (cell, class) in shard.cells(map.cells()).zip(part) {
                    assert_eq!(merged[cell].replace(class), None);
                }
            }
            assert_eq!(
                merged.into_iter().collect::<Option<Vec<_>>>().unwrap(),
                whole
            );
        }
    }

    #[test]
    fn heavy_damping_per_sample_is_left_to_the_scalar_core() {
        // β/μ up to 20: beyond the kernel's series. σ > ½ and β > ½ must rest.
        let map = Map::new(
            0.05,
            20_000,
            8,
            Span::new(0.5, 1.0).unwrap(),
            Span::new(0.5, 1.0).unwrap(),
            vec![3.0],
        )
        .unwrap();
        let settled = std::sync::atomic::AtomicU64::new(0);
        let classes = map.sweep(
            Shard::WHOLE,
            InstructionSet::best(),
            &AtomicBool::new(false),
            &|n| {
                settled.fetch_add(n, Ordering::Relaxed);
            },
        );
        assert!(
            classes
                .unwrap()
                .iter()
                .all(|c| c.window == Class::Rest && c.paper == Class::Rest)
        );
        assert_eq!(settled.into_inner(), 64 * 20_000);
    }

    #[test]
    fn a_sweep_that_is_stopped_returns_nothing() {
        let map = Map::new(50.0, 8_000, 8, Span::UNIT, Span::UNIT, vec![30.0]).unwrap();
        let stopped = map.sweep(
            Shard::WHOLE,
            InstructionSet::best(),
            &AtomicBool::new(true),
            &|_| (),
        );
        assert_eq!(stopped, None);
    }

    #[test]
    fn a_map_that_cannot_be_is_refused() {
        let new = |mu, samples, grid, v0| Map::new(mu, samples, grid, Span::UNIT, Span::UNIT, v0);
        assert_eq!(new(50.0, 1, 0, vec![1.0]), Err(MapError::Grid(0)));
        assert_eq!(new(50.0, 1, 10_001, vec![1.0]), Err(MapError::Grid(10_001)));
        assert_eq!(new(50.0, 0, 9, vec![1.0]), Err(MapError::Samples));
        assert_eq!(new(50.0, 1, 9, vec![]), Err(MapError::NoVelocity));
        assert_eq!(new(50.0, 1, 9, vec![1e10]), Err(MapError::Velocity(1e10)));
        assert!(new(50.0, 1, 9, vec![f64::NAN]).is_err());
        for mu in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-310] {
            assert!(
                matches!(new(mu, 1, 9, vec![1.0]), Err(MapError::Display(_))),
                "{mu}"
            );
        }
        assert_eq!(Span::new(0.5, 0.5), None);
        assert_eq!(Span::new(-0.1, 0.5), None);
        assert_eq!(Span::new(0.0, f64::NAN), None);
        assert_eq!(
            (Shard::new(0, 4), Shard::new(5, 4), Shard::new(1, 0)),
            (None, None, None)
        );
    }
}
