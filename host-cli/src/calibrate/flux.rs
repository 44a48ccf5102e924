//! The magnets' flux ψ, from the voltage across the rotor that R i does not explain, in a field that turns fast.

use std::f64::consts::{PI, TAU};

use plant_sim::identify::Estimate;
use protocol::Excitation;

use super::Bench;
use super::refusal::Refusal;
use super::shared::{Calibration, DEVIATIONS, Level, at_most, mean};
use super::sums::{self, PER_TURN, Vector, turned};
use super::three_phase::Turn;

/// How fast the shaft is turned at first, and at most, rad/s.
const FIRST_SPIN_RAD_S: f64 = 8.0;
const SPIN_RAD_S: f64 = 40.0;

/// The part of the voltage that back-EMF is to have.
const EMF_PART: f64 = 0.4;

/// By how much the zero of a fast turn may differ from that of the slow one, electrical turns.
const OFF_TURNS: f64 = 0.03;

/// Of the flux, beside the noise.
const SYSTEMATIC: f64 = 0.02;

/// What a spin brought.
struct Spin {
    flux_wb: f64,
    deviation_wb: f64,
    /// i_d, A.
    along_a: f64,
    /// Against the voltage, A.
    current: Vector,
    /// By how much the back-EMF leads the rotor's q axis, turns: by how much the zero is wrong.
    off_turns: f64,
}

/// ψ, Wb.
///
/// The first spin is slow and tells how fast the second may be. Each tells the next where its current lies:
/// there dead time is made up for, as it else turns a small voltage by degrees.
pub(super) fn measure<B: Bench>(
    calibration: &mut Calibration<'_, B>,
    level: &Level,
    resistance_ohm: f64,
    turn: &Turn,
    inductances: [Estimate; 2],
) -> Result<Estimate, B::Error> {
    let pole_pairs = f64::from(turn.pole_pairs);
    let held_v = resistance_ohm * level.vector.norm();
    let motor = Motor {
        level: *level,
        resistance_ohm,
        inductance_h: inductances.map(|estimate| estimate.value),
    };
    let slow = FIRST_SPIN_RAD_S * pole_pairs;
    let expected = Vector::new(level.vector.norm(), 0.0);
    let first = spin(calibration, &motor, turn, slow, expected)?;
    let lag = -first.current.arg();
    let fast = (EMF_PART * held_v / first.flux_wb.abs()).min(SPIN_RAD_S * pole_pairs);
    // The lag grows with the speed, up to the angle whose sine is the back-EMF's part.
    let there = Vector::from_polar(first.current.norm(), -(lag * fast / slow).min(0.45));
    let second = spin(calibration, &motor, turn, fast, there)?;
    let forth = spin(calibration, &motor, turn, fast, second.current)?;
    let back = spin(calibration, &motor, turn, -fast, second.current.conj())?;
    let value = 0.5 * (forth.flux_wb + back.flux_wb);
    let deviation = 0.5 * forth.deviation_wb.hypot(back.deviation_wb);
    // The two ways differ by what an angle that is a little off brings, of which the second order remains.
    let differ = 0.5 * (forth.flux_wb - back.flux_wb).abs();
    let along_a = forth.along_a.abs().max(back.along_a.abs());
    let off_turns = 0.5 * (forth.off_turns + back.off_turns).abs();
    if !at_most(off_turns, OFF_TURNS) {
        return Err(Refusal::ZeroMoved { turns: off_turns }.into());
    }
    let half = DEVIATIONS * deviation
        + 0.1 * differ
        + 0.5 * (inductances[0].high - inductances[0].low) * along_a
        + SYSTEMATIC * value.abs();
    let found = Estimate {
        value,
        low: value - half,
        high: value + half,
    };
    if !(found.low > 0.0 && found.half_width() < 0.3) {
        return Err(Refusal::Vague {
            name: "the magnets' flux (Wb)",
            low: found.low,
            high: found.high,
            advice: "the knob could not be turned fast enough to see it: friction, or a current limit too low",
        }
        .into());
    }
    Ok(found)
}

/// What is known of the motor.
struct Motor {
    level: Level,
    resistance_ohm: f64,
    inductance_h: [f64; 2],
}

/// In a field that turns at `speed` (rad/s, electrical), dead time made up for at the current `expected`.
///
/// v_q = R i_q + ω (L_d i_d + ψ) in the rotor's frame, its angle by the encoder.
fn spin<B: Bench>(
    calibration: &mut Calibration<'_, B>,
    motor: &Motor,
    turn: &Turn,
    speed: f64,
    expected: Vector,
) -> Result<Spin, B::Error> {
    let Motor {
        level,
        resistance_ohm,
        inductance_h: [d_h, q_h],
    } = motor;
    let period_s = f64::from(calibration.stage.pwm_period_s);
    let window = (TAU / speed.abs() / period_s / 4.0)
        .round()
        .clamp(25.0, 16_000.0)
        * 4.0;
    let turn_by = speed.signum() / window;
    let speed = TAU * turn_by / period_s;
    let turns = (0.25 * speed.abs() / TAU).clamp(4.0, 100.0) as u16;
    let excitation = Excitation {
        turn: (turn_by * PER_TURN) as i32,
        steady_v: level.volts as f32,
        steady_a: [expected.re as f32, expected.im as f32],
        rise: calibration.ticks(30e-3),
        settle: calibration.ticks(0.3),
        window: window as u16,
        windows: turns,
        ..calibration.nothing()
    };
    let windows = calibration.excite(&excitation)?;
    let way = match (windows.first(), windows.last()) {
        (Some(first), Some(last)) => f64::from(last.count.wrapping_sub(first.count)),
        _ => 0.0,
    };
    let moved = (way * f64::from(turn.pole_pairs) / turn.counts_per_rev).abs();
    let off = (moved - f64::from(turns - 1)).abs();
    if !at_most(off, 0.3) {
        return Err(Refusal::Follows {
            turns: off,
            current_a: expected.norm(),
        }
        .into());
    }
    let put =
        Vector::new(level.volts, 0.0) + along(expected, turning_v(calibration, expected.norm()));
    let part = dead_part(calibration, level, *resistance_ohm);
    let mut fluxes = Vec::new();
    let (mut along_a, mut off_turns) = (0.0, 0.0);
    let mut mean_current = Vector::new(0.0, 0.0);
    let number = windows.len() as f64;
    for sums in windows.chunks(1) {
        // The field in the middle of the window, at the moments of the currents; the voltage's mean lies half a
        // period behind.
        let field = f64::from(sums[0].angle) / PER_TURN - 0.5 * turn_by * (window - 1.0);
        let to_rotor = turned(field - turn.rotor_turns(sums::count(sums)));
        let seen = calibration.scale.turning(sums);
        let taken = along(seen, part * turning_v(calibration, seen.norm()));
        let current = seen * to_rotor;
        let volts = put * turned(-0.5 * turn_by) - taken;
        let behind_r = volts * to_rotor - current * *resistance_ohm;
        // The back-EMF over the speed, along d and q.
        let q_wb = behind_r.im / speed - d_h * current.re;
        let d_wb = behind_r.re / speed + q_h * current.im;
        fluxes.push(q_wb);
        off_turns += (-d_wb).atan2(q_wb) / TAU / number;
        along_a += current.re / number;
        mean_current += seen / number;
    }
    let (flux_wb, deviation_wb) = mean(&fluxes);
    Ok(Spin {
        flux_wb,
        deviation_wb,
        along_a,
        current: mean_current,
        off_turns,
    })
}

/// So many volts in the direction of a current.
fn along(current: Vector, volts: f64) -> Vector {
    current / current.norm().max(1e-9) * volts
}

/// What dead time really takes, as a part of what it is believed to: from what a steady level has beyond R i.
fn dead_part<B: Bench>(
    calibration: &Calibration<'_, B>,
    level: &Level,
    resistance_ohm: f64,
) -> f64 {
    let (edge_a, whole_v) = dead_time(calibration);
    // Along phase A: the others bear half the current each.
    let steady_v = |current_a: f64| {
        let ratio = current_a / edge_a;
        whole_v * 2.0 / 3.0 * (ratio.min(1.0) + (0.5 * ratio).min(1.0))
    };
    let current_a = level.vector.norm();
    let taken_v = level.volts + steady_v(level.expected_a) - resistance_ohm * current_a;
    (taken_v / steady_v(current_a)).clamp(0.0, 2.0)
}

/// The first harmonic of what dead time takes of the voltage, for currents of this amplitude that turn, V.
fn turning_v<B: Bench>(calibration: &Calibration<'_, B>, current_a: f64) -> f64 {
    let (edge_a, whole_v) = dead_time(calibration);
    let ratio = current_a / edge_a;
    if ratio <= 1.0 {
        return whole_v * ratio;
    }
    // Of a sine of amplitude `ratio` that is cut off at ±1.
    let cut = (1.0 / ratio).asin();
    whole_v * 2.0 / PI * (ratio * cut + cut.cos())
}

/// The current from which a phase loses the whole of it, and that, V.
fn dead_time<B: Bench>(calibration: &Calibration<'_, B>) -> (f64, f64) {
    let stage = &calibration.stage;
    (
        f64::from(stage.dead_edge_a),
        f64::from(stage.dead_duty) * calibration.bus_v,
    )
}
