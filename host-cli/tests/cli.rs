//! The `knob` command as a user and a script meet it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

fn knob() -> Command {
    Command::new(env!("CARGO_BIN_EXE_knob"))
}

fn run(args: &[&str]) -> Output {
    knob().args(args).output().unwrap()
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Standard output as the one JSON object that it must be.
fn json(args: &[&str]) -> Value {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "knob {args:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A refusal: nothing on standard output, the exit status, and every part of the message.
fn refused(args: &[&str], status: i32, parts: &[&str]) {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "knob {args:?}: {said}");
    assert!(
        output.stdout.is_empty(),
        "knob {args:?} wrote to standard output"
    );
    for part in parts {
        assert!(
            said.contains(part),
            "knob {args:?}: `{part}` is missing in: {said}"
        );
    }
    assert!(!said.contains("panicked"), "knob {args:?}: {said}");
}

#[test]
fn every_recorded_trajectory_comes_out_of_simulate() {
    let text = fs::read_to_string(repository().join("tests/data/exact-map.json")).unwrap();
    let recorded: Value = serde_json::from_str(&text).unwrap();
    let cases = recorded["cases"].as_array().unwrap();
    assert!(cases.len() >= 64);
    for case in cases {
        let number = |key: &str| case[key].as_f64().unwrap();
        let flag = |key: &str| number(key).to_string();
        let (mu, beta, sigma, v0, n) = (
            flag("mu"),
            flag("beta"),
            flag("sigma"),
            flag("v0"),
            flag("n"),
        );
        let out = json(&[
            "simulate",
            "--mu",
            &mu,
            "--beta",
            &beta,
            "--sigma",
            &sigma,
            "--v0",
            &v0,
            "--samples",
            &n,
            "--json",
        ]);
        let digits = |key: &str| case[key].as_str().unwrap().parse::<f64>().unwrap();
        let scale = 1.0_f64.max(digits("xi").abs()).max(digits("v").abs());
        for key in ["xi", "v"] {
            let error = (out[key].as_f64().unwrap() - digits(key)).abs();
            assert!(
                error <= 1e-12 * scale,
                "{}: {key} is off by {error}",
                case["tag"]
            );
        }
        let stuck = case["stuck"].as_bool().unwrap();
        assert!(!stuck || out["class"] == "rest", "{case}");
        assert!(out["samples"].as_u64().unwrap() <= case["n"].as_u64().unwrap());
        assert!(
            ["rest", "limit-cycle", "unstable", "undecided"]
                .contains(&out["class"].as_str().unwrap())
        );
    }
}

#[test]
fn figure_6_comes_out_of_its_scene_files() {
    for (name, class, samples) in [
        ("fig6a", "rest", 256),
        ("fig6b", "limit-cycle", 1000),
        ("fig6c", "rest", 119),
        ("fig6d", "unstable", 80),
    ] {
        let file = repository().join(format!("scenes/{name}.toml"));
        let out = json(&["simulate", file.to_str().unwrap(), "--json"]);
        assert_eq!(out["class"], class, "{name}");
        assert_eq!(out["samples"], samples, "{name}");
        let excess = out["energy_excess_j"].as_f64().unwrap();
        assert_eq!(excess > 0.0, name == "fig6d", "{name}: {excess}");
        for key in [
            "angle_rad",
            "velocity_rad_s",
            "peak_angle_rad",
            "peak_torque_nm",
            "min_margin_nm",
            "min_stiffness_nm_rad",
            "max_stiffness_nm_rad",
            "energy_start_j",
            "reversals_last_eighth",
        ] {
            assert!(out[key].is_number(), "{name}: {key}");
        }
    }
}

#[test]
fn a_trace_and_a_plot_hold_the_run() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let scene = repository().join("scenes/fig6c.toml");
    let (csv, svg) = (at("run.csv"), at("run.svg"));
    let out = json(&[
        "simulate",
        scene.to_str().unwrap(),
        "--json",
        "--trace",
        &csv,
        "--plot",
        &svg,
    ]);
    let trace = fs::read_to_string(&csv).unwrap();
    let mut rows = trace.lines();
    assert_eq!(
        rows.next().unwrap(),
        "time_s,angle_rad,velocity_rad_s,count,torque_nm,stiffness_nm_rad,margin_nm,account_j,law,reason"
    );
    assert_eq!(rows.count() as u64, out["samples"].as_u64().unwrap());
    let plot = fs::read_to_string(&svg).unwrap();
    assert!(plot.starts_with("<svg") && plot.trim_end().ends_with("</svg>"));
    for words in [
        "time, s",
        "angle, rad",
        "±1 count",
        "β = b / (K T)",
        "comes to rest",
    ] {
        assert!(plot.contains(words), "{words}");
    }
    // What exists stays, unless --force.
    refused(
        &["simulate", scene.to_str().unwrap(), "--plot", &svg],
        1,
        &["--plot", "run.svg", "--force"],
    );
    assert_eq!(fs::read_to_string(&svg).unwrap(), plot);
    json(&[
        "simulate",
        scene.to_str().unwrap(),
        "--json",
        "--plot",
        &svg,
        "--force",
    ]);
    // Nothing else is left beside them.
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn flags_that_make_no_sense_are_refused_with_what_would_do() {
    let display = |flag: &'static str, value: &'static str| {
        let mut args = vec!["simulate"];
        for (name, good) in [
            ("--mu", "50"),
            ("--beta", "0.3"),
            ("--sigma", "0.7"),
            ("--v0", "10"),
            ("--samples", "9"),
        ] {
            args.extend([name, if name == flag { value } else { good }]);
        }
        if flag == "--xi0" {
            args.extend([flag, value]);
        }
        args
    };
    for (flag, value, parts) in [
        ("--mu", "nan", vec!["--mu", "nan", "not finite"]),
        (
            "--mu",
            "inf",
            vec!["--mu", "inf", "accepted: a finite number"],
        ),
        ("--mu", "0", vec!["--mu", "0 is not above 0"]),
        ("--mu", "-50", vec!["--mu", "-50", "above 0"]),
        (
            "--mu",
            "1e-320",
            vec!["--mu", "1e-320", "from 1e-100 to 1e100"],
        ),
        ("--mu", "1e-300", vec!["--mu", "1e-100"]),
        ("--beta", "1e300", vec!["--beta", "1e300", "up to 1e100"]),
        (
            "--beta",
            "-0.1",
            vec!["--beta", "-0.1 is negative", "0 or more"],
        ),
        ("--sigma", "NaN", vec!["--sigma", "NaN"]),
        ("--sigma", "0,5", vec!["--sigma", "`0,5` is not a number"]),
        ("--v0", "3rad/s", vec!["--v0", "without a unit"]),
        ("--v0", "1e12", vec!["--v0", "1e12", "±1e9"]),
        ("--xi0", "inf", vec!["--xi0", "not finite"]),
        ("--samples", "0", vec!["--samples", "1 or more"]),
        ("--samples", "-5", vec!["--samples", "1 or more"]),
        ("--samples", "1.5", vec!["--samples", "whole number"]),
    ] {
        refused(&display(flag, value), 2, &parts);
    }
    refused(
        &["simulate"],
        2,
        &["scene file", "--mu --beta --sigma --v0 --samples"],
    );
    refused(
        &["simulate", "--mu", "50"],
        2,
        &["--beta", "--sigma", "--v0", "--samples"],
    );
    refused(
        &["simulate", "a.toml", "--mu", "50"],
        2,
        &["--mu", "cannot be used"],
    );
    refused(&["frobnicate"], 2, &["frobnicate"]);
    refused(
        &["plan", "--motor", "re36"],
        2,
        &["--motor", "re36", "re35", "gimbal-heavy"],
    );
    refused(
        &["plan", "--stiffness", "0"],
        2,
        &["--stiffness", "above 0"],
    );
    refused(&["plan", "--stiffness", "nan"], 2, &["--stiffness", "nan"]);
    refused(
        &["plan", "a.toml", "--motor", "re35"],
        2,
        &["cannot be used"],
    );

    let map = |flag: &'static str, value: &'static str| {
        let mut args = vec!["map"];
        for (name, good) in [
            ("--mu", "50"),
            ("--v0", "2"),
            ("--grid", "4"),
            ("--samples", "10"),
        ] {
            args.extend([name, if name == flag { value } else { good }]);
        }
        if !args.contains(&flag) {
            args.extend([flag, value]);
        }
        args
    };
    for (flag, value, parts) in [
        ("--mu", "0", vec!["--mu", "above 0"]),
        ("--v0", "2,nan", vec!["--v0", "nan"]),
        ("--v0", "2,,3", vec!["--v0", "not a number"]),
        ("--v0", "2,2", vec!["--v0", "given twice"]),
        (
            "--v0",
            "2e9",
            vec!["--v0", "2000000000", "1e9 counts per sample"],
        ),
        ("--grid", "0", vec!["--grid", "1 or more"]),
        (
            "--grid",
            "10001",
            vec!["--grid", "grid of 10001", "1 to 10000"],
        ),
        ("--mu", "1e-320", vec!["--mu", "1e-320", "1e-100"]),
        ("--samples", "0", vec!["--samples", "1 or more"]),
        ("--rule", "best", vec!["--rule", "best", "window", "paper"]),
        ("--beta", "1..0", vec!["--beta", "1..0", "A..B"]),
        ("--beta", "-1..0", vec!["--beta", "A..B"]),
        ("--sigma", "0.5", vec!["--sigma", "A..B", "0..1"]),
        ("--sigma", "0..inf", vec!["--sigma", "inf"]),
        ("--shard", "0/4", vec!["--shard", "0/4", "1 ≤ I ≤ N"]),
        ("--shard", "5/4", vec!["--shard", "5/4"]),
        (
            "--shard",
            "1/10000000000000",
            vec!["--shard", "16 cells", "up to 16"],
        ),
        ("--shard", "1/4", vec!["--shard", "--out NAME or --json"]),
    ] {
        refused(&map(flag, value), 2, &parts);
    }
    refused(&["map", "--mu", "50"], 2, &["--v0", "--grid", "--samples"]);
}

const SCENE: &str = r#"
[device]
inertia_kg_m2 = 6.28e-6
viscous_nm_s_rad = 9e-6
coulomb_nm = 2e-3
counts_per_rev = 8192

[loop]
sample_period_s = 1e-3
decimation = 1

[render]
law = "raw"
shape = "spring"
stiffness_nm_rad = 1.0

[start]
angle_rad = 0.0
velocity_rad_s = 3.0

[run]
samples = 200
seed = 1
"#;

#[test]
fn scene_files_that_make_no_sense_are_refused_with_file_key_and_value() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let path = file.to_str().unwrap();
    fs::write(&file, SCENE).unwrap();
    json(&["simulate", path, "--json"]);
    let change = |from: &str, to: &str, parts: &[&str]| {
        assert!(SCENE.contains(from), "{from}");
        fs::write(&file, SCENE.replacen(from, to, 1)).unwrap();
        let mut all = vec!["scene.toml"];
        all.extend(parts);
        refused(&["simulate", path, "--json"], 1, &all);
    };
    change(
        "6.28e-6",
        "-1.0",
        &["device.inertia_kg_m2 is -1", "above 0"],
    );
    change("6.28e-6", "0", &["device.inertia_kg_m2 is 0"]);
    change("6.28e-6", "nan", &["device.inertia_kg_m2 is NaN"]);
    change(
        "6.28e-6",
        "\"6.28 g cm²\"",
        &["inertia_kg_m2", "string", "line 3"],
    );
    change(
        "9e-6",
        "-9e-6",
        &["device.viscous_nm_s_rad is -0.000009", "0 or more"],
    );
    change("2e-3", "inf", &["device.coulomb_nm is inf"]);
    change("8192", "0", &["device.counts_per_rev is 0"]);
    change(
        "counts_per_rev = 8192",
        "counts_per_rev = 8192\ncount_rad = 1e-3",
        &["both given"],
    );
    change(
        "counts_per_rev = 8192",
        "",
        &["counts_per_rev is missing", "count_rad"],
    );
    change(
        "counts_per_rev",
        "counts_per_turn",
        &["unknown field `counts_per_turn`", "counts_per_rev"],
    );
    change("1e-3\n", "0.0\n", &["loop.sample_period_s is 0", "above 0"]);
    change("1e-3\n", "-1e-3\n", &["loop.sample_period_s is -0.001"]);
    // What an f32 takes for nothing or for infinite.
    change(
        "1e-3\n",
        "1e-300\n",
        &["loop.sample_period_s is 1e-300", "from 1e-15 to 1e15"],
    );
    change("6.28e-6", "1e-60", &["device.inertia_kg_m2 is 1e-60"]);
    change("2e-3", "1e60", &["device.coulomb_nm is 1e60", "up to 1e15"]);
    change("8192", "1e300", &["device.counts_per_rev is 1e300"]);
    change("1.0\n", "1e39\n", &["render.stiffness_nm_rad is 1e39"]);
    change(
        "decimation = 1",
        "torque_max_nm = 1e39",
        &["loop.torque_max_nm is 1e39", "3.4e38"],
    );
    change(
        "[start]",
        "[believed]\ninertia_kg_m2 = 0\n[start]",
        &["believed.inertia_kg_m2 is 0", "above 0"],
    );
    change(
        "decimation = 1",
        "decimation = 0",
        &["loop.decimation is 0"],
    );
    change("decimation = 1", "decimation = -4", &["decimation", "-4"]);
    change("decimation = 1", "decimation = 2.5", &["decimation", "2.5"]);
    change(
        "[start]",
        "[believed]\ncoulomb_nm = [2e-3, 1e-3]\n[start]",
        &["believed.coulomb_nm is [0.002, 0.001]", "lower end first"],
    );
    change(
        "[start]",
        "[believed]\ncoulomb_nm = \"low\"\n[start]",
        &["expected a number, or [low, high]"],
    );
    change(
        "decimation = 1",
        "torque_max_nm = -1",
        &["loop.torque_max_nm is -1"],
    );
    change(
        "\"raw\"",
        "\"bounded\"",
        &["bounded", "raw", "static", "episode", "ledger", "auto"],
    );
    change(
        "\"spring\"",
        "\"bump\"",
        &["bump", "spring", "wall", "detent"],
    );
    change("1.0\n", "-1.0\n", &["render.stiffness_nm_rad is -1"]);
    change("1.0\n", "nan\n", &["render.stiffness_nm_rad is NaN"]);
    change(
        "1.0\n",
        "1.0\nwall_rad = 0.1\n",
        &["render.wall_rad", "centre_rad"],
    );
    change(
        "1.0\n",
        "1.0\ncentre_rad = inf\n",
        &["render.centre_rad is inf"],
    );
    change(
        "1.0\n",
        "1.0\ncentre_rad = 1e12\n",
        &["render.centre_rad is 1000000000000", "counts", "accepted"],
    );
    change(
        "angle_rad = 0.0",
        "angle_rad = nan",
        &["start.angle_rad is NaN"],
    );
    change(
        "angle_rad = 0.0",
        "angle_rad = 1e9",
        &["start.angle_rad is 1000000000", "accepted"],
    );
    change(
        "velocity_rad_s = 3.0",
        "velocity_rad_s = -inf",
        &["start.velocity_rad_s is -inf"],
    );
    change(
        "velocity_rad_s = 3.0",
        "velocity_rad_s = 1e12",
        &["start.velocity_rad_s is 1000000000000"],
    );
    change("samples = 200", "samples = 0", &["run.samples is 0"]);
    change("samples = 200", "samples = -1", &["samples"]);
    change("[render]", "[render", &["line 12"]);
    change(
        "law = \"raw\"",
        "law = \"raw\"\nlaw = \"raw\"",
        &["law", "duplicate"],
    );

    // A file written halfway, one that is no text, a folder, and none.
    fs::write(&file, &SCENE[..SCENE.len() / 2]).unwrap();
    refused(&["simulate", path], 1, &["scene.toml"]);
    fs::write(&file, [0xff, 0xfe, 0x00, 0x80]).unwrap();
    refused(&["simulate", path], 1, &["scene.toml", "UTF-8"]);
    refused(
        &["simulate", folder.path().to_str().unwrap()],
        1,
        &["cannot read"],
    );
    refused(
        &["simulate", "nowhere.toml"],
        1,
        &["cannot read nowhere.toml"],
    );
    refused(&["plan", "nowhere.toml"], 1, &["cannot read nowhere.toml"]);
    fs::write(&file, SCENE.replace("6.28e-6", "-1")).unwrap();
    refused(
        &["plan", path],
        1,
        &["scene.toml", "device.inertia_kg_m2 is -1"],
    );
}

#[test]
fn every_number_of_a_scene_is_checked_by_its_key() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let path = file.to_str().unwrap();
    let with = |table: &str, line: &str| {
        let header = format!("[{table}]\n");
        let text = if SCENE.contains(&header) {
            SCENE.replacen(&header, &format!("{header}{line}\n"), 1)
        } else {
            format!("{SCENE}{header}{line}\n")
        };
        fs::write(&file, text).unwrap();
    };
    // Key, a value that is accepted, whether it may be negative.
    for (table, key, good, signed) in [
        ("device", "cogging_nm", "1e-4\ncogging_per_rev = 14", false),
        ("device", "cogging_per_rev", "14", false),
        ("device", "stiction_nm", "1e-4\nstribeck_rad_s = 0.5", false),
        ("device", "stribeck_rad_s", "0.5", false),
        ("loop", "delay_s", "1e-4", false),
        ("loop", "amplifier_tau_s", "1e-4", false),
        ("loop", "torque_step_nm", "1e-4", false),
        ("loop", "torque_max_nm", "0.5", false),
        ("loop", "jitter_s", "1e-4", false),
        ("loop", "missed_ticks", "0.1", false),
        ("believed", "inertia_kg_m2", "6e-6", false),
        ("believed", "viscous_nm_s_rad", "8e-6", false),
        ("believed", "coulomb_nm", "1e-3", false),
        ("believed", "counts_per_rev", "4096", false),
        ("believed", "count_rad", "1e-3", false),
        ("believed", "sample_period_s", "2e-3", false),
        ("believed", "delay_s", "1e-4", false),
        ("believed", "amplifier_tau_s", "1e-4", false),
        ("believed", "torque_step_nm", "1e-4", false),
        ("believed", "jitter_s", "1e-4", false),
        ("believed", "missed_ticks", "0.1", false),
        ("render", "damping_nm_s_rad", "1e-5", false),
        ("render", "centre_rad", "-0.1", true),
        ("hand", "inertia_kg_m2", "1e-5", false),
        ("hand", "damping_nm_s_rad", "1e-4", false),
        ("hand", "stiffness_nm_rad", "0.1", false),
        ("hand", "rest_rad", "-0.1", true),
        ("hand", "push_nm", "-1e-3", true),
        ("hand", "shake_nm", "-1e-3", true),
        ("hand", "shake_hz", "450", false),
    ] {
        with(table, &format!("{key} = {good}"));
        json(&["simulate", path, "--json"]);
        let name = format!("{table}.{key} is ");
        for bad in ["nan", "inf", "-inf", "1e300"] {
            with(table, &format!("{key} = {bad}"));
            refused(
                &["simulate", path, "--json"],
                1,
                &["scene.toml", &name, "accepted: "],
            );
        }
        if !signed {
            with(table, &format!("{key} = -0.25"));
            let parts = ["scene.toml", &name, "-0.25", "accepted: "];
            refused(&["simulate", path, "--json"], 1, &parts);
        }
        for wrong in ["\"much\"", "true", "[]"] {
            with(table, &format!("{key} = {wrong}"));
            let parts = ["scene.toml", key, "line", "expected"];
            refused(&["simulate", path, "--json"], 1, &parts);
        }
    }
    for (table, line, parts) in [
        (
            "loop",
            "delay = 1",
            &["unknown field `delay`", "delay_s"][..],
        ),
        ("hand", "push = 1", &["unknown field `push`", "push_nm"]),
        (
            "believed",
            "decimation = 2",
            &["unknown field `decimation`", "counts_per_rev"],
        ),
        ("render", "wall = 1", &["unknown field `wall`", "wall_rad"]),
        ("world", "g = 9.8", &["unknown field `world`", "hand"]),
        // What is wrong only beside something else.
        (
            "loop",
            "jitter_s = 1e-3",
            &["loop.jitter_s is 0.001", "less than the sample period"],
        ),
        (
            "believed",
            "jitter_s = 2e-3",
            &["believed.jitter_s is 0.002", "less than the sample period"],
        ),
        (
            "loop",
            "missed_ticks = 0.6",
            &["loop.missed_ticks is 0.6", "0 to 0.5", "no two"],
        ),
        (
            "loop",
            "delay_s = 1.5",
            &["loop.delay_s is 1.5", "up to 1 s", "1000 sample periods"],
        ),
        (
            "hand",
            "shake_hz = 2e4",
            &["hand.shake_hz is 20000", "up to 10000 Hz", "10 turns"],
        ),
        (
            "hand",
            "stiffness_nm_rad = 1e9",
            &["hand.stiffness_nm_rad is 1000000000", "up to 6.28e6 Nm/rad"],
        ),
        (
            "believed",
            "count_rad = 1e-3\ncounts_per_rev = 9",
            &["believed.counts_per_rev", "both given"],
        ),
        (
            "render",
            "period_rad = 0.2",
            &["render.period_rad is given", "reads centre_rad"],
        ),
        ("run", "# seed\nseed = -1", &["duplicate", "seed"]),
    ] {
        with(table, line);
        refused(&["simulate", path, "--json"], 1, parts);
    }
}

#[test]
fn shapes_and_laws_are_checked_against_the_keys_they_read() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let path = file.to_str().unwrap();
    let with = |law: &str, shape: &str, render: &str, sampling: &str| {
        let text = SCENE
            .replace("\"raw\"", &format!("\"{law}\""))
            .replace("\"spring\"", &format!("\"{shape}\"\n{render}"))
            .replace("decimation = 1", sampling);
        fs::write(&file, text).unwrap();
    };
    for law in ["raw", "static", "episode", "ledger", "auto"] {
        for (shape, keys) in [
            ("spring", "centre_rad = 0.1"),
            ("wall", "wall_rad = -0.1"),
            ("detent", "centre_rad = 0.01\nperiod_rad = 0.2"),
        ] {
            with(law, shape, keys, "");
            let out = json(&["simulate", path, "--json"]);
            let law_end = out["law_end"].as_str().unwrap();
            let in_force: &[&str] = match law {
                "auto" => &["static", "episode", "ledger"],
                other => &[other],
            };
            assert!(in_force.contains(&law_end), "{law}: {law_end}");
            assert!(!out["reason_end"].as_str().unwrap().is_empty());
            for key in ["min_account_j", "max_account_j", "torque_end_nm"] {
                assert!(out[key].is_number(), "{law} {shape}: {key}");
            }
        }
    }
    for (shape, keys, parts) in [
        ("detent", "", &["render.period_rad is missing"][..]),
        (
            "detent",
            "period_rad = 1e-3",
            &["render.period_rad is 0.001", "0.00153398", "two counts"],
        ),
        ("detent", "period_rad = 0.0", &["render.period_rad is 0"]),
        (
            "detent",
            "period_rad = -0.2",
            &["render.period_rad is -0.2"],
        ),
        ("detent", "period_rad = nan", &["render.period_rad is NaN"]),
        (
            "detent",
            "period_rad = 1e300",
            &["render.period_rad is 1e300"],
        ),
        ("detent", "period_rad = \"p\"", &["period_rad", "string"]),
        (
            "detent",
            "period_rad = 0.2\nwall_rad = 0.1",
            &["render.wall_rad is given", "period_rad and centre_rad"],
        ),
        (
            "wall",
            "centre_rad = 0.1",
            &["render.centre_rad is given", "reads wall_rad"],
        ),
        ("wall", "wall_rad = inf", &["render.wall_rad is inf"]),
    ] {
        with("raw", shape, keys, "");
        refused(&["simulate", path], 1, parts);
    }
    // A delay beyond a period is for the laws that look no further ahead.
    for law in ["raw", "static", "episode"] {
        with(law, "spring", "", "delay_s = 2.5e-3");
        json(&["simulate", path, "--json"]);
    }
    for law in ["ledger", "auto"] {
        with(law, "spring", "", "delay_s = 2.5e-3");
        let by = format!("law = \"{law}\"");
        refused(
            &["simulate", path],
            1,
            &["loop.delay_s is 0.0025", "up to 0.001 s", &by],
        );
        with(
            law,
            "spring",
            "",
            "delay_s = 1e-4\njitter_s = 4e-4\n[believed]\ndelay_s = 7e-4",
        );
        refused(
            &["simulate", path],
            1,
            &["believed.delay_s is 0.0007", "up to 6e-4 s"],
        );
    }
}

#[test]
fn what_is_believed_is_what_the_controller_is_told_and_no_more() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let run = |law: &str, believed: &str| {
        let text = SCENE.replace("\"raw\"", &format!("\"{law}\""));
        fs::write(&file, format!("{text}[believed]\n{believed}\n")).unwrap();
        json(&["simulate", file.to_str().unwrap(), "--json"])
    };
    let applied = |believed| {
        run("static", believed)["max_stiffness_nm_rad"]
            .as_f64()
            .unwrap()
    };
    let near = |got: f64, want: f64| assert!((got / want - 1.0).abs() < 1e-5, "{got}, not {want}");
    // 2b/Te, Te = T_max + 2·delay + 2τ.
    near(applied(""), 0.018);
    near(applied("viscous_nm_s_rad = [6e-6, 9e-6]"), 0.012);
    near(applied("sample_period_s = 2e-3"), 0.009);
    near(applied("delay_s = 5e-4"), 0.009);
    near(applied("amplifier_tau_s = 5e-4"), 0.009);
    near(applied("jitter_s = 5e-4"), 0.012);
    near(applied("missed_ticks = 1e-3"), 0.009);
    // 2c/Δ.
    near(
        applied("viscous_nm_s_rad = 1.0\ncounts_per_rev = 1024"),
        0.651_898_6,
    );
    // A count believed half as large is half the torque, and half the deflection.
    let (truth, half) = (run("raw", ""), run("raw", "counts_per_rev = 16384"));
    let stiffer = half["peak_angle_rad"].as_f64().unwrap();
    assert!(stiffer > 1.1 * truth["peak_angle_rad"].as_f64().unwrap());
    // The truth itself changes nothing.
    let same = "count_rad = 7.669903939428206e-4\ndelay_s = 0.0\nsample_period_s = 1e-3\ninertia_kg_m2 = 6.28e-6";
    assert_eq!(run("ledger", same), run("ledger", ""));
}

#[test]
fn jitter_is_the_same_for_the_same_seed() {
    let folder = TempDir::new().unwrap();
    let (file, trace) = (
        folder.path().join("scene.toml"),
        folder.path().join("trace.csv"),
    );
    let run = |seed: u64| {
        let text = SCENE
            .replace("seed = 1", &format!("seed = {seed}"))
            .replace("decimation = 1", "jitter_s = 3e-4\nmissed_ticks = 0.2");
        fs::write(&file, text).unwrap();
        let (file, trace) = (file.to_str().unwrap(), trace.to_str().unwrap());
        json(&["simulate", file, "--json", "--force", "--trace", trace]);
        fs::read_to_string(trace).unwrap()
    };
    let first = run(1);
    assert_eq!(first, run(1));
    assert_ne!(first, run(2));
    let column = |row: &str| row.split(',').next().unwrap().parse::<f64>().unwrap();
    let times: Vec<f64> = first.lines().skip(1).map(column).collect();
    let steps = times.windows(2).map(|pair| pair[1] - pair[0]);
    let (mut shortest, mut longest) = (f64::MAX, 0.0_f64);
    for step in steps {
        shortest = shortest.min(step);
        longest = longest.max(step);
    }
    assert!(shortest >= 7e-4 - 1e-12 && longest <= 2.6e-3 + 1e-12);
    assert!(longest > 1.4e-3, "none was missed: {longest}");
}

#[test]
fn every_scene_of_the_repository_does_what_it_says() {
    for (name, class, law_end) in [
        ("ledger-wall", "rest", "ledger"),
        ("ledger-push", "rest", "ledger"),
        ("detent", "rest", "episode"),
        ("delay-unaccounted", "unstable", "raw"),
        ("delay-accounted", "rest", "raw"),
        ("dac-rounding", "limit-cycle", "raw"),
        ("wall-off-edge", "rest", "raw"),
        ("fast-amplifier", "rest", "ledger"),
    ] {
        let file = repository().join(format!("scenes/{name}.toml"));
        let out = json(&["simulate", file.to_str().unwrap(), "--json"]);
        assert_eq!(out["class"], class, "{name}");
        assert_eq!(out["law_end"], law_end, "{name}");
        let excess = out["energy_excess_j"].as_f64().unwrap();
        let gains = ["delay-unaccounted", "wall-off-edge"].contains(&name);
        assert_eq!(excess > 0.0, gains, "{name}: {excess}");
        let holds = out["criterion_holds_at_start"].as_bool().unwrap();
        assert_eq!(holds, name == "delay-accounted", "{name}");
        if name == "ledger-push" {
            assert!(out["stiffness_end_nm_rad"].as_f64().unwrap() >= 3.6);
        }
        let words = run(&["simulate", file.to_str().unwrap()]).stdout;
        let words = String::from_utf8(words).unwrap();
        let reason = out["reason_end"].as_str().unwrap();
        assert!(words.contains(reason) && words.contains(law_end), "{words}");
        assert_eq!(
            words.contains("account      "),
            ["ledger-wall", "ledger-push", "detent", "fast-amplifier"].contains(&name)
        );
    }
}

#[test]
fn a_map_writes_its_three_files_and_reports_both_rules() {
    let folder = TempDir::new().unwrap();
    let name = folder.path().join("map");
    let name = name.to_str().unwrap();
    let flags = [
        "map",
        "--mu",
        "50",
        "--v0",
        "2,-10.0",
        "--grid",
        "12",
        "--samples",
        "9000",
        "--json",
    ];
    let mut args = flags.to_vec();
    args.extend(["--out", name]);
    let out = json(&args);
    assert_eq!((&out["mu"], &out["samples"]), (&50.0.into(), &9000.into()));
    assert_eq!((&out["grid"], &out["rule"]), (&12.into(), &"window".into()));
    assert_eq!(out["v0"], serde_json::json!([2, -10.0]));
    for v0 in ["2", "-10.0"] {
        let rows = out["classes"][v0].as_array().unwrap();
        assert_eq!(rows.len(), 12);
        let mut unstable = 0;
        for row in rows {
            let row = row.as_array().unwrap();
            assert_eq!(row.len(), 12);
            assert!(row.iter().all(|code| code.as_u64().unwrap() <= 2));
            unstable += row.iter().filter(|code| **code == 2).count() as u64;
        }
        assert_eq!(out["cells"][v0]["window"]["unstable"], unstable);
        assert_eq!(out["predictions"][v0]["criterion_missed"], 0);
        assert!(out["cells"][v0]["paper"]["limit_cycle"].is_u64());
        // β runs over the rows, σ inside them: the first row has the least viscous friction.
        assert_eq!(rows[0][0], 2);
        assert_eq!(rows[11][11], 0);
        assert_eq!(rows[11][0], 1);
    }
    let file = |ending: &str| fs::read_to_string(format!("{name}.{ending}")).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&file("json")).unwrap(), out);
    assert_eq!(file("csv").lines().count(), 1 + 2 * 144);
    assert!(file("svg").contains("from -10.0 counts per sample"));
    refused(&args, 1, &["--out", "map.svg", "--force"]);

    let paper = json(&[&flags[..], &["--rule", "paper"]].concat());
    assert_eq!(paper["rule"], "paper");
    assert_eq!(paper["cells"], out["cells"]);
    assert_ne!(paper["classes"], out["classes"]);
}

#[test]
fn shards_merged_equal_the_whole_byte_for_byte() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let flags = [
        "map",
        "--mu",
        "50",
        "--v0",
        "2,10",
        "--grid",
        "15",
        "--samples",
        "8000",
    ];
    let whole = at("whole");
    assert!(
        run(&[&flags[..], &["--out", &whole]].concat())
            .status
            .success()
    );
    let mut parts = Vec::new();
    for number in 1..=4 {
        let part = at(&format!("part-{number}"));
        let shard = format!("{number}/4");
        assert!(
            run(&[&flags[..], &["--shard", &shard, "--out", &part]].concat())
                .status
                .success()
        );
        parts.push(format!("{part}.json"));
    }
    let merged = at("merged");
    let merge = |parts: &[String], name: &str| {
        let mut args = vec!["map", "--out", name, "--merge"];
        args.extend(parts.iter().map(String::as_str));
        run(&args)
    };
    // In any order.
    parts.swap(0, 2);
    assert!(merge(&parts, &merged).status.success());
    for ending in ["svg", "csv", "json"] {
        let read = |name: &str| fs::read(format!("{name}.{ending}")).unwrap();
        assert!(read(&whole) == read(&merged), "{ending} differs");
    }

    let refused = |parts: &[String], words: &str| {
        let output = merge(parts, &at("none"));
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1));
        assert!(said.contains(words), "{said}");
        assert!(!Path::new(&at("none.svg")).exists());
    };
    refused(&parts[..3], "of 4 parts these are missing: 4");
    refused(
        &[&parts[..], &parts[..1]].concat(),
        "part 3 of 4 came before",
    );
    refused(&[at("nowhere.json")], "nowhere.json");
    refused(&[format!("{whole}.json")], "whole.json");
    let other = at("other");
    let foreign = [
        "map",
        "--mu",
        "51",
        "--v0",
        "2,10",
        "--grid",
        "15",
        "--samples",
        "8000",
    ];
    assert!(
        run(&[&foreign[..], &["--shard", "1/4", "--out", &other]].concat())
            .status
            .success()
    );
    refused(
        &[parts[1].clone(), format!("{other}.json")],
        "a part of another map",
    );
    // Half a part.
    let text = fs::read_to_string(&parts[0]).unwrap();
    fs::write(at("half.json"), &text[..text.len() / 2]).unwrap();
    refused(&[at("half.json")], "half.json");
    fs::write(
        at("odd.json"),
        text.replacen("\"window\":\"", "\"window\":\"7", 1),
    )
    .unwrap();
    refused(&[at("odd.json")], "cells where");
}

#[test]
fn a_plan_answers_both_questions() {
    let plan = json(&["plan", "--motor", "RE35", "--stiffness", "1", "--json"]);
    let near = |value: &Value, want: f64| (value.as_f64().unwrap() / want - 1.0).abs() < 1e-3;
    assert!(near(&plan["viscous_limit_nm_rad"], 0.018));
    assert!(near(&plan["coulomb_limit_nm_rad"], 5.2152));
    assert!(near(&plan["largest_stiffness_nm_rad"], 0.018));
    // min(m/T², 3c/Δ) = m/T².
    assert!(near(&plan["ledger_cap_nm_rad"], 6.28e-6 / 1e-6));
    let at_10 = plan["at_speed"]
        .as_array()
        .unwrap()
        .iter()
        .find(|at| at["speed_rad_s"] == 10.0);
    assert!(near(&at_10.unwrap()["largest_stiffness_nm_rad"], 0.3882));
    let wanted = &plan["wanted"];
    assert_eq!(wanted["region"], "d");
    assert!(near(&wanted["passive_up_to_rad_s"], 3.292));
    assert!(near(
        &wanted["every_speed"]["sample_period_s_at_most"],
        1.8e-5
    ));
    assert!(near(
        &wanted["every_speed"]["counts_per_rev_at_least"],
        1570.8
    ));

    // What it says would do, does: by the library's own criterion, through a device file.
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("device.toml");
    for change in wanted["one_change"].as_array().unwrap() {
        if change["passive_as_it_is"] == true {
            continue;
        }
        let speed = change["speed_rad_s"].as_f64().unwrap();
        let device = |viscous: f64, coulomb: f64, period: f64| {
            let text = format!(
                "[device]\ninertia_kg_m2 = 6.28e-6\nviscous_nm_s_rad = {viscous}\ncoulomb_nm = {coulomb}\n\
                 counts_per_rev = 8192\n[loop]\nsample_period_s = {period}\n"
            );
            fs::write(&file, text).unwrap();
            let plan = json(&["plan", file.to_str().unwrap(), "--stiffness", "1", "--json"]);
            let rows = plan["wanted"]["one_change"].as_array().unwrap().clone();
            let row = rows
                .into_iter()
                .find(|row| row["speed_rad_s"] == speed)
                .unwrap();
            row["passive_as_it_is"].as_bool().unwrap()
        };
        let need = |key: &str| change[key].as_f64().unwrap();
        let (b, c, t) = (9e-6, 2e-3, 1e-3);
        assert!(device(need("viscous_nm_s_rad_at_least") * 1.000_001, c, t));
        assert!(!device(need("viscous_nm_s_rad_at_least") * 0.999, c, t));
        assert!(device(b, need("coulomb_nm_at_least") * 1.000_001, t));
        assert!(!device(b, need("coulomb_nm_at_least") * 0.999, t));
        assert!(device(b, c, need("sample_period_s_at_most") * 0.999_999));
        assert!(!device(b, c, need("sample_period_s_at_most") * 1.001));
    }
    let svg = folder.path().join("plan.svg");
    assert!(
        run(&[
            "plan",
            "--motor",
            "gimbal-light",
            "--plot",
            svg.to_str().unwrap()
        ])
        .status
        .success()
    );
    assert!(
        fs::read_to_string(svg)
            .unwrap()
            .contains("how stiff at which speed")
    );
}

#[test]
fn the_figures_are_all_drawn() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("new/figures");
    assert!(
        run(&["figures", "--out", out.to_str().unwrap()])
            .status
            .success()
    );
    for name in [
        "fig3",
        "fig4",
        "fig5a",
        "fig5b",
        "fig5-panels",
        "fig6a",
        "fig6b",
        "fig6c",
        "fig6d",
    ] {
        let svg = fs::read_to_string(out.join(format!("{name}.svg"))).unwrap();
        assert!(svg.trim_end().ends_with("</svg>"), "{name}");
        assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{name}");
    }
    for name in ["fig5a", "fig5b"] {
        let shown = texts(&fs::read_to_string(out.join(format!("{name}.svg"))).unwrap());
        for v0 in ["2", "10", "100"] {
            assert!(
                shown.iter().any(|text| text == v0),
                "{name} {v0}: {shown:?}"
            );
        }
    }
    // Any one that exists is found before the work, and nothing is written.
    for name in ["fig3", "fig4", "fig5a", "fig5b", "fig5-panels", "fig6b"] {
        fs::remove_file(out.join(format!("{name}.svg"))).unwrap();
    }
    refused(
        &["figures", "--out", out.to_str().unwrap()],
        1,
        &["fig6a.svg", "--force"],
    );
    assert!(!out.join("fig3.svg").exists());
    let list = json(&[
        "figures",
        "--json",
        "--force",
        "--out",
        out.to_str().unwrap(),
    ]);
    let list = list["figures"].as_array().unwrap();
    assert_eq!(list.len(), 9);
    for figure in list {
        assert!(Path::new(figure["file"].as_str().unwrap()).is_file());
        assert!(figure["shows"].is_string());
    }
}

#[test]
fn every_command_has_help_with_an_example() {
    for command in ["simulate", "map", "plan", "figures"] {
        let output = run(&[command, "--help"]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(
            output.status.success() && text.contains("Example"),
            "{command}"
        );
        assert!(text.contains(&format!("knob {command} ")), "{command}");
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_long_work_within_a_second_and_leaves_nothing() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let long_scene = at("long.toml");
    // A limit cycle: it runs as long as it is told to.
    let endless = SCENE
        .replace("samples = 200", "samples = 1000000000000")
        .replace("8192", "20")
        .replace("nm_rad = 1.0", "nm_rad = 0.015");
    fs::write(&long_scene, endless).unwrap();
    let (out, trace) = (at("map"), at("trace.csv"));
    let samples = "1000000000000";
    for args in [
        vec![
            "map",
            "--mu",
            "50",
            "--v0",
            "2,10",
            "--grid",
            "300",
            "--samples",
            samples,
            "--out",
            &out,
        ],
        // Heavy damping: the scalar core.
        vec![
            "map",
            "--mu",
            "0.05",
            "--v0",
            "2",
            "--grid",
            "9",
            "--sigma",
            "0..0.4",
            "--samples",
            samples,
            "--out",
            &out,
        ],
        vec!["simulate", &long_scene, "--trace", &trace],
        vec![
            "simulate",
            "--mu",
            "50",
            "--beta",
            "0.6",
            "--sigma",
            "0.3",
            "--v0",
            "9",
            "--samples",
            samples,
        ],
    ] {
        let mut child = knob()
            .args(&args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(400));
        assert!(
            child.try_wait().unwrap().is_none(),
            "{args:?} ended by itself"
        );
        let asked = Instant::now();
        let killed = Command::new("kill")
            .args(["-INT", &child.id().to_string()])
            .status()
            .unwrap();
        assert!(killed.success());
        let output = child.wait_with_output().unwrap();
        let took = asked.elapsed();
        assert_eq!(output.status.code(), Some(130), "{args:?}");
        println!("{args:?}: stopped after {took:?}");
        assert!(output.stdout.is_empty());
        let left: Vec<_> = fs::read_dir(folder.path())
            .unwrap()
            .map(|e| e.unwrap().file_name())
            .collect();
        assert_eq!(left, ["long.toml"], "{args:?} left something behind");
    }
}

#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_is_no_failure_and_a_full_disk_is_one() {
    let scene = repository().join("scenes/fig6c.toml");
    let scene = scene.to_str().unwrap();
    let display = "simulate --mu 50 --beta 0.3 --sigma 0.7 --v0 10 --samples 9";
    let map = "map --mu 50 --v0 2 --grid 4 --samples 10";
    let mut all: Vec<Vec<&str>> = ["plan --stiffness 1", "plan --json", display, map]
        .map(|line| line.split(' ').collect())
        .into();
    all.push([&all[2][..], &["--json"]].concat());
    all.push([&all[3][..], &["--json"]].concat());
    all.push(vec!["simulate", scene]);
    for args in all {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let gone = knob().args(&args).stdout(writer).output().unwrap();
        let said = String::from_utf8_lossy(&gone.stderr);
        assert_eq!(gone.status.code(), Some(0), "{args:?}: {said}");
        if cfg!(target_os = "linux") {
            let full = fs::File::options().write(true).open("/dev/full").unwrap();
            let full = knob().args(&args).stdout(full).output().unwrap();
            let said = String::from_utf8_lossy(&full.stderr);
            assert_eq!(full.status.code(), Some(1), "{args:?}: {said}");
            assert!(said.contains("standard output"), "{args:?}: {said}");
        }
    }
}

const DISPLAY: [&str; 9] = [
    "simulate",
    "--mu",
    "50",
    "--beta",
    "0.3",
    "--sigma",
    "0.7",
    "--samples",
    "9",
];

#[test]
fn the_dimensionless_display_has_neither_trace_nor_plot() {
    for flag in ["--trace", "--plot"] {
        let args = [&DISPLAY[..], &["--v0", "10", flag, "nowhere/out"]].concat();
        refused(&args, 2, &[flag, "nowhere/out", "scene file"]);
    }
}

#[test]
fn a_display_that_diverges_is_followed_to_the_last_sample() {
    let args = "simulate --mu 50 --beta 0.1 --sigma 0.1 --v0 9 --samples 20000 --json";
    let out = json(&args.split(' ').collect::<Vec<_>>());
    assert_eq!(
        (&out["samples"], &out["class"]),
        (&20_000.into(), &"unstable".into())
    );
    assert!(
        out["xi"]
            .as_f64()
            .unwrap()
            .abs()
            .max(out["v"].as_f64().unwrap().abs())
            > 1e9
    );
    // Where no f64 holds it, the last that does.
    let args = "simulate --mu 0.1 --beta 0 --sigma 0 --v0 9 --samples 99999 --json";
    let out = json(&args.split(' ').collect::<Vec<_>>());
    assert_eq!(out["class"], "unstable");
    for key in [
        "xi",
        "v",
        "energy_generated",
        "energy_dissipated",
        "energy_given_out",
    ] {
        assert!(out[key].is_number(), "{key}: {out}");
    }
}

#[test]
fn a_start_under_load_is_judged_by_the_speed_it_can_turn_into() {
    let args =
        "simulate --mu 0.2428 --beta 0.0199 --sigma 0.6607 --v0 0.328 --samples 50000 --json --xi0";
    let from = |xi0| json(&args.split(' ').chain([xi0]).collect::<Vec<_>>());
    assert_eq!(from("0")["criterion_holds_at_start"], true);
    let loaded = from("0.994");
    assert_eq!(loaded["criterion_holds_at_start"], false);
    assert_eq!(loaded["class"], "unstable");

    // A spring that is held away from its zero, and a wall from outside and inside.
    let folder = TempDir::new().unwrap();
    let (file, plot) = (
        folder.path().join("scene.toml"),
        folder.path().join("out.svg"),
    );
    for (shape, angle, holds) in [
        ("\"spring\"", "0.0", true),
        ("\"spring\"", "-0.3", false),
        ("\"wall\"", "-0.3", true),
        ("\"wall\"", "0.3", false),
    ] {
        let text = SCENE
            .replace("\"spring\"", shape)
            .replace("angle_rad = 0.0", &format!("angle_rad = {angle}"));
        fs::write(&file, text).unwrap();
        let (file, plot) = (file.to_str().unwrap(), plot.to_str().unwrap());
        let out = json(&["simulate", file, "--json", "--force", "--plot", plot]);
        assert_eq!(out["criterion_holds_at_start"], holds, "{shape} {angle}");
        let words = if holds {
            "(10) holds"
        } else {
            "(10) does not hold"
        };
        assert!(
            fs::read_to_string(plot).unwrap().contains(words),
            "{shape} {angle}"
        );
    }
}

#[test]
fn a_part_of_more_parts_than_cells_is_refused() {
    let folder = TempDir::new().unwrap();
    let part = folder.path().join("part.json");
    let text = r#"{"shard":[2,10000000000000],"map":{"mu":50.0,"samples":10,"grid":1,"beta":[0.0,1.0],"sigma":[0.0,1.0],"v0":["2"]},"window":"","paper":""}"#;
    fs::write(&part, text).unwrap();
    let path = part.to_str().unwrap();
    refused(
        &["map", "--merge", path],
        1,
        &["part.json", "1 cells", "accepted"],
    );
}

#[cfg(target_os = "linux")]
#[test]
fn an_output_that_cannot_be_is_refused_before_the_work() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    // Work without an end: only a refusal before it returns.
    let map: Vec<&str> = "map --mu 50 --v0 2 --grid 300 --samples 1000000000000 --out /proc/map"
        .split(' ')
        .collect();
    refused(&map, 1, &["--out: /proc/map.svg cannot be written"]);
    let said = run(&map).stderr;
    assert!(!String::from_utf8_lossy(&said).contains(".knob-"));

    let pipe = at("pipe");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    for odd in [pipe.as_str(), "/dev/null"] {
        refused(
            &["plan", "--plot", odd, "--force"],
            1,
            &["--plot", odd, "no ordinary file"],
        );
    }
    let scene = at("scene.toml");
    fs::write(&scene, SCENE).unwrap();
    std::os::unix::fs::symlink(&scene, at("link")).unwrap();
    for args in [
        vec!["--trace", &scene, "--force"],
        vec!["--plot", &at("link"), "--force"],
        vec!["--trace", &at("out"), "--plot", &at("./out")],
    ] {
        refused(
            &[&["simulate", scene.as_str()], &args[..]].concat(),
            2,
            &["the same file as"],
        );
    }
    refused(
        &["plan", &scene, "--plot", &scene, "--force"],
        2,
        &["--plot", "device file"],
    );
    assert_eq!(fs::read_to_string(&scene).unwrap(), SCENE);
    // Through a link the file is replaced, not the link.
    let target = at("target.svg");
    fs::write(&target, "old").unwrap();
    std::os::unix::fs::symlink(&target, at("plot")).unwrap();
    refused(&["plan", "--plot", &at("plot")], 1, &["--force"]);
    assert!(
        run(&["plan", "--plot", &at("plot"), "--force"])
            .status
            .success()
    );
    assert!(fs::read_to_string(&target).unwrap().starts_with("<svg"));
    assert!(fs::symlink_metadata(at("plot")).unwrap().is_symlink());
}

#[test]
fn a_plan_gives_no_answer_where_there_is_none() {
    // Beyond 2c/Δ = 5.2 Nm/rad it never rests, whatever the viscous friction.
    let plan = json(&["plan", "--stiffness", "5.3", "--json"]);
    for row in plan["wanted"]["one_change"].as_array().unwrap() {
        assert!(row["viscous_nm_s_rad_at_least"].is_null(), "{row}");
        assert!(row["sample_period_s_at_most"].is_null(), "{row}");
        assert!(row["coulomb_nm_at_least"].is_number(), "{row}");
    }
    // The describing function, where the oscillation is larger than a count.
    for at in plan["at_speed"].as_array().unwrap() {
        let fast = at["speed_rad_s"].as_f64().unwrap() >= 1.0;
        assert_eq!(at["describing_function_nm_rad"].is_number(), fast, "{at}");
    }
    let folder = TempDir::new().unwrap();
    let (file, plot) = (
        folder.path().join("dry.toml"),
        folder.path().join("plan.svg"),
    );
    for (viscous, coulomb) in [("0.0", "2e-3"), ("9e-6", "0.0"), ("0.0", "0.0")] {
        let text = SCENE.replace("9e-6", viscous).replace("2e-3", coulomb);
        fs::write(&file, text).unwrap();
        let args = ["plan", file.to_str().unwrap(), "--stiffness", "1"];
        let output = run(&[&args[..], &["--force", "--plot", plot.to_str().unwrap()]].concat());
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success());
        assert!(
            text.contains('–') && !text.contains("inf") && !text.contains("NaN"),
            "{text}"
        );
        let wanted = &json(&[&args[..], &["--json"]].concat())["wanted"];
        let every = &wanted["every_speed"];
        assert_eq!(every["sample_period_s_at_most"].is_null(), viscous == "0.0");
        assert_eq!(every["counts_per_rev_at_least"].is_null(), coulomb == "0.0");
        for row in wanted["one_change"].as_array().unwrap() {
            for key in ["sample_period_s_at_most", "counts_per_rev_at_least"] {
                assert!(
                    row[key].is_null() || row[key].as_f64().unwrap() > 0.0,
                    "{row}"
                );
            }
        }
    }
    // Few letters, and the file's name where it is at fault.
    fs::write(&file, SCENE.replace("8192", "333.3333333333333")).unwrap();
    let text = run(&["plan", file.to_str().unwrap()]).stdout;
    let text = String::from_utf8(text).unwrap();
    assert!(text.contains("333.333 counts/rev"), "{text}");
}

#[test]
fn the_papers_rule_reads_the_last_sample_of_a_short_run_too() {
    let args = "map --mu 50 --v0 10 --grid 8 --samples 500 --json --rule";
    let map = |rule| json(&args.split(' ').chain([rule]).collect::<Vec<_>>());
    let codes = |map: &Value, code: u64| {
        let rows = map["classes"]["10"].as_array().unwrap();
        let cells = rows.iter().flat_map(|row| row.as_array().unwrap());
        cells.filter(|cell| **cell == code).count()
    };
    let (paper, window) = (map("paper"), map("window"));
    assert_eq!(codes(&paper, 3), 0);
    assert!(codes(&paper, 1) > 0 && codes(&window, 3) > 0);
    let args = "simulate --mu 50 --beta 0.6 --sigma 0.3 --v0 10 --samples 500 --json";
    let out = json(&args.split(' ').collect::<Vec<_>>());
    assert_eq!(out["class"], "undecided");
    assert_ne!(out["class_paper"], "undecided");
}

#[test]
fn a_run_table_with_a_seed_alone_runs_as_long_as_one_without() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let run = |table: &str| {
        fs::write(&file, SCENE.replace("samples = 200\nseed = 1\n", table)).unwrap();
        json(&["simulate", file.to_str().unwrap(), "--json"])
    };
    assert_eq!(run("seed = 7\n"), run("samples = 50000\n"));
}

#[cfg(unix)]
fn interrupt(child: &std::process::Child) {
    let id = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &id])
            .status()
            .unwrap()
            .success()
    );
}

#[cfg(unix)]
#[test]
fn ctrl_c_is_heard_while_a_large_map_is_written() {
    use std::io::{BufRead, BufReader};
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("map");
    let mut child = knob()
        .args([
            "map",
            "--mu",
            "50",
            "--v0",
            "2",
            "--grid",
            "2000",
            "--samples",
            "1",
        ])
        .args(["--out", out.to_str().unwrap()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The sweep says when it is done.
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    assert!(said.any(|line| line.unwrap().contains("runs in")));
    interrupt(&child);
    assert!(said.any(|line| line.unwrap().contains("nothing was written")));
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    assert!(output.stdout.is_empty());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[cfg(unix)]
#[test]
fn a_second_ctrl_c_ends_at_once_what_cannot_be_stopped() {
    use std::io::Read;
    // More than a pipe holds, which nobody reads: it waits in the midst of printing.
    let mut child = knob()
        .args([
            "map",
            "--mu",
            "50",
            "--v0",
            "2",
            "--grid",
            "500",
            "--samples",
            "1",
        ])
        .arg("--json")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut first = [0];
    child
        .stdout
        .as_mut()
        .unwrap()
        .read_exact(&mut first)
        .unwrap();
    for _ in 0..100 {
        interrupt(&child);
        std::thread::sleep(Duration::from_millis(50));
        if let Some(status) = child.try_wait().unwrap() {
            assert_eq!(status.code(), Some(130));
            return;
        }
    }
    child.kill().unwrap();
    panic!("it went on");
}

/// The texts of a chart of one run of [`SCENE`], changed, each as it stands in the SVG.
fn plotted(changes: &[(&str, &str)]) -> Vec<String> {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut text = SCENE.to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    fs::write(at("scene.toml"), text).unwrap();
    json(&[
        "simulate",
        &at("scene.toml"),
        "--json",
        "--plot",
        &at("run.svg"),
    ]);
    texts(&fs::read_to_string(at("run.svg")).unwrap())
}

fn texts(svg: &str) -> Vec<String> {
    let parts = svg
        .split("</text>")
        .filter_map(|part| part.rsplit('>').next());
    parts.map(|text| text.trim().to_owned()).collect()
}

/// The labels of one axis: no two read the same.
fn distinct<'a>(labels: impl Iterator<Item = &'a String>) {
    let mut labels: Vec<&String> = labels.collect();
    let all = labels.len();
    assert!(all > 3, "{labels:?}");
    labels.sort();
    labels.dedup();
    assert_eq!(labels.len(), all, "{labels:?}");
}

#[test]
fn charts_of_runs_say_where_the_point_the_wall_and_the_digits_are() {
    let has = |texts: &[String], words: &str| texts.iter().any(|text| text.contains(words));
    // σ = 2.6 lies in the plane, 145 does not.
    let near = plotted(&[]);
    assert!(
        has(&near, "(0.009, 2.61)") && !has(&near, "off the chart"),
        "{near:?}"
    );
    assert!(!has(&near, "wall"), "{near:?}");
    let stiff = plotted(&[("nm_rad = 1.0", "nm_rad = 0.018")]);
    assert!(has(&stiff, "(0.5, 145), off the chart"), "{stiff:?}");
    let wall = plotted(&[("\"spring\"", "\"wall\"")]);
    assert!(has(&wall, "edge of the wall"), "{wall:?}");
    // Where the point means nothing, what was done stands in its place.
    let account = "account, J";
    let ledger = plotted(&[("\"raw\"", "\"ledger\""), ("nm_rad = 1.0", "nm_rad = 100")]);
    assert!(has(&ledger, account) && has(&ledger, "torque, Nm"));
    assert!(has(&ledger, ": ledger, K = ") && has(&ledger, "Nm/rad of 100 demanded"));
    assert!(!has(&ledger, "critical line"), "{ledger:?}");
    let detent = plotted(&[("\"spring\"", "\"detent\"\nperiod_rad = 0.1")]);
    assert!(has(&detent, "detents") && has(&detent, "torque, Nm"));
    assert!(!has(&detent, "±1 count") && !has(&detent, account));
    let held = plotted(&[(
        "[start]",
        "[hand]\nstiffness_nm_rad = 0.1\nrest_rad = 0.02\n[start]",
    )]);
    assert!(has(&held, "place of the hand") && !has(&held, "critical line"));
    // Far from zero, and long after the start.
    let far = plotted(&[
        ("nm_rad = 1.0", "nm_rad = 1.0\ncentre_rad = 100.0"),
        ("angle_rad = 0.0", "angle_rad = 99.999"),
    ]);
    distinct(
        far.iter()
            .filter(|text| text.starts_with("100.") || text.starts_with("99.")),
    );
    let long = plotted(&[
        ("samples = 200", "samples = 20000"),
        ("8192", "20"),
        ("nm_rad = 1.0", "nm_rad = 0.015"),
    ]);
    assert!(has(&long, "time before the end, ms"), "{long:?}");
    assert!(has(&long, "-20") && has(&long, "-40"), "{long:?}");
}

#[test]
fn charts_of_maps_and_plans_name_what_they_show() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let out = at("map");
    let args = "map --mu 50 --v0 10 --grid 4 --samples 10 --out";
    assert!(
        run(&args.split(' ').chain([out.as_str()]).collect::<Vec<_>>())
            .status
            .success()
    );
    let shown = texts(&fs::read_to_string(at("map.svg")).unwrap());
    for letter in ["a", "b", "c", "d"] {
        assert!(
            shown.iter().any(|text| text == letter),
            "{letter}: {shown:?}"
        );
    }
    // Without a wanted stiffness the device still stands among the regions.
    assert!(run(&["plan", "--plot", &at("plan.svg")]).status.success());
    let shown = texts(&fs::read_to_string(at("plan.svg")).unwrap());
    for words in [
        "(0.5, 145)",
        "twice K",
        "half T",
        "a",
        "b",
        "c",
        "d",
        "1000",
    ] {
        assert!(shown.iter().any(|text| text == words), "{words}: {shown:?}");
    }
    fs::write(at("dry.toml"), SCENE.replace("9e-6", "0.0")).unwrap();
    assert!(
        run(&["plan", &at("dry.toml"), "--plot", &at("dry.svg")])
            .status
            .success()
    );
    let shown = texts(&fs::read_to_string(at("dry.svg")).unwrap());
    assert!(
        shown.iter().any(|text| text.contains("2b/T or 2c/Δ is 0")),
        "{shown:?}"
    );
    assert!(!shown.iter().any(|text| text == "twice K"), "{shown:?}");
}

/// What cannot change the angle by more than the tolerance is left out and named, with a bound that holds;
/// a run of which nothing can be left out is the full one.
#[test]
fn no_more_is_simulated_than_a_scene_needs() {
    let scene = repository().join("scenes/fast-amplifier.toml");
    let scene = scene.to_str().unwrap();
    let number = |out: &Value, key: &str| out[key].as_f64().unwrap();
    let all = [
        "stiction",
        "cogging",
        "amplifier-lag",
        "delay",
        "torque-step",
    ];
    let full = json(&["simulate", scene, "--json"]);
    assert_eq!(full["fidelity"], "full");
    assert_eq!((&full["dropped"], &full["kept"]), (&json!([]), &json!(all)));
    assert_eq!(number(&full, "error_bound_rad"), 0.0);

    for tolerance in ["1e-6", "1e-4"] {
        let auto = [
            "simulate",
            scene,
            "--fidelity",
            "auto",
            "--tolerance",
            tolerance,
            "--json",
        ];
        let auto = json(&auto);
        assert_eq!(auto["fidelity"], "auto");
        assert_eq!((&auto["dropped"], &auto["kept"]), (&json!(all), &json!([])));
        let bound = number(&auto, "error_bound_rad");
        assert!(
            0.0 < bound && bound <= tolerance.parse().unwrap(),
            "{bound}"
        );
        let error = (number(&auto, "angle_rad") - number(&full, "angle_rad")).abs();
        assert!(0.0 < error && error <= bound, "{error} {bound}");
    }
    // Without a tolerance a millionth of a radian.
    let auto = json(&["simulate", scene, "--fidelity", "auto", "--json"]);
    assert_eq!(auto["dropped"], json!(all));

    // Nothing can be left out within a billionth: the same run to the last bit.
    let strict = [
        "simulate",
        scene,
        "--fidelity",
        "auto",
        "--tolerance",
        "1e-9",
        "--json",
    ];
    let mut strict = json(&strict);
    assert_eq!(
        (&strict["dropped"], &strict["kept"]),
        (&json!([]), &json!(all))
    );
    strict["fidelity"] = json!("full");
    assert_eq!(strict, full);

    let text = run(&["simulate", scene, "--fidelity", "auto"]);
    let text = String::from_utf8(text.stdout).unwrap();
    let line = "left out     stiction, cogging, amplifier-lag, delay, torque-step; kept nothing; every angle within";
    assert!(text.contains(line), "{text}");
}

/// The trace and the picture are those of the run that is told.
#[test]
fn a_trace_of_a_simpler_run_ends_where_it_does() {
    let folder = TempDir::new().unwrap();
    let trace = folder.path().join("run.csv");
    let scene = repository().join("scenes/fast-amplifier.toml");
    let [scene, path] = [&scene, &trace].map(|path| path.to_str().unwrap());
    let out = json(&[
        "simulate",
        scene,
        "--fidelity",
        "auto",
        "--trace",
        path,
        "--json",
    ]);
    let rows = fs::read_to_string(&trace).unwrap();
    assert_eq!(
        rows.lines().count() as u64,
        1 + out["samples"].as_u64().unwrap()
    );
    let last = rows.lines().last().unwrap().split(',').nth(1).unwrap();
    // At rest for a hundred samples.
    assert_eq!(
        last.parse::<f64>().unwrap(),
        out["angle_rad"].as_f64().unwrap()
    );
}

#[test]
fn fidelity_without_sense_is_refused() {
    let scene = repository().join("scenes/fast-amplifier.toml");
    let scene = scene.to_str().unwrap();
    refused(
        &["simulate", scene, "--tolerance", "1e-6"],
        2,
        &[
            "--tolerance is given, but --fidelity full drops nothing",
            "accepted: with --fidelity auto",
        ],
    );
    for wrong in ["0", "-1", "nan", "inf", "small"] {
        let tolerance = [
            "simulate",
            scene,
            "--fidelity",
            "auto",
            "--tolerance",
            wrong,
        ];
        refused(&tolerance, 2, &["--tolerance", wrong]);
    }
    refused(
        &["simulate", scene, "--fidelity", "half"],
        2,
        &["half", "full", "auto"],
    );
    let display = [
        "--mu",
        "50",
        "--beta",
        "0.3",
        "--sigma",
        "0.6",
        "--v0",
        "10",
        "--samples",
        "100",
    ];
    refused(
        &[&["simulate"][..], &display, &["--fidelity", "auto"]].concat(),
        2,
        &["SCENE"],
    );
}

/// Cogging and stiction need the key that says where they are felt.
#[test]
fn cogging_and_stiction_come_in_pairs() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("scene.toml");
    let path = file.to_str().unwrap();
    for (line, parts) in [
        (
            "cogging_nm = 1e-4",
            [
                "device.cogging_nm is 0.0001",
                "device.cogging_per_rev is missing",
            ],
        ),
        (
            "stiction_nm = 1e-4",
            [
                "device.stiction_nm is 0.0001",
                "device.stribeck_rad_s is missing",
            ],
        ),
        (
            "cogging_per_rev = 20000",
            [
                "device.cogging_per_rev is 20000",
                "up to 10000 periods in a turn",
            ],
        ),
    ] {
        fs::write(
            &file,
            SCENE.replacen("[device]\n", &format!("[device]\n{line}\n"), 1),
        )
        .unwrap();
        refused(&["simulate", path], 1, &parts);
    }
}
