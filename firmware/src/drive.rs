//! What drives the motor: one of the drives of [`control::torque`], made from what is known of the motor and of
//! the power stage.

use core::f64::consts::TAU;

use control::torque::angle::EncoderOnMotor;
use control::torque::brushed::BrushedLoop;
use control::torque::current::CurrentLoop;
use control::torque::modulation::Duties;
use control::torque::sense::CurrentSense;
use control::torque::voltage::VoltageDrive;
use control::torque::{
    BrushedMotor, Delivery, FASTEST, InverterConfig, LoopConfig, Measured, ThreePhaseMotor,
};
use protocol::{Drive, Motor, MotorName, Refusal};

use crate::guard::{self, Limits};
use crate::power::StageFacts;
use crate::settings::{HIGHEST, MOTOR_HIGHEST, MOTOR_LOWEST};

/// The part by which resistance and inductance may be off: copper is a third more at 110 °C than at 25 °C.
pub const TOLERANCE: f64 = 0.3;

/// The loops' bandwidth, rad/s times the PWM period.
const BANDWIDTH: f64 = FASTEST;

/// The fewest PWM periods over which the speed is taken.
const LEAST_WINDOW: u32 = 16;
/// The most.
pub const MOST_WINDOW: u32 = 128;

/// The same of a voltage drive.
const VOLTAGE_WINDOW: u32 = 32;

/// A motor's drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotorDrive {
    /// Three phases, by their currents.
    Current(CurrentLoop),
    /// Three phases, by voltage.
    Voltage(VoltageDrive),
    /// Brushed, by its current.
    Brushed(BrushedLoop),
}

impl MotorDrive {
    /// The drive for a motor within [`MOTOR_LOWEST`] and [`MOTOR_HIGHEST`], whose encoder has `counts_per_rev` counts; none
    /// where the motor says so.
    ///
    /// # Errors
    /// The value of the motor that is not accepted, with what would be.
    pub fn new(
        motor: &Motor,
        counts_per_rev: u32,
        stage: &StageFacts,
    ) -> Result<Option<Self>, Refusal> {
        offsets(motor, stage)?;
        let inverter = InverterConfig {
            pwm_period_s: stage.pwm_period_s,
            pwm_steps: stage.pwm_steps,
            dead_time_s: stage.dead_time_s,
            dead_time_edge_a: stage.dead_time_edge_a,
            duty_max: stage.duty_max,
            bus_least_v: stage.bus_least_v,
            bus_most_v: stage.bus_most_v,
            current_step_a: stage.current_step_a,
        };
        let current_max_a =
            f64::from(motor.current_max_a).min(guard::largest_current_a(motor, stage));
        let asked = LoopConfig {
            bandwidth_rad_s: BANDWIDTH / stage.pwm_period_s,
            current_max_a,
            tolerance: TOLERANCE,
        };
        let three_phase = ThreePhaseMotor {
            resistance_ohm: f64::from(motor.resistance_ohm),
            d_inductance_h: f64::from(motor.d_inductance_h),
            q_inductance_h: f64::from(motor.q_inductance_h),
            flux_wb: f64::from(motor.torque_constant_nm_a) / (1.5 * f64::from(motor.pole_pairs)),
            pole_pairs: motor.pole_pairs,
        };
        let encoder = EncoderOnMotor {
            counts_per_rev,
            zero_turns: f64::from(motor.zero_turns),
        };
        let made = match motor.drive {
            Drive::None => return Ok(None),
            Drive::Current => {
                CurrentLoop::new(&three_phase, &encoder, &inverter, &asked).map(Self::Current)
            }
            Drive::Voltage => {
                slowest(motor)?;
                VoltageDrive::new(&three_phase, &encoder, &inverter, current_max_a, TOLERANCE)
                    .map(Self::Voltage)
            }
            Drive::Brushed => {
                let brushed = BrushedMotor {
                    resistance_ohm: f64::from(motor.resistance_ohm),
                    inductance_h: f64::from(motor.d_inductance_h),
                    torque_constant_nm_a: f64::from(motor.torque_constant_nm_a),
                };
                BrushedLoop::new(&brushed, &inverter, &asked).map(Self::Brushed)
            }
        };
        // Within the limits of a motor there is always a drive: the tests try.
        made.map(Some).map_err(|_| Refusal::NoMotor)
    }

    /// What a governor must know of its torque.
    #[must_use]
    pub fn delivery(&self) -> Delivery {
        match self {
            Self::Current(drive) => drive.delivery(),
            Self::Voltage(drive) => drive.delivery(),
            Self::Brushed(drive) => drive.delivery(),
        }
    }

    /// One period: the duties that bring a torque (Nm).
    #[must_use]
    #[inline]
    pub fn tick(&mut self, torque_nm: f32, measured: &Measured) -> Duties {
        match self {
            Self::Current(drive) => drive.tick(torque_nm, measured),
            Self::Voltage(drive) => drive.tick(torque_nm, measured),
            Self::Brushed(drive) => drive.tick(torque_nm, measured),
        }
    }

    /// The voltage that it takes beyond the motor's equation, V; 0 of a voltage drive, which does not look.
    #[must_use]
    #[inline]
    pub fn unexplained_v(&self) -> f32 {
        match self {
            Self::Current(drive) => drive.unexplained_v(),
            Self::Voltage(_) => 0.0,
            Self::Brushed(drive) => drive.unexplained_v(),
        }
    }

    /// Forgets the past: to be called where the bridge was off.
    #[inline]
    pub fn clear(&mut self) {
        match self {
            Self::Current(drive) => drive.clear(),
            Self::Voltage(_) => {}
            Self::Brushed(drive) => drive.clear(),
        }
    }
}

/// Codes without current that no good board has are a mistake.
fn offsets(motor: &Motor, stage: &StageFacts) -> Result<(), Refusal> {
    let lowest = (stage.current_zero_code - stage.current_zero_spread) as f32;
    let highest = (stage.current_zero_code + stage.current_zero_spread) as f32;
    for (name, given) in [
        (MotorName::OffsetBCodes, motor.offset_b_codes),
        (MotorName::OffsetCCodes, motor.offset_c_codes),
    ] {
        if !(lowest..=highest).contains(&given) {
            return Err(Refusal::MotorValue {
                name,
                given,
                lowest,
                highest,
            });
        }
    }
    Ok(())
}

/// Of a voltage drive, the lag is the windings' own, and a governor can be told of one up to a limit.
fn slowest(motor: &Motor) -> Result<(), Refusal> {
    let worst = (1.0 + TOLERANCE as f32) / (1.0 - TOLERANCE as f32);
    let highest =
        (HIGHEST.amplifier_tau_s / worst * motor.resistance_ohm).min(MOTOR_HIGHEST.q_inductance_h);
    if motor.q_inductance_h <= highest {
        return Ok(());
    }
    Err(Refusal::MotorValue {
        name: MotorName::QInductanceH,
        given: motor.q_inductance_h,
        lowest: MOTOR_LOWEST.q_inductance_h,
        highest,
    })
}

/// What the current tick takes of checked settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Power {
    /// n: the haptic tick comes in every n-th PWM period.
    pub every: u32,
    /// What drives the motor; none until it is known.
    pub drive: Option<MotorDrive>,
    /// The current converters.
    pub sense: CurrentSense,
    /// The counter falls where the motor's torque is positive.
    pub reversed: bool,
    /// The window of the speed, PWM periods, at most [`MOST_WINDOW`].
    pub window: u32,
    /// The speed of one count in the window, rad/s.
    pub count_speed_rad_s: f32,
    /// What puts torque to zero.
    pub limits: Limits,
}

impl Power {
    /// For a haptic tick in every `every`-th PWM period and a knob of at most `speed_max_rad_s`.
    ///
    /// # Errors
    /// As [`MotorDrive::new`].
    pub fn new(
        motor: &Motor,
        counts_per_rev: u32,
        every: u32,
        speed_max_rad_s: f32,
        stage: &StageFacts,
    ) -> Result<Self, Refusal> {
        let drive = MotorDrive::new(motor, counts_per_rev, stage)?;
        let window = window(motor, counts_per_rev, stage);
        let offsets = [motor.offset_b_codes, motor.offset_c_codes].map(f64::from);
        let window_s = f64::from(window) * stage.pwm_period_s;
        Ok(Self {
            every,
            drive,
            // The step is the stage's, and the offsets were checked.
            sense: CurrentSense::new(stage.current_step_a, offsets)
                .map_err(|_| Refusal::NoMotor)?,
            reversed: motor.reversed,
            window,
            count_speed_rad_s: (TAU / f64::from(counts_per_rev) / window_s) as f32,
            limits: Limits::new(motor, counts_per_rev, speed_max_rad_s, stage),
        })
    }

    /// What a governor must know of the torque on a knob of at least `inertia_kg_m2`: the drive's own, and what a speed
    /// that is coarse and late makes of it.
    ///
    /// A count more or less in the window W is a step of the back-EMF, k_e·Δ/W. A loop with the gain K_p ≥ ω_c·L takes it
    /// back, but begins with k/K_p of it: torque that is not as commanded, which goes to the step.
    ///
    /// Duties are whole steps, so the voltage is wrong by up to D = V/N between B and C, by 2/3 of that as a vector. From one
    /// period to the next it changes by 2·D at most, to which the loop lets the current rise by
    /// 2·D/(ω_c·L)·r^(r/(1 − r)) ≤ 2·D/(ω_c·L + R), r = R/(ω_c·L): torque either way, so twice that goes to the step.
    ///
    /// What of the back-EMF is made up for comes D = W/2 + 1½ periods late. The windings of a voltage drive make a drag of
    /// what is not. A loop answers with s/((L s + R)(s + ω_c)) of it, and the torque along the speed is
    /// −k·k_e·D/(R·ω_c)·ω² at a frequency ω. A spring m·ω² with a lag τ has −m·ω²·τ: it is as much as a lag of
    /// k·k_e·D/(R·ω_c·m).
    #[must_use]
    pub fn delivery(
        &self,
        motor: &Motor,
        stage: &StageFacts,
        inertia_kg_m2: f64,
    ) -> Option<Delivery> {
        let drive = self.drive.as_ref()?;
        let mut delivery = drive.delivery();
        let constant = f64::from(motor.torque_constant_nm_a);
        let resistance_ohm = f64::from(motor.resistance_ohm);
        if let MotorDrive::Voltage(_) = drive {
            return Some(delivery);
        }
        let count_v = back_emf_v_s(motor) * f64::from(self.count_speed_rad_s);
        let gain_v_a = least_gain_v_a(motor, stage);
        let rounding_v = match drive {
            MotorDrive::Brushed(_) => 1.0,
            MotorDrive::Current(_) | MotorDrive::Voltage(_) => 2.0 / 3.0,
        } * stage.bus_most_v
            / f64::from(stage.pwm_steps);
        delivery.torque_step_nm +=
            constant * (count_v / gain_v_a + 4.0 * rounding_v / (gain_v_a + resistance_ohm));
        let late_s = (0.5 * f64::from(self.window) + 1.5) * stage.pwm_period_s;
        let bandwidth_rad_s = BANDWIDTH / stage.pwm_period_s;
        delivery.tau_s += constant * back_emf_v_s(motor) * late_s
            / (resistance_ohm * bandwidth_rad_s * inertia_kg_m2);
        Some(delivery)
    }
}

/// The back-EMF along q, or of a brushed motor, V per rad/s of the shaft.
fn back_emf_v_s(motor: &Motor) -> f64 {
    let constant = f64::from(motor.torque_constant_nm_a);
    match motor.drive {
        Drive::Brushed => constant,
        Drive::None | Drive::Current | Drive::Voltage => constant / 1.5,
    }
}

/// ω_c·L, which the loop's gain is at least, V/A.
fn least_gain_v_a(motor: &Motor, stage: &StageFacts) -> f64 {
    let inductance_h = match motor.drive {
        Drive::Brushed => motor.d_inductance_h,
        Drive::None | Drive::Current | Drive::Voltage => motor.q_inductance_h,
    };
    BANDWIDTH / stage.pwm_period_s * f64::from(inductance_h)
}

/// How many PWM periods the speed is taken over. With a loop, so many that a count more or less makes no more current
/// than a step of the converter.
fn window(motor: &Motor, counts_per_rev: u32, stage: &StageFacts) -> u32 {
    if motor.drive == Drive::Voltage {
        return VOLTAGE_WINDOW;
    }
    let count_speed_rad_s = TAU / f64::from(counts_per_rev) / stage.pwm_period_s;
    let current_a = back_emf_v_s(motor) * count_speed_rad_s / least_gain_v_a(motor, stage);
    let periods = current_a / stage.current_step_a + 1.0;
    (periods as u32).clamp(LEAST_WINDOW, MOST_WINDOW)
}
