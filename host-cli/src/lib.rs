//! `knob`: simulate, map and plan a haptic display, and talk to one.
//!
//! Results go to standard output (one JSON object with `--json`), progress and errors to
//! standard error. Exit status: 0 success, 1 failure, 2 bad usage, 130 stopped by Ctrl-C.
#![forbid(unsafe_code)]

mod charts;
mod commands;
mod device;
mod device_list;
mod emulators;
pub mod failures;
mod image;
mod number;
mod output;
mod parameters;
mod ports;
mod progress;
mod reasons;
mod recording;
pub mod scene;
mod session;
mod stop;
mod terminal;
mod words;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use commands::orders::{self, Order};

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
    Stiffness(commands::stiffness::Args),
    Chart(commands::chart::Args),
    Figures(commands::figures::Args),
    Failures(commands::failures::Args),
    Campaign(commands::campaign::Args),
    Ablation(commands::ablation::Args),
    Emulate(commands::emulate::Args),
    Demo(commands::demo::Args),
    Ports(commands::ports::Args),
    Info(commands::info::Args),
    Get(commands::get::Args),
    Set(commands::set::Args),
    /// Render from now on, as soon as the knob passes zero force.
    #[command(after_help = "Example:\n  knob arm")]
    Arm(orders::Args),
    /// No torque from now on.
    #[command(after_help = "Example:\n  knob disarm")]
    Disarm(orders::Args),
    /// Leave the fault state, disarmed.
    #[command(after_help = "Example:\n  knob clear && knob arm")]
    Clear(orders::Args),
    /// Keep the parameters for the next start.
    #[command(after_help = "Example:\n  knob save")]
    Save(orders::Args),
    /// Go back to the defaults, motor included: in force at once, and at the next start.
    #[command(after_help = "Example:\n  knob get > mine.txt; knob reset-settings")]
    ResetSettings(orders::Args),
    Log(commands::log::Args),
    Monitor(commands::monitor::Args),
    Flash(commands::flash::Args),
    Identify(commands::identify::Args),
}

/// What the program `knob` does with its arguments: its exit status.
#[must_use]
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    stop::listen();
    let done = match cli.command {
        Command::Simulate(args) => commands::simulate::run(&args),
        Command::Map(args) => commands::map::run(&args),
        Command::Plan(args) => commands::plan::run(&args),
        Command::Stiffness(args) => commands::stiffness::run(&args),
        Command::Chart(args) => commands::chart::run(&args),
        Command::Figures(args) => commands::figures::run(&args),
        Command::Failures(args) => commands::failures::run(&args),
        Command::Campaign(args) => commands::campaign::run(&args),
        Command::Ablation(args) => commands::ablation::run(&args),
        Command::Emulate(args) => commands::emulate::run(&args),
        Command::Demo(args) => commands::demo::run(&args),
        Command::Ports(args) => commands::ports::run(&args),
        Command::Info(args) => commands::info::run(&args),
        Command::Get(args) => commands::get::run(&args),
        Command::Set(args) => commands::set::run(&args),
        Command::Arm(args) => orders::run(&args, Order::Arm),
        Command::Disarm(args) => orders::run(&args, Order::Disarm),
        Command::Clear(args) => orders::run(&args, Order::Clear),
        Command::Save(args) => orders::run(&args, Order::Save),
        Command::ResetSettings(args) => orders::run(&args, Order::ResetSettings),
        Command::Log(args) => commands::log::run(&args),
        Command::Monitor(args) => commands::monitor::run(&args),
        Command::Flash(args) => commands::flash::run(&args),
        Command::Identify(args) => commands::identify::run(&args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error)
            if error.is::<stop::Stopped>()
                || error.is::<stop::Interrupted>()
                || error.is::<stop::Ended>() =>
        {
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
