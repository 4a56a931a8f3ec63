//! What looks wrong in a scene: phantoms that are open or inside out, objects in the same place.

use std::collections::HashMap;

use glam::Vec3;

use super::entry::Complaint;
use super::{Kind, Mesh, Object, Placement, Scene};

/// Corners nearer than this share of a mesh's size are one.
const SAME_PLACE: f32 = 1e-5;

/// Parts of a mesh that hang together, by what is wrong with them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Parts {
    n: usize,
    /// With edges that belong to one face only; flat sheets are not counted: they are what they look like.
    open: usize,
    /// Closed, with faces that look inwards.
    inside_out: usize,
}

/// Refuses an object that stands exactly where another one of the same mesh does.
pub(super) fn check_beside(object: &Object, others: &[Object]) -> Result<(), Complaint> {
    let twin = |other: &&Object| same_marker(object, other) && other.file == object.file && other.mesh == object.mesh;
    others.iter().find(twin).map_or(Ok(()), |other| {
        let message = format!(
            "object `{}` is the same mesh on the same marker at the same place; give one of them another `marker_from_object`",
            other.name
        );
        Err(("marker", message))
    })
}

/// One sentence for everything that works but is hardly meant.
pub(super) fn warnings(scene: &Scene) -> Vec<String> {
    let mut warnings = Vec::new();
    for (index, object) in scene.objects.iter().enumerate() {
        if object.kind == Kind::Phantom {
            warnings.extend(phantom_warnings(object));
        }
        let beside =
            |other: &&Object| object.kind == Kind::Virtual && other.kind == Kind::Virtual && same_marker(object, other);
        warnings.extend(scene.objects[..index].iter().filter(beside).map(|other| {
            format!(
                "virtual objects `{}` and `{}` stand on the same marker at the same place; they may lie in each other",
                other.name, object.name
            )
        }));
    }
    warnings
}

/// Whether both stand on one marker, at the same place and moving alike.
fn same_marker(a: &Object, b: &Object) -> bool {
    matches!(a.placement, Placement::Marker { .. })
        && a.placement == b.placement
        && a.movement.motion == b.movement.motion
}

fn phantom_warnings(object: &Object) -> Vec<String> {
    let parts = parts(&object.mesh);
    let mut warnings = Vec::new();
    if parts.open > 0 {
        warnings.push(format!(
            "phantom `{}`: open edges in {} of its {} parts; light gets in where a face is missing",
            object.name, parts.open, parts.n
        ));
    }
    if parts.inside_out > 0 {
        warnings.push(format!(
            "phantom `{}`: faces look inwards in {} of its {} parts; turn them over in the program that made the mesh",
            object.name, parts.inside_out, parts.n
        ));
    }
    warnings
}

/// Looks at every part: an edge of a closed one is used as often one way as the other, and its signed volume is positive
/// when its faces look out.
fn parts(mesh: &Mesh) -> Parts {
    let corners = welded(mesh);
    let faces: Vec<[usize; 3]> = mesh
        .indices
        .chunks_exact(3)
        .map(|t| [0, 1, 2].map(|i| corners[t[i] as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .collect();
    let mut part_of: Vec<usize> = (0..mesh.vertices.len()).collect();
    for [a, b, c] in &faces {
        for other in [b, c] {
            let (x, y) = (root(&mut part_of, *a), root(&mut part_of, *other));
            part_of[x] = y;
        }
    }
    let mut of_part: HashMap<usize, Vec<[usize; 3]>> = HashMap::new();
    for face in faces {
        of_part.entry(root(&mut part_of, face[0])).or_default().push(face);
    }
    let place = |corner: usize| Vec3::from(mesh.vertices[corner].position);
    let mut parts = Parts {
        n: of_part.len(),
        ..Parts::default()
    };
    for faces in of_part.values() {
        let is_closed = is_closed(faces);
        parts.open += usize::from(!is_closed && !is_flat(faces, &place));
        parts.inside_out += usize::from(is_closed && volume(faces, &place) < 0.0);
    }
    parts
}

/// For every vertex the first one at its place.
fn welded(mesh: &Mesh) -> Vec<usize> {
    let size = mesh
        .vertices
        .iter()
        .flat_map(|v| v.position)
        .fold(0.0f32, |m, x| m.max(x.abs()));
    let cell = (SAME_PLACE * size).max(f32::MIN_POSITIVE);
    let mut first = HashMap::new();
    mesh.vertices
        .iter()
        .enumerate()
        .map(|(index, vertex)| {
            let key = vertex.position.map(|x| (x / cell).round() as i64);
            *first.entry(key).or_insert(index)
        })
        .collect()
}

fn root(part_of: &mut [usize], mut corner: usize) -> usize {
    while part_of[corner] != corner {
        part_of[corner] = part_of[part_of[corner]];
        corner = part_of[corner];
    }
    corner
}

fn is_closed(faces: &[[usize; 3]]) -> bool {
    let mut net: HashMap<(usize, usize), i32> = HashMap::new();
    for [a, b, c] in faces {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *net.entry((*from.min(to), *from.max(to))).or_default() += if from < to { 1 } else { -1 };
        }
    }
    net.values().all(|&n| n == 0)
}

/// Whether all faces lie in one plane.
fn is_flat(faces: &[[usize; 3]], place: &impl Fn(usize) -> Vec3) -> bool {
    /// Sine of the largest angle between faces of a sheet.
    const FLAT: f32 = 1e-2;
    let normal = |[a, b, c]: &[usize; 3]| {
        let a = place(*a);
        (place(*b) - a).cross(place(*c) - a).normalize_or_zero()
    };
    let first = faces.iter().map(normal).find(|n| *n != Vec3::ZERO).unwrap_or(Vec3::Z);
    faces.iter().all(|face| normal(face).cross(first).length() < FLAT)
}

/// Volume inside a closed part, negative when its faces look inwards.
fn volume(faces: &[[usize; 3]], place: &impl Fn(usize) -> Vec3) -> f64 {
    faces
        .iter()
        .map(|[a, b, c]| f64::from(place(*a).dot(place(*b).cross(place(*c)))) / 6.0)
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Vertex;

    /// A tetrahedron whose faces look out.
    fn solid() -> Mesh {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        Mesh {
            vertices: corners
                .map(|p| Vertex {
                    position: p.to_array(),
                    ..Vertex::PLAIN
                })
                .to_vec(),
            indices: vec![0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3],
            materials: Vec::new(),
        }
    }

    #[test]
    fn a_solid_is_sound_and_a_hole_and_a_turned_one_are_found() {
        let sound = Parts {
            n: 1,
            ..Parts::default()
        };
        assert_eq!(parts(&solid()), sound);
        let mut open = solid();
        open.indices.truncate(9);
        assert_eq!(parts(&open), Parts { open: 1, ..sound });
        let mut turned = solid();
        turned.indices.reverse();
        assert_eq!(parts(&turned), Parts { inside_out: 1, ..sound });
    }

    #[test]
    fn a_sheet_is_no_open_solid_and_seams_between_vertices_are_none() {
        let mut sheet = solid();
        sheet.indices.truncate(3);
        assert_eq!(
            parts(&sheet),
            Parts {
                n: 1,
                ..Parts::default()
            }
        );
        // Every face with corners of its own, as flat shading wants them.
        let mut split = Mesh::default();
        for &index in &solid().indices {
            split.indices.push(split.vertices.len() as u32);
            split.vertices.push(solid().vertices[index as usize]);
        }
        assert_eq!(
            parts(&split),
            Parts {
                n: 1,
                ..Parts::default()
            }
        );
    }
}
