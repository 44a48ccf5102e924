//! A measured program: a child that answers requests, one line each.
//!
//! It begins with `ready NAME`. To `run SETTING MU V0 SAMPLES BETA,SIGMA ...` it answers `done SECONDS
//! SAMPLES CLASSES`, a letter for each display, or `error TEXT`. It ends when its input does.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, bail};

use super::{GRID, MU, SAMPLES, V0, centre};

/// What became of a display, by the window rule of `plant_sim::outcome`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    Rest,
    LimitCycle,
    Unstable,
}

/// An answer.
#[derive(Debug, PartialEq)]
pub struct Done {
    /// Processor time that the simulation took, s.
    pub seconds: f64,
    /// Samples really simulated.
    pub samples: u64,
    pub classes: Vec<Class>,
}

/// The child. It does not outlive this.
pub struct Worker {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    name: String,
}

impl Worker {
    /// Starts it and waits until it is ready.
    pub fn spawn(mut command: Command) -> Result<Self> {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let (Some(requests), Some(answers)) = (child.stdin.take(), child.stdout.take()) else {
            bail!("no pipe to it");
        };
        let mut worker = Self {
            child,
            requests,
            answers: BufReader::new(answers),
            name: String::new(),
        };
        let line = worker.line()?;
        let Some(name) = line.strip_prefix("ready ") else {
            bail!("it said `{line}`, not that it is ready");
        };
        worker.name = name.to_owned();
        Ok(worker)
    }

    /// What it says it is.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Runs cells of the grid in a setting.
    pub fn run(&mut self, setting: &str, cells: &[usize]) -> Result<Done> {
        let mut request = format!("run {setting} {MU} {V0} {SAMPLES}");
        for cell in cells {
            let (beta, sigma) = (centre(cell / GRID), centre(cell % GRID));
            request += &format!(" {beta},{sigma}");
        }
        request.push('\n');
        self.requests
            .write_all(request.as_bytes())
            .context("it has ended")?;
        parse(&self.line()?, cells.len())
    }

    fn line(&mut self) -> Result<String> {
        let mut line = String::new();
        self.answers.read_line(&mut line)?;
        if line.is_empty() {
            bail!("it has ended");
        }
        Ok(line.trim_end().to_owned())
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // If it has ended already there is nothing to end.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads the answer for a number of displays.
fn parse(line: &str, displays: usize) -> Result<Done> {
    let nonsense = || format!("it answered `{line}`");
    if let Some(text) = line.strip_prefix("error ") {
        bail!("it reports: {text}");
    }
    let words: Vec<&str> = line.split_whitespace().collect();
    let ["done", seconds, samples, letters] = words[..] else {
        bail!(nonsense());
    };
    let classes = letters.chars().map(|letter| match letter {
        'r' => Some(Class::Rest),
        'c' => Some(Class::LimitCycle),
        'u' => Some(Class::Unstable),
        _ => None,
    });
    let classes: Vec<Class> = classes.collect::<Option<_>>().with_context(nonsense)?;
    let seconds: f64 = seconds.parse().with_context(nonsense)?;
    let samples = samples.parse().with_context(nonsense)?;
    if classes.len() != displays || samples == 0 || !(seconds.is_finite() && seconds > 0.0) {
        bail!(nonsense());
    }
    Ok(Done {
        seconds,
        samples,
        classes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_read() {
        let done = parse("done 0.25 24000 rcu", 3).unwrap();
        assert_eq!(
            done,
            Done {
                seconds: 0.25,
                samples: 24_000,
                classes: vec![Class::Rest, Class::LimitCycle, Class::Unstable],
            }
        );
    }

    #[test]
    fn an_answer_that_is_none_is_refused() {
        for line in [
            "",
            "done",
            "done 0.25 24000",
            "done 0.25 24000 rc",
            "done 0.25 24000 rc?",
            "done 0.25 24000 rcu r",
            "done nan 24000 rcu",
            "done 0 24000 rcu",
            "done 0.25 0 rcu",
            "done 0.25 -1 rcu",
            "ready x",
        ] {
            assert!(parse(line, 3).is_err(), "{line}");
        }
        let error = parse("error a setting that is none", 3).unwrap_err();
        assert_eq!(error.to_string(), "it reports: a setting that is none");
    }

    #[cfg(unix)]
    #[test]
    fn a_program_that_ends_or_talks_nonsense_is_told_of() {
        let shell = |script: &str| {
            let mut command = Command::new("sh");
            command.args(["-c", script]);
            Worker::spawn(command)
        };
        let ended = shell("exit 3").err().unwrap();
        assert_eq!(ended.to_string(), "it has ended");
        assert!(shell("echo hello").is_err());
        let mut worker =
            shell("echo ready sh 1; read line; echo done 1 5 r; read line; echo error no").unwrap();
        assert_eq!(worker.name(), "sh 1");
        assert_eq!(worker.run("x", &[0]).unwrap().samples, 5);
        assert!(worker.run("x", &[0]).is_err());
        assert!(worker.run("x", &[0]).is_err());
    }
}
