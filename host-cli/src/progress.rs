//! A bar with the time left, on standard error, if that is a terminal.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `total` units of work, which it calls `what`.
pub fn bar(total: u64, what: &'static str) -> ProgressBar {
    let bar = ProgressBar::new(total).with_message(what);
    // The template is checked by a test; without it the default bar would do.
    if let Ok(style) = ProgressStyle::with_template(TEMPLATE) {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// A bar over runs, of which so many are done, with their rate.
pub fn runs(total: u64, done: u64, what: &'static str) -> ProgressBar {
    let bar = bar(total, what);
    if let Ok(style) = ProgressStyle::with_template(RUNS) {
        bar.set_style(style);
    }
    bar.with_position(done)
}

const RUNS: &str = "{msg} {bar:40} {percent:>3} %, {per_sec}, {eta} left";

const TEMPLATE: &str = "{msg} {bar:40} {percent:>3} %, {eta} left";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_template_is_one() {
        assert!(ProgressStyle::with_template(TEMPLATE).is_ok());
        assert!(ProgressStyle::with_template(RUNS).is_ok());
    }
}
