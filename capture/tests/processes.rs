//! Two real processes, of which either is killed with SIGKILL and started again.

#![expect(clippy::unwrap_used, reason = "tests may; this covers their own functions too")]

use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use mirrorball_capture::handover::{self, READERS_MAX};
use mirrorball_capture::{CameraDescription, CameraRole, PixelFormat, Received, Size, Subscriber};
use support::{N_FRAMES, SIDES_PX, write_recording};

mod support;

/// Far beyond what anything here takes: only a hang lasts this long.
const WATCHDOG: Duration = Duration::from_secs(60);

/// Long enough to see that nothing comes.
const SHORT: Duration = Duration::from_millis(30);

fn is_set(subscriber: &mut Subscriber, timeout: Duration) -> bool {
    match subscriber.receive(timeout).unwrap() {
        Received::Set(set) => {
            assert!((1..=2).contains(&set.frames.len()));
            true
        }
        Received::TimedOut => false,
        Received::Ended => panic!("between processes there is no end"),
    }
}

/// A child process that is killed, as with `kill -9`, when it goes out of scope.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        // It may have ended by itself, which is as good.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A name nobody else uses, in this process or another.
fn unique_service() -> String {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    format!(
        "mirrorball/test-{}-{}",
        std::process::id(),
        COUNTER.fetch_add(1, Ordering::Relaxed)
    )
}

/// A recording, and the daemon that plays it.
struct Daemon {
    recording: tempfile::TempDir,
    service: String,
}

impl Daemon {
    fn new() -> Self {
        let recording = tempfile::tempdir().unwrap();
        write_recording(recording.path());
        Self {
            recording,
            service: unique_service(),
        }
    }

    fn start(&self, options: &[&str]) -> Killed {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mirrorball-capture"));
        command
            .arg("play")
            .arg(self.recording.path())
            .args(["--service", &self.service])
            .args(options);
        Killed(command.stderr(Stdio::piped()).spawn().unwrap())
    }

    /// Starts this test program again as a reader.
    fn start_reader(&self) -> Killed {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "reader_process", "--ignored", "--nocapture"]);
        Killed(
            command
                .env("MIRRORBALL_TEST_SERVICE", &self.service)
                .stdout(Stdio::piped())
                .spawn()
                .unwrap(),
        )
    }
}

/// Waits until a process has ended and returns its exit code and what it wrote to stderr.
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

/// Waits until the reader has said that it has received a set; returns its output.
fn wait_for_first_set(reader: &mut Killed) -> BufReader<std::process::ChildStdout> {
    let mut output = BufReader::new(reader.0.stdout.take().unwrap());
    let mut line = String::new();
    while !line.contains("received") {
        line.clear();
        assert!(output.read_line(&mut line).unwrap() > 0, "the reader has ended early");
    }
    output
}

/// Not a test: the reading process of the tests below.
#[test]
#[ignore = "started by other tests as a process of its own"]
fn reader_process() {
    let Ok(service) = std::env::var("MIRRORBALL_TEST_SERVICE") else {
        return;
    };
    let mut subscriber = handover::subscribe_to(&service).unwrap();
    let mut has_spoken = false;
    let started = Instant::now();
    while started.elapsed() < WATCHDOG {
        if is_set(&mut subscriber, SHORT) && !has_spoken {
            println!("received");
            has_spoken = true;
        }
    }
}

#[test]
fn a_killed_daemon_is_replaced_under_a_running_reader() {
    let daemon = Daemon::new();
    let mut subscriber = handover::subscribe_to(&daemon.service).unwrap();
    for round in 0..4 {
        let mut child = daemon.start(&["--loop", "--pace", "max"]);
        let started = Instant::now();
        while subscriber.stats().publisher_changes < round || subscriber.stats().received == 0 {
            if child.0.try_wait().unwrap().is_some() || started.elapsed() > WATCHDOG {
                child.0.kill().unwrap();
                panic!("the daemon is not heard in round {round}: {:?}", end_of(child));
            }
            is_set(&mut subscriber, SHORT);
        }
        assert!(is_set(&mut subscriber, WATCHDOG));
        drop(child);
        while is_set(&mut subscriber, SHORT) {}
    }
    assert_eq!(subscriber.stats().publisher_changes, 3);
}

#[test]
fn killed_readers_do_not_hurt_the_daemon_and_free_their_place() {
    let daemon = Daemon::new();
    let mut child = daemon.start(&["--loop", "--pace", "max"]);
    for _ in 0..2 * READERS_MAX {
        let mut reader = daemon.start_reader();
        wait_for_first_set(&mut reader);
        drop(reader);
        assert!(child.0.try_wait().unwrap().is_none(), "the daemon lives");
    }
    let mut subscriber = handover::subscribe_to(&daemon.service).unwrap();
    assert!(is_set(&mut subscriber, WATCHDOG));
    let kill = format!("kill -TERM {}", child.0.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
    let (code, log) = end_of(child);
    assert_eq!(code, Some(0), "{log}");
}

#[test]
fn both_may_be_killed_and_come_back() {
    let daemon = Daemon::new();
    for _ in 0..3 {
        let _child = daemon.start(&["--loop", "--pace", "max"]);
        wait_for_first_set(&mut daemon.start_reader());
    }
}

#[test]
fn a_daemon_killed_while_it_starts_leaves_nothing_in_the_way() {
    let daemon = Daemon::new();
    for delay_ms in 0..20 {
        let child = daemon.start(&["--loop", "--pace", "max"]);
        std::thread::sleep(Duration::from_millis(delay_ms));
        drop(child);
    }
    let _child = daemon.start(&["--loop", "--pace", "max"]);
    let mut subscriber = handover::subscribe_to(&daemon.service).unwrap();
    assert!(is_set(&mut subscriber, WATCHDOG));
}

/// What a process leaves that is killed between naming shared memory and giving it a size.
#[test]
fn shared_memory_without_size_is_in_nobodys_way() {
    let daemon = Daemon::new();
    let child = daemon.start(&["--loop", "--pace", "max"]);
    let mut reader = daemon.start_reader();
    wait_for_first_set(&mut reader);
    let reader_id = reader.0.id();
    // Standing still, they leave everything where it is; once killed, any other test clears away after them.
    let stop = format!("kill -STOP {} {reader_id}", child.0.id());
    assert!(Command::new("sh").args(["-c", &stop]).status().unwrap().success());
    // iceoryx2 names a connection `PREFIX_HASH_SENDER_RECEIVER`; bits 64 to 95 of a port are its process.
    let is_the_readers = |path: &Path| {
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        let receiver = stem.rsplit('_').next().and_then(|port| port.parse::<u128>().ok());
        receiver.is_some_and(|port| (port >> 64) & u128::from(u32::MAX) == u128::from(reader_id))
    };
    let mut n_connections = 0;
    for entry in std::fs::read_dir("/dev/shm").unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|end| end == "connection") && is_the_readers(&path) {
            std::fs::File::create(&path).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o200)).unwrap();
            n_connections += 1;
        }
    }
    drop((reader, child));
    assert!(
        n_connections > 0,
        "iceoryx2 names its connections as this test believes"
    );
    let _child = daemon.start(&["--loop", "--pace", "max"]);
    let mut subscriber = handover::subscribe_to(&daemon.service).unwrap();
    assert!(is_set(&mut subscriber, WATCHDOG));
}

#[test]
fn the_daemon_waits_for_a_reader_and_then_plays_all() {
    let daemon = Daemon::new();
    let child = daemon.start(&["--wait-for-reader", "--pace", "recorded", "--repeat", "5"]);
    let mut reader = daemon.start_reader();
    let _output = wait_for_first_set(&mut reader);
    let (code, log) = end_of(child);
    assert_eq!(code, Some(0), "{log}");
    assert!(
        log.contains(&format!(
            "published {} sets (0 incomplete), skipped 0 frames",
            5 * N_FRAMES
        )),
        "{log}"
    );
}

#[test]
fn the_daemon_skips_bad_frames_and_counts_them() {
    let daemon = Daemon::new();
    std::fs::remove_file(daemon.recording.path().join("scene/000001.png")).unwrap();
    let (code, log) = end_of(daemon.start(&["--pace", "max"]));
    assert_eq!(code, Some(0), "{log}");
    assert!(
        log.contains("skipped 1 bad frames") && log.contains("scene/000001.png"),
        "{log}"
    );
    assert!(
        log.contains("published 3 sets (0 incomplete), skipped 1 frames"),
        "{log}"
    );
}

#[test]
fn the_daemon_tells_bad_input_from_failure() {
    let daemon = Daemon::new();
    let (code, log) = end_of(daemon.start(&["--service", ""]));
    assert_eq!(code, Some(2), "{log}");
    let (code, log) = end_of(daemon.start(&["--repeat", "0"]));
    assert_eq!(code, Some(2), "{log}");
    std::fs::write(daemon.recording.path().join("rig.toml"), "camera = 3").unwrap();
    let (code, log) = end_of(daemon.start(&[]));
    assert_eq!(code, Some(2), "{log}");
    assert!(
        log.contains("error: cannot understand rig file") && log.contains("\n  caused by: "),
        "{log}"
    );
    assert!(log.contains("\n  hint: "), "{log}");
    std::fs::remove_file(daemon.recording.path().join("rig.toml")).unwrap();
    let (code, log) = end_of(daemon.start(&[]));
    assert_eq!(code, Some(2), "{log}");
    let taken = Daemon::new();
    let size = Size {
        width: SIDES_PX[0],
        height: SIDES_PX[1],
    };
    let camera = CameraDescription {
        name: "scene".into(),
        role: CameraRole::Scene,
        size,
        format: PixelFormat::Rgb8,
    };
    let _publisher = handover::publish_on(&taken.service, &[camera]).unwrap();
    let (code, log) = end_of(taken.start(&[]));
    assert_eq!(code, Some(1), "{log}");
    assert!(log.contains("already has a publisher"), "{log}");
}
