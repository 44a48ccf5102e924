//! The DRV8301's driver against a simulated one behind the real SPI registers.

use firmware::board::Housekeeping;
use firmware::odrive_v3::gate_driver::{self, GateDriver, GateDriverError, Status};
use firmware::odrive_v3::housekeeping::Slow;
use firmware::odrive_v3::pins;
use firmware::odrive_v3::spi::GateDriverSpi;
use protocol::ResetReason;

use crate::set_up::set_up;
use crate::sim::{Chip, EXTI};

fn started() -> (Chip, GateDriver<GateDriverSpi<Chip>>) {
    let mut chip = set_up();
    gate_driver::restart(&mut chip);
    let driver = GateDriver::new(GateDriverSpi::new(chip.clone()));
    (chip, driver)
}

#[test]
fn both_control_registers_are_set_as_the_board_wants_them() {
    let (chip, mut driver) = started();
    assert_eq!(driver.configure(), Ok(Status::default()));
    let [one, two] = chip.sim().drv.control;
    let threshold = one >> 6 & 31;
    assert!((7..=21).contains(&threshold), "{threshold}");
    assert_eq!(one >> 4 & 3, 1, "latched");
    assert_eq!(one >> 3 & 1, 0, "six inputs");
    assert_eq!(one & 7, 0, "1.7 A, no reset");
    assert_eq!(two >> 2 & 3, 3, "gain 80");
    assert_eq!(
        two & !0b1100,
        0,
        "no calibration, default off-time and OCTW"
    );
    chip.assert_no_violations();
    // Selected only while it is talked to.
    assert_eq!(chip.sim().driven('C', 13), Some(true));
    assert_eq!(driver.check(), Ok(Status::default()));
}

#[test]
fn lost_writes_are_repeated_up_to_five_times() {
    for lost in 0..=4 {
        let (chip, mut driver) = started();
        chip.sim().drv.lost_writes = lost;
        assert!(driver.configure().is_ok(), "{lost}");
    }
    let (chip, mut driver) = started();
    chip.sim().drv.lost_writes = 5;
    // The register reads as the reset left it: nothing but zeros in it, and its address before them.
    assert!(matches!(
        driver.configure(),
        Err(GateDriverError::NotKept {
            register: 2,
            read: 0,
            ..
        })
    ));
    assert_eq!(chip.sim().drv.frames.len(), 5 * 3);
}

#[test]
fn a_stuck_line_does_not_pass_for_a_healthy_driver() {
    for level in [0, 0xFFFF] {
        let (chip, mut driver) = started();
        chip.sim().drv.stuck = Some(level);
        assert_eq!(driver.configure(), Err(GateDriverError::Silent));
        // Later too, when it was healthy at the start.
        let (chip, mut driver) = started();
        assert!(driver.configure().is_ok());
        chip.sim().drv.stuck = Some(level);
        assert_eq!(driver.check(), Err(GateDriverError::Silent));
    }
    // Off, or asked before it is ready, it answers with zeros.
    let mut chip = set_up();
    let mut driver = GateDriver::new(GateDriverSpi::new(chip.clone()));
    assert_eq!(driver.configure(), Err(GateDriverError::Silent));
    gate_driver::restart(&mut chip);
    assert!(driver.configure().is_ok());
    gate_driver::turn_off(&mut chip);
    assert_eq!(driver.check(), Err(GateDriverError::Silent));
}

#[test]
fn a_driver_that_forgot_its_settings_is_found_out() {
    let (chip, mut driver) = started();
    assert!(driver.configure().is_ok());
    // A dip of the supply.
    chip.sim().drv.control = [0; 2];
    assert!(matches!(
        driver.check(),
        Err(GateDriverError::NotKept {
            register: 2,
            read: 0,
            ..
        })
    ));
    assert!(driver.configure().is_ok());
    for bit in 0..11 {
        for register in 0..2 {
            let (chip, mut driver) = started();
            assert!(driver.configure().is_ok());
            chip.sim().drv.control[register] ^= 1 << bit;
            let error = driver.check().unwrap_err();
            assert!(
                matches!(error, GateDriverError::NotKept { .. }),
                "{error:?}"
            );
        }
    }
}

#[test]
fn registers_that_do_not_keep_their_value_are_an_error() {
    for bit in [4, 7, 10] {
        let (chip, mut driver) = started();
        chip.sim().drv.dead_bits = 1 << bit;
        let error = driver.configure().unwrap_err();
        let GateDriverError::NotKept {
            register,
            wrote,
            read,
        } = error
        else {
            panic!("{error:?}");
        };
        assert_eq!((register, wrote & !(1 << bit)), (2, read));
    }
}

#[test]
fn frame_faults_and_answers_to_another_question_are_errors() {
    let (chip, mut driver) = started();
    chip.sim().drv.frame_faults = true;
    assert!(matches!(
        driver.configure(),
        Err(GateDriverError::Frame { .. })
    ));
    let (chip, mut driver) = started();
    chip.sim().drv.wrong_address = true;
    assert!(matches!(
        driver.configure(),
        Err(GateDriverError::Frame { .. })
    ));
    let (chip, mut driver) = started();
    chip.sim().spi_dead = true;
    assert_eq!(driver.configure(), Err(GateDriverError::Bus));
    assert_eq!(
        chip.sim().driven('C', 13),
        Some(true),
        "let go all the same"
    );
}

#[test]
fn every_fault_bit_is_a_fault_and_warmth_is_a_warning() {
    for bit in [0, 1, 2, 3, 4, 5, 7, 8, 9, 10] {
        let (chip, mut driver) = started();
        assert!(driver.configure().is_ok());
        chip.sim().drv.status[0] = 1 << bit;
        let status = Status {
            one: 1 << bit,
            two: 0,
        };
        assert_eq!(driver.check(), Err(GateDriverError::Fault(status)));
        assert!(pins::is_fault_signalled(&mut chip.clone()));
    }
    let (chip, mut driver) = started();
    chip.sim().drv.status = [1 << 6, 1];
    let status = driver.configure().unwrap();
    assert!(status.is_warm() && !status.is_fault());
    chip.sim().drv.status = [0, 1 << 7 | 1];
    assert!(matches!(driver.check(), Err(GateDriverError::Fault(status)) if status.two == 0x81));
}

#[test]
fn on_a_fault_status_1_is_what_is_read_first() {
    let (chip, mut driver) = started();
    assert!(driver.configure().is_ok());
    chip.sim().drv.frames.clear();
    chip.sim().drv.status[0] = 0x420;
    assert!(driver.check().is_err());
    assert_eq!(chip.sim().drv.frames[0], 0x8000);
}

#[test]
fn en_gate_is_low_for_longer_than_20_us_and_the_driver_gets_its_10_ms() {
    let (mut chip, mut driver) = started();
    assert!(driver.configure().is_ok());
    let before = chip.sim().now;
    gate_driver::restart(&mut chip);
    let sim = chip.sim();
    assert!(sim.now - sim.drv.on_since.unwrap() >= 168 * 20_000);
    assert!(sim.drv.on_since.unwrap() - before > 168 * 20);
    drop(sim);
    // It was reset, so it is to be set again.
    assert!(driver.check().is_err());
    assert!(driver.configure().is_ok());
    chip.assert_no_violations();
}

#[test]
fn slow_work_starts_the_driver_and_tells_what_is_wrong_in_two_words() {
    let mut chip = set_up();
    let mut slow = Slow::new(chip.clone(), ResetReason::PowerOn);
    assert_eq!(slow.gate_driver(), Err([0xFFFF; 2]), "off");
    assert_eq!(slow.restart_gate_driver(), Ok(()));
    assert_eq!(slow.gate_driver(), Ok(()));
    assert_eq!(chip.word(EXTI) & 4, 4, "nFAULT is listened to");
    chip.sim().drv.status = [0x410, 1];
    assert_eq!(slow.gate_driver(), Err([0x410, 1]));
    // As long as it is there, a new start does not help, and its line is not listened to.
    assert_eq!(slow.restart_gate_driver(), Err([0x410, 1]));
    assert_eq!(chip.word(EXTI) & 4, 0);
    chip.sim().drv.status = [0, 1];
    assert_eq!(slow.restart_gate_driver(), Ok(()));
    chip.sim().drv.control[1] = 0;
    assert_eq!(slow.gate_driver(), Err([0x8000 | 3 << 11, 0xC]));
    // The other axis's driver pulls the shared line down.
    chip.sim().drv.other_fault = true;
    assert_eq!(slow.restart_gate_driver(), Err([0, 1]));
    assert_eq!(slow.reset_reason(), ResetReason::PowerOn);
    let fed = chip.sim().fed.len();
    slow.feed_watchdog();
    assert_eq!(chip.sim().fed.len(), fed + 1);
    chip.sim().analog[15] = 1024;
    assert!((20.0..30.0).contains(&slow.temperature_c()));
    chip.sim().analog[15] = 0;
    assert!(slow.temperature_c().is_nan());
    chip.sim().adc_dead = true;
    assert!(slow.temperature_c().is_nan());
    pins::ignore_fault(&mut chip);
    chip.assert_no_violations();
}
