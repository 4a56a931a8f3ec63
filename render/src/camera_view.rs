//! What a camera sees of the real things: its picture, and the place and normal of the phantom behind every pixel.

use mirrorball_calib::rig::Camera;

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
        let camera = gpu.buffer("camera", &[<GpuCamera as bytemuck::Zeroable>::zeroed()]);
        let phantoms = LensSurface::new(
            gpu,
            "lens_surface: phantoms",
            (&camera, scene),
            model.intrinsics.size_px,
        );
        Self {
            model: model.clone(),
            picture: PictureBuffers::new(gpu, model),
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
