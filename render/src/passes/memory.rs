//! Memory of real surfaces: the radiance of every phantom's vertex in the light of now, for rays that meet what the camera does
//! not see (`memory_observe.wgsl`, `memory_mean.wgsl`, `memory_resolve.wgsl`).
//!
//! What the camera saw is kept as its ratio to the irradiance that harmonics give, so that it follows the light. Vertices that
//! it never saw take the probe's picture where the probe sees them, else the mean ratio of their part.

use crate::camera_view::CameraView;
use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::near::parts::Parts;
use crate::scene_gpu::SceneBuffers;
use crate::shadow::dome::Step;

/// Most parts whose means are kept; a workgroup each.
const MAX_PARTS: u32 = 65_535;

/// What the passes read.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// The scene camera and the phantoms that it sees.
    pub view: &'a CameraView,
    /// The scene.
    pub scene: &'a SceneBuffers,
    /// Light around the virtual objects.
    pub environments: &'a Environments,
    /// Radiance of real things in the camera's picture, without virtual shadows, with mips.
    pub unshadowed: &'a wgpu::TextureView,
    /// Radiance at the probe.
    pub probe_radiance: &'a wgpu::TextureView,
    /// Uniform that starts with the probe's place (world, metres).
    pub probe: &'a wgpu::Buffer,
}

/// The passes with what they remember: 40 bytes per vertex of the scene.
#[derive(Debug)]
pub struct Memory {
    observe: Step,
    mean: Step,
    resolve: Step,
    remembered: wgpu::Buffer,
    groups_of_vertices: u32,
    n_parts: u32,
}

impl Memory {
    /// Nothing remembered yet of a scene's `parts`.
    #[must_use]
    pub fn new(gpu: &Gpu, inputs: Inputs<'_>, parts: &Parts) -> Self {
        let bytes = 16 * parts.facts.len() as u64;
        let n_parts = (parts.ranges.len() as u32).min(MAX_PARTS);
        let [ratios, remembered] = ["memory: ratios", "memory: radiance"].map(|label| gpu.storage(label, bytes));
        let means = gpu.storage("memory: means", 16 * parts.ranges.len().max(1) as u64);
        let facts = gpu.buffer("memory: vertices", &parts.facts);
        // A scene without phantoms has one empty part.
        let or_one = |items: &[u32]| if items.is_empty() { vec![0; 2] } else { items.to_vec() };
        let members = gpu.buffer("memory: members", &or_one(&parts.members));
        let ranges = gpu.buffer("memory: parts", &or_one(parts.ranges.as_flattened()));
        let counts = gpu.buffer("memory: counts", &[[inputs.environments.slots.len() as u32, 0, 0, 0]]);
        let linear = gpu.linear_sampler();
        let vertices = [
            inputs.scene.vertices.as_entire_binding(),
            inputs.scene.objects.as_entire_binding(),
            facts.as_entire_binding(),
            inputs.environments.all.as_entire_binding(),
            inputs.environments.harmonics.as_entire_binding(),
            counts.as_entire_binding(),
        ];
        let observe = Step::new(
            gpu,
            "memory_observe",
            &[
                &vertices[..],
                &[
                    inputs.view.camera.as_entire_binding(),
                    wgpu::BindingResource::TextureView(inputs.view.phantoms.views().place),
                    wgpu::BindingResource::TextureView(inputs.unshadowed),
                    wgpu::BindingResource::Sampler(&linear),
                    ratios.as_entire_binding(),
                ],
            ]
            .concat(),
        );
        let mean = Step::new(
            gpu,
            "memory_mean",
            &[&ranges, &members, &ratios, &means].map(wgpu::Buffer::as_entire_binding),
        );
        let resolve = Step::new(
            gpu,
            "memory_resolve",
            &[
                &vertices[..],
                &[
                    inputs.probe.as_entire_binding(),
                    wgpu::BindingResource::TextureView(inputs.probe_radiance),
                    wgpu::BindingResource::Sampler(&linear),
                    ratios.as_entire_binding(),
                    means.as_entire_binding(),
                    remembered.as_entire_binding(),
                ],
            ]
            .concat(),
        );
        Self {
            observe,
            mean,
            resolve,
            remembered,
            groups_of_vertices: (parts.facts.len() as u32).div_ceil(64),
            n_parts,
        }
    }

    /// Radiance per vertex of the scene (linear RGB, the rig's common primaries, four floats; a: 1 for a phantom's).
    #[must_use]
    pub fn remembered(&self) -> &wgpu::Buffer {
        &self.remembered
    }

    /// Looks at the picture, and puts the memory into the light of now.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        if self.n_parts == 0 {
            return;
        }
        self.observe.record(encoder, timer, [self.groups_of_vertices, 1, 1]);
        self.mean.record(encoder, timer, [self.n_parts, 1, 1]);
        self.resolve.record(encoder, timer, [self.groups_of_vertices, 1, 1]);
    }
}
