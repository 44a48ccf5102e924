//! The exact plant beside a recording: trajectories, their misfit, and the least squares.

use control::criterion::Device;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Vector3};

use super::recording::Push;
use crate::hold::{Hold, State};

/// m, b and c as numbers near 1: m = m₀·e^θ₀, b = b₀·θ₁, c = c₀·e^θ₂.
pub(super) type Theta = [f64; 3];

/// The recording, and the units of θ.
#[derive(Debug, Clone)]
pub(super) struct Model<'a> {
    pub pushes: &'a [Push],
    pub period_s: f64,
    pub count_rad: f64,
    /// m₀, c₀ and b₀ = c₀ over the largest speed.
    pub unit: Device<f64>,
}

/// What acts beside m, b and c, with one number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Extra {
    Nothing,
    /// A constant torque, in units of c₀.
    Push,
    /// The largest torque given, in units of c₀.
    Limit,
}

impl Extra {
    fn torque(self, commanded_nm: f64, size_nm: f64) -> f64 {
        match self {
            Self::Nothing => commanded_nm,
            Self::Push => commanded_nm + size_nm,
            Self::Limit => commanded_nm.clamp(-size_nm.abs(), size_nm.abs()),
        }
    }
}

impl Model<'_> {
    /// m, b and c of a θ; b below 0 is 0.
    pub fn device(&self, theta: &Theta) -> Device<f64> {
        let [m, b, c] = *theta;
        Device {
            inertia_kg_m2: self.unit.inertia_kg_m2 * m.exp(),
            viscous_nm_s_rad: self.unit.viscous_nm_s_rad * b.max(0.0),
            coulomb_nm: self.unit.coulomb_nm * c.exp(),
        }
    }

    /// Angles from the start of each push, counts, sample by sample.
    ///
    /// None where m, b and c are too extreme.
    pub fn follow(&self, theta: &Theta, extra: Extra, size: f64) -> Option<Vec<Vec<f64>>> {
        let hold = Hold::new(&self.device(theta), self.period_s).ok()?;
        let size_nm = size * self.unit.coulomb_nm;
        let follow = |push: &Push| {
            let mut state = State {
                position: 0.0,
                velocity: 0.0,
            };
            let mut angles = Vec::with_capacity(push.torques.len());
            for &torque_nm in &push.torques {
                angles.push(state.position / self.count_rad);
                state = hold.step(state, extra.torque(torque_nm, size_nm)).end;
            }
            angles
        };
        Some(self.pushes.iter().map(follow).collect())
    }

    /// What the counts are beyond the angles, sample by sample.
    pub fn beyond(&self, angles: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let beyond = |(push, angles): (&Push, &Vec<f64>)| {
            let pairs = push.counts.iter().zip(angles);
            pairs.map(|(count, angle)| count - angle).collect()
        };
        self.pushes.iter().zip(angles).map(beyond).collect()
    }

    /// A model whose θ = 0, b aside, is near, from the equation of motion integrated twice over each
    /// push from rest: m x + b ∫x dt + c s t²/2 = ∬F, s the direction. No count is differentiated.
    pub fn near(pushes: &[Push], period_s: f64, count_rad: f64) -> Option<(Model<'_>, Theta)> {
        let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
        let mut fastest = 0.0_f64;
        for push in pushes {
            let far = push.furthest();
            if far.abs() < f64::from(super::recording::LEAST_COUNTS) {
                continue;
            }
            let start = push.torques.iter().position(|&torque| torque != 0.0)?;
            let last = push.counts.iter().rposition(|&count| count != far)? + 1;
            let sign = far.signum();
            let (mut impulse, mut twice, mut area) = (0.0, 0.0, 0.0);
            let samples = push.counts.iter().zip(&push.torques).enumerate();
            let width = 8;
            for (place, (count, torque)) in samples.take(last).skip(start) {
                let t = (place - start) as f64 * period_s;
                let angle = (count + 0.5 * sign * f64::from(*count != 0.0)) * count_rad;
                let row = Vector3::new(angle, area, sign * t * t / 2.0);
                // The further, the less a count matters.
                let weight = 1.0 / (far * count_rad).powi(2) / (last - start) as f64;
                normal += row * row.transpose() * weight;
                right += row * twice * weight;
                area += angle * period_s;
                twice += (impulse + 0.5 * torque * period_s) * period_s;
                impulse += torque * period_s;
                if let Some(before) = place.checked_sub(width).and_then(|at| push.counts.get(at)) {
                    fastest =
                        fastest.max((count - before).abs() * count_rad / (width as f64 * period_s));
                }
            }
        }
        let scale = Vector3::from_fn(|row, _| 1.0 / normal[(row, row)].sqrt());
        let scaled = Matrix3::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]);
        let good = |m: f64, c: f64| m > 0.0 && c > 0.0 && m.is_finite() && c.is_finite();
        let solved = scaled
            .try_inverse()
            .map(|inverse| inverse * right.component_mul(&scale))
            .map(|solved| solved.component_mul(&scale));
        let (m, b, c) = match solved {
            Some(it) if good(it[0], it[2]) && it[1] >= 0.0 => (it[0], it[1], it[2]),
            // Without viscous friction.
            _ => {
                let det = normal[(0, 0)] * normal[(2, 2)] - normal[(0, 2)].powi(2);
                let m = (right[0] * normal[(2, 2)] - right[2] * normal[(0, 2)]) / det;
                let c = (right[2] * normal[(0, 0)] - right[0] * normal[(0, 2)]) / det;
                good(m, c).then_some((m, 0.0, c))?
            }
        };
        let unit = Device {
            inertia_kg_m2: m,
            viscous_nm_s_rad: c / fastest.max(f64::MIN_POSITIVE),
            coulomb_nm: c,
        };
        let model = Model {
            pushes,
            period_s,
            count_rad,
            unit,
        };
        let theta = [0.0, (b / unit.viscous_nm_s_rad).clamp(1e-3, 10.0), 0.0];
        Some((model, theta))
    }

    /// The least squares of angle against count, each push from its own best start.
    ///
    /// Returns θ and the size of what acts beside. The errors of counts are no noise, so this is where to
    /// look, and no measure of how sure it is: see [`super::bounds`].
    pub fn fit(&self, start: &Theta, extra: Extra, size: f64) -> (Theta, f64) {
        let [m, b, c] = *start;
        let mut parameters = vec![m, b.max(1e-6).sqrt(), c];
        if extra != Extra::Nothing {
            parameters.push(size);
        }
        let problem = Fit {
            model: self,
            extra,
            parameters: DVector::from_vec(parameters),
        };
        let (fit, _) = LevenbergMarquardt::new()
            .with_patience(20)
            .minimize(problem);
        fit.theta()
    }
}

/// Rows of a push in the least squares.
const ROWS: usize = 120;

/// Step of a difference quotient in θ.
const STEP: f64 = 1e-6;

struct Fit<'a> {
    model: &'a Model<'a>,
    extra: Extra,
    /// θ, with the root of b, which so stays above 0; and the size of what acts beside.
    parameters: DVector<f64>,
}

impl Fit<'_> {
    fn theta(&self) -> (Theta, f64) {
        let p = &self.parameters;
        let size = if self.extra == Extra::Nothing {
            0.0
        } else {
            p[3]
        };
        ([p[0], p[1] * p[1], p[2]], size)
    }

    fn residuals_at(&self, parameters: &DVector<f64>) -> Option<DVector<f64>> {
        let at = Fit {
            model: self.model,
            extra: self.extra,
            parameters: parameters.clone(),
        };
        let (theta, size) = at.theta();
        if theta.iter().any(|it| it.abs() > 50.0) {
            return None;
        }
        let angles = self.model.follow(&theta, self.extra, size)?;
        let mut rows = Vec::new();
        for beyond in self.model.beyond(&angles) {
            let step = (beyond.len() / ROWS).max(1);
            let first = rows.len();
            rows.extend(beyond.iter().step_by(step));
            let own = rows.get_mut(first..)?;
            let mean = own.iter().sum::<f64>() / own.len() as f64;
            own.iter_mut().for_each(|row| *row -= mean);
        }
        rows.iter()
            .all(|row| row.is_finite())
            .then(|| DVector::from_vec(rows))
    }
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Fit<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, parameters: &DVector<f64>) {
        self.parameters.copy_from(parameters);
    }

    fn params(&self) -> DVector<f64> {
        self.parameters.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        self.residuals_at(&self.parameters)
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let mut columns = Vec::new();
        for place in 0..self.parameters.len() {
            let (mut up, mut down) = (self.parameters.clone(), self.parameters.clone());
            up[place] += STEP;
            down[place] -= STEP;
            let difference = self.residuals_at(&up)? - self.residuals_at(&down)?;
            columns.push(difference / (2.0 * STEP));
        }
        Some(DMatrix::from_columns(&columns))
    }
}
