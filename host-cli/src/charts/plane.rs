//! The (β, σ) plane with its four regions and the critical line (9).

use anyhow::Result;
use control::criterion::{Dimensionless, critical_sigma};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::ops::Range;

use super::style::{
    Area, BLUE, GREEN, GREY, LABEL, ORANGE, RED, SMALL, TITLE, clip, letters, trouble,
};
use crate::number::digits;
use crate::stop;

/// A chart over (β, σ), or over their decimal logarithms.
pub struct Plane<'a> {
    chart: ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>,
    beta: Range<f64>,
    sigma: Range<f64>,
    /// Where β = ½ and σ = ½ lie.
    half: f64,
}

impl<'a> Plane<'a> {
    /// An empty plane with axes.
    pub fn new(area: &Area<'a>, title: &str, beta: Range<f64>, sigma: Range<f64>) -> Result<Self> {
        Self::with_axes(area, title, beta, sigma, (6, 6), 0.5, |value| {
            digits(value, 3)
        })
    }

    /// An empty plane over log₁₀ β and log₁₀ σ, from and to whole powers of ten. All points
    /// are given in these coordinates; lines of the linear plane would be curves here.
    pub fn logarithmic(
        area: &Area<'a>,
        title: &str,
        beta: Range<f64>,
        sigma: Range<f64>,
    ) -> Result<Self> {
        let labels = |range: &Range<f64>| (range.end - range.start) as usize + 1;
        let count = (labels(&beta), labels(&sigma));
        Self::with_axes(area, title, beta, sigma, count, 0.5_f64.log10(), |value| {
            digits(10_f64.powf(value), 3)
        })
    }

    fn with_axes(
        area: &Area<'a>,
        title: &str,
        beta: Range<f64>,
        sigma: Range<f64>,
        labels: (usize, usize),
        half: f64,
        label: impl Fn(f64) -> String,
    ) -> Result<Self> {
        let mut chart = ChartBuilder::on(area)
            .caption(title, letters(TITLE, BLACK))
            .margin(12)
            .x_label_area_size(46)
            .y_label_area_size(56)
            .build_cartesian_2d(beta.clone(), sigma.clone())
            .map_err(trouble)?;
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc("β = b / (K T)   effective viscous friction")
            .y_desc("σ = c / (K Δ)   effective Coulomb friction")
            .x_labels(labels.0)
            .y_labels(labels.1)
            .x_label_formatter(&|beta| label(*beta))
            .y_label_formatter(&|sigma| label(*sigma))
            .label_style(letters(SMALL, BLACK))
            .axis_desc_style(letters(LABEL, BLACK))
            .draw()
            .map_err(trouble)?;
        Ok(Self {
            chart,
            beta,
            sigma,
            half,
        })
    }

    /// Filled rectangles: corners and colour.
    pub fn fill(
        &mut self,
        rectangles: impl IntoIterator<Item = ([(f64, f64); 2], RGBAColor)>,
    ) -> Result<()> {
        let shapes = rectangles
            .into_iter()
            .take_while(|_| !stop::requested())
            .map(|(corners, colour)| Rectangle::new(corners, colour.filled()));
        self.chart.draw_series(shapes).map_err(trouble)?;
        Ok(stop::check()?)
    }

    /// The four regions of Fig. 3 in faint colours.
    pub fn regions(&mut self) -> Result<()> {
        let (b, s, half) = (self.beta.clone(), self.sigma.clone(), self.half);
        self.fill([
            ([(half, half), (b.end, s.end)], GREEN.mix(0.22)),
            ([(b.start, s.start), (half, half)], RED.mix(0.25)),
            ([(half, s.start), (b.end, half)], ORANGE.mix(0.22)),
            ([(b.start, half), (half, s.end)], BLUE.mix(0.15)),
        ])
    }

    /// The paper's letters of the regions, each in the middle of the part that is shown.
    pub fn region_letters(&mut self, colour: RGBColor) -> Result<()> {
        let half = self.half;
        // Below and above one half; None where nothing is shown of it.
        let middles = |range: &Range<f64>| {
            let (low, high) = (range.end.min(half), range.start.max(half));
            [
                (range.start < low).then_some((range.start + low) / 2.0),
                (high < range.end).then_some((high + range.end) / 2.0),
            ]
        };
        let (beta, sigma) = (middles(&self.beta), middles(&self.sigma));
        for (b, s, letter) in [(1, 1, "a"), (0, 0, "b"), (1, 0, "c"), (0, 1, "d")] {
            if let (Some(b), Some(s)) = (beta[b], sigma[s]) {
                self.write((b, s), (-4, -8), letter, LABEL, colour)?;
            }
        }
        Ok(())
    }

    /// The borders β = ½ and σ = ½.
    pub fn borders(&mut self) -> Result<()> {
        let half = self.half;
        for (from, to) in [
            ((half, self.sigma.start), (half, self.sigma.end)),
            ((self.beta.start, half), (self.beta.end, half)),
        ] {
            self.dashes(from, to, 2, 4, GREY.stroke_width(1))?;
        }
        Ok(())
    }

    /// The critical line (9) at a speed in counts per sample, dashed.
    pub fn critical_line(&mut self, speed: f64, colour: RGBColor) -> Result<()> {
        let point = |beta: f64| (beta, critical_sigma(beta, speed));
        self.dashes(
            point(self.beta.start),
            point(self.beta.end),
            9,
            5,
            colour.stroke_width(2),
        )
    }

    /// The critical lines of several speeds, each with its speed at its upper end where there
    /// is room: left of the line if the slower one is far enough, else right of it if there
    /// is no faster one.
    pub fn critical_lines(&mut self, speeds: &[f64], colour: RGBColor) -> Result<()> {
        let mut speeds: Vec<f64> = speeds.iter().map(|speed| speed.abs()).collect();
        speeds.sort_by(f64::total_cmp);
        let top = self.sigma.end;
        let mut taken = self.pixel((self.beta.start, top)).0;
        for (i, speed) in speeds.iter().enumerate() {
            self.critical_line(*speed, colour)?;
            let at = (0.5 - (top - 0.5) / speed, top);
            if !(self.beta.start..self.beta.end).contains(&at.0) {
                continue;
            }
            let text = digits(*speed, 3);
            let width = 8 * text.len() as i32;
            let x = self.pixel(at).0;
            let left = if x - taken > width + 8 {
                -width - 4
            } else if i + 1 == speeds.len() {
                8
            } else {
                continue;
            };
            taken = x;
            // On white, since it may lie on cells of any shade.
            let corners = [(left - 2, 2), (left + width, 17)];
            let ground = Rectangle::new(corners, WHITE.mix(0.85).filled());
            let ground = EmptyElement::at(at) + ground;
            self.chart.draw_series([ground]).map_err(trouble)?;
            self.write(at, (left, 4), &text, SMALL, colour)?;
        }
        Ok(())
    }

    /// The describing-function line β + 4σ/(π v₀) = ½, solid.
    pub fn describing_function_line(&mut self, v0: f64, colour: RGBColor) -> Result<()> {
        let slope = std::f64::consts::PI * v0.abs() / 4.0;
        let point = |beta: f64| (beta, (0.5 - beta) * slope);
        self.line(
            point(self.beta.start),
            point(self.beta.end),
            colour.stroke_width(2),
        )
    }

    /// A solid line, cut at the frame.
    pub fn line(&mut self, from: (f64, f64), to: (f64, f64), style: ShapeStyle) -> Result<()> {
        if let Some(ends) = clip(from, to, self.beta.clone(), self.sigma.clone()) {
            self.chart
                .draw_series(LineSeries::new(ends, style))
                .map_err(trouble)?;
        }
        Ok(())
    }

    /// A dashed line, cut at the frame.
    fn dashes(
        &mut self,
        from: (f64, f64),
        to: (f64, f64),
        on: u32,
        off: u32,
        style: ShapeStyle,
    ) -> Result<()> {
        if let Some(ends) = clip(from, to, self.beta.clone(), self.sigma.clone()) {
            let series = DashedLineSeries::new(ends, on, off, style);
            self.chart.draw_series(series).map_err(trouble)?;
        }
        Ok(())
    }

    /// An arrow from one point to another.
    pub fn arrow(&mut self, from: (f64, f64), to: (f64, f64), colour: RGBColor) -> Result<()> {
        self.line(from, to, colour.stroke_width(3))?;
        // The head, in pixels, so that it has its shape whatever the axes.
        let (a, b) = (self.pixel(from), self.pixel(to));
        let (dx, dy) = (f64::from(b.0 - a.0), f64::from(b.1 - a.1));
        let length = dx.hypot(dy).max(1.0);
        let (ux, uy) = (dx / length, dy / length);
        let corner = |back: f64, side: f64| {
            (
                (-back * ux - side * uy) as i32,
                (-back * uy + side * ux) as i32,
            )
        };
        let head = EmptyElement::at(to)
            + Polygon::new(
                [(0, 0), corner(13.0, 5.5), corner(13.0, -5.5)],
                colour.filled(),
            );
        self.chart.draw_series([head]).map_err(trouble)?;
        Ok(())
    }

    fn pixel(&self, point: (f64, f64)) -> (i32, i32) {
        self.chart.backend_coord(&point)
    }

    /// Letters at a point, moved by pixels.
    pub fn write(
        &mut self,
        at: (f64, f64),
        shift: (i32, i32),
        text: &str,
        size: u32,
        colour: RGBColor,
    ) -> Result<()> {
        let words = EmptyElement::at(at) + Text::new(text.to_owned(), shift, letters(size, colour));
        self.chart.draw_series([words]).map_err(trouble)?;
        Ok(())
    }

    /// A dot.
    pub fn dot(&mut self, at: (f64, f64), colour: RGBColor) -> Result<()> {
        self.chart
            .draw_series([Circle::new(at, 6, colour.filled())])
            .map_err(trouble)?;
        Ok(())
    }

    /// The characteristic point of a display with a text; one that lies beyond the frame
    /// is drawn as a triangle at its edge.
    pub fn characteristic_point(&mut self, point: Dimensionless<f64>, text: &str) -> Result<()> {
        let Dimensionless { beta, sigma, .. } = point;
        let (right, above) = (beta > self.beta.end, sigma > self.sigma.end);
        let at = (beta.min(self.beta.end), sigma.min(self.sigma.end));
        if right || above {
            let (ux, uy) = match (right, above) {
                (true, true) => (0.7, -0.7),
                (true, false) => (1.0, 0.0),
                _ => (0.0, -1.0),
            };
            let corner = |back: f64, side: f64| {
                (
                    (-back * ux - side * uy) as i32,
                    (-back * uy + side * ux) as i32,
                )
            };
            let shape = EmptyElement::at(at)
                + Polygon::new(
                    [(0, 0), corner(14.0, 7.0), corner(14.0, -7.0)],
                    BLACK.filled(),
                );
            self.chart.draw_series([shape]).map_err(trouble)?;
        } else {
            self.dot(at, BLACK)?;
        }
        let left = at.0 > (self.beta.start + self.beta.end) / 2.0;
        let shift = if left {
            (-12 - 7 * text.chars().count() as i32, 12)
        } else {
            (12, 12)
        };
        self.write(at, shift, text, LABEL, BLACK)
    }
}
