//! How stiff each law gets: over the sample period and over the counts.

use std::ops::Range;

use anyhow::Result;
use plant_sim::suite::Contender;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::style::{
    Area, BLUE, FAINT, GREEN, GREY, LABEL, ORANGE, PURPLE, RED, SKY, SMALL, TITLE, letters,
    line_sample, page, trouble,
};
use crate::commands::stiffness::title;
use crate::number::short;

/// A law at a value of what is varied.
pub struct Point {
    pub law: Contender,
    pub x: f64,
    pub static_nm_rad: f64,
    /// Runs that were bad.
    pub bad: usize,
}

/// What is varied, and what came of it.
pub struct Panel {
    pub key: &'static str,
    pub title: &'static str,
    pub axis: &'static str,
    /// Where the axis has a number, and which.
    pub ticks: &'static [(f64, &'static str)],
    pub points: Vec<Point>,
}

/// The two panels.
pub struct StiffnessChart<'a> {
    panels: &'a [Panel],
}

/// Colour, width, dashed.
pub fn look(law: Contender) -> (RGBColor, u32, bool) {
    match law {
        Contender::Static => (GREY, 2, false),
        Contender::EnergyBounding => (BLACK, 2, true),
        Contender::Raw => (RED, 2, false),
        Contender::Episode => (BLUE, 2, false),
        Contender::PassivityControl => (PURPLE, 2, false),
        Contender::VirtualDamping => (ORANGE, 2, false),
        Contender::Ledger => (GREEN, 4, false),
        Contender::Auto => (SKY, 2, true),
    }
}

const PLOT_HEIGHT: u32 = 560;
const LEGEND_HEIGHT: u32 = 130;

impl<'a> StiffnessChart<'a> {
    pub fn new(panels: &'a [Panel]) -> Self {
        Self { panels }
    }

    /// The picture.
    pub fn svg(&self) -> Result<String> {
        // Both panels on the same scale.
        let all = || {
            let points = self.panels.iter().flat_map(|panel| &panel.points);
            points.map(|point| point.static_nm_rad)
        };
        let low = all().fold(f64::INFINITY, f64::min).max(1e-6) / 1.3;
        let high = all().fold(0.0, f64::max).max(1e-5) * 1.3;
        page((1180, PLOT_HEIGHT + LEGEND_HEIGHT), |page| {
            let (plots, legend) = page.split_vertically(PLOT_HEIGHT);
            for (area, panel) in plots.split_evenly((1, 2)).iter().zip(self.panels) {
                draw(area, panel, low..high)?;
            }
            self.legend(&legend)
        })
    }

    fn legend(&self, area: &Area<'_>) -> Result<()> {
        for (number, law) in Contender::ALL.into_iter().enumerate() {
            let (column, row) = (number as i32 / 3, number as i32 % 3);
            let (x, y) = (60 + 370 * column, 8 + 24 * row);
            let (colour, width, dashed) = look(law);
            if width > 2 {
                area.draw(&PathElement::new(
                    [(x, y + 8), (x + 37, y + 8)],
                    colour.stroke_width(width),
                ))
                .map_err(trouble)?;
            } else {
                line_sample(area, (x, y + 8), colour, dashed)?;
            }
            area.draw_text(title(law), &letters(LABEL, BLACK), (x + 47, y))
                .map_err(trouble)?;
        }
        let (x, y) = (60, 88);
        let failed = self.panels.iter().flat_map(|panel| &panel.points);
        let failed = failed.filter(|point| point.bad > 0).count();
        area.draw(&cross((x + 18, y + 8), GREY)).map_err(trouble)?;
        let text = format!(
            "some of the 240 runs of this point are bad ({})",
            match failed {
                0 => "none here".to_owned(),
                more => format!("{more} here"),
            }
        );
        area.draw_text(&text, &letters(LABEL, BLACK), (x + 47, y))
            .map_err(trouble)?;
        let note = "torque over penetration at rest under a push of 30 times the Coulomb friction";
        area.draw_text(note, &letters(SMALL, GREY), (x + 47 + 480, y + 1))
            .map_err(trouble)?;
        Ok(())
    }
}

/// A hollow cross, in pixels.
fn cross(at: (i32, i32), colour: RGBColor) -> PathElement<(i32, i32)> {
    let outline = hollow_cross().map(|(x, y)| (at.0 + x, at.1 + y));
    PathElement::new(outline, colour.stroke_width(1))
}

/// The outline of an upright cross turned by 45°, about its middle, pixels.
fn hollow_cross() -> [(i32, i32); 13] {
    const HALF: i32 = 3;
    const FAR: i32 = 8;
    [
        (0, -HALF),
        (FAR - HALF, -FAR),
        (FAR, HALF - FAR),
        (HALF, 0),
        (FAR, FAR - HALF),
        (FAR - HALF, FAR),
        (0, HALF),
        (HALF - FAR, FAR),
        (-FAR, FAR - HALF),
        (-HALF, 0),
        (-FAR, HALF - FAR),
        (HALF - FAR, -FAR),
        (0, -HALF),
    ]
}

fn draw(area: &Area<'_>, panel: &Panel, range: Range<f64>) -> Result<()> {
    let xs = || panel.points.iter().map(|point| point.x);
    let first = xs().fold(f64::INFINITY, f64::min);
    let last = xs().fold(0.0, f64::max);
    let mut chart = ChartBuilder::on(area)
        .caption(panel.title, letters(TITLE, BLACK))
        .margin(12)
        .margin_right(32)
        .x_label_area_size(46)
        .y_label_area_size(66)
        .build_cartesian_2d((first..last).log_scale(), range.clone().log_scale())
        .map_err(trouble)?;
    chart
        .configure_mesh()
        .x_desc(panel.axis)
        .y_desc("static stiffness, Nm/rad")
        .label_style(letters(SMALL, BLACK))
        .axis_desc_style(letters(LABEL, BLACK))
        .disable_mesh()
        .set_all_tick_mark_size(0)
        .x_label_formatter(&|_| String::new())
        .y_label_formatter(&|_| String::new())
        .draw()
        .map_err(trouble)?;
    let grid = |from, to, text: &str, shift, align| {
        let line = PathElement::new([from, to], FAINT);
        let style = letters(SMALL, BLACK).pos(align);
        let text = EmptyElement::at(from) + Text::new(text.to_owned(), shift, style);
        let plot = chart.plotting_area();
        plot.draw(&line)
            .and_then(|()| plot.draw(&text))
            .map_err(trouble)
    };
    for &(x, text) in panel.ticks {
        let align = Pos::new(HPos::Center, VPos::Top);
        grid((x, range.start), (x, range.end), text, (0, 8), align)?;
    }
    // 1, 2, 5 of every power of ten.
    for decade in -6..7 {
        for digit in [1.0, 2.0, 5.0] {
            let k = digit * 10_f64.powi(decade);
            if range.contains(&k) {
                let align = Pos::new(HPos::Right, VPos::Center);
                grid((first, k), (last, k), &short(k), (-8, 0), align)?;
            }
        }
    }
    for law in Contender::ALL {
        let (colour, width, dashed) = look(law);
        let points = panel.points.iter().filter(|point| point.law == law);
        let line: Vec<_> = points
            .clone()
            .map(|point| (point.x, point.static_nm_rad))
            .collect();
        if dashed {
            let line = DashedPathElement::new(line, 9, 6, colour.stroke_width(width));
            chart.plotting_area().draw(&line).map_err(trouble)?;
        } else {
            let line = PathElement::new(line, colour.stroke_width(width));
            chart.plotting_area().draw(&line).map_err(trouble)?;
        }
        for point in points.filter(|point| point.bad > 0) {
            let at = EmptyElement::at((point.x, point.static_nm_rad))
                + PathElement::new(hollow_cross(), colour.stroke_width(1));
            chart.plotting_area().draw(&at).map_err(trouble)?;
        }
    }
    Ok(())
}
