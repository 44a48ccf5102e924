//! What answers the host: reads frames, checks what they ask, hands commands to the tick, and
//! sends what the tick has to tell. Runs below the tick and never keeps it waiting.

use core::sync::atomic::Ordering::Relaxed;

use control::config::Law;
use control::tick::Reason;
use protocol::{
    Changes, ClampReason, Drive, Event, FRAME_MAX, Fault, Fields, Frames, FromDevice, Hello,
    MOVES_MAX, Message, MotorChanges, Moves, Name, Refusal, Request, ResetReason, State, Status,
    Stored, Subscription, Telemetry, ToDevice, VERSION, decode, encode,
};

use crate::commission::{self, Run, Told};
use crate::settings::{self, BoardKind, DEFAULT_SETTINGS, HIGHEST, LOWEST, Settings, Start};
use crate::store::{Keep, SaveError};
use crate::ticker::{Command, Occasion, Record, StateCode};
use crate::{CommandSender, Link, MeasurementReceiver, MoveReceiver, RecordReceiver};
use heapless::spsc::Consumer;

/// Who this is.
#[derive(Debug, Clone, Copy)]
pub struct Identity {
    /// The firmware's version.
    pub firmware: &'static str,
    /// The source it was built from.
    pub git_hash: &'static str,
    /// The board.
    pub board: &'static str,
    /// What its settings must suit.
    pub kind: BoardKind,
    /// Why it started.
    pub reset: ResetReason,
}

/// Records sent before the host is listened to again: on a slow line the tick may tell faster than
/// can be sent.
const RECORDS_AT_A_TIME: u32 = 8;

/// A request that the tick has not answered yet.
#[derive(Debug, Clone, Copy)]
struct Pending {
    sequence: u16,
    /// Commands taken once this one is.
    taken: u16,
    /// The settings that are in force then.
    settings: Settings,
    /// They are kept then, too.
    save: bool,
    /// They tell the encoder's zero.
    zero: bool,
}

/// Which request began the last push.
#[derive(Debug, Clone, Copy)]
struct Pushed {
    sequence: u16,
    /// The tick that took it, once one has.
    tick: Option<u32>,
}

/// How far the host was told of a push.
#[derive(Debug, Clone, Copy)]
struct Telling {
    /// The tick of the push that is told next.
    first: u32,
    /// The count before it.
    from: i32,
}

/// The desk, and all that it owns.
pub struct Desk<'a, K> {
    identity: Identity,
    settings: Settings,
    stored: Stored,
    /// The settings that the store would give at the next start, where it is known to.
    kept: Option<Settings>,
    store: K,
    subscription: Subscription,
    /// The encoder's zero was told since the start.
    zero_known: bool,
    pending: Option<Pending>,
    /// The request to leave a fault that waits for the gate driver's restart.
    clearing: Option<u16>,
    /// As long as the request may come again.
    pushed: Option<Pushed>,
    telling: Option<Telling>,
    frames: Frames,
    bad_frames: u32,
    /// Drops that the host has been told of.
    dropped_told: u32,
    unasked: u16,
    link: &'a Link,
    commands: CommandSender<'a>,
    records: RecordReceiver<'a>,
    measurements: Option<MeasurementReceiver<'a>>,
    moves: MoveReceiver<'a>,
}

impl<'a, K: Keep> Desk<'a, K> {
    /// A desk for a tick that was started with what `store` held.
    #[must_use]
    pub fn new(
        identity: Identity,
        start: &Start,
        store: K,
        link: &'a Link,
        commands: CommandSender<'a>,
        records: RecordReceiver<'a>,
        moves: MoveReceiver<'a>,
    ) -> Self {
        Self {
            identity,
            settings: start.settings,
            stored: start.stored,
            kept: (start.stored == Stored::Last).then_some(start.settings),
            store,
            subscription: Subscription::default(),
            zero_known: false,
            pending: None,
            clearing: None,
            pushed: None,
            telling: None,
            frames: Frames::new(),
            bad_frames: 0,
            dropped_told: 0,
            unasked: 0,
            link,
            commands,
            records,
            moves,
            measurements: None,
        }
    }

    /// The same, told what excitations bring.
    #[must_use]
    pub fn told(self, measurements: MeasurementReceiver<'a>) -> Self {
        Self {
            measurements: Some(measurements),
            ..self
        }
    }

    /// Gives the store back.
    pub fn into_store(self) -> K {
        self.store
    }

    /// Answers what the tick has taken, reads what the host sent as long as no request waits for the
    /// tick, and sends some of what the tick has told. What is left is for the next call, which the next
    /// tick brings.
    pub fn serve(&mut self, mut read: impl FnMut() -> Option<u8>, mut write: impl FnMut(&[u8])) {
        let runs = self.link.desk_runs.load(Relaxed);
        self.link.desk_runs.store(runs.wrapping_add(1), Relaxed);
        self.answer_pending(&mut write);
        self.clear_restarted(&mut write);
        while self.pending.is_none() && self.clearing.is_none() {
            let Some(byte) = read() else { break };
            let request = match self.frames.push(byte) {
                None => continue,
                Some(Ok(frame)) => decode::<ToDevice>(frame),
                Some(Err(error)) => Err(error),
            };
            match request {
                Ok(ToDevice { sequence, request }) => self.handle(sequence, &request, &mut write),
                Err(_) => self.bad_frames = self.bad_frames.wrapping_add(1),
            }
        }
        for _ in 0..RECORDS_AT_A_TIME {
            let Some(record) = self.records.dequeue() else {
                break;
            };
            self.tell(&record, &mut write);
        }
        for _ in 0..RECORDS_AT_A_TIME {
            let measured = self.measurements.as_mut().and_then(Consumer::dequeue);
            let event = match measured {
                Some(Told::Sums(sums)) => Event::Measured(sums),
                Some(Told::End(end)) => Event::Calibrated { end },
                None => break,
            };
            self.send_unasked(Message::Event(event), &mut write);
        }
        self.tell_moves(&mut write);
        let dropped = self.link.dropped.load(Relaxed);
        if dropped != self.dropped_told {
            self.dropped_told = dropped;
            self.send_unasked(
                Message::Event(Event::Dropped { total: dropped }),
                &mut write,
            );
        }
    }

    fn state(&self) -> State {
        self.state_of(self.link.status().state)
    }

    fn state_of(&self, code: StateCode) -> State {
        match code {
            StateCode::Disarmed => State::Disarmed,
            StateCode::Armed => State::Armed,
            StateCode::Fault => State::Fault(self.link.fault()),
            StateCode::Calibrating => State::Calibrating,
            StateCode::Pushing => State::Pushing,
        }
    }

    /// Leaves the fault, now that the gate driver was set up anew.
    fn clear_restarted(&mut self, write: &mut impl FnMut(&[u8])) {
        let done = self.link.restarts_done.load(Relaxed);
        if self.link.restarts_asked.load(Relaxed) != done {
            return;
        }
        if let Some(sequence) = self.clearing.take() {
            self.command(sequence, Command::Clear, self.settings, false, write);
        }
    }

    fn answer_pending(&mut self, write: &mut impl FnMut(&[u8])) {
        let Some(pending) = self.pending else { return };
        let status = self.link.status();
        if status.taken != pending.taken {
            return;
        }
        self.pending = None;
        let began = self.pushed.filter(|push| push.sequence == pending.sequence);
        let message = if status.refused {
            self.pushed = None;
            Message::Refused(Refusal::State(self.state_of(status.state)))
        } else {
            self.settings = pending.settings;
            self.zero_known |= pending.zero;
            if let Some(push) = began {
                self.pushed = Some(Pushed {
                    tick: Some(self.link.taken_at.load(Relaxed)),
                    ..push
                });
                self.telling = Some(Telling {
                    first: 0,
                    from: self.link.push_from.load(Relaxed).cast_signed(),
                });
            }
            match if pending.save { self.save() } else { Ok(()) } {
                Ok(()) => Message::Done {
                    tick: self.link.taken_at.load(Relaxed),
                },
                Err(refusal) => Message::Refused(refusal),
            }
        };
        send(pending.sequence, message, write);
    }

    fn handle(&mut self, sequence: u16, request: &Request, write: &mut impl FnMut(&[u8])) {
        if !matches!(request, Request::Push(_)) {
            self.pushed = None;
        }
        let answer = match request {
            Request::Hello { version } if *version == VERSION => Message::Hello(Hello {
                version: VERSION,
                firmware: self.identity.firmware,
                git_hash: self.identity.git_hash,
                board: self.identity.board,
                lowest: LOWEST,
                highest: HIGHEST,
            }),
            Request::Hello { .. } => Message::Refused(Refusal::Version { accepted: VERSION }),
            Request::Get => Message::Parameters(self.settings.parameters),
            Request::Set(changes) => match self.settle(changes) {
                Ok((command, settings)) => {
                    return self.command(sequence, command, settings, false, write);
                }
                Err(refusal) => Message::Refused(refusal),
            },
            Request::Arm if self.without_motor() => Message::Refused(Refusal::NoMotor),
            Request::Arm if self.without_zero() => Message::Refused(Refusal::NoZero),
            Request::Arm => {
                return self.command(sequence, Command::Arm, self.settings, false, write);
            }
            Request::Disarm => {
                return self.command(sequence, Command::Disarm, self.settings, false, write);
            }
            // Its shutdown is latched: it is set up anew by the slow task first, where there is one.
            Request::Clear
                if self.state() == State::Fault(Fault::GateDriver)
                    && self.link.slow_runs.load(Relaxed) != 0 =>
            {
                let asked = self.link.restarts_asked.load(Relaxed);
                self.link
                    .restarts_asked
                    .store(asked.wrapping_add(1), Relaxed);
                self.clearing = Some(sequence);
                return;
            }
            Request::Clear => {
                return self.command(sequence, Command::Clear, self.settings, false, write);
            }
            Request::Save => match self.save() {
                Ok(()) => Message::Done {
                    tick: self.link.tick.load(Relaxed),
                },
                Err(refusal) => Message::Refused(refusal),
            },
            Request::Subscribe(subscription) => {
                self.subscription = *subscription;
                self.link
                    .every_ticks
                    .store(u32::from(subscription.every_ticks), Relaxed);
                self.link
                    .clamp_events
                    .store(u32::from(subscription.clamp_events), Relaxed);
                Message::Done {
                    tick: self.link.tick.load(Relaxed),
                }
            }
            Request::Status => Message::Status(Status {
                tick: self.link.tick.load(Relaxed),
                state: self.state(),
                dropped: self.link.dropped.load(Relaxed),
                bad_frames: self.bad_frames,
                stored: self.stored,
                reset: self.identity.reset,
            }),
            Request::ResetSettings => match self.defaults() {
                Ok(command) => {
                    return self.command(sequence, command, DEFAULT_SETTINGS, true, write);
                }
                Err(refusal) => Message::Refused(refusal),
            },
            Request::Motor => Message::Motor(self.settings.motor),
            Request::SetMotor(changes) => match self.settle_motor(changes) {
                Ok((command, settings)) => {
                    self.command(sequence, command, settings, false, write);
                    if let Some(pending) = &mut self.pending {
                        pending.zero = changes.zero_turns.is_some();
                    }
                    return;
                }
                Err(refusal) => Message::Refused(refusal),
            },
            Request::LastFault => Message::Snapshot(self.link.snapshot()),
            Request::Push(_) if self.without_motor() => Message::Refused(Refusal::NoMotor),
            Request::Push(_) if self.without_zero() => Message::Refused(Refusal::NoZero),
            Request::Push(push) => match (self.pushed, self.push(push)) {
                // Its answer was lost.
                (
                    Some(Pushed {
                        sequence: of,
                        tick: Some(tick),
                    }),
                    _,
                ) if of == sequence => Message::Done { tick },
                (_, Ok(command)) => {
                    self.pushed = Some(Pushed {
                        sequence,
                        tick: None,
                    });
                    return self.command(sequence, command, self.settings, false, write);
                }
                (_, Err(refusal)) => Message::Refused(refusal),
            },
            Request::Calibrate(excitation) => {
                let run = match &self.identity.kind {
                    BoardKind::Stage(facts) => Run::new(excitation, facts),
                    _ => return send(sequence, Message::Refused(Refusal::NoPowerStage), write),
                };
                match run {
                    Ok(run) => {
                        let command = Command::Excite(run);
                        return self.command(sequence, command, self.settings, false, write);
                    }
                    Err(_) => Message::Refused(Refusal::Excitation),
                }
            }
            Request::PowerStage => Message::PowerStage(match &self.identity.kind {
                BoardKind::Stage(facts) => Some(commission::power_stage(facts)),
                _ => None,
            }),
        };
        send(sequence, answer, write);
    }

    /// Checks a set of changes as a whole.
    fn settle(&self, changes: &Changes) -> Result<(Command, Settings), Refusal> {
        let now = self.settings.parameters;
        let parameters = now.with(changes);
        let settings = Settings {
            parameters,
            ..self.settings
        };
        let settled = settings::settle(&settings, &self.identity.kind)?;
        if self.state() == State::Armed {
            for (name, changed) in [
                (
                    Name::SamplePeriodS,
                    parameters.sample_period_s != now.sample_period_s,
                ),
                (Name::Decimation, parameters.decimation != now.decimation),
                (
                    Name::CountsPerRev,
                    parameters.counts_per_rev != now.counts_per_rev,
                ),
            ] {
                if changed {
                    return Err(Refusal::Armed { name });
                }
            }
        }
        Ok((Command::Configure(settled), settings))
    }

    /// Checks changes of the motor as a whole, beside the parameters.
    fn settle_motor(&self, changes: &MotorChanges) -> Result<(Command, Settings), Refusal> {
        match self.state() {
            State::Disarmed => {}
            state => return Err(Refusal::State(state)),
        }
        let settings = Settings {
            motor: self.settings.motor.with(changes),
            ..self.settings
        };
        let settled = settings::settle(&settings, &self.identity.kind)?;
        Ok((Command::Configure(settled), settings))
    }

    /// There is a power stage, and nothing is known of what it drives.
    fn without_motor(&self) -> bool {
        matches!(self.identity.kind, BoardKind::Stage(_))
            && self.settings.motor.drive == Drive::None
    }

    /// The motor's torque depends on the encoder's zero, which nobody has told since the start: an encoder without an index
    /// counts from wherever it stands then.
    fn without_zero(&self) -> bool {
        matches!(self.identity.kind, BoardKind::Stage(_))
            && matches!(self.settings.motor.drive, Drive::Current | Drive::Voltage)
            && !self.zero_known
    }

    /// What brings the defaults back.
    fn defaults(&self) -> Result<Command, Refusal> {
        if self.stored == Stored::NoStorage {
            return Err(Refusal::NoStorage);
        }
        match self.state() {
            State::Disarmed => {}
            state => return Err(Refusal::State(state)),
        }
        settings::settle(&DEFAULT_SETTINGS, &self.identity.kind).map(Command::Configure)
    }

    /// Keeps the settings in force, unless they are kept already: a request that is repeated costs
    /// no flash. Nothing is under way with the tick now, so disarmed it stays until this is done.
    fn save(&mut self) -> Result<(), Refusal> {
        if self.stored == Stored::NoStorage {
            return Err(Refusal::NoStorage);
        }
        match self.state() {
            State::Disarmed => {}
            state => return Err(Refusal::State(state)),
        }
        if self.kept == Some(self.settings) {
            return Ok(());
        }
        match self.store.save(&self.settings) {
            Ok(()) => {
                self.stored = Stored::Last;
                self.kept = Some(self.settings);
                Ok(())
            }
            Err(SaveError::NoStorage) => Err(Refusal::NoStorage),
            Err(SaveError::Flash | SaveError::ReadBack | SaveError::TooLong) => {
                // What the next start finds is only known then.
                self.kept = None;
                Err(Refusal::NotKept)
            }
        }
    }

    /// What begins a push.
    fn push(&self, push: &protocol::Push) -> Result<Command, Refusal> {
        match self.state() {
            // The host has not been told all of the last one.
            State::Disarmed if self.telling.is_some() => Err(Refusal::State(State::Pushing)),
            State::Disarmed => settings::push(push, &self.settings.parameters).map(Command::Push),
            state => Err(Refusal::State(state)),
        }
    }

    /// Hands a command to the tick; it is answered when the tick has taken it.
    fn command(
        &mut self,
        sequence: u16,
        command: Command,
        settings: Settings,
        save: bool,
        write: &mut impl FnMut(&[u8]),
    ) {
        let taken = self.link.status().taken.wrapping_add(1);
        if self.commands.enqueue(command).is_ok() {
            self.pending = Some(Pending {
                sequence,
                taken,
                settings,
                save,
                zero: false,
            });
        } else {
            // One command at a time is under way, so there is room; if not, nothing was done.
            send(
                sequence,
                Message::Refused(Refusal::State(self.state())),
                write,
            );
        }
    }

    fn tell(&mut self, record: &Record, write: &mut impl FnMut(&[u8])) {
        let tick = &record.tick;
        let gives_torque = matches!(record.state, StateCode::Armed | StateCode::Pushing);
        let message = match record.occasion {
            Occasion::Fault(fault) => Message::Event(Event::Fault {
                tick: record.number,
                fault,
            }),
            Occasion::Clamp => Message::Event(Event::Clamp {
                tick: record.number,
                reason: clamp_reason(tick.reason),
                stiffness_nm_rad: tick.stiffness_nm_rad,
            }),
            Occasion::Telemetry => {
                let wanted = self.subscription.fields;
                Message::Telemetry(Telemetry {
                    tick: record.number,
                    state: self.state_of(record.state),
                    count: wanted.has(Fields::COUNT).then_some(tick.count),
                    torque_nm: wanted.has(Fields::TORQUE).then_some(if gives_torque {
                        tick.torque_nm
                    } else {
                        0.0
                    }),
                    stiffness_nm_rad: wanted
                        .has(Fields::STIFFNESS)
                        .then_some(tick.stiffness_nm_rad),
                    demanded_nm_rad: wanted
                        .has(Fields::DEMANDED)
                        .then_some(record.demanded_nm_rad),
                    margin_nm: wanted.has(Fields::MARGIN).then_some(tick.margin_nm),
                    reason: wanted
                        .has(Fields::REASON)
                        .then_some(clamp_reason(tick.reason)),
                    law: wanted.has(Fields::LAW).then_some(law(tick.law)),
                    account_j: wanted.has(Fields::ACCOUNT).then_some(tick.account_j),
                })
            }
        };
        self.send_unasked(message, write);
    }

    /// How a push goes on: a full frame where there is one, and what is left of a push that is over.
    fn tell_moves(&mut self, write: &mut impl FnMut(&[u8])) {
        let Some(Telling { first, from }) = self.telling else {
            return;
        };
        // Looked up before the queue is: once it is there, nothing is added.
        let end = self.link.push_end();
        if end.is_none() && self.moves.len() < MOVES_MAX / 2 {
            return;
        }
        let mut bytes = [0; MOVES_MAX];
        let (mut ticks, mut count) = (0, from);
        let (pairs, _) = bytes.as_chunks_mut();
        for pair in pairs {
            let Some(moved) = self.moves.dequeue() else {
                break;
            };
            *pair = moved.to_le_bytes();
            count = count.wrapping_add(i32::from(moved));
            ticks += 1;
        }
        let end = end.filter(|_| !self.moves.ready());
        let released = self.link.push_released.load(Relaxed);
        let moves = Moves {
            first,
            from,
            released: (released != u32::MAX).then_some(released),
            end,
            moves: bytes.get(..2 * ticks).unwrap_or_default(),
        };
        self.send_unasked(Message::Moves(moves), write);
        self.telling = match end {
            Some(_) => None,
            None => Some(Telling {
                first: first.wrapping_add(ticks as u32),
                from: count,
            }),
        };
    }

    fn send_unasked(&mut self, message: Message<'_>, write: &mut impl FnMut(&[u8])) {
        send(self.unasked, message, write);
        self.unasked = self.unasked.wrapping_add(1);
    }
}

fn send(sequence: u16, message: Message<'_>, write: &mut impl FnMut(&[u8])) {
    let mut buffer = [0; FRAME_MAX];
    // No message is longer than a frame: the tests encode the longest of each kind.
    if let Ok(frame) = encode(&FromDevice { sequence, message }, &mut buffer) {
        write(frame);
    }
}

fn clamp_reason(reason: Reason) -> ClampReason {
    match reason {
        Reason::None => ClampReason::None,
        Reason::Viscous => ClampReason::Viscous,
        Reason::Coulomb => ClampReason::Coulomb,
        Reason::Speed => ClampReason::Speed,
        Reason::ZeroForce => ClampReason::ZeroForce,
        Reason::Torque => ClampReason::Torque,
        Reason::Inertia => ClampReason::Inertia,
        Reason::Coarse => ClampReason::Coarse,
        Reason::Account => ClampReason::Account,
        Reason::Hand => ClampReason::Hand,
    }
}

fn law(law: Law) -> protocol::Law {
    match law {
        Law::Raw => protocol::Law::Raw,
        Law::Static => protocol::Law::Static,
        Law::Episode => protocol::Law::Episode,
        Law::Ledger => protocol::Law::Ledger,
        Law::Auto => protocol::Law::Auto,
    }
}
