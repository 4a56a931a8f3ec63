//! Rigs that have drifted, and such that have not.

use std::path::Path;

use super::*;
use crate::{pose::Twist, rig::Camera, tag::Family};

/// Noise of corners in pixels; what is expected of markers of 50 pixels' side.
const NOISE_PX: f64 = 0.05;

/// Normal deviates from a seed (SplitMix64, Steele et al. 2014; Box and Muller 1958).
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

fn looking_at(target: DVec3, from: DVec3) -> Pose {
    let forward = (target - from).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let rotation = glam::DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Pose {
        rotation,
        translation: -(rotation * from),
    }
}

/// A rig whose fixed camera sees the markers from the side through an ordinary lens.
fn rig() -> Rig {
    let text = include_str!("../../../tests/support/rig.toml");
    let mut rig = Rig::from_toml(text, Path::new("rig.toml")).expect("a rig");
    let scene = rig.scene_camera().clone();
    rig.cameras[1] = Camera {
        camera_from_world: Some(looking_at(DVec3::new(0.0, 0.03, 0.0), DVec3::new(-0.4, -0.2, 0.4))),
        name: "probe".to_owned(),
        role: Role::Ball,
        ..scene
    };
    rig
}

fn detections(rig: &Rig, intrinsics: &Intrinsics, pose: &Pose, noise: &mut Noise) -> Vec<Detection> {
    let seen = |marker: &Marker| {
        let mut corners_px = [DVec2::ZERO; 4];
        for (pixel, point) in corners_px.iter_mut().zip(marker.corners_world()) {
            let exact = intrinsics.project(pose.transform_point(point))?;
            *pixel = exact + NOISE_PX * DVec2::new(noise.normal(), noise.normal());
        }
        corners_px
            .iter()
            .all(|pixel| intrinsics.contains(*pixel))
            .then_some(Detection {
                family: Family::Tag36h11,
                id: marker.id,
                hamming: 0,
                decision_margin: 100.0,
                corners_px,
            })
    };
    rig.markers.iter().filter_map(seen).collect()
}

/// What is said about `file` of a recording made with `truth`.
fn verdict(file: &Rig, truth: &Rig, seed: u64) -> Drift {
    let mut noise = Noise(seed);
    let mut check = DriftCheck::new(file);
    for i in 0..12 {
        let angle = 0.5 * f64::from(i);
        let from = DVec3::new(0.35 * angle.sin(), -0.35 * angle.cos(), 0.35 + 0.02 * f64::from(i % 4));
        let pose = looking_at(DVec3::new(0.02, 0.03, 0.0), from);
        check.add(
            "scene",
            &detections(truth, &truth.cameras[0].intrinsics, &pose, &mut noise),
        );
        let probe = &truth.cameras[1];
        let place = probe.camera_from_world.expect("fixed");
        check.add("probe", &detections(truth, &probe.intrinsics, &place, &mut noise));
    }
    check.verdict(&|_| {}).expect("enough markers")
}

/// The findings in words, and that the routine is the right one.
fn only(drift: &Drift) -> &Finding {
    assert_eq!(drift.findings.len(), 1, "{:?}", drift.findings);
    &drift.findings[0]
}

#[test]
fn a_rig_that_holds_is_left_alone() {
    for seed in 0..10 {
        let drift = verdict(&rig(), &rig(), seed);
        assert!(drift.holds(), "{:?}", drift.findings);
        assert_eq!((drift.pictures, drift.lost), (12, 0));
        for fit in &drift.cameras {
            assert!((0.5..1.5).contains(&fit.ratio), "{fit:?}");
        }
        assert_eq!(drift.markers.len(), 5);
    }
}

#[test]
fn predicted_deviations_are_those_that_occur() {
    // Ways of markers that have not moved, in their standard deviations: as many beyond one as normal deviates have.
    let mut ratios = Vec::new();
    for seed in 100..120 {
        let drift = verdict(&rig(), &rig(), seed);
        for marker in &drift.markers {
            let displacement = marker.displacement.expect("determined");
            ratios.push(displacement.distance_m / displacement.distance_sigma_m);
        }
    }
    // Along its own direction a way in three dimensions is at least as long as a normal deviate and at most as a χ₃ one.
    let mean_square = ratios.iter().map(|ratio| ratio * ratio).sum::<f64>() / ratios.len() as f64;
    assert!((0.8..5.0).contains(&mean_square), "{mean_square}");
}

#[test]
fn a_marker_that_was_moved_is_named_and_how_far() {
    // Every marker, the main one too, which takes the world with it: the others are right about each other.
    for index in 0..5 {
        let mut truth = rig();
        let moved = &mut truth.markers[index].world_from_marker;
        *moved = *moved
            * Pose {
                translation: DVec3::new(0.0016, 0.0012, 0.0),
                ..Pose::identity()
            };
        let drift = verdict(&rig(), &truth, 7);
        let Finding::MarkerMoved { id, displacement, or } = only(&drift) else {
            panic!("{:?}", drift.findings)
        };
        assert_eq!((*id, or.len()), (truth.markers[index].id, 0), "{or:?}");
        let error = (displacement.distance_m - 0.002).abs();
        assert!(
            error < 4.0 * displacement.distance_sigma_m && error < 2e-4,
            "{displacement}"
        );
        assert_eq!(drift.findings[0].routine(), "markers");
    }
}

#[test]
fn two_markers_that_were_moved_are_both_named() {
    let mut truth = rig();
    for (index, way) in [(1, DVec3::X), (3, DVec3::Y)] {
        let moved = &mut truth.markers[index].world_from_marker;
        *moved = *moved
            * Pose {
                translation: 0.002 * way,
                ..Pose::identity()
            };
    }
    let drift = verdict(&rig(), &truth, 8);
    let mut ids: Vec<u32> = drift
        .findings
        .iter()
        .map(|finding| match finding {
            Finding::MarkerMoved { id, .. } => *id,
            other => panic!("{other}"),
        })
        .collect();
    ids.sort_unstable();
    assert_eq!(ids, [1, 3]);
}

#[test]
fn a_fixed_camera_that_was_turned_is_named() {
    let mut truth = rig();
    let place = truth.cameras[1].camera_from_world.expect("fixed");
    let turn = Pose::exp(Twist {
        rotation: DVec3::new(0.3f64.to_radians(), 0.0, 0.0),
        translation: DVec3::ZERO,
    });
    truth.cameras[1].camera_from_world = Some(turn * place);
    let drift = verdict(&rig(), &truth, 9);
    let Finding::CameraMoved {
        camera, displacement, ..
    } = only(&drift)
    else {
        panic!("{:?}", drift.findings)
    };
    assert_eq!(camera, "probe");
    let error_deg = displacement.angle_rad.to_degrees() - 0.3;
    assert!(error_deg.abs() < 0.05, "{displacement}");
    assert_eq!(drift.findings[0].routine(), "extrinsics");
}

#[test]
fn a_lens_that_was_turned_is_named() {
    let mut truth = rig();
    truth.cameras[0].intrinsics.focal_px *= 1.01;
    let drift = verdict(&rig(), &truth, 10);
    let Finding::LensChanged { camera, change, .. } = only(&drift) else {
        panic!("{:?}", drift.findings)
    };
    assert_eq!(camera, "scene");
    let error = (change.focal_ratio - 1.01).abs();
    assert!(error < 4.0 * change.focal_ratio_sigma && error < 2e-3, "{change:?}");
    assert_eq!(drift.findings[0].routine(), "intrinsics");
}

#[test]
fn a_longer_lens_of_a_fixed_camera_may_be_a_step_forward() {
    let mut truth = rig();
    truth.cameras[1].intrinsics.focal_px *= 1.01;
    let drift = verdict(&rig(), &truth, 10);
    let Finding::CameraMoved { camera, or, .. } = only(&drift) else {
        panic!("{:?}", drift.findings)
    };
    assert_eq!(camera, "probe");
    assert!(or[0].starts_with("its focal length by +1."), "{or:?}");
}

#[test]
fn of_two_markers_nobody_knows_which_has_moved() {
    let two = |mut rig: Rig| {
        rig.markers.truncate(2);
        rig
    };
    let mut truth = two(rig());
    truth.markers[1].world_from_marker.translation.x += 0.003;
    let drift = verdict(&two(rig()), &truth, 11);
    let Finding::MarkerMoved { or, .. } = &drift.findings[0] else {
        panic!("{:?}", drift.findings)
    };
    assert!(or.iter().any(|other| other.starts_with("marker `")), "{or:?}");
}

#[test]
fn a_wrong_marker_in_one_picture_is_no_drift() {
    let rig = rig();
    let mut noise = Noise(12);
    let mut check = DriftCheck::new(&rig);
    for i in 0..8 {
        let from = DVec3::new(0.1 * f64::from(i) - 0.4, -0.35, 0.4);
        let pose = looking_at(DVec3::new(0.02, 0.03, 0.0), from);
        let mut seen = detections(&rig, &rig.cameras[0].intrinsics, &pose, &mut noise);
        if i == 3 {
            let wrong = &mut seen[2].corners_px;
            wrong.iter_mut().for_each(|corner| *corner += DVec2::new(40.0, -25.0));
        }
        check.add("scene", &seen);
    }
    let drift = check.verdict(&|_| {}).expect("enough markers");
    assert!(drift.holds(), "{:?}", drift.findings);
}

#[test]
fn without_markers_nothing_is_said() {
    let rig = rig();
    let mut check = DriftCheck::new(&rig);
    check.add("scene", &[]);
    check.add("nobody", &[]);
    let error = check.verdict(&|_| {}).unwrap_err();
    assert_eq!(error, DriftError::TooLittle { pictures: 1 });
    assert!(error.to_string().contains("none of `1` pictures"));
}

#[test]
fn a_rig_that_is_wrong_throughout_is_judged_though_no_picture_has_a_pose() {
    let mut truth = rig();
    for (index, marker) in truth.markers.iter_mut().enumerate() {
        let angle = 1.3 * index as f64;
        let moved = &mut marker.world_from_marker;
        *moved = Pose {
            translation: 0.03 * DVec3::new(angle.cos(), angle.sin(), 0.3 * angle.sin()),
            ..Pose::identity()
        } * *moved;
    }
    let drift = verdict(&rig(), &truth, 3);
    assert!(!drift.holds());
    println!("{} of {} lost, {:?}", drift.lost, drift.pictures, drift.findings);
    assert_eq!((drift.pictures, drift.lost), (12, 12));
}
