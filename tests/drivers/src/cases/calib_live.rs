//! The calibration program with a camera at work: pictures come, Ctrl-C ends the collection, an unplugged camera is named.

use std::thread;
use std::time::{Duration, Instant};

use mirrorball_driver_tests::vivid::{self, VividFault};

use super::daemon_support::{PATIENCE, Program};
use super::support::{ensure, say};
use super::v4l2_vivid::{SIZE, set};

/// Starts to look for markers in what the first camera sends; `more` are further options.
fn start(name: &str, more: &[&str]) -> Result<Program, String> {
    let nodes = vivid::nodes();
    let node = nodes.first().ok_or("vivid has no camera")?.display().to_string();
    let size = format!("{}x{}", SIZE.0, SIZE.1);
    let arguments = ["detect", "--json", "--device", &node, "--size", &size];
    Program::start_calib(name, &[&arguments[..], more].concat())
}

/// Pictures told of so far.
fn pictures(log: &str) -> usize {
    log.lines().filter(|line| line.starts_with("{\"file\":")).count()
}

fn wait_for_pictures(program: &Program, n: usize) -> Result<(), String> {
    let deadline = Instant::now() + PATIENCE;
    while pictures(&program.log()) < n {
        ensure(Instant::now() < deadline, || {
            format!("no `{n}` pictures: {}", program.log())
        })?;
        thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

/// As many as asked for, and saved where there is something to see; exit code 0.
pub(super) fn pictures_come() -> Result<(), String> {
    let mut program = start("calib_frames", &["--frames", "30"])?;
    let status = program.wait()?;
    let log = program.log();
    ensure(status.success() && pictures(&log) == 30, || {
        format!("ended with {status} and {} pictures: {log}", pictures(&log))
    })
}

/// Ctrl-C is no failure: what was gathered is used.
pub(super) fn interrupt_ends_the_collection() -> Result<(), String> {
    let mut program = start("calib_interrupt", &[])?;
    wait_for_pictures(&program, 3)?;
    let status = program.interrupt()?;
    ensure(status.success(), || format!("ended with {status}: {}", program.log()))
}

/// A camera that is unplugged ends it with exit code 1, a cause and a hint.
pub(super) fn unplugged_is_an_error() -> Result<(), String> {
    let mut program = start("calib_unplug", &[])?;
    wait_for_pictures(&program, 3)?;
    set(VividFault::Disconnect, 1)?;
    let status = program.wait()?;
    let log = program.log();
    vivid::reload().map_err(say)?;
    let is_named = log.contains("has stopped")
        && log.contains("was unplugged while streaming")
        && log.contains("hint: plug it in");
    ensure(status.code() == Some(1) && is_named, || {
        format!("ended with {status}: {log}")
    })
}
