//! What is in the way: the real things' triangles, arranged so that rays find them fast.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;

/// Triangles in the world frame, in metres, behind a bounding volume hierarchy.
#[derive(Default)]
pub struct Occluders {
    hierarchy: Option<Bvh2>,
    triangles: Vec<Triangle>,
    corners: Vec<[Vec3; 3]>,
}

impl Occluders {
    /// Arranges triangles given by their corners (world frame, metres).
    #[must_use]
    pub fn new(corners: impl IntoIterator<Item = [Vec3; 3]>) -> Self {
        let corners: Vec<[Vec3; 3]> = corners
            .into_iter()
            .filter(|triangle| triangle.iter().all(|corner| corner.is_finite()))
            .collect();
        let triangles: Vec<Triangle> = corners
            .iter()
            .map(|&[a, b, c]| Triangle {
                v0: a.into(),
                v1: b.into(),
                v2: c.into(),
            })
            .collect();
        let hierarchy = (!triangles.is_empty())
            .then(|| build_bvh2_from_tris(&triangles, BvhBuildParams::medium_build(), &mut Duration::default()));
        Self {
            hierarchy,
            triangles,
            corners,
        }
    }

    /// The corners of all triangles, in the order they were given; those with a corner that is no finite number left out.
    #[must_use]
    pub fn triangles(&self) -> &[[Vec3; 3]] {
        &self.corners
    }

    /// Distance in metres to the first triangle from `origin` along the unit vector `direction`, beyond `from_m`.
    #[must_use]
    pub fn distance_m(&self, origin: Vec3, direction: Vec3, from_m: f32) -> Option<f32> {
        let hierarchy = self.hierarchy.as_ref()?;
        let ray = Ray::new(Vec3A::from(origin), Vec3A::from(direction), from_m, f32::INFINITY);
        let mut hit = RayHit::none();
        hierarchy
            .ray_traverse(ray, &mut hit, |ray, id| {
                intersect(&self.triangles[hierarchy.primitive_indices[id] as usize], ray)
            })
            .then_some(hit.t)
    }

    /// Whether anything stands between two points, 1 mm at both ends left out.
    #[must_use]
    pub fn blocks(&self, from: Vec3, to: Vec3) -> bool {
        const CLEARANCE_M: f32 = 1e-3;
        let way = to - from;
        let length = way.length();
        if length <= 2.0 * CLEARANCE_M {
            return false;
        }
        self.distance_m(from, way / length, CLEARANCE_M)
            .is_some_and(|d| d < length - CLEARANCE_M)
    }
}

/// Distance along a ray to a triangle, infinite where it misses (Möller and Trumbore 1997).
///
/// Edges count, and a little beyond them: `obvhs`'s own test lets a ray exactly through an edge slip between two triangles.
fn intersect(triangle: &Triangle, ray: &Ray) -> f32 {
    const EDGE: f32 = 1e-6;
    let (ab, ac) = (triangle.v1 - triangle.v0, triangle.v2 - triangle.v0);
    let across = ray.direction.cross(ac);
    let inverse = 1.0 / ab.dot(across);
    let from_corner = ray.origin - triangle.v0;
    let u = from_corner.dot(across) * inverse;
    let turned = from_corner.cross(ab);
    let v = ray.direction.dot(turned) * inverse;
    let distance = ac.dot(turned) * inverse;
    let is_hit = inverse.is_finite() && u >= -EDGE && v >= -EDGE && u + v <= 1.0 + EDGE;
    if is_hit && distance >= ray.tmin && distance <= ray.tmax {
        distance
    } else {
        f32::INFINITY
    }
}

impl std::fmt::Debug for Occluders {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Occluders")
            .field("n_triangles", &self.triangles.len())
            .finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Occluders {
        let (a, b, c, d) = (
            Vec3::new(-1.0, -1.0, 0.5),
            Vec3::new(1.0, -1.0, 0.5),
            Vec3::new(1.0, 1.0, 0.5),
            Vec3::new(-1.0, 1.0, 0.5),
        );
        Occluders::new([[a, b, c], [a, c, d]])
    }

    #[test]
    fn a_ray_finds_the_square_from_both_sides() {
        let square = square();
        assert!((square.distance_m(Vec3::ZERO, Vec3::Z, 0.0).unwrap() - 0.5).abs() < 1e-6);
        assert!((square.distance_m(Vec3::Z, Vec3::NEG_Z, 0.0).unwrap() - 0.5).abs() < 1e-6);
        assert_eq!(square.distance_m(Vec3::ZERO, Vec3::X, 0.0), None);
    }

    #[test]
    fn blocking_needs_the_square_between_the_points() {
        let square = square();
        assert!(square.blocks(Vec3::ZERO, Vec3::Z));
        assert!(!square.blocks(Vec3::ZERO, Vec3::new(0.0, 0.0, 0.4)));
        assert!(!Occluders::default().blocks(Vec3::ZERO, Vec3::Z));
    }
}
