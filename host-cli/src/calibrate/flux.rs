//! The magnets' flux ψ, from the voltage across the rotor that R i does not explain, in a field that turns fast.

use std::f64::consts::{PI, TAU};

use plant_sim::identify::Estimate;
use protocol::Excitation;

use super::Bench;
use super::refusal::Refusal;
use super::shared::{Calibration, DEVIATIONS, Level, mean};
use super::sums::{self, PER_TURN, turned};
use super::three_phase::Turn;

/// How fast the shaft is turned at first, and at most, rad/s.
const FIRST_SPIN_RAD_S: f64 = 8.0;
const SPIN_RAD_S: f64 = 40.0;

/// The part of the voltage that back-EMF is to have.
const EMF_PART: f64 = 0.4;

/// Of the flux, beside the noise.
const SYSTEMATIC: f64 = 0.02;

/// What a spin brought.
struct Spin {
    flux_wb: f64,
    deviation_wb: f64,
    /// i_d, A.
    along_a: f64,
}

/// ψ, Wb.
pub(super) fn measure<B: Bench>(
    calibration: &mut Calibration<'_, B>,
    level: &Level,
    resistance_ohm: f64,
    turn: &Turn,
    d_inductance: &Estimate,
) -> Result<Estimate, B::Error> {
    let fastest = SPIN_RAD_S * f64::from(turn.pole_pairs);
    let held_v = resistance_ohm * level.vector.norm();
    let mut speed = FIRST_SPIN_RAD_S * f64::from(turn.pole_pairs);
    let mut found: Option<Estimate> = None;
    for _ in 0..2 {
        let mut spins = [None, None];
        for (spun, sign) in spins.iter_mut().zip([1.0, -1.0]) {
            let inductance_h = d_inductance.value;
            *spun = spin(calibration, level, resistance_ohm, turn, inductance_h, sign * speed)?;
        }
        let [Some(forth), Some(back)] = spins else {
            break;
        };
        let value = 0.5 * (forth.flux_wb + back.flux_wb);
        let deviation = 0.5 * forth.deviation_wb.hypot(back.deviation_wb);
        // The two ways differ by what an angle that is a little off brings, of which the second order remains.
        let differ = 0.5 * (forth.flux_wb - back.flux_wb).abs();
        let along_a = forth.along_a.abs().max(back.along_a.abs());
        let half = DEVIATIONS * deviation
            + 0.1 * differ
            + 0.5 * (d_inductance.high - d_inductance.low) * along_a
            + SYSTEMATIC * value.abs();
        found = Some(Estimate {
            value,
            low: value - half,
            high: value + half,
        });
        let best = (EMF_PART * held_v / value.abs().max(1e-6)).min(fastest);
        if speed > 0.7 * best {
            break;
        }
        speed = best;
    }
    match found {
        Some(found) if found.low > 0.0 && found.half_width() < 0.3 => Ok(found),
        found => {
            let (low, high) = found.map_or((0.0, f64::INFINITY), |found| (found.low, found.high));
            Err(Refusal::Vague {
                name: "the magnets' flux (Wb)",
                low,
                high,
                advice: "the knob could not be turned fast enough to see it: friction, a hand, or a current limit too low",
            }
            .into())
        }
    }
}

/// In a field that turns at `speed` (rad/s, electrical); None if the rotor did not follow.
///
/// v_q = R i_q + ω (L_d i_d + ψ) in the rotor's frame, its angle by the encoder.
fn spin<B: Bench>(
    calibration: &mut Calibration<'_, B>,
    level: &Level,
    resistance_ohm: f64,
    turn: &Turn,
    d_inductance_h: f64,
    speed: f64,
) -> Result<Option<Spin>, B::Error> {
    let period_s = f64::from(calibration.stage.pwm_period_s);
    let window = (TAU / speed.abs() / period_s / 4.0).round().clamp(25.0, 16_000.0) * 4.0;
    let turn_by = speed.signum() / window;
    let speed = TAU * turn_by / period_s;
    let turns = (0.25 * speed.abs() / TAU).clamp(4.0, 100.0) as u16;
    let expected_a = level.vector.norm();
    let excitation = Excitation {
        turn: (turn_by * PER_TURN) as i32,
        steady_v: level.volts as f32,
        steady_a: expected_a as f32,
        rise: calibration.ticks(30e-3),
        settle: calibration.ticks(0.3),
        window: window as u16,
        windows: turns,
        ..calibration.nothing()
    };
    let windows = calibration.excite(&excitation)?;
    let (Some(first), Some(last)) = (windows.first(), windows.last()) else {
        return Ok(None);
    };
    let way = f64::from(last.count.wrapping_sub(first.count));
    let moved = (way * f64::from(turn.pole_pairs) / turn.counts_per_rev).abs();
    if !((moved - f64::from(turns - 1)).abs() <= 0.3) {
        return Ok(None);
    }
    let put_v = level.volts + turning_v(calibration, expected_a);
    let part = dead_part(calibration, level, resistance_ohm);
    let (mut fluxes, mut along_a) = (Vec::new(), 0.0);
    for sums in windows.chunks(1) {
        // The field in the middle of the window, at the moments of the currents; the voltage's mean lies half a
        // period behind.
        let field = f64::from(sums[0].angle) / PER_TURN - 0.5 * turn_by * (window - 1.0);
        let to_rotor = turned(field - turn.rotor_turns(sums::count(sums)));
        let current = calibration.scale.turning(sums) * to_rotor;
        let put = turned(-0.5 * turn_by) * to_rotor * put_v;
        // What is put for dead time lies along the voltage, what it takes along the current.
        let current_a = current.norm().max(1e-9);
        let taken = current / current_a * (part * turning_v(calibration, current_a));
        let across_v = (put - taken - current * resistance_ohm).im;
        fluxes.push(across_v / speed - d_inductance_h * current.re);
        along_a += current.re / windows.len() as f64;
    }
    let (flux_wb, deviation_wb) = mean(&fluxes);
    Ok(Some(Spin {
        flux_wb,
        deviation_wb,
        along_a,
    }))
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
