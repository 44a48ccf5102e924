//! The energy ledger: a spring that pays for sampling with energy that was measured.
//!
//! A stiff sampled spring makes energy. Instead of forbidding the stiffness that could, the
//! ledger measures what the knob has put in, and never gives out more:
//!
//! 1. **Intervals.** Velocity and position from the counts ([`crate::motion`]); ⟨x⟩ is the position's.
//! 2. **Account.** S += −F·(mid⟨x⟩ − mid⟨x⟩₋₁) + η·(c·path + b·((|n|−1)₊·Δ)²/dt): what the torque F
//!    that was held took in, and a share η of what friction surely took. path = |n|·Δ, after a turn (|n| − 1)·Δ: of
//!    n counts only |n| − 1 are sure to have been travelled after a turn.
//! 3. **No credit carried.** S = min(S, 0) out of contact (F = 0 or no nominal torque), and
//!    where a minimum of the potential was passed.
//! 4. **Torque.** s = max(0, S − w|F|/2), w the width of ⟨x⟩, is what is surely there. With
//!    d = (T_max + τ)·(lowest speed against the nominal torque),
//!    L(K, d) = 2s/(|d| + √(d² + 2s/K)) + max(ηc, 2Kd), and M = L(K, d − Δ). Where the knob does not
//!    move with the torque, and F already pushes the nominal way and is at most L(m/Te², d), M is at
//!    least |F|.
//!    The torque is the nominal one, clamped to ±M.
//! 5. **Charge.** S −= |F − F₋₁|·w/2.
//!
//! *Why it is sound.* Over all motions that the counts allow and that end at x, the worst
//! account is affine in x with slope −F; steps 2 and 5 are that update at the middle of ⟨x⟩, and
//! s is its minimum over ⟨x⟩. For the bare rotor work less friction is the change of kinetic
//! energy, so a tick is safe if v² at its end is at most v² + 2s/m. Moving with the torque that means
//! (F − ηc)·|d| + (F − ηc)²/2K ≤ s; with a reversal, and Coulomb friction in both its phases,
//! F² − PF ≤ ηcG + η²c² (G the first term of L, P = G + 2Kd, K ≤ m/T²). L satisfies both. The share (1 − η)·c·path is never credited, so the path is finite
//! and no cycle persists. The nominal torque does not enter: demand, shape and limits may change in
//! any tick.
//!
//! *Delay and lag.* A torque computed now acts `delay` later: intervals are carried ahead under
//! the torque in force until then. An amplifier with time constant τ goes on with the
//! old torque for τ more: that is reckoned with the fastest and the slowest speed.
//!
//! *Assumed:* m, b, c, the timing and the torque as believed, and a hand that leaves velocity and
//! position in their intervals. Nothing is said beyond: see `docs/limits.md`.

use crate::motion::{Interval, Motion, Span};
use crate::plan::LedgerPlan;
use crate::real::{larger, smaller};
use crate::root::root;
use crate::tick::Reason;
use crate::tuning::Tuning;

/// Where the knob is when the torque of this tick acts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ahead {
    /// The width of its position, rad.
    pub width_rad: f32,
    /// Its velocity, rad/s.
    pub velocity: Span,
}

const NO_ACCELERATION: Span = Span {
    low: 0.0,
    high: 0.0,
};

/// The account of one knob.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ledger {
    pub motion: Motion,
    /// S, J.
    pub account_j: f32,
    /// The torque commanded last, Nm.
    pub held_nm: f32,
    /// The one before it, which acts until the delay is over.
    before_nm: f32,
    /// What the amplifier gives now, Nm.
    lagging_nm: f32,
    /// The last movement, counts; 0 where it is over.
    direction: f32,
    /// The profile's torque in the last tick, Nm.
    nominal_nm: f32,
    /// The middle of the position when the torque changes, relative to the cell, rad.
    middle_rad: f32,
    /// The acceleration in the last tick, rad/s²; followed where there is delay or lag.
    acceleration: Span,
}

impl Ledger {
    /// A knob that was not followed, under a torque, with so much energy in the spring.
    pub fn new(plan: &LedgerPlan, held_nm: f32, stored_j: f32) -> Self {
        Self {
            motion: Motion::unknown(&plan.mechanics),
            account_j: stored_j,
            held_nm,
            before_nm: held_nm,
            lagging_nm: held_nm,
            direction: 0.0,
            nominal_nm: held_nm,
            middle_rad: 0.0,
            acceleration: NO_ACCELERATION,
        }
    }

    /// A knob that rests in a spring under load.
    pub fn at_rest(plan: &LedgerPlan, pull_nm: f32, stored_j: f32) -> Self {
        let mut ledger = Self::new(plan, pull_nm, stored_j);
        ledger.motion.rest();
        // Nothing acts on it before the first torque.
        ledger.before_nm = 0.0;
        ledger.lagging_nm = 0.0;
        ledger
    }

    /// Step 1: the tick that is over, `moved` counts in `duration_s`.
    #[inline(always)]
    pub fn enter(&mut self, plan: &LedgerPlan, tuning: &Tuning, interval: &Interval) {
        let held = self.held_nm;
        let mut torque = Span {
            low: held,
            high: held,
        };
        let mut strongest = held.abs();
        if plan.late {
            for other in [self.before_nm, self.lagging_nm] {
                torque.low = smaller(torque.low, other);
                torque.high = larger(torque.high, other);
                strongest = larger(strongest, other.abs());
            }
        }
        let acceleration = self
            .motion
            .follow(&plan.mechanics, tuning, interval, torque, strongest);
        if plan.late {
            self.acceleration = acceleration;
        }
    }

    /// Steps 1 (with delay) to 3 for the tick entered last; `nominal_nm` is the profile's torque now.
    #[inline(always)]
    pub fn account(
        &mut self,
        plan: &LedgerPlan,
        tuning: &Tuning,
        interval: &Interval,
        nominal_nm: f32,
    ) -> Ahead {
        let mechanics = &plan.mechanics;
        let held = self.held_nm;
        // 1. Intervals, at the time when the torque of this tick will act.
        let (mut position, mut velocity) = (self.motion.position(), self.motion.velocity());
        if plan.late {
            let acceleration = self.acceleration;
            let gained = Span {
                low: acceleration.low * plan.delay_s,
                high: acceleration.high * plan.delay_s,
            };
            position.low += (velocity.low + 0.5 * gained.low) * plan.delay_s;
            position.high += (velocity.high + 0.5 * gained.high) * plan.delay_s;
            velocity.low += gained.low;
            velocity.high += gained.high;
        }
        let middle = position.middle();

        // 2. Account.
        let moved = interval.counts;
        self.account_j -= held * (middle - self.middle_rad + moved * mechanics.count_rad);
        self.middle_rad = middle;
        if tuning.friction {
            let counts = moved.abs();
            let sure = if counts > 1.0 { counts - 1.0 } else { 0.0 } * mechanics.count_rad;
            let path = if moved * self.direction > 0.0 {
                counts * mechanics.count_rad
            } else {
                sure
            };
            self.account_j += plan.credited_coulomb * path
                + plan.credited_viscous * (sure * sure) * interval.rate;
        }

        // 3. No credit carried.
        if self.account_j > 0.0 && tuning.no_carry {
            let apart = held * nominal_nm == 0.0;
            if apart || (nominal_nm * self.nominal_nm < 0.0 && nominal_nm * moved < 0.0) {
                self.account_j = 0.0;
            }
        }
        self.nominal_nm = nominal_nm;
        Ahead {
            width_rad: position.width(),
            velocity,
        }
    }

    /// Steps 4 and 5 after [`Ledger::account`]; returns the torque, and why it is less.
    #[inline(always)]
    pub fn torque(
        &mut self,
        plan: &LedgerPlan,
        tuning: &Tuning,
        ahead: &Ahead,
        moved: f32,
        wanted: f32,
    ) -> (f32, Reason) {
        let held = self.held_nm;
        let (width, velocity) = (ahead.width_rad, ahead.velocity);
        // 4. Torque.
        let mut sure_j = self.account_j - 0.5 * width * held.abs();
        if plan.late {
            let with = if self.lagging_nm > 0.0 {
                velocity.high
            } else {
                -velocity.low
            };
            if with > 0.0 {
                sure_j -= self.lagging_nm.abs() * plan.tau_s * with;
            }
        }
        if sure_j < 0.0 {
            sure_j = 0.0;
        }
        let against = if wanted > 0.0 {
            -velocity.high
        } else {
            velocity.low
        };
        let reach = (plan.longest_s + plan.tau_s) * against;
        let friction = plan.credited_coulomb;
        let short = if tuning.count_margin {
            reach - plan.mechanics.count_rad
        } else {
            reach
        };
        let mut limit = limit_nm(sure_j, plan.stiffness, plan.compliance, short, friction);
        if tuning.holding && wanted * moved <= 0.0 && wanted * held > 0.0 {
            // |F| ≤ L(K_h, d), without its root.
            let braking = larger(2.0 * plan.holding * reach, friction);
            let rest = held.abs() - braking;
            if rest <= 0.0
                || rest * (rest * plan.holding_compliance + 2.0 * reach.abs()) <= 2.0 * sure_j
            {
                limit = larger(limit, held.abs());
            }
        }
        let mut reason = plan.reason;
        if limit > plan.torque_max_nm || !tuning.limit {
            limit = plan.torque_max_nm;
            if wanted.abs() > limit {
                reason = Reason::Torque;
            }
        } else if wanted.abs() > limit {
            reason = if self.motion.contradicted() {
                Reason::Hand
            } else {
                Reason::Account
            };
        }
        let torque = plan.cut(if wanted > limit {
            limit
        } else if wanted < -limit {
            -limit
        } else {
            wanted
        });

        // 5. Charge.
        if tuning.charge {
            self.account_j -= (torque - held).abs() * (0.5 * width);
        }
        if plan.late {
            // Until the amplifier has followed, the knob takes −(old − new)·∫v less in.
            let left = (self.lagging_nm - torque) * plan.lag_s;
            let worst = if left > 0.0 {
                velocity.high
            } else {
                velocity.low
            };
            self.account_j -= left * worst;
        }
        if moved != 0.0 {
            self.direction = moved;
        } else if torque == 0.0 {
            self.direction = 0.0;
        }
        self.hold(plan, torque);
        (torque, reason)
    }

    /// Takes note of the torque that is commanded.
    #[inline(always)]
    pub fn hold(&mut self, plan: &LedgerPlan, torque_nm: f32) {
        if plan.late {
            self.before_nm = self.held_nm;
            self.lagging_nm = torque_nm + (self.lagging_nm - torque_nm) * plan.lag_left;
        }
        self.held_nm = torque_nm;
    }
}

/// L(K, d) = 2s/(|d| + √(d² + 2s/K)) + max(ηc, 2Kd), Nm.
#[inline(always)]
fn limit_nm(sure_j: f32, stiffness: f32, compliance: f32, reach_rad: f32, friction: f32) -> f32 {
    let twice = 2.0 * sure_j;
    let size = reach_rad.abs() + root(reach_rad * reach_rad + twice * compliance);
    let braking = 2.0 * stiffness * reach_rad;
    let braking = larger(braking, friction);
    if size > 0.0 {
        twice / size + braking
    } else {
        braking
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Believed, Config, Law, Timing};
    use crate::encoder::EncoderConfig;
    use crate::plan::Plan;
    use crate::shape::Shape;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        /// What makes a tick safe: without a reversal, and with one and friction in both its phases.
        #[test]
        fn the_limit_is_what_the_energy_there_can_pay_for(
            energy in prop_oneof![Just(0.0), (-25.0..5.0f64).prop_map(f64::exp)],
            stiffness in (-5.0..10.0f64).prop_map(f64::exp),
            reach in prop_oneof![-1.0..1.0f64, -1e-4..1e-4f64],
            friction in (-10.0..0.0f64).prop_map(f64::exp),
        ) {
            let size = reach.abs() + (reach * reach + 2.0 * energy / stiffness).sqrt();
            let paid = 2.0 * energy / size.max(1e-20);
            let limit = f64::from(limit_nm(
                energy as f32, stiffness as f32, (1.0 / stiffness) as f32, reach as f32, friction as f32,
            ));
            if reach < 0.0 {
                // Moving with the torque: what is left after friction, times the way.
                // Less what f32 rounds.
                let left = (limit * (1.0 - 1e-6) - friction).max(0.0);
                let given = left * -reach + left * left / (2.0 * stiffness);
                prop_assert!(given <= energy * (1.0 + 1e-4) + 1e-5 * friction * -reach);
            } else {
                let p = paid + 2.0 * stiffness * reach;
                let scale = limit * limit + p * limit + friction * friction;
                let most = friction * paid + friction * friction;
                prop_assert!(limit * limit - p * limit - most <= 1e-5 * scale);
            }
            // And no more than a hair below it.
            let exact = paid + friction.max(2.0 * stiffness * reach);
            prop_assert!((limit / exact - 1.0).abs() < 1e-5);
        }
    }

    fn plan(edit: impl FnOnce(&mut Config)) -> LedgerPlan {
        let mut config = Config {
            believed: Believed {
                inertia_kg_m2: crate::config::Interval::exactly(6.28e-6),
                viscous_nm_s_rad: crate::config::Interval::exactly(0.0),
                coulomb_nm: crate::config::Interval::exactly(2e-3),
            },
            timing: Timing::ideal(1e-3),
            torque_step_nm: 0.0,
            hardware_count_rad: COUNT,
            encoder: EncoderConfig::default(),
            shape: Shape::Spring { centre_rad: 0.0 },
            stiffness_nm_rad: 1.0,
            damping_nm_s_rad: 0.0,
            law: Law::Ledger,
            torque_max_nm: 1.0,
        };
        edit(&mut config);
        Plan::new(&config).unwrap().ledger
    }

    const COUNT: f64 = 1e-3;

    /// A spring that holds −0.01 Nm and 1 mJ, whose knob moved by so many counts.
    fn loaded(plan: &LedgerPlan, direction: f32, counts: f32, nominal_nm: f32) -> (Ledger, Ahead) {
        let mut ledger = Ledger::new(plan, -0.01, 1e-3);
        ledger.direction = direction;
        let interval = Interval {
            counts,
            duration_s: 1e-3,
            rate: 1e3,
            fast: counts.abs() + 1.0,
        };
        let ahead = ledger.account(plan, &Tuning::DEFAULT, &interval, nominal_nm);
        (ledger, ahead)
    }

    fn near(have: f32, want: f64) {
        assert!(
            (f64::from(have) / want - 1.0).abs() < 1e-4,
            "{have:e}, not {want:e}"
        );
    }

    #[test]
    fn the_account_takes_the_work_and_the_friction_that_was_surely_travelled() {
        let plan = plan(|_| ());
        // 3 counts against the torque, on the way there already: 3 counts of friction.
        let on = loaded(&plan, 1.0, 3.0, -0.01).0.account_j;
        near(on, 1e-3 + 0.01 * 3.0 * COUNT + 0.75 * 2e-3 * 3.0 * COUNT);
        // After a turn only 2 are sure; back, the work is given out.
        let turned = loaded(&plan, -1.0, 3.0, -0.01).0.account_j;
        near(on - turned, 0.75 * 2e-3 * COUNT);
        let back = loaded(&plan, -1.0, -3.0, -0.01).0.account_j;
        near(back, 1e-3 - 0.01 * 3.0 * COUNT + 0.75 * 2e-3 * 3.0 * COUNT);
        // Standing takes nothing.
        near(loaded(&plan, 1.0, 0.0, -0.01).0.account_j, 1e-3);
    }

    #[test]
    fn no_credit_is_carried_out_of_contact_or_through_a_minimum() {
        let plan = plan(|_| ());
        assert_eq!(loaded(&plan, 1.0, -3.0, 0.0).0.account_j, 0.0);
        // Through the minimum: the nominal torque has turned and opposes the motion.
        assert_eq!(loaded(&plan, -1.0, -3.0, 0.01).0.account_j, 0.0);
        // Turned, but with the motion: over a detent's top.
        assert!(loaded(&plan, -1.0, 3.0, 0.01).0.account_j > 0.0);
        let mut apart = Ledger::new(&plan, 0.0, 1e-3);
        let still = Interval {
            counts: 0.0,
            duration_s: 1e-3,
            rate: 1e3,
            fast: 1.0,
        };
        let _ = apart.account(&plan, &Tuning::DEFAULT, &still, -0.01);
        assert_eq!(apart.account_j, 0.0);
    }

    #[test]
    fn a_change_of_torque_is_charged_with_what_the_position_leaves_open() {
        let plan = plan(|_| ());
        let (mut ledger, ahead) = loaded(&plan, 1.0, 0.0, -0.01);
        let before = ledger.account_j;
        let (torque, _) = ledger.torque(&plan, &Tuning::DEFAULT, &ahead, 0.0, -1e-3);
        assert_eq!(torque, -1e-3);
        near(before - ledger.account_j, 0.009 * 0.5 * COUNT);
    }

    #[test]
    fn only_what_is_there_wherever_the_knob_is_pays_for_a_torque() {
        let plan = plan(|_| ());
        let (mut ledger, mut ahead) = loaded(&plan, 1.0, 0.0, -0.01);
        ahead.velocity = Span {
            low: 0.0,
            high: 0.0,
        };
        // w|F|/2 = 5 µJ: with no more than that there is only friction.
        ledger.account_j = 4.9e-6;
        let (torque, reason) = ledger
            .clone()
            .torque(&plan, &Tuning::DEFAULT, &ahead, -1.0, -0.1);
        near(torque, -0.75 * 2e-3);
        assert_eq!(reason, Reason::Account);
        ledger.account_j = 105e-6;
        let (torque, _) = ledger.torque(&plan, &Tuning::DEFAULT, &ahead, -1.0, -0.1);
        // L(1, −Δ) of 100 µJ.
        near(
            torque,
            -(2e-4 / (COUNT + (COUNT * COUNT + 2e-4).sqrt()) + 0.75 * 2e-3),
        );
    }

    #[test]
    fn delay_and_lag_cost_what_the_speed_leaves_open() {
        let late = plan(|config| config.timing.delay_s = 5e-4);
        let mut ledger = Ledger::new(&late, -0.01, 1e-3);
        ledger.motion.rest();
        let still = Interval {
            counts: 0.0,
            duration_s: 1e-3,
            rate: 1e3,
            fast: 1.0,
        };
        ledger.enter(&late, &Tuning::DEFAULT, &still);
        let ahead = ledger.account(&late, &Tuning::DEFAULT, &still, -0.01);
        let velocity = ledger.motion.velocity();
        let acceleration = ledger.acceleration;
        let wider = velocity.width() * 5e-4 + 0.5 * acceleration.width() * 25e-8;
        near(
            ahead.width_rad,
            f64::from(ledger.motion.position().width() + wider),
        );
        near(
            ahead.velocity.width(),
            f64::from(velocity.width() + acceleration.width() * 5e-4),
        );
        // Until the amplifier follows, the old torque goes on for τ: at 2 rad/s outward.
        let lagging = plan(|config| config.timing.amplifier_tau_s = 1e-4);
        let (mut ledger, mut ahead) = loaded(&lagging, -1.0, 0.0, -0.01);
        ahead.velocity = Span {
            low: -2.0,
            high: -2.0,
        };
        let before = ledger.account_j;
        let (torque, _) = ledger.torque(&lagging, &Tuning::DEFAULT, &ahead, -1.0, 0.0);
        assert_eq!(torque, 0.0);
        near(before - ledger.account_j, 0.01 * (0.5 * COUNT + 2.0 * 1e-4));
    }
}
