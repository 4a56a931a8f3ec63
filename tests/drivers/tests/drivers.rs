//! Runs the cases on real kernel drivers: boots virtual machines, which run `driver-tests`, and reports.
//!
//! The daemon's cases start `mirrorball-capture`, which has to be built: `make test-drivers` does, and so does
//! `cargo test --workspace`.
//!
//! Where there is no QEMU the test says `SKIPPED` and passes; with the environment variable
//! `MIRRORBALL_REQUIRE_DRIVERS` set that is a failure. `MIRRORBALL_DRIVER_CASES` chooses cases by parts of their names.

use std::env;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::thread;

/// What `scripts/driver-vm.sh` exits with where the machine cannot be built or booted.
const CANNOT_RUN_HERE: i32 = 75;

/// About half of all cases, by time, by the beginnings of their names.
const FIRST_HALF: [&str; 3] = ["daemon_", "steering", "streaming"];

#[test]
fn cases_pass_on_real_drivers() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scripts/driver-vm.sh");
    let program = PathBuf::from(env!("CARGO_BIN_EXE_driver-tests"));
    // The first run fetches a kernel, which is not part of the machine's time.
    let prepared = Command::new(&script)
        .arg("--prepare")
        .output()
        .expect("the script can be started");
    if prepared.status.code() == Some(CANNOT_RUN_HERE) {
        let reason = String::from_utf8_lossy(&prepared.stderr);
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
    assert!(
        prepared.status.success(),
        "{}",
        String::from_utf8_lossy(&prepared.stderr)
    );

    let chosen = env::var("MIRRORBALL_DRIVER_CASES").unwrap_or_default();
    let chosen: Vec<&str> = chosen.split_whitespace().flat_map(|case| ["--only", case]).collect();
    let halves: Vec<Vec<&str>> = if chosen.is_empty() {
        // They wait for frames more than they compute, so two machines side by side take half the time.
        ["--only", "--except"]
            .map(|option| FIRST_HALF.iter().flat_map(|case| [option, *case]).collect())
            .into()
    } else {
        vec![chosen]
    };
    let outputs: Vec<Output> = thread::scope(|scope| {
        let machines: Vec<_> = halves
            .iter()
            .enumerate()
            .map(|(index, arguments)| {
                let (script, program) = (&script, &program);
                scope.spawn(move || boot(script, program, index, arguments))
            })
            .collect();
        let join = |machine: thread::ScopedJoinHandle<'_, Output>| machine.join().expect("it does not panic");
        machines.into_iter().map(join).collect()
    });
    for output in &outputs {
        println!("{}", log_of(output));
    }
    for output in outputs {
        assert!(
            output.status.success(),
            "on real drivers ({}):\n{}",
            output.status,
            log_of(&output)
        );
    }
}

/// Runs cases in a virtual machine of their own.
fn boot(script: &Path, program: &Path, index: usize, arguments: &[&str]) -> Output {
    let results = program.with_file_name(format!("driver-results-{index}"));
    Command::new(script)
        .arg("--results")
        .arg(results)
        .arg(program)
        .args(arguments)
        .output()
        .expect("the script can be started")
}

fn log_of(output: &Output) -> String {
    let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}
