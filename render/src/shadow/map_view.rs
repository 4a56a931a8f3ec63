//! How a light sees what casts shadows: one map, or the six faces of a cube around a light in the middle of things.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use super::casters::Casters;
use super::light::ShadowLight;
use crate::shadow::shadow_view::{Sphere, basis};

/// Tangent of the widest half angle from a rectangle's normal that its map shows, 76 degrees: what is cut off beyond is
/// 6 % of its light. There the map's edge goes on.
const WIDEST_TANGENT: f32 = 4.0;
/// A point light nearer to the middle of the casters than this many radii gets a cube: one map would be wider than 90
/// degrees and coarse.
const CUBE_DISTANCE: f32 = 1.4;
/// A cone wider than this (tangent of its half angle) gets a cube.
const CUBE_TANGENT: f32 = 2.0;
/// Texels beyond a cube's edges, for the widest filter.
const CUBE_RIM_PX: f32 = 5.0;
/// Nearest distance that a light inside the casters draws, as a share of the farthest.
const NEAREST: f32 = 1e-3;

/// A map's axes and extent, as the shaders take it too (`MapView` in `shared/map_view.wgsl`). World frame, metres.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct MapView {
    /// xyz: where the light stands; w: 0 perspective, 1 orthographic.
    pub position_m: Vec4,
    /// xyz: unit axis to the right in the map; w: half its width, in a perspective at distance 1 m.
    pub right: Vec4,
    /// xyz: unit axis upward in the map; w: half its height.
    pub up: Vec4,
    /// xyz: unit direction of view; w: near plane.
    pub forward: Vec4,
    /// x, y: middle of the map along its axes, in a perspective at distance 1 m; z: far plane; w: 1 where the map's edge
    /// goes on outside, 0 where nothing outside is in shadow.
    pub middle: Vec4,
}

/// The views of a light, from its middle, onto everything that can cast a shadow, for maps of `size_px` texels: one, or six
/// along +x, -x, +y, -y, +z and -z.
#[must_use]
pub fn map_views(light: &ShadowLight, casters: &Casters, size_px: u32) -> Vec<MapView> {
    let bounds = casters.bounds();
    match *light {
        ShadowLight::Directional { towards, .. } => vec![parallel(towards, bounds)],
        ShadowLight::Point { position_m, .. } => match around(position_m, bounds) {
            Some(view) => vec![view],
            None => cube(position_m, bounds, size_px),
        },
        ShadowLight::Spot {
            position_m,
            axis,
            cone_rad: [_, outer_rad],
            ..
        } => {
            let tangent = outer_rad.tan();
            let is_cone = tangent > 0.0 && tangent <= CUBE_TANGENT;
            match around(position_m, bounds) {
                Some(view) if !is_cone || view.right.w <= tangent => vec![view],
                _ if is_cone => vec![cone(position_m, (axis, outer_rad), bounds)],
                _ => cube(position_m, bounds, size_px),
            }
        }
        ShadowLight::Rect {
            center_m,
            half_u_m,
            half_v_m,
            ..
        } => vec![from_rectangle(center_m, [half_u_m, half_v_m], &boxes(casters), size_px)],
    }
}

/// Corners of the boxes around the casters, world frame, metres.
#[must_use]
pub fn boxes(casters: &Casters) -> Vec<[Vec3; 8]> {
    casters.objects.iter().map(super::casters::Caster::corners).collect()
}

/// The view from a place on a rectangle onto what of the boxes is in front of it: parallel to the rectangle with the sides'
/// directions as axes, fitted to the boxes as far as `WIDEST_TANGENT`.
#[must_use]
pub fn from_rectangle(place_m: Vec3, [u, v]: [Vec3; 2], boxes: &[[Vec3; 8]], size_px: u32) -> MapView {
    let forward = u.cross(v).normalize_or(Vec3::NEG_Z);
    let right = u.normalize_or(basis(forward)[0]);
    let up = forward.cross(right);
    let seen = |corner: &Vec3| {
        let offset = *corner - place_m;
        Vec3::new(offset.dot(right), offset.dot(up), offset.dot(forward))
    };
    let far_m = boxes.iter().flatten().map(|corner| seen(corner).z).fold(1e-3, f32::max);
    let nearest_m = NEAREST * far_m;
    let (mut low, mut high, mut near_m) = (Vec3::splat(WIDEST_TANGENT), Vec3::splat(-WIDEST_TANGENT), far_m);
    for corners in boxes {
        let corners = corners.map(|corner| seen(&corner));
        if corners.iter().all(|corner| corner.z <= nearest_m) {
            continue;
        }
        for corner in corners {
            let distance_m = corner.z.max(nearest_m);
            let tangents = (corner / distance_m).clamp(Vec3::splat(-WIDEST_TANGENT), Vec3::splat(WIDEST_TANGENT));
            (low, high, near_m) = (low.min(tangents), high.max(tangents), near_m.min(distance_m));
        }
    }
    if low.x > high.x {
        // Nothing in front.
        (low, high) = (Vec3::NEG_ONE, Vec3::ONE);
    }
    // A rim, so that the edge of a map that holds everything is empty.
    let rim = 2.0 / size_px.max(8) as f32 * (high - low).max(Vec3::splat(1e-3));
    let widest = Vec3::splat(WIDEST_TANGENT);
    (low, high) = ((low - rim).max(-widest), (high + rim).min(widest));
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    MapView {
        position_m: place_m.extend(0.0),
        right: right.extend(half.x),
        up: up.extend(half.y),
        forward: forward.extend(0.99 * near_m),
        middle: Vec4::new(middle.x, middle.y, 1.01 * far_m, 1.0),
    }
}

/// A directional light's view onto a sphere.
fn parallel(towards: Vec3, bounds: Sphere) -> MapView {
    let radius_m = bounds.radius_m.max(1e-3);
    let forward = (-towards).normalize_or(Vec3::NEG_Z);
    let [right, up] = basis(forward);
    MapView {
        position_m: (bounds.center_m - 2.0 * radius_m * forward).extend(1.0),
        right: right.extend(radius_m),
        up: up.extend(radius_m),
        forward: forward.extend(0.99 * radius_m),
        middle: Vec4::new(0.0, 0.0, 3.01 * radius_m, 0.0),
    }
}

/// A view onto a sphere from well outside it; `None` from near or inside.
fn around(position_m: Vec3, bounds: Sphere) -> Option<MapView> {
    let to_middle = bounds.center_m - position_m;
    let (distance_m, radius_m) = (to_middle.length(), bounds.radius_m.max(1e-3));
    if distance_m < CUBE_DISTANCE * radius_m {
        return None;
    }
    let sine = radius_m / distance_m;
    Some(perspective(
        (position_m, to_middle / distance_m),
        sine / (1.0 - sine * sine).sqrt(),
        [0.99 * (distance_m - radius_m), 1.01 * (distance_m + radius_m)],
    ))
}

/// A spot light's view of its cone.
fn cone(position_m: Vec3, (axis, outer_rad): (Vec3, f32), bounds: Sphere) -> MapView {
    let distance_m = position_m.distance(bounds.center_m);
    let far_m = distance_m + bounds.radius_m.max(1e-3);
    let near_m = (0.99 * (distance_m - bounds.radius_m) * outer_rad.cos()).max(NEAREST * far_m);
    let axis = axis.normalize_or(Vec3::NEG_Z);
    perspective((position_m, axis), outer_rad.tan(), [near_m, 1.01 * far_m])
}

fn cube(position_m: Vec3, bounds: Sphere, size_px: u32) -> Vec<MapView> {
    let far_m = position_m.distance(bounds.center_m) + bounds.radius_m.max(1e-3);
    let size_px = size_px.max(16) as f32;
    let tangent = size_px / (size_px - 2.0 * CUBE_RIM_PX);
    [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z]
        .map(|forward| perspective((position_m, forward), tangent, [NEAREST * far_m, 1.01 * far_m]))
        .to_vec()
}

fn perspective((position_m, forward): (Vec3, Vec3), tangent: f32, [near_m, far_m]: [f32; 2]) -> MapView {
    let [right, up] = basis(forward);
    MapView {
        position_m: position_m.extend(0.0),
        right: right.extend(tangent),
        up: up.extend(tangent),
        forward: forward.extend(near_m),
        middle: Vec4::new(0.0, 0.0, far_m, 0.0),
    }
}

impl MapView {
    /// Normalised device coordinates of a world point: x, y in -1 ..= 1 inside the map, z in 0 ..= 1. The CPU twin of
    /// `map_clip`.
    #[must_use]
    pub fn project(&self, point_m: Vec3) -> Vec3 {
        let offset = point_m - self.position_m.truncate();
        let [x, y, z] = [self.right, self.up, self.forward].map(|axis| axis.truncate().dot(offset));
        let (near_m, far_m) = (self.forward.w, self.middle.z);
        if self.position_m.w > 0.5 {
            return Vec3::new(x / self.right.w, y / self.up.w, (z - near_m) / (far_m - near_m));
        }
        Vec3::new(
            (x / z - self.middle.x) / self.right.w,
            (y / z - self.middle.y) / self.up.w,
            far_m / (far_m - near_m) * (1.0 - near_m / z),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Sphere = Sphere {
        center_m: Vec3::new(0.2, -0.1, 0.3),
        radius_m: 0.5,
    };

    fn on_sphere() -> impl Iterator<Item = Vec3> {
        (0..200).map(|i| {
            let (z, angle) = ((i as f32 + 0.5) / 100.0 - 1.0, 2.4 * i as f32);
            let radius = (1.0 - z * z).sqrt();
            BOUNDS.center_m + BOUNDS.radius_m * Vec3::new(radius * angle.cos(), radius * angle.sin(), z)
        })
    }

    #[test]
    fn one_map_holds_the_casters() {
        let views = [
            parallel(Vec3::new(0.6, 0.0, 0.8), BOUNDS),
            around(Vec3::new(1.0, 1.0, 2.0), BOUNDS).unwrap(),
        ];
        for view in views {
            let mut widest = 0.0f32;
            for point in on_sphere() {
                let ndc = view.project(point);
                assert!(ndc.truncate().abs().max_element() < 1.001, "{view:?}: {ndc}");
                assert!((0.0..=1.0).contains(&ndc.z), "{view:?}: {ndc}");
                widest = widest.max(ndc.truncate().abs().max_element());
            }
            assert!(widest > 0.95, "{view:?}: {widest}");
        }
    }

    #[test]
    fn a_light_inside_gets_a_cube_that_sees_everything() {
        let light_m = BOUNDS.center_m + Vec3::splat(0.1);
        assert_eq!(around(light_m, BOUNDS), None);
        let views = cube(light_m, BOUNDS, 512);
        for point in on_sphere() {
            let n_seeing = views.iter().filter(|view| {
                let ndc = view.project(point);
                view.forward.truncate().dot(point - light_m) > 0.0
                    && ndc.truncate().abs().max_element() < 1.0
                    && (0.0..=1.0).contains(&ndc.z)
            });
            assert!(n_seeing.count() >= 1, "{point}");
        }
    }

    #[test]
    fn a_rectangles_map_fits_what_is_in_front_of_it() {
        let corners: [Vec3; 8] = std::array::from_fn(|i| {
            let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
            Vec3::new(0.5 + 0.2 * sign(0), 0.1 * sign(1), 0.1 * sign(2))
        });
        let behind = corners.map(|corner| corner + 5.0 * Vec3::Z);
        let sides = [Vec3::X, Vec3::NEG_Y].map(|side| 0.2 * side);
        let view = from_rectangle(2.0 * Vec3::Z, sides, &[corners, behind], 1024);
        assert_eq!(view.forward.truncate(), Vec3::NEG_Z);
        let all = corners.map(|corner| view.project(corner));
        let widest = all.iter().fold(Vec3::ZERO, |widest, ndc| widest.max(ndc.abs()));
        assert!(
            widest.max_element() < 1.0 && widest.x > 0.98 && widest.y > 0.98,
            "{widest}"
        );
    }

    #[test]
    fn a_rectangle_between_walls_sees_as_far_as_the_widest_angle() {
        let wall: [Vec3; 8] =
            std::array::from_fn(|i| Vec3::new(1.0, 3.0 * (i & 1) as f32 - 1.5, 3.0 * (i >> 1 & 1) as f32));
        let view = from_rectangle(2.0 * Vec3::Z, [Vec3::X, Vec3::NEG_Y], &[wall], 1024);
        assert!((view.middle.x + view.right.w - WIDEST_TANGENT).abs() < 1e-5);
        assert!(view.project(Vec3::new(1.0, 0.0, 0.5)).is_finite());
        let none = from_rectangle(2.0 * Vec3::Z, [Vec3::ZERO; 2], &[], 1024);
        assert!(none.project(Vec3::ZERO).is_finite());
    }
}
