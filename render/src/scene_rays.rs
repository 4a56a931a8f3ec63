//! The scene for rays on the GPU: every object behind a hierarchy in its own frame, so that objects move by a matrix alone
//! (`shared/scene_ray.wgsl`).

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Mat4, Vec3, Vec4};

use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::scene::{GONE, Kind};
use crate::scene_gpu::{ObjectTriangles, SceneBuffers};
use crate::shadow::path::hierarchy::{Hierarchies, HierarchyBuffers};

/// An object as rays meet it (`Instance` in `shared/scene_ray.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuInstance {
    /// Object to world.
    pub world_from_object: Mat4,
    /// World to object.
    pub object_from_world: Mat4,
    /// Sphere around it in its own frame, metres.
    pub sphere_m: Vec4,
    /// Root of its hierarchy; 1 for a phantom, 2 for a virtual object; slot of its environment; unused.
    pub facts: [u32; 4],
}

/// All objects, for rays.
#[derive(Debug)]
pub struct SceneRays {
    hierarchy: HierarchyBuffers,
    /// The same in memory, where any object changes its shape.
    in_memory: Option<Hierarchies>,
    /// Nodes and triangles of every object.
    parts: Vec<[Range<usize>; 2]>,
    instances: wgpu::Buffer,
    known: Vec<GpuInstance>,
    /// [`kind_bit`] of every object.
    kinds: Vec<u32>,
    vertices: wgpu::Buffer,
}

impl SceneRays {
    /// Hierarchies over the objects of `scene`, which stand at `placements` (world from object).
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] or [`RenderError::Shadow`] for more triangles than rays can take.
    pub fn new(gpu: &Gpu, scene: &SceneBuffers, placements: &[Affine3A]) -> Result<Self, RenderError> {
        let mut hierarchies = Hierarchies::default();
        let mut known = Vec::with_capacity(placements.len());
        let mut parts = Vec::with_capacity(placements.len());
        let kinds = scene.objects_of_rays().iter().map(kind_bit).collect();
        for (object, &placement) in scene.objects_of_rays().iter().zip(placements) {
            let before = hierarchies.lengths();
            let root = hierarchies.add_numbered(gpu, &object.corners(), &object.indices())?;
            let after = hierarchies.lengths();
            parts.push([before[0]..after[0], before[1]..after[1]]);
            known.push(GpuInstance {
                sphere_m: object.sphere_m(),
                facts: [root.link, kind_bit(object), object.slot, 0],
                ..placed(placement)
            });
        }
        if known.is_empty() {
            known.push(GpuInstance::zeroed());
        }
        Ok(Self {
            hierarchy: hierarchies.clone().upload(gpu)?,
            in_memory: scene.bends().then_some(hierarchies),
            parts,
            instances: gpu.buffer("rays: objects", &known),
            known,
            kinds,
            vertices: scene.vertices.clone(),
        })
    }

    /// Follows an object that has changed its shape in `scene`; to be followed by [`SceneRays::place`].
    pub fn bend(&mut self, gpu: &Gpu, scene: &SceneBuffers, object: usize) {
        let Some(hierarchies) = &mut self.in_memory else {
            return;
        };
        let triangles = scene.object_of_rays(object);
        let place_of = |vertex: u32| Vec3::from(triangles.vertices[vertex as usize].position);
        hierarchies.refit(gpu, &self.hierarchy, self.parts[object].clone(), place_of);
        self.known[object].sphere_m = triangles.sphere_m();
    }

    /// Moves the objects: one placement per object, world from object; [`GONE`] ones are not hit.
    pub fn place(&mut self, gpu: &Gpu, placements: &[Affine3A]) {
        for ((instance, &kind), &placement) in self.known.iter_mut().zip(&self.kinds).zip(placements) {
            // No ray looks for an object of no kind.
            instance.facts[1] = if placement == GONE { 0 } else { kind };
            if placement != GONE {
                let moved = placed(placement);
                instance.world_from_object = moved.world_from_object;
                instance.object_from_world = moved.object_from_world;
            }
        }
        gpu.write(&self.instances, &self.known);
    }

    /// Bindings 0 to 3 of a pass that imports `bvh` and `scene_ray`.
    #[must_use]
    pub fn resources(&self) -> [wgpu::BindingResource<'_>; 4] {
        [
            self.hierarchy.nodes.as_entire_binding(),
            self.hierarchy.triangles.as_entire_binding(),
            self.instances.as_entire_binding(),
            self.vertices.as_entire_binding(),
        ]
    }
}

fn placed(world_from_object: Affine3A) -> GpuInstance {
    GpuInstance {
        world_from_object: Mat4::from(world_from_object),
        object_from_world: Mat4::from(world_from_object.inverse()),
        sphere_m: Vec4::ZERO,
        facts: [0; 4],
    }
}

fn kind_bit(object: &ObjectTriangles<'_>) -> u32 {
    match object.kind {
        Kind::Phantom => 1,
        Kind::Virtual => 2,
    }
}

impl ObjectTriangles<'_> {
    /// Corners of its triangles in its own frame, metres.
    fn corners(&self) -> Vec<[Vec3; 3]> {
        self.triangles()
            .map(|corners| corners.map(|i| Vec3::from(self.vertices[i as usize].position)))
            .collect()
    }

    /// The same as indices into the scene's vertices.
    fn indices(&self) -> Vec<[u32; 3]> {
        self.triangles().collect()
    }

    fn triangles(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]])
    }

    fn sphere_m(&self) -> Vec4 {
        let points = || {
            self.indices
                .iter()
                .map(|&i| Vec3::from(self.vertices[i as usize].position))
        };
        let low = points().reduce(Vec3::min).unwrap_or(Vec3::ZERO);
        let high = points().reduce(Vec3::max).unwrap_or(Vec3::ZERO);
        let center = 0.5 * (low + high);
        let radius = points().map(|p| p.distance(center)).fold(0.0, f32::max);
        // A little more, so that rounding leaves nothing out.
        center.extend(1.0001 * radius + 1e-5)
    }
}
