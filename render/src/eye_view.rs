//! What an eye beside the scene camera sees of the real things: the camera's picture as it looks from there.

use glam::{DMat3, DVec2, DVec3};
use mirrorball_calib::camera::{Intrinsics, LensModel};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Camera;

use crate::camera_view::CameraView;
use crate::config::ModeConfig;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::mode::Viewers;
use crate::passes::reproject::Reproject;
use crate::scene_gpu::SceneBuffers;

/// An eye's own view.
#[derive(Debug)]
pub struct EyeView {
    /// Its picture and the phantoms in it.
    pub view: CameraView,
    /// Coordinates in the eye's frame from those in the scene camera's; the axes of both are parallel.
    pub eye_from_camera: Pose,
    reproject: Reproject,
}

impl EyeView {
    /// An eye at `eye_m` in the frame of the scene camera, which sees `seen`; `room` is the uniform buffer of
    /// [`Reproject`].
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        (seen, room): (&CameraView, &wgpu::Buffer),
        scene: &SceneBuffers,
        (config, eye_m): (&ModeConfig, [f64; 3]),
    ) -> Self {
        let view = CameraView::drawn(gpu, &pinhole(&seen.model, config), scene);
        Self {
            reproject: Reproject::new(gpu, (seen, &view), room),
            view,
            eye_from_camera: Pose {
                rotation: DMat3::IDENTITY,
                translation: -DVec3::from_array(eye_m),
            },
        }
    }

    /// Draws the phantoms and the picture, after the phantoms that the scene camera sees.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, scene: &SceneBuffers) {
        self.view.phantoms.record(encoder, timer, (scene, &scene.phantoms));
        self.reproject.record(encoder, timer);
    }

    /// Draws the picture as if it stood on the walls of the room.
    pub fn record_flat(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        Gpu::clear(encoder, &[self.view.phantoms.views().place]);
        self.reproject.record(encoder, timer);
    }
}

/// Places of the eyes in the frame of the scene camera, metres, left to right; none where the scene camera itself looks.
#[must_use]
pub fn eye_places_m(config: &ModeConfig) -> Vec<[f64; 3]> {
    match config.name.viewers() {
        Viewers::Camera => Vec::new(),
        Viewers::OneEye => vec![[0.0; 3]],
        Viewers::TwoEyes => vec![config.left_eye_m, config.right_eye_m],
    }
}

/// An eye's camera: without distortion and without vignetting, otherwise with the scene camera's photometry.
#[must_use]
pub fn pinhole(scene_camera: &Camera, config: &ModeConfig) -> Camera {
    let own = &scene_camera.intrinsics;
    let size_px = config.eye_size_px.unwrap_or(own.size_px);
    let middle_px = 0.5 * (DVec2::new(f64::from(size_px[0]), f64::from(size_px[1])) - 1.0);
    let (focal_px, principal_point_px) = match config.field_of_view_deg {
        Some(angle_deg) => {
            let focal_px = 0.5 * f64::from(size_px[0]) / (0.5 * angle_deg).to_radians().tan();
            (DVec2::splat(focal_px), middle_px)
        }
        // The camera's own field of view, on as many pixels as the eye has.
        None => {
            let scale = f64::from(size_px[0]) / f64::from(own.size_px[0]);
            let own_middle_px = 0.5 * (DVec2::new(f64::from(own.size_px[0]), f64::from(own.size_px[1])) - 1.0);
            (
                own.focal_px * scale,
                middle_px + (own.principal_point_px - own_middle_px) * scale,
            )
        }
    };
    let mut eye = scene_camera.clone();
    eye.photometry.vignetting = [0.0; 2];
    eye.intrinsics = Intrinsics {
        size_px,
        focal_px,
        principal_point_px,
        lens: LensModel::BrownConrady {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        },
    };
    eye
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use mirrorball_calib::rig::Rig;

    use super::*;

    #[test]
    fn a_display_shows_the_cameras_field_of_view_or_its_own() {
        let rig = Rig::from_toml(include_str!("../tests/support/rig.toml"), Path::new("rig.toml")).unwrap();
        let camera = rig.scene_camera();
        let mut config = ModeConfig {
            eye_size_px: Some([160, 120]),
            ..ModeConfig::default()
        };
        let eye = pinhole(camera, &config).intrinsics;
        assert_eq!(eye.focal_px, 0.5 * camera.intrinsics.focal_px);
        // The left edge of the picture, half a pixel before the first centre, is where it was.
        let edge = |of: &Intrinsics| (of.principal_point_px.x + 0.5) / of.focal_px.x;
        assert!((edge(&eye) - edge(&camera.intrinsics)).abs() < 1e-12);
        config.field_of_view_deg = Some(90.0);
        let eye = pinhole(camera, &config).intrinsics;
        assert!((eye.focal_px - 80.0).abs().max_element() < 1e-9);
        assert_eq!(eye.principal_point_px, DVec2::new(79.5, 59.5));
    }
}
