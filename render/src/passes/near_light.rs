//! Light from near things per pixel of a surface, by rays: all of it on virtual objects (`near_light.wgsl`), what virtual
//! objects change of it on phantoms (`near_change.wgsl`).

use super::direct::ShadowedLight;
use super::groups;
use crate::eye::EyeInputs;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::shadow::dome::Step;

/// What the pass reads.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// Scene and camera.
    pub eye: EyeInputs<'a>,
    /// The surface and the target, [`ShadowedLight::near`].
    pub light: &'a ShadowedLight,
    /// Radiance of real things in the scene camera's picture, with mips.
    pub real: &'a wgpu::TextureView,
}

/// The pass with its filter.
#[derive(Debug)]
pub struct NearLight {
    rays: Step,
    filter: Step,
    size_px: [u32; 2],
}

impl NearLight {
    /// All light from near things, on virtual objects.
    #[must_use]
    pub fn light(gpu: &Gpu, inputs: Inputs<'_>) -> Self {
        Self::with(gpu, "near_light", inputs, None)
    }

    /// What virtual objects change of it on phantoms; `unshadowed` is the radiance of real things without virtual shadows.
    #[must_use]
    pub fn change(gpu: &Gpu, inputs: Inputs<'_>, unshadowed: &wgpu::TextureView) -> Self {
        Self::with(gpu, "near_change", inputs, Some(unshadowed))
    }

    fn with(gpu: &Gpu, name: &'static str, inputs: Inputs<'_>, unshadowed: Option<&wgpu::TextureView>) -> Self {
        let Inputs { eye, light, real } = inputs;
        let size_px = eye.view.size_px();
        let raw = gpu
            .texture("near light: rays", TextureShape::plain(size_px), RADIANCE_FORMAT)
            .create_view(&wgpu::TextureViewDescriptor::default());
        let repeating = gpu.repeating_sampler();
        let linear = gpu.linear_sampler();
        let mut resources: Vec<wgpu::BindingResource<'_>> = eye.rays.resources().into();
        resources.extend([
            eye.view.camera.as_entire_binding(),
            eye.near.far_lights.buffer().as_entire_binding(),
            eye.scene.materials.as_entire_binding(),
            wgpu::BindingResource::TextureView(&eye.scene.base_colors),
            wgpu::BindingResource::Sampler(&repeating),
            wgpu::BindingResource::TextureView(&eye.environments.specular_view),
            wgpu::BindingResource::Sampler(&linear),
            wgpu::BindingResource::TextureView(real),
            wgpu::BindingResource::TextureView(eye.view.phantoms.views().place),
            wgpu::BindingResource::TextureView(&light.place),
            wgpu::BindingResource::TextureView(&light.normal),
            wgpu::BindingResource::TextureView(&raw),
            eye.near.memory.remembered().as_entire_binding(),
        ]);
        resources.extend(unshadowed.map(wgpu::BindingResource::TextureView));
        let filter = Step::new(
            gpu,
            "dome_filter",
            &[
                wgpu::BindingResource::TextureView(&light.place),
                wgpu::BindingResource::TextureView(&light.normal),
                wgpu::BindingResource::TextureView(&raw),
                wgpu::BindingResource::TextureView(&light.near),
            ],
        );
        Self {
            rays: Step::new(gpu, name, &resources),
            filter,
            size_px,
        }
    }

    /// Fills the target.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        let [width, height] = self.size_px.map(groups);
        self.rays.record(encoder, timer, [width, height, 1]);
        self.filter.record(encoder, timer, [width, height, 1]);
    }
}
