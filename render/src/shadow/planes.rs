//! The large flat parts of a scene, which projected shadows fall on.

use std::collections::HashMap;

use glam::{Affine3A, DVec3, Vec3, Vec4};

/// Planes of a scene at most.
pub const MAX_PLANES: usize = 8;
/// A plane holds at least this share of all triangles' area.
pub const LEAST_SHARE: f64 = 0.01;
/// A triangle is in a plane when its corners are nearer than this.
pub const FLATNESS_M: f32 = 5e-4;
/// Cosine of the angle between normals that count as the same.
const SAME_NORMAL: f32 = 0.9995;
/// Steps of normals (no unit) and distances (metres) in which triangles are gathered at first.
const STEPS: [f64; 2] = [1.0 / 64.0, 2e-3];

/// Triangles in one plane, of an object or of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    /// Unit normal, and minus its distance from the origin in metres.
    pub plane: Vec4,
    /// Its triangles, metres.
    pub triangles: Vec<[Vec3; 3]>,
    /// Their area, square metres.
    pub area_m2: f64,
}

/// The flat parts of one object, in its own frame: found once, since objects move but do not bend.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatParts {
    planes: Vec<Plane>,
    /// Area of all its triangles, flat or not.
    total_m2: f64,
}

impl FlatParts {
    /// The largest planes among an object's triangles, metres: at most [`MAX_PLANES`], each with at least [`LEAST_SHARE`] of
    /// its area. Triangles that are not finite or have no area are left out.
    #[must_use]
    pub fn new(triangles: impl Iterator<Item = [Vec3; 3]>) -> Self {
        let triangles: Vec<([Vec3; 3], DVec3)> = triangles
            .map(|corners| (corners, area_normal(corners)))
            .filter(|(_, normal)| normal.is_finite() && normal.length() > 0.0)
            .collect();
        let total_m2: f64 = triangles.iter().map(|(_, normal)| normal.length()).sum();
        let mut planes: Vec<Plane> = Vec::new();
        for plane in candidates(&triangles) {
            if !planes.iter().any(|known| is_same(known.plane, plane)) {
                planes.push(Plane {
                    plane,
                    triangles: Vec::new(),
                    area_m2: 0.0,
                });
            }
        }
        for &(corners, normal) in &triangles {
            let direction = normal.normalize().as_vec3();
            if let Some(plane) = planes.iter_mut().find(|p| holds(p.plane, corners, direction)) {
                plane.triangles.push(corners);
                plane.area_m2 += normal.length();
            }
        }
        Self {
            planes: largest(planes, total_m2),
            total_m2,
        }
    }
}

/// The largest planes of placed objects (world from object, rigid), largest first: at most [`MAX_PLANES`], each with at least
/// [`LEAST_SHARE`] of all objects' area. Parts of several objects in one plane are joined.
#[must_use]
pub fn dominant_planes<'a>(objects: impl Iterator<Item = (&'a FlatParts, Affine3A)>) -> Vec<Plane> {
    let mut planes: Vec<Plane> = Vec::new();
    let mut total_m2 = 0.0;
    for (parts, placement) in objects {
        total_m2 += parts.total_m2;
        for part in &parts.planes {
            let normal = placement.transform_vector3(part.plane.truncate());
            let plane = normal.extend(part.plane.w - normal.dot(placement.translation.into()));
            let triangles = (part.triangles.iter()).map(|corners| corners.map(|at| placement.transform_point3(at)));
            match planes.iter_mut().find(|known| is_same(known.plane, plane)) {
                Some(known) => {
                    known.triangles.extend(triangles);
                    known.area_m2 += part.area_m2;
                }
                None => planes.push(Plane {
                    plane,
                    triangles: triangles.collect(),
                    area_m2: part.area_m2,
                }),
            }
        }
    }
    largest(planes, total_m2)
}

/// The largest of some planes, largest first.
fn largest(mut planes: Vec<Plane>, total_m2: f64) -> Vec<Plane> {
    planes.retain(|plane| plane.area_m2 > 0.0 && plane.area_m2 >= LEAST_SHARE * total_m2);
    planes.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
    planes.truncate(MAX_PLANES);
    planes
}

/// Mean planes of the steps that gather most area, largest first, some more than are wanted since one plane may fall
/// into several steps.
fn candidates(triangles: &[([Vec3; 3], DVec3)]) -> Vec<Vec4> {
    let [normal_step, distance_step_m] = STEPS;
    let mut gathered: HashMap<[i64; 4], (DVec3, f64)> = HashMap::new();
    for (corners, area_normal) in triangles {
        let area = area_normal.length();
        let normal = *area_normal / area;
        let distance = normal.dot(corners[0].as_dvec3());
        let [x, y, z] = (normal / normal_step).round().to_array().map(|v| v as i64);
        let entry = gathered
            .entry([x, y, z, (distance / distance_step_m).round() as i64])
            .or_default();
        entry.0 += *area_normal;
        entry.1 += distance * area;
    }
    let mut gathered: Vec<([i64; 4], (DVec3, f64))> = gathered.into_iter().collect();
    // The step itself decides between equal areas, so that the order never depends on the map.
    gathered.sort_by(|(at_a, (a, _)), (at_b, (b, _))| b.length().total_cmp(&a.length()).then(at_a.cmp(at_b)));
    gathered
        .iter()
        .take(8 * MAX_PLANES)
        .map(|(_, (sum, distance_sum))| (sum.normalize()).extend(-distance_sum / sum.length()).as_vec4())
        .collect()
}

fn area_normal([a, b, c]: [Vec3; 3]) -> DVec3 {
    0.5 * (b - a).as_dvec3().cross((c - a).as_dvec3())
}

fn is_same(a: Vec4, b: Vec4) -> bool {
    a.truncate().dot(b.truncate()) > SAME_NORMAL && (a.w - b.w).abs() < FLATNESS_M
}

fn holds(plane: Vec4, corners: [Vec3; 3], normal: Vec3) -> bool {
    normal.dot(plane.truncate()) > SAME_NORMAL
        && corners
            .iter()
            .all(|corner| plane.dot(corner.extend(1.0)).abs() < FLATNESS_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(n: u32, at: impl Fn(f32, f32) -> Vec3) -> Vec<[Vec3; 3]> {
        let corner = |i: u32, j: u32| at(i as f32 / n as f32, j as f32 / n as f32);
        (0..n)
            .flat_map(|i| (0..n).map(move |j| (i, j)))
            .flat_map(|(i, j)| {
                let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect()
    }

    #[test]
    fn floor_and_wall_are_found_however_fine_they_are_cut() {
        for n in [1, 30] {
            let tilted = Affine3A::from_rotation_x(0.3) * Affine3A::from_rotation_z(0.7);
            let mut room = grid(n, |u, v| Vec3::new(2.0 * u, 2.0 * v, 0.3));
            room.extend(grid(n, |u, v| Vec3::new(2.0 * u, 2.0, v)));
            let more_floor = grid(n, |u, v| Vec3::new(u, v, 0.0));
            let ball = grid(20, |u, v| {
                let (theta, phi) = (std::f32::consts::PI * u, std::f32::consts::TAU * v);
                Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()) * 0.2
            });
            let objects = [room, more_floor, ball].map(|triangles| FlatParts::new(triangles.into_iter()));
            let up = Affine3A::from_translation(Vec3::new(5.0, 0.0, 0.3));
            let placements = [tilted, tilted * up, tilted];
            let planes = dominant_planes(objects.iter().zip(placements));
            assert_eq!(planes.len(), 2);
            assert!((planes[0].area_m2 - 5.0).abs() < 1e-3 && (planes[1].area_m2 - 2.0).abs() < 1e-3);
            assert!((planes[0].plane.truncate() - tilted.transform_vector3(Vec3::Z)).length() < 1e-4);
            assert!((planes[0].plane.w + 0.3).abs() < 1e-4);
            assert_eq!(planes[0].triangles.len(), 4 * (n * n) as usize);
            for corner in planes[0].triangles.as_flattened() {
                assert!(planes[0].plane.dot(corner.extend(1.0)).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn nothing_flat_gives_no_plane() {
        assert!(dominant_planes(std::iter::empty()).is_empty());
        let bad = [[Vec3::NAN, Vec3::X, Vec3::Y], [Vec3::ZERO, Vec3::X, Vec3::X]];
        let parts = FlatParts::new(bad.into_iter());
        assert!(dominant_planes(std::iter::once((&parts, Affine3A::IDENTITY))).is_empty());
    }
}
