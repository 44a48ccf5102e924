//! The plant with more and more of its phenomena, and with no more than the answer needs: measured and told.

use std::fmt::Write as _;

use anyhow::Result;
use indicatif::ProgressBar;
use plant_sim::compare::{RUNGS, Rung, Spread, rungs, scenes};
use plant_sim::fidelity::Phenomenon;
use serde_json::{Value, json};

use crate::number::{digits, short};
use crate::stop::{self, Stopped};

/// How strong the phenomena are, as a share of those of a real knob, and what a reader calls it.
const STRENGTHS: [(f64, &str); 2] = [
    (1.0, "as a real drive, motor and finger have them"),
    (1e-4, "a ten-thousandth of that"),
];

/// What `auto` is asked for, rad.
const TOLERANCES_RAD: [f64; 4] = [1e-10, 1e-8, 1e-6, 1e-4];

/// The tolerance that is talked of.
const TOLERANCE_RAD: f64 = 1e-6;

/// The ladder on scenes of one strength.
pub struct Ladder {
    pub strength: f64,
    pub title: &'static str,
    pub scenes: usize,
    /// From the plain plant to the full one, then `auto` at each tolerance.
    pub rungs: Vec<Rung>,
}

impl Ladder {
    /// From plain to full.
    pub fn kept(&self) -> &[Rung] {
        &self.rungs[..RUNGS.len()]
    }

    /// `auto`, by tolerance.
    pub fn auto(&self) -> &[Rung] {
        &self.rungs[RUNGS.len()..]
    }

    fn full(&self) -> Option<&Rung> {
        self.kept().last()
    }

    /// How many times faster than the full plant `auto` is at [`TOLERANCE_RAD`], and that `auto`.
    fn saving(&self) -> Option<(f64, &Rung)> {
        let mut auto = self.auto().iter();
        let auto = auto.find(|rung| rung.tolerance_rad == Some(TOLERANCE_RAD))?;
        Some((self.full()?.tick_ns.median / auto.tick_ns.median, auto))
    }
}

/// Ways of a ladder that are measured, for the bar.
pub const WAYS: u64 = (STRENGTHS.len() * (RUNGS.len() + TOLERANCES_RAD.len())) as u64;

/// One thread; `work` of the bar for each way and round.
pub fn measure(rounds: usize, bar: &ProgressBar, work: u64) -> Result<Vec<Ladder>> {
    let ladder = |(strength, title)| {
        let scenes = scenes(strength);
        let told = || bar.inc(work);
        let rungs = rungs(&scenes, &TOLERANCES_RAD, rounds, stop::flag(), &told)?;
        Ok(Ladder {
            strength,
            title,
            scenes: scenes.len(),
            rungs: rungs.ok_or(Stopped)?,
        })
    };
    STRENGTHS.into_iter().map(ladder).collect()
}

/// What is written at a rung of a ladder.
pub fn label(rung: &Rung) -> String {
    let names: Vec<_> = rung.adds.iter().map(|added| words(*added)).collect();
    match (rung.tolerance_rad, names.is_empty()) {
        (Some(tolerance_rad), _) => format!("auto {}", short(tolerance_rad)),
        (None, true) => "plain".into(),
        (None, false) => format!("+ {}", names.join(", ")),
    }
}

fn words(phenomenon: Phenomenon) -> &'static str {
    match phenomenon {
        Phenomenon::TorqueStep => "torque steps",
        Phenomenon::Hand => "hand",
        Phenomenon::Delay => "delay",
        Phenomenon::AmplifierLag => "lag",
        Phenomenon::HandShake => "tremor",
        Phenomenon::Cogging => "cogging",
        Phenomenon::Stiction => "stiction",
    }
}

/// What to conclude.
pub fn conclusion(ladders: &[Ladder]) -> String {
    let one = |ladder: &Ladder| {
        let (saving, auto) = ladder.saving()?;
        let full = ladder.full()?;
        let plain = ladder.kept().first()?;
        let [out, all] = auto.left_out;
        Some(format!(
            "Phenomena {}: the full plant takes {} ns a tick, the plain one {} and errs by {} rad; auto at {} rad leaves out {out} of {all} and takes {} ns, {} × {}, errs by {} rad and had promised {}.",
            ladder.title,
            short(full.tick_ns.median),
            short(plain.tick_ns.median),
            digits(plain.error_rad, 2),
            short(TOLERANCE_RAD),
            short(auto.tick_ns.median),
            digits(saving.max(saving.recip()), 2),
            if saving >= 1.0 { "less" } else { "more" },
            digits(auto.error_rad, 2),
            digits(auto.bound_rad, 2),
        ))
    };
    ladders.iter().filter_map(one).collect::<Vec<_>>().join(" ")
}

/// How it was taken.
pub fn notes(ladders: &[Ladder], rounds: usize) -> String {
    let scenes = ladders.first().map_or(0, |ladder| ladder.scenes);
    format!(
        "RE35 at 1 ms under the energy ledger, {scenes} scenes: walls and springs hit at 1 to 30 rad/s, detents. At full strength: 20 µs late, an amplifier of 50 µs, torque steps of 0.12 mNm, cogging of 0.1 mNm, stiction of 0.2 mNm, a finger that leans with 1 mNm and trembles with 0.2 mNm. Error: largest distance from the full plant's angle at any sample. Times: controller and plant, all attempts of auto; one thread, medians of {rounds} interleaved rounds; bars: quartiles."
    )
}

pub fn text(ladders: &[Ladder]) -> Result<String> {
    let mut text = String::new();
    for ladder in ladders {
        writeln!(
            text,
            "\n{:<36} {:>9} {:>17} {:>12} {:>12} {:>10}",
            format!("phenomena × {}", short(ladder.strength)),
            "ns/tick",
            "quartiles",
            "error, rad",
            "bound, rad",
            "left out"
        )?;
        for rung in &ladder.rungs {
            let Spread { low, median, high } = rung.tick_ns;
            let [out, all] = rung.left_out;
            let is_auto = rung.tolerance_rad.is_some();
            writeln!(
                text,
                "{:<36} {:>9} {:>17} {:>12} {:>12} {:>10}",
                label(rung),
                short(median),
                format!("{} – {}", short(low), short(high)),
                digits(rung.error_rad, 2),
                if is_auto {
                    digits(rung.bound_rad, 2)
                } else {
                    "–".into()
                },
                if is_auto {
                    format!("{out} of {all}")
                } else {
                    "–".into()
                },
            )?;
        }
    }
    writeln!(text, "\n- {}\n", conclusion(ladders))?;
    Ok(text)
}

pub fn json(ladders: &[Ladder]) -> Value {
    let rung = |rung: &Rung| {
        let Spread { low, median, high } = rung.tick_ns;
        json!({
            "rung": label(rung),
            "adds": rung.adds.iter().map(|added| added.as_str()).collect::<Vec<_>>(),
            "tolerance_rad": rung.tolerance_rad,
            "ns_per_tick": { "median": median, "low": low, "high": high },
            "error_rad": rung.error_rad,
            "bound_rad": rung.tolerance_rad.map(|_| rung.bound_rad),
            "left_out": rung.tolerance_rad.map(|_| rung.left_out[0]),
            "phenomena": rung.tolerance_rad.map(|_| rung.left_out[1]),
        })
    };
    let ladder = |ladder: &Ladder| {
        json!({
            "strength": ladder.strength,
            "scenes": ladder.scenes,
            "rungs": ladder.rungs.iter().map(rung).collect::<Vec<_>>(),
        })
    };
    ladders.iter().map(ladder).collect()
}

/// Lines of the CSV that [`super::report::csv`] begins.
pub fn csv(ladders: &[Ladder]) -> Result<String> {
    let mut text = String::new();
    for ladder in ladders {
        for rung in &ladder.rungs {
            let name = label(rung).replace(", ", " and ");
            let head = format!("fidelity,{name},{:e}", ladder.strength);
            let Spread { low, median, high } = rung.tick_ns;
            writeln!(text, "{head},time,,{median},{low},{high},ns per tick")?;
            writeln!(text, "{head},error,,{},,,rad", rung.error_rad)?;
            if rung.tolerance_rad.is_some() {
                writeln!(text, "{head},bound,,{},,,rad", rung.bound_rad)?;
            }
        }
    }
    Ok(text)
}
