//! Failures of a control that leaves an effect out, in physical units: the scene as it is, and with one
//! line mended.

use anyhow::{Result, bail};
use control::shape::Shape;
use plant_sim::closed_loop::{Report, Sample};
use plant_sim::outcome::Class;

use super::forms::{by_the_local_slope, following_the_speed, mended, run_choosing};
use super::{Evidence, Row, mend, says, truth};
use crate::charts::failure::{Axis, Figure, Mark, Series, Whose};
use crate::number::short;
use crate::scene::{self, Loaded};
use crate::stop;

/// A run and what is drawn of it.
struct Watched {
    report: Report,
    /// Time (s), angle (rad) and velocity (rad/s) at every sample.
    samples: Vec<[f64; 3]>,
}

/// Runs a scene by `run`, which takes what sees every sample.
fn watch_by(
    loaded: &Loaded,
    run: impl FnOnce(&mut dyn FnMut(&Sample) -> bool) -> Result<Report>,
) -> Result<Watched> {
    let mut samples = Vec::new();
    let report = run(&mut |sample| {
        let state = sample.state;
        samples.push([loaded.time_s(sample), state.position, state.velocity]);
        !stop::requested()
    })?;
    stop::check()?;
    Ok(Watched { report, samples })
}

fn watch(loaded: &Loaded) -> Result<Watched> {
    watch_by(loaded, |observe| loaded.run(observe))
}

fn outcome(report: &Report) -> String {
    let class = match report.class {
        Class::Rest => "comes to rest".to_owned(),
        Class::LimitCycle => "limit cycle".to_owned(),
        Class::Unstable => "grows without bound".to_owned(),
        Class::Undecided => format!("undecided after {} samples", report.samples),
    };
    let gain = report.energy_excess_j / report.energy_start_j;
    if gain > 1e-3 {
        format!(
            "{class}; gives out {} times the energy of the start",
            short(gain)
        )
    } else {
        format!("{class}; gives out no energy")
    }
}

/// A run of the naive control and one of the mended, with their names.
struct Pair {
    naive: (Watched, &'static str),
    mended: (Watched, &'static str),
}

impl Pair {
    /// Of a scene as it stands, and with one line mended.
    fn of_lines(
        text: &str,
        (line, by): (&str, &str),
        naive_name: &'static str,
        mended_name: &'static str,
    ) -> Result<Self> {
        Ok(Self {
            naive: (watch(&scene::parse(text)?)?, naive_name),
            mended: (watch(&mended(text, line, by)?)?, mended_name),
        })
    }

    /// Of a scene under a stiffness that no scene can ask for, and as it stands.
    fn of_choice(
        text: &str,
        stiffness: impl FnMut(i32, f64) -> f64,
        naive_name: &'static str,
        mended_name: &'static str,
    ) -> Result<Self> {
        let loaded = scene::parse(text)?;
        let naive = watch_by(&loaded, |observe| {
            run_choosing(&loaded.scene, stiffness, observe)
        })?;
        Ok(Self {
            naive: (naive, naive_name),
            mended: (watch(&loaded)?, mended_name),
        })
    }

    /// What the naive reckoning promised, and both runs.
    fn rows(&self, promise: Row) -> Vec<Row> {
        vec![
            promise,
            truth(self.naive.1, outcome(&self.naive.0.report)),
            mend(self.mended.1, outcome(&self.mended.0.report)),
        ]
    }

    /// Angle against time, up to `most_s`.
    fn angle(self, title: &str, most_s: f64) -> Figure {
        let milli = |[time_s, angle_rad, _]: [f64; 3]| (time_s * 1e3, angle_rad * 1e3);
        self.figure(title, most_s, Axis::linear("angle, mrad"), milli)
    }

    /// Speed against time.
    fn speed(self, title: &str, most_s: f64) -> Figure {
        let speed = |[time_s, _, velocity]: [f64; 3]| (time_s * 1e3, velocity.abs());
        self.figure(title, most_s, Axis::logarithmic("|velocity|, rad/s"), speed)
    }

    fn figure(
        self,
        title: &str,
        most_s: f64,
        y: Axis,
        point: impl Fn([f64; 3]) -> (f64, f64),
    ) -> Figure {
        let line = |(watched, name): (Watched, &str), whose| Series {
            name: name.into(),
            whose,
            mark: Mark::Line,
            points: watched
                .samples
                .into_iter()
                .filter(|sample| sample[0] <= most_s)
                .map(&point)
                .collect(),
        };
        Figure {
            title: title.into(),
            x: Axis::linear("time, ms"),
            y,
            series: vec![
                line(self.naive, Whose::Naive),
                line(self.mended, Whose::Truth),
            ],
        }
    }
}

/// A law that promises passivity for one that does not.
const AUTO: (&str, &str) = ("law = \"raw\"", "law = \"auto\"");

/// Here the naive form is the plant: it lacks the delay.
pub(crate) fn delay_left_out(text: &str) -> Result<Evidence> {
    let pair = Pair {
        naive: (
            watch(&mended(text, "delay_s = 0.5e-3", "delay_s = 0.0")?)?,
            "plant without the delay",
        ),
        mended: (watch(&scene::parse(text)?)?, "plant with its delay of T/2"),
    };
    let rows = vec![
        says(pair.naive.1, outcome(&pair.naive.0.report)),
        truth(pair.mended.1, outcome(&pair.mended.0.report)),
    ];
    let figure = pair.angle("K = 0.38 Nm/rad from 10 rad/s, RE35", 0.12);
    Ok(Evidence { rows, figure })
}

pub(crate) fn wall_off_edge(text: &str) -> Result<Evidence> {
    let on_edge = (
        "wall_rad = 3.074097498922825e-3",
        "wall_rad = 6.135923151542565e-3",
    );
    let pair = Pair::of_lines(
        text,
        on_edge,
        "wall at 0.501 counts",
        "wall at 1 count, on an edge",
    )?;
    let mut rows = pair.rows(says(
        "K ≤ 2c/Δ, a first step of ½ K Δ",
        "K is 0.97 of it: friction holds the step",
    ));
    let auto = watch(&mended(text, AUTO.0, AUTO.1)?)?;
    rows.push(mend(
        "wall at 0.501 counts, law auto",
        outcome(&auto.report),
    ));
    let figure = pair.angle(
        "A wall on and off a count edge, RE35, 1024 counts/rev, K = 0.632 Nm/rad",
        0.003,
    );
    Ok(Evidence { rows, figure })
}

pub(crate) fn dac_rounding(text: &str) -> Result<Evidence> {
    let pair = Pair::of_lines(
        text,
        AUTO,
        "raw, rounded to the nearest step",
        "auto, cut towards zero",
    )?;
    let rows = pair.rows(says(
        "K ≤ 2c/Δ, without the steps",
        "4 of 5.2 Nm/rad: friction holds ½ K Δ",
    ));
    let figure = pair.angle("Torque in steps of 2.2 mNm, RE35, K = 4 Nm/rad", 0.1);
    Ok(Evidence { rows, figure })
}

pub(crate) fn start_deflected(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let criterion = loaded.criterion()?;
    let margin = |speed| short(criterion.power_margin_nm(1.0, speed));
    let reached = loaded.scene.reachable_speed_rad_s(1.0);
    let pair = Pair::of_lines(text, AUTO, "raw, K = 1 Nm/rad", "auto, demand 1 Nm/rad")?;
    let mut rows = pair.rows(says(
        "(11) at the initial speed 0",
        format!("passive, margin {} Nm", margin(0.0)),
    ));
    rows.push(mend(
        format!("(11) at the {} rad/s that it can reach", short(reached)),
        format!("not passive, margin {} Nm", margin(reached)),
    ));
    let figure = pair.angle("Let go at rest from 20 mrad, RE35", 0.08);
    Ok(Evidence { rows, figure })
}

pub(crate) fn region_c(text: &str) -> Result<Evidence> {
    let margin = scene::parse(text)?
        .criterion()?
        .power_margin_nm(0.015, 300.0);
    let pair = Pair::of_lines(
        text,
        AUTO,
        "raw, K = 0.015 Nm/rad",
        "auto, demand 0.015 Nm/rad",
    )?;
    let rows = pair.rows(says(
        "(11) at 300 rad/s",
        format!("passive, margin {} Nm", short(margin)),
    ));
    let figure = pair.speed("Region (c) from 300 rad/s, RE35, 20 counts/rev", 2.0);
    Ok(Evidence { rows, figure })
}

pub(crate) fn friction_believed(text: &str) -> Result<Evidence> {
    let pair = Pair::of_lines(
        text,
        ("stiffness_nm_rad = 0.776", "stiffness_nm_rad = 0.388"),
        "K for twice the friction, 0.776",
        "K for the friction that is, 0.388",
    )?;
    let rows = pair.rows(says(
        "(11) with twice the friction",
        "passive at 10 rad/s up to 0.776 Nm/rad",
    ));
    let figure = pair.angle(
        "What (11) allows at 10 rad/s, by the friction believed",
        0.1,
    );
    Ok(Evidence { rows, figure })
}

pub(crate) fn missed_ticks(text: &str) -> Result<Evidence> {
    let pair = Pair::of_lines(
        text,
        ("stiffness_nm_rad = 0.388", "stiffness_nm_rad = 0.201"),
        "K for the period T, 0.388",
        "K for 2T, 0.201",
    )?;
    let rows = pair.rows(says(
        "(11) with the period T",
        "passive at 10 rad/s up to 0.388 Nm/rad",
    ));
    let figure = pair.angle("Half of the ticks after a tick missed, from 10 rad/s", 0.1);
    Ok(Evidence { rows, figure })
}

pub(crate) fn delay_untold(text: &str) -> Result<Evidence> {
    let pair = Pair::of_lines(
        text,
        ("delay_s = 0.0", "delay_s = 0.5e-3"),
        "ledger, believes in no delay",
        "ledger, told of T/2",
    )?;
    let rows = pair.rows(says(
        "the ledger, told of no delay",
        "every torque is paid for",
    ));
    let figure = pair.angle("Half a period of delay under the energy ledger, RE35", 0.02);
    Ok(Evidence { rows, figure })
}

pub(crate) fn detent_slope(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let config = &loaded.scene.config;
    let Shape::Detent { period_rad, .. } = config.shape else {
        bail!("the scene has no detent");
    };
    let pair = Pair::of_choice(
        text,
        by_the_local_slope(loaded.criterion()?, period_rad, config.stiffness_nm_rad),
        "K by the slope where the knob is",
        "auto, by the steepest slope",
    )?;
    let rows = pair.rows(says(
        "min(2b/T, 2c/Δ) over the local slope",
        "passive in every tick",
    ));
    let figure = pair.angle(
        "A detent of 10 Nm/rad demanded, 20 per revolution, RE35",
        0.05,
    );
    Ok(Evidence { rows, figure })
}

pub(crate) fn clamp_both_ways(text: &str) -> Result<Evidence> {
    let loaded = scene::parse(text)?;
    let demand = loaded.scene.config.stiffness_nm_rad;
    let pair = Pair::of_choice(
        text,
        following_the_speed(loaded.criterion()?, demand),
        "K by the speed of each tick",
        "episode, K only falls",
    )?;
    let rows = pair.rows(says(
        "(11) at the speed of each tick",
        "passive in every tick",
    ));
    let figure = pair.angle(
        "A clamp that follows the speed, demand 0.5 Nm/rad, RE35",
        0.3,
    );
    Ok(Evidence { rows, figure })
}
