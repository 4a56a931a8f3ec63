//! Pictures of the probe that tell nothing: the light stays as it was, ages, and says so.

use image::{Rgb, RgbImage};
use mirrorball_tests::simulation::Exposure;

use crate::simulated::Stage;
use crate::support::has_adapter;

/// Frames before the pictures that tell nothing.
const N_GOOD: usize = 3;
/// Pictures that tell nothing.
const N_BLIND: usize = 3;

/// Some good frames, some of one colour, a good one.
fn assert_map_stays(stage: &Stage, color: [u8; 3], expected: &str) {
    let picture = stage.picture_of(&stage.map);
    let [width, height] = stage.probe().size_px;
    let blind = RgbImage::from_pixel(width, height, Rgb(color));
    let shots: Vec<(RgbImage, Exposure)> = (0..=N_GOOD + N_BLIND)
        .map(|index| {
            let (good, exposure) = stage.shot(&picture, 1.0, index as u64);
            let is_blind = (N_GOOD..N_GOOD + N_BLIND).contains(&index);
            (if is_blind { blind.clone() } else { good }, exposure)
        })
        .collect();
    let run = stage.run(&shots);
    let before = run.map(N_GOOD - 1);
    for frame in N_GOOD..N_GOOD + N_BLIND {
        let light = run.light(frame);
        assert_eq!(light["age_frames"], frame - N_GOOD + 1, "{light}");
        let said = light["blind"].to_string();
        assert!(said.contains("probe") && said.contains(expected), "{said}");
        assert_eq!(run.map(frame), before, "frame {frame}");
    }
    let after = run.light(N_GOOD + N_BLIND);
    assert_eq!(after["age_frames"], 0);
    assert!(after["blind"].is_null(), "{after}");
}

#[test]
fn black_pictures_of_the_ball() {
    if has_adapter() {
        assert_map_stays(&Stage::two_cameras(), [0; 3], "black");
    }
}

#[test]
fn pictures_of_the_ball_clipped_all_over() {
    if has_adapter() {
        assert_map_stays(&Stage::two_cameras(), [255; 3], "clipped");
    }
}

#[test]
fn black_pictures_of_a_fisheye() {
    if has_adapter() {
        assert_map_stays(&Stage::fisheye(), [0; 3], "black");
    }
}

#[test]
fn a_ball_covered_by_a_grey_cloth() {
    if has_adapter() {
        assert_map_stays(&Stage::two_cameras(), [90; 3], "not in the picture");
    }
}
