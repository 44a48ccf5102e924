//! Curves over two logarithmic axes, with a label at every point.

use std::ops::Range;

use anyhow::Result;
use plant_sim::compare::Spread;
use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::style::{Area, FAINT, GREY, LABEL, SMALL, TITLE, letters, trouble};
use crate::number::short;

/// A point with what is written at it.
#[derive(Clone)]
pub struct Mark {
    /// Drawn with a bar over its quartiles where they are apart.
    pub x: Spread,
    pub y: f64,
    pub label: String,
}

/// How a curve looks.
#[derive(Clone, Copy)]
pub struct Look {
    pub colour: RGBColor,
    pub dashed: bool,
    /// Of a point, pixels.
    pub radius: i32,
    pub hollow: bool,
}

/// Points that belong together, joined in their order.
pub struct Curve {
    pub look: Look,
    pub marks: Vec<Mark>,
}

/// The frame.
pub struct Panel<'a> {
    pub title: &'a str,
    pub x_axis: &'a str,
    pub y_axis: &'a str,
    pub x: Range<f64>,
    pub y: Range<f64>,
    /// Where what is zero is drawn, and what is written there.
    pub zero: Option<(f64, &'a str)>,
}

/// A place in pixels, and what is written there.
type Labelled = ((i32, i32), String);

/// Left, top, right and bottom, pixels.
type Rectangle = [i32; 4];

/// Width of a letter of size [`SMALL`], about, pixels.
const LETTER: i32 = 7;

/// A point as the legend shows it, too.
pub fn point(area: &DrawingArea<SVGBackend<'_>, Shift>, at: (i32, i32), look: Look) -> Result<()> {
    if look.hollow {
        area.draw(&Circle::new(at, look.radius, WHITE.filled()))
            .map_err(trouble)?;
        area.draw(&Circle::new(at, look.radius, look.colour.stroke_width(2)))
    } else {
        area.draw(&Circle::new(at, look.radius, look.colour.filled()))
    }
    .map_err(trouble)
}

/// Draws a panel with its curves.
pub fn draw(area: &Area<'_>, panel: &Panel<'_>, curves: &[Curve]) -> Result<()> {
    let (x, y) = (panel.x.clone(), panel.y.clone());
    let mut chart = ChartBuilder::on(area)
        .caption(panel.title, letters(TITLE, BLACK))
        .margin(10)
        .margin_right(22)
        .x_label_area_size(44)
        .y_label_area_size(78)
        .build_cartesian_2d(x.clone().log_scale(), y.clone().log_scale())
        .map_err(trouble)?;
    chart
        .configure_mesh()
        .x_desc(panel.x_axis)
        .y_desc(panel.y_axis)
        .label_style(letters(SMALL, BLACK))
        .axis_desc_style(letters(LABEL, BLACK))
        .disable_mesh()
        .set_all_tick_mark_size(0)
        .x_label_formatter(&|_| String::new())
        .y_label_formatter(&|_| String::new())
        .draw()
        .map_err(trouble)?;
    let plot = chart.plotting_area();
    let line = |ends: [(f64, f64); 2], text: &str, shift, align| {
        let style = letters(SMALL, BLACK).pos(align);
        let text = EmptyElement::at(ends[0]) + Text::new(text.to_owned(), shift, style);
        plot.draw(&PathElement::new(ends, FAINT))
            .and_then(|()| plot.draw(&text))
            .map_err(trouble)
    };
    let below = Pos::new(HPos::Center, VPos::Top);
    let beside = Pos::new(HPos::Right, VPos::Center);
    for value in ticks(&x) {
        line(
            [(value, y.start), (value, y.end)],
            &short(value),
            (0, 8),
            below,
        )?;
    }
    for value in ticks(&y) {
        // Not across what is written at the zero.
        if panel.zero.is_none_or(|(zero, _)| value > 2.0 * zero) {
            line(
                [(x.start, value), (x.end, value)],
                &short(value),
                (-8, 0),
                beside,
            )?;
        }
    }
    if let Some((zero, text)) = panel.zero {
        line([(x.start, zero), (x.end, zero)], text, (-8, 0), beside)?;
    }

    let pixel = |x: f64, y: f64| plot.map_coordinate(&(x, y));
    // In the plot's own pixels.
    let (across, down) = plot.get_pixel_range();
    let (left, top) = (across.start, down.start);
    let inner = plot.strip_coord_spec();
    let at = |x: f64, y: f64| {
        let (px, py) = pixel(x, y);
        (px - left, py - top)
    };
    let mut bars: Vec<Rectangle> = Vec::new();
    for curve in curves {
        let path = || curve.marks.iter().map(|mark| at(mark.x.median, mark.y));
        let style = curve.look.colour.stroke_width(2);
        if curve.look.dashed {
            inner.draw(&DashedPathElement::new(path(), 8, 5, style))
        } else {
            inner.draw(&PathElement::new(path().collect::<Vec<_>>(), style))
        }
        .map_err(trouble)?;
        for mark in &curve.marks {
            let ((from, row), (to, _)) = (at(mark.x.low, mark.y), at(mark.x.high, mark.y));
            if to - from > 2 * curve.look.radius {
                bars.push([from, row - 4, to, row + 4]);
                for ends in [
                    [(from, row), (to, row)],
                    [(from, row - 4), (from, row + 4)],
                    [(to, row - 4), (to, row + 4)],
                ] {
                    let bar = PathElement::new(ends, curve.look.colour.stroke_width(1));
                    inner.draw(&bar).map_err(trouble)?;
                }
            }
            point(&inner, at(mark.x.median, mark.y), curve.look)?;
        }
    }
    let size = (across.end - left, down.end - top);
    let marks = |curve: &Curve| -> Vec<Labelled> {
        let marks = curve.marks.iter();
        let all = marks.map(|mark| (at(mark.x.median, mark.y), mark.label.clone()));
        joined(all.collect())
    };
    let labelled: Vec<_> = curves
        .iter()
        .map(|curve| (curve.look, marks(curve)))
        .collect();
    for (place, label, colour) in placed(&labelled, &bars, size) {
        inner
            .draw_text(&label, &letters(SMALL, colour), place)
            .map_err(trouble)?;
    }
    Ok(())
}

/// Powers of ten within a range, at most about eight of them; twice and five times them too where
/// they are few.
fn ticks(range: &Range<f64>) -> Vec<f64> {
    if range.end / range.start < 1e3 {
        let (first, last) = (range.start.log10().floor(), range.end.log10().ceil());
        let decades = (first as i32..=last as i32).map(|power| 10_f64.powi(power));
        let all = decades.flat_map(|decade| [decade, 2.0 * decade, 5.0 * decade]);
        return all.filter(|tick| range.contains(tick)).collect();
    }
    let (first, last) = (range.start.log10().ceil(), range.end.log10().floor());
    let step = ((last - first) / 8.0).ceil().max(1.0);
    let count = ((last - first) / step).floor();
    let ticks = (0..=count.max(0.0) as i32).map(|i| last - step * f64::from(i));
    ticks.map(|power| 10_f64.powf(power)).collect()
}

/// Neighbours that lie on each other get one label, from the first to the last.
fn joined(marks: Vec<Labelled>) -> Vec<Labelled> {
    let mut groups: Vec<((i32, i32), String, String)> = Vec::new();
    for (at, label) in marks {
        match groups.last_mut() {
            Some((first, _, last)) if (at.0 - first.0).abs().max((at.1 - first.1).abs()) < 14 => {
                *last = label;
            }
            _ => groups.push((at, label.clone(), label)),
        }
    }
    let label = |first: String, last: String| match first == last {
        true => first,
        false => format!("{first} … {last}"),
    };
    let labels = groups.into_iter();
    labels
        .map(|(at, first, last)| (at, label(first, last)))
        .collect()
}

/// Where each label goes: near its point, where it covers no other label, no point and, after
/// that, as little of the bars and curves as can be.
fn placed(
    curves: &[(Look, Vec<Labelled>)],
    bars: &[Rectangle],
    (width, height): (i32, i32),
) -> Vec<((i32, i32), String, RGBColor)> {
    let mut taken: Vec<Rectangle> = Vec::new();
    let mut lines: Vec<(i32, i32)> = Vec::new();
    for (look, marks) in curves {
        let r = look.radius;
        taken.extend(marks.iter().map(|((x, y), _)| [x - r, y - r, x + r, y + r]));
        for ends in marks.windows(2) {
            let ((x0, y0), (x1, y1)) = (ends[0].0, ends[1].0);
            let between = |a: i32, b: i32, part: i32| a + (b - a) * part / 24;
            lines.extend((1..24).map(|part| (between(x0, x1, part), between(y0, y1, part))));
        }
    }
    let mut all = Vec::new();
    for (look, marks) in curves {
        for ((x, y), label) in marks {
            let (w, h, r) = (LETTER * label.chars().count() as i32, 13, look.radius + 3);
            let corners = [
                (x - w / 2, y - r - h),
                (x + r, y - h / 2),
                (x - w / 2, y + r),
                (x - r - w, y - h / 2),
                (x + r - 2, y - r - h + 3),
                (x + r - 2, y + r - 3),
                (x - w - r + 2, y - r - h + 3),
                (x - w - r + 2, y + r - 3),
                (x - w / 2, y - r - 2 * h),
                (x - w / 2, y + r + h),
                (x - w / 2, y - r - 3 * h),
                (x - w / 2, y + r + 2 * h),
            ];
            let cost = |(left, top): (i32, i32)| {
                let own = [left, top, left + w, top + h];
                let outside = left < 0 || top < 0 || left + w > width || top + h > height;
                let covered = taken.iter().filter(|other| overlap(own, **other)).count();
                let crossed = lines.iter().filter(|(x, y)| overlap(own, [*x, *y, *x, *y]));
                let barred = bars.iter().filter(|other| overlap(own, **other)).count();
                1000 * usize::from(outside) + 100 * covered + 10 * barred + crossed.count()
            };
            if let Some(best) = corners.into_iter().min_by_key(|corner| cost(*corner)) {
                taken.push([best.0, best.1, best.0 + w, best.1 + h]);
                all.push((best, label.clone(), look.colour));
            }
        }
    }
    all
}

fn overlap(a: Rectangle, b: Rectangle) -> bool {
    a[0] <= b[2] && b[0] <= a[2] && a[1] <= b[3] && b[1] <= a[3]
}

/// Pixels that [`sentences`] needs.
pub fn sentences_height(lines: &[String], notes: &[String]) -> u32 {
    20 * (lines.len() + notes.len()) as u32 + 34
}

/// Under a picture, what to conclude of it, and in grey how it was taken.
pub fn sentences(area: &Area<'_>, lines: &[String], notes: &[String]) -> Result<()> {
    let conclusions = lines.iter().map(|line| (line, letters(LABEL, BLACK), 6));
    let notes = notes.iter().map(|line| (line, letters(SMALL, GREY), 14));
    for (row, (line, style, below)) in conclusions.chain(notes).enumerate() {
        area.draw_text(line, &style, (40, 20 * row as i32 + below))
            .map_err(trouble)?;
    }
    Ok(())
}

/// Text in lines of at most so many letters.
pub fn wrapped(text: &str, letters: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.len() - 1;
        let length = lines[last].chars().count();
        if length > 0 && length + 1 + word.chars().count() > letters {
            lines.push(word.to_owned());
        } else {
            if length > 0 {
                lines[last].push(' ');
            }
            lines[last].push_str(word);
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOOK: Look = Look {
        colour: BLACK,
        dashed: false,
        radius: 4,
        hollow: false,
    };

    #[test]
    fn powers_of_ten_are_few_and_inside() {
        assert_eq!(ticks(&(0.5..2000.0)), [1000.0, 100.0, 10.0, 1.0]);
        assert_eq!(ticks(&(9.0..60.0)), [10.0, 20.0, 50.0]);
        let many = ticks(&(1e-17..1e5));
        assert!(
            many.len() <= 9 && many.iter().all(|t| (1e-17..=1e5).contains(t)),
            "{many:?}"
        );
    }

    #[test]
    fn labels_cover_neither_each_other_nor_points() {
        let marks = |dx: i32| -> Vec<Labelled> {
            (0..5)
                .map(|i| ((60 + 60 * i + dx, 100), "100".to_owned()))
                .collect()
        };
        let curves = [(LOOK, marks(0)), (LOOK, marks(6))];
        let placed = placed(&curves, &[[0, 80, 400, 90]], (400, 200));
        assert_eq!(placed.len(), 10);
        let boxes: Vec<Rectangle> = placed
            .iter()
            .map(|((x, y), ..)| [*x, *y, x + 21, y + 13])
            .collect();
        for (number, own) in boxes.iter().enumerate() {
            assert!(boxes[..number].iter().all(|other| !overlap(*own, *other)));
            assert!(own[0] >= 0 && own[2] <= 400 && own[1] >= 0 && own[3] <= 200);
        }
    }

    #[test]
    fn marks_on_each_other_share_a_label() {
        let marks = [((0, 0), "a"), ((3, 2), "b"), ((5, 0), "c"), ((90, 0), "d")];
        let marks = marks.map(|(at, label)| (at, label.to_owned()));
        let labels: Vec<String> = joined(marks.into()).into_iter().map(|it| it.1).collect();
        assert_eq!(labels, ["a … c", "d"]);
    }

    #[test]
    fn text_is_broken_between_words() {
        assert_eq!(wrapped("one two three", 7), ["one two", "three"]);
        assert_eq!(wrapped("unbreakable", 3), ["unbreakable"]);
    }
}
