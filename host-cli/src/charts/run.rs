//! One run of a scene, as Fig. 6 of the paper: the characteristic point and the critical line
//! of the start on the left, angle against time with ±1 count on the right. Where a hand, a
//! detent or the ledger leaves that point no meaning, torque and account stand in its place.

use std::collections::VecDeque;

use anyhow::Result;
use control::config::Law;
use control::criterion::{Dimensionless, Region};
use control::shape::Shape;
use plant_sim::closed_loop::{Report, Sample};
use plant_sim::outcome::Class;
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use super::plane::Plane;
use super::style::{
    Area, BLUE, FAINT, GREEN, GREY, LABEL, ORANGE, PURPLE, RED, SMALL, TITLE, legend, letters,
    page, tick, trouble,
};
use crate::number::{digits, short};
use crate::reasons;
use crate::scene::Loaded;

/// The smallest and the largest of a quantity over stretches of time: as many as a picture
/// can show, however long the run.
struct Envelope {
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

    fn new() -> Self {
        Self {
            stretches: Vec::new(),
            stride: 1,
            in_last: u64::MAX,
            ending: VecDeque::new(),
        }
    }

    /// Enters the next sample.
    fn enter(&mut self, time_s: f64, value: f64) {
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

/// What is drawn against time.
pub struct Curves {
    angle: Envelope,
    torque: Envelope,
    account: Envelope,
    /// At the last sample.
    law: Law,
    reason: &'static str,
}

impl Curves {
    pub fn new() -> Self {
        Self {
            angle: Envelope::new(),
            torque: Envelope::new(),
            account: Envelope::new(),
            law: Law::Raw,
            reason: "",
        }
    }

    /// Enters the next sample.
    pub fn enter(&mut self, time_s: f64, sample: &Sample) {
        let tick = &sample.tick;
        self.angle.enter(time_s, sample.state.position);
        self.torque.enter(time_s, f64::from(tick.torque_nm));
        self.account.enter(time_s, f64::from(tick.account_j));
        self.law = tick.law;
        self.reason = reasons::words(tick.reason);
    }

    /// Enters where the last sample led to.
    pub fn end(&mut self, time_s: f64, angle_rad: f64) {
        self.angle.enter(time_s, angle_rad);
    }
}

/// What the chart of a run shows.
pub struct RunChart<'a> {
    title: String,
    verdict: String,
    class: Class,
    left: Left,
    shape: Shape,
    /// Where the hand's spring is slack, if it has one, rad.
    hand_rest_rad: Option<f64>,
    count_rad: f64,
    curves: &'a Curves,
}

/// What stands beside the angle.
enum Left {
    /// The plane of Fig. 3: a spring or a wall of constant stiffness, and nobody's hand.
    Plane {
        point: Dimensionless<f64>,
        /// The speed that the start can turn into, counts per sample.
        speed: f64,
    },
    Torque,
    TorqueAndAccount,
}

impl<'a> RunChart<'a> {
    pub fn new(name: &str, loaded: &Loaded, report: &Report, curves: &'a Curves) -> Result<Self> {
        let scene = &loaded.scene;
        let config = &scene.config;
        let count_rad = config.count_rad();
        let criterion = loaded.criterion()?;
        let applied = report.max_stiffness_nm_rad;
        let point = criterion.dimensionless(applied);
        let speed_rad_s = scene.reachable_speed_rad_s(applied);
        let outcome = match report.class {
            Class::Rest => "comes to rest",
            Class::LimitCycle => "limit cycle",
            Class::Unstable => "grows without bound",
            Class::Undecided => "undecided",
        };
        let detent = matches!(config.shape, Shape::Detent { .. });
        let left = match config.law {
            Law::Ledger | Law::Auto => Left::TorqueAndAccount,
            Law::Raw | Law::Static | Law::Episode if detent || loaded.has_hand() => Left::Torque,
            Law::Raw | Law::Static | Law::Episode => {
                let sampling = criterion.sampling();
                Left::Plane {
                    point,
                    speed: speed_rad_s * sampling.period_s / sampling.count_rad,
                }
            }
        };
        let verdict = if let Left::Plane { .. } = left {
            let region = match point.region() {
                Region::GloballyPassive => "(a), passive",
                Region::Unstable => "(b), unstable",
                Region::LimitCycle => "(c), limit cycles",
                Region::LocallyPassive => "(d), passive while slow",
            };
            let holds = if criterion.power_margin_nm(applied, speed_rad_s) >= 0.0 {
                "holds"
            } else {
                "does not hold"
            };
            format!("region {region}; (10) {holds} at the start; outcome: {outcome}")
        } else {
            format!("at the end: {}; outcome: {outcome}", curves.reason)
        };
        let law = match (config.law, curves.law) {
            (Law::Auto, in_force) => format!("auto, {} at the end", reasons::law(in_force)),
            (law, _) => reasons::law(law).to_owned(),
        };
        let (demand, least) = (config.stiffness_nm_rad, report.min_stiffness_nm_rad);
        // The controller's f32 of the same number is the whole demand.
        let whole = (applied - demand).abs() <= 1e-6 * demand && applied == least;
        let stiffness = match (whole, least == applied) {
            (true, _) => format!("K = {} Nm/rad", short(demand)),
            (false, true) => format!(
                "K = {} Nm/rad of {} demanded",
                short(applied),
                short(demand)
            ),
            (false, false) => format!(
                "K = {} to {} Nm/rad of {} demanded",
                short(least),
                short(applied),
                short(demand)
            ),
        };
        Ok(Self {
            title: format!(
                "{name}: {law}, {stiffness}, {} counts/rev, T = {} ms, from {} rad/s",
                short(std::f64::consts::TAU / count_rad),
                short(config.timing.period_s * 1e3),
                short(scene.start.velocity)
            ),
            verdict,
            class: report.class,
            left,
            shape: config.shape,
            hand_rest_rad: (scene.hand.stiffness_nm_rad > 0.0).then_some(scene.hand.rest_rad),
            count_rad,
            curves,
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
            let middle = (height - 58) / 2;
            match &self.left {
                Left::Plane { point, speed } => {
                    let (left, _) = left.split_vertically(442);
                    plane(&left, *point, *speed)?;
                }
                Left::Torque => self.torque(&left)?,
                Left::TorqueAndAccount => {
                    let (above, below) = left.split_vertically(middle);
                    self.torque(&above)?;
                    let account = Curve {
                        title: "energy in the ledger's account",
                        quantity: "account",
                        unit: "J",
                        colour: GREEN,
                        ..Curve::default()
                    };
                    account.draw(&below, self.curves.account.line().collect(), &[])?;
                }
            }
            if self.class == Class::LimitCycle {
                let (above, below) = right.split_vertically(middle);
                self.time(&above)?;
                self.ending(&below)
            } else {
                self.time(&right)
            }
        })
    }

    fn torque(&self, area: &Area<'_>) -> Result<()> {
        let torque = Curve {
            title: "torque against time",
            quantity: "torque",
            unit: "Nm",
            colour: RED,
            ..Curve::default()
        };
        torque.draw(area, self.curves.torque.line().collect(), &[])
    }

    /// The whole run, with what is rendered: ±1 count about a spring's centre, the edge of a wall,
    /// the minima of a detent.
    fn time(&self, area: &Area<'_>) -> Result<()> {
        let points: Vec<_> = self.curves.angle.line().collect();
        let count = |angle_rad, name| Level {
            angle_rad,
            colour: GREY,
            name,
        };
        let zero = self.shape.zero_rad();
        let mut levels = match self.shape {
            Shape::Detent { period_rad, .. } => minima(&points, zero, period_rad),
            Shape::Spring { .. } | Shape::Wall { .. } => vec![
                count(zero + self.count_rad, Some("±1 count")),
                count(zero - self.count_rad, None),
            ],
        };
        if let Shape::Wall { .. } = self.shape {
            levels.push(Level {
                angle_rad: zero,
                colour: ORANGE,
                name: Some("edge of the wall"),
            });
        }
        if let Some(angle_rad) = self.hand_rest_rad {
            levels.push(Level {
                angle_rad,
                colour: PURPLE,
                name: Some("place of the hand"),
            });
        }
        Curve::default().draw(area, points, &levels)
    }

    /// The last samples, large: a limit cycle may be much smaller than a count.
    fn ending(&self, area: &Area<'_>) -> Result<()> {
        let ending = &self.curves.angle.ending;
        let end_s = ending.back().map_or(0.0, |last| last.0);
        let points = ending
            .iter()
            .map(|(time_s, angle)| ((time_s - end_s) * 1e3, *angle));
        let curve = Curve {
            title: &format!("the last {ENDING} samples, enlarged"),
            time: "time before the end, ms",
            ..Curve::default()
        };
        curve.draw(area, points.collect(), &[])
    }
}

/// The point and the critical line of the start among the regions.
fn plane(area: &Area<'_>, point: Dimensionless<f64>, speed: f64) -> Result<()> {
    let Dimensionless { beta, sigma, .. } = point;
    // The axes grow to the point, but not so far that the regions become too small to see.
    let end = |value: f64| match 1.15 * value {
        end if (1.0..=6.0).contains(&end) => end,
        _ => 1.0,
    };
    let (right, top) = (end(beta), end(sigma));
    let mut plane = Plane::new(area, "critical line of the start", 0.0..right, 0.0..top)?;
    plane.regions()?;
    plane.borders()?;
    plane.critical_line(speed, PURPLE)?;
    plane.region_letters(GREY)?;
    let mut text = format!("({}, {})", short(beta), short(sigma));
    if beta > right || sigma > top {
        text += ", off the chart";
    }
    plane.characteristic_point(point, &text)
}

/// The minima of a detent that a run passes, and one more; none if they would fill the chart.
fn minima(points: &[(f64, f64)], centre_rad: f64, period_rad: f64) -> Vec<Level> {
    const MOST: f64 = 40.0;
    let turns = |angle: f64| ((angle - centre_rad) / period_rad).round();
    let ends = points
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), point| {
            (low.min(turns(point.1)), high.max(turns(point.1)))
        });
    if !(0.0..=MOST).contains(&(ends.1 - ends.0)) {
        return Vec::new();
    }
    let count = (ends.1 - ends.0) as usize + 1;
    let level = |i: usize| Level {
        angle_rad: centre_rad + (ends.0 + i as f64) * period_rad,
        colour: ORANGE,
        name: (i == 0).then_some("detents"),
    };
    (0..count).map(level).collect()
}

/// An angle that is marked across a chart.
struct Level {
    angle_rad: f64,
    colour: RGBColor,
    name: Option<&'static str>,
}

/// A quantity against time: the angle, unless told otherwise.
struct Curve<'a> {
    title: &'a str,
    time: &'a str,
    quantity: &'static str,
    unit: &'static str,
    colour: RGBColor,
}

impl Default for Curve<'_> {
    fn default() -> Self {
        Self {
            title: "angle against time",
            time: "time, s",
            quantity: "angle",
            unit: "rad",
            colour: BLUE,
        }
    }
}

impl Curve<'_> {
    /// Draws it, with levels and a legend if there are any. Where the values differ by little, far
    /// from zero, what they share stands at the axis.
    fn draw(&self, area: &Area<'_>, points: Vec<(f64, f64)>, levels: &[Level]) -> Result<()> {
        let (quantity, unit, style) = (self.quantity, self.unit, self.colour.stroke_width(2));
        let values = points
            .iter()
            .map(|point| point.1)
            .chain(levels.iter().map(|level| level.angle_rad));
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        let span = (high - low).max(1e-12);
        let shared = if low.abs().max(high.abs()) > 1e4 * span {
            let unit = 10_f64.powf(span.log10().ceil() + 1.0);
            (low / unit).round() * unit
        } else {
            0.0
        };
        let name = match shared {
            0.0 => format!("{quantity}, {unit}"),
            _ if shared < 0.0 => format!("{quantity} + {}, {unit}", digits(-shared, 12)),
            _ => format!("{quantity} − {}, {unit}", digits(shared, 12)),
        };
        let margin = 0.06 * span;
        // Room for the legend above the curve.
        let head = match levels.iter().filter(|level| level.name.is_some()).count() {
            0 => margin,
            named => 2.0 * named.max(2) as f64 * margin,
        };
        let values = low - shared - margin..high - shared + head;
        let start = points.first().map_or(0.0, |point| point.0);
        let end = points.last().map_or(1.0, |point| point.0).max(start + 1e-9);
        let mut chart = ChartBuilder::on(area)
            .caption(self.title, letters(TITLE, BLACK))
            .margin(12)
            .x_label_area_size(46)
            .y_label_area_size(78)
            .build_cartesian_2d(start..end, values.clone())
            .map_err(trouble)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(FAINT)
            .x_desc(self.time)
            .y_desc(name)
            .y_labels(if area.dim_in_pixel().1 < 300 { 6 } else { 10 })
            .label_style(letters(SMALL, BLACK))
            .axis_desc_style(letters(LABEL, BLACK))
            .y_label_formatter(&|value| tick(*value, values.end - values.start))
            .x_label_formatter(&|time| tick(*time, end - start))
            .draw()
            .map_err(trouble)?;
        let points = points
            .into_iter()
            .map(|(time, value)| (time, value - shared));
        chart
            .draw_series(LineSeries::new(points, style))
            .map_err(trouble)?
            .label(quantity)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], style));
        for level in levels {
            let value = level.angle_rad - shared;
            let style = level.colour.stroke_width(2);
            let dashes = DashedLineSeries::new([(start, value), (end, value)], 6, 4, style);
            let series = chart.draw_series(dashes).map_err(trouble)?;
            if let Some(name) = level.name {
                series.label(name).legend(move |(x, y)| {
                    DashedPathElement::new([(x, y), (x + 22, y)], 6, 4, style)
                });
            }
        }
        if levels.is_empty() {
            return Ok(());
        }
        legend(&mut chart)
    }
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
