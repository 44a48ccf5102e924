//! The passivity criterion of Diolaiti, Niemeyer, Barbagli and Salisbury, in every
//! form of the paper. Equation numbers in parentheses are the paper's.
//!
//! A display of stiffness K, sampled every T through counts of size Δ, on a device
//! with viscous friction b and Coulomb friction c, is passive while
//!
//! (b − KT/2) + |ẋ|⁻¹(c − KΔ/2) ≥ 0. (11)
//!
//! Everything here uses the power form, (11) × |ẋ|, in Nm: it says the same wherever
//! the knob moves, has no division, and is affine in |ẋ|.
//!
//! Assumed: the torque is held for one period and applied without delay, the knob
//! starts at the spring's zero, friction is at least b and c. All functions
//! are generic: `f32` in the tick, `f64` in the analysis, one source.

use crate::error::{ConfigError, not_negative, positive};
use crate::real::{Real, smaller};

/// A device by its mechanics: m ẍ + b ẋ + c sgn ẋ = torque (1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Device<T> {
    /// m, kg m².
    pub inertia_kg_m2: T,
    /// b, Nm s/rad.
    pub viscous_nm_s_rad: T,
    /// c, Nm.
    pub coulomb_nm: T,
}

/// How the controller sees the device: in time and in angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampling<T> {
    /// T, s.
    pub period_s: T,
    /// Δ, rad, after decimation.
    pub count_rad: T,
}

/// The dimensionless parameters (7) of a display.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dimensionless<T> {
    /// μ = m/(K T²).
    pub mu: T,
    /// β = b/(K T), effective viscous friction.
    pub beta: T,
    /// σ = c/(K Δ), effective Coulomb friction.
    pub sigma: T,
}

/// The four regions of the (β, σ) plane (Fig. 3). A point on a border has enough
/// friction of that kind, as in (8).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Region {
    /// (a) β ≥ ½, σ ≥ ½: passive whatever the start.
    GloballyPassive,
    /// (b) β < ½, σ < ½: friction never suffices.
    Unstable,
    /// (c) β ≥ ½, σ < ½: self-sustained oscillation of about a count.
    LimitCycle,
    /// (d) β < ½, σ ≥ ½: passive while slow enough.
    LocallyPassive,
}

impl Region {
    /// The paper's letter.
    #[must_use]
    pub fn letter(self) -> char {
        match self {
            Self::GloballyPassive => 'a',
            Self::Unstable => 'b',
            Self::LimitCycle => 'c',
            Self::LocallyPassive => 'd',
        }
    }
}

impl<T: Real> Dimensionless<T> {
    /// (β − ½)·|ξ̇| + (σ − ½), inequality (8) times |ξ̇|: the power that friction takes
    /// beyond what sampling makes, in units of K Δ, at a speed in counts per sample.
    pub fn power_margin(&self, speed: T) -> T {
        let half = T::from(0.5);
        (self.beta - half) * speed.magnitude() + (self.sigma - half)
    }

    /// Inequality (8) at one speed in counts per sample; at the initial speed it is (10).
    ///
    /// ```
    /// use control::criterion::Dimensionless;
    /// let display = Dimensionless { mu: 50.0, beta: 0.4, sigma: 0.8 };
    /// assert!(display.holds_at(2.0)); // −0.1 + 0.3/2 ≥ 0
    /// assert!(!display.holds_at(4.0)); // −0.1 + 0.3/4 < 0
    /// ```
    pub fn holds_at(&self, speed: T) -> bool {
        self.power_margin(speed) >= T::from(0.0)
    }

    /// Which of the paper's four regions this display lies in.
    pub fn region(&self) -> Region {
        let half = T::from(0.5);
        match (self.beta >= half, self.sigma >= half) {
            (true, true) => Region::GloballyPassive,
            (false, false) => Region::Unstable,
            (true, false) => Region::LimitCycle,
            (false, true) => Region::LocallyPassive,
        }
    }
}

/// The σ of the critical line σ = ½ − |ξ̇|(β − ½) (9) at a given β and a speed in
/// counts per sample. Points on it or above satisfy (8).
///
/// ```
/// use control::criterion::critical_sigma;
/// assert_eq!(critical_sigma(0.5, 30.0), 0.5); // every line turns about (½, ½)
/// assert_eq!(critical_sigma(0.25, 2.0), 1.0); // and has slope −|ξ̇|
/// ```
pub fn critical_sigma<T: Real>(beta: T, speed: T) -> T {
    let half = T::from(0.5);
    half - speed.magnitude() * (beta - half)
}

/// The criterion for one device and one way of sampling it. Valid by construction:
/// no method divides by zero.
///
/// The paper's testbed, a Maxon RE35 with 8192 counts at 1 ms (Sec. V):
///
/// ```
/// use control::criterion::{Criterion, Device, Region, Sampling};
/// let re35 = Device { inertia_kg_m2: 6.28e-6, viscous_nm_s_rad: 9e-6, coulomb_nm: 2e-3 };
/// let sampling = Sampling { period_s: 1e-3, count_rad: core::f64::consts::TAU / 8192.0 };
/// let criterion = Criterion::new(re35, sampling)?;
///
/// // 2b/T is the smaller limit: this device lives in region (d) when stiff.
/// assert!((criterion.viscous_limit() - 0.018).abs() < 1e-12);
/// assert!((criterion.coulomb_limit() - 5.2152).abs() < 1e-4);
/// assert_eq!(criterion.largest_stiffness(), criterion.viscous_limit());
///
/// // Fig. 6(c): K = 1 Nm/rad is passive up to 3.29 rad/s, by (11).
/// let display = criterion.dimensionless(1.0);
/// assert!((display.beta - 0.009).abs() < 1e-12 && (display.sigma - 2.6076).abs() < 1e-4);
/// assert_eq!(display.region(), Region::LocallyPassive);
/// assert!(criterion.power_margin_nm(1.0, 3.29) > 0.0);
/// assert!(criterion.power_margin_nm(1.0, 3.30) < 0.0);
/// # Ok::<(), control::ConfigError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Criterion<T> {
    device: Device<T>,
    sampling: Sampling<T>,
    viscous_limit: T,
    coulomb_limit: T,
}

impl<T: Real> Criterion<T> {
    /// Takes a device and how it is sampled.
    ///
    /// # Errors
    /// Refuses what is not finite, an inertia, period or count that is not above
    /// zero, and negative friction.
    pub fn new(device: Device<T>, sampling: Sampling<T>) -> Result<Self, ConfigError> {
        let two = T::from(2.0);
        let device = Device {
            inertia_kg_m2: positive("inertia (kg m²)", device.inertia_kg_m2)?,
            viscous_nm_s_rad: not_negative("viscous friction (Nm s/rad)", device.viscous_nm_s_rad)?,
            coulomb_nm: not_negative("Coulomb friction (Nm)", device.coulomb_nm)?,
        };
        let sampling = Sampling {
            period_s: positive("sample period (s)", sampling.period_s)?,
            count_rad: positive("count size (rad)", sampling.count_rad)?,
        };
        Ok(Self {
            viscous_limit: not_negative(
                "2 × viscous friction / sample period (Nm/rad)",
                two * device.viscous_nm_s_rad / sampling.period_s,
            )?,
            coulomb_limit: not_negative(
                "2 × Coulomb friction / count (Nm/rad)",
                two * device.coulomb_nm / sampling.count_rad,
            )?,
            device,
            sampling,
        })
    }

    /// The device this criterion speaks of.
    pub fn device(&self) -> &Device<T> {
        &self.device
    }

    /// How that device is sampled.
    pub fn sampling(&self) -> &Sampling<T> {
        &self.sampling
    }

    /// μ, β and σ (7) of a display of stiffness K (Nm/rad) above zero; at K = 0 they
    /// are infinite, as the effective friction of no spring is.
    pub fn dimensionless(&self, stiffness: T) -> Dimensionless<T> {
        let Device {
            inertia_kg_m2: m,
            viscous_nm_s_rad: b,
            coulomb_nm: c,
        } = self.device;
        let Sampling {
            period_s: t,
            count_rad: delta,
        } = self.sampling;
        Dimensionless {
            mu: m / (stiffness * t * t),
            beta: b / (stiffness * t),
            sigma: c / (stiffness * delta),
        }
    }

    /// (b − KT/2)·|ẋ| + (c − KΔ/2), (11) times |ẋ|, in Nm, for K in Nm/rad and a
    /// speed in rad/s. The display is passive at that speed while it is ≥ 0.
    #[inline]
    pub fn power_margin_nm(&self, stiffness: T, speed: T) -> T {
        let half_stiffness = T::from(0.5) * stiffness;
        (self.device.viscous_nm_s_rad - half_stiffness * self.sampling.period_s) * speed.magnitude()
            + (self.device.coulomb_nm - half_stiffness * self.sampling.count_rad)
    }

    /// The power margin at the worst of all speeds between two, 0 or more. It is affine
    /// in the speed, so one of the two is the worst.
    pub fn worst_power_margin_nm(&self, stiffness: T, slow: T, fast: T) -> T {
        let half_stiffness = T::from(0.5) * stiffness;
        let slope = self.device.viscous_nm_s_rad - half_stiffness * self.sampling.period_s;
        let at_rest = self.device.coulomb_nm - half_stiffness * self.sampling.count_rad;
        let worst = if slope < T::from(0.0) { fast } else { slow };
        slope * worst + at_rest
    }

    /// The largest K that (11) allows at one speed: 2(b|ẋ| + c)/(T|ẋ| + Δ), Nm/rad.
    ///
    /// It lies between `coulomb_limit` at rest and `viscous_limit` at infinite
    /// speed, and is monotonic in between.
    pub fn largest_stiffness_at(&self, speed: T) -> T {
        let speed = speed.magnitude();
        T::from(2.0) * (self.device.viscous_nm_s_rad * speed + self.device.coulomb_nm)
            / (self.sampling.period_s * speed + self.sampling.count_rad)
    }

    /// The largest K that (11) allows at every speed: min(2b/T, 2c/Δ), Nm/rad, the
    /// border of region (a); also Abbott and Okamura's (2005).
    pub fn largest_stiffness(&self) -> T {
        smaller(self.viscous_limit, self.coulomb_limit)
    }

    /// 2b/T, Nm/rad: Colgate's limit, β = ½.
    pub fn viscous_limit(&self) -> T {
        self.viscous_limit
    }

    /// 2c/Δ, Nm/rad: σ = ½.
    pub fn coulomb_limit(&self) -> T {
        self.coulomb_limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn log_uniform(low: f64, high: f64) -> impl Strategy<Value = f64> {
        (low.ln()..high.ln()).prop_map(f64::exp)
    }

    prop_compose! {
        fn any_criterion()(
            m in log_uniform(1e-7, 1e-4),
            b in log_uniform(1e-7, 1e-3),
            c in log_uniform(1e-5, 1e-1),
            period_s in log_uniform(4e-5, 2e-2),
            count_rad in log_uniform(1e-5, 0.5),
        ) -> Criterion<f64> {
            let device = Device { inertia_kg_m2: m, viscous_nm_s_rad: b, coulomb_nm: c };
            Criterion::new(device, Sampling { period_s, count_rad }).unwrap()
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn the_physical_margin_is_the_dimensionless_one_in_units_of_k_delta(
            criterion in any_criterion(), k in log_uniform(1e-4, 1e3), speed in -100.0..100.0f64,
        ) {
            let Sampling { period_s, count_rad } = *criterion.sampling();
            let physical = criterion.power_margin_nm(k, speed);
            let counts = criterion.dimensionless(k).power_margin(speed * period_s / count_rad);
            let scale = criterion.device().viscous_nm_s_rad * speed.abs()
                + criterion.device().coulomb_nm + k * (period_s * speed.abs() + count_rad);
            prop_assert!((physical - counts * k * count_rad).abs() <= 1e-14 * scale);
        }

        #[test]
        fn the_largest_stiffness_is_where_the_margin_changes_sign(
            criterion in any_criterion(), speed in log_uniform(1e-3, 1e3),
        ) {
            let k = criterion.largest_stiffness_at(speed);
            prop_assert!(criterion.power_margin_nm(k * (1.0 - 1e-12), speed) >= 0.0);
            prop_assert!(criterion.power_margin_nm(k * (1.0 + 1e-12), speed) < 0.0);
        }

        #[test]
        fn the_stiffness_for_all_speeds_holds_at_each_and_no_larger_one_does(
            criterion in any_criterion(), speed in log_uniform(1e-6, 1e6),
        ) {
            let k = criterion.largest_stiffness() * (1.0 - 1e-12);
            prop_assert!(criterion.power_margin_nm(k, speed) >= 0.0);
            prop_assert!(criterion.power_margin_nm(k, 0.0) >= 0.0);
            let above = criterion.largest_stiffness() * (1.0 + 1e-9);
            let fails = criterion.power_margin_nm(above, 0.0) < 0.0
                || criterion.power_margin_nm(above, 1e15) < 0.0;
            prop_assert!(fails);
        }

        #[test]
        fn the_critical_line_parts_the_plane_where_the_inequality_does(
            beta in 0.0..1.0f64, sigma in 0.0..1.0f64, speed in -200.0..200.0f64,
        ) {
            let display = Dimensionless { mu: 50.0, beta, sigma };
            let above = sigma - critical_sigma(beta, speed);
            prop_assume!(above.abs() > 1e-12);
            prop_assert_eq!(display.holds_at(speed), above > 0.0);
            // The paper writes (8) with a division; where that is possible they agree.
            if speed != 0.0 {
                let as_printed = (beta - 0.5) + (sigma - 0.5) / speed.abs();
                prop_assert_eq!(display.holds_at(speed), as_printed >= 0.0);
            }
        }

        #[test]
        fn regions_say_what_the_inequality_says_at_rest_and_at_speed(
            beta in 0.0..1.0f64, sigma in 0.0..1.0f64,
        ) {
            let display = Dimensionless { mu: 50.0, beta, sigma };
            let (slow, fast) = (display.holds_at(0.0), display.holds_at(1e18));
            prop_assert_eq!(display.region(), match (fast, slow) {
                (true, true) => Region::GloballyPassive,
                (false, false) => Region::Unstable,
                (true, false) => Region::LimitCycle,
                (false, true) => Region::LocallyPassive,
            });
        }

        #[test]
        fn f32_agrees_with_f64_to_its_own_precision(
            criterion in any_criterion(), k in log_uniform(1e-3, 1e2), speed in -100.0..100.0f32,
        ) {
            let (d, s) = (criterion.device(), criterion.sampling());
            let single = Criterion::<f32>::new(
                Device {
                    inertia_kg_m2: d.inertia_kg_m2 as f32,
                    viscous_nm_s_rad: d.viscous_nm_s_rad as f32,
                    coulomb_nm: d.coulomb_nm as f32,
                },
                Sampling { period_s: s.period_s as f32, count_rad: s.count_rad as f32 },
            ).unwrap();
            let want = criterion.largest_stiffness_at(f64::from(speed));
            let have = f64::from(single.largest_stiffness_at(speed));
            prop_assert!((have - want).abs() <= 6.0 * f64::from(f32::EPSILON) * want);
            let want = criterion.power_margin_nm(k, f64::from(speed));
            let have = f64::from(single.power_margin_nm(k as f32, speed));
            let scale = d.viscous_nm_s_rad * f64::from(speed.abs()) + d.coulomb_nm
                + k * (s.period_s * f64::from(speed.abs()) + s.count_rad);
            prop_assert!((have - want).abs() <= 6.0 * f64::from(f32::EPSILON) * scale);
        }
    }

    #[test]
    fn what_is_no_device_is_refused_by_name_and_value() {
        let device = Device {
            inertia_kg_m2: 6.28e-6,
            viscous_nm_s_rad: 9e-6,
            coulomb_nm: 2e-3,
        };
        let sampling = Sampling {
            period_s: 1e-3,
            count_rad: 1e-3,
        };
        let refuse = |device, sampling| Criterion::new(device, sampling).unwrap_err().to_string();
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let said = refuse(
                device,
                Sampling {
                    period_s: bad,
                    ..sampling
                },
            );
            assert_eq!(
                said,
                format!("sample period (s) is {bad}; accepted: a finite number above 0")
            );
            let said = refuse(
                device,
                Sampling {
                    count_rad: bad,
                    ..sampling
                },
            );
            assert_eq!(
                said,
                format!("count size (rad) is {bad}; accepted: a finite number above 0")
            );
            let said = refuse(
                Device {
                    inertia_kg_m2: bad,
                    ..device
                },
                sampling,
            );
            assert_eq!(
                said,
                format!("inertia (kg m²) is {bad}; accepted: a finite number above 0")
            );
        }
        for bad in [-1e-9, f64::NAN, f64::NEG_INFINITY] {
            let said = refuse(
                Device {
                    coulomb_nm: bad,
                    ..device
                },
                sampling,
            );
            assert_eq!(
                said,
                format!("Coulomb friction (Nm) is {bad}; accepted: a finite number, 0 or more")
            );
        }
    }
}
