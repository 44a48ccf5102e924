//! What was measured, as a table, as JSON, as CSV and in sentences.

use std::fmt::Write as _;

use anyhow::Result;
use plant_sim::compare::{ADDED_OVER, AFTER, CLASSES, Plane, Spread};
use plant_sim::suite::Contender;
use serde_json::{Map, Value, json};

use super::{Family, Figures, LawMeasured, Measured, counted, rungs};
use crate::commands::stiffness::title;
use crate::number::{digits, short};

/// A class error below this is of interest.
const FEW: f64 = 0.02;

impl Figures {
    /// The methods of a family, in the order of their settings.
    pub fn family(&self, family: Family) -> impl Iterator<Item = &Measured> {
        self.methods.iter().filter(move |own| own.family == family)
    }

    fn exact(&self, family: Family) -> Option<&Measured> {
        self.family(family).next()
    }

    pub fn law(&self, law: Contender) -> Option<&LawMeasured> {
        self.laws.iter().find(|own| own.law == law)
    }

    pub fn cells(&self) -> usize {
        self.grid * self.grid
    }
}

fn ns(method: &Measured) -> f64 {
    method.times.all.median
}

/// The method with the shortest time.
fn fastest<'a>(methods: impl Iterator<Item = &'a Measured>) -> Option<&'a Measured> {
    methods.min_by(|a, b| ns(a).total_cmp(&ns(b)))
}

fn percent(share: f64) -> String {
    format!("{} %", digits(100.0 * share, 2))
}

/// An error, counts or energy, in two digits.
fn error(value: f64) -> String {
    if value.is_finite() {
        digits(value, 2)
    } else {
        "lost".into()
    }
}

/// Two digits.
fn times(ratio: f64) -> String {
    digits(ratio, 2)
}

/// What to conclude of the methods: of this run's figures, whatever they are.
pub fn conclusions(figures: &Figures) -> Vec<String> {
    let (Some(sweep), Some(one)) = (figures.exact(Family::Vector), figures.exact(Family::Exact))
    else {
        return vec![];
    };
    let mut all = vec![exact_alone(figures, sweep, one)];
    let against = |method: &Measured| {
        format!(
            "{} ns, {} × the exact map in a sweep, {} × it for one display",
            short(ns(method)),
            times(ns(method) / ns(sweep)),
            times(ns(method) / ns(one))
        )
    };
    let integrators = || {
        let methods = figures.methods.iter();
        methods.filter(|it| it.family.is_fixed_step() || it.family == Family::Dopri5)
    };
    all.push(match fastest(integrators().filter(|it| it.wrong == 0)) {
        Some(method) => format!(
            "The fastest integrator that has every class right too is {}: {}.",
            method.words(),
            against(method)
        ),
        None => "No integrator has every class right.".into(),
    });
    let good = || integrators().filter(|it| it.family.is_fixed_step() && it.class_error < FEW);
    all.push(match fastest(good()) {
        Some(method) => format!(
            "{} err on fewer than {} of the points, {}; the fastest of them, {}, takes {}.",
            match good().count() {
                1 => "One method of fixed steps".to_owned(),
                more => format!("{more} methods of fixed steps"),
            },
            percent(FEW),
            match good().filter(|it| it.wrong == 0).count() {
                0 => "but each on some".to_owned(),
                right => format!("{right} of them on none"),
            },
            method.words(),
            against(method)
        ),
        None => format!(
            "No method of fixed steps errs on fewer than {} of the points.",
            percent(FEW)
        ),
    });
    all.push(where_beaten(figures, sweep, one));
    all.extend(closed_form(figures));
    all
}

fn exact_alone(figures: &Figures, sweep: &Measured, one: &Measured) -> String {
    let [cells, differ] = figures.checked;
    format!(
        "The exact map has no error but rounding ({} counts after 1000 samples; 77 digits give {} of {cells} classes that were checked) at {} ns a sample in a sweep ({}) and {} ns for one display.",
        error(one.position[3].median),
        if differ == 0 {
            "the same".to_owned()
        } else {
            format!("{} the same", cells - differ)
        },
        short(ns(sweep)),
        figures.instruction_set,
        short(ns(one)),
    )
}

/// Where a method is faster than the exact map, or nearer to the truth.
fn where_beaten(figures: &Figures, sweep: &Measured, one: &Measured) -> String {
    let others = || {
        let methods = figures.methods.iter();
        methods.filter(|it| !matches!(it.family, Family::Vector | Family::Exact))
    };
    let list = |methods: Vec<String>| match methods.is_empty() {
        true => "nothing".to_owned(),
        false => methods.join(", "),
    };
    let faster = others().filter(|it| ns(it) < ns(one)).map(|it| {
        format!(
            "{} ({} ns, {} wrong)",
            it.words(),
            short(ns(it)),
            percent(it.class_error)
        )
    });
    let cycles = |method: &Measured| method.times.by_class[1].map(|spread| spread.median);
    let on_cycles = others()
        .filter(|it| {
            cycles(it)
                .zip(cycles(one))
                .is_some_and(|(own, exact)| own < exact)
        })
        .map(|it| {
            format!(
                "{} ({} ns)",
                it.words(),
                cycles(it).map_or("–".into(), short)
            )
        });
    let than_sweep = others()
        .filter(|it| ns(it) < ns(sweep))
        .map(Measured::words);
    let nearer = AFTER.iter().enumerate().flat_map(|(place, after)| {
        others()
            .filter(move |it| it.position[place].median < one.position[place].median)
            .map(move |it| format!("{} after {after}", it.words()))
    });
    format!(
        "Faster than the exact map for one display: {}; on limit cycles alone, where it takes {} ns: {}. Faster than its sweep: {}. Nearer to the truth: {}.",
        list(faster.collect()),
        cycles(one).map_or("–".into(), short),
        list(on_cycles.collect()),
        list(than_sweep.collect()),
        list(nearer.collect()),
    )
}

/// The textbook's closed form is its own kind.
fn closed_form(figures: &Figures) -> Option<String> {
    let textbook = figures.exact(Family::ClosedForm)?;
    let small = |family| {
        let rates = figures
            .small_rates
            .iter()
            .filter(move |it| it.family == family);
        let errors = rates.map(|it| error(it.position.median));
        errors.collect::<Vec<String>>().join(" and ")
    };
    let rates = figures
        .small_rates
        .iter()
        .filter(|it| it.family == Family::Exact);
    let rates: Vec<String> = rates.map(|it| short(it.beta_over_mu)).collect();
    Some(format!(
        "The closed form as textbooks write it is its own kind: {} of the classes wrong and {} counts off after 1000 samples at {} ns here, but {} at β/μ = {} (the exact map: {}).",
        percent(textbook.class_error),
        error(textbook.position[3].median),
        short(ns(textbook)),
        small(Family::ClosedForm),
        rates.join(" and "),
        small(Family::Exact),
    ))
}

/// What to conclude of the laws.
pub fn laws_conclusion(figures: &Figures) -> String {
    let of = |law| {
        let law = figures.law(law)?;
        Some((law.static_over_ao?, law.tick_ns.median, law.instructions))
    };
    let count = |count: Option<u64>| count.map_or("–".into(), |count| count.to_string());
    let mut text = String::new();
    if let (Some(ledger), Some(raw)) = (of(Contender::Ledger), of(Contender::Raw)) {
        text += &format!(
            "The energy ledger renders {} times what 2b/T and 2c/Δ allow, and {} times what a raw spring tuned offline does, for {} instructions a tick instead of {} ({} ns instead of {} here): stiffness bought with computing.",
            times(ledger.0),
            times(ledger.0 / raw.0),
            count(ledger.2),
            count(raw.2),
            short(ledger.1),
            short(raw.1),
        );
    }
    text
}

/// What to know of the laws' figures.
pub fn laws_notes() -> String {
    format!(
        "Energy bounding, passivity control and virtual damping (hollow) are not in the firmware: no instructions counted. Auto's count is with all that a tick can be asked for at once (detents, damping, delay, lag, jitter, torque steps), the others' for a plain spring; the ledger that looks 4 ticks back instead of 8 takes {}.",
        counted("tick_ledger_four_ticks_back_instructions").map_or("–".into(), |n| n.to_string())
    )
}

/// How the methods' figures were taken.
pub fn methods_notes(figures: &Figures) -> String {
    format!(
        "μ = 50. Classes: {g} × {g} cells of β, σ in [0, 1], from 10 counts per sample, {} samples{}. Position and energy (first {ADDED_OVER} samples): medians of {} random displays that keep moving, against 77 digits. Times: one thread, {} cells of the same plane, medians of {} interleaved rounds; bars: quartiles.",
        Plane::SAMPLES,
        if figures.quick { " (--quick)" } else { "" },
        figures.displays,
        figures.timed_cells,
        figures.rounds,
        g = figures.grid,
    )
}

/// What is printed.
pub fn text(figures: &Figures) -> Result<String> {
    let mut text = String::new();
    writeln!(
        text,
        "{:<16} {:>10} {:>21}  {:>14} {:>13} {:>13}",
        "method", "ns/sample", "quartiles", "wrong classes", "after 1000", "added energy"
    )?;
    writeln!(
        text,
        "{:<16} {:>10} {:>21}  {:>14} {:>13} {:>13}",
        "",
        "",
        "",
        format!("of {}", figures.cells()),
        "counts",
        "KΔ²/sample"
    )?;
    for method in &figures.methods {
        let Spread { low, median, high } = method.times.all;
        let wrong = format!("{} = {}", method.wrong, percent(method.class_error));
        writeln!(
            text,
            "{:<16} {:>10} {:>21}  {wrong:>14} {:>13} {:>13}",
            method.name(),
            short(median),
            format!("{} – {}", short(low), short(high)),
            error(method.position[3].median),
            error(method.added.median),
        )?;
    }
    writeln!(text, "\n{}\n", methods_notes(figures))?;
    for sentence in conclusions(figures) {
        writeln!(text, "- {sentence}")?;
    }
    writeln!(
        text,
        "\n{:<36} {:>10} {:>9} {:>17} {:>13}",
        "law", "stiffness", "ns/tick", "quartiles", "instructions"
    )?;
    writeln!(text, "{:<36} {:>10}", "", "× AO")?;
    for law in &figures.laws {
        let Spread { low, median, high } = law.tick_ns;
        writeln!(
            text,
            "{:<36} {:>10} {:>9} {:>17} {:>13}",
            title(law.law),
            law.static_over_ao.map_or("–".into(), short),
            short(median),
            format!("{} – {}", short(low), short(high)),
            law.instructions
                .map_or("–".into(), |count| count.to_string()),
        )?;
    }
    writeln!(
        text,
        "\n- {}\n- {}\n",
        laws_conclusion(figures),
        laws_notes()
    )?;
    text += &rungs::text(&figures.ladders)?;
    Ok(text)
}

/// As JSON; an infinite error, a result that is lost, is null.
fn spread_json(spread: &Spread) -> Value {
    json!({ "median": spread.median, "low": spread.low, "high": spread.high })
}

fn method_json(method: &Measured) -> Value {
    let by_class = CLASSES.iter().zip(&method.times.by_class);
    let by_class: Map<String, Value> = by_class
        .map(|(class, spread)| {
            (
                class.to_string(),
                spread.as_ref().map_or(Value::Null, spread_json),
            )
        })
        .collect();
    let position = AFTER.iter().zip(&method.position);
    let position: Map<String, Value> = position
        .map(|(after, spread)| (after.to_string(), spread_json(spread)))
        .collect();
    json!({
        "method": method.name(),
        "family": method.family.key(),
        "setting": method.setting.parse::<f64>().ok(),
        "ns_per_sample": spread_json(&method.times.all),
        "ns_per_sample_by_class": by_class,
        "position_error_counts": position,
        "added_energy_per_sample": spread_json(&method.added),
        "wrong_cells": method.wrong,
        "class_error": method.class_error,
    })
}

/// What `--json` prints.
pub fn json(figures: &Figures) -> Value {
    let small: Vec<Value> = figures
        .small_rates
        .iter()
        .map(|it| {
            json!({
                "method": it.family.key(),
                "beta_over_mu": it.beta_over_mu,
                "position_error_counts": { "1000": spread_json(&it.position) },
            })
        })
        .collect();
    let laws: Vec<Value> = figures
        .laws
        .iter()
        .map(|it| {
            json!({
                "law": it.law.as_str(),
                "static_over_ao": it.static_over_ao,
                "ns_per_tick": spread_json(&it.tick_ns),
                "instructions_per_tick": it.instructions,
            })
        })
        .collect();
    json!({
        "quick": figures.quick,
        "mu": 50.0,
        "grid": figures.grid,
        "map_v0": Plane::V0,
        "map_samples": Plane::SAMPLES,
        "timed_cells": figures.timed_cells,
        "rounds": figures.rounds,
        "displays": figures.displays,
        "added_energy_samples": ADDED_OVER,
        "instruction_set": figures.instruction_set,
        "checked_cells": figures.checked[0],
        "checked_cells_that_differ": figures.checked[1],
        "methods": figures.methods.iter().map(method_json).collect::<Vec<_>>(),
        "small_viscous_friction": small,
        "devices": figures.devices,
        "laws": laws,
        "conclusions": conclusions(figures),
        "laws_conclusion": laws_conclusion(figures),
        "fidelity": rungs::json(&figures.ladders),
        "fidelity_conclusion": rungs::conclusion(&figures.ladders),
    })
}

/// A line of the CSV, without what all lines of a method have in common.
fn line(measure: &str, samples: &str, spread: &Spread, unit: &str) -> String {
    let Spread { low, median, high } = spread;
    format!("{measure},{samples},{median},{low},{high},{unit}")
}

/// One line per method or law and measure. Value is a median and low and high are quartiles where there
/// are any; `inf` is a result that is lost.
pub fn csv(figures: &Figures) -> Result<String> {
    let mut text = String::from("picture,method,setting,measure,samples,value,low,high,unit\n");
    for method in &figures.methods {
        let mut lines = vec![line("time", "", &method.times.all, "ns per sample")];
        for (class, spread) in CLASSES.iter().zip(&method.times.by_class) {
            let measure = format!("time on {class}");
            lines.extend(spread.map(|spread| line(&measure, "", &spread, "ns per sample")));
        }
        for (after, spread) in AFTER.iter().zip(&method.position) {
            lines.push(line("position error", &after.to_string(), spread, "counts"));
        }
        let over = ADDED_OVER.to_string();
        lines.push(line(
            "added energy",
            &over,
            &method.added,
            "K Δ² per sample",
        ));
        let samples = Plane::SAMPLES;
        lines.push(format!(
            "class error,{samples},{},,,share",
            method.class_error
        ));
        for line in lines {
            writeln!(
                text,
                "methods,{},{},{line}",
                method.family.key(),
                method.setting
            )?;
        }
    }
    for it in &figures.small_rates {
        let measure = format!("position error at beta/mu = {:e}", it.beta_over_mu);
        let line = line(&measure, "1000", &it.position, "counts");
        writeln!(text, "methods,{},,{line}", it.family.key())?;
    }
    for law in &figures.laws {
        let key = law.law.as_str();
        if let Some(stiffness) = law.static_over_ao {
            writeln!(text, "laws,{key},,static stiffness,,{stiffness},,,AO")?;
        }
        let line = line("time", "", &law.tick_ns, "ns per tick");
        writeln!(text, "laws,{key},,{line}")?;
        if let Some(count) = law.instructions {
            writeln!(text, "laws,{key},,instructions,,{count},,,per tick")?;
        }
    }
    text += &rungs::csv(&figures.ladders)?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant_sim::compare::Times;

    fn at(value: f64) -> Spread {
        Spread {
            low: value,
            median: value,
            high: value,
        }
    }

    fn method(
        family: Family,
        setting: &'static str,
        ns: f64,
        wrong: usize,
        error: f64,
    ) -> Measured {
        Measured {
            family,
            setting,
            times: Times {
                all: at(ns),
                by_class: [None, Some(at(2.0 * ns)), None],
            },
            position: [at(error); 4],
            added: at(error),
            wrong,
            class_error: wrong as f64 / 400.0,
        }
    }

    fn figures(others: Vec<Measured>) -> Figures {
        let exact = [
            method(Family::Vector, "", 1.0, 0, 1e-13),
            method(Family::Exact, "", 10.0, 0, 1e-13),
        ];
        Figures {
            quick: true,
            instruction_set: "portable",
            grid: 20,
            timed_cells: 16,
            displays: 16,
            rounds: 3,
            checked: [16, 0],
            methods: exact.into_iter().chain(others).collect(),
            small_rates: vec![],
            devices: 11,
            laws: vec![],
            ladders: vec![],
        }
    }

    #[test]
    fn the_exact_map_s_corner_is_told_by_ratios() {
        let all = conclusions(&figures(vec![
            method(Family::Euler, "10", 60.0, 7, 0.1),
            method(Family::Midpoint, "3", 20.0, 8, 0.1),
            method(Family::Dopri5, "1e-4", 250.0, 0, 1e-12),
            method(Family::Dopri5, "1e-8", 260.0, 0, 1e-12),
        ]));
        assert_eq!(all.len(), 4);
        assert!(
            all[1].contains("DOPRI5 at 1e-4: 250 ns, 250 × the exact map in a sweep, 25 ×"),
            "{}",
            all[1]
        );
        // 8 of 400 are not fewer than 2 %.
        assert!(
            all[2].starts_with("One method of fixed steps err")
                && all[2].contains("Euler with 10 steps"),
            "{}",
            all[2]
        );
        assert!(
            all[3].contains("one display: nothing;")
                && all[3].ends_with("Nearer to the truth: nothing."),
            "{}",
            all[3]
        );
    }

    #[test]
    fn what_beats_the_exact_map_is_said() {
        let all = conclusions(&figures(vec![
            method(Family::Euler, "1", 5.0, 340, 0.1),
            method(Family::Rk4, "1", 0.5, 0, 1e-14),
        ]));
        assert!(
            all[1].contains("Runge–Kutta 4 with 1 step: 0.5 ns, 0.5 ×"),
            "{}",
            all[1]
        );
        for part in [
            "one display: semi-implicit Euler with 1 step (5 ns, 85 % wrong), Runge–Kutta 4",
            "Faster than its sweep: Runge–Kutta 4 with 1 step.",
            "Nearer to the truth: Runge–Kutta 4 with 1 step after 1,",
        ] {
            assert!(all[3].contains(part), "{part}: {}", all[3]);
        }
        let none = conclusions(&figures(vec![method(
            Family::Euler,
            "1",
            5.0,
            340,
            f64::INFINITY,
        )]));
        assert!(
            none[1].starts_with("No integrator") && none[2].starts_with("No method"),
            "{none:?}"
        );
    }
}
