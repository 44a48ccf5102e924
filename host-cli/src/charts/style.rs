//! What all charts share: colours that people with any colour vision tell apart (Okabe
//! and Ito's), letters, and how a chart becomes text.

use anyhow::{Result, anyhow};
use plotters::coord::{CoordTranslate, Shift};
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use crate::number::digits;

pub const BLUE: RGBColor = RGBColor(0, 114, 178);
pub const SKY: RGBColor = RGBColor(86, 180, 233);
pub const GREEN: RGBColor = RGBColor(0, 158, 115);
pub const ORANGE: RGBColor = RGBColor(230, 159, 0);
pub const RED: RGBColor = RGBColor(213, 94, 0);
pub const PURPLE: RGBColor = RGBColor(146, 80, 130);
pub const GREY: RGBColor = RGBColor(120, 120, 120);
pub const FAINT: RGBColor = RGBColor(225, 225, 225);

pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Sizes of letters, pixels.
pub const TITLE: u32 = 19;
pub const LABEL: u32 = 15;
pub const SMALL: u32 = 13;

/// Letters of a size and colour.
pub fn letters<'a>(size: u32, colour: RGBColor) -> TextStyle<'a> {
    ("sans-serif", size).into_font().color(&colour)
}

/// Draws on a white page of `size` pixels and returns the SVG.
pub fn page(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Result<()>) -> Result<String> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE).map_err(trouble)?;
        draw(&area)?;
        area.present().map_err(trouble)?;
    }
    Ok(svg)
}

/// A line as a legend shows it, from `at` to the right.
pub fn line_sample(area: &Area<'_>, at: (i32, i32), colour: RGBColor, dashed: bool) -> Result<()> {
    let (x, y) = at;
    let ends = [(x, y), (x + 37, y)];
    let style = colour.stroke_width(2);
    if dashed {
        area.draw(&DashedPathElement::new(ends, 9, 5, style))
    } else {
        area.draw(&PathElement::new(ends, style))
    }
    .map_err(trouble)
}

/// A number at an axis that spans `span`: as many digits as tell its neighbours apart.
pub fn tick(value: f64, span: f64) -> String {
    // What is left of a zero after rounding.
    if value.abs() < 1e-6 * span {
        return "0".into();
    }
    // An axis has about ten steps, of one digit, or a half of one.
    let decimals = (20.0 / span).log10().ceil();
    let significant = value.abs().log10().floor() + decimals + 1.0;
    digits(value, significant.clamp(1.0, 17.0) as usize)
}

/// Draws the names of a chart's series in its upper right corner.
pub fn legend<'a, C: CoordTranslate>(
    chart: &mut ChartContext<'a, SVGBackend<'a>, C>,
) -> Result<()> {
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(FAINT)
        .label_font(letters(SMALL, BLACK))
        .draw()
        .map_err(trouble)
}

/// A drawing error, as this program's.
pub fn trouble(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow!("cannot draw: {error}")
}

/// The part of the segment from `a` to `b` that lies in the rectangle, if any does
/// (Liang and Barsky).
pub fn clip(
    a: (f64, f64),
    b: (f64, f64),
    x: std::ops::Range<f64>,
    y: std::ops::Range<f64>,
) -> Option<[(f64, f64); 2]> {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    for (step, room) in [
        (-dx, a.0 - x.start),
        (dx, x.end - a.0),
        (-dy, a.1 - y.start),
        (dy, y.end - a.1),
    ] {
        if step == 0.0 {
            if room < 0.0 {
                return None;
            }
        } else if step < 0.0 {
            from = from.max(room / step);
        } else {
            to = to.min(room / step);
        }
    }
    (from <= to).then_some([
        (a.0 + from * dx, a.1 + from * dy),
        (a.0 + to * dx, a.1 + to * dy),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_at_an_axis_read_differently() {
        let ticks = |from: f64, step: f64| -> Vec<String> {
            let values = (0..10).map(|i| from + f64::from(i) * step);
            values.map(|value| tick(value, 9.9 * step)).collect()
        };
        for (from, step) in [
            (199.94, 0.01),
            (100.0, 1e-4),
            (0.0, 0.2),
            (-0.5, 0.1),
            (0.0, 5e-5),
            (0.0, 2e5),
            (-1e-9, 2e-10),
        ] {
            let mut texts = ticks(from, step);
            assert!(texts.iter().all(|text| text.len() <= 9), "{texts:?}");
            texts.dedup();
            assert_eq!(texts.len(), 10, "{texts:?}");
        }
        assert_eq!(ticks(199.94, 0.02)[..3], ["199.94", "199.96", "199.98"]);
        assert_eq!(ticks(-0.1, 0.1)[..3], ["-0.1", "0", "0.1"]);
    }

    #[test]
    fn lines_are_cut_at_the_frame() {
        let cut = |a, b| clip(a, b, 0.0..1.0, 0.0..1.0);
        assert_eq!(cut((-1.0, 0.5), (2.0, 0.5)), Some([(0.0, 0.5), (1.0, 0.5)]));
        assert_eq!(cut((0.5, 3.0), (0.5, -3.0)), Some([(0.5, 1.0), (0.5, 0.0)]));
        assert_eq!(cut((0.2, 0.2), (0.4, 0.8)), Some([(0.2, 0.2), (0.4, 0.8)]));
        assert_eq!(cut((2.0, 0.0), (3.0, 1.0)), None);
        assert_eq!(cut((0.0, 2.0), (1.0, 2.0)), None);
    }
}
