//! The electrical side of a motor: windings behind an inverter, one PWM period at a time.
//!
//! The shaft's motion is given, at constant speed over the period; what comes back is the torque.
//! A scene that does not ask for it has none of this: its motor is a [`drive`](crate::drive).
//!
//! In the rotor's frame, with ω = p·speed and the voltages of the bridge at rest in the windings',
//!
//! L_d i_d' = −R i_d + ω L_q i_q + u_d,  L_q i_q' = −R i_q − ω (L_d i_d + ψ) + u_q,
//! u_d' = ω u_q,  u_q' = −ω u_d,
//!
//! and for a brushed motor L i' = −R i − k·speed + u. Both are linear with constant coefficients, so a
//! period is an exponential of their matrix, summed as its series to rounding: there is no step
//! size in the currents. Their mean torque is Simpson's over pieces of at most 1/32 of the fastest
//! time constant: an error below 1e-6 of the torque's change within the period.
//!
//! What a real inverter adds is opt-in, each by a number that is 0 where it is not wanted: see
//! [`Inverter`], [`CurrentSensing`], [`Supply`]. Cogging is the [`motor`](crate::motor)'s.
//!
//! # Assumed
//! The inverter is its average over the period: no switching ripple, switches without
//! resistance. Iron does not saturate and the back-EMF is a sine.

use std::f64::consts::TAU;

use control::ConfigError;
use control::torque::{BrushedMotor, ThreePhaseMotor};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

use crate::knob::KnobError;

/// What the bridge drives. The electrical angle of three phases is p times the shaft's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Winding {
    /// Three phases.
    ThreePhase(ThreePhaseMotor),
    /// A brushed motor from phase B to C.
    Brushed(BrushedMotor),
}

/// The bridge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inverter {
    /// The PWM period, s.
    pub pwm_period_s: f64,
    /// Steps of a duty from 0 to 1, to the nearest of which it is rounded; 0: none.
    pub pwm_steps: u16,
    /// Both switches of a phase are off for so long at each change, s; 0: none. A phase gets
    /// (duty − sgn(i)·dead time/period)·bus, i its current at the period's start.
    pub dead_time_s: f64,
    /// Below this current the loss is in proportion to it, A, as ripple and the switches' capacitance
    /// have it; 0: the whole loss from any current on.
    pub dead_time_edge_a: f64,
    /// Duties act one period later.
    pub late: bool,
}

impl Inverter {
    /// Nothing but an average.
    #[must_use]
    pub fn ideal(pwm_period_s: f64) -> Self {
        Self {
            pwm_period_s,
            pwm_steps: 0,
            dead_time_s: 0.0,
            dead_time_edge_a: 0.0,
            late: false,
        }
    }
}

/// How the currents of B and C are measured: (i + offset + noise) rounded to a step. All 0, the
/// default, is ideal.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CurrentSensing {
    /// The converter's step, A; 0: none.
    pub step_a: f64,
    /// Standard deviation of normal noise, A.
    pub noise_a: f64,
    /// Of B and C, A.
    pub offset_a: [f64; 2],
    /// Of the noise.
    pub seed: u64,
}

/// What feeds the bus: a source behind a resistance, with a capacitor on the bus,
///
/// C v' = (source − v)/R_s − power of the bridge/v.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Supply {
    /// Without load, V.
    pub source_v: f64,
    /// R_s, Ω; 0: the bus stays at `source_v`.
    pub source_ohm: f64,
    /// C, F.
    pub capacitance_f: f64,
    /// The source takes current back; else the bus rises while the motor brakes.
    pub takes_back: bool,
}

impl Supply {
    /// A bus that stays where it is.
    #[must_use]
    pub fn stiff(source_v: f64) -> Self {
        Self {
            source_v,
            source_ohm: 0.0,
            capacitance_f: 0.0,
            takes_back: true,
        }
    }
}

/// What one PWM period did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    /// The mean torque on the shaft, Nm.
    pub torque_nm: f64,
    /// The energy that the bridge took from the bus, J.
    pub drawn_j: f64,
}

/// Windings, bridge, bus and sensing, between two PWM periods.
///
/// ```
/// use control::torque::BrushedMotor;
/// use plant_sim::electrical::{CurrentSensing, Electrical, Inverter, Supply, Winding};
/// let motor = BrushedMotor { resistance_ohm: 2.0, inductance_h: 1e-3, torque_constant_nm_a: 0.05 };
/// let mut windings = Electrical::new(
///     Winding::Brushed(motor),
///     Inverter::ideal(1e-3),
///     CurrentSensing::default(),
///     Supply::stiff(10.0),
/// )?;
/// // 4 V for 2 L/R: 2 A · (1 − e⁻²).
/// windings.period([0.0, 0.7, 0.3], 0.0, 0.0);
/// assert!((windings.torque_nm() - 0.1 * (1.0 - (-2.0_f64).exp())).abs() < 1e-15);
/// # Ok::<(), plant_sim::knob::KnobError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Electrical {
    winding: Winding,
    inverter: Inverter,
    sensing: CurrentSensing,
    supply: Supply,
    /// i_d, i_q; or the brushed motor's current and 0. A.
    currents: [f64; 2],
    bus_v: f64,
    /// On their way.
    waiting: [f64; 3],
    random: Pcg64,
}

/// The most time constants R/L in a period: far beyond any motor.
const FASTEST: f64 = 100.0;

/// Pieces per unit of the fastest rate.
const PIECES: f64 = 32.0;

/// Terms of the exponential's series: 8⁻¹⁴/14! is below 1e-23.
const TERMS: u32 = 14;

/// i_d, i_q, u_d, u_q and 1.
type Vector = [f64; 5];

impl Electrical {
    /// Without current, the bus at its source's voltage, duties of 0 on their way.
    ///
    /// # Errors
    /// Refuses what is not finite or has the wrong sign, a supply with a resistance and no
    /// capacitance, and windings with R/L beyond 100 per period.
    pub fn new(
        winding: Winding,
        inverter: Inverter,
        sensing: CurrentSensing,
        supply: Supply,
    ) -> Result<Self, KnobError> {
        let above_zero = [
            ("PWM period (s)", inverter.pwm_period_s),
            ("source voltage (V)", supply.source_v),
        ];
        let windings = match winding {
            Winding::ThreePhase(motor) => [
                ("phase resistance (Ω)", motor.resistance_ohm),
                ("d inductance (H)", motor.d_inductance_h),
                ("q inductance (H)", motor.q_inductance_h),
                ("flux (Wb)", motor.flux_wb),
                ("pole pairs", f64::from(motor.pole_pairs)),
            ],
            Winding::Brushed(motor) => [
                ("resistance (Ω)", motor.resistance_ohm),
                ("inductance (H)", motor.inductance_h),
                ("inductance (H)", motor.inductance_h),
                ("torque constant (Nm/A)", motor.torque_constant_nm_a),
                ("torque constant (Nm/A)", motor.torque_constant_nm_a),
            ],
        };
        for (name, value) in above_zero.into_iter().chain(windings) {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ConfigError::NotPositive { name, value }.into());
            }
        }
        for (name, value) in [
            ("dead time (s)", inverter.dead_time_s),
            (
                "current of the whole dead time (A)",
                inverter.dead_time_edge_a,
            ),
            ("current step (A)", sensing.step_a),
            ("current noise (A)", sensing.noise_a),
            ("source resistance (Ω)", supply.source_ohm),
            ("bus capacitance (F)", supply.capacitance_f),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(ConfigError::Negative { name, value }.into());
            }
        }
        if supply.source_ohm > 0.0 && supply.capacitance_f == 0.0 {
            let (name, value) = ("bus capacitance (F)", supply.capacitance_f);
            return Err(ConfigError::NotPositive { name, value }.into());
        }
        for value in sensing.offset_a {
            if !value.is_finite() {
                let name = "current offset (A)";
                return Err(KnobError::NotFinite { name, value });
            }
        }
        let electrical = Self {
            winding,
            inverter,
            sensing,
            supply,
            currents: [0.0; 2],
            bus_v: supply.source_v,
            waiting: [0.0; 3],
            random: Pcg64::seed_from_u64(sensing.seed),
        };
        let value = electrical.rate(0.0) * inverter.pwm_period_s;
        if value > FASTEST {
            return Err(KnobError::Above {
                name: "resistance / inductance × PWM period",
                value,
                limit: FASTEST,
                reason: "far beyond any motor",
            });
        }
        Ok(electrical)
    }

    /// The bus voltage, V.
    #[must_use]
    pub fn bus_v(&self) -> f64 {
        self.bus_v
    }

    /// The torque at this moment, Nm.
    #[must_use]
    pub fn torque_nm(&self) -> f64 {
        self.torque_of(self.currents)
    }

    /// i_d and i_q, or a brushed motor's current and 0, A.
    #[must_use]
    pub fn rotor_currents(&self) -> [f64; 2] {
        self.currents
    }

    /// The currents of A, B, C with the shaft at an angle (rad), A.
    #[must_use]
    pub fn phase_currents(&self, angle_rad: f64) -> [f64; 3] {
        let [d, q] = self.currents;
        match self.winding {
            Winding::ThreePhase(motor) => {
                let (sine, cosine) = electrical_angle(&motor, angle_rad).sin_cos();
                phases(d * cosine - q * sine, d * sine + q * cosine)
            }
            Winding::Brushed(_) => [0.0, d, -d],
        }
    }

    /// The currents of B and C as measured with the shaft at an angle (rad), A.
    pub fn measure(&mut self, angle_rad: f64) -> [f64; 2] {
        let [_, b, c] = self.phase_currents(angle_rad);
        let CurrentSensing {
            step_a,
            noise_a,
            offset_a,
            ..
        } = self.sensing;
        let mut measured = [b + offset_a[0], c + offset_a[1]];
        for current in &mut measured {
            if noise_a > 0.0 {
                *current += noise_a * self.normal();
            }
            if step_a > 0.0 {
                *current = (*current / step_a).round() * step_a;
            }
        }
        measured
    }

    /// One period under duties of A, B, C, the shaft at `angle_rad` at its start and at a constant speed
    /// (rad/s).
    pub fn period(&mut self, duties: [f64; 3], angle_rad: f64, velocity_rad_s: f64) -> Period {
        let duties = if self.inverter.late {
            std::mem::replace(&mut self.waiting, duties)
        } else {
            duties
        };
        let [a, b, c] = self.given(duties, self.phase_currents(angle_rad));
        let (matrix, voltage) = match self.winding {
            Winding::ThreePhase(motor) => {
                let (alpha, beta) = (a - (a + b + c) / 3.0, (b - c) / 3.0_f64.sqrt());
                let (sine, cosine) = electrical_angle(&motor, angle_rad).sin_cos();
                let voltage = [alpha * cosine + beta * sine, beta * cosine - alpha * sine];
                (three_phase_matrix(&motor, velocity_rad_s), voltage)
            }
            Winding::Brushed(motor) => (brushed_matrix(&motor, velocity_rad_s), [b - c, 0.0]),
        };
        let period_s = self.inverter.pwm_period_s;
        let pairs = (0.5 * PIECES * self.rate(velocity_rad_s) * period_s)
            .ceil()
            .max(1.0);
        let piece_s = 0.5 * period_s / pairs;
        let mut z: Vector = [
            self.currents[0],
            self.currents[1],
            voltage[0],
            voltage[1],
            1.0,
        ];
        let (mut torque, mut power) = (0.0, 0.0);
        for _ in 0..pairs as u64 {
            let middle = exponential_times(&matrix, piece_s, &z);
            let end = exponential_times(&matrix, piece_s, &middle);
            for (weight, z) in [(1.0, &z), (4.0, &middle), (1.0, &end)] {
                torque += weight / 6.0 * self.torque_of([z[0], z[1]]);
                power += weight / 6.0 * self.power_of(z);
            }
            z = end;
        }
        self.currents = [z[0], z[1]];
        let drawn_j = power / pairs * period_s;
        self.feed(drawn_j);
        Period {
            torque_nm: torque / pairs,
            drawn_j,
        }
    }

    /// The phase voltages that duties give, V.
    fn given(&self, duties: [f64; 3], currents: [f64; 3]) -> [f64; 3] {
        let Inverter {
            pwm_period_s,
            pwm_steps,
            dead_time_s,
            dead_time_edge_a,
            ..
        } = self.inverter;
        let steps = f64::from(pwm_steps);
        let mut volts = [0.0; 3];
        for ((volt, duty), current) in volts.iter_mut().zip(duties).zip(currents) {
            let mut part = duty;
            if pwm_steps > 0 {
                part = (duty * steps).round() / steps;
            }
            if dead_time_s > 0.0 && current != 0.0 {
                let sign = if current.abs() < dead_time_edge_a {
                    current / dead_time_edge_a
                } else {
                    current.signum()
                };
                part -= sign * dead_time_s / pwm_period_s;
            }
            *volt = part * self.bus_v;
        }
        volts
    }

    /// The bus after a period in which the bridge took `drawn_j`: exactly, for a current of that much
    /// charge held over the period.
    fn feed(&mut self, drawn_j: f64) {
        let Supply {
            source_v,
            source_ohm,
            capacitance_f,
            takes_back,
        } = self.supply;
        if source_ohm == 0.0 {
            return;
        }
        let period_s = self.inverter.pwm_period_s;
        let current_a = drawn_j / period_s / self.bus_v;
        if self.bus_v > source_v && !takes_back {
            self.bus_v -= current_a * period_s / capacitance_f;
        } else {
            let goal_v = source_v - source_ohm * current_a;
            let left = (-period_s / (source_ohm * capacitance_f)).exp();
            self.bus_v = goal_v + (self.bus_v - goal_v) * left;
        }
        // A load that takes all of it stalls the bridge; it does not turn the bus round.
        self.bus_v = self.bus_v.max(1e-3 * source_v);
    }

    fn torque_of(&self, [d, q]: [f64; 2]) -> f64 {
        match self.winding {
            Winding::ThreePhase(motor) => {
                let saliency = motor.d_inductance_h - motor.q_inductance_h;
                1.5 * f64::from(motor.pole_pairs) * (motor.flux_wb + saliency * d) * q
            }
            Winding::Brushed(motor) => motor.torque_constant_nm_a * d,
        }
    }

    fn power_of(&self, [d, q, u_d, u_q, _]: &Vector) -> f64 {
        let share = match self.winding {
            Winding::ThreePhase(_) => 1.5,
            Winding::Brushed(_) => 1.0,
        };
        share * (u_d * d + u_q * q)
    }

    /// The fastest rate at which currents vary, 1/s.
    fn rate(&self, velocity_rad_s: f64) -> f64 {
        match self.winding {
            Winding::ThreePhase(motor) => {
                let (d, q) = (motor.d_inductance_h, motor.q_inductance_h);
                let omega = f64::from(motor.pole_pairs) * velocity_rad_s.abs();
                motor.resistance_ohm / d.min(q) + omega * (d / q).max(q / d)
            }
            Winding::Brushed(motor) => motor.resistance_ohm / motor.inductance_h,
        }
    }

    /// A standard normal number, by Box and Muller.
    fn normal(&mut self) -> f64 {
        let mut uniform = || ((self.random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
        let radius = (-2.0 * uniform().ln()).sqrt();
        radius * (TAU * uniform()).cos()
    }
}

fn electrical_angle(motor: &ThreePhaseMotor, angle_rad: f64) -> f64 {
    f64::from(motor.pole_pairs) * angle_rad
}

fn phases(alpha: f64, beta: f64) -> [f64; 3] {
    let side = 0.75_f64.sqrt() * beta;
    [alpha, side - 0.5 * alpha, -side - 0.5 * alpha]
}

fn three_phase_matrix(motor: &ThreePhaseMotor, velocity_rad_s: f64) -> [Vector; 5] {
    let (d, q) = (motor.d_inductance_h, motor.q_inductance_h);
    let omega = f64::from(motor.pole_pairs) * velocity_rad_s;
    let resistance = motor.resistance_ohm;
    let emf = omega * motor.flux_wb;
    [
        [-resistance / d, omega * q / d, 1.0 / d, 0.0, 0.0],
        [-omega * d / q, -resistance / q, 0.0, 1.0 / q, -emf / q],
        [0.0, 0.0, 0.0, omega, 0.0],
        [0.0, 0.0, -omega, 0.0, 0.0],
        [0.0; 5],
    ]
}

fn brushed_matrix(motor: &BrushedMotor, velocity_rad_s: f64) -> [Vector; 5] {
    let mut matrix = [[0.0; 5]; 5];
    let inductance = motor.inductance_h;
    let emf = motor.torque_constant_nm_a * velocity_rad_s;
    matrix[0] = [
        -motor.resistance_ohm / inductance,
        0.0,
        1.0 / inductance,
        0.0,
        -emf / inductance,
    ];
    matrix
}

/// e^(M·time)·z = Σ (M·time)ᵏ z/k!.
fn exponential_times(matrix: &[Vector; 5], time: f64, z: &Vector) -> Vector {
    let mut sum = *z;
    let mut term = *z;
    for k in 1..=TERMS {
        let factor = time / f64::from(k);
        term = std::array::from_fn(|row| {
            let product: f64 = matrix[row].iter().zip(&term).map(|(m, t)| m * t).sum();
            factor * product
        });
        for (total, part) in sum.iter_mut().zip(term) {
            *total += part;
        }
    }
    sum
}
