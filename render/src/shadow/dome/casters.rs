//! Triangles that a dome's maps are drawn from: small ones, since a thread draws a whole triangle.

use bytemuck::{Pod, Zeroable};

use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::scene::{Split, Vertex, split};
use crate::shadow::casters::Casters;

/// Longest edge of a triangle, in texels of a map.
const MAX_EDGE_TEXELS: f32 = 10.0;
/// Most triangles that large ones are split into; beyond it they stay larger, and drawing takes longer.
const MAX_TRIANGLES: usize = 2_000_000;

/// A corner, in its object's frame.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct Corner {
    position_m: [f32; 3],
    object: u32,
}

/// Casters as a list of small triangles.
#[derive(Debug)]
pub struct DomeCasters {
    /// Three corners per triangle.
    pub corners: wgpu::Buffer,
    /// How many triangles there are.
    pub n_triangles: u32,
    bending: Vec<Bending>,
}

/// A caster that changes its shape.
#[derive(Debug)]
struct Bending {
    object: usize,
    /// Its first corner in the list.
    first_corner: usize,
    /// Its split mesh; vertices of the list's corners.
    vertices: Vec<Vertex>,
    ends: Vec<[u32; 2]>,
    of_corners: Vec<u32>,
    /// Corners on their way to the GPU.
    corners: Vec<Corner>,
}

impl DomeCasters {
    /// The triangles of `casters`, split for maps whose texels are about `texel_m` metres.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] for more than two million triangles.
    pub fn new(gpu: &Gpu, casters: &Casters, texel_m: f32) -> Result<Self, RenderError> {
        let mut corners: Vec<Corner> = Vec::new();
        let mut bending = Vec::new();
        for caster in casters.all() {
            let longest_m = (MAX_EDGE_TEXELS * texel_m).max(1e-4);
            let split = split(&caster.mesh, longest_m).unwrap_or_else(|| Split {
                mesh: caster.mesh.clone(),
                ends: Vec::new(),
            });
            let mesh = &split.mesh;
            let first_corner = corners.len();
            let mut of_corners = Vec::new();
            for triangle in mesh.indices.chunks_exact(3) {
                let of = |i: u32| Corner {
                    position_m: mesh.vertices[i as usize].position,
                    object: caster.index as u32,
                };
                let three = [of(triangle[0]), of(triangle[1]), of(triangle[2])];
                if three.iter().all(|c| c.position_m.iter().all(|x| x.is_finite())) {
                    corners.extend(three);
                    if caster.bends {
                        of_corners.extend_from_slice(triangle);
                    }
                }
            }
            if caster.bends {
                bending.push(Bending {
                    object: caster.index,
                    first_corner,
                    vertices: split.mesh.vertices,
                    ends: split.ends,
                    of_corners,
                    corners: Vec::new(),
                });
            }
            if corners.len() / 3 > MAX_TRIANGLES {
                return Err(RenderError::Shadow {
                    method: "dome",
                    message: format!(
                        "the casters up to object `{}` have {} triangles; a dome's maps take {MAX_TRIANGLES}",
                        caster.name,
                        corners.len() / 3
                    ),
                    hint: "use meshes with fewer triangles as casters",
                });
            }
        }
        let n_triangles = (corners.len() / 3) as u32;
        if corners.is_empty() {
            corners.push(Corner::zeroed());
        }
        Ok(Self {
            corners: gpu.buffer("dome: casters", &corners),
            n_triangles,
            bending,
        })
    }

    /// Changes an object's shape: the vertices of its mesh, in its own frame.
    pub fn bend(&mut self, gpu: &Gpu, object: usize, moved: &[Vertex]) {
        let Some(bending) = self.bending.iter_mut().find(|bending| bending.object == object) else {
            return;
        };
        Split::bend(moved, &bending.ends, &mut bending.vertices);
        let corner = |&vertex: &u32| Corner {
            position_m: bending.vertices[vertex as usize].position,
            object: object as u32,
        };
        bending.corners.clear();
        bending.corners.extend(bending.of_corners.iter().map(corner));
        let offset = (bending.first_corner * size_of::<Corner>()) as u64;
        gpu.queue
            .write_buffer(&self.corners, offset, bytemuck::cast_slice(&bending.corners));
    }
}
