//! What the controller of a simulated run decided, in words.

use control::config::Law;
use control::tick::Reason;

/// A law, as scene files name it.
pub fn law(law: Law) -> &'static str {
    match law {
        Law::Raw => "raw",
        Law::Static => "static",
        Law::Episode => "episode",
        Law::Ledger => "ledger",
        Law::Auto => "auto",
    }
}

/// Why less is applied than demanded, in a word, as scripts see it.
pub fn code(reason: Reason) -> &'static str {
    match reason {
        Reason::None => "none",
        Reason::Viscous => "viscous",
        Reason::Coulomb => "coulomb",
        Reason::Speed => "speed",
        Reason::ZeroForce => "zero-force",
        Reason::Torque => "torque",
        Reason::Inertia => "inertia",
        Reason::Coarse => "coarse",
        Reason::Account => "account",
        Reason::Hand => "hand",
    }
}

/// Why less is applied than demanded, in words.
pub fn words(reason: Reason) -> &'static str {
    match reason {
        Reason::None => "the whole demand is applied",
        Reason::Viscous => "sampled too slowly for this viscous friction: 2b/Te",
        Reason::Coulomb => "encoder too coarse for this Coulomb friction: 2c/Δ",
        Reason::Speed => "too fast in this contact: 2(b|ẋ| + c)/(Te|ẋ| + Δ)",
        Reason::ZeroForce => "may rise only at zero force, and waits for it",
        Reason::Torque => "the torque limit",
        Reason::Inertia => "sampled too slowly for this inertia: m/Te²",
        Reason::Coarse => "encoder too coarse: 3c/Δ",
        Reason::Account => "the energy account covers no more",
        Reason::Hand => "a hand moves the knob as no believed force can",
    }
}
