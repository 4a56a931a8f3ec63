//! A rig for tests, and a camera that takes pictures of its markers.
#![allow(dead_code, reason = "each test program uses its part of this")]

use std::path::Path;

use glam::{DVec2, DVec3};
use mirrorball_calib::{
    camera::Intrinsics,
    pose::{Pose, Twist},
    rig::Rig,
    tag::{Detection, Family},
};

/// A whole rig file: every key, five markers of which two lean, two cameras.
pub(crate) const RIG: &str = include_str!("rig.toml");

/// Upright marker pictures as AprilRobotics prints them, white border included (apriltag-imgs, tag36h11).
const BITMAPS: [(u32, [&str; 10]); 5] = [
    (
        0,
        [
            "..........",
            ".########.",
            ".#..#.#.#.",
            ".##...#.#.",
            ".##..####.",
            ".#.#.####.",
            ".##.#..##.",
            ".####.###.",
            ".########.",
            "..........",
        ],
    ),
    (
        1,
        [
            "..........",
            ".########.",
            ".#..#..##.",
            ".##.#...#.",
            ".#....###.",
            ".##..####.",
            ".#.#..#.#.",
            ".###.##.#.",
            ".########.",
            "..........",
        ],
    ),
    (
        2,
        [
            "..........",
            ".########.",
            ".#..#...#.",
            ".##.##.##.",
            ".#.######.",
            ".###.##.#.",
            ".####.###.",
            ".###...##.",
            ".########.",
            "..........",
        ],
    ),
    (
        3,
        [
            "..........",
            ".########.",
            ".#...##.#.",
            ".####...#.",
            ".#.##...#.",
            ".#.#.##.#.",
            ".#..##.##.",
            ".##..####.",
            ".########.",
            "..........",
        ],
    ),
    (
        586,
        [
            "..........",
            ".########.",
            ".#...#.##.",
            ".#####..#.",
            ".#.#....#.",
            ".#.##.###.",
            ".#.#..#.#.",
            ".#..##..#.",
            ".########.",
            "..........",
        ],
    ),
];

pub(crate) fn rig() -> Rig {
    Rig::from_toml(RIG, Path::new("rig.toml")).expect("the rig of the tests is valid")
}

/// Looks at a point from another one, with the picture's right side turned away from level by `roll_rad`.
pub(crate) fn looking_at(target: DVec3, from: DVec3, roll_rad: f64) -> Pose {
    let forward = (target - from).normalize();
    let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
    let rotation = glam::DMat3::from_cols(right, forward.cross(right), forward).transpose();
    let level = Pose {
        rotation,
        translation: -(rotation * from),
    };
    Pose::exp(Twist {
        rotation: DVec3::Z * roll_rad,
        translation: DVec3::ZERO,
    }) * level
}

/// What an exact detector would report of the rig's markers.
pub(crate) fn exact_detections(rig: &Rig, intrinsics: &Intrinsics, camera_from_world: &Pose) -> Vec<Detection> {
    let corners = |world: [DVec3; 4]| {
        let mut pixels = [DVec2::ZERO; 4];
        for (pixel, point) in pixels.iter_mut().zip(world) {
            *pixel = intrinsics
                .project(camera_from_world.transform_point(point))
                .filter(|p| intrinsics.contains(*p))?;
        }
        Some(pixels)
    };
    rig.markers
        .iter()
        .filter_map(|marker| {
            let corners_px = corners(marker.corners_world())?;
            Some(Detection {
                family: Family::Tag36h11,
                id: marker.id,
                hamming: 0,
                decision_margin: 100.0,
                corners_px,
            })
        })
        .collect()
}

/// Takes an RGB picture of the rig's markers on grey ground: rays through `samples`² points of each pixel.
pub(crate) fn picture(rig: &Rig, camera_from_world: &Pose, samples: u32) -> Vec<u8> {
    let camera = rig.scene_camera();
    let [width, height] = camera.intrinsics.size_px;
    let world_from_camera = camera_from_world.inverse();
    let mut rgb = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let mut light = 0.0;
            for i in 0..samples * samples {
                let offset = DVec2::new(f64::from(i % samples), f64::from(i / samples)) + 0.5;
                let pixel = DVec2::new(f64::from(x), f64::from(y)) - 0.5 + offset / f64::from(samples);
                let ray = camera.intrinsics.unproject(pixel);
                light += ray.map_or(0.0, |ray| radiance(rig, &world_from_camera, ray));
            }
            let code = camera.photometry.response.encode(light / f64::from(samples * samples));
            rgb.extend([code; 3]);
        }
    }
    rgb
}

/// White 0.7, black 0.03, grey 0.2 where there is no marker.
fn radiance(rig: &Rig, world_from_camera: &Pose, ray: DVec3) -> f64 {
    let direction = world_from_camera.transform_vector(ray);
    let is_white = paper(rig, world_from_camera.translation, direction).map(|(_, is_white)| is_white);
    is_white.map_or(0.2, |is_white| if is_white { 0.7 } else { 0.03 })
}

/// The nearest marker's paper that a ray of the world meets: how far away, in lengths of `direction`, and whether it is white
/// there.
pub(crate) fn paper(rig: &Rig, origin: DVec3, direction: DVec3) -> Option<(f64, bool)> {
    let mut nearest: Option<(f64, bool)> = None;
    for marker in &rig.markers {
        let marker_from_world = marker.world_from_marker.inverse();
        let (from, towards) = (
            marker_from_world.transform_point(origin),
            marker_from_world.transform_vector(direction),
        );
        let distance = -from.z / towards.z;
        let cell = (from + towards * distance).truncate() / (marker.side_m / 8.0) + 5.0;
        let inside = cell.cmpge(DVec2::ZERO).all() && cell.cmplt(DVec2::splat(10.0)).all();
        if distance > 1e-9 && inside && nearest.is_none_or(|(before, _)| distance < before) {
            let (_, bitmap) = BITMAPS
                .iter()
                .find(|(id, _)| *id == marker.id)
                .expect("a marker with a bitmap");
            nearest = Some((
                distance,
                bitmap[9 - cell.y as usize].as_bytes()[cell.x as usize] == b'.',
            ));
        }
    }
    nearest
}
