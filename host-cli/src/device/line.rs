use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::time::{Duration, Instant};

use protocol::{
    Event, Frames, FromDevice, Message, Motor, Moves, Parameters, PushEnd, Refusal, Snapshot,
    Status, Telemetry, decode,
};
use serialport::SerialPort;

use super::DeviceError;

/// Bits per second; means nothing over USB or to an emulator.
const BAUD: u32 = 115_200;
/// How long one look at the port takes if nothing comes: so soon Ctrl-C is seen.
const LOOK: Duration = Duration::from_millis(50);

/// Who a device is.
#[derive(Debug, Clone, PartialEq)]
pub struct Identity {
    /// The protocol's version.
    pub version: u16,
    /// The firmware's version.
    pub firmware: String,
    /// The source it was built from.
    pub git_hash: String,
    /// The board it runs on.
    pub board: String,
}

/// What a device says when asked.
#[derive(Debug, Clone, PartialEq)]
pub enum Answer {
    Hello(Identity),
    Parameters(Parameters),
    Done { tick: u32 },
    Refused(Refusal),
    Status(Status),
    Motor(Motor),
    Snapshot(Option<Snapshot>),
}

/// What a device says unasked.
#[derive(Debug, Clone, PartialEq)]
pub enum Unasked {
    /// A tick.
    Telemetry(Telemetry),
    /// Something happened.
    Event(Event),
    /// How a push goes on.
    Moves(Moved),
}

/// Counts of successive ticks of a push; see [`Moves`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Moved {
    pub first: u32,
    /// The count before the first of them.
    pub from: i32,
    pub released: Option<u32>,
    pub end: Option<PushEnd>,
    /// By how much each tick found the count moved.
    pub moves: Vec<i16>,
}

impl From<Moves<'_>> for Moved {
    fn from(moves: Moves<'_>) -> Self {
        let (pairs, _) = moves.moves.as_chunks();
        Self {
            first: moves.first,
            from: moves.from,
            released: moves.released,
            end: moves.end,
            moves: pairs.iter().map(|pair| i16::from_le_bytes(*pair)).collect(),
        }
    }
}

/// What a device says.
#[derive(Debug, Clone, PartialEq)]
pub enum Said {
    Answer(Answer),
    Unasked(Unasked),
}

impl From<Message<'_>> for Said {
    fn from(message: Message<'_>) -> Self {
        match message {
            Message::Hello(hello) => Self::Answer(Answer::Hello(Identity {
                version: hello.version,
                firmware: hello.firmware.to_owned(),
                git_hash: hello.git_hash.to_owned(),
                board: hello.board.to_owned(),
            })),
            Message::Parameters(parameters) => Self::Answer(Answer::Parameters(parameters)),
            Message::Done { tick } => Self::Answer(Answer::Done { tick }),
            Message::Refused(refusal) => Self::Answer(Answer::Refused(refusal)),
            Message::Status(status) => Self::Answer(Answer::Status(status)),
            Message::Telemetry(telemetry) => Self::Unasked(Unasked::Telemetry(telemetry)),
            Message::Event(event) => Self::Unasked(Unasked::Event(event)),
            Message::Motor(motor) => Self::Answer(Answer::Motor(motor)),
            Message::Snapshot(snapshot) => Self::Answer(Answer::Snapshot(snapshot)),
            Message::Moves(moves) => Self::Unasked(Unasked::Moves(moves.into())),
        }
    }
}

/// An open port, and the frames that came over it.
pub struct Line {
    port: Box<dyn SerialPort>,
    path: String,
    frames: Frames,
    heard: VecDeque<(u16, Said)>,
    bytes: u64,
    damaged: u64,
    whole: u64,
}

impl Line {
    /// Opens a port, for this process alone.
    pub fn open(path: &str) -> Result<Self, DeviceError> {
        let port = serialport::new(path, BAUD)
            .timeout(LOOK)
            .open()
            .map_err(|error| refusal(path, &error))?;
        Ok(Self {
            port,
            path: path.to_owned(),
            frames: Frames::new(),
            heard: VecDeque::new(),
            bytes: 0,
            damaged: 0,
            whole: 0,
        })
    }

    /// Sends all bytes, or fails at the deadline.
    pub fn send(&mut self, mut bytes: &[u8], deadline: Instant) -> Result<(), DeviceError> {
        while !bytes.is_empty() {
            match self.port.write(bytes) {
                Ok(taken) => bytes = bytes.get(taken..).unwrap_or_default(),
                Err(error) if is_pause(&error) => {}
                Err(error) => return Err(self.lost(error.to_string())),
            }
            if !bytes.is_empty() && Instant::now() >= deadline {
                return Err(DeviceError::Stuck(self.path.clone()));
            }
        }
        Ok(())
    }

    /// The next message that has been heard, with its sequence number.
    pub fn next(&mut self) -> Option<(u16, Said)> {
        self.heard.pop_front()
    }

    /// Takes in what comes now; waits a moment if nothing does.
    pub fn listen(&mut self) -> Result<(), DeviceError> {
        let mut buffer = [0; 4096];
        let read = match self.port.read(&mut buffer) {
            Ok(0) => return Err(self.lost("end of the stream".into())),
            Ok(read) => read,
            Err(error) if is_pause(&error) => 0,
            Err(error) => return Err(self.lost(error.to_string())),
        };
        self.bytes += read as u64;
        for byte in buffer.iter().take(read) {
            let message = match self.frames.push(*byte) {
                None => continue,
                Some(Ok(frame)) => decode::<FromDevice<'_>>(frame),
                Some(Err(error)) => Err(error),
            };
            match message {
                Ok(FromDevice { sequence, message }) => {
                    self.whole += 1;
                    self.heard.push_back((sequence, message.into()));
                }
                Err(_) => self.damaged += 1,
            }
        }
        Ok(())
    }

    /// Where it is.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Bytes that came.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Frames that could not be read.
    pub fn damaged(&self) -> u64 {
        self.damaged
    }

    /// Frames that could.
    pub fn whole(&self) -> u64 {
        self.whole
    }

    fn lost(&self, why: String) -> DeviceError {
        DeviceError::Lost {
            path: self.path.clone(),
            why,
        }
    }
}

/// Nothing came or went for a moment, or a signal did.
fn is_pause(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
    )
}

/// Why a port could not be opened.
fn refusal(path: &str, error: &serialport::Error) -> DeviceError {
    use serialport::ErrorKind as Kind;
    let path = path.to_owned();
    match error.kind() {
        Kind::Io(ErrorKind::NotFound) => DeviceError::NotFound(path),
        Kind::Io(ErrorKind::PermissionDenied) => DeviceError::NoPermission(path),
        // The crate says so of a port that somebody has for himself; on Windows also of none.
        Kind::NoDevice if cfg!(unix) => DeviceError::Busy(path),
        _ => DeviceError::NotSerial {
            path,
            why: error.to_string(),
        },
    }
}
