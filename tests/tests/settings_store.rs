//! Settings that survive: power cut at every step of every save, damage, other versions, wear, and what the
//! device says of it.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use acceptance::{Answer, Cut, Flash, Random, Twin, answers, request_frame};
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use firmware::settings::{DEFAULT_SETTINGS, DEFAULTS, Settings};
use firmware::store::{Keep, Loaded, SLOT, SaveError, Store, VERSION};
use protocol::{
    Changes, Drive, Frames, Interval, Law, Message, Motor, Name, Parameters, Refusal, Request,
    Shape, State, Status, Stored,
};
use rayon::prelude::*;

/// Four slots a sector, so that a few saves go round.
const SMALL: usize = 4 * SLOT;
/// A sector of the STM32F405.
const SECTOR: usize = 128 * 1024;

fn load<F: NorFlash>(flash: F) -> Loaded {
    Store::new(flash, 0).load()
}

fn save<F: NorFlash>(flash: F, settings: &Settings) -> Result<(), SaveError> {
    Store::new(flash, 0).save(settings)
}

/// Any settings: the store keeps what it is given. None of its bits is the same in every set.
fn any_settings(random: &mut Random) -> Settings {
    // Any sign, exponent and fraction, but finite, so that a set equals itself.
    let mut number = || f32::from_bits(random.bits() as u32 & 0xBFFF_FFFF);
    let mut interval = || Interval {
        low: number(),
        high: number(),
    };
    let parameters = Parameters {
        inertia_kg_m2: interval(),
        viscous_nm_s_rad: interval(),
        coulomb_nm: interval(),
        sample_period_s: number(),
        stiffness_nm_rad: number(),
        damping_nm_s_rad: number(),
        centre_rad: number(),
        wall_rad: number(),
        period_rad: number(),
        torque_max_nm: number(),
        speed_max_rad_s: number(),
        delay_s: number(),
        amplifier_tau_s: number(),
        jitter_s: number(),
        torque_step_nm: number(),
        decimation: random.bits() as u32 >> random.below(32),
        counts_per_rev: random.bits() as u32 >> random.below(32),
        law: [Law::Raw, Law::Static, Law::Episode, Law::Ledger, Law::Auto]
            [random.below(5) as usize],
        shape: [Shape::Spring, Shape::Wall, Shape::Detent][random.below(3) as usize],
    };
    let mut number = || f32::from_bits(random.bits() as u32 & 0xBFFF_FFFF);
    let motor = Motor {
        resistance_ohm: number(),
        d_inductance_h: number(),
        q_inductance_h: number(),
        torque_constant_nm_a: number(),
        current_max_a: number(),
        zero_turns: number(),
        offset_b_codes: number(),
        offset_c_codes: number(),
        drive: [Drive::None, Drive::Current, Drive::Voltage, Drive::Brushed]
            [random.below(4) as usize],
        pole_pairs: random.bits() as u32 >> random.below(32),
        reversed: random.below(2) == 1,
    };
    Settings { parameters, motor }
}

/// What is said where a set of parameters was taken, or the defaults for want of one.
fn is_set(loaded: &Loaded, set: Option<&Settings>) -> bool {
    match set {
        Some(set) => {
            loaded.settings == *set && matches!(loaded.stored, Stored::Last | Stored::Older)
        }
        None => {
            loaded.settings == DEFAULT_SETTINGS
                && matches!(loaded.stored, Stored::Nothing | Stored::Damaged)
        }
    }
}

/// How many cuts were tried.
#[derive(Default)]
struct Cuts {
    programming: AtomicU64,
    erasing: AtomicU64,
    /// Cuts that left the old set, or the new one.
    old: AtomicU64,
    new: AtomicU64,
}

/// Several saves, each cut at every one of its steps. From there on, with what one of the
/// cuts has left as often as with the whole save.
fn history<const WORD: usize>(seed: u64, cuts: &Cuts) {
    let mut random = Random(seed);
    let mut flash = Flash::<WORD, SMALL>::blank(random.bits());
    let mut kept: Option<Settings> = None;
    for round in 0..1 + random.below(7) {
        let new = any_settings(&mut random);
        let mut whole = flash.clone();
        assert_eq!(save(&mut whole, &new), Ok(()));
        let after = load(&mut whole);
        assert_eq!((after.stored, after.settings), (Stored::Last, new));

        let steps = whole.steps - flash.steps;
        let mut next = whole.clone();
        let mut next_kept = Some(new);
        let taken = random.below(2 * steps);
        for step in 1..=steps {
            let erased = flash.cut_erases;
            for cut in Cut::EACH {
                let mut torn = flash.clone();
                torn.cut = Some((flash.steps + step, cut));
                assert_eq!(save(&mut torn, &new), Err(SaveError::Flash));
                // The power is back.
                torn.cut = None;
                let loaded = load(&mut torn);
                let is_new = is_set(&loaded, Some(&new));
                assert!(
                    is_new || is_set(&loaded, kept.as_ref()),
                    "seed {seed}, save {round}, step {step} of {steps}, {cut:?}: {loaded:?}, \
                     old {kept:?}, new {new:?}"
                );
                let count = if is_new { &cuts.new } else { &cuts.old };
                count.fetch_add(1, Relaxed);
                if step == taken {
                    next = torn.clone();
                    next_kept = if is_new { Some(new) } else { kept };
                }
                // Saving works as before.
                let again = any_settings(&mut random);
                assert_eq!(save(&mut torn, &again), Ok(()));
                let loaded = load(&mut torn);
                assert_eq!((loaded.stored, loaded.settings), (Stored::Last, again));
                // All the ways to be cut differ only at an erase.
                if torn.cut_erases == erased {
                    cuts.programming.fetch_add(1, Relaxed);
                    break;
                }
                cuts.erasing.fetch_add(1, Relaxed);
            }
        }
        flash = next;
        kept = next_kept;
    }
}

#[test]
fn a_cut_at_any_step_of_ten_thousand_histories_leaves_the_old_or_the_new_set() {
    let cuts = Cuts::default();
    (0..10_000_u64).into_par_iter().for_each(|seed| {
        // By word, as the board programs; now and then by byte.
        if seed % 8 == 0 {
            history::<1>(seed, &cuts);
        } else {
            history::<4>(seed, &cuts);
        }
    });
    let [programming, erasing, old, new] =
        [&cuts.programming, &cuts.erasing, &cuts.old, &cuts.new].map(|count| count.load(Relaxed));
    println!(
        "{programming} cuts in words, {erasing} in erases; {old} left the old set, {new} the new one"
    );
    assert!(programming > 1_000_000 && erasing > 100_000);
    assert!(old > 1_000_000 && new > 1000, "{old} and {new}");
}

/// A flash with some saves, the last of which is returned, and the one before.
fn filled(random: &mut Random) -> (Flash<4, SMALL>, Vec<Settings>) {
    let mut flash = Flash::blank(random.bits());
    let saves = 1 + random.below(11);
    let sets: Vec<Settings> = (0..saves).map(|_| any_settings(random)).collect();
    for set in &sets {
        assert_eq!(save(&mut flash, set), Ok(()));
    }
    (flash, sets)
}

#[test]
fn damage_leaves_a_whole_set_or_defaults_and_is_told() {
    (0..20_000_u64).into_par_iter().for_each(|seed| {
        let mut random = Random(seed);
        let (mut flash, sets) = filled(&mut random);
        for _ in 0..1 + random.below(64) {
            let bit = random.below(8 * flash.bytes.len() as u64) as usize;
            flash.bytes[bit / 8] ^= 1 << (bit % 8);
        }
        let loaded = load(&mut flash);
        match loaded.stored {
            Stored::Last | Stored::Older => assert!(sets.contains(&loaded.settings)),
            Stored::Damaged => assert_eq!(loaded.settings, DEFAULT_SETTINGS),
            other => panic!("seed {seed}: {other:?}"),
        }
        let new = any_settings(&mut random);
        assert_eq!(save(&mut flash, &new), Ok(()), "seed {seed}");
        // Where a blank slot was damaged it may take that for a save that was cut short.
        assert!(is_set(&load(&mut flash), Some(&new)), "seed {seed}");
    });
}

/// Where the record of save `i` lies.
fn place(i: usize) -> usize {
    i % (2 * SMALL / SLOT) * SLOT
}

#[test]
fn a_bit_wrong_in_the_last_record_gives_the_one_before_and_says_so() {
    for seed in 0..2000 {
        let mut random = Random(seed);
        let (mut flash, sets) = filled(&mut random);
        let last = sets.len() - 1;
        let start = place(last);
        let length = flash.bytes[start..start + SLOT]
            .iter()
            .rposition(|byte| *byte != 0xFF)
            .unwrap();
        let bit = 8 * start + random.below(8 * length as u64) as usize;
        flash.bytes[bit / 8] ^= 1 << (bit % 8);
        let loaded = load(&mut flash);
        let wanted = match last {
            0 => Loaded::defaults(Stored::Damaged),
            _ => Loaded {
                stored: Stored::Older,
                settings: sets[last - 1],
            },
        };
        assert_eq!(loaded, wanted, "seed {seed}, {} saves", sets.len());
    }
}

#[test]
fn whatever_is_in_the_flash_it_starts_with_defaults_and_saves() {
    for seed in 0..2000 {
        let mut random = Random(seed);
        let mut flash = Flash::<4, SMALL>::blank(1);
        let mask = random.byte();
        for byte in &mut flash.bytes {
            *byte = random.byte() & mask;
        }
        assert_eq!(load(&mut flash), Loaded::defaults(Stored::Damaged));
        let new = any_settings(&mut random);
        assert_eq!(save(&mut flash, &new), Ok(()));
        assert_eq!(load(&mut flash).settings, new);
    }
    let mut blank = Flash::<4, SMALL>::blank(1);
    assert_eq!(load(&mut blank), Loaded::defaults(Stored::Nothing));
}

/// A record as `firmware::store` describes it, with its checksum worked out bit by bit.
fn record(number: u32, version: u16, content: &[u8]) -> Vec<u8> {
    let mut bytes = number.to_le_bytes().to_vec();
    bytes.extend(version.to_le_bytes());
    bytes.extend((content.len() as u16).to_le_bytes());
    bytes.extend(content);
    let mut crc = u32::MAX;
    for byte in &bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = crc >> 1 ^ if crc & 1 == 1 { 0x82F6_3B78 } else { 0 };
        }
    }
    bytes.extend((!crc).to_le_bytes());
    bytes
}

/// The parameters in what `save` wrote last.
fn content(flash: &Flash<4, SMALL>, slot: usize) -> Vec<u8> {
    let record = &flash.bytes[slot * SLOT..][..SLOT];
    let length = usize::from(u16::from_le_bytes([record[6], record[7]]));
    record[8..8 + length].to_vec()
}

#[test]
fn a_record_is_written_as_described() {
    let mut flash = Flash::<4, SMALL>::blank(1);
    for _ in 0..2 {
        save(&mut flash, &DEFAULT_SETTINGS).unwrap();
    }
    for number in 0..2 {
        let slot = number as usize;
        let wanted = record(number, VERSION, &content(&flash, slot));
        assert_eq!(flash.bytes[slot * SLOT..][..wanted.len()], wanted);
    }
    // Of version 2. If this fails, what is stored has changed: raise the version.
    let hex: String = content(&flash, 0)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    assert_eq!((VERSION, hex.as_str()), (2, DEFAULTS_V2));
}

/// [`DEFAULT_SETTINGS`] as version 2 stores them.
const DEFAULTS_V2: &str = "6f12833a018040040000000000000000000000000000000000cdcc4c3e0000003f00007a44cab8d236cab8d236b5fe1637b5fe16376f12033b6f12033b0000000000000000000000000000000000010000803f6f12833a6f12833acdcc4c3d0000000000000000000000004500000045";

#[test]
fn another_version_or_another_content_gives_defaults_and_is_told() {
    let mut flash = Flash::<4, SMALL>::blank(1);
    let old = any_settings(&mut Random(1));
    save(&mut flash, &old).unwrap();
    let good = content(&flash, 0);
    let mut long = good.clone();
    long.push(0);
    for (version, content, stored) in [
        (
            VERSION + 1,
            &good[..],
            Stored::Version { found: VERSION + 1 },
        ),
        (0, &[], Stored::Version { found: 0 }),
        (u16::MAX, &long, Stored::Version { found: u16::MAX }),
        (VERSION, &long, Stored::Damaged),
        (VERSION, &good[..good.len() - 1], Stored::Damaged),
        (VERSION, &[], Stored::Damaged),
    ] {
        let mut flash = flash.clone();
        let record = record(1, version, content);
        flash.bytes[SLOT..][..record.len()].copy_from_slice(&record);
        assert_eq!(load(&mut flash), Loaded::defaults(stored));
        // A save begins anew, and an older firmware's set is there until then.
        save(&mut flash, &old).unwrap();
        assert_eq!(load(&mut flash).stored, Stored::Last);
        assert_eq!(load(&mut flash).settings, old);
    }
}

#[test]
fn five_hundred_saves_cost_one_erase() {
    let mut flash = Flash::<4, SECTOR>::blank(1);
    let mut random = Random(1);
    let mut last = DEFAULT_SETTINGS;
    for saves in 1..=1600_u64 {
        last = any_settings(&mut random);
        assert_eq!(save(&mut flash, &last), Ok(()));
        assert_eq!(flash.erases, saves.div_ceil(512), "{saves} saves");
    }
    assert_eq!(load(&mut flash).settings, last);
}

/// A flash that says that all is well and does nothing, as the emulated chip's does.
struct Idle(Flash<4, SMALL>);

impl ErrorType for Idle {
    type Error = acceptance::PowerCut;
}

impl ReadNorFlash for Idle {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl NorFlash for Idle {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SMALL;

    fn erase(&mut self, _: u32, _: u32) -> Result<(), Self::Error> {
        Ok(())
    }

    fn write(&mut self, _: u32, _: &[u8]) -> Result<(), Self::Error> {
        Ok(())
    }
}

/// A board that keeps settings, switched off and on again.
fn restart(flash: Flash<4, SMALL>) -> Twin<Store<Flash<4, SMALL>>> {
    Twin::start(0, "test", Store::new(flash, 0))
}

fn ask<R>(twin: &mut Twin<impl Keep>, request: Request, read: impl FnOnce(&Message<'_>) -> R) -> R {
    twin.take_output();
    twin.send(&request_frame(3, request));
    twin.tick(0, false);
    let answers: Vec<Answer> = answers(&mut Frames::new(), &twin.take_output());
    answers[0].read(|_, message| read(message))
}

fn status(twin: &mut Twin<impl Keep>) -> Status {
    ask(twin, Request::Status, |message| match message {
        Message::Status(status) => *status,
        other => panic!("{other:?}"),
    })
}

fn parameters(twin: &mut Twin<impl Keep>) -> Parameters {
    ask(twin, Request::Get, |message| match message {
        Message::Parameters(parameters) => *parameters,
        other => panic!("{other:?}"),
    })
}

/// None where it was done.
fn order(twin: &mut Twin<impl Keep>, request: Request) -> Option<Refusal> {
    ask(twin, request, |message| match message {
        Message::Done { .. } => None,
        Message::Refused(refusal) => Some(*refusal),
        other => panic!("{other:?}"),
    })
}

#[test]
fn a_device_starts_with_what_was_saved_and_saves_only_while_disarmed() {
    let mut twin = restart(Flash::blank(1));
    assert_eq!(status(&mut twin).stored, Stored::Nothing);
    assert_eq!(parameters(&mut twin), DEFAULTS);
    let changes = Changes {
        law: Some(Law::Episode),
        stiffness_nm_rad: Some(0.01),
        sample_period_s: Some(2e-3),
        ..Changes::default()
    };
    let want = DEFAULTS.with(&changes);
    assert_eq!(order(&mut twin, Request::Set(changes)), None);
    assert_eq!(order(&mut twin, Request::Arm), None);
    let armed = Refusal::State(State::Armed);
    assert_eq!(order(&mut twin, Request::Save), Some(armed));
    // A late tick.
    twin.tick(0, true);
    let fault = Refusal::State(State::Fault(protocol::Fault::Overrun));
    assert_eq!(order(&mut twin, Request::Save), Some(fault));
    assert_eq!(order(&mut twin, Request::Clear), None);
    let flash = twin.into_store().into_flash();
    assert_eq!(flash.steps, 0, "nothing was written so far");

    let mut twin = restart(flash);
    order(&mut twin, Request::Set(changes));
    assert_eq!(order(&mut twin, Request::Save), None);
    assert_eq!(status(&mut twin).stored, Stored::Last);
    let flash = twin.into_store().into_flash();
    let steps = flash.steps;

    let mut twin = restart(flash);
    assert_eq!(twin.period_s(), 2e-3);
    assert_eq!(parameters(&mut twin), want);
    assert_eq!(status(&mut twin).stored, Stored::Last);
    // What is kept already is not written again.
    assert_eq!(order(&mut twin, Request::Save), None);
    let mut flash = twin.into_store().into_flash();
    assert_eq!(flash.steps, steps);

    // The power goes while another set is saved.
    flash.cut = Some((steps + 9, Cut::Nothing));
    let mut twin = restart(flash);
    let other = Changes {
        law: Some(Law::Raw),
        ..Changes::default()
    };
    order(&mut twin, Request::Set(other));
    assert_eq!(order(&mut twin, Request::Save), Some(Refusal::NotKept));
    let mut flash = twin.into_store().into_flash();
    flash.cut = None;
    let mut twin = restart(flash);
    assert_eq!(status(&mut twin).stored, Stored::Older);
    assert_eq!(parameters(&mut twin), want);
    // The same set once more makes it the last.
    assert_eq!(order(&mut twin, Request::Save), None);
    let mut twin = restart(twin.into_store().into_flash());
    assert_eq!(status(&mut twin).stored, Stored::Last);
    assert_eq!(parameters(&mut twin), want);
}

#[test]
fn what_this_firmware_does_not_accept_gives_defaults_by_name() {
    let narrow = |name: Name, change: fn(&mut Parameters)| {
        let mut parameters = DEFAULTS;
        change(&mut parameters);
        let mut flash = Flash::blank(1);
        let settings = Settings {
            parameters,
            ..DEFAULT_SETTINGS
        };
        save(&mut flash, &settings).unwrap();
        let mut twin = restart(flash);
        assert_eq!(status(&mut twin).stored, Stored::Refused { name });
        assert_eq!(self::parameters(&mut twin), DEFAULTS);
        assert_eq!(order(&mut twin, Request::Arm), None);
        assert_eq!(order(&mut twin, Request::Disarm), None);
        assert_eq!(order(&mut twin, Request::Save), None);
        let mut twin = restart(twin.into_store().into_flash());
        assert_eq!(status(&mut twin).stored, Stored::Last);
    };
    narrow(Name::TorqueMaxNm, |p| p.torque_max_nm = 1e9);
    narrow(Name::DelayS, |p| p.delay_s = f32::NAN);
    narrow(Name::CoulombNm, |p| p.coulomb_nm.low = 1.0);
    narrow(Name::JitterS, |p| p.jitter_s = 5e-3);
    narrow(Name::Decimation, |p| p.decimation = 0);
}

#[test]
fn a_board_without_storage_says_so() {
    let mut twin = Twin::new(0, "test");
    assert_eq!(status(&mut twin).stored, Stored::NoStorage);
    order(&mut twin, Request::Arm);
    assert_eq!(order(&mut twin, Request::Save), Some(Refusal::NoStorage));
}

#[test]
fn what_was_not_written_is_not_said_to_be() {
    let mut store = Store::new(Idle(Flash::blank(1)), 0);
    assert_eq!(store.save(&DEFAULT_SETTINGS), Err(SaveError::ReadBack));
    assert_eq!(store.load(), Loaded::defaults(Stored::Nothing));
}
