//! Measuring a motor, in the current tick: a known voltage on its windings, and sums of what comes back.
//!
//! The device decides nothing about a motor. The host asks for one [`Excitation`] after the other, and makes
//! values, intervals and refusals of the [`Sums`] in `f64`; `docs/calibrate.md` tells how. What the device
//! owes is that no excitation does harm: a current, a bus voltage or a speed beyond its limit ends it in
//! the very tick, it ends by itself after a time that is known at its start, and the bridge is then off.
//!
//! # How the current tick uses it
//! [`Run::new`] checks what the host asked, with divisions: in the desk. The run is handed to the current tick, which
//! calls [`Run::tick`] once in each PWM period, with what was sensed and the count, **not** reversed, that the
//! drive's angle is reckoned from. It hands the bridge on, and to the desk the sums where there are some. After
//! a step with an end there is nothing more to do; to break off, drop the run and turn the bridge off.
//!
//! # Voltages
//! Duties are rounded to whole steps here, and what a rounding left over is made up for in the next
//! period, so that the mean voltage is the one asked for.

mod refusal;

use control::torque::angle::Phase;
use control::torque::frames::{Rotating, Stationary};
use control::torque::modulation::Modulator;
use control::torque::sense::CurrentSense;
use control::torque::{InverterConfig, TorqueError};
use protocol::{Excitation, ExcitationEnd, PowerStage, Sums};

use crate::power::{Bridge, Sensed, StageFacts};
pub use refusal::ExcitationError;

/// The longest excitation, s.
pub const LONGEST_S: f64 = 30.0;

/// The fastest that the voltage turns, 2⁻³² turns in a period: at 24 kHz 300 turns a second.
pub const FASTEST: u32 = 1 << 26;

/// 1/√3.
const THIRD_ROOT: f64 = 0.577_350_269_189_625_8;

/// What a period of commissioning decides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// For the next period.
    pub bridge: Bridge,
    /// A window is over: [`Run::sums`] are for the host.
    pub window_over: bool,
    /// It is over, and how. The bridge is off.
    pub end: Option<ExcitationEnd>,
}

/// What the current tick has to tell the host, on its way to the desk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Told {
    /// A window is over.
    Sums(Sums),
    /// The excitation is.
    End(ExcitationEnd),
}

/// Where an excitation is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    Rise,
    Settle,
    Measure,
    Fall,
    Over,
}

/// An excitation under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    // The stage.
    modulator: Modulator,
    sense: CurrentSense,
    pwm_steps: u16,
    per_pwm_step: f32,
    bus_least_v: f32,
    bus_most_v: f32,
    // What was asked.
    asked: Excitation,
    per_rise: f32,
    per_settle: f32,
    // Where it is.
    part: Part,
    /// Periods of this part, of the window, and of the quarter of the ripple that are over; the window's number.
    done: u32,
    in_window: u16,
    window: u16,
    in_quarter: u16,
    quarter: u8,
    angle: u32,
    turn: i32,
    /// What rounding has left over, in duties.
    left: Stationary,
    /// The count when the speed was looked at last, and periods since.
    way_count: Option<i32>,
    way_periods: u16,
    sums: Sums,
}

const NO_SUMS: Sums = Sums {
    window: 0,
    periods: [0; 4],
    b_codes: [0; 4],
    c_codes: [0; 4],
    counts: 0,
    count: 0,
    angle: 0,
    bus_mv: 0,
};

const NOTHING: Stationary = Stationary {
    alpha: 0.0,
    beta: 0.0,
};

/// What the host must know of a stage.
#[must_use]
pub fn power_stage(facts: &StageFacts) -> PowerStage {
    let dead = facts.dead_time_s / facts.pwm_period_s;
    PowerStage {
        pwm_period_s: facts.pwm_period_s as f32,
        current_step_a: facts.current_step_a as f32,
        current_zero_code: facts.current_zero_code as f32,
        current_zero_spread: facts.current_zero_spread as f32,
        current_linear_a: facts.current_linear_a as f32,
        reach: ((facts.duty_max - 2.0 * dead) * THIRD_ROOT) as f32,
        dead_duty: dead as f32,
        dead_edge_a: facts.dead_time_edge_a as f32,
        bus_least_v: facts.bus_least_v as f32,
        bus_most_v: facts.bus_most_v as f32,
    }
}

fn inverter(facts: &StageFacts) -> InverterConfig {
    InverterConfig {
        pwm_period_s: facts.pwm_period_s,
        pwm_steps: facts.pwm_steps,
        dead_time_s: facts.dead_time_s,
        dead_time_edge_a: facts.dead_time_edge_a,
        duty_max: facts.duty_max,
        bus_least_v: facts.bus_least_v,
        bus_most_v: facts.bus_most_v,
        current_step_a: facts.current_step_a,
    }
}

impl Run {
    /// # Errors
    /// Names the first value that is not accepted, and what would be; or what is wrong with the stage.
    pub fn new(asked: &Excitation, facts: &StageFacts) -> Result<Self, ExcitationError> {
        refusal::check(asked, facts)?;
        let zero_codes = asked.zero_codes.map(f64::from);
        let first = |error: TorqueError| ExcitationError::Stage(error);
        Ok(Self {
            modulator: Modulator::new(&inverter(facts)).map_err(first)?,
            sense: CurrentSense::new(facts.current_step_a, zero_codes).map_err(first)?,
            pwm_steps: facts.pwm_steps,
            per_pwm_step: 1.0 / f32::from(facts.pwm_steps),
            bus_least_v: facts.bus_least_v as f32,
            bus_most_v: facts.bus_most_v as f32,
            asked: *asked,
            per_rise: 1.0 / f32::from(asked.rise),
            per_settle: 1.0 / f32::from(asked.settle),
            part: Part::Rise,
            done: 0,
            in_window: 0,
            window: 0,
            in_quarter: 0,
            quarter: 0,
            angle: asked.angle,
            turn: 0,
            left: NOTHING,
            way_count: None,
            way_periods: 0,
            sums: NO_SUMS,
        })
    }

    /// One PWM period.
    #[inline]
    pub fn tick(&mut self, sensed: &Sensed, count: i32) -> Step {
        if let Some(end) = self.danger(sensed, count) {
            self.part = Part::Over;
            return Step {
                bridge: Bridge::Off,
                window_over: false,
                end: Some(end),
            };
        }
        let window_over = self.part == Part::Measure && self.sum(sensed, count);
        self.go_on();
        if self.part == Part::Over {
            return Step {
                bridge: Bridge::Off,
                window_over,
                end: Some(ExcitationEnd::Done),
            };
        }
        Step {
            bridge: self.bridge(sensed.bus_v),
            window_over,
            end: None,
        }
    }

    /// What ends it at once. Written so that what is not a number does.
    fn danger(&mut self, sensed: &Sensed, count: i32) -> Option<ExcitationEnd> {
        let current = self.sense.currents(sensed.currents);
        let most = self.asked.current_max_a;
        let small = current.b_a.abs() <= most
            && current.c_a.abs() <= most
            && (current.b_a + current.c_a).abs() <= most;
        if !small {
            return Some(ExcitationEnd::Current);
        }
        if !(self.bus_least_v <= sensed.bus_v && sensed.bus_v <= self.bus_most_v) {
            return Some(ExcitationEnd::Bus);
        }
        let from = *self.way_count.get_or_insert(count);
        if count.wrapping_sub(from).unsigned_abs() > self.asked.way_max {
            return Some(ExcitationEnd::Speed);
        }
        self.way_periods = self.way_periods.wrapping_add(1);
        if self.way_periods >= self.asked.window {
            self.way_periods = 0;
            self.way_count = Some(count);
        }
        None
    }

    /// Of the window that is over, until the next period.
    #[must_use]
    #[inline]
    pub fn sums(&self) -> &Sums {
        &self.sums
    }

    /// Adds what was sensed. True if this was the last period of a window.
    #[inline]
    fn sum(&mut self, sensed: &Sensed, count: i32) -> bool {
        if self.in_window == 0 {
            self.sums = Sums {
                window: self.window,
                ..NO_SUMS
            };
        }
        let quarter = if self.asked.quarter == 0 {
            self.angle >> 30
        } else {
            u32::from(self.quarter)
        };
        let sums = &mut self.sums;
        let [b, c] = sensed.currents.map(u32::from);
        // One of four, whatever it reads.
        let quarter = quarter as usize & 3;
        sums.periods[quarter] = sums.periods[quarter].wrapping_add(1);
        sums.b_codes[quarter] = sums.b_codes[quarter].wrapping_add(b);
        sums.c_codes[quarter] = sums.c_codes[quarter].wrapping_add(c);
        sums.counts = sums.counts.wrapping_add(i64::from(count));
        sums.bus_mv = sums.bus_mv.wrapping_add((sensed.bus_v * 1e3) as u32);
        self.in_window = self.in_window.wrapping_add(1);
        if self.in_window < self.asked.window {
            return false;
        }
        self.in_window = 0;
        self.window = self.window.wrapping_add(1);
        self.sums.count = count;
        self.sums.angle = self.angle;
        true
    }

    /// From one period to the next.
    fn go_on(&mut self) {
        let asked = &self.asked;
        self.angle = self.angle.wrapping_add(self.turn.cast_unsigned());
        if self.part != Part::Rise && asked.quarter != 0 {
            self.in_quarter = self.in_quarter.wrapping_add(1);
            if self.in_quarter >= asked.quarter {
                self.in_quarter = 0;
                self.quarter = (self.quarter + 1) & 3;
            }
        }
        self.done += 1;
        match self.part {
            Part::Rise => self.next_after(u32::from(asked.rise), Part::Settle),
            Part::Settle => {
                self.turn = (asked.turn as f32 * self.done as f32 * self.per_settle) as i32;
                self.next_after(u32::from(asked.settle), Part::Measure);
            }
            Part::Measure => {
                let (windows, window) = (u32::from(asked.windows), u32::from(asked.window));
                if asked.back && self.done == windows / 2 * window {
                    self.turn = asked.turn.wrapping_neg();
                }
                self.next_after(windows * window, Part::Fall);
            }
            Part::Fall => self.next_after(u32::from(asked.rise), Part::Over),
            Part::Over => {}
        }
    }

    fn next_after(&mut self, periods: u32, next: Part) {
        if self.done >= periods {
            self.done = 0;
            self.part = next;
        }
    }

    /// The duties for the next period.
    fn bridge(&mut self, bus_v: f32) -> Bridge {
        let asked = &self.asked;
        let gone = self.done as f32 * self.per_rise;
        let (share, ripple) = match self.part {
            Part::Rise => (gone, 0.0),
            Part::Fall => (1.0 - gone, 0.0),
            Part::Over => (0.0, 0.0),
            Part::Settle | Part::Measure if asked.quarter == 0 => (1.0, 0.0),
            Part::Settle | Part::Measure if self.quarter < 2 => (1.0, 1.0),
            Part::Settle | Part::Measure => (1.0, -1.0),
        };
        let bus = self.modulator.bus(bus_v);
        let there = Phase::from_bits(self.angle).rotation();
        let volts = self.modulator.limited(
            Rotating {
                d: share * asked.steady_v + ripple * asked.along_v,
                q: ripple * asked.across_v,
            },
            bus,
        );
        let volts = volts.turned(there);
        let currents = Rotating {
            d: share * asked.steady_a[0],
            q: share * asked.steady_a[1],
        };
        let duties = self.modulator.three_phase(
            Stationary {
                alpha: volts.alpha + self.left.alpha * bus_v,
                beta: volts.beta + self.left.beta * bus_v,
            },
            currents.turned(there),
            bus,
        );
        let [a, b, c] = duties.parts();
        let [on_a, on_b, on_c] = duties
            .in_steps(self.pwm_steps)
            .map(|steps| f32::from(steps) * self.per_pwm_step);
        let (a, b, c) = (a - on_a, b - on_b, c - on_c);
        let star = (a + b + c) * (1.0 / 3.0);
        self.left = Stationary::from_two_phases(b - star, c - star);
        Bridge::On(duties)
    }
}
