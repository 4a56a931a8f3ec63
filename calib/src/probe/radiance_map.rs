//! Probe picture to radiance cube: every direction asks the picture, exactly, for a light at finite distance.
//!
//! The render node does the same on the GPU (its pass `radiance_map`); this is the plain version, for single pictures and
//! to compare with.

use glam::{DVec2, DVec3, Vec3, Vec4};

use super::cube::{Cube, FACES, face_direction};
use super::{ProbeOptics, Trust, View};
use crate::camera::LensModel;

/// The cube that `view` of the probe shows, with `near_m` the distance to the first phantom in every direction and
/// `room_m` that of everything else, metres.
///
/// rgb: radiance; a: 0 not seen, else 1 plus the bits of channels clipped anywhere plus 8 times those clipped everywhere.
#[must_use]
pub fn cube(view: &View<'_>, optics: &ProbeOptics, trust: &Trust, near_m: &Cube<f32>, room_m: f32) -> Cube<Vec4> {
    let size = near_m.size();
    let mut cube = Cube::filled(size, Vec4::ZERO);
    for face in 0..FACES {
        for y in 0..size {
            for x in 0..size {
                let index = (face * size as usize + y as usize) * size as usize + x as usize;
                let distance_m = near_m.texels()[index].min(room_m);
                let places = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)].map(|(dx, dy)| {
                    let at = |t: u32, d: f32| (t as f32 + d) / size as f32 * 2.0 - 1.0;
                    let direction = face_direction(face, at(x, dx), at(y, dy)).as_dvec3().normalize();
                    pixel(view, optics, trust, direction * f64::from(distance_m))
                });
                cube.texels_mut()[index] = texel(view, optics, places);
            }
        }
    }
    cube
}

/// Pixel that shows the light at `offset_m` from the probe.
fn pixel(view: &View<'_>, optics: &ProbeOptics, trust: &Trust, offset_m: DVec3) -> Option<DVec2> {
    let point_m = match optics {
        ProbeOptics::MirrorBall { ball, .. } => {
            let camera_m = view.camera_from_world.inverse().translation;
            let to_camera = camera_m - ball.center_m;
            let own_image = (f64::from(trust.camera_radius_m) / to_camera.length().max(1e-3))
                .min(1.0)
                .asin();
            if offset_m.angle_between(to_camera) < own_image {
                return None;
            }
            let glint = ball.glint(camera_m, offset_m.normalize(), offset_m.length())?;
            if glint.view_cosine < f64::from(trust.min_view_cosine) {
                return None;
            }
            glint.point_m
        }
        ProbeOptics::Fisheye { lens_m } => *lens_m + offset_m,
    };
    let in_camera = view.camera_from_world.transform_point(point_m);
    let pixel = view.camera.intrinsics.project(in_camera)?;
    match view.camera.intrinsics.lens {
        LensModel::BrownConrady { .. } => Some(pixel),
        // Two pixels of the rim are left out: beyond it the picture is black.
        LensModel::KannalaBrandt { max_angle_rad, .. } => {
            let rim_rad = max_angle_rad - 2.0 / view.camera.intrinsics.focal_px.x;
            (in_camera.angle_between(DVec3::Z) <= rim_rad).then_some(pixel)
        }
    }
}

/// Mean over the places of a texel that the picture shows, if it shows at least half of them.
fn texel(view: &View<'_>, optics: &ProbeOptics, places: [Option<DVec2>; 4]) -> Vec4 {
    let reflectance = match optics {
        ProbeOptics::MirrorBall { reflectance, .. } => *reflectance,
        ProbeOptics::Fisheye { .. } => Vec3::ONE,
    };
    let (mut sum, mut n_seen, mut clipped, mut all_clipped) = (Vec3::ZERO, 0, 0, 7);
    for pixel in places.into_iter().flatten() {
        if let Some(sample) = view.picture.sample(pixel) {
            sum += sample.radiance;
            n_seen += 1;
            clipped |= sample.clipped;
            all_clipped &= clipped_everywhere(view, pixel);
        }
    }
    if n_seen < 2 {
        return Vec4::ZERO;
    }
    (sum / (n_seen as f32 * reflectance)).extend(1.0 + f32::from(clipped | (all_clipped << 3)))
}

/// Channels that clip in every pixel that bilinear sampling at `pixel` reads.
fn clipped_everywhere(view: &View<'_>, pixel: DVec2) -> u8 {
    let low = pixel.floor();
    let high = pixel.ceil();
    [low, DVec2::new(high.x, low.y), DVec2::new(low.x, high.y), high]
        .into_iter()
        .filter_map(|corner| view.picture.sample(corner))
        .fold(7, |bits, sample| bits & sample.clipped)
}
