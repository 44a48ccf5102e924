//! Which m, b and c explain every count.
//!
//! A count n says that the angle lies in [n, n + 1) counts: that is a bound, not noise. With y the angle of
//! the exact plant since the start of a push, which began somewhere in its count, all counts of the push
//! are explained if, and only if, the range of n − y over its samples is at most 1: max(n − y) − min(n − y) ≤ 1.
//! The true m, b and c are among those that explain every push; the intervals are the ends of that set.
//! Each end is found by linear programs over the linearised plant, the exact plant being linearised anew where
//! each leads until it stays there.

use microlp::{ComparisonOp, OptimizationDirection, Problem, SolveOutcome, Variable};

use super::model::{Extra, Model, Theta};

/// How far one linear program may go: in ln m and ln c, and of b in its unit.
const REACH: f64 = 0.3;

/// Steps of a difference quotient in θ.
const STEP: f64 = 1e-5;

/// A constraint may be broken by so much, counts.
const SLACK: f64 = 1e-6;

/// So many linearisations at most.
const TURNS: u32 = 12;

/// So many rounds of constraints at most.
const ROUNDS: u32 = 60;

/// What is sought.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Aim {
    /// The least range that every push can have.
    Range,
    /// θ of this number, the most (1.0) or the least (−1.0), with ranges up to `within`.
    End {
        which: usize,
        sign: f64,
        within: f64,
    },
}

/// One push, linearised.
struct Linear {
    /// n − y.
    beyond: Vec<f64>,
    /// ∂y/∂θ.
    slope: Vec<Theta>,
}

/// The range of each push, counts: the largest.
pub(super) fn range(model: &Model<'_>, theta: &Theta) -> f64 {
    let Some(angles) = model.follow(theta, Extra::Nothing, 0.0) else {
        return f64::INFINITY;
    };
    largest_range(&model.beyond(&angles))
}

/// The same of n − y.
pub(super) fn largest_range(beyond: &[Vec<f64>]) -> f64 {
    let range = |one: &Vec<f64>| {
        let most = one.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let least = one.iter().copied().fold(f64::INFINITY, f64::min);
        most - least
    };
    beyond.iter().map(range).fold(0.0, f64::max)
}

fn linearise(model: &Model<'_>, theta: &Theta) -> Option<Vec<Linear>> {
    let follow = |theta: &Theta| model.follow(theta, Extra::Nothing, 0.0);
    let beyond = model.beyond(&follow(theta)?);
    let mut linear: Vec<Linear> = beyond
        .into_iter()
        .map(|beyond| Linear {
            slope: vec![[0.0; 3]; beyond.len()],
            beyond,
        })
        .collect();
    for which in 0..3 {
        let (mut up, mut down) = (*theta, *theta);
        up[which] += STEP;
        // b does not go below 0.
        if which != 1 || theta[1] >= STEP {
            down[which] -= STEP;
        }
        let width = up[which] - down[which];
        for ((linear, up), down) in linear.iter_mut().zip(follow(&up)?).zip(follow(&down)?) {
            for ((slope, up), down) in linear.slope.iter_mut().zip(up).zip(down) {
                slope[which] = (up - down) / width;
            }
        }
    }
    Some(linear)
}

/// A constraint: of which push, of which sample, and whether n + range bounds it from above.
type Row = (usize, usize, bool);

/// The step in θ that the linearised plant asks for; none if no step explains the counts.
///
/// Of all samples only those that bind become rows: solved with some, those that the solution breaks
/// most are added, until it breaks none.
fn step(linear: &[Linear], theta: &Theta, aim: Aim) -> Option<Theta> {
    // Unknowns in counts: then all coefficients are near 1.
    let mut scale = [0.0_f64; 3];
    for slope in linear.iter().flat_map(|push| &push.slope) {
        for (scale, slope) in scale.iter_mut().zip(slope) {
            *scale = scale.max(slope.abs());
        }
    }
    if scale
        .iter()
        .any(|&scale| scale == 0.0 || !scale.is_finite())
    {
        return None;
    }
    let mut rows: Vec<Row> = Vec::new();
    for (push, one) in linear.iter().enumerate() {
        let by = |a: &usize, b: &usize| one.beyond[*a].total_cmp(&one.beyond[*b]);
        let places = 0..one.beyond.len();
        rows.push((push, places.clone().max_by(by)?, false));
        rows.push((push, places.min_by(by)?, true));
    }
    for _ in 0..ROUNDS {
        let solved = solve(linear, theta, aim, &scale, &rows)?;
        let broken = broken(linear, &solved);
        if broken.is_empty() {
            return Some(solved.step);
        }
        rows.extend(broken);
    }
    None
}

/// A solution of the linear program.
struct Solved {
    step: Theta,
    range: f64,
    starts: Vec<f64>,
}

fn solve(
    linear: &[Linear],
    theta: &Theta,
    aim: Aim,
    scale: &Theta,
    rows: &[Row],
) -> Option<Solved> {
    let direction = match aim {
        Aim::End { sign, .. } if sign > 0.0 => OptimizationDirection::Maximize,
        _ => OptimizationDirection::Minimize,
    };
    let mut problem = Problem::new(direction);
    let mut unknown = |which: usize| {
        let wanted = matches!(aim, Aim::End { which: end, .. } if end == which);
        let (down, up) = match which {
            // b does not go below 0.
            1 => {
                let reach = REACH * theta[1].max(1.0);
                (reach.min(theta[1].max(0.0)), reach)
            }
            _ => (REACH, REACH),
        };
        let bounds = (-down * scale[which], up * scale[which]);
        problem.add_var(f64::from(wanted), bounds)
    };
    let unknowns = [unknown(0), unknown(1), unknown(2)];
    let range = match aim {
        Aim::Range => problem.add_var(1.0, (0.0, f64::INFINITY)),
        Aim::End { within, .. } => problem.add_var(0.0, (within, within)),
    };
    let anywhere = (f64::NEG_INFINITY, f64::INFINITY);
    let starts: Vec<Variable> = linear
        .iter()
        .map(|_| problem.add_var(0.0, anywhere))
        .collect();
    for &(push, sample, upper) in rows {
        // n ≤ start + y + slope·step ≤ n + range.
        let one = linear.get(push)?;
        let mut row = vec![(*starts.get(push)?, 1.0)];
        for which in 0..3 {
            row.push((
                unknowns[which],
                one.slope.get(sample)?[which] / scale[which],
            ));
        }
        let comparison = if upper {
            row.push((range, -1.0));
            ComparisonOp::Le
        } else {
            ComparisonOp::Ge
        };
        problem.add_constraint(row, comparison, *one.beyond.get(sample)?);
    }
    let Ok(SolveOutcome::Solution(solution)) = problem.solve() else {
        return None;
    };
    Some(Solved {
        step: [0, 1, 2].map(|which| solution.var_value(unknowns[which]) / scale[which]),
        range: solution.var_value(range),
        starts: starts
            .iter()
            .map(|&start| solution.var_value(start))
            .collect(),
    })
}

/// The samples of each push that a solution breaks most.
fn broken(linear: &[Linear], solved: &Solved) -> Vec<Row> {
    let mut broken = Vec::new();
    for (push, (one, start)) in linear.iter().zip(&solved.starts).enumerate() {
        let (mut low, mut high) = ((SLACK, None), (SLACK, None));
        for (sample, (beyond, slope)) in one.beyond.iter().zip(&one.slope).enumerate() {
            let moved: f64 = slope.iter().zip(&solved.step).map(|(a, b)| a * b).sum();
            let above = start + moved - beyond;
            if -above > low.0 {
                low = (-above, Some(sample));
            }
            if above - solved.range > high.0 {
                high = (above - solved.range, Some(sample));
            }
        }
        broken.extend(low.1.map(|sample| (push, sample, false)));
        broken.extend(high.1.map(|sample| (push, sample, true)));
    }
    broken
}

fn moved(theta: &Theta, step: &Theta) -> Theta {
    let [m, b, c] = *theta;
    [m + step[0], (b + step[1]).max(0.0), c + step[2]]
}

/// The θ with the least range from near `start` on, and that range, counts.
pub(super) fn least_range(model: &Model<'_>, start: &Theta) -> (Theta, f64) {
    let mut best = (*start, range(model, start));
    let mut theta = *start;
    for _ in 0..TURNS {
        let Some(linear) = linearise(model, &theta) else {
            break;
        };
        let Some(step) = step(&linear, &theta, Aim::Range) else {
            break;
        };
        theta = moved(&theta, &step);
        let now = range(model, &theta);
        if now < best.1 {
            let gain = best.1 - now;
            best = (theta, now);
            if gain > 1e-3 {
                continue;
            }
        }
        break;
    }
    best
}

/// The most (sign 1.0) or the least (−1.0) that θ of this number can be with ranges up to `within`, from a
/// θ that has them; None if it was not found.
pub(super) fn end(
    model: &Model<'_>,
    inside: &Theta,
    which: usize,
    sign: f64,
    within: f64,
) -> Option<f64> {
    let aim = Aim::End {
        which,
        sign,
        within,
    };
    let mut theta = *inside;
    for _ in 0..TURNS {
        let linear = linearise(model, &theta)?;
        let step = step(&linear, &theta, aim)?;
        theta = moved(&theta, &step);
        let width = (theta[which] - inside[which]).abs();
        if step[which].abs() <= 1e-3 * width + 1e-9 {
            return Some(theta[which]);
        }
    }
    None
}
