//! The constants of the energy ledger, and its parts, so that each can be taken out.

/// J: how many ticks back the velocity interval looks.
pub const TICKS_BACK: usize = if cfg!(feature = "four-ticks-back") {
    4
} else {
    8
};

/// The constants and the parts of the [ledger](crate::ledger). They are fixed at build time,
/// but for studies (feature `tuning`), which carry them in the plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tuning {
    /// η: the share of the friction that is credited.
    pub credit: f32,
    /// K ≤ this × m/Te².
    pub inertia_cap: f32,
    /// K ≤ this × c/Δ.
    pub coulomb_cap: f32,
    /// What is left of the hand's acceleration after a tick.
    pub hand_decay: f32,
    /// How the hand's acceleration grows where the counts contradict it.
    pub hand_growth: f32,
    /// How many ticks back the velocity interval looks, up to [`TICKS_BACK`].
    pub ticks_back: usize,
    /// The limit L.
    pub limit: bool,
    /// The position interval; else the whole cell.
    pub position: bool,
    /// The charge for changing the torque where the position is uncertain.
    pub charge: bool,
    /// No credit is carried out of contact or through a minimum.
    pub no_carry: bool,
    /// The count in d − Δ.
    pub count_margin: bool,
    /// The cap on the stiffness.
    pub cap: bool,
    /// The credit for friction.
    pub friction: bool,
    /// A torque that holds the knob may stay.
    pub holding: bool,
    /// The hand's acceleration adapts.
    pub hand: bool,
}

impl Tuning {
    /// As built into the firmware.
    pub const DEFAULT: Self = Self {
        credit: 0.75,
        inertia_cap: 1.0,
        coulomb_cap: 3.0,
        hand_decay: 0.996,
        hand_growth: 2.0,
        ticks_back: TICKS_BACK,
        limit: true,
        position: true,
        charge: true,
        no_carry: true,
        count_margin: true,
        cap: true,
        friction: true,
        holding: true,
        hand: true,
    };
}
