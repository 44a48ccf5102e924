//! Encoder, serial line, supply: what comes in and goes out beside the bridge.

use firmware::odrive_v3::supply::{Variant, fet_temperature_c, variant};
use firmware::odrive_v3::{current_sense, encoder, serial};
use firmware::power::ODRIVE_V3_24V;

use crate::set_up::set_up;
use crate::sim::{Chip, TIM3, UART4};

#[test]
fn the_encoder_counts_both_edges_through_a_filter_of_143_ns() {
    let mut chip = set_up();
    assert_eq!(chip.word(TIM3 + 0x08) & 7, 3, "both edges of both inputs");
    let ccmr = chip.word(TIM3 + 0x18);
    assert_eq!((ccmr & 3, ccmr >> 8 & 3), (1, 1), "TI1, TI2");
    assert_eq!((ccmr >> 2 & 3, ccmr >> 10 & 3), (0, 0), "every edge");
    assert_eq!((ccmr >> 4 & 0xF, ccmr >> 12 & 0xF), (4, 4));
    // ICxF 4: f_DTS / 2, six samples; CKD leaves f_DTS at the timer's 84 MHz.
    assert_eq!(chip.word(TIM3) >> 8 & 3, 0);
    assert!((6.0 * 2.0 / 84e6 - 143e-9_f64).abs() < 1e-9);
    assert_eq!(chip.word(TIM3 + 0x20), 0, "not inverted");
    assert_eq!(chip.word(TIM3 + 0x2C), 0xFFFF, "16 bits");
    assert_eq!(chip.word(TIM3) & 0x11, 1, "counting");
    assert_eq!(encoder::BITS, 16);
    for count in [0, 1, 0x7FFF, 0xFFFF] {
        chip.poke(TIM3 + 0x24, count);
        assert_eq!(encoder::counter(&mut chip), count);
    }
}

#[test]
fn the_line_has_115200_baud_within_what_a_receiver_bears() {
    let chip = set_up();
    let brr = chip.word(UART4 + 0x08);
    let baud = 42e6 / (f64::from(brr >> 4) + f64::from(brr & 15) / 16.0) / 16.0;
    assert!((baud / 115_200.0 - 1.0).abs() < 2e-3, "{baud}");
    let cr1 = chip.word(UART4 + 0x0C);
    assert_eq!(cr1 >> 15 & 1, 0, "oversampled 16 times");
    assert_eq!((cr1 >> 12 & 1, cr1 >> 10 & 1), (0, 0), "8 bits, no parity");
    assert_eq!(cr1 >> 13 & 1 & cr1 >> 3 & cr1 >> 2, 1, "on, both ways");
    assert_eq!(
        cr1 >> 4 & 0xF,
        0b0010,
        "interrupts by what is received only"
    );
    assert_eq!(chip.word(UART4 + 0x10) >> 12 & 3, 0, "one stop bit");
    assert_eq!(chip.word(UART4 + 0x14), 0);
}

#[test]
fn bytes_go_both_ways_and_a_lost_one_does_not_hang_the_interrupt() {
    let mut chip = set_up();
    serial::send(&mut chip, b"knob");
    assert_eq!(chip.sim().sent, b"knob");
    assert_eq!(serial::receive(&mut chip), None);
    chip.sim().received = vec![1, 2];
    chip.sim().lost_byte = true;
    assert_eq!(serial::receive(&mut chip), Some(1));
    assert!(!chip.sim().lost_byte);
    assert_eq!(serial::receive(&mut chip), Some(2));
    // Lost and nothing there: only reading DR ends the interrupt.
    chip.sim().lost_byte = true;
    assert_eq!(serial::receive(&mut chip), None);
    assert!(!chip.sim().lost_byte);
}

#[test]
fn the_variant_comes_from_otp_and_is_24_v_where_it_is_blank_or_makes_no_sense() {
    let blank = [u32::MAX; 2];
    for (otp, expected) in [
        (blank, Variant::Volts24),
        ([0; 2], Variant::Volts24),
        ([0x03FF_FFFF, 0xFFFF_1806], Variant::Volts24),
        ([0x03FF_FFFF, 0xFFFF_3006], Variant::Volts48),
        ([0x03FF_FFFF, 0xFFFF_3805], Variant::Volts56),
        ([0x04FF_FFFF, 0xFFFF_3805], Variant::Volts24),
        ([0x03FF_FFFF, 0xFFFF_6305], Variant::Volts24),
    ] {
        let mut chip = Chip::new();
        chip.sim().otp = otp;
        assert_eq!(variant(&mut chip), expected, "{otp:x?}");
    }
}

#[test]
fn bus_volts_follow_the_divider_and_trips_the_variant() {
    let mut chip = set_up();
    for (variant, divider, most_v) in [
        (Variant::Volts24, 11.0, 25.68),
        (Variant::Volts48, 19.0, 51.36),
        (Variant::Volts56, 19.0, 59.92),
    ] {
        for bus_v in [0.0, 8.0, 12.0, 24.0, 25.68, 35.0] {
            let code = (bus_v / divider / 3.3 * 4096.0_f64).round();
            chip.sim().analog[6] = code as u16;
            chip.pass(8000);
            let read =
                f64::from(current_sense::bus_code(&mut chip)) * f64::from(variant.bus_step_v());
            assert!((read - bus_v).abs() < 0.01, "{read} {bus_v}");
        }
        let facts = variant.facts();
        assert_eq!(facts.bus_most_v, most_v);
        assert_eq!(facts.bus_least_v, 8.0);
        assert_eq!(facts.pwm_steps, ODRIVE_V3_24V.pwm_steps);
        // The trip lies within what the converter can tell.
        assert!(4095.0 * f64::from(variant.bus_step_v()) > most_v + 1.0);
    }
}

#[test]
fn fet_temperature_follows_the_thermistor_within_1_5_degrees() {
    for tenths in 0..=1200 {
        let celsius = f64::from(tenths) / 10.0;
        let ohm = 10e3 * (3434.0 * (1.0 / (celsius + 273.15) - 1.0 / 298.15)).exp();
        let code = (3.3e3 / (3.3e3 + ohm) * 4096.0).round() as u16;
        let read = f64::from(fet_temperature_c(code).unwrap());
        assert!((read - celsius).abs() < 1.5, "{celsius} {read}");
    }
    // Open or shorted it must not pass for cold.
    for code in [0, 1, 50, 3950, 4095, u16::MAX] {
        assert_eq!(fet_temperature_c(code), None, "{code}");
    }
}
