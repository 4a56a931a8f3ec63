//! Environments filtered with Phong lobes: one exponent per mip.

use super::ENVIRONMENT_MIPS;
use super::lobe_sum::{LobeSum, Output};
use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::light_tree::Lobe;

/// Exponent of a mip, 4 ^ (5 - mip): 256, 64, 16, 4 and 1 from the second mip on, so that each lobe is twice as wide as
/// the one before, as texels are. The first mip is the mirror's.
///
/// An exponent n between two mips lies at mip 5 - log₄ n.
#[must_use]
pub fn exponent_of_mip(mip: u32) -> f32 {
    4.0f32.powi(ENVIRONMENT_MIPS as i32 - 1 - mip as i32)
}

/// Exponent of the lobe around the reflected ray that is as wide as a microfacet lobe of perceptual roughness `roughness`,
/// not below 0.
///
/// Half vectors of Beckmann's distribution spread like cos^N with N = 2 / α² - 2 (Walter et al. 2007, after eq. 31), and
/// reflected rays turn twice as far, so n = N / 4 (Fisher and Woo 1994, "R.E versus N.H specular highlights").
#[must_use]
pub fn exponent_of_roughness(roughness: f32) -> f32 {
    let alpha = (roughness * roughness).max(1e-3);
    0.5 * (1.0 / (alpha * alpha) - 1.0)
}

/// The pass, bound to a set of environments.
#[derive(Debug)]
pub struct PrefilterPhong {
    sum: LobeSum,
    slots: Vec<u32>,
}

impl PrefilterPhong {
    /// Binds the pass to the light trees of `slots`.
    #[must_use]
    pub fn new(gpu: &Gpu, environments: &Environments, slots: &[u32]) -> Self {
        let lobe = |mip| Lobe::Phong {
            exponent: exponent_of_mip(mip),
        };
        let lobes: Vec<_> = (1..ENVIRONMENT_MIPS).map(|mip| (mip, lobe(mip))).collect();
        let output = Output {
            texture: &environments.specular,
            lobes: &lobes,
            factor: 1.0,
        };
        Self {
            sum: LobeSum::new(gpu, "prefilter_phong", (environments, slots), output),
            slots: slots.to_vec(),
        }
    }

    /// Filters the environments, whose first mips are in `cubes` and whose light trees are up to date.
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (environments, cubes): (&Environments, &wgpu::Texture),
    ) {
        environments.copy_first_mip(encoder, cubes, &self.slots);
        self.sum.record(encoder, timer);
    }
}
