//! Angle against time of several runs, one under the other.

use anyhow::Result;
use plotters::prelude::*;

use super::style::{BLUE, FAINT, LABEL, RED, SMALL, TITLE, letters, page, trouble};

/// One run.
pub struct Curve<'a> {
    name: &'a str,
    points: &'a [(f64, f64)],
}

impl<'a> Curve<'a> {
    pub fn new(name: &'a str, points: &'a [(f64, f64)]) -> Self {
        Self { name, points }
    }
}

/// A picture of the runs, each with its own axes: they may differ by orders of magnitude.
pub fn curves(title: &str, curves: &[Curve<'_>]) -> Result<String> {
    page((900, 60 + 280 * curves.len() as u32), |page| {
        page.draw_text(title, &letters(TITLE, BLACK), (20, 14))
            .map_err(trouble)?;
        let (_, charts) = page.split_vertically(48);
        for ((area, curve), colour) in charts
            .split_evenly((curves.len(), 1))
            .iter()
            .zip(curves)
            .zip([RED, BLUE])
        {
            let extreme =
                |pick: fn(f64, f64) -> f64, from| curve.points.iter().map(|p| p.1).fold(from, pick);
            let (low, high) = (
                extreme(f64::min, f64::INFINITY),
                extreme(f64::max, f64::NEG_INFINITY),
            );
            // A knob at rest still gets an axis.
            let margin = (0.08 * (high - low)).max(1e-5);
            let decimals = (2.0 - (high - low + 2.0 * margin).log10()).clamp(2.0, 8.0) as usize;
            let times =
                curve.points.first().map_or(0.0, |p| p.0)..curve.points.last().map_or(1.0, |p| p.0);
            let mut chart = ChartBuilder::on(area)
                .caption(curve.name, letters(LABEL, colour))
                .margin(10)
                .x_label_area_size(40)
                .y_label_area_size(80)
                .build_cartesian_2d(times, low - margin..high + margin)
                .map_err(trouble)?;
            chart
                .configure_mesh()
                .light_line_style(TRANSPARENT)
                .bold_line_style(FAINT)
                .x_desc("time, s")
                .y_desc("angle, rad")
                .y_labels(6)
                .label_style(letters(SMALL, BLACK))
                .axis_desc_style(letters(LABEL, BLACK))
                .y_label_formatter(&|angle| format!("{angle:.decimals$}"))
                .x_label_formatter(&|time| format!("{time:.3}"))
                .draw()
                .map_err(trouble)?;
            let line = LineSeries::new(curve.points.iter().copied(), colour.stroke_width(2));
            chart.draw_series(line).map_err(trouble)?;
        }
        Ok(())
    })
}
