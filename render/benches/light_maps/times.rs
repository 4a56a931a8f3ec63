//! Time per stage.

use std::error::Error;
use std::time::Instant;

use glam::{DVec2, DVec3, Vec3};
use mirrorball_calib::probe::ProbeOptics;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::mirror_ball::MirrorBall;
use mirrorball_render::config::{DiffuseMethod, LightConfig, ProbeConfig, SpecularMethod};
use mirrorball_render::error::RenderError;
use mirrorball_render::gpu::types::{GpuCamera, GpuProbe};
use mirrorball_render::light_maps::LightMaps;
use mirrorball_render::passes::ENVIRONMENT_SIZE;
use mirrorball_render::passes::radiance_map::{CubePlace, RadianceMap, gpu_probe};
use mirrorball_render::probe::surroundings::NOTHING_M;
use mirrorball_render::scene_gpu::PictureBuffers;

use crate::rooms;
use crate::stage::Stage;
use crate::support;

/// Runs per figure, after some that are not counted.
const RUNS: usize = 60;
const WARM_UP: usize = 10;
/// Edge of the ball's picture, pixels.
const PICTURE_PX: u32 = 512;

/// Milliseconds of all runs: by the clock from recording to done, and per pass by the GPU.
#[derive(Default)]
struct Runs {
    wall_ms: Vec<f64>,
    passes_ms: Vec<(&'static str, Vec<f64>)>,
}

impl Runs {
    fn add(&mut self, wall_ms: f64, passes: Vec<(&'static str, f64)>) {
        self.wall_ms.push(wall_ms);
        for (name, ms) in passes {
            match self.passes_ms.iter_mut().find(|(known, _)| *known == name) {
                Some((_, all)) => all.push(ms),
                None => self.passes_ms.push((name, vec![ms])),
            }
        }
    }

    /// "| what | least | median | GPU median | its passes |"
    fn print(mut self, what: &str) {
        let wall = least_and_median(&mut self.wall_ms);
        let passes: Vec<(&str, f64)> = self
            .passes_ms
            .iter_mut()
            .map(|(name, all)| (*name, least_and_median(all)[1]))
            .collect();
        let sum: f64 = passes.iter().map(|(_, ms)| ms).sum();
        let list: Vec<String> = passes.iter().map(|(name, ms)| format!("{name} {ms:.3}")).collect();
        println!(
            "| {what} | {:.2} | {:.2} | {sum:.3} | {} |",
            wall[0],
            wall[1],
            list.join(", ")
        );
    }
}

fn least_and_median(all: &mut [f64]) -> [f64; 2] {
    all.sort_by(f64::total_cmp);
    [all[0], all[all.len() / 2]]
}

/// The ball's picture with what the radiance map needs of it.
struct Ball {
    camera: GpuCamera,
    probe: GpuProbe,
    picture: PictureBuffers,
    pass: RadianceMap,
}

impl Ball {
    fn new(stage: &Stage) -> Self {
        let mut camera = support::rig().scene_camera().clone();
        let ball = MirrorBall {
            center_m: DVec3::new(0.1, 0.2, 0.05),
            radius_m: 0.05,
        };
        let camera_m = ball.center_m + DVec3::new(0.05, -0.4, 0.3);
        camera.intrinsics.size_px = [PICTURE_PX; 2];
        // The ball fills the picture.
        let focal_px = 0.49 * f64::from(PICTURE_PX) * camera_m.distance(ball.center_m) / ball.radius_m;
        camera.intrinsics.focal_px = DVec2::splat(focal_px);
        camera.intrinsics.principal_point_px = DVec2::splat(0.5 * f64::from(PICTURE_PX - 1));
        let camera_from_world = support::looking_at(ball.center_m, camera_m);
        let frame = support::frame(&camera, 1, 1, |ray| DVec3::splat(1.0 + (40.0 * ray.x).sin()));
        let mut picture = PictureBuffers::new(&stage.gpu, &camera);
        picture.upload(&stage.gpu, &frame);
        let camera = GpuCamera::new(&camera, &camera_from_world, &support::EXPOSURE, [0.02, 20.0]);
        let config = ProbeConfig {
            cube_size: ENVIRONMENT_SIZE,
            ..ProbeConfig::default()
        };
        let optics = ProbeOptics::MirrorBall {
            ball,
            reflectance: Vec3::splat(0.8),
        };
        Self {
            probe: gpu_probe(
                &optics,
                camera.position_m.truncate(),
                &config,
                CubePlace {
                    origin_m: optics.position_m(),
                    room_m: 2.0,
                },
            ),
            pass: RadianceMap::new(&stage.gpu, &Cube::filled(ENVIRONMENT_SIZE, NOTHING_M)),
            camera,
            picture,
        }
    }

    /// Measures the cube; the time by the clock includes the copy to memory.
    fn run(&mut self, stage: &mut Stage) -> Result<(), RenderError> {
        let inputs = (&self.camera, &self.probe, &self.picture);
        self.pass.run(&stage.gpu, &mut stage.timer, inputs).map(|_| ())
    }
}

pub(crate) fn print() -> Result<(), Box<dyn Error>> {
    let mut stage = Stage::new()?;
    stage.upload(&rooms::all()[1].1);
    let mut ball = Ball::new(&stage);
    println!("\n### Time, ms, of {RUNS} runs\n");
    println!("By the clock: from recording to done, submission included. By the GPU: sum of the passes' time stamps");
    println!("(software drivers end a compute pass's stamp before its work is done: there only the clock counts).\n");
    println!("| what | least | median | GPU, median | passes |");
    println!("| --- | --- | --- | --- | --- |");
    let config = |diffuse, specular| LightConfig {
        diffuse,
        specular,
        ..LightConfig::default()
    };
    use DiffuseMethod as D;
    use SpecularMethod as S;
    measure(&mut stage, Some(&mut ball), None)?.print("ball 512² to cube 128², copied to memory");
    let maps = stage.maps(&config(D::Sh9, S::Ggx));
    measure(&mut stage, None, Some(&maps))?.print("cube 128² to mips, SH9 and GGX, 5 mips");
    measure(&mut stage, Some(&mut ball), Some(&maps))?.print("**ball to SH9 and GGX**");
    for (what, config) in [
        ("mips, SH9", config(D::Sh9, S::Ggx)),
        ("mips, cosine cube 32²", config(D::CosineCube, S::Ggx)),
        ("mips, separable blur", config(D::SeparableBlur, S::Ggx)),
        ("mips, cylindrical", config(D::Cylindrical, S::Ggx)),
        (
            "mips, cosine cube, sphere maps 256²",
            config(D::SphereMap, S::SphereMap),
        ),
    ] {
        // Nothing glossy: no reflections are prepared.
        stage.environments.slots[0].is_glossy = false;
        let maps = stage.maps(&config);
        stage.environments.slots[0].is_glossy = true;
        measure(&mut stage, None, Some(&maps))?.print(what);
    }
    for (what, config) in [
        ("mips, GGX", config(D::Lights, S::Ggx)),
        ("mips, Phong", config(D::Lights, S::Phong)),
        ("mips, SH9, highlight, Phong", config(D::Lights, S::Highlight)),
    ] {
        let maps = stage.maps(&config);
        measure(&mut stage, None, Some(&maps))?.print(what);
    }
    Ok(())
}

fn measure(stage: &mut Stage, mut ball: Option<&mut Ball>, maps: Option<&LightMaps>) -> Result<Runs, RenderError> {
    let mut runs = Runs::default();
    for run in 0..WARM_UP + RUNS {
        stage.timer.start_frame();
        let begun = Instant::now();
        if let Some(ball) = ball.as_deref_mut() {
            ball.run(stage)?;
        }
        let mut encoder = stage
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        if let Some(maps) = maps {
            maps.record(&mut encoder, &mut stage.timer, &stage.environments);
        }
        stage.timer.record(&mut encoder);
        stage.gpu.queue.submit([encoder.finish()]);
        stage.gpu.wait("a run")?;
        let wall_ms = begun.elapsed().as_secs_f64() * 1e3;
        let passes = stage.timer.read_ms(&stage.gpu)?;
        if run >= WARM_UP {
            runs.add(wall_ms, passes);
        }
    }
    Ok(runs)
}
