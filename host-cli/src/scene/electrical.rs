//! `[electrical]`: windings behind an inverter, and the drive that brings the torque.

use anyhow::{Result, anyhow, bail};
use control::torque::angle::{EncoderOnMotor, MOST_COUNTS_PER_REV, MOST_POLE_PAIRS};
use control::torque::brushed::BrushedLoop;
use control::torque::current::CurrentLoop;
use control::torque::voltage::VoltageDrive;
use control::torque::{
    BrushedMotor, Delivery, FASTEST, InverterConfig, LIVELIEST, LoopConfig, ThreePhaseMotor,
    TorqueError,
};
use plant_sim::closed_loop::Scene;
use plant_sim::driven::{Driven, DrivenError, TorqueDrive};
use plant_sim::electrical::{CurrentSensing, Inverter, Supply, Winding};
use plant_sim::knob::KnobError;
use plant_sim::powered::{EncoderSetup, Setup};

use super::accepted::{bound, finite, not_negative, plain, positive, refuse};
use super::file::{BelievedTable, DeviceTable, DriveName, ElectricalTable, LoopTable};

/// The largest duty, which leaves the low sides on for long enough to measure.
const DUTY_MAX: f64 = 0.85;

/// The bus voltages that a drive reckons with, as parts of the source's: 8 and 25.68 of 24 V.
const BUS: [f64; 2] = [1.0 / 3.0, 1.07];

/// Steps of a duty that a drive reckons with where the bridge has none.
const FINEST_STEPS: u16 = u16::MAX;

/// The current step of a drive that does not look at currents, A.
const UNUSED_STEP_A: f64 = 0.02;

/// Windings that were checked, and what drives them.
#[derive(Clone)]
pub struct Electrical {
    winding: Winding,
    inverter: Inverter,
    sensing: CurrentSensing,
    supply: Supply,
    counts_per_rev: u32,
    drive: TorqueDrive,
    /// What the drive says of its torque.
    pub delivery: Delivery,
}

impl Electrical {
    /// At the start of a scene.
    ///
    /// # Errors
    /// See [`Driven::new`].
    pub fn driven(&self, scene: &Scene) -> Result<Driven, DrivenError> {
        Driven::new(&self.setup(scene), self.drive)
    }

    /// The knob at the start of a scene.
    pub fn setup(&self, scene: &Scene) -> Setup {
        Setup {
            device: scene.device,
            motor: scene.motor,
            hand: scene.hand,
            winding: self.winding,
            inverter: self.inverter,
            sensing: CurrentSensing {
                seed: scene.seed,
                ..self.sensing
            },
            supply: self.supply,
            encoder: EncoderSetup {
                counts_per_rev: self.counts_per_rev,
                reversed: false,
                zero_turns: 0.0,
            },
            start: scene.start,
        }
    }
}

/// Reads the table, and fills in what the windings make of `[loop]`: delay, lag, steps and limit of the torque.
pub fn read(
    table: &ElectricalTable,
    believed: &BelievedTable,
    device: &DeviceTable,
    sampling: &mut LoopTable,
) -> Result<Electrical> {
    contradictions(table, believed, sampling)?;
    let pwm_period_s = positive("electrical.pwm_period_s", table.pwm_period_s)?;
    whole_periods(sampling.sample_period_s, pwm_period_s)?;
    let counts_per_rev = whole_counts(device)?;
    let inverter = Inverter {
        pwm_period_s,
        pwm_steps: table.pwm_steps,
        dead_time_s: not_negative("electrical.dead_time_s", table.dead_time_s)?,
        dead_time_edge_a: positive("electrical.dead_time_edge_a", table.dead_time_edge_a)?,
        late: table.late,
    };
    let sensing = sensing(table)?;
    let supply = supply(table)?;
    let reckoned = InverterConfig {
        pwm_period_s,
        pwm_steps: if table.pwm_steps == 0 {
            FINEST_STEPS
        } else {
            table.pwm_steps
        },
        dead_time_s: table.dead_time_s,
        dead_time_edge_a: table.dead_time_edge_a,
        duty_max: DUTY_MAX,
        bus_least_v: BUS[0] * supply.source_v,
        bus_most_v: BUS[1] * supply.source_v,
        current_step_a: sensing.step_a,
    };
    let tolerance = not_negative("electrical.tolerance", table.tolerance)?;
    if tolerance > 0.9 {
        return Err(refuse("electrical.tolerance", tolerance, "0 to 0.9"));
    }
    let asked = LoopConfig {
        bandwidth_rad_s: positive(
            "electrical.bandwidth_rad_s",
            table.bandwidth_rad_s.unwrap_or(FASTEST / pwm_period_s),
        )?,
        current_max_a: positive("electrical.current_max_a", table.current_max_a)?,
        tolerance,
    };
    let (winding, told, drive) = match table.drive {
        DriveName::Brushed => {
            let (motor, told) = brushed(table, believed)?;
            let drive = BrushedLoop::new(&told, &reckoned, &asked).map(TorqueDrive::Brushed);
            (Winding::Brushed(motor), Winding::Brushed(told), drive)
        }
        DriveName::Current | DriveName::Voltage => {
            let (motor, told) = three_phase(table, believed)?;
            let encoder = EncoderOnMotor {
                counts_per_rev,
                zero_turns: 0.0,
            };
            let drive = if let DriveName::Current = table.drive {
                CurrentLoop::new(&told, &encoder, &reckoned, &asked).map(TorqueDrive::Current)
            } else {
                VoltageDrive::new(&told, &encoder, &reckoned, asked.current_max_a, tolerance)
                    .map(TorqueDrive::Voltage)
            };
            (Winding::ThreePhase(motor), Winding::ThreePhase(told), drive)
        }
    };
    let drive = drive.map_err(|error| drive_named(error, &asked, pwm_period_s))?;
    plant_sim::electrical::Electrical::new(winding, inverter, sensing, supply)
        .map_err(|error| winding_named(error, table))?;
    let delivery = drive.delivery(&told, counts_per_rev, pwm_period_s);
    sampling.delay_s = delivery.delay_s;
    sampling.amplifier_tau_s = delivery.tau_s;
    sampling.torque_step_nm = delivery.torque_step_nm;
    sampling.torque_max_nm = sampling.torque_max_nm.min(delivery.torque_max_nm);
    Ok(Electrical {
        winding,
        inverter,
        sensing,
        supply,
        counts_per_rev,
        drive,
        delivery,
    })
}

/// Refuses what the file says twice, or says to a drive that does not read it.
fn contradictions(
    table: &ElectricalTable,
    believed: &BelievedTable,
    sampling: &LoopTable,
) -> Result<()> {
    for (key, value) in [
        ("delay_s", sampling.delay_s),
        ("amplifier_tau_s", sampling.amplifier_tau_s),
        ("torque_step_nm", sampling.torque_step_nm),
    ] {
        if value != 0.0 {
            bail!(
                "loop.{key} is {}, but [electrical] brings its own; accepted: believed.{key}, for what the \
                 controller is told",
                plain(value)
            );
        }
    }
    if sampling.jitter_s != 0.0 {
        bail!(
            "loop.jitter_s is {}, but with [electrical] ticks come at PWM periods; accepted: 0",
            plain(sampling.jitter_s)
        );
    }
    let brushed = table.drive == DriveName::Brushed;
    let voltage = table.drive == DriveName::Voltage;
    for (key, given, unread) in [
        ("electrical.pole_pairs", table.pole_pairs.is_some(), brushed),
        ("electrical.flux_wb", table.flux_wb.is_some(), brushed),
        (
            "electrical.d_inductance_h",
            table.d_inductance_h.is_some(),
            brushed,
        ),
        (
            "electrical.q_inductance_h",
            table.q_inductance_h.is_some(),
            brushed,
        ),
        (
            "believed.d_inductance_h",
            believed.d_inductance_h.is_some(),
            brushed,
        ),
        (
            "believed.q_inductance_h",
            believed.q_inductance_h.is_some(),
            brushed,
        ),
        (
            "electrical.inductance_h",
            table.inductance_h.is_some(),
            !brushed,
        ),
        (
            "believed.inductance_h",
            believed.inductance_h.is_some(),
            !brushed,
        ),
        (
            "electrical.bandwidth_rad_s",
            table.bandwidth_rad_s.is_some(),
            voltage,
        ),
        (
            "electrical.current_step_a",
            table.current_step_a.is_some(),
            voltage,
        ),
        (
            "electrical.current_noise_a",
            table.current_noise_a != 0.0,
            voltage,
        ),
        (
            "electrical.current_offset_a",
            table.current_offset_a != [0.0; 2],
            voltage,
        ),
    ] {
        if given && unread {
            let name = match table.drive {
                DriveName::Current => "current",
                DriveName::Voltage => "voltage",
                DriveName::Brushed => "brushed",
            };
            bail!("{key} is given, but drive = \"{name}\" does not read it; accepted: without it");
        }
    }
    Ok(())
}

/// A sample is a whole number of PWM periods.
fn whole_periods(sample_period_s: f64, pwm_period_s: f64) -> Result<()> {
    positive("loop.sample_period_s", sample_period_s)?;
    let ratio = sample_period_s / pwm_period_s;
    let whole = ratio.round().max(1.0);
    if (ratio - whole).abs() <= 1e-9 * whole {
        return Ok(());
    }
    bail!(
        "loop.sample_period_s is {}, {} times electrical.pwm_period_s; accepted: a whole multiple, the nearest is {} s",
        plain(sample_period_s),
        bound(ratio),
        plain(whole * pwm_period_s)
    )
}

/// Counts in a turn as the drive counts them.
fn whole_counts(device: &DeviceTable) -> Result<u32> {
    let Some(counts) = device.counts_per_rev else {
        bail!(
            "device.counts_per_rev is missing; accepted: it, as [electrical] needs a whole turn of counts"
        );
    };
    let nearest = counts.round().clamp(2.0, f64::from(MOST_COUNTS_PER_REV));
    if counts == nearest {
        return Ok(counts as u32);
    }
    let accepted = format!(
        "with [electrical] a whole number from 2 to {MOST_COUNTS_PER_REV}; the nearest is {nearest}"
    );
    Err(refuse("device.counts_per_rev", counts, &accepted))
}

fn sensing(table: &ElectricalTable) -> Result<CurrentSensing> {
    let step_a = match (table.drive, table.current_step_a) {
        (_, Some(step_a)) => positive("electrical.current_step_a", step_a)?,
        (DriveName::Voltage, None) => UNUSED_STEP_A,
        (_, None) => bail!(
            "electrical.current_step_a is missing; accepted: the step of the current converters, A"
        ),
    };
    let [b, c] = table.current_offset_a;
    Ok(CurrentSensing {
        step_a,
        noise_a: not_negative("electrical.current_noise_a", table.current_noise_a)?,
        offset_a: [
            finite("electrical.current_offset_a", b)?,
            finite("electrical.current_offset_a", c)?,
        ],
        seed: 0,
    })
}

fn supply(table: &ElectricalTable) -> Result<Supply> {
    let supply = Supply {
        source_v: positive("electrical.source_v", table.source_v)?,
        source_ohm: not_negative("electrical.source_ohm", table.source_ohm)?,
        capacitance_f: not_negative("electrical.capacitance_f", table.capacitance_f)?,
        takes_back: table.takes_back,
    };
    if supply.source_ohm > 0.0 && supply.capacitance_f == 0.0 {
        bail!(
            "electrical.source_ohm is {}, but electrical.capacitance_f is missing; accepted: both",
            plain(supply.source_ohm)
        );
    }
    if supply.source_ohm == 0.0 && (supply.capacitance_f > 0.0 || !supply.takes_back) {
        bail!(
            "electrical.{} is given, but source_ohm is 0, which holds the bus where it is; accepted: both",
            if supply.takes_back {
                "capacitance_f"
            } else {
                "takes_back"
            }
        );
    }
    Ok(supply)
}

/// The motor as it is, and as the drive is told it is.
fn brushed(
    table: &ElectricalTable,
    believed: &BelievedTable,
) -> Result<(BrushedMotor, BrushedMotor)> {
    let motor = BrushedMotor {
        resistance_ohm: positive("electrical.resistance_ohm", table.resistance_ohm)?,
        inductance_h: needed("electrical.inductance_h", table.inductance_h)?,
        torque_constant_nm_a: needed(
            "electrical.torque_constant_nm_a",
            table.torque_constant_nm_a,
        )?,
    };
    let told = BrushedMotor {
        resistance_ohm: told(
            "believed.resistance_ohm",
            believed.resistance_ohm,
            motor.resistance_ohm,
        )?,
        inductance_h: told(
            "believed.inductance_h",
            believed.inductance_h,
            motor.inductance_h,
        )?,
        ..motor
    };
    Ok((motor, told))
}

fn three_phase(
    table: &ElectricalTable,
    believed: &BelievedTable,
) -> Result<(ThreePhaseMotor, ThreePhaseMotor)> {
    let Some(pole_pairs) = table.pole_pairs else {
        bail!(
            "electrical.pole_pairs is missing; accepted: a whole number from 1 to {MOST_POLE_PAIRS}"
        );
    };
    if !(1..=MOST_POLE_PAIRS).contains(&pole_pairs) {
        bail!(
            "electrical.pole_pairs is {pole_pairs}; accepted: a whole number from 1 to {MOST_POLE_PAIRS}"
        );
    }
    let flux_wb = match (table.flux_wb, table.torque_constant_nm_a) {
        (Some(flux_wb), None) => positive("electrical.flux_wb", flux_wb)?,
        (None, Some(constant)) => {
            let constant = positive("electrical.torque_constant_nm_a", constant)?;
            constant / (1.5 * f64::from(pole_pairs))
        }
        (Some(_), Some(_)) => bail!(
            "electrical.flux_wb and electrical.torque_constant_nm_a are both given; accepted: one of them"
        ),
        (None, None) => {
            bail!("electrical.flux_wb is missing; accepted: it, or electrical.torque_constant_nm_a")
        }
    };
    let d_inductance_h = needed("electrical.d_inductance_h", table.d_inductance_h)?;
    let motor = ThreePhaseMotor {
        resistance_ohm: positive("electrical.resistance_ohm", table.resistance_ohm)?,
        d_inductance_h,
        q_inductance_h: told(
            "electrical.q_inductance_h",
            table.q_inductance_h,
            d_inductance_h,
        )?,
        flux_wb,
        pole_pairs,
    };
    let told = ThreePhaseMotor {
        resistance_ohm: told(
            "believed.resistance_ohm",
            believed.resistance_ohm,
            motor.resistance_ohm,
        )?,
        d_inductance_h: told(
            "believed.d_inductance_h",
            believed.d_inductance_h,
            motor.d_inductance_h,
        )?,
        q_inductance_h: told(
            "believed.q_inductance_h",
            believed.q_inductance_h,
            motor.q_inductance_h,
        )?,
        ..motor
    };
    Ok((motor, told))
}

fn needed(key: &str, value: Option<f64>) -> Result<f64> {
    let Some(value) = value else {
        bail!("{key} is missing; accepted: a finite number above 0");
    };
    positive(key, value)
}

/// What is given, or else this.
fn told(key: &str, given: Option<f64>, or: f64) -> Result<f64> {
    given.map_or(Ok(or), |value| positive(key, value))
}

/// What no drive can be made of, under the file's names. What could be seen in one value alone was refused before.
fn drive_named(error: TorqueError, asked: &LoopConfig, pwm_period_s: f64) -> anyhow::Error {
    match error {
        TorqueError::Above { name, .. } if name.starts_with("bandwidth") => {
            let most = LIVELIEST * (1.0 - asked.tolerance) / pwm_period_s;
            let accepted = format!(
                "up to {}, {LIVELIEST}·(1 − tolerance)/pwm_period_s",
                bound(most)
            );
            refuse(
                "electrical.bandwidth_rad_s",
                asked.bandwidth_rad_s,
                &accepted,
            )
        }
        other => anyhow!("[electrical] makes no drive: {other}"),
    }
}

/// The same for the windings.
fn winding_named(error: KnobError, table: &ElectricalTable) -> anyhow::Error {
    let KnobError::Above { value, limit, .. } = error else {
        return anyhow!("[electrical] makes no windings: {error}");
    };
    let accepted = format!(
        "up to {limit} for resistance / inductance × pwm_period_s, which is {}",
        bound(value)
    );
    refuse("electrical.resistance_ohm", table.resistance_ohm, &accepted)
}
