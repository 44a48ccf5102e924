//! A file of devices: one table `[[device]]` each.

use std::collections::HashSet;
use std::f64::consts::TAU;
use std::path::Path;

use anyhow::{Context, Result, bail};
use control::criterion::Device;
use plant_sim::campaign::{Draw, Kind};
use plant_sim::trial::Sampled;
use serde::Deserialize;

use crate::scene::accepted::{bound, refuse};

/// The devices that are measured unless a file is given.
const BUILT_IN: &str = include_str!("../../tests/data/devices.toml");

/// A device by name.
#[derive(Debug, Clone, PartialEq)]
pub struct Named {
    pub name: String,
    pub sampled: Sampled,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    device: Vec<Table>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    name: String,
    inertia_kg_m2: f64,
    viscous_nm_s_rad: f64,
    coulomb_nm: f64,
    counts_per_rev: f64,
    sample_period_s: f64,
    #[serde(default = "one")]
    decimation: u32,
    /// What was measured before: goes along.
    #[serde(rename = "static_ledger_nm_rad")]
    _static_ledger_nm_rad: Option<f64>,
}

fn one() -> u32 {
    1
}

/// The devices of this repository.
pub fn built_in() -> Result<Vec<Named>> {
    parse(BUILT_IN).context("tests/data/devices.toml")
}

/// Reads and checks a file.
pub fn load(path: &Path) -> Result<Vec<Named>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("--devices: cannot read {}", path.display()))?;
    parse(&text).with_context(|| format!("--devices: {}", path.display()))
}

/// `count` random devices.
pub fn random(count: u64, seed: u64) -> Vec<Named> {
    let device = |number| Named {
        name: format!("random-{}", number + 1),
        sampled: Draw::new(seed, Kind::Wall, number).sampled(),
    };
    (0..count).map(device).collect()
}

fn parse(text: &str) -> Result<Vec<Named>> {
    let file: File = toml::from_str(text)?;
    if file.device.is_empty() {
        bail!("there is no device; accepted: one or more tables [[device]]");
    }
    let mut names = HashSet::new();
    for (number, table) in file.device.iter().enumerate() {
        let name = &table.name;
        if name.trim().is_empty() {
            bail!(
                "device {}: name is empty; accepted: some letters",
                number + 1
            );
        }
        if !names.insert(name) {
            bail!("device.name is `{name}` twice; accepted: each name once");
        }
    }
    let named = |table: Table| {
        let sampled = checked(&table).with_context(|| format!("device `{}`", table.name))?;
        let name = table.name;
        Ok(Named { name, sampled })
    };
    file.device.into_iter().map(named).collect()
}

fn checked(table: &Table) -> Result<Sampled> {
    let device = Device {
        inertia_kg_m2: between("inertia_kg_m2", table.inertia_kg_m2, 1e-9, 1.0)?,
        viscous_nm_s_rad: between("viscous_nm_s_rad", table.viscous_nm_s_rad, 1e-9, 1.0)?,
        coulomb_nm: between("coulomb_nm", table.coulomb_nm, 1e-7, 10.0)?,
    };
    let counts = between("counts_per_rev", table.counts_per_rev, 4.0, 1e8)?;
    let period_s = between("sample_period_s", table.sample_period_s, 1e-6, 0.1)?;
    let decimation = f64::from(table.decimation);
    if table.decimation == 0 || counts / decimation < 4.0 {
        bail!(
            "decimation is {decimation}; accepted: a whole number from 1 that leaves 4 counts/rev or more"
        );
    }
    Ok(Sampled {
        device,
        count_rad: TAU / counts * decimation,
        period_s,
    })
}

/// Hits at 0.1 to 30 rad/s say something of knobs in these bounds only, and end.
fn between(key: &str, value: f64, least: f64, most: f64) -> Result<f64> {
    if (least..=most).contains(&value) {
        return Ok(value);
    }
    let accepted = format!("from {} to {}", bound(least), bound(most));
    Err(refuse(key, value, &accepted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_eleven_devices_are_there() {
        let devices = built_in().unwrap();
        assert_eq!(devices.len(), 11);
        assert_eq!(devices[0].name, "re35-1ms");
        assert_eq!(devices[5].sampled.count_rad, TAU / 256.0);
    }

    #[test]
    fn random_devices_are_the_same_again_and_begin_alike() {
        assert_eq!(random(2, 7), random(5, 7)[..2]);
        assert_ne!(random(2, 7), random(2, 8));
    }
}
