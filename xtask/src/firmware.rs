//! Building the firmware, by the first way that this machine has: rustup's target, rustup's target
//! after adding it, or Debian's own Rust with the core library from source.

use std::path::Path;

use anyhow::{Context, Result};

use crate::tools::{apt_install, cargo, command, root, run, works};

const TARGET: &str = "thumbv7em-none-eabihf";

/// What builds for the chip.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    Rustup,
    Debian,
}

/// Makes sure that something can build for the chip.
pub fn toolchain() -> Result<()> {
    way().map(|_| ())
}

fn way() -> Result<Way> {
    if has_target() {
        return Ok(Way::Rustup);
    }
    eprintln!("xtask: Rust's target {TARGET} is missing: adding it with rustup");
    if works(command("rustup").args(["target", "add", TARGET])) && has_target() {
        return Ok(Way::Rustup);
    }
    eprintln!(
        "xtask: rustup cannot add it: using Debian's Rust, with the core library from source"
    );
    if !works(command("/usr/bin/cargo").arg("--version"))
        || !works(command("ld.lld-19").arg("--version"))
        || !Path::new("/usr/lib/rustlib/src/rust/library/Cargo.toml").exists()
    {
        apt_install(&["rustc-web", "cargo-web", "rust-web-src", "lld-19"]).with_context(|| {
            format!("add the target with `rustup target add {TARGET}` and try again")
        })?;
    }
    Ok(Way::Debian)
}

/// True if the compiler in use has the target's libraries.
fn has_target() -> bool {
    let output = command("rustc")
        .args(["--print", "target-libdir", "--target", TARGET])
        .output();
    output.is_ok_and(|output| Path::new(String::from_utf8_lossy(&output.stdout).trim()).is_dir())
}

/// Builds the firmware for the emulated boards, once more with the ledger that looks four ticks back, and for the
/// motor-driver board.
pub fn build() -> Result<()> {
    let way = way()?;
    for (features, name) in [
        ("emulator,four-ticks-back", "emulated-four-ticks-back"),
        ("emulator", "emulated"),
        ("emulated-drive", "emulated_drive"),
        ("odrive-v3", "odrive_v3"),
    ] {
        build_image(&way, features, name)?;
    }
    Ok(())
}

fn build_image(way: &Way, features: &str, name: &str) -> Result<()> {
    let build = [
        "build",
        "--locked",
        "--release",
        "--target",
        TARGET,
        "-p",
        "firmware",
        "--no-default-features",
        "--features",
        features,
    ];
    let folder = match way {
        Way::Rustup => {
            run(cargo().env("DEFMT_LOG", "info").args(build))?;
            root().join("target")
        }
        Way::Debian => {
            let library = "/usr/lib/rustlib/src/rust/library/Cargo.toml";
            let debian = || {
                let mut cargo = command("/usr/bin/cargo");
                cargo
                    .env_remove("RUSTUP_TOOLCHAIN")
                    .env("RUSTC_BOOTSTRAP", "1")
                    .env("RUSTC", "/usr/bin/rustc")
                    .env("CARGO_TARGET_DIR", "target/debian")
                    .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld-19")
                    .env("DEFMT_LOG", "info");
                cargo
            };
            run(debian().args(["fetch", "--locked", "--manifest-path", library]))?;
            run(debian().args(build).arg("-Zbuild-std=core"))?;
            root().join("target/debian")
        }
    };
    let built = folder.join(TARGET).join("release/firmware");
    let place = root().join("target/firmware");
    std::fs::create_dir_all(&place)?;
    let image = place.join(format!("{name}.elf"));
    std::fs::copy(&built, &image).with_context(|| format!("cannot copy {}", built.display()))?;
    eprintln!("xtask: built target/firmware/{name}.elf");
    Ok(())
}
