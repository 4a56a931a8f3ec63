//! Real things in the light of virtual lamps: their albedo, and the radiance that lamps add to the picture.

use super::groups;
use crate::camera_view::CameraView;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::passes::direct::ShadowedLight;
use crate::passes::receive::Receive;
use crate::shadow::dome::Step;

/// The pass with its albedo; without lamps it does nothing, and its targets stay black.
#[derive(Debug)]
pub struct LampReceive {
    step: Option<Step>,
    albedo: wgpu::TextureView,
    size_px: [u32; 2],
}

impl LampReceive {
    /// A pass for `n_lamps` lamps that shine on the phantoms of `view`: their light is in `light`, the room's in `receive`, to
    /// which it adds.
    #[must_use]
    pub fn new(gpu: &Gpu, view: &CameraView, (light, receive): (&ShadowedLight, &Receive), n_lamps: usize) -> Self {
        let size_px = view.size_px();
        let albedo = gpu
            .texture("lamp_receive: albedo", TextureShape::plain(size_px), RADIANCE_FORMAT)
            .create_view(&wgpu::TextureViewDescriptor::default());
        let texture = |view| wgpu::BindingResource::TextureView(view);
        let resources = [
            view.camera.as_entire_binding(),
            view.picture.response.as_entire_binding(),
            texture(&view.picture.view),
            texture(receive.real_light()),
            texture(&light.lamps),
            texture(&light.place),
            texture(&light.normal),
            texture(&albedo),
            texture(receive.added()),
        ];
        Self {
            step: (n_lamps > 0).then(|| Step::new(gpu, "lamp_receive", &resources)),
            albedo,
            size_px,
        }
    }

    /// Albedo of the phantoms as the picture shows them, linear RGB, at most 0.95; alpha 1 where there is one.
    #[must_use]
    pub fn albedo(&self) -> &wgpu::TextureView {
        &self.albedo
    }

    /// Fills the albedo and what is added to the real things.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if let Some(step) = &self.step {
            step.record(encoder, timer, [groups(self.size_px[0]), groups(self.size_px[1]), 1]);
        }
    }
}
