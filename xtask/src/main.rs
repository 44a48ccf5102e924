//! `cargo xtask`: what a newcomer and CI call.
//!
//! `setup` installs what is missing and says so; `figures` writes the paper's figures to
//! `target/figures/`; `test` runs everything that must pass; `check` adds what CI asks
//! of the code itself. Each does the set-up it needs first.
#![forbid(unsafe_code)]

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use anyhow::{Context, Result, bail};
use clap::Parser;

/// Set-up, figures and tests of this workspace.
#[derive(Parser)]
#[command(bin_name = "cargo xtask")]
enum Task {
    /// Install what is missing for everything below, and say what
    Setup,
    /// Compute the paper's figures and write them to target/figures/
    Figures,
    /// Run every test
    Test,
    /// Formatting, clippy without warnings, documentation without warnings
    Check,
}

fn main() -> ExitCode {
    let done = match Task::parse() {
        Task::Setup => setup(),
        Task::Figures => figures(),
        Task::Test => test(),
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

fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).to_owned()
}

/// A command at the root of the workspace.
fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    command
}

/// The cargo that runs this task.
fn cargo() -> Command {
    command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Runs a command whose output the user sees; says what it is first.
fn run(command: &mut Command) -> Result<()> {
    let arguments: Vec<_> = command.get_args().map(OsStr::to_string_lossy).collect();
    let program = command.get_program().to_string_lossy();
    let name = Path::new(program.as_ref())
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy();
    let line = format!("{name} {}", arguments.join(" "));
    eprintln!("xtask: {line}");
    let status = command
        .status()
        .with_context(|| format!("cannot run `{line}`"))?;
    if !status.success() {
        bail!("`{line}` failed");
    }
    Ok(())
}

/// True if a command can be run and succeeds.
fn works(command: &mut Command) -> bool {
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}

/// The parts of the toolchain that `check` needs and a minimal Rust lacks.
const COMPONENTS: [&str; 2] = ["fmt", "clippy"];

fn setup() -> Result<()> {
    for tool in COMPONENTS {
        if works(cargo().args([tool, "--version"])) {
            eprintln!("xtask: cargo {tool} is there");
            continue;
        }
        let component = if tool == "fmt" { "rustfmt" } else { tool };
        eprintln!("xtask: cargo {tool} is missing: installing {component} with rustup");
        run(command("rustup").args(["component", "add", component]))?;
    }
    eprintln!("xtask: nothing else is needed");
    Ok(())
}

fn figures() -> Result<()> {
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
    run(cargo()
        .args(knob)
        .args(["figures", "--out", "target/figures", "--force"]))
}

fn test() -> Result<()> {
    run(cargo().args(["test", "--workspace"]))
}

fn check() -> Result<()> {
    setup()?;
    run(cargo().args(["fmt", "--all", "--check"]))?;
    run(cargo().args([
        "clippy",
        "--workspace",
        "--all-targets",
        "--",
        "-D",
        "warnings",
    ]))?;
    run(cargo()
        .env("RUSTDOCFLAGS", "-D warnings")
        .args(["doc", "--workspace", "--no-deps"]))
}
