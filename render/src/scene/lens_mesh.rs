//! Triangles small enough for a distorted lens.
//!
//! The vertex shader bends corners exactly as the lens does, but edges between them stay straight.
//! An edge of s pixels is off by about s² |k1| r / f · 3/4: with edges of at most 4 cm, 0.1 px for the lenses of a lab rig.

use glam::Vec3;

use super::{Mesh, Vertex};

/// Most triangles that a mesh may become.
const MAX_TRIANGLES: usize = 4_000_000;

/// A mesh whose long edges have been split.
#[derive(Debug, Clone, PartialEq)]
pub struct Split {
    /// The vertices as they were, then the middles of edges.
    pub mesh: Mesh,
    /// For every middle, in order, the ends of its edge: vertices before it.
    pub ends: Vec<[u32; 2]>,
}

/// The mesh with every edge longer than `max_edge_m` split, so that neighbouring triangles still share their corners.
///
/// Each round splits long edges at their middles (the same middle for both neighbours, hence no cracks).
/// `None` when that would take more than four million triangles: the mesh is not in metres.
#[must_use]
pub fn subdivided(mesh: &Mesh, max_edge_m: f32) -> Option<Mesh> {
    split(mesh, max_edge_m).map(|split| split.mesh)
}

/// As [`subdivided`], with what tells where the new vertices are when the old ones move.
#[must_use]
pub fn split(mesh: &Mesh, max_edge_m: f32) -> Option<Split> {
    const MAX_ROUNDS: u32 = 8;
    let mut mesh = mesh.clone();
    let mut ends = Vec::new();
    for _ in 0..MAX_ROUNDS {
        let before = mesh.indices.len();
        mesh = split_once(&mesh, max_edge_m, &mut ends);
        if mesh.indices.len() == before {
            break;
        }
        if mesh.indices.len() / 3 > MAX_TRIANGLES {
            return None;
        }
    }
    Some(Split { mesh, ends })
}

impl Split {
    /// Moves the vertices: positions, normals and tangents of the ones as they were are `moved`'s, the middles follow.
    pub fn bend(moved: &[Vertex], ends: &[[u32; 2]], vertices: &mut [Vertex]) {
        for (vertex, moved) in vertices.iter_mut().zip(moved) {
            (vertex.position, vertex.normal, vertex.tangent) = (moved.position, moved.normal, moved.tangent);
        }
        for (index, [a, b]) in (moved.len()..).zip(ends) {
            vertices[index] = between(&vertices[*a as usize], &vertices[*b as usize]);
        }
    }
}

fn split_once(mesh: &Mesh, max_edge_m: f32, ends: &mut Vec<[u32; 2]>) -> Mesh {
    let mut out = Mesh {
        vertices: mesh.vertices.clone(),
        indices: Vec::new(),
        materials: mesh.materials.clone(),
    };
    let mut middles = std::collections::HashMap::new();
    let long = |a: u32, b: u32| {
        let position = |i: u32| Vec3::from(mesh.vertices[i as usize].position);
        position(a).distance(position(b)) > max_edge_m
    };
    for triangle in mesh.indices.chunks_exact(3) {
        let [a, b, c] = [triangle[0], triangle[1], triangle[2]];
        let mut middle = |a: u32, b: u32, out: &mut Mesh| {
            long(a, b).then(|| {
                *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    ends.push([a, b]);
                    out.vertices
                        .push(between(&mesh.vertices[a as usize], &mesh.vertices[b as usize]));
                    out.vertices.len() as u32 - 1
                })
            })
        };
        let (ab, bc, ca) = (middle(a, b, &mut out), middle(b, c, &mut out), middle(c, a, &mut out));
        out.indices.extend(pieces([a, b, c], [ab, bc, ca]));
    }
    out
}

/// Triangles that a corner triple falls into when the named edges (ab, bc, ca) have middles.
fn pieces([a, b, c]: [u32; 3], middles: [Option<u32>; 3]) -> Vec<u32> {
    match middles {
        [None, None, None] => vec![a, b, c],
        [Some(m), None, None] => vec![a, m, c, m, b, c],
        [None, Some(m), None] => vec![b, m, a, m, c, a],
        [None, None, Some(m)] => vec![c, m, b, m, a, b],
        [Some(m), Some(n), None] => vec![m, b, n, a, m, n, a, n, c],
        [None, Some(m), Some(n)] => vec![m, c, n, b, m, n, b, n, a],
        [Some(n), None, Some(m)] => vec![m, a, n, c, m, n, c, n, b],
        [Some(m), Some(n), Some(o)] => vec![a, m, o, m, b, n, o, n, c, m, n, o],
    }
}

fn between(a: &Vertex, b: &Vertex) -> Vertex {
    let middle = |a: [f32; 3], b: [f32; 3]| 0.5 * (Vec3::from(a) + Vec3::from(b));
    let along = |v: &Vertex| Vec3::from_slice(&v.tangent[..3]);
    let tangent = (along(a) + along(b)).try_normalize().unwrap_or(along(a));
    Vertex {
        position: middle(a.position, b.position).to_array(),
        object: a.object,
        normal: middle(a.normal, b.normal)
            .try_normalize()
            .unwrap_or(Vec3::from(a.normal))
            .to_array(),
        material: a.material,
        uv: mean(a.uv, b.uv),
        uv1: mean(a.uv1, b.uv1),
        tangent: [tangent.x, tangent.y, tangent.z, a.tangent[3]],
        color: mean(a.color, b.color),
    }
}

fn mean<const N: usize>(a: [f32; N], b: [f32; N]) -> [f32; N] {
    std::array::from_fn(|i| 0.5 * (a[i] + b[i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mesh(corners: [Vec3; 3]) -> Mesh {
        let vertex = |p: Vec3| Vertex {
            position: p.to_array(),
            object: 0,
            normal: [0.0, 0.0, 1.0],
            material: 0,
            ..Vertex::PLAIN
        };
        Mesh {
            vertices: corners.map(vertex).to_vec(),
            indices: vec![0, 1, 2],
            materials: Vec::new(),
        }
    }

    fn area(mesh: &Mesh) -> Vec3 {
        mesh.indices
            .chunks_exact(3)
            .map(|t| {
                let p = |i: usize| Vec3::from(mesh.vertices[t[i] as usize].position);
                0.5 * (p(1) - p(0)).cross(p(2) - p(0))
            })
            .sum()
    }

    proptest! {
        #[test]
        fn edges_get_short_and_the_signed_area_stays(
            ax in -1.0f32..1.0, ay in -1.0f32..1.0, bx in -1.0f32..1.0, by in -1.0f32..1.0, max in 0.1f32..0.5,
        ) {
            let before = mesh([Vec3::ZERO, Vec3::new(ax, ay, 0.0), Vec3::new(bx, by, 0.0)]);
            let after = subdivided(&before, max).unwrap();
            prop_assert!((area(&before) - area(&after)).length() < 1e-4);
            for t in after.indices.chunks_exact(3) {
                for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                    let p = |k: usize| Vec3::from(after.vertices[t[k] as usize].position);
                    prop_assert!(p(i).distance(p(j)) <= max * 1.001);
                }
            }
        }
    }
}
