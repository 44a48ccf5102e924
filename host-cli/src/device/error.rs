use std::time::Duration;

use protocol::VERSION;

/// Why there is no talking to a device, and what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// Nothing there.
    #[error(
        "port {0}: it does not exist; plug the knob in, or pick one that `knob ports` lists with --port or KNOB_PORT"
    )]
    NotFound(String),
    /// Not ours.
    #[error(
        "port {0}: no permission to open it; on Linux join the group that owns it (`sudo usermod -aG dialout $USER`), then log in again"
    )]
    NoPermission(String),
    /// Somebody else's.
    #[error("port {0}: another program has it open; end that one first")]
    Busy(String),
    /// It cannot be opened for another reason.
    #[error(
        "port {path}: cannot open it as a serial port ({why}); accepted: one that `knob ports` lists"
    )]
    NotSerial {
        /// Where.
        path: String,
        /// What the system says.
        why: String,
    },
    /// Nothing came.
    #[error(
        "port {path}: opened it, but nothing answered within {} s; is it the knob's port (see `knob ports`)? is the firmware running?",
        .within.as_secs_f32()
    )]
    Silent {
        /// Where.
        path: String,
        /// How long it was waited for.
        within: Duration,
    },
    /// Something came, but nothing that could be read.
    #[error(
        "port {path}: {bytes} bytes came within {} s, but no message of a knob; is something else on this port (see `knob ports`)? does its firmware belong to this `knob`?",
        .within.as_secs_f32()
    )]
    Foreign {
        /// Where.
        path: String,
        /// How long it was waited for.
        within: Duration,
        /// What came.
        bytes: u64,
    },
    /// It talks, but does not listen.
    #[error(
        "port {path}: a knob sends here ({whole} messages within {} s), but does not answer; reset the board",
        .within.as_secs_f32()
    )]
    Deaf {
        /// Where.
        path: String,
        /// How long it was waited for.
        within: Duration,
        /// What came.
        whole: u64,
    },
    /// It speaks another version.
    #[error(
        "port {path}: the device speaks version {accepted} of the protocol, this `knob` speaks version {VERSION}; {}",
        remedy(*.accepted)
    )]
    Version {
        /// Where.
        path: String,
        /// The device's.
        accepted: u16,
    },
    /// It answered before, and does no more.
    #[error(
        "port {path}: `{asked}` was not answered within {} s, though the device answered before ({damaged} damaged frames came); check the cable, or reset the board",
        .within.as_secs_f32()
    )]
    Unanswered {
        /// Where.
        path: String,
        /// What was asked.
        asked: &'static str,
        /// How long it was waited for.
        within: Duration,
        /// Frames that could not be read.
        damaged: u64,
    },
    /// It answered, but not that.
    #[error(
        "port {path}: the answer to `{asked}` is not one; flash the firmware that belongs to this `knob`"
    )]
    Unexpected {
        /// Where.
        path: String,
        /// What was asked.
        asked: &'static str,
    },
    /// It does not take what is sent.
    #[error("port {0}: it takes no bytes; is it the knob's port (see `knob ports`)?")]
    Stuck(String),
    /// It is gone.
    #[error(
        "port {path}: lost the device ({why}); was it unplugged, or did its emulator end? `knob ports` lists what is there"
    )]
    Lost {
        /// Where.
        path: String,
        /// What the system says.
        why: String,
    },
}

/// What to do about another version.
fn remedy(accepted: u16) -> &'static str {
    if accepted > VERSION {
        "install the newer `knob` that came with that firmware, or flash the firmware of this one"
    } else {
        "flash the firmware that came with this `knob`"
    }
}
