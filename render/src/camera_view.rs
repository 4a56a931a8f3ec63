//! What a camera sees of the real things: its picture, and the place and normal of the phantom behind every pixel.

use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Camera;
use mirrorball_capture::frame::Exposure;

use crate::gpu::Gpu;
use crate::gpu::types::GpuCamera;
use crate::passes::lens_surface::LensSurface;
use crate::scene_gpu::{PictureBuffers, SceneBuffers};

/// A camera's picture and the phantoms in it.
#[derive(Debug)]
pub struct CameraView {
    /// Lens and photometry.
    pub model: Camera,
    /// The same with its pose, uniform ([`GpuCamera`]).
    pub camera: wgpu::Buffer,
    /// Its picture.
    pub picture: PictureBuffers,
    /// Places and normals of the phantoms that it sees.
    pub phantoms: LensSurface,
}

impl CameraView {
    /// Room for pictures of `model`.
    #[must_use]
    pub fn new(gpu: &Gpu, model: &Camera, scene: &SceneBuffers) -> Self {
        Self::with_picture(gpu, (model, PictureBuffers::new(gpu, model)), scene)
    }

    /// Room for pictures that a pass draws as `model` would take them.
    #[must_use]
    pub fn drawn(gpu: &Gpu, model: &Camera, scene: &SceneBuffers) -> Self {
        Self::with_picture(gpu, (model, PictureBuffers::drawn(gpu, model)), scene)
    }

    fn with_picture(gpu: &Gpu, (model, picture): (&Camera, PictureBuffers), scene: &SceneBuffers) -> Self {
        let exposure = Exposure {
            time_s: 0.01,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        // Until a pose is known the camera stands at the world's origin.
        let at_origin = GpuCamera::new(model, &Pose::identity(), &exposure, [0.02, 20.0]);
        let camera = gpu.buffer("camera", &[at_origin]);
        let phantoms = LensSurface::new(
            gpu,
            "lens_surface: phantoms",
            (&camera, scene),
            model.intrinsics.size_px,
        );
        Self {
            model: model.clone(),
            picture,
            camera,
            phantoms,
        }
    }

    /// Columns and rows.
    #[must_use]
    pub fn size_px(&self) -> [u32; 2] {
        self.model.intrinsics.size_px
    }
}
