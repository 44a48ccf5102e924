//! Files written beside their target and renamed into place.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use tempfile::NamedTempFile;

/// A file that is to be written, checked before the work that fills it.
#[derive(Debug, Clone)]
pub struct Output {
    path: PathBuf,
    force: bool,
}

impl Output {
    /// Makes sure, before any work is done, that `path` can be written: its folder
    /// exists, and it does not, unless `force` allows to replace it.
    pub fn prepare(flag: &str, path: &Path, force: bool) -> Result<Self> {
        if path.file_name().is_none() {
            bail!(
                "{flag}: {} names no file; accepted: a file name",
                path.display()
            );
        }
        if path.is_dir() {
            bail!(
                "{flag}: {} is a folder; accepted: a file name",
                path.display()
            );
        }
        let folder = folder(path);
        if !folder.is_dir() {
            bail!(
                "{flag}: there is no folder {}; create it first",
                folder.display()
            );
        }
        if path.exists() && !force {
            bail!(
                "{flag}: {} exists; give another name, or --force to replace it",
                path.display()
            );
        }
        Ok(Self {
            path: path.to_owned(),
            force,
        })
    }

    /// Where it will be.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes all of it or nothing.
    pub fn write(&self, content: &[u8]) -> Result<()> {
        let mut draft = self.draft()?;
        draft.write_all(content).with_context(|| draft.trouble())?;
        draft.publish()
    }

    /// A file beside the target that takes its place when it is published, and is gone
    /// if it never is.
    pub fn draft(&self) -> Result<Draft> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".knob-");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let file = builder
            .tempfile_in(folder(&self.path))
            .with_context(|| format!("cannot write {}", self.path.display()))?;
        Ok(Draft {
            file: BufWriter::new(file),
            output: self.clone(),
        })
    }
}

/// A file on its way to [`Output::path`].
pub struct Draft {
    file: BufWriter<NamedTempFile>,
    output: Output,
}

impl Draft {
    /// Puts the file in its place.
    pub fn publish(self) -> Result<()> {
        let trouble = self.trouble();
        let file = self.file.into_inner().map_err(|error| error.into_error());
        let file = file.with_context(|| trouble.clone())?;
        file.as_file().sync_all().with_context(|| trouble.clone())?;
        let renamed = if self.output.force {
            file.persist(&self.output.path)
        } else {
            file.persist_noclobber(&self.output.path)
        };
        renamed.map_err(|error| error.error).context(trouble)?;
        Ok(())
    }

    fn trouble(&self) -> String {
        format!("cannot write {}", self.output.path.display())
    }
}

impl Write for Draft {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}
