//! What a mirror ball far before the camera shows, texel by texel.

use glam::{Vec2, Vec3};
use mirrorball_calib::pose::Pose;

use crate::passes::sphere_map::SPHERE_MAP_SIZE;

/// Direction in the world that texel (`x`, `y`) of a sphere map shows; texels beyond the rim show what the rim shows.
///
/// The ball's normal there is the half vector between the direction to the eye and the mirrored one (Supan 2006, eq. 2.3).
#[must_use]
pub fn direction(camera_from_world: &Pose, x: u32, y: u32) -> Vec3 {
    let place = (Vec2::new(x as f32, y as f32) + 0.5) / SPHERE_MAP_SIZE as f32 * 2.0 - 1.0;
    let on_ball = place.clamp_length_max(1.0);
    // Camera frame: y down, z forward, so the ball turns its near side to -z.
    let normal = on_ball.extend(-(1.0 - on_ball.length_squared()).max(0.0).sqrt());
    let mirrored = Vec3::Z - 2.0 * normal.dot(Vec3::Z) * normal;
    camera_from_world
        .inverse()
        .transform_vector(mirrored.as_dvec3())
        .as_vec3()
}
