//! Outlines of meshes as a light sees them: what shadow volumes and penumbra wedges are drawn from.
//!
//! Corners at the same place are merged, so that faces that share an edge are found whatever their normals are. A light is
//! given in the mesh's own frame, homogeneous: `(x, y, z, 1)` for a place, `(x, y, z, 0)` for a direction towards it.
//!
//! A closed mesh blocks light with the faces that are turned away from the light: what is lit is then never the start of a
//! shadow, and a light inside the mesh shines on nothing outside. Of any other mesh every face blocks, turned towards the
//! light where it is not (Kim, Kim, Turk 2008, "A shadow volume algorithm for opaque and transparent non-manifold casters"):
//! right for any set of triangles, at the cost of counting some places twice. An edge is part of the outline as often as
//! the blocking faces on both sides of it do not cancel.

use std::collections::HashMap;

use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

use crate::error::RenderError;
use crate::scene::Mesh;

/// Most triangles of one mesh: about 100 bytes are needed for each.
pub const MAX_TRIANGLES: usize = 2_000_000;
/// Corners nearer than this share of the mesh's size are the same.
const SAME_PLACE: f64 = 1e-6;
/// No corner, in a chain.
const NONE: u32 = u32::MAX;
/// Faces or edges that one thread takes at least.
const SHARE: usize = 8192;

/// A mesh's faces and what they share.
#[derive(Debug, Clone, PartialEq)]
pub struct Silhouettes {
    corners: Vec<Vec3>,
    faces: Vec<[u32; 3]>,
    /// Plane of every face: unit normal, minus its distance from the origin.
    planes: Vec<Vec4>,
    /// Lower and higher corner of every edge and where its uses begin.
    edges: Vec<[u32; 3]>,
    /// Twice the face, plus 1 where the face goes from the edge's higher corner to the lower.
    uses: Vec<u32>,
    topology: Topology,
    n_degenerate: usize,
}

/// How a mesh's faces hang together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topology {
    /// Every edge belongs to two faces that run along it in opposite directions: the mesh bounds a solid.
    Closed,
    /// Some edges belong to one face only.
    Open,
    /// Some edges belong to more than two faces, or to two that are turned different ways.
    NonManifold,
}

/// What blocks a light, as corner numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Outline {
    /// The faces that block, counterclockwise as the light sees them.
    pub faces: Vec<[u32; 3]>,
    /// Edges between light and shadow: going along one, as the light sees it, the shadow is on the left. One that bounds
    /// two layers of shadow is there twice.
    pub edges: Vec<[u32; 2]>,
}

impl Silhouettes {
    /// Finds the edges of a mesh; `name` is the object's, for messages.
    ///
    /// Triangles without area are left out and counted. A closed mesh that is inside out is turned.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] for a mesh of more than [`MAX_TRIANGLES`] triangles, with corners that are no finite numbers,
    /// or with triangles whose corners do not exist.
    pub fn new(name: &str, mesh: &Mesh) -> Result<Self, RenderError> {
        check(name, mesh)?;
        let (corners, corner_of_vertex) = welded(mesh);
        let n_triangles = mesh.indices.len() / 3;
        let (mut faces, mut planes) = (Vec::with_capacity(n_triangles), Vec::with_capacity(n_triangles));
        for triangle in mesh.indices.chunks_exact(3) {
            let face = [0, 1, 2].map(|i| corner_of_vertex[triangle[i] as usize]);
            if let Some(plane) = plane_of(face.map(|i| corners[i as usize])) {
                faces.push(face);
                planes.push(plane);
            }
        }
        let n_degenerate = n_triangles - faces.len();
        let (edges, uses, topology) = shared_edges(&faces);
        let mut silhouettes = Self {
            corners,
            faces,
            planes,
            edges,
            uses,
            topology,
            n_degenerate,
        };
        if topology == Topology::Closed && silhouettes.volume() < 0.0 {
            silhouettes.turn();
        }
        Ok(silhouettes)
    }

    /// How the faces hang together.
    #[must_use]
    pub fn topology(&self) -> Topology {
        self.topology
    }

    /// Number of triangles that were left out because they have no area.
    #[must_use]
    pub fn n_degenerate(&self) -> usize {
        self.n_degenerate
    }

    /// The merged corners, in the mesh's frame.
    #[must_use]
    pub fn corners(&self) -> &[Vec3] {
        &self.corners
    }

    /// The triangles with area, as corner numbers, counterclockwise seen from outside.
    #[must_use]
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Whether every face is turned towards the light.
    #[must_use]
    pub fn is_lit(&self, light: Vec4) -> Vec<bool> {
        self.planes
            .par_iter()
            .with_min_len(SHARE)
            .map(|plane| plane.dot(light) > 0.0)
            .collect()
    }

    /// What blocks the light.
    #[must_use]
    pub fn outline(&self, light: Vec4) -> Outline {
        let is_lit = self.is_lit(light);
        let is_closed = self.topology == Topology::Closed;
        let faces = (self.faces.par_iter().zip(&is_lit))
            .with_min_len(SHARE)
            .filter(|&(_, &is_lit)| !(is_closed && is_lit))
            .map(|(&[a, b, c], &is_lit)| if is_lit { [a, b, c] } else { [a, c, b] })
            .collect();
        let edges = (self.edges.par_windows(2))
            .with_min_len(SHARE)
            .flat_map_iter(|pair| {
                let [low, high, first] = pair[0];
                let net: i32 = self.uses[first as usize..pair[1][2] as usize]
                    .iter()
                    .map(|&edge_use| match (is_lit[edge_use as usize / 2], edge_use & 1 == 0) {
                        (true, _) if is_closed => 0,
                        (true, true) | (false, false) => 1,
                        (true, false) | (false, true) => -1,
                    })
                    .sum();
                let edge = if net > 0 { [low, high] } else { [high, low] };
                std::iter::repeat_n(edge, net.unsigned_abs() as usize)
            })
            .collect();
        Outline { faces, edges }
    }

    /// Ends of the outline's edges in the mesh's frame; going along one, as the light sees it, the shadow is on the left.
    #[must_use]
    pub fn edges(&self, light: Vec4) -> Vec<[Vec3; 2]> {
        let outline = self.outline(light);
        outline
            .edges
            .iter()
            .map(|edge| edge.map(|i| self.corners[i as usize]))
            .collect()
    }

    /// Volume, negative for a mesh that is inside out.
    fn volume(&self) -> f64 {
        let middle = self.corners.first().copied().unwrap_or_default().as_dvec3();
        self.faces
            .iter()
            .map(|face| {
                let [a, b, c] = face.map(|i| self.corners[i as usize].as_dvec3() - middle);
                a.dot(b.cross(c))
            })
            .sum()
    }

    /// Turns the mesh inside out.
    fn turn(&mut self) {
        for face in &mut self.faces {
            face.swap(1, 2);
        }
        for plane in &mut self.planes {
            *plane = -*plane;
        }
        for edge_use in &mut self.uses {
            *edge_use ^= 1;
        }
    }
}

fn check(name: &str, mesh: &Mesh) -> Result<(), RenderError> {
    let refuse = |message: String, hint| {
        Err(RenderError::Shadow {
            method: "shadow outlines",
            message: format!("object `{name}` {message}"),
            hint,
        })
    };
    let n_triangles = mesh.indices.len() / 3;
    if n_triangles > MAX_TRIANGLES {
        return refuse(
            format!("has {n_triangles} triangles, {MAX_TRIANGLES} are allowed"),
            "simplify the mesh, or choose a method with shadow maps",
        );
    }
    let n_bad = mesh
        .vertices
        .iter()
        .filter(|vertex| !Vec3::from(vertex.position).is_finite())
        .count();
    if n_bad > 0 {
        return refuse(
            format!(
                "has {n_bad} of {} corners that are no finite numbers",
                mesh.vertices.len()
            ),
            "export the mesh again",
        );
    }
    if let Some(index) = mesh.indices.iter().find(|&&i| i as usize >= mesh.vertices.len()) {
        return refuse(
            format!("has a triangle with corner {index} of {}", mesh.vertices.len()),
            "export the mesh again",
        );
    }
    Ok(())
}

/// The different places of a mesh's vertices, and which of them each vertex is at.
///
/// Places are kept in a grid of cells four times as wide as what counts as the same, so that mostly one cell is searched.
fn welded(mesh: &Mesh) -> (Vec<Vec3>, Vec<u32>) {
    let place = |i: usize| Vec3::from(mesh.vertices[i].position);
    let n = mesh.vertices.len();
    let low = (0..n).map(place).reduce(Vec3::min).unwrap_or_default();
    let high = (0..n).map(place).reduce(Vec3::max).unwrap_or_default();
    let same = (SAME_PLACE * (high - low).as_dvec3().length()).max(f64::MIN_POSITIVE * 1e20);
    let cell_of = |at: DVec3| (at / (4.0 * same)).floor().to_array().map(|x| x as i64);
    let mut last_in_cell: HashMap<[i64; 3], u32> = HashMap::with_capacity(n / 4);
    let mut before: Vec<u32> = Vec::new();
    let mut corners: Vec<Vec3> = Vec::new();
    let corner_of_vertex = (0..n)
        .map(|i| {
            let at = (place(i) - low).as_dvec3();
            let ([x0, y0, z0], [x1, y1, z1]) = (cell_of(at - same), cell_of(at + same));
            for x in x0..=x1 {
                for y in y0..=y1 {
                    for z in z0..=z1 {
                        let mut corner = last_in_cell.get(&[x, y, z]).copied().unwrap_or(NONE);
                        while corner != NONE {
                            let other = (corners[corner as usize] - low).as_dvec3();
                            if other.distance_squared(at) <= same * same {
                                return corner;
                            }
                            corner = before[corner as usize];
                        }
                    }
                }
            }
            let corner = corners.len() as u32;
            corners.push(place(i));
            before.push(last_in_cell.insert(cell_of(at), corner).unwrap_or(NONE));
            corner
        })
        .collect();
    (corners, corner_of_vertex)
}

/// Plane of a triangle; `None` where it has no area.
fn plane_of(corners: [Vec3; 3]) -> Option<Vec4> {
    /// Least ratio of a triangle's area to the square of its longest side.
    const THINNEST: f64 = 1e-9;
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let normal = (b - a).cross(c - a);
    let longest = (b - a)
        .length_squared()
        .max((c - a).length_squared())
        .max((c - b).length_squared());
    let size = normal.length();
    (size > THINNEST * longest).then(|| {
        let normal = normal / size;
        normal.extend(-normal.dot(a)).as_vec4()
    })
}

/// Edges of faces in the order of their corners, closed by one that only says where the uses end; their uses; and what they
/// make of the mesh.
fn shared_edges(faces: &[[u32; 3]]) -> (Vec<[u32; 3]>, Vec<u32>, Topology) {
    let mut sides: Vec<[u32; 3]> = Vec::with_capacity(3 * faces.len());
    for (index, face) in faces.iter().enumerate() {
        for k in 0..3 {
            let (from, to) = (face[k], face[(k + 1) % 3]);
            sides.push([from.min(to), from.max(to), 2 * index as u32 + u32::from(from > to)]);
        }
    }
    sides.par_sort_unstable();
    let uses: Vec<u32> = sides.iter().map(|side| side[2]).collect();
    let mut edges: Vec<[u32; 3]> = Vec::with_capacity(sides.len() / 2 + 1);
    let mut topology = Topology::Closed;
    let mut first = 0;
    for group in sides.chunk_by(|a, b| a[..2] == b[..2]) {
        edges.push([group[0][0], group[0][1], first]);
        first += group.len() as u32;
        let n_forward = group.iter().filter(|side| side[2] & 1 == 0).count();
        topology = match (n_forward, group.len() - n_forward, topology) {
            (1, 1, so_far) => so_far,
            (0, 1, Topology::Closed | Topology::Open) | (1, 0, Topology::Closed | Topology::Open) => Topology::Open,
            _ => Topology::NonManifold,
        };
    }
    edges.push([0, 0, first]);
    (edges, uses, topology)
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use proptest::prelude::*;

    use super::*;
    use crate::scene::Vertex;

    fn mesh(corners: &[Vec3], indices: Vec<u32>) -> Mesh {
        let vertex = |at: &Vec3| Vertex {
            position: at.to_array(),
            object: 0,
            normal: [0.0, 0.0, 1.0],
            material: 0,
            ..Vertex::PLAIN
        };
        Mesh {
            vertices: corners.iter().map(vertex).collect(),
            indices,
            ..Mesh::default()
        }
    }

    /// A ball of rings and sectors whose every triangle has corners of its own, so that merging is tested too.
    fn ball(n_rings: u32, n_sectors: u32) -> Mesh {
        let at = |ring: u32, sector: u32| {
            let (theta, phi) = (
                std::f32::consts::PI * ring as f32 / n_rings as f32,
                std::f32::consts::TAU * (sector % n_sectors) as f32 / n_sectors as f32,
            );
            Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
        };
        let mut corners = Vec::new();
        for ring in 0..n_rings {
            for sector in 0..n_sectors {
                let [a, b, c, d] = [
                    at(ring, sector),
                    at(ring + 1, sector),
                    at(ring + 1, sector + 1),
                    at(ring, sector + 1),
                ];
                corners.extend([a, b, c, a, c, d]);
            }
        }
        let n = corners.len() as u32;
        mesh(&corners, (0..n).collect())
    }

    fn is_closed_loops(edges: &[[u32; 2]]) -> bool {
        let mut balance: HashMap<u32, i32> = HashMap::new();
        for [from, to] in edges {
            *balance.entry(*from).or_default() += 1;
            *balance.entry(*to).or_default() -= 1;
        }
        balance.values().all(|&b| b == 0)
    }

    fn tetrahedron() -> ([Vec3; 4], Vec<u32>) {
        (
            [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
            vec![0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3],
        )
    }

    proptest! {
        #[test]
        fn the_outline_of_any_mesh_is_closed_loops(
            x in -3.0f32..3.0, y in -3.0f32..3.0, z in -3.0f32..3.0, w in 0u8..2, n_left_out in 0usize..3,
        ) {
            let mut ball = ball(9, 12);
            ball.indices.truncate(ball.indices.len() - 60 * n_left_out);
            let silhouettes = Silhouettes::new("ball", &ball).unwrap();
            prop_assert_eq!(silhouettes.topology() == Topology::Closed, n_left_out == 0);
            let outline = silhouettes.outline(Vec4::new(x, y, z, f32::from(w)));
            prop_assert!(is_closed_loops(&outline.edges));
        }

        #[test]
        fn the_outline_of_a_ball_goes_round_the_light_once(x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0) {
            let light = Vec3::new(x, y, z);
            prop_assume!(light.length() > 0.1);
            let light = light.normalize();
            let silhouettes = Silhouettes::new("ball", &ball(16, 24)).unwrap();
            let [right, up] = crate::shadow::shadow_view::basis(light);
            // Shadow on the left: counterclockwise seen against the light, so once around in all.
            let turns: f32 = silhouettes.edges(light.extend(0.0)).iter().map(|ends| {
                let [a, b] = ends.map(|at| glam::Vec2::new(at.dot(right), at.dot(up)));
                a.angle_to(b)
            }).sum();
            prop_assert!((turns - std::f32::consts::TAU).abs() < 1e-3, "{turns}");
        }
    }

    #[test]
    fn a_ball_is_closed_and_its_poles_are_counted_as_degenerate() {
        let silhouettes = Silhouettes::new("ball", &ball(9, 12)).unwrap();
        assert_eq!(silhouettes.topology(), Topology::Closed);
        assert_eq!(silhouettes.n_degenerate(), 24);
        assert_eq!(silhouettes.corners().len(), 8 * 12 + 2);
    }

    #[test]
    fn a_light_inside_sees_every_face_and_no_edge() {
        let silhouettes = Silhouettes::new("ball", &ball(9, 12)).unwrap();
        let outline = silhouettes.outline(Vec4::W);
        assert_eq!(outline.faces.len(), silhouettes.faces().len());
        assert!(outline.edges.is_empty());
    }

    #[test]
    fn a_mesh_inside_out_is_turned() {
        let (corners, indices) = tetrahedron();
        let outward = Silhouettes::new("outward", &mesh(&corners, indices.clone())).unwrap();
        let turned: Vec<u32> = indices.chunks(3).flat_map(|t| [t[0], t[2], t[1]]).collect();
        let inward = Silhouettes::new("inward", &mesh(&corners, turned)).unwrap();
        let light = Vec4::new(2.0, 3.0, 4.0, 1.0);
        assert_eq!(outward.outline(light).edges, inward.outline(light).edges);
        assert_eq!(outward.outline(light).edges.len(), 3);
    }

    #[test]
    fn a_single_triangle_blocks_from_both_sides() {
        let silhouettes = Silhouettes::new("sheet", &mesh(&[Vec3::ZERO, Vec3::X, Vec3::Y], vec![0, 1, 2])).unwrap();
        assert_eq!(silhouettes.topology(), Topology::Open);
        let above = silhouettes.outline(Vec4::Z);
        assert_eq!(above.faces, [[0, 1, 2]]);
        assert!(above.edges.contains(&[0, 1]) && above.edges.len() == 3);
        let below = silhouettes.outline(-Vec4::Z);
        assert_eq!(below.faces, [[0, 2, 1]]);
        assert!(below.edges.contains(&[1, 0]) && below.edges.len() == 3);
    }

    #[test]
    fn three_faces_on_an_edge_are_no_manifold() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_Y];
        let silhouettes = Silhouettes::new("fan", &mesh(&corners, vec![0, 1, 2, 0, 1, 3, 0, 1, 4])).unwrap();
        assert_eq!(silhouettes.topology(), Topology::NonManifold);
        assert!(is_closed_loops(
            &silhouettes.outline(Vec4::new(0.3, 0.2, 1.0, 0.0)).edges
        ));
    }

    #[test]
    fn bad_meshes_are_refused_by_name() {
        let refusal = |mesh: &Mesh| Silhouettes::new("chair", mesh).unwrap_err().to_string();
        let nan = mesh(&[Vec3::ZERO, Vec3::X, Vec3::NAN], vec![0, 1, 2]);
        assert!(refusal(&nan).contains("object `chair` has 1 of 3 corners that are no finite numbers"));
        let missing = mesh(&[Vec3::ZERO, Vec3::X, Vec3::Y], vec![0, 1, 7]);
        assert!(refusal(&missing).contains("corner 7 of 3"));
        let large = mesh(&[Vec3::ZERO], vec![0; 3 * (MAX_TRIANGLES + 1)]);
        assert!(refusal(&large).contains("has 2000001 triangles, 2000000 are allowed"));
    }

    #[test]
    fn a_mesh_without_triangles_has_no_outline() {
        let silhouettes = Silhouettes::new("nothing", &Mesh::default()).unwrap();
        assert_eq!(silhouettes.outline(Vec4::Z), Outline::default());
    }
}
