//! What the interrupt of every PWM period does: take the encoder's count, decide at every n-th period by the haptic
//! tick what torque to give, and have the drive bring it.
//!
//! # When
//! Currents are sampled at a period's start, and the encoder is read right after. Haptic tick and drive follow each
//! other within the same interrupt: a torque decided from this count goes into duties at once, which are in
//! force for the whole of the next period. From the count to the first change of torque passes one PWM
//! period, however long the haptic period is, and then the drive's lag: both are
//! [`Delivery`](control::torque::Delivery), which the plan reckons with.
//!
//! # Direction
//! Angle and torque of the haptic tick are positive where the counter grows. Where the motor is wired the other way
//! round, the drive gets count, speed and torque negated.
//!
//! # Speed
//! The drive's speed is the counts of the last W PWM periods, less one towards 0, over their time: what the knob surely
//! had in the mean over that window, W/2 ago, and less than that by up to two counts in it. So what is made up for of the
//! back-EMF is never more than there was, and a knob that creeps from count to count is not pushed on. W is 16 to 128 and
//! depends on the motor; 32 with a voltage drive. What it makes of the torque, [`Power::delivery`] tells the plan.

use control::torque::Measured;
use protocol::{ExcitationEnd, Fault};

use crate::MeasurementSender;
use crate::commission::{Run, Told};
use crate::drive::{MOST_WINDOW, MotorDrive, Power};
use crate::guard::{Guard, Seen};
use crate::power::{Bridge, Sensed};
use crate::ticker::{StateCode, Stood, Ticker, Watch};

/// The current tick, and all that it owns.
pub struct CurrentTick<'a> {
    ticker: Ticker<'a>,
    power: Power,
    motion: Motion,
    /// PWM periods until the haptic tick.
    due_in: u32,
    /// Of the last haptic tick, Nm.
    torque_nm: f32,
    /// Found since the last haptic tick; the bridge is off from then on.
    fault: Option<Fault>,
    /// How things stood then.
    stood: Stood,
    guard: Guard,
    /// A motor is being measured.
    run: Option<Run>,
    /// How that ended, until the desk has been told.
    ended: Option<ExcitationEnd>,
    measurements: MeasurementSender<'a>,
}

impl<'a> CurrentTick<'a> {
    /// The bridge off, for an encoder whose counter of `counter_bits` bits (2 to 32) reads `counter` now; the ticker was
    /// made with its [`widened`] count. What excitations bring goes to `measurements`.
    #[must_use]
    pub fn new(
        ticker: Ticker<'a>,
        power: Power,
        counter_bits: u32,
        counter: u32,
        measurements: MeasurementSender<'a>,
    ) -> Self {
        Self {
            ticker,
            due_in: power.every,
            power,
            motion: Motion::new(counter_bits, counter),
            torque_nm: 0.0,
            fault: None,
            stood: Stood::default(),
            guard: Guard::new(),
            run: None,
            ended: None,
            measurements,
        }
    }

    /// One PWM period. `gate_fault`: the gate driver has put the outputs off; `overran`: another period began
    /// before this one was served.
    #[inline]
    pub fn tick(&mut self, sensed: &Sensed, gate_fault: bool, overran: bool) -> Bridge {
        let count = self.motion.follow(sensed.counter);
        let seen = self.seen(sensed);
        let state = self.ticker.state();
        let wrong = if state == StateCode::Calibrating {
            // What the motor bears is not known yet: current and speed are the run's to watch.
            self.guard.look_at_bus(&self.power.limits, sensed.bus_v)
        } else {
            self.guard.look(&self.power.limits, &seen)
        };
        if self.fault.is_none() && state != StateCode::Fault {
            self.stood = Stood {
                currents: seen.currents,
                bus_v: seen.bus_v,
            };
            // While disarmed, saving may keep the chip for longer than a period.
            self.fault = if gate_fault {
                Some(Fault::GateDriver)
            } else if overran && state != StateCode::Disarmed {
                Some(Fault::CurrentOverrun)
            } else {
                wrong
            };
        }
        if self.due_in <= 1 {
            let watch = Watch {
                found: self.fault.take(),
                stood: self.stood,
                guard: &self.guard,
            };
            let output = self
                .ticker
                .tick_with(&mut self.power, &mut self.run, count, &watch);
            self.torque_nm = output.torque_nm;
            self.due_in = self.power.every;
        } else {
            self.due_in -= 1;
        }
        self.bridge(sensed, &seen, count)
    }

    /// What the guard is shown, and the drive after it.
    #[inline]
    fn seen(&self, sensed: &Sensed) -> Seen {
        let power = &self.power;
        let counts = self.motion.counts_in(power.window);
        Seen {
            currents: power.sense.currents(sensed.currents),
            bus_v: sensed.bus_v,
            moved: self.motion.moved,
            speed_rad_s: counts.wrapping_sub(counts.signum()) as f32 * power.count_speed_rad_s,
            unexplained_v: power.drive.as_ref().map_or(0.0, MotorDrive::unexplained_v),
            active: matches!(self.ticker.state(), StateCode::Armed | StateCode::Pushing),
        }
    }

    /// True if the last period had a haptic tick in it.
    #[must_use]
    #[inline]
    pub fn was_haptic(&self) -> bool {
        self.due_in == self.power.every
    }

    /// What the bridge is to do, as things stand.
    #[inline]
    fn bridge(&mut self, sensed: &Sensed, seen: &Seen, count: i32) -> Bridge {
        if self.run.is_some() || self.ended.is_some() {
            return self.excite(sensed, count);
        }
        let speed_rad_s = seen.speed_rad_s;
        let Some(drive) = &mut self.power.drive else {
            return Bridge::Off;
        };
        let on = match self.ticker.state() {
            StateCode::Armed => true,
            // It coasts with the bridge off: a loop that holds 0 errs by up to half a step of the converter.
            StateCode::Pushing => self.torque_nm != 0.0,
            _ => false,
        };
        if !on || self.fault.is_some() {
            drive.clear();
            return Bridge::Off;
        }
        let (count, speed_rad_s, torque_nm) = if self.power.reversed {
            (count.wrapping_neg(), -speed_rad_s, -self.torque_nm)
        } else {
            (count, speed_rad_s, self.torque_nm)
        };
        let measured = Measured {
            currents: seen.currents,
            count,
            speed_rad_s,
            bus_v: seen.bus_v,
        };
        Bridge::On(drive.tick(torque_nm, &measured))
    }
}

impl CurrentTick<'_> {
    /// A period of an excitation, and what there is to tell of it. The end is told in a period of its own, as soon as
    /// there is room.
    #[inline(never)]
    fn excite(&mut self, sensed: &Sensed, count: i32) -> Bridge {
        if let Some(end) = self.ended {
            if self.measurements.enqueue(Told::End(end)).is_ok() {
                self.ended = None;
            }
            return Bridge::Off;
        }
        let Some(run) = &mut self.run else {
            return Bridge::Off;
        };
        let state = self.ticker.state();
        if state != StateCode::Calibrating || self.fault.is_some() {
            self.run = None;
            self.ended = Some(match (state, self.fault) {
                (StateCode::Disarmed, None) => ExcitationEnd::BrokenOff,
                _ => ExcitationEnd::Fault,
            });
            return Bridge::Off;
        }
        let step = run.tick(sensed, count);
        if step.window_over {
            // Where there is no room the host finds a window missing.
            let _ = self.measurements.enqueue(Told::Sums(*run.sums()));
        }
        if step.end.is_some() {
            self.run = None;
            self.ended = step.end;
            self.ticker.excited();
        }
        step.bridge
    }
}

/// A counter of so many bits (2 to 32) as a count near 0.
#[must_use]
pub fn widened(counter: u32, counter_bits: u32) -> i32 {
    let shift = 32 - counter_bits.clamp(2, 32);
    (counter << shift).cast_signed() >> shift
}

/// Counts of the last periods. A power of two, so that a number cut to it is always a place.
const HISTORY: usize = MOST_WINDOW as usize;
const _: () = assert!(HISTORY.is_power_of_two());

/// The encoder's count, widened, now and in the past.
struct Motion {
    /// 32 − the counter's bits.
    shift: u32,
    count: i32,
    /// Since the period before.
    moved: i32,
    past: [i32; HISTORY],
    /// Of the latest count.
    place: usize,
    /// The count [`MOST_WINDOW`] periods ago, which the latest has replaced.
    oldest: i32,
}

impl Motion {
    /// At rest since ever.
    fn new(counter_bits: u32, counter: u32) -> Self {
        let count = widened(counter, counter_bits);
        Self {
            shift: 32 - counter_bits.clamp(2, 32),
            count,
            moved: 0,
            past: [count; HISTORY],
            place: 0,
            oldest: count,
        }
    }

    /// Takes the counter as it reads now, and returns the count: right while the knob moves by less than half the
    /// counter's range in a PWM period.
    #[inline]
    fn follow(&mut self, counter: u32) -> i32 {
        let shift = self.shift & 31;
        let moved =
            (counter.wrapping_sub(self.count.cast_unsigned()) << shift).cast_signed() >> shift;
        self.moved = moved;
        self.count = self.count.wrapping_add(moved);
        self.place = (self.place + 1) % HISTORY;
        let place = &mut self.past[self.place];
        self.oldest = *place;
        *place = self.count;
        self.count
    }

    /// How far it moved in the last `periods`, at most [`MOST_WINDOW`].
    #[inline]
    fn counts_in(&self, periods: u32) -> i32 {
        let then = if periods >= MOST_WINDOW {
            self.oldest
        } else {
            self.past[self.place.wrapping_sub(periods as usize) % HISTORY]
        };
        self.count.wrapping_sub(then)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Whatever the counter's width, its wraps do not show.
        #[test]
        fn the_count_follows_a_counter_that_wraps(
            bits in 3..=32_u32,
            start in any::<u32>(),
            moves in prop::collection::vec(-1.0..1.0f64, 1..200),
            window in 1..=MOST_WINDOW,
        ) {
            let mask = u32::MAX >> (32 - bits);
            let mut motion = Motion::new(bits, start & mask);
            let reach = f64::from(1_u32 << (bits - 1)) - 1.0;
            let first = motion.count;
            let mut truth = vec![first; MOST_WINDOW as usize + 1];
            for share in moves {
                let moved = (share * reach) as i32;
                truth.push(truth.last().unwrap().wrapping_add(moved));
                let now = *truth.last().unwrap();
                let counter = start.wrapping_add(now.wrapping_sub(first).cast_unsigned()) & mask;
                prop_assert_eq!(motion.follow(counter), now);
                let then = truth[truth.len() - 1 - window as usize];
                prop_assert_eq!(motion.counts_in(window), now.wrapping_sub(then));
            }
        }
    }
}
