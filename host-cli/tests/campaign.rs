//! `knob campaign` and `knob ablation` as a user and a script meet them.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

fn knob(args: &[&str]) -> Command {
    let mut knob = Command::new(env!("CARGO_BIN_EXE_knob"));
    knob.args(args);
    knob
}

fn run(args: &[&str]) -> Output {
    knob(args).output().unwrap()
}

fn json(args: &[&str]) -> Value {
    let output = run(&[args, &["--json"]].concat());
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
        assert!(said.contains(part), "`{part}` is missing in: {said}");
    }
}

/// A state file in a folder of its own.
fn state() -> (TempDir, String) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("state.json");
    (folder, path.to_str().unwrap().to_owned())
}

#[test]
fn a_campaign_that_goes_on_ends_as_one_that_was_never_stopped() {
    let (_folder, path) = state();
    let some = ["campaign", "--kind", "wall,push", "--runs"];
    let kept = |runs: &'static str| [&some[..], &[runs, "--state", &path]].concat();
    let part = json(&kept("150"));
    assert_eq!(part["kinds"]["wall"]["runs"], 150);
    let all = json(&kept("400"));
    assert_eq!(all, json(&[&some[..], &["400"]].concat()));
    // What is done stays done.
    assert_eq!(all, json(&kept("100")));
    assert_eq!(all["kinds"]["wall"]["bad"].as_array().unwrap().len(), 0);
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_a_state_that_goes_on() {
    let (_folder, path) = state();
    let args = |runs| ["campaign", "--kind", "wall", "--runs", runs];
    let mut child = knob(&args("100000000"))
        .args(["--state", &path])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let runs = || {
        let text = fs::read_to_string(&path).ok()?;
        // Whole whenever it is looked at.
        let state: Value = serde_json::from_str(&text).unwrap();
        state["runs"]["wall"]["runs"].as_u64()
    };
    let begun = Instant::now();
    while runs().is_none() {
        assert!(begun.elapsed() < Duration::from_secs(120));
        assert!(child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(5));
    }
    let kill = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(kill.success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("the same command goes on"), "{said}");
    assert!(output.stdout.is_empty());
    let next = (runs().unwrap() + 500).to_string();
    let resumed = json(&[&args(&next)[..], &["--state", &path]].concat());
    assert_eq!(resumed, json(&args(&next)));
    let left: Vec<_> = fs::read_dir(Path::new(&path).parent().unwrap())
        .unwrap()
        .collect();
    assert_eq!(left.len(), 1, "{left:?}");
}

#[test]
fn a_state_that_is_not_whole_or_of_another_campaign_is_refused() {
    let (_folder, path) = state();
    let args = [
        "campaign", "--kind", "wall", "--runs", "50", "--state", &path,
    ];
    json(&args);
    let whole = fs::read_to_string(&path).unwrap();
    let with = |more: &[&'static str]| {
        args.iter()
            .copied()
            .chain(more.iter().copied())
            .collect::<Vec<_>>()
    };
    refused(
        &with(&["--seed", "2"]),
        1,
        &["--state", "seed 1", "remove it"],
    );
    refused(
        &with(&["--law", "ledger"]),
        1,
        &["law auto", "ledger is asked"],
    );
    for (from, to, parts) in [
        ("\"seed\":1", "\"sed\":1", ["not a whole state", "sed"]),
        (
            "\"version\":\"",
            "\"version\":\"9",
            ["version 9", "remove it"],
        ),
        (
            "\"fingerprint\":\"",
            "\"fingerprint\":\"0",
            ["a build whose runs end otherwise", "remove it"],
        ),
        (
            "\"wall\"",
            "\"well\"",
            ["not a state of a campaign", "remove it"],
        ),
    ] {
        fs::write(&path, whole.replacen(from, to, 1)).unwrap();
        refused(&args, 1, &parts);
    }
    for length in [0, 1, whole.len() / 2, whole.len() - 3] {
        fs::write(&path, &whole[..length]).unwrap();
        refused(&args, 1, &["not a whole state", "begin anew"]);
        assert_eq!(fs::read_to_string(&path).unwrap(), whole[..length]);
    }
    refused(
        &["campaign", "--state", "/no/such/folder/state.json"],
        1,
        &["--state", "no folder"],
    );
}

#[test]
fn a_bad_run_is_explained() {
    let args = [
        "campaign",
        "--law",
        "ledger",
        "--kind",
        "hand",
        "--explain",
        "206",
    ];
    let why = json(&args);
    assert_eq!(why["fault"], "given-out");
    assert_eq!(why["outside_the_assumptions"], true);
    let left = &why["left"];
    assert!(left["tick"].as_u64() <= why["given_out_at_tick"].as_u64());
    let velocity = left["velocity_rad_s"].as_f64().unwrap();
    assert!(velocity < left["believed_velocity_rad_s"][0].as_f64().unwrap());
    let output = run(&args);
    assert!(output.status.success());
    let said = String::from_utf8(output.stdout).unwrap();
    for part in [
        "hand 206 of seed 1 under ledger",
        "kg m²",
        "ω·T 1.03",
        "an assumption was broken: at tick 1 the true velocity",
        "only after that, by tick 2",
    ] {
        assert!(said.contains(part), "`{part}` is missing in: {said}");
    }
    let well = json(&["campaign", "--kind", "wall", "--explain", "7"]);
    assert_eq!(
        (&well["fault"], &well["left"]),
        (&Value::Null, &Value::Null)
    );
    refused(&["campaign", "--explain", "7"], 2, &["--kind"]);
    refused(
        &["campaign", "--kind", "wail"],
        2,
        &["`wail`", "wall, spring"],
    );
}

#[test]
fn a_table_names_what_was_run() {
    let output = run(&[
        "campaign",
        "--kind",
        "hand,wall",
        "--runs",
        "300",
        "--law",
        "ledger",
    ]);
    assert!(output.status.success());
    let said = String::from_utf8(output.stdout).unwrap();
    for part in [
        "law ledger, seed 1",
        "given-out",
        "206 given-out",
        "knob campaign --law ledger --seed 1 --kind hand --explain",
    ] {
        assert!(said.contains(part), "`{part}` is missing in: {said}");
    }
}

#[test]
fn a_search_goes_on_and_says_how_close_it_came() {
    let (_folder, path) = state();
    let args = |evaluations| ["campaign", "--search", evaluations];
    json(&[&args("1000")[..], &["--state", &path]].concat());
    let resumed = json(&[&args("3000")[..], &["--state", &path]].concat());
    assert_eq!(resumed, json(&args("3000")));
    assert_eq!(
        (&resumed["climbs"], &resumed["violations"]),
        (&15.into(), &0.into())
    );
    let closest = resumed["closest"].as_array().unwrap();
    assert_eq!(
        (&closest[0]["goal"], &closest[1]["goal"]),
        (&"energy".into(), &"cycle".into())
    );
    assert!(
        closest[0]["trial"]
            .as_str()
            .unwrap()
            .contains("Trial { scene")
    );
}

#[test]
fn an_ablation_is_written_with_what_each_part_is_for() {
    let folder = TempDir::new().unwrap();
    let name = folder.path().join("ablation");
    let name = name.to_str().unwrap();
    // What is there is not replaced unasked.
    fs::write(format!("{name}.md"), "mine").unwrap();
    refused(&["ablation", "--out", name], 1, &["exists", "--force"]);
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(left.len(), 1, "{left:?}");
    // The one that was committed.
    let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/ablation.md");
    let text = fs::read_to_string(committed).unwrap();
    for part in [
        "cargo xtask ablation",
        "| as built |",
        "*no limit*",
        "*no charge*",
    ] {
        assert!(text.contains(part), "`{part}` is missing");
    }
}
