//! `mirrorball-render`: puts virtual objects into recorded or live frames.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::{Args, Parser, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use mirrorball_calib::rig::Rig;
use mirrorball_capture::{BadFramePolicy, handover};
use mirrorball_render::app::{App, Frames, Input, Step};
use mirrorball_render::cli;
use mirrorball_render::config::RenderConfig;
use mirrorball_render::environment_in;
use mirrorball_render::error::RenderError;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::insets::{Buffer, Insets};
use mirrorball_render::mode::{Mode, Surround};
use mirrorball_render::node::{RenderNode, Work};
use mirrorball_render::output::file::{EnvironmentOut, FolderSink};
use mirrorball_render::output::{Sink, window};
use mirrorball_render::reload::{SceneWatch, Versions};
use mirrorball_render::scene::Scene;
use mirrorball_render::shadow::ShadowMethod;

/// Puts virtual objects into camera frames: tracked, lit by the room's light, with shadows.
#[derive(Debug, Parser)]
#[command(version, about)]
struct Arguments {
    #[command(flatten)]
    input: InputArguments,
    /// Scene file: virtual objects and phantoms.
    #[arg(long, value_name = "FILE")]
    scene: PathBuf,
    /// Environment map to light the objects with instead of measuring the light; equirectangular OpenEXR.
    #[arg(long, value_name = "FILE")]
    environment_in: Option<PathBuf>,
    /// How shadows are drawn, in place of the settings' `shadow.method`: stable, pcss, volume-zfail, ...; in a window the
    /// key S goes through all.
    #[arg(long, value_name = "METHOD")]
    shadow: Option<ShadowMethod>,
    /// What is shown, in place of the settings' `mode.name`: see-through, stereo (side by side), vr, vr-stereo, optical,
    /// optical-stereo.
    #[arg(long, value_name = "MODE")]
    mode: Option<Mode>,
    /// Buffers between the passes to draw small into the picture, sixteen at most, from its top left in rows of four: ratio,
    /// virtual, coverage, ...; a wrong name lists all. In a window the key D goes through them.
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    show: Vec<Buffer>,
    /// Settings; see `configs/render.toml`.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArguments,
}

#[derive(Debug, Args)]
struct InputArguments {
    /// Recording to render, every frame in order.
    #[arg(long, value_name = "DIR", required_unless_present = "from", conflicts_with = "from")]
    recording: Option<PathBuf>,
    /// Where frames come from instead.
    #[arg(long, value_enum)]
    from: Option<Live>,
    /// Service of the capture daemon, with `--from live`.
    #[arg(long, default_value = handover::DEFAULT_SERVICE)]
    service: String,
    /// Rig file; a recording brings its own.
    #[arg(long, value_name = "FILE", required_if_eq("from", "live"))]
    rig: Option<PathBuf>,
    /// Skip and count frames of the recording that cannot be read.
    #[arg(long)]
    skip_bad_frames: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Live {
    /// A running `mirrorball-capture`.
    Live,
}

#[derive(Debug, Args)]
struct OutputArguments {
    /// Folder for `composite/NNNNNN.png` and `frames.jsonl`.
    #[arg(long, value_name = "DIR", required_unless_present = "window")]
    out: Option<PathBuf>,
    /// Write the measured light as `environment/NNNNNN.exr` as well.
    #[arg(long, requires = "out")]
    environment_out: bool,
    /// Measure the light and leave the pictures alone: no composites, much faster; implies --environment-out.
    #[arg(long, requires = "out", conflicts_with = "window")]
    light_only: bool,
    /// Show the pictures in a window; Escape quits.
    #[arg(long)]
    window: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::start_log();
    cli::exit_code(&run(&arguments))
}

fn run(arguments: &Arguments) -> Result<(), RenderError> {
    let mut config = arguments
        .config
        .as_deref()
        .map_or_else(|| Ok(RenderConfig::default()), RenderConfig::load)?;
    config.shadow.method = arguments.shadow.unwrap_or(config.shadow.method);
    config.mode.name = arguments.mode.unwrap_or(config.mode.name);
    let input = input(&arguments.input);
    let rig = load_rig(&arguments.input)?;
    let versions = Versions::of(&arguments.scene);
    let scene = Scene::load(&arguments.scene, &rig)?;
    for warning in scene.warnings() {
        tracing::warn!("{warning}");
    }
    let work = if arguments.output.light_only {
        Work::LightOnly
    } else {
        Work::Everything
    };
    let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
    if let Some(folder) = &arguments.output.out {
        let environment = if arguments.output.environment_out || arguments.output.light_only {
            EnvironmentOut::Yes
        } else {
            EnvironmentOut::No
        };
        sinks.push(Box::new(FolderSink::create(folder, (environment, work))?));
    }
    let frames = Frames::open(&input, &rig.scene_camera().name)?;
    let given = arguments
        .environment_in
        .as_deref()
        .map(|file| environment_in::read_exr(file, config.probe.cube_size))
        .transpose()?;
    let mut node = RenderNode::new(Gpu::open()?, rig, &scene, config)?.with_work(work);
    if let Some(radiance) = given {
        node = node.with_light(radiance);
    }
    if arguments.show.len() > Insets::MOST {
        tracing::warn!(
            most = Insets::MOST,
            "only the first buffers of `--show` have a place in the picture"
        );
    }
    node.show(&arguments.show);
    say_ready(&node);
    if node.mode().surround() == Surround::Nothing {
        tracing::info!("shadows are off: a display that one looks through adds light and takes none away");
    }
    let watch = SceneWatch::start(&arguments.scene, versions, &node)?;
    let mut app = App::new(node, frames, sinks).watching(watch);
    let stop = stop_flag()?;
    let should_stop = || stop.load(Ordering::Relaxed);
    if arguments.output.window {
        window::run(&mut app, &should_stop)?;
    } else {
        run_headless(&mut app, &should_stop)?;
    }
    let counts = app.counts();
    tracing::info!(
        rendered = counts.rendered,
        without_pose = counts.without_pose,
        without_light = counts.without_light,
        skipped = counts.skipped,
        missed = counts.missed,
        reloads = counts.reloads,
        failed_reloads = counts.failed_reloads,
        "done"
    );
    Ok(())
}

fn say_ready(node: &RenderNode) {
    const MIB: u64 = 1 << 20;
    let (adapter, mode) = (node.adapter_name(), node.mode());
    let Some(memory) = node.gpu().memory() else {
        tracing::info!(adapter, %mode, "render node ready");
        return;
    };
    let used_mib = memory.used_bytes.div_ceil(MIB);
    tracing::info!(adapter, %mode, "render node ready: GPU memory {used_mib} MiB");
    for (pass, bytes) in &memory.by_pass {
        tracing::debug!("GPU memory of `{pass}`: {:.2} MiB", *bytes as f64 / MIB as f64);
    }
}

/// How long to wait for a frame before saying so.
const PATIENCE: Duration = Duration::from_secs(2);

fn run_headless(app: &mut App, should_stop: &dyn Fn() -> bool) -> Result<(), RenderError> {
    let bar = progress_bar(app.n_frames());
    let mut is_waiting = false;
    while !should_stop() {
        match app.step(PATIENCE)? {
            Step::Rendered(frame) => {
                is_waiting = false;
                bar.set_message(match frame.pose.camera_from_world() {
                    Some(_) => "tracked",
                    None => "no pose",
                });
                bar.inc(1);
            }
            Step::Skipped => is_waiting = false,
            Step::Waiting => {
                if !is_waiting {
                    tracing::info!("waiting for frames from the capture daemon");
                }
                is_waiting = true;
            }
            Step::Ended => break,
        }
    }
    bar.finish();
    Ok(())
}

fn progress_bar(n_frames: Option<u64>) -> ProgressBar {
    match n_frames {
        Some(n) if std::io::stderr().is_terminal() => {
            let style = ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {eta} left, {msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            ProgressBar::new(n).with_style(style)
        }
        _ => ProgressBar::hidden(),
    }
}

fn input(arguments: &InputArguments) -> Input {
    match &arguments.recording {
        Some(folder) => Input::Recording {
            folder: folder.clone(),
            bad_frames: if arguments.skip_bad_frames {
                BadFramePolicy::Skip
            } else {
                BadFramePolicy::Fail
            },
        },
        None => Input::Live {
            service: arguments.service.clone(),
        },
    }
}

fn load_rig(arguments: &InputArguments) -> Result<Rig, RenderError> {
    let file = match (&arguments.rig, &arguments.recording) {
        (Some(file), _) => file.clone(),
        (None, Some(folder)) => folder.join("rig.toml"),
        (None, None) => PathBuf::from("rig.toml"),
    };
    let text = std::fs::read_to_string(&file).map_err(|source| RenderError::Read {
        file: file.clone(),
        source,
    })?;
    Ok(Rig::from_toml(&text, &file)?)
}

/// Set by Ctrl-C and SIGTERM: the frame at hand is finished, then the program ends.
fn stop_flag() -> Result<Arc<AtomicBool>, RenderError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).map_err(|source| RenderError::Signals { source })?;
    }
    Ok(stop)
}
