//! `knob set`: change parameters, all or none.

use anyhow::{Result, bail};
use protocol::{Changes, Name, Refusal, Request};
use serde::Serialize;

use super::get;
use crate::device::{Device, Identity, Outcome};
use crate::output::say_line;
use crate::parameters::{self, Assignment, Named};
use crate::ports::Connection;
use crate::stop::Usage;
use crate::words;

/// Change parameters: all that are given, or none. Names and units as `knob get` shows them.
///
/// Words: law=raw|static|episode|ledger|auto, shape=spring|wall|detent. What is believed of the motor
/// is a number or a range: coulomb_nm=1.8e-3..2.2e-3.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob set stiffness_nm_rad=2 law=auto\n  knob set shape=detent period_rad=0.2 damping_nm_s_rad=1e-5\n  knob set coulomb_nm=1.8e-3..2.2e-3 shape=wall wall_rad=-0.2"
)]
pub struct Args {
    /// What to change
    #[arg(value_name = "NAME=VALUE", required = true, value_parser = Assignment::read)]
    assignments: Vec<Assignment>,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Serialize)]
struct Json<'a> {
    /// In force from this tick on.
    tick: u32,
    #[serde(flatten)]
    parameters: Named<'a>,
}

pub fn run(args: &Args) -> Result<()> {
    let changes = parameters::changes(&args.assignments).map_err(Usage)?;
    let (mut device, identity) = args.connection.connect()?;
    let tick = order(&mut device, &identity, &changes)?;
    let all = device.parameters()?;
    if args.connection.json {
        let json = Json {
            tick,
            parameters: Named {
                all: &all,
                names: Name::ALL,
            },
        };
        say_line!("{}", serde_json::to_string(&json)?);
    } else {
        let names: Vec<Name> = args.assignments.iter().map(|one| one.name).collect();
        get::print(&all, &names)?;
        say_line!("in force from tick {tick}");
    }
    Ok(())
}

/// Has a device take changes: the tick from which they are in force.
///
/// # Errors
/// What it refused, and what it would accept.
pub fn order(device: &mut Device, identity: &Identity, changes: &Changes) -> Result<u32> {
    match device.order(Request::Set(*changes))? {
        Outcome::Done { tick } => Ok(tick),
        Outcome::Refused(refusal) => {
            let wanted = match refusal {
                Refusal::Together { .. } => Some(device.parameters()?.with(changes)),
                _ => None,
            };
            bail!(
                "nothing was set: {}",
                words::refusal(&refusal, &identity.board, wanted.as_ref())
            );
        }
    }
}
