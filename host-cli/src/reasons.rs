//! What the controller of a simulated run decided, in words.

use control::config::Law;
use control::tick::Reason;
use firmware::desk::clamp_reason;

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
