//! A knob with windings: the image with a power stage, one PWM period at a time.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use plant_sim::hold::State;
use plant_sim::powered::{Powered, Setup};
use plant_sim::powered_lockstep::{
    CURRENT_STEP_A, DriveEmulator, PWM_PERIOD_S, PoweredBench, Surroundings,
};

use super::{Pace, Port};

/// Where `cargo xtask firmware` puts the image.
const IMAGE: &str = "target/firmware/emulated_drive.elf";

/// PWM periods between two looks at the port: 1 ms.
const AT_A_TIME: u32 = 24;

/// Boots the image against a scene's knob, which gets the board's bridge: its converters' step, and duties that act
/// a period later.
pub fn boot(image: Option<&Path>, setup: &Setup, settings: Option<&Path>) -> Result<PoweredBench> {
    let mut setup = *setup;
    if (setup.inverter.pwm_period_s / PWM_PERIOD_S - 1.0).abs() > 1e-6 {
        bail!(
            "electrical.pwm_period_s is {}; accepted by the emulated board: {PWM_PERIOD_S}",
            setup.inverter.pwm_period_s
        );
    }
    setup.inverter.late = true;
    setup.sensing.step_a = CURRENT_STEP_A;
    let image = image.map_or_else(|| PathBuf::from(IMAGE), Path::to_owned);
    Ok(PoweredBench {
        emulator: DriveEmulator::start(&image, 3, &[], settings).context("--firmware")?,
        knob: Powered::new(&setup)?,
        around: Surroundings::default(),
    })
}

/// PWM periods, and bytes between the port and the firmware, until it is told to end. `record` sees the time, the knob and
/// the mean torque of every millisecond.
pub fn serve(
    bench: &mut PoweredBench,
    port: &mut Port,
    pace: Pace,
    mut ended: impl FnMut() -> bool,
    mut record: impl FnMut(f64, State, f32) -> Result<()>,
) -> Result<()> {
    let mut due = Instant::now();
    let mut periods = 0_u64;
    while !ended() {
        let bytes = port.read()?;
        if !bytes.is_empty() {
            bench.emulator.send(&bytes)?;
        }
        let before = bench.knob.state();
        let mut torque_nm = 0.0;
        for _ in 0..AT_A_TIME {
            torque_nm += bench.period()?.turned.electrical.torque_nm / f64::from(AT_A_TIME);
        }
        record(periods as f64 * PWM_PERIOD_S, before, torque_nm as f32)?;
        periods += u64::from(AT_A_TIME);
        port.write(&bench.emulator.receive()?)?;
        if pace == Pace::Real {
            due += Duration::from_secs_f64(f64::from(AT_A_TIME) * PWM_PERIOD_S);
            let now = Instant::now();
            if due > now {
                std::thread::sleep(due - now);
            } else if now - due > Duration::from_secs(1) {
                // The machine was busy or too slow: time that is lost is not made up for.
                due = now;
            }
        }
    }
    Ok(())
}
