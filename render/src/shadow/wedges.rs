//! Soft shadow volumes: per pixel, how much of a rectangular light the casters' outlines cover (D9).
//!
//! The wedge of an edge is the space from which the edge is seen before the light (Akenine-Möller, Assarsson 2002,
//! "Approximate soft shadows on arbitrary surfaces using penumbra wedges"). Instead of drawing wedges into a buffer, tiles of
//! 8 × 8 pixels gather the edges whose wedges they may be in, and every pixel adds them up ([`Coverage`]). Nothing is
//! blended, so there are no seams where wedges meet.

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Mat4, UVec4, Vec4};

use super::key::{Job, KeyShadow};
use super::wedge_light::{Coverage, N_LINES, WedgeLight};
use super::wedge_outlines::Outlines;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};

/// Threads of a group that places corners.
const GROUP: usize = 64;

/// The method.
#[derive(Debug)]
pub struct Wedges {
    coverage: Coverage,
    corner_pipeline: wgpu::ComputePipeline,
    pipeline: wgpu::ComputePipeline,
    frame: wgpu::Buffer,
    casters: Option<Prepared>,
}

/// Casters as they were last prepared.
#[derive(Debug)]
struct Prepared {
    /// Index in the scene, number of vertices and of indices of every object.
    meshes: Vec<[usize; 3]>,
    outlines: Outlines,
    shapes: wgpu::Buffer,
    edges: wgpu::Buffer,
    faces: wgpu::Buffer,
    placed: wgpu::Buffer,
    planes: wgpu::Buffer,
    corner_bindings: wgpu::BindGroup,
}

/// The light and the eye as the shader takes them (`WedgeFrame` in `shadow_wedges.wgsl`), world, metres.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuWedgeFrame {
    /// World to the light's frame.
    pub light_from_world: Mat4,
    /// xyz: the eye; w: how far places are moved towards it.
    pub eye_m: Vec4,
    /// Middle of the light.
    pub center_m: Vec4,
    /// Half its sides.
    pub half_u_m: Vec4,
    /// The other half side.
    pub half_v_m: Vec4,
    /// x: number of shapes; y: [`N_LINES`].
    pub counts: UVec4,
}

/// A caster as the shaders take it (`WedgeShape` in `shared/wedge.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuWedgeShape {
    /// The caster's own frame to the light's.
    pub light_from_object: Mat4,
    /// Box around it in the light's frame; w of the first: 1 where its faces block from both sides.
    pub low: Vec4,
    /// The box's other corner.
    pub high: Vec4,
    /// First edge, number of edges, first face, number of faces.
    pub ranges: [u32; 4],
}

impl Wedges {
    /// The method with one of its two ways to find the covered share.
    #[must_use]
    pub fn new(gpu: &Gpu, coverage: Coverage) -> Self {
        let sums_areas = f64::from(u8::from(coverage == Coverage::Summed));
        Self {
            coverage,
            corner_pipeline: gpu.compute_pipeline("shadow_wedge_corners"),
            pipeline: gpu.compute_pipeline_variant("shadow_wedges", &[("sums_areas", sums_areas)]),
            frame: gpu.buffer("wedges: frame", &[GpuWedgeFrame::zeroed()]),
            casters: None,
        }
    }

    /// Buffers of the job's casters: the last ones where they are the same objects.
    fn take_or_prepare(&mut self, gpu: &Gpu, job: &Job<'_>) -> Result<Prepared, RenderError> {
        let objects = &job.casters.objects;
        let meshes: Vec<[usize; 3]> = objects
            .iter()
            .map(|caster| [caster.index, caster.mesh.vertices.len(), caster.mesh.indices.len()])
            .collect();
        match self.casters.take().filter(|prepared| prepared.meshes == meshes) {
            Some(prepared) => Ok(prepared),
            None => self.prepare(gpu, meshes, Outlines::new(job.casters)?),
        }
    }

    fn prepare(&self, gpu: &Gpu, meshes: Vec<[usize; 3]>, outlines: Outlines) -> Result<Prepared, RenderError> {
        let limits = gpu.device.limits();
        let n_most = outlines
            .edges
            .len()
            .max(outlines.corners.len())
            .max(outlines.faces.len());
        let room = u64::from(limits.max_compute_workgroups_per_dimension) * GROUP as u64;
        // Entries of the shader's lists have 27 bits for an index.
        let room = room.min(limits.max_storage_buffer_binding_size / 16).min(1 << 27);
        gpu.within("a number of shadow casting edges", n_most as u64, room)?;
        let shapes = gpu.buffer(
            "wedges: shapes",
            &or_one(vec![GpuWedgeShape::zeroed(); outlines.shapes.len()]),
        );
        let corners = gpu.buffer("wedges: corners", &or_one(outlines.corners.clone()));
        let faces = gpu.buffer("wedges: faces", &or_one(outlines.faces.clone()));
        let edges = gpu.buffer("wedges: edges", &or_one(outlines.edges.clone()));
        let [placed, planes] = [
            ("wedges: placed corners", outlines.corners.len()),
            ("wedges: planes", outlines.faces.len()),
        ]
        .map(|(label, n)| gpu.buffer(label, &or_one(vec![Vec4::ZERO; n])));
        let corner_bindings = gpu.bind(
            "shadow_wedge_corners",
            &self.corner_pipeline.get_bind_group_layout(0),
            &[&shapes, &corners, &faces, &placed, &planes].map(wgpu::Buffer::as_entire_binding),
        );
        Ok(Prepared {
            meshes,
            outlines,
            shapes,
            edges,
            faces,
            placed,
            planes,
            corner_bindings,
        })
    }

    /// Uploads where light and casters stand now.
    fn write(&self, gpu: &Gpu, (prepared, job): (&Prepared, &Job<'_>), light: &WedgeLight) {
        let light_from_world = light.light_from_world(self.coverage);
        let shapes: Vec<GpuWedgeShape> = (prepared.outlines.shapes.iter().zip(&job.casters.objects))
            .map(|(shape, caster)| {
                let light_from_object: Affine3A = light_from_world * caster.world_from_object;
                let [low, high] = shape.bounds_in(light_from_object);
                GpuWedgeShape {
                    light_from_object: light_from_object.into(),
                    low: low.extend(f32::from(u8::from(shape.is_open))),
                    high: high.extend(0.0),
                    ranges: shape.ranges,
                }
            })
            .collect();
        if !shapes.is_empty() {
            gpu.write(&prepared.shapes, &shapes);
        }
        let frame = GpuWedgeFrame {
            light_from_world: light_from_world.into(),
            eye_m: job.surface.view.eye_m.extend(light.lift_m),
            center_m: light.center_m.extend(0.0),
            half_u_m: light.half_m[0].extend(0.0),
            half_v_m: light.half_m[1].extend(0.0),
            counts: UVec4::new(shapes.len() as u32, N_LINES as u32, 0, 0),
        };
        gpu.write(&self.frame, &[frame]);
    }
}

impl KeyShadow for Wedges {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        let light = WedgeLight::new(job.light, job.casters.bounds())?;
        let prepared = self.take_or_prepare(gpu, job)?;
        self.write(gpu, (&prepared, job), &light);
        let bindings = gpu.bind(
            "shadow_wedges",
            &self.pipeline.get_bind_group_layout(0),
            &[
                self.frame.as_entire_binding(),
                prepared.shapes.as_entire_binding(),
                prepared.placed.as_entire_binding(),
                prepared.planes.as_entire_binding(),
                prepared.edges.as_entire_binding(),
                prepared.faces.as_entire_binding(),
                wgpu::BindingResource::TextureView(&job.surface.place),
                wgpu::BindingResource::TextureView(&job.surface.normal),
                wgpu::BindingResource::TextureView(job.visibility),
            ],
        );
        let n_most = prepared.outlines.corners.len().max(prepared.outlines.faces.len());
        let [width, height] = job.surface.view.size_px;
        let stages = [
            (
                "wedge corners",
                &self.corner_pipeline,
                &prepared.corner_bindings,
                [n_most.div_ceil(GROUP) as u32, 1],
            ),
            (
                "wedges",
                &self.pipeline,
                &bindings,
                [width.div_ceil(8), height.div_ceil(8)],
            ),
        ];
        for (name, pipeline, bindings, [x, y]) in stages {
            let span = timer.span(name);
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some(name),
                timestamp_writes: span.compute(Ends::Both),
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, bindings, &[]);
            pass.dispatch_workgroups(x, y, 1);
        }
        self.casters = Some(prepared);
        Ok(())
    }
}

/// A buffer needs an item.
fn or_one<T: Zeroable>(mut items: Vec<T>) -> Vec<T> {
    if items.is_empty() {
        items.push(T::zeroed());
    }
    items
}
