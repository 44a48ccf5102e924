//! The board as a [`PowerStage`]: what the current tick reads and writes.

use core::sync::atomic::{AtomicBool, Ordering::SeqCst};

use super::supply::Variant;
use super::{Registers, bridge, current_sense, dead_man, encoder, stopwatch};
use crate::board::PowerStage;
use crate::power::{Bridge, Sensed, StageFacts};

/// One and a half PWM periods, ticks of the stopwatch.
const LATE: u32 = 3 * bridge::PERIOD as u32 / 2;

/// TIM1, the ADCs and TIM3.
pub struct Stage<R> {
    registers: R,
    variant: Variant,
    /// Set by nFAULT's interrupt, after it has turned the outputs off.
    fault: &'static AtomicBool,
    armed: bool,
    late: bool,
    last: Option<u32>,
}

impl<R: Registers> Stage<R> {
    /// The board was set up; the bridge is off.
    pub const fn new(registers: R, variant: Variant, fault: &'static AtomicBool) -> Self {
        Self {
            registers,
            variant,
            fault,
            armed: false,
            late: false,
            last: None,
        }
    }
}

impl<R: Registers> PowerStage for Stage<R> {
    const COUNTER_BITS: u32 = encoder::BITS;

    fn facts(&self) -> StageFacts {
        self.variant.facts()
    }

    /// Also true if the last tick decided too late for the period that it was to decide for.
    #[inline]
    fn acknowledge(&mut self) -> bool {
        dead_man::check_in(&mut self.registers);
        current_sense::acknowledge(&mut self.registers);
        bridge::forget_update(&mut self.registers);
        let now = stopwatch(&mut self.registers);
        let skipped = self.last.is_some_and(|last| now.wrapping_sub(last) > LATE);
        self.last = Some(now);
        skipped || core::mem::take(&mut self.late)
    }

    #[inline]
    fn sensed(&mut self) -> Sensed {
        let registers = &mut self.registers;
        Sensed {
            currents: current_sense::current_codes(registers),
            bus_v: f32::from(current_sense::bus_code(registers)) * self.variant.bus_step_v(),
            counter: encoder::counter(registers),
        }
    }

    /// Arming: duties first, then AOE, so that MOE rises with them at the next update. nFAULT's interrupt either
    /// comes before the flag is looked at, or after AOE was set, and then clears it itself. Once it has come nothing arms
    /// before [`Bridge::Off`] was applied.
    #[inline]
    fn apply(&mut self, bridge: Bridge) {
        let registers = &mut self.registers;
        match bridge {
            Bridge::Off => {
                bridge::off(registers);
                self.armed = false;
            }
            Bridge::On(duties) => {
                bridge::set_duties(registers, duties.in_steps(bridge::PERIOD));
                if !self.armed {
                    self.armed = true;
                    bridge::arm(registers);
                    if self.fault.load(SeqCst) {
                        bridge::off(registers);
                    }
                }
            }
        }
        self.late |= bridge::has_updated(registers);
    }

    #[inline]
    fn gate_fault(&mut self) -> bool {
        self.fault.swap(false, SeqCst)
    }
}
