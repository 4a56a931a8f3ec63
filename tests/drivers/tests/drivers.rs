//! Runs the cases on real kernel drivers: boots the virtual machine, which runs `driver-tests`, and reports.
//!
//! Where there is no QEMU the test says `SKIPPED` and passes; with the environment variable
//! `MIRRORBALL_REQUIRE_DRIVERS` set that is a failure. `MIRRORBALL_DRIVER_CASES` chooses cases by parts of their names.

use std::env;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::Command;

/// What `scripts/driver-vm.sh` exits with where the machine cannot be built or booted.
const CANNOT_RUN_HERE: i32 = 75;

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

    let mut command = Command::new(&script);
    command.arg(program);
    for case in env::var("MIRRORBALL_DRIVER_CASES")
        .unwrap_or_default()
        .split_whitespace()
    {
        command.args(["--only", case]);
    }
    let output = command.output().expect("the script can be started");
    let log = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    println!("{log}");
    assert!(output.status.success(), "on real drivers ({}):\n{log}", output.status);
}
