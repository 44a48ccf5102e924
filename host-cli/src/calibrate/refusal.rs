//! Why a motor was not calibrated.

/// A phase of the bridge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// The first.
    A,
    /// The second, whose current is measured.
    B,
    /// The third, whose current is measured.
    C,
}

/// What was wrong, with the value that shows it, and what would be accepted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// A told value makes no sense.
    #[error("{name} is {value}; accepted: {accepted}")]
    Told {
        /// Which.
        name: &'static str,
        /// What was told.
        value: f64,
        /// What would do.
        accepted: String,
    },
    /// A converter reads a current where there is no voltage.
    #[error(
        "a current converter reads more than {limit_a:.1} A without voltage: it is stuck, its amplifier is broken, or the knob is being turned fast"
    )]
    CurrentWithoutVoltage {
        /// The most that can be measured, A.
        limit_a: f64,
    },
    /// An offset beyond that of a good board.
    #[error(
        "the converter of phase {phase:?} reads code {code:.0} without current; accepted: {least:.0} to {most:.0}. Its amplifier is broken, or not calibrated for this gain"
    )]
    Offset {
        /// Which.
        phase: Phase,
        /// Its mean code.
        code: f64,
        /// The least that a good board has.
        least: f64,
        /// The most.
        most: f64,
    },
    /// Noise that leaves no room below the limit.
    #[error(
        "currents are noisy by ± {noise_a:.2} A, too much for a limit of {current_max_a} A; accepted: a limit of {least_a:.1} A or more, or less noise (wiring, ground)"
    )]
    Noise {
        /// Three standard deviations, A.
        noise_a: f64,
        /// The limit told, A.
        current_max_a: f64,
        /// A limit that would do, A.
        least_a: f64,
    },
    /// Somebody turns the knob.
    #[error(
        "the knob moved by {counts:.0} counts without voltage; keep hands off, and let it come to rest"
    )]
    Moving {
        /// How far.
        counts: f64,
    },
    /// Nothing flows.
    #[error(
        "no current flows at {volts:.1} V in any phase: the motor is not connected, two of its wires are open, or its resistance is beyond what the shunts resolve"
    )]
    NoCurrent {
        /// The largest voltage tried, V.
        volts: f64,
    },
    /// A phase without current.
    #[error(
        "no current flows in phase {phase:?} at {volts:.1} V, but in the others: it is unplugged or broken"
    )]
    Unplugged {
        /// Which.
        phase: Phase,
        /// The voltage tried, V.
        volts: f64,
    },
    /// A converter that does not change.
    #[error(
        "the current converter of phase {phase:?} stands at code {code:.0} while {current_a:.2} A flow: it is stuck"
    )]
    Stuck {
        /// Which.
        phase: Phase,
        /// Where it stands.
        code: f64,
        /// What flows, A.
        current_a: f64,
    },
    /// A current that voltage does not explain.
    #[error(
        "a voltage of {volts:.2} V already drives more than the limit of {current_max_a} A: two phases are shorted, or the resistance is below what this board resolves (about {least_ohm:.3} Ω)"
    )]
    Short {
        /// The voltage, V.
        volts: f64,
        /// The limit, A.
        current_max_a: f64,
        /// The resistance at which it would be, Ω.
        least_ohm: f64,
    },
    /// Phases that differ.
    #[error(
        "the phases have {:.4}, {:.4} and {:.4} Ω; accepted: within {:.0} % of each other. A bad contact or a damaged winding",
        ohm[0], ohm[1], ohm[2], 100.0 * accepted
    )]
    Unequal {
        /// Of A, B, C, Ω.
        ohm: [f64; 3],
        /// The spread accepted, as a part of the mean.
        accepted: f64,
    },
    /// A value that could not be found with any use.
    #[error("{name} lies between {low:.3e} and {high:.3e}, which is too vague; {advice}")]
    Vague {
        /// Which, with its unit.
        name: &'static str,
        /// The least it can be.
        low: f64,
        /// The most.
        high: f64,
        /// What would help.
        advice: &'static str,
    },
    /// The count never changed.
    #[error(
        "the count never changed while the field turned: the encoder is not connected, or the shaft is blocked"
    )]
    NoMotion,
    /// The count goes back and forth.
    #[error(
        "the count only went back and forth by {counts} while the field turned: one channel of the encoder is dead, or the shaft is blocked"
    )]
    Toggles {
        /// From the least to the most.
        counts: i64,
    },
    /// The rotor stays behind.
    #[error(
        "the knob does not follow the field: it leaves its line by up to {turns:.2} electrical turns. Friction, cogging or a hand hold it; accepted: a knob that {current_a:.1} A can turn, or a larger --current-max"
    )]
    Follows {
        /// Electrical turns.
        turns: f64,
        /// The current that turned it, A.
        current_a: f64,
    },
    /// More one way than back.
    #[error(
        "the count moved by {there:.0} forth and {back:.0} back for the same turns: the encoder slips on the shaft or loses counts"
    )]
    Slips {
        /// Counts forth.
        there: f64,
        /// Counts back.
        back: f64,
    },
    /// The zero of the encoder is no longer where it was.
    #[error(
        "the encoder's zero was off by {turns:.2} electrical turns when the field turned fast: the encoder slips on the shaft or loses counts"
    )]
    ZeroMoved {
        /// How far.
        turns: f64,
    },
    /// A part of a pole pair.
    #[error(
        "the count moved as with {pole_pairs:.2} pole pairs, which is no whole number: the encoder slips, or {counts_per_rev} counts in a turn are wrong"
    )]
    NotWhole {
        /// What was measured.
        pole_pairs: f64,
        /// What was told.
        counts_per_rev: u32,
    },
    /// Another number than told.
    #[error(
        "the motor has {measured} pole pairs by the encoder, but {told} were told: a wrong count of poles (pairs, not poles), or {counts_per_rev} counts in a turn are wrong"
    )]
    PolePairs {
        /// What was measured.
        measured: u32,
        /// What was told.
        told: u32,
        /// What was told.
        counts_per_rev: u32,
    },
    /// Torque constant and Kv disagree.
    #[error(
        "back-EMF gives {measured:.0} rpm/V ({low:.0} to {high:.0}), but {told:.0} were told: a wrong Kv, pole count or count of the encoder, or magnets that lost their strength"
    )]
    Kv {
        /// By back-EMF, rpm/V.
        measured: f64,
        /// The least it can be.
        low: f64,
        /// The most.
        high: f64,
        /// What was told.
        told: f64,
    },
    /// A brushed motor at the wrong phases.
    #[error(
        "the motor is wired between phases A and {other:?}; accepted: between B and C, whose currents are measured"
    )]
    BrushedAt {
        /// The other phase.
        other: Phase,
    },
    /// Currents of B and C that do not cancel.
    #[error(
        "currents of {b_a:.2} A in B and {c_a:.2} A in C do not add up to 0: something is connected to phase A (a three-phase motor?), or a converter is wrong"
    )]
    Sum {
        /// Of B, A.
        b_a: f64,
        /// Of C, A.
        c_a: f64,
    },
    /// A single-phase path where three were told.
    #[error(
        "current flows from B to C only: a brushed motor between them, or phase A is unplugged"
    )]
    OnlyBToC,
    /// The bus.
    #[error(
        "the bus voltage left {least_v:.1} to {most_v:.1} V during {step}: the supply is too weak, or braking raises it"
    )]
    Bus {
        /// The least accepted, V.
        least_v: f64,
        /// The most accepted, V.
        most_v: f64,
        /// During what.
        step: &'static str,
    },
    /// A current beyond the limit.
    #[error(
        "a current went beyond {current_max_a} A during {step}, and the bridge was turned off; accepted: a larger --current-max, if the motor bears it"
    )]
    Current {
        /// The limit, A.
        current_max_a: f64,
        /// During what.
        step: &'static str,
    },
    /// Too fast.
    #[error(
        "the knob went faster than {rad_s:.0} rad/s during {step}, and the bridge was turned off; is it the told motor, with its knob on?"
    )]
    Speed {
        /// The limit, rad/s.
        rad_s: f64,
        /// During what.
        step: &'static str,
    },
    /// Not by itself.
    #[error("the device broke off during {step}: {why}")]
    BrokenOff {
        /// During what.
        step: &'static str,
        /// Why.
        why: &'static str,
    },
    /// Windows got lost on the line.
    #[error(
        "{missing} of {of} windows got lost on the line during {step}; try again, or look at the cable"
    )]
    Lost {
        /// How many.
        missing: usize,
        /// Of how many.
        of: usize,
        /// During what.
        step: &'static str,
    },
}
