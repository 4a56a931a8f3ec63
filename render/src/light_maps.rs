//! The maps that virtual objects are lit with, made of their environments each frame by the methods that the settings name.

use crate::config::{DiffuseMethod, LightConfig, SpecularMethod};
use crate::environments::Environments;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::passes::cylindrical::Cylindrical;
use crate::passes::downsample::Downsample;
use crate::passes::harmonics::Harmonics;
use crate::passes::highlight::Highlight;
use crate::passes::irradiance_cube::IrradianceCube;
use crate::passes::prefilter_phong::PrefilterPhong;
use crate::passes::prefilter_specular::PrefilterSpecular;
use crate::passes::separable_blur::SeparableBlur;
use crate::passes::sphere_map::SphereMap;

/// The passes that the methods need, in their order.
#[derive(Debug)]
pub struct LightMaps {
    downsample: Downsample,
    harmonics: Harmonics,
    diffuse: Diffuse,
    specular: Specular,
    sphere_map: Option<SphereMap>,
}

/// What fills the irradiance cubes.
#[derive(Debug)]
enum Diffuse {
    Nothing,
    Cosine(IrradianceCube),
    SeparableBlur(SeparableBlur),
    Cylindrical(Cylindrical),
}

/// What fills the specular cubes.
#[derive(Debug)]
enum Specular {
    Nothing,
    Ggx(PrefilterSpecular),
    Phong(PrefilterPhong),
    Highlight(Highlight, Downsample, PrefilterPhong),
}

impl LightMaps {
    /// The passes for `config`; `camera` is the scene camera's uniform buffer, `sampler` is linear.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        environments: &Environments,
        config: &LightConfig,
        (camera, sampler): (&wgpu::Buffer, &wgpu::Sampler),
    ) -> Self {
        let all: Vec<u32> = (0..environments.slots.len() as u32).collect();
        let is_glossy = |&slot: &u32| environments.slots[slot as usize].is_glossy;
        let glossy: Vec<u32> = all.iter().copied().filter(is_glossy).collect();
        let has_sphere_map = config.diffuse == DiffuseMethod::SphereMap || config.specular == SpecularMethod::SphereMap;
        let diffuse = match config.diffuse {
            DiffuseMethod::Lights | DiffuseMethod::Sh9 => Diffuse::Nothing,
            DiffuseMethod::CosineCube | DiffuseMethod::SphereMap => {
                Diffuse::Cosine(IrradianceCube::new(gpu, environments, &all))
            }
            DiffuseMethod::SeparableBlur => Diffuse::SeparableBlur(SeparableBlur::new(gpu, environments, &all)),
            DiffuseMethod::Cylindrical => Diffuse::Cylindrical(Cylindrical::new(gpu, environments, (&all, sampler))),
        };
        let specular = match config.specular {
            SpecularMethod::SphereMap => Specular::Nothing,
            SpecularMethod::Rays | SpecularMethod::Ggx | SpecularMethod::SmallCube => {
                Specular::Ggx(PrefilterSpecular::new(gpu, environments, &glossy))
            }
            SpecularMethod::Phong => Specular::Phong(PrefilterPhong::new(gpu, environments, &glossy)),
            SpecularMethod::Highlight => {
                let highlight = Highlight::new(gpu, environments, (&glossy, config.highlight_threshold));
                let downsample = Downsample::new(gpu, environments, (highlight.darkened(), &glossy));
                Specular::Highlight(highlight, downsample, PrefilterPhong::new(gpu, environments, &glossy))
            }
        };
        Self {
            downsample: Downsample::new(gpu, environments, (&environments.radiance, &all)),
            harmonics: Harmonics::new(gpu, environments, &all),
            diffuse,
            specular,
            sphere_map: has_sphere_map.then(|| SphereMap::new(gpu, environments, &all, (camera, sampler))),
        }
    }

    /// Makes all maps of the environments' first mips.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, environments: &Environments) {
        self.downsample.record(encoder, timer);
        self.harmonics.record(encoder, timer);
        match &self.diffuse {
            Diffuse::Nothing => {}
            Diffuse::Cosine(pass) => pass.record(encoder, timer),
            Diffuse::SeparableBlur(pass) => pass.record(encoder, timer),
            Diffuse::Cylindrical(pass) => pass.record(encoder, timer),
        }
        match &self.specular {
            Specular::Nothing => {}
            Specular::Ggx(pass) => pass.record(encoder, timer, environments),
            Specular::Phong(pass) => pass.record(encoder, timer, (environments, &environments.radiance)),
            Specular::Highlight(highlight, downsample, phong) => {
                highlight.record(encoder, timer);
                // The nodes of all the light have been read by now.
                downsample.record(encoder, timer);
                phong.record(encoder, timer, (environments, highlight.darkened()));
            }
        }
        if let Some(sphere_map) = &self.sphere_map {
            sphere_map.record(encoder, timer);
        }
    }
}
