//! The recorded cases of the passivity margin and the energy ledger, as scene files through
//! `knob simulate`.
//!
//! Recorded were states at ticks, E₀ = ½mv₀² + ½Kq₀² with the sensed deflection q₀, the largest angle
//! from the count where a wall's torque begins, and torques after the DAC. The cases under the ledger had seen nine
//! ticks of free motion before; a scene begins with none.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

/// What a run said, and its states at ticks: angle, velocity, torque.
struct Run {
    json: Value,
    ticks: Vec<[f64; 3]>,
}

impl Run {
    fn number(&self, key: &str) -> f64 {
        self.json[key].as_f64().unwrap()
    }

    /// The largest angle at a tick after the first, from `origin_rad`.
    fn furthest_rad(&self, origin_rad: f64, measure: impl Fn(f64) -> f64) -> f64 {
        let later = self.ticks.iter().skip(1).map(|tick| tick[0]);
        let all = later.chain([self.number("angle_rad")]);
        all.fold(f64::MIN, |most, angle| {
            most.max(measure(angle - origin_rad))
        })
    }

    fn fastest_rad_s(&self) -> f64 {
        let later = self.ticks.iter().skip(1).map(|tick| tick[1].abs());
        later.fold(self.number("velocity_rad_s").abs(), f64::max)
    }
}

fn number(value: &Value, key: &str) -> f64 {
    value[key]
        .as_f64()
        .unwrap_or_else(|| panic!("{key}: {value}"))
}

/// The wall's edge, or the spring's centre, rad.
fn zero_rad(case: &Value) -> f64 {
    case["scene"]["xw"].as_f64().unwrap_or(0.0)
}

/// Where the first torque acts, a count's edge, rad: the largest angle is recorded from there.
fn first_edge_rad(case: &Value) -> f64 {
    let count = number(&case["device"], "delta");
    (zero_rad(case) / count + 0.5).floor() * count
}

fn scene(case: &Value, law: &str) -> String {
    let (device, believed, hand) = (&case["device"], &case["believed"], &case["hand"]);
    let table = |of: &Value| {
        format!(
            "inertia_kg_m2 = {}\nviscous_nm_s_rad = {}\ncoulomb_nm = {}\ncount_rad = {}\n",
            of["m"], of["b"], of["c"], of["delta"]
        )
    };
    let timing = |of: &Value| {
        format!(
            "sample_period_s = {}\ndelay_s = {}\namplifier_tau_s = {}\ntorque_step_nm = {}\n",
            of["T"], of["td"], of["tau_amp"], of["dac_q"]
        )
    };
    let wall = match &case["scene"]["xw"] {
        Value::Null => String::new(),
        edge => format!("wall_rad = {edge}\n"),
    };
    format!(
        "[device]\n{}[loop]\n{}[believed]\n{}{}\
         [render]\nlaw = \"{law}\"\nshape = {}\nstiffness_nm_rad = {}\n{wall}\
         [start]\nangle_rad = {}\nvelocity_rad_s = {}\n\
         [hand]\ninertia_kg_m2 = {}\ndamping_nm_s_rad = {}\nstiffness_nm_rad = {}\nrest_rad = {}\npush_nm = {}\n\
         [run]\nsamples = {}\n",
        table(device),
        timing(device),
        table(believed),
        timing(believed),
        case["scene"]["type"],
        case["K_demand"],
        case["x0"],
        case["v0"],
        hand["M"],
        hand["B"],
        hand["K"],
        hand["x_ref"],
        hand["F_const"],
        case["ticks"],
    )
}

fn run(folder: &Path, name: &str, text: &str) -> Run {
    let (file, trace) = (
        folder.join(format!("{name}.toml")),
        folder.join(format!("{name}.csv")),
    );
    fs::write(&file, text).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_knob"))
        .args(["simulate", file.to_str().unwrap(), "--json", "--trace"])
        .arg(&trace)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name}: {said}");
    let trace = fs::read_to_string(trace).unwrap();
    let tick = |row: &str| {
        let column = |i: usize| row.split(',').nth(i).unwrap().parse().unwrap();
        [column(1), column(2), column(4)]
    };
    Run {
        json: serde_json::from_slice(&output.stdout).unwrap(),
        ticks: trace.lines().skip(1).map(tick).collect(),
    }
}

fn cases() -> Vec<Value> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/governor.json");
    let recorded: Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
    let cases = recorded["cases"].as_array().unwrap().clone();
    assert_eq!(cases.len(), 14);
    cases
}

fn near(id: &str, what: &str, got: f64, want: f64, relative: f64) {
    let off = (got - want).abs();
    assert!(
        off <= relative * want.abs(),
        "{id}: {what} is {got}, recorded {want}"
    );
}

#[test]
fn every_recorded_case_under_raw_comes_out_again() {
    let folder = TempDir::new().unwrap();
    let mut seen = 0;
    for case in cases() {
        if !case["policy"].as_str().unwrap().starts_with("raw") {
            continue;
        }
        seen += 1;
        let (id, expect) = (case["id"].as_str().unwrap(), &case["expect"]);
        let run = run(folder.path(), id, &scene(&case, "raw"));
        let class = match expect["class"].as_str().unwrap() {
            "settles" => "rest",
            "oscillates" => "limit-cycle",
            "diverges" => "unstable",
            other => panic!("{id}: {other}"),
        };
        assert_eq!(run.json["class"], class, "{id}");
        assert_eq!(run.json["law_end"], "raw", "{id}");
        assert_eq!(run.json["samples"], expect["ticks_run"], "{id}");
        // A limit cycle far inside a count, after 40,000 ticks, keeps fewer digits.
        let relative = if class == "limit-cycle" { 1e-3 } else { 1e-4 };
        let recorded = |key: &str| number(expect, key);
        near(
            id,
            "x_end",
            run.number("angle_rad"),
            recorded("x_end"),
            relative,
        );

        let wall = case["scene"]["type"] == "wall";
        let measure = |angle: f64| if wall { angle } else { angle.abs() };
        let furthest = run.furthest_rad(first_edge_rad(&case), measure);
        near(id, "x_max", furthest, recorded("x_max"), relative);

        let device = &case["device"];
        let step = number(device, "dac_q");
        let rounded = |torque: f64| match step {
            0.0 => torque,
            _ => (torque / step).round() * step,
        };
        let torques = run.ticks.iter().map(|tick| rounded(tick[2]).abs());
        near(
            id,
            "f_max",
            torques.fold(0.0, f64::max),
            recorded("f_max"),
            relative,
        );

        let (m, k, count) = (
            number(device, "m"),
            number(&case, "K_demand"),
            number(device, "delta"),
        );
        let cell = (number(&case, "x0") / count).floor();
        let sensed = (cell + 0.5) * count - zero_rad(&case);
        let wall_is_free = wall && sensed <= 0.0;
        let potential = if wall_is_free {
            0.0
        } else {
            0.5 * k * sensed * sensed
        };
        let start_j = 0.5 * m * number(&case, "v0").powi(2) + potential;
        let ratio = 0.5 * m * run.fastest_rad_s().powi(2) / start_j;
        near(
            id,
            "KE over E0",
            ratio,
            recorded("max_KE_over_E0"),
            relative,
        );
        // Its assertion, where that says more than the class.
        match id {
            "wall_off_edge" => assert!(run.number("energy_excess_j") > 0.2 * start_j),
            "fig6b_limitcycle" => assert!(
                run.ticks
                    .iter()
                    .rev()
                    .take(100)
                    .all(|tick| tick[0].abs() < 2.5 * count)
            ),
            _ => {}
        }
    }
    assert_eq!(seen, 11);
}

#[test]
fn every_recorded_case_under_the_governor_keeps_its_assertion() {
    let folder = TempDir::new().unwrap();
    let mut seen = 0;
    for case in cases() {
        if case["policy"] != "governor(LMS)" {
            continue;
        }
        for law in ["ledger", "auto"] {
            seen += 1;
            let (id, expect) = (case["id"].as_str().unwrap(), &case["expect"]);
            let run = run(folder.path(), &format!("{id}-{law}"), &scene(&case, law));
            assert_eq!(run.json["class"], "rest", "{id} {law}");
            assert!(run.number("energy_excess_j") <= 0.0, "{id} {law}");
            let zero_rad = zero_rad(&case);
            let (start_rad_s, end_rad) = (number(&case, "v0"), run.number("angle_rad"));
            match id {
                "gov_hit_re35_1ms_v3" => {
                    assert!(end_rad < zero_rad, "it leaves the wall");
                    assert!(run.fastest_rad_s() <= start_rad_s);
                    let furthest = run.furthest_rad(first_edge_rad(&case), |angle| angle);
                    assert!(furthest <= 1.15 * number(expect, "x_max"), "{furthest}");
                }
                "gov_spring_re35_1ms_v30" => assert!(run.fastest_rad_s() <= start_rad_s),
                "gov_push_re35_1ms" => {
                    let static_stiffness =
                        |torque_nm: f64, angle_rad: f64| -torque_nm / (angle_rad - zero_rad);
                    let got = static_stiffness(run.number("torque_end_nm"), end_rad);
                    let recorded = static_stiffness(
                        number(expect, "f_end"),
                        number(expect, "x_end") + zero_rad,
                    );
                    // 3.6 Nm/rad is what the law is known for.
                    assert!(
                        got >= 0.8 * recorded && got >= 3.6,
                        "{got}, recorded {recorded}"
                    );
                }
                other => panic!("{other}"),
            }
        }
    }
    assert_eq!(seen, 6);
}
