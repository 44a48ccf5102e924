//! What the screen shows: the last row of telemetry, and a trace of the seconds before it.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use protocol::{Parameters, State, Status, Telemetry};

/// How much of the past is kept, s.
pub const WINDOW_S: f64 = 10.0;

/// A point of the trace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Since the first row, s.
    pub time_s: f64,
    pub angle_rad: f64,
    pub torque_nm: f64,
}

/// What the screen shows.
pub struct View {
    /// Which knob.
    pub title: String,
    pub state: State,
    pub latest: Option<Telemetry>,
    /// Messages that found no room in the device.
    pub dropped: u32,
    /// Messages that were sent, but did not come.
    pub lost: u64,
    /// Frames that came damaged.
    pub damaged: u64,
    /// What happened last, in words.
    pub notice: String,
    /// The oldest first.
    pub trace: VecDeque<Point>,
    period_s: f64,
    count_rad: f64,
    /// The number of the last message that was sent unasked.
    last_number: Option<u16>,
    /// Of the last row, since the first one, s.
    time_s: f64,
}

impl View {
    /// Nothing was heard yet but how the device is.
    pub fn new(title: String, parameters: &Parameters, status: &Status) -> Self {
        let counts = f64::from(parameters.counts_per_rev);
        Self {
            title,
            state: status.state,
            latest: None,
            dropped: status.dropped,
            lost: 0,
            damaged: 0,
            notice: String::new(),
            trace: VecDeque::new(),
            period_s: f64::from(parameters.sample_period_s),
            count_rad: TAU * f64::from(parameters.decimation) / counts,
            last_number: None,
            time_s: 0.0,
        }
    }

    /// The middle of a count, rad.
    pub fn angle_rad(&self, count: i32) -> f64 {
        (f64::from(count) + 0.5) * self.count_rad
    }

    /// Takes in the number of a message that was sent unasked.
    pub fn number(&mut self, number: u16) {
        if let Some(last) = self.last_number.replace(number) {
            self.lost += u64::from(number.wrapping_sub(last).wrapping_sub(1));
        }
    }

    /// Takes in a row.
    pub fn telemetry(&mut self, row: Telemetry) {
        if let Some(last) = self.latest.replace(row) {
            let step = row.tick.wrapping_sub(last.tick);
            if step > u32::MAX / 2 {
                self.trace.clear();
                self.notice = "the device started anew".into();
            } else {
                self.time_s += f64::from(step) * self.period_s;
            }
        }
        self.state = row.state;
        let (Some(count), Some(torque)) = (row.count, row.torque_nm) else {
            return;
        };
        self.trace.push_back(Point {
            time_s: self.time_s,
            angle_rad: self.angle_rad(count),
            torque_nm: f64::from(torque),
        });
        let oldest = self.time_s - WINDOW_S;
        while self
            .trace
            .front()
            .is_some_and(|point| point.time_s < oldest)
        {
            self.trace.pop_front();
        }
    }

    /// The share of the demanded stiffness that is applied, 0 to 1; None where nothing is demanded.
    pub fn share(&self) -> Option<f64> {
        let row = self.latest?;
        let (applied, demanded) = (row.stiffness_nm_rad?, row.demanded_nm_rad?);
        let share = f64::from(applied) / f64::from(demanded);
        share.is_finite().then(|| share.clamp(0.0, 1.0))
    }

    /// The time of the last row, on the scale of the trace, s.
    pub fn now_s(&self) -> f64 {
        self.time_s
    }
}

#[cfg(test)]
pub mod tests {
    use protocol::{ClampReason, Interval, Law, ResetReason, Shape, Stored};

    use super::*;

    const fn exactly(value: f32) -> Interval {
        Interval {
            low: value,
            high: value,
        }
    }

    pub const PARAMETERS: Parameters = Parameters {
        sample_period_s: 1e-3,
        decimation: 2,
        counts_per_rev: 8192,
        law: Law::Auto,
        shape: Shape::Spring,
        stiffness_nm_rad: 100.0,
        damping_nm_s_rad: 0.0,
        centre_rad: 0.0,
        wall_rad: 0.0,
        period_rad: 0.2,
        torque_max_nm: 0.5,
        speed_max_rad_s: 200.0,
        inertia_kg_m2: exactly(6.28e-6),
        viscous_nm_s_rad: exactly(9e-6),
        coulomb_nm: exactly(2e-3),
        delay_s: 0.0,
        amplifier_tau_s: 0.0,
        jitter_s: 0.0,
        torque_step_nm: 0.0,
    };

    const STATUS: Status = Status {
        tick: 100,
        state: State::Disarmed,
        dropped: 3,
        bad_frames: 0,
        stored: Stored::NoStorage,
        reset: ResetReason::Unknown,
    };

    pub const ROW: Telemetry = Telemetry {
        tick: 1000,
        state: State::Armed,
        count: Some(123),
        torque_nm: Some(-0.0125),
        stiffness_nm_rad: Some(25.0),
        demanded_nm_rad: Some(100.0),
        margin_nm: Some(1.25e-3),
        reason: Some(ClampReason::Account),
        law: Some(Law::Ledger),
        account_j: Some(1.5e-5),
    };

    pub fn view() -> View {
        View::new("knob on /dev/ttyUSB0".into(), &PARAMETERS, &STATUS)
    }

    #[test]
    fn the_trace_holds_the_last_seconds_by_the_devices_clock() {
        let mut view = view();
        for row in 0..2000_u32 {
            view.telemetry(Telemetry {
                tick: row.wrapping_mul(20).wrapping_sub(10_000),
                count: Some(row as i32),
                ..ROW
            });
        }
        let (first, last) = (view.trace.front().unwrap(), view.trace.back().unwrap());
        // A tick number that wraps is nothing special: 20 ticks are 20 ms.
        let row_s = 20.0 * f64::from(PARAMETERS.sample_period_s);
        assert!((last.time_s - 1999.0 * row_s).abs() < 1e-9);
        assert!((last.time_s - first.time_s - WINDOW_S).abs() <= row_s);
        assert_eq!(view.trace.len(), 500);
        assert_eq!(last.angle_rad, view.angle_rad(1999));
        assert_eq!(view.notice, "");
        // One that starts anew begins a new trace.
        view.telemetry(Telemetry { tick: 5, ..ROW });
        assert_eq!(view.trace.len(), 1);
        assert!(view.notice.contains("anew"));
        // A row without a count or a torque has no place in it.
        view.telemetry(Telemetry {
            count: None,
            tick: 25,
            ..ROW
        });
        assert_eq!(view.trace.len(), 1);
    }

    #[test]
    fn the_angle_is_the_middle_of_its_count() {
        let count_rad = TAU * 2.0 / 8192.0;
        for (count, counts) in [(0, 0.5), (-1, -0.5), (8191, 8191.5)] {
            assert!((view().angle_rad(count) - counts * count_rad).abs() < 1e-12);
        }
    }

    #[test]
    fn gaps_in_the_numbers_are_counted() {
        let mut view = view();
        for number in [65_534, 65_535, 0, 3, 4, 14] {
            view.number(number);
        }
        assert_eq!(view.lost, 2 + 9);
        assert_eq!(view.dropped, 3);
    }

    #[test]
    fn the_share_lies_between_nothing_and_all() {
        let share = |applied, demanded| {
            let mut view = view();
            view.telemetry(Telemetry {
                stiffness_nm_rad: Some(applied),
                demanded_nm_rad: Some(demanded),
                ..ROW
            });
            view.share()
        };
        assert_eq!(share(25.0, 100.0), Some(0.25));
        assert_eq!(share(125.0, 100.0), Some(1.0));
        assert_eq!(share(-1.0, 100.0), Some(0.0));
        assert_eq!(share(0.0, 0.0), None);
        assert_eq!(share(f32::NAN, 1.0), None);
        assert_eq!(view().share(), None);
    }
}
