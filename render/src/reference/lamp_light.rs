//! Light of a virtual lamp by many rays.

use std::f32::consts::{PI, TAU};

use glam::{Mat3, Vec2, Vec3};

use crate::passes::lamp_light::GpuLamp;
use crate::scene::occluders::Occluders;

/// Irradiance of a lamp on a surface past `occluders`: the mean over `n`² places on the lamp, linear RGB.
#[must_use]
pub fn irradiance(lamp: &GpuLamp, (point_m, normal): (Vec3, Vec3), occluders: &Occluders, n: u32) -> Vec3 {
    let mut sum = 0.0;
    for index in 0..n * n {
        let u = (Vec2::new((index % n) as f32, (index / n) as f32) + 0.5) / n as f32;
        let (to_place, strength) = if lamp.position_m.w == 2.0 {
            on_rectangle(lamp, point_m, u)
        } else {
            on_ball(lamp, point_m, u)
        };
        let cosine = normal.dot(to_place.normalize());
        if cosine > 0.0 && !occluders.blocks(point_m, point_m + to_place) {
            sum += cosine * strength;
        }
    }
    lamp.irradiance.truncate() * sum / (n * n) as f32
}

/// Way to a place on a rectangle, and the irradiance of one that is all at that place, relative to the lamp's.
fn on_rectangle(lamp: &GpuLamp, point_m: Vec3, u: Vec2) -> (Vec3, f32) {
    let at = 2.0 * u - 1.0;
    let place = lamp.position_m.truncate() + at.x * lamp.across.truncate() + at.y * lamp.along.truncate();
    let to_place = place - point_m;
    let ahead = -to_place.normalize().dot(lamp.direction.truncate());
    (to_place, ahead.max(0.0) / to_place.length_squared())
}

/// The same for what is round: radiance is the same all over it, so that places are spread evenly over its solid angle.
fn on_ball(lamp: &GpuLamp, point_m: Vec3, u: Vec2) -> (Vec3, f32) {
    let is_distant = lamp.position_m.w == 1.0;
    let to_middle = if is_distant {
        -1e3 * lamp.direction.truncate()
    } else {
        lamp.position_m.truncate() - point_m
    };
    let distance_m = to_middle.length();
    let (sine, square) = if is_distant {
        (lamp.direction.w, 1.0)
    } else {
        (lamp.direction.w / distance_m, distance_m * distance_m)
    };
    let axis = to_middle / distance_m;
    let ahead = -axis.dot(lamp.direction.truncate());
    let inside = ((ahead - lamp.along.w) / (lamp.across.w - lamp.along.w)).clamp(0.0, 1.0);
    let strength = inside * inside / square;
    if sine == 0.0 {
        return (to_middle, strength);
    }
    let edge_cosine = (1.0 - sine * sine).sqrt();
    let z = 1.0 - u.x * (1.0 - edge_cosine);
    let ring = (1.0 - z * z).max(0.0).sqrt() * Vec2::from_angle(TAU * u.y);
    let (across, along) = axis.any_orthonormal_pair();
    let towards = Mat3::from_cols(across, along, axis) * ring.extend(z);
    // Radiance is irradiance over π sine²; it fills 2π (1 - cosine).
    let radiance = strength / (PI * sine * sine);
    (
        towards * distance_m * (1.0 - sine),
        radiance * TAU * (1.0 - edge_cosine),
    )
}
