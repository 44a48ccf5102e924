//! `knob stiffness` as a user and a script meet it.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

const ONE: &str = "[[device]]\nname = \"mine\"\ninertia_kg_m2 = 6.28e-6\nviscous_nm_s_rad = 9e-6\n\
                   coulomb_nm = 2e-3\ncounts_per_rev = 8192\nsample_period_s = 1e-3\n";

fn knob() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_knob"));
    command.arg("stiffness");
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

fn devices_file(folder: &Path, text: &str) -> String {
    let path = folder.join("devices.toml");
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// How stiff `law` is on the only device.
fn measured<'a>(json: &'a Value, law: &str) -> &'a Value {
    let all = json["measured"].as_array().unwrap();
    all.iter().find(|one| one["law"] == law).unwrap()
}

#[test]
fn help_has_an_example() {
    let output = run(&["--help"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success());
    for part in ["Examples:", "knob stiffness --out", "--random", "--devices"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn one_device_gives_one_json_object_with_every_law() {
    let folder = TempDir::new().unwrap();
    let file = devices_file(folder.path(), ONE);
    let output = run(&["--devices", &file, "--json"]);
    assert!(output.status.success());
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["devices"].as_array().unwrap().len(), 1);
    assert_eq!(json["devices"][0]["name"], "mine");
    assert_eq!(json["random"], Value::Null);
    let laws: Vec<&str> = json["laws"]
        .as_array()
        .unwrap()
        .iter()
        .map(|law| law["law"].as_str().unwrap())
        .collect();
    assert_eq!(
        laws,
        [
            "static",
            "energy-bounding",
            "raw",
            "episode",
            "passivity-control",
            "virtual-damping",
            "ledger",
            "auto"
        ]
    );
    for law in laws {
        let one = measured(&json, law);
        assert_eq!(one["device"], "mine");
        assert_eq!(
            (&one["runs"], &one["bad"]),
            (&240.into(), &0.into()),
            "{law}"
        );
        assert_eq!(one["bad_runs"].as_array().unwrap().len(), 0);
        let tuned = ["raw", "passivity-control", "virtual-damping"].contains(&law);
        assert_eq!(one["clamps_itself"], !tuned, "{law}");
        assert_eq!(one["feel_at_ledger_stiffness"].is_array(), tuned, "{law}");
        let ao = json["devices"][0]["ao_nm_rad"].as_f64().unwrap();
        for key in ["static", "hit3", "hit30"] {
            let number = |unit: &str| one[format!("{key}_{unit}")].as_f64().unwrap();
            assert!((number("nm_rad") / ao / number("over_ao") - 1.0).abs() < 1e-12);
        }
        for felt in one["feel"].as_array().unwrap() {
            for key in [
                "speed_rad_s",
                "hits",
                "penetration",
                "restitution",
                "torque_variation",
                "turns",
            ] {
                assert!(felt[key].is_number(), "{law}: {key}");
            }
        }
    }
    let stiffness = |law: &str| measured(&json, law)["static_nm_rad"].as_f64().unwrap();
    assert!((stiffness("static") - 0.018).abs() < 1e-4);
    assert!(stiffness("ledger") >= 3.6 && stiffness("auto") >= 3.6);
    assert!(stiffness("raw") < stiffness("virtual-damping"));
    // A stiff spring with virtual damping throws the knob back faster than it came.
    let thrown = &measured(&json, "virtual-damping")["feel_at_ledger_stiffness"][3];
    assert!(thrown["restitution"].as_f64().unwrap() > 1.05, "{thrown}");
    assert!(
        measured(&json, "ledger")["feel"][3]["restitution"]
            .as_f64()
            .unwrap()
            < 1.0
    );
}

#[test]
fn the_table_names_laws_and_devices() {
    let folder = TempDir::new().unwrap();
    let file = devices_file(folder.path(), ONE);
    let output = run(&["--devices", &file]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success());
    for part in [
        "energy ledger",
        "virtual damping",
        "0 of 240",
        "yes",
        "no",
        "mine",
        "--out",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(String::from_utf8_lossy(&output.stderr).contains("1 device,"));
}

#[test]
fn random_devices_are_told_by_their_seed() {
    let first = |seed: &str| {
        let output = run(&["--random", "1", "--seed", seed, "--json"]);
        assert!(output.status.success());
        let json: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(json["random"]["count"], 1);
        assert_eq!(measured(&json, "ledger")["bad"], 0);
        json["devices"][0].clone()
    };
    assert_eq!(first("3"), first("3"));
    assert_ne!(first("3"), first("4"));
}

#[test]
fn a_file_that_lists_no_devices_is_refused_with_what_would_be() {
    let folder = TempDir::new().unwrap();
    let with = |key: &str, value: &str| {
        let lines = ONE.lines().map(|line| match line.split_once(" = ") {
            Some((name, _)) if name == key => format!("{key} = {value}\n"),
            _ => format!("{line}\n"),
        });
        lines.collect::<String>()
    };
    let without = |key: &str| {
        let lines = ONE.lines().filter(|line| !line.starts_with(key));
        lines.map(|line| format!("{line}\n")).collect::<String>()
    };
    for (text, parts) in [
        (String::new(), vec!["no device", "[[device]]"]),
        ("colour = 1\n".into(), vec!["colour", "expected"]),
        (
            format!("{ONE}colour = 1\n"),
            vec!["colour", "unknown field"],
        ),
        (without("name"), vec!["missing field `name`"]),
        (without("coulomb_nm"), vec!["missing field `coulomb_nm`"]),
        (with("name", "\"\""), vec!["name is empty"]),
        (format!("{ONE}{ONE}"), vec!["`mine` twice", "accepted"]),
        (
            with("inertia_kg_m2", "nan"),
            vec!["`mine`", "inertia_kg_m2 is NaN", "accepted"],
        ),
        (
            with("coulomb_nm", "-1e-3"),
            vec!["coulomb_nm is -0.001", "accepted"],
        ),
        (
            with("viscous_nm_s_rad", "0"),
            vec!["viscous_nm_s_rad is 0", "accepted"],
        ),
        (
            with("sample_period_s", "0.0"),
            vec!["sample_period_s is 0", "accepted"],
        ),
        (
            with("counts_per_rev", "inf"),
            vec!["counts_per_rev is inf", "accepted"],
        ),
        (
            format!("{ONE}decimation = 0\n"),
            vec!["decimation is 0", "accepted"],
        ),
        (format!("{ONE}decimation = -1\n"), vec!["decimation", "-1"]),
        (
            with("inertia_kg_m2", "\"heavy\""),
            vec!["heavy", "inertia_kg_m2"],
        ),
        ("[[device]\n".into(), vec!["devices.toml"]),
        (
            with("sample_period_s", "1e-15"),
            vec!["sample_period_s is 1e-15", "accepted: from 1e-6 to 0.1"],
        ),
        (
            with("counts_per_rev", "1e15"),
            vec!["counts_per_rev is", "accepted: from 4"],
        ),
        (
            format!("{ONE}decimation = 4096\n"),
            vec!["decimation is 4096", "accepted"],
        ),
    ] {
        let file = devices_file(folder.path(), &text);
        let mut parts = parts;
        parts.extend(["--devices", "devices.toml"]);
        refused(&["--devices", &file], 1, &parts);
    }
    let missing = folder.path().join("missing.toml");
    refused(
        &["--devices", missing.to_str().unwrap()],
        1,
        &["cannot read", "missing.toml"],
    );
    refused(
        &["--devices", folder.path().to_str().unwrap()],
        1,
        &["cannot read"],
    );
    fs::write(folder.path().join("devices.toml"), [0xff, 0xfe]).unwrap();
    let file = folder.path().join("devices.toml");
    refused(&["--devices", file.to_str().unwrap()], 1, &["cannot read"]);
}

#[test]
fn flags_that_make_no_sense_are_bad_usage() {
    refused(&["--random", "0"], 2, &["--random", "accepted"]);
    refused(&["--random", "two"], 2, &["--random"]);
    refused(&["--seed", "1"], 2, &["--random"]);
    refused(
        &["--random", "2", "--devices", "some.toml"],
        2,
        &["--devices"],
    );
    refused(
        &["--out", "no-such-folder/name"],
        1,
        &["--out", "no folder"],
    );
}

#[test]
fn files_are_written_whole_and_replaced_only_by_force() {
    let folder = TempDir::new().unwrap();
    let file = devices_file(folder.path(), ONE);
    let name = folder.path().join("stiff");
    let out = name.to_str().unwrap();
    fs::write(name.with_extension("csv"), "old").unwrap();
    refused(
        &["--devices", &file, "--out", out],
        1,
        &["stiff.csv exists", "--force"],
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);

    let output = run(&["--devices", &file, "--out", out, "--json", "--force"]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let read = |ending: &str| fs::read_to_string(name.with_extension(ending)).unwrap();
    assert_eq!(read("json").as_bytes(), output.stdout);
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let sweeps = json["sweeps"].as_array().unwrap();
    assert_eq!(sweeps.len(), 2);
    let points = sweeps.iter().map(|sweep| {
        let points = sweep["points"].as_array().unwrap();
        for point in points
            .iter()
            .filter(|point| ["ledger", "auto", "static"].contains(&point["law"].as_str().unwrap()))
        {
            assert_eq!(point["bad"], 0, "{point}");
        }
        points.len()
    });
    let points: usize = points.sum();
    assert!(points > 200, "{points}");
    let csv = read("csv");
    assert_eq!(csv.lines().count(), 1 + 8 + points);
    let columns = csv.lines().map(|line| line.split(',').count());
    assert!(columns.into_iter().all(|count| count == 9), "{csv}");
    let svg = read("svg");
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    for part in ["energy ledger", "sample period, ms", "counts/rev"] {
        assert!(svg.contains(part), "{part}");
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_within_a_second_and_leaves_nothing() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("stiff");
    let child = knob()
        .args(["--random", "1000", "--out", out.to_str().unwrap()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(1500));
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
