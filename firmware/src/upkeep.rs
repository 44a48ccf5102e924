//! What a power stage needs 10 to 100 times a second, below the current tick: temperature, gate driver, watchdog.
//!
//! The watchdog is fed only where all three have checked in since it was fed last: a haptic tick ran, the desk
//! served the serial line, and this ran. So it bites where any of them hangs, and where the current tick, which
//! pends the other two, does not come.

use core::sync::atomic::Ordering::Relaxed;

use protocol::Fault;

use crate::Link;
use crate::board::Housekeeping;
use crate::ticker::StateCode;

/// PWM periods from one run to the next: 20 ms at 24 kHz. Without current ticks there is none.
pub const PERIODS: u32 = 480;

/// Above this temperature of the switches torque goes to zero, °C. What the maker's firmware takes for the end of
/// full current.
pub const HOTTEST_C: f32 = 100.0;

/// Below this the sensor is disconnected, °C: an open one reads −28.
pub const COLDEST_C: f32 = -20.0;

/// What the slow task found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
enum Found {
    Nothing = 0,
    GateDriver = 1,
    Temperature = 2,
}

/// The slow task's memory.
pub struct Upkeep<'a> {
    link: &'a Link,
    /// Of faults, ticks and the desk's runs, as seen when the watchdog was fed last.
    faults: u32,
    ticks: u32,
    desk_runs: u32,
}

impl<'a> Upkeep<'a> {
    /// Nothing was done yet.
    #[must_use]
    pub fn new(link: &'a Link) -> Self {
        Self {
            link,
            faults: 0,
            ticks: 0,
            desk_runs: 0,
        }
    }

    /// Once in each slow period.
    pub fn run(&mut self, board: &mut impl Housekeeping) {
        let link = self.link;
        let temperature_c = board.temperature_c();
        link.temperature.store(temperature_c.to_bits(), Relaxed);
        // After a fault, the gate driver's words are those of that fault.
        let faults = link.faults.load(Relaxed);
        if faults != self.faults {
            self.faults = faults;
            link.gate_driver.store(0, Relaxed);
        }
        let asked = link.restarts_asked.load(Relaxed);
        let is_off = link.status().state == StateCode::Fault;
        let gate_driver = if asked != link.restarts_done.load(Relaxed) && is_off {
            board.restart_gate_driver()
        } else {
            board.gate_driver()
        };
        if let Err([first, second]) = gate_driver {
            let words = u32::from(first) | u32::from(second) << 16;
            link.gate_driver.store(words, Relaxed);
        }
        let found = if gate_driver.is_err() {
            Found::GateDriver
        } else if (COLDEST_C..=HOTTEST_C).contains(&temperature_c) {
            Found::Nothing
        } else {
            Found::Temperature
        };
        link.slow_found.store(found as u32, Relaxed);
        link.restarts_done.store(asked, Relaxed);
        link.slow_runs
            .store(link.slow_runs.load(Relaxed).wrapping_add(1), Relaxed);
        self.feed(board);
    }

    /// Feeds the watchdog where tick and desk have checked in too.
    fn feed(&mut self, board: &mut impl Housekeeping) {
        let (ticks, desk_runs) = (
            self.link.tick.load(Relaxed),
            self.link.desk_runs.load(Relaxed),
        );
        if ticks != self.ticks && desk_runs != self.desk_runs {
            (self.ticks, self.desk_runs) = (ticks, desk_runs);
            board.feed_watchdog();
        }
    }
}

impl Link {
    /// What the slow task says is wrong.
    #[inline]
    pub(crate) fn slow_fault(&self) -> Option<Fault> {
        match self.slow_found.load(Relaxed) {
            0 => None,
            1 => Some(Fault::GateDriver),
            _ => Some(Fault::OverTemperature {
                temperature_c: f32::from_bits(self.temperature.load(Relaxed)),
            }),
        }
    }
}
