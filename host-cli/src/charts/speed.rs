//! Error against time per simulated sample, for every method.

use anyhow::Result;
use plant_sim::compare::{AFTER, Spread};
use plotters::prelude::*;

use super::loglog::{Curve, Look, Mark, Panel, draw, point, sentences, sentences_height, wrapped};
use super::style::{
    Area, BLUE, GREEN, GREY, LABEL, ORANGE, PURPLE, RED, SKY, letters, line_sample, page, trouble,
};
use crate::commands::chart::report::{conclusions, methods_notes};
use crate::commands::chart::{Family, Figures, Measured};

/// Width and height of a panel, pixels.
const PANEL: (u32, u32) = (520, 400);

const WIDTH: u32 = 3 * PANEL.0;
const LEGEND_HEIGHT: u32 = 92;

/// Letters that fit in a line.
const LINE: usize = 222;

const X_AXIS: &str = "time per simulated sample, ns";

fn look(family: Family) -> Look {
    let (colour, dashed, radius) = match family {
        Family::Vector => (RED, false, 9),
        Family::Exact => (RED, false, 7),
        Family::ClosedForm => (GREY, false, 5),
        Family::Euler => (ORANGE, false, 4),
        Family::Midpoint => (BLUE, false, 4),
        Family::Rk4 => (GREEN, false, 4),
        Family::Rk4Tanh => (PURPLE, true, 4),
        Family::Dopri5 => (SKY, false, 6),
    };
    Look {
        colour,
        dashed,
        radius,
        hollow: family == Family::Exact,
    }
}

/// What is written at a point.
fn label(method: &Measured) -> String {
    match method.family {
        Family::Vector => "exact, sweep".into(),
        Family::Exact => "exact".into(),
        Family::ClosedForm => "textbook".into(),
        _ => method.setting.into(),
    }
}

/// The picture.
pub fn picture(figures: &Figures) -> Result<String> {
    let mut lines = Vec::new();
    for sentence in conclusions(figures) {
        lines.extend(wrapped(&sentence, LINE));
    }
    let notes = wrapped(&methods_notes(figures), LINE * 15 / 13);
    let text_height = sentences_height(&lines, &notes);
    let plots_height = 2 * PANEL.1;
    page(
        (WIDTH, plots_height + LEGEND_HEIGHT + text_height),
        |page| {
            let (plots, rest) = page.split_vertically(plots_height);
            let (legend, text) = rest.split_vertically(LEGEND_HEIGHT);
            let areas = plots.split_evenly((2, 3));
            let (positions, others) = areas.split_at(AFTER.len());
            for (place, area) in positions.iter().enumerate() {
                draw_position(area, figures, place)?;
            }
            if let [energy, classes] = others {
                draw_energy(energy, figures)?;
                draw_classes(classes, figures)?;
            }
            draw_legend(&legend)?;
            sentences(&text, &lines, &notes)
        },
    )
}

/// The curves of a measure, with what is 0 at `zero` and what is lost left out.
fn curves(figures: &Figures, zero: f64, measure: impl Fn(&Measured) -> f64) -> Vec<Curve> {
    // The exact map last, on top.
    let families = Family::ALL.into_iter().rev();
    let curve = |family| {
        let marks = figures.family(family).map(|method| Mark {
            x: method.times.all,
            y: measure(method).max(zero),
            label: label(method),
        });
        Curve {
            look: look(family),
            marks: marks.filter(|mark| mark.y.is_finite()).collect(),
        }
    };
    families.map(curve).collect()
}

/// Room for labels on both sides.
fn x_range(figures: &Figures) -> std::ops::Range<f64> {
    let times = || figures.methods.iter().map(|method| method.times.all);
    let least = times().map(|time| time.low).fold(f64::INFINITY, f64::min);
    let most = times().map(|time| time.high).fold(0.0, f64::max);
    least / 4.0..most * 3.0
}

/// The finite values above zero, with room for labels, and for zero below.
fn y_range(values: impl Iterator<Item = f64> + Clone) -> std::ops::Range<f64> {
    let finite = values.filter(|value| value.is_finite() && *value > 0.0);
    let least = finite.clone().fold(f64::INFINITY, f64::min);
    let most = finite.fold(0.0, f64::max);
    least / 20.0..most * 20.0
}

fn draw_position(area: &Area<'_>, figures: &Figures, place: usize) -> Result<()> {
    let after = AFTER[place];
    // The same axis in all four.
    let all = figures.methods.iter();
    let y = y_range(all.flat_map(|method| method.position.iter().map(|it| it.median)));
    let zero = 2.0 * y.start;
    let mut curves = curves(figures, zero, |method| method.position[place].median);
    if after == AFTER[AFTER.len() - 1] {
        let textbook = figures.family(Family::ClosedForm).next();
        let small = figures.small_rates.iter();
        for it in small.filter(|it| it.family == Family::ClosedForm) {
            let Some(time) = textbook.map(|own| own.times.all) else {
                continue;
            };
            let mark = Mark {
                x: Spread {
                    low: time.median,
                    high: time.median,
                    ..time
                },
                y: it.position.median.clamp(zero, y.end / 4.0),
                label: format!("β/μ = {:e}", it.beta_over_mu),
            };
            let look = Look {
                hollow: true,
                ..look(Family::ClosedForm)
            };
            curves.push(Curve {
                look,
                marks: vec![mark],
            });
        }
    }
    let title = match after {
        1 => "Position after 1 sample".into(),
        _ => format!("Position after {after} samples"),
    };
    let panel = Panel {
        title: &title,
        x_axis: X_AXIS,
        y_axis: "error, counts",
        x: x_range(figures),
        y,
        zero: Some((zero, "none")),
    };
    draw(area, &panel, &curves)
}

fn draw_energy(area: &Area<'_>, figures: &Figures) -> Result<()> {
    let y = y_range(figures.methods.iter().map(|method| method.added.median));
    let zero = 2.0 * y.start;
    let panel = Panel {
        title: "Energy added or taken by the method itself",
        x_axis: X_AXIS,
        y_axis: "per sample, KΔ²",
        x: x_range(figures),
        y,
        zero: Some((zero, "none")),
    };
    draw(
        area,
        &panel,
        &curves(figures, zero, |method| method.added.median),
    )
}

fn draw_classes(area: &Area<'_>, figures: &Figures) -> Result<()> {
    // One cell is the least that can be wrong.
    let cell = 100.0 / figures.cells() as f64;
    let zero = cell / 4.0;
    let title = format!("Wrong classes of a {g} × {g} map", g = figures.grid);
    let panel = Panel {
        title: &title,
        x_axis: X_AXIS,
        y_axis: "wrong, % of the points",
        x: x_range(figures),
        y: zero / 2.5..300.0,
        zero: Some((zero, "none wrong")),
    };
    draw(
        area,
        &panel,
        &curves(figures, zero, |method| 100.0 * method.class_error),
    )
}

fn draw_legend(area: &Area<'_>) -> Result<()> {
    let entries = Family::ALL.map(|family| (look(family), family.title()));
    let small = Look {
        hollow: true,
        ..look(Family::ClosedForm)
    };
    let small = (
        small,
        "textbook closed form with hardly any viscous friction",
    );
    for (number, (look, title)) in entries.into_iter().chain([small]).enumerate() {
        let (column, row) = (number as i32 / 3, number as i32 % 3);
        let (x, y) = (60 + 500 * column, 6 + 26 * row);
        if look.radius == 4 {
            line_sample(area, (x, y + 8), look.colour, look.dashed)?;
        }
        point(area, (x + 18, y + 8), look)?;
        area.draw_text(title, &letters(LABEL, BLACK), (x + 47, y))
            .map_err(trouble)?;
    }
    Ok(())
}
