//! Commands, and the installation of what they need.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

/// The root of the workspace.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).to_owned()
}

/// A command at the root of the workspace.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    command
}

/// The cargo that runs this task.
pub fn cargo() -> Command {
    command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Runs a command whose output the user sees; says what it is first.
pub fn run(command: &mut Command) -> Result<()> {
    let arguments: Vec<_> = command.get_args().map(OsStr::to_string_lossy).collect();
    let program = command.get_program().to_string_lossy();
    let name = Path::new(program.as_ref()).file_stem().unwrap_or_default();
    let line = format!("{} {}", name.to_string_lossy(), arguments.join(" "));
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
pub fn works(command: &mut Command) -> bool {
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}

/// Makes sure of a part of the Rust toolchain that a minimal one lacks.
pub fn rust_component(tool: &str, component: &str) -> Result<()> {
    if works(cargo().args([tool, "--version"])) {
        return Ok(());
    }
    eprintln!("xtask: cargo {tool} is missing: installing {component} with rustup");
    run(command("rustup").args(["component", "add", component]))
}

/// Makes sure of a program that Debian's packages bring.
pub fn program(name: &str, packages: &[&str]) -> Result<()> {
    if works(command(name).arg("--version")) {
        return Ok(());
    }
    eprintln!(
        "xtask: {name} is missing: installing {} with apt-get",
        packages.join(", ")
    );
    apt_install(packages).with_context(|| {
        format!(
            "{name} cannot be installed here; on another system install it by hand and try again"
        )
    })
}

/// Installs packages of Debian, as root or through sudo.
pub fn apt_install(packages: &[&str]) -> Result<()> {
    if !works(command("apt-get").arg("--version")) {
        bail!("there is no apt-get");
    }
    let root = works(command("sh").args(["-c", "test $(id -u) = 0"]));
    let apt_get = || {
        let mut apt_get = command(if root { "apt-get" } else { "sudo" });
        if !root {
            apt_get.arg("apt-get");
        }
        apt_get.env("DEBIAN_FRONTEND", "noninteractive");
        apt_get
    };
    let install = ["install", "-y", "-qq", "--no-install-recommends"];
    if run(apt_get().args(install).args(packages)).is_ok() {
        return Ok(());
    }
    // A fresh machine knows no packages yet.
    run(apt_get().args(["update", "-qq"]))?;
    run(apt_get().args(install).args(packages))
}
