use core::ops::{Add, Div, Mul, Neg, Sub};

/// The number a law is written in: `f32` in the tick, `f64` in the analysis.
///
/// Only + − × ÷ and comparison are asked for. They are correctly rounded
/// everywhere, so a law written with them gives the same bits on the host and on
/// the chip.
pub trait Real:
    Copy
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + From<f32>
    + Into<f64>
{
    /// |x|.
    fn magnitude(self) -> Self;
}

impl Real for f32 {
    fn magnitude(self) -> Self {
        self.abs()
    }
}

impl Real for f64 {
    fn magnitude(self) -> Self {
        self.abs()
    }
}

/// The smaller of two numbers that are not NaN.
pub(crate) fn smaller<T: Real>(a: T, b: T) -> T {
    if b < a { b } else { a }
}

/// The larger of two numbers that are not NaN.
pub(crate) fn larger<T: Real>(a: T, b: T) -> T {
    if b > a { b } else { a }
}
