//! Which port the knob is on.

use std::path::Path;

use anyhow::{Result, bail};
use serde::Serialize;
use serialport::SerialPortType;

use crate::device::{Device, Identity};
use crate::emulators;

/// How every command with a board finds it, and how it prints.
#[derive(clap::Args)]
pub struct Connection {
    /// The serial port [default: the only one that `knob ports` lists]
    #[arg(long, value_name = "PATH", env = "KNOB_PORT")]
    port: Option<String>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

impl Connection {
    /// The knob on the port that was picked, or on the only one there is.
    pub fn connect(&self) -> Result<(Device, Identity)> {
        match self.port.as_deref() {
            Some(path) if !path.is_empty() => Device::connect(path),
            _ => Device::connect(only(&candidates())?),
        }
    }
}

/// A port that may be a knob's.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Candidate {
    /// Where it is.
    pub port: String,
    /// What it is.
    pub kind: Kind,
    /// What it calls itself.
    pub product: Option<String>,
    /// Who made it.
    pub manufacturer: Option<String>,
    /// Its serial number.
    pub serial_number: Option<String>,
}

/// What a port is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// On USB.
    Usb,
    /// An emulator's.
    Emulated,
}

impl Candidate {
    /// What is known of it, in words.
    pub fn description(&self) -> String {
        let kind = match self.kind {
            Kind::Usb => "USB",
            Kind::Emulated => "emulated",
        };
        let known = [&self.manufacturer, &self.product, &self.serial_number];
        let mut words: Vec<&str> = vec![kind];
        words.extend(known.into_iter().flatten().map(String::as_str));
        words.join(", ")
    }
}

/// All ports that may be a knob's: those on USB, then those of emulators.
pub fn candidates() -> Vec<Candidate> {
    let mut all = usb();
    all.extend(emulators::running().iter().map(|path| Candidate {
        port: path.display().to_string(),
        kind: Kind::Emulated,
        product: None,
        manufacturer: None,
        serial_number: None,
    }));
    all
}

fn usb() -> Vec<Candidate> {
    // Without this folder, as in some containers, `available_ports` panics.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").is_dir() {
        return Vec::new();
    }
    let mut ports: Vec<Candidate> = serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        // macOS lists each port twice; opening this one waits for a modem.
        .filter(|port| !(cfg!(target_os = "macos") && port.port_name.starts_with("/dev/tty.")))
        .filter_map(|port| match port.port_type {
            SerialPortType::UsbPort(info) => Some(Candidate {
                port: port.port_name,
                kind: Kind::Usb,
                product: info.product,
                manufacturer: info.manufacturer,
                serial_number: info.serial_number,
            }),
            _ => None,
        })
        .collect();
    ports.sort_by(|a, b| a.port.cmp(&b.port));
    ports
}

/// The only candidate.
fn only(candidates: &[Candidate]) -> Result<&str> {
    match candidates {
        [one] => Ok(&one.port),
        [] => bail!(
            "no knob is there: no serial port on USB, and no emulator is running; plug one in, start `knob emulate`, or name its port with --port or KNOB_PORT"
        ),
        several => {
            let list: Vec<String> = several
                .iter()
                .map(|one| format!("{} ({})", one.port, one.description()))
                .collect();
            bail!(
                "{} ports may be the knob's: {}; pick one with --port or KNOB_PORT",
                several.len(),
                list.join("; ")
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(port: &str, kind: Kind) -> Candidate {
        Candidate {
            port: port.into(),
            kind,
            product: (kind == Kind::Usb).then(|| "Knob".into()),
            manufacturer: None,
            serial_number: None,
        }
    }

    #[test]
    fn one_candidate_is_taken_and_several_are_listed() {
        let (a, b) = (
            candidate("/dev/ttyACM0", Kind::Usb),
            candidate("/dev/pts/7", Kind::Emulated),
        );
        assert_eq!(only(std::slice::from_ref(&a)).unwrap(), "/dev/ttyACM0");
        let said = only(&[a, b]).unwrap_err().to_string();
        for part in [
            "/dev/ttyACM0 (USB, Knob)",
            "/dev/pts/7 (emulated)",
            "--port",
            "KNOB_PORT",
        ] {
            assert!(said.contains(part), "`{part}` is missing in: {said}");
        }
        let said = only(&[]).unwrap_err().to_string();
        assert!(said.contains("knob emulate") && said.contains("--port"));
    }
}
