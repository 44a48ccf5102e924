//! Which torques to command, tick by tick, so that m, b and c show in the counts.
//!
//! Nothing about the knob has to be known before. In either direction a torque that rises slowly finds
//! where the knob breaks away; then come steps of [several heights](HEIGHTS), each up to a speed, and after
//! each the knob coasts to rest. From each push the next is planned: with d₁ travelled under the torque F
//! for a time t, and d₂ without it, c ≈ F·d₁/(d₁ + d₂) and m ≈ (F − c)·t²/2d₁ (viscous friction is in
//! this c).

use super::recording::{REST_S, Recording, Sample};
use super::refusal::Refusal;

/// What the knob must not exceed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Speed, rad/s.
    pub speed_rad_s: f64,
    /// Angle from where it starts, either way, rad.
    pub angle_rad: f64,
    /// Torque, Nm.
    pub torque_nm: f64,
}

/// Steps: torque in units of Coulomb friction, and the speed in units of the limit at which it ends.
pub const HEIGHTS: [(f64, f64); 6] = [
    (1.6, 0.25),
    (2.0, 0.5),
    (3.0, 0.85),
    (1.6, 0.6),
    (4.5, 0.4),
    (2.5, 0.85),
];

/// A torque that rises does so from this share of its limit to the limit,
const RAMP_FROM: f64 = 1e-3;
/// in this time, s.
const RAMP_S: f64 = 3.0;

/// So many counts are a motion.
const MOVED_COUNTS: i32 = 3;

/// Of the way that is left, pushes plan to use this share.
const WAY: f64 = 0.65;

/// A step lasts so many ticks or more, by choice of its height.
const LEAST_TICKS: f64 = 4.0;

/// A knob that has not stopped after so long never does, s.
const LONGEST_COAST_S: f64 = 30.0;

/// What is being done.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Torque 0 until the count stands still.
    Rest,
    /// A rising torque.
    Ramp,
    /// A torque until the knob is fast or far enough.
    Step {
        torque_nm: f64,
        speed_rad_s: f64,
        way_rad: f64,
    },
    Over,
}

/// An experiment under way. Give it each tick's count; it gives the torque to hold until the next.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    limits: Limits,
    period_s: f64,
    count_rad: f64,
    phase: Phase,
    /// What was done before the rest.
    last: Phase,
    /// Ticks in the phase.
    ticks: u32,
    /// Ticks since the count changed.
    still: u32,
    /// The phases that are done, rests not counted.
    done: usize,
    origin: i32,
    count: i32,
    /// The count where the last push began and where its torque ended.
    start: i32,
    release: i32,
    /// How long the last push was, ticks.
    pushed_ticks: u32,
    /// The torque at its end, Nm.
    torque_nm: f64,
    /// c and 1/m as far as they are known.
    coulomb_nm: f64,
    mobility: f64,
    /// The last counts, for speed.
    recent: [i32; 4],
}

impl Experiment {
    /// For a knob at rest, whose ticks are `period_s` (s) apart and whose counts are `count_rad` (rad).
    ///
    /// # Errors
    /// Refuses what is not finite and above 0.
    pub fn new(limits: Limits, period_s: f64, count_rad: f64) -> Result<Self, Refusal> {
        for (name, value) in [
            ("speed limit (rad/s)", limits.speed_rad_s),
            ("angle limit (rad)", limits.angle_rad),
            ("torque limit (Nm)", limits.torque_nm),
            ("sample period (s)", period_s),
            ("count size (rad)", count_rad),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Refusal::NotPositive { name, value });
            }
        }
        Ok(Self {
            limits,
            period_s,
            count_rad,
            phase: Phase::Rest,
            last: Phase::Rest,
            ticks: 0,
            still: 0,
            done: 0,
            origin: 0,
            count: 0,
            start: 0,
            release: 0,
            pushed_ticks: 0,
            torque_nm: 0.0,
            coulomb_nm: 0.0,
            mobility: 0.0,
            recent: [0; 4],
        })
    }

    /// The whole of it: `hold` is given a torque (Nm), holds it for a period, and returns the count then.
    ///
    /// # Errors
    /// See [`Experiment::new`].
    pub fn record(
        limits: Limits,
        period_s: f64,
        count_rad: f64,
        first: i32,
        mut hold: impl FnMut(f64) -> i32,
    ) -> Result<Recording, Refusal> {
        let mut experiment = Self::new(limits, period_s, count_rad)?;
        let mut samples = Vec::new();
        let mut count = first;
        while let Some(torque_nm) = experiment.tick(count) {
            samples.push(Sample { count, torque_nm });
            count = hold(torque_nm);
        }
        Ok(Recording {
            period_s,
            count_rad,
            samples,
        })
    }

    /// One tick: the torque to hold until the next, Nm; none once it is over.
    pub fn tick(&mut self, count: i32) -> Option<f64> {
        if self.done == 0 && self.ticks == 0 && self.phase == Phase::Rest {
            (self.origin, self.count, self.recent) = (count, count, [count; 4]);
        }
        self.still = if count == self.count {
            self.still + 1
        } else {
            0
        };
        self.count = count;
        self.recent.rotate_right(1);
        self.recent[0] = count;
        self.ticks += 1;
        self.torque_nm = match self.phase {
            Phase::Over => return None,
            Phase::Rest => self.rest(),
            Phase::Ramp => self.ramp(),
            Phase::Step {
                torque_nm,
                speed_rad_s,
                way_rad,
            } => self.step(torque_nm, speed_rad_s, way_rad),
        };
        (self.phase != Phase::Over).then_some(self.torque_nm)
    }

    /// +1 or −1: directions take turns.
    fn sign(&self) -> f64 {
        if self.done.is_multiple_of(2) {
            1.0
        } else {
            -1.0
        }
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.ticks = 0;
        self.still = 0;
    }

    fn rest(&mut self) -> f64 {
        let still_s = f64::from(self.still) * self.period_s;
        if f64::from(self.ticks) * self.period_s > LONGEST_COAST_S {
            self.phase = Phase::Over;
        }
        // The rest that follows has its 0.1 s too.
        if still_s < 1.5 * REST_S || self.still < 20 {
            return 0.0;
        }
        self.learn();
        match self.next() {
            Some(phase) => {
                self.start = self.count;
                self.enter(phase);
            }
            None => self.phase = Phase::Over,
        }
        0.0
    }

    /// c and 1/m from the push that came to rest.
    fn learn(&mut self) {
        let Phase::Step { torque_nm, .. } = self.last else {
            return;
        };
        let way = |from: i32, to: i32| f64::from(to.abs_diff(from)) * self.count_rad;
        let (pushed, coasted) = (way(self.start, self.release), way(self.release, self.count));
        if pushed < 5.0 * self.count_rad {
            return;
        }
        let height = torque_nm.abs();
        self.coulomb_nm = height * pushed / (pushed + coasted);
        let time_s = f64::from(self.pushed_ticks) * self.period_s;
        let net = (height - self.coulomb_nm).max(0.05 * height);
        self.mobility = 2.0 * pushed / (time_s * time_s * net);
    }

    /// What comes after a rest.
    fn next(&mut self) -> Option<Phase> {
        if self.done < 2 {
            return Some(Phase::Ramp);
        }
        let (height, share) = *HEIGHTS.get(self.done / 2 - 1)?;
        let speed_rad_s = share * self.limits.speed_rad_s;
        let mut height_nm = (height * self.coulomb_nm).min(self.limits.torque_nm);
        if self.mobility > 0.0 {
            let gentle = speed_rad_s / (LEAST_TICKS * self.period_s * self.mobility);
            height_nm = height_nm.min((self.coulomb_nm + gentle).max(1.3 * self.coulomb_nm));
        }
        let sign = self.sign();
        let angle = f64::from(self.count.wrapping_sub(self.origin)) * self.count_rad;
        let left = (self.limits.angle_rad - sign * angle).max(0.0);
        Some(Phase::Step {
            torque_nm: sign * height_nm,
            speed_rad_s,
            // Of all that it will travel, the way under torque is the share c/F.
            way_rad: WAY * left * self.coulomb_nm / height_nm,
        })
    }

    fn moved(&self) -> i32 {
        let moved = self.count.wrapping_sub(self.start);
        if self.sign() < 0.0 { -moved } else { moved }
    }

    fn release(&mut self) -> f64 {
        self.last = self.phase;
        self.release = self.count;
        self.pushed_ticks = self.ticks - 1;
        self.done += 1;
        self.enter(Phase::Rest);
        0.0
    }

    fn ramp(&mut self) -> f64 {
        let share = f64::from(self.ticks) * self.period_s / RAMP_S;
        if share >= 1.0 {
            // It does not move: what was recorded says so.
            self.done = usize::MAX / 2;
            self.enter(Phase::Rest);
            return 0.0;
        }
        if self.moved().abs() >= MOVED_COUNTS {
            self.coulomb_nm = self.coulomb_nm.max(self.torque_nm.abs());
            return self.release();
        }
        self.sign() * self.limits.torque_nm * RAMP_FROM.powf(1.0 - share)
    }

    fn step(&mut self, torque_nm: f64, speed_rad_s: f64, way_rad: f64) -> f64 {
        let counts = self.recent[0].abs_diff(self.recent[3]);
        let measured = f64::from(counts) * self.count_rad / (3.0 * self.period_s);
        // What the last pushes say of this one, at the end of the tick.
        let net = (torque_nm.abs() - 0.9 * self.coulomb_nm).max(0.0);
        let planned = f64::from(self.ticks) * self.period_s * net * self.mobility;
        let way = f64::from(self.moved()) * self.count_rad;
        let endless = f64::from(self.ticks) * self.period_s > LONGEST_COAST_S;
        let fast = planned.max(measured) > speed_rad_s && self.ticks > 1;
        if fast || way >= way_rad || endless {
            return self.release();
        }
        torque_nm
    }
}
