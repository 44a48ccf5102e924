//! What a device says, in words.

use protocol::{ClampReason, Fault, Name, Parameters, Refusal, ResetReason, State, Stored};

use crate::parameters::{short, value};

/// A state in a word, as scripts see it.
pub fn state(state: State) -> &'static str {
    match state {
        State::Disarmed => "disarmed",
        State::Armed => "armed",
        State::Fault(_) => "fault",
        State::Calibrating => "calibrating",
        State::Pushing => "pushing",
    }
}

/// A state in words, with what to do about it.
pub fn state_in_full(given: State) -> String {
    match given {
        State::Fault(cause) => format!("in fault: {}; `knob clear` leaves it", fault(cause)),
        other => state(other).into(),
    }
}

/// A fault in a word, as scripts see it.
pub fn fault_code(fault: Fault) -> &'static str {
    match fault {
        Fault::Overrun => "overrun",
        Fault::EncoderJump { .. } => "encoder-jump",
        Fault::TorqueNotFinite => "torque-not-finite",
        Fault::CurrentOverrun => "current-overrun",
        Fault::GateDriver => "gate-driver",
        Fault::OverCurrent { .. } => "over-current",
        Fault::CurrentSense => "current-sense",
        Fault::OverVoltage { .. } => "over-voltage",
        Fault::UnderVoltage { .. } => "under-voltage",
        Fault::OverTemperature { .. } => "over-temperature",
        Fault::OverSpeed { .. } => "over-speed",
        Fault::Encoder => "encoder",
        Fault::Guard => "guard",
    }
}

/// A fault in words.
pub fn fault(fault: Fault) -> String {
    match fault {
        Fault::Overrun => "a tick was not done before the next was due".into(),
        Fault::EncoderJump { counts } => format!(
            "the encoder moved {counts} counts in one period, more than speed_max_rad_s allows"
        ),
        Fault::TorqueNotFinite => "the torque was not a finite number".into(),
        Fault::CurrentOverrun => "a current tick was not done before the next was due".into(),
        Fault::GateDriver => {
            "the gate driver reported a fault, or lost what was written to it".into()
        }
        Fault::OverCurrent { current_a } => format!(
            "a current of {} A is beyond what is safe, or its converter stands at an end",
            short(current_a)
        ),
        Fault::CurrentSense => {
            "the current converters cannot be believed: currents that do not add up, \
             or some without a bridge that is on (`knob calibrate` measures them anew)"
                .into()
        }
        Fault::OverVoltage { bus_v } if bus_v.is_nan() => "the bus voltage is not a number".into(),
        Fault::OverVoltage { bus_v } => format!("the bus rose to {} V", short(bus_v)),
        Fault::UnderVoltage { bus_v } => format!("the bus fell to {} V", short(bus_v)),
        Fault::OverTemperature { temperature_c } if temperature_c.is_nan() => {
            "the temperature of the switches is not known any more".into()
        }
        Fault::OverTemperature { temperature_c } => format!(
            "the switches are at {} °C, or their sensor came off",
            short(temperature_c)
        ),
        Fault::OverSpeed { speed_rad_s } => format!(
            "the knob turned at {} rad/s, faster than it may",
            short(speed_rad_s)
        ),
        Fault::Encoder => {
            "the count does not follow the motor: the encoder, its wires, or the motor's values"
                .into()
        }
        Fault::Guard => "a push or a calibration went further than it may".into(),
    }
}

/// Why the stiffness is clamped, in a word, as scripts see it.
pub fn clamp_code(reason: ClampReason) -> &'static str {
    match reason {
        ClampReason::None => "none",
        ClampReason::Viscous => "viscous",
        ClampReason::Coulomb => "coulomb",
        ClampReason::Speed => "speed",
        ClampReason::ZeroForce => "zero-force",
        ClampReason::Torque => "torque",
        ClampReason::Inertia => "inertia",
        ClampReason::Coarse => "coarse",
        ClampReason::Account => "account",
        ClampReason::Hand => "hand",
    }
}

/// Why the stiffness is clamped, in words.
pub fn clamp(reason: ClampReason) -> &'static str {
    match reason {
        ClampReason::None => "the whole demand is applied",
        ClampReason::Viscous => "sampled too slowly for this viscous friction: 2b/Te",
        ClampReason::Coulomb => "encoder too coarse for this Coulomb friction: 2c/Δ",
        ClampReason::Speed => "too fast in this contact: 2(b|ẋ| + c)/(Te|ẋ| + Δ)",
        ClampReason::ZeroForce => "may rise only at zero force, and waits for it",
        ClampReason::Torque => "the torque limit",
        ClampReason::Inertia => "sampled too slowly for this inertia: m/Te²",
        ClampReason::Coarse => "encoder too coarse: 3c/Δ",
        ClampReason::Account => "the energy account covers no more",
        ClampReason::Hand => "a hand moves the knob as no believed force can: more is allowed for",
    }
}

/// Why a request was not done. `wanted`: the parameters as they would have been.
pub fn refusal(refusal: &Refusal, board: &str, wanted: Option<&Parameters>) -> String {
    match *refusal {
        Refusal::Version { accepted } => {
            format!("the device speaks version {accepted} of the protocol")
        }
        Refusal::Value {
            name,
            given,
            lowest,
            highest,
        } => out_of_range(name.as_str(), given, lowest, highest),
        Refusal::Reversed { name, low, high } => format!(
            "{}: {}..{} has its lower end above its upper end; accepted: LOW..HIGH with LOW ≤ HIGH",
            name.as_str(),
            short(low),
            short(high)
        ),
        Refusal::Together {
            name,
            lowest,
            highest,
        } => {
            let given = wanted.map_or_else(String::new, |all| format!("={}", value(all, name)));
            format!(
                "{}{given}: does not go together with {}; accepted beside that: {} to {}",
                name.as_str(),
                others(name),
                short(lowest),
                short(highest)
            )
        }
        Refusal::Armed { name } => format!(
            "{}: may only be changed while disarmed; `knob disarm` first",
            name.as_str()
        ),
        Refusal::State(state) => format!("the device is {}", state_in_full(state)),
        Refusal::NoStorage => {
            format!("this board ({board}) keeps no settings; set them anew after each start")
        }
        Refusal::NoPowerStage => format!("this board ({board}) drives no motor itself"),
        Refusal::NoZero => {
            "where the encoder's zero is, is not known since the device started, as an \
             encoder counts from wherever it stands then; `knob calibrate` finds it"
                .into()
        }
        Refusal::NoMotor => {
            "the motor is not known yet; `knob calibrate` first, or `knob set` its values".into()
        }
        Refusal::MotorValue {
            name,
            given,
            lowest,
            highest,
        } => out_of_range(name.as_str(), given, lowest, highest),
        Refusal::Push => "this push is out of range, or this device cannot push".into(),
        Refusal::Excitation => {
            "this excitation is out of range, or this device cannot measure".into()
        }
        Refusal::NotKept => "the device's flash could not be erased or written; \
             what was saved before is kept"
            .into(),
    }
}

/// What is stored, in a word, as scripts see it.
pub fn stored_code(stored: Stored) -> &'static str {
    match stored {
        Stored::NoStorage => "no-storage",
        Stored::Nothing => "nothing",
        Stored::Last => "last",
        Stored::Older => "older",
        Stored::Version { .. } => "version",
        Stored::Damaged => "damaged",
        Stored::Refused { .. } | Stored::RefusedMotor { .. } => "refused",
    }
}

/// What is stored, in words, and what the device began with for it.
pub fn stored(stored: Stored) -> String {
    match stored {
        Stored::NoStorage => "not kept by this board; it began with defaults".into(),
        Stored::Nothing => "none were saved; it began with defaults".into(),
        Stored::Last => "saved".into(),
        Stored::Older => "the last save was cut short or is damaged; \
             it began with the set saved before that"
            .into(),
        Stored::Version { found } => format!(
            "saved by a firmware with other settings (version {found}); \
             it began with defaults, and `knob save` replaces what was saved"
        ),
        Stored::Damaged => "what was saved is damaged; \
             it began with defaults, and `knob save` replaces it"
            .into(),
        Stored::Refused { name } => not_accepted(name.as_str()),
        Stored::RefusedMotor { name } => not_accepted(name.as_str()),
    }
}

fn out_of_range(name: &str, given: f32, lowest: f32, highest: f32) -> String {
    format!(
        "{name}: {} is out of range; accepted: {} to {}",
        short(given),
        short(lowest),
        short(highest)
    )
}

fn not_accepted(name: &str) -> String {
    format!(
        "what was saved is not accepted by this firmware ({name}); \
         it began with defaults, and `knob save` replaces it"
    )
}

/// Why a device started, in a word, as scripts see it.
pub fn reset_code(reason: ResetReason) -> &'static str {
    match reason {
        ResetReason::Unknown => "unknown",
        ResetReason::PowerOn => "power-on",
        ResetReason::BrownOut => "brown-out",
        ResetReason::Pin => "pin",
        ResetReason::Software => "software",
        ResetReason::Watchdog => "watchdog",
    }
}

/// Why a device started, in words.
pub fn reset(reason: ResetReason) -> &'static str {
    match reason {
        ResetReason::Unknown => "not told by this board",
        ResetReason::PowerOn => "power came on",
        ResetReason::BrownOut => "the supply sagged",
        ResetReason::Pin => "the reset pin",
        ResetReason::Software => "the program asked for it",
        ResetReason::Watchdog => "the watchdog was not fed",
    }
}

/// What a parameter must go together with.
fn others(name: Name) -> &'static str {
    match name {
        Name::DelayS => "law, sample_period_s and jitter_s",
        Name::JitterS => "sample_period_s",
        Name::CentreRad | Name::WallRad | Name::PeriodRad => "counts_per_rev and decimation",
        _ => "the other parameters",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_refusal_names_what_is_wrong_and_what_would_be_accepted() {
        let name = Name::CentreRad;
        for (given, parts) in [
            (Refusal::Version { accepted: 9 }, &["version 9"][..]),
            (
                Refusal::Value {
                    name,
                    given: f32::NAN,
                    lowest: -1e-7,
                    highest: 1e9,
                },
                &["centre_rad: NaN", "-1e-7 to 1e9"],
            ),
            (
                Refusal::Reversed {
                    name: Name::CoulombNm,
                    low: 2.0,
                    high: 0.5,
                },
                &["coulomb_nm: 2..0.5", "LOW ≤ HIGH"],
            ),
            (
                Refusal::Together {
                    name,
                    lowest: -5.5,
                    highest: 5.5,
                },
                &["centre_rad", "counts_per_rev", "-5.5 to 5.5"],
            ),
            (
                Refusal::Together {
                    name: Name::DelayS,
                    lowest: 0.0,
                    highest: 1e-3,
                },
                &["delay_s", "law, sample_period_s", "0 to 0.001"],
            ),
            (Refusal::Armed { name }, &["centre_rad", "knob disarm"]),
            (
                Refusal::State(State::Fault(Fault::Overrun)),
                &["a tick was not done", "knob clear"],
            ),
            (Refusal::NoStorage, &["some board", "keeps no settings"]),
            (Refusal::NotKept, &["flash", "saved before is kept"]),
        ] {
            let said = refusal(&given, "some board", None);
            for part in parts {
                assert!(said.contains(part), "`{part}` is missing in: {said}");
            }
        }
    }

    #[test]
    fn every_fault_says_what_was_wrong() {
        for (given, code, parts) in [
            (Fault::Overrun, "overrun", &["tick"][..]),
            (
                Fault::EncoderJump { counts: -70 },
                "encoder-jump",
                &["-70 counts", "speed_max_rad_s"],
            ),
            (
                Fault::TorqueNotFinite,
                "torque-not-finite",
                &["torque", "finite"],
            ),
            (Fault::CurrentOverrun, "current-overrun", &["current tick"]),
            (Fault::GateDriver, "gate-driver", &["gate driver"]),
            (
                Fault::OverCurrent { current_a: 31.5 },
                "over-current",
                &["31.5 A", "converter"],
            ),
            (
                Fault::CurrentSense,
                "current-sense",
                &["converters", "knob calibrate"],
            ),
            (
                Fault::OverVoltage { bus_v: 26.0 },
                "over-voltage",
                &["26 V"],
            ),
            (
                Fault::OverVoltage { bus_v: f32::NAN },
                "over-voltage",
                &["not a number"],
            ),
            (
                Fault::UnderVoltage { bus_v: 7.5 },
                "under-voltage",
                &["7.5 V"],
            ),
            (
                Fault::OverTemperature {
                    temperature_c: 104.0,
                },
                "over-temperature",
                &["104 °C"],
            ),
            (
                Fault::OverTemperature {
                    temperature_c: f32::NAN,
                },
                "over-temperature",
                &["not known"],
            ),
            (
                Fault::OverSpeed { speed_rad_s: 320.0 },
                "over-speed",
                &["320 rad/s"],
            ),
            (Fault::Encoder, "encoder", &["count", "motor"]),
            (Fault::Guard, "guard", &["push", "calibration"]),
        ] {
            assert_eq!(fault_code(given), code);
            let said = state_in_full(State::Fault(given));
            for part in parts.iter().chain(&["knob clear"]) {
                assert!(said.contains(part), "`{part}` is missing in: {said}");
            }
        }
    }

    #[test]
    fn what_is_stored_is_told_with_what_the_device_began_with() {
        let name = Name::CentreRad;
        for (given, code, parts) in [
            (Stored::NoStorage, "no-storage", &["defaults"][..]),
            (Stored::Nothing, "nothing", &["none", "defaults"]),
            (Stored::Last, "last", &["saved"]),
            (Stored::Older, "older", &["cut short", "before"]),
            (
                Stored::Version { found: 7 },
                "version",
                &["version 7", "defaults", "knob save"],
            ),
            (
                Stored::Damaged,
                "damaged",
                &["damaged", "defaults", "knob save"],
            ),
            (
                Stored::Refused { name },
                "refused",
                &["centre_rad", "defaults", "knob save"],
            ),
        ] {
            assert_eq!(stored_code(given), code);
            let said = stored(given);
            for part in parts {
                assert!(said.contains(part), "`{part}` is missing in: {said}");
            }
        }
    }
}
