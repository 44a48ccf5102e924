//! Why a recording gives no answer.

/// What was wrong with a recording, and what would be accepted.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// A quantity that has to be above zero is not.
    #[error("{name} is {value}; accepted: a finite number above 0")]
    NotPositive {
        /// Which, with its unit.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// Too few counts to plan anything by.
    #[error(
        "within the angle limit of {angle_rad} rad the encoder has only {counts:.0} counts; accepted: {least:.0} or more. Are the counts per turn right?"
    )]
    TooCoarse {
        /// The limit, rad.
        angle_rad: f64,
        /// Counts within it.
        counts: f64,
        /// How many there have to be.
        least: f64,
    },
    /// A torque is no number.
    #[error("the torque of sample {row} is {value} Nm; accepted: a finite number")]
    NotFinite {
        /// Which sample, from 0.
        row: usize,
        /// What was given.
        value: f64,
    },
    /// Not even rests fit into it.
    #[error(
        "too short: {samples} samples; accepted: {least} or more ({least_s} s), with pushes, coast-downs and rests of 0.1 s between them"
    )]
    TooShort {
        /// How many there are.
        samples: usize,
        /// How many there have to be.
        least: usize,
        /// The same, s.
        least_s: f64,
    },
    /// Stuck, or a motor without torque.
    #[error(
        "the knob never moved: {counts} counts under up to {torque_nm:.3} Nm; accepted: {least} counts or more. Is it stuck or held, the motor or the encoder unplugged, or friction above the torque limit?"
    )]
    NeverMoved {
        /// From the least to the most count.
        counts: u32,
        /// The largest torque, Nm.
        torque_nm: f64,
        /// How many it has to be.
        least: i32,
    },
    /// How it was moving at first is not known.
    #[error(
        "the recording begins in motion or under torque; accepted: one that begins with 0.1 s at rest without torque"
    )]
    StartsInMotion,
    /// Cut off, or a knob that never stops.
    #[error(
        "the recording ends after {time_s:.3} s in motion or under torque: it was cut off, or the knob never came to rest; accepted: one that ends with 0.1 s at rest without torque"
    )]
    EndsInMotion {
        /// Its length, s.
        time_s: f64,
    },
    /// A hand.
    #[error(
        "the knob left its rest at {time_s:.3} s without torque: something else moved it; keep hands off the knob"
    )]
    MovedWithoutTorque {
        /// When, s.
        time_s: f64,
    },
    /// Torque and count have opposite signs.
    #[error("the knob moves against the torque ({against} pushes of {}): the sign of the torque or of the encoder is reversed", against + along)]
    Reversed {
        /// Pushes that moved it the other way.
        against: usize,
        /// Pushes that moved it their way.
        along: usize,
    },
    /// Friction and offset cannot be told apart.
    #[error(
        "only one direction: no push moved the {missing}; accepted: pushes in both directions, of 20 counts or more"
    )]
    OneDirection {
        /// The other.
        missing: &'static str,
    },
    /// Inertia and friction cannot be told apart.
    #[error(
        "no coast-down to rest with the {missing}; accepted: pushes in both directions after which the knob runs 10 counts or more without torque, and stops by itself"
    )]
    NoCoastDown {
        /// In which direction.
        missing: &'static str,
    },
    /// A torque that is limited cannot be told from a heavier knob.
    #[error(
        "all pushes are of one height, {least_nm:.2e} to {most_nm:.2e} Nm; accepted: steps of several heights, the highest 1.2 times the lowest or more"
    )]
    OneHeight {
        /// The lowest, Nm.
        least_nm: f64,
        /// The highest, Nm.
        most_nm: f64,
    },
    /// Counts jump.
    #[error(
        "the count jumps by {jump:.0} at {time_s:.3} s as no motion can: the encoder slips or loses counts"
    )]
    Slips {
        /// Counts beyond the motion there.
        jump: f64,
        /// When, s.
        time_s: f64,
    },
    /// Torque that nobody commanded.
    #[error(
        "the knob moves as under a constant torque of {torque_nm:.2e} Nm beside the commanded one: a hand pushes it, its weight is out of balance, or the torque has an offset"
    )]
    Pushed {
        /// That torque, Nm.
        torque_nm: f64,
    },
    /// Torque that was commanded but not given.
    #[error(
        "the motor gives about {limit_nm:.2e} Nm where {commanded_nm:.2e} Nm are commanded: its torque saturates; accepted: a recording with a lower torque limit"
    )]
    Saturates {
        /// What it gives at most, Nm.
        limit_nm: f64,
        /// What was commanded at most, Nm.
        commanded_nm: f64,
    },
    /// Something else than inertia and friction moves it.
    #[error(
        "no inertia, viscous and Coulomb friction explain the counts: the best miss by {misfit_counts:.1} counts, most near {time_s:.3} s; accepted: {accepted_counts:.1} or less. Something else acts: a hand on the knob, cogging, a slipping coupling, a delay, or a torque that is not as commanded"
    )]
    Unexplained {
        /// By how much beyond its own count, in counts.
        misfit_counts: f64,
        /// Where most, s.
        time_s: f64,
        /// How much would do.
        accepted_counts: f64,
    },
    /// All of it fits, and says next to nothing.
    #[error(
        "the recording leaves {name} between {low:.2e} and {high:.2e}; accepted: within a factor of 2. Push further, faster, or record with a finer encoder"
    )]
    Vague {
        /// What, with its unit.
        name: &'static str,
        /// At least.
        low: f64,
        /// At most.
        high: f64,
    },
}
