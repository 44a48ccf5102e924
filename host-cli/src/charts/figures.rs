//! The paper's Figs. 3, 4 and 5 as pictures.

use anyhow::Result;
use plant_sim::outcome::{Class, Classes};
use plotters::prelude::*;

use super::map::{Filled, rectangles};
use super::plane::Plane;
use super::style::{
    Area, BLUE, GREEN, GREY, LABEL, PURPLE, RED, SMALL, TITLE, letters, line_sample, page, trouble,
};
use crate::commands::map::{Rule, Swept};

/// Fig. 3: the four regions, and the critical line turning with the speed.
pub fn regions() -> Result<String> {
    page((760, 700), |page| {
        let mut plane = Plane::new(
            page,
            "Fig. 3  Stability regions of the (β, σ) plane",
            0.0..1.0,
            0.0..1.0,
        )?;
        plane.regions()?;
        plane.borders()?;
        for (speed, at) in [
            (0.25, (0.02, 0.65)),
            (1.0, (0.02, 1.0)),
            (4.0, (0.385, 1.0)),
        ] {
            plane.critical_line(speed, PURPLE)?;
            plane.write(at, (4, 6), &format!("|ξ̇| = {speed}"), LABEL, PURPLE)?;
        }
        for (at, lines) in [
            ((0.68, 0.9), ["(a) globally passive", "whatever the start"]),
            ((0.1, 0.25), ["(b) unstable", "friction never suffices"]),
            ((0.65, 0.14), ["(c) limit cycles", "of about one count"]),
            ((0.14, 0.96), ["(d) locally passive", "while slow enough"]),
        ] {
            plane.write(at, (0, 0), lines[0], TITLE, BLACK)?;
            plane.write(at, (0, 24), lines[1], LABEL, GREY)?;
        }
        for (row, text) in [
            "all critical lines (9) turn about (½, ½)",
            "with slope −|ξ̇|; passive on their right",
        ]
        .into_iter()
        .enumerate()
        {
            plane.write((0.53, 0.6), (0, 20 * row as i32), text, LABEL, PURPLE)?;
        }
        Ok(())
    })
}

/// Fig. 4: what stiffness, sample period and count size do to the characteristic point.
pub fn arrows() -> Result<String> {
    page((760, 700), |page| {
        let title = "Fig. 4  Effect of stiffness K, sample period T and count Δ";
        let mut plane = Plane::new(page, title, 0.0..1.0, 0.0..1.0)?;
        plane.regions()?;
        plane.borders()?;
        // Twice the stiffness, half the period, a third of the count.
        let (p1, p2, p3, p4) = ((0.7, 0.48), (0.35, 0.24), (0.7, 0.24), (0.7, 0.72));
        plane.line((0.0, 0.0), p1, GREY.stroke_width(1))?;
        for (from, to, colour) in [(p1, p2, RED), (p2, p3, BLUE), (p3, p4, GREEN)] {
            plane.arrow(from, to, colour)?;
        }
        for (at, name, shift) in [
            (p1, "P₁", (10, -20)),
            (p2, "P₂", (-28, -6)),
            (p3, "P₃", (10, 4)),
            (p4, "P₄", (10, -18)),
        ] {
            plane.dot(at, BLACK)?;
            plane.write(at, shift, name, TITLE, BLACK)?;
        }
        plane.write((0.3, 0.42), (0, 0), "K × 2: towards the origin", LABEL, RED)?;
        plane.write((0.41, 0.21), (0, 0), "T ÷ 2: to the right", LABEL, BLUE)?;
        plane.write((0.72, 0.6), (0, 0), "Δ ÷ 3: up", LABEL, GREEN)
    })
}

/// Fig. 5(a): the unstable cells of each initial velocity, one shade each, with the
/// critical and the describing-function lines.
pub fn unstable(swept: &Swept) -> Result<String> {
    page((900, 760), |page| {
        let (chart, legend) = page.split_vertically(676);
        let title = format!(
            "Fig. 5(a)  Unstable displays, μ = {}",
            swept.map.point(0).0.mu
        );
        let mut plane = Plane::new(&chart, &title, 0.0..1.0, 0.0..1.0)?;
        let shades = overlay(swept, |classes| Rule::Window.of(classes) == Class::Unstable)?;
        plane.fill(shades)?;
        plane.borders()?;
        plane.critical_lines(swept.map.v0(), RED)?;
        for v0 in swept.map.v0() {
            plane.describing_function_line(*v0, BLUE)?;
        }
        key(&legend, swept, "unstable from", true)
    })
}

/// Fig. 5(b): the oscillating cells of each initial velocity by the paper's rule on the
/// left, by the window rule on the right.
pub fn oscillating(swept: &Swept) -> Result<String> {
    page((1240, 700), |page| {
        let (charts, legend) = page.split_vertically(616);
        let (left, right) = charts.split_horizontally(620);
        for (area, rule, name) in [
            (&left, Rule::Paper, "|ξ̇(N)| ≥ 0.01, the paper's rule"),
            (&right, Rule::Window, "peak speed of the last 2,000 samples"),
        ] {
            let title = format!("Fig. 5(b)  Oscillating: {name}");
            let mut plane = Plane::new(area, &title, 0.0..1.0, 0.0..1.0)?;
            plane.fill(overlay(swept, |classes| {
                rule.of(classes) == Class::LimitCycle
            })?)?;
            plane.borders()?;
            plane.critical_lines(swept.map.v0(), RED)?;
        }
        key(&legend, swept, "oscillates from", false)
    })
}

/// The shade of the smallest velocity of a cell: dark for the first.
fn shade(panel: usize, panels: usize) -> RGBAColor {
    let light = 40 + (180 * panel / panels.max(2).saturating_sub(1)).min(180);
    RGBColor(light as u8, light as u8, light as u8).to_rgba()
}

/// Rectangles of all panels, the last panel first, so that the first lies on top.
fn overlay(swept: &Swept, shown: impl Fn(Classes) -> bool) -> Result<Vec<Filled>> {
    let panels = swept.v0.len();
    let painted = rectangles(swept, |classes, panel| {
        shown(classes).then(|| shade(panel, panels))
    })?;
    Ok(painted.into_iter().rev().flatten().collect())
}

fn key(area: &Area<'_>, swept: &Swept, what: &str, describing: bool) -> Result<()> {
    let (mut x, y) = (24, 8);
    for (panel, v0) in swept.v0.iter().enumerate() {
        let corners = [(x, y), (x + 20, y + 16)];
        let shade = shade(panel, swept.v0.len());
        area.draw(&Rectangle::new(corners, shade.filled()))
            .map_err(trouble)?;
        let text = format!("{what} {v0}");
        area.draw_text(&text, &letters(LABEL, BLACK), (x + 28, y))
            .map_err(trouble)?;
        x += 52 + 8 * text.len() as i32;
    }
    area.draw_text("counts per sample", &letters(SMALL, GREY), (x, y + 1))
        .map_err(trouble)?;
    let y = 44;
    let mut x = 24;
    let mut lines = vec![(true, RED, "critical lines (9), each with its velocity")];
    if describing {
        lines.push((
            false,
            BLUE,
            "describing function β + 4σ/(π v₀) = ½, not in the paper",
        ));
    }
    for (dashed, colour, text) in lines {
        line_sample(area, (x, y + 8), colour, dashed)?;
        area.draw_text(text, &letters(LABEL, BLACK), (x + 45, y))
            .map_err(trouble)?;
        x += 70 + 7 * text.chars().count() as i32;
    }
    Ok(())
}
