//! What the tick does: obey at most one command, read the encoder, call [`control`], watch
//! over the result, and say what there is to say.
//!
//! The tick owns the state. Torque is zero in every state but armed and pushing:
//!
//! disarmed → (arm) → armed → (fault) → fault → (clear) → disarmed; armed → (disarm) → disarmed;
//! disarmed → (push) → pushing → (it is over, or disarm) → disarmed; pushing → (fault) → fault.

use core::sync::atomic::Ordering::Relaxed;

use control::plan::Plan;
use control::push::{Push, Pushing, Step};
use control::tick::{Controller, Reason, Tick};
use control::torque::sense::PhaseCurrents;

use protocol::{Fault, PushEnd};

use crate::commission::Run;
use crate::drive::Power;
use crate::guard::Guard;
use crate::{CommandReceiver, Link, LinkStatus, MoveSender, RecordSender};

/// What the desk tells the tick.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "two of them lie in the queue, some 380 bytes each; without an allocator nothing is boxed"
)]
pub enum Command {
    /// Take this plan. Refused while armed if it changes the period, the encoder or the count, and while pushing.
    Configure(Settled),
    /// Render; refused in fault.
    Arm,
    /// No torque; refused in fault. A push is over.
    Disarm,
    /// Leave the fault; refused without one.
    Clear,
    /// Put a voltage on the motor; refused unless disarmed, and without a power stage.
    Excite(Run),
    /// Play this from this tick on; refused unless disarmed. Checked: see [`crate::settings::push`].
    Push(Push),
}

/// A checked configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settled {
    /// What the controller uses.
    pub plan: Plan,
    /// The most counts that the knob can move in one period.
    pub furthest_counts: u32,
    /// Of a board with a power stage.
    pub power: Option<Power>,
}

/// Whether torque is given, in one byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum StateCode {
    /// No torque.
    Disarmed = 0,
    /// Rendering.
    Armed = 1,
    /// No torque until cleared.
    Fault = 2,
    /// The motor is being measured.
    Calibrating = 3,
    /// A torque without a spring.
    Pushing = 4,
}

impl StateCode {
    pub(crate) fn from_bits(word: u32) -> Self {
        match word & 0xFF {
            0 => Self::Disarmed,
            1 => Self::Armed,
            3 => Self::Calibrating,
            4 => Self::Pushing,
            _ => Self::Fault,
        }
    }
}

/// What a tick has to tell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Its number.
    pub number: u32,
    /// The state after it.
    pub state: StateCode,
    /// What the controller decided; its torque is given only while armed. Of a push, the torque is the push's.
    pub tick: Tick,
    /// Stiffness demanded, Nm/rad.
    pub demanded_nm_rad: f32,
    /// Why it is told.
    pub occasion: Occasion,
}

/// Why a tick is told of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Occasion {
    /// Telemetry is due.
    Telemetry,
    /// The reason for clamping changed.
    Clamp,
    /// Torque went to zero.
    Fault(Fault),
}

/// What a tick has the board do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// The torque to give, Nm: finite, and 0 unless armed or pushing.
    pub torque_nm: f32,
    /// The new period, s, where it changed.
    pub period_s: Option<f32>,
}

/// After arming, the torque limit takes so long to rise to its full value, s.
pub const RAMP_S: f32 = 0.1;

/// A slow task that ran once and has not for so long is taken for dead, s.
pub const SLOW_MOST_S: f32 = 0.5;

/// What the current tick saw since the last haptic tick.
pub struct Watch<'a> {
    /// The first thing that was wrong.
    pub found: Option<Fault>,
    /// How things stood then, or now.
    pub stood: Stood,
    /// What it watches with.
    pub guard: &'a Guard,
}

/// What a power stage measured. All 0, the default, where there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stood {
    /// The currents.
    pub currents: PhaseCurrents,
    /// The bus voltage, V.
    pub bus_v: f32,
}

impl Default for Stood {
    fn default() -> Self {
        Self {
            currents: PhaseCurrents { b_a: 0.0, c_a: 0.0 },
            bus_v: 0.0,
        }
    }
}

/// What stands in the way of a command.
#[derive(Debug, Clone, Copy, Default)]
struct Against {
    clearing: Option<Fault>,
    arming: Option<Fault>,
}

/// The tick, and all that it owns.
pub struct Ticker<'a> {
    controller: Controller,
    furthest_counts: u32,
    /// What the link was told last; its state is the state.
    status: LinkStatus,
    reason: Reason,
    /// Ticks until telemetry is due.
    due_in: u32,
    /// Since arming, s.
    ramp_s: f32,
    /// The part of the torque limit that is in force.
    ramp: f32,
    /// The slow task's runs as seen last, and for how long there was none, s.
    slow_runs: u32,
    slow_silent_s: f32,
    /// Why arming was refused.
    barred: Option<Fault>,
    /// What is played while pushing.
    pushing: Option<Pushing>,
    link: &'a Link,
    commands: CommandReceiver<'a>,
    records: RecordSender<'a>,
    moves: MoveSender<'a>,
}

impl<'a> Ticker<'a> {
    /// Disarmed, for a knob whose counter reads `counter` now.
    #[must_use]
    pub fn new(
        settled: &Settled,
        counter: u32,
        link: &'a Link,
        commands: CommandReceiver<'a>,
        records: RecordSender<'a>,
        moves: MoveSender<'a>,
    ) -> Self {
        let status = LinkStatus {
            state: StateCode::Disarmed,
            refused: false,
            taken: 0,
        };
        link.set_status(status);
        Self {
            controller: Controller::new(settled.plan, counter as i32),
            furthest_counts: settled.furthest_counts,
            status,
            reason: Reason::None,
            due_in: 0,
            ramp_s: RAMP_S,
            ramp: 1.0,
            slow_runs: 0,
            slow_silent_s: 0.0,
            barred: None,
            pushing: None,
            link,
            commands,
            records,
            moves,
        }
    }

    /// One tick, `elapsed_s` after the last one (s, finite, above 0). `overran`: another was due
    /// before this one was served.
    #[inline]
    pub fn tick(&mut self, counter: u32, elapsed_s: f32, overran: bool) -> Output {
        self.begin();
        let mut period_s = None;
        if self.commands.ready() {
            period_s = self.obey(None);
        }
        let mut tick = self.controller.tick(counter, elapsed_s);
        let mut torque_nm = 0.0;
        if self.status.state == StateCode::Armed {
            match fault_in(&tick, self.furthest_counts, overran) {
                None => torque_nm = tick.torque_nm,
                Some(fault) => self.fail(tick, fault, &Stood::default()),
            }
        } else if self.status.state == StateCode::Pushing {
            let found = overran.then_some(Fault::Overrun);
            torque_nm = self.push(&mut tick, found, &Stood::default());
        }
        self.tell(&tick);
        Output {
            torque_nm,
            period_s,
        }
    }

    /// One tick on a board with a power stage, which comes as often as `power` says to the bit; a new motor goes there
    /// while the bridge is off. What `watch` found since the last tick counts in every state. The torque limit rises
    /// from 0 to its full value in [`RAMP_S`] after arming, or as soon after that as it adds no energy.
    #[inline]
    pub fn tick_with(
        &mut self,
        power: &mut Power,
        run: &mut Option<Run>,
        count: i32,
        watch: &Watch<'_>,
    ) -> Output {
        self.begin();
        let elapsed_s = self.controller.plan().period_s();
        let slow = self.slow_work(elapsed_s);
        let mut period_s = None;
        if self.commands.ready() {
            let against = Against {
                clearing: watch.guard.against_clearing().or(slow),
                arming: watch.guard.against_arming(&power.limits).or(slow),
            };
            period_s = self.obey(Some((power, run, &against)));
        }
        if self.ramp < 1.0 {
            self.raise(elapsed_s);
        }
        let mut tick = self.controller.tick(count.cast_unsigned(), elapsed_s);
        let mut torque_nm = 0.0;
        let mut fault = watch.found.or(self.barred.take());
        let gives = matches!(self.status.state, StateCode::Armed | StateCode::Pushing);
        if fault.is_none() && gives {
            fault = fault_in(&tick, self.furthest_counts, false)
                .map(|fault| self.of_many_periods(fault));
        }
        if fault.is_none() && self.status.state != StateCode::Disarmed {
            fault = slow;
        }
        match fault {
            None if self.status.state == StateCode::Armed => torque_nm = tick.torque_nm,
            _ if self.status.state == StateCode::Pushing => {
                torque_nm = self.push(&mut tick, fault, &watch.stood);
            }
            Some(fault) if self.status.state != StateCode::Fault => {
                self.fail(tick, fault, &watch.stood);
            }
            _ => {}
        }
        self.tell(&tick);
        Output {
            torque_nm,
            period_s,
        }
    }

    /// An excitation is over.
    pub fn excited(&mut self) {
        if self.status.state == StateCode::Calibrating {
            self.status.state = StateCode::Disarmed;
            self.link.set_status(self.status);
        }
    }

    /// The state.
    #[must_use]
    #[inline]
    pub fn state(&self) -> StateCode {
        self.status.state
    }

    #[inline]
    fn begin(&mut self) {
        let number = self.link.tick.load(Relaxed).wrapping_add(1);
        self.link.tick.store(number, Relaxed);
    }

    /// Where a jump would have been seen in its PWM period, a long way is a speed.
    fn of_many_periods(&self, fault: Fault) -> Fault {
        match fault {
            Fault::EncoderJump { counts } => Fault::OverSpeed {
                speed_rad_s: counts as f32 * self.controller.plan().count_speed_rad_s(),
            },
            other => other,
        }
    }

    /// What is wrong with what the slow task watches, or with itself: it ran once and does not any more.
    #[inline]
    fn slow_work(&mut self, elapsed_s: f32) -> Option<Fault> {
        let runs = self.link.slow_runs.load(Relaxed);
        if runs != self.slow_runs {
            self.slow_runs = runs;
            self.slow_silent_s = 0.0;
        } else if runs != 0 {
            self.slow_silent_s += elapsed_s;
            if self.slow_silent_s > SLOW_MOST_S {
                return Some(Fault::OverTemperature {
                    temperature_c: f32::NAN,
                });
            }
        }
        self.link.slow_fault()
    }

    /// The torque limit of this tick after arming.
    #[cold]
    #[inline(never)]
    fn raise(&mut self, elapsed_s: f32) {
        self.ramp_s += elapsed_s;
        self.ramp = self.controller.raise_torque(self.ramp_s / RAMP_S);
    }

    /// Takes the next command.
    #[cold]
    #[inline(never)]
    fn obey(&mut self, stage: Option<(&mut Power, &mut Option<Run>, &Against)>) -> Option<f32> {
        let (power, run, against) = match stage {
            Some((power, run, against)) => (Some(power), Some(run), *against),
            None => (None, None, Against::default()),
        };
        let has_stage = power.is_some();
        let command = self.commands.dequeue()?;
        let mut period_s = None;
        let done = match (command, self.status.state) {
            // What is played was checked beside the parameters that are in force.
            (Command::Configure(_), StateCode::Pushing) => false,
            (Command::Configure(settled), state) => {
                let off = matches!(state, StateCode::Disarmed | StateCode::Fault);
                match (power, settled.power) {
                    (Some(power), Some(new)) if off => *power = new,
                    (Some(power), Some(new)) => power.limits = new.limits,
                    _ => {}
                }
                let (old, new) = (self.controller.plan(), settled.plan);
                // With the same period, Δ/T is the same where Δ is. Believed jitter, delay and
                // lag are the plan's alone.
                let same_sampling = old.encoder() == new.encoder()
                    && old.period_s() == new.period_s()
                    && old.count_speed_rad_s() == new.count_speed_rad_s();
                if same_sampling {
                    self.controller.adopt(new);
                    self.furthest_counts = settled.furthest_counts;
                    true
                } else if state != StateCode::Armed {
                    self.controller = Controller::new(new, self.controller.hardware_count());
                    self.furthest_counts = settled.furthest_counts;
                    period_s = Some(new.period_s());
                    true
                } else {
                    false
                }
            }
            (Command::Arm | Command::Push(_), StateCode::Disarmed) if against.arming.is_some() => {
                self.barred = against.arming;
                false
            }
            (Command::Arm, StateCode::Disarmed) => {
                self.controller.release();
                if has_stage {
                    self.ramp_s = 0.0;
                    self.ramp = self.controller.raise_torque(0.0);
                }
                self.status.state = StateCode::Armed;
                true
            }
            // Not by offsets: measuring them anew is what it is for.
            (Command::Excite(_), StateCode::Disarmed) if against.clearing.is_some() => {
                self.barred = against.clearing;
                false
            }
            (Command::Excite(new), StateCode::Disarmed) => match run {
                Some(run) => {
                    *run = Some(new);
                    self.status.state = StateCode::Calibrating;
                    true
                }
                None => false,
            },
            (Command::Disarm, StateCode::Armed | StateCode::Calibrating) => {
                self.status.state = StateCode::Disarmed;
                true
            }
            (Command::Push(push), StateCode::Disarmed) => {
                self.pushing = Some(Pushing::new(push));
                self.link.begin_push(self.controller.count());
                self.status.state = StateCode::Pushing;
                true
            }
            (Command::Disarm, StateCode::Pushing) => {
                self.end_push(PushEnd::BrokenOff);
                true
            }
            (Command::Arm, StateCode::Armed) | (Command::Disarm, StateCode::Disarmed) => true,
            (Command::Clear, StateCode::Fault) if against.clearing.is_none() => {
                self.status.state = StateCode::Disarmed;
                true
            }
            (Command::Disarm, StateCode::Fault)
            | (Command::Arm, StateCode::Fault | StateCode::Calibrating | StateCode::Pushing)
            | (Command::Clear | Command::Push(_) | Command::Excite(_), _) => false,
        };
        let number = self.link.tick.load(Relaxed);
        self.link.taken_at.store(number, Relaxed);
        self.status.refused = !done;
        self.status.taken = self.status.taken.wrapping_add(1);
        self.link.set_status(self.status);
        period_s
    }

    #[cold]
    #[inline(never)]
    fn fail(&mut self, tick: Tick, fault: Fault, stood: &Stood) {
        self.link.set_fault(fault);
        self.link.set_snapshot(&tick, stood);
        self.status.state = StateCode::Fault;
        self.link.set_status(self.status);
        self.record(tick, Occasion::Fault(fault));
    }

    /// A tick of a push: the torque to give, Nm. Where the move finds no room, or a fault was `found`, the push is over.
    #[cold]
    #[inline(never)]
    fn push(&mut self, tick: &mut Tick, found: Option<Fault>, stood: &Stood) -> f32 {
        let Some(pushing) = &mut self.pushing else {
            return 0.0;
        };
        let step = pushing.tick(tick.moved);
        let released = pushing.released().unwrap_or(u32::MAX);
        self.link.push_released.store(released, Relaxed);
        tick.torque_nm = match step {
            Step::Torque(torque_nm) => torque_nm,
            _ => 0.0,
        };
        let mut fault = found.or(fault_in(tick, self.furthest_counts, false));
        let mut room = true;
        match i16::try_from(tick.moved) {
            Ok(moved) => room = self.moves.enqueue(moved).is_ok(),
            Err(_) => fault = fault.or(Some(Fault::Guard)),
        }
        if step == Step::Beyond {
            fault = fault.or(Some(Fault::Guard));
        }
        let end = match (fault, room, step) {
            (Some(fault), ..) => {
                self.fail(*tick, fault, stood);
                PushEnd::Fault
            }
            (None, false, _) => PushEnd::NoRoom,
            (None, true, Step::Rest) => PushEnd::Rest,
            (None, true, Step::InMotion) => PushEnd::InMotion,
            (None, true, _) => return tick.torque_nm,
        };
        tick.torque_nm = 0.0;
        self.end_push(end);
        0.0
    }

    fn end_push(&mut self, end: PushEnd) {
        self.pushing = None;
        self.link.end_push(end);
        if self.status.state == StateCode::Pushing {
            self.status.state = StateCode::Disarmed;
            self.link.set_status(self.status);
        }
    }

    /// Telemetry where it is due, and changes of the clamp's reason where they are wanted.
    #[inline]
    fn tell(&mut self, tick: &Tick) {
        let every = self.link.every_ticks.load(Relaxed);
        if every != 0 {
            // Also where less often was asked for before.
            if self.due_in <= 1 || self.due_in > every {
                self.due_in = every;
                self.record(*tick, Occasion::Telemetry);
            } else {
                self.due_in -= 1;
            }
        }
        if tick.reason != self.reason {
            self.reason = tick.reason;
            if self.link.clamp_events.load(Relaxed) != 0 {
                self.record(*tick, Occasion::Clamp);
            }
        }
    }

    #[inline(never)]
    fn record(&mut self, tick: Tick, occasion: Occasion) {
        let record = Record {
            number: self.link.tick.load(Relaxed),
            state: self.status.state,
            tick,
            demanded_nm_rad: self.controller.plan().demanded_nm_rad(),
            occasion,
        };
        if self.records.enqueue(record).is_err() {
            let dropped = self.link.dropped.load(Relaxed);
            self.link.dropped.store(dropped.wrapping_add(1), Relaxed);
        }
    }
}

/// What is wrong with a tick, if anything is.
#[inline]
fn fault_in(tick: &Tick, furthest_counts: u32, overran: bool) -> Option<Fault> {
    if overran {
        return Some(Fault::Overrun);
    }
    if tick.moved.unsigned_abs() > furthest_counts {
        return Some(Fault::EncoderJump { counts: tick.moved });
    }
    if !tick.torque_nm.is_finite() {
        return Some(Fault::TorqueNotFinite);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use control::config::Law;

    #[test]
    fn every_fault_is_seen() {
        let good = Tick {
            count: 0,
            moved: -7,
            torque_nm: 0.1,
            stiffness_nm_rad: 1.0,
            margin_nm: 0.0,
            account_j: 0.0,
            law: Law::Ledger,
            reason: Reason::None,
        };
        assert_eq!(fault_in(&good, 7, false), None);
        assert_eq!(fault_in(&good, 7, true), Some(Fault::Overrun));
        assert_eq!(
            fault_in(&good, 6, false),
            Some(Fault::EncoderJump { counts: -7 })
        );
        let far = Tick {
            moved: i32::MIN,
            ..good
        };
        assert!(matches!(
            fault_in(&far, 7, false),
            Some(Fault::EncoderJump { .. })
        ));
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let wild = Tick {
                torque_nm: bad,
                ..good
            };
            assert_eq!(fault_in(&wild, 7, false), Some(Fault::TorqueNotFinite));
        }
    }
}
