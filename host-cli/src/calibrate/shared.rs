//! What both kinds of motors have in common: offsets, the search for a voltage, limits, intervals.

use std::f64::consts::TAU;

use plant_sim::identify::Estimate;
use protocol::{Excitation, ExcitationEnd, PowerStage, Sums};

use super::refusal::{Phase, Refusal};
use super::sums::{self, PER_TURN, Scale, Vector};
use super::{Bench, Recorded, Step, Told};

/// The fastest that the shaft may turn, rad/s.
pub(super) const FASTEST_RAD_S: f64 = 200.0;

/// An interval is so many standard deviations to either side, beside what is known to be wrong at most.
pub(super) const DEVIATIONS: f64 = 3.0;

/// By so much, as a part of itself, a resistance or an inductance may be wrong beside the noise: bus voltage and dead
/// time are believed.
pub(super) const SYSTEMATIC: f64 = 0.01;

/// How far Kv as told may be from the truth, as a part of it.
const KV_TOLERANCE: f64 = 0.1;

/// The first voltage that is tried, V.
const FIRST_V: f64 = 0.05;

/// From one voltage to the next.
const GROWTH: f64 = 1.6;

/// The part of the longest voltage vector that is used: the bus may sag.
const REACH: f64 = 0.9;

/// A measurement under way.
pub(super) struct Calibration<'a, B> {
    bench: &'a mut B,
    pub told: Told,
    pub stage: PowerStage,
    pub step: Step,
    pub scale: Scale,
    /// Of one code's noise, A.
    pub noise_a: f64,
    pub bus_v: f64,
}

/// A steady voltage, and what it drives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Level {
    pub volts: f64,
    /// For which dead time was made up, A.
    pub expected_a: f64,
    /// Of B and C, A.
    pub currents: [f64; 2],
    pub vector: Vector,
    pub periods: f64,
}

impl<'a, B: Bench> Calibration<'a, B> {
    pub fn new(bench: &'a mut B, told: &Told) -> Result<Self, B::Error> {
        let stage = bench.power_stage();
        let most = f64::from(stage.current_linear_a);
        let refuse = |name, value, accepted: String| Refusal::Told {
            name,
            value,
            accepted,
        };
        let current = told.current_max_a;
        if !(current > 0.0 && current <= most) {
            let accepted = format!("above 0, up to {most:.1} A");
            return Err(refuse("the largest current (A)", current, accepted).into());
        }
        if let Some(kv) = told.kv_rpm_v
            && !(kv > 0.0 && kv.is_finite())
        {
            return Err(refuse("Kv (rpm/V)", kv, "a number above 0".into()).into());
        }
        if let Some(pairs) = told.pole_pairs
            && !(1..=MOST_POLE_PAIRS).contains(&pairs)
        {
            let accepted = format!("1 to {MOST_POLE_PAIRS}");
            return Err(refuse("pole pairs", f64::from(pairs), accepted).into());
        }
        let zero = f64::from(stage.current_zero_code);
        Ok(Self {
            bench,
            told: *told,
            step: Step::Offsets,
            scale: Scale {
                step_a: f64::from(stage.current_step_a),
                zero_codes: [zero; 2],
            },
            noise_a: 0.0,
            bus_v: 0.0,
            stage,
        })
    }

    pub fn begin(&mut self, step: Step) {
        self.step = step;
        self.bench.begin(step);
    }

    /// PWM periods of so many seconds, as far as a request can say.
    pub fn ticks(&self, time_s: f64) -> u16 {
        (time_s / f64::from(self.stage.pwm_period_s)).clamp(1.0, 65_535.0) as u16
    }

    /// Nothing but the limits; 20 ms to rise and to settle, 50 windows of 2 ms.
    pub fn nothing(&self) -> Excitation {
        let window = self.ticks(2e-3);
        Excitation {
            angle: 0,
            turn: 0,
            back: false,
            steady_v: 0.0,
            steady_a: [0.0; 2],
            along_v: 0.0,
            across_v: 0.0,
            quarter: 0,
            rise: self.ticks(20e-3),
            settle: self.ticks(20e-3),
            window,
            windows: 50,
            zero_codes: self.scale.zero_codes.map(|code| code as f32),
            current_max_a: self.told.current_max_a as f32,
            way_max: 0,
        }
    }

    /// Runs it, ended or not.
    pub fn try_excite(&mut self, excitation: &Excitation) -> Result<Recorded, B::Error> {
        let way_rad =
            FASTEST_RAD_S * f64::from(excitation.window) * f64::from(self.stage.pwm_period_s);
        let way_max = (way_rad / TAU * f64::from(self.told.counts_per_rev)).ceil() + 2.0;
        let limited = Excitation {
            way_max: way_max as u32,
            ..*excitation
        };
        let recorded = self.bench.excite(&limited)?;
        let step = self.step.name();
        let refusal = match recorded.end {
            ExcitationEnd::Done | ExcitationEnd::Current => None,
            ExcitationEnd::Bus => Some(Refusal::Bus {
                least_v: f64::from(self.stage.bus_least_v),
                most_v: f64::from(self.stage.bus_most_v),
                step,
            }),
            ExcitationEnd::Speed => Some(Refusal::Speed {
                rad_s: FASTEST_RAD_S,
                step,
            }),
            ExcitationEnd::BrokenOff => Some(Refusal::BrokenOff {
                step,
                why: "it was told to end",
            }),
            ExcitationEnd::Fault => Some(Refusal::BrokenOff {
                step,
                why: "a fault; `knob info` tells which",
            }),
        };
        if let Some(refusal) = refusal {
            return Err(refusal.into());
        }
        let of = usize::from(limited.windows);
        if recorded.end == ExcitationEnd::Done && recorded.windows.len() != of {
            let missing = of.saturating_sub(recorded.windows.len());
            return Err(Refusal::Lost { missing, of, step }.into());
        }
        Ok(recorded)
    }

    /// Runs it to its proper end.
    pub fn excite(&mut self, excitation: &Excitation) -> Result<Vec<Sums>, B::Error> {
        let recorded = self.try_excite(excitation)?;
        match recorded.end {
            ExcitationEnd::Done => Ok(recorded.windows),
            _ => Err(Refusal::Current {
                current_max_a: self.told.current_max_a,
                step: self.step.name(),
            }
            .into()),
        }
    }

    /// Codes without current, and their noise.
    pub fn offsets(&mut self) -> Result<(), B::Error> {
        self.begin(Step::Offsets);
        let excitation = Excitation {
            rise: 1,
            settle: 1,
            quarter: 1,
            window: self.ticks(10e-3) / 4 * 4,
            windows: 32,
            current_max_a: self.stage.current_linear_a,
            ..self.nothing()
        };
        let recorded = self.try_excite(&excitation)?;
        if recorded.end != ExcitationEnd::Done {
            let limit_a = f64::from(self.stage.current_linear_a);
            return Err(Refusal::CurrentWithoutVoltage { limit_a }.into());
        }
        let windows = &recorded.windows;
        let counts = windows
            .chunks(1)
            .flat_map(|sums| [sums::count(sums), f64::from(sums[0].count)]);
        let (least, most) = counts.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), count| {
            (l.min(count), m.max(count))
        });
        if most - least > 2.0 {
            let counts = most - least;
            return Err(Refusal::Moving { counts }.into());
        }
        let codes = sums::codes(windows);
        let middle = f64::from(self.stage.current_zero_code);
        let spread = f64::from(self.stage.current_zero_spread);
        for (phase, code) in [(Phase::B, codes[0]), (Phase::C, codes[1])] {
            if (code - middle).abs() > spread {
                return Err(Refusal::Offset {
                    phase,
                    code,
                    least: middle - spread,
                    most: middle + spread,
                }
                .into());
            }
        }
        self.scale.zero_codes = codes;
        let noise = sums::noise_codes(windows, 0).max(sums::noise_codes(windows, 1));
        self.noise_a = noise * self.scale.step_a;
        self.bus_v = sums::bus_v(windows);
        // Half of the limit is used; five deviations must fit into the rest.
        let least_a = 10.0 * self.noise_a;
        if least_a > self.told.current_max_a {
            return Err(Refusal::Noise {
                noise_a: 3.0 * self.noise_a,
                current_max_a: self.told.current_max_a,
                least_a,
            }
            .into());
        }
        Ok(())
    }

    /// The longest vector to be used, V.
    pub fn reach_v(&self) -> f64 {
        REACH * f64::from(self.stage.reach) * self.bus_v
    }

    /// Standard deviation of a current's mean over so many periods, A. What is below a converter's noise is rounded
    /// to a code and does not average out.
    pub fn deviation_a(&self, periods: f64) -> f64 {
        let step = self.scale.step_a;
        let smooth = (self.noise_a / (0.5 * step)).min(1.0);
        let rounding = 0.3 * step * (1.0 - smooth);
        (self.noise_a * self.noise_a / periods + rounding * rounding).sqrt()
    }

    /// A current that is none, A.
    pub fn nothing_a(&self, level: &Level) -> f64 {
        let most = level.most_a();
        (5.0 * self.deviation_a(level.periods))
            .max(self.scale.step_a)
            .max(0.1 * most)
    }

    /// A steady voltage (V) in a direction.
    pub fn level(
        &mut self,
        turns: f64,
        volts: f64,
        expected_a: f64,
        times: &Times,
    ) -> Result<Option<Level>, B::Error> {
        let excitation = Excitation {
            angle: angle(turns),
            steady_v: volts as f32,
            steady_a: [expected_a as f32, 0.0],
            rise: self.ticks(times.rise_s),
            settle: self.ticks(times.settle_s),
            window: self.ticks(times.window_s),
            windows: times.windows,
            ..self.nothing()
        };
        let recorded = self.try_excite(&excitation)?;
        if recorded.end != ExcitationEnd::Done {
            return Ok(None);
        }
        self.bus_v = sums::bus_v(&recorded.windows);
        Ok(Some(Level {
            volts,
            expected_a,
            currents: self.scale.currents(&recorded.windows),
            vector: self.scale.vector(&recorded.windows),
            periods: sums::periods(&recorded.windows),
        }))
    }

    /// The voltage at which some phase in this direction bears `part` of the limit, or the most there is.
    pub fn search(&mut self, turns: f64, part: f64, times: &Times) -> Result<Level, B::Error> {
        let limit_a = self.told.current_max_a;
        let mut volts = FIRST_V;
        loop {
            let most = self.reach_v();
            volts = volts.min(most);
            // Whatever flows is well above the current from which dead time is lost as a whole.
            let Some(level) = self.level(turns, volts, limit_a, times)? else {
                return Err(self.short(volts));
            };
            if level.most_a() >= part * limit_a || volts >= 0.999 * most {
                return Ok(level);
            }
            volts *= GROWTH;
        }
    }

    /// A ripple of four periods, of no voltage yet, on a rotor that `steady_v` holds.
    pub fn rippling(&self, steady_v: f64) -> Excitation {
        Excitation {
            steady_v: steady_v as f32,
            quarter: 1,
            rise: self.ticks(30e-3),
            settle: self.ticks(50e-3),
            window: self.ticks(20e-3) / 32 * 32,
            windows: 2,
            ..self.nothing()
        }
    }

    /// The ripple along the steady voltage, up to `most_v`, whose amplitude drives `part` of the current limit, from
    /// one on that surely does not; and the quarter of its period, longer than one period if that voltage
    /// drives too little.
    pub fn find_ripple(
        &mut self,
        held: &Excitation,
        part: f64,
        first_v: f64,
        most_v: f64,
    ) -> Result<(f64, u16), B::Error> {
        let aim_a = part * self.told.current_max_a;
        let mut volts = first_v.min(most_v);
        loop {
            let windows = self.excite(&Excitation {
                along_v: volts as f32,
                ..*held
            })?;
            // Twice the amplitude.
            let [alpha, beta] = self.scale.ripple(&windows);
            let current_a = 0.5 * alpha.norm().hypot(beta.norm());
            if current_a >= 0.5 * aim_a {
                return Ok((volts, 1));
            }
            if volts >= 0.999 * most_v {
                let quarter = if current_a >= 0.25 * aim_a { 2 } else { 4 };
                return Ok((volts, quarter));
            }
            let larger = (aim_a / current_a.max(1e-3 * aim_a)).min(4.0);
            volts = (volts * larger).min(most_v);
        }
    }

    /// A voltage that drives too much.
    pub fn short(&self, volts: f64) -> B::Error {
        let current_max_a = self.told.current_max_a;
        Refusal::Short {
            volts,
            current_max_a,
            least_ohm: 1.5 * volts / current_max_a,
        }
        .into()
    }

    /// The torque constant by Kv where it is told, within what was measured.
    pub fn constant(&self, measured: Estimate, by_kv: Option<f64>) -> Result<Estimate, Refusal> {
        let (Some(told), Some(by_kv)) = (self.told.kv_rpm_v, by_kv) else {
            return Ok(measured);
        };
        let low = measured.low.max(by_kv * (1.0 - KV_TOLERANCE));
        let high = measured.high.min(by_kv * (1.0 + KV_TOLERANCE));
        if low > high {
            let kv = |constant: f64| told * by_kv / constant;
            return Err(Refusal::Kv {
                measured: kv(measured.value),
                low: kv(measured.high),
                high: kv(measured.low),
                told,
            });
        }
        Ok(Estimate {
            value: by_kv.clamp(low, high),
            low,
            high,
        })
    }
}

/// The most pole pairs that can be told from each other.
pub(super) const MOST_POLE_PAIRS: u32 = 50;

/// How long a voltage is on.
pub(super) struct Times {
    pub rise_s: f64,
    pub settle_s: f64,
    pub window_s: f64,
    pub windows: u16,
}

/// So short that a motor hardly turns.
pub(super) const SHORT: Times = Times {
    rise_s: 0.1e-3,
    settle_s: 0.5e-3,
    window_s: 0.5e-3,
    windows: 2,
};

impl Level {
    /// Of the phase with the most, A.
    pub fn most_a(&self) -> f64 {
        let [b, c] = self.currents;
        b.abs().max(c.abs()).max((b + c).abs())
    }
}

/// L of a winding with a resistance whose current answers a ripple, of a quarter of so many periods, with
/// the reactance `x_ohm`: the imaginary part of ripple over answer, in [`Scale::ripple`]'s measure.
///
/// i⁺ = a i + (1 − a) v/R, a = e^(−RT/L). With h periods in a quarter and the voltage ±V, half a period from i₀ on is
/// i = V/R + (i₀ − V/R) aᵏ, and ends at −i₀. The reactance grows with L, by which it is bisected.
pub(super) fn inductance_h(
    stage: &PowerStage,
    resistance_ohm: f64,
    quarter: u16,
    x_ohm: f64,
) -> f64 {
    let period_s = f64::from(stage.pwm_period_s);
    let h = i32::from(quarter);
    let reactance = |inductance_h: f64| {
        let rate = resistance_ohm * period_s / inductance_h;
        let a = (-rate).exp();
        let whole = 1.0 / resistance_ohm;
        let half = a.powi(2 * h);
        let from = -whole * (1.0 - half) / (1.0 + half) - whole;
        let mean = (1.0 - a.powi(h)) / (f64::from(h) * -(-rate).exp_m1());
        let first = whole + from * mean;
        let second = whole + from * mean * a.powi(h);
        (sums::ripple_of_one() / (2.0 * Vector::new(first, -second))).im
    };
    let (mut low, mut high) = (1e-8_f64, 10.0_f64);
    for _ in 0..100 {
        let middle = (low * high).sqrt();
        if reactance(middle) < x_ohm {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// False for what is not a number.
pub(super) fn at_most(value: f64, most: f64) -> bool {
    value <= most
}

/// Turns in 2⁻³².
pub(super) fn angle(turns: f64) -> u32 {
    (turns.rem_euclid(1.0) * PER_TURN) as u64 as u32
}

/// A value, wrong by `deviation` at random and by the part `systematic` of it at most.
pub(super) fn estimate(value: f64, deviation: f64, systematic: f64) -> Estimate {
    let half = DEVIATIONS * deviation + systematic * value.abs();
    Estimate {
        value,
        low: value - half,
        high: value + half,
    }
}

/// Mean, and the standard deviation of the mean.
pub(super) fn mean(values: &[f64]) -> (f64, f64) {
    let number = values.len() as f64;
    let mean = values.iter().sum::<f64>() / number;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, (square / (number * (number - 1.0)).max(1.0)).sqrt())
}
