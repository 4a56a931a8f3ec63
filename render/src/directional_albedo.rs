//! How much of the light from all around alike a surface reflects towards the eye (directional albedo), by angle and
//! roughness.

use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;

/// Columns (cosine of the angle to the normal) and rows (perceptual roughness) of [`table`]; both run from 0 to 1, values
/// lie in the cells' middles.
pub const TABLE_SIZE: [u32; 2] = [64, 32];

/// Least perceptual roughness of a sheen: below it the distribution is all but a spike at the horizon.
const MIN_SHEEN_ROUGHNESS: f32 = 0.07;

/// Albedo of a GGX surface, in parts, and of a sheen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Albedo {
    /// Factor of the reflectance at normal incidence.
    pub scale: f32,
    /// Factor of the reflectance at grazing incidence.
    pub offset: f32,
    /// Albedo of a white sheen.
    pub sheen: f32,
}

/// The table, rows of growing roughness; computed once.
pub fn table() -> &'static [Albedo] {
    static TABLE: OnceLock<Vec<Albedo>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let [columns, rows] = TABLE_SIZE;
        let middle = |i: u32, n: u32| (i as f32 + 0.5) / n as f32;
        let cell = |i: u32| albedo(middle(i / columns, rows), middle(i % columns, columns));
        (0..columns * rows).into_par_iter().map(cell).collect()
    })
}

/// The albedos of one perceptual roughness, for light towards `cosine` of the normal.
///
/// GGX with Smith's correlated masking and Schlick's Fresnel term split by its two reflectances (Karis 2013, "Real shading in
/// Unreal Engine 4"), single scattering, over visible normals (Heitz 2018). Sheen: the distribution and the visibility
/// of Estevez and Kulla 2017, "Production friendly microfacet sheen BRDF".
#[must_use]
pub fn albedo(roughness: f32, cosine: f32) -> Albedo {
    let eye = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine.max(1e-4));
    let alpha = (roughness * roughness).max(1e-4);
    let (scale, offset) = ggx(eye, alpha);
    Albedo {
        scale,
        offset,
        sheen: sheen(eye, roughness.max(MIN_SHEEN_ROUGHNESS).powi(2)).min(1.0),
    }
}

fn ggx(eye: Vec3, alpha: f32) -> (f32, f32) {
    const SAMPLES: u32 = 256;
    let (mut scale, mut offset) = (0.0, 0.0);
    for i in 0..SAMPLES {
        let facet = visible_normal(eye, alpha, hammersley(i, SAMPLES));
        let light = (2.0 * eye.dot(facet) * facet - eye).normalize();
        if light.z > 0.0 {
            let seen = 1.0 + smith_lambda(eye, alpha);
            let share = seen / (seen + smith_lambda(light, alpha));
            let grazing = (1.0 - eye.dot(facet).clamp(0.0, 1.0)).powi(5);
            scale += share * (1.0 - grazing);
            offset += share * grazing;
        }
    }
    (scale / SAMPLES as f32, offset / SAMPLES as f32)
}

fn sheen(eye: Vec3, alpha: f32) -> f32 {
    const SAMPLES: u32 = 1024;
    let own = sheen_lambda(eye.z, alpha);
    let mut sum = 0.0;
    for i in 0..SAMPLES {
        let [u, height] = hammersley(i, SAMPLES);
        let (sin, cos) = (std::f32::consts::TAU * u).sin_cos();
        let z = height + 0.5 / SAMPLES as f32;
        let across = (1.0 - z * z).sqrt();
        let half = (eye + Vec3::new(across * cos, across * sin, z)).normalize();
        let sine2 = (1.0 - half.z * half.z).max(0.0);
        let distribution = (2.0 + 1.0 / alpha) * sine2.powf(0.5 / alpha) / std::f32::consts::TAU;
        sum += distribution / ((1.0 + own + sheen_lambda(z, alpha)) * 4.0 * eye.z);
    }
    sum * std::f32::consts::TAU / SAMPLES as f32
}

/// Masking of the sheen (Estevez and Kulla 2017, table 1 and eq. 3, without their softening of the terminator).
fn sheen_lambda(cosine: f32, alpha: f32) -> f32 {
    let t = (1.0 - alpha) * (1.0 - alpha);
    let mix = |rough: f32, smooth: f32| rough + (smooth - rough) * t;
    let [a, b, c, d, e] = [
        mix(21.5473, 25.3245),
        mix(3.82987, 3.32435),
        mix(0.19823, 0.16801),
        mix(-1.97760, -1.27393),
        mix(-4.32054, -4.85967),
    ];
    let l = |x: f32| a / (1.0 + b * x.powf(c)) + d * x + e;
    if cosine < 0.5 {
        l(cosine).exp()
    } else {
        (2.0 * l(0.5) - l(1.0 - cosine)).exp()
    }
}

/// Smith's masking of GGX (Heitz 2014, eq. 72).
fn smith_lambda(direction: Vec3, alpha: f32) -> f32 {
    let tangent2 = direction.truncate().length_squared() / (direction.z * direction.z);
    0.5 * ((1.0 + alpha * alpha * tangent2).sqrt() - 1.0)
}

/// A facet's normal among those that `eye` sees (Heitz 2018, "Sampling the GGX distribution of visible normals").
fn visible_normal(eye: Vec3, alpha: f32, [u, v]: [f32; 2]) -> Vec3 {
    let stretched = (eye * Vec3::new(alpha, alpha, 1.0)).normalize();
    let one = Vec3::new(-stretched.y, stretched.x, 0.0)
        .try_normalize()
        .unwrap_or(Vec3::X);
    let other = stretched.cross(one);
    let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
    let radius = u.sqrt();
    let x = radius * cos;
    let s = 0.5 * (1.0 + stretched.z);
    let y = (1.0 - s) * (1.0 - x * x).max(0.0).sqrt() + s * radius * sin;
    let normal = x * one + y * other + (1.0 - x * x - y * y).max(0.0).sqrt() * stretched;
    Vec3::new(alpha * normal.x, alpha * normal.y, normal.z.max(0.0)).normalize_or(Vec3::Z)
}

/// Point `i` of `n` of the Hammersley set in the unit square.
fn hammersley(i: u32, n: u32) -> [f32; 2] {
    [(i as f32 + 0.5) / n as f32, i.reverse_bits() as f32 / 4_294_967_296.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smooth_surface_reflects_by_schlick() {
        for cosine in [0.1f32, 0.5, 1.0] {
            let found = albedo(0.0, cosine);
            assert!((found.scale + found.offset - 1.0).abs() < 2e-3, "{found:?}");
            assert!((found.offset - (1.0 - cosine).powi(5)).abs() < 2e-3, "{found:?}");
        }
    }

    /// Kulla and Conty 2017 ("Revisiting physically based shading at Imageworks"): at roughness 1 about 60 % of the light is
    /// lost between the facets.
    #[test]
    fn a_rough_surface_loses_light_and_never_gains_any() {
        let mut before = f32::INFINITY;
        for step in 0..=10 {
            let roughness = step as f32 / 10.0;
            let mean: f32 = (0..50)
                .map(|i| (i as f32 + 0.5) / 50.0)
                .map(|cosine| {
                    let found = albedo(roughness, cosine);
                    assert!(found.scale + found.offset <= 1.0005, "{roughness} {cosine} {found:?}");
                    assert!((0.0..=1.0).contains(&found.sheen));
                    2.0 * cosine * (found.scale + found.offset) / 50.0
                })
                .sum();
            assert!(mean < before + 1e-3, "roughness {roughness}: {mean}");
            before = mean;
        }
        assert!((before - 0.41).abs() < 0.02, "{before}");
    }

    #[test]
    fn a_sheen_is_strongest_at_the_outline() {
        assert!(albedo(0.3, 0.1).sheen > 3.0 * albedo(0.3, 1.0).sheen);
    }
}
