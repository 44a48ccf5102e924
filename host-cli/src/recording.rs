//! Recordings as `knob log` writes them: CSV with a row for every tick.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use plant_sim::identify::{Recording, Sample};

/// The columns that are read; others may stand beside them, in any order.
const COLUMNS: [&str; 3] = ["tick", "count", "torque_nm"];

/// Reads a file of ticks `period_s` (s) apart, whose counts are `count_rad` (rad).
pub fn load(path: &Path, period_s: f64, count_rad: f64) -> Result<Recording> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let samples = parse(&text).with_context(|| path.display().to_string())?;
    Ok(Recording {
        period_s,
        count_rad,
        samples,
    })
}

fn parse(text: &str) -> Result<Vec<Sample>> {
    let mut lines = text.lines().enumerate();
    let header = lines.next().map_or("", |(_, line)| line);
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    let mut places = [0; 3];
    for (place, column) in places.iter_mut().zip(COLUMNS) {
        *place = names.iter().position(|name| *name == column).ok_or_else(|| {
            anyhow!(
                "line 1 has no column {column}, but: {header}; accepted: columns {} as `knob log` writes them, \
                 torque in Nm",
                COLUMNS.join(", ")
            )
        })?;
    }
    let mut samples = Vec::new();
    let mut last: Option<u32> = None;
    for (number, line) in lines {
        if line.trim().is_empty() {
            continue;
        }
        let at = number + 1;
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        if fields.len() != names.len() {
            bail!(
                "line {at} has {} values, and line 1 has {} names: the file was cut off or damaged",
                fields.len(),
                names.len()
            );
        }
        let [tick, count, torque] = places.map(|place| fields[place]);
        let wrong = |column: &str, given: &str, accepted: &str| {
            anyhow!("line {at}: {column} is `{given}`; accepted: {accepted}")
        };
        let tick: u32 = tick
            .parse()
            .map_err(|_| wrong("tick", tick, "a whole number from 0 to 4294967295"))?;
        if let Some(last) = last
            && tick != last.wrapping_add(1)
        {
            bail!(
                "line {at}: tick {tick} follows tick {last}; accepted: every tick, one after the other. \
                 Record with --every 1 on a line that carries all"
            );
        }
        last = Some(tick);
        let count = count
            .parse()
            .map_err(|_| wrong("count", count, "a whole number"))?;
        let torque_nm: f64 = torque
            .parse()
            .ok()
            .filter(|torque: &f64| torque.is_finite())
            .ok_or_else(|| wrong("torque_nm", torque, "a finite number, Nm"))?;
        samples.push(Sample { count, torque_nm });
    }
    Ok(samples)
}
