//! What the firmware costs: flash, RAM, stack, instructions of a tick. `cargo xtask size` prints it and
//! writes `firmware/size.txt`; without that the figures must not exceed the file's by more than 2 %.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use acceptance::powered_twin::{all_of, example_motor, knob};
use acceptance::{PoweredRig, Rig, request_frame};
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SymbolKind};
use plant_sim::hold::State as Motion;
use plant_sim::lockstep::{Bench, Emulator, Order, Plant, SETTINGS_BYTES};
use plant_sim::powered::Powered;
use plant_sim::powered_lockstep::{DriveEmulator, PoweredBench, Surroundings};
use plant_sim::preset::preset;
use protocol::{Changes, Drive, Excitation, Fields, Law, Motor, Request, Shape, Subscription};

/// Instructions that a tick of a spring may take, by law; of a board with a power stage, the whole interrupt of a PWM period,
/// without and with a haptic tick in it.
const BUDGET: [(&str, u64); 10] = [
    ("tick_static_instructions", 100),
    ("tick_episode_instructions", 180),
    ("tick_ledger_instructions", 650),
    ("tick_ledger_four_ticks_back_instructions", 450),
    ("current_tick_current_instructions", 700),
    ("current_tick_voltage_instructions", 700),
    ("current_tick_brushed_instructions", 700),
    ("current_tick_current_ledger_instructions", 1300),
    ("current_tick_voltage_ledger_instructions", 1300),
    ("current_tick_brushed_ledger_instructions", 1300),
];

struct Image {
    bytes: Vec<u8>,
    /// Address and size of every function, by name.
    functions: BTreeMap<String, (u64, u64)>,
    /// Where data lies among the code.
    data: BTreeSet<u64>,
    code: BTreeSet<u64>,
    flash: u64,
    ram: u64,
}

impl Image {
    fn load(path: &Path) -> Self {
        let bytes = fs::read(path).expect("the firmware was built");
        let file = object::File::parse(&*bytes).expect("an ELF file");
        let (mut functions, mut data, mut code) =
            (BTreeMap::new(), BTreeSet::new(), BTreeSet::new());
        for symbol in file.symbols() {
            let name = symbol.name().unwrap_or_default().to_owned();
            if symbol.kind() == SymbolKind::Text && symbol.size() > 0 {
                functions.insert(name, (symbol.address() & !1, symbol.size()));
            } else if name.starts_with("$d") {
                data.insert(symbol.address());
            } else if name.starts_with("$t") {
                code.insert(symbol.address());
            }
        }
        let (mut flash, mut ram) = (0, 0);
        for section in file.sections() {
            let SectionFlags::Elf { sh_flags } = section.flags() else {
                continue;
            };
            let (allocated, written) = (sh_flags & 2 != 0, sh_flags & 1 != 0);
            let name = section.name().unwrap_or_default();
            if !allocated || name == ".uninit" {
                continue;
            }
            if !name.starts_with(".bss") {
                flash += section.size();
            }
            if written {
                ram += section.size();
            }
        }
        Self {
            functions,
            data,
            code,
            flash,
            ram,
            bytes,
        }
    }

    /// The one function whose mangled name holds all these parts.
    fn function(&self, parts: &[&str]) -> (u64, u64) {
        let mut found = self
            .functions
            .iter()
            .filter(|(name, _)| parts.iter().all(|part| name.contains(part)));
        let (_, place) = found
            .next()
            .unwrap_or_else(|| panic!("no function {parts:?}"));
        *place
    }

    /// Functions that can be reached from one by branches with a fixed target.
    fn reached_from(&self, start: u64) -> BTreeSet<&str> {
        let by_address: BTreeMap<u64, (&str, u64)> = self
            .functions
            .iter()
            .map(|(name, (at, size))| (*at, (name.as_str(), *size)))
            .collect();
        let mut names = BTreeSet::new();
        let mut waiting = vec![start];
        while let Some(address) = waiting.pop() {
            let Some((name, size)) = by_address.get(&address) else {
                continue;
            };
            if names.insert(*name) {
                waiting.extend(self.branches(address, *size));
            }
        }
        names
    }

    /// Targets of BL and B.W in a function (Thumb-2), outside of it.
    fn branches(&self, start: u64, size: u64) -> Vec<u64> {
        let file = object::File::parse(&*self.bytes).expect("an ELF file");
        let section = file
            .sections()
            .find(|section| {
                section.address() <= start && start < section.address() + section.size()
            })
            .expect("functions lie in sections");
        let bytes = section.data().expect("code has bytes");
        let half = |at: u64| {
            let i = (at - section.address()) as usize;
            u32::from(u16::from_le_bytes([bytes[i], bytes[i + 1]]))
        };
        let mut targets = Vec::new();
        let mut at = start;
        while at + 2 <= start + size {
            let marks = |set: &BTreeSet<u64>| set.range(..=at).next_back().copied().unwrap_or(0);
            if marks(&self.data) > marks(&self.code) {
                at += 2;
                continue;
            }
            let first = half(at);
            if first >> 11 < 0b11101 {
                at += 2;
                continue;
            }
            let second = half(at + 2);
            // B.W is a call too, where it is the last thing that a function does.
            if first >> 11 == 0b11110 && second & 0x9000 == 0x9000 {
                let s = first >> 10 & 1;
                let (j1, j2) = (second >> 13 & 1, second >> 11 & 1);
                let (i1, i2) = (1 ^ j1 ^ s, 1 ^ j2 ^ s);
                let offset =
                    s << 24 | i1 << 23 | i2 << 22 | (first & 0x3FF) << 12 | (second & 0x7FF) << 1;
                let offset = i64::from((offset << 7) as i32 >> 7);
                let target = (at as i64 + 4 + offset) as u64;
                if !(start..start + size).contains(&target) {
                    targets.push(target);
                }
            }
            at += 4;
        }
        targets
    }
}

fn spring(law: Law) -> Changes {
    Changes {
        law: Some(law),
        shape: Some(Shape::Spring),
        stiffness_nm_rad: Some(0.5),
        ..Changes::default()
    }
}

/// All that a tick can be asked for, at once.
fn everything(law: Law) -> Changes {
    Changes {
        shape: Some(Shape::Detent),
        period_rad: Some(0.2),
        damping_nm_s_rad: Some(1e-4),
        delay_s: Some(2e-4),
        amplifier_tau_s: Some(1e-4),
        jitter_s: Some(1e-5),
        torque_step_nm: Some(1e-4),
        stiffness_nm_rad: Some(2.0),
        ..spring(law)
    }
}

/// A bench that renders, thrown at 3 rad/s.
fn bench(shift: u32, arguments: &[String], changes: Changes) -> Bench {
    bench_of(&Rig::image(), shift, arguments, None, changes)
}

fn bench_of(
    image: &Path,
    shift: u32,
    arguments: &[String],
    settings: Option<&Path>,
    changes: Changes,
) -> Bench {
    let device = preset("re35").unwrap().device;
    let mut bench = Bench {
        emulator: Emulator::start_with(image, shift, arguments, settings).unwrap(),
        plant: Plant::new(device, 8192.0, 0.0).unwrap(),
    };
    for request in [Request::Set(changes), Request::Arm] {
        bench.emulator.send(&request_frame(1, request)).unwrap();
        bench.tick().unwrap();
    }
    bench.plant.let_go(3.0);
    bench
}

/// Most instructions executed in one tick of the controller, with what it calls.
fn instructions(path: &Path, changes: Changes) -> usize {
    let image = Image::load(path);
    let (start, _) = image.function(&["Controller4tick"]);
    let reached = image.reached_from(start);
    // Where the tick returns to: what others do with the functions it shares does not count.
    let (caller, caller_size) = image.function(&["TIM2"]);
    let reached = reached.iter().map(|name| image.functions[*name]);
    let ranges = reached.chain([(caller, caller_size)]);
    let ranges: Vec<String> = ranges
        .map(|(at, size)| format!("{at:#x}+{size:#x}"))
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("exec.log");
    let trace = ["-singlestep", "-d", "exec,nochain", "-dfilter"].map(String::from);
    let mut arguments = trace.to_vec();
    arguments.push(ranges.join(","));
    arguments.extend(["-D".into(), log.display().to_string()]);
    let mut bench = bench_of(path, 0, &arguments, None, changes);
    for _ in 0..300 {
        bench.tick().unwrap();
    }
    drop(bench);
    let text = fs::read_to_string(&log).unwrap();
    // Trace 0: 0x7f… [flags/PC/…] name. One line an instruction.
    let addresses = text.lines().filter_map(|line| {
        let fields = line.split_once('[')?.1;
        u64::from_str_radix(fields.split('/').nth(1)?, 16).ok()
    });
    let (mut most, mut now, mut inside) = (0, 0, false);
    for address in addresses {
        if address == start {
            (now, inside) = (0, true);
        } else if (caller..caller + caller_size).contains(&address) {
            inside = false;
        }
        now += usize::from(inside);
        most = most.max(now);
    }
    assert!(most > 10, "the trace is empty");
    most
}

/// PWM periods between two haptic ticks.
const EVERY: usize = 24;

/// A bench with a power stage and that motor, thrown at so many rad/s, which was asked all this.
fn powered_bench(motor: &Motor, speed_rad_s: f64, requests: &[Request]) -> PoweredBench {
    let thrown = Motion {
        position: -0.01,
        velocity: speed_rad_s,
    };
    let setup = knob(motor, 8192, preset("re35").unwrap().device, thrown);
    let mut bench = PoweredBench {
        emulator: DriveEmulator::start(&PoweredRig::image(), 0, &[], None).unwrap(),
        knob: Powered::new(&setup).unwrap(),
        around: Surroundings::default(),
    };
    for request in requests {
        bench.emulator.send(&request_frame(1, *request)).unwrap();
        for _ in 0..EVERY {
            bench.period().unwrap();
        }
    }
    bench
}

/// Most instructions of the interrupt of a PWM period while a motor is measured, by a field that turns and ripples; without,
/// and with the haptic tick and the end of a window in it.
fn calibrating() -> [u64; 2] {
    let motor = example_motor(Drive::Current);
    let excitation = Excitation {
        angle: 0,
        turn: 1 << 20,
        back: true,
        steady_v: 0.5,
        steady_a: [0.5, 0.1],
        along_v: 0.3,
        across_v: 0.3,
        quarter: 2,
        rise: 240,
        // So that windows end where haptic ticks are.
        settle: 241,
        window: 48,
        windows: 80,
        zero_codes: [motor.offset_b_codes, motor.offset_c_codes],
        current_max_a: 8.0,
        way_max: 1000,
    };
    let mut bench = powered_bench(&motor, 0.0, &[Request::Calibrate(excitation)]);
    let (mut costs, mut on) = (Vec::new(), 0);
    for _ in 0..200 * EVERY {
        let report = bench.period().unwrap().report;
        costs.push(u64::from(report.cost));
        on += u32::from(report.duties.is_some());
    }
    // Rise, settling, windows, fall: all of it went by, and it ended.
    assert!((4500..=4560).contains(&on), "{on} periods of voltage");
    assert!(bench.emulator.report().duties.is_none());
    by_phase(&costs)
}

/// The most of two of the 24 phases: the one with the haptic tick in it is the dearest; and the next.
fn by_phase(costs: &[u64]) -> [u64; 2] {
    let most = |phase: usize| {
        let of_phase = costs.iter().skip(phase).step_by(EVERY);
        of_phase.copied().max().unwrap_or(0)
    };
    let mut phases: Vec<u64> = (0..EVERY).map(most).collect();
    phases.sort_unstable();
    let [.., current, haptic] = phases[..] else {
        unreachable!("there are 24");
    };
    assert!(haptic > current + 200, "{phases:?}");
    [current, haptic]
}

/// Most instructions of the interrupt of a PWM period, without and with a haptic tick under the ledger in it: all of it, from
/// what was sensed to the duties.
fn current_ticks(drive: Drive) -> [u64; 2] {
    let motor = example_motor(drive);
    let requests = [
        Request::Set(spring(Law::Ledger)),
        Request::SetMotor(all_of(&motor)),
        Request::Arm,
    ];
    let mut bench = powered_bench(&motor, 3.0, &requests);
    let costs: Vec<u64> = (0..200 * EVERY)
        .map(|_| u64::from(bench.period().unwrap().report.cost))
        .collect();
    assert!(bench.emulator.report().duties.is_some());
    by_phase(&costs)
}

fn measure() -> BTreeMap<&'static str, u64> {
    let image = Image::load(&Rig::image());
    let mut figures = BTreeMap::from([("flash_bytes", image.flash), ("ram_bytes", image.ram)]);
    for (name, changes) in [
        ("tick_raw_instructions", spring(Law::Raw)),
        ("tick_static_instructions", spring(Law::Static)),
        ("tick_episode_instructions", spring(Law::Episode)),
        ("tick_ledger_instructions", spring(Law::Ledger)),
        (
            "tick_ledger_everything_instructions",
            everything(Law::Ledger),
        ),
        ("tick_auto_everything_instructions", everything(Law::Auto)),
    ] {
        figures.insert(name, instructions(&Rig::image(), changes) as u64);
    }
    let four = Rig::image().with_file_name("emulated-four-ticks-back.elf");
    figures.insert(
        "tick_ledger_four_ticks_back_instructions",
        instructions(&four, spring(Law::Ledger)) as u64,
    );
    for (name, law) in [
        ("interrupt_static_instructions", Law::Static),
        ("interrupt_ledger_instructions", Law::Ledger),
    ] {
        let mut whole = bench(0, &[], spring(law));
        let costs = (0..2000).map(|_| u64::from(whole.tick().unwrap().1.cost));
        figures.insert(name, costs.max().unwrap());
    }
    for (drive, names) in [
        (
            Drive::Current,
            [
                "current_tick_current_instructions",
                "current_tick_current_ledger_instructions",
            ],
        ),
        (
            Drive::Voltage,
            [
                "current_tick_voltage_instructions",
                "current_tick_voltage_ledger_instructions",
            ],
        ),
        (
            Drive::Brushed,
            [
                "current_tick_brushed_instructions",
                "current_tick_brushed_ledger_instructions",
            ],
        ),
    ] {
        figures.extend(names.into_iter().zip(current_ticks(drive)));
    }
    let names = [
        "current_tick_calibrating_instructions",
        "current_tick_calibrating_haptic_instructions",
    ];
    figures.extend(names.into_iter().zip(calibrating()));
    let drive_image = Image::load(&PoweredRig::image());
    figures.insert("drive_flash_bytes", drive_image.flash);
    figures.insert("drive_ram_bytes", drive_image.ram);
    // Everything at once, for the deepest stack.
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("settings");
    fs::write(&settings, [0xFF; SETTINGS_BYTES]).unwrap();
    let mut busy = bench_of(
        &Rig::image(),
        3,
        &[],
        Some(&settings),
        everything(Law::Auto),
    );
    let all = Subscription {
        every_ticks: 1,
        fields: Fields::ALL,
        clamp_events: true,
    };
    for request in [
        Request::Subscribe(all),
        Request::Hello {
            version: protocol::VERSION,
        },
        Request::Set(spring(Law::Raw)),
        Request::Set(everything(Law::Ledger)),
        Request::Get,
        Request::Disarm,
        Request::Save,
    ] {
        busy.emulator.send(&request_frame(2, request)).unwrap();
        for _ in 0..50 {
            busy.tick().unwrap();
        }
    }
    assert_ne!(fs::read(&settings).unwrap(), [0xFF; SETTINGS_BYTES]);
    let stack = busy.emulator.exchange(Order::Stack, 0).unwrap().cost;
    figures.insert("stack_bytes", u64::from(stack));
    figures
}

fn file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/size.txt")
}

#[test]
fn size_and_cost_are_what_they_were() {
    let figures = measure();
    let mut text = String::new();
    for (name, figure) in &figures {
        writeln!(text, "{name} {figure}").unwrap();
    }
    println!("{text}");
    let mut quick = bench(3, &[], spring(Law::Static));
    let began = std::time::Instant::now();
    for _ in 0..20_000 {
        quick.tick().unwrap();
    }
    let per_second = 20_000.0 / began.elapsed().as_secs_f64();
    println!("lockstep: {per_second:.0} ticks per second");
    assert!(
        figures["flash_bytes"] <= 768 * 1024
            && figures["ram_bytes"] + figures["stack_bytes"] <= 128 * 1024
    );
    let write = std::env::var_os("KNOB_WRITE_SIZE").is_some();
    if write {
        fs::write(file(), text).unwrap();
    }
    for (name, budget) in BUDGET {
        assert!(
            figures[name] <= budget,
            "{name}: {} of {budget}",
            figures[name]
        );
    }
    if write {
        return;
    }
    let known =
        fs::read_to_string(file()).expect("firmware/size.txt: write it with `cargo xtask size`");
    for line in known.lines() {
        let (name, limit) = line.split_once(' ').unwrap();
        let (figure, limit) = (figures[name], limit.parse::<u64>().unwrap());
        assert!(
            figure * 100 <= limit * 102,
            "{name} is {figure}, was {limit}: if that is meant, `cargo xtask size`"
        );
    }
}

#[test]
fn the_tick_calls_no_panicking_code() {
    let odrive = Rig::image().with_file_name("odrive_v3.elf");
    for (path, interrupt) in [
        (Rig::image(), "TIM2"),
        (PoweredRig::image(), "ADC"),
        (odrive, "ADC"),
    ] {
        let image = Image::load(&path);
        let reached = image.reached_from(image.functions[interrupt].0);
        assert!(
            reached.iter().any(|name| name.contains("Controller4tick")),
            "{reached:?}"
        );
        let panics: Vec<_> = reached
            .iter()
            .filter(|name| name.contains("panic") || name.contains("unwrap"))
            .collect();
        assert!(panics.is_empty(), "{interrupt} can reach {panics:?}");
        // The walk would find a panic: init has one.
        let init = image.reached_from(image.function(&["main"]).0);
        assert!(init.iter().any(|name| name.contains("panic")), "{init:?}");
    }
}
