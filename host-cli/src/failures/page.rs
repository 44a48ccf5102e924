//! The catalogue as a page of Markdown, and as JSON.

use std::fmt::Write as _;

use anyhow::Result;
use serde_json::{Value, json};

use super::{Evidence, Failure};

const INTRODUCTION: &str = "# Where methods fail

Written by `cargo xtask failures` (`knob failures`); do not edit. The texts are in `host-cli/src/failures/catalogue.rs`, the numbers are
this program's.

A simulation can be wrong in ways that look right: an integrator that takes away the instability under study, a rule that reads one lucky
sample, a model that lacks the effect it is to judge. Each section below is one such failure. It has a scene file that shows it, what the
method *says*, what is *true*, and a test that holds both. True is what the exact map says (`plant-sim`, no step size and no tolerance);
where rounding could be in doubt, arithmetic with 77 digits (`plant_sim::precise`), or whole numbers. The scenes of dimensionless displays
have T = 1 s, K = 1 Nm/rad and counts of 1 rad, so that inertia, friction and start are μ, β, σ, ξ₀ and v₀ of (6) and (7); equation
numbers in parentheses are those of Diolaiti, Niemeyer, Barbagli, Salisbury (2005).

A method is named as `knob simulate --method` takes it: `euler:N` is semi-implicit Euler with N steps per sample and friction σ sgn ξ̇,
`rk4:N` the classical Runge–Kutta method with the same friction, `rk4-tanh:N` with σ tanh(ξ̇/0.01), `midpoint:N` the implicit midpoint rule with
projected friction, `dopri5:TOL` Dormand and Prince's method with events, `closed-form` the exact solution as textbooks write it. *Rest* is a display
that never moves again; a run that is merely slower than 0.01 counts per sample is called so. Classes are those of the window rule.

Physics engines, whose friction is a soft constraint, are measured on the whole plane of β and σ: [peers.md](peers.md).
";

const FOUND: &str = "## Found by its test

Each test was seen to fail once: the naive form below was put in the place of the mended one, in the library, and the test said this. All
are in `tests/tests/where_methods_fail.rs`.

| failure | naive form put in | test | what it said |
|---|---|---|---|
";

/// The page; figures lie in `figures`, a folder beside it.
pub fn document(measured: &[(&Failure, Evidence)], figures: &str) -> Result<String> {
    let mut text = INTRODUCTION.to_owned();
    text += "\n| failure | |\n|---|---|\n";
    for (failure, _) in measured {
        let name = failure.name;
        writeln!(text, "| [{name}](#{name}) | {} |", failure.title)?;
    }
    for (failure, evidence) in measured {
        section(&mut text, failure, evidence, figures)?;
    }
    text.push('\n');
    text += FOUND;
    for (failure, _) in measured {
        let Failure {
            name,
            put,
            test,
            found,
            ..
        } = failure;
        writeln!(text, "| {name} | {put} | `{test}` | {found} |")?;
    }
    Ok(text)
}

fn section(text: &mut String, failure: &Failure, evidence: &Evidence, figures: &str) -> Result<()> {
    let Failure {
        name,
        title,
        path,
        about,
        test,
        conclusion,
        ..
    } = failure;
    writeln!(text, "\n## {name}\n\n**{title}.** {about}\n")?;
    writeln!(text, "![{title}]({figures}/{name}.svg)\n")?;
    writeln!(text, "*{conclusion}*\n")?;
    text.push_str("| | | |\n|---|---|---|\n");
    for row in &evidence.rows {
        writeln!(text, "| {} | {} | {} |", row.kind.name(), row.by, row.says)?;
    }
    writeln!(
        text,
        "\nScene [`{path}`](../{path}), test `{test}`. To see it:\n"
    )?;
    writeln!(text, "```sh\n{}\n```", failure.commands.join("\n"))?;
    Ok(())
}

/// For machines.
pub fn object(failure: &Failure, evidence: &Evidence) -> Value {
    let rows = evidence
        .rows
        .iter()
        .map(|row| json!({ "by": row.by, "says": row.says, "kind": row.kind.name() }));
    json!({
        "name": failure.name,
        "title": failure.title,
        "scene": failure.path,
        "test": failure.test,
        "rows": rows.collect::<Vec<_>>(),
    })
}

/// For people at a terminal.
pub fn table(measured: &[(&Failure, Evidence)]) -> Result<String> {
    let mut text = String::new();
    for (failure, evidence) in measured {
        writeln!(text, "{}: {}", failure.name, failure.title)?;
        for row in &evidence.rows {
            writeln!(text, "  {:<6}  {}: {}", row.kind.name(), row.by, row.says)?;
        }
    }
    Ok(text)
}
