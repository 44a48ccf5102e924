//! What a number in a scene file may be.

use anyhow::{Result, anyhow};

use crate::number::digits;

/// The smallest and the largest quantity of a device or a spring: the controller computes
/// in f32, which must hold them and their ratios.
pub const LEAST: f64 = 1e-15;
pub const MOST: f64 = 1e15;

/// A number as a user would write it.
pub fn plain(value: f64) -> String {
    if value == 0.0 || !value.is_finite() || (1e-6..1e16).contains(&value.abs()) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// A bound as a user would read it.
pub fn bound(value: f64) -> String {
    if (1e-6..1e16).contains(&value.abs()) {
        digits(value, 6)
    } else {
        format!("{value:e}")
    }
}

pub fn refuse(key: &str, value: f64, accepted: &str) -> anyhow::Error {
    anyhow!("{key} is {}; accepted: {accepted}", plain(value))
}

pub fn finite(key: &str, value: f64) -> Result<f64> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(refuse(key, value, "a finite number"))
    }
}

pub fn signed(key: &str, value: f64) -> Result<f64> {
    if value.abs() <= MOST {
        Ok(value)
    } else {
        let accepted = format!("a finite number within ±{MOST:e}");
        Err(refuse(key, value, &accepted))
    }
}

pub fn positive(key: &str, value: f64) -> Result<f64> {
    if (LEAST..=MOST).contains(&value) {
        Ok(value)
    } else {
        let accepted = format!("a finite number above 0, from {LEAST:e} to {MOST:e}");
        Err(refuse(key, value, &accepted))
    }
}

pub fn not_negative(key: &str, value: f64) -> Result<f64> {
    if (0.0..=MOST).contains(&value) {
        Ok(value)
    } else {
        let accepted = format!("a finite number, 0 or more, up to {MOST:e}");
        Err(refuse(key, value, &accepted))
    }
}

/// A share of ticks that can be missed without two in a row.
pub fn share(key: &str, value: f64) -> Result<f64> {
    if (0.0..=0.5).contains(&value) {
        Ok(value)
    } else {
        Err(refuse(
            key,
            value,
            "0 to 0.5, as no two ticks in a row are missed",
        ))
    }
}
