//! `mirrorball-shadows`: every shadow method on a scene without camera, as pictures or in a window.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{ArgAction, Parser};
use mirrorball_calib::rig::Rig;
use mirrorball_render::cli;
use mirrorball_render::error::RenderError;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::lab::lamp::{Lamp, LampKind};
use mirrorball_render::lab::scenes::{self, MovingScene};
use mirrorball_render::lab::show::{Choice, Show};
use mirrorball_render::lab::{MAP_SIZE, window};
use mirrorball_render::scene::Scene;
use mirrorball_render::shadow::ShadowMethod;

/// Time from picture to picture, seconds.
const STEP_S: f32 = 1.0 / 25.0;

/// Shows shadow methods on a test scene (toy cars, a street sign, two walls) or on another one, without camera.
#[derive(Debug, Parser)]
#[command(name = "mirrorball-shadows", version, about)]
struct Arguments {
    /// Shadow method: `mirrorball-shadows --shadow ?` lists them.
    #[arg(long, value_name = "METHOD", default_value = "stable")]
    shadow: ShadowMethod,
    /// Scene file instead of the test scene; objects stand at their `world_from_object`.
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Kind of light: point, spot, directional or rect.
    #[arg(long, value_name = "KIND", default_value = "rect")]
    light: LampKind,
    /// Columns and rows of the picture.
    #[arg(long, value_name = "WxH", default_value = "960x720", value_parser = size)]
    size: [u32; 2],
    /// Edge of shadow maps, texels.
    #[arg(long, value_name = "TEXELS", default_value_t = MAP_SIZE)]
    map_size: u32,
    /// Number of pictures to write, 25 per second of the scene.
    #[arg(long, value_name = "N", default_value_t = 1)]
    frames: u32,
    /// Folder for `NNNNNN.png`.
    #[arg(
        long,
        value_name = "DIR",
        required_unless_present = "window",
        conflicts_with = "window"
    )]
    out: Option<PathBuf>,
    /// Show the scene in a window: S next method, L next kind of light, arrows and Page Up and Down move the light, space
    /// pauses, Escape quits.
    #[arg(long, action = ArgAction::SetTrue)]
    window: bool,
}

/// `WxH` as columns and rows.
fn size(text: &str) -> Result<[u32; 2], String> {
    const LARGEST_PX: u32 = 8192;
    let parse = |part: &str| part.parse().ok().filter(|px| (1..=LARGEST_PX).contains(px));
    text.split_once('x')
        .and_then(|(width, height)| Some([parse(width)?, parse(height)?]))
        .ok_or_else(|| format!("`{text}` is no size; allowed is WxH, both 1 to {LARGEST_PX}, as in 640x480"))
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::start_log();
    cli::exit_code(&run(&arguments))
}

fn run(arguments: &Arguments) -> Result<(), RenderError> {
    let (scene, view, lamp) = match &arguments.scene {
        None => (
            MovingScene::test(0),
            scenes::view(arguments.size),
            Lamp::over_test_scene(arguments.light),
        ),
        Some(file) => {
            let scene = load(file)?;
            let bounds = scene.bounds();
            let view = scenes::view_of(bounds, arguments.size);
            (scene, view, Lamp::over(arguments.light, bounds))
        }
    };
    let gpu = Gpu::open()?;
    tracing::info!(adapter = gpu.name, "shadow scene ready");
    let choice = Choice {
        method: arguments.shadow,
        map_size: arguments.map_size,
        lamp,
    };
    let mut show = Show::new(gpu, scene, &view, choice)?;
    match &arguments.out {
        Some(folder) => write_pictures(&mut show, folder, arguments.frames),
        None => window::run(&mut show),
    }
}

/// Reads a scene file; without a rig there are no markers that objects could stand on.
fn load(file: &Path) -> Result<MovingScene, RenderError> {
    let rig = Rig {
        main_marker: 0,
        cameras: Vec::new(),
        markers: Vec::new(),
        ball: None,
    };
    let scene = Scene::load(file, &rig)?;
    let placements: Vec<_> = scene
        .objects
        .iter()
        .map(|object| object.world_from_object(&rig))
        .collect();
    Ok(MovingScene::still(scene, &placements))
}

fn write_pictures(show: &mut Show, folder: &Path, n_frames: u32) -> Result<(), RenderError> {
    let failed = |file: &Path, source: Box<dyn std::error::Error + Send + Sync>| RenderError::Write {
        file: file.to_owned(),
        source,
    };
    std::fs::create_dir_all(folder).map_err(|error| failed(folder, error.into()))?;
    for index in 0..n_frames {
        let shown = show.picture()?;
        let [width, height] = shown.size_px;
        let file = folder.join(format!("{index:06}.png"));
        image::save_buffer(&file, &shown.rgba, width, height, image::ColorType::Rgba8)
            .map_err(|error| failed(&file, error.into()))?;
        show.advance(STEP_S);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_two_numbers_in_range() {
        assert_eq!(size("640x480"), Ok([640, 480]));
        for wrong in ["640", "640x", "0x480", "640x480x3", "9000x480", "-1x5"] {
            assert!(size(wrong).unwrap_err().contains(wrong), "{wrong}");
        }
    }
}
