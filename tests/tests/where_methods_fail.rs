//! Where methods fail: for each failure of the catalogue, what the naive form says and what is true.
//! `docs/where-methods-fail.md` is its page.
//!
//! True is the exact map; where rounding could be in doubt, arithmetic with 77 digits or whole numbers.

use control::criterion::{Dimensionless, Region};
use control::encoder::{Encoder, EncoderConfig};
use control::margin::effective_criterion;
use control::shape::{Profile, Shape};
use host_cli::failures::{self, adaptive, forms};
use host_cli::scene::{self, Loaded};
use plant_sim::closed_loop::Report;
use plant_sim::display::{Display, Run, quantised_force};
use plant_sim::energy;
use plant_sim::hold::State;
use plant_sim::methods::{self, Exact, Method};
use plant_sim::outcome::Class;
use plant_sim::precise::{PreciseDisplay, PreciseState, double, number};

/// The scene of a failure, as the repository has it.
fn text(name: &str) -> &'static str {
    failures::named(name).unwrap().scene
}

/// The display that the scene of a failure is.
struct Case {
    display: Display,
    start: State,
    samples: u64,
}

impl Case {
    fn new(name: &str) -> Self {
        Self::of(&scene::parse(text(name)).unwrap())
    }

    fn of(loaded: &Loaded) -> Self {
        let (display, start) = loaded.display().unwrap();
        let samples = loaded.scene.samples;
        Self {
            display,
            start,
            samples,
        }
    }

    fn run(&self, method: &str) -> Run {
        let method = methods::named(method).unwrap();
        method.run(&self.display, self.start, self.samples)
    }

    fn class(&self, method: &str) -> Class {
        self.run(method).classes.window
    }

    /// Whether it stands still for ever, by a method.
    fn rests(&self, method: &str) -> bool {
        self.display.rests(self.run(method).end)
    }

    fn with(&self, parameters: Dimensionless<f64>) -> Self {
        Self {
            display: Display::new(parameters).unwrap(),
            ..*self
        }
    }

    /// The exact map's run ends where 77 digits do, to `digits` digits.
    fn is_true_to(&self, digits: i32) -> Run {
        let run = self.run("exact");
        let precise = PreciseDisplay::new(self.display.parameters()).unwrap();
        let truth = double(&precise.follow(self.start, run.samples).position);
        let error = (run.end.position - truth).abs() / truth.abs().max(1.0);
        assert!(error < 10_f64.powi(-digits), "{error} off 77 digits");
        run
    }
}

/// Every failure has its scene where it says, and its test here.
#[test]
fn the_catalogue_is_complete() {
    let here = include_str!("where_methods_fail.rs");
    let page = include_str!("../../docs/where-methods-fail.md");
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    for failure in failures::all() {
        let stands = std::fs::read_to_string(format!("{root}/{}", failure.path)).unwrap();
        assert_eq!(stands, failure.scene, "{}", failure.path);
        let test = format!("#[test]\nfn {}()", failure.test);
        assert!(here.contains(&test), "{test}");
        let name = failure.name;
        assert!(page.contains(&format!("\n## {name}\n")), "{name}");
        let figure = format!("{root}/docs/where-methods-fail/{name}.svg");
        assert!(std::fs::exists(&figure).unwrap(), "{figure}");
    }
    let of_scenes = std::fs::read_dir(format!("{root}/scenes/fail")).unwrap();
    for entry in of_scenes {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let name = name.trim_end_matches(".toml");
        let second = name == "sigma-half-decimal";
        assert!(second || failures::named(name).is_some(), "{name}");
    }
}

#[test]
fn euler_hides_the_instability() {
    let case = Case::new("euler-hides");
    let naive = case.run("euler:1");
    assert_eq!(naive.classes.window, Class::LimitCycle, "chatter");
    assert_eq!(naive.classes.paper, Class::Rest);
    assert!(naive.end.position.abs() < 0.1 && naive.end.velocity.abs() < 0.1);
    assert_eq!(case.is_true_to(6).classes.window, Class::Unstable);

    // The threshold moves by 1/(2n).
    let edge = |method: &str| {
        let method = methods::named(method).unwrap();
        forms::edge(&*method, &case.display, case.start).unwrap()
    };
    let truth = edge("exact");
    assert!((truth - 0.48).abs() < 0.002, "{truth}");
    for n in [2, 4, 10] {
        let moved = truth - edge(&format!("euler:{n}"));
        let rule = 0.5 / f64::from(n);
        assert!((moved - rule).abs() < 0.003, "n = {n}: {moved}, not {rule}");
    }
    assert!(edge("euler:1") < 0.001);
}

#[test]
fn a_plain_sign_chatters_where_the_display_rests() {
    let case = Case::new("chatter");
    for naive in ["euler:1", "euler:10", "rk4:1", "rk4:10"] {
        assert_eq!(case.class(naive), Class::LimitCycle, "{naive}");
    }
    // A step that projects friction rests, if in another count.
    for mended in ["midpoint:1", "midpoint:10", "dopri5:1e-9", "exact"] {
        assert!(case.rests(mended), "{mended}");
    }
    assert_eq!(case.is_true_to(12).samples, 16);
}

#[test]
fn an_adaptive_solver_collapses_its_step_at_a_plain_sign() {
    let case = Case::new("adaptive-chatter");
    let (hold, start) = (case.display.hold(), case.start);
    let force = quantised_force(start.position);
    for tolerance in [1e-6, 1e-8, 1e-10] {
        let naive = adaptive::effort_without_events(hold, start, force, tolerance);
        assert!(naive.evaluations > 100_000, "{naive:?}");
        let mended = adaptive::effort_with_event(hold, start, force, tolerance);
        assert!(mended.finished && mended.evaluations < 50, "{mended:?}");
    }
    let tight = adaptive::effort_without_events(hold, start, force, 1e-8);
    assert!(!tight.finished, "{tight:?}");
    // It stops within the first sample, and sticks.
    let run = case.is_true_to(12);
    assert!(case.display.rests(run.end) && run.samples == 1);
}

#[test]
fn smooth_friction_creeps_through_the_dead_band() {
    let case = Case::new("tanh-creep");
    for naive in ["rk4-tanh:10", "rk4-tanh:100"] {
        let method = methods::named(naive).unwrap();
        let crept = method.follow(&case.display, case.start, 500);
        assert!(crept.position.abs() < 0.01, "{naive}: {crept:?}");
        assert!(!case.rests(naive), "{naive}");
        assert_eq!(case.run(naive).samples, case.samples, "{naive}");
    }
    // Under |φ| < σ in the middle of a count: artanh(φ/σ) of the width a sample.
    let method = methods::named("rk4-tanh:10").unwrap();
    let at = |samples| method.follow(&case.display, case.start, samples).position;
    let rate = (at(100) - at(200)) / 100.0;
    let expected = methods::TANH_WIDTH * (0.5_f64 / 1.6).atanh();
    assert!((rate / expected - 1.0).abs() < 0.02, "{rate}, {expected}");

    let run = case.is_true_to(12);
    assert!(case.display.rests(run.end) && run.samples == 1);
    assert!((run.end.position - 1.52).abs() < 0.001);
}

#[test]
fn the_textbooks_closed_form_loses_its_digits() {
    let case = Case::new("lost-digits");
    let naive = case.run("closed-form");
    assert_eq!(naive.classes.window, Class::Rest);
    assert_eq!(case.is_true_to(6).classes.window, Class::Unstable);

    let closed = methods::named("closed-form").unwrap();
    let slide = State {
        position: 0.3,
        velocity: 2.7,
    };
    for exponent in 1..=12 {
        let ratio = 10_f64.powi(-exponent);
        let parameters = case.display.parameters();
        let beta = ratio * parameters.mu;
        let case = case.with(Dimensionless { beta, ..parameters });
        let error = |method: &dyn Method| {
            forms::error_after_a_sample(method, &case.display, slide).unwrap()
        };
        let (lost, kept) = (error(&*closed), error(&Exact));
        assert!(kept < 1e-14, "β/μ = {ratio:e}: {kept}");
        // v∞ is as large as 1/(β/μ), and twice: the digits go with its square.
        if exponent >= 6 {
            let least = (1e-20 / (ratio * ratio)).min(100.0);
            assert!(lost > least, "β/μ = {ratio:e}: {lost}");
        }
    }
    let parameters = case.display.parameters();
    let frictionless = case.with(Dimensionless {
        beta: 0.0,
        ..parameters
    });
    let force = quantised_force(slide.position);
    let end = closed.sample(frictionless.display.hold(), slide, force);
    assert!(end.position.is_nan());
    let exact = forms::error_after_a_sample(&Exact, &frictionless.display, slide).unwrap();
    assert!(exact < 1e-14);
}

#[test]
fn near_the_nyquist_edge_one_step_methods_have_limits_of_their_own() {
    let case = Case::new("nyquist");
    let parameters = case.display.parameters();
    assert_eq!(parameters.region(), Region::GloballyPassive);
    let nyquist = std::f64::consts::PI.powi(-2);
    for mu in [nyquist, 0.15, 0.2, 0.25] {
        let light = case.with(Dimensionless { mu, ..parameters });
        assert_eq!(light.class("euler:1"), Class::Unstable, "μ = {mu}");
        let run = light.is_true_to(9);
        assert!(light.display.rests(run.end), "μ = {mu}");
    }
    // Without friction Euler's limit is ¼, with β it is (1 + 2β)/4; nothing of either is true.
    for beta in [0.0, 0.2] {
        let limit = 0.25 * (1.0 + 2.0 * beta);
        for (mu, grows) in [(0.98 * limit, true), (1.02 * limit, false)] {
            let sigma = 0.0;
            let light = case.with(Dimensionless { mu, beta, sigma });
            let naive = light.class("euler:1") == Class::Unstable;
            assert_eq!(naive, grows, "β = {beta}, μ = {mu}");
            assert_eq!(
                light.class("exact"),
                Class::Unstable,
                "β = {beta}, μ = {mu}"
            );
        }
    }
    // Fast starts: midpoint with one step keeps to the describing function, the display does not.
    let fast = State {
        position: 0.0,
        velocity: 40.0,
    };
    let predicted = 0.5 - 4.0 * 0.6 / (std::f64::consts::PI * 40.0);
    let midpoint = methods::named("midpoint:1").unwrap();
    for (mu, truth) in [(nyquist, 0.266), (0.25, 0.353)] {
        let light = case.with(Dimensionless { mu, ..parameters });
        let naive = forms::edge(&*midpoint, &light.display, fast).unwrap();
        assert!((naive - predicted).abs() < 0.015, "μ = {mu}: {naive}");
        let exact = forms::edge(&Exact, &light.display, fast).unwrap();
        assert!((exact - truth).abs() < 0.005, "μ = {mu}: {exact}");
    }
}

#[test]
fn on_count_edges_rounding_decides() {
    let case = Case::new("count-edges");
    let wrong = |method: &str| {
        let method = methods::named(method).unwrap();
        forms::first_wrong_count(&*method, &case.display, case.start, 200)
    };
    for naive in ["rk4:10", "midpoint:10"] {
        let (sample, position) = wrong(naive).unwrap();
        assert_eq!(sample, 2, "{naive}");
        assert!(position < 7.0 && position > 7.0 - 1e-14, "{position}");
    }
    // The exact map goes the right way for longer, and not for ever.
    let (sample, _) = wrong("exact").unwrap();
    assert!(sample > 60, "{sample}");
    // Nor do 77 digits know, after a reversal at a time that is no binary fraction.
    let precise = PreciseDisplay::new(case.display.parameters()).unwrap();
    let mut state = PreciseState::from(case.start);
    let mut first = None;
    for (sample, (x, _)) in forms::in_eighths(case.start).enumerate().take(90) {
        let off = double(&(&state.position - number(x as f64 / 8.0))).abs();
        assert!(off < 1e-60, "sample {sample}");
        if double(&state.position.floor()) != x.div_euclid(8) as f64 {
            first = Some(sample);
            break;
        }
        state = precise.sample(&state);
    }
    assert_eq!(first, Some(12));
    let on_edges = forms::in_eighths(case.start).take(90);
    assert!(on_edges.filter(|(x, _)| x % 8 == 0).count() > 10);
}

#[test]
fn friction_of_exactly_one_half_just_holds() {
    let case = Case::new("sigma-half");
    for naive in ["euler:10", "rk4:10"] {
        let run = case.run(naive);
        assert!(!case.display.rests(run.end), "{naive}");
        assert!(run.end.velocity.abs() < 1e-15, "no cycle that is seen");
    }
    for mended in ["midpoint:10", "exact"] {
        assert!(case.rests(mended), "{mended}");
    }
    assert_eq!(case.is_true_to(11).samples, 923);

    // One bit less friction, and it never rests.
    let parameters = case.display.parameters();
    let sigma = parameters.sigma.next_down();
    let below = case.with(Dimensionless {
        sigma,
        ..parameters
    });
    assert!(!below.rests("exact"));
    assert!(below.run("exact").end.velocity.abs() < 1e-15);

    // In decimals, by the controller in single precision: K = 0.1 is more than 0.1.
    let decimal = scene::parse(include_str!("../../scenes/fail/sigma-half-decimal.toml")).unwrap();
    assert!(Case::of(&decimal).rests("exact"));
    let report = decimal.run(|_| true).unwrap();
    assert_eq!(report.samples, decimal.scene.samples, "never at rest");
    assert!(report.end.velocity.abs() > 1e-9 && report.end.velocity.abs() < 1e-6);
}

#[test]
fn on_the_critical_line_the_margin_is_zero_and_nothing_happens() {
    let case = Case::new("critical-line");
    let parameters = case.display.parameters();
    let on = case.start.velocity;
    assert_eq!(parameters.power_margin(on), 0.0);
    assert!(parameters.holds_at(on));
    assert!(!parameters.holds_at(on.next_up()));
    // In f32 there is nothing between.
    let single = Dimensionless {
        mu: 50.0_f32,
        beta: 0.25,
        sigma: 1.0,
    };
    assert!(single.holds_at(2.000_000_01));
    // On the line in decimals, beyond it in binary.
    let decimal = Dimensionless {
        beta: 0.3,
        sigma: 0.7,
        ..parameters
    };
    assert!(!decimal.holds_at(1.0));
    assert!(decimal.power_margin(1.0).abs() < 1e-16);
    // (8) as printed is 0/0 where σ = ½ at rest.
    let corner = Dimensionless {
        beta: 0.3,
        sigma: 0.5,
        ..parameters
    };
    assert!(!forms::holds_by_division(&corner, 0.0));
    assert!(corner.holds_at(0.0));

    let from = |velocity| Case {
        start: State {
            velocity,
            ..case.start
        },
        ..case
    };
    for velocity in [on, on.next_up(), 1.05 * on, 2.0 * on] {
        let case = from(velocity);
        assert!(case.rests("exact"), "{velocity}");
    }
    from(on.next_up()).is_true_to(12);
    // The display's own edge is that of the describing function, 4σ/(π(½ − β)) = 5.09.
    assert_eq!(from(5.5).class("exact"), Class::Unstable);
}

#[test]
fn a_million_counts_per_sample_need_double_precision() {
    let case = Case::new("million-counts");
    let precise = PreciseDisplay::new(case.display.parameters()).unwrap();
    let mut truth = PreciseState::from(case.start);
    let (mut exact, mut single) = (case.start, case.start);
    let (mut exact_off, mut single_off) = (0.0_f64, 0.0_f64);
    for sample in 0..1000 {
        let step = |method: &dyn Method, state: State| {
            method.sample(case.display.hold(), state, quantised_force(state.position))
        };
        truth = precise.sample(&truth);
        exact = step(&Exact, exact);
        single = step(&forms::SinglePrecision, single);
        let off = |state: State| double(&(number(state.position) - &truth.position)).abs();
        exact_off = exact_off.max(off(exact));
        single_off = single_off.max(off(single));
        assert_eq!(
            exact.position.floor(),
            double(&truth.position.floor()),
            "sample {sample}"
        );
    }
    assert!(exact_off < 1e-6, "{exact_off}");
    assert!(single_off > 1.0, "{single_off}");
    assert!(case.rests("exact"));

    // A counter of 16 bits has turned round; one of 32 has not.
    let moved = 1_000_000;
    let read = |bits| {
        let mut encoder = Encoder::new(EncoderConfig::new(bits, 1).unwrap(), 0);
        encoder.update(moved)
    };
    assert_eq!((read(16), read(32)), (16_960, 1_000_000));
}

#[test]
fn a_start_under_load_satisfies_10_and_not_8() {
    let case = Case::new("start-under-load");
    let parameters = case.display.parameters();
    assert!(parameters.holds_at(case.start.velocity), "(10)");
    assert_eq!(case.is_true_to(9).classes.window, Class::Unstable);
    let reached = energy::reachable_speed(case.start, 1.0, parameters.mu);
    assert!(!parameters.holds_at(reached), "(8) at {reached}");
    // From zero, with the same velocity, it is passive.
    let from_zero = Case {
        start: State {
            position: 0.0,
            ..case.start
        },
        ..case
    };
    assert!(from_zero.rests("exact"));
}

#[test]
fn the_papers_rule_labels_by_luck() {
    let case = Case::new("papers-rule");
    let run = |samples| Case { samples, ..case }.run("exact").classes;
    let (last, next) = (run(case.samples), run(case.samples + 1));
    assert_eq!((last.paper, next.paper), (Class::Rest, Class::LimitCycle));
    assert_eq!(
        (last.window, next.window),
        (Class::LimitCycle, Class::LimitCycle)
    );
    case.is_true_to(6);
}

#[test]
fn the_papers_bound_has_a_hole_between_whole_counts() {
    let case = Case::new("bound-hole");
    let (end, exchange) = case.display.audited_step(case.start, 0.0);
    let moved = end.position - case.start.position;
    assert!((end.position - 1.49).abs() < 1e-12);
    let bound = energy::generated_bound_of_the_paper(moved);
    assert!((bound - 0.375).abs() < 1e-9, "{bound}");
    assert!((exchange.generated - 0.49).abs() < 1e-9, "{exchange:?}");
    assert!(exchange.generated <= energy::generated_supremum(moved));
    // Without friction or hand it is energy that the display gains, in 77 digits too.
    let precise = PreciseDisplay::new(case.display.parameters()).unwrap();
    let after = precise.stored_energy(&precise.follow(case.start, 1));
    let gained = double(&(after - precise.stored_energy(&case.start.into())));
    assert!((gained - 0.49).abs() < 1e-12, "{gained}");
}

#[test]
fn dense_output_is_wrong_at_any_tolerance() {
    let case = Case::new("dense-output");
    for tolerance in [1e-6, 1e-9, 1e-12] {
        let error =
            |dense| forms::slide_error(&case.display, case.start, tolerance, dense).unwrap();
        assert!(error(true) > 1e-3, "{tolerance:e}: {}", error(true));
        assert!(error(false) < tolerance, "{tolerance:e}: {}", error(false));
    }
    let exact = forms::error_after_a_sample(&Exact, &case.display, case.start).unwrap();
    assert!(exact < 1e-14, "{exact}");
}

/// A scene of a failure as it stands.
fn naive(name: &str) -> Report {
    scene::parse(text(name)).unwrap().run(|_| true).unwrap()
}

/// The same with one line for another.
fn mended(name: &str, line: &str, by: &str) -> Report {
    let mended = forms::mended(text(name), line, by).unwrap();
    mended.run(|_| true).unwrap()
}

/// The stiffness that a control which believes what the scene says reckons with at 10 rad/s, Nm/rad.
fn allowed_at_10(name: &str) -> f32 {
    let config = scene::parse(text(name)).unwrap().scene.config;
    let profile = Profile::new(&config.shape, config.count_rad()).unwrap();
    let criterion = effective_criterion(&config, &profile, 0.0).unwrap();
    criterion.largest_stiffness_at(10.0)
}

/// Under another law than `raw`.
fn under(law: &str, name: &str) -> Report {
    mended(name, "law = \"raw\"", &format!("law = \"{law}\""))
}

/// Under every law that promises passivity.
fn passive_under_laws(name: &str) {
    for law in ["static", "episode", "ledger", "auto"] {
        passive(&under(law, name));
    }
}

fn passive(report: &Report) {
    assert_eq!(report.class, Class::Rest, "{report:?}");
    let excess = report.energy_excess_j / report.energy_start_j;
    assert!(excess < 1e-6, "{report:?}");
}

#[test]
fn a_model_without_the_delay_calls_a_growing_spring_safe() {
    let model = mended("delay-left-out", "delay_s = 0.5e-3", "delay_s = 0.0");
    passive(&model);
    assert_eq!(naive("delay-left-out").class, Class::Unstable);
}

/// `what_breaks::a_wall_off_a_count_edge_counts_with_its_first_step`, as a scene.
#[test]
fn a_wall_off_an_edge_gives_energy_out() {
    // The criterion knows of the first step; with ½ K Δ it would hold.
    let loaded = scene::parse(text("wall-off-edge")).unwrap();
    let stiffness = loaded.scene.config.stiffness_nm_rad;
    let margin = loaded.criterion().unwrap().power_margin_nm(stiffness, 0.0);
    assert!(margin < 0.0, "margin {margin} Nm");
    let off = naive("wall-off-edge");
    let gain = off.energy_excess_j / off.energy_start_j;
    assert!(gain > 0.4, "{off:?}");
    passive(&mended(
        "wall-off-edge",
        "wall_rad = 3.074097498922825e-3",
        "wall_rad = 6.135923151542565e-3",
    ));
    passive_under_laws("wall-off-edge");
}

/// `what_breaks::torques_are_cut_to_steps_not_rounded`, as a scene.
#[test]
fn torque_rounded_to_steps_cycles() {
    // The criterion knows of half a step; without it it would hold.
    let loaded = scene::parse(text("dac-rounding")).unwrap();
    let margin = loaded.criterion().unwrap().power_margin_nm(4.0, 0.0);
    assert!(margin < 0.0, "margin {margin} Nm");
    assert_eq!(naive("dac-rounding").class, Class::LimitCycle);
    passive(&mended(
        "dac-rounding",
        "torque_step_nm = 2.2e-3",
        "torque_step_nm = 0.0",
    ));
    passive_under_laws("dac-rounding");
}

/// `what_breaks::a_start_under_load_counts_with_the_speed_it_turns_into`, as a scene.
#[test]
fn a_spring_let_go_under_load_grows() {
    let loaded = scene::parse(text("start-deflected")).unwrap();
    let criterion = loaded.criterion().unwrap();
    assert!(criterion.power_margin_nm(1.0, 0.0) > 0.0);
    assert_eq!(naive("start-deflected").class, Class::Unstable);
    let reached = loaded.scene.reachable_speed_rad_s(1.0);
    assert!(criterion.power_margin_nm(1.0, reached) < 0.0);
    passive_under_laws("start-deflected");
}

/// `what_breaks::region_c_is_refused_at_every_speed`, as a scene.
#[test]
fn region_c_is_admitted_and_never_rests() {
    let loaded = scene::parse(text("region-c")).unwrap();
    let criterion = loaded.criterion().unwrap();
    assert!(criterion.power_margin_nm(0.015, 300.0) > 0.0);
    assert_eq!(criterion.dimensionless(0.015).region(), Region::LimitCycle);
    assert_eq!(naive("region-c").class, Class::LimitCycle);
    passive_under_laws("region-c");
}

/// `what_breaks::a_detent_counts_with_its_steepest_slope`, as a scene.
#[test]
fn a_detent_by_its_local_slope_gives_energy_out() {
    let loaded = scene::parse(text("detent-slope")).unwrap();
    let config = &loaded.scene.config;
    let Shape::Detent { period_rad, .. } = config.shape else {
        panic!("no detent");
    };
    let local = forms::by_the_local_slope(
        loaded.criterion().unwrap(),
        period_rad,
        config.stiffness_nm_rad,
    );
    let report = forms::run_choosing(&loaded.scene, local, |_| true).unwrap();
    let gain = report.energy_excess_j / report.energy_start_j;
    assert!(gain > 30.0, "{report:?}");
    for law in ["static", "episode", "ledger", "auto"] {
        let by = format!("law = \"{law}\"");
        passive(&mended("detent-slope", "law = \"auto\"", &by));
    }
}

/// `what_breaks::friction_counts_with_the_least_it_may_be`, as a scene.
#[test]
fn friction_believed_twice_as_large_grows() {
    assert_eq!(naive("friction-believed").class, Class::Unstable);
    passive(&mended(
        "friction-believed",
        "stiffness_nm_rad = 0.776",
        "stiffness_nm_rad = 0.388",
    ));
    // The low ends of what is believed.
    let allowed = allowed_at_10("friction-believed");
    assert!((0.388..0.389).contains(&allowed), "{allowed} Nm/rad");
    passive_under_laws("friction-believed");
}

/// `what_breaks::a_missed_tick_counts_as_the_longest_interval`, as a scene.
#[test]
fn missed_ticks_grow_by_the_nominal_period() {
    assert_eq!(naive("missed-ticks").class, Class::Unstable);
    passive(&mended(
        "missed-ticks",
        "stiffness_nm_rad = 0.388",
        "stiffness_nm_rad = 0.201",
    ));
    let allowed = allowed_at_10("missed-ticks");
    assert!((0.201..0.202).contains(&allowed), "{allowed} Nm/rad");
    passive_under_laws("missed-ticks");
}

/// `limits::a_delay_that_nobody_told_grows`, as a scene.
#[test]
fn a_delay_that_nobody_told_the_ledger_grows() {
    assert_eq!(naive("delay-untold").class, Class::Unstable);
    passive(&mended("delay-untold", "delay_s = 0.0", "delay_s = 0.5e-3"));
}

/// `what_breaks::within_a_contact_stiffness_only_falls`, as a scene.
#[test]
fn a_clamp_that_follows_the_speed_both_ways_grows() {
    let loaded = scene::parse(text("clamp-both-ways")).unwrap();
    let demand = loaded.scene.config.stiffness_nm_rad;
    let both_ways = forms::following_the_speed(loaded.criterion().unwrap(), demand);
    let report = forms::run_choosing(&loaded.scene, both_ways, |_| true).unwrap();
    assert_eq!(report.class, Class::Unstable, "{report:?}");
    for law in ["static", "episode", "ledger", "auto"] {
        let by = format!("law = \"{law}\"");
        passive(&mended("clamp-both-ways", "law = \"episode\"", &by));
    }
}
