//! Parameters as they come over the wire: their limits, their defaults, and how they
//! become a plan. Nothing reaches the tick that did not pass here.

use core::f64::consts::TAU;

use control::ConfigError;
use control::config::{Believed, Config, Interval, Law, Timing};
use control::encoder::EncoderConfig;
use control::plan::Plan;
use control::push::Push;
use protocol::{Drive, Motor, MotorName, Name, Parameters, Refusal, Shape, Stored};

use crate::drive::Power;
use crate::power::StageFacts;
use crate::store::Loaded;
use crate::ticker::Settled;

/// The least that each numeric parameter may be.
pub const LOWEST: Parameters = Parameters {
    sample_period_s: 40e-6,
    decimation: 1,
    counts_per_rev: 4,
    law: protocol::Law::Raw,
    shape: Shape::Spring,
    stiffness_nm_rad: 0.0,
    damping_nm_s_rad: 0.0,
    centre_rad: -1e3,
    wall_rad: -1e3,
    period_rad: 1e-3,
    torque_max_nm: 0.0,
    speed_max_rad_s: 1.0,
    inertia_kg_m2: between(1e-8, 1e-8),
    viscous_nm_s_rad: between(0.0, 0.0),
    coulomb_nm: between(0.0, 0.0),
    delay_s: 0.0,
    amplifier_tau_s: 0.0,
    jitter_s: 0.0,
    torque_step_nm: 0.0,
};

/// The most that each numeric parameter may be.
pub const HIGHEST: Parameters = Parameters {
    sample_period_s: 20e-3,
    decimation: 4096,
    counts_per_rev: 1_000_000,
    law: protocol::Law::Auto,
    shape: Shape::Detent,
    stiffness_nm_rad: 1e4,
    damping_nm_s_rad: 1.0,
    centre_rad: 1e3,
    wall_rad: 1e3,
    period_rad: 100.0,
    torque_max_nm: 10.0,
    speed_max_rad_s: 1e4,
    inertia_kg_m2: between(1e-1, 1e-1),
    viscous_nm_s_rad: between(1.0, 1.0),
    coulomb_nm: between(10.0, 10.0),
    delay_s: 20e-3,
    amplifier_tau_s: 20e-3,
    jitter_s: 10e-3,
    torque_step_nm: 1.0,
};

/// What a device starts with where nothing is stored: the paper's RE35 at 1 ms, no stiffness, and the law that takes no
/// more trouble than the demand needs.
pub const DEFAULTS: Parameters = Parameters {
    sample_period_s: 1e-3,
    decimation: 1,
    counts_per_rev: 8192,
    law: protocol::Law::Auto,
    shape: Shape::Spring,
    stiffness_nm_rad: 0.0,
    damping_nm_s_rad: 0.0,
    centre_rad: 0.0,
    wall_rad: 0.0,
    period_rad: 0.2,
    torque_max_nm: 0.5,
    speed_max_rad_s: 1000.0,
    inertia_kg_m2: between(6.28e-6, 6.28e-6),
    viscous_nm_s_rad: between(9e-6, 9e-6),
    coulomb_nm: between(2e-3, 2e-3),
    delay_s: 0.0,
    amplifier_tau_s: 0.0,
    jitter_s: 0.0,
    torque_step_nm: 0.0,
};

/// The least that each number of a motor may be.
pub const MOTOR_LOWEST: Motor = Motor {
    drive: Drive::None,
    pole_pairs: 1,
    resistance_ohm: 1e-3,
    d_inductance_h: 1e-7,
    q_inductance_h: 1e-7,
    torque_constant_nm_a: 1e-4,
    current_max_a: 0.0,
    reversed: false,
    zero_turns: -1.0,
    offset_b_codes: 0.0,
    offset_c_codes: 0.0,
};

/// The most.
pub const MOTOR_HIGHEST: Motor = Motor {
    drive: Drive::Brushed,
    pole_pairs: 100,
    resistance_ohm: 1e3,
    d_inductance_h: 1.0,
    q_inductance_h: 1.0,
    torque_constant_nm_a: 10.0,
    current_max_a: 30.0,
    reversed: true,
    zero_turns: 1.0,
    offset_b_codes: 4095.0,
    offset_c_codes: 4095.0,
};

/// No motor: nothing is driven until it is calibrated or set.
pub const NO_MOTOR: Motor = Motor {
    drive: Drive::None,
    pole_pairs: 1,
    resistance_ohm: 1.0,
    d_inductance_h: 1e-3,
    q_inductance_h: 1e-3,
    torque_constant_nm_a: 0.05,
    current_max_a: 0.0,
    reversed: false,
    zero_turns: 0.0,
    offset_b_codes: 2048.0,
    offset_c_codes: 2048.0,
};

/// All that is kept for the next start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Of the rendering, and of what is believed.
    pub parameters: Parameters,
    /// Of the motor.
    pub motor: Motor,
}

/// What a device starts with where nothing is stored.
pub const DEFAULT_SETTINGS: Settings = Settings {
    parameters: DEFAULTS,
    motor: NO_MOTOR,
};

const fn between(low: f32, high: f32) -> protocol::Interval {
    protocol::Interval { low, high }
}

/// What settings must know of the board that they are for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BoardKind {
    /// One whose torque output has an amplifier of its own.
    Amplifier {
        /// Width of the encoder's counter.
        counter_bits: u32,
    },
    /// One with a power stage, whose counter the current tick widens to 32 bits.
    Stage(StageFacts),
}

impl BoardKind {
    /// Width of the counter that the haptic tick reads.
    #[must_use]
    pub fn counter_bits(&self) -> u32 {
        match self {
            Self::Amplifier { counter_bits } => *counter_bits,
            Self::Stage(_) => 32,
        }
    }
}

/// What a device starts with, checked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    /// Where the parameters come from.
    pub stored: Stored,
    /// The settings.
    pub settings: Settings,
    /// What the tick uses.
    pub settled: Settled,
}

/// Checks what was stored; takes the defaults instead where it is not accepted.
///
/// # Errors
/// Not even the defaults are accepted on that board.
pub fn start(loaded: &Loaded, board: &BoardKind) -> Result<Start, Refusal> {
    let checked = settle(&loaded.settings, board);
    let refusal = match checked {
        Ok(settled) => {
            return Ok(Start {
                stored: loaded.stored,
                settings: loaded.settings,
                settled,
            });
        }
        Err(refusal) => refusal,
    };
    let stored = match refusal {
        Refusal::Value { name, .. }
        | Refusal::Reversed { name, .. }
        | Refusal::Together { name, .. } => Stored::Refused { name },
        Refusal::MotorValue { name, .. } => Stored::RefusedMotor { name },
        other => return Err(other),
    };
    Ok(Start {
        stored,
        settings: DEFAULT_SETTINGS,
        settled: settle(&DEFAULT_SETTINGS, board)?,
    })
}

/// One number of a motor.
type MotorNumber = fn(&Motor) -> f32;

const MOTOR_NUMBERS: [(MotorName, MotorNumber); 9] = [
    (MotorName::PolePairs, |m| m.pole_pairs as f32),
    (MotorName::ResistanceOhm, |m| m.resistance_ohm),
    (MotorName::DInductanceH, |m| m.d_inductance_h),
    (MotorName::QInductanceH, |m| m.q_inductance_h),
    (MotorName::TorqueConstantNmA, |m| m.torque_constant_nm_a),
    (MotorName::CurrentMaxA, |m| m.current_max_a),
    (MotorName::ZeroTurns, |m| m.zero_turns),
    (MotorName::OffsetBCodes, |m| m.offset_b_codes),
    (MotorName::OffsetCCodes, |m| m.offset_c_codes),
];

/// Checks a motor.
///
/// # Errors
/// The first value that is not accepted, with what would be.
pub fn motor(given: &Motor) -> Result<(), Refusal> {
    for (name, of) in MOTOR_NUMBERS {
        let (given, lowest, highest) = (of(given), of(&MOTOR_LOWEST), of(&MOTOR_HIGHEST));
        // Written so that NaN fails.
        if !(lowest <= given && given <= highest) {
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

/// Checks settings for a board, and makes them what the tick uses. How late and how coarse the torque of a power stage
/// is comes on top of what is believed.
///
/// # Errors
/// The first value that is not accepted, with what would be.
pub fn settle(settings: &Settings, board: &BoardKind) -> Result<Settled, Refusal> {
    let parameters = &settings.parameters;
    let mut config = config(parameters, board.counter_bits())?;
    motor(&settings.motor)?;
    let (mut power, mut delay_s) = (None, 0.0);
    if let BoardKind::Stage(stage) = board {
        let every = periods(parameters.sample_period_s, stage.pwm_period_s)?;
        let made = Power::new(
            &settings.motor,
            parameters.counts_per_rev,
            every,
            parameters.speed_max_rad_s,
            stage,
        )?;
        config.timing.period_s = f64::from(every) * stage.pwm_period_s;
        if let Some(delivery) =
            made.delivery(&settings.motor, stage, config.believed.inertia_kg_m2.low)
        {
            delay_s = delivery.delay_s;
            config.timing.delay_s += delay_s;
            config.timing.amplifier_tau_s += delivery.tau_s;
            config.torque_step_nm = config.torque_step_nm.max(delivery.torque_step_nm);
            config.torque_max_nm = config.torque_max_nm.min(delivery.torque_max_nm);
        }
        power = Some(made);
    }
    let plan = Plan::new(&config).map_err(|error| together(parameters, delay_s, error))?;
    let longest = 1.0 + parameters.jitter_s / parameters.sample_period_s;
    let furthest = parameters.speed_max_rad_s / plan.count_speed_rad_s() * longest;
    Ok(Settled {
        // One count more than the way at top speed: a move may begin and end anywhere in a cell.
        furthest_counts: furthest as u32 + 1,
        plan,
        power,
    })
}

/// By so much a sample period may differ from a whole number of PWM periods, in parts of it.
const WHOLE: f64 = 1e-4;

/// How many PWM periods a sample period is.
fn periods(sample_period_s: f32, pwm_period_s: f64) -> Result<u32, Refusal> {
    let periods = f64::from(sample_period_s) / pwm_period_s;
    let below = periods as u32;
    let nearest = (periods + 0.5) as u32;
    let off = periods - f64::from(nearest);
    if nearest >= 1 && -WHOLE * periods <= off && off <= WHOLE * periods {
        return Ok(nearest);
    }
    let whole = |n: u32| (f64::from(n) * pwm_period_s) as f32;
    Err(Refusal::Together {
        name: Name::SamplePeriodS,
        lowest: whole(below.max(1)),
        highest: whole(below + 1),
    })
}

/// Torque of a push lasts no longer than this, s.
pub const PUSH_MOST_S: f32 = 10.0;

/// The coast after it lasts no longer than this, s.
pub const COAST_MOST_S: f32 = 60.0;

/// Checks a push beside the parameters in force.
///
/// # Errors
/// [`Refusal::Push`]: a torque that is no number or beyond `torque_max_nm`; torque or coast that may last longer than
/// [`PUSH_MOST_S`] or [`COAST_MOST_S`]; a limit in counts, or a rest, of 0.
pub fn push(given: &protocol::Push, parameters: &Parameters) -> Result<Push, Refusal> {
    let protocol::Push {
        from_nm,
        to_nm,
        rise_ticks,
        most_ticks,
        way_counts,
        speed_counts,
        rest_ticks,
        coast_ticks,
        guard_counts,
    } = *given;
    let seconds = |ticks: u32| ticks as f32 * parameters.sample_period_s;
    // Written so that NaN fails.
    let torque = |nm: f32| nm.abs() <= parameters.torque_max_nm;
    let counts = [way_counts, speed_counts, guard_counts, rest_ticks];
    let accepted = torque(from_nm)
        && torque(to_nm)
        && seconds(most_ticks) <= PUSH_MOST_S
        && seconds(coast_ticks) <= COAST_MOST_S
        && counts.iter().all(|counts| *counts > 0);
    if !accepted {
        return Err(Refusal::Push);
    }
    Ok(Push {
        from_nm,
        to_nm,
        rise_ticks,
        most_ticks,
        way_counts,
        speed_counts,
        rest_ticks,
        coast_ticks,
        guard_counts,
    })
}

/// Values that are each accepted, but not together: names the one that shows it, with what
/// would be accepted beside the others. `delay_s` is the power stage's own.
fn together(parameters: &Parameters, delay_s: f64, error: ConfigError) -> Refusal {
    let p = parameters;
    let (name, lowest, highest) = match error {
        ConfigError::OutOfCounts { limit, .. } => {
            let name = match p.shape {
                Shape::Wall => Name::WallRad,
                Shape::Spring | Shape::Detent => Name::CentreRad,
            };
            // The limit itself is out.
            let limit = (limit as f32).next_down();
            (name, -limit, limit)
        }
        ConfigError::Period { least, most, .. } => {
            (Name::PeriodRad, -at_most(-least), at_most(most))
        }
        // The stage alone takes longer than the shortest period: with less jitter it does not.
        ConfigError::Delay { limit, .. } if limit < delay_s => (
            Name::JitterS,
            LOWEST.jitter_s,
            at_most((limit + f64::from(p.jitter_s) - delay_s).max(0.0)),
        ),
        ConfigError::Delay { limit, .. } => {
            (Name::DelayS, LOWEST.delay_s, at_most(limit - delay_s))
        }
        ConfigError::CounterBits(_) | ConfigError::Decimation(_) => (
            Name::Decimation,
            LOWEST.decimation as f32,
            HIGHEST.decimation as f32,
        ),
        _ if p.jitter_s >= p.sample_period_s => (
            Name::JitterS,
            LOWEST.jitter_s,
            p.sample_period_s.next_down(),
        ),
        _ => (
            Name::SamplePeriodS,
            LOWEST.sample_period_s,
            HIGHEST.sample_period_s,
        ),
    };
    Refusal::Together {
        name,
        lowest,
        highest,
    }
}

/// The largest `f32` that is not above `limit`.
fn at_most(limit: f64) -> f32 {
    let near = limit as f32;
    if f64::from(near) > limit {
        near.next_down()
    } else {
        near
    }
}

/// One number of the parameters.
type Number = fn(&Parameters) -> f32;

const NUMBERS: [(Name, Number); 12] = [
    (Name::SamplePeriodS, |p| p.sample_period_s),
    (Name::StiffnessNmRad, |p| p.stiffness_nm_rad),
    (Name::DampingNmSRad, |p| p.damping_nm_s_rad),
    (Name::CentreRad, |p| p.centre_rad),
    (Name::WallRad, |p| p.wall_rad),
    (Name::PeriodRad, |p| p.period_rad),
    (Name::TorqueMaxNm, |p| p.torque_max_nm),
    (Name::SpeedMaxRadS, |p| p.speed_max_rad_s),
    (Name::DelayS, |p| p.delay_s),
    (Name::AmplifierTauS, |p| p.amplifier_tau_s),
    (Name::JitterS, |p| p.jitter_s),
    (Name::TorqueStepNm, |p| p.torque_step_nm),
];

/// Checks parameters, and says them in the controller's words.
///
/// # Errors
/// The first value that is not accepted, with what would be.
pub fn config(parameters: &Parameters, counter_bits: u32) -> Result<Config, Refusal> {
    let p = parameters;
    for (name, of) in NUMBERS {
        number(name, of(p), of(&LOWEST), of(&HIGHEST))?;
    }
    whole(
        Name::Decimation,
        p.decimation,
        LOWEST.decimation,
        HIGHEST.decimation,
    )?;
    whole(
        Name::CountsPerRev,
        p.counts_per_rev,
        LOWEST.counts_per_rev,
        HIGHEST.counts_per_rev,
    )?;
    let believed = Believed {
        inertia_kg_m2: interval(
            Name::InertiaKgM2,
            p.inertia_kg_m2,
            LOWEST.inertia_kg_m2,
            HIGHEST.inertia_kg_m2,
        )?,
        viscous_nm_s_rad: interval(
            Name::ViscousNmSRad,
            p.viscous_nm_s_rad,
            LOWEST.viscous_nm_s_rad,
            HIGHEST.viscous_nm_s_rad,
        )?,
        coulomb_nm: interval(
            Name::CoulombNm,
            p.coulomb_nm,
            LOWEST.coulomb_nm,
            HIGHEST.coulomb_nm,
        )?,
    };
    Ok(Config {
        believed,
        timing: Timing {
            period_s: f64::from(p.sample_period_s),
            jitter_s: f64::from(p.jitter_s),
            // A tick that is missed puts torque to zero.
            may_miss: false,
            delay_s: f64::from(p.delay_s),
            amplifier_tau_s: f64::from(p.amplifier_tau_s),
        },
        torque_step_nm: f64::from(p.torque_step_nm),
        hardware_count_rad: TAU / f64::from(p.counts_per_rev),
        encoder: EncoderConfig::new(counter_bits, p.decimation)
            .map_err(|error| together(p, 0.0, error))?,
        shape: match p.shape {
            Shape::Spring => control::shape::Shape::Spring {
                centre_rad: f64::from(p.centre_rad),
            },
            Shape::Wall => control::shape::Shape::Wall {
                edge_rad: f64::from(p.wall_rad),
            },
            Shape::Detent => control::shape::Shape::Detent {
                centre_rad: f64::from(p.centre_rad),
                period_rad: f64::from(p.period_rad),
            },
        },
        stiffness_nm_rad: f64::from(p.stiffness_nm_rad),
        damping_nm_s_rad: f64::from(p.damping_nm_s_rad),
        law: match p.law {
            protocol::Law::Raw => Law::Raw,
            protocol::Law::Static => Law::Static,
            protocol::Law::Episode => Law::Episode,
            protocol::Law::Ledger => Law::Ledger,
            protocol::Law::Auto => Law::Auto,
        },
        torque_max_nm: f64::from(p.torque_max_nm),
    })
}

fn number(name: Name, given: f32, lowest: f32, highest: f32) -> Result<(), Refusal> {
    // Written so that NaN fails.
    if lowest <= given && given <= highest {
        Ok(())
    } else {
        Err(Refusal::Value {
            name,
            given,
            lowest,
            highest,
        })
    }
}

fn whole(name: Name, given: u32, lowest: u32, highest: u32) -> Result<(), Refusal> {
    if (lowest..=highest).contains(&given) {
        Ok(())
    } else {
        Err(Refusal::Value {
            name,
            given: given as f32,
            lowest: lowest as f32,
            highest: highest as f32,
        })
    }
}

fn interval(
    name: Name,
    given: protocol::Interval,
    lowest: protocol::Interval,
    highest: protocol::Interval,
) -> Result<Interval, Refusal> {
    number(name, given.low, lowest.low, highest.low)?;
    number(name, given.high, lowest.high, highest.high)?;
    if given.low > given.high {
        return Err(Refusal::Reversed {
            name,
            low: given.low,
            high: given.high,
        });
    }
    Ok(Interval {
        low: f64::from(given.low),
        high: f64::from(given.high),
    })
}
