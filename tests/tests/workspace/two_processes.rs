//! Capture daemon and render node as two processes: each may be killed and come back.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::support::{Running, data, has_adapter, program};

/// How long anything may take before the test gives up; lavapipe on a busy machine is slow.
const PATIENCE: Duration = Duration::from_secs(120);

fn play(service: &str) -> Running {
    let recording = data("two_cameras/recording");
    let child = program("mirrorball-capture")
        .args(["play".as_ref(), recording.as_os_str()])
        .args(["--loop", "--service", service])
        .spawn()
        .unwrap();
    Running(child)
}

fn render(service: &str, out: &Path) -> Running {
    let folder = data("two_cameras");
    let log = std::fs::File::create(out.with_extension("log")).unwrap();
    let child = program("mirrorball-render")
        .args(["--from", "live", "--service", service])
        .args(["--rig".as_ref(), folder.join("recording/rig.toml").as_os_str()])
        .args(["--scene".as_ref(), folder.join("scene/scene.toml").as_os_str()])
        .args(["--out".as_ref(), out.as_os_str()])
        .stderr(log)
        .spawn()
        .unwrap();
    Running(child)
}

fn n_frames(out: &Path) -> usize {
    std::fs::read_to_string(out.join("frames.jsonl")).map_or(0, |text| text.lines().count())
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(started.elapsed() < PATIENCE, "gave up waiting until {what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn either_may_be_killed_and_comes_back() {
    if !has_adapter() {
        return;
    }
    let service = format!("mirrorball/test-{}", std::process::id());
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));

    let node = render(&service, &first);
    let log = first.with_extension("log");
    wait_until("the render node says that it waits", || {
        std::fs::read_to_string(&log).is_ok_and(|text| text.contains("waiting for frames"))
    });

    let daemon = play(&service);
    wait_until("frames are rendered", || n_frames(&first) >= 2);
    daemon.kill();
    let before = n_frames(&first);
    let daemon = play(&service);
    wait_until("frames come from the restarted daemon", || {
        n_frames(&first) >= before + 3
    });

    node.kill();
    let node = render(&service, &second);
    wait_until("the restarted render node renders", || n_frames(&second) >= 2);
    drop((node, daemon));

    let text = std::fs::read_to_string(second.join("frames.jsonl")).unwrap();
    assert!(
        text.lines().next().unwrap().contains("\"camera_from_world\":[["),
        "{text}"
    );
}
