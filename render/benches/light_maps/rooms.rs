//! Environments made by formula.

use glam::Vec3;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_render::passes::ENVIRONMENT_SIZE;

/// Towards the lamp, not along any axis.
pub(crate) const LAMP: Vec3 = Vec3::new(0.48, -0.36, 0.8);
/// Its radius: 1.5°.
const LAMP_RADIUS_RAD: f32 = 0.026;

/// Name and radiance of all environments.
pub(crate) fn all() -> [(&'static str, Cube<Vec3>); 3] {
    [
        ("smooth room", cube_of(room)),
        ("room with a lamp of 10,000 times the mean", cube_of(lamp_room)),
        ("overcast window", cube_of(window)),
    ]
}

fn cube_of(radiance: fn(Vec3) -> Vec3) -> Cube<Vec3> {
    let mut cube = Cube::filled(ENVIRONMENT_SIZE, Vec3::ZERO);
    for index in 0..cube.texels().len() {
        let value = radiance(cube.direction(index));
        cube.texels_mut()[index] = value;
    }
    cube
}

/// Coloured walls that run into each other.
fn room(d: Vec3) -> Vec3 {
    let wave = (3.0 * d.x).sin() + (4.0 * d.y + d.z).cos();
    Vec3::new(2.0 + wave, 2.2 - 0.6 * wave, 1.5 + 0.5 * (5.0 * d.z).sin())
}

fn lamp_room(d: Vec3) -> Vec3 {
    if d.angle_between(LAMP) < LAMP_RADIUS_RAD {
        Vec3::new(20_000.0, 18_000.0, 14_000.0)
    } else {
        room(d)
    }
}

/// A dim room with a window 50° wide and 40° high, bright at its top, with a cross of bars.
fn window(d: Vec3) -> Vec3 {
    let (across, up) = (d.y.atan2(d.x), d.z.asin());
    let is_inside = across.abs() < 0.44 && (up - 0.3).abs() < 0.35;
    let is_bar = across.abs() < 0.02 || (up - 0.3).abs() < 0.02;
    if is_inside && !is_bar {
        Vec3::new(0.9, 1.0, 1.15) * (20.0 + 30.0 * (up + 0.1))
    } else {
        Vec3::new(0.3, 0.27, 0.22) * (1.0 + 0.5 * d.z)
    }
}
