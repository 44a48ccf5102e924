//! `knob emulate`: the firmware in the emulator, in lockstep with the exact plant, on a serial port.

mod powered;

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use plant_sim::drive::Drive;
use plant_sim::hand::Hand;
use plant_sim::hold::State;
use plant_sim::lockstep::{Plant, SETTINGS_BYTES};
use plant_sim::motor::Motor;
use plant_sim::preset::PRESETS;
use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use crate::output::say_line;
use crate::output::{Output, publish_after_stop};
use crate::scene;
use crate::session::{ImageChoice, Session};
use crate::stop::Ended;
use crate::{emulators, stop};

/// Run the firmware in the emulator, in lockstep with the exact plant, until Ctrl-C.
///
/// Prints the serial port to use; `knob` finds it by itself. The plant is the scene's device from
/// the scene's start, or else the paper's RE35 at rest.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  knob emulate\n  knob emulate --scene scenes/fig6c.toml --port-link knob-port &\n  knob info --port knob-port"
)]
pub struct Args {
    /// The scene whose device and start make the plant (TOML)
    #[arg(long)]
    scene: Option<PathBuf>,
    /// As fast as time passes, or as fast as it goes
    #[arg(long, value_enum, default_value_t = Pace::Real)]
    pace: Pace,
    /// A symbolic link to the port, removed at the end
    #[arg(long, value_name = "PATH")]
    port_link: Option<PathBuf>,
    /// Where `knob save` keeps the settings; made if it does not exist. Without it nothing is kept
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Write every tick as CSV at the end: time, angle, velocity, counter, torque
    #[arg(long, value_name = "OUT.csv")]
    record: Option<PathBuf>,
    /// Replace the record if it exists
    #[arg(long)]
    force: bool,
    /// Print the port as one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    image: ImageChoice,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Pace {
    /// One second of the plant takes one second
    Real,
    /// No waiting
    Free,
}

pub fn run(args: &Args) -> Result<()> {
    let record = match &args.record {
        Some(path) => Some(Output::prepare("--record", path, args.force)?),
        None => None,
    };
    if let Some(path) = &args.settings {
        settings_file(path).with_context(|| format!("--settings: {}", path.display()))?;
    }
    let scene = match &args.scene {
        Some(path) => Some((path, scene::load(path)?)),
        None => None,
    };
    let settings = args.settings.as_deref();
    if let Some((path, setup)) = scene
        .as_ref()
        .and_then(|(path, scene)| Some((path, scene.powered()?)))
    {
        let mut bench = powered::boot(args.image.firmware.as_deref(), &setup, settings)
            .with_context(|| path.display().to_string())?;
        return on_port(args, record, |port, rows| {
            powered::serve(&mut bench, port, args.pace, stop::requested, rows)
        });
    }
    let (plant, start) = match scene {
        Some((path, scene::Loaded { scene, .. })) => {
            if scene.hand != Hand::default()
                || scene.drive != Drive::default()
                || scene.motor != Motor::default()
            {
                eprintln!(
                    "the scene's hand, delay, lag, torque steps, cogging and stiction are not emulated"
                );
            }
            let counts = std::f64::consts::TAU / scene.config.hardware_count_rad;
            let plant = Plant::new(scene.device, counts, scene.start.position);
            (
                plant.with_context(|| path.display().to_string())?,
                scene.start,
            )
        }
        None => {
            let known = &PRESETS[0];
            let rest = State {
                position: 0.0,
                velocity: 0.0,
            };
            (Plant::new(known.device, known.counts_per_rev, 0.0)?, rest)
        }
    };
    let mut session = args.image.boot(plant, settings)?;
    session.bench.plant.let_go(start.velocity);
    on_port(args, record, |port, rows| {
        serve(&mut session, port, args.pace, stop::requested, rows)
    })
}

/// Writes a row of the record: time, knob, torque.
type Rows<'a> = &'a mut dyn FnMut(f64, State, f32) -> Result<()>;

/// Opens a port, says which, and serves until Ctrl-C.
fn on_port(
    args: &Args,
    mut record: Option<Output>,
    serve: impl FnOnce(&mut Port, Rows<'_>) -> Result<()>,
) -> Result<()> {
    let mut port = Port::open(args.port_link.as_deref())?;
    if args.json {
        say_line!("{}", serde_json::json!({ "port": port.path }));
    } else {
        say_line!("port {}", port.path.display());
        eprintln!("the firmware runs; try `knob info` in another terminal; Ctrl-C ends it");
    }
    if let Some(record) = &mut record {
        writeln!(record, "time_s,angle_rad,velocity_rad_s,torque_nm")?;
    }
    let mut rows = |time_s: f64, state: State, torque_nm: f32| match &mut record {
        Some(record) => {
            let State { position, velocity } = state;
            writeln!(record, "{time_s},{position},{velocity},{torque_nm}")
        }
        None => Ok(()),
    };
    serve(&mut port, &mut rows)?;
    publish_after_stop(record.into_iter().collect())?;
    Err(Ended.into())
}

/// Makes sure of the file that takes the place of the chip's flash; a new one is blank.
fn settings_file(path: &Path) -> Result<()> {
    match fs::read(path) {
        Ok(bytes) if bytes.len() == SETTINGS_BYTES => Ok(()),
        Ok(bytes) => bail!(
            "it is {} bytes long; accepted: a file of {SETTINGS_BYTES} bytes that `knob emulate` made, \
             or one that does not exist",
            bytes.len()
        ),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            Ok(fs::write(path, [0xFF; SETTINGS_BYTES])?)
        }
        Err(error) => Err(error.into()),
    }
}

/// Ticks, and carries bytes between the port and the firmware, until it is told to end. `record` sees
/// the time, the plant and the torque of every tick.
pub fn serve(
    session: &mut Session,
    port: &mut Port,
    pace: Pace,
    mut ended: impl FnMut() -> bool,
    mut record: impl FnMut(f64, State, f32) -> Result<()>,
) -> Result<()> {
    let mut due = Instant::now();
    let mut time_s = 0.0;
    while !ended() {
        let bytes = port.read()?;
        if !bytes.is_empty() {
            session.bench.emulator.send(&bytes)?;
        }
        let before = session.bench.plant.state();
        let report = session.tick()?;
        record(time_s, before, report.torque_nm)?;
        time_s += f64::from(report.period_s);
        port.write(&session.bench.emulator.receive()?)?;
        if pace == Pace::Real {
            due += Duration::from_secs_f32(report.period_s);
            let now = Instant::now();
            if due > now {
                std::thread::sleep(due - now);
            } else if now - due > Duration::from_secs(1) {
                // The machine was busy or asleep: time that is lost is not made up for.
                due = now;
            }
        }
    }
    Ok(())
}

/// A pseudo-terminal that the firmware's serial line ends in.
pub struct Port {
    host: File,
    /// Kept open, so that the line stays when a client leaves.
    _device: File,
    /// Bytes that the client has not taken yet.
    waiting: VecDeque<u8>,
    pub path: PathBuf,
    link: Option<PathBuf>,
    _registration: emulators::Registration,
}

impl Port {
    /// A new port, with a link to it if one is wanted.
    pub fn open(link: Option<&Path>) -> Result<Self> {
        let cannot = "cannot make a serial port";
        let host = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).context(cannot)?;
        grantpt(&host).context(cannot)?;
        unlockpt(&host).context(cannot)?;
        let name = ptsname(&host, Vec::new()).context(cannot)?;
        let path = PathBuf::from(name.to_str().context(cannot)?);
        let device = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY, Mode::empty())
            .context(cannot)?;
        let mut line = tcgetattr(&device).context(cannot)?;
        line.make_raw();
        tcsetattr(&device, OptionalActions::Now, &line).context(cannot)?;
        let flags = fcntl_getfl(&host).context(cannot)?;
        fcntl_setfl(&host, flags | OFlags::NONBLOCK).context(cannot)?;
        if let Some(link) = link {
            // A link that an earlier run left behind is replaced; anything else is not.
            if link.is_symlink() {
                fs::remove_file(link)
                    .with_context(|| format!("--port-link: {}", link.display()))?;
            }
            std::os::unix::fs::symlink(&path, link)
                .with_context(|| format!("--port-link: {}", link.display()))?;
        }
        Ok(Self {
            _registration: emulators::register(&path).context(cannot)?,
            host: File::from(host),
            _device: File::from(device),
            waiting: VecDeque::new(),
            path,
            link: link.map(Path::to_owned),
        })
    }

    /// What a client has sent since.
    pub fn read(&mut self) -> Result<Vec<u8>> {
        let mut buffer = [0; 256];
        match self.host.read(&mut buffer) {
            Ok(length) => Ok(buffer[..length].to_vec()),
            Err(error) if nothing_yet(&error) => Ok(Vec::new()),
            Err(error) => bail!("the serial port broke: {error}"),
        }
    }

    /// Hands bytes to the client. What it is slow to take waits; what is more than a client can
    /// have missed without being gone is lost, as on a wire.
    pub fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.waiting.extend(bytes);
        if self.waiting.len() > MOST_WAITING {
            self.waiting.clear();
        }
        while !self.waiting.is_empty() {
            let (next, _) = self.waiting.as_slices();
            match self.host.write(next) {
                Ok(0) => return Ok(()),
                Ok(length) => {
                    self.waiting.drain(..length);
                }
                Err(error) if nothing_yet(&error) => return Ok(()),
                Err(error) => bail!("the serial port broke: {error}"),
            }
        }
        Ok(())
    }
}

/// Not a failure: no room or no byte yet, or a signal came by.
fn nothing_yet(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Bytes that wait for a client, at most: two seconds of all that telemetry can carry.
const MOST_WAITING: usize = 1 << 17;

impl Drop for Port {
    fn drop(&mut self) {
        if let Some(link) = &self.link {
            let _ = fs::remove_file(link);
        }
    }
}
