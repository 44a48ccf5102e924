//! One tick: a hardware count in, a torque out, and how passive that was.
//!
//! The tick has no error path: everything it takes was validated by [`Plan::new`]. It computes
//! in `f32` with + − × ÷ only, so host and chip agree to the last bit.
//!
//! *Raw, static, episode.* The torque is the profile's times a stiffness, which may fall in
//! any tick, but rises only at zero force: raising it by ΔK at a deflection q would add
//! ½ ΔK q² to the display. Zero force is the free side of a wall, or a cell that touches
//! the zero, where at most ½ ΔK Δ² is added.
//!
//! *Ledger.* The torque is what the account allows: see [`crate::ledger`].
//!
//! *Auto.* The plain spring where the demand is passive at every speed; the episode where it is
//! at the speeds of the moment; else the ledger. From the spring to the ledger the account begins
//! with what the spring stores, K·U(q), ⅛KΔ² less than the quantised potential (16), which
//! pays for what sampling may have made. Back to the spring only when the account holds all that
//! the spring could anywhere in its cell: S − |F − K·u|·w/2 ≥ K·(U(q) + ½Δ|u| + ⅛Δ²), u the torque and U
//! the potential over the stiffness.
//! So a change adds no energy, in contact or out of it.

use crate::config::Law;
use crate::encoder::Encoder;
use crate::ledger::Ledger;
use crate::margin::reachable_speed_rad_s;
use crate::motion::Motion;
use crate::plan::Plan;
use crate::real::smaller;
use crate::shape::Reading;

/// Why the stiffness or the torque is less than demanded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// It is not.
    None,
    /// Sampled too slowly for this viscous friction: 2b/Te.
    Viscous,
    /// Encoder too coarse for this Coulomb friction: 2c/Δ.
    Coulomb,
    /// Too fast in this contact: 2(b|ẋ| + c)/(Te|ẋ| + Δ).
    Speed,
    /// It may rise only at zero force, and waits for it.
    ZeroForce,
    /// The torque limit.
    Torque,
    /// Sampled too slowly for this inertia: m/Te².
    Inertia,
    /// Encoder too coarse for this Coulomb friction, under the ledger: 3c/Δ.
    Coarse,
    /// The account does not cover more.
    Account,
    /// A hand moved the knob as no believed force can; more is allowed for.
    Hand,
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
    /// The stiffness applied, Nm/rad: under the ledger, torque over deflection.
    pub stiffness_nm_rad: f32,
    /// The [margin](crate::margin) of the applied stiffness at the worst of the mean
    /// speeds that the counts of the last period allow, Nm; under raw, of the speed that
    /// the state can turn into. The first tick has seen no motion and answers for a knob that
    /// moves by less than a count. Below 0 the ledger pays.
    pub margin_nm: f32,
    /// The energy in the ledger's account, J; 0 under the other laws.
    pub account_j: f32,
    /// The law in force; under auto one of static, episode, ledger.
    pub law: Law,
    /// Why less is applied than demanded.
    pub reason: Reason,
}

/// A sampled spring, with the law that watches it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    plan: Plan,
    encoder: Encoder,
    applied_nm_rad: f32,
    /// The least that the margin allowed in this contact, Nm/rad.
    contact_limit_nm_rad: f32,
    /// A tick has run, so that the next one knows how far the knob moved.
    seen: bool,
    /// Under auto the law in force; else the plan's.
    in_force: Law,
    ledger: Ledger,
}

impl Controller {
    /// A controller for a knob that stands at `hardware_count` counts from zero now, and
    /// renders at once, also under load. How it moves is not known, so the ledger begins empty.
    #[must_use]
    pub fn new(plan: Plan, hardware_count: i32) -> Self {
        Self {
            plan,
            encoder: Encoder::new(plan.encoder(), hardware_count),
            applied_nm_rad: match plan.law {
                Law::Episode => smaller(plan.limit_nm_rad, plan.criterion.largest_stiffness()),
                _ => plan.limit_nm_rad,
            },
            contact_limit_nm_rad: plan.criterion.largest_stiffness(),
            seen: false,
            in_force: match plan.law {
                Law::Auto => Law::Ledger,
                law => law,
            },
            ledger: Ledger::new(&plan.ledger, 0.0, 0.0),
        }
    }

    /// The same for a knob that is known to be at rest: the ledger begins with what the spring
    /// stores under that load.
    #[must_use]
    pub fn at_rest(plan: Plan, hardware_count: i32) -> Self {
        let mut controller = Self::new(plan, hardware_count);
        let reading = plan.profile.read(controller.encoder.count());
        let stiffness = plan.ledger.stiffness;
        controller.ledger = Ledger::at_rest(
            &plan.ledger,
            stiffness * reading.pull_rad,
            stiffness * plan.profile.potential_rad2(&reading),
        );
        controller
    }

    /// Lets go: no torque until the knob passes zero force, or under the ledger until it has
    /// put energy in.
    pub fn release(&mut self) {
        self.applied_nm_rad = 0.0;
        self.ledger = Ledger::new(&self.plan.ledger, 0.0, 0.0);
        if self.plan.law == Law::Auto {
            self.in_force = Law::Ledger;
        }
    }

    /// Takes another plan with the same encoder and period. What is felt changes without a
    /// step upwards: see the module.
    pub fn adopt(&mut self, plan: Plan) {
        let old = self.plan;
        if plan.profile != old.profile {
            self.applied_nm_rad = 0.0;
        }
        // What this contact has allowed so far was found with other values.
        if plan.criterion != old.criterion || plan.law != old.law {
            self.contact_limit_nm_rad = plan.criterion.largest_stiffness();
        }
        let ledger_goes_on =
            self.in_force == Law::Ledger && plan.ledger.mechanics == old.ledger.mechanics;
        match plan.law {
            Law::Ledger | Law::Auto if !ledger_goes_on => {
                // Raw vouches for no energy; the others for what their spring stores.
                let reading = old.profile.read(self.encoder.count());
                let stored_j = match self.in_force {
                    Law::Static | Law::Episode => {
                        self.applied_nm_rad * old.profile.potential_rad2(&reading)
                    }
                    Law::Raw | Law::Ledger | Law::Auto => 0.0,
                };
                self.ledger = Ledger::new(&plan.ledger, self.ledger.held_nm, stored_j);
            }
            Law::Raw | Law::Static | Law::Episode if self.in_force == Law::Ledger => {
                self.applied_nm_rad = 0.0;
            }
            _ => {}
        }
        self.in_force = match plan.law {
            Law::Auto => Law::Ledger,
            law => law,
        };
        self.plan = plan;
    }

    /// Hardware counts from zero at the last tick, wrapped to 32 bits.
    #[must_use]
    pub fn hardware_count(&self) -> i32 {
        self.encoder.hardware_count()
    }

    /// Where the counts say that the knob is and how fast, as of the last tick; none where the
    /// law in force does not follow it.
    #[must_use]
    pub fn motion(&self) -> Option<&Motion> {
        (self.in_force == Law::Ledger).then_some(&self.ledger.motion)
    }

    /// The plan in force.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// One sample: takes the hardware counter and the time since the last sample (s, above 0),
    /// returns the torque to hold.
    pub fn tick(&mut self, hardware_counter: u32, duration_s: f32) -> Tick {
        let before = self.encoder.count();
        let count = self.encoder.update(hardware_counter);
        let moved = count.wrapping_sub(before);
        let reading = self.plan.profile.read(count);
        let counts = moved.unsigned_abs();
        let speed_step = self.plan.ledger.mechanics.count_rad / duration_s;
        let fast = counts.saturating_add(1) as f32 * speed_step;
        let seen = self.seen;
        self.seen = true;
        let (torque, stiffness, reason) = match self.plan.law {
            Law::Raw | Law::Static | Law::Episode => {
                self.clamped(&reading, fast, seen, moved, speed_step)
            }
            Law::Ledger => self.ledgered(&reading, seen, moved, duration_s, speed_step),
            Law::Auto => {
                self.automatic(&reading, before, fast, seen, moved, duration_s, speed_step)
            }
        };
        let plan = &self.plan;
        let fast = if plan.law == Law::Raw {
            let mobility = plan.ledger.mechanics.mobility;
            reachable_speed_rad_s(fast, stiffness, reading.pull_rad, mobility)
        } else {
            fast
        };
        let slow = counts.saturating_sub(1) as f32 * speed_step;
        Tick {
            count,
            moved,
            torque_nm: torque,
            stiffness_nm_rad: stiffness,
            margin_nm: plan.criterion.worst_power_margin_nm(stiffness, slow, fast),
            account_j: if self.in_force == Law::Ledger {
                self.ledger.account_j
            } else {
                0.0
            },
            law: self.in_force,
            reason,
        }
    }

    /// The raw, the static and the episode law.
    #[inline]
    fn clamped(
        &mut self,
        reading: &Reading,
        fast: f32,
        seen: bool,
        moved: i32,
        speed_step: f32,
    ) -> (f32, f32, Reason) {
        let plan = &self.plan;
        let zero_force =
            reading.free || reading.deflection_rad.abs() <= plan.ledger.mechanics.half_count_rad;
        let mut target = plan.limit_nm_rad;
        let mut reason = plan.limit_reason;
        if plan.law == Law::Episode {
            // Where 2b/Te < 2c/Δ the limit falls with speed, so the fast end is the worse
            // one; else it never falls below 2c/Δ, which the target keeps to anyway.
            let now = if seen {
                plan.criterion.largest_stiffness_at(fast)
            } else {
                plan.criterion.largest_stiffness()
            };
            if (zero_force && seen) || now < self.contact_limit_nm_rad {
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
        let stiffness = self.applied_nm_rad;
        let (torque, limited) = self.spring_torque(reading, moved, speed_step);
        self.ledger.held_nm = torque;
        (
            torque,
            stiffness,
            if limited { Reason::Torque } else { reason },
        )
    }

    /// The profile's torque at the applied stiffness, with as much virtual damping as the stiffness
    /// leaves room for, within the torque limit; true if that acts.
    #[inline]
    fn spring_torque(&self, reading: &Reading, moved: i32, speed_step: f32) -> (f32, bool) {
        let plan = &self.plan;
        let stiffness = self.applied_nm_rad;
        let mut torque = stiffness * reading.pull_rad;
        if plan.demanded_damping > 0.0 && !reading.free {
            let damping = match plan.law {
                Law::Raw => plan.demanded_damping,
                _ => smaller(plan.demanded_damping, plan.damping_limit(stiffness)),
            };
            torque -= damping * (moved as f32 * speed_step);
        }
        let most = plan.torque_max_nm;
        let limited = torque.abs() > most;
        if limited {
            torque = if torque > 0.0 { most } else { -most };
        }
        if plan.law != Law::Raw {
            torque = plan.ledger.cut(torque);
        }
        (torque, limited)
    }

    /// The ledger.
    #[inline]
    fn ledgered(
        &mut self,
        reading: &Reading,
        seen: bool,
        moved: i32,
        duration_s: f32,
        speed_step: f32,
    ) -> (f32, f32, Reason) {
        let plan = &self.plan;
        if seen {
            self.ledger.enter(&plan.ledger, moved as f32, duration_s);
        }
        self.ledger.account(
            &plan.ledger,
            &plan.tuning(),
            moved,
            duration_s,
            plan.ledger.stiffness * reading.pull_rad,
        );
        self.ledger_torque(reading, moved, speed_step)
    }

    #[inline]
    fn ledger_torque(
        &mut self,
        reading: &Reading,
        moved: i32,
        speed_step: f32,
    ) -> (f32, f32, Reason) {
        let plan = &self.plan.ledger;
        let mut wanted = plan.stiffness * reading.pull_rad;
        let spring = wanted;
        if plan.damping > 0.0 && !reading.free {
            wanted -= plan.damping * (moved as f32 * speed_step);
        }
        let (torque, reason) = self.ledger.torque(plan, &self.plan.tuning(), moved, wanted);
        // Less than the whole torque is less than the whole stiffness.
        let stiffness = if torque.abs() < spring.abs() {
            torque / reading.pull_rad
        } else {
            plan.stiffness
        };
        self.applied_nm_rad = stiffness;
        (
            torque,
            if stiffness > 0.0 { stiffness } else { 0.0 },
            reason,
        )
    }

    /// The cheapest law that applies the whole demand, or the ledger.
    #[inline]
    #[expect(clippy::too_many_arguments)]
    fn automatic(
        &mut self,
        reading: &Reading,
        before: i32,
        fast: f32,
        seen: bool,
        moved: i32,
        duration_s: f32,
        speed_step: f32,
    ) -> (f32, f32, Reason) {
        let plan = &self.plan;
        let demanded = plan.demanded_nm_rad();
        // The static limit holds the whole demand; or that of the speeds of the moment does.
        let plain = plan.limit_reason == Reason::None;
        let cheap = plain
            || (plan.episode_may_do
                && seen
                && demanded <= plan.criterion.largest_stiffness_at(fast));
        let spring_law = if plain { Law::Static } else { Law::Episode };
        if self.in_force != Law::Ledger {
            if !plain {
                self.ledger.enter(&plan.ledger, moved as f32, duration_s);
            }
            if cheap {
                return self.plain_spring(spring_law, reading, moved, speed_step);
            }
            // The speed has grown beyond what the spring is good for: the ledger takes over, as
            // of the last tick, with what the spring stored.
            let stored =
                self.applied_nm_rad * plan.profile.potential_rad2(&plan.profile.read(before));
            self.ledger.take_over(&plan.ledger, stored);
            self.in_force = Law::Ledger;
        } else if seen {
            self.ledger.enter(&plan.ledger, moved as f32, duration_s);
        }
        let plan = &self.plan;
        self.ledger.account(
            &plan.ledger,
            &plan.tuning(),
            moved,
            duration_s,
            plan.ledger.stiffness * reading.pull_rad,
        );
        if cheap && seen {
            // The potential anywhere in the cell, at most.
            let half = plan.ledger.mechanics.half_count_rad;
            let stores = if reading.free {
                0.0
            } else {
                demanded
                    * (plan.profile.potential_rad2(reading)
                        + half * (reading.pull_rad.abs() + 0.5 * half))
            };
            if self.ledger.covers(stores, demanded * reading.pull_rad) {
                self.in_force = spring_law;
                return self.plain_spring(spring_law, reading, moved, speed_step);
            }
        }
        self.ledger_torque(reading, moved, speed_step)
    }

    #[inline]
    fn plain_spring(
        &mut self,
        law: Law,
        reading: &Reading,
        moved: i32,
        speed_step: f32,
    ) -> (f32, f32, Reason) {
        self.in_force = law;
        self.applied_nm_rad = self.plan.demanded_nm_rad();
        let (torque, limited) = self.spring_torque(reading, moved, speed_step);
        self.ledger.hold(&self.plan.ledger, torque);
        (
            torque,
            self.applied_nm_rad,
            if limited {
                Reason::Torque
            } else {
                Reason::None
            },
        )
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
