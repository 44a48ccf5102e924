//! How stiff a device can be: stiffness against speed, and the device in the (β, σ) plane.

use anyhow::Result;
use control::criterion::Criterion;
use plotters::prelude::*;

use super::plane::Plane;
use super::style::{
    Area, BLUE, FAINT, GREEN, GREY, LABEL, ORANGE, PURPLE, RED, SMALL, TITLE, clip, legend,
    letters, page, trouble,
};
use crate::commands::plan::describing_function_stiffness;
use crate::number::short;

/// Speeds shown, rad/s.
const SPEED: std::ops::Range<f64> = 0.1..100.0;

/// What the chart shows.
pub struct PlanChart<'a> {
    name: &'a str,
    criterion: Criterion<f64>,
    wanted: Option<f64>,
}

impl<'a> PlanChart<'a> {
    pub fn new(name: &'a str, criterion: Criterion<f64>, wanted: Option<f64>) -> Self {
        Self {
            name,
            criterion,
            wanted,
        }
    }

    /// The picture.
    pub fn svg(&self) -> Result<String> {
        page((1180, 560), |page| {
            let (left, right) = page.split_horizontally(640);
            self.stiffness(&left)?;
            self.plane(&right)
        })
    }

    fn stiffness(&self, area: &Area<'_>) -> Result<()> {
        let criterion = &self.criterion;
        let (viscous, coulomb) = (criterion.viscous_limit(), criterion.coulomb_limit());
        let speeds =
            (0..=120).map(|i| SPEED.start * (SPEED.end / SPEED.start).powf(f64::from(i) / 120.0));
        let passive: Vec<_> = speeds
            .clone()
            .map(|v| (v, criterion.largest_stiffness_at(v).min(coulomb)))
            .collect();
        let growing: Vec<_> = speeds
            .filter_map(|v| Some((v, describing_function_stiffness(criterion, v)?)))
            .collect();
        let shown = [viscous, coulomb, self.wanted.unwrap_or(coulomb)]
            .into_iter()
            .chain(passive.iter().map(|p| p.1));
        let shown: Vec<f64> = shown.filter(|k| *k > 0.0).collect();
        let low = shown.iter().copied().fold(f64::INFINITY, f64::min) / 2.5;
        let high = shown.iter().copied().fold(0.0, f64::max) * 2.5;
        // Without any friction nothing is passive: an empty frame says so.
        let range = if low.is_finite() && high > low {
            low..high
        } else {
            1e-3..1.0
        };
        let mut chart = ChartBuilder::on(area)
            .caption(
                format!("{}: how stiff at which speed", self.name),
                letters(TITLE, BLACK),
            )
            .margin(12)
            .x_label_area_size(46)
            .y_label_area_size(70)
            .build_cartesian_2d(SPEED.log_scale(), range.clone().log_scale())
            .map_err(trouble)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(FAINT)
            .x_desc("speed, rad/s")
            .y_desc("stiffness, Nm/rad")
            .label_style(letters(SMALL, BLACK))
            .axis_desc_style(letters(LABEL, BLACK))
            .x_label_formatter(&|v| short(*v))
            .y_label_formatter(&|k| short(*k))
            .draw()
            .map_err(trouble)?;
        let level = |k: f64| vec![(SPEED.start, k), (SPEED.end, k)];
        let mut curves = vec![
            (passive, GREEN, 3, "passive by (11) and 2c/Δ".to_owned()),
            (
                growing,
                RED,
                2,
                "growth expected (describing function)".to_owned(),
            ),
            (
                level(viscous),
                BLUE,
                1,
                format!("2b/T = {}", short(viscous)),
            ),
            (
                level(coulomb),
                ORANGE,
                1,
                format!("2c/Δ = {}", short(coulomb)),
            ),
        ];
        if let Some(wanted) = self.wanted {
            curves.push((
                level(wanted),
                PURPLE,
                2,
                format!("wanted: {}", short(wanted)),
            ));
        }
        for (points, colour, width, name) in curves {
            // Cut at the frame in the coordinates in which the frame is a rectangle.
            let log = |p: &(f64, f64)| (p.0.log10(), p.1.max(1e-300).log10());
            let back = |p: (f64, f64)| (10_f64.powf(p.0), 10_f64.powf(p.1));
            let frame = (
                SPEED.start.log10()..SPEED.end.log10(),
                range.start.log10()..range.end.log10(),
            );
            let pieces = points.windows(2).filter_map(|ends| {
                let cut = clip(
                    log(&ends[0]),
                    log(&ends[1]),
                    frame.0.clone(),
                    frame.1.clone(),
                )?;
                Some(PathElement::new(cut.map(back), colour.stroke_width(width)))
            });
            chart
                .draw_series(pieces)
                .map_err(trouble)?
                .label(name)
                .legend(move |(x, y)| {
                    PathElement::new([(x, y), (x + 22, y)], colour.stroke_width(width))
                });
        }
        legend(&mut chart)
    }

    /// The device at the wanted stiffness, or at the largest that is passive at every speed,
    /// and where half the period, half the count and twice the stiffness would put it. Over
    /// logarithms each of these is a step of the same length, and the stiffness moves the
    /// device along a diagonal.
    fn plane(&self, area: &Area<'_>) -> Result<()> {
        let stiffness = self.wanted.unwrap_or(self.criterion.largest_stiffness());
        if stiffness == 0.0 {
            let at = (40, 40);
            area.draw_text(
                "2b/T or 2c/Δ is 0: no stiffness is passive at every speed",
                &letters(LABEL, GREY),
                at,
            )
            .map_err(trouble)?;
            return Ok(());
        }
        let point = self.criterion.dimensionless(stiffness);
        let log = |value: f64| value.clamp(1e-6, 1e6).log10();
        // A friction of zero lies infinitely far out: the point is put at the edge.
        let place = |value: f64| match value {
            0.0 => (-1.0, -1.0..1.0),
            _ => {
                let at = log(value);
                (at, (at - 0.5).min(-1.0).floor()..(at + 0.6).max(1.0).ceil())
            }
        };
        let ((beta, beta_range), (sigma, sigma_range)) = (place(point.beta), place(point.sigma));
        let title = match self.wanted {
            Some(_) => format!("at the wanted {} Nm/rad", short(stiffness)),
            None => format!("at {} Nm/rad, passive at every speed", short(stiffness)),
        };
        let mut plane = Plane::logarithmic(area, &title, beta_range, sigma_range)?;
        plane.regions()?;
        plane.borders()?;
        plane.region_letters(GREY)?;
        if point.beta > 0.0 && point.sigma > 0.0 {
            // All stiffnesses.
            let far = 20.0;
            plane.line(
                (beta - far, sigma - far),
                (beta + far, sigma + far),
                GREY.stroke_width(1),
            )?;
            let step = 2.0_f64.log10();
            for (to, shift, colour, text) in [
                ((beta - step, sigma - step), (-58, 2), RED, "twice K"),
                ((beta + step, sigma), (6, -8), BLUE, "half T"),
                ((beta, sigma + step), (-16, -20), GREEN, "half Δ"),
            ] {
                plane.arrow((beta, sigma), to, colour)?;
                plane.write(to, shift, text, LABEL, colour)?;
            }
        }
        plane.dot((beta, sigma), BLACK)?;
        let text = format!("({}, {})", short(point.beta), short(point.sigma));
        plane.write((beta, sigma), (12, 12), &text, LABEL, BLACK)
    }
}
