//! Numbers given as flags: read, checked, and refused with what would be accepted; and
//! numbers written in few letters.

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

/// The largest number, and one over the smallest above zero, whose squares and ratios an f64
/// holds.
const EXTREME: f64 = 1e100;

/// A finite number above zero.
pub fn positive(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    if number <= 0.0 {
        Err(format!(
            "{text} is not above 0; accepted: a finite number above 0"
        ))
    } else if (EXTREME.recip()..=EXTREME).contains(&number) {
        Ok(number)
    } else {
        Err(format!(
            "{text} is too extreme; accepted: from 1e-100 to 1e100"
        ))
    }
}

/// A finite number, zero or more.
pub fn not_negative(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    if number < 0.0 {
        Err(format!(
            "{text} is negative; accepted: a finite number, 0 or more"
        ))
    } else if number <= EXTREME {
        Ok(number)
    } else {
        Err(format!("{text} is too extreme; accepted: up to 1e100"))
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

/// A number with three significant digits: 0.018, 12.3, 4.1e-6.
pub fn short(number: f64) -> String {
    digits(number, 3)
}

/// A number with so many significant digits, without zeros that say nothing.
pub fn digits(number: f64, digits: usize) -> String {
    if number == 0.0 || !number.is_finite() {
        // Without the sign of a zero.
        return (number + 0.0).to_string();
    }
    // Rounded first, since 9.999 may become 10.0.
    let scientific = format!("{number:.*e}", digits - 1);
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let fraction = |text: &str| match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text.to_owned(),
    };
    if (-3..6).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0);
        fraction(&format!("{number:.*}", decimals as usize))
    } else {
        format!("{}e{exponent}", fraction(mantissa))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let all = [
            0.0, 0.018, 1.0, 12.345, 5.2154, 8192.0, 4.1e-6, -0.25, 9.999, 200.0, 1e6, 1e-13,
        ];
        let texts = all.map(short);
        let want = [
            "0", "0.018", "1", "12.3", "5.22", "8192", "4.1e-6", "-0.25", "10", "200", "1e6",
            "1e-13",
        ];
        assert_eq!(texts, want);
        assert_eq!(digits(1000.0 / 3.0, 6), "333.333");
    }
}
