//! The figures of [`crate::failures`]: what is true in blue, what a naive form says in the other
//! colours, on linear or logarithmic axes.

use std::ops::Range;

use anyhow::Result;
use plotters::prelude::*;

use super::style::{
    Area, BLUE, FAINT, GREEN, GREY, LABEL, ORANGE, PURPLE, RED, SMALL, TITLE, letters, line_sample,
    page, tick, trouble,
};
use crate::number::digits;

/// A figure.
#[derive(Debug, Clone)]
pub struct Figure {
    /// What it shows.
    pub title: String,
    /// From left to right.
    pub x: Axis,
    /// From bottom to top.
    pub y: Axis,
    /// In the order of the legend; the last is drawn on top.
    pub series: Vec<Series>,
}

/// A quantity at an axis.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Its name and unit.
    pub name: &'static str,
    /// Whether equal steps are equal ratios.
    pub logarithmic: bool,
}

/// A line or points, with a name in the legend.
#[derive(Debug, Clone)]
pub struct Series {
    /// Who says so.
    pub name: String,
    /// Of whom it is.
    pub whose: Whose,
    /// How it is drawn.
    pub mark: Mark,
    /// x and y. On a logarithmic axis what is not above zero is left out.
    pub points: Vec<(f64, f64)>,
}

/// Of whom a series is: its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Whose {
    /// What is true, or the mended form.
    Truth,
    /// The naive form.
    Naive,
    /// Another naive form.
    Second,
    /// A third.
    Third,
    /// A fourth.
    Fourth,
    /// A level to compare with.
    Level,
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// A line.
    Line,
    /// A dashed line.
    Dashed,
    /// A dot at every point.
    Dots,
    /// Dots on a line.
    DotsOnLine,
}

const WIDTH: u32 = 760;
const PLOT_HEIGHT: u32 = 380;
/// Of a row of the legend.
const ROW: u32 = 22;

impl Axis {
    /// A linear axis.
    pub fn linear(name: &'static str) -> Self {
        Self {
            name,
            logarithmic: false,
        }
    }

    /// A logarithmic axis.
    pub fn logarithmic(name: &'static str) -> Self {
        Self {
            name,
            logarithmic: true,
        }
    }

    fn place(&self, value: f64) -> f64 {
        if self.logarithmic {
            value.log10()
        } else {
            value
        }
    }

    /// How many numbers an axis has at most: one a decade, if there are some.
    fn labels(&self, span: f64, most: usize) -> usize {
        if self.logarithmic && span >= 2.0 {
            most.min(span.floor() as usize + 1)
        } else {
            most
        }
    }

    fn label(&self, place: f64, span: f64) -> String {
        if !self.logarithmic {
            tick(place, span)
        } else if place.fract().abs() > 1e-9 {
            digits(10_f64.powf(place), 2)
        } else if (-2.0..=3.0).contains(&place) {
            10_f64.powi(place as i32).to_string()
        } else {
            format!("1e{place}")
        }
    }
}

impl Whose {
    fn colour(self) -> RGBColor {
        match self {
            Self::Truth => BLUE,
            Self::Naive => RED,
            Self::Second => ORANGE,
            Self::Third => PURPLE,
            Self::Fourth => GREEN,
            Self::Level => GREY,
        }
    }

    fn style(self) -> ShapeStyle {
        let width = if self == Self::Truth { 3 } else { 2 };
        self.colour().stroke_width(width)
    }
}

impl Figure {
    /// The picture.
    ///
    /// # Errors
    /// If it cannot be drawn.
    pub fn svg(&self) -> Result<String> {
        let rows = self.series.len().div_ceil(2) as u32;
        page((WIDTH, PLOT_HEIGHT + ROW * rows + 10), |page| {
            let (plot, legend) = page.split_vertically(PLOT_HEIGHT);
            self.plot(&plot)?;
            self.legend(&legend)
        })
    }

    /// The points that can be drawn, in the places of the axes.
    fn placed(&self, series: &Series) -> Vec<(f64, f64)> {
        let places = series
            .points
            .iter()
            .map(|(x, y)| (self.x.place(*x), self.y.place(*y)));
        places
            .filter(|(x, y)| x.is_finite() && y.is_finite())
            .collect()
    }

    fn range(&self, of: impl Fn((f64, f64)) -> f64, margin: f64) -> Range<f64> {
        let all = self.series.iter().flat_map(|series| self.placed(series));
        let (low, high) = all
            .map(of)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        let room = margin * (high - low).max(1e-12);
        low - room..high + room
    }

    fn plot(&self, area: &Area<'_>) -> Result<()> {
        let x = self.range(|point| point.0, 0.02);
        let y = self.range(|point| point.1, 0.06);
        let (wide, high) = (x.end - x.start, y.end - y.start);
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, letters(TITLE, BLACK))
            .margin(12)
            .x_label_area_size(46)
            .y_label_area_size(78)
            .build_cartesian_2d(x, y)
            .map_err(trouble)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(FAINT)
            .x_desc(self.x.name)
            .y_desc(self.y.name)
            .x_labels(self.x.labels(wide, 9))
            .y_labels(self.y.labels(high, 8))
            .label_style(letters(SMALL, BLACK))
            .axis_desc_style(letters(LABEL, BLACK))
            .x_label_formatter(&|place| self.x.label(*place, wide))
            .y_label_formatter(&|place| self.y.label(*place, high))
            .draw()
            .map_err(trouble)?;
        for series in &self.series {
            let points = self.placed(series);
            let style = series.whose.style();
            match series.mark {
                Mark::Line | Mark::DotsOnLine => {
                    chart
                        .draw_series(LineSeries::new(points.clone(), style))
                        .map_err(trouble)?;
                }
                Mark::Dashed => {
                    chart
                        .draw_series(DashedLineSeries::new(points.clone(), 7, 5, style))
                        .map_err(trouble)?;
                }
                Mark::Dots => {}
            }
            if matches!(series.mark, Mark::Dots | Mark::DotsOnLine) {
                let dots = points.into_iter();
                chart
                    .draw_series(dots.map(|at| Circle::new(at, 4, series.whose.colour().filled())))
                    .map_err(trouble)?;
            }
        }
        Ok(())
    }

    fn legend(&self, area: &Area<'_>) -> Result<()> {
        for (number, series) in self.series.iter().enumerate() {
            let (column, row) = (number as i32 % 2, number as i32 / 2);
            let (x, y) = (40 + 365 * column, 2 + ROW as i32 * row);
            let colour = series.whose.colour();
            if series.mark != Mark::Dots {
                line_sample(area, (x, y + 8), colour, series.mark == Mark::Dashed)?;
            }
            if matches!(series.mark, Mark::Dots | Mark::DotsOnLine) {
                area.draw(&Circle::new((x + 18, y + 8), 4, colour.filled()))
                    .map_err(trouble)?;
            }
            area.draw_text(&series.name, &letters(SMALL, BLACK), (x + 46, y + 1))
                .map_err(trouble)?;
        }
        Ok(())
    }
}
