//! Hands the linker its scripts, the program the hash of its source, and the image the name of its board.
//!
//! The scripts go from here and not through `rustflags` in `.cargo/config.toml`, because a
//! RUSTFLAGS in the environment would silently replace those.

use std::path::PathBuf;
use std::process::Command;
use std::{env, fs};

fn main() {
    println!("cargo:rerun-if-changed=../memory.x");
    println!("cargo:rerun-if-changed=../.git/HEAD");
    println!("cargo:rerun-if-changed=../.git/refs/heads");
    let hash = Command::new("git")
        .args(["rev-parse", "--short=12", "HEAD"])
        .output();
    let hash = hash.ok().filter(|output| output.status.success());
    let hash = hash.and_then(|output| String::from_utf8(output.stdout).ok());
    println!(
        "cargo:rustc-env=GIT_HASH={}",
        hash.as_deref().unwrap_or("unknown").trim()
    );

    // Not `cfg!`: a build script is compiled for the host.
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::copy("../memory.x", out.join("memory.x")).expect("memory.x lies at the root");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-arg-bins=-Tlink.x"); // cortex-m-rt
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    println!("cargo:rustc-link-arg-bins=--nmagic"); // sections need not lie on pages
    // A symbol that takes no room, by which `knob flash` knows which board an image is for.
    println!(
        "cargo:rustc-link-arg-bins=--defsym=knob_board_{}=0",
        board()
    );
}

/// The board, as `src/main.rs` chooses it.
fn board() -> &'static str {
    let on = |feature| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some();
    if on("ODRIVE_V3") {
        "odrive_v3"
    } else if on("EMULATED_DRIVE") {
        "emulated_drive"
    } else {
        "emulated"
    }
}
