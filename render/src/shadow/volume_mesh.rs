//! Shadow volumes of casters as triangles: caps, walls from the outline to infinity, caps at infinity.
//!
//! The corners stay on the GPU, each twice: where it is, and pushed to infinity by the vertex stage. A frame uploads indices
//! only, and none while neither light nor objects move.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Vec4};
use rayon::prelude::*;

use super::casters::{Caster, Casters};
use super::silhouette::{Outline, Silhouettes};
use crate::error::RenderError;
use crate::gpu::Gpu;

/// How a volume's corners are read.
pub(super) const CORNER_LAYOUT: wgpu::VertexBufferLayout<'static> = wgpu::VertexBufferLayout {
    array_stride: size_of::<Corner>() as u64,
    step_mode: wgpu::VertexStepMode::Vertex,
    attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Uint32],
};
/// Sets of casters that are kept at most.
const MAX_SETS: usize = 4;
/// Marks a corner that is pushed to infinity.
const AT_INFINITY: u32 = 1 << 31;

/// A corner of a volume.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct Corner {
    /// In the object's frame.
    position: [f32; 3],
    /// The object's index in the scene, with [`AT_INFINITY`].
    object: u32,
}

/// Ranges of a frame's triangles, in [`VolumeDraws`].
pub(super) const WALLS: usize = 0;
/// Caps of the same volumes.
pub(super) const CAPS: usize = 1;
/// Walls of volumes that hold the eye, or may.
pub(super) const WALLS_AROUND_EYE: usize = 2;
/// Caps of the same volumes, at both ends.
pub(super) const CAPS_AROUND_EYE: usize = 3;

/// The triangles of one light's volumes.
#[derive(Debug)]
pub(super) struct VolumeDraws {
    corners: wgpu::Buffer,
    indices: wgpu::Buffer,
    ranges: [Range<u32>; 4],
}

impl VolumeDraws {
    /// Draws one of the ranges with the pipeline and bindings already set.
    pub(super) fn draw(&self, pass: &mut wgpu::RenderPass<'_>, range: usize) {
        let range = self.ranges[range].clone();
        if !range.is_empty() {
            pass.set_vertex_buffer(0, self.corners.slice(..));
            pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(range, 0, 0..1);
        }
    }
}

/// Volumes of the last sets of casters that were asked for.
#[derive(Debug, Default)]
pub(super) struct VolumeMeshes {
    sets: Vec<VolumeMesh>,
}

#[derive(Debug)]
struct VolumeMesh {
    key: Vec<MeshKey>,
    silhouettes: Vec<Silhouettes>,
    first_corners: Vec<u32>,
    corners: wgpu::Buffer,
    drawn: Option<(Pose, VolumeDraws)>,
}

/// A mesh, recognised by where it lies in memory and by how often it has changed its shape.
pub(super) type MeshKey = (usize, usize, usize, u32);

/// What a frame's triangles depend on: the light, the placements, and which volumes may hold the eye.
#[derive(Debug, PartialEq)]
struct Pose {
    light: Vec4,
    placements: Vec<Affine3A>,
    is_around_eye: Vec<bool>,
}

impl VolumeMeshes {
    /// The volumes of all casters for a light (homogeneous, world); `is_around_eye` says which may hold the eye.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] as [`Silhouettes::new`], [`RenderError::TooLarge`] for more corners or triangles than the
    /// adapter's buffers take.
    pub(super) fn draws(
        &mut self,
        gpu: &Gpu,
        casters: &Casters,
        light: Vec4,
        is_around_eye: impl Fn(&Caster) -> bool,
    ) -> Result<&VolumeDraws, RenderError> {
        let key: Vec<MeshKey> = casters.objects.iter().map(mesh_key).collect();
        let set = match self.sets.iter().position(|set| set.key == key) {
            Some(at) => self.sets.remove(at),
            None => VolumeMesh::new(gpu, casters, key)?,
        };
        self.sets.truncate(MAX_SETS - 1);
        self.sets.insert(0, set);
        let pose = Pose {
            light,
            placements: casters.objects.iter().map(|c| c.world_from_object).collect(),
            is_around_eye: casters.objects.iter().map(is_around_eye).collect(),
        };
        self.sets[0].posed(gpu, pose)
    }
}

pub(super) fn mesh_key(caster: &Caster) -> MeshKey {
    let vertices = &caster.mesh.vertices;
    (caster.index, vertices.as_ptr() as usize, vertices.len(), caster.version)
}

impl VolumeMesh {
    fn new(gpu: &Gpu, casters: &Casters, key: Vec<MeshKey>) -> Result<Self, RenderError> {
        let silhouettes = casters
            .objects
            .par_iter()
            .map(|caster| Silhouettes::new(&caster.name, &caster.mesh))
            .collect::<Result<Vec<Silhouettes>, RenderError>>()?;
        let n_corners: usize = silhouettes.iter().map(|s| s.corners().len()).sum();
        let n_bytes = (2 * n_corners * size_of::<Corner>()) as u64;
        gpu.within(
            "a number of bytes for the corners of shadow volumes",
            n_bytes,
            gpu.device.limits().max_buffer_size,
        )?;
        let mut corners: Vec<Corner> = Vec::with_capacity(2 * n_corners + 1);
        let mut first_corners = Vec::with_capacity(silhouettes.len());
        for (caster, silhouettes) in casters.objects.iter().zip(&silhouettes) {
            first_corners.push(corners.len() as u32);
            for corner in silhouettes.corners() {
                corners.extend([0, AT_INFINITY].map(|end| Corner {
                    position: corner.to_array(),
                    object: caster.index as u32 | end,
                }));
            }
        }
        if corners.is_empty() {
            corners.push(Corner::zeroed());
        }
        Ok(Self {
            key,
            silhouettes,
            first_corners,
            corners: gpu.buffer("shadow_volume: corners", &corners),
            drawn: None,
        })
    }

    fn posed(&mut self, gpu: &Gpu, pose: Pose) -> Result<&VolumeDraws, RenderError> {
        let draws = match self.drawn.take() {
            Some((drawn, draws)) if drawn == pose => draws,
            _ => self.draws(gpu, &pose)?,
        };
        Ok(&self.drawn.insert((pose, draws)).1)
    }

    fn draws(&self, gpu: &Gpu, pose: &Pose) -> Result<VolumeDraws, RenderError> {
        let outlines: Vec<Outline> = (self.silhouettes.par_iter().zip(&pose.placements))
            .map(|(silhouettes, placement)| silhouettes.outline(in_object(*placement, pose.light)))
            .collect();
        let is_directional = pose.light.w == 0.0;
        let mut lists: [Vec<u32>; 4] = Default::default();
        for (index, outline) in outlines.iter().enumerate() {
            let is_around_eye = pose.is_around_eye[index];
            let [walls, caps] = if is_around_eye {
                [WALLS_AROUND_EYE, CAPS_AROUND_EYE]
            } else {
                [WALLS, CAPS]
            };
            let first = self.first_corners[index];
            lists[walls].extend(outline.edges.iter().flat_map(|&edge| wall(first, edge, is_directional)));
            for face in &outline.faces {
                let [a, b, c] = face.map(|corner| first + 2 * corner);
                lists[caps].extend([a, b, c]);
                // All ends of a directional light's walls are one point, and only counting behind what is seen meets them.
                if is_around_eye && !is_directional {
                    lists[caps].extend([a + 1, c + 1, b + 1]);
                }
            }
        }
        let mut ends = [0u32; 4];
        let mut all: Vec<u32> = Vec::with_capacity(lists.iter().map(Vec::len).sum::<usize>() + 3);
        for (list, end) in lists.iter().zip(&mut ends) {
            all.extend_from_slice(list);
            *end = all.len() as u32;
        }
        gpu.within(
            "a number of bytes for the triangles of shadow volumes",
            4 * all.len() as u64,
            gpu.device.limits().max_buffer_size,
        )?;
        if all.is_empty() {
            all.extend([0; 3]);
        }
        Ok(VolumeDraws {
            corners: self.corners.clone(),
            indices: gpu.buffer("shadow_volume: triangles", &all),
            ranges: [0..ends[0], ends[0]..ends[1], ends[1]..ends[2], ends[2]..ends[3]],
        })
    }
}

/// The wall that hangs from an edge of the outline, outside of the volume counterclockwise.
fn wall(first_corner: u32, edge: [u32; 2], is_directional: bool) -> impl Iterator<Item = u32> {
    let [a, b] = edge.map(|corner| first_corner + 2 * corner);
    let n = if is_directional { 3 } else { 6 };
    [b, a, a + 1, b, a + 1, b + 1].into_iter().take(n)
}

/// A homogeneous place of the world in an object's frame.
fn in_object(world_from_object: Affine3A, at: Vec4) -> Vec4 {
    glam::Mat4::from(world_from_object.inverse()) * at
}
