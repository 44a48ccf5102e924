use serde::{Deserialize, Serialize};

use crate::calibration::{Excitation, ExcitationEnd, PowerStage, Sums};
use crate::parameters::{Changes, Law, Motor, MotorChanges, MotorName, Name, Parameters};

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
    /// Forget what was saved: the defaults, motor included, are in force at once and at the next start. Only while
    /// disarmed; takes as long as [`Request::Save`].
    ResetSettings,
    /// Answer: [`Message::Motor`].
    Motor,
    /// All or none, only while disarmed. Answer: as to [`Request::Set`].
    SetMotor(MotorChanges),
    /// Answer: [`Message::Snapshot`], of the last fault since the start.
    LastFault,
    /// Put a voltage on the motor and tell what comes of it. Only while disarmed, and only on a board with a power
    /// stage. Answer: done once it has begun; then comes [`Event::Measured`] for each window, and in the end
    /// [`Event::Calibrated`]. [`Request::Disarm`] breaks it off.
    Calibrate(Excitation),
    /// Give a torque without a spring and tell how the knob moves. Only while disarmed. Answer: done once it has
    /// begun; then come [`Message::Moves`]. [`Request::Disarm`] breaks it off. Repeated at once under the same sequence
    /// number it is answered again, but not played again.
    Push(Push),
    /// Answer: [`Message::PowerStage`].
    PowerStage,
}

/// A torque without a spring: it rises evenly from `from_nm` to `to_nm`, is held, and ends for good as soon as one of
/// the limits is reached.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Push {
    /// Torque of the first tick, Nm.
    pub from_nm: f32,
    /// Torque of tick `rise_ticks` and after, Nm.
    pub to_nm: f32,
    /// In so many ticks, 0 for a step.
    pub rise_ticks: u32,
    /// The torque ends after so many ticks.
    pub most_ticks: u32,
    /// It ends when the count has moved so far, either way.
    pub way_counts: u32,
    /// It ends when a tick moved the count by so many, either way.
    pub speed_counts: u32,
    /// With the torque off, the push is over when the count stood still for so many ticks,
    pub rest_ticks: u32,
    /// or after so many ticks, at rest or not.
    pub coast_ticks: u32,
    /// A knob that is further from where it was than this, either way, is a fault, counts.
    pub guard_counts: u32,
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
    /// Answer: the motor.
    Motor(Motor),
    /// Answer: the last fault since the start, if there was one.
    Snapshot(Option<Snapshot>),
    /// Unasked: how a push goes on.
    #[serde(borrow)]
    Moves(Moves<'a>),
    /// Answer: the board's power stage, if it has one.
    PowerStage(Option<PowerStage>),
}

/// The most bytes of [`Moves::moves`] that fit a frame.
pub const MOVES_MAX: usize = 224;

/// Counts of successive ticks of a push.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Moves<'a> {
    /// The number of the first of these ticks, from the push's first one as 0.
    pub first: u32,
    /// The count before the first of these ticks.
    pub from: i32,
    /// The number of the tick from which on there is no torque, as far as it is known.
    pub released: Option<u32>,
    /// How the push ended, if it did so with the last of these.
    pub end: Option<PushEnd>,
    /// By how much each tick found the count moved: two bytes each, signed, the low one first.
    pub moves: &'a [u8],
}

/// How a push ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum PushEnd {
    /// The knob rests.
    Rest,
    /// The knob did not come to rest in time.
    InMotion,
    /// It was told to end.
    BrokenOff,
    /// A fault ended it.
    Fault,
    /// The line is too slow for this sample period: a move found no room, and is lost.
    NoRoom,
}

/// How things stood in the tick that found a fault. What a board does not measure is 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// The tick.
    pub tick: u32,
    /// Why.
    pub fault: Fault,
    /// Decimated count.
    pub count: i32,
    /// By how much it had moved since the tick before.
    pub moved: i32,
    /// Torque commanded, Nm.
    pub torque_nm: f32,
    /// Current of phase B, A.
    pub current_b_a: f32,
    /// Current of phase C, A.
    pub current_c_a: f32,
    /// Bus voltage, V.
    pub bus_v: f32,
    /// Temperature of the switches, °C.
    pub temperature_c: f32,
    /// The gate driver's status words, as read after the fault.
    pub gate_driver: [u16; 2],
}

/// Why a device started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ResetReason {
    /// The board does not say.
    Unknown,
    /// Power came on.
    PowerOn,
    /// The supply sagged.
    BrownOut,
    /// The reset pin.
    Pin,
    /// The program asked for it.
    Software,
    /// The watchdog was not fed.
    Watchdog,
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
    /// Why it started.
    pub reset: ResetReason,
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
    /// The same, of the motor.
    RefusedMotor {
        /// The value that shows it.
        name: MotorName,
    },
}

/// Whether a device gives torque.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum State {
    /// It does not.
    Disarmed,
    /// It renders.
    Armed,
    /// It does not, and will not until it is cleared.
    Fault(Fault),
    /// It measures its motor.
    Calibrating,
    /// It gives a torque without a spring.
    Pushing,
}

/// What put torque to zero.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
    /// A current tick was not done before the next was due.
    CurrentOverrun,
    /// The gate driver reported a fault, or does not hold what was written to it.
    GateDriver,
    /// A current beyond what is safe.
    OverCurrent {
        /// The current, A.
        current_a: f32,
    },
    /// The current converters cannot be believed: at an end of their range, or currents that do not add up.
    CurrentSense,
    /// The bus voltage is too high.
    OverVoltage {
        /// The voltage, V.
        bus_v: f32,
    },
    /// The bus voltage is too low.
    UnderVoltage {
        /// The voltage, V.
        bus_v: f32,
    },
    /// The switches are too hot, or their sensor does not answer.
    OverTemperature {
        /// The temperature, °C.
        temperature_c: f32,
    },
    /// The knob turns faster than it may.
    OverSpeed {
        /// The speed, rad/s.
        speed_rad_s: f32,
    },
    /// The count does not follow the motor.
    Encoder,
    /// A push or a calibration went further than it may.
    Guard,
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
    /// This board has no power stage.
    NoPowerStage,
    /// The motor is not known yet: calibrate, or set it.
    NoMotor,
    /// A value of the motor is out of range, or not a number.
    MotorValue {
        /// Which.
        name: MotorName,
        /// What was given.
        given: f32,
        /// The least that is accepted.
        lowest: f32,
        /// The most.
        highest: f32,
    },
    /// A push is out of range, or not a number.
    Push,
    /// An excitation is out of range, or not a number.
    Excitation,
    /// Where the encoder's zero is, is not known since the start: calibrate, or set `zero_turns`.
    NoZero,
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
    /// A window of an excitation is over.
    Measured(Sums),
    /// An excitation is over; the bridge is off.
    Calibrated {
        /// How it ended.
        end: ExcitationEnd,
    },
}
