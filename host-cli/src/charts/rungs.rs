//! What each phenomenon of the plant costs, and what it changes.

use anyhow::Result;
use plant_sim::compare::{Rung, Spread};
use plotters::prelude::*;

use super::loglog::{Curve, Look, Mark, Panel, draw, point, sentences, sentences_height, wrapped};
use super::style::{BLUE, GREEN, LABEL, RED, letters, page, trouble};
use crate::commands::chart::Figures;
use crate::commands::chart::rungs::{Ladder, conclusion, label, notes};

const PLOT_HEIGHT: u32 = 470;
const LEGEND_HEIGHT: u32 = 34;
const WIDTH: u32 = 1300;

/// Letters that fit in a line.
const LINE: usize = 182;

const LADDER: Look = Look {
    colour: BLUE,
    dashed: false,
    radius: 5,
    hollow: false,
};

const AUTO: Look = Look {
    colour: RED,
    radius: 7,
    ..LADDER
};

const BOUND: Look = Look {
    colour: GREEN,
    radius: 5,
    hollow: true,
    ..LADDER
};

/// The picture.
pub fn picture(figures: &Figures) -> Result<String> {
    let ladders = &figures.ladders;
    let lines = wrapped(&conclusion(ladders), LINE);
    let notes = wrapped(&notes(ladders, figures.rounds), LINE * 15 / 13);
    let text_height = sentences_height(&lines, &notes);
    page((WIDTH, PLOT_HEIGHT + LEGEND_HEIGHT + text_height), |page| {
        let (plots, rest) = page.split_vertically(PLOT_HEIGHT);
        let (legend, text) = rest.split_vertically(LEGEND_HEIGHT);
        for (area, ladder) in plots.split_evenly((1, 2)).iter().zip(ladders) {
            draw_ladder(area, ladder)?;
        }
        for (place, (look, words)) in [
            (
                LADDER,
                "phenomena added one after the other, from the plain plant up",
            ),
            (AUTO, "auto, with its tolerance, rad"),
            (BOUND, "what auto promised"),
        ]
        .into_iter()
        .enumerate()
        {
            let x = [60, 560, 860][place];
            point(&legend, (x, 12), look)?;
            legend
                .draw_text(words, &letters(LABEL, BLACK), (x + 16, 4))
                .map_err(trouble)?;
        }
        sentences(&text, &lines, &notes)
    })
}

fn draw_ladder(area: &super::style::Area<'_>, ladder: &Ladder) -> Result<()> {
    let values = ladder
        .rungs
        .iter()
        .flat_map(|rung| [rung.error_rad, rung.bound_rad]);
    let errors = || values.clone().filter(|error| *error > 0.0);
    let least = errors().fold(f64::INFINITY, f64::min).min(1.0);
    let most = errors().fold(0.0, f64::max).max(least);
    let zero = least / 30.0;
    let times = || ladder.rungs.iter().map(|rung| rung.tick_ns);
    let fastest = times().map(|time| time.low).fold(f64::INFINITY, f64::min);
    let slowest = times().map(|time| time.high).fold(0.0, f64::max);
    let mark = |rung: &Rung, y: f64, label: String| Mark {
        x: rung.tick_ns,
        y: y.max(zero),
        label,
    };
    let kept = ladder.kept().iter();
    let auto = ladder.auto().iter();
    // One at a time, so that they are not joined.
    let single = |look: Look, mark: Mark| Curve {
        look,
        marks: vec![mark],
    };
    let mut curves = vec![Curve {
        look: LADDER,
        marks: kept
            .map(|rung| mark(rung, rung.error_rad, label(rung)))
            .collect(),
    }];
    let (idle, busy): (Vec<&Rung>, Vec<&Rung>) = auto.partition(|rung| rung.left_out[0] == 0);
    for rung in busy {
        curves.push(single(BOUND, mark(rung, rung.bound_rad, String::new())));
        curves.push(single(AUTO, mark(rung, rung.error_rad, label(rung))));
    }
    // Those that leave nothing out are one point: the full plant, and what the attempts cost.
    if let (Some(first), Some(last)) = (idle.first(), idle.last()) {
        let times = || idle.iter().map(|rung| rung.tick_ns);
        let all = Spread {
            low: times().map(|time| time.low).fold(f64::INFINITY, f64::min),
            median: first.tick_ns.median,
            high: times().map(|time| time.high).fold(0.0, f64::max),
        };
        let words = match idle.len() {
            1 => label(first),
            _ => format!("{} … {}", label(first), label(last).replace("auto ", "")),
        };
        let mark = Mark {
            x: all,
            y: zero,
            label: words,
        };
        curves.push(single(AUTO, mark));
    }
    let panel = Panel {
        title: &format!("Phenomena {}", ladder.title),
        x_axis: "time per tick, controller and plant, ns",
        y_axis: "largest error of the angle, rad",
        x: fastest / 2.0..slowest * 2.0,
        y: zero / 3.0..most * 10.0,
        zero: Some((zero, "none")),
    };
    draw(area, &panel, &curves)
}
