//! Runs of the render node on simulated pictures of the probe.

use std::path::Path;

use image::RgbImage;
use mirrorball_tests::brightest_light::{angle_deg, brightest_light};
use mirrorball_tests::environment_error::unclipped_error;
use mirrorball_tests::environment_map::{EnvironmentMap, Sphere, WIDTH, luminance};
use mirrorball_tests::irradiance::{self, IrradianceError};
use mirrorball_tests::outputs::{Outputs, StrongLight};
use mirrorball_tests::simulation::{
    Camera, Exposure, Noise, ProbeShot, RadiancePicture, RecordingWriter, SimulatedRig, Surroundings, ball_picture,
    fisheye_picture,
};
use mirrorball_tests::truth::Truth;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{data, program};

/// A carried recording with a second camera: one picture of the scene camera, and what the probe camera would see.
pub(crate) struct Stage {
    name: &'static str,
    rig: SimulatedRig,
    knows_ball: bool,
    /// The true environment map at the probe.
    pub(crate) map: EnvironmentMap,
    scene_camera: Camera,
    scene: RadiancePicture,
    exposure: Exposure,
    background: RadiancePicture,
}

/// Files and settings of the recorded frame that a stage starts from.
struct Recorded {
    map: &'static str,
    frame: &'static str,
    exposure: Exposure,
}

impl Stage {
    /// A small lamp, seen in the ball by a second camera.
    pub(crate) fn two_cameras() -> Self {
        let exposure = Exposure {
            exposure_s: 0.004_694,
            gain: 2.0,
            white_balance: [1.0, 1.141_299_963, 1.419_499_993],
        };
        Self::load(
            "two_cameras",
            &Recorded {
                map: "static_ball",
                frame: "000003",
                exposure,
            },
        )
    }

    /// A large bright ceiling over a fisheye camera.
    pub(crate) fn fisheye() -> Self {
        let exposure = Exposure {
            exposure_s: 0.014_54,
            gain: 1.0,
            white_balance: [1.164_399_981, 1.089_200_02, 1.0],
        };
        Self::load(
            "fisheye",
            &Recorded {
                map: "static_fisheye",
                frame: "000005",
                exposure,
            },
        )
    }

    /// The same light with a rig file that knows of no ball.
    pub(crate) fn without_ball(self) -> Self {
        Self {
            knows_ball: false,
            ..self
        }
    }

    fn load(name: &'static str, recorded: &Recorded) -> Self {
        let picture = |camera: &str| {
            let path = data(&format!("{name}/recording/{camera}/{}.png", recorded.frame));
            image::open(path).unwrap().into_rgb8()
        };
        let rig = SimulatedRig::load(&data(name).join("recording/rig.toml")).unwrap();
        let truth = Truth::load(&data(name).join("truth")).unwrap();
        let pose = truth
            .scene_frame(recorded.frame.parse().unwrap())
            .unwrap()
            .camera_from_marker;
        let scene_camera = rig.scene_camera().unwrap().placed(pose);
        let background = rig
            .probe_camera()
            .unwrap()
            .develop(&picture("probe"), &recorded.exposure);
        Self {
            name,
            rig,
            knows_ball: true,
            map: EnvironmentMap::load(&data(&format!("{name}/truth/env/{}.exr", recorded.map))).unwrap(),
            scene: scene_camera.develop(&picture("scene"), &recorded.exposure),
            scene_camera,
            exposure: recorded.exposure,
            background,
        }
    }

    /// The probe camera.
    pub(crate) fn probe(&self) -> &Camera {
        self.rig.probe_camera().unwrap()
    }

    /// What the probe camera sees of an environment, before noise.
    pub(crate) fn picture_of(&self, map: &EnvironmentMap) -> RadiancePicture {
        if self.probe().role == "ball" {
            self.with_ball(self.probe(), map, &self.background)
        } else {
            fisheye_picture(self.probe(), map)
        }
    }

    /// A picture with the mirror ball in it, lit by the environment at the ball.
    fn with_ball(&self, camera: &Camera, map: &EnvironmentMap, background: &RadiancePicture) -> RadiancePicture {
        // The lamp's distance; the walls are somewhat farther away.
        let surroundings = Surroundings {
            map,
            distance_m: 1.37,
            table_z_m: -0.002,
        };
        ball_picture(camera, self.rig.ball.as_ref().unwrap(), &surroundings, background)
    }

    /// What the scene camera sees: the recorded picture, where a ball camera needs it with the ball in another light.
    ///
    /// Nothing but the ball changes with the light: papers and table stay as they were recorded. There is noise once more,
    /// on top of the recorded, so that it is √2 times what it should be.
    pub(crate) fn scene_of(&self, map: &EnvironmentMap, seed: u64) -> RgbImage {
        let noise = &mut Noise::new(seed);
        if self.probe().role == "ball" {
            let picture = self.with_ball(&self.scene_camera, map, &self.scene);
            self.scene_camera.expose(&picture, &self.exposure, noise)
        } else {
            self.scene_camera.expose(&self.scene, &self.exposure, noise)
        }
    }

    /// The probe camera's picture at a multiple of the recorded exposure.
    pub(crate) fn shot(&self, picture: &RadiancePicture, times: f64, seed: u64) -> (RgbImage, Exposure) {
        let exposure = self.exposure.times(times);
        (self.probe().expose(picture, &exposure, &mut Noise::new(seed)), exposure)
    }

    /// Measures the light of one frame per picture of the probe; the scene camera sees the same all the time.
    pub(crate) fn run(&self, shots: &[(RgbImage, Exposure)]) -> Run {
        let scene = self.scene_of(&self.map, 0);
        let frames: Vec<_> = shots.iter().map(|shot| (scene.clone(), shot.clone())).collect();
        self.run_with(&frames)
    }

    /// Measures the light of frames of both cameras.
    pub(crate) fn run_with(&self, frames: &[(RgbImage, (RgbImage, Exposure))]) -> Run {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("recording");
        let mut writer = RecordingWriter::new(&recording, &data(self.name).join("recording/rig.toml")).unwrap();
        for (scene, (picture, exposure)) in frames {
            let shot = ProbeShot {
                picture,
                exposure: *exposure,
            };
            writer.add((scene, self.exposure), shot).unwrap();
        }
        writer.finish().unwrap();
        if !self.knows_ball {
            let rig = recording.join("rig.toml");
            let text = std::fs::read_to_string(&rig).unwrap();
            std::fs::write(rig, &text[..text.find("[ball]").unwrap()]).unwrap();
        }
        let run = Run::measure(folder, &data(self.name).join("scene/scene.toml"));
        assert_eq!(run.frames.len(), frames.len());
        run
    }

    /// The errors of a map that a run has measured at the probe.
    pub(crate) fn errors(&self, found: &EnvironmentMap, clipping_radiance: f64) -> LightErrors {
        let (sphere, normals) = (Sphere::new(), irradiance::normals());
        let [found_light, true_light] = [found, &self.map].map(|map| brightest_light(map, &sphere).unwrap().direction);
        let [found_sums, true_sums] = [found, &self.map].map(|map| irradiance::irradiance(map, &sphere, &normals));
        LightErrors {
            irradiance: irradiance::compare(&found_sums, &true_sums, &normals),
            light_deg: angle_deg(found_light, true_light),
            unclipped_percent: unclipped_error(found, &self.map, &sphere, clipping_radiance).unwrap(),
        }
    }

    /// Least radiance that clips at a multiple of the recorded exposure.
    pub(crate) fn clipping_radiance(&self, times: f64) -> f64 {
        let exposure = self.exposure.times(times);
        let gain = exposure.white_balance.into_iter().fold(0.0, f64::max) * exposure.gain;
        1.0 / (gain * self.probe().photometry.sensitivity * exposure.exposure_s)
    }
}

/// How far a measured map is from the true one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightErrors {
    pub(crate) irradiance: IrradianceError,
    pub(crate) light_deg: f64,
    pub(crate) unclipped_percent: f64,
}

/// What the render node wrote.
pub(crate) struct Run {
    folder: TempDir,
    /// The lines of `frames.jsonl`.
    pub(crate) frames: Vec<Value>,
}

impl Run {
    fn measure(folder: TempDir, scene: &Path) -> Self {
        let out = folder.path().join("out");
        let output = program("mirrorball-render")
            .args(["--recording".as_ref(), folder.path().join("recording").as_os_str()])
            .args(["--scene".as_ref(), scene.as_os_str()])
            .args(["--out".as_ref(), out.as_os_str(), "--light-only".as_ref()])
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = std::fs::read_to_string(out.join("frames.jsonl")).unwrap();
        let frames = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        Self { folder, frames }
    }

    /// The strong lights of every frame.
    pub(crate) fn strong_lights(&self) -> Vec<Vec<StrongLight>> {
        let outputs = Outputs::load(&self.folder.path().join("out")).unwrap();
        outputs.frames.into_iter().map(|frame| frame.strong_lights).collect()
    }

    /// What is known about the light of a frame.
    pub(crate) fn light(&self, frame: usize) -> &Value {
        &self.frames[frame]["light"]
    }

    /// The measured map at the probe.
    pub(crate) fn map(&self, frame: usize) -> EnvironmentMap {
        let name = format!("out/environment/{frame:06}.exr");
        EnvironmentMap::load(&self.folder.path().join(name)).unwrap()
    }
}

/// A lamp in a map: where it is, and how far around it anything is its light.
pub(crate) struct Lamp {
    pub(crate) direction: glam::DVec3,
    pub(crate) radius_deg: f64,
}

impl Lamp {
    /// The brightest light of a map.
    pub(crate) fn brightest(map: &EnvironmentMap, radius_deg: f64) -> Self {
        Self {
            direction: brightest_light(map, &Sphere::new()).unwrap().direction,
            radius_deg,
        }
    }

    fn angle_deg(&self, direction: glam::Vec3) -> f64 {
        angle_deg(self.direction, direction.as_dvec3())
    }

    /// Mean radiance of a ring around the lamp, half again as wide as the lamp.
    pub(crate) fn surroundings(&self, map: &EnvironmentMap) -> [f32; 3] {
        let sphere = Sphere::new();
        let ring = map.radiance.iter().zip(&sphere.directions).filter(|(_, direction)| {
            let angle_deg = self.angle_deg(**direction);
            angle_deg > self.radius_deg && angle_deg < 1.5 * self.radius_deg
        });
        let (mut sum, mut count) = ([0.0_f32; 3], 0.0_f32);
        for (texel, _) in ring {
            count += 1.0;
            for channel in 0..3 {
                sum[channel] += texel[channel];
            }
        }
        sum.map(|channel| channel / count)
    }

    /// The map with the lamp's surroundings in its place.
    pub(crate) fn taken_out_of(&self, map: &EnvironmentMap) -> EnvironmentMap {
        let (sphere, around) = (Sphere::new(), self.surroundings(map));
        let mut texels = map.radiance.iter().zip(&sphere.directions);
        EnvironmentMap::from_fn(&sphere, |_| {
            let (texel, direction) = texels.next().unwrap();
            if self.angle_deg(*direction) <= self.radius_deg {
                around
            } else {
                *texel
            }
        })
    }

    /// Irradiance of what is brighter than a luminance within three radii of the lamp, on a surface that faces it.
    pub(crate) fn energy(&self, map: &EnvironmentMap, threshold: f64) -> f64 {
        let sphere = Sphere::new();
        let texels = map.radiance.iter().zip(&sphere.directions).enumerate();
        texels
            .filter(|(_, (_, direction))| self.angle_deg(**direction) < 3.0 * self.radius_deg)
            .map(|(index, (texel, _))| {
                (luminance(*texel) - threshold).max(0.0) * sphere.row_solid_angles[index / WIDTH]
            })
            .sum()
    }
}
