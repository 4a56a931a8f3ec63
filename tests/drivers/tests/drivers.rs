//! Runs the cases on real kernel drivers: boots virtual machines, which run `driver-tests`, and reports.
//!
//! There are two machines, side by side: one for the cases of drivers and cameras, one for those of the daemon. Their
//! time is waiting for frames more than computing.
//!
//! Where there is no QEMU the tests say `SKIPPED` and pass; with the environment variable
//! `MIRRORBALL_REQUIRE_DRIVERS` set that is a failure. `MIRRORBALL_DRIVER_CASES` chooses cases by parts of their names.

#![expect(clippy::print_stdout, reason = "what machines say is shown with a test that fails")]

use std::env;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{OnceLock, PoisonError, RwLock};

/// What `scripts/driver-vm.sh` exits with where the machine cannot be built or booted.
const CANNOT_RUN_HERE: i32 = 75;

/// After this time a machine is taken to hang: three times what it needs where nothing else runs.
const TIMEOUT_S: &str = "300";

#[test]
fn drivers_and_cameras() {
    run(
        "cameras",
        &[
            "streaming",
            "steering",
            "webcam_faults",
            "vivid",
            "v4l2_webcam",
            "calib",
        ],
    );
}

#[test]
fn the_daemon() {
    run("daemon", &["daemon"]);
}

fn script() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scripts/driver-vm.sh")
}

/// Why there can be no machine here; none if it is ready. The first run fetches a kernel.
fn hindrance() -> Option<&'static str> {
    static HINDRANCE: OnceLock<Option<String>> = OnceLock::new();
    let prepare = || {
        let prepared = Command::new(script())
            .arg("--prepare")
            .output()
            .expect("the script can be started");
        let reason = String::from_utf8_lossy(&prepared.stderr).into_owned();
        if prepared.status.code() == Some(CANNOT_RUN_HERE) {
            return Some(reason);
        }
        assert!(prepared.status.success(), "{reason}");
        None
    };
    HINDRANCE.get_or_init(prepare).as_deref()
}

/// Runs the cases whose names have one of `parts` in them.
fn run(machine: &str, parts: &[&str]) {
    if let Some(reason) = hindrance() {
        assert!(
            env::var_os("MIRRORBALL_REQUIRE_DRIVERS").is_none(),
            "the driver tests cannot run here:\n{reason}"
        );
        // Straight to standard error: the test harness would swallow what a passing test prints.
        let _ = writeln!(
            io::stderr(),
            "SKIPPED: no virtual machine with camera drivers: {reason}"
        );
        return;
    }
    let chosen = env::var("MIRRORBALL_DRIVER_CASES").unwrap_or_default();
    let mut parts = parts.to_vec();
    if !chosen.trim().is_empty() {
        parts = chosen.split_whitespace().filter(|case| belongs(case, &parts)).collect();
    }
    if parts.is_empty() {
        return;
    }
    let first = {
        let _beside = BESIDE.read().unwrap_or_else(PoisonError::into_inner);
        boot(machine, &parts)
    };
    if first.is_success {
        return;
    }
    let failed: Vec<&str> = first.log.lines().filter_map(failed_case).collect();
    let again = if failed.is_empty() { &parts } else { &failed };
    let _alone = BESIDE.write().unwrap_or_else(PoisonError::into_inner);
    println!("once more, with no other machine beside it: {}", again.join(" "));
    let second = boot(machine, again);
    assert!(
        second.is_success,
        "on real drivers, twice:\n{}\n{}",
        first.log, second.log
    );
}

/// Emulated machines have their own time only as long as the computer has some for them. A case that fails gets a
/// second chance while no other machine runs: the writing side.
static BESIDE: RwLock<()> = RwLock::new(());

/// How a machine ended.
struct Outcome {
    is_success: bool,
    log: String,
}

/// The name in a line that says that a case has failed.
fn failed_case(line: &str) -> Option<&str> {
    line.strip_prefix("FAILED ")?.split(": ").next()
}

/// Runs a machine with these cases.
fn boot(machine: &str, parts: &[&str]) -> Outcome {
    let results = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("driver-vm-{machine}"));
    let mut command = Command::new(script());
    command.args(["--timeout", TIMEOUT_S, "--results"]).arg(&results);
    command.arg(env!("CARGO_BIN_EXE_driver-tests"));
    for part in parts {
        command.args(["--only", part]);
    }
    let output = command.output().expect("the script can be started");
    let log = format!(
        "{}{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
        output.status
    );
    println!("{log}");
    Outcome {
        is_success: output.status.success(),
        log,
    }
}

/// True if a chosen case is one of this machine's.
fn belongs(case: &str, parts: &[&str]) -> bool {
    case.starts_with("daemon") == (parts == ["daemon"])
}
