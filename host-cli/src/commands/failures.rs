//! `knob failures`: where methods fail, measured and drawn.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::json;

use crate::failures::{self, page};
use crate::output::{self, Output};
use crate::{progress, stop};

/// Show where methods fail: what each says, what is true, and a figure.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob failures\n  knob failures --out docs/where-methods-fail --force"
)]
pub struct Args {
    /// Write the page to NAME.md and a figure of each to the folder NAME, which is made if it is not there
    #[arg(long, value_name = "NAME")]
    out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

pub fn run(args: &Args) -> Result<()> {
    let mut outputs = match &args.out {
        Some(name) => prepare(name, args.force)?,
        None => Vec::new(),
    };
    let bar = progress::bar(failures::all().len() as u64, "failures");
    let mut measured = Vec::new();
    for failure in failures::all() {
        bar.set_message(failure.name);
        stop::check()?;
        measured.push((failure, failure.evidence()?));
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let (Some(name), [page, figures @ ..]) = (&args.out, outputs.as_mut_slice()) {
        let folder = name.file_name().unwrap_or_default().to_string_lossy();
        write!(page, "{}", page::document(&measured, &folder)?)?;
        for (output, (_, evidence)) in figures.iter_mut().zip(&measured) {
            write!(output, "{}", evidence.figure.svg()?)?;
        }
    }
    let written: Vec<_> = outputs.iter().map(|o| o.path().to_owned()).collect();
    output::publish(outputs)?;
    if args.json {
        let objects = measured.iter().map(|(f, e)| page::object(f, e));
        let object = json!({ "failures": objects.collect::<Vec<_>>(), "files": written });
        return output::say(&(object.to_string() + "\n"));
    }
    let mut said = page::table(&measured)?;
    for path in written {
        said += &format!("wrote {}\n", path.display());
    }
    output::say(&said)
}

/// The page, then a figure of each.
fn prepare(name: &Path, force: bool) -> Result<Vec<Output>> {
    let shown = name.display();
    let Some(stem) = name.file_name() else {
        bail!("--out: {shown} names no folder; accepted: a name for it");
    };
    std::fs::create_dir_all(name).with_context(|| format!("--out: {shown}"))?;
    let page = name.with_file_name(format!("{}.md", stem.to_string_lossy()));
    let figures = failures::all()
        .iter()
        .map(|failure| name.join(format!("{}.svg", failure.name)));
    std::iter::once(page)
        .chain(figures)
        .map(|path| Output::prepare("--out", &path, force))
        .collect()
}
