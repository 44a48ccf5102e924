//! The experiment on a connected knob: push after push, each played by the device itself.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use indicatif::ProgressBar;
use plant_sim::identify::Recording;
use plant_sim::identify::experiment::{Experiment, Limits, Played, STEPS, Stage};
use protocol::{Changes, Event, Fault, Parameters, PushEnd, Refusal, Request, State};

use crate::commands::set;
use crate::device::{Device, Identity, Moved, Outcome, Unasked};
use crate::number::digits;
use crate::parameters::short;
use crate::{progress, words};

/// The shortest sample period that is pushed with, s: at 115,200 baud the line carries twice as many ticks, and the delay
/// of a power stage, 1/24 ms, is less than a tenth of it.
const SHORTEST_PERIOD_S: f32 = 500e-6;

/// What is late is to be late by this share of a period at most; more is not explained.
const MOST_DELAY: f32 = 0.1;

/// Ticks in a message.
const TICKS: f64 = (protocol::MOVES_MAX / 2) as f64;

/// After so long without a message that was due the device is asked how it is.
const SILENCE: Duration = Duration::from_secs(2);

/// So often a push is played that the line does not carry whole.
const TRIES: u32 = 3;

/// Plays the experiment. Whatever happens, the device is disarmed afterwards, and samples as it did before.
pub fn record(
    device: &mut Device,
    identity: &Identity,
    limits: Limits,
    before: &Parameters,
) -> Result<Recording> {
    match device.status()?.state {
        State::Disarmed => {}
        State::Armed => bail!("cannot push: the device is armed; `knob disarm` first"),
        state => bail!("cannot push: the device is {}", words::state_in_full(state)),
    }
    let changes = sampling(before);
    if changes == Changes::default() {
        return play_all(device, identity, limits).inspect_err(|_| disarm(device));
    }
    eprintln!(
        "for the time of the pushes: sample_period_s={} decimation=1",
        digits(f64::from(before.with(&changes).sample_period_s), 4)
    );
    let played = set::order(device, identity, &changes)
        .and_then(|_| play_all(device, identity, limits))
        .inspect_err(|_| disarm(device));
    let back = Changes {
        sample_period_s: Some(before.sample_period_s),
        decimation: Some(before.decimation),
        ..Changes::default()
    };
    let is_back = device.order_to_the_end(Request::Set(back));
    if !matches!(is_back, Ok(Outcome::Done { .. })) {
        eprintln!(
            "could not put back sample_period_s={} decimation={}; see `knob get`",
            short(before.sample_period_s),
            before.decimation
        );
    }
    played
}

/// How it has to sample for a good recording that the line carries, where it does not yet: every count, and a period that
/// is a multiple of its own.
fn sampling(before: &Parameters) -> Changes {
    let late_s = before.delay_s + before.amplifier_tau_s;
    let least_s = SHORTEST_PERIOD_S.max(late_s / MOST_DELAY);
    // What rounding leaves of a multiple is none.
    let times = (0.9999 * least_s / before.sample_period_s).ceil().max(1.0);
    Changes {
        sample_period_s: (times > 1.0).then_some(times * before.sample_period_s),
        decimation: (before.decimation != 1).then_some(1),
        ..Changes::default()
    }
}

/// Breaks off what it is doing, after Ctrl-C too. A device that is in fault, or gone, has ended the push by itself.
fn disarm(device: &mut Device) {
    let _ = device.order_to_the_end(Request::Disarm);
}

fn play_all(device: &mut Device, identity: &Identity, limits: Limits) -> Result<Recording> {
    let parameters = device.parameters()?;
    let period_s = f64::from(parameters.sample_period_s);
    let count_rad = std::f64::consts::TAU * f64::from(parameters.decimation)
        / f64::from(parameters.counts_per_rev);
    let path = device.path().to_owned();
    let mut experiment = Experiment::new(limits, period_s, count_rad)
        .with_context(|| format!("port {path}: counts_per_rev={}", parameters.counts_per_rev))?;
    let bar = progress::bar(STEPS as u64 + 3, "");
    let (mut pushes, mut tries) = (0, 0);
    while let Some(push) = experiment.push() {
        show(&bar, experiment.stage(), pushes);
        let sent = protocol::Push {
            from_nm: push.from_nm,
            to_nm: push.to_nm,
            rise_ticks: push.rise_ticks,
            most_ticks: push.most_ticks,
            way_counts: push.way_counts,
            speed_counts: push.speed_counts,
            rest_ticks: push.rest_ticks,
            coast_ticks: push.coast_ticks,
            guard_counts: push.guard_counts,
        };
        match play(device, identity, sent, period_s)? {
            Heard::Whole(played) => {
                (pushes, tries) = (pushes + 1, 0);
                let taken = experiment.take(&push, &played);
                taken.with_context(|| format!("port {path}"))?;
            }
            Heard::Holes { count } => {
                tries += 1;
                if tries == TRIES {
                    bail!(
                        "port {path}: messages were lost in {TRIES} pushes in a row ({} frames came damaged); \
                         check the cable",
                        device.damaged()
                    );
                }
                experiment.forget(count);
            }
        }
    }
    bar.finish_and_clear();
    Ok(experiment.into_recording())
}

fn show(bar: &ProgressBar, stage: Stage, pushes: u32) {
    let (done, what) = match stage {
        Stage::Rest => (0, "waiting for rest".to_owned()),
        Stage::BreakAway { upwards: true } => (1, "torque that moves it, upwards".to_owned()),
        Stage::BreakAway { upwards: false } => (2, "torque that moves it, downwards".to_owned()),
        Stage::Step { number } => (2 + number as u64, format!("step {number} of {STEPS}")),
        Stage::Over => (3 + STEPS as u64, String::new()),
    };
    bar.set_position(done);
    bar.set_message(format!("{what} ({pushes} pushes done)"));
}

/// What came of a push.
enum Heard {
    Whole(Played),
    /// A message of it was lost; the knob is near this count.
    Holes {
        count: i32,
    },
}

/// One push.
fn play(
    device: &mut Device,
    identity: &Identity,
    push: protocol::Push,
    period_s: f64,
) -> Result<Heard> {
    device.forget_unasked();
    if let Outcome::Refused(refusal) = device.order(Request::Push(push))? {
        let path = device.path();
        match refusal {
            Refusal::State(State::Disarmed) => {
                bail!("port {path}: the device pushes for another program")
            }
            other => bail!(
                "port {path}: cannot push: {}",
                words::refusal(&other, &identity.board, None)
            ),
        }
    }
    let patience = SILENCE + Duration::from_secs_f64(TICKS * period_s);
    let mut heard = Recorded::default();
    loop {
        let deadline = Instant::now() + patience;
        let end = loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match device.unasked(left)? {
                Some((_, Unasked::Moves(moves))) => {
                    let end = moves.end;
                    heard.add(moves);
                    break end;
                }
                Some((_, Unasked::Event(Event::Fault { fault, .. }))) => heard.fault = Some(fault),
                Some(_) => {}
                None => {
                    heard.holes = true;
                    match device.status()?.state {
                        State::Pushing => break None,
                        // The last message was lost.
                        State::Fault(_) => break Some(PushEnd::Fault),
                        _ => break Some(PushEnd::Rest),
                    }
                }
            }
        };
        if let Some(end) = end {
            return ended(device, heard, end, period_s);
        }
    }
}

/// What was heard of a push so far.
#[derive(Default)]
struct Recorded {
    from: i32,
    moves: Vec<i32>,
    released: Option<u32>,
    /// The count after the last move that was heard.
    count: i32,
    holes: bool,
    fault: Option<Fault>,
}

impl Recorded {
    fn add(&mut self, moved: Moved) {
        if moved.first == 0 {
            self.from = moved.from;
        } else if moved.first as usize != self.moves.len() || moved.from != self.count {
            self.holes = true;
        }
        self.count = moved.from;
        for one in moved.moves {
            self.moves.push(i32::from(one));
            self.count = self.count.wrapping_add(i32::from(one));
        }
        self.released = moved.released;
    }
}

fn ended(device: &mut Device, heard: Recorded, end: PushEnd, period_s: f64) -> Result<Heard> {
    let path = device.path().to_owned();
    match end {
        PushEnd::Rest | PushEnd::InMotion if heard.holes => Ok(Heard::Holes { count: heard.count }),
        PushEnd::Rest | PushEnd::InMotion => {
            let released = heard
                .released
                .map_or(heard.moves.len(), |tick| tick as usize);
            Ok(Heard::Whole(Played {
                from: heard.from,
                moves: heard.moves,
                released,
            }))
        }
        PushEnd::BrokenOff => {
            bail!("port {path}: the push was broken off: another program disarmed the device")
        }
        PushEnd::NoRoom => bail!(
            "port {path}: the line does not carry a tick every {period_s} s; accepted: a longer sample_period_s, \
             or a faster line"
        ),
        PushEnd::Fault => {
            let fault = match (heard.fault, device.status()?.state) {
                (Some(fault), _) | (None, State::Fault(fault)) => fault,
                (None, state) => bail!(
                    "port {path}: a fault ended the push, and now it is {}",
                    words::state_in_full(state)
                ),
            };
            let more = match fault {
                Fault::Guard => {
                    "; something else moved it, or --angle-max is too small for how it coasts"
                }
                Fault::EncoderJump { .. } | Fault::OverSpeed { .. } => "; is counts_per_rev right?",
                _ => "",
            };
            bail!(
                "port {path}: a fault ended the push: {}{more}; `knob clear` leaves the fault",
                words::fault(fault)
            )
        }
    }
}
