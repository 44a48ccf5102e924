//! A knob on a serial port: requests and their answers, and what it sends unasked.
//!
//! Every wait has a limit, and ends early when the user stops the work.

mod error;
mod line;

use std::collections::VecDeque;
use std::time::{Duration, Instant, SystemTime};

use anyhow::Result;
use protocol::{
    FRAME_MAX, Motor, Parameters, PowerStage, Refusal, Request, Snapshot, State, Status,
    Subscription, ToDevice, VERSION, encode,
};

pub use error::DeviceError;
use line::{Answer, Line, Said};
pub use line::{Identity, Moved, Unasked};

use crate::stop::{self, Stopped};

/// How long a first answer may take.
const HELLO_WITHIN: Duration = Duration::from_millis(1500);
/// How long any other answer may take.
const ANSWER_WITHIN: Duration = Duration::from_millis(2500);
/// How long a save may take: two seconds for the slowest erase, and an answer to the request that was
/// sent once more.
const SAVED_WITHIN: Duration = Duration::from_millis(6000);
/// How long the device may take to fall silent when a log ends, however it ends.
const HUSH_WITHIN: Duration = Duration::from_millis(500);
/// After so long without an answer the request is sent once more.
const AGAIN_AFTER: Duration = Duration::from_millis(700);

/// A knob that has answered.
pub struct Device {
    line: Line,
    sequence: u16,
    unasked: VecDeque<(u16, Unasked)>,
    /// It has said hello.
    known: bool,
}

/// What came of a request that changes something.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// Done; in force from this tick on.
    Done { tick: u32 },
    /// Not done, and nothing was changed.
    Refused(Refusal),
}

/// An answer, and whether it may be the second to the same request.
struct Answered {
    answer: Answer,
    repeated: bool,
}

/// Whether a wait ends when the user stops the work.
#[derive(Clone, Copy, PartialEq, Eq)]
enum CtrlC {
    Ends,
    Waits,
}

impl Device {
    /// Opens a port and greets the device there.
    pub fn connect(path: &str) -> Result<(Self, Identity)> {
        // Another number for each connection: answers to an earlier one that still lie in the
        // buffers are not taken for ours.
        let clock = SystemTime::now()
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |now| now.subsec_micros());
        let mut device = Self {
            line: Line::open(path)?,
            sequence: (clock ^ std::process::id()) as u16,
            unasked: VecDeque::new(),
            known: false,
        };
        // Ends whatever piece of a frame the device has from before.
        device.line.send(&[0], Instant::now() + HELLO_WITHIN)?;
        let hello = Request::Hello { version: VERSION };
        match device.exchange(hello, HELLO_WITHIN, CtrlC::Ends)?.answer {
            Answer::Hello(identity) if identity.version == VERSION => {
                device.known = true;
                Ok((device, identity))
            }
            Answer::Hello(Identity {
                version: accepted, ..
            })
            | Answer::Refused(Refusal::Version { accepted }) => {
                Err(device.trouble(|path| DeviceError::Version { path, accepted }))
            }
            _ => Err(device.unexpected(hello)),
        }
    }

    /// All parameters.
    pub fn parameters(&mut self) -> Result<Parameters> {
        match self.request(Request::Get)?.answer {
            Answer::Parameters(parameters) => Ok(parameters),
            _ => Err(self.unexpected(Request::Get)),
        }
    }

    /// How it is.
    pub fn status(&mut self) -> Result<Status> {
        match self.request(Request::Status)?.answer {
            Answer::Status(status) => Ok(status),
            _ => Err(self.unexpected(Request::Status)),
        }
    }

    /// The motor at its bridge.
    pub fn motor(&mut self) -> Result<Motor> {
        match self.request(Request::Motor)?.answer {
            Answer::Motor(motor) => Ok(motor),
            _ => Err(self.unexpected(Request::Motor)),
        }
    }

    /// How things stood at its last fault.
    pub fn last_fault(&mut self) -> Result<Option<Snapshot>> {
        match self.request(Request::LastFault)?.answer {
            Answer::Snapshot(snapshot) => Ok(snapshot),
            _ => Err(self.unexpected(Request::LastFault)),
        }
    }

    /// Has it do something.
    pub fn order(&mut self, request: Request) -> Result<Outcome> {
        let answered = self.request(request)?;
        self.outcome(request, answered)
    }

    /// The same, also after Ctrl-C.
    pub fn order_to_the_end(&mut self, request: Request) -> Result<Outcome> {
        let answered = self.exchange(request, ANSWER_WITHIN, CtrlC::Waits)?;
        self.outcome(request, answered)
    }

    fn outcome(&mut self, request: Request, answered: Answered) -> Result<Outcome> {
        let Answered { answer, repeated } = answered;
        match answer {
            Answer::Done { tick } => Ok(Outcome::Done { tick }),
            // The first Clear was taken and its answer was lost.
            Answer::Refused(Refusal::State(State::Disarmed))
                if repeated && request == Request::Clear =>
            {
                let Status { tick, .. } = self.status()?;
                Ok(Outcome::Done { tick })
            }
            // The first was taken, and is under way.
            Answer::Refused(Refusal::State(State::Calibrating))
                if repeated && matches!(request, Request::Calibrate(_)) =>
            {
                let Status { tick, .. } = self.status()?;
                Ok(Outcome::Done { tick })
            }
            Answer::Refused(refusal) => Ok(Outcome::Refused(refusal)),
            _ => Err(self.unexpected(request)),
        }
    }

    /// Subscribes; what was sent unasked before is forgotten.
    pub fn subscribe(&mut self, subscription: Subscription) -> Result<()> {
        match self.order(Request::Subscribe(subscription))? {
            Outcome::Done { .. } => {
                self.unasked.clear();
                Ok(())
            }
            Outcome::Refused(_) => Err(self.unexpected(Request::Subscribe(subscription))),
        }
    }

    /// Ends the subscription, also after Ctrl-C.
    pub fn hush(&mut self) -> Result<()> {
        let nothing = Request::Subscribe(Subscription::default());
        match self.exchange(nothing, HUSH_WITHIN, CtrlC::Waits)?.answer {
            Answer::Done { .. } => Ok(()),
            _ => Err(self.unexpected(nothing)),
        }
    }

    /// The power stage, if the board has one.
    pub fn power_stage(&mut self) -> Result<Option<PowerStage>> {
        match self.request(Request::PowerStage)?.answer {
            Answer::PowerStage(stage) => Ok(stage),
            _ => Err(self.unexpected(Request::PowerStage)),
        }
    }

    /// Turns the bridge off, also after Ctrl-C.
    pub fn break_off(&mut self) -> Result<()> {
        self.exchange(Request::Disarm, HUSH_WITHIN, CtrlC::Waits)?;
        Ok(())
    }

    /// The next message that was sent unasked, with its number, if one comes within `patience`.
    pub fn unasked(&mut self, patience: Duration) -> Result<Option<(u16, Unasked)>> {
        let deadline = Instant::now() + patience;
        loop {
            if stop::requested() {
                return Err(Stopped.into());
            }
            if let Some(message) = self.unasked.pop_front() {
                return Ok(Some(message));
            }
            while let Some((sequence, said)) = self.line.next() {
                // An answer here is the second to a request that was sent twice.
                if let Said::Unasked(message) = said {
                    return Ok(Some((sequence, message)));
                }
            }
            if Instant::now() >= deadline {
                return Ok(None);
            }
            self.line.listen()?;
        }
    }

    /// Forgets what was sent unasked until now.
    pub fn forget_unasked(&mut self) {
        self.unasked.clear();
    }

    /// True if messages that were sent unasked are waiting to be read.
    pub fn has_unasked(&self) -> bool {
        !self.unasked.is_empty()
    }

    /// Frames since the start that could not be read.
    pub fn damaged(&self) -> u64 {
        self.line.damaged()
    }

    /// Where it is.
    pub fn path(&self) -> &str {
        self.line.path()
    }

    fn request(&mut self, request: Request) -> Result<Answered> {
        let within = match request {
            Request::Save | Request::ResetSettings => SAVED_WITHIN,
            _ => ANSWER_WITHIN,
        };
        self.exchange(request, within, CtrlC::Ends)
    }

    /// Sends a request and waits for its answer. After a silence it is sent once more under the
    /// same number: a device does the same again without harm.
    fn exchange(&mut self, request: Request, within: Duration, ctrl_c: CtrlC) -> Result<Answered> {
        self.sequence = self.sequence.wrapping_add(1);
        let sequence = self.sequence;
        let mut buffer = [0; FRAME_MAX];
        let frame = encode(&ToDevice { sequence, request }, &mut buffer)
            .map_err(|_| self.unexpected(request))?;
        let start = Instant::now();
        let deadline = start + within;
        self.line.send(frame, deadline)?;
        let mut repeated = false;
        loop {
            while let Some((number, said)) = self.line.next() {
                match said {
                    Said::Unasked(message) => self.unasked.push_back((number, message)),
                    Said::Answer(answer) if number == sequence => {
                        return Ok(Answered { answer, repeated });
                    }
                    Said::Answer(_) => {}
                }
            }
            if ctrl_c == CtrlC::Ends && stop::requested() {
                return Err(Stopped.into());
            }
            let now = Instant::now();
            if now >= deadline {
                return Err(self.silence(request, within));
            }
            if !repeated && now >= start + AGAIN_AFTER {
                repeated = true;
                self.line.send(frame, deadline)?;
            }
            self.line.listen()?;
        }
    }

    /// Why there is no answer, as far as can be told from what came instead.
    fn silence(&self, request: Request, within: Duration) -> anyhow::Error {
        let (bytes, damaged, whole) = (self.line.bytes(), self.line.damaged(), self.line.whole());
        self.trouble(|path| match (self.known, whole, bytes) {
            (true, ..) => DeviceError::Unanswered {
                path,
                asked: asked(request),
                within,
                damaged,
            },
            (false, 0, 0) => DeviceError::Silent { path, within },
            (false, 0, _) => DeviceError::Foreign {
                path,
                within,
                bytes,
            },
            (false, ..) => DeviceError::Deaf {
                path,
                within,
                whole,
            },
        })
    }

    fn unexpected(&self, request: Request) -> anyhow::Error {
        self.trouble(|path| DeviceError::Unexpected {
            path,
            asked: asked(request),
        })
    }

    fn trouble(&self, error: impl FnOnce(String) -> DeviceError) -> anyhow::Error {
        error(self.line.path().to_owned()).into()
    }
}

/// A request in a word.
fn asked(request: Request) -> &'static str {
    match request {
        Request::Hello { .. } => "hello",
        Request::Get => "get",
        Request::Set(_) => "set",
        Request::Arm => "arm",
        Request::Disarm => "disarm",
        Request::Clear => "clear",
        Request::Save => "save",
        Request::Subscribe(_) => "subscribe",
        Request::Status => "status",
        Request::ResetSettings => "reset-settings",
        Request::Motor => "motor",
        Request::SetMotor(_) => "set motor",
        Request::LastFault => "last fault",
        Request::Calibrate(_) => "calibrate",
        Request::PowerStage => "power stage",
        Request::Push(_) => "push",
    }
}
