//! What the peers need: a virtual environment with MuJoCo and SciPy, a C compiler, three programs.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use super::Program;
use crate::tools::{self, apt_install, cargo, command, root, run, works};

/// Where the programs are.
pub struct Place {
    ours: PathBuf,
    c: PathBuf,
    python: PathBuf,
}

impl Place {
    /// The command that starts a program, on one core if it is given.
    pub fn command(&self, program: Program, core: Option<usize>) -> Command {
        let mut words = Vec::new();
        match program {
            Program::Ours => words.push(self.ours.clone()),
            Program::C => words.push(self.c.clone()),
            Program::Python => {
                words.push(self.python.clone());
                words.push(sources().join("peers.py"));
            }
        }
        let mut started = match core {
            Some(core) => {
                let mut taskset = command("taskset");
                taskset.args(["-c", &core.to_string()]).arg(&words[0]);
                taskset
            }
            None => command(&words[0]),
        };
        started
            .args(&words[1..])
            // One core means one thread.
            .env("OMP_NUM_THREADS", "1")
            .env("OPENBLAS_NUM_THREADS", "1");
        started
    }
}

fn sources() -> PathBuf {
    root().join("xtask/peers")
}

/// Installs and builds all of it, in target/peers/.
pub fn all() -> Result<Place> {
    let target = root().join("target/peers");
    fs::create_dir_all(&target)?;
    tools::program("cc", &["gcc", "libc6-dev"])?;
    let python = environment(&target)?;
    let c = driver(&python, &target)?;
    let build = ["build", "--locked", "--release", "-p", "plant-sim"];
    run(cargo()
        .args(build)
        .args(["--example", "peer", "--target-dir", "target"]))?;
    Ok(Place {
        ours: root().join("target/release/examples/peer"),
        c,
        python,
    })
}

/// The Python of the virtual environment, which is made afresh unless it holds just what
/// requirements.txt wants.
fn environment(target: &Path) -> Result<PathBuf> {
    let venv = target.join("venv");
    let python = venv.join("bin/python");
    let requirements = sources().join("requirements.txt");
    let wanted = fs::read_to_string(&requirements)?;
    let installed = venv.join("installed.txt");
    if fs::read_to_string(&installed).is_ok_and(|have| have == wanted)
        && works(command(&python).arg("--version"))
    {
        return Ok(python);
    }
    tools::program("python3", &["python3", "python3-venv"])?;
    if !works(command("python3").args(["-c", "import venv, ensurepip"])) {
        eprintln!("xtask: python3 cannot make virtual environments: installing python3-venv");
        apt_install(&["python3-venv"])
            .context("install the modules venv and ensurepip of your Python and try again")?;
    }
    run(command("python3")
        .args(["-m", "venv", "--clear"])
        .arg(&venv))?;
    let quiet = ["--quiet", "--disable-pip-version-check", "--retries", "2"];
    run(command(&python)
        .args(["-m", "pip", "install"])
        .args(quiet)
        .args(["--only-binary", ":all:", "--requirement"])
        .arg(&requirements))
    .context(
        "pip cannot install MuJoCo and SciPy; it needs the network, Python 3.11 or newer and \
         a machine for which they are built: mend that and try again",
    )?;
    fs::write(installed, wanted)?;
    Ok(python)
}

/// Compiles peer.c against the C library that ships inside MuJoCo's wheel.
fn driver(python: &Path, target: &Path) -> Result<PathBuf> {
    let script =
        "import importlib.util as u; print(u.find_spec('mujoco').submodule_search_locations[0])";
    let output = command(python).args(["-c", script]).output()?;
    if !output.status.success() {
        bail!("MuJoCo is not in target/peers/venv: delete that folder and try again");
    }
    let mujoco = PathBuf::from(String::from_utf8(output.stdout)?.trim());
    let library = fs::read_dir(&mujoco)?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with("libmujoco.")
        })
        .context("MuJoCo's wheel holds no C library")?;
    let program = target.join("peer");
    run(command("cc")
        .args(["-O2", "-Wall", "-I"])
        .arg(mujoco.join("include"))
        .arg(sources().join("peer.c"))
        .arg(&library)
        .arg(format!("-Wl,-rpath,{}", mujoco.display()))
        .args(["-lm", "-o"])
        .arg(&program))?;
    Ok(program)
}

/// The core to run on: the last that this process may use, if `taskset` can pin to it.
pub fn core() -> Option<usize> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let core = last_core(&status)?;
    let pinned = works(command("taskset").args(["-c", &core.to_string(), "true"]));
    if !pinned {
        eprintln!("xtask: there is no taskset (package util-linux): not pinned to a core");
    }
    pinned.then_some(core)
}

fn last_core(status: &str) -> Option<usize> {
    let list = status
        .lines()
        .find_map(|line| line.strip_prefix("Cpus_allowed_list:"))?;
    list.trim().rsplit([',', '-']).next()?.parse().ok()
}

/// The processor's name, as the system gives it.
pub fn machine() -> String {
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or("an unnamed processor", |(_, name)| name.trim())
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_core_is_read() {
        let status =
            |list: &str| format!("Name:\tx\nCpus_allowed:\t3\nCpus_allowed_list:\t{list}\n");
        assert_eq!(last_core(&status("0-1")), Some(1));
        assert_eq!(last_core(&status("0-3,8,10-11")), Some(11));
        assert_eq!(last_core(&status("5")), Some(5));
        assert_eq!(last_core(&status("")), None);
        assert_eq!(last_core("Name: x"), None);
    }
}
