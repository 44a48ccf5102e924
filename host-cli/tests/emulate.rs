//! `knob emulate` and `knob demo` with the firmware's image in the emulator. Built and turned on by
//! `cargo xtask test`.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

fn knob() -> Command {
    let mut knob = Command::new(env!("CARGO_BIN_EXE_knob"));
    let image = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/firmware/emulated.elf");
    if std::env::var_os("KNOB_FIRMWARE").is_none() {
        knob.env("KNOB_FIRMWARE", image);
    }
    knob.env_remove("KNOB_PORT");
    knob
}

fn run(args: &[&str]) -> Output {
    knob().args(args).output().unwrap()
}

fn json(args: &[&str]) -> Value {
    let output = run(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "knob {args:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// An emulated knob that ends with the test.
struct Emulated {
    child: Child,
    port: String,
}

impl Emulated {
    fn start(args: &[&str]) -> Self {
        let mut command = knob();
        command.arg("emulate").args(args).arg("--json");
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let said: Value = serde_json::from_str(&line).unwrap_or_else(|error| {
            let _ = child.kill();
            panic!("{error}: {line}");
        });
        Self {
            child,
            port: said["port"].as_str().unwrap().to_owned(),
        }
    }

    fn interrupt(mut self) -> Option<i32> {
        let id = self.child.id().to_string();
        assert!(
            Command::new("kill")
                .args(["-INT", &id])
                .status()
                .unwrap()
                .success()
        );
        self.child.wait().unwrap().code()
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_emulated_knob_is_set_armed_logged_and_left() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (link, record, log) = (at("port"), at("record.csv"), at("log.csv"));
    let emulated = Emulated::start(&["--port-link", &link, "--record", &record]);
    assert_eq!(fs::read_link(&link).unwrap(), PathBuf::from(&emulated.port));

    let info = json(&["info", "--port", &link, "--json"]);
    assert!(info.to_string().contains("emulated"), "{info}");
    let set = [
        "law=raw",
        "stiffness_nm_rad=0.5",
        "coulomb_nm=1.8e-3..2.2e-3",
    ];
    json(&[&["set", "--port", &link, "--json"], &set[..]].concat());
    let got = json(&["get", "--port", &link, "--json"]);
    assert!(
        got.to_string().contains("\"stiffness_nm_rad\":0.5"),
        "{got}"
    );
    json(&["arm", "--port", &link, "--json"]);
    json(&[
        "log",
        "--seconds",
        "1",
        "--out",
        &log,
        "--port",
        &link,
        "--json",
    ]);
    let rows = fs::read_to_string(&log).unwrap();
    assert!(rows.lines().count() > 500, "{} rows", rows.lines().count());
    // Without a gap: 1 kHz over the emulator's line.
    let ticks: Vec<u64> = rows
        .lines()
        .skip(1)
        .map(|row| row.split(',').next().unwrap().parse().unwrap())
        .collect();
    assert!(ticks.windows(2).all(|pair| pair[1] == pair[0] + 1));

    let refused = run(&["set", "sample_period_s=2e-3", "--port", &link]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("sample_period_s"));
    json(&["disarm", "--port", &link, "--json"]);
    assert_eq!(run(&["save", "--port", &link]).status.code(), Some(1));

    assert_eq!(emulated.interrupt(), Some(130));
    assert!(!Path::new(&link).exists());
    let rows = fs::read_to_string(&record).unwrap();
    assert!(rows.starts_with("time_s,angle_rad") && rows.lines().count() > 500);
    let gone = run(&["info", "--port", &link]);
    assert_eq!(gone.status.code(), Some(1));
}

#[test]
fn what_the_emulated_knob_saves_is_there_when_it_starts_again() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (link, settings) = (at("port"), at("settings"));
    let ask = |args: &[&str]| json(&[args, &["--port", &link, "--json"]].concat());
    let start = || Emulated::start(&["--port-link", &link, "--settings", &settings]);

    let emulated = start();
    assert_eq!(ask(&["info"])["settings"], "nothing");
    ask(&["set", "law=episode", "sample_period_s=2e-3"]);
    ask(&["save"]);
    assert_eq!(ask(&["info"])["settings"], "last");
    let kept = ask(&["get"]);
    assert_eq!(emulated.interrupt(), Some(130));

    let emulated = start();
    assert_eq!(ask(&["info"])["settings"], "last");
    assert_eq!(ask(&["get"]), kept);
    assert_eq!(kept["sample_period_s"], 2e-3);
    // A sector is full after some saves, and the other takes over.
    for wall in 0..20 {
        ask(&["set", &format!("wall_rad={wall}")]);
        ask(&["save"]);
    }
    assert_eq!(emulated.interrupt(), Some(130));

    let emulated = start();
    assert_eq!(ask(&["get"])["wall_rad"], 19.0);
    assert_eq!(emulated.interrupt(), Some(130));

    // Damage.
    let mut bytes = fs::read(&settings).unwrap();
    bytes.fill(0xA5);
    fs::write(&settings, bytes).unwrap();
    let emulated = start();
    assert_eq!(ask(&["info"])["settings"], "damaged");
    assert_eq!(ask(&["get"])["sample_period_s"], 1e-3);
    ask(&["save"]);
    assert_eq!(ask(&["info"])["settings"], "last");
    assert_eq!(emulated.interrupt(), Some(130));

    fs::write(&settings, "text").unwrap();
    let refused = run(&["emulate", "--settings", &settings]);
    assert_eq!(refused.status.code(), Some(1));
    let said = String::from_utf8_lossy(&refused.stderr);
    for part in ["--settings", "4 bytes", "8192"] {
        assert!(said.contains(part), "{said}");
    }
    assert_eq!(fs::read_to_string(&settings).unwrap(), "text");
}

/// The pushes are played by the image, and the plant's truth is found.
#[test]
fn the_emulated_knob_is_identified() {
    let folder = TempDir::new().unwrap();
    let scene = folder.path().join("scene.toml");
    let truth = [
        ("inertia_kg_m2", 9e-6),
        ("viscous_nm_s_rad", 2e-5),
        ("coulomb_nm", 3e-3),
    ];
    let mut text = "[device]\ncounts_per_rev = 8192\n".to_owned();
    for (key, value) in truth {
        text += &format!("{key} = {value:e}\n");
    }
    text += "[loop]\nsample_period_s = 1e-3\n[render]\nlaw = \"raw\"\nshape = \"spring\"\nstiffness_nm_rad = 1.0\n";
    fs::write(&scene, text).unwrap();
    let emulated = Emulated::start(&["--scene", scene.to_str().unwrap(), "--pace", "free"]);
    let ask = |args: &[&str]| json(&[args, &["--port", &emulated.port, "--json"]].concat());
    let found = ask(&["identify", "--apply"]);
    for (key, value) in truth {
        let number = |end: &str| found[key][end].as_f64().unwrap();
        let (low, high) = (number("low"), number("high"));
        assert!(low <= value && value <= high, "{key}: {found}");
        assert!(high - low < 0.2 * value, "{key}: {found}");
    }
    // An f32, written in few digits.
    let low = ask(&["get"])["coulomb_nm"][0].as_f64().unwrap() as f32;
    assert!(f64::from(low) <= found["coulomb_nm"]["low"].as_f64().unwrap());
    assert!(low > 2.9e-3);
    assert_eq!(ask(&["info"])["state"], "disarmed");
    assert_eq!(emulated.interrupt(), Some(130));
}

#[test]
fn a_scene_makes_the_plant() {
    let folder = TempDir::new().unwrap();
    let record = folder.path().join("record.csv");
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/fig6a.toml");
    let emulated = Emulated::start(&[
        "--scene",
        scene.to_str().unwrap(),
        "--pace",
        "free",
        "--record",
        record.to_str().unwrap(),
    ]);
    // Disarmed, the knob coasts from 30 rad/s until friction stops it.
    json(&["info", "--port", &emulated.port, "--json"]);
    assert_eq!(emulated.interrupt(), Some(130));
    let rows = fs::read_to_string(&record).unwrap();
    let speed = |row: &str| row.split(',').nth(2).unwrap().parse::<f64>().unwrap();
    assert_eq!(rows.lines().nth(1).map(speed), Some(30.0));
    assert!(rows.lines().nth(2).map(speed).unwrap() < 30.0);
}

#[test]
fn the_demo_tells_what_the_paper_says() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("demo");
    let demo = json(&["demo", "--json", "--out", out.to_str().unwrap()]);
    let number = |throw: &str, key: &str| demo[throw][key].as_f64().unwrap();
    assert_eq!(demo["soft_wall"]["at_rest"], true);
    assert!(number("soft_wall", "energy_ratio") <= 1.0);
    assert!(number("raw_spring", "energy_ratio") > 10.0);
    assert_eq!(demo["clamped_spring"]["at_rest"], true);
    assert!(number("clamped_spring", "energy_ratio") <= 1.0);
    assert!((number("clamped_spring", "stiffness_applied_nm_rad") - 0.018).abs() < 1e-5);
    assert_eq!(demo["coarse_raw"]["at_rest"], false);
    assert_eq!(demo["coarse_clamped"]["at_rest"], true);
    assert!(
        demo["refused"]
            .as_str()
            .unwrap()
            .contains("sample_period_s is 0.05")
    );
    for chart in ["hit.svg", "coarse.svg"] {
        assert!(
            fs::read_to_string(out.join(chart))
                .unwrap()
                .trim_end()
                .ends_with("</svg>")
        );
    }
}

#[test]
fn an_image_that_is_none_is_refused() {
    for (image, words) in [
        ("nowhere.elf", "cargo xtask firmware"),
        ("Cargo.toml", "--firmware"),
    ] {
        let output = run(&["demo", "--firmware", image]);
        assert_eq!(output.status.code(), Some(1));
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains(words), "{said}");
    }
}

#[test]
fn a_scene_with_windings_runs_the_image_with_a_power_stage() {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let image = scenes.join("../target/firmware/emulated_drive.elf");
    let (scene, image) = (scenes.join("re35-brushed.toml"), image);
    let emulated = Emulated::start(&[
        "--scene",
        scene.to_str().unwrap(),
        "--firmware",
        image.to_str().unwrap(),
    ]);
    let info = json(&["info", "--port", &emulated.port, "--json"]);
    assert!(info.to_string().contains("emulated_drive"), "{info}");
    // Nothing is known of its motor yet.
    let arm = knob()
        .args(["arm", "--port", &emulated.port])
        .output()
        .unwrap();
    assert!(!arm.status.success());
    assert_eq!(emulated.interrupt(), Some(130));
}

/// A scene whose motor is calibrated.
struct Calibrated {
    scene: &'static str,
    calibrate: &'static [&'static str],
    truth: &'static [(&'static str, f64)],
    pole_pairs: u32,
}

#[test]
fn the_motors_of_the_scenes_are_calibrated_and_armed() {
    let folder = TempDir::new().unwrap();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let image = scenes.join("../target/firmware/emulated_drive.elf");
    for Calibrated {
        scene,
        calibrate,
        truth,
        pole_pairs,
    } in [
        Calibrated {
            scene: "three-phase.toml",
            calibrate: &["--drive", "current", "--current-max", "8"],
            truth: &[
                ("resistance_ohm", 1.2),
                ("d_inductance_h", 4e-4),
                ("q_inductance_h", 5e-4),
                ("torque_constant_nm_a", 1.5 * 7.0 * 4e-3),
                ("measured_constant_nm_a", 1.5 * 7.0 * 4e-3),
            ],
            pole_pairs: 7,
        },
        Calibrated {
            scene: "re35-brushed.toml",
            calibrate: &["--drive", "brushed", "--current-max", "4"],
            truth: &[
                ("resistance_ohm", 2.0),
                ("d_inductance_h", 6e-4),
                ("torque_constant_nm_a", 0.052),
            ],
            pole_pairs: 1,
        },
    ] {
        let text = fs::read_to_string(scenes.join(scene)).unwrap();
        let free = folder.path().join(scene);
        // At rest and without a hand.
        let motor = text.split("[start]").next().unwrap();
        fs::write(&free, motor).unwrap();
        let counts_per_rev = motor
            .lines()
            .find(|line| line.starts_with("counts_per_rev"))
            .unwrap()
            .replace(' ', "");
        let record = free.with_extension("csv");
        let emulated = Emulated::start(&[
            "--scene",
            free.to_str().unwrap(),
            "--firmware",
            image.to_str().unwrap(),
            "--pace",
            "free",
            "--record",
            record.to_str().unwrap(),
        ]);
        let port = ["--port", &emulated.port, "--json"];
        let ask = |args: &[&str]| json(&[args, &port].concat());
        ask(&["set", &counts_per_rev]);
        let log = free.with_extension("log.csv");
        let log = ["--out", log.to_str().unwrap(), "--force"];
        let dry = ask(&[&["calibrate"], calibrate].concat());
        assert!(dry["applied_at_tick"].is_null());
        // It coasts to rest.
        ask(&[&["log", "--seconds", "2"], &log[..]].concat());
        assert!(!run(&[&["arm"], &port[..]].concat()).status.success());
        let found = ask(&[&["calibrate"], calibrate, &["--apply"]].concat());
        for (key, value) in truth {
            let (low, high) = (&found[key]["low"], &found[key]["high"]);
            let (low, high) = (low.as_f64().unwrap(), high.as_f64().unwrap());
            assert!(
                low <= *value && *value <= high && high - low < 0.2 * value,
                "{scene}: {key} is {value}: {found}"
            );
        }
        // The same after a whole turn: a scene's is 0.
        let zero = |end: &str| found["zero_turns"][end].as_f64().unwrap();
        let whole = zero("value").round();
        assert!(
            zero("low") <= whole && whole <= zero("high") && zero("high") - zero("low") < 0.02,
            "{scene}: {found}"
        );
        assert_eq!(found["pole_pairs"], pole_pairs, "{scene}");
        assert_eq!(found["reversed"], false, "{scene}");

        // It is armed without a save, and holds a spring about where it stands.
        ask(&["set", "law=ledger", "shape=spring", "stiffness_nm_rad=0.5"]);
        ask(&["arm"]);
        ask(&[&["log", "--seconds", "0.5"], &log[..]].concat());
        assert_eq!(ask(&["info"])["state"], "armed", "{scene}");
        ask(&["disarm"]);
        assert_eq!(emulated.interrupt(), Some(130));
    }
}
