//! Light from infinitely far away, ready to be drawn by its power (`shared/environment_map.wgsl`).

use glam::{Vec3, Vec4};
use mirrorball_calib::probe::cube::Cube;

use super::hierarchy::within_binding;
use super::refused;
use crate::error::RenderError;
use crate::gpu::Gpu;

/// Light from infinitely far away, linear radiance, world frame.
#[derive(Debug, Clone, Copy)]
pub enum Environment<'a> {
    /// From everywhere alike.
    Uniform(Vec3),
    /// By direction: one radiance per texel, not interpolated. Radiance below 0 counts as 0.
    Cube(&'a Cube<Vec3>),
}

/// The same on the GPU.
#[derive(Debug)]
pub struct EnvironmentBuffers {
    /// xyz: radiance of a texel; w: probability that it is drawn.
    pub texels: wgpu::Buffer,
    /// Alias table.
    pub aliases: wgpu::Buffer,
    /// Texels along the edge of a face.
    pub size: u32,
    /// Whether drawing by power pays: the light is neither the same everywhere nor none.
    pub is_drawn: bool,
}

impl EnvironmentBuffers {
    /// Uploads an environment.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] for radiance that is no finite number, [`RenderError::TooLarge`] for more texels than the
    /// adapter binds.
    pub fn new(gpu: &Gpu, environment: &Environment<'_>) -> Result<Self, RenderError> {
        let one;
        let (cube, is_uniform) = match environment {
            Environment::Uniform(radiance) => {
                one = Cube::filled(1, *radiance);
                (&one, true)
            }
            Environment::Cube(cube) => (*cube, false),
        };
        if let Some(bad) = cube.texels().iter().position(|radiance| !radiance.is_finite()) {
            return Err(refused(
                format!(
                    "texel {bad} of the environment is {}, not a finite radiance",
                    cube.texels()[bad]
                ),
                "repair the map, or leave the frames out that made it",
            ));
        }
        if cube.size() == 0 {
            return Err(refused(
                "the environment has no texels",
                "give a map with at least one texel per face",
            ));
        }
        let power: Vec<f64> = cube
            .texels()
            .iter()
            .enumerate()
            .map(|(i, radiance)| f64::from(radiance.max(Vec3::ZERO).element_sum()) * f64::from(cube.solid_angle(i)))
            .collect();
        let total: f64 = power.iter().sum();
        let is_drawn = !is_uniform && total > 0.0;
        let table = AliasTable::new(&power);
        let texels: Vec<Vec4> = cube
            .texels()
            .iter()
            .zip(&table.probabilities)
            .map(|(radiance, &probability)| radiance.max(Vec3::ZERO).extend(probability))
            .collect();
        within_binding(gpu, "a number of bytes of an environment", size_of_val(&texels[..]))?;
        Ok(Self {
            texels: gpu.buffer("path: environment", &texels),
            aliases: gpu.buffer("path: aliases", &table.entries),
            size: cube.size(),
            is_drawn,
        })
    }
}

/// Draws an index with given probabilities in constant time (Walker 1977, built as Vose 1991).
#[derive(Debug, PartialEq)]
struct AliasTable {
    /// Bits of the probability that the index stays itself, and what else it is.
    entries: Vec<[u32; 2]>,
    /// Probability of each index.
    probabilities: Vec<f32>,
}

impl AliasTable {
    /// A table for weights of 0 or more; all equal where none is more.
    fn new(weights: &[f64]) -> Self {
        let n = weights.len();
        let total: f64 = weights.iter().sum();
        let of_mean = |weight: f64| if total > 0.0 { weight / total * n as f64 } else { 1.0 };
        let mut left: Vec<f64> = weights.iter().map(|&w| of_mean(w)).collect();
        let probabilities = left.iter().map(|&share| (share / n as f64) as f32).collect();
        let mut entries: Vec<[u32; 2]> = (0..n as u32).map(|i| [1.0f32.to_bits(), i]).collect();
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..n).partition(|&i| left[i] < 1.0);
        while let (Some(i), Some(&j)) = (small.pop(), large.last()) {
            entries[i] = [(left[i] as f32).to_bits(), j as u32];
            left[j] -= 1.0 - left[i];
            if left[j] < 1.0 {
                large.pop();
                small.push(j);
            }
        }
        // What rounding leaves in `small` when `large` is empty fills its own place.
        Self { entries, probabilities }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_draws_each_index_as_often_as_its_weight_says() {
        let weights = [0.0, 3.0, 0.5, 12.0, 0.0, 1.5];
        let table = AliasTable::new(&weights);
        let total: f64 = weights.iter().sum();
        let mut drawn = [0.0f64; 6];
        for (i, &[stays, other]) in table.entries.iter().enumerate() {
            let stays = f64::from(f32::from_bits(stays));
            drawn[i] += stays / 6.0;
            drawn[other as usize] += (1.0 - stays) / 6.0;
        }
        for (i, &weight) in weights.iter().enumerate() {
            assert!((drawn[i] - weight / total).abs() < 1e-6, "{i}: {}", drawn[i]);
            assert!((f64::from(table.probabilities[i]) - weight / total).abs() < 1e-6);
        }
    }

    #[test]
    fn no_weight_at_all_draws_evenly() {
        let table = AliasTable::new(&[0.0; 4]);
        assert_eq!(table.probabilities, [0.25; 4]);
    }
}
