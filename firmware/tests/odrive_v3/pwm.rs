//! The bridge's timer, what it triggers, and how it is armed.

use std::sync::atomic::{AtomicBool, Ordering::SeqCst};

use control::torque::InverterConfig;
use control::torque::frames::Stationary;
use control::torque::modulation::{Bus, Modulator};
use firmware::board::PowerStage;
use firmware::odrive_v3::stage::Stage;
use firmware::odrive_v3::supply::Variant;
use firmware::odrive_v3::{Registers, bridge, current_sense, dead_man};
use firmware::power::{Bridge, ODRIVE_V3_24V, Sensed};

use crate::set_up::set_up;
use crate::sim::{ADC, Chip, TIM1, TIM3};

const PERIOD: u64 = 7000;
const BDTR: u32 = TIM1 + 0x44;

/// Whether channel 1 to 3's high side is meant to be on at a count, from mode and CCR as they are in the registers.
fn reference(chip: &Chip, channel: u32, at: u64) -> bool {
    let ccmr = chip.word(TIM1 + 0x18 + 4 * (channel / 2)) >> (8 * (channel % 2));
    assert_eq!(ccmr & 3, 0, "an output");
    assert_eq!(ccmr >> 3 & 1, 1, "preload");
    let ccr = u64::from(chip.sim().active[channel as usize]);
    let top = u64::from(chip.word(TIM1 + 0x2C));
    let count = if at < top { at } else { 2 * top - at };
    // Up: CNT < CCR. Down: not while CNT > CCR.
    let mode_1 = if at < top {
        count < ccr
    } else {
        count <= ccr && ccr > 0
    };
    match ccmr >> 4 & 7 {
        6 => mode_1,
        7 => !mode_1,
        mode => panic!("mode {mode}"),
    }
}

/// The flag of nFAULT's interrupt, and a stage that looks at it.
fn stage<R: Registers>(registers: R) -> (&'static AtomicBool, Stage<R>) {
    let fault: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(false)));
    (fault, Stage::new(registers, Variant::Volts24, fault))
}

/// Waits for the next update, which is the start of a period.
fn next_period(chip: &Chip) {
    let seen = chip.sim().updates.len();
    for _ in 0..3 * PERIOD {
        chip.pass(1);
        if chip.sim().updates.len() > seen {
            return;
        }
    }
    panic!("no update in three periods");
}

/// Duties that three phases really get.
fn duties(volts: f32) -> Bridge {
    let stage = ODRIVE_V3_24V;
    let modulator = Modulator::new(&InverterConfig {
        pwm_period_s: stage.pwm_period_s,
        pwm_steps: stage.pwm_steps,
        dead_time_s: stage.dead_time_s,
        dead_time_edge_a: stage.dead_time_edge_a,
        duty_max: stage.duty_max,
        bus_least_v: stage.bus_least_v,
        bus_most_v: stage.bus_most_v,
        current_step_a: stage.current_step_a,
    })
    .unwrap();
    let volts = Stationary {
        alpha: volts,
        beta: 0.7 * volts,
    };
    let none = Stationary {
        alpha: 0.0,
        beta: 0.0,
    };
    let bus: Bus = modulator.bus(24.0);
    Bridge::On(modulator.three_phase(volts, none, bus))
}

#[test]
fn pwm_is_24_khz_with_119_ns_of_dead_time() {
    let chip = set_up();
    let top = chip.word(TIM1 + 0x2C);
    let cr1 = chip.word(TIM1);
    assert_ne!(cr1 >> 5 & 3, 0, "centre-aligned");
    assert_eq!(chip.word(TIM1 + 0x28), 0, "not divided");
    assert_eq!(168e6 / f64::from(2 * top), 24e3);
    assert_eq!(top, u32::from(ODRIVE_V3_24V.pwm_steps));
    assert_eq!(f64::from(2 * top) / 168e6, ODRIVE_V3_24V.pwm_period_s);
    // Up to 127 DTG is in ticks of t_DTS, which CKD leaves undivided.
    let dtg = chip.word(BDTR) & 0xFF;
    assert_eq!(cr1 >> 8 & 3, 0);
    assert!(dtg < 128);
    let dead_s = f64::from(dtg) / 168e6;
    assert!((dead_s - 119e-9).abs() < 1e-9, "{dead_s}");
    let all = dead_s + 104e-9;
    assert!((all - ODRIVE_V3_24V.dead_time_s).abs() < 1e-9, "{all}");
    // Off: held low, not let go, while MOE is clear and the channels are on.
    assert_eq!(chip.word(BDTR) >> 10 & 3, 0b11, "OSSI, OSSR");
    assert_eq!(chip.word(TIM1 + 0x20), 0x555, "six outputs, high active");
    assert_eq!(chip.word(TIM1 + 0x04) >> 8, 0, "idle low");
}

#[test]
fn one_update_in_a_period_at_the_top_of_the_count() {
    let chip = set_up();
    chip.pass(100 * PERIOD);
    let sim = chip.sim();
    assert!(sim.updates.len() > 100);
    assert!(sim.updates.iter().all(|update| update.overflow));
    let gaps = sim.updates.windows(2).map(|pair| pair[1].at - pair[0].at);
    assert!(gaps.into_iter().all(|gap| gap == PERIOD));
}

#[test]
fn currents_are_sampled_in_the_middle_of_the_low_sides_conduction() {
    let chip = set_up();
    let (_, mut stage) = stage(chip.clone());
    stage.apply(duties(6.0));
    chip.pass(3 * PERIOD);
    let sim = chip.sim();
    let (start, last) = (
        sim.now - sim.position().unwrap(),
        *sim.triggers.last().unwrap(),
    );
    assert!(
        sim.triggers
            .windows(2)
            .all(|pair| pair[1] - pair[0] == PERIOD)
    );
    drop(sim);
    let trigger = (PERIOD + last - start) % PERIOD;
    for channel in 0..3 {
        let low: Vec<u64> = (0..PERIOD)
            .filter(|at| !reference(&chip, channel, *at))
            .collect();
        let (begin, end) = (low[0], low[low.len() - 1] + 1);
        assert_eq!(end - begin, low.len() as u64, "one stretch");
        assert!(low.len() > 1000 && low.len() < 6500, "{}", low.len());
        assert!(
            (begin + end).abs_diff(2 * trigger) <= 2,
            "{begin} {end} {trigger}"
        );
    }
}

#[test]
fn the_largest_duty_leaves_the_amplifiers_their_time() {
    // Half of what is left of the period, less the dead time, against 2.4 µs at a gain of 80.
    let left_s = (1.0 - ODRIVE_V3_24V.duty_max) * ODRIVE_V3_24V.pwm_period_s / 2.0;
    assert!(left_s - ODRIVE_V3_24V.dead_time_s > 2.4e-6);
}

#[test]
fn adcs_run_at_21_mhz_sample_three_cycles_and_one_of_them_interrupts() {
    let chip = set_up();
    let divider = 2.0 * f64::from((chip.word(0x4001_2304) >> 16 & 3) + 1);
    let clock_hz = 84e6 / divider;
    assert_eq!(clock_hz, 21e6);
    let channels = [6, 10, 11];
    for (adc, channel) in ADC.into_iter().zip(channels) {
        assert_eq!(
            chip.word(adc + 0x38),
            channel << 15,
            "JL 0, the channel in JSQ4"
        );
        let (register, place) = if channel < 10 {
            (0x10, 3 * channel)
        } else {
            (0x0C, 3 * (channel - 10))
        };
        assert_eq!(chip.word(adc + register) >> place & 7, 0, "3 cycles");
        let cr2 = chip.word(adc + 0x08);
        assert_eq!((cr2 & 1, cr2 >> 20 & 3, cr2 >> 16 & 0xF), (1, 1, 1));
        assert_eq!(cr2 >> 11 & 1, 0, "right aligned");
        assert_eq!(chip.word(adc + 0x04) >> 24 & 3, 0, "12 bits");
    }
    let interrupts = ADC.map(|adc| chip.word(adc + 0x04) >> 5 & 7);
    assert_eq!(interrupts, [0b100, 0, 0], "JEOCIE of ADC1, nothing else");
}

#[test]
fn every_trigger_brings_all_three_codes_within_a_microsecond() {
    let mut chip = set_up();
    for code in [0, 1, 2047, 2048, 4095] {
        chip.sim().analog[6] = code ^ 1;
        chip.sim().analog[10] = code;
        chip.sim().analog[11] = 4095 - code;
        next_period(&chip);
        // 15 cycles of 21 MHz.
        chip.pass(121);
        assert_ne!(chip.word(ADC[0]) & 4, 0, "JEOC");
        current_sense::acknowledge(&mut chip);
        assert_eq!(chip.word(ADC[0]) & 4, 0);
        assert_eq!(current_sense::current_codes(&mut chip), [code, 4095 - code]);
        assert_eq!(current_sense::bus_code(&mut chip), code ^ 1);
    }
}

#[test]
fn fet_temperature_is_converted_between_the_ticks() {
    let mut chip = set_up();
    chip.sim().analog[15] = 1234;
    assert_eq!(current_sense::fet_temperature_code(&mut chip), Some(1234));
    // 2.5 kΩ and 6 kΩ into 4 pF to half a step of 12 bits, RM0090 / data sheet.
    let cycles = [3, 15, 28, 56, 84, 112, 144, 480][(chip.word(ADC[0] + 0x0C) >> 15 & 7) as usize];
    let least = 8.5e3 * 4e-12 * (2f64.powi(14)).ln() * 21e6 + 0.5;
    assert!(f64::from(cycles) > least, "{cycles} {least}");
    // It fits between two triggers.
    assert!((f64::from(cycles) + 12.0) / 21e6 < 1.0 / 24e3 - 1e-6);
    chip.sim().adc_dead = true;
    assert_eq!(current_sense::fet_temperature_code(&mut chip), None);
    // The triggers go on.
    assert_eq!(chip.word(ADC[0] + 8) >> 20 & 3, 1);
}

#[test]
fn arming_brings_moe_with_the_duties_at_the_next_update_and_off_is_off_at_once() {
    let chip = set_up();
    let (_, mut stage) = stage(chip.clone());
    stage.acknowledge();
    let fired = chip.sim().dead_man_fired;
    for volts in [0.0, 3.0, 8.0] {
        stage.acknowledge();
        chip.forget();
        stage.apply(duties(volts));
        let Bridge::On(asked) = duties(volts) else {
            unreachable!()
        };
        let ccrs = asked.in_steps(3500).map(u32::from);
        let expected = vec![
            (TIM1 + 0x34, ccrs[0]),
            (TIM1 + 0x38, ccrs[1]),
            (TIM1 + 0x3C, ccrs[2]),
            (BDTR, 20 | 0b11 << 10 | 0b11 << 12 | 1 << 14),
        ];
        assert_eq!(chip.writes(), expected, "CCR, then AOE");
        assert!(!chip.sim().moe(), "not before the update");
        chip.pass(PERIOD);
        assert!(chip.sim().moe());
        assert_eq!(chip.sim().active, ccrs);
        // Once armed, only duties.
        chip.forget();
        stage.apply(duties(1.0));
        assert_eq!(chip.writes().len(), 3);
        assert_eq!(chip.sim().active, ccrs, "not before the next period");
        chip.pass(PERIOD);
        assert_ne!(chip.sim().active, ccrs);
        chip.forget();
        stage.apply(Bridge::Off);
        assert!(!chip.sim().moe());
        let writes = chip.writes();
        assert_eq!(writes.len(), 1);
        assert_eq!((writes[0].0, writes[0].1 >> 14 & 3), (BDTR, 0), "AOE, MOE");
        for _ in 0..10 {
            chip.pass(PERIOD);
            stage.acknowledge();
        }
        assert!(!chip.sim().moe(), "and stays off");
        assert_eq!(chip.sim().dead_man_fired, fired);
    }
    chip.assert_no_violations();
}

#[test]
fn the_emergency_is_one_write_that_nothing_undoes_but_a_new_arming() {
    let mut chip = set_up();
    let (fault, mut stage) = stage(chip.clone());
    stage.apply(duties(3.0));
    chip.pass(PERIOD);
    assert!(chip.sim().moe());
    chip.forget();
    bridge::off(&mut chip);
    assert_eq!(chip.sim().log.len(), 1, "no read, one write");
    assert!(!chip.sim().moe());
    // A tick that was interrupted by it goes on, and so do later ones.
    for _ in 0..5 {
        stage.acknowledge();
        stage.apply(duties(3.0));
        chip.pass(PERIOD);
        assert!(!chip.sim().moe());
    }
    // The fault's flag keeps an arming out, wherever the interrupt comes.
    stage.apply(Bridge::Off);
    fault.store(true, SeqCst);
    stage.apply(duties(3.0));
    chip.pass(2 * PERIOD);
    assert!(!chip.sim().moe());
    fault.store(false, SeqCst);
    stage.apply(Bridge::Off);
    stage.apply(duties(3.0));
    bridge::off(&mut chip);
    chip.pass(2 * PERIOD);
    assert!(!chip.sim().moe(), "between AOE and the update");
    stage.acknowledge();
    stage.apply(Bridge::Off);
    stage.apply(duties(3.0));
    chip.pass(PERIOD);
    assert!(chip.sim().moe(), "off and on again is an arming");
}

/// A chip on which nFAULT's interrupt comes before the n-th access of a tick.
struct Interrupted {
    chip: Chip,
    fault: &'static AtomicBool,
    countdown: u32,
}

impl Interrupted {
    fn step(&mut self) {
        if self.countdown == 0 {
            bridge::off(&mut self.chip);
            self.fault.store(true, SeqCst);
        }
        self.countdown = self.countdown.wrapping_sub(1);
    }
}

impl Registers for Interrupted {
    fn read(&mut self, address: u32) -> u32 {
        self.step();
        self.chip.read(address)
    }

    fn write(&mut self, address: u32, value: u32) {
        self.step();
        self.chip.write(address, value);
    }

    fn wait_us(&mut self, time_us: u32) {
        self.chip.wait_us(time_us);
    }
}

#[test]
fn a_fault_at_any_moment_of_an_arming_tick_leaves_the_bridge_off() {
    for countdown in 0..6 {
        let chip = set_up();
        let fault: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(false)));
        let registers = Interrupted {
            chip: chip.clone(),
            fault,
            countdown,
        };
        let mut stage = Stage::new(registers, Variant::Volts24, fault);
        dead_man::check_in(&mut chip.clone());
        stage.apply(duties(3.0));
        chip.pass(2 * PERIOD);
        let came = countdown < 5;
        assert_eq!(chip.sim().moe(), !came, "{countdown}");
        // It is told once.
        assert_eq!(stage.gate_fault(), came);
        assert!(!stage.gate_fault());
    }
}

#[test]
fn a_tick_that_is_skipped_or_decides_too_late_is_told_once() {
    let chip = set_up();
    let (_, mut stage) = stage(chip.clone());
    for run in [100, 3400, 6500, 2000] {
        next_period(&chip);
        assert!(!stage.acknowledge());
        chip.pass(run);
        stage.apply(duties(3.0));
    }
    // Still at work when the next period begins.
    next_period(&chip);
    assert!(!stage.acknowledge());
    chip.pass(7010);
    stage.apply(duties(3.0));
    assert!(stage.acknowledge());
    next_period(&chip);
    assert!(!stage.acknowledge());
    stage.apply(duties(3.0));
    // Kept from running for more than a period.
    for periods in [2, 3, 10] {
        for _ in 0..periods {
            next_period(&chip);
        }
        assert!(stage.acknowledge());
        stage.apply(Bridge::Off);
        next_period(&chip);
        assert!(!stage.acknowledge());
        stage.apply(Bridge::Off);
    }
}

#[test]
fn what_is_sensed_is_this_periods() {
    let chip = set_up();
    let (_, mut stage) = stage(chip.clone());
    for step in 0..20 {
        chip.sim().analog[10] = 2000 + step;
        chip.sim().analog[11] = 2096 - step;
        chip.sim().analog[6] = 2700 + step;
        chip.poke(TIM3 + 0x24, u32::from(step));
        next_period(&chip);
        chip.pass(168);
        stage.acknowledge();
        let expected = Sensed {
            currents: [2000 + step, 2096 - step],
            bus_v: f32::from(2700 + step) * (3.3 / 4096.0 * 11.0),
            counter: u32::from(step),
        };
        let sensed = stage.sensed();
        assert_eq!(
            (sensed.currents, sensed.counter),
            (expected.currents, expected.counter)
        );
        assert!((sensed.bus_v - expected.bus_v).abs() < 1e-4);
    }
    assert_eq!(stage.facts(), ODRIVE_V3_24V);
    assert_eq!(Stage::<Chip>::COUNTER_BITS, 16);
}

#[test]
fn where_current_ticks_do_not_come_the_bridge_is_off_after_four_periods_with_no_programs_help() {
    let mut chip = set_up();
    let (_, mut stage) = stage(chip.clone());
    for hangs_after in [1, 2, 100] {
        next_period(&chip);
        stage.acknowledge();
        stage.apply(Bridge::Off);
        stage.apply(duties(3.0));
        let fired = chip.sim().dead_man_fired;
        for _ in 0..hangs_after {
            next_period(&chip);
            assert!(chip.sim().moe());
            stage.acknowledge();
            stage.apply(duties(3.0));
        }
        assert_eq!(chip.sim().dead_man_fired, fired);
        // No access from here on.
        chip.pass(4 * PERIOD - 30);
        assert!(chip.sim().moe());
        chip.pass(60);
        assert!(!chip.sim().moe());
        assert_eq!(chip.word(BDTR), bridge::OFF);
        chip.pass(1000 * PERIOD);
        assert!(!chip.sim().moe());
        // Nor does a tick that comes after all turn it on again, and it says that others were skipped.
        next_period(&chip);
        assert!(stage.acknowledge());
        stage.apply(duties(3.0));
        chip.pass(2 * PERIOD);
        assert!(!chip.sim().moe());
    }
    bridge::off(&mut chip);
    chip.assert_no_violations();
}
