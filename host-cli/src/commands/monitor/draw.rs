//! The screen.

use protocol::State;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph};

use super::view::{Point, View, WINDOW_S};
use crate::number::digits;
use crate::{parameters, words};

/// Draws all of it, as far as there is room.
pub fn draw(frame: &mut Frame<'_>, view: &View) {
    let figures = figures(view);
    let [title, table, angle, torque, notice, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(figures.len() as u16),
        Constraint::Fill(1),
        Constraint::Fill(1),
        Constraint::Length(1),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    let bold = Style::new().add_modifier(Modifier::BOLD);
    frame.render_widget(Paragraph::new(view.title.as_str()).style(bold), title);
    frame.render_widget(Paragraph::new(figures), table);
    chart(frame, angle, view, "angle, rad", Color::Cyan, |point| {
        point.angle_rad
    });
    chart(frame, torque, view, "torque, Nm", Color::Yellow, |point| {
        point.torque_nm
    });
    frame.render_widget(Paragraph::new(view.notice.as_str()).style(bold), notice);
    frame.render_widget(
        Paragraph::new("q quit   a arm   d disarm   c clear a fault"),
        keys,
    );
}

/// The figures, one a line.
fn figures(view: &View) -> Vec<Line<'_>> {
    let row = view.latest;
    let number = |value: Option<f32>, unit: &str| match value {
        Some(value) => format!("{} {unit}", digits(f64::from(value), 4)),
        None => NOTHING.into(),
    };
    let angle = match row.and_then(|row| row.count) {
        Some(count) => {
            let rad = view.angle_rad(count);
            format!("{rad:.5} rad = {:.3}°, count {count}", rad.to_degrees())
        }
        None => NOTHING.into(),
    };
    let stiffness = match row.and_then(|row| Some((row.stiffness_nm_rad?, row.demanded_nm_rad?))) {
        Some((applied, demanded)) => format!(
            "{} of {} Nm/rad {}",
            digits(f64::from(applied), 4),
            digits(f64::from(demanded), 4),
            view.share().map_or_else(String::new, bar)
        ),
        None => NOTHING.into(),
    };
    let reason = row.and_then(|row| row.reason).map_or(NOTHING, words::clamp);
    let law = row.and_then(|row| row.law).map_or(NOTHING, parameters::law);
    let account = number(row.and_then(|row| row.account_j), "J");
    let tick = row.map_or_else(|| NOTHING.into(), |row| row.tick.to_string());
    let state = match view.state {
        State::Disarmed => Style::new(),
        State::Armed | State::Calibrating | State::Pushing => {
            Style::new().fg(Color::Green).add_modifier(Modifier::BOLD)
        }
        State::Fault(_) => Style::new().fg(Color::Red).add_modifier(Modifier::BOLD),
    };
    vec![
        line(
            "state",
            Span::styled(words::state_in_full(view.state), state),
        ),
        line("angle", angle),
        line("torque", number(row.and_then(|row| row.torque_nm), "Nm")),
        line("stiffness", stiffness),
        line("why", reason),
        line("margin", number(row.and_then(|row| row.margin_nm), "Nm")),
        line("law", format!("{law}, account {account}")),
        line(
            "tick",
            format!(
                "{tick}; messages: {} dropped, {} lost, {} damaged",
                view.dropped, view.lost, view.damaged
            ),
        ),
    ]
}

/// Where nothing was heard yet.
const NOTHING: &str = "–";

fn line<'a>(label: &str, value: impl Into<Span<'a>>) -> Line<'a> {
    Line::from(vec![Span::raw(format!("{label:<11}")), value.into()])
}

/// A share as a bar.
fn bar(share: f64) -> String {
    const WIDTH: usize = 20;
    let full = (share * WIDTH as f64).round() as usize;
    let empty = WIDTH.saturating_sub(full);
    format!(
        "{}{} {} %",
        "█".repeat(full),
        "░".repeat(empty),
        digits(100.0 * share, 3)
    )
}

/// The last seconds of one quantity.
fn chart(
    frame: &mut Frame<'_>,
    area: Rect,
    view: &View,
    name: &str,
    colour: Color,
    quantity: impl Fn(&Point) -> f64,
) {
    if area.height < 3 {
        return;
    }
    let points: Vec<(f64, f64)> = view
        .trace
        .iter()
        .map(|point| (point.time_s - view.now_s(), quantity(point)))
        .filter(|(_, value)| value.is_finite())
        .collect();
    let [low, high] = bounds(points.iter().map(|(_, value)| *value));
    let data = Dataset::default()
        .marker(Marker::Braille)
        .graph_type(GraphType::Line)
        .style(Style::new().fg(colour))
        .data(&points);
    let labels = [low, high].map(|value| format!("{:>9}", digits(value, 3)));
    let time = format!("{name}, the last {WINDOW_S} s");
    let chart = Chart::new(vec![data])
        .block(Block::new().title(time))
        .x_axis(Axis::default().bounds([-WINDOW_S, 0.0]))
        .y_axis(Axis::default().bounds([low, high]).labels(labels));
    frame.render_widget(chart, area);
}

/// The ends of an axis that shows all values; never the same.
fn bounds(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values {
        low = low.min(value);
        high = high.max(value);
    }
    if low > high {
        return [-1.0, 1.0];
    }
    let room = match 0.05 * (high - low) {
        0.0 => (0.05 * high.abs()).max(1e-3),
        room => room,
    };
    [low - room, high + room]
}

#[cfg(test)]
mod tests {
    use protocol::{Fault, Telemetry};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::super::view::tests::{ROW, view};
    use super::*;

    /// What is drawn, without the blanks at the ends of lines.
    fn drawn(view: &View, columns: u16, rows: u16) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
        terminal.draw(|frame| draw(frame, view)).unwrap();
        let buffer = terminal.backend().buffer();
        let cells: Vec<&str> = buffer.content().iter().map(|cell| cell.symbol()).collect();
        let lines = cells.chunks(usize::from(columns).max(1));
        lines
            .map(|line| line.concat().trim_end().to_owned())
            .collect()
    }

    #[test]
    fn all_is_there_as_soon_as_a_row_has_come() {
        let mut view = view();
        for row in 0..501 {
            view.telemetry(Telemetry {
                tick: 1000 + 20 * row,
                count: Some(if row < 250 { 0 } else { 1000 }),
                torque_nm: Some(-0.0125 * row as f32 / 500.0),
                ..ROW
            });
        }
        (view.lost, view.damaged) = (2, 1);
        view.notice = "armed from tick 999".into();
        assert_eq!(drawn(&view, 80, 24).join("\n"), SCREEN.trim_start());
    }

    const SCREEN: &str = "
knob on /dev/ttyUSB0
state      armed
angle      1.53475 rad = 87.935°, count 1000
torque     -0.0125 Nm
stiffness  25 of 100 Nm/rad █████░░░░░░░░░░░░░░░ 25 %
why        the energy account covers no more
margin     0.00125 Nm
law        ledger, account 1.5e-5 J
tick       11000; messages: 3 dropped, 2 lost, 1 damaged
angle, rad, the last 10 s
     1.61│                                  ⢰⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒⠒
         │                                  ⢸
         │                                  ⢸
         │                                  ⢸
         │                                  ⢸
  -0.0759│⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠼
torque, Nm, the last 10 s
  5.99e-4│⠒⠒⠒⠤⠤⠤⠤⣀⣀⣀⣀
         │           ⠉⠉⠉⠉⠒⠒⠒⠒⠤⠤⠤⠤⣀⣀⣀⣀
         │                           ⠉⠉⠉⠉⠒⠒⠒⠒⠤⠤⠤⠤⣄⣀⣀⣀⡀
         │                                           ⠉⠉⠉⠉⠓⠒⠒⠒⠦⠤⠤⠤⣄⣀⣀⣀⡀
  -0.0131│                                                           ⠉⠉⠉⠉⠓⠒⠒⠒⠦⠤⠤
armed from tick 999
q quit   a arm   d disarm   c clear a fault";

    #[test]
    fn before_the_first_row_nothing_is_made_up() {
        let lines = drawn(&view(), 80, 24);
        assert_eq!(lines[1], "state      disarmed");
        for (line, label) in
            lines[2..8]
                .iter()
                .zip(["angle", "torque", "stiffness", "why", "margin"])
        {
            assert_eq!(*line, format!("{label:<11}–"));
        }
        assert_eq!(
            lines[8],
            "tick       –; messages: 3 dropped, 0 lost, 0 damaged"
        );
    }

    #[test]
    fn a_fault_is_told_in_words() {
        let mut view = view();
        view.telemetry(Telemetry {
            state: State::Fault(Fault::Overrun),
            ..ROW
        });
        let lines = drawn(&view, 100, 24);
        assert!(
            lines[1].contains("in fault: a tick was not done") && lines[1].contains("knob clear")
        );
    }

    #[test]
    fn no_size_and_no_number_is_too_much() {
        let ends = [
            0.0,
            -0.0,
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            f32::MAX,
            f32::MIN_POSITIVE,
        ];
        for (index, end) in ends.into_iter().enumerate() {
            let mut view = view();
            for tick in 0..40 {
                view.telemetry(Telemetry {
                    tick,
                    count: Some(if tick % 2 == 0 { i32::MIN } else { i32::MAX }),
                    torque_nm: Some(if tick % 3 == 0 { end } else { 1.0 }),
                    stiffness_nm_rad: Some(end),
                    demanded_nm_rad: Some(ends[(index + 1) % ends.len()]),
                    margin_nm: Some(end),
                    account_j: Some(end),
                    ..ROW
                });
            }
            for columns in [0, 1, 2, 5, 12, 40, 80, 300] {
                for rows in 0..40 {
                    let _ = drawn(&view, columns, rows);
                }
            }
        }
    }

    #[test]
    fn an_axis_has_two_ends() {
        for values in [&[][..], &[0.0], &[5.0, 5.0], &[-1e300, 1e300], &[1e-300]] {
            let [low, high] = bounds(values.iter().copied());
            assert!(low < high, "{values:?}");
            assert!(
                values.iter().all(|value| (low..=high).contains(value)),
                "{values:?}"
            );
        }
    }
}
