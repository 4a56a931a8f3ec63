//! Markers in pictures that were drawn exactly: ids, corner order, corner error, and pictures without markers.

mod support;

use glam::{DVec2, DVec3};
use mirrorball_calib::{
    resection::locate,
    tag::{Detector, Family, Finder, LumaError, LumaView, PictureError},
};
use support::{exact_detections, looking_at, picture, rig};

/// Corner error that a marker with a side of 30 pixels or more may have, in a picture without noise, in pixels. Eight
/// bits per pixel and six samples across leave about a fiftieth.
const CORNER_TOLERANCE_PX: f64 = 0.1;

#[test]
fn drawn_markers_are_found_where_they_are() {
    let rig = rig();
    let camera = rig.scene_camera();
    let mut finder = Finder::new(&[Family::Tag36h11]);
    let views = [
        looking_at(DVec3::new(0.0, 0.05, 0.0), DVec3::new(0.05, -0.35, 0.45), 0.0),
        looking_at(DVec3::new(0.0, 0.05, 0.0), DVec3::new(-0.3, -0.3, 0.45), 2.0),
    ];
    for (number, pose) in views.iter().enumerate() {
        let rgb = picture(&rig, pose, 6);
        let found = finder.find(&rgb, [640, 480], camera).expect("a picture");
        let exact = exact_detections(&rig, &camera.intrinsics, pose);
        let ids = |detections: &[mirrorball_calib::tag::Detection]| detections.iter().map(|d| d.id).collect::<Vec<_>>();
        assert_eq!(ids(&found), ids(&exact), "view {number}");
        for (found, exact) in found.iter().zip(&exact) {
            assert_eq!((found.hamming, found.family), (0, Family::Tag36h11));
            for (corner, truth) in found.corners_px.iter().zip(exact.corners_px) {
                let error = corner.distance(truth);
                assert!(
                    error < CORNER_TOLERANCE_PX,
                    "view {number}, marker {}: off by {error} px",
                    found.id
                );
            }
        }
        let located = locate(&found, &rig, &camera.intrinsics).expect("a pose");
        let error = located
            .camera_from_world
            .inverse()
            .translation
            .distance(pose.inverse().translation);
        assert!(error < 5e-4, "view {number}: off by {error} m");
        assert_eq!(
            finder.find(&rgb, [640, 480], camera).expect("a picture"),
            found,
            "view {number}, the second time"
        );
    }
}

#[test]
fn pictures_without_markers_have_none() {
    let mut detector = Detector::new(&[Family::Tag36h11]);
    for size in [
        [0, 0],
        [1, 1],
        [3, 500],
        [14, 14],
        [15, 15],
        [16, 33],
        [640, 480],
        [641, 7],
    ] {
        let flat = vec![128; size[0] * size[1]];
        let checkers: Vec<u8> = (0..size[0] * size[1])
            .map(|i| if (i ^ (i / size[0].max(1))) & 1 == 0 { 0 } else { 255 })
            .collect();
        // Numbers without a pattern (Knuth's multiplicative hash).
        let noise: Vec<u8> = (0..size[0] * size[1])
            .map(|i| ((i as u32).wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        for pixels in [flat, checkers, noise] {
            let view = LumaView::new(size, size[0], &pixels).expect("a picture");
            assert!(detector.detect(view).is_empty(), "{view:?}");
        }
    }
}

#[test]
fn a_stride_does_not_matter() {
    let rig = rig();
    let pose = looking_at(DVec3::new(0.0, 0.05, 0.0), DVec3::new(0.05, -0.35, 0.45), 0.0);
    let grey: Vec<u8> = picture(&rig, &pose, 2).chunks_exact(3).map(|pixel| pixel[0]).collect();
    let wide: Vec<u8> = grey
        .chunks_exact(640)
        .flat_map(|row| row.iter().copied().chain([255; 61]))
        .collect();
    let mut detector = Detector::new(&[Family::Tag36h11]);
    let found = detector.detect(LumaView::new([640, 480], 640, &grey).unwrap());
    assert_eq!(found.len(), 5);
    assert_eq!(detector.detect(LumaView::new([640, 480], 701, &wide).unwrap()), found);
    assert!(
        Detector::new(&[])
            .detect(LumaView::new([640, 480], 640, &grey).unwrap())
            .is_empty()
    );
    // A mirrored marker is not a marker.
    let mirrored: Vec<u8> = grey
        .chunks_exact(640)
        .flat_map(|row| row.iter().rev().copied())
        .collect();
    assert!(
        detector
            .detect(LumaView::new([640, 480], 640, &mirrored).unwrap())
            .is_empty()
    );
}

#[test]
fn what_is_no_picture_is_refused() {
    assert_eq!(
        LumaView::new([40_000, 1], 40_000, &[]).unwrap_err(),
        LumaError::TooLarge {
            width: 40_000,
            height: 1,
            stride: 40_000
        }
    );
    assert_eq!(
        LumaView::new([4, 4], 3, &[0; 16]).unwrap_err(),
        LumaError::Stride { row: 4, stride: 3 }
    );
    let error = LumaView::new([4, 4], 5, &[0; 16]).unwrap_err();
    assert_eq!(error.to_string(), "the picture has `16` bytes (needed: `19`)");
    let rig = rig();
    let mut finder = Finder::new(&[Family::Tag36h11]);
    let error = finder.find(&[0; 12], [2, 2], rig.scene_camera()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "a picture of camera `scene` has `2×2` pixels (its rig entry says: `640×480`)"
    );
    let error = finder.find(&[0; 12], [640, 480], rig.scene_camera()).unwrap_err();
    assert!(matches!(error, PictureError::Luma { .. }), "{error}");
}

#[test]
fn corners_run_from_bottom_left_counterclockwise() {
    let rig = rig();
    // Straight from above, the top of the picture being the top of marker 0.
    let pose = looking_at(DVec3::ZERO, DVec3::new(0.0, -1e-6, 0.5), 0.0);
    let rgb = picture(&rig, &pose, 3);
    let found = Finder::new(&[Family::Tag36h11])
        .find(&rgb, [640, 480], rig.scene_camera())
        .expect("a picture");
    let main = found
        .iter()
        .find(|detection| detection.id == 0)
        .expect("the main marker");
    let middle = main.corners_px.iter().sum::<DVec2>() / 4.0;
    let sides = main.corners_px.map(|corner| (corner.x > middle.x, corner.y > middle.y));
    assert_eq!(sides, [(false, true), (true, true), (true, false), (false, false)]);
}
