//! Pictures of the probe that tell nothing: the light stays as it was, ages, and says so.

use image::{Rgb, RgbImage};
use mirrorball_tests::environment_map::{EnvironmentMap, Sphere};

use crate::simulated::{Run, Stage};
use crate::support::has_adapter;

/// Frames before the pictures that tell nothing.
const N_GOOD: usize = 3;
/// Pictures that tell nothing.
const N_BLIND: usize = 3;

/// Some good frames, some in a room of one radiance all around, a good one.
fn in_a_room_of(stage: &Stage, radiance: f32) -> Run {
    let maps = [
        stage.map.clone(),
        EnvironmentMap::from_fn(&Sphere::new(), |_| [radiance; 3]),
    ];
    let pictures = maps.each_ref().map(|map| stage.picture_of(map));
    let scenes = maps.each_ref().map(|map| stage.scene_of(map, 0));
    let frames: Vec<_> = (0..=N_GOOD + N_BLIND)
        .map(|index| {
            let light = usize::from((N_GOOD..N_GOOD + N_BLIND).contains(&index));
            (scenes[light].clone(), stage.shot(&pictures[light], 1.0, index as u64))
        })
        .collect();
    stage.run_with(&frames)
}

fn assert_map_stays(run: &Run, expected: &str) {
    let before = run.map(N_GOOD - 1);
    for frame in N_GOOD..N_GOOD + N_BLIND {
        let light = run.light(frame);
        assert_eq!(light["age_frames"], frame - N_GOOD + 1, "{light}");
        let said = light["blind"].to_string();
        assert!(said.contains(expected), "{said}");
        assert!(run.map(frame) == before, "the map of frame {frame} is another one");
    }
    let after = run.light(N_GOOD + N_BLIND);
    assert_eq!(after["age_frames"], 0);
    assert!(after["blind"].is_null(), "{after}");
}

#[test]
fn a_ball_that_is_black_in_all_pictures() {
    if has_adapter() {
        assert_map_stays(&in_a_room_of(&Stage::two_cameras(), 0.0), "black");
    }
}

#[test]
fn a_ball_that_clips_in_all_pictures() {
    if has_adapter() {
        assert_map_stays(&in_a_room_of(&Stage::two_cameras(), 1e4), "clipped");
    }
}

#[test]
fn black_and_clipped_pictures_of_a_fisheye() {
    if has_adapter() {
        let stage = Stage::fisheye().without_ball();
        assert_map_stays(&in_a_room_of(&stage, 0.0), "black");
        assert_map_stays(&in_a_room_of(&stage, 1e4), "clipped");
    }
}

#[test]
fn a_cloth_before_the_ball_camera_is_no_light() {
    if !has_adapter() {
        return;
    }
    let stage = Stage::two_cameras();
    let [width, height] = stage.probe().size_px;
    let picture = stage.picture_of(&stage.map);
    let shots: Vec<_> = (0..N_GOOD + N_BLIND)
        .map(|index| {
            let (good, exposure) = stage.shot(&picture, 1.0, index as u64);
            let cloth = RgbImage::from_pixel(width, height, Rgb([90; 3]));
            (if index < N_GOOD { good } else { cloth }, exposure)
        })
        .collect();
    let run = stage.run(&shots);
    for frame in N_GOOD..N_GOOD + N_BLIND {
        let light = run.light(frame);
        assert!(light["blind"].to_string().contains("outline"), "{light}");
        // The ball in the scene camera's picture still shows the light.
        assert!(light["residual"].as_f64().unwrap() < 0.05, "{light}");
    }
}
