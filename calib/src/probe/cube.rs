//! A cube map on the CPU: six square faces around a point, texels addressed by direction.
//!
//! Faces lie as Vulkan and WebGPU lay them: +x, -x, +y, -y, +z, -z, rows from the top.
//! The axes are the world's own, so a direction in world coordinates looks a texel up without any rotation.

use std::ops::{Add, Mul};

use glam::Vec3;

/// Number of faces.
pub const FACES: usize = 6;

/// Six faces of `size` × `size` texels of any kind, face after face, row after row.
#[derive(Debug, Clone, PartialEq)]
pub struct Cube<T> {
    size: u32,
    texels: Vec<T>,
}

impl<T: Copy> Cube<T> {
    /// A cube whose every texel is `value`.
    #[must_use]
    pub fn filled(size: u32, value: T) -> Self {
        Self {
            size,
            texels: vec![value; FACES * (size * size) as usize],
        }
    }

    /// A cube from its texels; `None` unless there are exactly `6 * size * size`.
    #[must_use]
    pub fn from_texels(size: u32, texels: Vec<T>) -> Option<Self> {
        (texels.len() == FACES * (size * size) as usize).then_some(Self { size, texels })
    }

    /// Edge length of a face in texels.
    #[must_use]
    pub fn size(&self) -> u32 {
        self.size
    }

    /// All texels, face after face.
    #[must_use]
    pub fn texels(&self) -> &[T] {
        &self.texels
    }

    /// All texels, to be changed in place.
    pub fn texels_mut(&mut self) -> &mut [T] {
        &mut self.texels
    }

    /// The texel that `direction` (any length, not zero) falls into.
    #[must_use]
    pub fn nearest(&self, direction: Vec3) -> T {
        self.texels[self.index_of(direction)]
    }

    /// Index of the texel that `direction` falls into.
    #[must_use]
    pub fn index_of(&self, direction: Vec3) -> usize {
        let (face, u, v) = face_of(direction);
        let at = |t: f32| (((t + 1.0) * 0.5 * self.size as f32) as u32).min(self.size - 1);
        ((face as u32 * self.size + at(v)) * self.size + at(u)) as usize
    }

    /// Unit direction through the centre of texel `index`.
    #[must_use]
    pub fn direction(&self, index: usize) -> Vec3 {
        texel_direction(self.size, index)
    }

    /// Solid angle of texel `index` in steradians; over the cube they sum to 4π.
    #[must_use]
    pub fn solid_angle(&self, index: usize) -> f32 {
        texel_solid_angle(self.size, index)
    }

    /// Indices of the four texels beside texel `index`, across the edges of its face where need be.
    #[must_use]
    pub fn neighbours(&self, index: usize) -> [usize; 4] {
        let (face, u, v) = texel_uv(self.size, index);
        let step = 2.0 / self.size as f32;
        [(step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)]
            .map(|(du, dv)| self.index_of(face_direction(face, u + du, v + dv)))
    }

    /// A cube of the same size with `f` applied to every texel.
    #[must_use]
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Cube<U> {
        Cube {
            size: self.size,
            texels: self.texels.iter().map(f).collect(),
        }
    }
}

impl<T: Copy + Default + Add<Output = T> + Mul<f32, Output = T>> Cube<T> {
    /// Value towards `direction` from the four nearest texel centres, seamless across the edges.
    #[must_use]
    pub fn bilinear(&self, direction: Vec3) -> T {
        let (face, u, v) = face_of(direction);
        let to_texel = |t: f32| (t + 1.0) * 0.5 * self.size as f32 - 0.5;
        let (x, y) = (to_texel(u), to_texel(v));
        let (x0, y0) = (x.floor(), y.floor());
        let mut sum = T::default();
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let weight = (1.0 - (x - x0 - dx).abs()) * (1.0 - (y - y0 - dy).abs());
            if weight > 0.0 {
                sum = sum + self.tap(face, x0 + dx, y0 + dy) * weight;
            }
        }
        sum
    }

    /// The texel at (`x`, `y`) of `face`; one beyond the edge is found on the neighbouring face by its direction.
    fn tap(&self, face: usize, x: f32, y: f32) -> T {
        let last = self.size as f32 - 1.0;
        if (0.0..=last).contains(&x) && (0.0..=last).contains(&y) {
            return self.texels[((face as u32 * self.size + y as u32) * self.size + x as u32) as usize];
        }
        let from_texel = |t: f32| (t + 0.5) / self.size as f32 * 2.0 - 1.0;
        self.nearest(face_direction(face, from_texel(x), from_texel(y)))
    }

    /// The next smaller mip: means of 2 × 2 texels.
    #[must_use]
    pub fn halved(&self) -> Self {
        let size = (self.size / 2).max(1);
        let mut out = Self::filled(size, T::default());
        for face in 0..FACES as u32 {
            for y in 0..size {
                for x in 0..size {
                    let at = |dx: u32, dy: u32| {
                        self.texels[((face * self.size + 2 * y + dy) * self.size + 2 * x + dx) as usize]
                    };
                    out.texels[((face * size + y) * size + x) as usize] =
                        (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) * 0.25;
                }
            }
        }
        out
    }
}

/// Unit direction through the centre of texel `index` of a cube with faces of `size` texels.
#[must_use]
pub fn texel_direction(size: u32, index: usize) -> Vec3 {
    let (face, u, v) = texel_uv(size, index);
    face_direction(face, u, v).normalize()
}

/// Solid angle of texel `index` in steradians: the exact integral over the texel's square.
///
/// The integral of 1 / (1 + u² + v²)^1.5 is atan(u v / sqrt(1 + u² + v²)) (Arvo 1995, area of a spherical rectangle).
#[must_use]
pub fn texel_solid_angle(size: u32, index: usize) -> f32 {
    let (_, u, v) = texel_uv(size, index);
    let half = 1.0 / f64::from(size);
    let (u, v) = (f64::from(u), f64::from(v));
    let corner = |u: f64, v: f64| (u * v / (1.0 + u * u + v * v).sqrt()).atan();
    (corner(u + half, v + half) - corner(u - half, v + half) - corner(u + half, v - half) + corner(u - half, v - half))
        as f32
}

/// Face and coordinates in -1 ..= 1 of the centre of texel `index`.
fn texel_uv(size: u32, index: usize) -> (usize, f32, f32) {
    let n = size as usize;
    let (face, y, x) = (index / (n * n), index / n % n, index % n);
    let centre = |t: usize| (t as f32 + 0.5) / size as f32 * 2.0 - 1.0;
    (face, centre(x), centre(y))
}

/// Face that `direction` falls into, and where on it (u to the right, v down, each -1 ..= 1).
#[must_use]
pub fn face_of(direction: Vec3) -> (usize, f32, f32) {
    let a = direction.abs();
    let d = direction;
    if a.x >= a.y && a.x >= a.z {
        if d.x > 0.0 {
            (0, -d.z / a.x, -d.y / a.x)
        } else {
            (1, d.z / a.x, -d.y / a.x)
        }
    } else if a.y >= a.z {
        if d.y > 0.0 {
            (2, d.x / a.y, d.z / a.y)
        } else {
            (3, d.x / a.y, -d.z / a.y)
        }
    } else if d.z > 0.0 {
        (4, d.x / a.z, -d.y / a.z)
    } else {
        (5, -d.x / a.z, -d.y / a.z)
    }
}

/// Direction (not normalised) of the point (`u`, `v`) on `face`.
#[must_use]
pub fn face_direction(face: usize, u: f32, v: f32) -> Vec3 {
    match face {
        0 => Vec3::new(1.0, -v, -u),
        1 => Vec3::new(-1.0, -v, u),
        2 => Vec3::new(u, 1.0, v),
        3 => Vec3::new(u, -1.0, -v),
        4 => Vec3::new(u, -v, 1.0),
        _ => Vec3::new(-u, -v, -1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn solid_angles_sum_to_the_sphere() {
        for size in [1, 2, 16, 64] {
            let sum: f64 = (0..FACES * (size * size) as usize)
                .map(|i| f64::from(texel_solid_angle(size, i)))
                .sum();
            assert!((sum - 4.0 * std::f64::consts::PI).abs() < 1e-4, "{size}: {sum}");
        }
    }

    #[test]
    fn a_smooth_function_has_no_seam_at_any_edge() {
        let mut cube = Cube::filled(32, Vec3::ZERO);
        for i in 0..cube.texels().len() {
            let d = cube.direction(i);
            cube.texels_mut()[i] = Vec3::splat(1.0 + 0.3 * d.x + 0.5 * d.y - 0.2 * d.z);
        }
        // Both sides of all twelve edges, along the whole edge.
        for (axis_a, axis_b) in [(0, 1), (0, 2), (1, 2)] {
            for signs in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                for step in -9..=9 {
                    let mut on_edge = Vec3::splat(step as f32 / 10.0);
                    on_edge[axis_a] = signs.0;
                    on_edge[axis_b] = signs.1;
                    let (mut one, mut other) = (on_edge, on_edge);
                    one[axis_a] *= 1.0 + 1e-4;
                    other[axis_b] *= 1.0 + 1e-4;
                    let jump = (cube.bilinear(one) - cube.bilinear(other)).abs().max_element();
                    assert!(jump < 0.02, "edge {axis_a}{axis_b} {signs:?} at {step}: jump {jump}");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn a_texel_centre_falls_into_its_texel(size in 1u32..40, pick in 0.0f32..1.0) {
            let cube = Cube::filled(size, 0u8);
            let index = ((cube.texels().len() - 1) as f32 * pick) as usize;
            prop_assert_eq!(cube.index_of(cube.direction(index)), index);
        }

        #[test]
        fn face_and_direction_round_trip(x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0) {
            let d = Vec3::new(x, y, z);
            prop_assume!(d.length() > 1e-3);
            let (face, u, v) = face_of(d);
            prop_assert!((face_direction(face, u, v).normalize() - d.normalize()).length() < 1e-5);
        }
    }
}
