//! What the second eye costs: frames with one eye and with two, the same scene, light and pixels per eye, in one run.
//!
//! `cargo bench -p mirrorball-render --bench stereo [-- --frames N]`. Prints medians; nothing is asserted. With a software
//! adapter the processor's time tells more than the clock's where other programs run.

#![allow(clippy::print_stdout, reason = "a table is what this program is for")]

#[path = "../tests/support/mod.rs"]
mod support;

use std::error::Error;

use glam::{DVec3, Vec3};
use mirrorball_calib::rig::Rig;
use mirrorball_capture::frame::FrameSet;
use mirrorball_render::config::RenderConfig;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::mode::Mode;
use mirrorball_render::node::{RenderNode, RenderedFrame};
use mirrorball_render::scene::{Kind, Scene};

/// Frames per mode that count, after one that does not, unless the command line says otherwise.
const FRAMES: u64 = 9;

fn scene() -> Scene {
    let sphere = |x: f32, y: f32, material| support::sphere(Vec3::new(x, y, 0.035), 0.03, 32, material);
    support::scene([
        (
            "ground",
            Kind::Phantom,
            support::square(Vec3::ZERO, Vec3::X * 0.3, Vec3::Y * 0.3),
        ),
        (
            "block",
            Kind::Phantom,
            support::sphere(Vec3::new(-0.06, 0.1, 0.03), 0.03, 24, support::diffuse(0.5)),
        ),
        ("white", Kind::Virtual, sphere(0.03, 0.06, support::diffuse(0.8))),
        ("mirror", Kind::Virtual, sphere(0.10, 0.06, support::mirror())),
    ])
}

/// The test rig's cameras with 640 × 480 pixels.
fn rig() -> Rig {
    let mut rig = support::rig();
    for camera in rig.cameras.iter_mut().filter(|camera| camera.name == "scene") {
        camera.intrinsics.size_px = [640, 480];
        camera.intrinsics.focal_px *= 2.0;
        camera.intrinsics.principal_point_px = camera.intrinsics.principal_point_px * 2.0 + 0.5;
    }
    rig
}

fn frame_set(rig: &Rig, sequence: u64) -> FrameSet {
    let from = DVec3::new(0.05, -0.30, 0.34);
    let world_from_camera = support::looking_at(DVec3::new(0.03, 0.0, 0.0), from).inverse();
    let scene = support::frame(rig.scene_camera(), sequence, 1, |ray| {
        let direction = world_from_camera.transform_vector(ray);
        DVec3::splat(3.0 * support::ground_reflectance(rig, from - direction * (from.z / direction.z)))
    });
    let probe = support::frame(rig.probe_camera().unwrap_or(&rig.cameras[0]), sequence, 1, |ray| {
        DVec3::splat(if ray.x > 0.7 { 4.0 } else { 1.0 })
    });
    FrameSet {
        frames: vec![scene, probe],
    }
}

fn stage_ms(frame: &RenderedFrame, stage: &str) -> f64 {
    let of = |(name, ms): &(&str, f64)| (*name == stage).then_some(*ms);
    frame.stages_ms.iter().filter_map(of).sum()
}

/// Processor time of this process so far, all threads, milliseconds in steps of ten (proc(5): fields 14 and 15 of `stat`,
/// in hundredths of a second).
fn processor_ms() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let (_, after_name) = stat.rsplit_once(')')?;
    let ticks = after_name.split_whitespace().skip(11).take(2);
    Some(10.0 * ticks.filter_map(|field| field.parse::<f64>().ok()).sum::<f64>())
}

fn n_frames() -> u64 {
    let arguments: Vec<String> = std::env::args().collect();
    let value = arguments.iter().position(|a| a == "--frames").map(|at| at + 1);
    value
        .and_then(|at| arguments.get(at)?.parse().ok())
        .unwrap_or(FRAMES)
        .max(1)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() -> Result<(), Box<dyn Error>> {
    let rig = rig();
    let modes = [Mode::SeeThrough, Mode::Stereo];
    let mut nodes = Vec::new();
    for mode in modes {
        let mut config = RenderConfig::default();
        config.mode.name = mode;
        nodes.push(RenderNode::new(Gpu::open()?, rig.clone(), &scene(), config)?);
    }
    println!("{}, 640 x 480 pixels per eye", nodes[0].adapter_name());
    let mut frames: [Vec<RenderedFrame>; 2] = [Vec::new(), Vec::new()];
    // One after the other, so that whatever else the machine does falls on both.
    let mut processor: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
    for sequence in 0..=n_frames() {
        let set = frame_set(&rig, sequence);
        for (index, node) in nodes.iter_mut().enumerate() {
            let before_ms = processor_ms();
            let frame = node.render(&set)?;
            if sequence > 0 {
                frames[index].push(frame);
                processor[index].extend(processor_ms().zip(before_ms).map(|(after, before)| after - before));
            }
        }
    }
    let names: Vec<&str> = frames[1][0].stages_ms.iter().map(|(name, _)| *name).collect();
    println!("{:32} {:>9} {:>9} {:>7}", "median ms", "one eye", "two eyes", "ratio");
    let print = |name: &str, [one, two]: [f64; 2]| println!("{name:32} {one:9.2} {two:9.2} {:7.2}", two / one);
    for name in names {
        let medians = [0, 1].map(|i: usize| median(frames[i].iter().map(|frame| stage_ms(frame, name)).collect()));
        print(name, medians);
    }
    if processor.iter().all(|times| !times.is_empty()) {
        print("processor time", processor.map(median));
    }
    Ok(())
}
