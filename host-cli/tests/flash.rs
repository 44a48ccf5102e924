//! `knob flash`: which images it takes, and what becomes of them with a `probe-rs` that only pretends.
#![cfg(target_os = "linux")]

mod image;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use image::{Image, good};
use tempfile::TempDir;

/// A folder to flash from, with a folder of programs that is searched before all others.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        fs::create_dir(folder.path().join("programs")).unwrap();
        Self { folder }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn image(&self, name: &str, image: &Image) -> String {
        let path = self.at(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, image.bytes()).unwrap();
        path.to_str().unwrap().to_owned()
    }

    fn knob(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_knob"));
        command
            .args(args)
            .current_dir(self.folder.path())
            .env("PATH", self.at("programs"))
            .env_remove("PROBE_RS_PROBE")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        self.knob(args).output().unwrap()
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Nothing on standard output, the exit status, and every part of the message.
fn refused(output: &Output, what: &str, status: i32, parts: &[&str]) {
    let said = said(output);
    assert_eq!(output.status.code(), Some(status), "{what}: {said}");
    assert!(output.stdout.is_empty(), "{what} wrote to standard output");
    for part in parts {
        assert!(
            said.contains(part),
            "{what}: `{part}` is missing in: {said}"
        );
    }
    assert!(!said.contains("panicked"), "{what}: {said}");
}

#[test]
fn images_that_are_no_firmware_for_the_board_are_refused() {
    let bench = Bench::new();
    let with = |change: &dyn Fn(&mut Image)| {
        let mut image = good();
        change(&mut image);
        image
    };
    for (what, image, parts) in [
        (
            "a program for the host",
            with(&|image| image.machine = 62),
            &["not for ARM", "62", "cargo xtask firmware"][..],
        ),
        (
            "one that ends in the settings",
            with(&|image| image.segments.push((0x080B_FFF0, 17))),
            &[
                "the settings of the device",
                "0x080bfff0 to 0x080c0001",
                "0x080c0000",
            ],
        ),
        (
            "one that lies in the settings",
            with(&|image| image.segments.push((0x080F_FFFC, 4))),
            &["the settings of the device", "0x080ffffc to 0x08100000"],
        ),
        (
            "one that covers them",
            with(&|image| image.segments = vec![(0x0800_0000, 0x10_0000)]),
            &["the settings of the device"],
        ),
        (
            "one below the flash",
            with(&|image| image.segments.push((0x07FF_FFFC, 8))),
            &["out of the program's flash", "0x07fffffc to 0x08000004"],
        ),
        (
            "one for RAM",
            with(&|image| image.segments = vec![(0x2000_0000, 64)]),
            &["out of the program's flash", "0x20000000"],
        ),
        (
            "one above the flash",
            with(&|image| image.segments.push((0x0810_0000, 64))),
            &["out of the program's flash"],
        ),
        (
            "one at the end of the addresses",
            with(&|image| image.segments.push((0xFFFF_FFF0, 64))),
            &["out of the program's flash"],
        ),
        (
            "an empty one",
            with(&|image| image.segments = vec![(0x0800_0000, 0)]),
            &["nothing in it"],
        ),
        (
            "the emulated board's",
            with(&|image| image.symbols = vec!["main", "knob_board_emulated"]),
            &["for the board `emulated`, not `odrive_v3`"],
        ),
        (
            "one of two boards",
            with(&|image| image.symbols.push("knob_board_emulated")),
            &["does not say which board"],
        ),
        (
            "a foreign one",
            with(&|image| image.symbols = vec!["main"]),
            &["does not say which board"],
        ),
    ] {
        let path = bench.image("image.elf", &image);
        let output = bench.run(&["flash", "--image", &path]);
        refused(&output, what, 1, &[parts, &[&path, "accepted"]].concat());
    }
    let whole = good().bytes();
    for (what, bytes) in [
        ("nothing", &[][..]),
        ("text", b"not an image"),
        ("the beginning of one", &whole[..40]),
    ] {
        let path = bench.at("bytes.elf");
        fs::write(&path, bytes).unwrap();
        let path = path.to_str().unwrap();
        let output = bench.run(&["flash", "--image", path]);
        refused(
            &output,
            what,
            1,
            &[path, "not a 32-bit ELF file", "accepted"],
        );
    }
    let folder = bench.folder.path().to_str().unwrap();
    refused(
        &bench.run(&["flash", "--image", folder]),
        "a folder",
        1,
        &[folder],
    );
    // Every piece of an image is refused or taken, and nothing panics.
    for length in 0..whole.len() {
        let path = bench.at("piece.elf");
        fs::write(&path, &whole[..length]).unwrap();
        let output = bench.run(&["flash", "--image", path.to_str().unwrap()]);
        refused(&output, "a piece", 1, &[]);
        if length > 600 {
            break;
        }
    }
}

#[test]
fn an_image_that_is_not_there_is_told_with_how_to_build_it() {
    let bench = Bench::new();
    refused(
        &bench.run(&["flash"]),
        "no image",
        1,
        &[
            "target/firmware/odrive_v3.elf",
            "no such file",
            "cargo xtask firmware",
            "--image",
        ],
    );
    refused(
        &bench.run(&["flash", "--image", "x.elf"]),
        "no such image",
        1,
        &["x.elf: there is no such file", "cargo xtask firmware"],
    );
    refused(
        &bench.run(&["flash", "--board", "emulated"]),
        "another board",
        2,
        &["emulated", "odrive-v3"],
    );
}

#[test]
fn help_has_an_example() {
    let output = Bench::new().run(&["flash", "--help"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success());
    for part in [
        "Examples:",
        "knob flash --board",
        "--json",
        "settings are kept",
    ] {
        assert!(text.contains(part), "`{part}` is missing in: {text}");
    }
}

/// What only the way through the installed program has.
#[cfg(not(feature = "flash"))]
mod program {
    use std::os::unix::fs::PermissionsExt;
    use std::time::Duration;

    use serde_json::Value;

    use super::*;

    impl Bench {
        /// A `probe-rs` that writes its arguments, a line each time, to `calls`, and then does this.
        fn pretend(&self, script: &str) {
            let path = self.at("programs/probe-rs");
            let calls = self.at("calls");
            let calls = calls.display();
            let text = format!("#!/bin/sh\necho \"$*\" >> '{calls}'\necho progress\n{script}\n");
            fs::write(&path, text).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        }

        fn calls(&self) -> Vec<String> {
            let text = fs::read_to_string(self.at("calls")).unwrap_or_default();
            text.lines().map(str::to_owned).collect()
        }
    }

    #[test]
    fn it_downloads_checks_and_starts() {
        let bench = Bench::new();
        bench.pretend("exit 0");
        let path = bench.image("target/firmware/odrive_v3.elf", &good());
        let output = bench.run(&["flash"]);
        assert!(output.status.success(), "{}", said(&output));
        assert_eq!(
            bench.calls(),
            [
                "download --non-interactive --chip STM32F405RGTx --verify target/firmware/odrive_v3.elf",
                "reset --non-interactive --chip STM32F405RGTx",
            ]
        );
        let text = String::from_utf8(output.stdout.clone()).unwrap();
        assert_eq!(
            text,
            "written, checked and started; `knob info` shows what runs\n"
        );
        for part in ["progress", "1392 bytes", "odrive_v3", "STM32F405RGTx"] {
            assert!(said(&output).contains(part), "{}", said(&output));
        }

        // What probe-rs says is not in the way of the one JSON object.
        let output = bench.run(&["flash", "--json", "--image", &path, "--board", "odrive-v3"]);
        assert!(output.status.success(), "{}", said(&output));
        let json: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(
            json,
            serde_json::json!({
                "image": path, "board": "odrive_v3", "chip": "STM32F405RGTx", "bytes": 1392
            })
        );
        assert!(said(&output).contains("progress"));
    }

    #[test]
    fn a_probe_may_be_picked() {
        let bench = Bench::new();
        bench.pretend("exit 0");
        let path = bench.image("i.elf", &good());
        let flash = ["flash", "--image", &path];
        let picked = bench.run(&[&flash[..], &["--probe", "0483:3748:1A"]].concat());
        assert!(picked.status.success());
        let calls = bench.calls();
        assert_eq!(calls.len(), 2);
        for call in &calls {
            assert!(
                call.contains("--chip STM32F405RGTx --probe 0483:3748:1A"),
                "{call}"
            );
        }
        let mut by_variable = bench.knob(&flash);
        by_variable.env("PROBE_RS_PROBE", "0483:3748");
        assert!(by_variable.output().unwrap().status.success());
        assert!(bench.calls()[2].contains("--probe 0483:3748 "));
    }

    #[test]
    fn nothing_is_flashed_that_was_refused() {
        let bench = Bench::new();
        bench.pretend("exit 0");
        let mut image = good();
        image.segments.push((0x080C_0000, 4));
        let path = bench.image("i.elf", &image);
        refused(
            &bench.run(&["flash", "--image", &path]),
            "settings",
            1,
            &["settings"],
        );
        assert_eq!(bench.calls(), [""; 0]);
    }

    #[test]
    fn a_probe_rs_that_fails_is_told_with_what_to_look_at() {
        let bench = Bench::new();
        let path = bench.image("i.elf", &good());
        bench.pretend("echo 'no probe was found' >&2; exit 7");
        for json in [&[][..], &["--json"]] {
            refused(
                &bench.run(&[&["flash", "--image", &path], json].concat()),
                "failing",
                1,
                &[
                    "no probe was found",
                    "nothing was started",
                    "probe-rs download",
                    "exit status: 7",
                    "powered",
                    "docs/hardware.md",
                ],
            );
        }
        assert!(
            bench
                .calls()
                .iter()
                .all(|call| call.starts_with("download "))
        );
        // Killed, as by the system.
        bench.pretend("kill -9 $$");
        refused(
            &bench.run(&["flash", "--image", &path]),
            "killed",
            1,
            &["signal: 9"],
        );
        // It writes, but cannot start it.
        bench.pretend("test $1 != reset");
        refused(
            &bench.run(&["flash", "--image", &path]),
            "not started",
            1,
            &[
                "written and checked",
                "was not started",
                "by hand",
                "probe-rs reset",
            ],
        );
        // It is there, but no program.
        fs::write(bench.at("programs/probe-rs"), "").unwrap();
        refused(
            &bench.run(&["flash", "--image", &path]),
            "no program",
            1,
            &["cannot run `probe-rs`"],
        );
    }

    #[test]
    fn without_probe_rs_it_says_how_to_get_it() {
        let bench = Bench::new();
        let path = bench.image("i.elf", &good());
        refused(
            &bench.run(&["flash", "--image", &path]),
            "missing",
            1,
            &[
                "`probe-rs` is missing",
                "probe-rs-tools-installer.sh",
                "cargo install probe-rs-tools --locked",
                "cargo install --path host-cli --features flash",
            ],
        );
    }

    #[test]
    fn ctrl_c_ends_it() {
        let bench = Bench::new();
        bench.pretend("exec /bin/sleep 60");
        let path = bench.image("i.elf", &good());
        let mut child = bench.knob(&["flash", "--image", &path]).spawn().unwrap();
        while bench.calls().is_empty() {
            std::thread::sleep(Duration::from_millis(5));
        }
        let kill = Command::new("kill")
            .args(["-INT", &child.id().to_string()])
            .status();
        assert!(kill.unwrap().success());
        // Not for ever: the limit is there to end a test that hangs.
        for _ in 0..600 {
            if child.try_wait().unwrap().is_some() {
                break;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        child.kill().unwrap();
        let output = child.wait_with_output().unwrap();
        refused(
            &output,
            "stopped",
            130,
            &["stopped", "half written", "flash it again"],
        );
        assert_eq!(bench.calls().len(), 1);
    }
}

/// What only the way through the library has; no probe is needed to see it.
#[cfg(feature = "flash")]
#[test]
fn a_probe_that_is_not_there_is_an_error() {
    let bench = Bench::new();
    let path = bench.image("i.elf", &good());
    let flash = |probe: &str| bench.run(&["flash", "--image", &path, "--probe", probe]);
    refused(
        &flash("first"),
        "no selector",
        2,
        &["`first`", "VID:PID", "0483:3748"],
    );
    refused(
        &flash("ffff:fffe"),
        "no such probe",
        1,
        &["ffff:fffe", "cannot open it", "probe-setup"],
    );
}

#[test]
fn the_path_of_an_image_may_have_spaces() {
    let bench = Bench::new();
    let mut image = good();
    image.machine = 3;
    let path = bench.image("my images/i.elf", &image);
    assert!(Path::new(&path).exists());
    refused(
        &bench.run(&["flash", "--image", &path]),
        "spaces",
        1,
        &["my images/i.elf", "not for ARM"],
    );
}

/// What `cargo xtask firmware` has built, marks and all.
#[cfg(feature = "emulator")]
#[test]
fn images_say_which_board_they_are_for() {
    let bench = Bench::new();
    for (name, part) in [
        ("emulated", "for the board `emulated`, not `odrive_v3`"),
        ("emulated-four-ticks-back", "for the board `emulated`, not"),
        ("emulated_drive", "for the board `emulated_drive`, not"),
        // This one is taken, and fails only for want of a probe.
        ("odrive_v3", "bytes for the board odrive_v3"),
    ] {
        let image = format!(
            "{}/../target/firmware/{name}.elf",
            env!("CARGO_MANIFEST_DIR")
        );
        let flash = ["flash", "--image", &image, "--probe", "ffff:fffe"];
        refused(&bench.run(&flash), name, 1, &[part]);
    }
}
