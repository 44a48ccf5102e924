//! Our own engines behind the line protocol of `cargo xtask peers`, to be timed beside others.
//!
//! A request is one line, `run SETTING MU V0 SAMPLES BETA,SIGMA ...`, an answer one line, `done
//! SECONDS SAMPLES CLASSES` or `error TEXT`. The settings are `scalar`, [`Display::run`] one display after
//! the other, and `vector`, [`kernel::classify`] with the best instruction set. Both run the displays
//! over and over until 50 ms of processor time have passed: the seconds are those of all
//! repetitions, and so are the samples. Samples are those really simulated: none after a display has come to rest or
//! diverged. The vector kernel, which looks at that every 64 samples only, is credited with no
//! more than the scalar map.
#![forbid(unsafe_code)]

use std::hint::black_box;
use std::io::{BufRead, Write, stdin, stdout};
use std::time::Duration;

use control::criterion::Dimensionless;
use plant_sim::display::Display;
use plant_sim::hold::State;
use plant_sim::kernel::{self, InstructionSet};
use plant_sim::outcome::{Class, Classes};

/// A batch is repeated until it has taken this much processor time.
const LEAST: Duration = Duration::from_millis(50);

fn main() -> std::io::Result<()> {
    let set = InstructionSet::best();
    let mut out = stdout();
    writeln!(
        out,
        "ready plant-sim {} {}",
        env!("CARGO_PKG_VERSION"),
        set.name()
    )?;
    for line in stdin().lock().lines() {
        match answer(&line?, set) {
            Some(done) => writeln!(out, "{done}")?,
            None => writeln!(out, "error a request that is none")?,
        }
    }
    Ok(())
}

fn answer(line: &str, set: InstructionSet) -> Option<String> {
    let mut words = line.split_whitespace();
    if words.next()? != "run" {
        return None;
    }
    let setting = words.next()?;
    let mu = words.next()?.parse().ok()?;
    let velocity = words.next()?.parse().ok()?;
    let samples: u64 = words.next()?.parse().ok()?;
    let mut displays = Vec::new();
    for word in words {
        let (beta, sigma) = word.split_once(',')?;
        let (beta, sigma) = (beta.parse().ok()?, sigma.parse().ok()?);
        let display = Display::new(Dimensionless { mu, beta, sigma }).ok()?;
        if !kernel::serves(&display) {
            return None;
        }
        let start = State {
            position: 0.0,
            velocity,
        };
        displays.push((display, start));
    }
    let scalar = || -> (u64, Vec<Classes>) {
        let runs = black_box(&displays)
            .iter()
            .map(|(display, start)| display.run(*start, samples, |_, _| true));
        let runs: Vec<_> = runs.collect();
        (
            runs.iter().map(|run| run.samples).sum(),
            runs.iter().map(|run| run.classes).collect(),
        )
    };
    let (simulated, _) = scalar();
    let engine = || match setting {
        "scalar" => Some(scalar().1),
        "vector" => kernel::classify(set, black_box(&displays), samples, |_| true),
        _ => None,
    };
    let (mut time, mut repetitions) = (Duration::ZERO, 0);
    let classes = loop {
        let start = processor_time()?;
        let classes = engine()?;
        time += processor_time()? - start;
        repetitions += 1;
        if time >= LEAST {
            break classes;
        }
    };
    let letters: String = classes
        .iter()
        .map(|classes| match classes.window {
            Class::Rest => 'r',
            Class::LimitCycle => 'c',
            Class::Unstable => 'u',
            Class::Undecided => '?',
        })
        .collect();
    Some(format!(
        "done {:.9} {} {letters}",
        time.as_secs_f64(),
        simulated * repetitions
    ))
}

/// Time that this process has had on a processor: what else runs there does not count.
#[cfg(unix)]
fn processor_time() -> Option<Duration> {
    rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime)
        .try_into()
        .ok()
}

#[cfg(not(unix))]
fn processor_time() -> Option<Duration> {
    None
}
