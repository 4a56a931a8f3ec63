//! How a light of a dome sees what its depth map shows.

use glam::Vec3;

/// A sphere, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Centre.
    pub center_m: Vec3,
    /// Radius.
    pub radius_m: f32,
}

/// A light's view of the receivers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShadowView {
    /// The light, world, metres.
    pub position_m: Vec3,
    /// The map's axes and the direction of view, unit, world.
    pub axes: [Vec3; 3],
    /// Tangent of half the opening angle.
    pub tangent: f32,
    /// Near and far plane, metres.
    pub depth_m: [f32; 2],
    /// Size of a texel in the middle of the receivers, metres.
    pub texel_m: f32,
}

impl ShadowView {
    /// The view from `position_m` that just holds `receivers` and is as deep as `everything`, in a map of `map_size` texels.
    #[must_use]
    pub fn new(position_m: Vec3, (receivers, everything): (Sphere, Sphere), map_size: u32) -> Self {
        let to_middle = receivers.center_m - position_m;
        // A light inside the sphere looks at it with a wide angle instead of none.
        let distance = to_middle.length().max(1.05 * receivers.radius_m);
        let forward = to_middle.normalize_or(Vec3::NEG_Z);
        let [right, up] = basis(forward);
        let ratio = receivers.radius_m / distance;
        let tangent = ratio / (1.0 - ratio * ratio).sqrt();
        let middle = (everything.center_m - position_m).dot(forward);
        let near_m = (middle - everything.radius_m).max(0.02 * distance);
        let far_m = (middle + everything.radius_m).max(1.01 * near_m + 1e-3);
        Self {
            position_m,
            axes: [right, up, forward],
            tangent,
            depth_m: [near_m, far_m],
            texel_m: 2.0 * tangent * distance / map_size as f32,
        }
    }

    /// Normalised device coordinates of a world point: x, y in -1 ..= 1 inside the map, z in 0 ..= 1.
    #[must_use]
    pub fn project(&self, point_m: Vec3) -> Vec3 {
        let [x, y, z] = self.axes.map(|axis| axis.dot(point_m - self.position_m));
        let [near, far] = self.depth_m;
        Vec3::new(
            x / (self.tangent * z),
            y / (self.tangent * z),
            far * (z - near) / ((far - near) * z),
        )
    }
}

/// Two unit vectors that make a right-handed frame with `forward` (Duff et al. 2017, "Building an orthonormal basis,
/// revisited").
pub(crate) fn basis(forward: Vec3) -> [Vec3; 2] {
    let sign = if forward.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + forward.z);
    let b = forward.x * forward.y * a;
    [
        Vec3::new(1.0 + sign * forward.x * forward.x * a, sign * b, -sign * forward.x),
        Vec3::new(b, sign + forward.y * forward.y * a, -forward.y),
    ]
}

/// Smallest-ish sphere around spheres: centred on the middle of their bounding box. `None` without any.
#[must_use]
pub fn enclosing(spheres: &[Sphere]) -> Option<Sphere> {
    let low = spheres.iter().map(|s| s.center_m - s.radius_m).reduce(Vec3::min)?;
    let high = spheres.iter().map(|s| s.center_m + s.radius_m).reduce(Vec3::max)?;
    let center_m = 0.5 * (low + high);
    let radius_m = spheres
        .iter()
        .map(|s| s.center_m.distance(center_m) + s.radius_m)
        .fold(0.0, f32::max);
    Some(Sphere { center_m, radius_m })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_receivers_fill_the_map(
            x in -1.0f32..1.0, y in -1.0f32..1.0, z in 0.3f32..2.0, dx in -1.0f32..1.0, dy in -1.0f32..1.0, dz in -1.0f32..1.0,
        ) {
            let receivers = Sphere { center_m: Vec3::new(0.1, 0.2, 0.0), radius_m: 0.2 };
            let casters = Sphere { center_m: Vec3::ZERO, radius_m: 0.5 };
            let view = ShadowView::new(receivers.center_m + Vec3::new(x, y, z), (receivers, casters), 512);
            let off = Vec3::new(dx, dy, dz);
            prop_assume!(off.length() > 0.01);
            let ndc = view.project(receivers.center_m + off.normalize() * receivers.radius_m);
            prop_assert!(ndc.x.abs() < 1.01 && ndc.y.abs() < 1.01, "{ndc}");
            prop_assert!(ndc.z > 0.0 && ndc.z < 1.0, "{ndc}");
            prop_assert!(view.texel_m > 2.0 * receivers.radius_m / 512.0 * 0.99);
        }
    }

    #[test]
    fn nearer_is_smaller_in_depth() {
        let sphere = Sphere {
            center_m: Vec3::ZERO,
            radius_m: 0.3,
        };
        let view = ShadowView::new(Vec3::Z, (sphere, sphere), 512);
        assert!(view.project(Vec3::new(0.0, 0.0, 0.1)).z < view.project(Vec3::ZERO).z);
    }

    #[test]
    fn an_enclosing_sphere_holds_all() {
        let spheres = [
            Sphere {
                center_m: Vec3::X,
                radius_m: 0.1,
            },
            Sphere {
                center_m: Vec3::NEG_X,
                radius_m: 0.3,
            },
        ];
        let all = enclosing(&spheres).unwrap();
        for s in spheres {
            assert!(s.center_m.distance(all.center_m) + s.radius_m <= all.radius_m + 1e-6);
        }
        assert_eq!(enclosing(&[]), None);
    }
}
