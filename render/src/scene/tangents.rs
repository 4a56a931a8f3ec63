//! Tangents of meshes that have none, for normal maps.
//!
//! Directions of growing u, weighted at every corner by the triangle's angle there and laid into the plane of the normal, as
//! MikkTSpace does (Mikkelsen 2008, "Simulation of wrinkled surfaces revisited"), over vertices as the file shares them.

use glam::{Vec2, Vec3};

use super::Vertex;

/// Writes tangents into the vertices that `indices` use, `uv` being the coordinates that the normal map goes by. A vertex
/// that triangles with mirrored and with unmirrored coordinates share is split: its twin comes after all others. Returns
/// which vertex each of these is the twin of.
pub(super) fn fill(vertices: &mut Vec<Vertex>, indices: &mut [u32], uv: impl Fn(&Vertex) -> Vec2) -> Vec<u32> {
    // Of every vertex: sums of the triangles whose coordinates run the right way round, and of the mirrored ones.
    let mut sums = vec![[Vec3::ZERO; 2]; vertices.len()];
    let mut used = vec![[false; 2]; vertices.len()];
    for triangle in indices.chunks_exact(3) {
        let corners = [triangle[0], triangle[1], triangle[2]].map(|i| i as usize);
        let (along, side) = along_u(corners.map(|i| &vertices[i]), &uv);
        for k in 0..3 {
            let corner = corners[k];
            let angle = angle_at(vertices, [corner, corners[(k + 1) % 3], corners[(k + 2) % 3]]);
            let normal = Vec3::from(vertices[corner].normal);
            sums[corner][side] += angle * along.reject_from(normal).normalize_or_zero();
            used[corner][side] = true;
        }
    }
    let mut twins = vec![None; sums.len()];
    let mut origins = Vec::new();
    for index in 0..sums.len() {
        let sides = used[index];
        let first = usize::from(!sides[0]);
        vertices[index].tangent = tangent(&vertices[index], sums[index][first], first);
        if sides == [true; 2] {
            let mut twin = vertices[index];
            twin.tangent = tangent(&twin, sums[index][1], 1);
            twins[index] = Some(vertices.len() as u32);
            vertices.push(twin);
            origins.push(index as u32);
        }
    }
    for triangle in indices.chunks_exact_mut(3) {
        let corners = [triangle[0], triangle[1], triangle[2]].map(|i| i as usize);
        if along_u(corners.map(|i| &vertices[i]), &uv).1 == 1 {
            for index in triangle {
                *index = twins[*index as usize].unwrap_or(*index);
            }
        }
    }
    origins
}

/// Any tangent of a surface with this normal.
pub(super) fn any(normal: Vec3) -> [f32; 4] {
    normal
        .any_orthogonal_vector()
        .normalize_or(Vec3::X)
        .extend(1.0)
        .to_array()
}

/// Direction in which u grows over a triangle (Lengyel 2001), zero where it does not, and 1 for mirrored coordinates.
fn along_u(corners: [&Vertex; 3], uv: impl Fn(&Vertex) -> Vec2) -> (Vec3, usize) {
    let [a, b, c] = corners.map(|v| Vec3::from(v.position));
    let [uv_a, uv_b, uv_c] = corners.map(uv);
    let (one, other) = (uv_b - uv_a, uv_c - uv_a);
    // v runs down the picture and up the surface (glTF 2.0, 3.8.3), so that the bitangent points along -v of the picture.
    let area = one.perp_dot(other);
    let along = ((b - a) * other.y - (c - a) * one.y) * area.signum();
    let along = if area == 0.0 { Vec3::ZERO } else { along };
    (along.normalize_or_zero(), usize::from(area > 0.0))
}

fn angle_at(vertices: &[Vertex], [corner, next, last]: [usize; 3]) -> f32 {
    let place = |i: usize| Vec3::from(vertices[i].position);
    let (one, other) = (place(next) - place(corner), place(last) - place(corner));
    if one == Vec3::ZERO || other == Vec3::ZERO {
        return 0.0;
    }
    one.angle_between(other)
}

fn tangent(vertex: &Vertex, sum: Vec3, side: usize) -> [f32; 4] {
    let sense = if side == 0 { 1.0 } else { -1.0 };
    match sum.try_normalize() {
        Some(along) => along.extend(sense).to_array(),
        // Coordinates without area: any direction does.
        None => any(Vec3::from(vertex.normal)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vertex(position: [f32; 3], uv: [f32; 2]) -> Vertex {
        Vertex {
            position,
            uv,
            ..Vertex::PLAIN
        }
    }

    fn uv(vertex: &Vertex) -> Vec2 {
        Vec2::from(vertex.uv)
    }

    #[test]
    fn a_picture_that_lies_upright_has_its_tangent_to_the_right_and_its_bitangent_up() {
        // v = 0 is the picture's upper edge.
        let mut vertices = vec![
            vertex([0.0, 0.0, 0.0], [0.0, 1.0]),
            vertex([1.0, 0.0, 0.0], [1.0, 1.0]),
            vertex([0.0, 1.0, 0.0], [0.0, 0.0]),
        ];
        fill(&mut vertices, &mut [0, 1, 2], uv);
        for v in &vertices {
            assert_eq!(v.tangent, [1.0, 0.0, 0.0, 1.0]);
        }
    }

    #[test]
    fn corners_of_mirrored_and_unmirrored_triangles_are_split() {
        let mut vertices = vec![
            vertex([0.0, 0.0, 0.0], [0.0, 1.0]),
            vertex([0.0, 1.0, 0.0], [0.0, 0.0]),
            vertex([-1.0, 0.0, 0.0], [1.0, 1.0]),
            vertex([1.0, 0.0, 0.0], [1.0, 1.0]),
        ];
        let mut indices = [0, 3, 1, 0, 1, 2];
        assert_eq!(fill(&mut vertices, &mut indices, uv), [0, 1]);
        assert_eq!(vertices.len(), 6);
        let tangents: Vec<[f32; 4]> = indices.iter().map(|&i| vertices[i as usize].tangent).collect();
        assert_eq!(tangents[..3], [[1.0, 0.0, 0.0, 1.0]; 3]);
        assert_eq!(tangents[3..], [[-1.0, 0.0, 0.0, -1.0]; 3]);
    }

    #[test]
    fn coordinates_without_area_give_some_tangent() {
        let mut vertices = vec![
            vertex([0.0, 0.0, 0.0], [0.5, 0.5]),
            vertex([1.0, 0.0, 0.0], [0.5, 0.5]),
            vertex([0.0, 1.0, 0.0], [0.5, 0.5]),
        ];
        fill(&mut vertices, &mut [0, 1, 2], uv);
        for v in &vertices {
            let along = Vec3::from_slice(&v.tangent[..3]);
            assert!((along.length() - 1.0).abs() < 1e-5 && along.z.abs() < 1e-5, "{along}");
        }
    }
}
