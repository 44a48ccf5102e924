//! The windings' equations, while the same phases conduct under the same voltages at constant speed.

use control::torque::{BrushedMotor, ThreePhaseMotor};

use super::Winding;

/// Pieces per unit of the fastest rate.
const PIECES: f64 = 32.0;

/// Terms of the exponential's series: 8⁻¹⁴/14! is below 1e-23.
const TERMS: u32 = 14;

/// Halvings of a piece in which a current ends: to rounding.
const HALVINGS: u32 = 50;

/// i_d, i_q, u_d, u_q and 1.
pub(super) type Vector = [f64; 5];

/// Which terminals carry current. A brushed motor's are B and C.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Carrying {
    All,
    /// Of three phases, all but one.
    AllBut(usize),
    None,
}

/// What a time did: ∫torque dt, Nm s, and the energy that came from the bus, J.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Done {
    pub(super) torque_nm_s: f64,
    pub(super) drawn_j: f64,
}

/// Windings under constant voltages of their terminals at constant speed.
pub(super) struct Run<'a> {
    winding: &'a Winding,
    carrying: Carrying,
    matrix: [Vector; 5],
    /// Electrical, rad/s.
    omega: f64,
    /// Electrical, at the start, rad.
    angle: f64,
    velocity_rad_s: f64,
    start: Vector,
}

impl<'a> Run<'a> {
    /// From i_d and i_q (or the current of a brushed motor and 0), A, under the voltages of A, B, C, V.
    pub(super) fn new(
        winding: &'a Winding,
        carrying: Carrying,
        [d, q]: [f64; 2],
        [a, b, c]: [f64; 3],
        angle_rad: f64,
        velocity_rad_s: f64,
    ) -> Self {
        let (matrix, [u_d, u_q]) = match winding {
            Winding::ThreePhase(motor) => {
                let (alpha, beta) = (a - (a + b + c) / 3.0, (b - c) / 3.0_f64.sqrt());
                let (sine, cosine) = winding.electrical(angle_rad).sin_cos();
                let voltage = [alpha * cosine + beta * sine, beta * cosine - alpha * sine];
                (three_phase_matrix(motor, velocity_rad_s), voltage)
            }
            Winding::Brushed(motor) => (brushed_matrix(motor, velocity_rad_s), [b - c, 0.0]),
        };
        Self {
            winding,
            carrying,
            matrix,
            omega: winding.electrical(velocity_rad_s),
            angle: winding.electrical(angle_rad),
            velocity_rad_s,
            start: [d, q, u_d, u_q, 1.0],
        }
    }

    /// The currents after `time_s`.
    pub(super) fn through(&self, time_s: f64, done: &mut Done) -> [f64; 2] {
        let pairs = self.pairs(time_s);
        let pair_s = time_s / pairs;
        let mut z = self.start;
        for n in 0..pairs as u64 {
            z = self.pair(n as f64 * pair_s, pair_s, &z, done);
        }
        [z[0], z[1]]
    }

    /// [`Run::through`], at most until one of the currents turns round against its sign in `signs`: the
    /// time that took, the currents then, and the terminal whose current ended.
    pub(super) fn until_one_ends(
        &self,
        signs: [f64; 3],
        time_s: f64,
        done: &mut Done,
    ) -> (f64, [f64; 2], Option<usize>) {
        let ended = |time: f64, z: &Vector| -> Option<usize> {
            let currents = self.phases(time, z);
            (0..3).find(|&k| currents[k] * signs[k] < 0.0)
        };
        let pairs = self.pairs(time_s);
        let pair_s = time_s / pairs;
        let mut z = self.start;
        for n in 0..pairs as u64 {
            let from = n as f64 * pair_s;
            let end = self.after(from, 0.5 * pair_s, &z);
            let end = self.after(from + 0.5 * pair_s, 0.5 * pair_s, &end);
            let Some(mut which) = ended(from + pair_s, &end) else {
                z = self.pair(from, pair_s, &z, done);
                continue;
            };
            let (mut yes, mut no) = (0.0, pair_s);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (yes + no);
                match ended(from + middle, &self.after(from, middle, &z)) {
                    Some(other) => (no, which) = (middle, other),
                    None => yes = middle,
                }
            }
            let z = self.pair(from, yes, &z, done);
            return (from + yes, [z[0], z[1]], Some(which));
        }
        (time_s, [z[0], z[1]], None)
    }

    fn pairs(&self, time_s: f64) -> f64 {
        let rate = self.winding.rate(self.velocity_rad_s);
        (0.5 * PIECES * rate * time_s).ceil().max(1.0)
    }

    /// Two pieces, and their Simpson's rule.
    fn pair(&self, from_s: f64, pair_s: f64, z: &Vector, done: &mut Done) -> Vector {
        let piece_s = 0.5 * pair_s;
        let middle = self.after(from_s, piece_s, z);
        let end = self.after(from_s + piece_s, piece_s, &middle);
        for (weight, z) in [(1.0, z), (4.0, &middle), (1.0, &end)] {
            done.torque_nm_s += weight / 6.0 * pair_s * self.winding.torque_nm([z[0], z[1]]);
            done.drawn_j += weight / 6.0 * pair_s * self.winding.power_w(z);
        }
        end
    }

    fn after(&self, from_s: f64, time_s: f64, z: &Vector) -> Vector {
        match (self.carrying, self.winding) {
            (Carrying::AllBut(open), Winding::ThreePhase(motor)) => {
                self.line_after(motor, open, from_s, time_s, z)
            }
            _ => exponential_times(&self.matrix, time_s, z),
        }
    }

    fn phases(&self, time_s: f64, z: &Vector) -> [f64; 3] {
        let angle = self.angle + self.omega * time_s;
        self.winding.phases(self.carrying, [z[0], z[1]], angle)
    }

    /// A step of Runge and Kutta's for the flux between the two phases that are not open.
    fn line_after(
        &self,
        motor: &ThreePhaseMotor,
        open: usize,
        from_s: f64,
        time_s: f64,
        z: &Vector,
    ) -> Vector {
        let root = 3.0_f64.sqrt();
        // From the rotor's d axis to the line, rad.
        let lead = |time: f64| line_angle(open) - self.angle - self.omega * time;
        let current = |flux: f64, time: f64| {
            let (sine, cosine) = lead(time).sin_cos();
            let inductance =
                2.0 * (motor.d_inductance_h * cosine * cosine + motor.q_inductance_h * sine * sine);
            (flux - root * motor.flux_wb * cosine) / inductance
        };
        let [d, q, u_d, u_q, _] = *z;
        let (sine, cosine) = lead(from_s).sin_cos();
        let flux = root
            * ((motor.d_inductance_h * d + motor.flux_wb) * cosine
                + motor.q_inductance_h * q * sine);
        let volts = root * (u_d * cosine + u_q * sine);
        let slope = |flux: f64, time: f64| volts - 2.0 * motor.resistance_ohm * current(flux, time);
        let (middle_s, end_s) = (from_s + 0.5 * time_s, from_s + time_s);
        let k1 = slope(flux, from_s);
        let k2 = slope(flux + 0.5 * time_s * k1, middle_s);
        let k3 = slope(flux + 0.5 * time_s * k2, middle_s);
        let k4 = slope(flux + time_s * k3, end_s);
        let flux = flux + time_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
        let length = 2.0 / root * current(flux, end_s);
        let (sine, cosine) = lead(end_s).sin_cos();
        let (turn_sine, turn_cosine) = (self.omega * time_s).sin_cos();
        [
            length * cosine,
            length * sine,
            u_d * turn_cosine + u_q * turn_sine,
            u_q * turn_cosine - u_d * turn_sine,
            1.0,
        ]
    }
}

impl Winding {
    /// The electrical angle of the shaft's, and the speed of its.
    pub(super) fn electrical(&self, shaft: f64) -> f64 {
        match self {
            Winding::ThreePhase(motor) => f64::from(motor.pole_pairs) * shaft,
            Winding::Brushed(_) => shaft,
        }
    }

    /// The currents of the terminals at an electrical angle, A; of those that carry none exactly 0.
    pub(super) fn phases(&self, carrying: Carrying, [d, q]: [f64; 2], angle: f64) -> [f64; 3] {
        match (carrying, self) {
            (Carrying::None, _) => [0.0; 3],
            (_, Winding::Brushed(_)) => [0.0, d, -d],
            (Carrying::All, Winding::ThreePhase(_)) => {
                let (sine, cosine) = angle.sin_cos();
                let (alpha, beta) = (d * cosine - q * sine, d * sine + q * cosine);
                let side = 0.75_f64.sqrt() * beta;
                [alpha, side - 0.5 * alpha, -side - 0.5 * alpha]
            }
            (Carrying::AllBut(open), Winding::ThreePhase(_)) => {
                let (sine, cosine) = (line_angle(open) - angle).sin_cos();
                let current = 0.75_f64.sqrt() * (d * cosine + q * sine);
                let mut phases = [0.0; 3];
                phases[(open + 1) % 3] = current;
                phases[(open + 2) % 3] = -current;
                phases
            }
        }
    }

    pub(super) fn torque_nm(&self, [d, q]: [f64; 2]) -> f64 {
        match self {
            Winding::ThreePhase(motor) => {
                let saliency = motor.d_inductance_h - motor.q_inductance_h;
                1.5 * f64::from(motor.pole_pairs) * (motor.flux_wb + saliency * d) * q
            }
            Winding::Brushed(motor) => motor.torque_constant_nm_a * d,
        }
    }

    /// What the bridge takes from the bus, W.
    fn power_w(&self, [d, q, u_d, u_q, _]: &Vector) -> f64 {
        let share = match self {
            Winding::ThreePhase(_) => 1.5,
            Winding::Brushed(_) => 1.0,
        };
        share * (u_d * d + u_q * q)
    }

    /// The fastest rate at which currents vary, 1/s.
    pub(super) fn rate(&self, velocity_rad_s: f64) -> f64 {
        match self {
            Winding::ThreePhase(motor) => {
                let (d, q) = (motor.d_inductance_h, motor.q_inductance_h);
                let omega = f64::from(motor.pole_pairs) * velocity_rad_s.abs();
                motor.resistance_ohm / d.min(q) + omega * (d / q).max(q / d)
            }
            Winding::Brushed(motor) => motor.resistance_ohm / motor.inductance_h,
        }
    }
}

/// From phase A's axis to that of the other two phases with one open: square to the open one's, rad.
fn line_angle(open: usize) -> f64 {
    std::f64::consts::FRAC_PI_2 + open as f64 * std::f64::consts::TAU / 3.0
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
