//! What the passes share that put light from afar, past all shadows, together with light from near things.

use crate::environments::Environments;
use crate::scene_gpu::SceneBuffers;

/// What bindings 0 to 5 of `receive` and `shade` need.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The scene camera, uniform.
    pub camera: &'a wgpu::Buffer,
    /// The scene.
    pub scene: &'a SceneBuffers,
    /// Light around the virtual objects.
    pub environments: &'a Environments,
    /// Light from afar on the surfaces that the pass draws.
    pub light: &'a ShadowedLight,
}

/// Irradiance from afar on what one pass draws, per pixel of the camera's picture; linear RGB.
#[derive(Debug)]
pub struct ShadowedLight {
    /// Past the real things alone.
    pub without: wgpu::TextureView,
    /// Past all objects.
    pub with_virtual: wgpu::TextureView,
    /// xyz: place of the surface it belongs to, world, metres; w: 1 where there is one.
    pub place: wgpu::TextureView,
    /// xyz: its unit normal, world.
    pub normal: wgpu::TextureView,
}

/// Bindings 0 to 5, in order.
#[must_use]
pub fn resources(inputs: Inputs<'_>) -> Vec<wgpu::BindingResource<'_>> {
    vec![
        inputs.camera.as_entire_binding(),
        inputs.scene.objects.as_entire_binding(),
        inputs.environments.all.as_entire_binding(),
        inputs.environments.near_sh.as_entire_binding(),
        wgpu::BindingResource::TextureView(&inputs.light.without),
        wgpu::BindingResource::TextureView(&inputs.light.with_virtual),
    ]
}
