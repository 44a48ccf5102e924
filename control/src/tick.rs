//! One tick: a hardware count in, a torque out, and how passive that was.
//!
//! The tick has no error path: everything it takes was validated by
//! [`Controller::new`]. It computes in `f32` with + − × ÷ only.

use crate::criterion::{Criterion, Device, Sampling};
use crate::encoder::{Encoder, EncoderConfig};
use crate::error::{ConfigError, not_negative, positive};
use crate::real::smaller;
use crate::spring::{SampledSpring, Side};

/// What decides the stiffness that is applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Law {
    /// The demanded stiffness, whatever it does.
    Raw,
    /// At most min(2b/T, 2c/Δ), which is passive at every speed.
    Static,
}

/// Everything a controller is told. Plain data, in `f64` and SI units; checked once,
/// by [`Controller::new`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// The device as it is believed to be.
    pub device: Device<f64>,
    /// The sample period T, s.
    pub period_s: f64,
    /// The size of one hardware count, before decimation, rad.
    pub hardware_count_rad: f64,
    /// How the hardware counter is read.
    pub encoder: EncoderConfig,
    /// Spring or wall.
    pub side: Side,
    /// The centre of the spring or the edge of the wall, rad.
    pub zero_rad: f64,
    /// The demanded stiffness K, Nm/rad.
    pub stiffness_nm_rad: f64,
    /// The law that decides how much of it is applied.
    pub law: Law,
}

impl Config {
    /// Δ: the size of a count after decimation, rad.
    #[must_use]
    pub fn count_rad(&self) -> f64 {
        self.hardware_count_rad * f64::from(self.encoder.decimation())
    }
}

/// What one tick decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// The decimated count n.
    pub count: i32,
    /// The torque to hold until the next tick, Nm.
    pub torque_nm: f32,
    /// The stiffness applied, Nm/rad.
    pub stiffness_nm_rad: f32,
    /// The passivity margin (11) × |ẋ| of the applied stiffness at the worst of the
    /// mean speeds that the counts of the last period allow, Nm. The first tick has
    /// seen no motion and answers for a knob at rest.
    pub margin_nm: f32,
}

/// A sampled spring, with the criterion that watches it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    criterion: Criterion<f32>,
    spring: SampledSpring,
    encoder: Encoder,
    stiffness_nm_rad: f32,
    /// Δ/T, rad/s: the speed of one count per sample.
    count_speed_rad_s: f32,
    seen: bool,
}

impl Controller {
    /// A controller for a knob that stands at `hardware_count` counts from zero now.
    ///
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, by name and value.
    pub fn new(config: &Config, hardware_count: i32) -> Result<Self, ConfigError> {
        let device = Criterion::new(
            config.device,
            Sampling {
                period_s: config.period_s,
                count_rad: positive("count size (rad)", config.count_rad())?,
            },
        )?;
        let Device {
            inertia_kg_m2,
            viscous_nm_s_rad,
            coulomb_nm,
        } = *device.device();
        let criterion = Criterion::new(
            Device {
                inertia_kg_m2: inertia_kg_m2 as f32,
                viscous_nm_s_rad: viscous_nm_s_rad as f32,
                coulomb_nm: coulomb_nm as f32,
            },
            Sampling {
                period_s: config.period_s as f32,
                count_rad: config.count_rad() as f32,
            },
        )?;
        let demanded = not_negative("stiffness (Nm/rad)", config.stiffness_nm_rad as f32)?;
        let sampling = criterion.sampling();
        Ok(Self {
            spring: SampledSpring::new(config.side, config.zero_rad, config.count_rad())?,
            encoder: Encoder::new(config.encoder, hardware_count),
            stiffness_nm_rad: match config.law {
                Law::Raw => demanded,
                Law::Static => smaller(demanded, criterion.largest_stiffness()),
            },
            count_speed_rad_s: positive(
                "count / sample period (rad/s)",
                sampling.count_rad / sampling.period_s,
            )?,
            criterion,
            seen: false,
        })
    }

    /// One sample: takes the hardware counter, returns the torque to hold.
    pub fn tick(&mut self, hardware_counter: u32) -> Tick {
        let before = self.encoder.count();
        let count = self.encoder.update(hardware_counter);
        let stiffness_nm_rad = self.stiffness_nm_rad;
        let margin_nm = if self.seen {
            self.worst_margin_nm(stiffness_nm_rad, count.wrapping_sub(before))
        } else {
            self.criterion.power_margin_nm(stiffness_nm_rad, 0.0)
        };
        self.seen = true;
        Tick {
            count,
            torque_nm: self.spring.torque_nm(count, stiffness_nm_rad),
            stiffness_nm_rad,
            margin_nm,
        }
    }

    /// `moved` counts in one period put the mean speed between (|moved| − 1)₊ Δ/T and
    /// (|moved| + 1) Δ/T. The margin is affine in the speed: one of the ends is the worst.
    fn worst_margin_nm(&self, stiffness: f32, moved: i32) -> f32 {
        let counts = moved.unsigned_abs();
        let slow = counts.saturating_sub(1) as f32 * self.count_speed_rad_s;
        let fast = counts.saturating_add(1) as f32 * self.count_speed_rad_s;
        smaller(
            self.criterion.power_margin_nm(stiffness, slow),
            self.criterion.power_margin_nm(stiffness, fast),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn re35(law: Law, stiffness_nm_rad: f64) -> Config {
        Config {
            device: Device {
                inertia_kg_m2: 6.28e-6,
                viscous_nm_s_rad: 9e-6,
                coulomb_nm: 2e-3,
            },
            period_s: 1e-3,
            hardware_count_rad: core::f64::consts::TAU / 8192.0,
            encoder: EncoderConfig::new(16, 1).unwrap(),
            side: Side::Both,
            zero_rad: 0.0,
            stiffness_nm_rad,
            law,
        }
    }

    #[test]
    fn raw_applies_the_demand_and_static_what_is_passive_at_every_speed() {
        let count = core::f32::consts::TAU / 8192.0;
        let tick = Controller::new(&re35(Law::Raw, 1.0), 0).unwrap().tick(10);
        assert_eq!(tick.stiffness_nm_rad, 1.0);
        assert!((tick.torque_nm + 10.5 * count).abs() < 1e-8);
        let tick = Controller::new(&re35(Law::Static, 1.0), 0)
            .unwrap()
            .tick(10);
        assert!((tick.stiffness_nm_rad - 0.018).abs() < 1e-8);
        assert!((tick.torque_nm + 0.018 * 10.5 * count).abs() < 1e-8);
        let tick = Controller::new(&re35(Law::Static, 0.01), 0)
            .unwrap()
            .tick(10);
        assert_eq!(tick.stiffness_nm_rad, 0.01);
    }

    #[test]
    fn the_margin_is_the_worst_over_the_speeds_the_counts_allow() {
        let config = re35(Law::Raw, 1.0);
        let mut controller = Controller::new(&config, 0).unwrap();
        let m =
            |speed: f32| (9e-6 - 0.5e-3) * speed + (2e-3 - 0.5 * core::f32::consts::TAU / 8192.0);
        let count_speed = core::f32::consts::TAU / 8.192;
        assert!((controller.tick(0).margin_nm - m(0.0)).abs() < 1e-9);
        // Moved by 3 counts, either way: between 2 and 4 counts per sample, 4 is worse.
        assert!((controller.tick(3).margin_nm - m(4.0 * count_speed)).abs() < 1e-8);
        assert!((controller.tick(0).margin_nm - m(4.0 * count_speed)).abs() < 1e-8);
        assert!((controller.tick(0).margin_nm - m(count_speed)).abs() < 1e-8);
        // Where viscous friction wins, the slow end is worse.
        let mut soft = Controller::new(&re35(Law::Raw, 0.01), 0).unwrap();
        soft.tick(0);
        let want =
            (9e-6 - 0.5e-5) * 2.0 * count_speed + (2e-3 - 0.005 * core::f32::consts::TAU / 8192.0);
        assert!((soft.tick(3).margin_nm - want).abs() < 1e-8);
    }

    #[test]
    fn a_configuration_that_no_tick_may_run_with_is_refused() {
        for bad in [-1.0, f64::NAN, f64::INFINITY, 1e300] {
            assert!(
                Controller::new(&re35(Law::Static, bad), 0).is_err(),
                "{bad}"
            );
        }
        let mut config = re35(Law::Raw, 1.0);
        config.hardware_count_rad = 1e-60; // above zero, but not in f32
        assert!(Controller::new(&config, 0).is_err());
    }
}
