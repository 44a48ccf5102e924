//! The commands that talk to a board, against the firmware itself on a pseudo-terminal.
#![cfg(target_os = "linux")]

#[allow(dead_code, reason = "shared with tests that use more of it")]
mod native;

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use firmware::settings::{DEFAULTS, Settings};
use firmware::store::{Keep, Loaded, SaveError};
use native::powered::{self, board_with_motor};
use native::{Fate, Port, board, board_that_keeps, board_with};
use plant_sim::electrical::Wiring;
use protocol::{
    FRAME_MAX, Frames, FromDevice, Hello, Message, Refusal, Stored, ToDevice, decode, encode,
};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};
use serde_json::{Value, json};
use tempfile::TempDir;

fn knob(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_knob"));
    command
        .args(args)
        .env_remove("KNOB_PORT")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// Waits for the end. Not for ever: the limit is there to end a test that hangs.
fn end(mut child: Child) -> Output {
    for _ in 0..1200 {
        if child.try_wait().unwrap().is_some() {
            return child.wait_with_output().unwrap();
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    child.kill().unwrap();
    let output = child.wait_with_output().unwrap();
    panic!("hung: {}", String::from_utf8_lossy(&output.stderr));
}

fn run(args: &[&str]) -> Output {
    end(knob(args).spawn().unwrap())
}

fn on<'a>(port: &'a Port, args: &[&'a str]) -> Vec<&'a str> {
    [args, &["--port", &port.path]].concat()
}

/// Standard output as the one JSON object that it must be.
fn ask(port: &Port, args: &[&str]) -> Value {
    let output = run(&on(port, &[args, &["--json"]].concat()));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "knob {args:?}: {said}");
    let value: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(value.is_object());
    value
}

/// Standard output as a person reads it.
fn read(port: &Port, args: &[&str]) -> String {
    let output = run(&on(port, args));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "knob {args:?}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

/// Nothing on standard output, the exit status, and every part of the message.
fn is_refusal(output: &Output, what: &str, status: i32, parts: &[&str]) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{what}: {said}");
    assert!(output.stdout.is_empty(), "{what} wrote to standard output");
    for part in parts {
        assert!(
            said.contains(part),
            "{what}: `{part}` is missing in: {said}"
        );
    }
    assert!(!said.contains("panicked"), "{what}: {said}");
}

fn refused(port: &Port, args: &[&str], status: i32, parts: &[&str]) {
    for json in [&[][..], &["--json"]] {
        let args = on(port, &[args, json].concat());
        is_refusal(&run(&args), &args.join(" "), status, parts);
    }
}

#[test]
fn info_says_who_the_device_is_and_how() {
    let (port, _) = board();
    let info = ask(&port, &["info"]);
    assert_eq!(info["port"], port.path);
    assert_eq!(info["firmware"], "1.2.3");
    assert_eq!(info["git_hash"], "abc1234");
    assert_eq!(info["board"], "native");
    assert_eq!(info["protocol"], protocol::VERSION);
    assert_eq!(info["state"], "disarmed");
    assert_eq!(info["fault"], Value::Null);
    assert_eq!(info["dropped"], 0);
    assert_eq!(info["bad_frames"], 0);
    assert_eq!(info["settings"], "no-storage");
    let later = ask(&port, &["info"]);
    assert!(later["tick"].as_u64() > info["tick"].as_u64());
    let text = read(&port, &["info"]);
    for part in ["1.2.3 (abc1234)", "native", "disarmed"] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn the_port_may_come_from_the_environment() {
    let (port, _) = board();
    let with =
        |args: &[&str], variable: &str| end(knob(args).env("KNOB_PORT", variable).spawn().unwrap());
    assert!(with(&["info"], &port.path).status.success());
    // The flag wins.
    let flag = with(&["info", "--port", &port.path], "/no/such/port");
    assert!(flag.status.success());
    is_refusal(
        &with(&["info"], "/no/such/port"),
        "KNOB_PORT",
        1,
        &["/no/such/port"],
    );
}

#[test]
fn get_shows_all_parameters_or_the_named_ones() {
    let (port, _) = board();
    let all = ask(&port, &["get"]);
    assert_eq!(all.as_object().unwrap().len(), protocol::Name::ALL.len());
    assert_eq!(all["sample_period_s"], 0.001);
    assert_eq!(all["law"], "auto");
    assert_eq!(all["inertia_kg_m2"], json!([6.28e-6, 6.28e-6]));
    let some = ask(&port, &["get", "law", "decimation", "law"]);
    assert_eq!(some, json!({"law": "auto", "decimation": 1}));
    assert_eq!(
        read(&port, &["get", "law", "coulomb_nm", "stiffness_nm_rad"]),
        "law=auto\ncoulomb_nm=0.002\nstiffness_nm_rad=0\n"
    );
    refused(
        &port,
        &["get", "law", "lore"],
        2,
        &["`lore`", "shape", "coulomb_nm"],
    );
}

#[test]
fn set_changes_what_it_is_given_and_says_from_when() {
    let (port, _) = board();
    let before = ask(&port, &["info"])["tick"].as_u64().unwrap();
    let set = ask(
        &port,
        &[
            "set",
            "law=episode",
            "shape=wall",
            "stiffness_nm_rad=0.75",
            "damping_nm_s_rad=2e-5",
            "wall_rad=-0.25",
            "period_rad=0.25",
            "delay_s=1e-4",
            "amplifier_tau_s=2e-4",
            "jitter_s=3e-5",
            "torque_step_nm=1e-3",
            "coulomb_nm=1.8e-3..2.2e-3",
            "viscous_nm_s_rad=1e-5",
            "decimation=4",
            "sample_period_s=2e-3",
        ],
    );
    assert!(set["tick"].as_u64().unwrap() > before);
    let wanted = json!({
        "law": "episode", "shape": "wall", "stiffness_nm_rad": 0.75, "wall_rad": -0.25,
        "coulomb_nm": [1.8e-3, 2.2e-3], "viscous_nm_s_rad": [1e-5, 1e-5], "decimation": 4,
        "sample_period_s": 2e-3, "torque_max_nm": 0.5, "damping_nm_s_rad": 2e-5, "period_rad": 0.25,
        "delay_s": 1e-4, "amplifier_tau_s": 2e-4, "jitter_s": 3e-5, "torque_step_nm": 1e-3,
    });
    let now = ask(&port, &["get"]);
    for (name, value) in wanted.as_object().unwrap() {
        assert_eq!(&now[name], value, "{name}");
        assert_eq!(&set[name], value, "{name}");
    }
    for (name, words) in [
        ("law", &["raw", "static", "ledger", "auto"][..]),
        ("shape", &["spring", "detent"]),
    ] {
        for word in words {
            let set = ask(&port, &["set", &format!("{name}={word}")]);
            assert_eq!(set[name], *word);
        }
    }
    let text = read(&port, &["set", "torque_max_nm=0.125"]);
    assert!(
        text.starts_with("torque_max_nm=0.125\nin force from tick "),
        "{text}"
    );
    // What get shows, set takes.
    let shown = read(&port, &["get"]);
    let (other, _) = board();
    let lines: Vec<&str> = shown.lines().collect();
    ask(&other, &[&["set"], &lines[..]].concat());
    assert_eq!(read(&other, &["get"]), shown);
}

#[test]
fn bad_values_are_refused_before_anything_is_sent() {
    // Nobody answers here: only what is refused before the port is touched has status 2.
    let silent = Port::new(|_, _| {});
    for (args, parts) in [
        (
            &["stiffness_nm_rad=NaN"][..],
            &["stiffness_nm_rad", "finite"][..],
        ),
        (&["stiffness_nm_rad=inf"], &["finite"]),
        (&["stiffness_nm_rad=1e300"], &["32-bit"]),
        (
            &["law=lore"],
            &["law", "raw, static, episode, ledger, auto"],
        ),
        (&["shape=notch"], &["shape", "spring, wall, detent"]),
        (&["decimation=2.5"], &["decimation", "whole number"]),
        (&["coulomb_nm=1e-3..x"], &["coulomb_nm", "`x`"]),
        (&["stiffnes=1"], &["`stiffnes`", "stiffness_nm_rad"]),
        (&["stiffness_nm_rad"], &["NAME=VALUE"]),
        (
            &["law=raw", "centre_rad=1", "law=raw"],
            &["law is set twice"],
        ),
        (&[], &["NAME=VALUE"]),
    ] {
        refused(&silent, &[&["set"], args].concat(), 2, parts);
    }
}

#[test]
fn what_the_device_refuses_is_told_with_what_it_accepts_and_changes_nothing() {
    let (port, _) = board();
    let before = read(&port, &["get"]);
    for (args, parts) in [
        (
            &["sample_period_s=0.05"][..],
            &["nothing was set", "sample_period_s: 0.05", "4e-5 to 0.02"][..],
        ),
        (
            &["coulomb_nm=2.2e-3..1.8e-3"],
            &["coulomb_nm", "0.0022..0.0018", "LOW ≤ HIGH"],
        ),
        (&["inertia_kg_m2=0"], &["inertia_kg_m2: 0", "1e-8 to 0.1"]),
        (&["decimation=0"], &["decimation: 0", "1 to 4096"]),
        (
            &[
                "centre_rad=1e3",
                "counts_per_rev=1000000",
                "torque_max_nm=-1",
            ],
            &["torque_max_nm: -1", "0 to 10"],
        ),
        (&["damping_nm_s_rad=2"], &["damping_nm_s_rad: 2", "0 to 1"]),
        (&["delay_s=-1e-4"], &["delay_s: -0.0001", "0 to 0.02"]),
        // Each accepted, but not together.
        (
            &["delay_s=2e-3"],
            &["delay_s=0.002", "sample_period_s", "0 to 0.001"],
        ),
        (
            &["shape=detent", "period_rad=1e-3"],
            &["period_rad=0.001", "counts_per_rev", "0.00153"],
        ),
        (
            &["jitter_s=2e-3"],
            &["jitter_s=0.002", "sample_period_s", "0 to 0.000999"],
        ),
        // A good value beside a bad one.
        (
            &["stiffness_nm_rad=1", "speed_max_rad_s=0"],
            &["speed_max_rad_s: 0", "1 to 10000"],
        ),
    ] {
        refused(&port, &[&["set"], args].concat(), 1, parts);
        assert_eq!(read(&port, &["get"]), before, "{args:?} changed something");
    }
    ask(&port, &["arm"]);
    refused(
        &port,
        &["set", "stiffness_nm_rad=1", "sample_period_s=2e-3"],
        1,
        &["sample_period_s", "while disarmed", "knob disarm"],
    );
    assert_eq!(read(&port, &["get"]), before);
    // The stiffness alone is accepted.
    ask(&port, &["set", "stiffness_nm_rad=1"]);
}

#[test]
fn arm_and_disarm_do_so() {
    let (port, _) = board();
    assert_eq!(ask(&port, &["arm"])["state"], "armed");
    assert_eq!(ask(&port, &["info"])["state"], "armed");
    assert!(read(&port, &["arm"]).starts_with("armed from tick "));
    assert_eq!(ask(&port, &["disarm"])["state"], "disarmed");
    assert_eq!(ask(&port, &["info"])["state"], "disarmed");
}

#[test]
fn a_fault_is_told_in_words_and_cleared() {
    let (port, hand) = board();
    refused(&port, &["clear"], 1, &["nothing to clear", "disarmed"]);
    ask(&port, &["arm"]);
    hand.jump.store(-123_456, Relaxed);
    while hand.jump.load(Relaxed) != 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let info = ask(&port, &["info"]);
    assert_eq!(info["state"], "fault");
    assert_eq!(info["fault"], "encoder-jump");
    assert!(info["fault_text"].as_str().unwrap().contains("-123456"));
    let text = read(&port, &["info"]);
    assert!(
        text.contains("-123456 counts") && text.contains("knob clear"),
        "{text}"
    );
    for order in ["arm", "disarm"] {
        refused(&port, &[order], 1, &["cannot", "-123456", "knob clear"]);
    }
    assert_eq!(ask(&port, &["clear"])["state"], "disarmed");
    assert_eq!(ask(&port, &["arm"])["state"], "armed");
}

#[test]
fn a_board_without_storage_says_so() {
    let (port, _) = board();
    refused(
        &port,
        &["save"],
        1,
        &["nothing was saved", "native", "keeps no settings"],
    );
}

/// Keeps settings in memory, as long as the test does.
#[derive(Clone)]
struct Memory(Arc<Mutex<Loaded>>);

impl Memory {
    fn with(stored: Stored) -> Self {
        Self(Arc::new(Mutex::new(Loaded::defaults(stored))))
    }
}

impl Keep for Memory {
    fn load(&mut self) -> Loaded {
        *self.0.lock().unwrap()
    }

    fn save(&mut self, settings: &Settings) -> Result<(), SaveError> {
        let mut kept = self.0.lock().unwrap();
        if settings.parameters.decimation == 13 {
            return Err(SaveError::ReadBack);
        }
        *kept = Loaded {
            stored: Stored::Last,
            settings: *settings,
        };
        Ok(())
    }
}

#[test]
fn what_is_saved_is_there_after_the_next_start() {
    let memory = Memory::with(Stored::Nothing);
    let (port, hand) = board_that_keeps(memory.clone());
    let info = ask(&port, &["info"]);
    assert_eq!(info["settings"], "nothing");
    assert!(read(&port, &["info"]).contains("settings     none were saved"));
    ask(&port, &["set", "law=episode", "sample_period_s=2e-3"]);
    // Not while the motor may turn, nor before a fault is looked at.
    ask(&port, &["arm"]);
    let armed = ["nothing was saved", "is armed", "knob disarm"];
    refused(&port, &["save"], 1, &armed);
    hand.jump.store(99_999, Relaxed);
    while ask(&port, &["info"])["state"] != "fault" {}
    refused(&port, &["save"], 1, &["nothing was saved", "knob clear"]);
    ask(&port, &["clear"]);
    assert_eq!(ask(&port, &["info"])["settings"], "nothing");
    assert_eq!(ask(&port, &["save"])["state"], "disarmed");
    assert_eq!(ask(&port, &["info"])["settings"], "last");
    let shown = read(&port, &["get"]);
    drop(port);

    let (port, _) = board_that_keeps(memory);
    assert_eq!(ask(&port, &["info"])["settings"], "last");
    assert_eq!(read(&port, &["get"]), shown);
    assert!(shown.contains("law=episode") && shown.contains("sample_period_s=0.002"));
    // A save that fails is told, and what was saved is still there.
    ask(&port, &["set", "decimation=13"]);
    refused(&port, &["save"], 1, &["nothing was saved", "flash"]);
}

#[test]
fn defaults_for_want_of_good_settings_are_told() {
    for (stored, code, part) in [
        (Stored::Damaged, "damaged", "damaged"),
        (Stored::Version { found: 9 }, "version", "version 9"),
    ] {
        let (port, _) = board_that_keeps(Memory::with(stored));
        let info = ask(&port, &["info"]);
        assert_eq!(info["settings"], code);
        let text = info["settings_text"].as_str().unwrap();
        assert!(text.contains(part) && text.contains("defaults"), "{text}");
    }
    let memory = Memory::with(Stored::Last);
    memory.0.lock().unwrap().settings.parameters.torque_max_nm = 1e9;
    let (port, _) = board_that_keeps(memory);
    let info = ask(&port, &["info"]);
    assert_eq!(info["settings"], "refused");
    let text = info["settings_text"].as_str().unwrap();
    assert!(text.contains("torque_max_nm"), "{text}");
    assert_eq!(
        ask(&port, &["get"])["torque_max_nm"],
        DEFAULTS.torque_max_nm
    );
}

/// The rows of a log, each as its cells, after the header is checked.
fn rows(path: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(
        lines.next().unwrap(),
        "tick,state,count,torque_nm,stiffness_nm_rad,demanded_nm_rad,margin_nm,reason,law,account_j"
    );
    lines
        .map(|line| line.split(',').map(str::to_owned).collect())
        .collect()
}

fn left_in(folder: &TempDir) -> Vec<String> {
    fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect()
}

#[test]
fn log_writes_every_tick_or_every_nth() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("log.csv");
    let out_flag = out.to_str().unwrap();
    let (port, hand) = board();
    // Far more than m/T²: it is clamped.
    ask(&port, &["set", "stiffness_nm_rad=100", "torque_max_nm=10"]);
    ask(&port, &["arm"]);
    hand.speed.store(1, Relaxed);
    let log = ask(&port, &["log", "--seconds", "0.2", "--out", out_flag]);
    for (key, value) in [
        ("rows", 200),
        ("gaps", 0),
        ("missing", 0),
        ("dropped", 0),
        ("lost", 0),
        ("damaged_frames", 0),
    ] {
        assert_eq!(log[key], value, "{key}: {log}");
    }
    let all = rows(&out);
    assert_eq!(all.len(), 200);
    let number = |cell: &str| cell.parse::<f64>().unwrap();
    for pair in all.windows(2) {
        assert_eq!(number(&pair[1][0]), number(&pair[0][0]) + 1.0);
        assert_eq!(number(&pair[1][2]), number(&pair[0][2]) + 1.0);
    }
    for row in &all {
        assert_eq!(row.len(), 10);
        assert_eq!((row[1].as_str(), row[5].as_str()), ("armed", "100"));
        assert!(number(&row[4]) < 100.0 && number(&row[3]) < 0.0);
        assert!(number(&row[6]).is_finite());
        assert_ne!(row[7], "none");
        assert_eq!(row[8], "ledger", "auto, with more than the others could do");
        assert!(number(&row[9]) >= 0.0);
    }
    assert_eq!(log["laws"], json!({"ledger": 200}));
    let reasons = log["reasons"].as_object().unwrap();
    let counted: u64 = reasons.values().map(|rows| rows.as_u64().unwrap()).sum();
    assert_eq!(counted, 200);
    assert_eq!(number(&all[0][0]), log["first_tick"].as_f64().unwrap());
    assert_eq!(number(&all[199][0]), log["last_tick"].as_f64().unwrap());

    // It is replaced only by force, and nothing goes on being sent.
    let again = [
        "log",
        "--seconds",
        "0.1",
        "--every",
        "10",
        "--out",
        out_flag,
    ];
    refused(&port, &again, 1, &["log.csv exists", "--force"]);
    let sent = hand.telemetry.load(Relaxed);
    ask(&port, &["info"]);
    assert_eq!(hand.telemetry.load(Relaxed), sent);
    let text = read(&port, &[&again[..], &["--force"]].concat());
    assert!(text.contains("rows         10,"), "{text}");
    let tenth = rows(&out);
    assert_eq!(tenth.len(), 10);
    assert_eq!(number(&tenth[1][0]), number(&tenth[0][0]) + 10.0);
    assert_eq!(left_in(&folder), ["log.csv"]);
}

#[test]
fn log_refuses_flags_that_make_no_sense() {
    let silent = Port::new(|_, _| {});
    for (args, part) in [
        (["--seconds", "0", "--every", "1"], "above 0"),
        (["--seconds", "nan", "--every", "1"], "finite"),
        (["--seconds", "1", "--every", "0"], "1..=65535"),
        (["--seconds", "1", "--every", "65536"], "1..=65535"),
    ] {
        let args = [&["log", "--out", "/tmp/never.csv"], &args[..]].concat();
        refused(&silent, &args, 2, &[part]);
    }
    let nowhere = ["log", "--seconds", "1", "--out", "/no/such/folder/log.csv"];
    refused(&silent, &nowhere, 1, &["--out", "/no/such/folder"]);
}

#[test]
fn log_tells_of_faults_and_of_rows_that_are_missing() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("log.csv");
    let (mut lost, mut damaged) = (0, 0);
    let (port, hand) = board_with(move |said| {
        let Message::Telemetry(telemetry) = said.message else {
            return Fate::Arrives;
        };
        match telemetry.tick % 64 {
            // Twice two neighbours and twice one alone, from any beginning.
            10 | 11 if lost < 4 => {
                lost += 1;
                Fate::Vanishes
            }
            30 if damaged < 2 => {
                damaged += 1;
                Fate::IsDamaged
            }
            _ => Fate::Arrives,
        }
    });
    ask(&port, &["arm"]);
    let args = ["log", "--seconds", "0.3", "--json", "--out"];
    let child = knob(&on(&port, &[&args[..], &[out.to_str().unwrap()]].concat()))
        .spawn()
        .unwrap();
    while hand.telemetry.load(Relaxed) < 100 {
        std::thread::sleep(Duration::from_millis(1));
    }
    hand.jump.store(50_000, Relaxed);
    let output = end(child);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("50000 counts"), "{said}");
    let log: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(log["faults"][0]["fault"], "encoder-jump");
    assert_eq!(log["faults"].as_array().unwrap().len(), 1);
    let fault_tick = log["faults"][0]["tick"].as_u64().unwrap();
    let all = rows(&out);
    for row in &all {
        let armed = row[0].parse::<u64>().unwrap() < fault_tick;
        assert_eq!(row[1], if armed { "armed" } else { "fault" });
    }
    // The log may begin within a pair: what matters is that the sums are right.
    let (rows, missing) = (&log["rows"], log["missing"].as_u64().unwrap());
    assert_eq!(rows.as_u64().unwrap() + missing, 300);
    assert_eq!(rows.as_u64().unwrap() as usize, all.len());
    assert!((4..=6).contains(&missing), "{log}");
    assert_eq!(log["damaged_frames"], 2);
    assert_eq!(log["dropped"], 0);
}

#[test]
fn ctrl_c_ends_a_log_without_a_file_and_the_device_falls_silent() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("log.csv");
    let (port, hand) = board();
    let args = ["log", "--seconds", "1e6", "--out", out.to_str().unwrap()];
    let child = knob(&on(&port, &args)).spawn().unwrap();
    while hand.telemetry.load(Relaxed) < 50 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let kill = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(kill.unwrap().success());
    is_refusal(&end(child), "log", 130, &["stopped"]);
    assert!(left_in(&folder).is_empty());
    let sent = hand.telemetry.load(Relaxed);
    ask(&port, &["info"]);
    assert_eq!(hand.telemetry.load(Relaxed), sent);
}

#[test]
fn a_device_that_goes_away_in_a_log_leaves_no_file() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("log.csv");
    let (port, hand) = board();
    let args = [
        "log",
        "--seconds",
        "1e6",
        "--json",
        "--out",
        out.to_str().unwrap(),
    ];
    let child = knob(&on(&port, &args)).spawn().unwrap();
    while hand.telemetry.load(Relaxed) < 50 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let path = port.path.clone();
    drop(port);
    let parts = [path.as_str(), "lost the device", "unplugged", "knob ports"];
    is_refusal(&end(child), "log", 1, &parts);
    assert!(left_in(&folder).is_empty());
}

#[test]
fn a_device_that_falls_silent_in_a_log_is_told_apart_from_one_that_waits() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    // It goes on answering, but sends nothing more.
    let mut telemetry = 0;
    let (port, _) = board_with(move |said| match said.message {
        Message::Telemetry(_) if telemetry == 30 => Fate::Vanishes,
        Message::Telemetry(_) => {
            telemetry += 1;
            Fate::Arrives
        }
        _ => Fate::Arrives,
    });
    refused_once(
        &port,
        &["log", "--seconds", "9", "--out", &at("a.csv")],
        &["answers, but sends no telemetry"],
    );
    // It does not answer either.
    let mut all = 0;
    let (port, _) = board_with(move |_| {
        all += 1;
        if all > 40 {
            Fate::Vanishes
        } else {
            Fate::Arrives
        }
    });
    refused_once(
        &port,
        &["log", "--seconds", "9", "--out", &at("b.csv")],
        &["`status` was not answered within 2.5 s"],
    );
    assert!(left_in(&folder).is_empty());
}

fn refused_once(port: &Port, args: &[&str], parts: &[&str]) {
    is_refusal(&run(&on(port, args)), &args.join(" "), 1, parts);
}

/// The first answer to each request meets its fate; the second comes.
fn only_second_answers_come(fate: fn() -> Fate) {
    let mut last = None;
    let (port, hand) = board_with(move |said| {
        let unasked = matches!(said.message, Message::Event(_));
        if unasked || last.replace(said.sequence) == Some(said.sequence) {
            Fate::Arrives
        } else {
            fate()
        }
    });
    assert_eq!(ask(&port, &["arm"])["state"], "armed");
    assert_eq!(ask(&port, &["set", "law=raw"])["law"], "raw");
    hand.jump.store(99_999, Relaxed);
    while ask(&port, &["info"])["state"] != "fault" {}
    // The second Clear is refused, since the first was taken.
    assert_eq!(ask(&port, &["clear"])["state"], "disarmed");
}

#[test]
fn an_answer_that_is_lost_is_asked_for_again() {
    only_second_answers_come(|| Fate::Vanishes);
}

#[test]
fn an_answer_that_is_damaged_is_asked_for_again() {
    only_second_answers_come(|| Fate::IsDamaged);
}

#[test]
fn an_answer_that_never_comes_whole_is_an_error() {
    // After hello every answer is damaged.
    let (port, _) = board_with(|said| match said.message {
        Message::Hello(_) => Fate::Arrives,
        _ => Fate::IsDamaged,
    });
    refused_once(
        &port,
        &["get"],
        &[
            &port.path,
            "`get` was not answered within 2.5 s",
            "2 damaged frames",
        ],
    );
}

#[test]
fn a_silent_port_is_an_error() {
    let port = Port::new(|_, _| {});
    for command in ["info", "get", "arm", "disarm", "clear", "save"] {
        refused_once(
            &port,
            &[command],
            &[
                &port.path,
                "nothing answered within 1.5 s",
                "knob ports",
                "firmware",
            ],
        );
    }
}

#[test]
fn ctrl_c_ends_the_wait_for_an_answer() {
    let (heard, hears) = std::sync::mpsc::channel();
    let port = Port::new(move |incoming, _| {
        if let Some(first) = incoming.first() {
            let _ = heard.send(*first);
        }
    });
    let child = knob(&on(&port, &["info"])).spawn().unwrap();
    // A zero first: it ends whatever piece of a frame the device has from before.
    assert_eq!(hears.recv(), Ok(0));
    let kill = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(kill.unwrap().success());
    is_refusal(&end(child), "info", 130, &["stopped"]);
}

#[test]
fn a_port_that_babbles_is_an_error() {
    let mut state = 0x1234_5678_9abc_def1_u64;
    let port = Port::new(move |_, outgoing| {
        // As much as the line takes, without end.
        while outgoing.len() < 4096 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            outgoing.extend(state.to_le_bytes());
        }
    });
    refused(
        &port,
        &["info"],
        1,
        &[
            &port.path,
            "bytes came",
            "no message of a knob",
            "something else",
        ],
    );
}

#[test]
fn a_knob_that_sends_but_does_not_listen_is_an_error() {
    let event = Message::Event(protocol::Event::Dropped { total: 1 });
    let port = Port::new(move |_, outgoing| {
        if outgoing.is_empty() {
            outgoing.extend(frame(7, event));
        }
    });
    refused_once(
        &port,
        &["info"],
        &[&port.path, "sends here", "does not answer"],
    );
}

fn frame(sequence: u16, message: Message<'_>) -> Vec<u8> {
    let mut buffer = [0; FRAME_MAX];
    encode(&FromDevice { sequence, message }, &mut buffer)
        .unwrap()
        .to_vec()
}

/// Something that gives the same answer to every request.
fn parrot(answer: Message<'static>) -> Port {
    let mut frames = Frames::new();
    Port::new(move |incoming, outgoing| {
        for byte in incoming {
            if let Some(Ok(request)) = frames.push(*byte)
                && let Ok(ToDevice { sequence, .. }) = decode(request)
            {
                // First a late answer to somebody else.
                outgoing.extend(frame(sequence.wrapping_sub(9), Message::Done { tick: 1 }));
                outgoing.extend(frame(sequence, answer));
            }
        }
    })
}

#[test]
fn another_version_of_the_protocol_is_an_error() {
    let ours = format!("this `knob` speaks version {}", protocol::VERSION);
    for (accepted, remedy) in [
        (protocol::VERSION + 6, "install the newer `knob`"),
        (protocol::VERSION - 1, "flash the firmware"),
    ] {
        let theirs = format!("the device speaks version {accepted}");
        let hello = Message::Hello(Hello {
            version: accepted,
            firmware: "0",
            git_hash: "0",
            board: "0",
            lowest: firmware::settings::LOWEST,
            highest: firmware::settings::HIGHEST,
        });
        for answer in [Message::Refused(Refusal::Version { accepted }), hello] {
            let port = parrot(answer);
            refused(&port, &["info"], 1, &[&port.path, &ours, &theirs, remedy]);
        }
    }
}

#[test]
fn an_answer_to_another_question_is_an_error() {
    let port = parrot(Message::Done { tick: 3 });
    refused(&port, &["info"], 1, &["`hello`", "not one"]);
}

#[test]
fn a_port_that_cannot_be_opened_is_an_error() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "text").unwrap();
    for (path, parts) in [
        (
            "/no/such/port",
            &["/no/such/port", "does not exist", "knob ports"][..],
        ),
        (
            file.to_str().unwrap(),
            &["not", "serial port", "knob ports"],
        ),
        (folder.path().to_str().unwrap(), &["serial port"]),
    ] {
        is_refusal(&run(&["info", "--port", path]), path, 1, parts);
    }
    assert_eq!(fs::read_to_string(&file).unwrap(), "text");
    // Somebody else has it.
    let (port, _) = board();
    let held = open(&port.path, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
    flock(&held, FlockOperation::LockExclusive).unwrap();
    refused(
        &port,
        &["info"],
        1,
        &[&port.path, "another program has it open"],
    );
    drop(held);
    ask(&port, &["info"]);
}

#[test]
fn emulators_are_listed_and_found() {
    let folder = TempDir::new().unwrap();
    let entries = folder.path().join(format!(
        "knob-emulators-{}",
        rustix::process::getuid().as_raw()
    ));
    fs::create_dir(&entries).unwrap();
    let in_folder = |args: &[&str]| end(knob(args).env("TMPDIR", folder.path()).spawn().unwrap());
    let listed = || {
        let output = in_folder(&["ports", "--json"]);
        assert!(output.status.success());
        let json: Value = serde_json::from_slice(&output.stdout).unwrap();
        json["ports"].as_array().unwrap().clone()
    };
    // What is on USB here, if anything.
    let usb = listed();
    assert!(usb.iter().all(|port| port["kind"] == "usb"));
    if usb.is_empty() {
        let none = in_folder(&["info"]);
        is_refusal(
            &none,
            "none",
            1,
            &["no knob is there", "--port", "knob emulate"],
        );
        assert!(
            String::from_utf8(in_folder(&["ports"]).stdout)
                .unwrap()
                .contains("none")
        );
    }

    let ((one, _), (two, _)) = (board(), board());
    let own = std::process::id();
    fs::write(entries.join(own.to_string()), &one.path).unwrap();
    let now = listed();
    assert_eq!(now.len(), usb.len() + 1);
    let last = now.last().unwrap();
    assert_eq!(
        (&last["port"], &last["kind"]),
        (&json!(one.path), &json!("emulated"))
    );
    let text = String::from_utf8(in_folder(&["ports"]).stdout).unwrap();
    assert!(
        text.contains(&one.path) && text.contains("emulated"),
        "{text}"
    );
    if usb.is_empty() {
        assert!(in_folder(&["info"]).status.success());
    }

    // A second one, of the process that started this test.
    let parent = std::os::unix::process::parent_id();
    fs::write(entries.join(parent.to_string()), &two.path).unwrap();
    let several = in_folder(&["info"]);
    let parts = [one.path.as_str(), &two.path, "--port", "KNOB_PORT"];
    is_refusal(&several, "several", 1, &parts);

    // Those that are gone are forgotten.
    let gone = two.path.clone();
    drop(two);
    assert!(listed().iter().all(|port| port["port"] != gone));
    assert!(!entries.join(parent.to_string()).exists());
}

#[test]
fn every_command_has_help_with_an_example() {
    for command in [
        "ports", "info", "get", "set", "arm", "disarm", "clear", "save", "log",
    ] {
        let output = run(&[command, "--help"]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(
            output.status.success() && text.contains("Example"),
            "{command}"
        );
        assert!(text.contains(&format!("knob {command}")), "{command}");
        assert!(text.contains("--json"), "{command}");
        assert_eq!(text.contains("KNOB_PORT"), command != "ports", "{command}");
    }
}

#[test]
fn calibrate_finds_the_motor_and_sets_it() {
    let port = board_with_motor(Wiring::default());
    assert!(ask(&port, &["info"])["motor"].is_null());
    let args = [
        "calibrate",
        "--drive",
        "current",
        "--current-max",
        "5",
        "--pole-pairs",
        "7",
    ];
    let found = ask(&port, &[&args[..], &["--apply"]].concat());
    let holds = |key: &str, truth: f64| {
        let end = |end: &str| found[key][end].as_f64().unwrap();
        assert!(
            end("low") <= truth && truth <= end("high"),
            "{key}: {}",
            found[key]
        );
    };
    holds("resistance_ohm", powered::MOTOR.resistance_ohm);
    holds("d_inductance_h", powered::MOTOR.d_inductance_h);
    holds("q_inductance_h", powered::MOTOR.q_inductance_h);
    holds(
        "torque_constant_nm_a",
        powered::MOTOR.torque_constant_nm_a(),
    );
    holds("zero_turns", powered::ZERO_TURNS);
    assert_eq!(found["pole_pairs"], 7);
    assert_eq!(found["reversed"], true);
    assert!(found["applied_at_tick"].is_u64());
    let motor = &ask(&port, &["info"])["motor"];
    assert_eq!(motor["drive"], "current");
    for key in ["resistance_ohm", "q_inductance_h", "torque_constant_nm_a"] {
        let (told, value) = (motor[key].as_f64(), found[key]["value"].as_f64());
        let ratio = told.unwrap() / value.unwrap();
        assert!((ratio - 1.0).abs() < 1e-6, "{key}: {ratio}");
    }
    // With a motor it arms.
    assert_eq!(ask(&port, &["arm"])["state"], "armed");
    refused(&port, &args, 1, &["armed"]);
}

#[test]
fn calibrate_refuses_with_the_reason() {
    let open = Wiring {
        open: Some(1),
        ..Wiring::default()
    };
    let port = board_with_motor(open);
    let args = ["calibrate", "--drive", "current", "--current-max", "5"];
    refused(&port, &args, 1, &["phase B", "unplugged"]);
    assert_eq!(ask(&port, &["info"])["state"], "disarmed");
    let (port, _) = board();
    refused(&port, &args, 1, &["native", "drives no motor itself"]);
    let brushed = [
        "calibrate",
        "--drive",
        "brushed",
        "--current-max",
        "5",
        "--pole-pairs",
        "7",
    ];
    refused(&port, &brushed, 2, &["--pole-pairs"]);
}

#[test]
fn ctrl_c_ends_a_calibration_with_the_bridge_off() {
    let port = board_with_motor(Wiring::default());
    let args = ["calibrate", "--drive", "current", "--current-max", "5"];
    let child = knob(&on(&port, &args)).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(1000));
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
    let output = end(child);
    assert_eq!(
        output.status.code(),
        Some(130),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(output.stdout.is_empty());
    assert_eq!(ask(&port, &["info"])["state"], "disarmed");
}
