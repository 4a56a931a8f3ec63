//! The pinhole view in which shadows are drawn: the virtual camera of a picture without camera, or one that holds what a
//! real camera's lens sees.

use bytemuck::{Pod, Zeroable};
use glam::{Mat4, Vec3, Vec4};

/// A pinhole camera. World frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Where the camera stands.
    pub eye_m: Vec3,
    /// World to camera: x right, y up, z backward (right-handed, as OpenGL's).
    pub camera_from_world: Mat4,
    /// Tangents of half the horizontal and half the vertical angle of view.
    pub tangents: [f32; 2],
    /// Nearest distance drawn, metres. There is no farthest.
    pub near_m: f32,
    /// Columns and rows.
    pub size_px: [u32; 2],
}

/// A view as the shaders take it (`View` in `shared/view.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuView {
    /// World to clip coordinates: x right, y up, depth 0 at the near plane and 1 at infinity.
    pub clip_from_world: Mat4,
    /// Its inverse.
    pub world_from_clip: Mat4,
    /// xyz: where the camera stands; w: near plane, metres.
    pub eye_m: Vec4,
    /// Columns and rows, and their inverses.
    pub size_px: Vec4,
}

impl View {
    /// A camera at `eye_m` that looks at `target_m`, world z up in the picture, `height_rad` its vertical angle of view.
    #[must_use]
    pub fn looking_at(eye_m: Vec3, target_m: Vec3, height_rad: f32, size_px: [u32; 2]) -> Self {
        let up = if (target_m - eye_m).normalize_or(Vec3::X).z.abs() > 0.999 {
            Vec3::Y
        } else {
            Vec3::Z
        };
        let tangent = (0.5 * height_rad).tan();
        Self {
            eye_m,
            camera_from_world: looking_along(eye_m, target_m - eye_m, up),
            tangents: [tangent * size_px[0] as f32 / size_px[1] as f32, tangent],
            near_m: 0.02,
            size_px,
        }
    }

    /// Unit direction of view, world.
    #[must_use]
    pub fn forward(&self) -> Vec3 {
        -self.camera_from_world.row(2).truncate()
    }

    /// World to clip coordinates: x right, y up, depth 0 at the near plane and 1 at infinity.
    #[must_use]
    pub fn clip_from_world(&self) -> Mat4 {
        let [x, y] = self.tangents;
        let projection = Mat4::from_cols(
            Vec4::new(1.0 / x, 0.0, 0.0, 0.0),
            Vec4::new(0.0, 1.0 / y, 0.0, 0.0),
            Vec4::new(0.0, 0.0, -1.0, -1.0),
            Vec4::new(0.0, 0.0, -self.near_m, 0.0),
        );
        projection * self.camera_from_world
    }

    /// The same as the shaders take it.
    #[must_use]
    pub fn to_gpu(&self) -> GpuView {
        let clip_from_world = self.clip_from_world();
        let [width, height] = self.size_px.map(|s| s as f32);
        GpuView {
            clip_from_world,
            world_from_clip: clip_from_world.inverse(),
            eye_m: self.eye_m.extend(self.near_m),
            size_px: Vec4::new(width, height, 1.0 / width, 1.0 / height),
        }
    }
}

/// World to camera for a camera at `eye_m` that looks along `forward`, `up` upward in the picture.
fn looking_along(eye_m: Vec3, forward: Vec3, up: Vec3) -> Mat4 {
    let backward = -forward.normalize_or(Vec3::NEG_Z);
    let right = up.cross(backward).normalize_or(Vec3::X);
    let up = backward.cross(right);
    Mat4::from_cols(
        Vec4::new(right.x, up.x, backward.x, 0.0),
        Vec4::new(right.y, up.y, backward.y, 0.0),
        Vec4::new(right.z, up.z, backward.z, 0.0),
        Vec4::new(-right.dot(eye_m), -up.dot(eye_m), -backward.dot(eye_m), 1.0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_runs_from_the_near_plane_to_infinity() {
        let view = View::looking_at(Vec3::new(0.0, -1.0, 0.0), Vec3::ZERO, 1.0, [640, 480]);
        let at = |distance: f32| view.clip_from_world().project_point3(view.eye_m + Vec3::Y * distance);
        assert!(at(view.near_m).z.abs() < 1e-5);
        assert!((at(1e6).z - 1.0).abs() < 1e-5);
        assert!(at(1.0).truncate().length() < 1e-6);
        let above = view.clip_from_world().project_point3(Vec3::Z * 0.1);
        assert!(above.y > 0.0 && above.x.abs() < 1e-6);
    }
}
