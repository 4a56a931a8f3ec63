//! Vertices and triangles of glTF files.

use glam::{Mat3, Mat4, Vec3, Vec4};
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::util::{ReadColors, ReadTexCoords};
use gltf::{Primitive, Semantic};

use super::material::UvSet;
use super::{Vertex, gltf_check, tangents};

/// The triangles of a primitive.
pub(super) struct Triangles {
    /// Corners; without normals of their own they have those of the faces around them.
    pub(super) vertices: Vec<Vertex>,
    /// Three per triangle.
    pub(super) indices: Vec<u32>,
    /// Whether the file gives tangents.
    pub(super) has_tangents: bool,
    /// Whether the file gives texture coordinates, by set.
    uv_sets: [bool; 2],
}

/// Reads a primitive in its node's frame; a message says which attribute is wrong.
pub(super) fn read(primitive: &Primitive<'_>, buffers: &[gltf::buffer::Data]) -> Result<Triangles, String> {
    check_attributes(primitive, buffers)?;
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| &data.0[..]));
    let positions: Vec<Vec3> = reader
        .read_positions()
        .ok_or("a primitive has no positions")?
        .map(Vec3::from)
        .collect();
    let mut indices: Vec<u32> = match reader.read_indices() {
        Some(indices) => indices.into_u32().collect(),
        None => (0..positions.len() as u32).collect(),
    };
    indices.truncate(indices.len() / 3 * 3);
    check_triangles(&positions, &indices)?;
    let mut triangles = Triangles {
        vertices: positions
            .iter()
            .map(|position| Vertex {
                position: position.to_array(),
                ..Vertex::PLAIN
            })
            .collect(),
        has_tangents: primitive.get(&Semantic::Tangents).is_some(),
        uv_sets: [0, 1].map(|set| primitive.get(&Semantic::TexCoords(set)).is_some()),
        indices,
    };
    let vertices = &mut triangles.vertices;
    fill(vertices, reader.read_normals(), |vertex, normal| vertex.normal = normal);
    fill(vertices, reader.read_tangents(), |vertex, tangent| {
        vertex.tangent = tangent;
    });
    fill(
        vertices,
        reader.read_tex_coords(0).map(ReadTexCoords::into_f32),
        |vertex, uv| vertex.uv = uv,
    );
    fill(
        vertices,
        reader.read_tex_coords(1).map(ReadTexCoords::into_f32),
        |vertex, uv| vertex.uv1 = uv,
    );
    fill(
        vertices,
        reader.read_colors(0).map(ReadColors::into_rgba_f32),
        |vertex, color| {
            vertex.color = color;
        },
    );
    check_numbers(vertices)?;
    triangles.complete_normals(primitive.get(&Semantic::Normals).is_some());
    Ok(triangles)
}

impl Triangles {
    /// Whether the file gives these texture coordinates.
    pub(super) fn has_uv(&self, set: UvSet) -> bool {
        self.uv_sets[set.index() as usize]
    }

    /// Whether triangles run clockwise around the normals that the file gives, more than one in a hundred: which of their
    /// sides is the front is not known then.
    pub(super) fn are_turned(&self) -> bool {
        let is_turned = |triangle: &&[u32]| {
            let [a, b, c] = [0, 1, 2].map(|k| &self.vertices[triangle[k] as usize]);
            let place = |v: &Vertex| Vec3::from(v.position);
            let face = (place(b) - place(a)).cross(place(c) - place(a));
            let normals = Vec3::from(a.normal) + Vec3::from(b.normal) + Vec3::from(c.normal);
            face.dot(normals) < 0.0
        };
        100 * self.indices.chunks_exact(3).filter(is_turned).count() > self.indices.len() / 3
    }

    /// Moves the triangles into the object's frame and gives them their material.
    pub(super) fn place(&mut self, object_from_node: Mat4, material: u32) {
        let linear = Mat3::from_mat4(object_from_node);
        let normal_matrix = linear.inverse().transpose();
        let is_mirrored = linear.determinant() < 0.0;
        let sense = if is_mirrored { -1.0 } else { 1.0 };
        for vertex in &mut self.vertices {
            let normal = normal_matrix * Vec3::from(vertex.normal);
            let normal = normal.try_normalize().unwrap_or(Vec3::Z);
            let along = linear * Vec3::from_slice(&vertex.tangent[..3]);
            vertex.position = object_from_node
                .transform_point3(Vec3::from(vertex.position))
                .to_array();
            vertex.tangent = along.try_normalize().map_or_else(
                || tangents::any(normal),
                |along| along.extend(sense * vertex.tangent[3]).to_array(),
            );
            vertex.normal = normal.to_array();
            vertex.material = material;
        }
        if is_mirrored {
            // The front side stays the front side (glTF 2.0, 3.7.4).
            for triangle in self.indices.chunks_exact_mut(3) {
                triangle.swap(1, 2);
            }
        }
    }

    /// Normals of the faces around, where the file gives none or one without length.
    fn complete_normals(&mut self, has_normals: bool) {
        let is_missing = |vertex: &Vertex| !has_normals || Vec3::from(vertex.normal).try_normalize().is_none();
        if !self.vertices.iter().any(is_missing) {
            return;
        }
        let positions: Vec<Vec3> = self.vertices.iter().map(|v| Vec3::from(v.position)).collect();
        let smooth = smooth_normals(&positions, &self.indices);
        for (vertex, normal) in self.vertices.iter_mut().zip(smooth) {
            if is_missing(vertex) {
                vertex.normal = normal.to_array();
            }
        }
    }
}

fn fill<T>(vertices: &mut [Vertex], values: Option<impl Iterator<Item = T>>, write: impl Fn(&mut Vertex, T)) {
    for (vertex, value) in vertices.iter_mut().zip(values.into_iter().flatten()) {
        write(vertex, value);
    }
}

fn check_numbers(vertices: &[Vertex]) -> Result<(), String> {
    let is_finite = |v: &Vertex| {
        let [tx, ty, tz, tw] = v.tangent;
        Vec3::from(v.normal).is_finite()
            && Vec4::new(v.uv[0], v.uv[1], v.uv1[0], v.uv1[1]).is_finite()
            && Vec4::new(tx, ty, tz, tw).is_finite()
            && Vec4::from(v.color).is_finite()
    };
    match vertices.iter().position(|vertex| !is_finite(vertex)) {
        Some(bad) => Err(format!(
            "vertex {bad} has a normal, tangent, colour or texture coordinate that is not a finite number"
        )),
        None => Ok(()),
    }
}

/// What the reader takes for granted: every attribute of a type that glTF allows, within its buffer, one value per position.
fn check_attributes(primitive: &Primitive<'_>, buffers: &[gltf::buffer::Data]) -> Result<(), String> {
    use DataType::{F32, U8, U16, U32};
    use Dimensions::{Scalar, Vec2, Vec3, Vec4};
    let float = &[F32][..];
    let small = &[F32, U8, U16][..];
    let n_positions = primitive
        .get(&Semantic::Positions)
        .map_or(0, |accessor| accessor.count());
    for (semantic, dimensions, types) in [
        (Semantic::Positions, &[Vec3][..], float),
        (Semantic::Normals, &[Vec3], float),
        (Semantic::Tangents, &[Vec4], float),
        (Semantic::TexCoords(0), &[Vec2], small),
        (Semantic::TexCoords(1), &[Vec2], small),
        (Semantic::Colors(0), &[Vec3, Vec4], small),
    ] {
        let Some(accessor) = primitive.get(&semantic) else {
            continue;
        };
        let name = semantic.to_string();
        gltf_check::accessor(&name, &accessor, (dimensions, types), buffers)?;
        gltf_check::count(&name, &accessor, n_positions)?;
    }
    if let Some(accessor) = primitive.indices() {
        gltf_check::accessor("indices", &accessor, (&[Scalar], &[U8, U16, U32]), buffers)?;
    }
    Ok(())
}

fn check_triangles(positions: &[Vec3], indices: &[u32]) -> Result<(), String> {
    if let Some(bad) = indices.iter().find(|&&i| i as usize >= positions.len()) {
        return Err(format!("index {bad} with only {} positions", positions.len()));
    }
    if let Some(bad) = positions.iter().position(|p| !p.is_finite()) {
        return Err(format!("position {bad} is not a finite number"));
    }
    Ok(())
}

/// Normals of the adjoining faces, weighted by their areas.
fn smooth_normals(positions: &[Vec3], indices: &[u32]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; positions.len()];
    for triangle in indices.chunks_exact(3) {
        let [a, b, c] = [triangle[0] as usize, triangle[1] as usize, triangle[2] as usize];
        let area = (positions[b] - positions[a]).cross(positions[c] - positions[a]);
        for corner in [a, b, c] {
            normals[corner] += area;
        }
    }
    normals.iter().map(|n| n.try_normalize().unwrap_or(Vec3::Z)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_of_a_flat_triangle_point_up() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y];
        assert_eq!(smooth_normals(&positions, &[0, 1, 2]), vec![Vec3::Z; 3]);
    }

    #[test]
    fn bad_indices_and_positions_are_refused() {
        assert!(
            check_triangles(&[Vec3::ZERO], &[0, 0, 1])
                .unwrap_err()
                .contains("index 1")
        );
        assert!(
            check_triangles(&[Vec3::NAN], &[0, 0, 0])
                .unwrap_err()
                .contains("finite")
        );
    }

    #[test]
    fn a_mirrored_triangle_keeps_its_front() {
        let corner = |position: Vec3| Vertex {
            position: position.to_array(),
            ..Vertex::PLAIN
        };
        let mut triangles = Triangles {
            vertices: [Vec3::ZERO, Vec3::X, Vec3::Y].map(corner).to_vec(),
            indices: vec![0, 1, 2],
            has_tangents: true,
            uv_sets: [true, false],
        };
        triangles.place(Mat4::from_scale(Vec3::new(-1.0, 1.0, 1.0)), 3);
        let place = |k: usize| Vec3::from(triangles.vertices[triangles.indices[k] as usize].position);
        let front = (place(1) - place(0)).cross(place(2) - place(0));
        assert_eq!(front, Vec3::Z);
        assert_eq!(triangles.vertices[0].tangent, [-1.0, 0.0, 0.0, -1.0]);
        assert_eq!(triangles.vertices[0].material, 3);
    }
}
