//! What all charts share: colours that people with any colour vision tell apart (Okabe
//! and Ito's), letters, and how a chart becomes text.

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;

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
    fn lines_are_cut_at_the_frame() {
        let cut = |a, b| clip(a, b, 0.0..1.0, 0.0..1.0);
        assert_eq!(cut((-1.0, 0.5), (2.0, 0.5)), Some([(0.0, 0.5), (1.0, 0.5)]));
        assert_eq!(cut((0.5, 3.0), (0.5, -3.0)), Some([(0.5, 1.0), (0.5, 0.0)]));
        assert_eq!(cut((0.2, 0.2), (0.4, 0.8)), Some([(0.2, 0.2), (0.4, 0.8)]));
        assert_eq!(cut((2.0, 0.0), (3.0, 1.0)), None);
        assert_eq!(cut((0.0, 2.0), (1.0, 2.0)), None);
    }
}
