//! The exact plant beside a recording: trajectories, their misfit, and the least squares.

use control::criterion::Device;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{DMatrix, DVector, Dyn};

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

    /// A model whose θ = 0, b aside, is near, from the lowest push: with d₁ travelled under the torque
    /// F for a time t, and d₂ without it, c ≈ F·d₁/(d₁ + d₂) and m ≈ (F − c)·t²/2d₁.
    pub fn near(pushes: &[Push], period_s: f64, count_rad: f64) -> Option<(Model<'_>, Theta)> {
        let moving = || pushes.iter().filter(|push| push.moves());
        let lowest = moving().min_by(|a, b| a.height_nm().abs().total_cmp(&b.height_nm().abs()))?;
        let pushed = lowest.torques.iter().position(|&torque| torque != 0.0)?;
        let released = 1 + lowest.torques.iter().rposition(|&torque| torque != 0.0)?;
        let way = lowest.counts.get(released)?.abs().max(1.0);
        let whole = lowest.counts.last()?.abs().max(way + 1.0);
        let height = lowest.height_nm().abs();
        // A knob that does not coast, or comes back, has some friction and inertia to begin with.
        let c = height * way / whole.max(1.05 * way);
        let time_s = (released - pushed) as f64 * period_s;
        let m = (height - c) * time_s * time_s / (2.0 * way * count_rad);
        let longest = moving()
            .map(|push| push.furthest().abs())
            .fold(0.0, f64::max);
        // As fast as a coast-down of half the way begins.
        let fastest = (longest * count_rad * c / m).sqrt();
        let unit = Device {
            inertia_kg_m2: m,
            viscous_nm_s_rad: c / fastest,
            coulomb_nm: c,
        };
        let model = Model {
            pushes,
            period_s,
            count_rad,
            unit,
        };
        Some((model, [0.0, 0.1, 0.0]))
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
            .with_patience(10)
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
