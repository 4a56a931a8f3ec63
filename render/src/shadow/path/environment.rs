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
    /// Texels by power.
    pub cells: wgpu::Buffer,
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
        let table = PowerTable::new(cube.size(), &power);
        let texels: Vec<Vec4> = cube
            .texels()
            .iter()
            .zip(&table.probabilities)
            .map(|(radiance, &probability)| radiance.max(Vec3::ZERO).extend(probability))
            .collect();
        within_binding(gpu, "a number of bytes of an environment", size_of_val(&texels[..]))?;
        Ok(Self {
            texels: gpu.buffer("path: environment", &texels),
            cells: gpu.buffer("path: environment by power", &table.cells),
            size: cube.size(),
            is_drawn,
        })
    }
}

/// Draws a texel with given probabilities by bisection. Texels lie along Morton's curve (1966), so that even steps of power
/// are even steps over every part of the map, which a table of aliases would not give.
#[derive(Debug, PartialEq)]
struct PowerTable {
    /// Bits of the probability of all texels up to this one, and its index.
    cells: Vec<[u32; 2]>,
    /// Probability of each texel.
    probabilities: Vec<f32>,
}

impl PowerTable {
    /// A table for the weights (0 or more) of a cube's texels; nothing is drawn where none is more.
    fn new(size: u32, weights: &[f64]) -> Self {
        let mut order: Vec<u32> = (0..weights.len() as u32).collect();
        order.sort_by_key(|&index| place_on_curve(size, index));
        let total: f64 = weights.iter().sum();
        let mut probabilities = vec![0.0; weights.len()];
        let mut cells = Vec::with_capacity(weights.len());
        let (mut sum, mut before) = (0.0f64, 0.0f32);
        for index in order {
            sum += weights[index as usize];
            let up_to_here = if total > 0.0 {
                (sum / total).min(1.0) as f32
            } else {
                1.0
            };
            // As the shader draws it, rounding included.
            probabilities[index as usize] = up_to_here - before;
            before = up_to_here;
            cells.push([up_to_here.to_bits(), index]);
        }
        Self { cells, probabilities }
    }
}

/// Place of a texel along Morton's curve, face after face.
fn place_on_curve(size: u32, index: u32) -> u64 {
    let spread = |t: u32| (0..16).fold(0u64, |sum, bit| sum | (u64::from(t >> bit & 1) << (2 * bit)));
    let (x, y, face) = (index % size, index / size % size, index / (size * size));
    (u64::from(face) << 32) | (spread(y) << 1) | spread(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_draws_each_texel_as_often_as_its_weight_says() {
        let weights: Vec<f64> = (0..24).map(|i| f64::from(i * i % 7)).collect();
        let table = PowerTable::new(2, &weights);
        let total: f64 = weights.iter().sum();
        let mut before = 0.0;
        for &[bits, index] in &table.cells {
            let share = f64::from(f32::from_bits(bits)) - before;
            before += share;
            assert!(
                (share - weights[index as usize] / total).abs() < 1e-6,
                "{index}: {share}"
            );
            assert!((f64::from(table.probabilities[index as usize]) - share).abs() < 1e-7);
        }
        assert!((before - 1.0).abs() < 1e-7);
    }

    #[test]
    fn neighbours_lie_together() {
        let order: Vec<u32> = PowerTable::new(4, &[1.0; 96])
            .cells
            .iter()
            .map(|cell| cell[1])
            .collect();
        assert_eq!(order[..8], [0, 1, 4, 5, 2, 3, 6, 7]);
        assert_eq!(order[16..20], [16, 17, 20, 21]);
    }

    #[test]
    fn no_weight_at_all_draws_nothing_twice() {
        let table = PowerTable::new(1, &[0.0; 6]);
        assert_eq!(table.cells.len(), 6);
        assert!(table.probabilities.iter().sum::<f32>() <= 1.0);
    }
}
