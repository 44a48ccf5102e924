//! `knob monitor` on a terminal that is none, against the firmware itself.
#![cfg(target_os = "linux")]

#[allow(dead_code, reason = "shared with tests that use more of it")]
mod native;
mod screen;

use std::process::{Command, Output, Stdio};
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use native::{Fate, Port, board, board_with};
use protocol::Message;
use screen::Terminal;
use serde_json::Value;

fn knob(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_knob"));
    command
        .args(args)
        .env_remove("KNOB_PORT")
        .stdin(Stdio::null());
    command.output().unwrap()
}

/// A monitor that has drawn its first row.
fn monitor(port: &Port) -> Terminal {
    let mut terminal = Terminal::run(&["monitor", "--port", &port.path]);
    terminal.until("angle, rad, the last 10 s");
    terminal.until("count ");
    terminal
}

/// Nothing more comes from the device.
fn is_silent(port: &Port, hand: &native::Hand) {
    let sent = hand.telemetry.load(Relaxed);
    // Ten rows would come in this time.
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(hand.telemetry.load(Relaxed), sent);
    assert!(knob(&["info", "--port", &port.path]).status.success());
}

#[test]
fn it_shows_what_is_and_obeys_keys() {
    let (port, hand) = board();
    let set = [
        "set",
        "stiffness_nm_rad=100",
        "torque_max_nm=10",
        "--port",
        &port.path,
    ];
    assert!(knob(&set).status.success());
    let mut terminal = monitor(&port);
    for part in [
        "knob on /dev/pts/",
        "native, firmware 1.2.3",
        "disarmed",
        "q quit",
        "of 100 Nm/rad",
    ] {
        terminal.until(part);
    }
    terminal.keys("a");
    terminal.until("armed from tick");
    terminal.until("state      armed");
    hand.speed.store(1, Relaxed);
    terminal.until("law        ledger");
    hand.speed.store(0, Relaxed);
    terminal.keys("d");
    terminal.until("state      disarmed");
    terminal.keys("c");
    terminal.until("nothing cleared: the device is disarmed");
    terminal.keys("a");
    terminal.until("state      armed");
    hand.jump.store(50_000, Relaxed);
    terminal.until("in fault: the encoder moved 50000 counts");
    terminal.until("fault: the encoder");
    terminal.keys("a");
    terminal.until("not armed: the device is in fault");
    terminal.keys("c");
    terminal.until("cleared from tick");
    // Others mean nothing.
    terminal.keys("xyz");
    terminal.keys("q");
    let (status, said) = terminal.end();
    assert_eq!(status.code(), Some(0), "{said}");
    assert_eq!(said, "");
    is_silent(&port, &hand);
}

#[test]
fn a_knob_that_is_left_armed_is_told() {
    let (port, _) = board();
    let mut terminal = monitor(&port);
    terminal.keys("a");
    terminal.until("state      armed");
    // Escape, too, quits.
    terminal.keys("\x1b");
    let (status, said) = terminal.end();
    assert_eq!(status.code(), Some(0), "{said}");
    assert!(
        said.contains("stays armed") && said.contains("knob disarm"),
        "{said}"
    );
    let info = knob(&["info", "--json", "--port", &port.path]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["state"], "armed");
}

#[test]
fn ctrl_c_and_a_signal_end_it_with_the_terminal_as_it_was() {
    let (port, hand) = board();
    let terminal = monitor(&port);
    terminal.keys("\x03");
    let (status, said) = terminal.end();
    assert_eq!(status.code(), Some(130), "{said}");
    assert!(said.contains("ended"), "{said}");
    is_silent(&port, &hand);

    let terminal = monitor(&port);
    terminal.signal("TERM");
    let (status, said) = terminal.end();
    assert_eq!(status.code(), Some(130), "{said}");
    is_silent(&port, &hand);
}

#[test]
fn a_second_ctrl_c_gives_the_terminal_back_too() {
    // It stops answering, so that the end takes its time.
    let mut rows = 0;
    let (port, _) = board_with(move |said| match said.message {
        Message::Telemetry(_) => {
            rows += 1;
            Fate::Arrives
        }
        _ if rows > 20 => Fate::Vanishes,
        _ => Fate::Arrives,
    });
    let terminal = monitor(&port);
    std::thread::sleep(Duration::from_millis(600));
    terminal.keys("\x03");
    std::thread::sleep(Duration::from_millis(100));
    terminal.keys("\x03");
    let (status, said) = terminal.end();
    assert_eq!(status.code(), Some(130), "{said}");
}

#[test]
fn a_knob_that_is_unplugged_is_told_with_the_terminal_as_it_was() {
    let (port, _) = board();
    let terminal = monitor(&port);
    let path = port.path.clone();
    drop(port);
    let (status, said) = terminal.end();
    assert_eq!(status.code(), Some(1), "{said}");
    for part in [path.as_str(), "lost the device", "unplugged", "knob ports"] {
        assert!(said.contains(part), "`{part}` is missing in: {said}");
    }
}

#[test]
fn a_knob_that_falls_silent_is_told_apart_from_one_that_is_gone() {
    // It goes on answering, but sends nothing more.
    let mut rows = 0;
    let (port, _) = board_with(move |said| match said.message {
        Message::Telemetry(_) if rows == 5 => Fate::Vanishes,
        Message::Telemetry(_) => {
            rows += 1;
            Fate::Arrives
        }
        _ => Fate::Arrives,
    });
    let mut terminal = monitor(&port);
    terminal.until("sends no telemetry; reset it");
    terminal.keys("q");
    assert_eq!(terminal.end().0.code(), Some(0));
    // It does not answer either.
    let mut all = 0;
    let (port, _) = board_with(move |_| {
        all += 1;
        if all > 12 {
            Fate::Vanishes
        } else {
            Fate::Arrives
        }
    });
    let terminal = monitor(&port);
    let (status, said) = terminal.end();
    assert_eq!(status.code(), Some(1), "{said}");
    assert!(said.contains("`status` was not answered"), "{said}");
}

#[test]
fn a_quarter_of_the_line_is_enough() {
    let (port, hand) = board();
    let tick = || {
        let info = knob(&["info", "--json", "--port", &port.path]);
        let info: Value = serde_json::from_slice(&info.stdout).unwrap();
        info["tick"].as_u64().unwrap()
    };
    let before = tick();
    let terminal = monitor(&port);
    while hand.telemetry.load(Relaxed) < 60 {
        std::thread::sleep(Duration::from_millis(5));
    }
    terminal.keys("q");
    assert_eq!(terminal.end().0.code(), Some(0));
    // One row in 20 ms of the device's time, and none before or after.
    let rows = u64::from(hand.telemetry.load(Relaxed));
    assert!(20 * (rows - 1) <= tick() - before, "{rows} rows");
}

#[test]
fn without_a_terminal_it_refuses_and_says_what_to_use() {
    let (port, hand) = board();
    let output = knob(&["monitor", "--port", &port.path]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(output.stdout.is_empty());
    for part in ["not a terminal", "knob log", "knob monitor --json"] {
        assert!(said.contains(part), "`{part}` is missing in: {said}");
    }
    assert_eq!(hand.telemetry.load(Relaxed), 0);
}

#[test]
fn json_is_one_object_of_what_is_now() {
    let (port, hand) = board();
    let set = [
        "set",
        "stiffness_nm_rad=100",
        "decimation=2",
        "--port",
        &port.path,
    ];
    assert!(knob(&set).status.success());
    assert!(knob(&["arm", "--port", &port.path]).status.success());
    hand.speed.store(1, Relaxed);
    std::thread::sleep(Duration::from_millis(50));
    hand.speed.store(0, Relaxed);
    let output = knob(&["monitor", "--json", "--port", &port.path]);
    assert!(output.status.success());
    let now: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (&now["state"], &now["fault"]),
        (&"armed".into(), &Value::Null)
    );
    assert_eq!(now["demanded_nm_rad"], 100.0);
    assert_eq!(
        (&now["law"], &now["dropped"]),
        (&"ledger".into(), &0.into())
    );
    let (count, angle) = (
        now["count"].as_f64().unwrap(),
        now["angle_rad"].as_f64().unwrap(),
    );
    assert!(count > 10.0);
    // 8192 counts a turn, two of them one count.
    let expected = (count + 0.5) * std::f64::consts::TAU * 2.0 / 8192.0;
    assert!((angle - expected).abs() < 1e-12, "{now}");
    for key in [
        "tick",
        "torque_nm",
        "stiffness_nm_rad",
        "margin_nm",
        "account_j",
    ] {
        assert!(now[key].is_number(), "{key}: {now}");
    }
    assert!(now["reason_text"].as_str().unwrap().len() > now["reason"].as_str().unwrap().len());
    is_silent(&port, &hand);
    // Where nothing comes.
    let (port, _) = board_with(|said| match said.message {
        Message::Telemetry(_) => Fate::Vanishes,
        _ => Fate::Arrives,
    });
    let output = knob(&["monitor", "--json", "--port", &port.path]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        output.stdout.is_empty() && said.contains("sends no telemetry"),
        "{said}"
    );
}

#[test]
fn help_has_an_example_and_the_keys() {
    let text = String::from_utf8(knob(&["monitor", "--help"]).stdout).unwrap();
    for part in [
        "Example",
        "knob monitor",
        "--json",
        "KNOB_PORT",
        "a arms",
        "stays armed",
    ] {
        assert!(text.contains(part), "`{part}` is missing in: {text}");
    }
}
