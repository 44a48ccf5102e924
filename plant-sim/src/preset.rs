//! Devices known by name.

use std::f64::consts::TAU;

use control::criterion::Device;

/// A motor with its encoder and a usual sample period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preset {
    /// What to call it on a command line.
    pub name: &'static str,
    /// Where its values come from, or that they are assumed.
    pub source: &'static str,
    /// m, b and c.
    pub device: Device<f64>,
    /// Encoder counts per revolution.
    pub counts_per_rev: f64,
    /// Sample period, s.
    pub period_s: f64,
}

impl Preset {
    /// The size of a count, rad.
    #[must_use]
    pub fn count_rad(&self) -> f64 {
        TAU / self.counts_per_rev
    }
}

/// The paper's testbed and three gimbal knobs.
pub const PRESETS: [Preset; 4] = [
    Preset {
        name: "re35",
        source: "Maxon RE35 with an 8192-count encoder at 1 ms: measured by Diolaiti et al., Sec. V",
        device: Device {
            inertia_kg_m2: 6.28e-6,
            viscous_nm_s_rad: 9e-6,
            coulomb_nm: 2e-3,
        },
        counts_per_rev: 8192.0,
        period_s: 1e-3,
    },
    Preset {
        name: "gimbal-light",
        source: "assumed: a small brushless gimbal motor with a 14-bit sensor and a light cap; nobody measured it",
        device: Device {
            inertia_kg_m2: 5e-6,
            viscous_nm_s_rad: 1e-5,
            coulomb_nm: 1e-3,
        },
        counts_per_rev: 16384.0,
        period_s: 1.25e-4,
    },
    Preset {
        name: "gimbal-medium",
        source: "assumed: a brushless gimbal motor with a 14-bit sensor and a knob; nobody measured it",
        device: Device {
            inertia_kg_m2: 1e-5,
            viscous_nm_s_rad: 3e-5,
            coulomb_nm: 3e-3,
        },
        counts_per_rev: 16384.0,
        period_s: 2.5e-4,
    },
    Preset {
        name: "gimbal-heavy",
        source: "assumed: a larger gimbal motor with a 14-bit sensor, greased, with a metal knob; nobody measured it",
        device: Device {
            inertia_kg_m2: 2e-5,
            viscous_nm_s_rad: 1e-4,
            coulomb_nm: 1e-2,
        },
        counts_per_rev: 16384.0,
        period_s: 1.25e-4,
    },
];

/// The preset of a name, whatever its case.
#[must_use]
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS
        .iter()
        .find(|preset| preset.name.eq_ignore_ascii_case(name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use control::criterion::{Criterion, Sampling};

    #[test]
    fn every_preset_is_a_device_and_says_where_it_comes_from() {
        for known in &PRESETS {
            let sampling = Sampling {
                period_s: known.period_s,
                count_rad: known.count_rad(),
            };
            assert!(Criterion::new(known.device, sampling).is_ok());
            assert!(known.source.contains("measured by") || known.source.starts_with("assumed"));
            assert_eq!(preset(&known.name.to_uppercase()), Some(known));
        }
        assert_eq!(preset("rs-385"), None);
    }
}
