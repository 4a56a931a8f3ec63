//! The truth that every shadow of one light is measured against: rays from a surface to places all over the light.

use glam::Vec3;

use crate::scene::occluders::Occluders;
use crate::shadow::light::ShadowLight;

/// How far a ray towards a directional light goes, metres.
const FAR_M: f32 = 1e4;

/// Share of a light that reaches a point on a surface: of the irradiance that it would get without anything in between, what
/// is left, 0 ..= 1. A rectangle is met by `n_per_side`² rays (1 at least), each weighted with the irradiance from its place;
/// other lights by one. 0 where the surface turns away from all of the light.
///
/// The rays leave one millimetre free at both ends ([`Occluders::blocks`]).
#[must_use]
pub fn share_lit(light: &ShadowLight, occluders: &Occluders, (point_m, normal): (Vec3, Vec3), n_per_side: u32) -> f32 {
    let ShadowLight::Rect { half_u_m, half_v_m, .. } = *light else {
        let to_m = light.place_m([0.0; 2], point_m, FAR_M);
        let is_lit = normal.dot(to_m - point_m) > 0.0 && !occluders.blocks(point_m, to_m);
        return f32::from(u8::from(is_lit));
    };
    let axis = half_u_m.cross(half_v_m).normalize_or_zero();
    let n = n_per_side.max(1);
    let (mut lit, mut all) = (0.0f64, 0.0f64);
    for row in 0..n {
        for column in 0..n {
            let to_m = light.place_m(place_in_grid([column, row], n), point_m, FAR_M);
            let weight = irradiance_from(to_m - point_m, normal, axis);
            if weight > 0.0 {
                all += weight;
                if !occluders.blocks(point_m, to_m) {
                    lit += weight;
                }
            }
        }
    }
    if all > 0.0 { (lit / all) as f32 } else { 0.0 }
}

/// Width of the penumbra on a receiver parallel to the light and to the blocker, metres (Fernando 2005): `light_m` is the
/// light's width, distances are measured along its normal from the light.
#[must_use]
pub fn penumbra_width_m(light_m: f32, receiver_m: f32, blocker_m: f32) -> f32 {
    (receiver_m - blocker_m) * light_m / blocker_m
}

/// A place in cell `at` of an n × n grid, -1 ..= 1: one per cell, each in a strip of its own along both axes (the canonical
/// arrangement of Chiu, Shirley, Wang 1994, "Multi-jittered sampling", without jitter).
fn place_in_grid(at: [u32; 2], n: u32) -> [f32; 2] {
    let n = n as f32;
    let [column, row] = at.map(|i| i as f32);
    let within = |cell: f32, other: f32| (cell + (other + 0.5) / n) / n * 2.0 - 1.0;
    [within(column, row), within(row, column)]
}

/// Irradiance on a surface from a small piece of a light that shines along `axis`, `to_light` away: cos cos / distance².
fn irradiance_from(to_light: Vec3, normal: Vec3, axis: Vec3) -> f64 {
    let squared = f64::from(to_light.length_squared());
    let cosines = f64::from(normal.dot(to_light).max(0.0)) * f64::from((-axis.dot(to_light)).max(0.0));
    if squared > 0.0 {
        cosines / (squared * squared)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One square metre 1 m above the floor, with half of it covered at half the height.
    #[test]
    fn half_a_light_is_half_lit() {
        let light = ShadowLight::Rect {
            center_m: Vec3::Z,
            half_u_m: 0.5 * Vec3::X,
            half_v_m: -0.5 * Vec3::Y,
            radiance: Vec3::ONE,
        };
        let corners = [[0.0, -9.0], [9.0, -9.0], [9.0, 9.0], [0.0, 9.0]].map(|[x, y]| Vec3::new(x, y, 0.5));
        let [a, b, c, d] = corners;
        let half = Occluders::new([[a, b, c], [a, c, d]]);
        let surface = (Vec3::ZERO, Vec3::Z);
        assert!((share_lit(&light, &half, surface, 16) - 0.5).abs() < 0.01);
        assert!((share_lit(&light, &Occluders::default(), surface, 4) - 1.0).abs() < 1e-6);
        assert!(share_lit(&light, &Occluders::default(), (Vec3::ZERO, Vec3::NEG_Z), 4) == 0.0);
        // The penumbra of the edge is as wide as the light here.
        let width = penumbra_width_m(1.0, 1.0, 0.5);
        let outer = share_lit(&light, &half, (Vec3::NEG_X * 0.5 * width * 1.01, Vec3::Z), 16);
        let inner = share_lit(&light, &half, (Vec3::X * 0.5 * width * 1.01, Vec3::Z), 16);
        assert!((outer - 1.0).abs() < 1e-6 && inner < 1e-6, "{outer} {inner}");
    }
}
