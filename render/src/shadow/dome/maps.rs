//! Depth maps of all lights of a dome.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};

use super::lights::GpuDomeLight;
use super::step::Step;
use super::{DomeCasters, DomeLight, MAX_DOME_LIGHTS};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::scene::Vertex;
use crate::scene_gpu::SceneBuffers;
use crate::shadow::shadow_view::Sphere;
use mirrorball_calib::probe::radiance::luminance;

/// Workgroups along one axis that every adapter takes.
const MAX_GROUPS: u32 = 65_535;

/// No light, where an index is expected.
pub const NO_LIGHT: u32 = u32::MAX;
/// No bright lights.
pub(crate) const NONE_BRIGHT: [[u32; 4]; 2] = [[NO_LIGHT; 4]; 2];

/// What all threads of a pass share (`Frame` in `shared/dome.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuDomeFrame {
    /// x: number of lights; y: edge of a map, texels; z: first light to be refreshed; w: one past the last.
    pub counts: [u32; 4],
    /// x: number of triangles; y: columns; z: rows; w: 1 for soft shadows.
    pub sizes: [u32; 4],
    /// xyz: irradiance that nothing shades; w: 1 when it comes from above alone, 0 when from everywhere.
    pub unshaded: Vec4,
    /// Indices of the lights that give so much of the light that their penumbrae show; [`NO_LIGHT`] beyond the last.
    pub bright: [[u32; 4]; 2],
}

/// What the maps of a picture show.
#[derive(Debug, Clone, Copy)]
pub struct MapsJob<'a> {
    /// The lights.
    pub lights: &'a [DomeLight],
    /// Sphere that the maps cover.
    pub receivers: Sphere,
    /// Sphere around all casters and receivers: the maps' depth.
    pub everything: Sphere,
    /// Whether casters have moved since the last picture, so that no map may be kept.
    pub is_moved: bool,
    /// Maps refreshed at most in this picture, once all have been drawn; others keep what they show (the seeds' rule
    /// is 1).
    pub refreshes_max: usize,
}

/// Depth maps of one set of casters. A map whose light stands where it stood is kept.
#[derive(Debug)]
pub struct DomeMaps {
    map_size: u32,
    n_lights: u32,
    casters: DomeCasters,
    frame: wgpu::Buffer,
    draw: Step,
    /// What each map shows; `None` for nothing yet.
    drawn: Vec<Option<GpuDomeLight>>,
    /// The next map to be refreshed where not all may be.
    turn: usize,
    /// Lights as their maps show them ([`GpuDomeLight`], [`MAX_DOME_LIGHTS`] of them), uniform.
    pub(super) lights: wgpu::Buffer,
    /// The maps, light after light, rows from the top.
    pub(super) maps: wgpu::Buffer,
    /// How many lights the last picture had.
    n_shown: u32,
    /// Which of them are bright ([`GpuDomeFrame::bright`]).
    bright: [[u32; 4]; 2],
}

impl DomeMaps {
    /// Room for the maps, `map_size` texels wide, of up to `n_lights` lights.
    ///
    /// # Errors
    /// [`RenderError::TooLarge`] for more lights or larger maps than the adapter takes.
    pub fn new(
        gpu: &Gpu,
        scene: &SceneBuffers,
        casters: DomeCasters,
        [n_lights, map_size]: [u32; 2],
    ) -> Result<Self, RenderError> {
        gpu.within("a number of dome lights", u64::from(n_lights), MAX_DOME_LIGHTS as u64)?;
        let bytes = 4 * u64::from(n_lights.max(1)) * u64::from(map_size) * u64::from(map_size);
        gpu.within(
            "the dome's maps in bytes",
            bytes,
            gpu.device.limits().max_storage_buffer_binding_size,
        )?;
        let frame = gpu.buffer("dome: maps' frame", &[GpuDomeFrame::zeroed()]);
        let lights = gpu.buffer("dome: lights", &[GpuDomeLight::zeroed(); MAX_DOME_LIGHTS]);
        let maps = gpu.storage("dome: maps", bytes);
        let draw = Step::new(
            gpu,
            "dome_maps",
            &[
                frame.as_entire_binding(),
                lights.as_entire_binding(),
                casters.corners.as_entire_binding(),
                scene.objects.as_entire_binding(),
                maps.as_entire_binding(),
            ],
        );
        Ok(Self {
            map_size,
            n_lights,
            casters,
            frame,
            draw,
            drawn: vec![None; n_lights as usize],
            turn: 0,
            lights,
            maps,
            n_shown: 0,
            bright: NONE_BRIGHT,
        })
    }

    /// Changes a caster's shape: the vertices of its mesh, in its own frame. Its shadow changes with the next maps.
    pub fn bend(&mut self, gpu: &Gpu, object: usize, moved: &[Vertex]) {
        self.casters.bend(gpu, object, moved);
    }

    /// Edge of a map, texels.
    #[must_use]
    pub fn map_size(&self) -> u32 {
        self.map_size
    }

    /// How many lights there is room for.
    #[must_use]
    pub fn n_lights(&self) -> u32 {
        self.n_lights
    }

    /// The maps: `map_size` × `map_size` numbers of 32 bits per light, rows from the top, 1 at the near plane and 0 at the far
    /// one and where nothing is.
    #[must_use]
    pub fn maps(&self) -> &wgpu::Buffer {
        &self.maps
    }

    /// How many lights the last picture had.
    #[must_use]
    pub fn n_shown(&self) -> u32 {
        self.n_shown
    }

    /// Indices of the last picture's lights that give so much of the light that their penumbrae show, the brightest first;
    /// [`NO_LIGHT`] beyond the last.
    #[must_use]
    pub fn bright(&self) -> [[u32; 4]; 2] {
        self.bright
    }

    /// Draws what has changed; returns which maps were refreshed.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &MapsJob<'_>,
    ) -> Range<usize> {
        let lights: Vec<GpuDomeLight> = job
            .lights
            .iter()
            .take(self.n_lights as usize)
            .map(|light| GpuDomeLight::new(light, (job.receivers, job.everything), self.map_size))
            .collect();
        let range = self.stale(&lights, job);
        for index in range.clone() {
            self.drawn[index] = Some(lights[index]);
        }
        // A map that is not refreshed yet goes on showing what its light saw, with the light of now.
        let shown: Vec<GpuDomeLight> = lights
            .iter()
            .zip(&self.drawn)
            .map(|(light, drawn)| {
                drawn.map_or(*light, |drawn| GpuDomeLight {
                    intensity: light.intensity,
                    ..drawn
                })
            })
            .collect();
        if !shown.is_empty() {
            gpu.write(&self.lights, &shown);
        }
        self.n_shown = shown.len() as u32;
        self.bright = bright(job.lights, job.receivers.center_m);
        if range.is_empty() {
            return range;
        }
        gpu.write(
            &self.frame,
            &[GpuDomeFrame {
                counts: [self.n_shown, self.map_size, range.start as u32, range.end as u32],
                sizes: [self.casters.n_triangles, 0, 0, 0],
                unshaded: Vec4::ZERO,
                bright: NONE_BRIGHT,
            }],
        );
        let layer_bytes = 4 * u64::from(self.map_size) * u64::from(self.map_size);
        encoder.clear_buffer(
            &self.maps,
            layer_bytes * range.start as u64,
            Some(layer_bytes * range.len() as u64),
        );
        let groups = self.casters.n_triangles.div_ceil(64);
        let rows = groups.div_ceil(MAX_GROUPS).max(1);
        self.draw
            .record(encoder, timer, [groups.div_ceil(rows).max(1), rows, 1]);
        range
    }

    /// The maps to be drawn anew: one run of lights.
    fn stale(&mut self, lights: &[GpuDomeLight], job: &MapsJob<'_>) -> Range<usize> {
        let n = lights.len();
        let is_stale = |i: usize| {
            job.is_moved
                || self.drawn[i]
                    .as_ref()
                    .is_none_or(|drawn| !drawn.shows_the_same(&lights[i]))
        };
        let Some(first) = (0..n).find(|&i| is_stale(i)) else {
            return 0..0;
        };
        let last = (first..n).rev().find(|&i| is_stale(i)).unwrap_or(first);
        let never_drawn = self.drawn[..n].iter().any(Option::is_none);
        if never_drawn || last + 1 - first <= job.refreshes_max {
            return first..last + 1;
        }
        let from = self.turn % n;
        let to = (from + job.refreshes_max.max(1)).min(n);
        self.turn = to;
        from..to
    }
}

/// The lights that give at least a twentieth of what arrives at a place, eight at most.
fn bright(lights: &[DomeLight], at_m: Vec3) -> [[u32; 4]; 2] {
    const SHARE: f32 = 0.05;
    let arriving = |l: &DomeLight| luminance(l.intensity) / l.position_m.distance_squared(at_m).max(1e-6);
    let total: f32 = lights.iter().map(arriving).sum();
    let mut found: Vec<(u32, f32)> = (0..)
        .zip(lights.iter().map(arriving))
        .filter(|(_, brightness)| *brightness > SHARE * total)
        .collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut bright = NONE_BRIGHT;
    for (place, (index, _)) in bright.as_flattened_mut().iter_mut().zip(found) {
        *place = index;
    }
    bright
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lamp_is_bright_and_the_sky_is_not() {
        let light = |brightness: f32| DomeLight {
            position_m: 2.0 * Vec3::Z,
            intensity: Vec3::splat(brightness),
            angular_radius_rad: 0.1,
        };
        let mut lights = vec![light(1.0); 140];
        lights[37] = light(30.0);
        lights[130] = light(40.0);
        let mut expected = NONE_BRIGHT;
        (expected[0][0], expected[0][1]) = (130, 37);
        assert_eq!(bright(&lights, Vec3::ZERO), expected);
        assert_eq!(bright(&[], Vec3::ZERO), NONE_BRIGHT);
    }
}
