//! The light probe: a measured radiance cube becomes light from every direction, with what the camera could not see or
//! could not count put back.

pub mod clipped;
mod least_squares;
pub mod light_meter;
pub mod surroundings;

use glam::{DVec3, Vec3, Vec4};
use mirrorball_calib::lights::{KeyLight, LightCounts, LightTracker};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::radiance::luminance;
use mirrorball_calib::probe::{ProbeOptics, View, fill};
use mirrorball_calib::rig::Rig;
use rayon::prelude::*;

use crate::config::{ProbeConfig, RenderConfig};
use crate::scene::occluders::Occluders;
use clipped::clipped_regions;
use light_meter::{KnownLight, LightMeter, MeterFit};
use surroundings::NOTHING_M;

/// Light at the probe's place.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Radiance that arrives at the probe from every direction, linear RGB.
    pub radiance: Cube<Vec3>,
    /// The same without the phantoms: from the room, as far as is known or can be guessed.
    pub far: Cube<Vec3>,
    /// `far` as lights, dome first.
    pub lights: Vec<KeyLight>,
    /// Distance of the room from the probe, metres.
    pub room_m: f32,
    /// What the papers said.
    pub meter: MeterFit,
}

/// What is remembered of a texel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Memory {
    radiance: Vec3,
    /// Frames in the average, 0 when never seen.
    frames: u8,
    /// Channels clipped anywhere in the texel when last seen (bits 0 to 2) and everywhere in it (bits 3 to 5).
    clipped: u8,
}

/// The light probe over time.
#[derive(Debug)]
pub struct LightProbe {
    config: ProbeConfig,
    optics: ProbeOptics,
    near_m: Cube<f32>,
    lights: LightTracker,
    meter: LightMeter,
    memory: Vec<Memory>,
    room: Room,
    n_updates: usize,
}

/// The room's distance over time, metres.
#[derive(Debug, Clone, Copy)]
struct Room {
    /// Follows `averaged_m` in steps, so that shadow maps can be kept.
    used_m: f32,
    averaged_m: f32,
    is_measured: bool,
}

impl LightProbe {
    /// A probe that has seen nothing yet, among phantoms; `interest` are the points that light is wanted for.
    #[must_use]
    pub fn new(
        config: &RenderConfig,
        rig: &Rig,
        optics: ProbeOptics,
        occluders: &Occluders,
        interest: &[Vec3],
    ) -> Self {
        const OPEN_CUBE_SIZE: u32 = 32;
        let open = surroundings::open_directions(occluders, interest, OPEN_CUBE_SIZE);
        let size = config.probe.cube_size;
        let near_m = surroundings::distances_m(occluders, optics.position_m(), optics.own_extent_m(), size);
        let counts = LightCounts {
            dome: config.shadow.dome_lights,
            bright: config.shadow.bright_lights,
        };
        Self {
            config: config.probe,
            lights: LightTracker::new(config.lights.method, &open, counts),
            meter: LightMeter::new(rig, occluders),
            memory: vec![Memory::default(); near_m.texels().len()],
            near_m,
            optics,
            room: Room {
                used_m: config.probe.room_distance_m,
                averaged_m: config.probe.room_distance_m,
                is_measured: false,
            },
            n_updates: 0,
        }
    }

    /// What looks at the light.
    #[must_use]
    pub fn optics(&self) -> &ProbeOptics {
        &self.optics
    }

    /// Distance to the first phantom in every direction, metres.
    #[must_use]
    pub fn near_m(&self) -> &Cube<f32> {
        &self.near_m
    }

    /// Distance of the room as known so far, metres.
    #[must_use]
    pub fn room_m(&self) -> f32 {
        self.room.used_m
    }

    /// Whether papers have told how far away the room is.
    #[must_use]
    pub fn knows_room(&self) -> bool {
        self.room.is_measured
    }

    /// Forgets what was seen, but not how far away the room is.
    pub fn forget(&mut self) {
        self.memory.fill(Memory::default());
        self.n_updates = 0;
    }

    /// Takes a measured cube in (rgb radiance; a: 0 not seen, else 1 plus the bits of channels clipped anywhere in
    /// the texel plus 8 times those clipped everywhere) and gives the
    /// light. Without a view of the scene (no pose) nothing is put back from the papers.
    pub fn update(&mut self, measured: &[Vec4], view: Option<&View<'_>>, occluders: &Occluders) -> Light {
        self.remember(measured);
        if let Some(view) = view {
            self.look_from_camera(measured, view, occluders);
        }
        self.n_updates += 1;
        let (mut far, mut radiance) = self.filled();
        let clipped = Cube::from_texels(self.near_m.size(), self.memory.iter().map(|m| m.clipped).collect())
            .unwrap_or_else(|| self.near_m.map(|_| 0));
        let regions = clipped_regions(&clipped, &self.near_m, &far);
        let readings = view.map_or_else(Vec::new, |view| {
            self.meter
                .read(&view.picture, view.camera, &view.camera_from_world, occluders)
        });
        let known = KnownLight {
            probe_m: self.optics.position_m(),
            far: &far,
            radiance: &radiance,
        };
        let question = self.meter.question(&readings, known, &regions, occluders);
        if !readings.is_empty() {
            self.room.see(question.room_m(self.config.room_distance_m));
        }
        let meter = question.explain(self.room.used_m);
        tracing::trace!(
            readings = meter.readings,
            residual = meter.residual,
            room_m = meter.room_m,
            "papers read"
        );
        for (texels, missing) in &meter.missing {
            tracing::trace!(texels = texels.len(), direction = %far.direction(texels[0].0), %missing, "clipped region");
            for &(texel, brightness) in texels {
                far.texels_mut()[texel] += brightness * *missing;
                radiance.texels_mut()[texel] += brightness * *missing;
            }
        }
        let lights = self.lights.update(&far, &Cube::filled(1, self.room.used_m)).to_vec();
        Light {
            radiance,
            far,
            lights,
            room_m: self.room.used_m,
            meter,
        }
    }

    /// Averages what stays and replaces what changed.
    fn remember(&mut self, measured: &[Vec4]) {
        let config = self.config;
        self.memory.par_iter_mut().zip(measured).for_each(|(memory, texel)| {
            if texel.w >= 1.0 {
                memory.take(texel.truncate(), texel.w as u8 - 1, &config);
            }
        });
    }

    /// Fills in phantoms that the probe cannot see but the scene camera can; a quarter of them per frame after the first.
    fn look_from_camera(&mut self, measured: &[Vec4], view: &View<'_>, occluders: &Occluders) {
        const PARTS: usize = 4;
        let config = self.config;
        let (probe_m, near_m, n) = (self.optics.position_m(), &self.near_m, self.n_updates);
        let eye = view.camera_from_world.inverse().translation.as_vec3();
        self.memory.par_iter_mut().enumerate().for_each(|(index, memory)| {
            let distance = near_m.texels()[index];
            if measured[index].w >= 1.0 || distance >= NOTHING_M || (n > 0 && index % PARTS != n % PARTS) {
                return;
            }
            let point = probe_m + near_m.direction(index) * distance;
            let in_camera = view.camera_from_world.transform_point(DVec3::from(point));
            let sample = view
                .camera
                .intrinsics
                .project(in_camera)
                .and_then(|pixel| view.picture.sample(pixel));
            if let Some(sample) = sample
                && !occluders.blocks(eye, point)
            {
                memory.take(sample.radiance, sample.clipped, &config);
            }
        });
    }

    /// Every direction filled: the room alone, and the room with the phantoms before it.
    fn filled(&self) -> (Cube<Vec3>, Cube<Vec3>) {
        let known = |is_near: bool| {
            let texel = |(memory, &near): (&Memory, &f32)| {
                let is_known = memory.frames > 0 && (near < NOTHING_M) == is_near;
                memory.radiance.extend(if is_known { 1.0 } else { 0.0 })
            };
            let texels = self.memory.iter().zip(self.near_m.texels()).map(texel).collect();
            Cube::from_texels(self.near_m.size(), texels).unwrap_or_else(|| self.near_m.map(|_| Vec4::ZERO))
        };
        let far = fill::fill_unknown(&known(false));
        let near = fill::fill_unknown(&known(true));
        let mut radiance = far.clone();
        for ((texel, near), distance) in radiance
            .texels_mut()
            .iter_mut()
            .zip(near.texels())
            .zip(self.near_m.texels())
        {
            if *distance < NOTHING_M {
                *texel = *near;
            }
        }
        (far, radiance)
    }
}

impl Room {
    /// Takes an estimate in: a geometric average over about four of them.
    fn see(&mut self, seen_m: f32) {
        /// Changes smaller than this share are left out.
        const STEP: f32 = 0.05;
        if !self.is_measured {
            *self = Self {
                used_m: seen_m,
                averaged_m: seen_m,
                is_measured: true,
            };
            return;
        }
        self.averaged_m = self.averaged_m.powf(0.75) * seen_m.powf(0.25);
        if (self.averaged_m / self.used_m).ln().abs() > STEP {
            self.used_m = self.averaged_m;
        }
    }
}

impl Memory {
    /// Takes a measurement in; one that is no finite number (an exposure of almost nothing) is left out.
    fn take(&mut self, radiance: Vec3, clipped: u8, config: &ProbeConfig) {
        if !radiance.is_finite() {
            return;
        }
        let (new, old) = (luminance(radiance), luminance(self.radiance));
        let has_changed =
            self.frames == 0 || (new - old).abs() > config.change_ratio * old || clipped & 7 != self.clipped & 7;
        self.frames = if has_changed {
            1
        } else {
            (self.frames + 1).min(config.average_frames as u8)
        };
        self.radiance += (radiance - self.radiance) / f32::from(self.frames);
        self.clipped = clipped;
    }
}
