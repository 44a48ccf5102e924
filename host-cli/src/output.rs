//! Standard output, and files written beside their target and renamed into place.

use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, Result, anyhow, bail};
use tempfile::TempPath;

use crate::stop;

/// Writes to standard output. A reader that has gone away (`knob plan | head -1`) wants no
/// more and is no failure; a full disk is one.
pub fn say(text: &str) -> Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(anyhow!("cannot write to standard output: {error}"))
        }
        _ => Ok(()),
    }
}

/// Writes one line to standard output, as `println!` does but without its panic; for
/// functions that return a `Result`.
macro_rules! say_line {
    ($($text:tt)*) => {
        $crate::output::say(&format!("{}\n", format_args!($($text)*)))?
    };
}
pub(crate) use say_line;

/// Every draft of this process, for [`remove_drafts`].
static DRAFTS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Removes what has not been published, before the process ends without unwinding.
pub fn remove_drafts() {
    if let Ok(drafts) = DRAFTS.lock() {
        for draft in drafts.iter() {
            // One that was published or dropped has no file of this name any more.
            let _ = fs::remove_file(draft);
        }
    }
}

/// A file that is to be written: a draft beside its target, made before the work that
/// fills it. It takes the target's place when it is published, and is gone if it never is.
pub struct Output {
    /// The flag that asked for it, and the path as the user wrote it.
    name: String,
    path: PathBuf,
    /// Where it goes: `path`, or the file that a link there leads to.
    target: PathBuf,
    force: bool,
    file: BufWriter<File>,
    draft: TempPath,
}

impl Output {
    /// Makes sure, before any work is done, that `path` can be written: a file can be made
    /// in its folder, and it does not exist, or is a file that `force` allows to replace.
    pub fn prepare(flag: &str, path: &Path, force: bool) -> Result<Self> {
        let name = format!("{flag}: {}", path.display());
        if path.file_name().is_none() {
            bail!("{name} names no file; accepted: a file name");
        }
        if path.is_dir() {
            bail!("{name} is a folder; accepted: a file name");
        }
        let folder = folder(path);
        if !folder.is_dir() {
            bail!(
                "{flag}: there is no folder {}; create it first",
                folder.display()
            );
        }
        let mut target = path.to_owned();
        if path.symlink_metadata().is_ok() {
            target = fs::canonicalize(path)
                .with_context(|| format!("{name} is a link that leads nowhere"))?;
            if !target.is_file() {
                bail!("{name} is no ordinary file, so it is left alone; give another name");
            }
            if !force {
                bail!("{name} exists; give another name, or --force to replace it");
            }
        }
        let (file, draft) = draft_beside(&target).map_err(|error| trouble(&name, &error))?;
        Ok(Self {
            name,
            path: path.to_owned(),
            target,
            force,
            file: BufWriter::new(file),
            draft,
        })
    }

    /// Where it will be, as the user wrote it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether it would take the place of `other`.
    pub fn replaces(&self, other: &Path) -> bool {
        let whole = |path: &Path| {
            let folder = fs::canonicalize(folder(path)).ok()?;
            Some(folder.join(path.file_name()?))
        };
        let real = |path: &Path| fs::canonicalize(path).ok().or_else(|| whole(path));
        real(&self.target).is_some_and(|target| Some(target) == real(other))
    }

    /// Adds to the draft, by `write!`.
    pub fn write_fmt(&mut self, content: std::fmt::Arguments<'_>) -> Result<()> {
        self.file
            .write_fmt(content)
            .map_err(|error| trouble(&self.name, &error))
    }
}

/// Puts files in their places: all of them, or none if the user has asked to stop or one
/// of them cannot be completed.
pub fn publish(outputs: Vec<Output>) -> Result<()> {
    stop::check()?;
    publish_after_stop(outputs)
}

/// As [`publish`], also where the user has asked to stop: for work that ends no other way.
pub fn publish_after_stop(outputs: Vec<Output>) -> Result<()> {
    let mut complete = Vec::new();
    for output in outputs {
        let file = output
            .file
            .into_inner()
            .map_err(|error| trouble(&output.name, error.error()))?;
        file.sync_all()
            .map_err(|error| trouble(&output.name, &error))?;
        complete.push((output.name, output.target, output.force, output.draft));
    }
    for (name, target, force, draft) in complete {
        let renamed = if force {
            draft.persist(&target)
        } else {
            draft.persist_noclobber(&target)
        };
        renamed.map_err(|error| trouble(&name, &error.error))?;
    }
    Ok(())
}

fn draft_beside(target: &Path) -> io::Result<(File, TempPath)> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".knob-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let (file, draft) = builder.tempfile_in(folder(target))?.into_parts();
    if let Ok(mut drafts) = DRAFTS.lock() {
        drafts.push(draft.to_path_buf());
    }
    Ok((file, draft))
}

/// By its kind alone: an error of the draft names the draft, which means nothing to the user.
fn trouble(name: &str, error: &io::Error) -> anyhow::Error {
    anyhow!(
        "{name} cannot be written: {}",
        io::Error::from(error.kind())
    )
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}
