//! The commands for recordings as processes: killed, stopped, out of room, and with bad input.

#![expect(clippy::unwrap_used, reason = "tests may; this covers their own functions too")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use mirrorball_capture::recording::mcap::{Ending, McapPlayer};
use mirrorball_capture::recording::report_on;
use mirrorball_capture::{Frame, Next, Pace, Repeat, Source, open_recording};
use support::{N_FRAMES, write_recording};

mod support;

/// Far beyond what anything here takes: only a hang lasts this long.
const WATCHDOG: Duration = Duration::from_secs(60);

/// A child process that is killed, as with `kill -9`, when it goes out of scope.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        // It may have ended by itself, which is as good.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_mirrorball-capture"))
}

fn run(args: &[&dyn AsRef<std::ffi::OsStr>]) -> Output {
    let output = program().args(args.iter().map(AsRef::as_ref)).output().unwrap();
    assert_ne!(
        output.status.code(),
        Some(101),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    output
}

fn run_well(args: &[&dyn AsRef<std::ffi::OsStr>]) -> String {
    let output = run(args);
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// Exit code and what was said.
fn run_badly(args: &[&dyn AsRef<std::ffi::OsStr>]) -> (i32, String) {
    let output = run(args);
    let log = String::from_utf8(output.stderr).unwrap();
    assert!(log.contains("error: ") && log.contains("\n  hint: "), "{log}");
    (output.status.code().unwrap(), log)
}

/// A daemon that plays this recording again and again.
fn start_daemon(recording: &Path, service: &str, pace: &str) -> Killed {
    let mut command = program();
    command.arg("play").arg(recording);
    command.args(["--loop", "--pace", pace, "--service", service]);
    Killed(command.stderr(Stdio::null()).spawn().unwrap())
}

fn start_recording(out: &Path, service: &str) -> Killed {
    let mut command = program();
    command.args(["record", "--service", service, "--out"]).arg(out);
    Killed(command.stderr(Stdio::piped()).spawn().unwrap())
}

/// Waits for the end of a process; returns exit code and what it said.
fn end_of(mut child: Killed) -> (Option<i32>, String) {
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.0.try_wait().unwrap() {
            break status;
        }
        assert!(started.elapsed() < WATCHDOG, "the process hangs");
        std::thread::sleep(Duration::from_millis(5));
    };
    let log = std::io::read_to_string(child.0.stderr.take().unwrap()).unwrap();
    (status.code(), log)
}

fn wait_for_bytes(path: &Path, n_bytes: u64) {
    let started = Instant::now();
    while fs::metadata(path).map_or(0, |file| file.len()) < n_bytes {
        assert!(started.elapsed() < WATCHDOG, "nothing is recorded");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// A name nobody else uses, in this process or another.
fn unique_service() -> String {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let number = COUNTER.fetch_add(1, Ordering::Relaxed);
    format!("mirrorball/test-record-{}-{number}", std::process::id())
}

fn frames_of(recording: &Path) -> Vec<Frame> {
    let mut source = open_recording(recording, Pace::Max, Repeat::ONCE).unwrap();
    let mut frames = Vec::new();
    while let Next::Frame(frame) = source.next_frame(Duration::from_secs(60)).unwrap() {
        frames.push(frame);
    }
    frames
}

fn assert_same(found: &[Frame], expected: &[Frame]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(found.meta, expected.meta);
        assert!(*found.pixels == *expected.pixels);
    }
}

fn two_cameras() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/two_cameras/recording")
}

#[test]
fn a_folder_comes_back_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let [file, again, out] = ["a.mcap", "b.mcap", "out"].map(|name| folder.path().join(name));
    run_well(&[&"import", &two_cameras(), &file]);
    run_well(&[&"import", &"--lz4", &two_cameras(), &again]);
    run_well(&[&"export", &file, &out]);
    let expected = frames_of(&two_cameras());
    for recording in [&file, &again, &out] {
        assert_same(&frames_of(recording), &expected);
    }
    let rig = |folder: &Path| fs::read(folder.join("rig.toml")).unwrap();
    assert_eq!(rig(&out), rig(&two_cameras()));
    let list = |folder: &Path| fs::read(folder.join("frames.csv")).unwrap();
    assert_eq!(list(&out), list(&two_cameras()));
    let text = run_well(&[&"info", &"--verify", &file]);
    assert!(
        text.contains("mcap recording") && text.contains("nothing lost"),
        "{text}"
    );
    let json: serde_json::Value = serde_json::from_str(&run_well(&[&"info", &"--json", &file])).unwrap();
    assert_eq!(json["cameras"][0]["name"], "scene");
    assert_eq!(json["ending"]["how"], "complete");
    let json: serde_json::Value = serde_json::from_str(&run_well(&[&"info", &"--json", &out])).unwrap();
    assert_eq!(json["kind"], "folder");
}

#[test]
fn a_recorder_that_is_killed_leaves_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let service = unique_service();
    let _daemon = start_daemon(&two_cameras(), &service, "recorded");
    for round in 0..3 {
        let file = folder.path().join(format!("{round}.mcap"));
        let recorder = start_recording(&file, &service);
        wait_for_bytes(&file, 20_000_000 + round * 1_000_000);
        drop(recorder);
        let player = McapPlayer::open(&file, Pace::Max, Repeat::ONCE).unwrap();
        assert_ne!(player.ending(), Ending::Complete);
        assert_eq!(player.cameras().len(), 2);
        let frames = frames_of(&file);
        assert!(frames.len() as u64 * 921_600 > 8_000_000, "{} frames", frames.len());
        let first = frames_of(&two_cameras());
        for frame in &frames {
            assert!(first.iter().any(|other| *other.pixels == *frame.pixels));
        }
        let text = run_well(&[&"info", &"--verify", &file]);
        assert!(
            text.contains("ends: broken off") || text.contains("ends: cut off"),
            "{text}"
        );
    }
}

#[test]
fn a_recorder_that_is_stopped_ends_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let recording = tempfile::tempdir().unwrap();
    write_recording(recording.path());
    let service = unique_service();
    let daemon = start_daemon(recording.path(), &service, "recorded");
    let rig = recording.path().join("rig.toml");
    for signal in ["TERM", "INT"] {
        let file = folder.path().join(format!("{signal}.mcap"));
        let recorder = start_recording(&file, &service);
        wait_for_bytes(&file, 30_000);
        let kill = format!("kill -{signal} {}", recorder.0.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        let (code, log) = end_of(recorder);
        assert_eq!(code, Some(0), "{log}");
        assert!(log.contains("recorded ") && log.contains("sets missed"), "{log}");
        let report = report_on(&file).unwrap();
        assert_eq!(report.ending, Ending::Complete);
        assert!(report.cameras[0].frames > 10 && report.cameras[0].role == "scene");
    }
    let file = folder.path().join("frames.mcap");
    run_well(&[
        &"record",
        &"--service",
        &service,
        &"--frames",
        &"7",
        &"--rig",
        &rig,
        &"--out",
        &file,
    ]);
    let report = report_on(&file).unwrap();
    assert_eq!((report.cameras[0].frames, report.has_rig), (7, true));
    run_well(&[&"export", &file, &folder.path().join("out")]);
    let file = folder.path().join("seconds.mcap");
    run_well(&[
        &"record",
        &"--service",
        &service,
        &"--duration",
        &"0.3",
        &"--lz4",
        &"--out",
        &file,
    ]);
    assert!(report_on(&file).unwrap().cameras[0].frames > 0);
    drop(daemon);
    // The daemon takes MCAP files as it takes folders.
    let imported = folder.path().join("imported.mcap");
    run_well(&[&"import", &recording.path(), &imported]);
    let output = run(&[&"play", &imported, &"--pace", &"max", &"--service", &service]);
    let log = String::from_utf8(output.stderr).unwrap();
    assert!(
        log.contains(&format!("published {N_FRAMES} sets (0 incomplete)")),
        "{log}"
    );
}

/// A file system of so many megabytes, if we may have one.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    fn mount(megabytes: u32) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let size = format!("size={megabytes}m");
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(folder.path());
        let is_mounted = mount
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success());
        is_mounted.then_some(Self(folder))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // What stays mounted is seen in the list of mounts; a test cannot do more.
        let _ = Command::new("umount").arg(self.0.path()).status();
    }
}

#[test]
fn a_disk_that_fills_up_ends_the_recording() {
    let Some(disk) = SmallDisk::mount(24) else {
        println!("SKIPPED: mounting a small disk needs root");
        return;
    };
    let service = unique_service();
    let _daemon = start_daemon(&two_cameras(), &service, "recorded");
    let file = disk.0.path().join("a.mcap");
    let (code, log) = end_of(start_recording(&file, &service));
    assert_eq!(code, Some(1), "{log}");
    assert!(
        log.contains("error: the disk is full") && log.contains("which are safe"),
        "{log}"
    );
    let frames = frames_of(&file);
    assert!(log.contains(&format!("ends after {} frames", frames.len())), "{log}");
    assert!(frames.len() as u64 * 921_600 > 8_000_000, "{} frames", frames.len());
}

#[test]
fn bad_input_is_told_from_failure() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    let missing = folder.path().join("missing");
    assert_eq!(run_badly(&[&"info", &missing]).0, 2);
    assert_eq!(run_badly(&[&"export", &missing, &folder.path()]).0, 2);
    assert_eq!(run_badly(&[&"import", &missing, &file]).0, 2);
    assert!(!file.exists());
    run_well(&[&"import", &two_cameras(), &file]);
    let (code, log) = run_badly(&[&"import", &two_cameras(), &file]);
    assert_eq!(code, 2);
    assert!(log.contains("the file exists"), "{log}");
    let (code, log) = run_badly(&[&"export", &file, &folder.path()]);
    assert_eq!(code, 2);
    assert!(log.contains("no empty folder"), "{log}");
    let rig = folder.path().join("rig.toml");
    fs::write(
        &rig,
        "[[camera]]\nname = \"scene\"\nrole = \"scene\"\nsize_px = [8, 8]\n",
    )
    .unwrap();
    let (code, log) = run_badly(&[&"export", &file, &missing, &"--rig", &rig]);
    assert_eq!(code, 2);
    assert!(log.contains("does not have camera `scene`"), "{log}");
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&file, bytes).unwrap();
    let (code, log) = run_badly(&[&"info", &"--verify", &file]);
    assert_eq!(code, 2);
    assert!(log.contains("check sum is wrong"), "{log}");
    let silent = unique_service();
    let recorder = start_recording(&folder.path().join("b.mcap"), &silent);
    std::thread::sleep(Duration::from_millis(300));
    let kill = format!("kill -TERM {}", recorder.0.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    let (code, log) = end_of(recorder);
    assert_eq!(code, Some(1), "{log}");
    assert!(log.contains("nothing was received"), "{log}");
}
