//! A brushed motor between B and C: connection, inductance, then resistance and torque constant at once, as
//! it turns while it is measured.
//!
//! B to C is the direction a quarter of a turn ahead of phase A; a vector of V there is √3 V from B to C.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};
use plant_sim::identify::Estimate;
use protocol::{Excitation, Sums};

use super::refusal::{Phase, Refusal};
use super::shared::{Calibration, Level, SHORT, SYSTEMATIC, angle, estimate, inductance_h, mean};
use super::sums::{self, ripple_of_one};
use super::{Bench, Found, Step};

/// The direction from B to C.
const B_TO_C: f64 = 0.25;

/// The part of the current limit at which the search ends; where voltage turns round while it spins, twice
/// as much flows.
const SEARCH: f64 = 0.2;

/// The fastest that it is meant to turn, rad/s.
const SPIN_RAD_S: f64 = 60.0;

/// How many times the voltage of the search is tried until it turns.
const MORE: f64 = 2.5;

/// Of a push from rest: how long the current rises, windows, and how many pushes.
const RISE_S: f64 = 1.5e-3;
const WINDOW_S: f64 = 1.7e-3;
const WINDOWS: u16 = 12;
const PUSHES: usize = 12;

/// The part of the current limit that a push may reach, and what a spin may have when it is shorted.
const PUSHED: f64 = 0.6;

/// How far dead time may be from what is believed, as a part of it.
const DEAD_TIME: f64 = 0.25;

/// The same around the current from which all of it is lost.
const UNSURE: f64 = 0.3;

/// The part of the current limit that a ripple's amplitude is to have: the larger, the less dead time matters.
const RIPPLE: f64 = 0.4;

/// By how much a ripple across no current may be wrong, as dead time goes with the current's sign.
const ACROSS_ZERO: f64 = 0.05;

pub(super) fn measure<B: Bench>(calibration: &mut Calibration<'_, B>) -> Result<Found, B::Error> {
    calibration.begin(Step::Resistance);
    let level = calibration.search(B_TO_C, SEARCH, &SHORT)?;
    connected(calibration, &level)?;
    calibration.begin(Step::Inductance);
    let ripple = ripple(calibration)?;
    calibration.begin(Step::BackEmf);
    let spun = spin(calibration, &level)?;
    let rows = rows(calibration, &level, &spun, &ripple);
    let Fit {
        resistance,
        constant,
    } = fit(&rows).ok_or(Refusal::NoMotion)?;
    let Ripple {
        quarter,
        x_ohm,
        deviation_ohm,
    } = ripple;
    let inductance = inductance_h(&calibration.stage, resistance.value, quarter, x_ohm);
    let inductance = estimate(inductance, inductance * deviation_ohm / x_ohm, ACROSS_ZERO);
    let reversed = constant.value < 0.0;
    let measured = if reversed {
        Estimate {
            value: -constant.value,
            low: -constant.high,
            high: -constant.low,
        }
    } else {
        constant
    };
    for (name, found) in [
        ("the resistance (Ω)", resistance),
        ("the inductance (H)", inductance),
        ("the torque constant (Nm/A)", measured),
    ] {
        if !(found.low > 0.0 && found.half_width() < 0.3) {
            return Err(Refusal::Vague {
                name,
                low: found.low,
                high: found.high,
                advice: "allow more current, or a higher bus voltage",
            }
            .into());
        }
    }
    let by_kv = calibration.told.kv_rpm_v.map(|kv| 60.0 / (TAU * kv));
    Ok(Found {
        zero_codes: calibration.scale.zero_codes,
        noise_a: calibration.noise_a,
        resistance_ohm: resistance,
        d_inductance_h: inductance,
        q_inductance_h: inductance,
        pole_pairs: 1,
        reversed,
        zero_turns: Estimate {
            value: 0.0,
            low: 0.0,
            high: 0.0,
        },
        torque_constant_nm_a: calibration.constant(measured, by_kv)?,
        measured_constant_nm_a: measured,
        current_of_bus_a: 3.0_f64.sqrt() * calibration.reach_v() / resistance.value,
    })
}

/// Whether the motor is between B and C, and nothing at A.
fn connected<B: Bench>(
    calibration: &mut Calibration<'_, B>,
    level: &Level,
) -> Result<(), B::Error> {
    let nothing = calibration.nothing_a(level);
    let [b_a, c_a] = level.currents;
    let codes = calibration.scale.zero_codes;
    // Where only one of the two bears current: a direction in which the other side of a motor at A has
    // no voltage against A.
    let (other, turns) = match [b_a, c_a].map(|current| current.abs() > nothing) {
        [false, false] => return Err(Refusal::NoCurrent { volts: level.volts }.into()),
        [true, false] => (Phase::B, 1.0 / 6.0),
        [false, true] => (Phase::C, 5.0 / 6.0),
        [true, true] => {
            // Three phases: along A current flows too.
            let along = calibration.level(0.0, level.volts, 0.0, &SHORT)?;
            let along = along.ok_or_else(|| calibration.short(level.volts))?;
            for [b_a, c_a] in [level.currents, along.currents] {
                if (b_a + c_a).abs() > nothing.max(0.2 * level.most_a()) {
                    return Err(Refusal::Sum { b_a, c_a }.into());
                }
            }
            return Ok(());
        }
    };
    let again = calibration.search(turns, SEARCH, &SHORT)?;
    let nothing = calibration.nothing_a(&again);
    let [b_a, c_a] = again.currents;
    let (flows_a, silent, code) = match other {
        Phase::B => (b_a, Phase::C, codes[1]),
        _ => (c_a, Phase::B, codes[0]),
    };
    Err(if flows_a.abs() > nothing {
        Refusal::Stuck {
            phase: silent,
            code,
            current_a: flows_a,
        }
    } else {
        Refusal::BrushedAt { other }
    }
    .into())
}

/// The reactance of the winding under a ripple of a quarter of so many periods.
struct Ripple {
    quarter: u16,
    x_ohm: f64,
    deviation_ohm: f64,
}

fn ripple<B: Bench>(calibration: &mut Calibration<'_, B>) -> Result<Ripple, B::Error> {
    let held = Excitation {
        angle: angle(B_TO_C),
        ..calibration.rippling(0.0)
    };
    let (volts, quarter) = calibration.find_ripple(&held, RIPPLE, 0.05, calibration.reach_v())?;
    let windows = calibration.excite(&Excitation {
        along_v: volts as f32,
        quarter,
        windows: 16,
        ..held
    })?;
    // Of the current from B to C, and of the voltage there.
    let reactance = |windows: &[Sums]| {
        let [_, beta] = calibration.scale.ripple(windows);
        (ripple_of_one() * (3.0_f64.sqrt() * volts) / (beta * 0.75_f64.sqrt())).im
    };
    let groups: Vec<f64> = windows.chunks(2).map(reactance).collect();
    Ok(Ripple {
        quarter,
        x_ohm: reactance(&windows),
        deviation_ohm: mean(&groups).1,
    })
}

/// What was recorded: pushes from rest, and a steady voltage, each either way.
struct Spun {
    pushes: Vec<(f64, Vec<Sums>)>,
    steady: Vec<(f64, Vec<Sums>)>,
}

fn spin<B: Bench>(calibration: &mut Calibration<'_, B>, level: &Level) -> Result<Spun, B::Error> {
    // The current that a voltage drives at rest is known from the search.
    let most_v = PUSHED * calibration.told.current_max_a / level.most_a() * level.volts;
    let most_v = most_v.min(calibration.reach_v());
    let mut spun = Spun {
        pushes: Vec::new(),
        steady: Vec::new(),
    };
    // As much faster as it may, so that dead time is little beside it.
    let mut volts = level.volts.min(most_v);
    for _ in 0..4 {
        let mut fastest_rad_s = 0.0_f64;
        for volts in [volts, -volts] {
            let windows = calibration.excite(&Excitation {
                angle: angle(B_TO_C),
                steady_v: volts as f32,
                rise: calibration.ticks(50e-3),
                settle: calibration.ticks(0.1),
                window: calibration.ticks(10e-3),
                windows: 10,
                ..calibration.nothing()
            })?;
            if let (Some(first), Some(last)) = (windows.first(), windows.last()) {
                let way = f64::from(last.count.wrapping_sub(first.count)).abs();
                let time_s = 90e-3;
                let count_rad = TAU / f64::from(calibration.told.counts_per_rev);
                fastest_rad_s = fastest_rad_s.max(way * count_rad / time_s);
            }
            spun.steady.push((volts, windows));
        }
        let more = (SPIN_RAD_S / fastest_rad_s.max(1e-3)).min(MORE);
        if more < 1.3 || volts >= 0.999 * most_v {
            break;
        }
        volts = (more * volts).min(most_v);
    }
    let ends = spun.steady.iter().flat_map(|(_, windows)| windows);
    let ends = ends.map(|sums| i64::from(sums.count));
    let (least, most) = ends.fold((i64::MAX, i64::MIN), |(l, m), n| (l.min(n), m.max(n)));
    let uneven = spun.steady.iter().flat_map(|(_, windows)| windows);
    let uneven = uneven.map(|sums| sums::count(std::slice::from_ref(sums)));
    let (low, high) = uneven.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), count| {
        (l.min(count), h.max(count))
    });
    if high - low < 1e-9 {
        return Err(Refusal::NoMotion.into());
    }
    if most - least <= 2 {
        return Err(Refusal::Toggles {
            counts: (most - least).max(1),
        }
        .into());
    }
    let expected_a = PUSHED * calibration.told.current_max_a;
    for push in 0..PUSHES {
        // Shorted, it comes to rest.
        calibration.excite(&Excitation {
            rise: 1,
            settle: calibration.ticks(40e-3),
            windows: 1,
            ..calibration.nothing()
        })?;
        let sign = if push % 2 == 0 { 1.0 } else { -1.0 };
        let windows = calibration.excite(&Excitation {
            angle: angle(B_TO_C),
            steady_v: (sign * most_v) as f32,
            steady_a: [(sign * expected_a) as f32, 0.0],
            rise: 2,
            settle: calibration.ticks(RISE_S),
            window: calibration.ticks(WINDOW_S),
            windows: WINDOWS,
            ..calibration.nothing()
        })?;
        spun.pushes.push((sign * most_v, windows));
    }
    Ok(spun)
}

/// v = R i + L i' + k ω + f·(what dead time is believed to take).
struct Row {
    /// 1/(standard deviation of the volts), 1/V.
    weight: f64,
    /// v − L i', V.
    volts: f64,
    current_a: f64,
    speed_rad_s: f64,
    dead_v: f64,
}

fn rows<B: Bench>(
    calibration: &Calibration<'_, B>,
    level: &Level,
    spun: &Spun,
    ripple: &Ripple,
) -> Vec<Row> {
    let period_s = f64::from(calibration.stage.pwm_period_s);
    let edge_a = f64::from(calibration.stage.dead_edge_a);
    let dead_v = 2.0 * f64::from(calibration.stage.dead_duty) * calibration.bus_v;
    let count_rad = TAU / f64::from(calibration.told.counts_per_rev);
    // Near enough for the noise, and for what is left of i' after the first window.
    let near_ohm = 3.0_f64.sqrt() * level.volts / level.most_a();
    let near_h = inductance_h(&calibration.stage, near_ohm, ripple.quarter, ripple.x_ohm);
    let current = |sums: &Sums| {
        let [b, c] = calibration.scale.currents(std::slice::from_ref(sums));
        0.5 * (b - c)
    };
    let row = |volts: f64, before: &Sums, sums: &Sums, slope_a_s: f64| {
        let periods = sums::periods(std::slice::from_ref(sums));
        let way = f64::from(sums.count.wrapping_sub(before.count));
        let current_a = current(sums);
        let ratio = current_a.abs() / edge_a;
        // Around the edge it is not known what dead time takes.
        let unsure = if ratio < 2.0 {
            UNSURE * ratio.min(1.0)
        } else {
            0.02
        };
        let noise_v = near_ohm * calibration.deviation_a(2.0 * periods);
        Row {
            weight: 1.0 / noise_v.hypot(unsure * dead_v),
            volts: volts - near_h * slope_a_s,
            current_a,
            speed_rad_s: way * count_rad / (periods * period_s),
            dead_v: dead_v * (current_a / edge_a).clamp(-1.0, 1.0),
        }
    };
    let mut rows = Vec::new();
    for (volts, windows) in &spun.steady {
        for pair in windows.windows(2) {
            if let [before, sums] = pair {
                rows.push(row(3.0_f64.sqrt() * volts, before, sums, 0.0));
            }
        }
    }
    for (volts, windows) in &spun.pushes {
        // What was put for dead time.
        let put_v = 3.0_f64.sqrt() * volts + volts.signum() * dead_v;
        for three in windows.windows(3) {
            if let [before, sums, after] = three {
                let window_s = sums::periods(std::slice::from_ref(sums)) * period_s;
                let slope_a_s = (current(after) - current(before)) / (2.0 * window_s);
                rows.push(row(put_v, before, sums, slope_a_s));
            }
        }
    }
    rows
}

struct Fit {
    resistance: Estimate,
    /// Below 0 where the counter falls.
    constant: Estimate,
}

/// R, k and f by least squares, f held near 1.
fn fit(rows: &[Row]) -> Option<Fit> {
    let mut deviation = 1.0_f64;
    let mut found = None;
    // Once to know by how much rows are wrong beyond their own deviations, once more with it.
    for _ in 0..2 {
        let hold = deviation / DEAD_TIME;
        let mut normal = Matrix3::zeros();
        normal[(2, 2)] = hold * hold;
        let mut right = Vector3::new(0.0, 0.0, hold * hold);
        for row in rows {
            let x = Vector3::new(row.current_a, row.speed_rad_s, row.dead_v) * row.weight;
            normal += x * x.transpose();
            right += x * (row.volts * row.weight);
        }
        let inverse = normal.try_inverse()?;
        let solution = inverse * right;
        let square: f64 = rows
            .iter()
            .map(|row| {
                let x = Vector3::new(row.current_a, row.speed_rad_s, row.dead_v);
                (row.weight * (row.volts - x.dot(&solution))).powi(2)
            })
            .sum();
        deviation = (square / (rows.len() as f64 - 3.0)).sqrt().max(1.0);
        found = Some((solution, inverse));
    }
    let (solution, inverse) = found?;
    let of = |which: usize| {
        let spread = deviation * inverse[(which, which)].max(0.0).sqrt();
        estimate(solution[which], spread, SYSTEMATIC)
    };
    Some(Fit {
        resistance: of(0),
        constant: of(1),
    })
}
