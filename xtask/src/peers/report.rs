//! Statistics of a run of all engines, and the page, table and CSV that tell them.

use std::fmt::Write;
use std::fs;

use anyhow::Result;

use super::worker::Class;
use super::{Engine, GRID, MU, Part, Program, ROUNDS, SAMPLES, V0, VECTOR};
use crate::tools::root;

/// What was aimed at: this many times MuJoCo's time per sample.
const TARGET: f64 = 1_000.0;

/// What an engine did in a round.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sample {
    pub seconds: f64,
    /// Samples simulated.
    pub samples: u64,
}

impl Sample {
    fn ns(&self) -> f64 {
        self.seconds * 1e9 / self.samples as f64
    }
}

/// One engine's figures.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    pub engine: Engine,
    /// Lower quartile, median and upper quartile over the rounds, ns per sample.
    ns: [f64; 3],
    /// Median over the rounds of its time per sample over ours: the vector kernel's, the scalar map's.
    ratios: [f64; 2],
    cells: usize,
    /// Cells classed other than by the truth.
    wrong: usize,
    /// Cells that rest in truth.
    resting: usize,
    /// Those of them that the engine lets diverge.
    let_diverge: usize,
}

impl Row {
    /// From an engine's rounds, those of ours (vector, scalar), its classes and the true ones.
    pub fn new(
        engine: Engine,
        rounds: &[Sample],
        ours: [&[Sample]; 2],
        classes: &[Option<Class>],
        truth: &[Option<Class>],
    ) -> Self {
        let cells: Vec<_> = classes
            .iter()
            .zip(truth)
            .filter_map(|(have, want)| Some(((*have)?, (*want)?)))
            .collect();
        let count = |test: fn(&(Class, Class)) -> bool| cells.iter().filter(|c| test(c)).count();
        let median_ratio = |ours: &[Sample]| {
            let ratios = rounds.iter().zip(ours).map(|(a, b)| a.ns() / b.ns());
            quartiles(ratios.collect())[1]
        };
        Self {
            engine,
            ns: quartiles(rounds.iter().map(Sample::ns).collect()),
            ratios: ours.map(median_ratio),
            cells: cells.len(),
            wrong: count(|(have, want)| have != want),
            resting: count(|(_, want)| *want == Class::Rest),
            let_diverge: count(|(have, want)| *want == Class::Rest && *have == Class::Unstable),
        }
    }

    /// Share of wrongly classed cells.
    fn error(&self) -> f64 {
        self.wrong as f64 / self.cells as f64
    }

    fn steps(&self) -> String {
        match self.engine.steps {
            0 => "–".to_owned(),
            steps => steps.to_string(),
        }
    }
}

/// Lower quartile, median and upper quartile, linearly between neighbours.
fn quartiles(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [0.25, 0.5, 0.75].map(|share| {
        let place = share * (values.len() - 1) as f64;
        let (low, high) = (
            values[place.floor() as usize],
            values[place.ceil() as usize],
        );
        low + (high - low) * place.fract()
    })
}

/// All figures of a run.
pub struct Report {
    pub rows: Vec<Row>,
    /// What our program says it is, and the Python one.
    pub ours: String,
    pub theirs: String,
    pub machine: String,
    pub pinned: bool,
}

/// A way to read "MuJoCo's best".
struct Reading<'a> {
    what: &'static str,
    row: &'a Row,
}

impl Report {
    /// MuJoCo's C library at its best, by every reading of best.
    fn readings(&self) -> Vec<Reading<'_>> {
        use Part::{NoFriction, Stages, Whole};
        let fastest: fn(&Row) -> f64 = |row| row.ns[1];
        // Shares are compared on the whole grid only, but for the last word.
        let exact: fn(&Row) -> f64 = |row| {
            if row.engine.every == 1 {
                row.error()
            } else {
                f64::INFINITY
            }
        };
        let on_its_cells: fn(&Row) -> f64 = Row::error;
        let least = |parts: &[Part], key: fn(&Row) -> f64| {
            let rows = self
                .rows
                .iter()
                .filter(|row| row.engine.program == Program::C && parts.contains(&row.engine.part));
            rows.min_by(|a, b| {
                let time = a.ns[1].total_cmp(&b.ns[1]);
                key(a).total_cmp(&key(b)).then(time)
            })
        };
        let readings = [
            ("`mj_step` alone, fastest", &[Whole][..], fastest),
            (
                "`mj_step` alone, fewest wrong on the whole grid",
                &[Whole],
                exact,
            ),
            (
                "stages or positions of the caller's, fastest",
                &[Stages],
                fastest,
            ),
            (
                "stages or positions of the caller's, fewest wrong on the whole grid",
                &[Stages],
                exact,
            ),
            (
                "any with MuJoCo's friction, fewest wrong on the cells that it ran",
                &[Whole, Stages],
                on_its_cells,
            ),
            ("without MuJoCo's friction, fastest", &[NoFriction], fastest),
        ];
        let found = readings
            .into_iter()
            .filter_map(|(what, parts, key)| Some((what, least(parts, key)?)));
        found.map(|(what, row)| Reading { what, row }).collect()
    }

    /// The table and the readings.
    pub fn text(&self) -> String {
        format!("{}\n{}", self.table(), self.conclusion())
    }

    fn table(&self) -> String {
        let mut table = String::from(
            "| engine | steps a sample | ns a sample | quartiles | × vector | × scalar | wrong cells | of | % | resting, let diverge |\n\
             |---|---|---|---|---|---|---|---|---|---|\n",
        );
        for row in &self.rows {
            let [low, median, high] = row.ns.map(figure);
            let [vector, scalar] = row.ratios.map(figure);
            let engine = match row.engine.program {
                Program::Ours => format!("**{}**", row.engine.name),
                Program::C => format!("MuJoCo, {}", row.engine.name),
                Program::Python => row.engine.name.to_owned(),
            };
            // Writing to a String cannot fail.
            let _ = writeln!(
                table,
                "| {engine} | {} | {median} | {low} – {high} | {vector} | {scalar} | {} | {} | {:.1} | {} of {} |",
                row.steps(),
                row.wrong,
                row.cells,
                100.0 * row.error(),
                row.let_diverge,
                row.resting
            );
        }
        table
    }

    fn conclusion(&self) -> String {
        let mut text = format!(
            "| MuJoCo's C library at its best, read as | setting | steps a sample | % wrong | × vector | × scalar | {}× |\n\
             |---|---|---|---|---|---|---|\n",
            figure(TARGET)
        );
        for Reading { what, row } in self.readings() {
            let [vector, scalar] = row.ratios;
            let reached = if vector >= TARGET { "yes" } else { "**no**" };
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "| {what} | {} | {} | {:.1} of {} cells | {} | {} | {reached} |",
                row.engine.name,
                row.steps(),
                100.0 * row.error(),
                row.cells,
                figure(vector),
                figure(scalar)
            );
        }
        text
    }

    /// For how many readings of best the aim is reached.
    fn verdict(&self) -> String {
        let readings = self.readings();
        let reached = readings.iter().filter(|r| r.row.ratios[0] >= TARGET);
        let ratios = readings.iter().map(|r| r.row.ratios[0]);
        let least = ratios.fold(f64::INFINITY, f64::min);
        format!(
            "the vector kernel takes {} times less per sample than MuJoCo by {} of {} readings of best, and at least {} times less by all",
            figure(TARGET),
            reached.count(),
            readings.len(),
            figure(least)
        )
    }

    fn page(&self) -> String {
        let Self {
            ours,
            theirs,
            machine,
            pinned,
            ..
        } = self;
        let on = if *pinned {
            "one core, all engines pinned to the same"
        } else {
            "one thread, not pinned"
        };
        let whole_grid = self
            .rows
            .iter()
            .filter(|row| row.engine.program != Program::Ours && row.engine.every == 1);
        let least = whole_grid.map(Row::error).fold(1.0, f64::min);
        format!(
            "\
# Other engines beside the exact map

Written by `cargo xtask peers`; do not edit. The figures are also in [peers.csv](peers.csv).

**What.** The dimensionless display (6), μ ξ̈ + β ξ̇ + σ sgn ξ̇ = φ with φ = −(⌊ξ⌋ + ½) held for a sample, at μ = {MU}, ξ(0) = 0, ξ̇(0) = {V0} counts
per sample, over {SAMPLES} samples: the centres of {GRID} × {GRID} cells of β and σ from 0 to 1. Each engine says of each cell, by the window rule of
`plant_sim::outcome`, whether it rests, cycles or grows. A cell is *wrong* if the scalar exact map says otherwise. Slow engines run every 2nd,
4th or 8th cell along both sides (column *of*: 400, 100 or 25 cells), so that their shares are coarse.

**On what.** {machine}; {on}. Ours: {ours}. Theirs: {theirs}; the C library is the one in MuJoCo's wheel, called by `xtask/peers/peer.c`.

**How.** {ROUNDS} rounds, in each every engine once, one after the other; processor time over samples really simulated, none after rest or divergence; set-up is not
timed. Median and quartiles over the rounds; a ratio is the median of the rounds' ratios. The foreign engines run each cell once, a share of the cells a
round; ours run all cells in every round, the vector kernel all side by side, on one core like the rest.

{}
{}
*× vector, × scalar*: the time per sample over that of the exact map. What to conclude: {}; of the engines that ran the whole grid the best has {:.1} % of
its cells wrong, the vector kernel {}.

**The settings.** *Lean*: everything off that this model has no use for (contacts, limits, equality, springs, gravity, actuation, sensors, islands, warm
start, auto-reset). *PGS* in place of Newton, the fastest solver for one constraint. *Hard*: MuJoCo's friction is a soft constraint, which creeps; impedance
0.9999 and a velocity damped within a step, or half a step with RK4, is as hard as it bears. *Explicit damping*: Euler's method with β taken explicitly (`eulerdamp` off).
*Stages*: not `mj_step` but `mj_forwardSkip` and the integrator's function, so that all that depends on position is computed once a run; right here only because nothing does.
*Trapezoid*: the caller sets the position from the mean of the velocities before and after, as semi-implicit Euler with one step a sample takes away the
very instability under study. *Friction by hand*: the caller adds −σ sgn ξ̇ to the force and MuJoCo's constraints are off; what is left of MuJoCo is a sum.

**Measured** is all in the table. **Believed**: that no setting of MuJoCo is much better than these. Its options were searched by hand, on fewer cells; another
machine shifts the ratios. MuJoCo is built for bodies with contacts, not for one mass; a sample costs it the same passes over a model either way.
",
            self.table(),
            self.conclusion(),
            self.verdict(),
            100.0 * least,
            self.rows[VECTOR].wrong
        )
    }

    fn csv(&self) -> String {
        let mut csv = String::from(
            "program,setting,steps_per_sample,ns_per_sample_q1,ns_per_sample_median,ns_per_sample_q3,\
             ratio_to_vector,ratio_to_scalar,cells,wrong,resting,resting_let_diverge\n",
        );
        for row in &self.rows {
            let program = match row.engine.program {
                Program::Ours => "plant-sim",
                Program::C => "mujoco-c",
                Program::Python => "python",
            };
            let [low, median, high] = row.ns;
            let [vector, scalar] = row.ratios;
            let _ = writeln!(
                csv,
                "{program},\"{}\",{},{low:.4},{median:.4},{high:.4},{vector:.4},{scalar:.4},{},{},{},{}",
                row.engine.setting,
                row.engine.steps,
                row.cells,
                row.wrong,
                row.resting,
                row.let_diverge
            );
        }
        csv
    }

    /// Writes docs/peers.md and docs/peers.csv.
    pub fn write(&self) -> Result<()> {
        fs::write(root().join("docs/peers.md"), self.page())?;
        fs::write(root().join("docs/peers.csv"), self.csv())?;
        eprintln!("xtask: wrote docs/peers.md and docs/peers.csv");
        Ok(())
    }
}

/// Three digits, or all before the point.
fn figure(value: f64) -> String {
    let decimals = match value {
        v if v >= 100.0 => 0,
        v if v >= 10.0 => 1,
        _ => 2,
    };
    let digits = format!("{value:.decimals$}");
    let whole = digits.find('.').unwrap_or(digits.len());
    // Commas between thousands.
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if 0 < i && i < whole && (whole - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::ENGINES;
    use super::*;
    use Class::{LimitCycle, Rest, Unstable};

    fn rounds(ns: &[f64]) -> Vec<Sample> {
        let sample = |ns: &f64| Sample {
            seconds: ns * 1e-6,
            samples: 1_000,
        };
        ns.iter().map(sample).collect()
    }

    #[test]
    fn quartiles_of_known_values() {
        assert_eq!(quartiles(vec![5.0, 1.0, 3.0, 2.0, 4.0]), [2.0, 3.0, 4.0]);
        assert_eq!(quartiles(vec![1.0, 2.0]), [1.25, 1.5, 1.75]);
        assert_eq!(quartiles(vec![7.0]), [7.0; 3]);
    }

    #[test]
    fn figures_have_three_digits_and_commas() {
        let have = [0.7, 9.876, 12.34, 999.4, 1_234.5, 1_234_567.0].map(figure);
        assert_eq!(have, ["0.70", "9.88", "12.3", "999", "1,234", "1,234,567"]);
    }

    #[test]
    fn a_row_counts_only_cells_that_were_run() {
        let have = [
            Some(Rest),
            Some(Unstable),
            None,
            Some(LimitCycle),
            Some(Unstable),
        ];
        let want = [Rest, Rest, Rest, Rest, Unstable].map(Some);
        let ours = rounds(&[1.0, 2.0, 4.0]);
        let row = Row::new(
            ENGINES[2],
            &rounds(&[10.0, 40.0, 40.0]),
            [&ours, &ours],
            &have,
            &want,
        );
        assert_eq!((row.cells, row.wrong), (4, 2));
        assert_eq!((row.resting, row.let_diverge), (3, 1));
        assert!((row.error() - 0.5).abs() < 1e-12);
        assert!((row.ns[1] - 40.0).abs() < 1e-9);
        // The median of 10, 20, 10, not the ratio of the medians.
        assert!((row.ratios[0] - 10.0).abs() < 1e-9);
    }

    /// A report in which engine i takes 2ⁱ ns and errs in one of four cells, but for ours.
    fn report() -> Report {
        let truth = [Rest, LimitCycle, Unstable, Rest].map(Some);
        let mut wrong = truth;
        wrong[3] = Some(Unstable);
        let ours = rounds(&[1.0; ROUNDS]);
        let rows = ENGINES.iter().enumerate().map(|(i, engine)| {
            let classes = match engine.program {
                Program::Ours => &truth,
                _ => &wrong,
            };
            let own = rounds(&[2.0_f64.powi(i as i32); ROUNDS]);
            Row::new(*engine, &own, [&ours, &ours], classes, &truth)
        });
        Report {
            rows: rows.collect(),
            ours: "ours 1".to_owned(),
            theirs: "theirs 2".to_owned(),
            machine: "a machine".to_owned(),
            pinned: true,
        }
    }

    #[test]
    fn the_readings_take_the_least_and_say_whether_the_aim_is_reached() {
        let report = report();
        let readings = report.readings();
        assert_eq!(readings.len(), 6);
        // The first of each part is the fastest.
        let first = |part| {
            let found = ENGINES
                .iter()
                .position(|e| e.program == Program::C && e.part == part);
            2.0_f64.powi(found.unwrap() as i32)
        };
        let [step, stages, none] = [Part::Whole, Part::Stages, Part::NoFriction].map(first);
        let ratios: Vec<f64> = readings.iter().map(|r| r.row.ratios[0].round()).collect();
        assert_eq!(ratios, [step, step, stages, stages, step, none]);
        let text = report.conclusion();
        assert_eq!(text.matches("| **no** |").count(), 3, "{text}");
        assert_eq!(text.matches("| yes |").count(), 3, "{text}");
    }

    #[test]
    fn page_and_table_and_csv_hold_every_engine() {
        let report = report();
        let page = report.page();
        for row in &report.rows {
            assert!(page.contains(row.engine.name), "{}", row.engine.name);
        }
        for told in [
            "ours 1",
            "theirs 2",
            "a machine",
            "pinned to the same",
            "μ = 50",
            "25.0 %",
        ] {
            assert!(page.contains(told), "{told}");
        }
        let csv = report.csv();
        assert_eq!(csv.lines().count(), report.rows.len() + 1);
        let header = csv.lines().next().unwrap_or("");
        assert_eq!(header.split(',').count(), 12);
        assert!(csv.contains("python,\"scipy\",0,"));
        let columns = report
            .table()
            .lines()
            .map(|l| l.matches('|').count())
            .collect::<Vec<_>>();
        assert!(columns.iter().all(|n| *n == 11), "{columns:?}");
    }
}
