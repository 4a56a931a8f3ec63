//! The edges of all casters as soft shadow volumes take them: in a row, with the faces on both sides.

use glam::{Affine3A, Vec3, Vec4};

use super::casters::Casters;
use super::silhouette::{Silhouettes, Topology};
use crate::error::RenderError;

/// No face.
pub const NO_FACE: u32 = u32::MAX;

/// Corners, faces and edges of all casters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outlines {
    /// xyz: place in the object's frame; w: index in `shapes`.
    pub corners: Vec<Vec4>,
    /// Corners of every face; the fourth is unused.
    pub faces: Vec<[u32; 4]>,
    /// Lower and higher corner, the face that runs from the lower to the higher, the face that runs back; [`NO_FACE`] where
    /// there is none. An edge of more than two faces is there more than once.
    pub edges: Vec<[u32; 4]>,
    /// The objects.
    pub shapes: Vec<Shape>,
}

/// One caster.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Box around it in its own frame.
    pub bounds_m: [Vec3; 2],
    /// First edge, number of edges, first face, number of faces.
    pub ranges: [u32; 4],
    /// Whether its faces block from both sides: it does not bound a solid.
    pub is_open: bool,
}

impl Outlines {
    /// Finds the edges of casters.
    ///
    /// # Errors
    /// As [`Silhouettes::new`].
    pub fn new(casters: &Casters) -> Result<Self, RenderError> {
        let mut outlines = Self::default();
        for caster in &casters.objects {
            outlines.push(&Silhouettes::new(&caster.name, &caster.mesh)?);
        }
        Ok(outlines)
    }

    /// Adds an object.
    pub fn push(&mut self, silhouettes: &Silhouettes) {
        let shape = self.shapes.len() as f32;
        let (first_corner, first_face, first_edge) = (
            self.corners.len() as u32,
            self.faces.len() as u32,
            self.edges.len() as u32,
        );
        let corners = silhouettes.corners();
        self.corners.extend(corners.iter().map(|corner| corner.extend(shape)));
        let faces = silhouettes
            .faces()
            .iter()
            .map(|face| face.map(|corner| corner + first_corner));
        self.faces.extend(faces.map(|[a, b, c]| [a, b, c, 0]));
        self.push_edges(first_face);
        self.shapes.push(Shape {
            bounds_m: [
                corners.iter().copied().reduce(Vec3::min).unwrap_or_default(),
                corners.iter().copied().reduce(Vec3::max).unwrap_or_default(),
            ],
            ranges: [
                first_edge,
                self.edges.len() as u32 - first_edge,
                first_face,
                self.faces.len() as u32 - first_face,
            ],
            is_open: silhouettes.topology() != Topology::Closed,
        });
    }

    /// Pairs the sides of the faces from `first_face` on that run along the same two corners in opposite directions.
    fn push_edges(&mut self, first_face: u32) {
        let mut sides: Vec<[u32; 4]> = Vec::with_capacity(3 * (self.faces.len() - first_face as usize));
        for (face, &[a, b, c, _]) in (first_face..).zip(&self.faces[first_face as usize..]) {
            sides.extend(
                [[a, b], [b, c], [c, a]].map(|[from, to]| [from.min(to), from.max(to), u32::from(from > to), face]),
            );
        }
        sides.sort_unstable();
        for group in sides.chunk_by(|a, b| a[..2] == b[..2]) {
            let n_forward = group.iter().filter(|side| side[2] == 0).count();
            let (forward, backward) = group.split_at(n_forward);
            for i in 0..forward.len().max(backward.len()) {
                let face = |sides: &[[u32; 4]]| sides.get(i).map_or(NO_FACE, |side| side[3]);
                self.edges
                    .push([group[0][0], group[0][1], face(forward), face(backward)]);
            }
        }
    }
}

impl Shape {
    /// Box around it in another frame.
    #[must_use]
    pub fn bounds_in(&self, target_from_object: Affine3A) -> [Vec3; 2] {
        let corners = (0..8).map(|i| {
            let pick = |axis: usize| self.bounds_m[(i >> axis) & 1][axis];
            target_from_object.transform_point3(Vec3::new(pick(0), pick(1), pick(2)))
        });
        corners.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], corner| {
            [low.min(corner), high.max(corner)]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Mesh, Vertex};

    fn outlines(corners: &[Vec3], indices: Vec<u32>) -> Outlines {
        let vertex = |at: &Vec3| Vertex {
            position: at.to_array(),
            object: 0,
            normal: [0.0, 0.0, 1.0],
            material: 0,
            ..Vertex::PLAIN
        };
        let mesh = Mesh {
            vertices: corners.iter().map(vertex).collect(),
            indices,
            ..Mesh::default()
        };
        let mut outlines = Outlines::default();
        outlines.push(&Silhouettes::new("test", &mesh).unwrap());
        outlines
    }

    #[test]
    fn every_edge_of_a_closed_mesh_has_a_face_on_both_sides() {
        let tetrahedron = outlines(
            &[Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            vec![0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3],
        );
        assert_eq!(tetrahedron.edges.len(), 6);
        assert!(tetrahedron.edges.iter().all(|edge| !edge[2..].contains(&NO_FACE)));
        assert!(!tetrahedron.shapes[0].is_open);
        assert_eq!(tetrahedron.shapes[0].ranges, [0, 6, 0, 4]);
    }

    #[test]
    fn the_third_face_of_an_edge_gets_an_edge_of_its_own() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_Y];
        let fan = outlines(&corners, vec![0, 1, 2, 0, 1, 3, 1, 0, 4]);
        let hinge: Vec<_> = fan.edges.iter().filter(|edge| edge[..2] == [0, 1]).collect();
        assert_eq!(hinge, [&[0, 1, 0, 2], &[0, 1, 1, NO_FACE]]);
        assert_eq!(fan.edges.len(), 2 + 6);
        assert!(fan.shapes[0].is_open);
    }

    #[test]
    fn a_turned_box_holds_all_corners() {
        let shape = outlines(&[Vec3::ZERO, Vec3::X, Vec3::Y], vec![0, 1, 2]).shapes[0];
        let [low, high] = shape.bounds_in(Affine3A::from_rotation_z(std::f32::consts::FRAC_PI_2));
        assert!((low - Vec3::new(-1.0, 0.0, 0.0)).length() < 1e-6);
        assert!((high - Vec3::new(0.0, 1.0, 0.0)).length() < 1e-6);
    }
}
