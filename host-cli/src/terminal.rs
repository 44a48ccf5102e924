//! The terminal as a screen, and as it was again in the end, however it ends.

use std::io::{self, Write as _};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use ratatui::DefaultTerminal;
use rustix::termios::{LocalModes, OptionalActions, SpecialCodeIndex, tcgetattr, tcsetattr};

/// True while the terminal is a screen.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The terminal as a screen until this is dropped; a panic, too, gives it back before it is told.
pub struct Screen(pub DefaultTerminal);

impl Screen {
    /// Takes the terminal behind standard output.
    ///
    /// # Errors
    /// Where it cannot be set up; it is as it was then.
    pub fn take() -> io::Result<Self> {
        TAKEN.store(true, Relaxed);
        // From here on dropping gives it back.
        let taken = ratatui::try_init().map(Self);
        let ready = taken.and_then(|screen| signals().map(|()| screen));
        if ready.is_err() {
            give_back();
        }
        ready
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        give_back();
    }
}

/// Has Ctrl-C stop the work at once, also while an answer is waited for; a stop by Ctrl-Z or Ctrl-\ would
/// leave the screen behind.
fn signals() -> io::Result<()> {
    let out = io::stdout();
    let mut mode = tcgetattr(&out)?;
    mode.local_modes |= LocalModes::ISIG;
    // No key.
    mode.special_codes[SpecialCodeIndex::VSUSP] = 0;
    mode.special_codes[SpecialCodeIndex::VQUIT] = 0;
    Ok(tcsetattr(&out, OptionalActions::Now, &mode)?)
}

/// Gives the terminal back, if it was taken.
pub fn give_back() {
    if TAKEN.swap(false, Relaxed) {
        // Where it is gone there is nothing to give back.
        let _ = ratatui::try_restore();
        let mut out = io::stdout();
        let _ = write!(out, "{}", ratatui::crossterm::cursor::Show);
        let _ = out.flush();
    }
}

#[cfg(test)]
mod tests {
    use std::process::{Command, Stdio};

    use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

    use super::*;

    /// Says to the test below, which this one runs once more, that it has a terminal to panic in.
    const PANIC: &str = "KNOB_TEST_PANIC";

    #[test]
    fn a_panic_gives_the_terminal_back_before_it_is_told() {
        if std::env::var_os(PANIC).is_some() {
            let _screen = Screen::take().unwrap();
            panic!("on purpose");
        }
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = open(&path, flags, Mode::empty()).unwrap();
        fcntl_setfl(&master, OFlags::NONBLOCK).unwrap();
        let before = format!("{:?}", tcgetattr(&slave).unwrap());
        let end = || Stdio::from(slave.try_clone().unwrap());
        let status = Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "terminal::tests::a_panic_gives_the_terminal_back_before_it_is_told",
            ])
            .args(["--nocapture", "--test-threads=1"])
            .env(PANIC, "1")
            .env("RUST_BACKTRACE", "0")
            .stdin(end())
            .stdout(end())
            .stderr(end())
            .status()
            .unwrap();
        assert!(!status.success());
        let mut said = Vec::new();
        let mut buffer = [0; 4096];
        while let Ok(count @ 1..) = rustix::io::read(&master, &mut buffer) {
            said.extend_from_slice(&buffer[..count]);
        }
        let said = String::from_utf8_lossy(&said);
        let place = |part: &str| {
            said.find(part)
                .unwrap_or_else(|| panic!("no {part:?} in {said:?}"))
        };
        assert!(place("\x1b[?1049h") < place("\x1b[?1049l"));
        assert!(place("\x1b[?1049l") < place("on purpose"));
        assert_eq!(format!("{:?}", tcgetattr(&slave).unwrap()), before);
    }
}
