//! From the commanded torque to the one that the motor gives.

use std::collections::VecDeque;

use control::ConfigError;
use control::criterion::Device;

use crate::hold::State;
use crate::knob::KnobError;
use crate::series::{phi1, phi2};

/// What lies between command and motor. All 0, the default, is ideal.
///
/// The command is rounded to the nearest multiple of `torque_step_nm` (ties away from
/// zero), takes effect `delay_s` after its tick, and is followed by the motor's torque as
/// F' = (command − F)/`amplifier_tau_s`. Before the first effect the torque is 0.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drive {
    /// From the encoder's sample to the command's effect, s; may exceed a period.
    pub delay_s: f64,
    /// The amplifier's time constant, s; 0: none.
    pub amplifier_tau_s: f64,
    /// The step of the converter, Nm; 0: none.
    pub torque_step_nm: f64,
}

/// The longest delay, in periods: every command under way is kept.
const LONGEST_DELAY_PERIODS: f64 = 1000.0;

/// Above this many steps, rounding changes nothing: such numbers are whole.
const WHOLE_STEPS: f64 = (1_u64 << 52) as f64;

/// After so many time constants the amplifier has arrived: e⁻⁴⁰ is 4e-18.
const SETTLED_TAUS: f64 = 40.0;

impl Drive {
    /// Refuses what is not finite or negative, and a delay beyond 1000 periods.
    pub(crate) fn check(&self, period_s: f64) -> Result<(), KnobError> {
        for (name, value) in [
            ("delay (s)", self.delay_s),
            ("amplifier time constant (s)", self.amplifier_tau_s),
            ("torque step (Nm)", self.torque_step_nm),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(ConfigError::Negative { name, value }.into());
            }
        }
        let limit = LONGEST_DELAY_PERIODS * period_s;
        if self.delay_s > limit {
            return Err(KnobError::Above {
                name: "delay (s)",
                value: self.delay_s,
                limit,
                reason: "1000 sample periods",
            });
        }
        Ok(())
    }

    /// Whether the torque changes at ticks only.
    pub(crate) fn is_prompt(&self) -> bool {
        self.delay_s == 0.0 && self.amplifier_tau_s == 0.0
    }

    /// The command as the converter can say it, Nm.
    #[inline]
    pub(crate) fn rounded(&self, command_nm: f64) -> f64 {
        if self.torque_step_nm == 0.0 {
            return command_nm;
        }
        let steps = command_nm / self.torque_step_nm;
        if steps.abs() < WHOLE_STEPS {
            steps.round() * self.torque_step_nm
        } else {
            command_nm
        }
    }
}

/// Two constant torques that stand for a varying one over the equal halves of a piece,
/// `mean` ∓ `lean`: of the same impulse, and the same ∫F(t)(δ − t) dt over the piece's
/// length δ. A mass without friction ends where the varying torque would take it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Halves {
    /// Nm.
    pub(crate) mean: f64,
    /// Nm; −(4/δ²) ∫(F(t) − mean)(δ − t) dt.
    pub(crate) lean: f64,
}

impl Halves {
    /// A torque that does not vary.
    pub(crate) fn even(torque: f64) -> Self {
        Self {
            mean: torque,
            lean: 0.0,
        }
    }

    /// A parabola through the torques at start, middle and end of a piece.
    pub(crate) fn parabola([start, middle, end]: [f64; 3]) -> Self {
        Self {
            mean: (start + 4.0 * middle + end) / 6.0,
            lean: (end - start) / 3.0,
        }
    }
}

/// What stands for delay t_d and lag τ when the torque changes by −1 Nm: a jump of velocity and
/// position at the tick.
///
/// The old torque F + d lasts t_d, then d·e^(−t/τ) is left of it. A mass with a = b/m that does not turn
/// meanwhile moves, once that is over, as if at the tick
///
/// Δv = (d/m)·(t_d ψ₁ + e^(at_d) τ′),  Δx = −(d/m)·(t_d² ψ₂ + τ′(t_d ψ₁ + τ)),
///
/// τ′ = τ/(1 − aτ), ψ₁ = (e^y − 1)/y, ψ₂ = (e^y − 1 − y)/y², y = a·t_d: exactly. What rests is not
/// kicked: friction takes the impulse.
///
/// # Assumes
/// aτ < 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Impulse {
    /// Δv per Nm.
    pub(crate) velocity: f64,
    /// Δx per Nm.
    pub(crate) position: f64,
    /// The torque until now, Nm.
    torque_nm: f64,
}

impl Impulse {
    pub(crate) fn new(drive: &Drive, device: &Device<f64>) -> Self {
        let (delay, tau) = (drive.delay_s, drive.amplifier_tau_s);
        let mobility = device.inertia_kg_m2.recip();
        let rate = device.viscous_nm_s_rad * mobility;
        let y = rate * delay;
        // ψ₁(y) = e^y φ₁(y), ψ₂(y) = (ψ₁(y) − 1)/y, and ½ + y/6 where that would cancel.
        let grown = y.exp();
        let psi1 = grown * phi1(y, phi2(y));
        let psi2 = if y < 1e-4 {
            0.5 + y / 6.0 + y * y / 24.0
        } else {
            (psi1 - 1.0) / y
        };
        let tau1 = tau / (1.0 - rate * tau);
        Self {
            velocity: mobility * (delay * psi1 + grown * tau1),
            position: -mobility * (delay * delay * psi2 + tau1 * (delay * psi1 + tau)),
            torque_nm: 0.0,
        }
    }

    /// The state from which the new torque moves a knob in `state`.
    pub(crate) fn kick(&mut self, state: State, torque_nm: f64) -> State {
        let deviation = self.torque_nm - torque_nm;
        self.torque_nm = torque_nm;
        if state.velocity == 0.0 {
            return state;
        }
        State {
            position: state.position + deviation * self.position,
            velocity: state.velocity + deviation * self.velocity,
        }
    }
}

/// A [`Drive`] at work.
#[derive(Debug, Clone)]
pub(crate) struct Actuator {
    drive: Drive,
    /// What the motor's torque goes to, Nm.
    target: f64,
    /// The motor's torque − target, Nm.
    deviation: f64,
    /// Since the target changed, s.
    age: f64,
    /// Commands on their way, the oldest first: s until the effect, Nm.
    waiting: VecDeque<(f64, f64)>,
}

impl Actuator {
    pub(crate) fn new(drive: Drive) -> Self {
        Self {
            drive,
            target: 0.0,
            deviation: 0.0,
            age: 0.0,
            waiting: VecDeque::new(),
        }
    }

    /// A tick commands.
    pub(crate) fn command(&mut self, command_nm: f64) {
        let torque = self.drive.rounded(command_nm);
        self.waiting.push_back((self.drive.delay_s, torque));
    }

    /// Lets the commands take effect that are due within `margin` seconds, and tells when the
    /// next one is.
    pub(crate) fn take_due(&mut self, margin: f64) -> Option<f64> {
        while let Some(&(due, torque)) = self.waiting.front() {
            if due > margin {
                return Some(due);
            }
            self.waiting.pop_front();
            if torque != self.target {
                if self.drive.amplifier_tau_s > 0.0 {
                    self.deviation += self.target - torque;
                }
                self.target = torque;
                self.age = 0.0;
            }
        }
        None
    }

    /// `time` passes for the commands under way.
    pub(crate) fn wait(&mut self, time: f64) {
        for (due, _) in &mut self.waiting {
            *due -= time;
        }
    }

    /// `time` passes for the amplifier.
    pub(crate) fn follow(&mut self, time: f64) {
        self.deviation = self.deviation_after(time);
        self.age += time;
    }

    fn deviation_after(&self, time: f64) -> f64 {
        let tau = self.drive.amplifier_tau_s;
        if self.deviation == 0.0 || self.age + time > SETTLED_TAUS * tau {
            0.0
        } else {
            self.deviation * (-time / tau).exp()
        }
    }

    /// Whether the motor's torque varies while the target stays.
    pub(crate) fn is_lagging(&self) -> bool {
        self.deviation != 0.0
    }

    /// The motor's torque, Nm.
    pub(crate) fn torque(&self) -> f64 {
        self.target + self.deviation
    }

    /// The motor's torque after `time` at the same target, Nm.
    pub(crate) fn torque_after(&self, time: f64) -> f64 {
        self.target + self.deviation_after(time)
    }

    /// The motor's torque over the next `length` seconds. With y = length/τ: mean
    /// target + deviation·φ₁(y), lean deviation·(2φ₁(y) − 4φ₂(y)).
    pub(crate) fn halves(&self, length: f64) -> Halves {
        if self.deviation == 0.0 {
            return Halves::even(self.target);
        }
        let y = length / self.drive.amplifier_tau_s;
        let two = phi2(y);
        let one = phi1(y, two);
        Halves {
            mean: self.target + self.deviation * one,
            lean: self.deviation * (2.0 * one - 4.0 * two),
        }
    }
}
