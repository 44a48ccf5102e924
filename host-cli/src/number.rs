//! Numbers given as flags: read, checked, and refused with what would be accepted.

/// A finite number.
pub fn finite(text: &str) -> Result<f64, String> {
    let number: f64 = text.trim().parse().map_err(|_| {
        format!(
            "`{text}` is not a number; accepted: a plain number without a unit, such as 0.5 or 1e-3"
        )
    })?;
    if number.is_finite() {
        Ok(number)
    } else {
        Err(format!("{text} is not finite; accepted: a finite number"))
    }
}

/// A finite number above zero.
pub fn positive(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    if number > 0.0 {
        Ok(number)
    } else {
        Err(format!(
            "{text} is not above 0; accepted: a finite number above 0"
        ))
    }
}

/// A finite number, zero or more.
pub fn not_negative(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    if number >= 0.0 {
        Ok(number)
    } else {
        Err(format!(
            "{text} is negative; accepted: a finite number, 0 or more"
        ))
    }
}

/// A whole number from 1.
pub fn count(text: &str) -> Result<u64, String> {
    match text.trim().parse::<u64>() {
        Ok(number) if number >= 1 => Ok(number),
        _ => Err(format!(
            "`{text}` is not a whole number from 1; accepted: 1 or more"
        )),
    }
}
