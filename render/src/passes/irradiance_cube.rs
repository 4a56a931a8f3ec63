//! Irradiance for every normal, as a small cube: the exact cosine convolution.

use std::f32::consts::PI;

use super::lobe_sum::{LobeSum, Output};
use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::light_tree::Lobe;

/// Edge of a face of an irradiance cube, texels: between two normals 2.8° apart the cosine bends by 3 parts in 10,000.
pub const IRRADIANCE_SIZE: u32 = 32;

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct IrradianceCube {
    sum: LobeSum,
}

impl IrradianceCube {
    /// Binds the pass to the light trees of `slots`.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, slots: &[u32]) -> Self {
        let output = Output {
            texture: &environments.irradiance,
            lobes: &[(0, Lobe::Cosine)],
            // The cosine's mean over the hemisphere to irradiance.
            factor: PI,
        };
        Self {
            sum: LobeSum::new(gpu, "irradiance_cube", (environments, slots), output),
        }
    }

    /// Fills the irradiance cubes.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer) {
        self.sum.record(encoder, timer);
    }
}
