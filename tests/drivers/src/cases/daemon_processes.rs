//! The daemon and its readers as processes: killed and started again, each without harm to the other.

use std::fs;
use std::thread;
use std::time::{Duration, Instant};

use super::daemon_rig::{KNOWN_LATENCY, SERVICE, STATUS_SOCKET, ball_camera, scene_camera};
use super::daemon_support::{PATIENCE, Program, Seen, Stage, output_of, start_daemon, with_daemon};
use super::support::{ensure, say};

/// A recording by a reader process is a good one, and one that was killed is good as far as it goes; the daemon cares
/// about neither. A daemon that was killed is followed by another, and readers go on. SIGTERM is an orderly end.
pub(super) fn daemon_and_reader_as_processes() -> Result<(), String> {
    with_daemon(&[scene_camera(), ball_camera()], KNOWN_LATENCY, |stage| {
        record_to_the_end()?;
        kill_the_reader(stage)?;
        kill_the_daemon(stage)?;
        tell_how_it_is()?;
        let began = Instant::now();
        let status = stage.daemon.terminate()?;
        println!("    ended {:.2?} after SIGTERM with {status}", began.elapsed());
        ensure(status.success(), || format!("after SIGTERM it ended with {status}"))
    })
}

fn record_to_the_end() -> Result<(), String> {
    let path = "/tmp/whole.mcap";
    let arguments = ["record", "--out", path, "--service", SERVICE, "--frames", "20"];
    let mut recorder = Program::start("record", &arguments)?;
    let status = recorder.wait()?;
    ensure(status.success(), || {
        format!("`record` ended with {status}: {}", recorder.log())
    })?;
    let text = output_of(&["info", "--verify", path])?;
    println!("    {}", text.trim_end().replace('\n', "\n    "));
    let is_whole =
        text.contains("ends: as it should") && text.contains("camera `scene`") && text.contains("camera `ball`");
    ensure(is_whole, || format!("no whole recording of both cameras: {text}"))?;
    fs::remove_file(path).map_err(say)
}

fn kill_the_reader(stage: &mut Stage) -> Result<(), String> {
    let path = "/tmp/killed.mcap";
    let mut recorder = Program::start("killed", &["record", "--out", path, "--service", SERVICE])?;
    let deadline = Instant::now() + PATIENCE;
    // Progress is told once a second, and what was recorded is safe once a second.
    while recorder.log().matches("recorded ").count() < 2 {
        ensure(Instant::now() < deadline, || {
            format!("nothing recorded: {}", recorder.log())
        })?;
        stage.reader.next(Duration::from_millis(100))?;
    }
    recorder.kill()?;
    let missed_before = stage.reader.subscriber.stats().missed;
    let killed = Instant::now();
    stage.reader.sets(10)?;
    let missed = stage.reader.subscriber.stats().missed - missed_before;
    println!(
        "    reader killed: the other has 10 sets in the {:.2?} after, {missed} missed",
        killed.elapsed()
    );
    let text = output_of(&["info", path])?;
    ensure(
        text.contains("camera `scene`") && !text.contains("ends: as it should"),
        || format!("no broken-off recording: {text}"),
    )?;
    fs::remove_file(path).map_err(say)
}

fn kill_the_daemon(stage: &mut Stage) -> Result<(), String> {
    let last = stage.reader.next(PATIENCE)?.ok_or("no set")?;
    let last_ns = last.iter().map(|seen| seen.meta.timestamp_ns).max().unwrap_or(0);
    stage.daemon.kill()?;
    thread::sleep(Duration::from_millis(100));
    let began = Instant::now();
    stage.daemon = start_daemon()?;
    let is_new = |set: &[Seen]| set.len() == 2 && set[0].meta.timestamp_ns > last_ns + 100_000_000;
    stage.reader.set_where("a set of the new daemon", is_new)?;
    let changes = stage.reader.subscriber.stats().publisher_changes;
    println!(
        "    daemon killed: the reader has whole sets {:.2?} after the new one's start",
        began.elapsed()
    );
    ensure(changes == 1, || format!("{changes} changes of publisher"))?;
    stage.reader.sets(8).map(|_| ())
}

fn tell_how_it_is() -> Result<(), String> {
    // What it tells is up to a second old, and it has only just started.
    thread::sleep(Duration::from_millis(1200));
    let json = output_of(&["status", "--json", "--socket", STATUS_SOCKET])?;
    ensure(json.matches("\"streaming\"").count() == 2, || {
        format!("two cameras that stream: {json}")
    })
}
