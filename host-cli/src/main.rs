//! `knob`: simulate, map and plan a haptic display.
//!
//! Results go to standard output (one JSON object with `--json`), progress and errors to
//! standard error. Exit status: 0 success, 1 failure, 2 bad usage, 130 stopped by Ctrl-C.
#![forbid(unsafe_code)]

mod charts;
mod commands;
mod number;
mod output;
mod progress;
mod scene;
mod stop;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The stiffest virtual spring that can be trusted: simulate a haptic knob exactly, map where it is stable, plan how stiff it can be.
#[derive(Parser)]
#[command(name = "knob", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Simulate(commands::simulate::Args),
    Map(commands::map::Args),
    Plan(commands::plan::Args),
    Figures(commands::figures::Args),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    stop::listen();
    let done = match cli.command {
        Command::Simulate(args) => commands::simulate::run(&args),
        Command::Map(args) => commands::map::run(&args),
        Command::Plan(args) => commands::plan::run(&args),
        Command::Figures(args) => commands::figures::run(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<stop::Stopped>() => {
            eprintln!("{error:#}");
            ExitCode::from(130)
        }
        Err(error) if error.is::<stop::Usage>() => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
