//! The carried recordings, rendered by the program and scored against the path-traced truth.

use std::path::Path;

use crate::support::{data, has_adapter, program};
use mirrorball_tests::floors::{self, Floor};
use mirrorball_tests::score::Score;

/// Renders a carried recording and scores it.
fn render_and_score(name: &str, out: &Path) -> Score {
    let folder = data(name);
    let status = program("mirrorball-render")
        .args(["--recording".as_ref(), folder.join("recording").as_os_str()])
        .args(["--scene".as_ref(), folder.join("scene/scene.toml").as_os_str()])
        .args(["--out".as_ref(), out.as_os_str(), "--environment-out".as_ref()])
        .status()
        .unwrap();
    assert!(status.success());
    Score::measure(out, &folder.join("truth")).unwrap()
}

/// Every floor must be reached.
fn assert_floors(score: &Score) {
    let floors = floors::check(score);
    let missed: Vec<&Floor> = floors.iter().filter(|floor| !floor.passed).collect();
    assert!(floors.len() > 8, "only {} floors were measured", floors.len());
    assert!(missed.is_empty(), "{missed:#?}");
}

#[test]
fn a_moving_lamp_seen_by_one_camera() {
    if has_adapter() {
        let out = tempfile::tempdir().unwrap();
        let score = render_and_score("moving_lamp", out.path());
        assert_eq!(score.pose.frames.len(), 10);
        assert_floors(&score);
    }
}

#[test]
fn a_lamp_seen_by_a_second_camera_in_the_ball() {
    if has_adapter() {
        let out = tempfile::tempdir().unwrap();
        assert_floors(&render_and_score("two_cameras", out.path()));
    }
}

#[test]
fn a_bright_ceiling_seen_by_a_fisheye() {
    if has_adapter() {
        let out = tempfile::tempdir().unwrap();
        assert_floors(&render_and_score("fisheye", out.path()));
    }
}

#[test]
fn poses_and_pictures_repeat_bit_for_bit() {
    if has_adapter() {
        let [one, other] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        for out in [&one, &other] {
            render_and_score("two_cameras", out.path());
        }
        let lines = |out: &Path| -> Vec<serde_json::Value> {
            let text = std::fs::read_to_string(out.join("frames.jsonl")).unwrap();
            let without_times = |line: &str| {
                let mut value: serde_json::Value = serde_json::from_str(line).unwrap();
                value.as_object_mut().unwrap().remove("stages_ms").unwrap();
                value
            };
            text.lines().map(without_times).collect()
        };
        assert_eq!(lines(one.path()), lines(other.path()));
        let picture = |out: &Path| std::fs::read(out.join("composite/000003.png")).unwrap();
        assert_eq!(picture(one.path()), picture(other.path()));
    }
}
