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
//! pays for what sampling may have made.
//! Back to the spring only where it starts with nothing: on the free side of a wall; for
//! a spring that is passive at every speed in the cell of its zero, as under static; else at rest where
//! friction holds its whole torque, K·(|q| + Δ/2) ≤ c, so that what it stores is no more than what friction
//! takes on the way back. So a change adds no energy, in contact or out of it. (An account below 0
//! says how much is uncertain, not that it was given out.)

use crate::config::Law;
use crate::encoder::Encoder;
use crate::ledger::Ledger;
use crate::margin::reachable_speed_rad_s;
use crate::motion::{Interval, Motion};
use crate::plan::Plan;
use crate::real::{larger, smaller};
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
    /// The plan's torque limit as it was made, Nm; the plan here has the one in force.
    torque_max_nm: f32,
    encoder: Encoder,
    applied_nm_rad: f32,
    /// The least that the margin allowed in this contact, Nm/rad.
    contact_limit_nm_rad: f32,
    /// A tick has run, so that the next one knows how far the knob moved.
    seen: bool,
    /// Under auto the law in force; else the plan's.
    in_force: Law,
    /// What the spring that follows the ledger stored when it began, which nobody has put in, J.
    unpaid_j: f32,
    ledger: Ledger,
}

impl Controller {
    /// A controller for a knob that stands at `hardware_count` counts from zero now, and
    /// renders at once, also under load. How it moves is not known, so the ledger begins empty.
    #[must_use]
    pub fn new(plan: Plan, hardware_count: i32) -> Self {
        Self {
            plan,
            torque_max_nm: plan.torque_max_nm,
            encoder: Encoder::new(plan.encoder(), hardware_count),
            applied_nm_rad: match plan.law {
                Law::Episode => smaller(plan.limit_nm_rad, plan.criterion.largest_stiffness()),
                _ => plan.limit_nm_rad,
            },
            contact_limit_nm_rad: plan.criterion.largest_stiffness(),
            seen: false,
            in_force: match plan.law {
                Law::Auto if plan.limit_reason == Reason::None => Law::Static,
                Law::Auto => Law::Ledger,
                law => law,
            },
            unpaid_j: 0.0,
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

    /// Sets the torque limit of the next tick (Nm; below 0 or not a number counts as 0), at most the plan's, and
    /// returns it. It falls at once. It rises where that adds no energy: under the ledger in any tick; to a
    /// spring where no torque between here and its zero is cut, so that what it stores stays the same.
    pub fn limit_torque(&mut self, most_nm: f32) -> f32 {
        let wanted_nm = smaller(larger(0.0, most_nm), self.torque_max_nm);
        let now_nm = self.plan.torque_max_nm;
        if wanted_nm < now_nm || self.in_force == Law::Ledger || self.cuts_nothing(now_nm) {
            self.plan.limit_torque(wanted_nm);
        }
        self.plan.torque_max_nm
    }

    /// [`Self::limit_torque`] at a part of the plan's limit; returns the part in force, 1 where it is all.
    pub fn raise_torque(&mut self, part: f32) -> f32 {
        let full_nm = self.torque_max_nm;
        let limit_nm = self.limit_torque(if part < 1.0 { part * full_nm } else { full_nm });
        if limit_nm < full_nm {
            limit_nm / full_nm
        } else {
            1.0
        }
    }

    /// Whether the spring in force stays within a torque from its zero to where the knob is.
    fn cuts_nothing(&self, torque_nm: f32) -> bool {
        let reading = self.plan.profile.read(self.encoder.count());
        // Of a detent too: sin x ≤ x.
        self.plan.at_zero_force(&reading)
            || self.applied_nm_rad * reading.deflection_rad.abs() <= torque_nm
    }

    /// Takes another plan with the same encoder and period. What is felt changes without a
    /// step upwards: see the module. A torque limit that was rising goes on from where it is.
    pub fn adopt(&mut self, mut plan: Plan) {
        let old = self.plan;
        let rising = old.torque_max_nm < self.torque_max_nm;
        self.torque_max_nm = plan.torque_max_nm;
        if rising {
            plan.limit_torque(smaller(old.torque_max_nm, plan.torque_max_nm));
        }
        // Raw vouches for no energy; the others for what was put into their spring.
        let stored_j = match self.in_force {
            Law::Static | Law::Episode => self.stored_j(self.encoder.count()),
            Law::Raw | Law::Ledger | Law::Auto => 0.0,
        };
        if plan.profile != old.profile || self.in_force == Law::Ledger {
            self.applied_nm_rad = 0.0;
        }
        // What this contact has allowed so far was found with other values.
        if plan.criterion != old.criterion || plan.law != old.law {
            self.contact_limit_nm_rad = plan.criterion.largest_stiffness();
        }
        let goes_on = self.in_force == Law::Ledger && plan.ledger.mechanics == old.ledger.mechanics;
        if !goes_on {
            self.ledger = Ledger::new(&plan.ledger, self.ledger.held_nm, stored_j);
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

    /// The decimated count at the last tick.
    #[must_use]
    pub fn count(&self) -> i32 {
        self.encoder.count()
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
        let tick = match self.plan.law {
            Law::Static => self.fixed(count, moved, duration_s),
            Law::Raw | Law::Episode => self.clamped(count, moved, duration_s),
            Law::Ledger => self.ledgered(count, moved, duration_s),
            Law::Auto => self.automatic(count, moved, duration_s),
        };
        self.seen = true;
        tick
    }

    /// What this tick sees of the time since the last.
    #[inline(always)]
    fn look(&self, count: i32, moved: i32, duration_s: f32) -> Step {
        let rate = 1.0 / duration_s;
        let count_speed = self.plan.ledger.mechanics.count_rad * rate;
        let counts = moved as f32;
        Step {
            count,
            moved,
            interval: Interval {
                counts,
                duration_s,
                rate,
                fast: (counts.abs() + 1.0) * count_speed,
            },
            count_speed,
            speed: counts.abs() * count_speed,
            seen: self.seen,
            reading: self.plan.profile.read(count),
        }
    }

    /// The tick that gives a torque under a law. `fast`: the fastest of the speeds that it
    /// answers for, rad/s.
    #[inline(always)]
    fn told(&self, step: &Step, fast: f32, law: Law, torque_nm: f32, reason: Reason) -> Tick {
        let stiffness = self.applied_nm_rad;
        Tick {
            count: step.count,
            moved: step.moved,
            torque_nm,
            stiffness_nm_rad: stiffness,
            margin_nm: self
                .plan
                .criterion
                .worst_power_margin_nm(stiffness, step.slow(), fast),
            account_j: if law == Law::Ledger {
                self.ledger.account_j
            } else {
                0.0
            },
            law,
            reason,
        }
    }

    /// The static law. Its stiffness is at most 2b/Te, so the slow end of the speeds is the worse
    /// one for the margin.
    #[inline(always)]
    fn fixed(&mut self, count: i32, moved: i32, duration_s: f32) -> Tick {
        let plan = &self.plan;
        let reading = plan.profile.read(count);
        let counts = moved as f32;
        let slow = if counts.abs() > 1.0 {
            (counts.abs() - 1.0) * plan.ledger.mechanics.count_rad / duration_s
        } else {
            0.0
        };
        let (mut stiffness, mut reason) = (plan.limit_nm_rad, plan.limit_reason);
        if stiffness > self.applied_nm_rad && !plan.at_zero_force(&reading) {
            stiffness = self.applied_nm_rad;
            reason = Reason::ZeroForce;
        }
        self.applied_nm_rad = stiffness;
        let mut torque_nm = stiffness * reading.pull_rad;
        if torque_nm.abs() > plan.bare_up_to_nm {
            let velocity = counts * plan.ledger.mechanics.count_rad / duration_s;
            let limited;
            (torque_nm, limited) = self.dressed(torque_nm, velocity, reading.free);
            if limited {
                reason = Reason::Torque;
            }
        }
        self.ledger.held_nm = torque_nm;
        Tick {
            count,
            moved,
            torque_nm,
            stiffness_nm_rad: stiffness,
            margin_nm: self.plan.criterion.power_margin_nm(stiffness, slow),
            account_j: 0.0,
            law: Law::Static,
            reason,
        }
    }

    /// The raw and the episode law.
    #[inline(never)]
    fn clamped(&mut self, count: i32, moved: i32, duration_s: f32) -> Tick {
        let step = self.look(count, moved, duration_s);
        let plan = &self.plan;
        let mut target = plan.limit_nm_rad;
        let mut reason = plan.limit_reason;
        if plan.law == Law::Episode {
            // Where 2b/Te < 2c/Δ the limit falls with speed, so the fast end is the worse
            // one; else it never falls below 2c/Δ, which the target keeps to anyway.
            let now = if step.seen {
                plan.criterion.largest_stiffness_at(step.fast())
            } else {
                plan.criterion.largest_stiffness()
            };
            if (step.seen && self.plan.at_zero_force(&step.reading))
                || now < self.contact_limit_nm_rad
            {
                self.contact_limit_nm_rad = now;
            }
            if self.contact_limit_nm_rad < target {
                target = self.contact_limit_nm_rad;
                reason = Reason::Speed;
            }
        }
        if target <= self.applied_nm_rad || self.plan.at_zero_force(&step.reading) {
            self.applied_nm_rad = target;
        } else {
            reason = Reason::ZeroForce;
        }
        let (torque, limited) = self.spring_torque(&step);
        if limited {
            reason = Reason::Torque;
        }
        self.ledger.held_nm = torque;
        let plan = &self.plan;
        let fast = if plan.law == Law::Raw {
            let mobility = plan.ledger.mechanics.mobility;
            let stiffness = self.applied_nm_rad;
            reachable_speed_rad_s(step.fast(), stiffness, step.reading.pull_rad, mobility)
        } else {
            step.fast()
        };
        self.told(&step, fast, plan.law, torque, reason)
    }

    /// The profile's torque at the applied stiffness, with as much virtual damping as the stiffness
    /// leaves room for, within the torque limit; and whether that acts.
    #[inline(always)]
    fn spring_torque(&self, step: &Step) -> (f32, bool) {
        let plan = &self.plan;
        let torque = self.applied_nm_rad * step.reading.pull_rad;
        if torque.abs() <= plan.bare_up_to_nm {
            return (torque, false);
        }
        let velocity = step.interval.counts * step.count_speed;
        self.dressed(torque, velocity, step.reading.free)
    }

    /// A torque with virtual damping, but on the free side of a wall, within its limit; and
    /// whether that acts.
    #[inline(never)]
    fn dressed(&self, torque_nm: f32, velocity: f32, free: bool) -> (f32, bool) {
        let damped = if free {
            torque_nm
        } else {
            self.damped(torque_nm, velocity)
        };
        let limited = damped.abs() > self.plan.torque_max_nm;
        (self.given(damped), limited)
    }

    /// A torque with virtual damping.
    #[inline(never)]
    fn damped(&self, torque_nm: f32, velocity: f32) -> f32 {
        let plan = &self.plan;
        let most = match plan.law {
            Law::Raw => plan.demanded_damping,
            _ => plan.damping_limit(self.applied_nm_rad),
        };
        torque_nm - smaller(plan.demanded_damping, most) * velocity
    }

    /// A torque within its limit, in the DAC's steps but under raw.
    #[inline(never)]
    fn given(&self, torque_nm: f32) -> f32 {
        let plan = &self.plan;
        let most = plan.torque_max_nm;
        let torque = if torque_nm > most {
            most
        } else if torque_nm < -most {
            -most
        } else {
            torque_nm
        };
        if plan.law == Law::Raw {
            torque
        } else {
            plan.ledger.cut(torque)
        }
    }

    /// The ledger.
    #[inline(never)]
    fn ledgered(&mut self, count: i32, moved: i32, duration_s: f32) -> Tick {
        let step = self.look(count, moved, duration_s);
        let plan = &self.plan.ledger;
        let tuning = self.plan.tuning();
        let spring = plan.stiffness * step.reading.pull_rad;
        if step.seen {
            self.ledger.enter(plan, &tuning, &step.interval);
        }
        let ahead = self.ledger.account(plan, &tuning, &step.interval, spring);
        let mut wanted = spring;
        if plan.damping > 0.0 && !step.reading.free {
            wanted -= plan.damping * (step.interval.counts * step.count_speed);
        }
        let (torque, reason) =
            self.ledger
                .torque(plan, &tuning, &ahead, step.interval.counts, wanted);
        // Less than the whole torque is less than the whole stiffness.
        self.applied_nm_rad = if torque.abs() < spring.abs() {
            let stiffness = torque / step.reading.pull_rad;
            if stiffness > 0.0 { stiffness } else { 0.0 }
        } else {
            plan.stiffness
        };
        self.told(&step, step.fast(), Law::Ledger, torque, reason)
    }

    /// The cheapest law that applies the whole demand, or the ledger.
    #[inline(never)]
    fn automatic(&mut self, count: i32, moved: i32, duration_s: f32) -> Tick {
        let step = self.look(count, moved, duration_s);
        let plan = &self.plan;
        // The static limit holds the whole demand; or that of the speeds of the moment does.
        let plain = plan.limit_reason == Reason::None;
        let episode = plan.episode_may_do
            && step.seen
            && plan.demanded_nm_rad() <= plan.criterion.largest_stiffness_at(step.fast());
        if plain || episode {
            if self.in_force != Law::Ledger || self.may_hand_over(plain, &step) {
                if self.in_force == Law::Ledger {
                    self.unpaid_j = self.unpaid_j(&step);
                }
                self.in_force = if plain { Law::Static } else { Law::Episode };
                self.applied_nm_rad = self.plan.demanded_nm_rad();
                let (torque, limited) = self.spring_torque(&step);
                let reason = if limited {
                    Reason::Torque
                } else {
                    Reason::None
                };
                self.ledger.held_nm = torque;
                return self.told(&step, step.fast(), self.in_force, torque, reason);
            }
        } else if self.in_force != Law::Ledger {
            // The speed has grown beyond what the spring is good for: the ledger takes over, as
            // of the last tick, with what the spring stored.
            let stored_j = self.stored_j(count.wrapping_sub(moved));
            self.ledger = Ledger::new(&self.plan.ledger, self.ledger.held_nm, stored_j);
            self.in_force = Law::Ledger;
        }
        self.ledgered(count, moved, duration_s)
    }

    /// Whether the spring may follow the ledger: see the module.
    #[inline]
    fn may_hand_over(&self, plain: bool, step: &Step) -> bool {
        let mechanics = &self.plan.ledger.mechanics;
        let furthest = step.reading.deflection_rad.abs() + mechanics.half_count_rad;
        step.reading.free
            || (plain && furthest <= mechanics.count_rad)
            || (step.seen
                && step.moved == 0
                && self.plan.demanded_nm_rad() * furthest <= mechanics.coulomb_low)
    }

    /// What a spring that follows the ledger stores at the most when it begins, J.
    #[inline]
    fn unpaid_j(&self, step: &Step) -> f32 {
        if step.reading.free {
            return 0.0;
        }
        let half = self.plan.ledger.mechanics.half_count_rad;
        let furthest = step.reading.deflection_rad.abs() + half;
        0.5 * self.plan.demanded_nm_rad() * (furthest * furthest)
    }

    /// What was put into the spring in force, at a count, J: at least. Where the torque limit cuts, the torque rises
    /// to it and stays there, so that at least half of limit times deflection was put in; of a detent too, as
    /// its torque is concave from the minimum to the top.
    fn stored_j(&self, count: i32) -> f32 {
        let profile = &self.plan.profile;
        let reading = profile.read(count);
        let all = smaller(
            self.applied_nm_rad * profile.potential_rad2(&reading),
            0.5 * self.plan.torque_max_nm * reading.deflection_rad.abs(),
        );
        let paid = all - self.unpaid_j;
        if paid > 0.0 { paid } else { 0.0 }
    }
}

/// What a tick sees of the time since the last.
#[derive(Clone, Copy)]
struct Step {
    /// The count.
    count: i32,
    /// Counts moved.
    moved: i32,
    interval: Interval,
    /// The speed of one count in that time, rad/s.
    count_speed: f32,
    /// The mean speed of the counts, rad/s.
    speed: f32,
    /// There was a last tick.
    seen: bool,
    reading: Reading,
}

impl Step {
    /// The slowest mean speed that the counts allow, rad/s.
    #[inline(always)]
    fn slow(&self) -> f32 {
        let slow = self.speed - self.count_speed;
        if slow > 0.0 { slow } else { 0.0 }
    }

    /// The fastest.
    #[inline(always)]
    fn fast(&self) -> f32 {
        self.interval.fast
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Believed, Config, Interval, Timing};
    use crate::encoder::EncoderConfig;
    use crate::shape::Shape;
    use proptest::prelude::*;

    const COUNT: f32 = core::f32::consts::TAU / 8192.0;
    const PERIOD: f32 = 1e-3;
    const SPRING: Shape = Shape::Spring { centre_rad: 0.0 };
    const WALL: Shape = Shape::Wall { edge_rad: 0.0 };

    fn re35(law: Law, shape: Shape, stiffness_nm_rad: f64) -> Config {
        Config {
            believed: Believed {
                inertia_kg_m2: Interval::exactly(6.28e-6),
                viscous_nm_s_rad: Interval::exactly(9e-6),
                coulomb_nm: Interval::exactly(2e-3),
            },
            timing: Timing::ideal(1e-3),
            torque_step_nm: 0.0,
            hardware_count_rad: core::f64::consts::TAU / 8192.0,
            encoder: EncoderConfig::new(16, 1).unwrap(),
            shape,
            stiffness_nm_rad,
            damping_nm_s_rad: 0.0,
            law,
            torque_max_nm: 0.5,
        }
    }

    fn plan(config: &Config) -> Plan {
        Plan::new(config).unwrap()
    }

    fn controller(config: &Config) -> Controller {
        Controller::new(plan(config), 0)
    }

    /// A tick of the nominal period.
    fn tick(controller: &mut Controller, count: i32) -> Tick {
        controller.tick(count as u32, PERIOD)
    }

    #[test]
    fn raw_applies_the_demand_and_static_what_is_passive_at_every_speed() {
        let first = |config: &Config, count| tick(&mut controller(config), count);
        let raw = first(&re35(Law::Raw, SPRING, 1.0), 10);
        assert_eq!((raw.stiffness_nm_rad, raw.reason), (1.0, Reason::None));
        assert!((raw.torque_nm + 10.5 * COUNT).abs() < 1e-8);
        for law in [Law::Static, Law::Auto] {
            let soft = first(&re35(law, SPRING, 0.01), 10);
            assert_eq!((soft.stiffness_nm_rad, soft.reason), (0.01, Reason::None));
            assert_eq!(soft.law, Law::Static);
        }
        let fixed = first(&re35(Law::Static, SPRING, 1.0), 10);
        assert!((fixed.stiffness_nm_rad - 0.018).abs() < 1e-8);
        assert_eq!(fixed.reason, Reason::Viscous);
        assert!((fixed.torque_nm + 0.018 * 10.5 * COUNT).abs() < 1e-8);
        let mut coarse = re35(Law::Static, SPRING, 1.0);
        coarse.hardware_count_rad = core::f64::consts::TAU / 20.0;
        let fixed = first(&coarse, 0);
        assert!((f64::from(fixed.stiffness_nm_rad) - 4e-3 / coarse.count_rad()).abs() < 1e-8);
        assert_eq!(fixed.reason, Reason::Coulomb);
    }

    #[test]
    fn the_margin_is_the_worst_over_the_speeds_the_counts_allow() {
        // On the free side of a wall only the counts' speed tells.
        let at = Shape::Wall { edge_rad: 1.0 };
        let mut stiff = controller(&re35(Law::Raw, at, 1.0));
        let m = |speed: f32| (9e-6 - 0.5e-3) * speed + (2e-3 - 0.5 * COUNT);
        let count_speed = COUNT / PERIOD;
        let margin = |stiff: &mut Controller, count| tick(stiff, count).margin_nm;
        let step = stiff.plan.profile.step_counts() as f32;
        let m = |speed: f32| m(speed) - 0.5 * COUNT * (step - 1.0);
        assert!((margin(&mut stiff, 0) - m(count_speed)).abs() < 1e-8);
        // Moved by 3 counts, either way: between 2 and 4 counts per sample, 4 is worse.
        assert!((margin(&mut stiff, 3) - m(4.0 * count_speed)).abs() < 1e-8);
        assert!((margin(&mut stiff, 0) - m(4.0 * count_speed)).abs() < 1e-8);
        assert!((margin(&mut stiff, 0) - m(count_speed)).abs() < 1e-8);
        // Where viscous friction wins, the slow end is worse.
        let mut soft = controller(&re35(Law::Raw, SPRING, 0.01));
        let _ = tick(&mut soft, 0);
        let want = (9e-6 - 0.5e-5) * 2.0 * count_speed + (2e-3 - 0.005 * COUNT);
        assert!((margin(&mut soft, 3) - want).abs() < 1e-8);
        // At rest under load it answers for the speed that the load can turn into.
        let mut loaded = controller(&re35(Law::Raw, SPRING, 1.0));
        let reached = (count_speed.powi(2) + (26.5 * COUNT).powi(2) / 6.28e-6).sqrt();
        let want = (9e-6 - 0.5e-3) * reached + (2e-3 - 0.5 * COUNT);
        let _ = tick(&mut loaded, 26);
        assert!((margin(&mut loaded, 26) - want).abs() < 1e-8);
    }

    #[test]
    fn an_episode_remembers_its_worst_speed_until_zero_force() {
        let config = re35(Law::Episode, WALL, 1e3);
        let limit = |counts: f32| {
            let speed = counts * COUNT / PERIOD;
            2.0 * (9e-6 * speed + 2e-3) / (1e-3 * speed + COUNT)
        };
        let near = |have: f32, want: f32| (have / want - 1.0).abs() < 1e-5;
        let mut wall = controller(&config);
        // Free, at rest: all that a speed of up to one count per sample allows.
        let _ = tick(&mut wall, -256);
        let free = tick(&mut wall, -256);
        assert!(near(free.stiffness_nm_rad, limit(1.0)) && free.reason == Reason::Speed);
        // In at 5 counts per sample, then slower: the stiffness stays.
        let _ = tick(&mut wall, -7);
        let _ = tick(&mut wall, -2);
        let hit = tick(&mut wall, 3);
        assert!(near(hit.stiffness_nm_rad, limit(6.0)) && hit.torque_nm < 0.0);
        for count in [5, 6, 6, 6, 5] {
            let slower = tick(&mut wall, count);
            assert_eq!(
                (slower.stiffness_nm_rad, slower.reason),
                (hit.stiffness_nm_rad, Reason::Speed)
            );
        }
        // A faster moment lowers it further, zero force releases it.
        assert!(near(tick(&mut wall, 20).stiffness_nm_rad, limit(16.0)));
        assert!(near(tick(&mut wall, -1).stiffness_nm_rad, limit(22.0)));
        assert!(near(tick(&mut wall, -1).stiffness_nm_rad, limit(1.0)));
    }

    #[test]
    fn stiffness_falls_at_once_and_rises_at_zero_force() {
        let raw = |stiffness| plan(&re35(Law::Raw, SPRING, stiffness));
        let mut spring = Controller::new(raw(0.5), 0);
        assert_eq!(tick(&mut spring, 10).stiffness_nm_rad, 0.5);
        spring.adopt(raw(0.2));
        assert_eq!(tick(&mut spring, 10).stiffness_nm_rad, 0.2);
        spring.adopt(raw(0.9));
        let later = tick(&mut spring, 12);
        assert_eq!(
            (later.stiffness_nm_rad, later.reason),
            (0.2, Reason::ZeroForce)
        );
        assert_eq!(tick(&mut spring, 0).stiffness_nm_rad, 0.9);
        // A spring that is moved is let go until the knob comes by its new centre.
        let mut moved = re35(Law::Raw, SPRING, 0.9);
        moved.shape = Shape::Spring {
            centre_rad: 20.0 * moved.count_rad(),
        };
        spring.adopt(plan(&moved));
        let later = tick(&mut spring, 3);
        assert_eq!((later.torque_nm, later.reason), (0.0, Reason::ZeroForce));
        assert_eq!(tick(&mut spring, 20).stiffness_nm_rad, 0.9);
        // So is one that is released.
        spring.release();
        assert_eq!(tick(&mut spring, 25).torque_nm, 0.0);
    }

    #[test]
    fn the_torque_limit_holds_and_says_so() {
        let mut config = re35(Law::Raw, SPRING, 100.0);
        config.torque_max_nm = 0.01;
        let mut spring = controller(&config);
        for count in [5000, -5000] {
            let tick = tick(&mut spring, count);
            assert_eq!((tick.torque_nm.abs(), tick.reason), (0.01, Reason::Torque));
        }
    }

    proptest! {
        /// ∫ min(K f, limit) from the zero to where the knob is.
        #[test]
        fn a_spring_under_a_limit_stores_no_more_than_was_put_in(
            detent in any::<bool>(),
            stiffness in 0.01..2.0f64,
            limit_nm in 1e-4..0.1f32,
            count in -130..130_i32,
        ) {
            let period_rad = 0.2;
            let shape = if detent {
                Shape::Detent { centre_rad: 0.0, period_rad }
            } else {
                SPRING
            };
            let mut controller = controller(&re35(Law::Raw, shape, stiffness));
            prop_assert_eq!(controller.limit_torque(limit_nm), limit_nm);
            let reading = controller.plan.profile.read(count);
            let way = f64::from(reading.deflection_rad.abs());
            let torque = |x: f64| {
                let turn = core::f64::consts::TAU / period_rad;
                let pull = if detent { (turn * x).sin() / turn } else { x };
                (stiffness * pull).min(f64::from(limit_nm))
            };
            let steps = 2_000;
            let step = way / f64::from(steps);
            let put_in: f64 = (0..steps).map(|i| torque((f64::from(i) + 0.5) * step) * step).sum();
            let stored = f64::from(controller.stored_j(count));
            prop_assert!(stored <= put_in * (1.0 + 1e-4), "{stored:e} of {put_in:e}");
            prop_assert!(stored >= 0.49 * put_in, "{stored:e} of {put_in:e}");
        }
    }

    #[test]
    fn torques_are_cut_to_whole_steps_and_raw_is_not() {
        for (law, torque) in [(Law::Raw, -2.5 * COUNT * 0.01), (Law::Static, -1e-5)] {
            let mut config = re35(law, SPRING, 0.01);
            config.torque_step_nm = 1e-5;
            let have = tick(&mut controller(&config), 2).torque_nm;
            assert!((have - torque).abs() < 1e-9, "{law:?}: {have}");
        }
        // Steps finer than a float are none.
        let mut config = re35(Law::Static, SPRING, 0.01);
        config.torque_step_nm = 1e-30;
        assert!((tick(&mut controller(&config), 2).torque_nm + 2.5e-2 * COUNT).abs() < 1e-9);
    }

    #[test]
    fn damping_gets_what_the_stiffness_leaves() {
        let damped = |law, stiffness, counts| {
            let mut config = re35(law, SPRING, stiffness);
            config.damping_nm_s_rad = 1.0;
            config.torque_max_nm = 1e9;
            let mut spring = controller(&config);
            let _ = tick(&mut spring, 0);
            let torque = tick(&mut spring, counts).torque_nm;
            let speed = counts as f32 * COUNT / PERIOD;
            -(torque + spring.applied_nm_rad * (counts as f32 + 0.5) * COUNT) / speed
        };
        let near = |have: f32, want: f32| (have / want - 1.0).abs() < 1e-3;
        assert!(near(damped(Law::Raw, 0.01, 5), 1.0));
        // b − K·T/2, here less than (c − K·Δ/2)·T/Δ.
        assert!(near(damped(Law::Static, 0.01, 5), 9e-6 - 0.5e-5));
        assert!(near(damped(Law::Static, 0.0, 5), 9e-6));
        assert!(damped(Law::Static, 1.0, 5).abs() < 1e-9);
        // On a coarse encoder (c − K·Δ/2)·T/Δ.
        let mut coarse = re35(Law::Static, SPRING, 0.0);
        coarse.hardware_count_rad = core::f64::consts::TAU / 20.0;
        coarse.damping_nm_s_rad = 1.0;
        let mut spring = controller(&coarse);
        let _ = tick(&mut spring, 0);
        // One count a period, so c.
        assert!(near(-tick(&mut spring, 1).torque_nm, 2e-3));
    }

    #[test]
    fn the_ledger_gives_out_no_more_than_was_put_in() {
        let mut config = re35(Law::Ledger, WALL, 1e6);
        config.torque_max_nm = 1e9;
        let mut wall = controller(&config);
        for count in -20..0 {
            let free = tick(&mut wall, count);
            assert_eq!((free.torque_nm, free.law), (0.0, Law::Ledger));
        }
        // At first hardly more than friction; then what the knob has put in lets it rise.
        let first = tick(&mut wall, 1);
        assert!(-2e-3 < first.torque_nm && first.torque_nm < -1e-3);
        assert_eq!(first.reason, Reason::Account);
        let mut last = first;
        for count in 2..20 {
            let next = tick(&mut wall, count);
            assert!(next.torque_nm < last.torque_nm && next.account_j > last.account_j);
            last = next;
        }
        // m/T² = 6.28 Nm/rad is the most.
        assert!(last.stiffness_nm_rad > 1.0 && last.stiffness_nm_rad <= 6.281);
        let _ = tick(&mut wall, -1);
        assert!(tick(&mut wall, -2).account_j <= 0.0);
    }

    #[test]
    fn auto_takes_the_cheapest_law_that_does() {
        let law_at = |stiffness, speed: i32| {
            let mut wall = controller(&re35(Law::Auto, WALL, stiffness));
            for n in 0..12 {
                let _ = tick(&mut wall, -100 + n * speed);
            }
            tick(&mut wall, -100 + 12 * speed).law
        };
        assert_eq!(law_at(0.017, 8), Law::Static);
        assert_eq!(law_at(1.0, 1), Law::Episode);
        assert_eq!(law_at(1.0, 8), Law::Ledger); // 6 rad/s: (11) allows 0.62
        assert_eq!(law_at(1e3, 1), Law::Ledger);
        // A spring that is left slowly is handed back where friction holds it.
        let mut spring = controller(&re35(Law::Auto, SPRING, 1.0));
        for _ in 0..3 {
            let _ = tick(&mut spring, 0);
        }
        assert_eq!(tick(&mut spring, 0).law, Law::Episode);
        assert_eq!(tick(&mut spring, 9).law, Law::Ledger);
        let _ = tick(&mut spring, 8);
        assert_eq!(tick(&mut spring, 8).law, Law::Ledger); // 6.5 mNm: more than friction
    }

    proptest! {
        /// Also after rounding to f32: what is applied does not exceed what is passive.
        #[test]
        fn the_static_law_stays_within_the_limits_in_exact_arithmetic(
            counts in 10.0..20_000.0f64, period_s in 4e-5..2e-2f64,
        ) {
            let mut config = re35(Law::Static, SPRING, 1e3);
            config.hardware_count_rad = core::f64::consts::TAU / counts;
            config.timing.period_s = period_s;
            let stiffness = f64::from(tick(&mut controller(&config), 0).stiffness_nm_rad);
            prop_assert!(stiffness * config.count_rad() <= 2.0 * 2e-3);
            prop_assert!(stiffness * period_s <= 2.0 * 9e-6);
        }

        #[test]
        fn stiffness_never_rises_under_load_nor_above_the_demand(
            law in prop::sample::select(vec![Law::Raw, Law::Static, Law::Episode]),
            demands in prop::collection::vec(0.0..20.0f64, 1..4),
            steps in prop::collection::vec(-40i32..40, 1..200), wall in any::<bool>(),
        ) {
            let plan = |demand| plan(&re35(law, if wall { WALL } else { SPRING }, demand));
            let mut controller = Controller::new(plan(demands[0]), 0);
            let mut position = 0_i32;
            let mut before = tick(&mut controller, 0).stiffness_nm_rad;
            for (i, step) in steps.iter().enumerate() {
                let demand = demands[i * demands.len() / steps.len()];
                controller.adopt(plan(demand));
                position += step;
                let tick = tick(&mut controller, position);
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

        /// Whatever the counts, the period and the plan do: finite torques within their limit.
        #[test]
        fn no_counts_lead_to_a_torque_that_is_none(
            law in prop::sample::select(vec![Law::Ledger, Law::Auto]),
            steps in prop::collection::vec((prop_oneof![-40..40i32, -40_000..40_000i32, any::<i32>()], 1e-5..1e-2f32), 1..300),
            demands in prop::collection::vec((-2.0..6.0f64, 0..3usize, 0.0..1.0f64), 1..4),
            delay in 0.0..1.0f64, lag in 0.0..2.0f64, damping in 0.0..1.0f64, torque_step in 0.0..1e-2f64,
        ) {
            let plans: Vec<Plan> = demands.iter().map(|(exponent, shape, centre_rad)| {
                let shape = [
                    Shape::Spring { centre_rad: *centre_rad },
                    Shape::Wall { edge_rad: *centre_rad },
                    Shape::Detent { centre_rad: *centre_rad, period_rad: 0.1 },
                ][*shape];
                let mut config = re35(law, shape, 10.0_f64.powf(*exponent));
                config.encoder = EncoderConfig::default();
                config.timing.delay_s = delay * 1e-3;
                config.timing.amplifier_tau_s = lag * 1e-3;
                config.damping_nm_s_rad = damping;
                config.torque_step_nm = torque_step;
                plan(&config)
            }).collect();
            let mut controller = Controller::new(plans[0], 0);
            let mut count = 0_i32;
            for (i, (moved, duration_s)) in steps.iter().enumerate() {
                controller.adopt(plans[i * plans.len() / steps.len()]);
                count = count.wrapping_add(*moved);
                let tick = controller.tick(count as u32, *duration_s);
                prop_assert!(tick.torque_nm.abs() <= 0.5, "{tick:?}");
                prop_assert!(tick.stiffness_nm_rad >= 0.0 && tick.margin_nm.is_finite(), "{tick:?}");
                prop_assert!(tick.account_j.is_finite(), "{tick:?}");
            }
        }
    }

    #[test]
    fn a_configuration_that_no_tick_may_run_with_is_refused() {
        for bad in [-1.0, f64::NAN, f64::INFINITY, 1e300] {
            let edits: [fn(&mut Config, f64); 8] = [
                |config, bad| config.stiffness_nm_rad = bad,
                |config, bad| config.torque_max_nm = bad,
                |config, bad| config.damping_nm_s_rad = bad,
                |config, bad| config.torque_step_nm = bad,
                |config, bad| config.timing.period_s = bad,
                |config, bad| config.timing.jitter_s = bad,
                |config, bad| config.timing.delay_s = bad,
                |config, bad| config.timing.amplifier_tau_s = bad,
            ];
            for edit in edits {
                for law in [Law::Static, Law::Ledger] {
                    let mut config = re35(law, SPRING, 1.0);
                    edit(&mut config, bad);
                    assert!(Plan::new(&config).is_err(), "{config:?}");
                }
            }
        }
        let mut config = re35(Law::Raw, SPRING, 1.0);
        config.hardware_count_rad = 1e-60; // above zero, but not in f32
        assert!(Plan::new(&config).is_err());
        let mut config = re35(Law::Ledger, SPRING, 1.0);
        config.timing.delay_s = 1.1e-3;
        assert_eq!(
            Plan::new(&config).unwrap_err().to_string(),
            "delay is 0.0011 s; accepted by this law: up to 0.001 s, the shortest interval between ticks"
        );
        let mut config = re35(Law::Raw, SPRING, 1.0);
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
