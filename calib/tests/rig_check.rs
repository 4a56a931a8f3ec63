//! Pictures that come from another camera than the rig says.

mod support;

use glam::DVec3;
use mirrorball_calib::{
    pose::Pose,
    rig::{
        Rig,
        check::{RigCheck, RigMismatch},
    },
};
use mirrorball_capture::frame::{Exposure, Frame, FrameMeta, PixelFormat, Size};
use support::{RIG, looking_at, picture, rig};

/// A rig whose fixed camera has the size and the lens of the scene camera and sees the markers from the side.
fn rig_of_two() -> Rig {
    let mut rig = rig();
    let scene = rig.scene_camera().clone();
    let probe = rig
        .cameras
        .iter_mut()
        .find(|camera| camera.name == "probe")
        .expect("the rig has a fixed camera");
    probe.intrinsics = scene.intrinsics;
    probe.photometry = scene.photometry;
    probe.camera_from_world = Some(fixed_pose());
    rig
}

fn fixed_pose() -> Pose {
    looking_at(DVec3::new(0.0, 0.03, 0.0), DVec3::new(-0.4, -0.2, 0.4), 0.0)
}

fn scene_pose() -> Pose {
    looking_at(DVec3::new(0.0, 0.05, 0.0), DVec3::new(0.05, -0.35, 0.45), 0.0)
}

fn frame(camera: &str, [width, height]: [u32; 2], pixels: Vec<u8>) -> Frame {
    let exposure = Exposure {
        time_s: 0.01,
        gain: 1.0,
        white_balance: [1.0; 3],
    };
    Frame {
        meta: FrameMeta::new(camera.into(), 0, 0, exposure),
        size: Size { width, height },
        format: PixelFormat::Rgb8,
        pixels: pixels.into(),
    }
}

/// What the check says of one picture of each camera; `None` is a picture without markers.
fn verdict(rig: &Rig, scene: Option<Pose>, probe: Option<Pose>) -> Result<(), RigMismatch> {
    let shown = |pose: Option<Pose>| pose.map_or_else(|| vec![90; 3 * 640 * 480], |pose| picture(rig, &pose, 2));
    let mut check = RigCheck::new(rig);
    for (name, pose) in [("scene", scene), ("probe", probe)] {
        check.add(&frame(name, [640, 480], shown(pose))).expect("a picture");
    }
    check.verdict()
}

#[test]
fn cameras_that_see_what_they_should_are_left_alone() {
    let rig = rig_of_two();
    assert_eq!(verdict(&rig, Some(scene_pose()), None), Ok(()));
    assert_eq!(verdict(&rig, Some(scene_pose()), Some(fixed_pose())), Ok(()));
    // The scene camera looks away for once: the fixed one sees the markers where it stands.
    assert_eq!(verdict(&rig, None, Some(fixed_pose())), Ok(()));
    assert_eq!(verdict(&rig, None, None), Ok(()));
}

#[test]
fn exchanged_cameras_are_found_by_the_markers() {
    let rig = rig_of_two();
    let mismatch = verdict(&rig, None, Some(scene_pose())).unwrap_err();
    assert!(
        matches!(&mismatch, RigMismatch::Exchanged { scene, probe, frames: 1, found: 1 } if scene == "scene" && probe == "probe"),
        "{mismatch}"
    );
    assert!(mismatch.hint().starts_with("exchange the two names"));
    // Through a lens of quite another kind the markers fit nothing, through the scene camera's they do.
    let mut rig = rig_of_two();
    let fisheye = support::rig().cameras[1].intrinsics.lens;
    rig.cameras[1].intrinsics.lens = fisheye;
    rig.cameras[1].intrinsics.focal_px *= 0.3;
    let mismatch = verdict(&rig, None, Some(scene_pose())).unwrap_err();
    assert!(matches!(mismatch, RigMismatch::Exchanged { .. }), "{mismatch}");
}

#[test]
fn a_fixed_camera_that_has_moved_is_named() {
    let rig = rig_of_two();
    let moved = looking_at(DVec3::new(0.0, 0.03, 0.0), DVec3::new(-0.4, -0.3, 0.4), 0.0);
    let mismatch = verdict(&rig, Some(scene_pose()), Some(moved)).unwrap_err();
    let RigMismatch::Moved { camera, distance_m, .. } = &mismatch else {
        panic!("{mismatch}")
    };
    assert!(camera == "probe" && (distance_m - 0.1).abs() < 0.005, "{mismatch}");
    let turned = looking_at(DVec3::new(0.05, 0.03, 0.0), DVec3::new(-0.4, -0.2, 0.4), 0.0);
    assert!(matches!(
        verdict(&rig, Some(scene_pose()), Some(turned)),
        Err(RigMismatch::Moved { .. })
    ));
}

#[test]
fn exchanged_sizes_are_named_and_one_odd_picture_is_not() {
    let rig = rig();
    let grey = |size: [u32; 2]| vec![90; 3 * (size[0] * size[1]) as usize];
    let (scene_px, probe_px) = ([640, 480], [640, 640]);
    for cameras in [&["scene", "probe"][..], &["scene"], &["probe"]] {
        let mut check = RigCheck::new(&rig);
        for name in cameras {
            let size = if *name == "scene" { probe_px } else { scene_px };
            check.add(&frame(name, size, grey(size))).expect("a picture");
        }
        let mismatch = check.verdict().unwrap_err();
        assert!(matches!(mismatch, RigMismatch::SizesExchanged { .. }), "{mismatch}");
        assert!(
            mismatch
                .to_string()
                .contains("(`scene` has `640×480` pixels, `probe` `640×640`)"),
            "{mismatch}"
        );
    }
    // Half way through a recording a picture of another size is a fault of its own.
    let mut check = RigCheck::new(&rig);
    for size in [scene_px, probe_px] {
        check.add(&frame("scene", size, grey(size))).expect("a picture");
    }
    assert_eq!(check.verdict(), Ok(()));
    // A size that no camera has exchanges nothing.
    let mut check = RigCheck::new(&rig);
    check
        .add(&frame("scene", [320, 240], grey([320, 240])))
        .expect("a picture");
    assert_eq!(check.verdict(), Ok(()));
    assert!(RIG.contains("size_px = [640, 640]"));
}
