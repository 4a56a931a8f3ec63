//! The light probe: a measured radiance cube becomes light from every direction, with what the camera could not see or
//! could not count put back.

pub mod clipped;
mod compact;
pub mod meter;
mod strong_lights;
pub mod surroundings;

use glam::{DVec3, Vec3, Vec4};
use mirrorball_calib::lights::{KeyLight, LightCounts, LightTracker};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::fusion::{Fusion, ViewNoise};
use mirrorball_calib::probe::mapping::{LightSphere, ProbeMap};
use mirrorball_calib::probe::radiance_map::Seen;
use mirrorball_calib::probe::{ProbeOptics, View, fill};
use mirrorball_calib::rig::Rig;

use crate::config::{ProbeConfig, RenderConfig, SceneCamera};
use crate::scene::occluders::Occluders;
use clipped::{StrongRegion, strong_regions};
use meter::{KnownLight, LightMeter, MAX_REGIONS, MeterFit};
use strong_lights::StrongLights;
use surroundings::NOTHING_M;

/// What one camera shows of the light.
#[derive(Debug, Clone, Copy)]
pub struct Sighting<'a> {
    /// Texels of the cube as [`Seen::pack`] packs them.
    pub texels: &'a [Vec4],
    /// How their radiance is uncertain.
    pub noise: &'a ViewNoise,
    /// The picture.
    pub view: View<'a>,
    /// What it shows the light by.
    pub optics: &'a ProbeOptics,
}

/// Light at the probe's place.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Radiance that arrives at the probe from every direction, linear RGB.
    pub radiance: Cube<Vec3>,
    /// The same without the phantoms: from the room, as far as is known or can be guessed.
    pub far: Cube<Vec3>,
    /// `far` without the strong lights: what would be seen in their place, as far as one can guess.
    pub behind: Cube<Vec3>,
    /// Number of the strong light that a direction shows, counted from 1 in the order of [`MeterFit::lights`]; 0 for none.
    pub strong: Cube<u8>,
    /// `far` as lights, dome first.
    pub lights: Vec<KeyLight>,
    /// Distance of what `far` shows, metres: of the strong lights where they are, of the room elsewhere.
    pub distance_m: Cube<f32>,
    /// Distance of the room from the probe, metres.
    pub room_m: f32,
    /// What papers and phantoms said.
    pub meter: MeterFit,
}

/// Confidence from which on a texel is shown as it was seen; below it the more is filled in from around it the less is
/// known.
const FULL_CONFIDENCE: f32 = 0.2;

/// A room this far away looks the same from everywhere near the probe, metres.
const INFINITELY_FAR_M: f32 = 1000.0;

/// The light probe over time.
#[derive(Debug)]
pub struct LightProbe {
    config: ProbeConfig,
    optics: ProbeOptics,
    near_m: Cube<f32>,
    lights: LightTracker,
    meter: LightMeter,
    fusion: Fusion,
    strong: StrongLights,
    /// How far away what each direction shows is taken to be, metres: phantoms, lights about where they were last, the room.
    assumed_m: Cube<f32>,
    /// Whether the last update found the lights far from where they were taken to be.
    knows_better: bool,
    n_updates: usize,
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
            lights: LightTracker::new(config.light.extraction, &open, counts),
            meter: LightMeter::new(rig, occluders, interest, &mirrors_of(rig)),
            fusion: Fusion::new(size, config.probe.change_ratio, config.probe.average_frames),
            assumed_m: near_m.map(|&near| near.min(config.probe.room_distance_m)),
            knows_better: false,
            near_m,
            optics,
            strong: StrongLights::default(),
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

    /// How far away what each direction shows is to be taken, metres.
    #[must_use]
    pub fn assumed_m(&self) -> &Cube<f32> {
        &self.assumed_m
    }

    /// Whether a second look at the same pictures would see more: the first lights stand elsewhere than was assumed.
    #[must_use]
    pub fn knows_better(&self) -> bool {
        self.knows_better
    }

    /// Forgets what was seen, but not where the lights are.
    pub fn forget(&mut self) {
        self.fusion.forget();
        self.n_updates = 0;
    }

    /// Distance of the room, metres.
    #[must_use]
    pub fn room_m(&self) -> f32 {
        self.config.room_distance_m
    }

    /// Takes in what views of one moment show and gives the light.
    ///
    /// `scene` is the scene camera's picture with its noise; without it (no pose) nothing is read off surfaces.
    pub fn update(
        &mut self,
        sightings: &[Sighting<'_>],
        scene: Option<(&View<'_>, &ViewNoise)>,
        occluders: &Occluders,
    ) -> Light {
        let views: Vec<(&[Vec4], &ViewNoise)> = sightings.iter().map(|s| (s.texels, s.noise)).collect();
        self.fusion.take(&views);
        if let Some((view, noise)) = scene
            && self.config.scene_camera == SceneCamera::Fills
        {
            self.look_from_camera(view, noise, occluders);
        }
        self.n_updates += 1;
        let (mut far, mut radiance) = self.filled();
        let mut regions = strong_regions(&self.fusion.clipped(), &self.near_m, &far);
        regions.truncate(MAX_REGIONS);
        for region in &mut regions {
            self.sharpen(region, sightings, &far);
        }
        clipped::divide_shared(&mut regions);
        let regions = &regions[..];
        let room_m = self.config.room_distance_m;
        let known = KnownLight {
            probe_m: self.optics.position_m(),
            far: &far,
            radiance: &radiance,
            room_m,
        };
        self.meter.focus_on(regions, known, occluders);
        let readings = scene.map_or_else(Vec::new, |(view, _)| self.meter.read(view, occluders));
        let question = self.meter.question(&readings, known, regions, occluders);
        let mut distances_m = question.distances_m(room_m, &self.strong.expected_m(regions, &far));
        if question.can_tell() {
            self.strong.settle(regions, &far, &mut distances_m);
        }
        let meter = question.explain(&distances_m);
        tracing::trace!(
            papers = meter.papers,
            patches = meter.patches,
            residual = meter.residual,
            "light read off surfaces"
        );
        for missing in &meter.missing {
            for &(texel, brightness) in &missing.texels {
                far.texels_mut()[texel] += brightness * missing.radiance;
                radiance.texels_mut()[texel] += brightness * missing.radiance;
            }
        }
        let mut distance_m = self.near_m.map(|_| room_m);
        let mut strong = self.near_m.map(|_| 0u8);
        for (index, light) in meter.lights.iter().enumerate() {
            for &texel in &light.texels {
                distance_m.texels_mut()[texel] = light.distance_m;
                strong.texels_mut()[texel] = index as u8 + 1;
            }
        }
        self.assume(&meter);
        let behind = behind(&far, &strong);
        let lights = self.lights.update(&far, &distance_m).to_vec();
        Light {
            radiance,
            far,
            behind,
            strong,
            lights,
            distance_m,
            room_m,
            meter,
        }
    }

    /// The light of a given map, infinitely far away: nothing is measured.
    pub fn given(&mut self, radiance: &Cube<Vec3>) -> Light {
        let distance_m = radiance.map(|_| f32::INFINITY);
        Light {
            radiance: radiance.clone(),
            far: radiance.clone(),
            behind: radiance.clone(),
            strong: radiance.map(|_| 0),
            lights: self.lights.update(radiance, &distance_m).to_vec(),
            distance_m,
            room_m: INFINITELY_FAR_M,
            meter: MeterFit {
                missing: Vec::new(),
                lights: Vec::new(),
                residual: 0.0,
                papers: 0,
                patches: 0,
            },
        }
    }

    /// Puts a small clipped lamp where the picture that shows it best says that it is.
    fn sharpen(&self, region: &mut StrongRegion, sightings: &[Sighting<'_>], far: &Cube<Vec3>) {
        let Some(direction) = region
            .core
            .iter()
            .map(|&i| far.direction(i))
            .sum::<Vec3>()
            .try_normalize()
        else {
            return;
        };
        let index = far.index_of(direction);
        let quality = |s: &&Sighting<'_>| Seen::unpack(s.texels[index]).map_or(0.0, |seen| seen.quality);
        let Some(best) = sightings.iter().max_by(|a, b| quality(a).total_cmp(&quality(b))) else {
            return;
        };
        let map = ProbeMap {
            intrinsics: &best.view.camera.intrinsics,
            camera_from_world: best.view.camera_from_world,
            optics: best.optics,
        };
        let sphere = LightSphere {
            origin_m: self.optics.position_m().as_dvec3(),
            distance_m: f64::from(self.assumed_m.texels()[index]),
        };
        if let Some(lamp) = compact::locate(&best.view, &map, direction.as_dvec3(), &sphere) {
            region.core = compact::texels_of(&lamp, far);
            let added: Vec<usize> = region
                .core
                .iter()
                .copied()
                .filter(|i| !region.texels.contains(i))
                .collect();
            region.texels.extend(added);
        }
    }

    /// Takes the strong lights to be where they were found now, and around there, as they may move.
    fn assume(&mut self, meter: &MeterFit) {
        /// Angle around a light in which its distance is assumed, radians.
        const AROUND_RAD: f32 = 0.1;
        /// Relative change of a distance that is worth another look: on a ball of 40 mm and for a lamp 1 m away 0.1°.
        const WORTH_A_LOOK: f32 = 0.06;
        let room_m = self.config.room_distance_m;
        let before: Vec<f32> = meter
            .lights
            .iter()
            .map(|light| self.assumed_m.texels()[light.texels[light.texels.len() / 2]])
            .collect();
        for (assumed, &near) in self.assumed_m.texels_mut().iter_mut().zip(self.near_m.texels()) {
            *assumed = near.min(room_m);
        }
        let steps = (AROUND_RAD * self.near_m.size() as f32 / std::f32::consts::FRAC_PI_2).ceil() as usize;
        // Larger lights first, so that a lamp before a bright ceiling keeps its own distance.
        for light in &meter.lights {
            for index in clipped::grown(&self.near_m, &light.texels, steps) {
                if self.near_m.texels()[index] >= NOTHING_M {
                    self.assumed_m.texels_mut()[index] = light.distance_m;
                }
            }
        }
        let is_first = self.n_updates == 1;
        self.knows_better = is_first
            && meter.lights.iter().zip(before).any(|(light, before)| {
                light.distance_sigma.is_finite() && (light.distance_m / before).ln().abs() > WORTH_A_LOOK
            });
    }

    /// Fills in what the probe does not see but the scene camera does: phantoms, a quarter of them per picture after the
    /// first, and the room where nothing is known of it.
    fn look_from_camera(&mut self, view: &View<'_>, noise: &ViewNoise, occluders: &Occluders) {
        const PARTS: usize = 4;
        /// A surface that the camera sees straight is where its phantom says, give or take.
        const PHANTOM_QUALITY: f32 = 0.3;
        /// The room's distance is a guess, so what it looks like from elsewhere is one as well.
        const ROOM_QUALITY: f32 = 0.05;
        let (probe_m, near_m, n) = (self.optics.position_m(), &self.near_m, self.n_updates);
        let room_m = self.config.room_distance_m;
        let eye = view.camera_from_world.inverse().translation.as_vec3();
        self.fusion.take_elsewhere(noise, |index| {
            let distance = near_m.texels()[index];
            if n > 0 && index % PARTS != n % PARTS {
                return None;
            }
            let (distance, quality) = if distance < NOTHING_M {
                (distance, PHANTOM_QUALITY)
            } else {
                (room_m, ROOM_QUALITY)
            };
            let point = probe_m + near_m.direction(index) * distance;
            let in_camera = view.camera_from_world.transform_point(DVec3::from(point));
            let pixel = view.camera.intrinsics.project(in_camera)?;
            let sample = view.picture.sample(pixel)?;
            (!occluders.blocks(eye, point)).then_some(Seen {
                radiance: sample.radiance,
                clipped: sample.clipped,
                clipped_everywhere: sample.clipped,
                quality,
            })
        });
    }

    /// Every direction filled: the room alone, and the room with the phantoms before it.
    fn filled(&self) -> (Cube<Vec3>, Cube<Vec3>) {
        let known = |is_near: bool| {
            let texel = |(index, &near): (usize, &f32)| {
                let share = if (near < NOTHING_M) == is_near {
                    (self.fusion.confidence(index) / FULL_CONFIDENCE).min(1.0)
                } else {
                    0.0
                };
                self.fusion.radiance(index).extend(share)
            };
            let texels = self.near_m.texels().iter().enumerate().map(texel).collect();
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

/// The light without the strong ones, filled in from around them.
fn behind(far: &Cube<Vec3>, strong: &Cube<u8>) -> Cube<Vec3> {
    if strong.texels().iter().all(|&index| index == 0) {
        return far.clone();
    }
    let mut known = far.map(|radiance| radiance.extend(1.0));
    for (texel, &index) in known.texels_mut().iter_mut().zip(strong.texels()) {
        if index > 0 {
            *texel = Vec4::ZERO;
        }
    }
    fill::fill_unknown(&known)
}

/// Spheres (centre, radius with some margin, metres) whose surface mirrors and so says nothing about the light on it.
fn mirrors_of(rig: &Rig) -> Vec<(Vec3, f32)> {
    let of_ball = |ball: &mirrorball_calib::rig::Ball| (ball.center_m.as_vec3(), 1.05 * ball.radius_m as f32);
    rig.ball.iter().map(of_ball).collect()
}
