//! `knob get`: the parameters that are in force.

use anyhow::Result;
use protocol::{Name, Parameters};

use crate::output::say_line;
use crate::parameters::{self, Named, value};
use crate::ports::Connection;

/// Show parameters, all or the named ones, as `knob set` takes them.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob get\n  knob get stiffness_nm_rad law --json\n  knob get > mine.txt; knob set $(cat mine.txt)"
)]
pub struct Args {
    /// Which parameters [default: all]
    #[arg(value_name = "NAME", value_parser = parameters::name)]
    names: Vec<Name>,
    #[command(flatten)]
    connection: Connection,
}

pub fn run(args: &Args) -> Result<()> {
    let (mut device, _) = args.connection.connect()?;
    let all = device.parameters()?;
    let names = if args.names.is_empty() {
        Name::ALL
    } else {
        &args.names
    };
    if args.connection.json {
        // A name that was given twice is one key.
        let once: Vec<Name> = Name::ALL
            .iter()
            .copied()
            .filter(|name| names.contains(name))
            .collect();
        let named = Named {
            all: &all,
            names: &once,
        };
        say_line!("{}", serde_json::to_string(&named)?);
    } else {
        print(&all, names)?;
    }
    Ok(())
}

/// One NAME=VALUE a line.
pub fn print(all: &Parameters, names: &[Name]) -> Result<()> {
    for name in names {
        say_line!("{}={}", name.as_str(), value(all, *name));
    }
    Ok(())
}
