//! What the controller of a simulated run decided, in words.

use control::config::Law;
use control::tick::Reason;
use protocol::ClampReason;

use crate::words;

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
    words::clamp_code(clamp_reason(reason))
}

/// Why less is applied than demanded, in words.
pub fn words(reason: Reason) -> &'static str {
    words::clamp(clamp_reason(reason))
}

/// The same reason as a device says it.
fn clamp_reason(reason: Reason) -> ClampReason {
    match reason {
        Reason::None => ClampReason::None,
        Reason::Viscous => ClampReason::Viscous,
        Reason::Coulomb => ClampReason::Coulomb,
        Reason::Speed => ClampReason::Speed,
        Reason::ZeroForce => ClampReason::ZeroForce,
        Reason::Torque => ClampReason::Torque,
        Reason::Inertia => ClampReason::Inertia,
        Reason::Coarse => ClampReason::Coarse,
        Reason::Account => ClampReason::Account,
        Reason::Hand => ClampReason::Hand,
    }
}
