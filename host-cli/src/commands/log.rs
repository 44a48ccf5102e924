//! `knob log`: what every tick, or every Nth, did, as CSV.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, bail};
use protocol::{ClampReason, Event, Fields, Subscription, Telemetry};
use serde::Serialize;

use crate::device::{Device, Unasked};
use crate::output::say_line;
use crate::output::{Output, publish};
use crate::parameters::{self, short};
use crate::ports::Connection;
use crate::{number, progress, words};

/// Record what the ticks do as CSV: state, count, torque, stiffness, margin, why it is clamped, the
/// law in force, and the energy in the ledger's account.
///
/// Time is the device's: S seconds of its ticks. Ticks that are missing are counted.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob log --seconds 2 --out throw.csv\n  knob log --seconds 60 --every 10 --out slow.csv --json"
)]
pub struct Args {
    /// How long
    #[arg(long, value_name = "S", value_parser = number::positive)]
    seconds: f64,
    /// The file to write
    #[arg(long, value_name = "FILE.csv")]
    out: PathBuf,
    /// One row every N ticks; a slow line cannot carry all
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    every: u16,
    /// Replace a file that exists
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    connection: Connection,
}

/// After so long without a row the device is asked how it is.
const SILENCE: Duration = Duration::from_secs(2);

const HEADER: &str =
    "tick,state,count,torque_nm,stiffness_nm_rad,demanded_nm_rad,margin_nm,reason,law,account_j";

pub fn run(args: &Args) -> Result<()> {
    let output = Output::prepare("--out", &args.out, args.force)?;
    let (mut device, _) = args.connection.connect()?;
    let period_s = f64::from(device.parameters()?.sample_period_s);
    let before = device.status()?;
    let mut log = Log {
        every: u32::from(args.every),
        ticks: (args.seconds / period_s).round().max(1.0) as u64,
        elapsed: 0,
        last_tick: None,
        last_number: None,
        summary: Summary {
            file: output.path().display().to_string(),
            ..Summary::default()
        },
        output,
    };
    log.line(format_args!("{HEADER}"))?;
    let damaged = device.damaged();
    device.subscribe(Subscription {
        every_ticks: args.every,
        fields: Fields::ALL,
        clamp_events: true,
    })?;
    let recorded = log.record(&mut device, before.tick, before.dropped);
    let hushed = device.hush();
    recorded?;
    log.summary.damaged_frames = device.damaged() - damaged;
    match hushed.and_then(|()| device.status()) {
        Ok(after) => log.summary.dropped = after.dropped.wrapping_sub(before.dropped),
        Err(error) => eprintln!("the log is whole, but the device goes on sending: {error:#}"),
    }
    publish(vec![log.output])?;
    if args.connection.json {
        say_line!("{}", serde_json::to_string(&log.summary)?);
    } else {
        log.summary.print()?;
    }
    Ok(())
}

/// What came of it.
#[derive(Debug, Default, Serialize)]
struct Summary {
    file: String,
    rows: u64,
    first_tick: Option<u32>,
    last_tick: Option<u32>,
    /// Places where rows are missing.
    gaps: u64,
    /// Rows that are missing there.
    missing: u64,
    /// Messages that found no room in the device.
    dropped: u32,
    /// Messages that were sent, but did not come.
    lost: u64,
    /// Frames that came damaged.
    damaged_frames: u64,
    /// Changes of the reason for clamping.
    clamp_changes: u64,
    /// Rows by reason.
    reasons: BTreeMap<&'static str, u64>,
    /// Rows by law in force.
    laws: BTreeMap<&'static str, u64>,
    faults: Vec<FaultJson>,
}

#[derive(Debug, Serialize)]
struct FaultJson {
    tick: u32,
    fault: &'static str,
    fault_text: String,
}

impl Summary {
    fn print(&self) -> Result<()> {
        say_line!("wrote        {}", self.file);
        say_line!(
            "rows         {}, ticks {} to {}",
            self.rows,
            self.first_tick.unwrap_or_default(),
            self.last_tick.unwrap_or_default()
        );
        say_line!("gaps         {}, {} rows missing", self.gaps, self.missing);
        say_line!(
            "lost         {} messages found no room in the device, {} did not come, {} frames came damaged",
            self.dropped,
            self.lost,
            self.damaged_frames
        );
        if self.dropped > 0 {
            say_line!("             the line cannot carry all: a larger --every drops fewer");
        }
        for reason in REASONS {
            if let Some(rows) = self.reasons.get(words::clamp_code(reason)) {
                say_line!("clamp        {}: {rows} rows", words::clamp(reason));
            }
        }
        for (law, rows) in &self.laws {
            say_line!("law          {law}: {rows} rows");
        }
        for fault in &self.faults {
            say_line!("fault        tick {}: {}", fault.tick, fault.fault_text);
        }
        Ok(())
    }
}

const REASONS: [ClampReason; 10] = [
    ClampReason::None,
    ClampReason::Viscous,
    ClampReason::Coulomb,
    ClampReason::Speed,
    ClampReason::ZeroForce,
    ClampReason::Torque,
    ClampReason::Inertia,
    ClampReason::Coarse,
    ClampReason::Account,
    ClampReason::Hand,
];

/// A log that is being written.
struct Log {
    output: Output,
    every: u32,
    /// How long it is to be, ticks.
    ticks: u64,
    /// Ticks since the first row.
    elapsed: u64,
    last_tick: Option<u32>,
    /// The number of the last message that was sent unasked.
    last_number: Option<u16>,
    summary: Summary,
}

impl Log {
    fn line(&mut self, line: std::fmt::Arguments<'_>) -> Result<()> {
        writeln!(self.output, "{line}")
    }

    /// Takes rows until there are enough. `start`, `dropped`: as before the subscription.
    fn record(&mut self, device: &mut Device, start: u32, dropped: u32) -> Result<()> {
        let bar = progress::bar(self.ticks, "ticks");
        let mut asked_at = start;
        loop {
            let Some((number, message)) = device.unasked(SILENCE)? else {
                asked_at = self.check(device, start, asked_at)?;
                continue;
            };
            if let Some(last) = self.last_number.replace(number) {
                self.summary.lost += u64::from(number.wrapping_sub(last).wrapping_sub(1));
            }
            match message {
                Unasked::Telemetry(telemetry) => {
                    if !self.enter(device, &telemetry)? {
                        bar.finish_and_clear();
                        return Ok(());
                    }
                    bar.set_position(self.elapsed);
                }
                Unasked::Event(Event::Clamp { .. }) => self.summary.clamp_changes += 1,
                Unasked::Event(Event::Fault { tick, fault }) => {
                    bar.suspend(|| eprintln!("tick {tick}: fault: {}", words::fault(fault)));
                    self.summary.faults.push(FaultJson {
                        tick,
                        fault: words::fault_code(fault),
                        fault_text: words::fault(fault),
                    });
                }
                Unasked::Event(Event::Dropped { total }) => {
                    self.summary.dropped = total.wrapping_sub(dropped);
                }
                // Of a push or a calibration that another host began.
                Unasked::Moves(_)
                | Unasked::Event(Event::Measured(_) | Event::Calibrated { .. }) => {}
            }
        }
    }

    /// One tick; false if it is past the end.
    fn enter(&mut self, device: &Device, telemetry: &Telemetry) -> Result<bool> {
        let tick = telemetry.tick;
        match self.last_tick {
            None => self.summary.first_tick = Some(tick),
            Some(last) => {
                let step = forward(device, last, tick)?;
                let since = self.elapsed;
                self.elapsed += u64::from(step);
                // Between the last row and this one, or the end.
                let between = (self.elapsed.min(self.ticks) - since).saturating_sub(1);
                let missing = between / u64::from(self.every);
                self.summary.gaps += u64::from(missing > 0);
                self.summary.missing += missing;
            }
        }
        self.last_tick = Some(tick);
        if self.elapsed >= self.ticks {
            return Ok(false);
        }
        self.summary.rows += 1;
        self.summary.last_tick = Some(tick);
        if let Some(reason) = telemetry.reason {
            *self
                .summary
                .reasons
                .entry(words::clamp_code(reason))
                .or_default() += 1;
        }
        if let Some(law) = telemetry.law {
            *self.summary.laws.entry(parameters::law(law)).or_default() += 1;
        }
        let count = telemetry.count.map(|count| count.to_string());
        let number = |value: Option<f32>| value.map(short).unwrap_or_default();
        self.line(format_args!(
            "{tick},{},{},{},{},{},{},{},{},{}",
            words::state(telemetry.state),
            count.unwrap_or_default(),
            number(telemetry.torque_nm),
            number(telemetry.stiffness_nm_rad),
            number(telemetry.demanded_nm_rad),
            number(telemetry.margin_nm),
            telemetry.reason.map(words::clamp_code).unwrap_or_default(),
            telemetry.law.map(parameters::law).unwrap_or_default(),
            number(telemetry.account_j)
        ))?;
        Ok(true)
    }

    /// Whether rows may still come. Returns the device's tick.
    fn check(&self, device: &mut Device, start: u32, asked_at: u32) -> Result<u32> {
        let tick = device.status()?.tick;
        if device.has_unasked() {
            return Ok(tick);
        }
        let path = device.path();
        if forward(device, asked_at, tick)? == 0 {
            bail!("port {path}: the device answers, but its tick stands still at {tick}; reset it");
        }
        let since = forward(device, self.last_tick.unwrap_or(start), tick)?;
        if since / 2 > self.every {
            bail!(
                "port {path}: the device answers, but sends no telemetry for {since} ticks; reset it"
            );
        }
        Ok(tick)
    }
}

/// Ticks from one to the next, which is not before it.
fn forward(device: &Device, from: u32, to: u32) -> Result<u32> {
    let step = to.wrapping_sub(from);
    if step > u32::MAX / 2 {
        bail!(
            "port {}: the device started anew: tick {to} came after tick {from}",
            device.path()
        );
    }
    Ok(step)
}
