//! Triangles that a dome's maps are drawn from: small ones, since a thread draws a whole triangle.

use bytemuck::{Pod, Zeroable};

use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::scene::subdivided;
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
}

impl DomeCasters {
    /// The triangles of `casters`, split for maps whose texels are about `texel_m` metres.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] for more than two million triangles.
    pub fn new(gpu: &Gpu, casters: &Casters, texel_m: f32) -> Result<Self, RenderError> {
        let mut corners: Vec<Corner> = Vec::new();
        for caster in &casters.objects {
            let longest_m = (MAX_EDGE_TEXELS * texel_m).max(1e-4);
            let split = subdivided(&caster.mesh, longest_m);
            let mesh = split.as_ref().unwrap_or(&caster.mesh);
            for triangle in mesh.indices.chunks_exact(3) {
                let of = |i: u32| Corner {
                    position_m: mesh.vertices[i as usize].position,
                    object: caster.index as u32,
                };
                let three = [of(triangle[0]), of(triangle[1]), of(triangle[2])];
                if three.iter().all(|c| c.position_m.iter().all(|x| x.is_finite())) {
                    corners.extend(three);
                }
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
        })
    }
}
