//! What the acceptance tests share: the firmware run natively, and beside its image in the
//! emulator.
#![forbid(unsafe_code)]

mod flash;
#[cfg(unix)]
mod powered_rig;
pub mod powered_twin;
#[cfg(unix)]
mod rig;
pub mod systematic;
mod twin;

pub use flash::{Cut, Flash, PowerCut, Random};
#[cfg(unix)]
pub use powered_rig::PoweredRig;
#[cfg(unix)]
pub use rig::Rig;
pub use twin::{Answer, Twin, answers, request_frame};
