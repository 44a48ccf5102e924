//! Parameters as a user writes and reads them: NAME=VALUE.

use std::fmt;

use protocol::{Changes, Interval, Law, Name, Parameters, Shape};
use serde::ser::{Serialize, SerializeMap, Serializer};

use crate::number;

/// The name of a parameter.
///
/// # Errors
/// What names there are.
pub fn name(text: &str) -> Result<Name, String> {
    Name::ALL
        .iter()
        .copied()
        .find(|name| name.as_str() == text)
        .ok_or_else(|| {
            let all: Vec<&str> = Name::ALL.iter().map(|name| name.as_str()).collect();
            format!(
                "there is no parameter `{text}`; accepted: {}",
                all.join(", ")
            )
        })
}

/// One NAME=VALUE.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assignment {
    pub name: Name,
    value: Value,
}

impl Assignment {
    /// Reads `NAME=VALUE`.
    ///
    /// # Errors
    /// What is wrong with it, and what would be accepted.
    pub fn read(text: &str) -> Result<Self, String> {
        let (name_text, value) = text.split_once('=').ok_or_else(|| {
            format!("`{text}` sets nothing; accepted: NAME=VALUE, such as stiffness_nm_rad=0.5")
        })?;
        let name = name(name_text.trim())?;
        let value = Value::read(name, value.trim())
            .map_err(|wrong| format!("{}: {wrong}", name.as_str()))?;
        Ok(Self { name, value })
    }
}

/// All of them as one set of changes.
///
/// # Errors
/// A name that comes twice.
pub fn changes(assignments: &[Assignment]) -> Result<Changes, String> {
    let mut changes = Changes::default();
    for (place, assignment) in assignments.iter().enumerate() {
        let name = assignment.name;
        let others = assignments.get(..place).unwrap_or_default();
        if others.iter().any(|other| other.name == name) {
            return Err(format!(
                "{} is set twice; accepted: each name once",
                name.as_str()
            ));
        }
        assignment.value.put(name, &mut changes);
    }
    Ok(changes)
}

/// A value of any parameter. Shown as it can be read again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    Number(f32),
    Whole(u32),
    Law(Law),
    Shape(Shape),
    Interval(Interval),
}

impl Value {
    fn read(name: Name, text: &str) -> Result<Self, String> {
        match name {
            Name::SamplePeriodS
            | Name::StiffnessNmRad
            | Name::DampingNmSRad
            | Name::CentreRad
            | Name::WallRad
            | Name::PeriodRad
            | Name::TorqueMaxNm
            | Name::SpeedMaxRadS
            | Name::DelayS
            | Name::AmplifierTauS
            | Name::JitterS
            | Name::TorqueStepNm => single(text).map(Self::Number),
            Name::Decimation | Name::CountsPerRev => text.parse().map(Self::Whole).map_err(|_| {
                format!("`{text}` is not a whole number; accepted: one from 0 to 4294967295")
            }),
            Name::Law => one_of("law", &LAWS, law, text).map(Self::Law),
            Name::Shape => one_of("shape", &SHAPES, shape, text).map(Self::Shape),
            Name::InertiaKgM2 | Name::ViscousNmSRad | Name::CoulombNm => {
                let (low, high) = text.split_once("..").unwrap_or((text, text));
                Ok(Self::Interval(Interval {
                    low: single(low)?,
                    high: single(high)?,
                }))
            }
        }
    }

    /// Puts it in its place; what [`Value::read`] gave for this name fits there.
    fn put(self, name: Name, changes: &mut Changes) {
        match (name, self) {
            (Name::SamplePeriodS, Self::Number(it)) => changes.sample_period_s = Some(it),
            (Name::StiffnessNmRad, Self::Number(it)) => changes.stiffness_nm_rad = Some(it),
            (Name::DampingNmSRad, Self::Number(it)) => changes.damping_nm_s_rad = Some(it),
            (Name::CentreRad, Self::Number(it)) => changes.centre_rad = Some(it),
            (Name::WallRad, Self::Number(it)) => changes.wall_rad = Some(it),
            (Name::PeriodRad, Self::Number(it)) => changes.period_rad = Some(it),
            (Name::TorqueMaxNm, Self::Number(it)) => changes.torque_max_nm = Some(it),
            (Name::SpeedMaxRadS, Self::Number(it)) => changes.speed_max_rad_s = Some(it),
            (Name::Decimation, Self::Whole(it)) => changes.decimation = Some(it),
            (Name::CountsPerRev, Self::Whole(it)) => changes.counts_per_rev = Some(it),
            (Name::Law, Self::Law(it)) => changes.law = Some(it),
            (Name::Shape, Self::Shape(it)) => changes.shape = Some(it),
            (Name::InertiaKgM2, Self::Interval(it)) => changes.inertia_kg_m2 = Some(it),
            (Name::ViscousNmSRad, Self::Interval(it)) => changes.viscous_nm_s_rad = Some(it),
            (Name::CoulombNm, Self::Interval(it)) => changes.coulomb_nm = Some(it),
            (Name::DelayS, Self::Number(it)) => changes.delay_s = Some(it),
            (Name::AmplifierTauS, Self::Number(it)) => changes.amplifier_tau_s = Some(it),
            (Name::JitterS, Self::Number(it)) => changes.jitter_s = Some(it),
            (Name::TorqueStepNm, Self::Number(it)) => changes.torque_step_nm = Some(it),
            _ => {}
        }
    }
}

/// The value of one parameter.
pub fn value(all: &Parameters, name: Name) -> Value {
    match name {
        Name::SamplePeriodS => Value::Number(all.sample_period_s),
        Name::Decimation => Value::Whole(all.decimation),
        Name::CountsPerRev => Value::Whole(all.counts_per_rev),
        Name::Law => Value::Law(all.law),
        Name::Shape => Value::Shape(all.shape),
        Name::StiffnessNmRad => Value::Number(all.stiffness_nm_rad),
        Name::DampingNmSRad => Value::Number(all.damping_nm_s_rad),
        Name::CentreRad => Value::Number(all.centre_rad),
        Name::WallRad => Value::Number(all.wall_rad),
        Name::PeriodRad => Value::Number(all.period_rad),
        Name::TorqueMaxNm => Value::Number(all.torque_max_nm),
        Name::SpeedMaxRadS => Value::Number(all.speed_max_rad_s),
        Name::InertiaKgM2 => Value::Interval(all.inertia_kg_m2),
        Name::ViscousNmSRad => Value::Interval(all.viscous_nm_s_rad),
        Name::CoulombNm => Value::Interval(all.coulomb_nm),
        Name::DelayS => Value::Number(all.delay_s),
        Name::AmplifierTauS => Value::Number(all.amplifier_tau_s),
        Name::JitterS => Value::Number(all.jitter_s),
        Name::TorqueStepNm => Value::Number(all.torque_step_nm),
    }
}

/// A finite number that an `f32` can hold.
fn single(text: &str) -> Result<f32, String> {
    let number = number::finite(text)?;
    let single = number as f32;
    if single.is_finite() && (single != 0.0 || number == 0.0) {
        Ok(single)
    } else {
        Err(format!(
            "{} is beyond a 32-bit float; accepted: 0, or 1e-45 to 3.4e38 in magnitude",
            text.trim()
        ))
    }
}

/// The fewest digits that give the same `f32` again.
pub fn short(number: f32) -> String {
    let magnitude = number.abs();
    if magnitude == 0.0 || (1e-4..1e7).contains(&magnitude) || !magnitude.is_finite() {
        format!("{number}")
    } else {
        format!("{number:e}")
    }
}

const LAWS: [Law; 5] = [Law::Raw, Law::Static, Law::Episode, Law::Ledger, Law::Auto];

/// A law in a word.
pub fn law(law: Law) -> &'static str {
    match law {
        Law::Raw => "raw",
        Law::Static => "static",
        Law::Episode => "episode",
        Law::Ledger => "ledger",
        Law::Auto => "auto",
    }
}

const SHAPES: [Shape; 3] = [Shape::Spring, Shape::Wall, Shape::Detent];

fn shape(shape: Shape) -> &'static str {
    match shape {
        Shape::Spring => "spring",
        Shape::Wall => "wall",
        Shape::Detent => "detent",
    }
}

/// The one that is called so.
fn one_of<T: Copy>(
    kind: &str,
    all: &[T],
    word: impl Fn(T) -> &'static str,
    text: &str,
) -> Result<T, String> {
    all.iter()
        .copied()
        .find(|one| word(*one) == text)
        .ok_or_else(|| {
            let words: Vec<&str> = all.iter().map(|one| word(*one)).collect();
            format!(
                "there is no {kind} `{text}`; accepted: {}",
                words.join(", ")
            )
        })
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(it) => f.write_str(&short(*it)),
            Self::Whole(it) => it.fmt(f),
            Self::Law(it) => f.write_str(law(*it)),
            Self::Shape(it) => f.write_str(shape(*it)),
            Self::Interval(Interval { low, high }) if low == high => f.write_str(&short(*low)),
            Self::Interval(Interval { low, high }) => {
                write!(f, "{}..{}", short(*low), short(*high))
            }
        }
    }
}

/// As in a scene file: numbers, words, and `[low, high]`.
impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Number(it) => serializer.serialize_f32(*it),
            Self::Whole(it) => serializer.serialize_u32(*it),
            Self::Law(it) => serializer.serialize_str(law(*it)),
            Self::Shape(it) => serializer.serialize_str(shape(*it)),
            Self::Interval(Interval { low, high }) => [low, high].serialize(serializer),
        }
    }
}

/// Some parameters by name, as one JSON object.
pub struct Named<'a> {
    pub all: &'a Parameters,
    pub names: &'a [Name],
}

impl Serialize for Named<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.names.len()))?;
        for name in self.names {
            map.serialize_entry(name.as_str(), &value(self.all, *name))?;
        }
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOME: Parameters = Parameters {
        sample_period_s: 1e-3,
        decimation: 3,
        counts_per_rev: 8192,
        law: Law::Auto,
        shape: Shape::Detent,
        stiffness_nm_rad: 12.5,
        damping_nm_s_rad: 2.5e-5,
        centre_rad: -0.1,
        wall_rad: 1e-7,
        period_rad: 0.2,
        torque_max_nm: 0.0,
        speed_max_rad_s: 1e9,
        inertia_kg_m2: Interval {
            low: 6.28e-6,
            high: 6.28e-6,
        },
        viscous_nm_s_rad: Interval {
            low: 0.0,
            high: 9e-6,
        },
        coulomb_nm: Interval {
            low: 1.8e-3,
            high: 2.2e-3,
        },
        delay_s: 1e-4,
        amplifier_tau_s: 2e-4,
        jitter_s: 3e-5,
        torque_step_nm: 4e-4,
    };

    const OTHER: Parameters = Parameters {
        sample_period_s: 2.0,
        decimation: 7,
        counts_per_rev: 9,
        law: Law::Raw,
        shape: Shape::Spring,
        stiffness_nm_rad: 3.0,
        damping_nm_s_rad: 9.0,
        centre_rad: 4.0,
        wall_rad: 5.0,
        period_rad: 10.0,
        torque_max_nm: 6.0,
        speed_max_rad_s: 8.0,
        inertia_kg_m2: Interval {
            low: 1.0,
            high: 2.0,
        },
        viscous_nm_s_rad: Interval {
            low: 1.0,
            high: 2.0,
        },
        coulomb_nm: Interval {
            low: 1.0,
            high: 2.0,
        },
        delay_s: 11.0,
        amplifier_tau_s: 12.0,
        jitter_s: 13.0,
        torque_step_nm: 14.0,
    };

    #[test]
    fn what_is_shown_can_be_read_again() {
        let read: Vec<Assignment> = Name::ALL
            .iter()
            .map(|name| format!("{}={}", name.as_str(), value(&SOME, *name)))
            .map(|text| Assignment::read(&text).unwrap())
            .collect();
        assert_eq!(OTHER.with(&changes(&read).unwrap()), SOME);
    }

    #[test]
    fn json_keeps_every_number_as_it_is_written() {
        let names = &[Name::SamplePeriodS, Name::Law, Name::CoulombNm];
        let json = serde_json::to_string(&Named { all: &SOME, names }).unwrap();
        assert_eq!(
            json,
            r#"{"sample_period_s":0.001,"law":"auto","coulomb_nm":[0.0018,0.0022]}"#
        );
    }

    #[test]
    fn what_is_no_value_is_refused_with_what_would_be() {
        for (text, part) in [
            ("stiffness_nm_rad", "NAME=VALUE"),
            ("stiffness=1", "stiffness_nm_rad, damping_nm_s_rad"),
            ("stiffness_nm_rad=", "not a number"),
            ("stiffness_nm_rad=stiff", "not a number"),
            ("stiffness_nm_rad=NaN", "finite"),
            ("stiffness_nm_rad=inf", "finite"),
            ("stiffness_nm_rad=1e39", "32-bit"),
            ("stiffness_nm_rad=1e-60", "32-bit"),
            ("decimation=1.5", "whole"),
            ("decimation=-1", "whole"),
            ("law=paper", "raw, static, episode, ledger, auto"),
            ("shape=notch", "spring, wall, detent"),
            ("coulomb_nm=1..", "not a number"),
            ("coulomb_nm=1e-3..nan", "finite"),
            ("coulomb_nm=1e-3..2e-3..3e-3", "not a number"),
        ] {
            let said = Assignment::read(text).unwrap_err();
            assert!(said.contains(part), "{text}: {said}");
        }
    }
}
