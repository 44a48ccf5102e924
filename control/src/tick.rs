//! One tick: a hardware count in, a torque out, and how passive that was.
//!
//! The tick has no error path: everything it takes was validated by [`Plan::new`]. It computes
//! in `f32` with + − × ÷ only, so host and chip agree to the last bit.
//!
//! Stiffness may fall in any tick, but rises only at zero force: raising it by ΔK at a
//! deflection q would add ½ ΔK q² to the display. Zero force is the free side of a
//! wall, or a cell that touches the spring's zero, where at most ½ ΔK Δ² is added.

use crate::criterion::{Criterion, Device, Sampling};
use crate::encoder::{Encoder, EncoderConfig};
use crate::error::{ConfigError, interval, not_negative, positive};
use crate::real::smaller;
use crate::spring::{SampledSpring, Side};

/// What decides the stiffness that is applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Law {
    /// The demanded stiffness, whatever it does.
    Raw,
    /// At most min(2b/T, 2c/Δ), which is passive at every speed.
    Static,
    /// At most what (11) allows at the worst speed seen in this contact, and at most 2c/Δ,
    /// or it would never rest. Within a contact the stiffness only falls; it is released at
    /// zero force. Until a speed has been seen, as [`Law::Static`].
    Episode,
}

/// A quantity that is known to lie between two values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// The least it may be.
    pub low: f64,
    /// The most it may be.
    pub high: f64,
}

impl Interval {
    /// A quantity that is believed to be known exactly.
    #[must_use]
    pub fn exactly(value: f64) -> Self {
        Self {
            low: value,
            high: value,
        }
    }
}

/// A device as it is believed to be, in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Believed {
    /// m, kg m².
    pub inertia_kg_m2: Interval,
    /// b, Nm s/rad.
    pub viscous_nm_s_rad: Interval,
    /// c, Nm.
    pub coulomb_nm: Interval,
}

impl Believed {
    /// A device whose values are believed to be known exactly.
    #[must_use]
    pub fn exactly(device: &Device<f64>) -> Self {
        Self {
            inertia_kg_m2: Interval::exactly(device.inertia_kg_m2),
            viscous_nm_s_rad: Interval::exactly(device.viscous_nm_s_rad),
            coulomb_nm: Interval::exactly(device.coulomb_nm),
        }
    }
}

/// Everything a controller is told. Plain data, in `f64` and SI units; checked once,
/// by [`Plan::new`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// The device as it is believed to be; its least friction counts.
    pub believed: Believed,
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
    /// The largest torque commanded, in magnitude, Nm.
    pub torque_max_nm: f64,
}

impl Config {
    /// Δ: the size of a count after decimation, rad.
    #[must_use]
    pub fn count_rad(&self) -> f64 {
        self.hardware_count_rad * f64::from(self.encoder.decimation())
    }
}

/// Why the stiffness or the torque is less than demanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// It is not.
    None,
    /// Sampled too slowly for this viscous friction: 2b/T.
    Viscous,
    /// Encoder too coarse for this Coulomb friction: 2c/Δ.
    Coulomb,
    /// Too fast in this contact: 2(b|ẋ| + c)/(T|ẋ| + Δ).
    Speed,
    /// It may rise only at zero force, and waits for it.
    ZeroForce,
    /// The torque limit.
    Torque,
}

/// What one tick decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// The decimated count n.
    pub count: i32,
    /// Counts moved since the last tick.
    pub moved: i32,
    /// The torque to hold until the next tick, Nm.
    pub torque_nm: f32,
    /// The stiffness applied, Nm/rad.
    pub stiffness_nm_rad: f32,
    /// The passivity margin (11) × |ẋ| of the applied stiffness at the worst of the
    /// mean speeds that the counts of the last period allow, Nm. The first tick has
    /// seen no motion and answers for a knob that moves by less than a count.
    pub margin_nm: f32,
    /// Why less is applied than demanded.
    pub reason: Reason,
}

/// A configuration that was checked, in the form that the tick uses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    criterion: Criterion<f32>,
    spring: SampledSpring,
    encoder: EncoderConfig,
    law: Law,
    demanded_nm_rad: f32,
    /// What the law allows at every speed, and why not more.
    limit_nm_rad: f32,
    limit_reason: Reason,
    torque_max_nm: f32,
    half_count_rad: f32,
    /// Δ/T, rad/s: the speed of one count per sample.
    count_speed_rad_s: f32,
}

impl Plan {
    /// Checks a configuration.
    ///
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, by name and value, and an interval
    /// that is reversed.
    pub fn new(config: &Config) -> Result<Self, ConfigError> {
        let believed = &config.believed;
        let inertia = interval("inertia (kg m²)", &believed.inertia_kg_m2)?;
        let viscous = interval("viscous friction (Nm s/rad)", &believed.viscous_nm_s_rad)?;
        let coulomb = interval("Coulomb friction (Nm)", &believed.coulomb_nm)?;
        positive("count size (rad)", config.count_rad())?;
        let criterion = Criterion::new(
            Device {
                inertia_kg_m2: inertia.low as f32,
                viscous_nm_s_rad: viscous.low as f32,
                coulomb_nm: coulomb.low as f32,
            },
            Sampling {
                period_s: config.period_s as f32,
                count_rad: config.count_rad() as f32,
            },
        )?;
        let demanded = not_negative("stiffness (Nm/rad)", config.stiffness_nm_rad as f32)?;
        let sampling = *criterion.sampling();
        // A little down: a limit that f32 has rounded up would be none.
        let down = 1.0 - 4.0 * f32::EPSILON;
        let (viscous_limit, coulomb_limit) = (
            down * criterion.viscous_limit(),
            down * criterion.coulomb_limit(),
        );
        let (limit, limit_reason) = match config.law {
            Law::Raw => (demanded, Reason::None),
            Law::Static if viscous_limit < coulomb_limit => (viscous_limit, Reason::Viscous),
            Law::Static | Law::Episode => (coulomb_limit, Reason::Coulomb),
        };
        Ok(Self {
            spring: SampledSpring::new(config.side, config.zero_rad, config.count_rad())?,
            encoder: config.encoder,
            law: config.law,
            demanded_nm_rad: demanded,
            limit_nm_rad: smaller(demanded, limit),
            limit_reason: if demanded > limit {
                limit_reason
            } else {
                Reason::None
            },
            torque_max_nm: not_negative("torque limit (Nm)", config.torque_max_nm as f32)?,
            half_count_rad: 0.5 * sampling.count_rad,
            count_speed_rad_s: positive(
                "count / sample period (rad/s)",
                sampling.count_rad / sampling.period_s,
            )?,
            criterion,
        })
    }

    /// The demanded stiffness, Nm/rad.
    #[must_use]
    pub fn demanded_nm_rad(&self) -> f32 {
        self.demanded_nm_rad
    }

    /// T, s.
    #[must_use]
    pub fn period_s(&self) -> f32 {
        self.criterion.sampling().period_s
    }

    /// Δ/T: the speed of one count per sample, rad/s.
    #[must_use]
    pub fn count_speed_rad_s(&self) -> f32 {
        self.count_speed_rad_s
    }

    /// How the hardware counter is read.
    #[must_use]
    pub fn encoder(&self) -> EncoderConfig {
        self.encoder
    }
}

/// A sampled spring, with the criterion that watches it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    plan: Plan,
    encoder: Encoder,
    applied_nm_rad: f32,
    /// The least that (11) allowed in this contact, Nm/rad.
    contact_limit_nm_rad: f32,
    /// A tick has run, so that the next one knows how far the knob moved.
    seen: bool,
}

impl Controller {
    /// A controller for a knob that stands at `hardware_count` counts from zero now, and
    /// renders at once, also under load.
    #[must_use]
    pub fn new(plan: Plan, hardware_count: i32) -> Self {
        Self {
            plan,
            encoder: Encoder::new(plan.encoder, hardware_count),
            applied_nm_rad: match plan.law {
                Law::Raw | Law::Static => plan.limit_nm_rad,
                Law::Episode => smaller(plan.limit_nm_rad, plan.criterion.largest_stiffness()),
            },
            contact_limit_nm_rad: plan.criterion.largest_stiffness(),
            seen: false,
        }
    }

    /// Lets go: no stiffness is applied until the knob passes zero force.
    pub fn release(&mut self) {
        self.applied_nm_rad = 0.0;
    }

    /// Takes another plan with the same encoder. What is felt changes without a step upwards:
    /// the stiffness falls at once where it must, and rises at zero force; a spring or wall
    /// that was moved is let go first.
    pub fn adopt(&mut self, plan: Plan) {
        if plan.spring != self.plan.spring {
            self.release();
        }
        // What this contact has allowed so far was found with other values.
        if plan.criterion != self.plan.criterion || plan.law != self.plan.law {
            self.contact_limit_nm_rad = plan.criterion.largest_stiffness();
        }
        self.plan = plan;
    }

    /// Hardware counts from zero at the last tick, wrapped to 32 bits.
    #[must_use]
    pub fn hardware_count(&self) -> i32 {
        self.encoder.hardware_count()
    }

    /// The plan in force.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// One sample: takes the hardware counter, returns the torque to hold.
    pub fn tick(&mut self, hardware_counter: u32) -> Tick {
        let plan = &self.plan;
        let before = self.encoder.count();
        let count = self.encoder.update(hardware_counter);
        let moved = count.wrapping_sub(before);
        // `moved` counts in one period put the mean speed between these, in counts.
        let counts = moved.unsigned_abs();
        let slow = counts.saturating_sub(1) as f32;
        let fast = counts.saturating_add(1) as f32;

        let deflection = plan.spring.deflection_rad(count);
        let free = plan.spring.side() == Side::Above && deflection <= 0.0;
        let zero_force = free || deflection.abs() <= plan.half_count_rad;

        let mut target = plan.limit_nm_rad;
        let mut reason = plan.limit_reason;
        if plan.law == Law::Episode {
            // Where 2b/T < 2c/Δ the limit falls with speed, so the fast end is the worse
            // one; else it never falls below 2c/Δ, which the target keeps to anyway.
            let now = if self.seen {
                plan.criterion
                    .largest_stiffness_at(fast * plan.count_speed_rad_s)
            } else {
                plan.criterion.largest_stiffness()
            };
            if (zero_force && self.seen) || now < self.contact_limit_nm_rad {
                self.contact_limit_nm_rad = now;
            }
            if self.contact_limit_nm_rad < target {
                target = self.contact_limit_nm_rad;
                reason = Reason::Speed;
            }
        }
        if target <= self.applied_nm_rad || zero_force {
            self.applied_nm_rad = target;
        } else {
            reason = Reason::ZeroForce;
        }
        self.seen = true;

        let stiffness = self.applied_nm_rad;
        let mut torque = if free { 0.0 } else { -(stiffness * deflection) };
        if torque.abs() > plan.torque_max_nm {
            torque = if torque > 0.0 {
                plan.torque_max_nm
            } else {
                -plan.torque_max_nm
            };
            reason = Reason::Torque;
        }
        Tick {
            count,
            moved,
            torque_nm: torque,
            stiffness_nm_rad: stiffness,
            margin_nm: plan.criterion.worst_power_margin_nm(
                stiffness,
                slow,
                fast,
                plan.count_speed_rad_s,
            ),
            reason,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const COUNT: f32 = core::f32::consts::TAU / 8192.0;

    fn re35(law: Law, stiffness_nm_rad: f64) -> Config {
        Config {
            believed: Believed {
                inertia_kg_m2: Interval::exactly(6.28e-6),
                viscous_nm_s_rad: Interval::exactly(9e-6),
                coulomb_nm: Interval::exactly(2e-3),
            },
            period_s: 1e-3,
            hardware_count_rad: core::f64::consts::TAU / 8192.0,
            encoder: EncoderConfig::new(16, 1).unwrap(),
            side: Side::Both,
            zero_rad: 0.0,
            stiffness_nm_rad,
            law,
            torque_max_nm: 0.5,
        }
    }

    fn controller(config: &Config) -> Controller {
        Controller::new(Plan::new(config).unwrap(), 0)
    }

    #[test]
    fn raw_applies_the_demand_and_static_what_is_passive_at_every_speed() {
        let tick = controller(&re35(Law::Raw, 1.0)).tick(10);
        assert_eq!((tick.stiffness_nm_rad, tick.reason), (1.0, Reason::None));
        assert!((tick.torque_nm + 10.5 * COUNT).abs() < 1e-8);
        let tick = controller(&re35(Law::Static, 1.0)).tick(10);
        assert!((tick.stiffness_nm_rad - 0.018).abs() < 1e-8);
        assert_eq!(tick.reason, Reason::Viscous);
        assert!((tick.torque_nm + 0.018 * 10.5 * COUNT).abs() < 1e-8);
        let tick = controller(&re35(Law::Static, 0.01)).tick(10);
        assert_eq!((tick.stiffness_nm_rad, tick.reason), (0.01, Reason::None));
        let mut coarse = re35(Law::Static, 1.0);
        coarse.hardware_count_rad = core::f64::consts::TAU / 20.0;
        let tick = controller(&coarse).tick(0);
        assert!((f64::from(tick.stiffness_nm_rad) - 4e-3 / coarse.count_rad()).abs() < 1e-8);
        assert_eq!(tick.reason, Reason::Coulomb);
    }

    #[test]
    fn the_margin_is_the_worst_over_the_speeds_the_counts_allow() {
        let mut stiff = controller(&re35(Law::Raw, 1.0));
        let m = |speed: f32| (9e-6 - 0.5e-3) * speed + (2e-3 - 0.5 * COUNT);
        let count_speed = COUNT / 1e-3;
        assert!((stiff.tick(0).margin_nm - m(count_speed)).abs() < 1e-8);
        // Moved by 3 counts, either way: between 2 and 4 counts per sample, 4 is worse.
        assert!((stiff.tick(3).margin_nm - m(4.0 * count_speed)).abs() < 1e-8);
        assert!((stiff.tick(0).margin_nm - m(4.0 * count_speed)).abs() < 1e-8);
        assert!((stiff.tick(0).margin_nm - m(count_speed)).abs() < 1e-8);
        // Where viscous friction wins, the slow end is worse.
        let mut soft = controller(&re35(Law::Raw, 0.01));
        soft.tick(0);
        let want = (9e-6 - 0.5e-5) * 2.0 * count_speed + (2e-3 - 0.005 * COUNT);
        assert!((soft.tick(3).margin_nm - want).abs() < 1e-8);
    }

    #[test]
    fn an_episode_remembers_its_worst_speed_until_zero_force() {
        let mut config = re35(Law::Episode, 1e3);
        config.side = Side::Above;
        let limit = |counts: f32| {
            let speed = counts * COUNT / 1e-3;
            2.0 * (9e-6 * speed + 2e-3) / (1e-3 * speed + COUNT)
        };
        let near = |have: f32, want: f32| (have / want - 1.0).abs() < 1e-5;
        let mut wall = controller(&config);
        // Free, at rest: all that a speed of up to one count per sample allows.
        wall.tick(0xFFFF_FF00);
        let tick = wall.tick(0xFFFF_FF00);
        assert!(near(tick.stiffness_nm_rad, limit(1.0)) && tick.reason == Reason::Speed);
        // In at 5 counts per sample, then slower: the stiffness stays.
        wall.tick(0xFFFF_FFF9);
        wall.tick(0xFFFF_FFFE);
        let hit = wall.tick(3);
        assert!(near(hit.stiffness_nm_rad, limit(6.0)) && hit.torque_nm < 0.0);
        for count in [5, 6, 6, 6, 5] {
            let tick = wall.tick(count);
            assert_eq!(
                (tick.stiffness_nm_rad, tick.reason),
                (hit.stiffness_nm_rad, Reason::Speed)
            );
        }
        // A faster moment lowers it further, zero force releases it.
        assert!(near(wall.tick(20).stiffness_nm_rad, limit(16.0)));
        assert!(near(wall.tick(0xFFFF_FFFF).stiffness_nm_rad, limit(22.0)));
        assert!(near(wall.tick(0xFFFF_FFFF).stiffness_nm_rad, limit(1.0)));
    }

    #[test]
    fn stiffness_falls_at_once_and_rises_at_zero_force() {
        let plan = |stiffness| Plan::new(&re35(Law::Raw, stiffness)).unwrap();
        let mut spring = Controller::new(plan(0.5), 0);
        assert_eq!(spring.tick(10).stiffness_nm_rad, 0.5);
        spring.adopt(plan(0.2));
        assert_eq!(spring.tick(10).stiffness_nm_rad, 0.2);
        spring.adopt(plan(0.9));
        let tick = spring.tick(12);
        assert_eq!(
            (tick.stiffness_nm_rad, tick.reason),
            (0.2, Reason::ZeroForce)
        );
        assert_eq!(spring.tick(0).stiffness_nm_rad, 0.9);
        // A spring that is moved is let go until the knob comes by its new centre.
        let mut moved = re35(Law::Raw, 0.9);
        moved.zero_rad = 20.0 * moved.count_rad();
        spring.adopt(Plan::new(&moved).unwrap());
        let tick = spring.tick(3);
        assert_eq!((tick.torque_nm, tick.reason), (0.0, Reason::ZeroForce));
        assert_eq!(spring.tick(20).stiffness_nm_rad, 0.9);
        // So is one that is released.
        spring.release();
        assert_eq!(spring.tick(25).torque_nm, 0.0);
    }

    #[test]
    fn the_torque_limit_holds_and_says_so() {
        let mut config = re35(Law::Raw, 100.0);
        config.torque_max_nm = 0.01;
        let mut spring = controller(&config);
        for count in [5000, -5000_i32 as u32] {
            let tick = spring.tick(count);
            assert_eq!((tick.torque_nm.abs(), tick.reason), (0.01, Reason::Torque));
        }
    }

    proptest! {
        /// Also after rounding to f32: what is applied does not exceed what is passive.
        #[test]
        fn the_static_law_stays_within_the_limits_in_exact_arithmetic(
            counts in 10.0..20_000.0f64, period_s in 4e-5..2e-2f64,
        ) {
            let mut config = re35(Law::Static, 1e3);
            config.hardware_count_rad = core::f64::consts::TAU / counts;
            config.period_s = period_s;
            let stiffness = f64::from(controller(&config).tick(0).stiffness_nm_rad);
            prop_assert!(stiffness * config.count_rad() <= 2.0 * 2e-3);
            prop_assert!(stiffness * period_s <= 2.0 * 9e-6);
        }

        #[test]
        fn stiffness_never_rises_under_load_nor_above_the_demand(
            law in prop::sample::select(vec![Law::Raw, Law::Static, Law::Episode]),
            demands in prop::collection::vec(0.0..20.0f64, 1..4),
            steps in prop::collection::vec(-40i32..40, 1..200), wall in any::<bool>(),
        ) {
            let plan = |demand| {
                let mut config = re35(law, demand);
                config.side = if wall { Side::Above } else { Side::Both };
                Plan::new(&config).unwrap()
            };
            let mut controller = Controller::new(plan(demands[0]), 0);
            let mut position = 0_i32;
            let mut before = controller.tick(0).stiffness_nm_rad;
            for (i, step) in steps.iter().enumerate() {
                let demand = demands[i * demands.len() / steps.len()];
                controller.adopt(plan(demand));
                position += step;
                let tick = controller.tick(position as u32);
                let loaded = if wall { position > 0 } else { !(-1..=0).contains(&position) };
                prop_assert!(!loaded || tick.stiffness_nm_rad <= before);
                prop_assert!(tick.stiffness_nm_rad <= demand as f32);
                prop_assert!(tick.torque_nm.abs() <= 0.5 && tick.margin_nm.is_finite());
                if law != Law::Raw {
                    prop_assert!(tick.stiffness_nm_rad <= 5.2153);
                }
                let less = tick.stiffness_nm_rad < demand as f32;
                prop_assert!(!less || tick.reason != Reason::None);
                before = tick.stiffness_nm_rad;
            }
        }
    }

    #[test]
    fn a_configuration_that_no_tick_may_run_with_is_refused() {
        for bad in [-1.0, f64::NAN, f64::INFINITY, 1e300] {
            assert!(Plan::new(&re35(Law::Static, bad)).is_err(), "{bad}");
            let mut config = re35(Law::Raw, 1.0);
            config.torque_max_nm = bad;
            assert!(Plan::new(&config).is_err(), "{bad}");
        }
        let mut config = re35(Law::Raw, 1.0);
        config.hardware_count_rad = 1e-60; // above zero, but not in f32
        assert!(Plan::new(&config).is_err());
        let mut config = re35(Law::Raw, 1.0);
        config.believed.coulomb_nm = Interval {
            low: 2e-3,
            high: 1e-3,
        };
        assert_eq!(
            Plan::new(&config).unwrap_err().to_string(),
            "Coulomb friction (Nm) is [0.002, 0.001]; accepted: finite, 0 or more, the lower end first"
        );
    }
}
