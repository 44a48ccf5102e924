//! `knob identify` on a connected knob: the firmware itself, natively, with the exact plant behind it.
#![cfg(target_os = "linux")]

#[allow(dead_code, reason = "shared with tests that use more of it")]
mod native;

use std::f64::consts::TAU;
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::time::Duration;

use control::criterion::Device;
use native::{Fate, Port, board_at};
use plant_sim::drive::Drive;
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::knob::Knob;
use plant_sim::motor::Motor;
use plant_sim::preset::PRESETS;
use protocol::{FromDevice, Message};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde_json::Value;

/// Ticks in a millisecond: much faster than time passes.
const FAST: u32 = 64;

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

fn on(port: &Port, args: &[&str]) -> Command {
    knob(&[args, &["--port", &port.path]].concat())
}

/// Waits for the end. Not for ever: the limit is there to end a test that hangs.
fn end(mut child: Child) -> Output {
    for _ in 0..2400 {
        if child.try_wait().unwrap().is_some() {
            return child.wait_with_output().unwrap();
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    child.kill().unwrap();
    let output = child.wait_with_output().unwrap();
    panic!("hung: {}", String::from_utf8_lossy(&output.stderr));
}

fn run(port: &Port, args: &[&str]) -> Output {
    end(on(port, args).spawn().unwrap())
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Standard output as the one JSON object that it must be.
fn ask(port: &Port, args: &[&str]) -> Value {
    let output = run(port, &[args, &["--json"]].concat());
    assert!(output.status.success(), "{args:?}: {}", said(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// It failed with this status and these words, and the device is in this state.
fn refused(port: &Port, output: &Output, status: i32, parts: &[&str], state: &str) {
    let said = said(output);
    assert_eq!(output.status.code(), Some(status), "{said}");
    assert!(output.stdout.is_empty());
    for part in parts {
        assert!(said.contains(part), "`{part}` is missing in: {said}");
    }
    assert!(!said.contains("panicked"), "{said}");
    assert_eq!(ask(port, &["info"])["state"], state, "{said}");
}

/// A knob, and its encoder.
#[derive(Clone, Copy)]
struct Bench {
    device: Device<f64>,
    counts_per_rev: f64,
    period_s: f64,
    hand: Hand,
    /// Where in its count it starts.
    phase: f64,
}

impl Bench {
    fn preset(place: usize) -> Self {
        let known = &PRESETS[place];
        Self {
            device: known.device,
            counts_per_rev: known.counts_per_rev,
            period_s: known.period_s,
            hand: Hand::default(),
            phase: 0.5,
        }
    }

    fn knob(&self) -> Knob {
        let start = State {
            position: self.phase * TAU / self.counts_per_rev,
            velocity: 0.0,
        };
        let (motor, drive) = (Motor::default(), Drive::default());
        Knob::new(
            &self.device,
            &motor,
            &self.hand,
            &drive,
            self.period_s,
            start,
        )
        .unwrap()
    }

    /// What the counter reads after a torque was held.
    fn turned(self) -> impl FnMut(f32, f32) -> i32 + Send + 'static {
        let mut knob = self.knob();
        move |torque_nm, period_s| {
            let end = knob.hold(f64::from(torque_nm), f64::from(period_s)).end;
            (end.position * self.counts_per_rev / TAU).floor() as i32
        }
    }

    fn port(self) -> Port {
        board_at(FAST, self.turned(), |_| Fate::Arrives)
    }

    /// Tells the device of its encoder.
    fn set_up(&self, port: &Port, more: &[&str]) {
        let counts = format!("counts_per_rev={}", self.counts_per_rev);
        let period = format!("sample_period_s={}", self.period_s as f32);
        ask(port, &[&["set", &counts, &period], more].concat());
    }
}

/// Motors log-uniform around the presets.
fn random(number: u64) -> Bench {
    let mut random = Pcg64::seed_from_u64(number);
    let mut uniform = || (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
    let mut between = |low: f64, high: f64| low * (high / low).powf(uniform());
    Bench {
        device: Device {
            inertia_kg_m2: between(2e-6, 5e-5),
            viscous_nm_s_rad: between(1e-6, 1e-4),
            coulomb_nm: between(3e-4, 1.5e-2),
        },
        counts_per_rev: between(4096.0, 65_536.0).round(),
        period_s: between(2.5e-4, 1e-3),
        hand: Hand::default(),
        phase: uniform(),
    }
}

/// The truth lies between the ends; for inertia and Coulomb friction these are near.
fn finds(found: &Value, device: &Device<f64>) {
    for (key, truth) in [
        ("inertia_kg_m2", device.inertia_kg_m2),
        ("viscous_nm_s_rad", device.viscous_nm_s_rad),
        ("coulomb_nm", device.coulomb_nm),
    ] {
        let number = |end: &str| found[key][end].as_f64().unwrap();
        let (low, high) = (number("low"), number("high"));
        assert!(low <= truth && truth <= high, "{key} is {truth}: {found}");
        let wide = high - low > 0.2 * truth;
        assert!(!wide || key == "viscous_nm_s_rad", "{key}: {found}");
    }
    assert_eq!(found["misfit_counts"], 0.0, "{found}");
}

#[test]
fn presets_and_random_motors_are_found_through_the_device() {
    for number in 0..10 {
        let bench = match number {
            0..4 => Bench::preset(number),
            _ => random(number as u64),
        };
        let port = bench.port();
        bench.set_up(&port, &[]);
        let found = ask(&port, &["identify"]);
        finds(&found, &bench.device);
        assert_eq!(ask(&port, &["info"])["state"], "disarmed");
    }
}

/// The believed values are those that the governor uses from then on.
#[test]
fn apply_sets_what_was_found_and_out_writes_it() {
    let bench = random(77);
    let port = bench.port();
    bench.set_up(&port, &[]);
    let folder = tempfile::TempDir::new().unwrap();
    let out = folder.path().join("believed.toml");
    let found = ask(
        &port,
        &["identify", "--apply", "--out", out.to_str().unwrap()],
    );
    finds(&found, &bench.device);
    assert!(found["applied_at_tick"].as_u64().is_some());
    let device = ask(&port, &["get"]);
    let table: toml::Table = std::fs::read_to_string(out).unwrap().parse().unwrap();
    for key in ["inertia_kg_m2", "viscous_nm_s_rad", "coulomb_nm"] {
        let on_device = |place: usize| f64::from(device[key][place].as_f64().unwrap() as f32);
        let (low, high) = (
            found[key]["low"].as_f64().unwrap(),
            found[key]["high"].as_f64().unwrap(),
        );
        assert!(
            on_device(0) <= low && high <= on_device(1),
            "{key}: {device}"
        );
        assert_eq!(table["believed"][key][0].as_float(), Some(low));
    }
    // For a reader, without --apply: the command to do it.
    let text = run(&port, &["identify"]);
    let text = String::from_utf8(text.stdout).unwrap();
    for part in [
        "inertia, kg m²",
        "all counts are explained",
        "knob set inertia_kg_m2=",
    ] {
        assert!(text.contains(part), "`{part}` is missing in: {text}");
    }
}

/// Faster than the line, decimated, and late: for the time of the pushes it samples otherwise, and says so.
#[test]
fn a_sampling_that_does_not_suit_is_changed_for_the_time_of_the_pushes() {
    let bench = Bench {
        period_s: 1e-4,
        ..Bench::preset(2)
    };
    let port = bench.port();
    bench.set_up(
        &port,
        &["decimation=4", "delay_s=3e-5", "stiffness_nm_rad=1"],
    );
    let before = ask(&port, &["get"]);
    let output = run(&port, &["identify", "--json"]);
    assert!(output.status.success(), "{}", said(&output));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    finds(&found, &bench.device);
    let period_s = found["sample_period_s"].as_f64().unwrap();
    assert!((period_s - 5e-4).abs() < 1e-9, "{period_s}");
    assert!(
        said(&output).contains("sample_period_s=5e-4 decimation=1"),
        "{}",
        said(&output)
    );
    assert_eq!(ask(&port, &["get"]), before);
    // Also where it ends otherwise.
    let stuck = board_at(FAST, |_, _| 0, |_| Fate::Arrives);
    bench.set_up(&stuck, &["decimation=4"]);
    let before = ask(&stuck, &["get"]);
    let output = run(&stuck, &["identify"]);
    refused(&stuck, &output, 1, &["never moved"], "disarmed");
    assert_eq!(ask(&stuck, &["get"]), before);
}

#[test]
fn a_device_that_cannot_push_now_says_why() {
    let port = Bench::preset(0).port();
    ask(&port, &["arm"]);
    let output = run(&port, &["identify"]);
    refused(
        &port,
        &output,
        1,
        &["cannot push", "is armed", "knob disarm"],
        "armed",
    );
    ask(&port, &["disarm"]);
    let output = run(&port, &["identify", "--torque-max", "0.6"]);
    refused(
        &port,
        &output,
        1,
        &["torque_max_nm=0.5", "--torque-max"],
        "disarmed",
    );
    ask(&port, &["set", "torque_max_nm=0"]);
    let output = run(&port, &["identify"]);
    refused(&port, &output, 1, &["torque_max_nm=0"], "disarmed");
    ask(&port, &["set", "torque_max_nm=0.5", "speed_max_rad_s=20"]);
    let output = run(&port, &["identify", "--speed-max", "21"]);
    refused(
        &port,
        &output,
        1,
        &["--speed-max", "speed_max_rad_s=20"],
        "disarmed",
    );
    // Counts per turn that cannot be.
    ask(&port, &["set", "torque_max_nm=0.5", "counts_per_rev=4"]);
    let output = run(&port, &["identify"]);
    let parts = [
        &port.path,
        "counts_per_rev=4",
        "only 6 counts",
        "200 or more",
    ];
    refused(&port, &output, 1, &parts, "disarmed");
    // In fault.
    let (port, hand) = native::board();
    ask(&port, &["arm"]);
    hand.jump.store(99_999, Relaxed);
    while ask(&port, &["info"])["state"] != "fault" {}
    let output = run(&port, &["identify"]);
    refused(
        &port,
        &output,
        1,
        &["cannot push", "99999 counts", "knob clear"],
        "fault",
    );
}

#[test]
fn counts_that_are_far_too_many_are_pointed_at() {
    let bench = Bench::preset(0);
    let port = bench.port();
    ask(&port, &["set", "counts_per_rev=262144"]);
    // Said to be 32 times as fine as it is, it turns 32 times as far.
    let args = ["identify", "--angle-max", "0.3", "--speed-max", "1.5"];
    let output = run(&port, &args);
    assert!(output.status.success(), "{}", said(&output));
    let told = said(&output);
    assert!(
        told.contains("counts_per_rev=262144") && told.contains("believed an inertia"),
        "{told}"
    );
}

/// Hands, and knobs that are none.
#[test]
fn what_is_no_free_knob_is_refused_with_the_reason() {
    let refuses = |what: &str,
                   turned: Box<dyn FnMut(f32, f32) -> i32 + Send>,
                   parts: &[&str],
                   state: &str| {
        let port = board_at(FAST, turned, |_| Fate::Arrives);
        let output = run(&port, &["identify", "--apply"]);
        println!("{what}: {}", said(&output).lines().last().unwrap());
        refused(
            &port,
            &output,
            1,
            &[&[port.path.as_str()][..], parts].concat(),
            state,
        );
    };
    let bench = Bench::preset(0);
    refuses(
        "held fast",
        Box::new(|_, _| 7),
        &[
            "never moved",
            "0.200 Nm",
            "stuck or held",
            "encoder unplugged",
        ],
        "disarmed",
    );
    let hand = |hand: Hand| Box::new(Bench { hand, ..bench }.turned());
    let pushes = Hand {
        push_nm: 4e-4,
        ..Hand::default()
    };
    refuses(
        "pushed",
        hand(pushes),
        &["constant torque", "a hand pushes it"],
        "disarmed",
    );
    let shakes = Hand {
        shake_nm: 1e-3,
        shake_hz: 5.0,
        ..Hand::default()
    };
    refuses("shaken", hand(shakes), &["a hand on the knob"], "disarmed");
    let mut turned = bench.turned();
    let reversed = move |torque_nm: f32, period_s: f32| turned(-torque_nm, period_s);
    refuses(
        "reversed",
        Box::new(reversed),
        &["moves against the torque", "reversed"],
        "disarmed",
    );
    let mut ticks = 0;
    let turning = move |_, _| {
        ticks += 1;
        ticks / 10
    };
    refuses(
        "turned all the time",
        Box::new(turning),
        &["begins in motion"],
        "disarmed",
    );
    // Turned by 40 counts while nothing is pushed, later on.
    let (mut turned, mut still, mut pushes, mut shift) = (bench.turned(), true, 0, 0);
    let between = move |torque_nm: f32, period_s: f32| {
        pushes += i32::from(still && torque_nm != 0.0);
        still = torque_nm == 0.0;
        shift = (shift + i32::from(pushes > 12)).min(40);
        turned(torque_nm, period_s) + shift
    };
    refuses(
        "turned now and then",
        Box::new(between),
        &["hand"],
        "disarmed",
    );
    // Something runs away with it.
    let (mut turned, mut pushes, mut count) = (bench.turned(), 0, 0);
    let wild = move |torque_nm: f32, period_s: f32| {
        pushes += i32::from(torque_nm != 0.0);
        count += if pushes > 1000 { 100 } else { 0 };
        turned(torque_nm, period_s) + count
    };
    refuses(
        "run away",
        Box::new(wild),
        &[
            "fault ended the push",
            "further than it may",
            "--angle-max",
            "knob clear",
        ],
        "fault",
    );
}

/// Damaged and lost messages are seen, and the push is played once more.
#[test]
fn a_line_that_loses_messages_costs_pushes_but_no_truth() {
    let bench = random(5);
    let mut told = 0;
    let line = move |said: &FromDevice<'_>| match said.message {
        Message::Moves(_) => {
            told += 1;
            match told % 23 {
                5 => Fate::Vanishes,
                17 => Fate::IsDamaged,
                _ => Fate::Arrives,
            }
        }
        _ => Fate::Arrives,
    };
    let port = board_at(FAST, bench.turned(), line);
    bench.set_up(&port, &[]);
    finds(&ask(&port, &["identify"]), &bench.device);
    // All of them.
    let line = |said: &FromDevice<'_>| match said.message {
        Message::Moves(_) => Fate::IsDamaged,
        _ => Fate::Arrives,
    };
    let port = board_at(FAST, bench.turned(), line);
    let output = run(&port, &["identify"]);
    refused(
        &port,
        &output,
        1,
        &["messages were lost in 3 pushes", "check the cable"],
        "disarmed",
    );
}

/// The first answer to each push is lost: it is asked for again, and played once.
#[test]
fn a_push_whose_answer_is_lost_is_played_once() {
    let bench = Bench::preset(0);
    let pushes = Arc::new(AtomicU32::new(0));
    let count = |pushes: &Arc<AtomicU32>| {
        let (mut turned, mut still, pushes) = (bench.turned(), true, Arc::clone(pushes));
        move |torque_nm: f32, period_s: f32| {
            pushes.fetch_add(u32::from(still && torque_nm != 0.0), Relaxed);
            still = torque_nm == 0.0;
            turned(torque_nm, period_s)
        }
    };
    let port = board_at(FAST, count(&pushes), |_| Fate::Arrives);
    bench.set_up(&port, &[]);
    let found = ask(&port, &["identify"]);
    let once = pushes.swap(0, Relaxed);
    let mut last = None;
    let line = move |said: &FromDevice<'_>| match said.message {
        Message::Done { .. } if last.replace(said.sequence) != Some(said.sequence) => {
            Fate::Vanishes
        }
        _ => Fate::Arrives,
    };
    let port = board_at(FAST, count(&pushes), line);
    let again = ask(&port, &["identify"]);
    assert_eq!(pushes.load(Relaxed), once);
    assert_eq!(again["samples"], found["samples"]);
    finds(&again, &bench.device);
}

/// A device at the pace of time, and whether it is being pushed.
fn slow() -> (Port, Arc<AtomicBool>) {
    let pushed = Arc::new(AtomicBool::new(false));
    let (mut turned, seen) = (Bench::preset(0).turned(), Arc::clone(&pushed));
    let watched = move |torque_nm: f32, period_s: f32| {
        seen.store(torque_nm != 0.0, Relaxed);
        turned(torque_nm, period_s)
    };
    (board_at(1, watched, |_| Fate::Arrives), pushed)
}

fn wait_for_torque(pushed: &AtomicBool) {
    while !pushed.load(Relaxed) {
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn ctrl_c_in_a_push_disarms_and_puts_back() {
    let (port, pushed) = slow();
    ask(&port, &["set", "decimation=2"]);
    let before = ask(&port, &["get"]);
    let child = on(&port, &["identify", "--out", "/tmp/never-written.toml"])
        .spawn()
        .unwrap();
    wait_for_torque(&pushed);
    let kill = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(kill.unwrap().success());
    let output = end(child);
    refused(&port, &output, 130, &["stopped"], "disarmed");
    assert!(!pushed.load(Relaxed));
    assert!(!std::path::Path::new("/tmp/never-written.toml").exists());
    assert_eq!(ask(&port, &["get"]), before);
}

#[test]
fn a_cable_that_is_pulled_in_a_push_is_told() {
    let (port, pushed) = slow();
    let child = on(&port, &["identify"]).spawn().unwrap();
    wait_for_torque(&pushed);
    drop(port);
    let output = end(child);
    let told = said(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(
        told.contains("lost the device") && told.contains("unplugged"),
        "{told}"
    );
}

/// A host that is gone leaves no torque behind: the push ends by itself.
#[test]
fn a_host_that_is_killed_leaves_no_torque() {
    let (port, pushed) = slow();
    let mut child = on(&port, &["identify"]).spawn().unwrap();
    wait_for_torque(&pushed);
    child.kill().unwrap();
    child.wait().unwrap();
    while ask(&port, &["info"])["state"] != "disarmed" {}
    assert!(!pushed.load(Relaxed));
}
