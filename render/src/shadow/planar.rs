//! Planar shadows: the casters drawn once more, flattened onto the receivers' planes.
//!
//! Blinn 1988, "Me and my (fake) shadow": a matrix of plane and light flattens. The planes are the large flat parts of the
//! receivers ([`super::planes`]); other receivers get no shadow, and objects none of their own. The stencil keeps a shadow
//! on the pixels of its plane and darkens each of them once. Casters are cut at the plane and at the light's height, so
//! nothing casts an anti-shadow.
//!
//! Soft (Heckbert, Herf 1997, "Simulating soft shadows with graphics hardware"): the same from jittered places all over an
//! area light, each of which takes an equal share of the light away. A hard one shines from an area light's middle.

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Vec3, Vec4};
use rayon::prelude::*;

use super::casters::Casters;
use super::key::{Job, KeyShadow};
use super::light::ShadowLight;
use super::planes::{FLATNESS_M, FlatParts, Plane, dominant_planes};
use super::stencil::lit;
use super::surface::DEPTH_STENCIL_FORMAT;
use super::volume_mesh::{MeshKey, mesh_key};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, VERTEX_LAYOUT};
use crate::gpu::shader;
use crate::gpu::timer::{Ends, Timer};

/// Stencil of pixels that are not on the plane being drawn: above every place on the light.
const ELSEWHERE: u32 = 255;
/// Sets of receivers whose planes are kept at most.
const MAX_SETS: usize = 4;
/// Moves a receiver's polygons, which are drawn once more, in front of themselves; not so far that they come in front of what
/// stands on them.
const MARK_BIAS: wgpu::DepthBiasState = wgpu::DepthBiasState {
    constant: -16,
    slope_scale: -0.03,
    clamp: 0.0,
};
const RECEIVER_LAYOUT: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: size_of::<Vec3>() as u64,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &wgpu::vertex_attr_array![0 => Float32x3],
};

/// The method.
#[derive(Debug)]
pub struct PlanarShadow {
    places_per_side: u32,
    layout: wgpu::BindGroupLayout,
    mark: wgpu::RenderPipeline,
    /// For as many places as the light has, and for one.
    project: [wgpu::RenderPipeline; 2],
    /// The last sets of receivers, the last first.
    receivers: Vec<Receivers>,
}

/// A set of receivers and where their planes were last.
#[derive(Debug)]
struct Receivers {
    key: Vec<MeshKey>,
    parts: Vec<FlatParts>,
    placements: Vec<Affine3A>,
    planes: Vec<(Vec4, wgpu::Buffer, u32)>,
}

/// A plane and a place on the light (`Projection` in `shadow_planar.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuProjection {
    /// Unit normal towards the light's side and minus its distance from the origin, metres.
    pub plane: Vec4,
    /// Place on the light, homogeneous.
    pub light: Vec4,
}

impl PlanarShadow {
    /// One place on the light.
    pub const HARD: u32 = 1;
    /// Four by four places on an area light.
    pub const SOFT: u32 = 4;

    /// The method with `places_per_side` squared places on an area light, at most 15 per side.
    #[must_use]
    pub fn new(gpu: &Gpu, places_per_side: u32) -> Self {
        let places_per_side = places_per_side.clamp(1, 15);
        let binding = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::VERTEX,
            ty: wgpu::BindingType::Buffer {
                ty,
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("shadow_planar"),
            entries: &[
                binding(0, wgpu::BufferBindingType::Uniform),
                binding(1, wgpu::BufferBindingType::Storage { read_only: true }),
                binding(2, wgpu::BufferBindingType::Storage { read_only: true }),
            ],
        });
        let pipelines = Pipelines::new(gpu, &layout);
        Self {
            places_per_side,
            mark: pipelines.mark(gpu),
            project: [places_per_side * places_per_side, 1].map(|n| pipelines.project(gpu, n)),
            layout,
            receivers: Vec::new(),
        }
    }

    /// Puts these receivers first, and their planes where they are now.
    fn find_planes(&mut self, gpu: &Gpu, receivers: &Casters) {
        let objects = &receivers.objects;
        let key: Vec<MeshKey> = objects.iter().map(mesh_key).collect();
        let mut set = match self.receivers.iter().position(|known| known.key == key) {
            Some(at) => self.receivers.remove(at),
            None => Receivers {
                key,
                parts: objects.par_iter().map(|o| FlatParts::new(o.own_triangles())).collect(),
                placements: Vec::new(),
                planes: Vec::new(),
            },
        };
        let placements: Vec<Affine3A> = objects.iter().map(|o| o.world_from_object).collect();
        if set.placements != placements {
            let upload = |found: &Plane| {
                let buffer = gpu.buffer("shadow_planar: receiver", found.triangles.as_flattened());
                (found.plane, buffer, 3 * found.triangles.len() as u32)
            };
            let placed = set.parts.iter().zip(placements.iter().copied());
            set.planes = dominant_planes(placed).iter().map(upload).collect();
            set.placements = placements;
        }
        self.receivers.truncate(MAX_SETS - 1);
        self.receivers.insert(0, set);
    }

    /// Places on the light, homogeneous.
    fn places(&self, light: &ShadowLight) -> Vec<Vec4> {
        let ShadowLight::Rect {
            center_m,
            half_u_m,
            half_v_m,
            ..
        } = *light
        else {
            return vec![light.homogeneous()];
        };
        let n = self.places_per_side;
        if n == 1 {
            return vec![light.homogeneous()];
        }
        (0..n * n)
            .map(|i| {
                let at = [i % n, i / n].map(|cell| cell as f32);
                let [u, v] = [0, 1].map(|axis| 2.0 * (at[axis] + jitter(i, axis as u32)) / n as f32 - 1.0);
                (center_m + u * half_u_m + v * half_v_m).extend(1.0)
            })
            .collect()
    }
}

impl KeyShadow for PlanarShadow {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        let places = self.places(job.light);
        self.find_planes(gpu, job.receivers);
        let planes = &self.receivers[0].planes;
        let mut projections: Vec<GpuProjection> = planes
            .iter()
            .flat_map(|(plane, _, _)| places.iter().map(|&light| projection(*plane, light)))
            .collect();
        if projections.is_empty() {
            projections.push(GpuProjection::zeroed());
        }
        let bindings = gpu.bind(
            "shadow_planar",
            &self.layout,
            &[
                job.surface.view_buffer.as_entire_binding(),
                job.scene.objects.as_entire_binding(),
                gpu.buffer("shadow_planar: projections", &projections)
                    .as_entire_binding(),
            ],
        );
        let span = timer.span("shadow_planar");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow_planar"),
            color_attachments: &[Some(lit(job.visibility))],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &job.surface.depth_stencil,
                depth_ops: None,
                stencil_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(ELSEWHERE),
                    store: wgpu::StoreOp::Store,
                }),
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_bind_group(0, &bindings, &[]);
        let project = &self.project[usize::from(places.len() == 1)];
        for (index, (_, receiver, n_corners)) in planes.iter().enumerate() {
            let mark = |pass: &mut wgpu::RenderPass<'_>, stencil| {
                pass.set_pipeline(&self.mark);
                pass.set_vertex_buffer(0, receiver.slice(..));
                pass.set_stencil_reference(stencil);
                pass.draw(0..*n_corners, 0..1);
            };
            mark(&mut pass, 0);
            if job.casters.range.n_indices > 0 {
                pass.set_pipeline(project);
                pass.set_vertex_buffer(0, job.scene.vertices.slice(..));
                pass.set_index_buffer(job.casters.range.buffer.slice(..), wgpu::IndexFormat::Uint32);
                for place in 0..places.len() as u32 {
                    let instance = (index * places.len()) as u32 + place;
                    // A pixel holds the last place that was taken from it, so each place is taken once.
                    pass.set_stencil_reference(place + 1);
                    pass.draw_indexed(0..job.casters.range.n_indices, 0, instance..instance + 1);
                }
            }
            mark(&mut pass, ELSEWHERE);
        }
        Ok(())
    }
}

/// The plane turned to the light's side.
fn projection(plane: Vec4, light: Vec4) -> GpuProjection {
    GpuProjection {
        plane: if plane.dot(light) < 0.0 { -plane } else { plane },
        light,
    }
}

/// A number in 0 .. 1 for a place on the light, always the same (the mixing of Wang's integer hash).
fn jitter(place: u32, axis: u32) -> f32 {
    let mut x = 2 * place + axis;
    x = (x ^ 61) ^ (x >> 16);
    x = x.wrapping_mul(9);
    x ^= x >> 4;
    x = x.wrapping_mul(0x27d4_eb2d);
    x ^= x >> 15;
    (x >> 8) as f32 / (1u32 << 24) as f32
}

struct Pipelines {
    module: wgpu::ShaderModule,
    layout: wgpu::PipelineLayout,
}

impl Pipelines {
    fn new(gpu: &Gpu, layout: &wgpu::BindGroupLayout) -> Self {
        Self {
            module: shader::module(&gpu.device, "shadow_planar"),
            layout: gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("shadow_planar"),
                bind_group_layouts: &[Some(layout)],
                immediate_size: 0,
            }),
        }
    }

    /// Writes the reference where the receiver is what is seen.
    fn mark(&self, gpu: &Gpu) -> wgpu::RenderPipeline {
        let replace = wgpu::StencilFaceState {
            pass_op: wgpu::StencilOperation::Replace,
            ..wgpu::StencilFaceState::IGNORE
        };
        let state = self.depth_stencil(replace, wgpu::CompareFunction::LessEqual, MARK_BIAS);
        // The pass has a colour target, which marking leaves alone.
        let nothing = wgpu::ColorTargetState {
            write_mask: wgpu::ColorWrites::empty(),
            ..wgpu::ColorTargetState::from(RADIANCE_FORMAT)
        };
        self.pipeline(gpu, ("receiver", RECEIVER_LAYOUT), state, (None, nothing))
    }

    /// Takes one of `n_places` shares from pixels whose stencil is below the reference, which it then is.
    fn project(&self, gpu: &Gpu, n_places: u32) -> wgpu::RenderPipeline {
        let once = wgpu::StencilFaceState {
            compare: wgpu::CompareFunction::Greater,
            pass_op: wgpu::StencilOperation::Replace,
            ..wgpu::StencilFaceState::IGNORE
        };
        let state = self.depth_stencil(once, wgpu::CompareFunction::Always, wgpu::DepthBiasState::default());
        let take = wgpu::BlendComponent {
            src_factor: wgpu::BlendFactor::One,
            dst_factor: wgpu::BlendFactor::One,
            operation: wgpu::BlendOperation::ReverseSubtract,
        };
        let target = wgpu::ColorTargetState {
            format: RADIANCE_FORMAT,
            blend: Some(wgpu::BlendState {
                color: take,
                alpha: take,
            }),
            write_mask: wgpu::ColorWrites::ALL,
        };
        let constants = [
            ("share", 1.0 / f64::from(n_places)),
            ("lowest_m", 2.0 * f64::from(FLATNESS_M)),
        ];
        self.pipeline(gpu, ("caster", VERTEX_LAYOUT), state, (Some(&constants), target))
    }

    fn depth_stencil(
        &self,
        face: wgpu::StencilFaceState,
        depth_compare: wgpu::CompareFunction,
        bias: wgpu::DepthBiasState,
    ) -> wgpu::DepthStencilState {
        wgpu::DepthStencilState {
            format: DEPTH_STENCIL_FORMAT,
            depth_write_enabled: Some(false),
            depth_compare: Some(depth_compare),
            stencil: wgpu::StencilState {
                front: face,
                back: face,
                read_mask: 0xff,
                write_mask: 0xff,
            },
            bias,
        }
    }

    fn pipeline(
        &self,
        gpu: &Gpu,
        (vertex, buffer): (&str, wgpu::VertexBufferLayout<'_>),
        depth_stencil: wgpu::DepthStencilState,
        (constants, target): (Option<&[(&str, f64)]>, wgpu::ColorTargetState),
    ) -> wgpu::RenderPipeline {
        let targets = [Some(target)];
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("shadow_planar"),
            layout: Some(&self.layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some(vertex),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[Some(buffer)],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(depth_stencil),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &self.module,
                entry_point: Some(if constants.is_some() { "fragment" } else { "nothing" }),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: constants.unwrap_or_default(),
                    ..wgpu::PipelineCompilationOptions::default()
                },
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jitter_fills_the_cell() {
        let values: Vec<f32> = (0..225).flat_map(|i| [jitter(i, 0), jitter(i, 1)]).collect();
        assert!(values.iter().all(|v| (0.0..1.0).contains(v)));
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        assert!((mean - 0.5).abs() < 0.05, "{mean}");
    }
}
