//! Places on real surfaces that tell how much light there is: white paper of known reflectance, and patches of phantoms
//! whose reflectance is not known but the same all over a part.

use std::collections::HashMap;
use std::f32::consts::PI;

use glam::{Mat3, Vec3};
use mirrorball_calib::rig::{Marker, Rig};
use rayon::prelude::*;

use super::super::surroundings::NOTHING_M;
use crate::scene::occluders::Occluders;

/// Rays per spot that gather the light from everywhere.
pub(super) const RAYS: usize = 256;
/// Patches of all parts together.
const MAX_PATCHES: usize = 420;
/// Least number of patches that make a part worth reading.
const MIN_PATCHES: usize = 8;
/// Patches lie this close to a marker or a virtual object at most, metres.
const REACH_M: f32 = 0.35;
/// Half the edge of a patch, metres.
const PATCH_HALF_M: f32 = 0.003;
/// Width of the white rim of a marker around its black square, relative to the square's side: the printed sheet is known to
/// be white there and unknown beyond.
const PRINTED: f32 = 0.65;

/// What a spot reflects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Reflectance {
    /// Diffuse reflectance, 0 to 1.
    Known(f32),
    /// That of a part of the phantoms, by number; the same all over it but for its texture.
    OfPart(usize),
}

/// A small piece of surface.
#[derive(Debug, Clone)]
pub(super) struct Spot {
    pub(super) position_m: Vec3,
    /// Unit normal, out of the surface.
    pub(super) normal: Vec3,
    pub(super) reflectance: Reflectance,
    /// Places whose mean is its radiance, world, metres.
    pub(super) places_m: Vec<Vec3>,
    /// Two opposite ends of its narrow side, world, metres: what must be a few pixels wide.
    pub(super) ends_m: [Vec3; 2],
    /// Directions, cosine-distributed about the normal, and the distance of what they meet, metres.
    pub(super) rays: Vec<(Vec3, f32)>,
}

impl Spot {
    /// The point a little above the surface that rays start from.
    pub(super) fn origin_m(&self) -> Vec3 {
        self.position_m + self.normal * 1e-3
    }

    pub(super) fn gather(&mut self, occluders: &Occluders) {
        let origin = self.origin_m();
        self.rays = cosine_directions(self.normal)
            .map(|d| (d, occluders.distance_m(origin, d, 1e-3).unwrap_or(NOTHING_M)))
            .collect();
    }
}

/// Candidates for patches at the edges of shadows.
const MAX_POOL: usize = 2400;

/// What can be read: spots that always are, and candidates for more.
#[derive(Debug, Default)]
pub(super) struct Spots {
    /// Papers and patches spread evenly.
    pub(super) always: Vec<Spot>,
    /// More patches, without rays.
    pub(super) pool: Vec<Spot>,
    /// Number of parts that patches belong to.
    pub(super) n_parts: usize,
}

/// All spots of a rig among phantoms; `interest` are the points that light is wanted for, `probe` centre and radius in metres
/// of what is no diffuse surface.
pub(super) fn find(rig: &Rig, occluders: &Occluders, interest: &[Vec3], mirrors: &[(Vec3, f32)]) -> Spots {
    let mut always: Vec<Spot> = rig.markers.iter().flat_map(papers_of).collect();
    let mut spots = patches(rig, occluders, interest, mirrors);
    always.append(&mut spots.always);
    always.par_iter_mut().for_each(|spot| spot.gather(occluders));
    Spots { always, ..spots }
}

/// Four strips of the white rim of a marker, three papers each, one cell outside the black square.
fn papers_of(marker: &Marker) -> Vec<Spot> {
    const OFFSETS: [f32; 3] = [-0.2, 0.0, 0.2];
    let pose = crate::scene::affine(&marker.world_from_marker);
    let side = marker.side_m as f32;
    // A tag36h11 is eight cells wide inside one white cell all round (AprilRobotics' layout).
    let rim_m = side / 8.0;
    let outwards = 0.5 * side + 0.5 * rim_m;
    let mut papers = Vec::with_capacity(12);
    for (out, along) in [
        (Vec3::X, Vec3::Y),
        (Vec3::NEG_X, Vec3::Y),
        (Vec3::Y, Vec3::X),
        (Vec3::NEG_Y, Vec3::X),
    ] {
        for place in [-0.35, 0.0, 0.35] {
            let position_m = pose.transform_point3(out * outwards + along * (place * side));
            let along = pose.transform_vector3(along);
            let across = pose.transform_vector3(out);
            papers.push(Spot {
                position_m,
                normal: pose.transform_vector3(Vec3::Z),
                reflectance: Reflectance::Known(marker.white_reflectance as f32),
                places_m: OFFSETS.map(|offset| position_m + along * (offset * rim_m)).to_vec(),
                ends_m: [-0.5, 0.5].map(|side| position_m + across * (side * rim_m)),
                rays: Vec::new(),
            });
        }
    }
    papers
}

/// Patches on the phantoms near markers and virtual objects, spread by area within a part.
fn patches(rig: &Rig, occluders: &Occluders, interest: &[Vec3], mirrors: &[(Vec3, f32)]) -> Spots {
    let markers: Vec<(Vec3, Mat3, f32)> = rig
        .markers
        .iter()
        .map(|marker| {
            let pose = crate::scene::affine(&marker.world_from_marker);
            let marker_from_world = Mat3::from(pose.matrix3).transpose();
            (pose.translation.into(), marker_from_world, marker.side_m as f32)
        })
        .collect();
    let is_near = |p: Vec3| {
        let of_markers = markers.iter().map(|&(center, _, _)| center);
        of_markers
            .chain(interest.iter().copied())
            .any(|q| q.distance(p) < REACH_M)
    };
    let is_printed = |p: Vec3| {
        markers.iter().any(|&(center, marker_from_world, side)| {
            let q = marker_from_world * (p - center);
            q.x.abs().max(q.y.abs()) < PRINTED * side && q.z.abs() < 0.003
        })
    };
    let is_mirror = |p: Vec3| mirrors.iter().any(|&(center, radius)| p.distance(center) < radius);
    let parts = connected_parts(occluders.triangles());
    let candidates: Vec<Vec<Spot>> = parts
        .iter()
        .map(|triangles| {
            let points = spread_over(triangles.iter().map(|&t| occluders.triangles()[t]));
            points
                .filter(|&(p, _)| is_near(p) && !is_printed(p) && !is_mirror(p))
                .map(|(p, normal)| patch(p, normal))
                .collect()
        })
        .filter(|spots: &Vec<Spot>| spots.len() >= MIN_PATCHES)
        .collect();
    let n_parts = candidates.len();
    let share = MAX_PATCHES / (n_parts + 2).max(1);
    // The largest part, usually the table, has three shares: it tells most about where shadows fall.
    let largest = (0..n_parts).max_by_key(|&i| candidates[i].len());
    let mut spots = Spots {
        n_parts,
        ..Spots::default()
    };
    for (part, candidates) in candidates.into_iter().enumerate() {
        let wanted = if Some(part) == largest { 3 * share } else { share };
        // Their order is without pattern, so the first ones are spread as all of them are.
        let mut of_part = candidates.into_iter().map(|spot| Spot {
            reflectance: Reflectance::OfPart(part),
            ..spot
        });
        spots.always.extend(of_part.by_ref().take(wanted));
        let more = if Some(part) == largest {
            MAX_POOL / 2
        } else {
            MAX_POOL / 2 / n_parts
        };
        spots.pool.extend(of_part.take(more));
    }
    spots
}

fn patch(position_m: Vec3, normal: Vec3) -> Spot {
    let along = normal.any_orthonormal_vector() * PATCH_HALF_M;
    let across = normal.cross(along);
    Spot {
        position_m,
        normal,
        reflectance: Reflectance::OfPart(0),
        places_m: [(-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7), (0.7, 0.7), (0.0, 0.0)]
            .map(|(a, b)| position_m + along * a + across * b)
            .to_vec(),
        ends_m: [position_m - along, position_m + along],
        rays: Vec::new(),
    }
}

/// Points on triangles with their normals, one per [`CELL_M`]² or so, in an order that does not follow the surface.
fn spread_over(triangles: impl Iterator<Item = [Vec3; 3]>) -> impl Iterator<Item = (Vec3, Vec3)> {
    /// Edge of the square that one candidate stands for, metres.
    const CELL_M: f32 = 0.008;
    /// Candidates of a part at most.
    const MOST: usize = 20_000;
    let mut points: Vec<(u64, Vec3, Vec3)> = Vec::new();
    let mut owed = 0.5;
    for [a, b, c] in triangles {
        let across = (b - a).cross(c - a);
        let Some(normal) = across.try_normalize() else { continue };
        owed += 0.5 * across.length() / (CELL_M * CELL_M);
        while owed >= 1.0 && points.len() < MOST {
            owed -= 1.0;
            let i = points.len() as f32;
            // The R2 sequence (Roberts 2018), folded into the triangle.
            let (mut u, mut v) = ((0.5 + i * 0.754_877_7).fract(), (0.5 + i * 0.569_840_3).fract());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            points.push((scrambled(points.len() as u64), a + (b - a) * u + (c - a) * v, normal));
        }
    }
    points.sort_by_key(|&(order, _, _)| order);
    points.into_iter().map(|(_, p, n)| (p, n))
}

/// A number without pattern for every number (Steele, Lea and Flood 2014, "SplitMix").
fn scrambled(n: u64) -> u64 {
    let mut z = n.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Triangles that hang together by common corners: one thing each, in the order of their first triangle.
fn connected_parts(triangles: &[[Vec3; 3]]) -> Vec<Vec<usize>> {
    let mut corner_of: HashMap<[i64; 3], usize> = HashMap::new();
    let mut parent: Vec<usize> = (0..triangles.len()).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    for (index, triangle) in triangles.iter().enumerate() {
        for corner in triangle {
            // Corners within 10 µm are one.
            let key = (corner.as_dvec3() * 1e5).round().to_array().map(|x| x as i64);
            let first = *corner_of.entry(key).or_insert(index);
            let (a, b) = (root(&mut parent, first), root(&mut parent, index));
            parent[a.max(b)] = a.min(b);
        }
    }
    let mut parts: Vec<Vec<usize>> = Vec::new();
    let mut part_of: HashMap<usize, usize> = HashMap::new();
    for index in 0..triangles.len() {
        let root = root(&mut parent, index);
        let part = *part_of.entry(root).or_insert_with(|| {
            parts.push(Vec::new());
            parts.len() - 1
        });
        parts[part].push(index);
    }
    parts
}

/// Directions about `normal` whose density is proportional to the cosine (Malley's method over a Fibonacci spiral).
pub(super) fn cosine_directions(normal: Vec3) -> impl Iterator<Item = Vec3> {
    let tangent = normal.any_orthonormal_vector();
    let world_from_surface = Mat3::from_cols(tangent, normal.cross(tangent), normal);
    let golden_angle = PI * (3.0 - 5.0f32.sqrt());
    (0..RAYS).map(move |i| {
        let r2 = (i as f32 + 0.5) / RAYS as f32;
        let (sin, cos) = (golden_angle * i as f32).sin_cos();
        world_from_surface * Vec3::new(r2.sqrt() * cos, r2.sqrt() * sin, (1.0 - r2).sqrt())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_that_do_not_touch_are_different_parts() {
        let triangle = |x: f32| {
            [
                Vec3::new(x, 0.0, 0.0),
                Vec3::new(x + 1.0, 0.0, 0.0),
                Vec3::new(x, 1.0, 0.0),
            ]
        };
        let parts = connected_parts(&[triangle(0.0), triangle(5.0), triangle(1.0)]);
        assert_eq!(parts, [vec![0, 2], vec![1]]);
    }

    #[test]
    fn points_are_spread_by_area() {
        let corner = |x: f32, y: f32| Vec3::new(x, y, 0.2);
        let small = [corner(0.0, 0.0), corner(0.1, 0.0), corner(0.0, 0.1)];
        let large = [corner(1.0, 0.0), corner(1.2, 0.0), corner(1.0, 0.1)];
        let points: Vec<_> = spread_over([small, large].into_iter()).collect();
        let in_large = points.iter().filter(|(p, _)| p.x >= 1.0).count();
        assert!(points.iter().all(|(p, n)| (p.z - 0.2).abs() < 1e-6 && *n == Vec3::Z));
        assert!(
            (in_large as f32 / points.len() as f32 - 2.0 / 3.0).abs() < 0.02,
            "{in_large}"
        );
    }
}
