//! What sums say: currents as vectors, and their answer to a ripple or in a turning field.
//!
//! A vector of three phases is a complex number, phase A along 1: i = −(B + C) + j (B − C)/√3.

use std::f64::consts::{FRAC_PI_4, TAU};

use nalgebra::Complex;
use protocol::Sums;

/// A vector of three phases, or a phasor.
pub(super) type Vector = Complex<f64>;

/// 2⁻³² turns.
pub(super) const PER_TURN: f64 = 4_294_967_296.0;

/// How codes become currents.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scale {
    pub step_a: f64,
    /// Of B and C.
    pub zero_codes: [f64; 2],
}

/// Mean codes of B and C in one quarter, and in how many periods.
fn quarter(windows: &[Sums], which: usize) -> ([f64; 2], f64) {
    let mut codes = [0.0; 2];
    let mut periods = 0.0;
    for sums in windows {
        codes[0] += f64::from(sums.b_codes[which]);
        codes[1] += f64::from(sums.c_codes[which]);
        periods += f64::from(sums.periods[which]);
    }
    (codes.map(|sum| sum / periods), periods)
}

/// Mean codes of B and C.
pub(super) fn codes(windows: &[Sums]) -> [f64; 2] {
    let mut codes = [0.0; 2];
    for sums in windows {
        for which in 0..4 {
            codes[0] += f64::from(sums.b_codes[which]);
            codes[1] += f64::from(sums.c_codes[which]);
        }
    }
    codes.map(|sum| sum / periods(windows))
}

pub(super) fn periods(windows: &[Sums]) -> f64 {
    let all = windows.iter().flat_map(|sums| sums.periods);
    all.map(f64::from).sum()
}

/// The mean bus voltage, V.
pub(super) fn bus_v(windows: &[Sums]) -> f64 {
    let sum: f64 = windows.iter().map(|sums| f64::from(sums.bus_mv)).sum();
    1e-3 * sum / periods(windows)
}

/// The mean count.
pub(super) fn count(windows: &[Sums]) -> f64 {
    let sum: f64 = windows.iter().map(|sums| sums.counts as f64).sum();
    sum / periods(windows)
}

/// Standard deviation of the codes of a converter, from how much the means of quarters scatter where no
/// current flows.
pub(super) fn noise_codes(windows: &[Sums], phase: usize) -> f64 {
    let all = codes(windows)[phase];
    let mut square = 0.0;
    let mut number = 0.0;
    for sums in windows {
        for which in 0..4 {
            let ([b, c], periods) = quarter(std::slice::from_ref(sums), which);
            let off = [b, c][phase] - all;
            if periods > 0.0 {
                square += off * off * periods;
                number += 1.0;
            }
        }
    }
    (square / number).sqrt()
}

impl Scale {
    fn amperes(&self, codes: [f64; 2]) -> [f64; 2] {
        let of = |phase: usize| (codes[phase] - self.zero_codes[phase]) * self.step_a;
        [of(0), of(1)]
    }

    /// Mean currents of B and C, A.
    pub fn currents(&self, windows: &[Sums]) -> [f64; 2] {
        self.amperes(codes(windows))
    }

    /// The mean current, A.
    pub fn vector(&self, windows: &[Sums]) -> Vector {
        clarke(self.currents(windows))
    }

    /// The answer to a ripple: the first bin of α's and of β's discrete Fourier transform over the means of the
    /// four quarters, which is twice the amplitude where a quarter is one period.
    pub fn ripple(&self, windows: &[Sums]) -> [Vector; 2] {
        let mut bins = [Vector::new(0.0, 0.0); 2];
        let mut turned = Vector::new(1.0, 0.0);
        for which in 0..4 {
            let mean = clarke(self.amperes(quarter(windows, which).0));
            bins[0] += turned * mean.re;
            bins[1] += turned * mean.im;
            turned *= Vector::new(0.0, -1.0);
        }
        bins
    }

    /// In a field that turned evenly through whole turns: the current as seen from it, A.
    pub fn turning(&self, windows: &[Sums]) -> Vector {
        let mut sum = Vector::new(0.0, 0.0);
        for which in 0..4 {
            let mean = clarke(self.amperes(quarter(windows, which).0));
            sum += mean * turned(-(which as f64 + 0.5) / 4.0);
        }
        // The mean over a quarter turn of what turns is shorter than it.
        sum / 4.0 * (FRAC_PI_4 / FRAC_PI_4.sin())
    }
}

/// The ripple itself, +1, +1, −1, −1, in the same measure.
pub(super) fn ripple_of_one() -> Vector {
    Vector::new(2.0, -2.0)
}

/// e^(j·turns).
pub(super) fn turned(turns: f64) -> Vector {
    Vector::from_polar(1.0, TAU * turns)
}

fn clarke([b, c]: [f64; 2]) -> Vector {
    Vector::new(-(b + c), (b - c) / 3.0_f64.sqrt())
}
