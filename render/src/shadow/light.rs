//! The one light whose shadow the one-light methods draw.

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec3, Vec4};

use crate::shadow::shadow_view::{Sphere, basis};

/// A light that casts shadows. World frame, metres, linear RGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ShadowLight {
    /// Shines in all directions from one place.
    Point {
        /// Where it stands.
        position_m: Vec3,
        /// Radiant intensity, watts per steradian.
        intensity: Vec3,
    },
    /// Shines into a cone from one place.
    Spot {
        /// Where it stands.
        position_m: Vec3,
        /// Unit axis of the cone, away from the light.
        axis: Vec3,
        /// Half angles of the cone within which it shines fully and beyond which not at all, radians, below π/2.
        cone_rad: [f32; 2],
        /// Radiant intensity on the axis, watts per steradian.
        intensity: Vec3,
    },
    /// Shines from infinitely far away.
    Directional {
        /// Unit direction towards the light.
        towards: Vec3,
        /// Irradiance on a surface that faces it.
        irradiance: Vec3,
    },
    /// A rectangle that shines to one side.
    Rect {
        /// Its middle.
        center_m: Vec3,
        /// Half its sides, perpendicular; it shines towards `half_u_m` × `half_v_m`.
        half_u_m: Vec3,
        /// The other half side.
        half_v_m: Vec3,
        /// Radiance, the same in all directions.
        radiance: Vec3,
    },
}

/// A light as the shaders take it (`KeyLight` in `shared/key_light.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuShadowLight {
    /// xyz: its place (middle of a rectangle), metres; w: 0 point, 1 spot, 2 directional, 3 rectangle.
    pub position_m: Vec4,
    /// xyz: half side of a rectangle, axis of a spot, direction towards a directional light; w: cosine of a spot's inner
    /// angle.
    pub u: Vec4,
    /// xyz: other half side of a rectangle; w: cosine of a spot's outer angle.
    pub v: Vec4,
    /// xyz: intensity, irradiance or radiance, linear RGB; w: unused.
    pub power: Vec4,
}

/// How a light sees what it shines on: an orthographic view for a directional light, perspective for all others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightView {
    /// World to clip coordinates: x, y in -1 ..= 1, depth 0 at the near plane and 1 at the far one.
    pub clip_from_world: Mat4,
    /// Where the light stands; far away along its direction for a directional light.
    pub position_m: Vec3,
    /// Near and far plane, metres along the direction of view.
    pub depth_m: [f32; 2],
    /// Width of the map, metres, at distance 1 m for a perspective view, at any for an orthographic one.
    pub width_m: f32,
}

impl ShadowLight {
    /// The same as the shaders take it.
    #[must_use]
    pub fn to_gpu(&self) -> GpuShadowLight {
        let (position, kind, u, v, power) = match *self {
            Self::Point { position_m, intensity } => (position_m, 0.0, Vec4::ZERO, Vec4::ZERO, intensity),
            Self::Spot {
                position_m,
                axis,
                cone_rad: [inner, outer],
                intensity,
            } => (
                position_m,
                1.0,
                axis.extend(inner.cos()),
                Vec3::ZERO.extend(outer.cos()),
                intensity,
            ),
            Self::Directional { towards, irradiance } => (Vec3::ZERO, 2.0, towards.extend(0.0), Vec4::ZERO, irradiance),
            Self::Rect {
                center_m,
                half_u_m,
                half_v_m,
                radiance,
            } => (center_m, 3.0, half_u_m.extend(0.0), half_v_m.extend(0.0), radiance),
        };
        GpuShadowLight {
            position_m: position.extend(kind),
            u,
            v,
            power: power.extend(0.0),
        }
    }

    /// A place on the light: `at` in -1 ..= 1 over a rectangle's two sides; other lights have one place only, a
    /// directional one `far_m` away from `seen_from_m`.
    #[must_use]
    pub fn place_m(&self, at: [f32; 2], seen_from_m: Vec3, far_m: f32) -> Vec3 {
        match *self {
            Self::Point { position_m, .. } | Self::Spot { position_m, .. } => position_m,
            Self::Directional { towards, .. } => seen_from_m + far_m * towards,
            Self::Rect {
                center_m,
                half_u_m,
                half_v_m,
                ..
            } => center_m + at[0] * half_u_m + at[1] * half_v_m,
        }
    }

    /// Its place, homogeneous: `(x, y, z, 1)`, the middle of a rectangle; `(x, y, z, 0)` towards a directional light.
    #[must_use]
    pub fn homogeneous(&self) -> Vec4 {
        match *self {
            Self::Point { position_m, .. } | Self::Spot { position_m, .. } => position_m.extend(1.0),
            Self::Directional { towards, .. } => towards.extend(0.0),
            Self::Rect { center_m, .. } => center_m.extend(1.0),
        }
    }

    /// The view from a place on the light (see [`ShadowLight::place_m`]) onto everything inside `bounds`.
    ///
    /// A light inside the sphere looks at its middle with at most 150 degrees.
    #[must_use]
    pub fn view(&self, at: [f32; 2], bounds: Sphere) -> LightView {
        /// Sine of half of 150 degrees.
        const WIDEST_SINE: f32 = 0.966;
        let radius_m = bounds.radius_m.max(1e-3);
        let position_m = self.place_m(at, bounds.center_m, 4.0 * radius_m);
        let forward = (bounds.center_m - position_m).normalize_or(Vec3::NEG_Z);
        let [right, up] = basis(forward);
        let distance_m = position_m.distance(bounds.center_m);
        let far_m = distance_m + radius_m;
        let near_m = (distance_m - radius_m).max(0.01 * far_m);
        let view_from_world = Mat4::from_cols(
            Vec4::new(right.x, up.x, forward.x, 0.0),
            Vec4::new(right.y, up.y, forward.y, 0.0),
            Vec4::new(right.z, up.z, forward.z, 0.0),
            Vec4::new(
                -right.dot(position_m),
                -up.dot(position_m),
                -forward.dot(position_m),
                1.0,
            ),
        );
        let depth = far_m - near_m;
        let (clip_from_view, width_m) = if matches!(self, Self::Directional { .. }) {
            let projection = Mat4::from_cols(
                Vec4::new(1.0 / radius_m, 0.0, 0.0, 0.0),
                Vec4::new(0.0, 1.0 / radius_m, 0.0, 0.0),
                Vec4::new(0.0, 0.0, 1.0 / depth, 0.0),
                Vec4::new(0.0, 0.0, -near_m / depth, 1.0),
            );
            (projection, 2.0 * radius_m)
        } else {
            let sine = (radius_m / distance_m.max(1e-6)).min(WIDEST_SINE);
            let tangent = sine / (1.0 - sine * sine).sqrt();
            let projection = Mat4::from_cols(
                Vec4::new(1.0 / tangent, 0.0, 0.0, 0.0),
                Vec4::new(0.0, 1.0 / tangent, 0.0, 0.0),
                Vec4::new(0.0, 0.0, far_m / depth, 1.0),
                Vec4::new(0.0, 0.0, -far_m * near_m / depth, 0.0),
            );
            (projection, 2.0 * tangent)
        };
        LightView {
            clip_from_world: clip_from_view * view_from_world,
            position_m,
            depth_m: [near_m, far_m],
            width_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Sphere = Sphere {
        center_m: Vec3::new(0.2, -0.1, 0.3),
        radius_m: 0.5,
    };

    fn lights() -> [ShadowLight; 3] {
        [
            ShadowLight::Point {
                position_m: Vec3::new(1.0, 1.0, 2.0),
                intensity: Vec3::ONE,
            },
            ShadowLight::Directional {
                towards: Vec3::new(0.6, 0.0, 0.8),
                irradiance: Vec3::ONE,
            },
            ShadowLight::Rect {
                center_m: Vec3::new(-1.0, 0.5, 1.5),
                half_u_m: Vec3::new(0.2, 0.0, 0.0),
                half_v_m: Vec3::new(0.0, -0.2, 0.0),
                radiance: Vec3::ONE,
            },
        ]
    }

    #[test]
    fn the_bounds_fill_a_lights_view() {
        for light in lights() {
            let view = light.view([1.0, -1.0], BOUNDS);
            let mut widest = 0.0f32;
            for direction in [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z] {
                let clip = view
                    .clip_from_world
                    .project_point3(BOUNDS.center_m + BOUNDS.radius_m * direction);
                assert!(clip.truncate().abs().max_element() < 1.001, "{light:?}: {clip}");
                assert!((-0.001..=1.001).contains(&clip.z), "{light:?}: {clip}");
                widest = widest.max(clip.truncate().abs().max_element());
            }
            assert!(widest > 0.6, "{light:?}: {widest}");
        }
    }

    #[test]
    fn a_light_inside_the_bounds_has_a_finite_view() {
        let light = ShadowLight::Point {
            position_m: BOUNDS.center_m,
            intensity: Vec3::ONE,
        };
        assert!(light.view([0.0; 2], BOUNDS).clip_from_world.is_finite());
    }
}
