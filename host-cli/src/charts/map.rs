//! The classes of a swept plane, one panel per initial velocity.

use anyhow::Result;
use plant_sim::map::Span;
use plant_sim::outcome::Class;
use plotters::prelude::*;

use super::plane::Plane;
use super::style::{Area, BLUE, GREY, LABEL, RED, SKY, SMALL, letters, line_sample, page, trouble};
use crate::commands::map::Swept;
use crate::stop;

/// Width and height of a panel, pixels.
const PANEL: (u32, u32) = (520, 500);

fn colour(class: Class) -> RGBAColor {
    match class {
        Class::Rest => WHITE.to_rgba(),
        Class::LimitCycle => SKY.mix(0.75),
        Class::Unstable => RED.mix(0.85),
        Class::Undecided => GREY.mix(0.5),
    }
}

/// All panels with both lines and the four regions.
pub fn panels(swept: &Swept) -> Result<String> {
    let count = swept.v0.len();
    let columns = (count as f64).sqrt().ceil() as usize;
    let rows = count.div_ceil(columns);
    let width = (PANEL.0 * columns as u32).max(780);
    let size = (width, PANEL.1 * rows as u32 + 74);
    page(size, |page| {
        let (charts, legend) = page.split_vertically(size.1 - 74);
        let cells = rectangles(swept, |classes, _| Some(colour(swept.rule.of(classes))))?;
        let areas = charts.split_evenly((rows, columns));
        for (panel, (area, cells)) in areas.iter().zip(cells).enumerate() {
            draw_panel(swept, panel, area, cells)?;
        }
        draw_legend(swept, &legend)
    })
}

fn draw_panel(swept: &Swept, panel: usize, area: &Area<'_>, cells: Vec<Filled>) -> Result<()> {
    let map = &swept.map;
    let (mu, v0) = (map.point(0).0.mu, map.v0()[panel]);
    let title = format!("μ = {mu}, from {} counts per sample", swept.v0[panel]);
    let range = |span: Span| span.from()..span.to();
    let mut plane = Plane::new(area, &title, range(map.beta()), range(map.sigma()))?;
    plane.fill(cells)?;
    plane.borders()?;
    plane.region_letters(BLACK)?;
    plane.critical_line(v0, BLACK)?;
    if v0 != 0.0 {
        plane.describing_function_line(v0, BLUE)?;
    }
    Ok(())
}

/// A filled rectangle: two corners and a colour.
pub type Filled = ([(f64, f64); 2], RGBAColor);

/// The cells of every panel as rectangles, runs of one colour joined along σ. `paint` gives
/// the colour of a cell's classes in a panel, None to leave it white. An error where the user
/// asks to stop.
pub fn rectangles(
    swept: &Swept,
    paint: impl Fn(plant_sim::outcome::Classes, usize) -> Option<RGBAColor>,
) -> Result<Vec<Vec<Filled>>> {
    let map = &swept.map;
    let grid = map.grid();
    let edge = |span: Span, index: usize| {
        span.from() + (span.to() - span.from()) * (index as f64 / grid as f64)
    };
    let mut panels = vec![Vec::new(); map.v0().len()];
    for (row, classes) in swept.classes.chunks(grid).enumerate() {
        stop::check()?;
        let (panel, i, _) = map.place(row * grid);
        let mut from = 0;
        for run in classes.chunk_by(|a, b| paint(*a, panel) == paint(*b, panel)) {
            let to = from + run.len();
            if let Some(colour) = paint(run[0], panel).filter(|colour| *colour != WHITE.to_rgba()) {
                let low = (edge(map.beta(), i), edge(map.sigma(), from));
                let high = (edge(map.beta(), i + 1), edge(map.sigma(), to));
                panels[panel].push(([low, high], colour));
            }
            from = to;
        }
    }
    Ok(panels)
}

fn draw_legend(swept: &Swept, area: &Area<'_>) -> Result<()> {
    let rule = match swept.rule {
        crate::commands::map::Rule::Window => "window rule",
        crate::commands::map::Rule::Paper => "the paper's rule",
    };
    let (mut x, y) = (24, 12);
    for (class, text) in [
        (Class::Rest, "rests, or slower than 0.01 counts per sample"),
        (Class::LimitCycle, "limit cycle"),
        (Class::Unstable, "unstable"),
        (Class::Undecided, "undecided"),
    ] {
        if class == Class::Undecided && !swept.classes.iter().any(|c| swept.rule.of(*c) == class) {
            continue;
        }
        let corners = [(x, y), (x + 20, y + 16)];
        area.draw(&Rectangle::new(corners, colour(class).filled()))
            .map_err(trouble)?;
        area.draw(&Rectangle::new(corners, GREY.stroke_width(1)))
            .map_err(trouble)?;
        area.draw_text(text, &letters(LABEL, BLACK), (x + 28, y))
            .map_err(trouble)?;
        x += 46 + 7 * text.len() as i32;
    }
    let y = 44;
    let mut x = 24;
    for (dashed, colour, text) in [
        (true, BLACK, "critical line (9)"),
        (false, BLUE, "describing function"),
    ] {
        line_sample(area, (x, y + 8), colour, dashed)?;
        area.draw_text(text, &letters(LABEL, BLACK), (x + 45, y))
            .map_err(trouble)?;
        x += 62 + 7 * text.len() as i32;
    }
    let text = format!("({rule}, {} samples)", swept.map.samples());
    area.draw_text(&text, &letters(SMALL, GREY), (x, y + 1))
        .map_err(trouble)?;
    Ok(())
}
