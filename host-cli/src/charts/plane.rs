//! The (β, σ) plane with its four regions and the critical line (9).

use anyhow::Result;
use control::criterion::{Dimensionless, critical_sigma};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::ops::Range;

use super::style::{
    Area, BLUE, GREEN, GREY, LABEL, ORANGE, RED, SMALL, TITLE, clip, letters, trouble,
};
use crate::stop;

/// A chart over (β, σ).
pub struct Plane<'a> {
    chart: ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>,
    beta: Range<f64>,
    sigma: Range<f64>,
}

impl<'a> Plane<'a> {
    /// An empty plane with axes.
    pub fn new(area: &Area<'a>, title: &str, beta: Range<f64>, sigma: Range<f64>) -> Result<Self> {
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
            .x_labels(6)
            .y_labels(6)
            .label_style(letters(SMALL, BLACK))
            .axis_desc_style(letters(LABEL, BLACK))
            .draw()
            .map_err(trouble)?;
        Ok(Self { chart, beta, sigma })
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
        let (b, s) = (self.beta.clone(), self.sigma.clone());
        self.fill([
            ([(0.5, 0.5), (b.end, s.end)], GREEN.mix(0.22)),
            ([(b.start, s.start), (0.5, 0.5)], RED.mix(0.25)),
            ([(0.5, s.start), (b.end, 0.5)], ORANGE.mix(0.22)),
            ([(b.start, 0.5), (0.5, s.end)], BLUE.mix(0.15)),
        ])
    }

    /// The borders β = ½ and σ = ½.
    pub fn borders(&mut self) -> Result<()> {
        for (from, to) in [
            ((0.5, self.sigma.start), (0.5, self.sigma.end)),
            ((self.beta.start, 0.5), (self.beta.end, 0.5)),
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
        let half = (self.beta.start + self.beta.end) / 2.0;
        let left = at.0 > half;
        let shift = if left {
            (-12 - 7 * text.chars().count() as i32, 12)
        } else {
            (12, 12)
        };
        self.write(at, shift, text, LABEL, BLACK)
    }
}
