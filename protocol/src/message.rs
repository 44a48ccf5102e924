use serde::{Deserialize, Serialize};

use crate::parameters::{Changes, Law, Name, Parameters};

/// A frame from the host.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ToDevice {
    /// Chosen by the host; the answer carries the same.
    pub sequence: u16,
    /// What is asked.
    pub request: Request,
}

/// What a host asks. Each request gets one answer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// The first message, with the host's version. Answer: [`Message::Hello`], or a refusal
    /// that names the device's.
    Hello {
        /// [`crate::VERSION`] of the host.
        version: u16,
    },
    /// Answer: [`Message::Parameters`].
    Get,
    /// All or none. Answer: [`Message::Done`] once a tick has taken it, or a refusal.
    Set(Changes),
    /// Render from now on, as soon as the knob passes zero force or has put energy in.
    Arm,
    /// No torque from now on.
    Disarm,
    /// Leave the fault state, disarmed.
    Clear,
    /// Keep the parameters for the next start. Only while disarmed: the device may stand still for some
    /// seconds until it answers, tick and all.
    Save,
    /// What to send unasked; replaces what was subscribed to before.
    Subscribe(Subscription),
    /// Answer: [`Message::Status`].
    Status,
}

/// What a host wants to be told unasked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Subscription {
    /// One telemetry message every so many ticks; 0: none.
    pub every_ticks: u16,
    /// What it carries.
    pub fields: Fields,
    /// An event whenever the reason for clamping changes.
    pub clamp_events: bool,
}

/// What telemetry carries, as bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Fields(pub u16);

impl Fields {
    /// The count.
    pub const COUNT: Self = Self(1);
    /// The torque.
    pub const TORQUE: Self = Self(2);
    /// The stiffness applied.
    pub const STIFFNESS: Self = Self(4);
    /// The stiffness demanded.
    pub const DEMANDED: Self = Self(8);
    /// The passivity margin.
    pub const MARGIN: Self = Self(16);
    /// Why the stiffness is clamped.
    pub const REASON: Self = Self(32);
    /// The law in force.
    pub const LAW: Self = Self(64);
    /// The energy in the ledger's account.
    pub const ACCOUNT: Self = Self(128);
    /// All of them.
    pub const ALL: Self = Self(255);

    /// True if every bit of `other` is set.
    #[must_use]
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// A frame from the device.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FromDevice<'a> {
    /// Of an answer: the request's. Of what comes unasked: counted up, so that a gap shows.
    pub sequence: u16,
    /// What is said.
    #[serde(borrow)]
    pub message: Message<'a>,
}

/// What a device says.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Message<'a> {
    /// Answer: who this is.
    #[serde(borrow)]
    Hello(Hello<'a>),
    /// Answer: all parameters.
    Parameters(Parameters),
    /// Answer: done; in force from this tick on.
    Done {
        /// The number of that tick.
        tick: u32,
    },
    /// Answer: not done, and nothing was changed.
    Refused(Refusal),
    /// Answer: how it is.
    Status(Status),
    /// Unasked, as subscribed.
    Telemetry(Telemetry),
    /// Unasked.
    Event(Event),
}

/// Who a device is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Hello<'a> {
    /// The protocol's version.
    pub version: u16,
    /// The firmware's version.
    pub firmware: &'a str,
    /// The source it was built from.
    pub git_hash: &'a str,
    /// The board it runs on.
    pub board: &'a str,
    /// The least that each numeric parameter may be.
    pub lowest: Parameters,
    /// The most.
    pub highest: Parameters,
}

/// How a device is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Ticks since the start.
    pub tick: u32,
    /// Armed or not.
    pub state: State,
    /// Telemetry and events that found no room since the start.
    pub dropped: u32,
    /// Frames that could not be read since the start.
    pub bad_frames: u32,
    /// What became of the last save.
    pub stored: Stored,
}

/// What a device found kept when it started, and so which parameters it began with; [`Self::Last`] after
/// a save.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stored {
    /// This board keeps no settings; it began with defaults.
    NoStorage,
    /// Nothing was ever saved; it began with defaults.
    Nothing,
    /// The last set that was saved.
    Last,
    /// The last save was cut short or is damaged; it began with the set before.
    Older,
    /// What was saved is of another version of the settings; it began with defaults.
    Version {
        /// Which.
        found: u16,
    },
    /// What was saved is damaged; it began with defaults.
    Damaged,
    /// What was saved can be read, but this firmware does not accept it; it began with defaults.
    Refused {
        /// The parameter that shows it.
        name: Name,
    },
}

/// Whether a device gives torque.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum State {
    /// It does not.
    Disarmed,
    /// It renders.
    Armed,
    /// It does not, and will not until it is cleared.
    Fault(Fault),
}

/// What put torque to zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// A tick was not done before the next was due.
    Overrun,
    /// The count moved further in one period than the knob can turn.
    EncoderJump {
        /// How far, counts.
        counts: i32,
    },
    /// The torque was not a finite number.
    TorqueNotFinite,
}

/// Why a request was not done.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Refusal {
    /// The host speaks another version.
    Version {
        /// The device's.
        accepted: u16,
    },
    /// A value is out of range, or not a number.
    Value {
        /// Which parameter.
        name: Name,
        /// What was given; of an interval, the end that is wrong.
        given: f32,
        /// The least that is accepted.
        lowest: f32,
        /// The most.
        highest: f32,
    },
    /// An interval's lower end lies above its upper end.
    Reversed {
        /// Which parameter.
        name: Name,
        /// The lower end given.
        low: f32,
        /// The upper end given.
        high: f32,
    },
    /// The values are each accepted, but not together.
    Together {
        /// The parameter that shows it.
        name: Name,
        /// The least that it may be beside the others.
        lowest: f32,
        /// The most.
        highest: f32,
    },
    /// May only be changed while disarmed.
    Armed {
        /// Which parameter.
        name: Name,
    },
    /// Not in this state.
    State(State),
    /// This board keeps no settings.
    NoStorage,
    /// The storage failed; what was saved before is kept.
    NotKept,
}

/// One tick, as subscribed; what was not asked for is None.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Its number.
    pub tick: u32,
    /// Armed or not.
    pub state: State,
    /// Decimated count.
    pub count: Option<i32>,
    /// Torque, Nm.
    pub torque_nm: Option<f32>,
    /// Stiffness applied, Nm/rad; under the ledger, torque over deflection.
    pub stiffness_nm_rad: Option<f32>,
    /// Stiffness demanded, Nm/rad.
    pub demanded_nm_rad: Option<f32>,
    /// Passivity margin, Nm.
    pub margin_nm: Option<f32>,
    /// Why less is applied than demanded.
    pub reason: Option<ClampReason>,
    /// The law in force; under auto one of static, episode, ledger.
    pub law: Option<Law>,
    /// The energy in the ledger's account, J; 0 under the other laws.
    pub account_j: Option<f32>,
}

/// Why less is applied than demanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClampReason {
    /// It is not.
    None,
    /// Sampled too slowly for this viscous friction: 2b/Te.
    Viscous,
    /// Encoder too coarse for this Coulomb friction: 2c/Δ.
    Coulomb,
    /// Too fast in this contact.
    Speed,
    /// It may rise only at zero force, and waits for it.
    ZeroForce,
    /// The torque limit.
    Torque,
    /// Sampled too slowly for this inertia, under the ledger: m/Te².
    Inertia,
    /// Encoder too coarse for this Coulomb friction, under the ledger: 3c/Δ.
    Coarse,
    /// The account covers no more.
    Account,
    /// A hand moved the knob as no believed force can; more is allowed for.
    Hand,
}

/// Something happened.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// Torque went to zero, and stays there.
    Fault {
        /// In which tick.
        tick: u32,
        /// Why.
        fault: Fault,
    },
    /// The reason for clamping changed.
    Clamp {
        /// In which tick.
        tick: u32,
        /// To what.
        reason: ClampReason,
        /// Stiffness applied, Nm/rad.
        stiffness_nm_rad: f32,
    },
    /// Telemetry or events found no room: the link is too slow for what was subscribed to.
    Dropped {
        /// How many since the start.
        total: u32,
    },
}
