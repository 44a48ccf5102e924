//! The RTIC applications for the STM32F405, one for each kind of board. See `docs/firmware.md`.
//!
//! On the host this binary is a stub, so that the workspace can be checked as a whole.
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

#[cfg(all(target_os = "none", feature = "emulator"))]
#[path = "app/amplifier.rs"]
mod application;

#[cfg(all(target_os = "none", feature = "emulator"))]
#[path = "board/emulated.rs"]
mod board;

#[cfg(all(
    target_os = "none",
    any(feature = "emulated-drive", feature = "odrive-v3")
))]
#[path = "app/power_stage.rs"]
mod application;

#[cfg(all(target_os = "none", feature = "emulated-drive"))]
#[path = "board/emulated_drive.rs"]
mod board;

#[cfg(all(target_os = "none", feature = "odrive-v3"))]
#[path = "board/odrive_v3.rs"]
mod board;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program runs on the chip: build it with `cargo xtask firmware`");
}
