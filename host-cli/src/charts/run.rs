//! One run of a scene, as Fig. 6 of the paper: the characteristic point and the critical line
//! of the start on the left, angle against time with ±1 count on the right.

use std::collections::VecDeque;

use anyhow::Result;
use control::criterion::{Criterion, Dimensionless, Region, Sampling};
use control::shape::Shape;
use plant_sim::closed_loop::{Report, Scene};
use plant_sim::outcome::Class;
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::plane::Plane;
use super::style::{
    Area, BLUE, FAINT, GREY, LABEL, ORANGE, PURPLE, SMALL, TITLE, legend, letters, page, tick,
    trouble,
};
use crate::number::{digits, short};

/// The smallest and the largest of a quantity over stretches of time: as many as a picture
/// can show, however long the run.
pub struct Envelope {
    stretches: Vec<Stretch>,
    /// Samples per stretch.
    stride: u64,
    in_last: u64,
    /// The last samples themselves: time and value.
    ending: VecDeque<(f64, f64)>,
}

/// Samples that an [`Envelope`] keeps as they are.
const ENDING: usize = 60;

#[derive(Clone, Copy)]
struct Stretch {
    time_s: f64,
    first: f64,
    low: f64,
    high: f64,
}

impl Envelope {
    const MOST: usize = 3000;

    pub fn new() -> Self {
        Self {
            stretches: Vec::new(),
            stride: 1,
            in_last: u64::MAX,
            ending: VecDeque::new(),
        }
    }

    /// Enters the next sample.
    pub fn enter(&mut self, time_s: f64, value: f64) {
        if self.ending.len() == ENDING {
            self.ending.pop_front();
        }
        self.ending.push_back((time_s, value));
        if self.in_last < self.stride
            && let Some(last) = self.stretches.last_mut()
        {
            last.low = last.low.min(value);
            last.high = last.high.max(value);
            self.in_last += 1;
            return;
        }
        if self.stretches.len() == Self::MOST {
            let pairs = self.stretches.chunks(2).map(|pair| Stretch {
                low: pair[0].low.min(pair[pair.len() - 1].low),
                high: pair[0].high.max(pair[pair.len() - 1].high),
                ..pair[0]
            });
            self.stretches = pairs.collect();
            self.stride *= 2;
        }
        self.stretches.push(Stretch {
            time_s,
            first: value,
            low: value,
            high: value,
        });
        self.in_last = 1;
    }

    /// A line through all of it.
    fn line(&self) -> impl Iterator<Item = (f64, f64)> {
        self.stretches.iter().flat_map(|s| {
            let points = [(s.time_s, s.first), (s.time_s, s.low), (s.time_s, s.high)];
            points.into_iter().take(if s.low == s.high { 1 } else { 3 })
        })
    }
}

/// What the chart of a run shows.
pub struct RunChart<'a> {
    title: String,
    verdict: String,
    class: Class,
    point: Dimensionless<f64>,
    /// The speed that the start can turn into, counts per sample.
    speed: f64,
    zero_rad: f64,
    wall: bool,
    count_rad: f64,
    envelope: &'a Envelope,
}

impl<'a> RunChart<'a> {
    pub fn new(name: &str, scene: &Scene, report: &Report, envelope: &'a Envelope) -> Result<Self> {
        let config = &scene.config;
        let count_rad = config.count_rad();
        let sampling = Sampling {
            period_s: config.timing.period_s,
            count_rad,
        };
        let criterion = Criterion::new(scene.device, sampling)?;
        let point = criterion.dimensionless(report.max_stiffness_nm_rad);
        let region = match point.region() {
            Region::GloballyPassive => "(a), passive",
            Region::Unstable => "(b), unstable",
            Region::LimitCycle => "(c), limit cycles",
            Region::LocallyPassive => "(d), passive while slow",
        };
        let speed_rad_s = scene.reachable_speed_rad_s(report.max_stiffness_nm_rad);
        let holds = if criterion.power_margin_nm(report.max_stiffness_nm_rad, speed_rad_s) >= 0.0 {
            "holds"
        } else {
            "does not hold"
        };
        let class = match report.class {
            Class::Rest => "comes to rest",
            Class::LimitCycle => "limit cycle",
            Class::Unstable => "grows without bound",
            Class::Undecided => "undecided",
        };
        Ok(Self {
            title: format!(
                "{name}: K = {} Nm/rad, {} counts/rev, T = {} ms, from {} rad/s",
                short(report.max_stiffness_nm_rad),
                short(std::f64::consts::TAU / count_rad),
                short(config.timing.period_s * 1e3),
                short(scene.start.velocity)
            ),
            verdict: format!("region {region}; (10) {holds} at the start; outcome: {class}"),
            class: report.class,
            point,
            speed: speed_rad_s * config.timing.period_s / count_rad,
            zero_rad: config.shape.zero_rad(),
            wall: matches!(config.shape, Shape::Wall { .. }),
            count_rad,
            envelope,
        })
    }

    /// The picture.
    pub fn svg(&self) -> Result<String> {
        let height = if self.class == Class::LimitCycle {
            640
        } else {
            500
        };
        page((1120, height), |page| {
            page.draw_text(&self.title, &letters(TITLE + 2, BLACK), (20, 12))
                .map_err(trouble)?;
            page.draw_text(&self.verdict, &letters(LABEL, GREY), (20, 40))
                .map_err(trouble)?;
            let (_, charts) = page.split_vertically(58);
            let (left, right) = charts.split_horizontally(460);
            let (left, _) = left.split_vertically(442);
            self.plane(&left)?;
            if self.class == Class::LimitCycle {
                let (above, below) = right.split_vertically((height - 58) / 2);
                self.time(&above)?;
                self.ending(&below)
            } else {
                self.time(&right)
            }
        })
    }

    fn plane(&self, area: &Area<'_>) -> Result<()> {
        let Dimensionless { beta, sigma, .. } = self.point;
        // The axes grow to the point, but not so far that the regions become too small to see.
        let end = |value: f64| match 1.15 * value {
            end if (1.0..=6.0).contains(&end) => end,
            _ => 1.0,
        };
        let (right, top) = (end(beta), end(sigma));
        let mut plane = Plane::new(area, "critical line of the start", 0.0..right, 0.0..top)?;
        plane.regions()?;
        plane.borders()?;
        plane.critical_line(self.speed, PURPLE)?;
        plane.region_letters(GREY)?;
        let mut text = format!("({}, {})", short(beta), short(sigma));
        if beta > right || sigma > top {
            text += ", off the chart";
        }
        plane.characteristic_point(self.point, &text)
    }

    /// The whole run with ±1 count, and the wall where there is one.
    fn time(&self, area: &Area<'_>) -> Result<()> {
        let zero = self.zero_rad;
        let mut levels = vec![
            Level {
                angle_rad: zero + self.count_rad,
                colour: GREY,
                name: Some("±1 count"),
            },
            Level {
                angle_rad: zero - self.count_rad,
                colour: GREY,
                name: None,
            },
        ];
        if self.wall {
            levels.push(Level {
                angle_rad: zero,
                colour: ORANGE,
                name: Some("edge of the wall"),
            });
        }
        curve(
            area,
            "angle against time",
            "time, s",
            self.envelope.line().collect(),
            &levels,
        )
    }

    /// The last samples, large: a limit cycle may be much smaller than a count.
    fn ending(&self, area: &Area<'_>) -> Result<()> {
        let title = format!("the last {ENDING} samples, enlarged");
        let ending = &self.envelope.ending;
        let end_s = ending.back().map_or(0.0, |last| last.0);
        let points = ending
            .iter()
            .map(|(time_s, angle)| ((time_s - end_s) * 1e3, *angle));
        curve(
            area,
            &title,
            "time before the end, ms",
            points.collect(),
            &[],
        )
    }
}

/// An angle that is marked across a chart.
struct Level {
    angle_rad: f64,
    colour: RGBColor,
    name: Option<&'static str>,
}

/// Angles (rad) against time, with levels and a legend if there are any. Where they differ
/// by little, far from zero, what they share stands at the axis.
fn curve(
    area: &Area<'_>,
    title: &str,
    time_name: &str,
    points: Vec<(f64, f64)>,
    levels: &[Level],
) -> Result<()> {
    let angles = points
        .iter()
        .map(|point| point.1)
        .chain(levels.iter().map(|level| level.angle_rad));
    let (low, high) = angles.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), angle| {
        (low.min(angle), high.max(angle))
    });
    let span = (high - low).max(1e-9);
    let shared = if low.abs().max(high.abs()) > 1e4 * span {
        let unit = 10_f64.powf(span.log10().ceil() + 1.0);
        (low / unit).round() * unit
    } else {
        0.0
    };
    let name = match shared {
        0.0 => "angle, rad".to_owned(),
        _ if shared < 0.0 => format!("angle + {}, rad", digits(-shared, 12)),
        _ => format!("angle − {}, rad", digits(shared, 12)),
    };
    let margin = 0.06 * span;
    // Room for the legend above the curve.
    let head = if levels.is_empty() {
        margin
    } else {
        4.0 * margin
    };
    let angles = low - shared - margin..high - shared + head;
    let start = points.first().map_or(0.0, |point| point.0);
    let end = points.last().map_or(1.0, |point| point.0).max(start + 1e-9);
    let mut chart = ChartBuilder::on(area)
        .caption(title, letters(TITLE, BLACK))
        .margin(12)
        .x_label_area_size(46)
        .y_label_area_size(78)
        .build_cartesian_2d(start..end, angles.clone())
        .map_err(trouble)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(FAINT)
        .x_desc(time_name)
        .y_desc(name)
        .label_style(letters(SMALL, BLACK))
        .axis_desc_style(letters(LABEL, BLACK))
        .y_label_formatter(&|angle| tick(*angle, angles.end - angles.start))
        .x_label_formatter(&|time| tick(*time, end - start))
        .draw()
        .map_err(trouble)?;
    let points = points
        .into_iter()
        .map(|(time, angle)| (time, angle - shared));
    chart
        .draw_series(LineSeries::new(points, BLUE.stroke_width(2)))
        .map_err(trouble)?
        .label("angle")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 22, y)], BLUE.stroke_width(2)));
    for level in levels {
        let angle = level.angle_rad - shared;
        let style = level.colour.stroke_width(2);
        let dashes = DashedLineSeries::new([(start, angle), (end, angle)], 6, 4, style);
        let series = chart.draw_series(dashes).map_err(trouble)?;
        if let Some(name) = level.name {
            series
                .label(name)
                .legend(move |(x, y)| DashedPathElement::new([(x, y), (x + 22, y)], 6, 4, style));
        }
    }
    if levels.is_empty() {
        return Ok(());
    }
    legend(&mut chart)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_envelope_keeps_the_extremes_of_any_length() {
        for samples in [1_u32, 2, 2999, 3000, 3001, 100_000] {
            let mut envelope = Envelope::new();
            for i in 0..samples {
                let spike = if i == samples / 2 { 5.0 } else { 0.0 };
                envelope.enter(f64::from(i), (f64::from(i) * 0.1).sin() + spike);
            }
            assert!(envelope.stretches.len() <= Envelope::MOST);
            let high = envelope.line().fold(f64::MIN, |high, (_, y)| high.max(y));
            let want = (f64::from(samples / 2) * 0.1).sin() + 5.0;
            assert!((high - want).abs() < 1e-12, "{samples}: {high}, not {want}");
            let times: Vec<f64> = envelope.line().map(|(t, _)| t).collect();
            assert!(times.is_sorted());
        }
    }
}
