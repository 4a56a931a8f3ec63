//! Triangles behind bounding volume hierarchies, flattened for rays on the GPU (`shared/bvh.wgsl`).

use std::ops::Range;
use std::time::Duration;

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;

use super::refused;
use crate::error::RenderError;
use crate::gpu::Gpu;

/// Depth of the deepest hierarchy that is taken: as many nodes may wait on the shader's stack.
pub const MAX_DEPTH: usize = 64;
/// Link of a hierarchy without triangles.
pub const NO_ROOT: u32 = u32::MAX;
/// Nodes and triangles are counted with 24 bits.
const MAX_INDEX: u64 = (1 << 24) - 1;

/// A node (`Node` in `shared/bvh.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuBvhNode {
    /// Lower corner of its box, world, metres.
    pub low: Vec3,
    /// Upper 8 bits: how many triangles, 0 for an inner node; lower 24: the first of them, or the first of two children.
    pub link: u32,
    /// Upper corner.
    pub high: Vec3,
    /// Unused.
    pub unused: u32,
}

/// A triangle (`Triangle` in `shared/bvh.wgsl`): its corners, metres, in each w the corner's number.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuBvhTriangle {
    /// First corner.
    pub a: Vec4,
    /// Second corner.
    pub b: Vec4,
    /// Third corner.
    pub c: Vec4,
}

/// Hierarchies that lie in the same buffers.
#[derive(Debug, Clone, Default)]
pub struct Hierarchies {
    nodes: Vec<GpuBvhNode>,
    triangles: Vec<GpuBvhTriangle>,
}

/// The same on the GPU.
#[derive(Debug)]
pub struct HierarchyBuffers {
    /// Nodes.
    pub nodes: wgpu::Buffer,
    /// Triangles.
    pub triangles: wgpu::Buffer,
}

/// One hierarchy among them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Root {
    /// What the shader starts from.
    pub link: u32,
    /// For each of its triangles in the buffer, in order, its position in what was given.
    pub order: Vec<u32>,
}

impl Hierarchies {
    /// Adds a hierarchy over triangles (corners, world, metres); those with a corner that is no finite number are left out.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] for more than 16 million triangles or nodes in all, [`RenderError::Shadow`] for triangles so
    /// unevenly spread that the hierarchy gets too deep.
    pub fn add(&mut self, gpu: &Gpu, corners: &[[Vec3; 3]]) -> Result<Root, RenderError> {
        self.add_numbered(gpu, corners, &[])
    }

    /// The same; every corner takes a number along, in its w: the rows of `numbers`, 0 beyond their end. Numbers below
    /// 2^24 arrive as they are.
    ///
    /// # Errors
    /// As [`Hierarchies::add`].
    pub fn add_numbered(
        &mut self,
        gpu: &Gpu,
        corners: &[[Vec3; 3]],
        numbers: &[[u32; 3]],
    ) -> Result<Root, RenderError> {
        let (chosen, triangles): (Vec<u32>, Vec<Triangle>) = corners
            .iter()
            .enumerate()
            .filter(|(_, triangle)| triangle.iter().all(|corner| corner.is_finite()))
            .map(|(i, &[a, b, c])| {
                let triangle = Triangle {
                    v0: a.into(),
                    v1: b.into(),
                    v2: c.into(),
                };
                (i as u32, triangle)
            })
            .unzip();
        // A hierarchy has at most two nodes per triangle.
        let wanted = (self.nodes.len() + 2 * triangles.len()) as u64;
        gpu.within("a number of nodes over triangles", wanted, MAX_INDEX)?;
        if triangles.is_empty() {
            return Ok(Root {
                link: NO_ROOT,
                order: Vec::new(),
            });
        }
        let built = build_bvh2_from_tris(&triangles, BvhBuildParams::medium_build(), &mut Duration::default());
        let depth = built.depth(0);
        if depth > MAX_DEPTH {
            return Err(refused(
                format!("the hierarchy over the triangles is {depth} nodes deep; {MAX_DEPTH} at most"),
                "remove tiny or degenerate triangles from the meshes",
            ));
        }
        let (first_node, first_triangle) = (self.nodes.len() as u32, self.triangles.len() as u32);
        let link_of = |n_triangles: u32, first: u32| {
            let base = if n_triangles == 0 { first_node } else { first_triangle };
            (n_triangles << 24) | (base + first)
        };
        self.nodes.extend(built.nodes.iter().map(|node| GpuBvhNode {
            low: node.aabb().min.into(),
            link: link_of(node.prim_count, node.first_index),
            high: node.aabb().max.into(),
            unused: 0,
        }));
        let order: Vec<u32> = built.primitive_indices.iter().map(|&i| chosen[i as usize]).collect();
        self.triangles.extend(order.iter().map(|&i| {
            let own = numbers.get(i as usize).copied().unwrap_or_default();
            let of = |k: usize| corners[i as usize][k].extend(own[k] as f32);
            GpuBvhTriangle {
                a: of(0),
                b: of(1),
                c: of(2),
            }
        }));
        Ok(Root {
            link: self.nodes[first_node as usize].link,
            order,
        })
    }

    /// How many nodes and triangles there are.
    #[must_use]
    pub fn lengths(&self) -> [usize; 2] {
        [self.nodes.len(), self.triangles.len()]
    }

    /// Follows corners that have moved: triangles `range` (as [`Hierarchies::lengths`] counted them) take the places that
    /// `place_of` has for the numbers of their corners, and the boxes above them grow or shrink; the tree stays as it was
    /// built (Wald, Boulos, Shirley 2007, "Ray tracing deformable scenes using dynamic bounding volume hierarchies").
    pub fn refit(
        &mut self,
        gpu: &Gpu,
        buffers: &HierarchyBuffers,
        [nodes, triangles]: [Range<usize>; 2],
        place_of: impl Fn(u32) -> Vec3,
    ) {
        if triangles.is_empty() {
            return;
        }
        self.follow(&nodes, &triangles, place_of);
        let offset = |range: &Range<usize>, size: usize| (range.start * size) as u64;
        gpu.queue.write_buffer(
            &buffers.nodes,
            offset(&nodes, size_of::<GpuBvhNode>()),
            bytemuck::cast_slice(&self.nodes[nodes]),
        );
        gpu.queue.write_buffer(
            &buffers.triangles,
            offset(&triangles, size_of::<GpuBvhTriangle>()),
            bytemuck::cast_slice(&self.triangles[triangles]),
        );
    }

    fn follow(&mut self, nodes: &Range<usize>, triangles: &Range<usize>, place_of: impl Fn(u32) -> Vec3) {
        for triangle in &mut self.triangles[triangles.clone()] {
            for corner in [&mut triangle.a, &mut triangle.b, &mut triangle.c] {
                *corner = place_of(corner.w as u32).extend(corner.w);
            }
        }
        let root = self.nodes[nodes.start].link;
        let [low, high] = self.refit_below(root);
        (self.nodes[nodes.start].low, self.nodes[nodes.start].high) = (low, high);
    }

    /// The box around all that hangs on a link; no deeper than [`MAX_DEPTH`].
    fn refit_below(&mut self, link: u32) -> [Vec3; 2] {
        let (n_triangles, first) = ((link >> 24) as usize, (link & MAX_INDEX as u32) as usize);
        let mut around = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        let mut hold = |low: Vec3, high: Vec3| around = [around[0].min(low), around[1].max(high)];
        // `first` counts nodes or triangles, and there are more nodes.
        if n_triangles == 0 {
            for child in [first, first + 1] {
                let [low, high] = self.refit_below(self.nodes[child].link);
                (self.nodes[child].low, self.nodes[child].high) = (low, high);
                hold(low, high);
            }
        } else {
            for triangle in &self.triangles[first..first + n_triangles] {
                for corner in [triangle.a, triangle.b, triangle.c] {
                    hold(corner.truncate(), corner.truncate());
                }
            }
        }
        around
    }

    /// Uploads all of them.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] for more bytes than the adapter binds.
    pub fn upload(mut self, gpu: &Gpu) -> Result<HierarchyBuffers, RenderError> {
        if self.nodes.is_empty() {
            self.nodes.push(GpuBvhNode::zeroed());
            self.triangles.push(GpuBvhTriangle::zeroed());
        }
        within_binding(gpu, "a number of bytes of triangles", size_of_val(&self.triangles[..]))?;
        within_binding(
            gpu,
            "a number of bytes of nodes over triangles",
            size_of_val(&self.nodes[..]),
        )?;
        Ok(HierarchyBuffers {
            nodes: gpu.buffer("path: nodes", &self.nodes),
            triangles: gpu.buffer("path: triangles", &self.triangles),
        })
    }
}

/// Refuses a storage buffer larger than the adapter binds.
pub(super) fn within_binding(gpu: &Gpu, what: &'static str, bytes: usize) -> Result<(), RenderError> {
    let limits = gpu.device.limits();
    let limit = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size);
    gpu.within(what, bytes as u64, limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_follow_corners_that_move() {
        let node = |link: u32| GpuBvhNode {
            link,
            ..GpuBvhNode::zeroed()
        };
        // A root over two leaves of a triangle each, behind more nodes than there are triangles; corners numbered 0 to 5.
        let triangle = |first: f32| GpuBvhTriangle {
            a: Vec4::W * first,
            b: Vec4::W * (first + 1.0),
            c: Vec4::W * (first + 2.0),
        };
        let mut hierarchies = Hierarchies {
            nodes: vec![node(3), node(0), node(0), node(1 << 24), node(1 << 24 | 1)],
            triangles: vec![triangle(0.0), triangle(3.0)],
        };
        let places = [
            Vec3::ZERO,
            Vec3::X,
            Vec3::Y,
            5.0 * Vec3::Z,
            7.0 * Vec3::Z,
            Vec3::new(1.0, -2.0, 6.0),
        ];
        hierarchies.follow(&(0..5), &(0..2), |corner| places[corner as usize]);
        let boxes: Vec<[Vec3; 2]> = hierarchies.nodes.iter().map(|node| [node.low, node.high]).collect();
        let second = [Vec3::new(0.0, -2.0, 5.0), Vec3::new(1.0, 0.0, 7.0)];
        assert_eq!(boxes[3], [Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0)]);
        assert_eq!(boxes[4], second);
        assert_eq!(boxes[0], [second[0].min(Vec3::ZERO), second[1].max(boxes[3][1])]);
        assert_eq!(
            hierarchies.triangles[1].c,
            places[5].extend(5.0),
            "corners keep their numbers"
        );
    }
}
