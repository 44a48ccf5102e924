//! Scenes with `[electrical]`, as a user and a script meet them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

fn run(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_knob"))
        .args(args)
        .output()
        .unwrap()
}

fn json(args: &[&str]) -> Value {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "knob {args:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn refused(args: &[&str], status: i32, parts: &[&str]) {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "knob {args:?}: {said}");
    assert!(output.stdout.is_empty(), "knob {args:?}");
    for part in parts {
        assert!(
            said.contains(part),
            "knob {args:?}: `{part}` is missing in: {said}"
        );
    }
    assert!(!said.contains("panicked"), "knob {args:?}: {said}");
}

fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../scenes")
        .join(name)
}

/// A motor with all its keys; a test takes out and puts in lines.
const SCENE: &str = r#"
[device]
inertia_kg_m2 = 3e-5
viscous_nm_s_rad = 3e-5
coulomb_nm = 4e-3
counts_per_rev = 16384
[loop]
sample_period_s = 2e-4
[electrical]
drive = "current"
resistance_ohm = 1.2
d_inductance_h = 4e-4
flux_wb = 4e-3
pole_pairs = 7
pwm_period_s = 5e-5
current_step_a = 0.02
source_v = 24.0
current_max_a = 4.0
[render]
law = "ledger"
shape = "spring"
stiffness_nm_rad = 1e3
[start]
velocity_rad_s = 2.0
[run]
samples = 200
"#;

const BRUSHED: [(&str, &str); 2] = [
    ("\"current\"", "\"brushed\""),
    (
        "d_inductance_h = 4e-4\nflux_wb = 4e-3\npole_pairs = 7",
        "inductance_h = 4e-4\ntorque_constant_nm_a = 0.05",
    ),
];

const VOLTAGE: [(&str, &str); 3] = [
    ("\"current\"", "\"voltage\""),
    ("resistance_ohm = 1.2", "resistance_ohm = 12"),
    ("current_step_a = 0.02\n", ""),
];

fn changed(changes: &[(&str, &str)]) -> String {
    changes.iter().fold(SCENE.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    })
}

#[test]
fn the_example_scenes_run_and_tell_of_their_windings() {
    let folder = TempDir::new().unwrap();
    let (trace, plot) = (
        folder.path().join("trace.csv"),
        folder.path().join("plot.svg"),
    );
    for name in ["three-phase.toml", "re35-brushed.toml"] {
        let file = scene(name);
        let args = [
            "simulate",
            file.to_str().unwrap(),
            "--json",
            "--force",
            "--trace",
            trace.to_str().unwrap(),
            "--plot",
            plot.to_str().unwrap(),
        ];
        let out = json(&args);
        assert_eq!(out, json(&args), "{name}");
        assert_eq!(out["class"], "rest", "{name}");
        assert!(out["energy_excess_j"].as_f64().unwrap() <= 0.0, "{name}");
        let windings = &out["electrical"];
        for (told, is) in [("told_delay_s", "delay_s"), ("told_tau_s", "tau_s")] {
            assert_eq!(windings[told], windings[is], "{name}");
        }
        assert_eq!(windings["delay_s"], 4.166_666_666_666_667e-5);
        assert!(windings["peak_current_a"].as_f64().unwrap() > 0.5);
        let rows = fs::read_to_string(&trace).unwrap().lines().count() as u64;
        assert_eq!(rows, out["samples"].as_u64().unwrap() + 1);
        assert!(fs::read_to_string(&plot).unwrap().contains("</svg>"));
        let said = run(&["simulate", file.to_str().unwrap()]).stdout;
        let said = String::from_utf8(said).unwrap();
        assert!(said.contains("torque       4.167e-5 s late"), "{said}");
    }
    let plain = json(&[
        "simulate",
        scene("ledger-push.toml").to_str().unwrap(),
        "--json",
    ]);
    assert!(plain.get("electrical").is_none());
}

#[test]
fn what_the_windings_deliver_enters_the_plan_unless_something_else_is_believed() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let path = file.to_str().unwrap();
    let told = |changes: &[(&str, &str)], believed: &str| {
        fs::write(
            &file,
            format!("{}[believed]\n{believed}\n", changed(changes)),
        )
        .unwrap();
        json(&["simulate", path, "--json"])
    };
    for changes in [&[][..], &BRUSHED, &VOLTAGE] {
        let out = told(changes, "");
        let windings = &out["electrical"];
        assert_eq!(windings["told_delay_s"], 5e-5);
        assert!(windings["told_tau_s"].as_f64().unwrap() > 3e-5);
        let ideal = told(
            changes,
            "delay_s = 0.0\namplifier_tau_s = 0.0\ntorque_step_nm = 0.0",
        );
        assert_eq!(ideal["electrical"]["told_delay_s"], 0.0);
        assert_eq!(ideal["electrical"]["delay_s"], 5e-5);
        let stiffness = |out: &Value| out["max_stiffness_nm_rad"].as_f64().unwrap();
        assert!(stiffness(&ideal) > 1.1 * stiffness(&out), "{out} {ideal}");
    }
    // A drive that believes half of the resistance has another loop.
    let (right, wrong) = (told(&[], ""), told(&[], "resistance_ohm = 0.6"));
    assert_ne!(right["angle_rad"], wrong["angle_rad"]);
    // `knob plan` reckons with the same.
    let stiffness = |text: &str| {
        fs::write(&file, text).unwrap();
        json(&["plan", path, "--json"])
    };
    let without = SCENE.split("[electrical]").next().unwrap();
    assert_ne!(stiffness(SCENE), stiffness(without));
}

#[test]
fn noise_comes_from_the_runs_seed() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let end = |seed: u32, noise: &str| {
        let lines = format!("samples = 200\nseed = {seed}");
        let text = changed(&[("samples = 200", &lines), ("current_step_a = 0.02", noise)]);
        fs::write(&file, text).unwrap();
        json(&["simulate", file.to_str().unwrap(), "--json"])["angle_rad"].clone()
    };
    let noisy = "current_step_a = 0.02\ncurrent_noise_a = 0.1";
    assert_eq!(end(1, noisy), end(1, noisy));
    assert_ne!(end(1, noisy), end(2, noisy));
    assert_eq!(
        end(1, "current_step_a = 0.02"),
        end(2, "current_step_a = 0.02")
    );
}

#[test]
fn what_cannot_be_or_is_said_twice_is_refused_by_its_key() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let path = file.to_str().unwrap();
    let table = |line: &str| changed(&[("[electrical]\n", &format!("[electrical]\n{line}\n"))]);
    let refuse = |text: &str, parts: &[&str]| {
        fs::write(&file, text).unwrap();
        refused(&["simulate", path, "--json"], 1, parts);
    };
    // Each number by its key.
    for key in [
        "resistance_ohm",
        "d_inductance_h",
        "flux_wb",
        "pwm_period_s",
        "current_step_a",
        "source_v",
        "current_max_a",
    ] {
        let line = SCENE.lines().find(|line| line.starts_with(key)).unwrap();
        for bad in ["nan", "inf", "-1.0", "0.0", "1e300"] {
            let text = changed(&[(line, &format!("{key} = {bad}"))]);
            refuse(
                &text,
                &["scene.toml", &format!("electrical.{key} is "), "accepted: "],
            );
        }
    }
    for key in [
        "q_inductance_h",
        "dead_time_s",
        "dead_time_edge_a",
        "current_noise_a",
        "source_ohm",
        "capacitance_f",
        "bandwidth_rad_s",
        "tolerance",
    ] {
        for bad in ["nan", "-1.0"] {
            refuse(
                &table(&format!("{key} = {bad}")),
                &[&format!("electrical.{key} is "), "accepted: "],
            );
        }
    }
    refuse(
        &table("current_offset_a = [0.1, inf]"),
        &["electrical.current_offset_a is inf"],
    );
    for key in ["flux_wb", "pole_pairs", "d_inductance_h", "current_step_a"] {
        let line = SCENE.lines().find(|line| line.starts_with(key)).unwrap();
        let text = changed(&[(&format!("{line}\n"), "")]);
        refuse(
            &text,
            &[&format!("electrical.{key} is missing"), "accepted: "],
        );
    }
    for (text, parts) in [
        (table("volts = 3"), &["unknown field `volts`"][..]),
        (
            changed(&[("\"current\"", "\"stepper\"")]),
            &["unknown variant `stepper`", "brushed"],
        ),
        (
            changed(&[("pole_pairs = 7", "pole_pairs = 0")]),
            &["electrical.pole_pairs is 0", "1 to 1024"],
        ),
        (
            table("torque_constant_nm_a = 0.04"),
            &[
                "electrical.flux_wb and electrical.torque_constant_nm_a",
                "one of them",
            ],
        ),
        (
            table("inductance_h = 1e-3"),
            &[
                "electrical.inductance_h is given",
                "\"current\" does not read it",
            ],
        ),
        (
            table("bandwidth_rad_s = 1e4\ntolerance = 0.3"),
            &["electrical.bandwidth_rad_s is 10000", "up to 7000"],
        ),
        (
            table("source_ohm = 0.1"),
            &["electrical.source_ohm is 0.1", "capacitance_f is missing"],
        ),
        (
            table("takes_back = false"),
            &["electrical.takes_back is given", "source_ohm is 0"],
        ),
        (
            changed(&[("sample_period_s = 2e-4", "sample_period_s = 2.1e-4")]),
            &[
                "loop.sample_period_s is 0.00021",
                "4.2 times",
                "the nearest is 0.0002 s",
            ],
        ),
        (
            changed(&[("sample_period_s = 2e-4", "sample_period_s = 1e-5")]),
            &[
                "loop.sample_period_s is 0.00001",
                "the nearest is 0.00005 s",
            ],
        ),
        (
            changed(&[(
                "sample_period_s = 2e-4",
                "sample_period_s = 2e-4\ndelay_s = 1e-5",
            )]),
            &[
                "loop.delay_s is 0.00001",
                "[electrical] brings its own",
                "believed.delay_s",
            ],
        ),
        (
            changed(&[(
                "sample_period_s = 2e-4",
                "sample_period_s = 2e-4\njitter_s = 1e-5",
            )]),
            &["loop.jitter_s is 0.00001", "PWM periods"],
        ),
        (
            changed(&[("16384", "16384.5")]),
            &["device.counts_per_rev is 16384.5", "whole number"],
        ),
        (
            changed(&[("counts_per_rev = 16384", "count_rad = 1e-3")]),
            &["device.counts_per_rev is missing"],
        ),
        (
            format!("{SCENE}[believed]\ninductance_h = 1e-3\n"),
            &["believed.inductance_h is given"],
        ),
        (
            format!("{SCENE}[believed]\nresistance_ohm = -1.0\n"),
            &["believed.resistance_ohm is -1"],
        ),
    ] {
        refuse(&text, parts);
    }
    for (changes, line, key) in [
        (&BRUSHED[..], "pole_pairs = 7", "electrical.pole_pairs"),
        (
            &BRUSHED,
            "q_inductance_h = 1e-3",
            "electrical.q_inductance_h",
        ),
        (
            &VOLTAGE,
            "current_step_a = 0.02",
            "electrical.current_step_a",
        ),
        (
            &VOLTAGE,
            "bandwidth_rad_s = 1e3",
            "electrical.bandwidth_rad_s",
        ),
    ] {
        let text =
            changed(changes).replacen("[electrical]\n", &format!("[electrical]\n{line}\n"), 1);
        refuse(&text, &[&format!("{key} is given"), "does not read it"]);
    }
    let (before, after) = SCENE.split_once("[electrical]").unwrap();
    let plain = format!(
        "{before}[render]{}",
        after.split_once("[render]").unwrap().1
    );
    refuse(
        &format!("{plain}[believed]\nresistance_ohm = 1.0\n"),
        &["believed.resistance_ohm is given", "[electrical]"],
    );
}

#[test]
fn what_knows_nothing_of_windings_says_so() {
    let file = scene("re35-brushed.toml");
    let path = file.to_str().unwrap();
    refused(
        &["simulate", path, "--fidelity", "auto"],
        2,
        &["--fidelity auto", "[electrical]", "--fidelity full"],
    );
    refused(
        &["simulate", path, "--method", "euler:1"],
        2,
        &["the scene has"],
    );
    refused(
        &["identify", "--scene", path],
        1,
        &["[electrical]", "accepted: a scene without it"],
    );
}
