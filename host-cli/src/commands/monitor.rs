//! `knob monitor`: what the knob does now, on a screen.

mod draw;
mod view;

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use protocol::{Event, Fields, Parameters, Request, State, Subscription};
use ratatui::crossterm::event::{
    self, Event as Input, KeyCode, KeyEvent, KeyEventKind, KeyModifiers,
};
use serde::Serialize;

use crate::device::{Device, Identity, Outcome, Unasked};
use crate::output::say_line;
use crate::parameters;
use crate::ports::Connection;
use crate::stop::{Ended, Stopped, Usage};
use crate::terminal::Screen;
use crate::words;
use view::View;

/// Watch the knob in the terminal: angle, torque, stiffness, margin, law, and why it is no stiffer.
///
/// Keys: a arms, d disarms, c clears a fault, q quits. Quitting changes nothing on the device: a knob that is
/// armed stays armed. About 50 ticks a second are shown, so that the slowest line carries them; `knob log` records every
/// one. With --json nothing is drawn: one object tells what the screen would show now.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  knob monitor\n  knob monitor --json")]
pub struct Args {
    #[command(flatten)]
    connection: Connection,
}

/// From one row of telemetry to the next, about, s. A row takes at most 60 bytes: a quarter of 115,200 baud.
const SHOWN_EVERY_S: f64 = 0.02;
/// From one drawing to the next.
const DRAWN_EVERY: Duration = Duration::from_millis(50);
/// After so long without telemetry the device is asked how it is.
const SILENCE: Duration = Duration::from_secs(2);

pub fn run(args: &Args) -> Result<()> {
    if !args.connection.json && !std::io::stdout().is_terminal() {
        let text = "standard output is not a terminal, so there is no screen to draw on; \
                    `knob log` writes a file, `knob monitor --json` prints what is now";
        return Err(Usage(text.into()).into());
    }
    let (mut device, identity) = args.connection.connect()?;
    let parameters = device.parameters()?;
    let status = device.status()?;
    let mut view = View::new(title(device.path(), &identity), &parameters, &status);
    let damaged = device.damaged();
    device.subscribe(Subscription {
        every_ticks: every_ticks(&parameters),
        fields: Fields::ALL,
        clamp_events: false,
    })?;
    if args.connection.json {
        let shown = first(&mut device, &mut view);
        let hushed = device.hush();
        shown.and(hushed)?;
        say_line!("{}", serde_json::to_string(&Json::new(&view))?);
        return Ok(());
    }
    // Given back before anything is said.
    let mut screen = Screen::take().context("the terminal cannot be made a screen")?;
    let shown = show(&mut screen, &mut device, &identity, &mut view, damaged);
    let hushed = device.hush();
    drop(screen);
    match shown {
        Err(error) if error.is::<Stopped>() => return Err(Ended.into()),
        other => other?,
    }
    hushed?;
    if view.state == State::Armed {
        eprintln!("the knob stays armed; `knob disarm` ends that");
    }
    Ok(())
}

fn title(path: &str, identity: &Identity) -> String {
    format!(
        "knob on {path}, {}, firmware {} ({})",
        identity.board, identity.firmware, identity.git_hash
    )
}

/// How many ticks from one row to the next.
fn every_ticks(parameters: &Parameters) -> u16 {
    let ticks = SHOWN_EVERY_S / f64::from(parameters.sample_period_s);
    // Saturates; a period that is no number cannot come from a device.
    ticks.round().max(1.0) as u16
}

/// Waits for one row.
fn first(device: &mut Device, view: &mut View) -> Result<()> {
    while let Some((number, message)) = device.unasked(SILENCE)? {
        take(view, number, &message);
        if view.latest.is_some() {
            return Ok(());
        }
    }
    let why = quiet(device)?;
    bail!("port {}: {why}", device.path())
}

/// Draws until the user quits.
fn show(
    screen: &mut Screen,
    device: &mut Device,
    identity: &Identity,
    view: &mut View,
    damaged: u64,
) -> Result<()> {
    let mut heard = Instant::now();
    loop {
        view.damaged = device.damaged() - damaged;
        screen
            .0
            .draw(|frame| draw::draw(frame, view))
            .context("the terminal is lost")?;
        let next = Instant::now() + DRAWN_EVERY;
        while let Some(left) = next.checked_duration_since(Instant::now()) {
            if let Some((number, message)) = device.unasked(left)? {
                take(view, number, &message);
                heard = Instant::now();
            }
        }
        while event::poll(Duration::ZERO).context("the keys cannot be read")? {
            let input = event::read().context("the keys cannot be read")?;
            let Some(key) = pressed(&input) else { continue };
            match key {
                Key::Quit => return Ok(()),
                Key::Order(request) => order(device, identity, view, request)?,
            }
            // What came meanwhile is on its way.
            heard = Instant::now();
        }
        if heard.elapsed() > SILENCE {
            view.notice = quiet(device)?;
            heard = Instant::now();
        }
    }
}

/// What a key is for.
enum Key {
    Quit,
    Order(Request),
}

fn pressed(input: &Input) -> Option<Key> {
    let Input::Key(KeyEvent {
        code,
        modifiers: KeyModifiers::NONE,
        kind: KeyEventKind::Press,
        ..
    }) = input
    else {
        return None;
    };
    match code {
        KeyCode::Char('q') | KeyCode::Esc => Some(Key::Quit),
        KeyCode::Char('a') => Some(Key::Order(Request::Arm)),
        KeyCode::Char('d') => Some(Key::Order(Request::Disarm)),
        KeyCode::Char('c') => Some(Key::Order(Request::Clear)),
        _ => None,
    }
}

fn order(
    device: &mut Device,
    identity: &Identity,
    view: &mut View,
    request: Request,
) -> Result<()> {
    let (done, not_done) = match request {
        Request::Arm => ("armed", "not armed"),
        Request::Disarm => ("disarmed", "not disarmed"),
        _ => ("cleared", "nothing cleared"),
    };
    view.notice = match device.order(request)? {
        Outcome::Done { tick } => format!("{done} from tick {tick}"),
        Outcome::Refused(refusal) => {
            format!(
                "{not_done}: {}",
                words::refusal(&refusal, &identity.board, None)
            )
        }
    };
    Ok(())
}

fn take(view: &mut View, number: u16, message: &Unasked) {
    view.number(number);
    match *message {
        Unasked::Telemetry(telemetry) => view.telemetry(telemetry),
        Unasked::Event(Event::Fault { tick, fault }) => {
            view.state = State::Fault(fault);
            view.notice = format!("tick {tick}: fault: {}", words::fault(fault));
        }
        Unasked::Event(Event::Dropped { total }) => view.dropped = total,
        // Not subscribed to, or of a push or a calibration that another host began.
        Unasked::Moves(_)
        | Unasked::Event(
            Event::Clamp { .. }
            | Event::Calibrating { .. }
            | Event::Measured { .. }
            | Event::Calibrated { .. },
        ) => {}
    }
}

/// What to say of a device that sends nothing, if it answers at all.
fn quiet(device: &mut Device) -> Result<String> {
    let tick = device.status()?.tick;
    Ok(format!(
        "the device answers in tick {tick}, but sends no telemetry; reset it"
    ))
}

/// What the screen would show.
#[derive(Serialize)]
struct Json {
    state: &'static str,
    fault: Option<&'static str>,
    fault_text: Option<String>,
    tick: Option<u32>,
    count: Option<i32>,
    angle_rad: Option<f64>,
    torque_nm: Option<f32>,
    stiffness_nm_rad: Option<f32>,
    demanded_nm_rad: Option<f32>,
    margin_nm: Option<f32>,
    reason: Option<&'static str>,
    reason_text: Option<&'static str>,
    law: Option<&'static str>,
    account_j: Option<f32>,
    /// Messages that found no room in the device since its start.
    dropped: u32,
}

impl Json {
    fn new(view: &View) -> Self {
        let fault = match view.state {
            State::Fault(fault) => Some(fault),
            State::Disarmed | State::Armed | State::Calibrating | State::Pushing => None,
        };
        let row = view.latest;
        let reason = row.and_then(|row| row.reason);
        Self {
            state: words::state(view.state),
            fault: fault.map(words::fault_code),
            fault_text: fault.map(words::fault),
            tick: row.map(|row| row.tick),
            count: row.and_then(|row| row.count),
            angle_rad: row
                .and_then(|row| row.count)
                .map(|count| view.angle_rad(count)),
            torque_nm: row.and_then(|row| row.torque_nm),
            stiffness_nm_rad: row.and_then(|row| row.stiffness_nm_rad),
            demanded_nm_rad: row.and_then(|row| row.demanded_nm_rad),
            margin_nm: row.and_then(|row| row.margin_nm),
            reason: reason.map(words::clamp_code),
            reason_text: reason.map(words::clamp),
            law: row.and_then(|row| row.law).map(parameters::law),
            account_j: row.and_then(|row| row.account_j),
            dropped: view.dropped,
        }
    }
}

#[cfg(test)]
mod tests {
    use protocol::{ClampReason, FRAME_MAX, Fault, FromDevice, Law, Message, Telemetry, encode};

    use super::*;

    #[test]
    fn the_longest_rows_take_a_third_of_the_slowest_line() {
        let longest = Telemetry {
            tick: u32::MAX,
            state: State::Fault(Fault::EncoderJump { counts: i32::MIN }),
            count: Some(i32::MIN),
            torque_nm: Some(f32::MAX),
            stiffness_nm_rad: Some(f32::MAX),
            demanded_nm_rad: Some(f32::MAX),
            margin_nm: Some(f32::MAX),
            reason: Some(ClampReason::Hand),
            law: Some(Law::Auto),
            account_j: Some(f32::MAX),
        };
        let (sequence, message) = (u16::MAX, Message::Telemetry(longest));
        let mut buffer = [0; FRAME_MAX];
        let frame = encode(&FromDevice { sequence, message }, &mut buffer).unwrap();
        // Ten bits a byte.
        let bits_per_s = 10.0 * frame.len() as f64 / SHOWN_EVERY_S;
        assert!(bits_per_s < 115_200.0 / 3.0, "{bits_per_s}");
    }

    #[test]
    fn rows_come_about_every_20_ms() {
        for (period_s, ticks) in [
            (1e-3, 20),
            (1.0 / 24e3, 480),
            (4e-5, 500),
            (0.02, 1),
            (0.05, 1),
        ] {
            let parameters = Parameters {
                sample_period_s: period_s as f32,
                ..view::tests::PARAMETERS
            };
            assert_eq!(every_ticks(&parameters), ticks, "{period_s}");
        }
    }

    #[test]
    fn a_key_counts_when_it_is_pressed_alone() {
        let key = |code, kind| Input::Key(KeyEvent::new_with_kind(code, KeyModifiers::NONE, kind));
        let a = KeyCode::Char('a');
        assert!(matches!(
            pressed(&key(a, KeyEventKind::Press)),
            Some(Key::Order(Request::Arm))
        ));
        assert!(pressed(&key(a, KeyEventKind::Release)).is_none());
        assert!(pressed(&key(KeyCode::Char('b'), KeyEventKind::Press)).is_none());
        assert!(pressed(&Input::Resize(3, 3)).is_none());
        // Not what else a key may mean: Ctrl-A is no order.
        for modifiers in [KeyModifiers::CONTROL, KeyModifiers::ALT] {
            assert!(pressed(&Input::Key(KeyEvent::new(a, modifiers))).is_none());
        }
    }
}
