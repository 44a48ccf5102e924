//! A terminal without a window: what a program draws on it, as text.

use std::os::fd::OwnedFd;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::{read, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Termios, Winsize, tcgetattr, tcsetwinsize};

const COLUMNS: usize = 100;
const ROWS: usize = 30;

/// A terminal in which `knob` runs.
pub struct Terminal {
    master: OwnedFd,
    slave: OwnedFd,
    before: Termios,
    child: Child,
    bytes: Vec<u8>,
}

impl Terminal {
    /// Runs `knob` in a new terminal, which is the one that it is controlled from.
    pub fn run(args: &[&str]) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC);
        let master = master.unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, Vec::new()).unwrap();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = open(&path, flags, Mode::empty()).unwrap();
        let size = Winsize {
            ws_row: ROWS as u16,
            ws_col: COLUMNS as u16,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        tcsetwinsize(&slave, size).unwrap();
        fcntl_setfl(&master, OFlags::NONBLOCK).unwrap();
        let child = Command::new("setsid")
            .args(["--ctty", env!("CARGO_BIN_EXE_knob")])
            .args(args)
            .env_remove("KNOB_PORT")
            .env("TERM", "xterm")
            .stdin(Stdio::from(slave.try_clone().unwrap()))
            .stdout(Stdio::from(slave.try_clone().unwrap()))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self {
            before: tcgetattr(&slave).unwrap(),
            master,
            slave,
            child,
            bytes: Vec::new(),
        }
    }

    /// Types.
    pub fn keys(&self, keys: &str) {
        assert_eq!(write(&self.master, keys.as_bytes()), Ok(keys.len()));
    }

    pub fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let kill = Command::new("kill")
            .args([&format!("-{name}"), &id])
            .status();
        assert!(kill.unwrap().success());
    }

    /// Waits until the screen shows this. Not for ever: the limit is there to end a test that hangs.
    pub fn until(&mut self, text: &str) {
        for _ in 0..6000 {
            self.take();
            if self.text().contains(text) {
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("`{text}` never came:\n{}", self.text());
    }

    /// Waits for the end, and makes sure that the terminal is as it was. Returns what was said on standard error.
    pub fn end(mut self) -> (ExitStatus, String) {
        for _ in 0..6000 {
            self.take();
            if self.child.try_wait().unwrap().is_some() {
                self.take();
                let text = self.text();
                let last = |sequence: &[u8]| {
                    let mut all = self.bytes.windows(sequence.len());
                    all.rposition(|window| window == sequence)
                };
                let entered = last(b"\x1b[?1049h").expect("there was a screen");
                assert!(
                    last(b"\x1b[?1049l") > Some(entered),
                    "the screen stays:\n{text}"
                );
                assert!(
                    last(b"\x1b[?25h") > last(b"\x1b[?25l"),
                    "no cursor:\n{text}"
                );
                let now = tcgetattr(&self.slave).unwrap();
                assert_eq!(format!("{now:?}"), format!("{:?}", self.before));
                let output = self.child.wait_with_output().unwrap();
                return (output.status, String::from_utf8(output.stderr).unwrap());
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.child.kill().unwrap();
        panic!("hung:\n{}", self.text());
    }

    fn take(&mut self) {
        let mut buffer = [0; 4096];
        while let Ok(count @ 1..) = read(&self.master, &mut buffer) {
            self.bytes.extend_from_slice(&buffer[..count]);
        }
    }

    /// What stands on the screen: of the control sequences only the cursor's place means something here.
    fn text(&self) -> String {
        let mut screen = vec![vec![' '; COLUMNS]; ROWS];
        let (mut row, mut column) = (0, 0);
        let all = String::from_utf8_lossy(&self.bytes);
        let mut letters = all.chars().peekable();
        while let Some(letter) = letters.next() {
            if letter == '\x1b' && letters.next_if_eq(&'[').is_some() {
                let mut numbers = String::new();
                while let Some(next) = letters.next_if(|next| !next.is_ascii_alphabetic()) {
                    numbers.push(next);
                }
                if letters.next() == Some('H') {
                    let mut places = numbers.split(';').map(|it| it.parse().unwrap_or(1) - 1);
                    (row, column) = (places.next().unwrap_or(0), places.next().unwrap_or(0));
                }
            } else if !letter.is_control() {
                if let Some(cell) = screen.get_mut(row).and_then(|line| line.get_mut(column)) {
                    *cell = letter;
                }
                column += 1;
            }
        }
        let lines: Vec<String> = screen.iter().map(|line| line.iter().collect()).collect();
        lines.join("\n")
    }
}
