//! How stiff the energy ledger is: the systematic suite on the 11 devices of `data/devices.toml`, on which
//! its constants were chosen, and on random ones, on which nothing was.

use std::f64::consts::TAU;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use control::criterion::Device;
use plant_sim::campaign::{Draw, Kind};
use plant_sim::suite::{ANY_STIFFNESS, Contender, Mean, Measured, clamps_itself, measure, tune};
use plant_sim::trial::{Sampled, abbott_okamura};

static NEVER: AtomicBool = AtomicBool::new(false);

fn devices() -> Vec<(String, Sampled)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/devices.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let table = |table: &str| {
        let word = |key: &str| {
            let lines = table.lines().filter_map(|line| line.split_once('='));
            let of_key = |(name, value): (&str, &str)| {
                let value = value.split('#').next().unwrap().trim();
                (name.trim() == key).then(|| value.trim_matches('"').to_owned())
            };
            lines.into_iter().find_map(of_key).unwrap()
        };
        let number = |key: &str| word(key).parse::<f64>().unwrap();
        let sampled = Sampled {
            device: Device {
                inertia_kg_m2: number("inertia_kg_m2"),
                viscous_nm_s_rad: number("viscous_nm_s_rad"),
                coulomb_nm: number("coulomb_nm"),
            },
            count_rad: TAU / number("counts_per_rev") * number("decimation"),
            period_s: number("sample_period_s"),
        };
        (word("name"), sampled)
    };
    text.split("[[device]]").skip(1).map(table).collect()
}

fn random_devices(count: u64) -> Vec<(String, Sampled)> {
    let device = |number| {
        let sampled = Draw::new(1, Kind::Wall, number).sampled();
        (format!("random-{number}: {sampled:?}"), sampled)
    };
    (0..count).map(device).collect()
}

fn measured(law: Contender, sampled: &Sampled) -> Measured {
    measure(law, sampled, ANY_STIFFNESS, false, &NEVER).unwrap()
}

/// Static stiffness over AO of the ledger and of auto, geometric means; no run may be bad.
fn ledger_and_auto(devices: &[(String, Sampled)]) -> [f64; 2] {
    [Contender::Ledger, Contender::Auto].map(|law| {
        let mut mean = Mean::default();
        for (name, sampled) in devices {
            let measured = measured(law, sampled);
            assert_eq!(measured.runs, 240);
            assert_eq!(measured.bad, [], "{law:?} on {name}");
            mean.enter(measured.static_nm_rad / abbott_okamura(sampled).unwrap());
        }
        mean.value().unwrap()
    })
}

#[test]
fn the_ledger_is_53_times_as_stiff_as_the_bound_for_all_speeds_without_a_bad_run() {
    let devices = devices();
    assert_eq!(devices.len(), 11);
    let [ledger, auto] = ledger_and_auto(&devices);
    println!("× AO: ledger {ledger:.2}, auto {auto:.2}");
    assert!(ledger >= 53.0, "{ledger}");
    assert!(auto >= 0.98 * ledger, "{auto} of {ledger}");
    let (name, re35) = &devices[0];
    assert_eq!(name, "re35-1ms");
    for law in [Contender::Ledger, Contender::Auto] {
        let stiffness = measured(law, re35).static_nm_rad;
        assert!(stiffness >= 3.6, "{law:?}: {stiffness} Nm/rad");
    }
}

#[test]
fn fifty_random_devices_on_which_nothing_was_chosen_show_no_bad_run_either() {
    let [ledger, auto] = ledger_and_auto(&random_devices(50));
    println!("× AO: ledger {ledger:.2}, auto {auto:.2}");
    assert!(auto >= 0.98 * ledger, "{auto} of {ledger}");
}

#[test]
fn laws_that_clamp_themselves_do_so_and_the_others_do_not() {
    for (name, sampled) in devices().iter().step_by(4) {
        for law in Contender::ALL {
            assert_eq!(
                clamps_itself(law, sampled, &NEVER).unwrap(),
                !law.is_tuned(),
                "{law:?} on {name}"
            );
        }
    }
}

#[test]
fn what_is_found_offline_is_at_the_edge() {
    let re35 = devices()[0].1;
    let raw = tune(Contender::Raw, &re35, &NEVER).unwrap().unwrap();
    let bad = |stiffness| {
        let measured = measure(Contender::Raw, &re35, stiffness, false, &NEVER);
        measured.unwrap().bad.len()
    };
    assert_eq!(bad(raw), 0);
    assert!(bad(1.01 * raw) > 0);
    assert!(raw < measured(Contender::Ledger, &re35).static_nm_rad / 10.0);
}
