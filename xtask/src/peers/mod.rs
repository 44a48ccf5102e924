//! `cargo xtask peers`: MuJoCo and SciPy beside the exact map, in one run on one core.
//!
//! Every engine simulates the dimensionless display (6) over the same grid of the (β, σ) plane and says
//! of each cell what became of it; the scalar exact map is the truth. The cells are dealt out to
//! [`ROUNDS`] rounds; in each round every engine has its share timed, one engine after the
//! other, so that what else the machine does meets all of them.

mod report;
mod setup;
mod worker;

use anyhow::{Context, Result};

use report::{Report, Row, Sample};
use worker::Worker;

/// μ, the initial velocity (counts per sample) and the samples of every run: the fewest that the window
/// rule of `plant_sim::outcome` takes.
pub const MU: f64 = 50.0;
pub const V0: f64 = 10.0;
pub const SAMPLES: u64 = 8_000;

/// Cells along a side of the grid, over β and σ from 0 to 1.
pub const GRID: usize = 40;

/// Rounds of measurement.
pub const ROUNDS: usize = 8;

/// Whose program runs an engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Program {
    /// plant-sim/examples/peer.rs.
    Ours,
    /// xtask/peers/peer.c.
    C,
    /// xtask/peers/peers.py.
    Python,
}

/// How much of the simulation an engine does itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// All of it.
    Whole,
    /// MuJoCo's friction, in stages that the caller puts together, or with a position that the
    /// caller corrects.
    Stages,
    /// The arithmetic of the step; friction is the caller's.
    NoFriction,
}

/// An engine in one setting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Engine {
    pub program: Program,
    /// What its program calls it.
    pub setting: &'static str,
    /// What the page calls it.
    pub name: &'static str,
    /// Steps a sample; 0 where the method needs none.
    pub steps: u32,
    pub part: Part,
    /// Every so many-th cell along both sides: slow engines do not run them all.
    pub every: usize,
}

const fn ours(setting: &'static str, name: &'static str) -> Engine {
    Engine {
        program: Program::Ours,
        setting,
        name,
        steps: 0,
        part: Whole,
        every: 1,
    }
}

const fn c(
    steps: u32,
    part: Part,
    every: usize,
    setting: &'static str,
    name: &'static str,
) -> Engine {
    Engine {
        program: Program::C,
        setting,
        name,
        steps,
        part,
        every,
    }
}

const fn python(steps: u32, every: usize, setting: &'static str, name: &'static str) -> Engine {
    Engine {
        program: Program::Python,
        setting,
        name,
        steps,
        part: Whole,
        every,
    }
}

/// The engine that is the truth, and the one that ratios are relative to.
const SCALAR: usize = 0;
const VECTOR: usize = 1;

use Part::{NoFriction, Stages, Whole};

/// All that are measured. MuJoCo's settings were searched for the fastest and for the most accurate; with
/// semi-implicit Euler, its default, one step a sample removes the instability under study.
const ENGINES: &[Engine] = &[
    ours("scalar", "exact map, one display after the other"),
    ours("vector", "exact map, vector kernel"),
    c(1, Whole, 1, "steps=1,euler", "`mj_step`, as it comes"),
    c(
        1,
        Whole,
        1,
        "steps=1,euler,lean,pgs",
        "`mj_step`, lean, PGS",
    ),
    c(
        1,
        Whole,
        1,
        "steps=1,euler,explicit,lean,pgs,hard=1",
        "`mj_step`, lean, PGS, hard, explicit damping",
    ),
    c(
        1,
        Whole,
        2,
        "steps=1,implicitfast,lean,pgs,hard=1",
        "`mj_step`, implicitfast, lean, PGS, hard",
    ),
    c(
        1,
        Whole,
        2,
        "steps=1,implicit,lean,pgs,hard=1",
        "`mj_step`, implicit, lean, PGS, hard",
    ),
    c(
        1,
        Whole,
        2,
        "steps=1,discrete,lean,pgs,hard=1",
        "`mj_step`, discrete, lean, PGS, hard",
    ),
    c(1, Whole, 2, "steps=1,rk4", "`mj_step`, RK4"),
    c(
        1,
        Whole,
        1,
        "steps=1,rk4,lean,pgs,hard=2",
        "`mj_step`, RK4, lean, PGS, hard",
    ),
    c(10, Whole, 4, "steps=10,euler", "`mj_step`, as it comes"),
    c(
        10,
        Whole,
        4,
        "steps=10,rk4,lean,pgs,hard=2",
        "`mj_step`, RK4, lean, PGS, hard",
    ),
    c(100, Whole, 8, "steps=100,euler", "`mj_step`, as it comes"),
    c(
        1,
        Stages,
        1,
        "steps=1,euler,explicit,lean,pgs,parts",
        "stages, PGS, explicit damping",
    ),
    c(
        1,
        Stages,
        1,
        "steps=1,euler,lean,pgs,hard=1,trapezoid",
        "`mj_step`, lean, PGS, hard, trapezoid",
    ),
    c(
        1,
        Stages,
        1,
        "steps=1,euler,lean,pgs,hard=1,parts,trapezoid",
        "stages, PGS, hard, trapezoid",
    ),
    c(
        1,
        Stages,
        1,
        "steps=1,euler,explicit,lean,pgs,hard=1,parts,trapezoid",
        "stages, PGS, hard, explicit damping, trapezoid",
    ),
    c(
        10,
        Stages,
        2,
        "steps=10,euler,lean,pgs,hard=1,parts,trapezoid",
        "stages, PGS, hard, trapezoid",
    ),
    c(
        100,
        Stages,
        4,
        "steps=100,euler,lean,pgs,hard=1,parts,trapezoid",
        "stages, PGS, hard, trapezoid",
    ),
    c(
        1,
        NoFriction,
        1,
        "steps=1,euler,explicit,lean,parts,by-hand",
        "stages, friction by hand, explicit damping",
    ),
    python(1, 2, "mujoco", "Python, `mj_step`, lean, PGS"),
    python(0, 8, "scipy", "SciPy `solve_ivp`, DOP853, events"),
];

/// Installs, builds, measures, prints, and writes docs/peers.md and docs/peers.csv.
pub fn peers() -> Result<()> {
    let place = setup::all()?;
    let core = setup::core();
    let spawn = |program, what| {
        Worker::spawn(place.command(program, core)).with_context(|| format!("cannot start {what}"))
    };
    let mut workers = [
        spawn(Program::Ours, "the exact map")?,
        spawn(Program::C, "the driver of MuJoCo's C library")?,
        spawn(Program::Python, "MuJoCo and SciPy in Python")?,
    ];
    let mut runs: Vec<Vec<Sample>> = vec![Vec::new(); ENGINES.len()];
    let mut classes = vec![vec![None; GRID * GRID]; ENGINES.len()];
    for round in 0..ROUNDS {
        for (i, engine) in ENGINES.iter().enumerate() {
            eprintln!(
                "xtask: round {} of {ROUNDS}, {} of {}: {} {}",
                round + 1,
                i + 1,
                ENGINES.len(),
                engine.name,
                engine.setting
            );
            let worker = &mut workers[engine.program as usize];
            let cells = share(engine, round);
            // Foreign engines gain nothing from company. Asked for one cell at a time, they end
            // soon after this program, however it ends.
            let at_once = match engine.program {
                Program::Ours => cells.len(),
                Program::C | Program::Python => 1,
            };
            let mut sum = Sample::default();
            for cells in cells.chunks(at_once) {
                let done = worker
                    .run(engine.setting, cells)
                    .with_context(|| format!("{} ({})", engine.name, engine.setting))?;
                sum.seconds += done.seconds;
                sum.samples += done.samples;
                for (cell, class) in cells.iter().zip(done.classes) {
                    classes[i][*cell] = Some(class);
                }
            }
            runs[i].push(sum);
        }
    }
    let rows = ENGINES.iter().enumerate().map(|(i, engine)| {
        Row::new(
            *engine,
            &runs[i],
            [&runs[VECTOR], &runs[SCALAR]],
            &classes[i],
            &classes[SCALAR],
        )
    });
    let report = Report {
        rows: rows.collect(),
        ours: workers[0].name().to_owned(),
        theirs: workers[2].name().to_owned(),
        machine: setup::machine(),
        pinned: core.is_some(),
    };
    print!("{}", report.text());
    report.write()
}

/// The cells of an engine in a round, σ running fastest as in `plant_sim::map`. Ours run all in every
/// round: the vector kernel is made for many at once. The others run each once.
fn share(engine: &Engine, round: usize) -> Vec<usize> {
    let side = (engine.every / 2..GRID).step_by(engine.every);
    let cells = side.clone().enumerate().flat_map(|(m, i)| {
        let row = side.clone().enumerate();
        row.map(move |(n, j)| (m + 3 * n, i * GRID + j))
    });
    cells
        .filter(|(deal, _)| engine.program == Program::Ours || deal % ROUNDS == round)
        .map(|(_, cell)| cell)
        .collect()
}

/// β or σ in the middle of a cell.
fn centre(index: usize) -> f64 {
    (index as f64 + 0.5) / GRID as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_round_has_work_and_every_cell_has_its_turn() {
        for engine in ENGINES {
            let side = GRID / engine.every;
            let mut met = vec![0; GRID * GRID];
            for round in 0..ROUNDS {
                let cells = share(engine, round);
                assert!(!cells.is_empty(), "{}", engine.setting);
                for cell in cells {
                    met[cell] += 1;
                }
            }
            let times = match engine.program {
                Program::Ours => ROUNDS,
                _ => 1,
            };
            assert_eq!(met.iter().filter(|n| **n == times).count(), side * side);
            assert_eq!(met.iter().sum::<usize>(), times * side * side);
        }
    }

    #[test]
    fn the_truth_and_what_ratios_refer_to_are_ours() {
        assert_eq!(ENGINES[SCALAR].setting, "scalar");
        assert_eq!(ENGINES[VECTOR].setting, "vector");
    }
}
