//! Emulators that are running: each leaves a file, named by its process, that says where its
//! port is.

use std::ffi::OsStr;
use std::io::{self, Write};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};

/// Where the files are: each user's apart, as they share the folder above.
fn folder() -> PathBuf {
    let user = rustix::process::getuid().as_raw();
    std::env::temp_dir().join(format!("knob-emulators-{user}"))
}

/// This process's entry; gone when dropped.
pub struct Registration {
    entry: PathBuf,
}

impl Drop for Registration {
    fn drop(&mut self) {
        // If it stays, it is stale, and removed by whoever looks next.
        let _ = std::fs::remove_file(&self.entry);
    }
}

/// Says that this process emulates a knob on the port at `path`.
///
/// # Errors
/// Where the entry cannot be written.
pub fn register(path: &Path) -> io::Result<Registration> {
    register_in(&folder(), path)
}

fn register_in(folder: &Path, path: &Path) -> io::Result<Registration> {
    std::fs::create_dir_all(folder)?;
    let entry = folder.join(std::process::id().to_string());
    // Whole or not at all: nobody reads half a path and takes the entry for stale.
    let mut draft = tempfile::NamedTempFile::new_in(folder)?;
    draft.write_all(path.as_os_str().as_bytes())?;
    draft.persist(&entry).map_err(|error| error.error)?;
    Ok(Registration { entry })
}

/// The ports of all emulators that are running, in the order of their process ids.
///
/// Entries of those that are not are removed.
pub fn running() -> Vec<PathBuf> {
    running_in(&folder())
}

fn running_in(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut ports = Vec::new();
    for entry in entries.flatten() {
        let Some(process) = process_id(&entry.file_name()) else {
            continue;
        };
        let Ok(bytes) = std::fs::read(entry.path()) else {
            continue;
        };
        let port = PathBuf::from(std::ffi::OsString::from_vec(bytes));
        if is_running(process) && port.exists() {
            ports.push((process, port));
        } else {
            // Another user's stays; it is passed over all the same.
            let _ = std::fs::remove_file(entry.path());
        }
    }
    ports.sort_unstable();
    ports.into_iter().map(|(_, port)| port).collect()
}

fn process_id(name: &OsStr) -> Option<u32> {
    name.to_str()?.parse().ok()
}

/// Whether a process is there; where that cannot be known, yes.
fn is_running(process: u32) -> bool {
    let processes = Path::new("/proc");
    !processes.join("self").exists() || processes.join(process.to_string()).exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_emulator_is_listed_while_it_is_registered() {
        let folder = tempfile::tempdir().unwrap();
        let port = Path::new("/dev/null");
        assert!(running_in(folder.path()).is_empty());
        let registration = register_in(folder.path(), port).unwrap();
        assert_eq!(running_in(folder.path()), [port]);
        drop(registration);
        assert!(running_in(folder.path()).is_empty());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn the_real_folder_can_be_used() {
        // Several tests may run in this process, but only this one registers there.
        let registration = register(Path::new("/dev/null")).unwrap();
        assert!(running().contains(&PathBuf::from("/dev/null")));
        drop(registration);
        assert!(!folder().join(std::process::id().to_string()).exists());
    }

    #[test]
    fn stale_entries_are_passed_over_and_removed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        // No process has this number.
        std::fs::write(at("4294967295"), "/dev/null").unwrap();
        let own = std::process::id().to_string();
        std::fs::write(at(&own), "/no/such/port").unwrap();
        std::fs::write(at("notes"), "not an entry").unwrap();
        assert!(running_in(folder.path()).is_empty());
        assert!(!at("4294967295").exists() && !at(&own).exists());
        assert!(at("notes").exists());
    }
}
