//! A motor of three phases: resistance, the turn of the field, inductance, back-EMF.

use std::f64::consts::TAU;

use nalgebra::Matrix2;
use plant_sim::identify::Estimate;
use protocol::{Excitation, Sums};

use super::refusal::{Phase, Refusal};
use super::shared::{
    Calibration, DEVIATIONS, Level, MOST_POLE_PAIRS, SHORT, SYSTEMATIC, Times, at_most, estimate,
    inductance_h, mean,
};
use super::sums::{self, PER_TURN, ripple_of_one, turned};
use super::{Bench, Found, Step, flux};

const SEARCHING: Times = Times {
    rise_s: 5e-3,
    settle_s: 10e-3,
    window_s: 10e-3,
    windows: 2,
};

const MEASURING: Times = Times {
    rise_s: 30e-3,
    settle_s: 80e-3,
    window_s: 10e-3,
    windows: 12,
};

/// The part of the current limit at which the search ends.
const SEARCH: f64 = 0.3;

/// The part of the current limit that is used.
const USED: f64 = 0.5;

/// The spread of the three resistances that is accepted, as a part of their mean.
const EQUAL: f64 = 0.15;

/// A resistance may be wrong by this part of itself.
const VAGUE: f64 = 0.1;

/// The part of the used voltage that holds the rotor under a ripple.
const HELD: f64 = 0.6;

/// The part of the current limit that a ripple's amplitude is to have.
const RIPPLE: f64 = 0.15;

/// Windows in a turn of the slow field.
const PER_FIELD_TURN: u16 = 16;

/// Electrical turns of the slow field, either way, and how many a second.
const FIELD_TURNS: u16 = 3;
const FIELD_TURNS_S: f64 = 5.0;

/// How far pole pairs may be from a whole number.
const WHOLE: f64 = 0.12;

/// How far the rotor may leave the line of its motion, electrical turns.
const OFF_THE_LINE: f64 = 0.15;

/// How much longer the way forth may be than the way back, as a part of it.
const SAME_WAY: f64 = 0.02;

pub(super) fn measure<B: Bench>(calibration: &mut Calibration<'_, B>) -> Result<Found, B::Error> {
    calibration.begin(Step::Resistance);
    let (resistance, level) = resistance(calibration)?;
    calibration.begin(Step::Turn);
    let turn = turn(calibration, &level)?;
    calibration.begin(Step::Inductance);
    let [d, q] = inductance(calibration, &level, &resistance, &turn)?;
    calibration.begin(Step::BackEmf);
    let flux = flux::measure(calibration, &level, resistance.value, &turn, [d, q])?;
    let per_flux = 1.5 * f64::from(turn.pole_pairs);
    let measured = Estimate {
        value: per_flux * flux.value,
        low: per_flux * flux.low,
        high: per_flux * flux.high,
    };
    // ψ = 60/(2π√3 p Kv), and 3/2 p of it.
    let by_kv = calibration
        .told
        .kv_rpm_v
        .map(|kv| 1.5 * 60.0 / (TAU * 3.0_f64.sqrt() * kv));
    Ok(Found {
        zero_codes: calibration.scale.zero_codes,
        noise_a: calibration.noise_a,
        resistance_ohm: resistance,
        d_inductance_h: d,
        q_inductance_h: q,
        pole_pairs: turn.pole_pairs,
        reversed: turn.reversed,
        zero_turns: turn.zero_turns,
        torque_constant_nm_a: calibration.constant(measured, by_kv)?,
        measured_constant_nm_a: measured,
        current_of_bus_a: calibration.reach_v() / resistance.value,
    })
}

/// R, and the level at which the rest is measured.
fn resistance<B: Bench>(
    calibration: &mut Calibration<'_, B>,
) -> Result<(Estimate, Level), B::Error> {
    let mut first = calibration.search(0.0, SEARCH, &SEARCHING)?;
    connected(calibration, &mut first)?;
    let limit_a = calibration.told.current_max_a;
    let current_a = first.vector.re;
    let volts = (first.volts * USED * limit_a / current_a).min(calibration.reach_v());
    let expected_a = volts / first.volts * current_a;
    let mut ohm = [0.0; 3];
    let mut deviation = 0.0;
    let mut high = None;
    for (axis, ohm) in ohm.iter_mut().enumerate() {
        let turns = axis as f64 / 3.0;
        let along = |level: &Level| (level.vector * turned(-turns)).re;
        let mut levels = [first; 2];
        for (level, part) in levels.iter_mut().zip([1.0, 0.5]) {
            let measured = calibration.level(turns, part * volts, part * expected_a, &MEASURING)?;
            *level = measured.ok_or_else(|| calibration.short(part * volts))?;
        }
        let [full, half] = levels;
        let difference_a = along(&full) - along(&half);
        *ohm = (full.volts - half.volts) / difference_a;
        let deviation_a = 2.0_f64.sqrt() * 1.2 * calibration.deviation_a(full.periods);
        deviation = *ohm * deviation_a / difference_a;
        high.get_or_insert(full);
    }
    let (value, scatter) = mean(&ohm);
    let most = ohm.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = ohm.iter().copied().fold(f64::INFINITY, f64::min);
    if !at_most(most - least, EQUAL * value + 6.0 * deviation) {
        return Err(Refusal::Unequal {
            ohm,
            accepted: EQUAL,
        }
        .into());
    }
    let found = estimate(
        value,
        (deviation * deviation / 3.0 + scatter * scatter).sqrt(),
        SYSTEMATIC,
    );
    if !at_most(found.half_width(), VAGUE) {
        return Err(Refusal::Vague {
            name: "the resistance (Ω)",
            low: found.low,
            high: found.high,
            advice: "allow more current, or a higher bus voltage; a motor of so high a resistance is to be driven by voltage, with the values of its data sheet",
        }
        .into());
    }
    Ok((found, high.unwrap_or(first)))
}

/// Whether all three phases bear current, from a voltage along phase A.
fn connected<B: Bench>(
    calibration: &mut Calibration<'_, B>,
    level: &mut Level,
) -> Result<(), B::Error> {
    let volts = level.volts;
    let mut flows = [false; 2];
    // Once more with time to come to rest: while the rotor swings, a current may be 0 for a moment.
    for again in [false, true] {
        if again {
            let limit_a = calibration.told.current_max_a;
            let slow = calibration.level(0.0, volts, limit_a, &MEASURING)?;
            *level = slow.ok_or_else(|| calibration.short(volts))?;
        }
        let nothing = calibration.nothing_a(level);
        flows = level.currents.map(|current| current.abs() > nothing);
        if flows == [true, true] {
            return Ok(());
        }
    }
    let codes = calibration.scale.zero_codes;
    // Where it would flow if the silent phase were open: not at all along that phase.
    let (phase, turns) = match flows {
        [false, true] => (Phase::B, 1.0 / 3.0),
        [true, false] => (Phase::C, 2.0 / 3.0),
        _ => (Phase::A, 0.25),
    };
    // A brushed motor, if it is one, is not to spin; and a phase whose converter stands bears more than is seen.
    let other = calibration.search(turns, 0.5 * SEARCH, &SHORT)?;
    let nothing = calibration.nothing_a(&other);
    let [b, c] = other.currents;
    let flows_a = match phase {
        Phase::A => {
            let flows = [b, c].map(|current| current.abs() > nothing);
            return Err(match flows {
                [true, true] => Refusal::Unplugged {
                    phase: Phase::A,
                    volts,
                },
                [false, false] => Refusal::NoCurrent { volts },
                [true, false] => stuck(Phase::C, codes[1], b),
                [false, true] => stuck(Phase::B, codes[0], c),
            }
            .into());
        }
        Phase::B => c,
        Phase::C => b,
    };
    let code = if phase == Phase::B {
        codes[0]
    } else {
        codes[1]
    };
    Err(if flows_a.abs() > nothing {
        stuck(phase, code, flows_a)
    } else {
        Refusal::Unplugged { phase, volts }
    }
    .into())
}

fn stuck(phase: Phase, code: f64, current_a: f64) -> Refusal {
    Refusal::Stuck {
        phase,
        code,
        current_a,
    }
}

/// What the slow turn of the field brought.
pub(super) struct Turn {
    pub pole_pairs: u32,
    reversed: bool,
    zero_turns: Estimate,
    pub counts_per_rev: f64,
}

impl Turn {
    /// The rotor's electrical angle at a mean count, turns.
    pub fn rotor_turns(&self, count: f64) -> f64 {
        let sign = if self.reversed { -1.0 } else { 1.0 };
        sign * f64::from(self.pole_pairs) * count / self.counts_per_rev + self.zero_turns.value
    }
}

/// The count over the turns of the field: slope, and furthest distance from the line.
fn line(points: &[(f64, f64)]) -> (f64, f64) {
    let number = points.len() as f64;
    let x = points.iter().map(|point| point.0).sum::<f64>() / number;
    let y = points.iter().map(|point| point.1).sum::<f64>() / number;
    let product: f64 = points
        .iter()
        .map(|point| (point.0 - x) * (point.1 - y))
        .sum();
    let square: f64 = points.iter().map(|point| (point.0 - x).powi(2)).sum();
    let slope = product / square;
    let off = |point: &(f64, f64)| (point.1 - y - slope * (point.0 - x)).abs();
    (slope, points.iter().map(off).fold(0.0, f64::max))
}

fn turn<B: Bench>(calibration: &mut Calibration<'_, B>, level: &Level) -> Result<Turn, B::Error> {
    let window = calibration.ticks(1.0 / (FIELD_TURNS_S * f64::from(PER_FIELD_TURN)));
    let step = PER_TURN / (f64::from(window) * f64::from(PER_FIELD_TURN));
    // Half a turn more each way, in which the rotor comes along.
    let lead = PER_FIELD_TURN / 2;
    let each_way = FIELD_TURNS * PER_FIELD_TURN + lead;
    let excitation = Excitation {
        turn: step as i32,
        back: true,
        steady_v: level.volts as f32,
        steady_a: [level.vector.norm() as f32, 0.0],
        rise: calibration.ticks(50e-3),
        settle: calibration.ticks(200e-3),
        window,
        windows: 2 * each_way,
        ..calibration.nothing()
    };
    let windows = calibration.excite(&excitation)?;
    let told_counts = f64::from(calibration.told.counts_per_rev);
    let counts: Vec<f64> = windows
        .iter()
        .map(|sums| sums::count(std::slice::from_ref(sums)))
        .collect();
    let ends = windows.iter().map(|sums| i64::from(sums.count));
    let (least, most) = ends.fold((i64::MAX, i64::MIN), |(l, m), count| {
        (l.min(count), m.max(count))
    });
    // A whole turn of 50 pole pairs moves this far or more.
    let expected = told_counts * f64::from(FIELD_TURNS) / f64::from(MOST_POLE_PAIRS);
    let uneven = counts.iter().any(|count| (count - counts[0]).abs() > 1e-9);
    if !uneven {
        return Err(Refusal::NoMotion.into());
    }
    if most - least <= 2 && expected > 4.0 {
        return Err(Refusal::Toggles {
            counts: (most - least).max(1),
        }
        .into());
    }
    // The field's angle in the middle of each window, as turns from its start.
    let mut field = Vec::with_capacity(windows.len());
    let mut at = f64::NAN;
    for (index, sums) in windows.iter().enumerate() {
        let forth = index < usize::from(each_way);
        let turn = if forth { step } else { -step } / PER_TURN;
        let now = f64::from(sums.angle) / PER_TURN - 0.5 * turn * f64::from(window - 1);
        let near = if at.is_nan() {
            now
        } else {
            at + turn * f64::from(window)
        };
        at = now + (near - now).round();
        field.push(at);
    }
    let way = |from: usize, to: usize| -> Vec<(f64, f64)> {
        (from..to)
            .map(|index| (field[index], counts[index]))
            .collect()
    };
    let (first, lead) = (usize::from(each_way), usize::from(lead));
    let forth = way(lead, first);
    let home = way(first + lead, windows.len());
    let ((slope_forth, off_forth), (slope_home, off_home)) = (line(&forth), line(&home));
    let slope = 0.5 * (slope_forth + slope_home);
    let current_a = level.vector.norm();
    let moved = f64::from(FIELD_TURNS);
    let pole_pairs = told_counts / slope.abs();
    let off = off_forth.max(off_home) / slope.abs().max(1e-9);
    if !at_most(off, OFF_THE_LINE) {
        // A count that leaps is off one way only; a rotor that is held back is off both ways.
        let differ = (slope_forth - slope_home).abs() > SAME_WAY * slope.abs();
        let only_one = off_forth.max(off_home) > 4.0 * off_forth.min(off_home);
        if pole_pairs < f64::from(2 * MOST_POLE_PAIRS) && (differ || only_one) {
            return Err(Refusal::Slips {
                there: moved * slope_forth.abs(),
                back: moved * slope_home.abs(),
            }
            .into());
        }
        return Err(Refusal::Follows {
            turns: off.min(f64::from(FIELD_TURNS)),
            current_a,
        }
        .into());
    }
    if !at_most((slope_forth - slope_home).abs(), SAME_WAY * slope.abs()) {
        return Err(Refusal::Slips {
            there: moved * slope_forth.abs(),
            back: moved * slope_home.abs(),
        }
        .into());
    }
    let whole = pole_pairs.round();
    if !((pole_pairs - whole).abs() <= WHOLE && whole >= 1.0 && whole <= f64::from(MOST_POLE_PAIRS))
    {
        return Err(Refusal::NotWhole {
            pole_pairs,
            counts_per_rev: calibration.told.counts_per_rev,
        }
        .into());
    }
    let measured = whole as u32;
    if let Some(told) = calibration.told.pole_pairs
        && told != measured
    {
        return Err(Refusal::PolePairs {
            measured,
            told,
            counts_per_rev: calibration.told.counts_per_rev,
        }
        .into());
    }
    let reversed = slope < 0.0;
    let per_count = slope.signum() * whole / told_counts;
    // Turn by turn, so that cogging is even over each.
    let per_turn = usize::from(PER_FIELD_TURN);
    let zeros = |way: &[(f64, f64)]| -> Vec<f64> {
        let zero = |points: &[(f64, f64)]| {
            let sum: f64 = points
                .iter()
                .map(|(field, count)| field - per_count * count)
                .sum();
            sum / points.len() as f64
        };
        way.chunks_exact(per_turn).map(zero).collect()
    };
    let (forth, home) = (zeros(&forth), zeros(&home));
    let ((ahead, ahead_off), (behind, behind_off)) = (mean(&forth), mean(&home));
    let lag = 0.5 * (ahead - behind);
    // A count that leapt between the ways leaves the rotor ahead of the field, or far behind it.
    if !(-0.02..0.25).contains(&lag) {
        let counts = whole_counts(lag, per_count);
        return Err(Refusal::Slips {
            there: moved * slope_forth.abs(),
            back: moved * slope_home.abs() - counts,
        }
        .into());
    }
    let zero = (0.5 * (ahead + behind)).rem_euclid(1.0);
    let half = DEVIATIONS * 0.5 * ahead_off.hypot(behind_off)
        + 0.1 * lag.abs()
        + 0.5 * per_count.abs()
        + 1e-3;
    Ok(Turn {
        pole_pairs: measured,
        reversed,
        zero_turns: Estimate {
            value: zero,
            low: zero - half,
            high: zero + half,
        },
        counts_per_rev: told_counts,
    })
}

/// Counts of so many turns.
fn whole_counts(turns: f64, per_count: f64) -> f64 {
    (2.0 * turns / per_count).abs()
}

/// A ripple along the field and one across it, on a rotor that the field holds.
fn inductance<B: Bench>(
    calibration: &mut Calibration<'_, B>,
    level: &Level,
    resistance: &Estimate,
    turn: &Turn,
) -> Result<[Estimate; 2], B::Error> {
    let held_v = HELD * level.volts;
    let held = Excitation {
        steady_a: [(HELD * level.vector.norm()) as f32, 0.0],
        ..calibration.rippling(held_v)
    };
    // Even without inductance this one is no larger than the current that holds.
    let first_v = held_v.min(0.1 * calibration.reach_v());
    let most_v = calibration.reach_v() - held_v;
    let (volts, quarter) = calibration.find_ripple(&held, RIPPLE, first_v, most_v)?;
    let long = Excitation {
        quarter,
        settle: calibration.ticks(150e-3),
        windows: 16,
        ..held
    };
    let along = calibration.excite(&Excitation {
        along_v: volts as f32,
        ..long
    })?;
    let across = calibration.excite(&Excitation {
        across_v: volts as f32,
        ..long
    })?;
    let rotor = turn.rotor_turns(0.5 * (sums::count(&along) + sums::count(&across)));
    let volts = ripple_of_one() * volts;
    let both = |along: &[Sums], across: &[Sums]| -> Option<[f64; 2]> {
        let [aa, ba] = calibration.scale.ripple(along);
        let [ab, bb] = calibration.scale.ripple(across);
        let admittance = Matrix2::new(aa / volts, ab / volts, ba / volts, bb / volts);
        let impedance = admittance.try_inverse()?.map(|z| z.im);
        let (sine, cosine) = (TAU * rotor).sin_cos();
        let to_rotor = Matrix2::new(cosine, sine, -sine, cosine);
        let seen = to_rotor * impedance * to_rotor.transpose();
        Some([seen[(0, 0)], seen[(1, 1)]])
    };
    let all = both(&along, &across);
    let mut found = [Estimate {
        value: f64::NAN,
        low: f64::NAN,
        high: f64::NAN,
    }; 2];
    let groups: Vec<[f64; 2]> = along
        .chunks(2)
        .zip(across.chunks(2))
        .filter_map(|(along, across)| both(along, across))
        .collect();
    for (axis, found) in found.iter_mut().enumerate() {
        let Some(all) = all else { continue };
        let scattered: Vec<f64> = groups.iter().map(|group| group[axis]).collect();
        let (_, deviation) = mean(&scattered);
        let value = inductance_h(&calibration.stage, resistance.value, quarter, all[axis]);
        *found = estimate(value, value * deviation / all[axis], 0.02);
    }
    for (name, found) in [
        ("the inductance along the rotor (H)", found[0]),
        ("the inductance across the rotor (H)", found[1]),
    ] {
        if !(found.low > 0.0 && found.half_width() < 0.5) {
            return Err(Refusal::Vague {
                name,
                low: found.low,
                high: found.high,
                advice: "allow more current, or a higher bus voltage",
            }
            .into());
        }
    }
    Ok(found)
}
