//! What others do for the same purpose, on the CPU, from their published formulas; only measured against.

use std::f32::consts::{PI, TAU};

use glam::Vec3;
use mirrorball_calib::probe::cube::Cube;

/// A chain of mips, each the plain mean of 2 × 2 texels, read between texels and mips.
pub(crate) struct Mips {
    mips: Vec<Cube<Vec3>>,
}

impl Mips {
    pub(crate) fn new(radiance: &Cube<Vec3>) -> Self {
        let mut mips = vec![radiance.clone()];
        while let Some(last) = mips.last()
            && last.size() > 1
        {
            mips.push(last.halved());
        }
        Self { mips }
    }

    fn sample(&self, direction: Vec3, level: f32) -> Vec3 {
        let level = level.clamp(0.0, (self.mips.len() - 1) as f32);
        let (low, share) = (level as usize, level.fract());
        let below = self.mips[low].bilinear(direction);
        match self.mips.get(low + 1) {
            Some(above) if share > 0.0 => below.lerp(above.bilinear(direction), share),
            _ => below,
        }
    }
}

/// Point i of n of the Hammersley set in the unit square.
fn hammersley(i: u32, n: u32) -> [f32; 2] {
    [i as f32 / n as f32, i.reverse_bits() as f32 * 2.328_306_4e-10]
}

/// Turns a direction around +z into one around `normal`.
fn around(normal: Vec3, [x, y, z]: [f32; 3]) -> Vec3 {
    let (tangent, bitangent) = normal.any_orthonormal_pair();
    tangent * x + bitangent * y + normal * z
}

fn distribution(cos_half: f32, alpha: f32) -> f32 {
    let d = 1.0 - cos_half * cos_half * (1.0 - alpha * alpha);
    alpha * alpha / (PI * d * d)
}

/// Filtered importance sampling (Krivanek and Colbert 2008) of the GGX lobe with `n` samples, each read a mip coarser than
/// its share of the lobe: what this renderer did before.
pub(crate) fn filtered_sampling(source: &Mips, alpha: f32, normal: Vec3, n: u32) -> Vec3 {
    let size = source.mips[0].size() as f32;
    let texel_sr = 4.0 * PI / (6.0 * size * size);
    let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
    for i in 0..n {
        let [u, v] = hammersley(i, n);
        let cos2 = (1.0 - v) / (1.0 + (alpha * alpha - 1.0) * v);
        let (sin, cos) = ((1.0 - cos2).max(0.0).sqrt(), cos2.sqrt());
        let half = around(normal, [sin * (TAU * u).cos(), sin * (TAU * u).sin(), cos]);
        let light = 2.0 * cos * half - normal;
        let cos_light = normal.dot(light);
        if cos_light > 0.0 {
            let sample_sr = 4.0 / (distribution(cos, alpha) * n as f32);
            let level = 0.5 * (sample_sr / texel_sr).log2() + 1.0;
            sum += cos_light * source.sample(light, level);
            weights += cos_light;
        }
    }
    sum / weights
}

/// Whether Bevy's samples are compressed before they are averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Compression {
    /// As in the releases 0.17.3 and 0.19.1.
    None,
    /// c / (c + 1), undone after the mean: as while the filter was developed (bevyengine/bevy, commit 09b7ae9, 2025).
    Reinhard,
}

impl Compression {
    fn apply(self, c: Vec3) -> Vec3 {
        match self {
            Self::None => c,
            Self::Reinhard => c / (c + 1.0),
        }
    }

    fn undo(self, c: Vec3) -> Vec3 {
        match self {
            Self::None => c,
            Self::Reinhard => c / (Vec3::ONE - c),
        }
    }
}

/// Numbers in 0 .. 1 from a texel, in place of Bevy's blue noise.
fn noise(index: u32) -> [f32; 2] {
    let mut state = index.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let mut next = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
        ((word >> 22) ^ word) as f32 * 2.328_306_4e-10
    };
    [next(), next()]
}

/// Bevy's runtime environment filter (`bevy_pbr` 0.19.1, `environment_filter.wgsl`, `generate_radiance_map`): bounded
/// sampling of visible normals for view = normal (Eto and Tokuyoshi 2023), weights N·L times Smith's G, and a mip by the
/// size of the texel written, not of the one read. `index` is the texel, of a face of `size`.
pub(crate) fn bevy_radiance(
    source: &Mips,
    roughness: f32,
    (normal, index, size): (Vec3, u32, u32),
    compression: Compression,
) -> Vec3 {
    let alpha = roughness.clamp(0.089, 1.0).powi(2);
    let n = 32 << (roughness * 4.0) as u32;
    let turn = noise(index);
    let bound = (1.0 - alpha * alpha) / (1.0 + alpha * alpha);
    let texel_sr = 4.0 * PI / (6.0 * (size * size) as f32);
    let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
    for i in 0..n {
        let [u, v] = hammersley(i, n);
        let (u, v) = ((u + turn[0]).fract(), (v + turn[1]).fract());
        let z = 1.0 - v * (1.0 + bound);
        let sin = (1.0 - z * z).max(0.0).sqrt();
        let half = Vec3::new(alpha * sin * (TAU * u).cos(), alpha * sin * (TAU * u).sin(), z + 1.0).normalize();
        let half = around(normal, half.to_array());
        let light = 2.0 * half.dot(normal) * half - normal;
        let cos_light = normal.dot(light);
        if cos_light > 0.0 {
            let weight = cos_light * smith(cos_light, alpha);
            // The density for a view along +z; the shader passes its view in world space, where +z means nothing.
            let density = bevy_density(normal, normal.dot(half), alpha);
            let level = (0.5 * (1.0 / (n as f32 * density) / texel_sr).log2()).max(0.0);
            sum += weight * compression.apply(source.sample(light, level));
            weights += weight;
        }
    }
    compression.undo(sum / weights)
}

/// The lobe that Bevy's filter samples, by the cosine of light to normal: its own brute force.
pub(crate) fn bevy_lobe(cosine: f64, roughness: f32) -> f64 {
    if cosine <= 0.0 {
        return 0.0;
    }
    let alpha = f64::from(roughness.clamp(0.089, 1.0).powi(2));
    let d = 1.0 - (0.5 + 0.5 * cosine) * (1.0 - alpha * alpha);
    let k = 0.5 * alpha;
    cosine / (d * d) * cosine / (cosine * (1.0 - k) + k)
}

fn smith(cos_light: f32, alpha: f32) -> f32 {
    let k = 0.5 * alpha;
    cos_light / (cos_light * (1.0 - k) + k)
}

/// `ggx_vndf_pdf` with the view in world space, as the shader calls it.
fn bevy_density(view: Vec3, cos_half: f32, alpha: f32) -> f32 {
    let ndf = distribution(cos_half, alpha);
    let len2 = alpha * alpha * view.truncate().length_squared();
    let t = (len2 + view.z * view.z).sqrt();
    if view.z >= 0.0 {
        let s2 = (1.0 + view.truncate().length()).powi(2);
        let k = (1.0 - alpha * alpha) * s2 / (s2 + alpha * alpha * view.z * view.z);
        ndf / (2.0 * (k * view.z + t))
    } else {
        ndf * (t - view.z) / (2.0 * len2)
    }
}

/// Bevy's irradiance over π (`generate_irradiance_map`): 1024 cosine-distributed directions by chance, the first mip read.
pub(crate) fn bevy_irradiance(source: &Mips, normal: Vec3, index: u32) -> Vec3 {
    const SAMPLES: u32 = 1024;
    let mut sum = Vec3::ZERO;
    for i in 0..SAMPLES {
        let [u, v] = noise(index.wrapping_mul(2_131_358_057) ^ i.wrapping_mul(566_200_673));
        let z = 1.0 - 2.0 * u;
        let sin = (1.0 - z * z).max(0.0).sqrt();
        let direction = normal + Vec3::new(sin * (TAU * v).cos(), sin * (TAU * v).sin(), z);
        sum += source.sample(direction.try_normalize().unwrap_or(normal), 0.0);
    }
    sum / SAMPLES as f32
}
