//! The camera's pose from corners that are known exactly, with noise, wrong ids, moved and broken markers.

mod support;

use glam::{DVec2, DVec3};
use mirrorball_calib::{
    pose::Pose,
    resection::{NoPose, locate, marker_poses},
    rig::Rig,
    tag::Detection,
};
use proptest::prelude::*;
use support::{exact_detections, looking_at, rig};

/// A camera position from which all markers of the rig are in the picture.
fn camera() -> impl Strategy<Value = Pose> {
    (0.0..std::f64::consts::TAU, 0.5f64..1.3, 0.55f64..0.9, -0.5f64..0.5).prop_map(|(turn, height, distance, roll)| {
        let from = DVec3::new(height.cos() * turn.cos(), height.cos() * turn.sin(), height.sin()) * distance;
        looking_at(DVec3::new(0.0, 0.03, 0.0), from, roll)
    })
}

/// Numbers that look random, mean 0, standard deviation 1, the same for the same seed (sum of twelve uniform ones).
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    let mut uniform = move || {
        // SplitMix64 (Steele, Lea and Flood 2014).
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    };
    move || (0..12).map(|_| uniform()).sum::<f64>() - 6.0
}

fn add_noise(detections: &mut [Detection], sigma_px: f64, seed: u64) {
    let mut noise = noise(seed);
    for corner in detections.iter_mut().flat_map(|detection| &mut detection.corners_px) {
        *corner += sigma_px * DVec2::new(noise(), noise());
    }
}

fn distance_m(a: &Pose, b: &Pose) -> f64 {
    a.inverse().translation.distance(b.inverse().translation)
}

fn seen(rig: &Rig, pose: &Pose) -> Vec<Detection> {
    exact_detections(rig, &rig.scene_camera().intrinsics, pose)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn exact_corners_of_one_marker_give_its_exact_pose_first(pose in camera()) {
        let rig = rig();
        let intrinsics = &rig.scene_camera().intrinsics;
        for detection in seen(&rig, &pose) {
            let marker = rig.marker(detection.id).expect("a marker of the rig");
            let found = marker_poses(&detection, marker, intrinsics);
            let camera_from_marker = pose * marker.world_from_marker;
            let camera_m = camera_from_marker.inverse().translation;
            if camera_m.z < 0.02 * camera_m.length() {
                // Seen along its plane or from behind, where it is no marker.
                continue;
            }
            prop_assert!(!found.is_empty());
            prop_assert!(distance_m(&found[0].camera_from_marker, &camera_from_marker) < 1e-6);
            prop_assert!(found[0].reprojection_error_px < 1e-6);
        }
    }

    #[test]
    fn exact_corners_give_the_exact_pose(pose in camera()) {
        let rig = rig();
        let detections = seen(&rig, &pose);
        prop_assume!(detections.len() >= 2);
        let located = locate(&detections, &rig, &rig.scene_camera().intrinsics).expect("a pose");
        prop_assert!(distance_m(&located.camera_from_world, &pose) < 1e-8);
        prop_assert!(located.camera_from_world.angle_to(&pose) < 1e-8);
        prop_assert!(located.reprojection_error_px < 1e-6);
        prop_assert_eq!(located.markers, detections.len());
    }

    /// Five standard deviations of the worst direction: one test in a million would fail by chance, if errors were
    /// normal.
    #[test]
    fn noisy_corners_give_a_pose_within_its_uncertainty(pose in camera(), seed: u64) {
        let rig = rig();
        let mut detections = seen(&rig, &pose);
        prop_assume!(detections.len() >= 4);
        add_noise(&mut detections, 0.1, seed);
        let located = locate(&detections, &rig, &rig.scene_camera().intrinsics).expect("a pose");
        let error = distance_m(&located.camera_from_world, &pose);
        // The uncertainty is itself estimated from some 16 corners, so it is not taken below that of the noise put in.
        prop_assert!(error < 5.0 * located.position_sigma_m.max(3e-4), "{} {}", error, located.position_sigma_m);
        prop_assert!(error < 1e-2 && located.position_sigma_m < 1e-2, "{} {}", error, located.position_sigma_m);
        prop_assert!(located.reprojection_error_px < 0.25);
    }

    #[test]
    fn a_wrong_marker_is_left_out(pose in camera(), seed: u64, wrong in 0usize..4, dx in 8.0f64..60.0, dy in 8.0f64..60.0) {
        let rig = rig();
        let mut detections = seen(&rig, &pose);
        prop_assume!(detections.len() >= 4);
        add_noise(&mut detections, 0.05, seed);
        detections[wrong].corners_px = detections[wrong].corners_px.map(|corner| corner + DVec2::new(dx, -dy));
        let located = locate(&detections, &rig, &rig.scene_camera().intrinsics).expect("a pose");
        prop_assert_eq!((located.markers, located.rejected_markers), (detections.len() - 1, 1));
        prop_assert!(distance_m(&located.camera_from_world, &pose) < 1e-2);
    }

    #[test]
    fn one_wrong_corner_is_left_out(pose in camera(), wrong in 0usize..16, by in 5.0f64..40.0) {
        let rig = rig();
        let mut detections = seen(&rig, &pose);
        prop_assume!(detections.len() >= 4);
        detections[wrong / 4].corners_px[wrong % 4].x += by;
        let located = locate(&detections, &rig, &rig.scene_camera().intrinsics).expect("a pose");
        prop_assert!(located.corners >= 4 * (detections.len() - 1));
        prop_assert!(distance_m(&located.camera_from_world, &pose) < 1e-6);
    }

    #[test]
    fn anything_is_answered(corners in prop::collection::vec(prop::array::uniform8(any::<f64>()), 0..4), id in 0u32..4) {
        let rig = rig();
        let detections: Vec<Detection> = corners
            .iter()
            .zip(id..)
            .map(|(c, id)| Detection { id, corners_px: std::array::from_fn(|i| DVec2::new(c[2 * i], c[2 * i + 1])), ..model() })
            .collect();
        let _ = locate(&detections, &rig, &rig.scene_camera().intrinsics);
    }
}

fn model() -> Detection {
    let rig = rig();
    seen(&rig, &looking_at(DVec3::ZERO, DVec3::new(0.1, -0.5, 0.5), 0.0))[0]
}

#[test]
fn both_planar_solutions_are_tried_and_the_true_one_wins() {
    // A small marker seen obliquely from afar has a second pose that fits nearly as well; exact corners still tell
    // them apart, and with noise a second marker on another plane does.
    let rig = rig();
    let intrinsics = rig.scene_camera().intrinsics;
    for turn in 0..24 {
        let angle = f64::from(turn) * std::f64::consts::TAU / 24.0;
        let from = DVec3::new(0.7 * angle.cos(), 0.7 * angle.sin(), 1.2);
        let pose = looking_at(DVec3::new(-0.11, 0.07, 0.0), from, 0.3);
        let detections = seen(&rig, &pose);
        let small: Vec<Detection> = detections
            .iter()
            .copied()
            .filter(|detection| detection.id == 2)
            .collect();
        let located = locate(&small, &rig, &intrinsics).expect("a pose");
        assert!(distance_m(&located.camera_from_world, &pose) < 1e-6, "turn {turn}");
        let mut two: Vec<Detection> = detections.into_iter().filter(|d| d.id == 2 || d.id == 3).collect();
        if two.len() == 2 {
            add_noise(&mut two, 0.2, turn as u64);
            let located = locate(&two, &rig, &intrinsics).expect("a pose");
            assert!(
                located.camera_from_world.angle_to(&pose).to_degrees() < 3.0,
                "turn {turn}"
            );
        }
    }
}

#[test]
fn equal_input_gives_equal_bits() {
    let rig = rig();
    let mut detections = seen(&rig, &looking_at(DVec3::ZERO, DVec3::new(0.1, -0.5, 0.5), 0.1));
    add_noise(&mut detections, 0.1, 7);
    let once = locate(&detections, &rig, &rig.scene_camera().intrinsics);
    assert_eq!(once, locate(&detections, &rig, &rig.scene_camera().intrinsics));
}

#[test]
fn the_reason_for_no_pose_is_named() {
    let rig = rig();
    let locate = |detections: &[Detection]| locate(detections, &rig, &rig.scene_camera().intrinsics);
    assert_eq!(locate(&[]), Err(NoPose::NoMarkers));
    let unknown = locate(&[Detection { id: 77, ..model() }]).unwrap_err();
    assert_eq!(
        unknown.to_string(),
        "none of the `1` markers in the picture belongs to the rig"
    );
    let nan = Detection {
        corners_px: [DVec2::NAN; 4],
        ..model()
    };
    assert_eq!(locate(&[nan]), Err(NoPose::NoKnownMarker { seen: 1 }));
    // A mirrored marker, and one that is a point.
    let mut mirrored = model();
    mirrored.corners_px.swap(1, 3);
    assert_eq!(locate(&[mirrored]), Err(NoPose::NoSquare { known: 1 }));
    let point = Detection {
        corners_px: [DVec2::new(100.0, 200.0); 4],
        ..model()
    };
    assert_eq!(locate(&[point]), Err(NoPose::NoSquare { known: 1 }));
    // Corners that no square has: one is 25 pixels off.
    let mut bent = model();
    bent.corners_px[2] += DVec2::new(25.0, -25.0);
    let bent = locate(&[bent]).unwrap_err();
    assert!(
        matches!(bent, NoPose::TooLargeError { .. } | NoPose::NoAgreement { .. }),
        "{bent}"
    );
    // A marker of a few pixels says little about where the camera is.
    let tiny = [(0.0, 5.0), (5.0, 5.0), (5.0, 0.0), (0.0, 0.0)].map(|(x, y)| DVec2::new(300.0 + x, 200.0 + y));
    let tiny = locate(&[Detection {
        corners_px: tiny,
        ..model()
    }])
    .unwrap_err();
    assert!(matches!(tiny, NoPose::Degenerate { .. }), "{tiny}");
}

#[test]
fn a_known_marker_in_two_places_counts_where_it_fits() {
    let rig = rig();
    let pose = looking_at(DVec3::ZERO, DVec3::new(0.1, -0.5, 0.5), 0.1);
    let mut detections = seen(&rig, &pose);
    let copy = detections[0].corners_px.map(|corner| corner + DVec2::new(-120.0, 40.0));
    detections.push(Detection {
        corners_px: copy,
        ..detections[0]
    });
    let located = locate(&detections, &rig, &rig.scene_camera().intrinsics).expect("a pose");
    assert_eq!(located.rejected_markers, 1);
    assert!(distance_m(&located.camera_from_world, &pose) < 1e-7);
}
