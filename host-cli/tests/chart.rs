//! `knob chart` as a user and a script meet it. What is asserted is accuracy and structure,
//! never a time.

use std::fs;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

fn knob() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_knob"));
    command.arg("chart");
    command
}

fn run(args: &[&str]) -> Output {
    knob().args(args).output().unwrap()
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

fn named<'a>(json: &'a Value, list: &str, key: &str, name: &str) -> &'a Value {
    let all = json[list].as_array().unwrap();
    let found = all.iter().find(|one| one[key] == name);
    found.unwrap_or_else(|| panic!("no {name} in {list}"))
}

fn method<'a>(json: &'a Value, name: &str) -> &'a Value {
    named(json, "methods", "method", name)
}

/// Median position error, counts.
fn error(json: &Value, name: &str, after: &str) -> f64 {
    let spread = &method(json, name)["position_error_counts"][after];
    spread["median"].as_f64().unwrap()
}

/// The order p of a method, from the errors after one sample with 1 and with 3 steps: 3^−p.
fn order(json: &Value, family: &str) -> f64 {
    let of = |steps: u32| error(json, &format!("{family}:{steps}"), "1");
    (of(1) / of(3)).ln() / 3_f64.ln()
}

fn accuracy_is_what_it_must_be(json: &Value) {
    let cells = json["grid"].as_u64().unwrap().pow(2);
    let class_error = |name: &str| method(json, name)["class_error"].as_f64().unwrap();
    for one in json["methods"].as_array().unwrap() {
        let wrong = one["wrong_cells"].as_u64().unwrap();
        assert_eq!(one["class_error"], wrong as f64 / cells as f64, "{one}");
        if ["exact", "exact-vector", "closed-form", "dopri5"]
            .contains(&one["family"].as_str().unwrap())
        {
            assert_eq!(wrong, 0, "{one}");
        } else {
            assert!(wrong > 0, "{one}");
        }
    }
    assert!(class_error("euler:1") > 0.5);
    assert!(class_error("euler:10") < class_error("euler:3"));
    assert!(json["checked_cells"].as_u64().unwrap() >= 16);
    assert_eq!(json["checked_cells_that_differ"], 0);

    for exact in ["exact", "exact-vector"] {
        assert!(error(json, exact, "1000") < 1e-9);
        let added = |name: &str| {
            let spread = &method(json, name)["added_energy_per_sample"];
            spread["median"].as_f64().unwrap()
        };
        for one in json["methods"].as_array().unwrap() {
            if !one["setting"].is_null() && one["family"] != "dopri5" {
                let name = one["method"].as_str().unwrap();
                for after in ["100", "1000"] {
                    let own = error(json, name, after);
                    assert!(
                        1e3 * error(json, exact, after) < own,
                        "{name} after {after}"
                    );
                }
                assert!(1e3 * added(exact) < added(name), "{name}");
            }
        }
    }
    for (family, expected) in [("euler", 1.0), ("midpoint", 2.0), ("rk4", 4.0)] {
        let order = order(json, family);
        assert!((order - expected).abs() < 0.3, "{family}: order {order}");
    }
    for (coarse, fine) in [("euler:3", "euler:30"), ("midpoint:3", "midpoint:30")] {
        assert!(error(json, fine, "10") < error(json, coarse, "10") / 5.0);
    }
    // The textbook's form is as good at β up to 1 and lost as β/μ → 0.
    assert!(error(json, "closed-form", "1000") < 1e-9);
    for small in json["small_viscous_friction"].as_array().unwrap() {
        // Null is lost.
        let error = small["position_error_counts"]["1000"]["median"].as_f64();
        if small["method"] == "exact" {
            assert!(error.unwrap() < 1e-7, "{small}");
        } else {
            assert!(error.is_none_or(|error| error > 1e-3), "{small}");
        }
    }
}

fn laws_are_what_they_must_be(json: &Value) {
    let laws = json["laws"].as_array().unwrap();
    assert_eq!(laws.len(), 8);
    let law = |name: &str, key: &str| named(json, "laws", "law", name)[key].as_f64();
    assert_eq!(json["devices"], 11);
    assert!((law("static", "static_over_ao").unwrap() - 1.0).abs() < 0.01);
    assert!(law("ledger", "static_over_ao") > Some(45.0));
    assert!(law("ledger", "static_over_ao") > law("virtual-damping", "static_over_ao"));
    for name in ["energy-bounding", "passivity-control", "virtual-damping"] {
        assert_eq!(law(name, "instructions_per_tick"), None);
    }
    assert!(law("static", "instructions_per_tick") < law("ledger", "instructions_per_tick"));
    for law in laws {
        assert!(law["ns_per_tick"]["median"].as_f64() > Some(0.0), "{law}");
    }
}

/// More of the plant is nearer to the full one, and auto errs by less than it promised.
fn fidelity_is_what_it_must_be(json: &Value) {
    let ladders = json["fidelity"].as_array().unwrap();
    assert_eq!(ladders.len(), 2);
    for ladder in ladders {
        let rungs = ladder["rungs"].as_array().unwrap();
        let error = |rung: &Value| rung["error_rad"].as_f64().unwrap();
        let (autos, kept): (Vec<_>, Vec<_>) = rungs
            .iter()
            .partition(|rung| !rung["tolerance_rad"].is_null());
        assert_eq!((kept.len(), autos.len()), (7, 4));
        assert!(error(kept[0]) > 10.0 * error(kept[4]) && error(kept[6]) == 0.0);
        for auto in autos {
            let bound = auto["bound_rad"].as_f64().unwrap();
            assert!(error(auto) <= bound, "{auto}");
            assert!(bound <= auto["tolerance_rad"].as_f64().unwrap(), "{auto}");
        }
    }
}

#[test]
fn the_quick_chart_measures_writes_and_refuses_to_replace() {
    let folder = TempDir::new().unwrap();
    let name = folder.path().join("speed");
    let out = name.to_str().unwrap();
    let path = |ending: &str| folder.path().join(format!("speed{ending}"));
    fs::write(path(".csv"), "old").unwrap();
    refused(&["--out", out], 1, &["speed.csv exists", "--force"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);

    let output = run(&["--quick", "--json", "--out", out, "--force"]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["quick"], &json["grid"]), (&true.into(), &20.into()));
    accuracy_is_what_it_must_be(&json);
    laws_are_what_they_must_be(&json);
    fidelity_is_what_it_must_be(&json);

    let read = |ending: &str| fs::read_to_string(path(ending)).unwrap();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 5);
    assert_eq!(read(".json").as_bytes(), output.stdout);
    for one in json["methods"].as_array().unwrap() {
        let times = &one["ns_per_sample"];
        let of = |key: &str| times[key].as_f64().unwrap();
        assert!(0.0 < of("low") && of("low") <= of("median") && of("median") <= of("high"));
        assert_eq!(one["ns_per_sample_by_class"].as_object().unwrap().len(), 3);
    }
    let csv = read(".csv");
    let columns = csv.lines().map(|line| line.split(',').count());
    assert!(columns.into_iter().all(|count| count == 9), "{csv}");
    let methods = json["methods"].as_array().unwrap().len();
    // Time, by class three times, position after four counts of samples, energy, classes.
    let lines = csv.lines().filter(|line| line.starts_with("methods,"));
    assert_eq!(lines.count(), methods * 10 + 4, "{csv}");
    for (ending, parts) in [
        (
            ".svg",
            [
                "semi-implicit Euler, n steps",
                "time per simulated sample, ns",
                "20 × 20",
            ],
        ),
        (
            "-laws.svg",
            [
                "energy ledger",
                "instructions per tick",
                "not in the firmware",
            ],
        ),
        (
            "-fidelity.svg",
            [
                "+ cogging",
                "what auto promised",
                "largest error of the angle, rad",
            ],
        ),
    ] {
        let svg = read(ending);
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        for part in parts {
            assert!(svg.contains(part), "{ending}: {part}");
        }
    }
}

#[test]
fn help_has_an_example_and_bad_usage_is_told() {
    let output = run(&["--help"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success());
    for part in ["Examples:", "knob chart --out", "NAME-laws.svg", "--quick"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    refused(&["--slow"], 2, &["--slow"]);
    refused(&["--out"], 2, &["--out"]);
    refused(&["speed"], 2, &["speed"]);
    refused(
        &["--out", "no-such-folder/name"],
        1,
        &["--out", "no folder"],
    );
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_within_a_second_and_leaves_nothing() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("speed");
    let child = knob()
        .args(["--out", out.to_str().unwrap()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(3000));
    let asked = Instant::now();
    let killed = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(killed.unwrap().success());
    let output = child.wait_with_output().unwrap();
    println!("stopped after {:?}", asked.elapsed());
    assert_eq!(output.status.code(), Some(130));
    assert!(output.stdout.is_empty());
    assert!(String::from_utf8_lossy(&output.stderr).contains("stopped"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    assert!(asked.elapsed() < Duration::from_secs(5));
}
