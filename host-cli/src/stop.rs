//! How work ends other than by success: Ctrl-C, and bad usage that only shows later.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::{output, terminal};

static STOP: AtomicBool = AtomicBool::new(false);

/// The user stopped the work; the process exits with 130.
#[derive(Debug, thiserror::Error)]
#[error("stopped; nothing was written")]
pub struct Stopped;

/// The user stopped work that can go on; the process exits with 130.
#[derive(Debug, thiserror::Error)]
#[error("stopped; {0} holds what was done, and the same command goes on from there")]
pub struct Interrupted(pub String);

/// The user ended what ends no other way; the process exits with 130.
#[derive(Debug, thiserror::Error)]
#[error("ended")]
pub struct Ended;

/// Flags that do not go together or make no sense; the process exits with 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Usage(pub String);

/// From now on Ctrl-C (and a request to terminate) sets the flag instead of killing; a
/// second one ends the process at once.
pub fn listen() {
    // Where no handler can be set, Ctrl-C kills as it always does; files stay whole
    // all the same, since they are renamed into place.
    let _ = ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            terminal::give_back();
            output::remove_drafts();
            std::process::exit(130);
        }
    });
}

/// An error if the user asked to stop.
pub fn check() -> Result<(), Stopped> {
    if requested() { Err(Stopped) } else { Ok(()) }
}

/// Whether the user asked to stop.
pub fn requested() -> bool {
    STOP.load(Ordering::Relaxed)
}

/// The flag itself, for work in many threads.
pub fn flag() -> &'static AtomicBool {
    &STOP
}
