//! Environments filtered for roughness: one GGX lobe per mip.

use super::ENVIRONMENT_MIPS;
use super::lobe_sum::{LobeSum, Output};
use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::light_tree::Lobe;

/// GGX alpha of a mip: the square of its perceptual roughness, which rises evenly from 0 to 1.
#[must_use]
pub fn alpha_of_mip(mip: u32) -> f32 {
    let roughness = mip as f32 / (ENVIRONMENT_MIPS - 1) as f32;
    roughness * roughness
}

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct PrefilterSpecular {
    sum: LobeSum,
    slots: Vec<u32>,
}

impl PrefilterSpecular {
    /// Binds the pass to the light trees of `slots`.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, slots: &[u32]) -> Self {
        let lobes: Vec<_> = (1..ENVIRONMENT_MIPS)
            .map(|mip| {
                (
                    mip,
                    Lobe::Ggx {
                        alpha: alpha_of_mip(mip),
                    },
                )
            })
            .collect();
        let output = Output {
            texture: &environments.specular,
            lobes: &lobes,
            factor: 1.0,
        };
        Self {
            sum: LobeSum::new(gpu, "prefilter_specular", (environments, slots), output),
            slots: slots.to_vec(),
        }
    }

    /// Filters the environments; the first mip is the environment itself.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, environments: &Environments) {
        environments.copy_first_mip(encoder, &environments.radiance, &self.slots);
        self.sum.record(encoder, timer);
    }
}
