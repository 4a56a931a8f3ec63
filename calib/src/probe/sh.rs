//! Irradiance in nine numbers per channel: spherical harmonics up to order 2.
//!
//! Ramamoorthi and Hanrahan 2001, "An efficient representation for irradiance environment maps": the cosine lobe keeps
//! only these orders to within 1 % of the energy of any map, so E(n) = Σ A_l c_lm Y_lm(n) with A = π, 2π/3, π/4.

use std::f32::consts::PI;

use glam::Vec3;

use super::cube::Cube;

/// Real spherical harmonics Y_00, Y_1-1, Y_10, Y_11, Y_2-2, Y_2-1, Y_20, Y_21, Y_22 at unit direction `d`.
#[must_use]
pub fn basis(d: Vec3) -> [f32; 9] {
    [
        0.282_094_8,
        0.488_602_5 * d.y,
        0.488_602_5 * d.z,
        0.488_602_5 * d.x,
        1.092_548_4 * d.x * d.y,
        1.092_548_4 * d.y * d.z,
        0.315_391_57 * (3.0 * d.z * d.z - 1.0),
        1.092_548_4 * d.x * d.z,
        0.546_274_2 * (d.x * d.x - d.y * d.y),
    ]
}

/// Cosine-lobe factors A_l for each of the nine harmonics (Ramamoorthi and Hanrahan 2001, eq. 8).
const COSINE: [f32; 9] = [
    PI,
    2.0 * PI / 3.0,
    2.0 * PI / 3.0,
    2.0 * PI / 3.0,
    PI / 4.0,
    PI / 4.0,
    PI / 4.0,
    PI / 4.0,
    PI / 4.0,
];

/// Radiance projected onto the nine harmonics; evaluates to irradiance on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IrradianceSh {
    /// Radiance coefficients c_lm, linear RGB, in the order of [`basis`].
    pub coefficients: [Vec3; 9],
}

impl IrradianceSh {
    /// Projects a radiance cube; the weights are the texels' solid angles, divided by their exact sum 4π.
    #[must_use]
    pub fn from_cube(radiance: &Cube<Vec3>) -> Self {
        let mut coefficients = [Vec3::ZERO; 9];
        for (index, &value) in radiance.texels().iter().enumerate() {
            let weighted = value * radiance.solid_angle(index);
            for (coefficient, y) in coefficients.iter_mut().zip(basis(radiance.direction(index))) {
                *coefficient += y * weighted;
            }
        }
        Self { coefficients }
    }

    /// Irradiance on a surface with unit normal `normal` (world frame), not below zero.
    #[must_use]
    pub fn irradiance(&self, normal: Vec3) -> Vec3 {
        let mut sum = Vec3::ZERO;
        for ((coefficient, y), a) in self.coefficients.iter().zip(basis(normal)).zip(COSINE) {
            sum += a * y * *coefficient;
        }
        sum.max(Vec3::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube_of(size: u32, f: impl Fn(Vec3) -> f32) -> Cube<Vec3> {
        let mut cube = Cube::filled(size, Vec3::ZERO);
        for i in 0..cube.texels().len() {
            let value = Vec3::splat(f(cube.direction(i)));
            cube.texels_mut()[i] = value;
        }
        cube
    }

    #[test]
    fn uniform_light_has_the_exact_constant_term() {
        let sh = IrradianceSh::from_cube(&cube_of(32, |_| 1.0));
        assert!((sh.coefficients[0].x - 3.544_908).abs() < 1e-3);
        assert!((sh.irradiance(Vec3::Z).x - PI).abs() < 1e-3);
    }

    #[test]
    fn a_linear_gradient_is_exact() {
        let a = Vec3::new(0.2, -0.4, 0.3);
        let sh = IrradianceSh::from_cube(&cube_of(64, |d| 1.0 + a.dot(d)));
        for n in [Vec3::X, Vec3::NEG_Y, Vec3::new(0.6, 0.0, 0.8)] {
            let expected = PI + 2.0 * PI / 3.0 * a.dot(n);
            assert!((sh.irradiance(n).x - expected).abs() < 2e-3, "{n}");
        }
    }

    #[test]
    fn a_lit_hemisphere_is_exact() {
        let sh = IrradianceSh::from_cube(&cube_of(64, |d| if d.y > 0.0 { 1.0 } else { 0.0 }));
        for n in [Vec3::Y, Vec3::NEG_Y, Vec3::new(0.8, 0.6, 0.0), Vec3::Z] {
            let expected = PI / 2.0 * (1.0 + n.y);
            assert!(
                (sh.irradiance(n).x - expected).abs() < 2e-2,
                "{n}: {} {expected}",
                sh.irradiance(n).x
            );
        }
    }

    #[test]
    fn a_single_direction_gives_the_known_lobe() {
        // One texel of unit irradiance: the band-limited cosine lobe is 1.0625, 0.09375, 0.0625 at 0°, 90°, 180°.
        let mut cube = Cube::filled(65, Vec3::ZERO);
        let top = cube.index_of(Vec3::Z);
        let lit = 1.0 / cube.solid_angle(top);
        cube.texels_mut()[top] = Vec3::splat(lit);
        let sh = IrradianceSh::from_cube(&cube);
        for (n, expected) in [(Vec3::Z, 1.0625), (Vec3::X, 0.09375), (Vec3::NEG_Z, 0.0625)] {
            assert!((sh.irradiance(n).x - expected).abs() < 1e-3, "{n}");
        }
    }
}
