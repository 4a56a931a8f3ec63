//! The things of the test scene: a toy car, a street sign, the ground with its road, a wall.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Affine3A, Quat, Vec3};

use super::meshes::{BoxSteps, Solid, mesh};
use crate::scene::Mesh;

/// Middle of the road, from the origin, metres.
pub const ROAD_RADIUS_M: f32 = 0.42;
/// Half the road's width, metres.
const HALF_ROAD_M: f32 = 0.125;
/// Half an edge of the ground, metres.
pub const HALF_GROUND_M: f32 = 0.95;
/// Height of the street sign's plate above the ground, metres.
pub const SIGN_HEIGHT_M: f32 = 0.36;

const GLASS: [f32; 3] = [0.06, 0.08, 0.1];
const TYRE: [f32; 3] = [0.03, 0.03, 0.032];
const HUB: [f32; 3] = [0.55, 0.55, 0.57];
const WHITE: [f32; 3] = [0.8, 0.8, 0.78];
const HEADLIGHT: [f32; 3] = [0.85, 0.8, 0.6];
const REAR_LIGHT: [f32; 3] = [0.5, 0.02, 0.02];
const GROUND: [f32; 3] = [0.5, 0.5, 0.42];
const ASPHALT: [f32; 3] = [0.27, 0.27, 0.28];
const SIGN_RED: [f32; 3] = [0.62, 0.03, 0.04];
const METAL: [f32; 3] = [0.42, 0.43, 0.45];

/// A car of 0.3 m that drives towards +x, its wheels on z = 0 below the origin.
#[must_use]
pub fn car(paint: [f32; 3]) -> Mesh {
    let steps = BoxSteps { flat: 2, round: 2 };
    // Narrower towards the top, the bonnet lower than the boot.
    let body = Solid::rounded_box((Vec3::new(0.15, 0.068, 0.031), 0.024), steps, paint)
        .bent(|p| {
            let share = ((p.x - 0.02) / 0.13).clamp(0.0, 1.0) * (p.z / 0.031).max(0.0);
            Vec3::new(p.x, p.y * (1.0 - 1.2 * p.z.max(0.0)), p.z - 0.012 * share)
        })
        .at(Vec3::new(0.0, 0.0, 0.055));
    // Leans in on all sides, most in front.
    let cabin = Solid::rounded_box((Vec3::new(0.083, 0.06, 0.036), 0.016), steps, GLASS)
        .bent(|p| {
            let up = (p.z + 0.036) / 0.072;
            let lean = if p.x > 0.0 { 0.45 } else { 0.25 };
            Vec3::new(p.x * (1.0 - lean * up), p.y * (1.0 - 0.2 * up), p.z)
        })
        .at(Vec3::new(-0.022, 0.0, 0.1));
    let roof = Solid::rounded_box(
        (Vec3::new(0.058, 0.05, 0.008), 0.006),
        BoxSteps { flat: 1, round: 1 },
        paint,
    )
    .at(Vec3::new(-0.03, 0.0, 0.134));
    let mut parts = vec![body, cabin, roof];
    for (x, side) in [(0.092, 1.0), (0.092, -1.0), (-0.092, 1.0), (-0.092, -1.0)] {
        parts.extend(wheel(side).map(|part| part.at(Vec3::new(x, 0.062 * side, 0.034))));
    }
    for side in [1.0, -1.0] {
        let lamp = |color| Solid::sphere(0.012, [8, 3], color);
        parts.push(lamp(HEADLIGHT).at(Vec3::new(0.141, 0.042 * side, 0.056)));
        parts.push(lamp(REAR_LIGHT).at(Vec3::new(-0.142, 0.044 * side, 0.064)));
    }
    mesh(&parts)
}

/// Tyre and hub around the origin, the hub towards `side` of y.
fn wheel(side: f32) -> [Solid; 2] {
    let [radius_m, half_m, bevel_m] = [0.034, 0.015, 0.005];
    let tyre = Solid::lathe(
        &[
            [0.0, -half_m],
            [radius_m - bevel_m, -half_m],
            [radius_m, bevel_m - half_m],
            [radius_m, half_m - bevel_m],
            [radius_m - bevel_m, half_m],
            [0.0, half_m],
        ],
        18,
        TYRE,
    );
    let hub = Solid::lathe(
        &[[0.0, 0.0], [0.018, 0.0], [0.014, half_m + 0.003], [0.0, half_m + 0.003]],
        12,
        HUB,
    );
    let outward = Affine3A::from_quat(Quat::from_rotation_x(-side * FRAC_PI_2));
    [tyre.moved(outward), hub.moved(outward)]
}

/// A warning sign on a pole that stands on the origin and faces -y.
#[must_use]
pub fn street_sign() -> Mesh {
    let pole = Solid::lathe(
        &[
            [0.0, -0.004],
            [0.009, -0.004],
            [0.009, SIGN_HEIGHT_M + 0.05],
            [0.0, SIGN_HEIGHT_M + 0.05],
        ],
        14,
        METAL,
    );
    let foot = Solid::lathe(
        &[[0.0, -0.002], [0.055, -0.002], [0.05, 0.014], [0.0, 0.016]],
        28,
        METAL,
    );
    // A lathe of three sides is a triangle; its point up and its axis towards -y.
    let upright = Affine3A::from_quat(Quat::from_rotation_x(FRAC_PI_2) * Quat::from_rotation_z(FRAC_PI_2));
    let plate = |radius_m: f32, [back_m, front_m]: [f32; 2], color| {
        Solid::lathe(
            &[[0.0, back_m], [radius_m, back_m], [radius_m, front_m], [0.0, front_m]],
            3,
            color,
        )
        .moved(upright)
        .at(Vec3::new(0.0, -0.009, SIGN_HEIGHT_M))
    };
    let stroke = Solid::block(Vec3::new(0.006, 0.002, 0.017), TYRE).at(Vec3::new(0.0, -0.017, SIGN_HEIGHT_M + 0.013));
    let dot = Solid::block(Vec3::new(0.006, 0.002, 0.005), TYRE).at(Vec3::new(0.0, -0.017, SIGN_HEIGHT_M - 0.018));
    mesh(&[
        pole,
        foot,
        plate(0.098, [-0.002, 0.006], SIGN_RED),
        plate(0.066, [0.001, 0.0075], WHITE),
        stroke,
        dot,
    ])
}

/// The ground: a square slab whose upper side is z = 0, a road painted on it.
#[must_use]
pub fn ground() -> Mesh {
    const N_AROUND: u32 = 96;
    let [inner_m, outer_m] = [ROAD_RADIUS_M - HALF_ROAD_M, ROAD_RADIUS_M + HALF_ROAD_M];
    let profile = [
        [0.0, -0.03],
        [HALF_GROUND_M, -0.03],
        [HALF_GROUND_M, 0.0],
        [outer_m, 0.0],
        [ROAD_RADIUS_M + 0.004, 0.0],
        [ROAD_RADIUS_M - 0.004, 0.0],
        [inner_m, 0.0],
        [0.0, 0.0],
    ];
    let paint = |at: Vec3| {
        let radius_m = at.truncate().length();
        let step = (at.y.atan2(at.x) / (2.0 * PI / N_AROUND as f32)).rem_euclid(4.0);
        if at.z < 0.0 || !(inner_m..outer_m).contains(&radius_m) {
            None
        } else if (radius_m - ROAD_RADIUS_M).abs() < 0.0035 && step < 2.0 {
            Some(WHITE)
        } else {
            Some(ASPHALT)
        }
    };
    let square = |p: Vec3| {
        let share = p.truncate().length() / p.truncate().abs().max_element().max(1e-6);
        if p.truncate().length() > outer_m + 0.01 {
            Vec3::new(p.x * share, p.y * share, p.z)
        } else {
            p
        }
    };
    mesh(&[Solid::lathe(&profile, N_AROUND, GROUND).painted(paint).bent(square)])
}

/// A slab of height `height_m` above the ground and a little below it, along x around the origin.
#[must_use]
pub fn wall(height_m: f32, color: [f32; 3]) -> Mesh {
    let foot_m = 0.015;
    let half_m = Vec3::new(HALF_GROUND_M - 0.01, 0.02, 0.5 * (height_m + foot_m));
    mesh(&[Solid::block(half_m, color).at(Vec3::new(0.0, 0.0, 0.5 * (height_m - foot_m)))])
}

#[cfg(test)]
mod tests {
    use super::super::meshes::check::{assert_closed, assert_outward};
    use super::*;

    #[test]
    fn toys_are_closed_and_of_the_right_size() {
        for (name, mesh, n_triangles, size_m) in [
            ("car", car([0.6, 0.1, 0.1]), 1000..2000, Vec3::new(0.31, 0.16, 0.142)),
            ("sign", street_sign(), 100..400, Vec3::new(0.17, 0.11, 0.47)),
            ("ground", ground(), 1000..1500, Vec3::new(1.9, 1.9, 0.03)),
            ("wall", wall(0.6, [0.5; 3]), 12..13, Vec3::new(1.88, 0.04, 0.615)),
        ] {
            assert_closed(name, &mesh);
            assert_outward(name, &mesh);
            let n = mesh.indices.len() / 3;
            assert!(n_triangles.contains(&n), "{name}: {n} triangles");
            let points = || mesh.vertices.iter().map(|v| Vec3::from(v.position));
            let extent = points().reduce(Vec3::max).unwrap() - points().reduce(Vec3::min).unwrap();
            assert!((extent - size_m).abs().max_element() < 0.02, "{name}: {extent}");
        }
    }
}
