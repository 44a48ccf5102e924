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
