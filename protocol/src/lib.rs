//! What the knob and its host say to each other, and how it is framed.
//!
//! One source for both ends of the wire: `no_std`, no allocation. `docs/protocol.md`
//! describes the same for a client in another language; its golden frames are tested.
//!
//! A message is written by `postcard`, followed by its CRC-32 (ISCSI, little endian), the
//! whole COBS-encoded and closed by a zero byte. A frame is at most [`FRAME_MAX`] bytes.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

mod frame;
mod message;
mod parameters;

pub use frame::{FRAME_MAX, FrameError, Frames, decode, encode};
pub use message::{
    Calibrate, CalibrationEnd, ClampReason, Event, Fault, Fields, FromDevice, Hello, MOVES_MAX,
    Message, Moves, Push, PushEnd, Refusal, Request, ResetReason, Snapshot, Stage, State, Status,
    Stored, Subscription, Telemetry, ToDevice,
};
pub use parameters::{
    Changes, Drive, Interval, Law, Motor, MotorChanges, MotorName, Name, Parameters, Shape,
};

/// The version of the protocol; the first message of a host names its own.
pub const VERSION: u16 = 4;
