//! How stiff each law gets against what its tick costs.

use anyhow::Result;
use plant_sim::compare::Spread;
use plant_sim::suite::Contender;

use super::loglog::{Curve, Look, Mark, Panel, draw, sentences, sentences_height, wrapped};
use super::stiffness::look as stiffness_look;
use super::style::page;
use crate::commands::chart::report::{laws_conclusion, laws_notes};
use crate::commands::chart::{Figures, LawMeasured};

const PLOT_HEIGHT: u32 = 470;
const WIDTH: u32 = 1300;

/// Letters that fit in a line.
const LINE: usize = 182;

/// What is written at a point.
fn label(law: Contender) -> &'static str {
    match law {
        Contender::Static => "static",
        Contender::EnergyBounding => "energy bounding",
        Contender::Raw => "raw spring*",
        Contender::Episode => "episode-peak criterion",
        Contender::PassivityControl => "passivity control*",
        Contender::VirtualDamping => "virtual damping*",
        Contender::Ledger => "energy ledger",
        Contender::Auto => "auto",
    }
}

/// The picture.
pub fn picture(figures: &Figures) -> Result<String> {
    let conclusion = wrapped(&laws_conclusion(figures), LINE);
    let notes = format!(
        "Static stiffness without a bad run over Abbott and Okamura's bound min(2b/T, 2c/Δ), geometric mean over {} devices, as `knob stiffness` measures it. * K found offline: does not clamp itself. {} Times: recorded counters, one thread, medians of interleaved rounds; bars: quartiles.",
        figures.devices,
        laws_notes()
    );
    let notes = wrapped(&notes, LINE * 15 / 13);
    let text_height = sentences_height(&conclusion, &notes);
    page((WIDTH, PLOT_HEIGHT + text_height), |page| {
        let (plots, text) = page.split_vertically(PLOT_HEIGHT);
        let areas = plots.split_evenly((1, 2));
        let native = |law: &LawMeasured| Some(law.tick_ns);
        let counted = |law: &LawMeasured| {
            let count = law.instructions? as f64;
            Some(Spread {
                low: count,
                median: count,
                high: count,
            })
        };
        if let [left, right] = &areas[..] {
            let panel = panel(
                figures,
                "Stiffness against time on this machine",
                "time per tick, ns",
                native,
            );
            draw(left, &panel, &curves(figures, native))?;
            let title = "Stiffness against instructions on the Cortex-M4";
            let panel = self::panel(figures, title, "instructions per tick", counted);
            draw(right, &panel, &curves(figures, counted))?;
        }
        sentences(&text, &conclusion, &notes)
    })
}

fn panel<'a>(
    figures: &Figures,
    title: &'a str,
    x_axis: &'a str,
    cost: impl Fn(&LawMeasured) -> Option<Spread>,
) -> Panel<'a> {
    let costs = || figures.laws.iter().filter_map(&cost);
    let least = costs().map(|cost| cost.low).fold(f64::INFINITY, f64::min);
    let most = costs().map(|cost| cost.high).fold(0.0, f64::max);
    let stiffness = || figures.laws.iter().filter_map(|law| law.static_over_ao);
    let softest = stiffness().fold(f64::INFINITY, f64::min);
    let stiffest = stiffness().fold(0.0, f64::max);
    Panel {
        title,
        x_axis,
        y_axis: "static stiffness, × AO",
        x: least / 2.0..most * 2.0,
        y: softest / 2.0..stiffest * 2.0,
        zero: None,
    }
}

/// One point per law: laws are not settings of one another.
fn curves(figures: &Figures, cost: impl Fn(&LawMeasured) -> Option<Spread>) -> Vec<Curve> {
    let curve = |law: &LawMeasured| {
        let (colour, _, _) = stiffness_look(law.law);
        let look = Look {
            colour,
            dashed: false,
            radius: if law.law == Contender::Ledger { 8 } else { 5 },
            hollow: law.instructions.is_none(),
        };
        let mark = Mark {
            x: cost(law)?,
            y: law.static_over_ao?,
            label: label(law.law).into(),
        };
        Some(Curve {
            look,
            marks: vec![mark],
        })
    };
    figures.laws.iter().filter_map(curve).collect()
}
