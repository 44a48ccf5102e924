//! Where methods fail: a catalogue of integrators, rules and controls that say something else than is true,
//! each with the scene that shows it. `knob failures` draws it, `docs/where-methods-fail.md` is its page,
//! `tests/tests/where_methods_fail.rs` holds both what each says and what is true.

pub mod adaptive;
mod catalogue;
pub mod forms;
mod integrators;
mod loops;
mod numbers;
pub(crate) mod page;
mod rules;
mod trace;

use anyhow::{Context, Result};

use crate::charts::failure::Figure;

/// One way to be wrong.
pub struct Failure {
    /// The stem of its scene, its figure and its command.
    pub name: &'static str,
    /// What it is.
    pub title: &'static str,
    /// Where its scene stands in the repository.
    pub path: &'static str,
    /// The scene.
    pub scene: &'static str,
    /// Why it fails.
    about: &'static str,
    /// Commands that show it, from the root of the repository.
    commands: &'static [&'static str],
    /// The test that holds both.
    pub test: &'static str,
    /// What to conclude.
    conclusion: &'static str,
    /// What was put in the place of the mended form once, to see its test find it.
    put: &'static str,
    /// What the test then said.
    found: &'static str,
    evidence: fn(&str) -> Result<Evidence>,
}

/// What was measured of a failure.
pub(crate) struct Evidence {
    pub rows: Vec<Row>,
    pub figure: Figure,
}

/// What one method, rule or control says.
pub(crate) struct Row {
    pub by: String,
    pub says: String,
    pub kind: Kind,
}

/// What to take it for.
#[derive(Clone, Copy)]
pub(crate) enum Kind {
    /// A method or a rule under test.
    Said,
    /// What is true.
    True,
    /// What the mended form does.
    Mended,
}

impl Kind {
    /// In the page and in JSON.
    fn name(self) -> &'static str {
        match self {
            Self::Said => "says",
            Self::True => "true",
            Self::Mended => "mended",
        }
    }
}

fn row(kind: Kind, by: impl Into<String>, says: impl Into<String>) -> Row {
    Row {
        by: by.into(),
        says: says.into(),
        kind,
    }
}

fn says(by: impl Into<String>, says: impl Into<String>) -> Row {
    row(Kind::Said, by, says)
}

fn truth(by: impl Into<String>, says: impl Into<String>) -> Row {
    row(Kind::True, by, says)
}

fn mend(by: impl Into<String>, says: impl Into<String>) -> Row {
    row(Kind::Mended, by, says)
}

impl Failure {
    /// Measures it.
    pub(crate) fn evidence(&self) -> Result<Evidence> {
        (self.evidence)(self.scene).with_context(|| self.path)
    }
}

/// The whole catalogue, in the order of the page.
#[must_use]
pub fn all() -> &'static [Failure] {
    catalogue::ALL
}

/// The failure of a name, such as `euler-hides`.
#[must_use]
pub fn named(name: &str) -> Option<&'static Failure> {
    all().iter().find(|failure| failure.name == name)
}
