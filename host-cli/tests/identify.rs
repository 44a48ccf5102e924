//! `knob identify` as a user and a script meet it.
#![cfg(target_os = "linux")]

#[allow(dead_code, reason = "shared with tests that use more of it")]
mod native;

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use control::criterion::Device;
use plant_sim::hold::{Hold, State};
use plant_sim::identify::experiment::{Experiment, Limits};
use serde_json::Value;
use tempfile::TempDir;

const DEVICE: Device<f64> = Device {
    inertia_kg_m2: 6.28e-6,
    viscous_nm_s_rad: 9e-6,
    coulomb_nm: 2e-3,
};

const SCENE: &str = "[device]\ninertia_kg_m2 = 6.28e-6\nviscous_nm_s_rad = 9e-6\ncoulomb_nm = 2e-3\n\
                     counts_per_rev = 8192\n[loop]\nsample_period_s = 1e-3\n[render]\nlaw = \"raw\"\n\
                     shape = \"spring\"\nstiffness_nm_rad = 1.0\n";

fn run(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_knob"));
    command.arg("identify").args(args).env_remove("KNOB_PORT");
    command.output().unwrap()
}

fn succeeds(args: &[&str]) -> String {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

fn json(args: &[&str]) -> Value {
    serde_json::from_str(&succeeds(&[args, &["--json"]].concat())).unwrap()
}

fn refused(args: &[&str], status: i32, parts: &[&str]) {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{args:?}: {said}");
    assert!(
        output.stdout.is_empty(),
        "{args:?} wrote to standard output"
    );
    for part in parts {
        assert!(
            said.contains(part),
            "{args:?}: `{part}` is missing in: {said}"
        );
    }
    assert!(!said.contains("panicked"), "{args:?}: {said}");
}

/// What `knob log` would have written of the experiment on [`DEVICE`].
fn recorded() -> String {
    let count_rad = TAU / 8192.0;
    let hold = Hold::new(&DEVICE, 1e-3).unwrap();
    let mut state = State {
        position: 0.0,
        velocity: 0.0,
    };
    let limits = Limits {
        speed_rad_s: 50.0,
        angle_rad: 10.0,
        torque_nm: 0.2,
    };
    let recording = Experiment::record(limits, 1e-3, count_rad, 0, |torque_nm| {
        state = hold.step(state, f64::from(torque_nm as f32)).end;
        (state.position / count_rad).floor() as i32
    })
    .unwrap();
    let mut text = String::from(
        "tick,state,count,torque_nm,stiffness_nm_rad,demanded_nm_rad,margin_nm,reason,law,account_j\n",
    );
    for (tick, sample) in recording.samples.iter().enumerate() {
        let (count, torque) = (sample.count, sample.torque_nm as f32);
        writeln!(text, "{},armed,{count},{torque:e},,,,,,", tick + 4711).unwrap();
    }
    text
}

fn file(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Every value within a tenth, and the truth between its ends.
fn finds_the_truth(found: &Value) {
    for (key, truth) in [
        ("inertia_kg_m2", DEVICE.inertia_kg_m2),
        ("viscous_nm_s_rad", DEVICE.viscous_nm_s_rad),
        ("coulomb_nm", DEVICE.coulomb_nm),
    ] {
        let number = |end: &str| found[key][end].as_f64().unwrap();
        let (low, value, high) = (number("low"), number("value"), number("high"));
        assert!(low <= truth && truth <= high, "{key}: {found}");
        assert!(low <= value && value <= high, "{key}: {found}");
        assert!(high - low <= 0.2 * truth, "{key}: {found}");
    }
}

#[test]
fn a_recording_and_a_scene_give_the_truth_and_what_to_believe() {
    let folder = TempDir::new().unwrap();
    let recording = file(folder.path(), "pushes.csv", &recorded());
    let sampling = ["--sample-period", "1e-3", "--counts-per-rev", "8192"];
    let of_file = [&["--recording", &recording][..], &sampling].concat();
    let found = json(&of_file);
    finds_the_truth(&found);
    assert_eq!(found["applied_at_tick"], Value::Null);
    let scene = file(folder.path(), "scene.toml", SCENE);
    let out = folder.path().join("believed.toml");
    let out = out.to_str().unwrap();
    let simulated = json(&["--scene", &scene, "--out", out]);
    finds_the_truth(&simulated);

    // The table believed goes into a scene as it is, and its ends are those of the JSON.
    let table = fs::read_to_string(out).unwrap();
    let parsed: toml::Table = toml::from_str(&table).unwrap();
    for key in ["inertia_kg_m2", "viscous_nm_s_rad", "coulomb_nm"] {
        for (place, end) in ["low", "high"].iter().enumerate() {
            let given = parsed["believed"][key][place].as_float().unwrap();
            assert_eq!(given, simulated[key][end].as_f64().unwrap());
        }
    }
    host_cli::scene::parse(&format!("{SCENE}{table}")).unwrap();

    // The line for a device holds the interval also where a device rounds to f32.
    let set = simulated["set"].as_str().unwrap();
    for (part, key) in set.strip_prefix("knob set ").unwrap().split(' ').zip([
        "inertia_kg_m2",
        "viscous_nm_s_rad",
        "coulomb_nm",
    ]) {
        let range = part.strip_prefix(&format!("{key}=")).unwrap();
        let (low, high) = range.split_once("..").unwrap();
        let (low, high): (f32, f32) = (low.parse().unwrap(), high.parse().unwrap());
        assert!(f64::from(low) <= simulated[key]["low"].as_f64().unwrap());
        assert!(f64::from(high) >= simulated[key]["high"].as_f64().unwrap());
    }
    // For a reader, the same.
    let text = succeeds(&["--scene", &scene]);
    for part in [
        "inertia, kg m²",
        "viscous",
        "Coulomb",
        "all counts are explained",
        set,
    ] {
        assert!(text.contains(part), "`{part}` is missing in: {text}");
    }
    // Never over what is there.
    refused(
        &["--scene", &scene, "--out", out],
        1,
        &["exists", "--force"],
    );
    refused(
        &["--scene", &scene, "--out", &scene, "--force"],
        2,
        &["--out"],
    );
    succeeds(&["--scene", &scene, "--out", out, "--force"]);
}

#[test]
fn a_file_that_is_no_recording_is_refused_by_line_and_column() {
    let folder = TempDir::new().unwrap();
    let good = recorded();
    let lines: Vec<&str> = good.lines().collect();
    let sampling = ["--sample-period", "1e-3", "--counts-per-rev", "8192"];
    let is = |name: &str, text: String, parts: &[&str]| {
        let path = file(folder.path(), name, &text);
        let args = [&["--recording", &path][..], &sampling].concat();
        refused(&args, 1, &[&[name][..], parts].concat());
    };
    let with_line = |place: usize, line: &str| {
        let mut changed = lines.clone();
        changed[place] = line;
        changed.join("\n")
    };
    is("empty.csv", String::new(), &["no column tick"]);
    let renamed = good.replacen("torque_nm", "torque_mnm", 1);
    is(
        "unit.csv",
        renamed,
        &["line 1 has no column torque_nm", "Nm"],
    );
    is(
        "nan.csv",
        with_line(3, "4713,armed,0,NaN,,,,,,"),
        &["line 4: torque_nm is `NaN`", "finite"],
    );
    is(
        "word.csv",
        with_line(3, "4713,armed,many,0,,,,,,"),
        &["line 4: count is `many`"],
    );
    is(
        "none.csv",
        with_line(3, "4713,armed,,0,,,,,,"),
        &["line 4: count is ``"],
    );
    is(
        "far.csv",
        with_line(3, "4713,armed,3000000000,0,,,,,,"),
        &["line 4: count"],
    );
    is(
        "gap.csv",
        with_line(3, "4714,armed,0,0,,,,,,"),
        &["line 4: tick 4714 follows tick 4712", "--every 1"],
    );
    is("cut.csv", good[..good.len() - 9].to_owned(), &["cut off"]);
    // Cut off between two lines, in the middle of a push.
    let pushed = |line: &&str| line.split(',').nth(3).is_some_and(|torque| torque != "0e0");
    let place = lines.len() / 2 + lines[lines.len() / 2..].iter().position(pushed).unwrap();
    is(
        "half.csv",
        lines[..=place].join("\n"),
        &["ends after", "cut off", "at rest"],
    );
    is(
        "short.csv",
        lines[..40].join("\n"),
        &["too short: 39 samples"],
    );
    refused(
        &[
            "--recording",
            "no-such.csv",
            "--sample-period",
            "1e-3",
            "--counts-per-rev",
            "8192",
        ],
        1,
        &["no-such.csv"],
    );
}

#[test]
fn sabotaged_scenes_are_refused_with_their_reason() {
    let folder = TempDir::new().unwrap();
    let is = |name: &str, scene: String, flags: &[&str], parts: &[&str]| {
        let path = file(folder.path(), name, &scene);
        refused(
            &[&["--scene", &path][..], flags].concat(),
            1,
            &[&[name][..], parts].concat(),
        );
    };
    let hand = |keys: &str| format!("{SCENE}[hand]\n{keys}\n");
    is(
        "push.toml",
        hand("push_nm = 5e-4"),
        &[],
        &["constant torque of 5.0", "a hand pushes it"],
    );
    is(
        "shake.toml",
        hand("shake_nm = 1e-3\nshake_hz = 5.0"),
        &[],
        &["a hand on the knob", "counts"],
    );
    let cogs = SCENE.replacen(
        "counts_per_rev",
        "cogging_nm = 1e-3\ncogging_per_rev = 42\ncounts_per_rev",
        1,
    );
    is("cogs.toml", cogs, &[], &["cogging", "counts"]);
    let limit = |most: &str| {
        SCENE.replacen(
            "sample_period_s",
            &format!("torque_max_nm = {most}\nsample_period_s"),
            1,
        )
    };
    is(
        "weak.toml",
        limit("1e-3"),
        &[],
        &["never moved", "stuck or held", "0.001 Nm"],
    );
    is(
        "saturates.toml",
        limit("5e-3"),
        &["--torque-max", "0.2"],
        &["gives about 5.0", "saturates"],
    );
}

/// The device takes what was found, and the file of the same run holds the same.
#[test]
fn apply_sets_it_on_the_device() {
    let (port, _) = native::board();
    let folder = TempDir::new().unwrap();
    let scene = SCENE.replacen("coulomb_nm = 2e-3", "coulomb_nm = 3e-3", 1);
    let scene = file(folder.path(), "scene.toml", &scene);
    let found = json(&["--scene", &scene, "--apply", "--port", &port.path]);
    assert!(found["applied_at_tick"].as_u64().is_some(), "{found}");
    let mut get = Command::new(env!("CARGO_BIN_EXE_knob"));
    let get = get
        .args(["get", "--json", "--port", &port.path])
        .output()
        .unwrap();
    let device: Value = serde_json::from_slice(&get.stdout).unwrap();
    for key in ["inertia_kg_m2", "viscous_nm_s_rad", "coulomb_nm"] {
        // An f32, written in few digits.
        let on_device = |place: usize| f64::from(device[key][place].as_f64().unwrap() as f32);
        let (low, high) = (&found[key]["low"], &found[key]["high"]);
        assert!(on_device(0) <= low.as_f64().unwrap(), "{key}: {device}");
        assert!(on_device(1) >= high.as_f64().unwrap(), "{key}: {device}");
        assert!(
            on_device(1) - on_device(0) < 0.1 * on_device(0),
            "{key}: {device}"
        );
    }
    // Nothing is set where nothing was found.
    let held = file(
        folder.path(),
        "held.toml",
        &format!("{SCENE}[hand]\npush_nm = 5e-4\n"),
    );
    let args = ["--scene", &held, "--apply", "--port", &port.path];
    refused(&args, 1, &["a hand pushes it"]);
    refused(
        &["--scene", &scene, "--apply", "--port", "/no/such/port"],
        1,
        &["/no/such/port"],
    );
}

#[test]
fn flags_that_make_no_sense_are_bad_usage() {
    refused(
        &["--recording", "a.csv", "--angle-max", "3"],
        2,
        &["--angle-max", "--recording"],
    );
    refused(
        &["--port", "/no/such/port"],
        1,
        &["/no/such/port", "does not exist"],
    );
    refused(
        &["--recording", "a.csv"],
        2,
        &["--sample-period", "--counts-per-rev"],
    );
    refused(
        &["--recording", "a.csv", "--scene", "b.toml"],
        2,
        &["--scene"],
    );
    for value in ["0", "-1", "NaN", "inf"] {
        let flag = format!("--speed-max={value}");
        refused(&["--scene", "b.toml", &flag], 2, &["--speed-max"]);
        let flag = format!("--sample-period={value}");
        refused(
            &["--recording", "a.csv", &flag, "--counts-per-rev", "8192"],
            2,
            &["--sample-period"],
        );
    }
    let help = succeeds(&["--help"]);
    let words: Vec<&str> = help.split_whitespace().collect();
    let help = words.join(" ");
    for part in [
        "Example",
        "pushes the connected knob",
        "keep hands off",
        "Ctrl-C",
    ] {
        assert!(help.contains(part), "{help}");
    }
}
