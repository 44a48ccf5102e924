//! `cargo xtask`: what a newcomer and CI call.
//!
//! `demo` runs the firmware in an emulator against the exact plant and tells what happens; `test`
//! runs everything that must pass. Each installs what it lacks first, and says so.
#![forbid(unsafe_code)]

mod firmware;
mod peers;
mod tools;

use std::process::ExitCode;

use anyhow::Result;
use clap::Parser;
use tools::{cargo, run};

/// Set-up, firmware, demo, figures and tests of this workspace.
#[derive(Parser)]
#[command(bin_name = "cargo xtask")]
enum Task {
    /// Install what is missing for everything below, and say what
    Setup,
    /// Build the firmware for every board, to target/firmware/
    Firmware,
    /// Run the firmware in the emulator against the exact plant, and tell what happens
    Demo {
        /// Leave the device running for `knob` from another terminal, until Ctrl-C
        #[arg(long)]
        hold: bool,
        /// Print the figures as one JSON object
        #[arg(long)]
        json: bool,
    },
    /// Compute the paper's figures and write them to target/figures/
    Figures,
    /// Measure and draw where methods fail, and write docs/where-methods-fail.md
    Failures,
    /// Run the random campaigns and the search for violations in full, and keep their state in target/campaign/
    Campaign,
    /// Take each part out of the energy ledger in turn, and write docs/ablation.md
    Ablation,
    /// Measure MuJoCo and SciPy beside the exact map, in about six minutes, and write docs/peers.md and docs/peers.csv
    Peers,
    /// Run every test, those of the firmware in the emulator too
    Test,
    /// Measure flash, RAM, stack and the tick's instructions, and write firmware/size.txt
    Size,
    /// Formatting, clippy without warnings, documentation without warnings
    Check,
}

fn main() -> ExitCode {
    let done = match Task::parse() {
        Task::Setup => setup(),
        Task::Firmware => firmware::build(),
        Task::Demo { hold, json } => demo(hold, json),
        Task::Figures => knob(&["figures", "--out", "target/figures", "--force"]),
        Task::Failures => knob(&["failures", "--out", "docs/where-methods-fail", "--force"]),
        Task::Campaign => campaign(),
        Task::Ablation => knob(&[
            "ablation",
            "--runs",
            "3000",
            "--out",
            "docs/ablation",
            "--force",
        ]),
        Task::Peers => peers::peers(),
        Task::Test => test(),
        Task::Size => size(),
        Task::Check => check(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn setup() -> Result<()> {
    tools::rust_component("fmt", "rustfmt")?;
    tools::rust_component("clippy", "clippy")?;
    tools::program("qemu-system-arm", &["qemu-system-arm"])?;
    firmware::toolchain()?;
    eprintln!("xtask: all that is needed is there");
    Ok(())
}

/// Runs the `knob` of this workspace.
fn knob(arguments: &[&str]) -> Result<()> {
    let knob = [
        "run",
        "--quiet",
        "--release",
        "-p",
        "host-cli",
        "--bin",
        "knob",
        "--",
    ];
    run(cargo().args(knob).args(arguments))
}

fn demo(hold: bool, json: bool) -> Result<()> {
    tools::program("qemu-system-arm", &["qemu-system-arm"])?;
    firmware::build()?;
    let mut arguments = vec!["demo", "--out", "target/demo", "--force"];
    arguments.extend(hold.then_some("--hold"));
    arguments.extend(json.then_some("--json"));
    knob(&arguments)
}

/// Goes on where it was stopped. All of it is run, whatever fails.
fn campaign() -> Result<()> {
    std::fs::create_dir_all("target/campaign")?;
    let mut done = Ok(());
    for law in ["auto", "ledger"] {
        let state = format!("target/campaign/{law}.json");
        let common = ["campaign", "--law", law, "--state", &state];
        for more in [&[][..], &["--search", "200000"]] {
            done = done.and(knob(&[&common[..], more].concat()));
        }
    }
    done
}

fn test() -> Result<()> {
    tools::program("qemu-system-arm", &["qemu-system-arm"])?;
    firmware::build()?;
    run(cargo().args([
        "test",
        "--workspace",
        "--features",
        "acceptance/emulator,host-cli/emulator",
    ]))
}

fn size() -> Result<()> {
    tools::program("qemu-system-arm", &["qemu-system-arm"])?;
    firmware::build()?;
    let test = [
        "test",
        "-p",
        "acceptance",
        "--features",
        "emulator",
        "--test",
        "firmware_cost",
        "size",
    ];
    run(cargo()
        .env("KNOB_WRITE_SIZE", "1")
        .args(test)
        .args(["--", "--nocapture"]))
}

fn check() -> Result<()> {
    tools::rust_component("fmt", "rustfmt")?;
    tools::rust_component("clippy", "clippy")?;
    run(cargo().args(["fmt", "--all", "--check"]))?;
    let everything = [
        "--workspace",
        "--all-targets",
        "--features",
        "acceptance/emulator,host-cli/emulator",
    ];
    run(cargo()
        .arg("clippy")
        .args(everything)
        .args(["--", "-D", "warnings"]))?;
    // `knob flash` has two forms.
    let flash = ["-p", "host-cli", "--all-targets", "--features", "flash"];
    run(cargo()
        .arg("clippy")
        .args(flash)
        .args(["--", "-D", "warnings"]))?;
    run(cargo()
        .env("RUSTDOCFLAGS", "-D warnings")
        .args(["doc", "--workspace", "--no-deps"]))
}
