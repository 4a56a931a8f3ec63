//! Virtual objects as radiance, with smooth edges.

use glam::{Affine3A, Vec3};

use super::direct::{self, Inputs};
use crate::config::{DiffuseMethod, Facets, LightConfig, SpecularMethod};
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::scene_gpu::SceneBuffers;

/// Samples per pixel at edges.
pub const SAMPLES: u32 = 4;

/// The pass with its targets.
#[derive(Debug)]
pub struct Shade {
    opaque: Layer,
    blended: Layer,
    /// Blended objects, the farthest first, as indices into [`SceneBuffers::blended`].
    order: Vec<usize>,
    samples: wgpu::TextureView,
    resolved: wgpu::TextureView,
}

/// Value of the shader's constant `FACETS`.
fn facets_constant(facets: Facets) -> f64 {
    match facets {
        Facets::Single => 0.0,
        Facets::Multiple => 1.0,
    }
}

/// Triangles that are drawn alike.
#[derive(Debug)]
struct Layer {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    materials: wgpu::BindGroup,
    lamps: wgpu::BindGroup,
}

/// What the pass draws.
#[derive(Debug, Clone, Copy)]
pub struct ShadeTarget<'a> {
    /// Columns and rows.
    pub size_px: [u32; 2],
    /// How light reaches the objects.
    pub light: LightConfig,
    /// What rays have found of reflections, and of what is seen through glass, per pixel; linear radiance.
    pub traced: [&'a wgpu::TextureView; 2],
}

/// Value of the shader's constant `DIFFUSE`.
fn diffuse_constant(method: DiffuseMethod) -> f64 {
    match method {
        DiffuseMethod::Lights => 0.0,
        DiffuseMethod::CosineCube | DiffuseMethod::SeparableBlur | DiffuseMethod::Cylindrical => 1.0,
        DiffuseMethod::Sh9 => 2.0,
        DiffuseMethod::SphereMap => 3.0,
    }
}

/// Value of the shader's constant `SPECULAR`.
fn specular_constant(method: SpecularMethod) -> f64 {
    match method {
        SpecularMethod::Ggx => 0.0,
        SpecularMethod::Phong | SpecularMethod::Highlight => 1.0,
        SpecularMethod::SphereMap => 2.0,
        SpecularMethod::SmallCube => 4.0,
        SpecularMethod::Rays => 3.0,
    }
}

impl Shade {
    /// A pass for `target`; `sampler` is linear and clamped.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, (sampler, target): (&wgpu::Sampler, ShadeTarget<'_>)) -> Self {
        let state = RasterState {
            targets: &[RADIANCE_FORMAT],
            samples: SAMPLES,
            bias: wgpu::DepthBiasState::default(),
            cull: None,
        };
        let constants = [
            ("DIFFUSE", diffuse_constant(target.light.diffuse)),
            ("SPECULAR", specular_constant(target.light.specular)),
            ("FACETS", facets_constant(target.light.facets)),
        ];
        let sphere_maps = inputs
            .environments
            .sphere_maps
            .create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..wgpu::TextureViewDescriptor::default()
            });
        let mut resources = direct::resources(inputs);
        resources.extend([
            wgpu::BindingResource::TextureView(&inputs.environments.specular_view),
            wgpu::BindingResource::Sampler(sampler),
            wgpu::BindingResource::TextureView(&inputs.environments.irradiance_view),
            inputs.environments.harmonics.as_entire_binding(),
            wgpu::BindingResource::TextureView(&sphere_maps),
            wgpu::BindingResource::TextureView(&inputs.light.place),
            wgpu::BindingResource::TextureView(&inputs.light.normal),
        ]);
        resources.extend(target.traced.map(wgpu::BindingResource::TextureView));
        let lamps = [
            inputs.scene.lamps.as_entire_binding(),
            wgpu::BindingResource::TextureView(&inputs.light.lamp_shares),
        ];
        let layer = |pipeline: wgpu::RenderPipeline| Layer {
            bindings: gpu.bind("shade", &pipeline.get_bind_group_layout(0), &resources),
            materials: inputs.scene.materials.bind(gpu, &pipeline.get_bind_group_layout(1)),
            lamps: gpu.bind("shade: lamps", &pipeline.get_bind_group_layout(2), &lamps),
            pipeline,
        };
        let radiance = |samples| {
            let shape = TextureShape {
                samples,
                ..TextureShape::plain(target.size_px)
            };
            let texture = gpu.texture("shade: radiance", shape, RADIANCE_FORMAT);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        Self {
            samples: radiance(SAMPLES),
            resolved: radiance(1),
            opaque: layer(gpu.render_pipeline_variant("shade", &state, &constants)),
            blended: layer(gpu.render_pipeline_over("shade", &state, &constants)),
            order: (0..inputs.scene.blended.len()).collect(),
        }
    }

    /// Puts blended objects that stand at `placements` (world from object) into their order for an eye at `eye_m`, world.
    pub fn sort(&mut self, scene: &SceneBuffers, placements: &[Affine3A], eye_m: Vec3) {
        let off = |&index: &usize| {
            let of = &scene.blended[index];
            placements[of.object]
                .transform_point3(of.middle_m)
                .distance_squared(eye_m)
        };
        self.order
            .sort_unstable_by(|one, other| off(other).total_cmp(&off(one)));
    }

    /// Radiance of virtual objects times their coverage, alpha the coverage.
    #[must_use]
    pub fn radiance(&self) -> &wgpu::TextureView {
        &self.resolved
    }

    /// Draws the virtual objects before the phantoms' `depth`, which has as many samples.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        scene: &SceneBuffers,
        depth: &wgpu::TextureView,
    ) {
        let span = timer.span("shade");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shade"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.samples,
                depth_slice: None,
                resolve_target: Some(&self.resolved),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Discard,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Load,
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        self.opaque.set(&mut pass);
        scene.opaque.draw(&mut pass, &scene.vertices);
        if !self.order.is_empty() {
            self.blended.set(&mut pass);
        }
        for &index in &self.order {
            scene.blended[index].triangles.draw(&mut pass, &scene.vertices);
        }
    }
}

impl Layer {
    fn set(&self, pass: &mut wgpu::RenderPass<'_>) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.set_bind_group(1, &self.materials, &[]);
        pass.set_bind_group(2, &self.lamps, &[]);
    }
}
