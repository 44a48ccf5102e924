//! Many displays of equal μ at once: the closed form of [`hold`](crate::hold) for a
//! vector of lanes, without branches but one ("does any lane reverse?").
//!
//! The instruction set is chosen at run time. The formulas are those of
//! [`Hold::step`] for b·h/m ≤ 1/32, where short series suffice; a display with more
//! damping per sample is run by the scalar core. A lane's result does not depend on
//! what its neighbours do.

use pulp::{Simd, WithSimd};

use crate::display::{Display, ROUNDER};
use crate::hold::{Hold, LOG_TAIL_SMALL, State};
use crate::outcome::{Class, Classes, DIVERGED_COUNTS, Peaks};
use crate::series::{PHI2_SMALL, SMALL};

/// Registers worked on side by side, so that one fills the wait for another.
const INTERLEAVED: usize = 4;

/// Lanes come in multiples of this: [`INTERLEAVED`] registers of the widest set.
const GROUP: usize = INTERLEAVED * 8;

/// Samples between two looks at which lanes have finished.
const LOOK_EVERY: u64 = 64;

/// An instruction set that the kernel can use on this machine.
#[derive(Debug, Clone, Copy)]
pub struct InstructionSet(Set);

#[derive(Debug, Clone, Copy)]
enum Set {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2(pulp::x86::V3),
    #[cfg(target_arch = "x86_64")]
    Avx512(pulp::x86::V4),
}

impl InstructionSet {
    /// All that this machine has, the fastest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let mut sets = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            sets.extend(pulp::x86::V4::try_new().map(|set| Self(Set::Avx512(set))));
            sets.extend(pulp::x86::V3::try_new().map(|set| Self(Set::Avx2(set))));
        }
        sets.push(Self(Set::Portable));
        sets
    }

    /// The fastest that this machine has.
    #[must_use]
    pub fn best() -> Self {
        Self::available()[0]
    }

    /// What to call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self.0 {
            Set::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2(_) => "AVX2 with FMA",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512(_) => "AVX-512",
        }
    }

    fn run(self, op: Advance<'_>) {
        match self.0 {
            Set::Portable => op.with_simd(pulp::Scalar::new()),
            #[cfg(target_arch = "x86_64")]
            Set::Avx2(set) => Simd::vectorize(set, op),
            #[cfg(target_arch = "x86_64")]
            Set::Avx512(set) => Simd::vectorize(set, op),
        }
    }
}

/// True if the kernel's short series hold for a display; else it is for the scalar core.
#[must_use]
pub fn serves(display: &Display) -> bool {
    display.hold().decay_exponent() <= SMALL
}

/// The lanes, one column per quantity.
#[derive(Default)]
struct Lanes {
    position: Vec<f64>,
    velocity: Vec<f64>,
    /// Peak speed since it was last taken.
    peak: Vec<f64>,
    viscous: Vec<f64>,
    coulomb: Vec<f64>,
    decay_exponent: Vec<f64>,
    decay: Vec<f64>,
    reach: Vec<f64>,
    impulse: Vec<f64>,
    thrust: Vec<f64>,
}

impl Lanes {
    fn columns(&mut self) -> [&mut Vec<f64>; 10] {
        [
            &mut self.position,
            &mut self.velocity,
            &mut self.peak,
            &mut self.viscous,
            &mut self.coulomb,
            &mut self.decay_exponent,
            &mut self.decay,
            &mut self.reach,
            &mut self.impulse,
            &mut self.thrust,
        ]
    }

    fn push(&mut self, hold: &Hold, start: State) {
        let values = [
            start.position,
            start.velocity,
            0.0,
            hold.viscous(),
            hold.coulomb(),
            hold.decay_exponent(),
            hold.decay(),
            hold.reach(),
            hold.impulse(),
            hold.thrust(),
        ];
        for (column, value) in self.columns().into_iter().zip(values) {
            column.push(value);
        }
    }

    fn swap_remove(&mut self, lane: usize) {
        for column in self.columns() {
            column.swap_remove(lane);
        }
    }

    /// Fills up to whole groups. What is filled in is never looked at; zeros stand still.
    fn pad(&mut self) {
        let padded = self.position.len().next_multiple_of(GROUP);
        for column in self.columns() {
            column.resize(padded, 0.0);
        }
    }

    fn truncate(&mut self, lanes: usize) {
        for column in self.columns() {
            column.truncate(lanes);
        }
    }
}

/// Runs each display of inertia μ from its start for `samples` intervals and returns its
/// classes, as [`Display::run`] does. `progress` is told of display-samples as they are
/// settled; if it returns false the run ends early and None is returned.
///
/// # Assumes
/// All displays share one μ, and [`serves`] holds for each.
#[must_use]
pub fn classify(
    set: InstructionSet,
    displays: &[(Display, State)],
    samples: u64,
    mut progress: impl FnMut(u64) -> bool,
) -> Option<Vec<Classes>> {
    let both = |class| Classes {
        window: class,
        paper: class,
    };
    let Some((first, _)) = displays.first() else {
        return Some(Vec::new());
    };
    let inertia = first.hold().inertia();
    let mut classes = vec![both(Class::Undecided); displays.len()];
    let mut lanes = Lanes::default();
    let mut peaks = Vec::new();
    let mut who: Vec<usize> = (0..displays.len()).collect();
    for (display, start) in displays {
        lanes.push(display.hold(), *start);
        let mut own = Peaks::new(samples);
        own.enter(0, start.velocity.abs());
        peaks.push(own);
    }
    let mut sample = 0;
    loop {
        let mut lane = 0;
        while lane < who.len() {
            let state = State {
                position: lanes.position[lane],
                velocity: lanes.velocity[lane],
            };
            let ended = if displays[who[lane]].0.rests(state) {
                both(Class::Rest)
            } else if state.position.is_nan() || state.position.abs() > DIVERGED_COUNTS {
                both(Class::Unstable)
            } else if sample == samples {
                peaks[lane].classes(state.velocity.abs())
            } else {
                lane += 1;
                continue;
            };
            classes[who[lane]] = ended;
            lanes.swap_remove(lane);
            peaks.swap_remove(lane);
            who.swap_remove(lane);
            if !progress(samples - sample) {
                return None;
            }
        }
        if who.is_empty() {
            return Some(classes);
        }
        let alike = peaks[0].last_alike(sample + 1);
        let next = (sample + LOOK_EVERY).min(samples).min(alike);
        lanes.pad();
        set.run(Advance {
            lanes: &mut lanes,
            inertia,
            samples: next - sample,
        });
        lanes.truncate(who.len());
        for (own, peak) in peaks.iter_mut().zip(&mut lanes.peak) {
            own.enter(next, std::mem::take(peak));
        }
        if !progress((next - sample) * who.len() as u64) {
            return None;
        }
        sample = next;
    }
}

/// The states of displays of one inertia `samples` intervals later, whatever becomes of them.
///
/// # Assumes
/// As [`classify`].
#[must_use]
pub fn follow(set: InstructionSet, displays: &[(Display, State)], samples: u64) -> Vec<State> {
    let Some((first, _)) = displays.first() else {
        return Vec::new();
    };
    let mut lanes = Lanes::default();
    for (display, start) in displays {
        lanes.push(display.hold(), *start);
    }
    lanes.pad();
    set.run(Advance {
        lanes: &mut lanes,
        inertia: first.hold().inertia(),
        samples,
    });
    let states = lanes.position.iter().zip(&lanes.velocity);
    states
        .take(displays.len())
        .map(|(position, velocity)| State {
            position: *position,
            velocity: *velocity,
        })
        .collect()
}

/// Advances all lanes by a number of samples.
struct Advance<'a> {
    lanes: &'a mut Lanes,
    inertia: f64,
    samples: u64,
}

impl WithSimd for Advance<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            lanes,
            inertia,
            samples,
        } = self;
        let [
            position,
            velocity,
            peak,
            viscous,
            coulomb,
            decay_exponent,
            decay,
            reach,
            impulse,
            thrust,
        ] = lanes.columns().map(|column| S::as_mut_simd_f64s(column).0);
        let kernel = Kernel {
            simd,
            inertia: simd.splat_f64s(inertia),
            mobility: simd.splat_f64s(1.0 / inertia),
        };
        let mut from = 0;
        while from + INTERLEAVED <= position.len() {
            let mut x = [simd.splat_f64s(0.0); INTERLEAVED];
            let (mut v, mut fastest) = (x, x);
            let here = from..from + INTERLEAVED;
            x.copy_from_slice(&position[here.clone()]);
            v.copy_from_slice(&velocity[here.clone()]);
            fastest.copy_from_slice(&peak[here.clone()]);
            for _ in 0..samples {
                for r in 0..INTERLEAVED {
                    let constants = Constants {
                        viscous: viscous[from + r],
                        coulomb: coulomb[from + r],
                        decay_exponent: decay_exponent[from + r],
                        decay: decay[from + r],
                        reach: reach[from + r],
                        impulse: impulse[from + r],
                        thrust: thrust[from + r],
                    };
                    (x[r], v[r]) = kernel.step(&constants, x[r], v[r]);
                    fastest[r] = simd.max_f64s(fastest[r], simd.abs_f64s(v[r]));
                }
            }
            position[here.clone()].copy_from_slice(&x);
            velocity[here.clone()].copy_from_slice(&v);
            peak[here].copy_from_slice(&fastest);
            from += INTERLEAVED;
        }
    }
}

/// One register of each of a lane's constants; names as in [`Hold`].
struct Constants<V> {
    viscous: V,
    coulomb: V,
    decay_exponent: V,
    decay: V,
    reach: V,
    impulse: V,
    thrust: V,
}

struct Kernel<S: Simd> {
    simd: S,
    inertia: S::f64s,
    mobility: S::f64s,
}

impl<S: Simd> Kernel<S> {
    /// φ of (5), as [`quantised_force`](crate::display::quantised_force).
    #[inline(always)]
    fn quantised_force(&self, x: S::f64s) -> S::f64s {
        let s = self.simd;
        let rounder = s.splat_f64s(ROUNDER);
        let nearest = s.sub_f64s(s.add_f64s(x, rounder), rounder);
        let above = s.less_than_f64s(x, nearest);
        let half = s.select_f64s(above, s.splat_f64s(0.5), s.splat_f64s(-0.5));
        s.sub_f64s(half, nearest)
    }

    /// F − clamp(F, ±c), as [`Hold::breakaway`].
    #[inline(always)]
    fn breakaway(&self, force: S::f64s, coulomb: S::f64s) -> S::f64s {
        let s = self.simd;
        let held = s.min_f64s(s.max_f64s(force, s.neg_f64s(coulomb)), coulomb);
        s.sub_f64s(force, held)
    }

    /// [`Hold::step`] for lanes of b·h/m ≤ 1/32 and h = 1.
    #[inline(always)]
    fn step(&self, c: &Constants<S::f64s>, x: S::f64s, v: S::f64s) -> (S::f64s, S::f64s) {
        let s = self.simd;
        let zero = s.splat_f64s(0.0);
        let force = self.quantised_force(x);
        let forwards = s.less_than_f64s(zero, v);
        let backwards = s.less_than_f64s(v, zero);
        let released = self.breakaway(force, c.coulomb);
        let d = s.select_f64s(
            forwards,
            s.sub_f64s(force, c.coulomb),
            s.select_f64s(backwards, s.add_f64s(force, c.coulomb), released),
        );
        let velocity = s.mul_add_e_f64s(d, c.impulse, s.sub_f64s(v, s.mul_f64s(v, c.decay)));
        let position = s.mul_add_e_f64s(d, c.thrust, s.mul_add_e_f64s(v, c.reach, x));
        let turned = s.less_than_f64s(s.mul_f64s(v, velocity), zero);
        if s.first_true_m64s(turned) == S::F64_LANES {
            return (position, velocity);
        }
        let (turned_position, turned_velocity) = self.turn(c, x, v, d, released);
        (
            s.select_f64s(turned, turned_position, position),
            s.select_f64s(turned, turned_velocity, velocity),
        )
    }

    /// The part of [`Hold::step`] for a velocity that reverses; nonsense elsewhere.
    #[inline(always)]
    fn turn(
        &self,
        c: &Constants<S::f64s>,
        x: S::f64s,
        v: S::f64s,
        d: S::f64s,
        released: S::f64s,
    ) -> (S::f64s, S::f64s) {
        let s = self.simd;
        let one = s.splat_f64s(1.0);
        let drag = s.neg_f64s(s.mul_f64s(c.viscous, v));
        let reciprocal = s.div_f64s(one, s.add_f64s(s.add_f64s(d, d), drag));
        let w = s.mul_f64s(drag, reciprocal);
        let w2 = s.mul_f64s(w, w);
        let r = self.polynomial(&LOG_TAIL_SMALL, w2);
        let push = s.neg_f64s(s.mul_f64s(s.mul_f64s(self.inertia, v), reciprocal));
        let time = s.mul_f64s(s.add_f64s(push, push), s.mul_add_e_f64s(w2, r, one));
        let wr = s.mul_f64s(w, r);
        let twice = s.mul_f64s(s.add_f64s(wr, wr), s.mul_f64s(d, reciprocal));
        let distance = s.mul_f64s(s.mul_f64s(push, v), s.sub_f64s(one, twice));
        let left = s.sub_f64s(one, s.min_f64s(time, one));
        let y = s.mul_f64s(c.decay_exponent, left);
        let two = self.polynomial(&PHI2_SMALL, s.neg_f64s(y));
        let gain = s.mul_f64s(released, s.mul_f64s(left, self.mobility));
        (
            s.mul_add_e_f64s(s.mul_f64s(gain, left), two, s.add_f64s(x, distance)),
            s.mul_f64s(gain, s.sub_f64s(one, s.mul_f64s(y, two))),
        )
    }

    #[inline(always)]
    fn polynomial<const N: usize>(&self, coefficients: &[f64; N], x: S::f64s) -> S::f64s {
        let s = self.simd;
        let mut sum = s.splat_f64s(0.0);
        for c in coefficients.iter().rev() {
            sum = s.mul_add_e_f64s(sum, x, s.splat_f64s(*c));
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use control::criterion::Dimensionless;

    #[test]
    fn every_instruction_set_follows_the_scalar_core() {
        let mut displays = Vec::new();
        let mut starts = Vec::new();
        for i in 0..200 {
            let (beta, sigma) = (0.013 * f64::from(i % 77), 0.009 * f64::from(i % 113));
            let display = Display::new(Dimensionless {
                mu: 50.0,
                beta,
                sigma,
            })
            .unwrap();
            assert!(serves(&display));
            starts.push(State {
                position: f64::from(i % 7) - 3.3,
                velocity: 0.37 * f64::from(i) - 20.0,
            });
            displays.push(display);
        }
        for set in InstructionSet::available() {
            for samples in [1_u64, 2, 7, 64, 190] {
                let mut lanes = Lanes::default();
                for (display, start) in displays.iter().zip(&starts) {
                    lanes.push(display.hold(), *start);
                }
                lanes.pad();
                set.run(Advance {
                    lanes: &mut lanes,
                    inertia: 50.0,
                    samples,
                });
                for (lane, (display, start)) in displays.iter().zip(&starts).enumerate() {
                    let mut peak = 0.0_f64;
                    let mut state = *start;
                    for _ in 0..samples {
                        let force = crate::display::quantised_force(state.position);
                        state = display.hold().step(state, force).end;
                        peak = peak.max(state.velocity.abs());
                    }
                    let scale = state.position.abs().max(state.velocity.abs()).max(1.0);
                    for (have, want) in [
                        (lanes.position[lane], state.position),
                        (lanes.velocity[lane], state.velocity),
                        (lanes.peak[lane], peak),
                    ] {
                        let error = (have - want).abs();
                        assert!(
                            error <= 1e-11 * scale,
                            "{} lane {lane} after {samples}: {have}, not {want}",
                            set.name()
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn classes_are_those_of_the_scalar_core_whatever_the_set_and_the_company() {
        let mut displays = Vec::new();
        for i in 0..300 {
            let (beta, sigma) = (
                f64::from(i % 20) * 0.05 + 0.02,
                f64::from(i / 20) * 0.066 + 0.01,
            );
            let display = Display::new(Dimensionless {
                mu: 50.0,
                beta,
                sigma,
            })
            .unwrap();
            let velocity = [2.0, 10.0, -30.0][i as usize % 3];
            displays.push((
                display,
                State {
                    position: 0.0,
                    velocity,
                },
            ));
        }
        for samples in [300, 8_000, 9_001] {
            let want: Vec<_> = displays
                .iter()
                .map(|(display, start)| display.run(*start, samples, |_, _| true).classes)
                .collect();
            for set in InstructionSet::available() {
                let have = classify(set, &displays, samples, |_| true).unwrap();
                assert_eq!(have, want, "{}, {samples} samples", set.name());
                let mut settled = 0;
                let alone = classify(set, &displays[17..18], samples, |n| {
                    settled += n;
                    true
                });
                assert_eq!(alone.unwrap(), want[17..18]);
                assert_eq!(settled, samples, "progress adds up");
            }
        }
        assert_eq!(
            classify(InstructionSet::best(), &displays, 50, |_| false),
            None
        );
    }
}
