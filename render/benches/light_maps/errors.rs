//! Error tables: energy, and root mean square over the sphere, both relative to brute force.

use std::error::Error;
use std::f32::consts::PI;

use glam::Vec3;
use mirrorball_calib::probe::cube::{Cube, texel_direction, texel_solid_angle};
use mirrorball_render::config::{DiffuseMethod, LightConfig, SpecularMethod};
use mirrorball_render::light_tree::{Lobe, NodeLists};
use mirrorball_render::passes::ENVIRONMENT_MIPS;
use mirrorball_render::passes::irradiance_cube::IRRADIANCE_SIZE;
use mirrorball_render::passes::prefilter_phong::exponent_of_mip;
use mirrorball_render::passes::prefilter_specular::alpha_of_mip;
use mirrorball_render::reference;
use mirrorball_render::reference::lobe_sum::Texels;
use rayon::prelude::*;

use crate::peers::{self, Compression, Mips};
use crate::rooms::{self, LAMP};
use crate::stage::Stage;

/// Texels of a map that are compared, each with the share of the sphere that it stands for.
struct Picks {
    size: u32,
    texels: Vec<(usize, f32)>,
}

impl Picks {
    /// All texels near the lamp up to some hundred, some of the others.
    fn new(size: u32) -> Self {
        let n = 6 * (size * size) as usize;
        let share = |index: usize| {
            let step = match texel_direction(size, index).angle_between(LAMP) {
                near if near < 0.15 => n / 12_000 + 1,
                near if near < 0.6 => n / 2000 + 1,
                _ => n / 600 + 1,
            };
            index
                .is_multiple_of(step)
                .then(|| (index, step as f32 * texel_solid_angle(size, index)))
        };
        Self {
            size,
            texels: (0..n).filter_map(share).collect(),
        }
    }

    /// A map at these texels.
    fn of(&self, map: impl Fn(usize, Vec3) -> Vec3 + Sync) -> Vec<Vec3> {
        let at = |(index, _): &(usize, f32)| map(*index, texel_direction(self.size, *index));
        self.texels.par_iter().map(at).collect()
    }

    /// "energy error %, rms %, worst error in % of the peak" of a map.
    fn figures(&self, found: &[Vec3], exact: &[Vec3]) -> String {
        let (mut light, mut all_light, mut squares, mut all) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
        let (mut worst, mut peak) = (0.0f32, 0.0f32);
        for (((_, share), found), exact) in self.texels.iter().zip(found).zip(exact) {
            let share = f64::from(*share);
            light += share * f64::from(found.element_sum());
            all_light += share * f64::from(exact.element_sum());
            squares += share * f64::from((*found - *exact).length_squared());
            all += share * f64::from(exact.length_squared());
            worst = worst.max((*found - *exact).abs().max_element());
            peak = peak.max(exact.max_element());
        }
        format!(
            "{:+.2} / {:.2} / {:.2}",
            100.0 * (light / all_light - 1.0),
            100.0 * (squares / all).sqrt(),
            100.0 * worst / peak
        )
    }
}

pub(crate) fn print() -> Result<(), Box<dyn Error>> {
    println!("\nError: energy / rms / worst, in % of brute force (worst in % of its peak).");
    println!("Bevy is compared with brute force of its own lobe; its noise is white here instead of blue.");
    let mut stage = Stage::new()?;
    for (name, radiance) in rooms::all() {
        stage.upload(&radiance);
        print_ggx(&mut stage, name, &radiance)?;
        print_phong(&mut stage, name, &radiance)?;
        print_diffuse(&mut stage, name, &radiance)?;
    }
    Ok(())
}

fn print_ggx(stage: &mut Stage, name: &str, radiance: &Cube<Vec3>) -> Result<(), Box<dyn Error>> {
    println!("\n### GGX, {name}\n");
    println!("| mip | roughness | nodes | this renderer | as before (sampled) | Bevy 0.19.1 | Bevy, compressed |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let (texels, mips) = (Texels::new(radiance), Mips::new(radiance));
    let maps = stage.maps(&LightConfig::default());
    stage.make(&maps)?;
    for mip in 1..ENVIRONMENT_MIPS {
        let (ours, alpha) = (stage.specular(mip), alpha_of_mip(mip));
        let roughness = alpha.sqrt();
        let picks = Picks::new(ours.size());
        let exact = picks.of(|_, d| reference::prefilter_specular::radiance(&texels, alpha, d));
        let found = picks.of(|index, _| ours.texels()[index]);
        let sampled = picks.of(|_, d| peers::filtered_sampling(&mips, alpha, d, 32 << mip));
        let own = picks.of(|_, d| texels.mean(d, |cosine| peers::bevy_lobe(cosine, roughness)));
        let bevy = |compression| {
            let found =
                picks.of(|index, d| peers::bevy_radiance(&mips, roughness, (d, index as u32, picks.size), compression));
            picks.figures(&found, &own)
        };
        let lists = NodeLists::new(ours.size(), Lobe::Ggx { alpha });
        println!(
            "| {mip} | {roughness:.1} | {} | {} | {} | {} | {} |",
            lists.entries.len() / lists.tiles.len(),
            picks.figures(&found, &exact),
            picks.figures(&sampled, &exact),
            bevy(Compression::None),
            bevy(Compression::Reinhard)
        );
    }
    Ok(())
}

fn print_phong(stage: &mut Stage, name: &str, radiance: &Cube<Vec3>) -> Result<(), Box<dyn Error>> {
    println!("\n### Phong, {name}\n");
    println!("| mip | exponent | this renderer |");
    println!("| --- | --- | --- |");
    let texels = Texels::new(radiance);
    let maps = stage.maps(&LightConfig {
        specular: SpecularMethod::Phong,
        ..LightConfig::default()
    });
    stage.make(&maps)?;
    for mip in 1..ENVIRONMENT_MIPS {
        let (ours, exponent) = (stage.specular(mip), exponent_of_mip(mip));
        let picks = Picks::new(ours.size());
        let exact = picks.of(|_, d| reference::prefilter_phong::radiance(&texels, exponent, d));
        let found = picks.of(|index, _| ours.texels()[index]);
        println!("| {mip} | {exponent} | {} |", picks.figures(&found, &exact));
    }
    Ok(())
}

fn print_diffuse(stage: &mut Stage, name: &str, radiance: &Cube<Vec3>) -> Result<(), Box<dyn Error>> {
    println!("\n### Irradiance, {name}\n");
    println!("| method | error |");
    println!("| --- | --- |");
    let (texels, mips) = (Texels::new(radiance), Mips::new(radiance));
    let picks = Picks::new(IRRADIANCE_SIZE);
    let exact = picks.of(|_, d| reference::irradiance_cube::irradiance(&texels, d));
    let methods = [
        ("cosine cube", DiffuseMethod::CosineCube),
        ("separable blur on faces (seed)", DiffuseMethod::SeparableBlur),
        ("cylindrical, three axes (seed)", DiffuseMethod::Cylindrical),
        ("SH9", DiffuseMethod::Sh9),
    ];
    for (method, diffuse) in methods {
        let maps = stage.maps(&LightConfig {
            diffuse,
            specular: SpecularMethod::SphereMap,
            ..LightConfig::default()
        });
        stage.make(&maps)?;
        let found = if diffuse == DiffuseMethod::Sh9 {
            let harmonics = stage.harmonics()?;
            picks.of(|_, d| harmonics.irradiance(d))
        } else {
            let cube = stage.irradiance();
            picks.of(|index, _| cube.texels()[index])
        };
        println!("| {method} | {} |", picks.figures(&found, &exact));
    }
    let bevy = picks.of(|index, d| PI * peers::bevy_irradiance(&mips, d, index as u32));
    println!("| Bevy 0.19.1 | {} |", picks.figures(&bevy, &exact));
    Ok(())
}
