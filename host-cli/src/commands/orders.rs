//! `knob arm`, `disarm`, `clear`, `save` and `reset-settings`: orders without values.

use anyhow::{Result, bail};
use protocol::{Refusal, Request, State};
use serde::Serialize;

use crate::device::Outcome;
use crate::output::say_line;
use crate::ports::Connection;
use crate::words;

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    connection: Connection,
}

/// What is ordered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    Arm,
    Disarm,
    Clear,
    Save,
    ResetSettings,
}

impl Order {
    fn request(self) -> Request {
        match self {
            Self::Arm => Request::Arm,
            Self::Disarm => Request::Disarm,
            Self::Clear => Request::Clear,
            Self::Save => Request::Save,
            Self::ResetSettings => Request::ResetSettings,
        }
    }

    /// What was not done if it is refused.
    fn failed(self) -> &'static str {
        match self {
            Self::Arm => "cannot arm",
            Self::Disarm => "cannot disarm",
            Self::Clear => "nothing to clear",
            Self::Save => "nothing was saved",
            Self::ResetSettings => "nothing was reset",
        }
    }
}

#[derive(Serialize)]
struct Json {
    /// Done in this tick.
    tick: u32,
    /// The state after it.
    state: &'static str,
}

pub fn run(args: &Args, order: Order) -> Result<()> {
    let (mut device, identity) = args.connection.connect()?;
    let tick = match device.order(order.request())? {
        Outcome::Done { tick } => tick,
        Outcome::Refused(Refusal::State(state)) if order == Order::Clear => bail!(
            "nothing to clear: the device is {}, not in fault",
            words::state(state)
        ),
        Outcome::Refused(Refusal::State(State::Armed))
            if matches!(order, Order::Save | Order::ResetSettings) =>
        {
            bail!(
                "{}: the device is armed, and it may stand still for two seconds while it \
                 saves; `knob disarm` first",
                order.failed()
            )
        }
        Outcome::Refused(refusal) => bail!(
            "{}: {}",
            order.failed(),
            words::refusal(&refusal, &identity.board, None)
        ),
    };
    let state = device.status()?.state;
    if let (Order::Arm, State::Fault(_)) = (order, state) {
        bail!(
            "armed from tick {tick}, but now it is {}",
            words::state_in_full(state)
        );
    }
    if args.connection.json {
        let json = Json {
            tick,
            state: words::state(state),
        };
        say_line!("{}", serde_json::to_string(&json)?);
    } else if order == Order::Save {
        say_line!("saved; the next start begins with these parameters");
    } else if order == Order::ResetSettings {
        say_line!("the defaults are in force from tick {tick}, and saved for the next start");
    } else {
        say_line!("{} from tick {tick}", words::state_in_full(state));
    }
    Ok(())
}
