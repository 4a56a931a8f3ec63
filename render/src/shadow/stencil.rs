//! What all methods share that count shadow volumes in the stencil: the pipelines that count, and the pass that turns a
//! count into a visibility.

use super::key::Job;
use super::surface::DEPTH_STENCIL_FORMAT;
use super::volume_mesh::{CORNER_LAYOUT, VolumeDraws};
use crate::gpu::Gpu;
use crate::gpu::pass::RADIANCE_FORMAT;
use crate::gpu::shader;
use crate::gpu::timer::{Ends, Timer};

/// Pushes a cap away from the eye: a surface that is a cap itself is then outside the volume where it is turned towards
/// the light and inside where it is turned away, without ties.
pub(super) const CAP_BIAS: wgpu::DepthBiasState = wgpu::DepthBiasState {
    constant: 8,
    slope_scale: 1.0,
    clamp: 0.0,
};

/// How one kind of polygons is counted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Count {
    /// For polygons that are turned towards the eye.
    pub(super) front: wgpu::StencilFaceState,
    /// For those turned away.
    pub(super) back: wgpu::StencilFaceState,
    /// Which of them are left out.
    pub(super) cull: Option<wgpu::Face>,
    /// How their depth is moved.
    pub(super) bias: wgpu::DepthBiasState,
}

impl Count {
    /// Counts polygons in front of what is seen.
    pub(super) fn passing(operation: wgpu::StencilOperation) -> wgpu::StencilFaceState {
        wgpu::StencilFaceState {
            compare: wgpu::CompareFunction::Always,
            fail_op: wgpu::StencilOperation::Keep,
            depth_fail_op: wgpu::StencilOperation::Keep,
            pass_op: operation,
        }
    }

    /// Counts polygons at or behind what is seen.
    pub(super) fn failing(operation: wgpu::StencilOperation) -> wgpu::StencilFaceState {
        wgpu::StencilFaceState {
            compare: wgpu::CompareFunction::Always,
            fail_op: wgpu::StencilOperation::Keep,
            depth_fail_op: operation,
            pass_op: wgpu::StencilOperation::Keep,
        }
    }
}

/// Makes counting pipelines with one common layout, and resolves.
#[derive(Debug)]
pub(super) struct Stencil {
    layout: wgpu::BindGroupLayout,
    counts: Vec<wgpu::RenderPipeline>,
    resolve: wgpu::RenderPipeline,
}

impl Stencil {
    /// Pipelines that count in these ways, in their order.
    pub(super) fn new(gpu: &Gpu, counts: &[Count]) -> Self {
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
            label: Some("shadow_volume"),
            entries: &[
                binding(0, wgpu::BufferBindingType::Uniform),
                binding(1, wgpu::BufferBindingType::Storage { read_only: true }),
                binding(2, wgpu::BufferBindingType::Uniform),
            ],
        });
        let counts = counts.iter().map(|count| count_pipeline(gpu, &layout, count)).collect();
        Self {
            layout,
            counts,
            resolve: resolve_pipeline(gpu),
        }
    }

    /// Clears the stencil and counts: each entry of `order` draws some ranges of `draws` with one of the pipelines.
    pub(super) fn record_count(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (job, draws, order): (&Job<'_>, &VolumeDraws, &[(usize, usize)]),
    ) {
        let bindings = gpu.bind(
            "shadow_volume",
            &self.layout,
            &[
                job.surface.view_buffer.as_entire_binding(),
                job.scene.objects.as_entire_binding(),
                job.light_buffer.as_entire_binding(),
            ],
        );
        let span = timer.span("shadow_volume");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow_volume"),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &job.surface.depth_stencil,
                depth_ops: None,
                stencil_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0),
                    store: wgpu::StoreOp::Store,
                }),
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_bind_group(0, &bindings, &[]);
        for &(pipeline, range) in order {
            pass.set_pipeline(&self.counts[pipeline]);
            draws.draw(&mut pass, range);
        }
    }

    /// Fills the visibility: 0 where something was counted, else 1.
    pub(super) fn record_resolve(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, job: &Job<'_>) {
        let span = timer.span("shadow_stencil");
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow_stencil"),
            color_attachments: &[Some(lit(job.visibility))],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &job.surface.depth_stencil,
                depth_ops: None,
                stencil_ops: None,
            }),
            timestamp_writes: span.render(Ends::Both),
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.resolve);
        pass.set_stencil_reference(0);
        pass.draw(0..3, 0..1);
    }
}

/// A visibility that is 1 before anything is drawn into it.
pub(super) fn lit(view: &wgpu::TextureView) -> wgpu::RenderPassColorAttachment<'_> {
    wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations {
            load: wgpu::LoadOp::Clear(wgpu::Color::WHITE),
            store: wgpu::StoreOp::Store,
        },
    }
}

fn count_pipeline(gpu: &Gpu, layout: &wgpu::BindGroupLayout, count: &Count) -> wgpu::RenderPipeline {
    let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("shadow_volume"),
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("shadow_volume"),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &shader::module(&gpu.device, "shadow_volume"),
            entry_point: Some("vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(CORNER_LAYOUT)],
        },
        primitive: wgpu::PrimitiveState {
            cull_mode: count.cull,
            ..wgpu::PrimitiveState::default()
        },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_STENCIL_FORMAT,
            depth_write_enabled: Some(false),
            depth_compare: Some(wgpu::CompareFunction::Less),
            stencil: wgpu::StencilState {
                front: count.front,
                back: count.back,
                read_mask: 0xff,
                write_mask: 0xff,
            },
            bias: count.bias,
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: None,
        multiview_mask: None,
        cache: None,
    })
}

fn resolve_pipeline(gpu: &Gpu) -> wgpu::RenderPipeline {
    let module = shader::module(&gpu.device, "shadow_stencil");
    let counted = wgpu::StencilFaceState {
        compare: wgpu::CompareFunction::NotEqual,
        ..wgpu::StencilFaceState::IGNORE
    };
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("shadow_stencil"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_STENCIL_FORMAT,
            depth_write_enabled: Some(false),
            // Nearer than infinity: where there is no surface there is no shadow.
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState {
                front: counted,
                back: counted,
                read_mask: 0xff,
                write_mask: 0,
            },
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(wgpu::ColorTargetState::from(RADIANCE_FORMAT))],
        }),
        multiview_mask: None,
        cache: None,
    })
}
