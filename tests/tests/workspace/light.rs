//! Light measured from simulated pictures of the probe: brackets, a still scene, a lamp that goes out.

use image::RgbImage;
use mirrorball_tests::brightest_light::angle_deg;
use mirrorball_tests::environment_map::luminance;
use mirrorball_tests::outputs::StrongLight;
use mirrorball_tests::simulation::Exposure;

use crate::simulated::{Lamp, LightErrors, Run, Stage};
use crate::support::has_adapter;

/// Bounds of the figures of a measured map.
struct Bounds {
    irradiance_percent: f64,
    light_deg: f64,
    unclipped_percent: f64,
}

/// The goals for a probe whose exposures alternate.
const BRACKETED: Bounds = Bounds {
    irradiance_percent: 3.0,
    light_deg: 0.7,
    unclipped_percent: 5.0,
};

/// Checks figures that were all printed before.
fn assert_within(all: &[LightErrors], bounds: &Bounds) {
    for errors in all {
        assert!(
            errors.irradiance.upper_mean_percent <= bounds.irradiance_percent,
            "{errors:?}"
        );
        assert!(errors.light_deg <= bounds.light_deg, "{errors:?}");
        assert!(errors.unclipped_percent <= bounds.unclipped_percent, "{errors:?}");
    }
}

/// Pictures of one environment with exposures that take turns.
fn bracket(stage: &Stage, steps: &[f64], n_frames: usize) -> Vec<(RgbImage, Exposure)> {
    let picture = stage.picture_of(&stage.map);
    (0..n_frames)
        .map(|index| stage.shot(&picture, steps[index % steps.len()], index as u64))
        .collect()
}

/// Checks every frame from the one that completes the first bracket on.
fn assert_bracketed(stage: &Stage, steps: &[f64], bounds: &Bounds) {
    let run = stage.run(&bracket(stage, steps, 6));
    let clipping = stage.clipping_radiance(steps[0]);
    let measure = |frame: usize| {
        let errors = stage.errors(&run.map(frame), clipping);
        let irradiance = errors.irradiance;
        eprintln!(
            "frame {frame}, exposure x {:.4}: irradiance {:.2} % (all normals {:.2} %), light {:.2} deg, unclipped {:.2} %",
            steps[frame % steps.len()],
            irradiance.upper_mean_percent,
            irradiance.mean_percent,
            errors.light_deg,
            errors.unclipped_percent
        );
        errors
    };
    let all: Vec<LightErrors> = (steps.len() - 1..6).map(measure).collect();
    assert_within(&all, bounds);
}

#[test]
fn a_bracket_that_holds_the_lamp_in_the_ball() {
    if has_adapter() {
        // 0.5° but for the first bracket: what clips around the lamp in its long exposure is black in the short one, and
        // the papers' missing light is put there.
        let bounds = Bounds {
            light_deg: 1.7,
            ..BRACKETED
        };
        assert_bracketed(&Stage::two_cameras(), &[1.0 / 1024.0, 1.0 / 32.0, 1.0], &bounds);
    }
}

#[test]
fn a_bracket_in_which_the_lamp_clips() {
    if has_adapter() {
        assert_bracketed(&Stage::two_cameras(), &[1.0 / 16.0, 1.0, 4.0], &BRACKETED);
    }
}

#[test]
fn a_bracket_that_holds_the_ceiling_over_a_fisheye() {
    if has_adapter() {
        // 2.3 % and 0.2° in all but the long exposures: where those clip, the ball in the scene camera's picture tells how
        // bright the ceiling is, and at the ceiling's edge that overrules what the short exposure measured.
        let bounds = Bounds {
            irradiance_percent: 4.3,
            light_deg: 1.6,
            ..BRACKETED
        };
        assert_bracketed(&Stage::fisheye(), &[1.0 / 16.0, 1.0, 4.0], &bounds);
    }
}

/// Root mean square of deviations.
fn rms(deviations: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for deviation in deviations {
        sum += deviation * deviation;
        count += 1.0;
    }
    f64::sqrt(sum / count)
}

/// How much a light varies from frame to frame.
#[derive(Clone, Copy, Debug)]
struct Flicker {
    power_percent: f64,
    direction_deg: f64,
}

/// The goals for a still scene.
const STILL: Flicker = Flicker {
    power_percent: 1.0,
    direction_deg: 0.2,
};

/// Checks how much every light of the last frame varies from a frame on that has a twentieth of the strongest's power.
fn assert_still(run: &Run, from: usize, most: Flicker) {
    let frames = run.strong_lights().split_off(from);
    let last = frames.last().unwrap();
    assert!(!last.is_empty(), "no strong light");
    let of = |light: &StrongLight| {
        let same: Vec<StrongLight> = frames
            .iter()
            .map(|frame| {
                let angle = |other: &&StrongLight| angle_deg(other.direction, light.direction);
                let nearest = frame.iter().min_by(|a, b| angle(a).total_cmp(&angle(b))).unwrap();
                assert!(angle(&nearest) < 5.0, "a light is gone from a frame");
                *nearest
            })
            .collect();
        let n = same.len() as f64;
        let mean_irradiance = same.iter().map(|light| luminance(light.irradiance)).sum::<f64>() / n;
        let mean_direction = same
            .iter()
            .map(|light| light.direction)
            .sum::<glam::DVec3>()
            .normalize();
        let flicker = Flicker {
            power_percent: 100.0
                * rms(same
                    .iter()
                    .map(|light| luminance(light.irradiance) / mean_irradiance - 1.0)),
            direction_deg: rms(same.iter().map(|light| angle_deg(light.direction, mean_direction))),
        };
        eprintln!("light of irradiance {mean_irradiance:.3} from {mean_direction}: {flicker:?}");
        flicker
    };
    let strongest = last.iter().map(|light| luminance(light.irradiance)).fold(0.0, f64::max);
    let counts = |light: &&StrongLight| luminance(light.irradiance) > 0.05 * strongest;
    let all: Vec<Flicker> = last.iter().filter(counts).map(of).collect();
    for flicker in all {
        assert!(flicker.power_percent <= most.power_percent, "{flicker:?}");
        assert!(flicker.direction_deg <= most.direction_deg, "{flicker:?}");
    }
}

fn still_frames(stage: &Stage) -> Vec<(RgbImage, (RgbImage, Exposure))> {
    let picture = stage.picture_of(&stage.map);
    (0..8)
        .map(|seed| (stage.scene_of(&stage.map, 100 + seed), stage.shot(&picture, 1.0, seed)))
        .collect()
}

#[test]
fn a_still_lamp_does_not_flicker() {
    if has_adapter() {
        let stage = Stage::two_cameras();
        assert_still(&stage.run_with(&still_frames(&stage)), 4, STILL);
    }
}

#[test]
fn a_still_ceiling_does_not_flicker() {
    if has_adapter() {
        let stage = Stage::fisheye();
        // The goals of `STILL` are missed: the patch of the ceiling that clips in the fisheye and in the ball changes its
        // outline with the noise of the pixels around it, by 0.33° and 0.9 to 1.2 %.
        let most = Flicker {
            power_percent: 1.5,
            direction_deg: 0.5,
        };
        assert_still(&stage.run_with(&still_frames(&stage)), 4, most);
    }
}

/// Switches the lamp off before a frame, in the ball of both pictures, not on the papers, which still tell of a lamp; its light must be gone from the map of the frame after that one.
fn assert_goes_out(stage: &Stage, steps: &[f64], off: usize) {
    let lamp = Lamp::brightest(&stage.map, 4.0);
    let maps = [stage.map.clone(), lamp.taken_out_of(&stage.map)];
    let pictures = maps.each_ref().map(|map| stage.picture_of(map));
    let scenes = maps.each_ref().map(|map| stage.scene_of(map, 0));
    let frames: Vec<_> = (0..off + 3)
        .map(|index| {
            let light = usize::from(index >= off);
            let shot = stage.shot(&pictures[light], steps[index % steps.len()], index as u64);
            (scenes[light].clone(), shot)
        })
        .collect();
    let run = stage.run_with(&frames);
    let threshold = 2.0 * luminance(lamp.surroundings(&stage.map));
    let before = lamp.energy(&run.map(off - 1), threshold);
    let truth = lamp.energy(&stage.map, threshold);
    let after: Vec<f64> = (off..off + 3)
        .map(|frame| lamp.energy(&run.map(frame), threshold) / before)
        .collect();
    eprintln!("steps {steps:?}, off at {off}: true {truth:.3}, before {before:.3}, then {after:?}");
    assert!(before > 0.5 * truth, "the lamp was not there: {before} of {truth}");
    assert!(
        after[1..].iter().all(|&share| share < 0.02),
        "steps {steps:?}, off at {off}: {after:?}"
    );
}

#[test]
fn a_lamp_that_is_switched_off_is_gone_within_two_frames() {
    if has_adapter() {
        assert_goes_out(&Stage::two_cameras(), &[1.0], 5);
    }
}

#[test]
fn a_lamp_that_is_switched_off_is_gone_within_two_frames_of_a_bracket() {
    if has_adapter() {
        for off in [6, 7, 8] {
            assert_goes_out(&Stage::two_cameras(), &[1.0 / 1024.0, 1.0 / 32.0, 1.0], off);
        }
    }
}

#[test]
fn a_clipped_lamp_that_is_switched_off_is_gone_within_two_frames_of_a_bracket() {
    if has_adapter() {
        assert_goes_out(&Stage::two_cameras(), &[1.0 / 16.0, 1.0, 4.0], 6);
    }
}
