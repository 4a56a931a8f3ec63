//! What the passes share that put light from afar, past all shadows, together with light from near things.

use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::passes::lamp_light::layers;
use crate::scene::MAX_LAMPS;
use crate::scene_gpu::SceneBuffers;
use crate::shadow::surface::SurfaceViews;

/// What bindings 0 to 7 of `receive` and `shade` need.
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
#[derive(Debug, Clone)]
pub struct ShadowedLight {
    /// Past the real things alone.
    pub without: wgpu::TextureView,
    /// Past all objects.
    pub with_virtual: wgpu::TextureView,
    /// Irradiance of virtual lamps, past all objects.
    pub lamps: wgpu::TextureView,
    /// Share of the light of every virtual lamp that gets past all objects, four lamps per layer.
    pub lamp_shares: wgpu::TextureView,
    /// On phantoms: irradiance from near things that virtual objects add or, negative, take away. On virtual objects:
    /// irradiance from near things.
    pub near: wgpu::TextureView,
    /// xyz: place of the surface it belongs to, world, metres; w: 1 where there is one.
    pub place: wgpu::TextureView,
    /// xyz: its unit normal, world.
    pub normal: wgpu::TextureView,
}

impl ShadowedLight {
    /// Room for the light on the surface that `views` shows.
    #[must_use]
    pub fn new(gpu: &Gpu, views: SurfaceViews<'_>) -> Self {
        let target = |label| {
            let texture = gpu.target(label, TextureShape::plain(views.size_px), RADIANCE_FORMAT);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        let shares = TextureShape::layered(views.size_px, MAX_LAMPS as u32 / 4);
        Self {
            without: target("light past real things"),
            with_virtual: target("light past all things"),
            lamps: target("light of virtual lamps"),
            lamp_shares: gpu
                .texture("shares of virtual lamps", shares, RADIANCE_FORMAT)
                .create_view(&layers()),
            near: target("light from near things"),
            place: views.place.clone(),
            normal: views.normal.clone(),
        }
    }
}

impl ShadowedLight {
    /// The same with other light from near things.
    #[must_use]
    pub fn with_near(&self, near: &wgpu::TextureView) -> Self {
        Self {
            near: near.clone(),
            ..self.clone()
        }
    }
}

/// Bindings 0 to 7, in order.
#[must_use]
pub fn resources(inputs: Inputs<'_>) -> Vec<wgpu::BindingResource<'_>> {
    vec![
        inputs.camera.as_entire_binding(),
        inputs.scene.objects.as_entire_binding(),
        inputs.environments.all.as_entire_binding(),
        inputs.environments.near_sh.as_entire_binding(),
        wgpu::BindingResource::TextureView(&inputs.light.without),
        wgpu::BindingResource::TextureView(&inputs.light.with_virtual),
        wgpu::BindingResource::TextureView(&inputs.light.lamps),
        wgpu::BindingResource::TextureView(&inputs.light.near),
    ]
}
