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
    /// Radiance of real things in the picture of the eye's view, with mips.
    pub real: &'a wgpu::TextureView,
}

/// The pass with its filter.
#[derive(Debug)]
pub struct NearLight {
    rays: Step,
    filter: Step,
    /// Places that send rays, and pixels.
    ray_size_px: [u32; 2],
    size_px: [u32; 2],
}

impl NearLight {
    /// All light from near things, on virtual objects.
    #[must_use]
    pub fn light(gpu: &Gpu, inputs: Inputs<'_>) -> Self {
        let size_px = inputs.eye.view.size_px();
        Self::with(gpu, inputs, (["near_light", "dome_filter"], size_px), None)
    }

    /// What virtual objects change of it on phantoms; `unshadowed` is the radiance of real things without virtual
    /// shadows, in the same picture.
    #[must_use]
    pub fn change(gpu: &Gpu, inputs: Inputs<'_>, unshadowed: &wgpu::TextureView) -> Self {
        let size_px = inputs.eye.view.size_px().map(|size| size.div_ceil(2));
        Self::with(gpu, inputs, (["near_change", "near_filter"], size_px), Some(unshadowed))
    }

    /// Passes for rays at `ray_size_px` places and for what puts them together.
    fn with(
        gpu: &Gpu,
        inputs: Inputs<'_>,
        ([rays, filter], ray_size_px): ([&'static str; 2], [u32; 2]),
        unshadowed: Option<&wgpu::TextureView>,
    ) -> Self {
        let Inputs { eye, light, real } = inputs;
        let raw = gpu
            .texture("near light: rays", TextureShape::plain(ray_size_px), RADIANCE_FORMAT)
            .create_view(&wgpu::TextureViewDescriptor::default());
        let linear = gpu.linear_sampler();
        let mut resources: Vec<wgpu::BindingResource<'_>> = eye.rays.resources().into();
        resources.extend([
            eye.view.camera.as_entire_binding(),
            eye.near.far_lights.buffer().as_entire_binding(),
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
        let targets = [&light.place, &light.normal, &raw, &light.near].map(wgpu::BindingResource::TextureView);
        Self {
            rays: Step::new(gpu, rays, &resources).with_materials(gpu, &eye.scene.materials),
            filter: Step::new(gpu, filter, &targets),
            ray_size_px,
            size_px: eye.view.size_px(),
        }
    }

    /// Fills the target.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        for (step, size_px) in [(&self.rays, self.ray_size_px), (&self.filter, self.size_px)] {
            let [width, height] = size_px.map(groups);
            step.record(encoder, timer, [width, height, 1]);
        }
    }
}
