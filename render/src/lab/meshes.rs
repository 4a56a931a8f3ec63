//! Closed bodies made from code: every edge lies between exactly two triangles, normals point outward, so that shadow
//! volumes work on them.

use std::collections::HashMap;
use std::f32::consts::{FRAC_PI_4, TAU};

use glam::{Affine3A, Vec3};

use crate::scene::{Material, Mesh, Vertex};

/// Faces that meet at a sharper angle than this keep normals of their own, radians.
const CREASE_RAD: f32 = 0.87;

/// A closed body. Triangles are counterclockwise seen from outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    corners: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    /// Linear base colour of every triangle.
    colors: Vec<[f32; 3]>,
}

/// How finely a rounded box is divided, along each of its axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoxSteps {
    /// Over the flat part; 0 only when nothing is flat.
    pub flat: u32,
    /// Over half the rounding at either end; 0 only without rounding.
    pub round: u32,
}

impl Solid {
    /// A body of revolution around z. `profile` goes from a point on the axis (radius 0) outward and up to another one:
    /// radius and z, metres.
    #[must_use]
    pub fn lathe(profile: &[[f32; 2]], n_around: u32, color: [f32; 3]) -> Self {
        let inner = &profile[1..profile.len() - 1];
        let mut solid = Self::rings(inner, n_around);
        for i in 1..inner.len() as u32 {
            solid.band([i - 1, i], n_around, color);
        }
        let last = (inner.len() as u32 - 1) * n_around;
        let poles = [profile[0], profile[profile.len() - 1]].map(|[_, z]| {
            solid.corners.push(Vec3::new(0.0, 0.0, z));
            solid.corners.len() as u32 - 1
        });
        for j in 0..n_around {
            let next = (j + 1) % n_around;
            solid.push([poles[0], next, j], color);
            solid.push([poles[1], last + j, last + next], color);
        }
        solid
    }

    /// A ring around z. `profile` is a closed line that goes up on its outside: radius and z, metres.
    #[must_use]
    pub fn ring(profile: &[[f32; 2]], n_around: u32, color: [f32; 3]) -> Self {
        let mut solid = Self::rings(profile, n_around);
        let n = profile.len() as u32;
        for i in 0..n {
            solid.band([i, (i + 1) % n], n_around, color);
        }
        solid
    }

    /// A sphere around the origin of `n_rings` rings of corners and two poles.
    #[must_use]
    pub fn sphere(radius_m: f32, [n_around, n_rings]: [u32; 2], color: [f32; 3]) -> Self {
        let profile: Vec<[f32; 2]> = (0..n_rings + 2)
            .map(|i| {
                let angle_rad = 0.5 * TAU * i as f32 / (n_rings + 1) as f32;
                [radius_m * angle_rad.sin(), -radius_m * angle_rad.cos()]
            })
            .collect();
        Self::lathe(&profile, n_around, color)
    }

    /// A ring of circular section around z.
    #[must_use]
    pub fn torus([radius_m, section_m]: [f32; 2], [n_around, n_section]: [u32; 2], color: [f32; 3]) -> Self {
        let profile: Vec<[f32; 2]> = (0..n_section)
            .map(|i| {
                let (sine, cosine) = (TAU * i as f32 / n_section as f32).sin_cos();
                [radius_m + section_m * cosine, section_m * sine]
            })
            .collect();
        Self::ring(&profile, n_around, color)
    }

    /// A box around the origin with flat faces and sharp edges.
    #[must_use]
    pub fn block(half_m: Vec3, color: [f32; 3]) -> Self {
        Self::rounded_box((half_m, 0.0), BoxSteps { flat: 1, round: 0 }, color)
    }

    /// A box around the origin whose edges are rounded with a radius of at most its smallest half edge.
    #[must_use]
    pub fn rounded_box((half_m, radius_m): (Vec3, f32), steps: BoxSteps, color: [f32; 3]) -> Self {
        let n = steps.flat + 2 * steps.round;
        let inner_m = half_m - radius_m;
        let lattice = |at: [u32; 3]| {
            let point = Vec3::from_array([0, 1, 2].map(|axis| lattice_m((inner_m[axis], radius_m), steps, at[axis])));
            let within = point.clamp(-inner_m, inner_m);
            within + radius_m * (point - within).normalize_or_zero()
        };
        let mut solid = Self::empty();
        let mut known: HashMap<[u32; 3], u32> = HashMap::new();
        for (axis, at_end) in [0, 1, 2].into_iter().flat_map(|axis| [(axis, false), (axis, true)]) {
            let (u, v) = if at_end {
                ((axis + 1) % 3, (axis + 2) % 3)
            } else {
                ((axis + 2) % 3, (axis + 1) % 3)
            };
            for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let quad = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]].map(|[a, b]| {
                    let mut at = [0; 3];
                    (at[axis], at[u], at[v]) = (if at_end { n } else { 0 }, a, b);
                    *known.entry(at).or_insert_with(|| {
                        solid.corners.push(lattice(at));
                        solid.corners.len() as u32 - 1
                    })
                });
                solid.push([quad[0], quad[1], quad[2]], color);
                solid.push([quad[0], quad[2], quad[3]], color);
            }
        }
        solid
    }

    /// Bends the body. `to` must keep its inside inside.
    #[must_use]
    pub fn bent(mut self, to: impl Fn(Vec3) -> Vec3) -> Self {
        for corner in &mut self.corners {
            *corner = to(*corner);
        }
        self
    }

    /// Moves and turns the body.
    #[must_use]
    pub fn moved(self, by: Affine3A) -> Self {
        self.bent(|corner| by.transform_point3(corner))
    }

    /// Moves the body.
    #[must_use]
    pub fn at(self, place_m: Vec3) -> Self {
        self.bent(|corner| corner + place_m)
    }

    /// Colours triangles by the middle of each; `None` leaves the colour.
    #[must_use]
    pub fn painted(mut self, color_at: impl Fn(Vec3) -> Option<[f32; 3]>) -> Self {
        for (triangle, color) in self.triangles.iter().zip(&mut self.colors) {
            let middle = triangle.iter().map(|&i| self.corners[i as usize]).sum::<Vec3>() / 3.0;
            *color = color_at(middle).unwrap_or(*color);
        }
        self
    }

    fn empty() -> Self {
        Self {
            corners: Vec::new(),
            triangles: Vec::new(),
            colors: Vec::new(),
        }
    }

    /// Corners of a profile turned around z, ring after ring, no triangles yet.
    fn rings(profile: &[[f32; 2]], n_around: u32) -> Self {
        let ring = |&[radius_m, z_m]: &[f32; 2]| {
            (0..n_around).map(move |j| {
                let (sine, cosine) = (TAU * j as f32 / n_around as f32).sin_cos();
                Vec3::new(radius_m * cosine, radius_m * sine, z_m)
            })
        };
        Self {
            corners: profile.iter().flat_map(ring).collect(),
            ..Self::empty()
        }
    }

    /// Triangles between two rings, the first below the second on the outside.
    fn band(&mut self, [low, high]: [u32; 2], n_around: u32, color: [f32; 3]) {
        for j in 0..n_around {
            let next = (j + 1) % n_around;
            let [a, b] = [low * n_around + j, low * n_around + next];
            let [d, c] = [high * n_around + j, high * n_around + next];
            self.push([a, b, c], color);
            self.push([a, c, d], color);
        }
    }

    fn push(&mut self, triangle: [u32; 3], color: [f32; 3]) {
        self.triangles.push(triangle);
        self.colors.push(color);
    }

    /// Normal of every corner of every triangle: the mean of the faces around that are not behind a crease, each weighted
    /// with its angle there (Thürmer, Wüthrich 1998, "Computing vertex normals from polygonal facets").
    fn normals(&self) -> Vec<[Vec3; 3]> {
        let place = |triangle: &[u32; 3], i: usize| self.corners[triangle[i % 3] as usize];
        let faces: Vec<Vec3> = self
            .triangles
            .iter()
            .map(|t| {
                (place(t, 1) - place(t, 0))
                    .cross(place(t, 2) - place(t, 0))
                    .normalize_or_zero()
            })
            .collect();
        let mut around: Vec<Vec<(usize, f32)>> = vec![Vec::new(); self.corners.len()];
        for (index, triangle) in self.triangles.iter().enumerate() {
            for i in 0..3 {
                let (to_next, to_last) = (
                    place(triangle, i + 1) - place(triangle, i),
                    place(triangle, i + 2) - place(triangle, i),
                );
                around[triangle[i] as usize].push((index, to_next.angle_between(to_last)));
            }
        }
        let least_cosine = CREASE_RAD.cos();
        let normal_of = |corner: u32, own: Vec3| {
            around[corner as usize]
                .iter()
                .filter(|(face, _)| faces[*face].dot(own) >= least_cosine)
                .map(|(face, angle_rad)| *angle_rad * faces[*face])
                .sum::<Vec3>()
                .normalize_or(own)
        };
        self.triangles
            .iter()
            .zip(&faces)
            .map(|(triangle, &own)| triangle.map(|corner| normal_of(corner, own)))
            .collect()
    }
}

/// Place of lattice line `at` of a rounded box along one axis, before the rounding is bent round: steps of equal angle
/// over the rounding, of equal length over the flat part.
fn lattice_m((inner_m, radius_m): (f32, f32), steps: BoxSteps, at: u32) -> f32 {
    let n = steps.flat + 2 * steps.round;
    if 2 * at > n {
        return -lattice_m((inner_m, radius_m), steps, n - at);
    }
    if at < steps.round {
        let angle_rad = FRAC_PI_4 * (steps.round - at) as f32 / steps.round as f32;
        return -inner_m - radius_m * angle_rad.tan();
    }
    if steps.flat == 0 {
        return 0.0;
    }
    -inner_m * (steps.flat - 2 * (at - steps.round)) as f32 / steps.flat as f32
}

/// One mesh of several bodies. Corners that agree in place, normal and colour are shared.
#[must_use]
pub fn mesh(parts: &[Solid]) -> Mesh {
    let mut mesh = Mesh::default();
    let mut materials: HashMap<[u32; 3], u32> = HashMap::new();
    for part in parts {
        let mut known: HashMap<(u32, [u32; 3], u32), u32> = HashMap::new();
        for ((triangle, color), normals) in part.triangles.iter().zip(&part.colors).zip(part.normals()) {
            let material = *materials.entry(color.map(f32::to_bits)).or_insert_with(|| {
                mesh.materials.push(matt(*color));
                mesh.materials.len() as u32 - 1
            });
            for (&corner, normal) in triangle.iter().zip(normals) {
                let key = (corner, normal.to_array().map(f32::to_bits), material);
                let index = *known.entry(key).or_insert_with(|| {
                    mesh.vertices.push(Vertex {
                        position: part.corners[corner as usize].to_array(),
                        object: 0,
                        normal: normal.to_array(),
                        material,
                        ..Vertex::PLAIN
                    });
                    mesh.vertices.len() as u32 - 1
                });
                mesh.indices.push(index);
            }
        }
    }
    mesh
}

/// A surface that scatters alike into all directions.
fn matt(base_color: [f32; 3]) -> Material {
    Material {
        base_color,
        ..Material::default()
    }
}

/// What a mesh from code must be, for tests.
#[cfg(test)]
pub(super) mod check {
    use super::*;

    fn corners(mesh: &Mesh, triangle: &[u32]) -> [Vec3; 3] {
        [0, 1, 2].map(|i| Vec3::from(mesh.vertices[triangle[i] as usize].position))
    }

    /// Every edge is used once in each direction.
    pub(in crate::lab) fn assert_closed(name: &str, mesh: &Mesh) {
        let mut edges: HashMap<[[u32; 3]; 2], i32> = HashMap::new();
        for triangle in mesh.indices.chunks_exact(3) {
            let places = corners(mesh, triangle).map(|p| p.to_array().map(f32::to_bits));
            for i in 0..3 {
                *edges.entry([places[i], places[(i + 1) % 3]]).or_default() += 1;
            }
        }
        for (&[a, b], &n) in &edges {
            assert_eq!(n, 1, "{name}: an edge belongs to several faces");
            assert!(edges.contains_key(&[b, a]), "{name}: an open edge");
        }
    }

    /// Faces have a size and agree with their corners' normals, and the body has a positive volume.
    pub(in crate::lab) fn assert_outward(name: &str, mesh: &Mesh) {
        let mut volume_m3 = 0.0;
        for triangle in mesh.indices.chunks_exact(3) {
            let [a, b, c] = corners(mesh, triangle);
            let normal = (b - a).cross(c - a);
            assert!(normal.length() > 1e-9, "{name}: a face without size");
            for &index in triangle {
                let own = Vec3::from(mesh.vertices[index as usize].normal);
                assert!((own.length() - 1.0).abs() < 1e-4, "{name}");
                assert!(own.dot(normal.normalize()) > 0.5, "{name}: a normal that turns away");
            }
            volume_m3 += a.dot(b.cross(c)) / 6.0;
        }
        assert!(volume_m3 > 0.0, "{name}: inside out");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use check::{assert_closed, assert_outward};

    const GREY: [f32; 3] = [0.5; 3];

    fn volume_m3(mesh: &Mesh) -> f32 {
        let place = |i: u32| Vec3::from(mesh.vertices[i as usize].position);
        let cone = |t: &[u32]| place(t[0]).dot(place(t[1]).cross(place(t[2]))) / 6.0;
        mesh.indices.chunks_exact(3).map(cone).sum()
    }

    #[test]
    fn bodies_are_closed_and_have_their_volume() {
        let pi = 0.5 * TAU;
        let round = BoxSteps { flat: 2, round: 8 };
        let rounded = |r: f32| {
            let [x, y, z] = [1.0 - 2.0 * r, 0.8 - 2.0 * r, 0.6 - 2.0 * r];
            x * y * z + 2.0 * r * (x * y + y * z + z * x) + pi * r * r * (x + y + z) + 4.0 / 3.0 * pi * r * r * r
        };
        let half_m = Vec3::new(0.5, 0.4, 0.3);
        for (name, solid, volume) in [
            ("block", Solid::block(half_m, GREY), 0.48),
            (
                "rounded box",
                Solid::rounded_box((half_m, 0.1), round, GREY),
                rounded(0.1),
            ),
            (
                "ball of six faces",
                Solid::rounded_box((Vec3::splat(0.3), 0.3), BoxSteps { flat: 0, round: 12 }, GREY),
                4.0 / 3.0 * pi * 0.027,
            ),
            ("sphere", Solid::sphere(0.3, [64, 40], GREY), 4.0 / 3.0 * pi * 0.027),
            (
                "torus",
                Solid::torus([0.5, 0.1], [96, 48], GREY),
                2.0 * pi * pi * 0.5 * 0.01,
            ),
            (
                "cylinder",
                Solid::lathe(&[[0.0, 0.0], [0.2, 0.0], [0.2, 0.5], [0.0, 0.5]], 96, GREY),
                pi * 0.04 * 0.5,
            ),
        ] {
            let mesh = mesh(&[solid]);
            assert_closed(name, &mesh);
            assert_outward(name, &mesh);
            let found = volume_m3(&mesh);
            assert!((found / volume - 1.0).abs() < 0.01, "{name}: {found} for {volume}");
        }
    }

    #[test]
    fn smooth_bodies_share_corners_and_edges_stay_sharp() {
        assert_eq!(mesh(&[Solid::sphere(0.1, [35, 19], GREY)]).vertices.len(), 35 * 19 + 2);
        assert_eq!(mesh(&[Solid::block(Vec3::ONE, GREY)]).vertices.len(), 24);
        let two = mesh(&[Solid::block(Vec3::ONE, GREY).painted(|at| (at.z > 0.9).then_some([1.0; 3]))]);
        assert_eq!(two.materials.len(), 2);
    }
}
