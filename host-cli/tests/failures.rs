//! `knob failures`, and `knob simulate --method`, which shows each failure.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn run(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_knob"))
        .args(args)
        .output()
        .unwrap()
}

fn scene(name: &str) -> String {
    let root: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let path = root.join(format!("scenes/{name}.toml"));
    path.to_str().unwrap().to_owned()
}

fn json(args: &[&str]) -> Value {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "knob {args:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn refused(args: &[&str], parts: &[&str]) {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "knob {args:?}: {said}");
    assert!(output.stdout.is_empty());
    for part in parts {
        assert!(said.contains(part), "`{part}` is missing in: {said}");
    }
}

#[test]
fn a_scene_runs_by_any_method() {
    let euler_hides = scene("fail/euler-hides");
    let by = |method: &str| json(&["simulate", &euler_hides, "--method", method, "--json"]);
    let exact = by("exact");
    assert_eq!(exact["class"], "unstable");
    assert_eq!(exact["method"], "exact");
    let euler = by("euler:1");
    assert_eq!(
        (&euler["class_paper"], &euler["samples"]),
        (&Value::from("rest"), &Value::from(50_000))
    );
    // The scene is the display of its flags.
    let flags = [
        "--mu",
        "50",
        "--beta",
        "0.3",
        "--sigma",
        "0.6",
        "--v0",
        "40",
        "--samples",
        "50000",
    ];
    let with = [&["simulate"], &flags[..], &["--method", "exact", "--json"]].concat();
    assert_eq!(json(&with), exact);
    let plain = json(&[&["simulate"], &flags[..], &["--json"]].concat());
    assert_eq!(plain["class"], exact["class"]);
    // What is no number is null, and no panic.
    let frictionless = scene("fail/count-edges");
    let lost = json(&[
        "simulate",
        &frictionless,
        "--method",
        "closed-form",
        "--json",
    ]);
    assert_eq!(lost["xi"], Value::Null);
    let said = run(&["simulate", &euler_hides, "--method", "euler:2"]);
    assert!(String::from_utf8_lossy(&said.stdout).contains("by euler:2"));
}

#[test]
fn methods_and_scenes_that_do_not_fit_are_refused() {
    let display = scene("fail/euler-hides");
    refused(
        &["simulate", &display, "--method", "euler:0"],
        &["method euler:0; accepted: exact", "--method"],
    );
    refused(
        &[
            "simulate", &display, "--method", "exact", "--trace", "out.csv",
        ],
        &["--trace", "--method"],
    );
    refused(
        &[
            "simulate",
            &display,
            "--method",
            "exact",
            "--fidelity",
            "auto",
        ],
        &["--fidelity", "--method"],
    );
    for (name, part) in [
        ("ledger-push", "another law than raw"),
        ("delay-unaccounted", "delay, lag or steps"),
        ("dac-rounding", "delay, lag or steps"),
        ("wall-off-edge", "another shape"),
        ("fail/missed-ticks", "jitter or missed ticks"),
    ] {
        let scene = scene(name);
        refused(
            &["simulate", &scene, "--method", "euler:1"],
            &["--method euler:1", part, "accepted: a raw spring"],
        );
    }
    // A hand.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hand.toml");
    let text = fs::read_to_string(&display).unwrap() + "\n[hand]\npush_nm = 0.1\n";
    fs::write(&path, text).unwrap();
    refused(
        &["simulate", path.to_str().unwrap(), "--method", "euler:1"],
        &["a hand", "accepted: a raw spring"],
    );
}

#[test]
fn the_catalogue_is_measured_and_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let name = folder.path().join("new/failures");
    let out = name.to_str().unwrap();
    let drawn = json(&["failures", "--out", out, "--json"]);
    let failures = drawn["failures"].as_array().unwrap();
    assert!(failures.len() >= 24);
    let page = fs::read_to_string(name.with_extension("md")).unwrap();
    for failure in failures {
        let stem = failure["name"].as_str().unwrap();
        let svg = fs::read_to_string(name.join(format!("{stem}.svg"))).unwrap();
        assert!(
            svg.starts_with("<svg") && svg.contains("polyline"),
            "{stem}"
        );
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{stem}");
        assert!(page.contains(&format!("](failures/{stem}.svg)")), "{stem}");
        let rows = failure["rows"].as_array().unwrap();
        let kind = |kind: &str| rows.iter().filter(|row| row["kind"] == kind).count();
        assert!(kind("says") >= 1 && kind("true") >= 1, "{stem}: {rows:?}");
    }
    // Not over files that are there.
    let again = run(&["failures", "--out", out]);
    assert_eq!(again.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&again.stderr).contains("--force"));
    let forced = run(&["failures", "--out", out, "--force"]);
    assert!(forced.status.success());
    let said = String::from_utf8_lossy(&forced.stdout);
    assert!(said.contains("euler-hides: Euler hides") && said.contains("wrote "));
}
