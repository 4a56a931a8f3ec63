//! The camera's look on virtual pixels: noise against the camera's model, blur against its twin and against Gauss, sharpness
//! against pictures that were blurred on purpose.

mod support;

use glam::{DMat2, DMat3, DVec2, DVec3, IVec2, Vec3, Vec4};
use mirrorball_calib::photometry::Photometry;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::{Camera, Marker, Rig};
use mirrorball_capture::frame::{Exposure, Frame, FrameSet};
use mirrorball_render::config::{self, RenderConfig, SceneCamera};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::{GpuCamera, GpuNoise};
use mirrorball_render::look::kernel::{self, from_eigen};
use mirrorball_render::look::sharpness::measure;
use mirrorball_render::node::RenderNode;
use mirrorball_render::passes::composite::Composite;
use mirrorball_render::passes::look_blur::LookBlur;
use mirrorball_render::reference::{self, composite::PixelOf};
use mirrorball_render::scene::Kind;
use mirrorball_render::scene_gpu::PictureBuffers;
use support::stage::{Stage, environment_stage};
use support::{Errors, halves, spread};

const SIZE: [u32; 2] = [320, 240];
const N: usize = 320 * 240;

/// An exposure whose channels differ.
const EXPOSURE: Exposure = Exposure {
    time_s: 0.005,
    gain: 2.0,
    white_balance: [1.5, 1.0, 1.25],
};

/// The scene camera of the tests with a sensor that is as noisy as a webcam's.
fn noisy_camera() -> Camera {
    let mut camera = support::rig().scene_camera().clone();
    camera.photometry.full_well_e = 6000.0;
    camera.photometry.read_noise_e = 8.0;
    camera
}

fn place(index: usize) -> DVec2 {
    DVec2::new((index % 320) as f64, (index / 320) as f64)
}

fn pixel_of(camera: &Camera, index: usize) -> PixelOf<'_> {
    PixelOf {
        camera,
        exposure: &EXPOSURE,
        pixel: place(index),
    }
}

/// Variance of the signal that a sensor gives for the signal `y`, per channel (README of the recordings, section 5).
fn sensor_variance(photometry: &Photometry, y: DVec3) -> DVec3 {
    let gain = EXPOSURE.gain * DVec3::from_array(EXPOSURE.white_balance);
    let q = y / gain;
    let read = photometry.read_noise_e / photometry.full_well_e;
    gain * gain * (q / photometry.full_well_e + read * read)
}

/// Composites by hand.
struct Table {
    stage: Stage,
    camera: Camera,
    picture: PictureBuffers,
}

impl Table {
    fn new(gpu: Gpu) -> Self {
        let camera = noisy_camera();
        let stage = environment_stage(gpu);
        let picture = PictureBuffers::new(&stage.gpu, &camera);
        stage.gpu.write(
            &stage.camera,
            &[GpuCamera::new(&camera, &Pose::identity(), &EXPOSURE, [0.02, 20.0])],
        );
        Self { stage, camera, picture }
    }

    /// Codes, three per pixel, of frame `sequence`: `codes` with light `ratios` behind `over`.
    fn mixed(&mut self, sequence: u64, codes: &[u8], ratios: &[Vec4], over: &[Vec4]) -> Vec<u8> {
        let Self { stage, camera, picture } = self;
        let gpu = &stage.gpu;
        picture.upload(gpu, &support::frame_of(camera, sequence, codes.to_vec()));
        let write = |view: &wgpu::TextureView, texels: &[Vec4]| {
            support::write_texture(gpu, view.texture(), &halves(texels.iter().copied()));
        };
        write(stage.receive.ratio(), ratios);
        write(stage.shade.radiance(), over);
        let pass = Composite::new(gpu, &stage.camera, picture, (&stage.shade, &stage.receive), SIZE);
        pass.set_noise(gpu, &GpuNoise::new(&camera.photometry, &EXPOSURE, sequence));
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        pass.record(&mut encoder, &mut Timer::new(gpu));
        pass.codes().record(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        let rgba = pass.codes().read(gpu).expect("the device works");
        rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect()
    }

    /// Mean of (found - expected) / σ, and of its square, per channel: `codes` against the noise-free signals.
    fn judge(&self, codes: &[u8], signal_at: impl Fn(usize) -> DVec3) -> [DVec3; 2] {
        let response = &self.camera.photometry.response;
        let (mut mean, mut square) = (DVec3::ZERO, DVec3::ZERO);
        for (i, code) in codes.chunks_exact(3).enumerate() {
            let expected = signal_at(i);
            let found = DVec3::from_array([code[0], code[1], code[2]].map(|c| response.linear_from_code(c)));
            let rounding = DVec3::from_array(expected.to_array().map(|y| response.code_width(response.encode(y))));
            let variance = sensor_variance(&self.camera.photometry, expected) + rounding * rounding / 12.0;
            let off = found - expected;
            mean += off / DVec3::from_array(variance.to_array().map(f64::sqrt)) / N as f64;
            square += off * off / variance / N as f64;
        }
        [mean, square]
    }
}

/// Of [`N`] numbers with mean 0 and variance 1 the mean's σ is 0.0036 and that of the mean square 0.0051. The mean of what is
/// rounded on a curve is off by a hundredth of σ; a code's own width stands for its neighbours'.
fn assert_like_the_sensor(what: &str, [mean, square]: [DVec3; 2]) {
    assert!(mean.abs().max_element() < 3.0 * 0.0036 + 0.01, "{what}: mean {mean}");
    assert!(
        (square - 1.0).abs().max_element() < 3.0 * 0.0051 + 0.01,
        "{what}: {square}"
    );
}

#[test]
fn a_virtual_patch_has_the_noise_of_the_sensor() {
    let Some(gpu) = support::gpu() else { return };
    let mut table = Table::new(gpu);
    let (codes, ratios) = (vec![90; 3 * N], vec![Vec4::ONE; N]);
    // In the common RGB; the brightest is three quarters of full scale in red.
    for radiance in [
        Vec3::new(0.0625, 0.125, 0.09375),
        Vec3::new(0.5, 0.75, 0.5),
        Vec3::splat(1.5),
    ] {
        let over = vec![radiance.extend(1.0); N];
        let found = table.mixed(3, &codes, &ratios, &over);
        let camera = table.camera.clone();
        let stats = table.judge(&found, |i| {
            camera.photometry.color.inverse() * radiance.as_dvec3() * pixel_of(&camera, i).signal_per_radiance()
        });
        assert_like_the_sensor(&format!("virtual patch of {radiance}"), stats);
    }
}

#[test]
fn shaded_and_half_covered_pixels_have_the_noise_of_the_light_they_show() {
    let Some(gpu) = support::gpu() else { return };
    let mut table = Table::new(gpu);
    let camera = table.camera.clone();
    let photometry = &camera.photometry;
    // A picture of even light as the sensor would have taken it.
    let light = DVec3::new(1.25, 1.5, 1.25);
    let clean =
        |i: usize, light: DVec3| photometry.color.inverse() * light * pixel_of(&camera, i).signal_per_radiance();
    let codes: Vec<u8> = (0..N)
        .flat_map(|i| {
            let y = clean(i, light);
            let sigma = DVec3::from_array(sensor_variance(photometry, y).to_array().map(f64::sqrt));
            let noisy = y + sigma * reference::noise::normals([i as u32 % 320, i as u32 / 320], 1 << 20);
            noisy.to_array().map(|y| photometry.response.encode(y))
        })
        .collect();
    assert_like_the_sensor("the picture itself", table.judge(&codes, |i| clean(i, light)));
    for (ratio, covered, radiance) in [
        (Vec3::splat(0.5), 0.0, Vec3::ZERO),
        (Vec3::new(0.25, 0.5, 0.75), 0.0, Vec3::ZERO),
        (Vec3::ONE, 0.5, Vec3::splat(0.5)),
        (Vec3::splat(0.75), 0.25, Vec3::splat(2.0)),
    ] {
        let over = vec![(radiance * covered).extend(covered); N];
        let found = table.mixed(4, &codes, &vec![ratio.extend(1.0); N], &over);
        let mixed = light * ratio.as_dvec3() * f64::from(1.0 - covered) + (radiance * covered).as_dvec3();
        assert_like_the_sensor(
            &format!("light times {ratio}, {covered} covered"),
            table.judge(&found, |i| clean(i, mixed)),
        );
    }
}

#[test]
fn noise_equals_its_twin_comes_back_and_leaves_the_rest_alone() {
    let Some(gpu) = support::gpu() else { return };
    let mut table = Table::new(gpu);
    let codes: Vec<u8> = (0..3 * N).map(|i| (spread(i, 0.4) * 256.0) as u8).collect();
    let value = |i: usize, offset: f64| spread(i, offset) as f32;
    let rounded = |v: Vec4| Vec4::from_array(v.to_array().map(|x| half::f16::from_f32(x).to_f32()));
    let ratios: Vec<Vec4> = (0..N)
        .map(|i| match i % 4 {
            0 => Vec4::ZERO,
            1 => Vec4::ONE,
            _ => rounded(Vec4::new(2.0 * value(i, 0.1), 2.0 * value(i, 0.2), value(i, 0.5), 1.0)),
        })
        .collect();
    let over: Vec<Vec4> = (0..N)
        .map(|i| {
            let coverage = if i % 4 == 3 { [0.25, 0.5, 1.0][i % 12 / 4] } else { 0.0 };
            rounded((Vec3::new(value(i, 0.7), value(i, 0.8), value(i, 0.9)) * 2.0 * coverage).extend(coverage))
        })
        .collect();
    let found = table.mixed(8, &codes, &ratios, &over);
    assert_eq!(table.mixed(8, &codes, &ratios, &over), found, "the same frame twice");
    let later = table.mixed(9, &codes, &ratios, &over);
    let mut errors = Vec::new();
    let mut moved = 0;
    for i in 0..N {
        let [code, found, later] = [&codes, &found, &later].map(|of| [of[3 * i], of[3 * i + 1], of[3 * i + 2]]);
        if i % 4 < 2 {
            assert_eq!([found, later], [code, code], "pixel {i} has nothing to change it");
            continue;
        }
        moved += usize::from(later != found);
        let of = pixel_of(&table.camera, i);
        let expected = reference::noise::pixel(&of, 8, (code, ratios[i].truncate(), over[i]));
        errors.extend((0..3).map(|c| f32::from(found[c]) - f32::from(expected[c])));
    }
    assert!(moved > N / 4, "the next frame's noise is another: {moved} pixels");
    let errors = Errors::of("noise, codes", errors);
    // As for the composite without noise: the table rounds elsewhere than the formula.
    assert!(errors.worst <= 1.0 && errors.mean < 0.01, "{errors:?}");
}

/// The picture after the pass.
fn blurred(gpu: &Gpu, picture: &[Vec4], size_px: [u32; 2], covariance_px2: Option<DMat2>) -> Vec<Vec4> {
    let texture = gpu.texture("test: picture", TextureShape::plain(size_px), RADIANCE_FORMAT);
    support::write_texture(gpu, &texture, &halves(picture.iter().copied()));
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    let mut pass = LookBlur::new(gpu, &[&view], size_px);
    pass.set(gpu, covariance_px2);
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    pass.record(&mut encoder, &mut Timer::new(gpu));
    gpu.queue.submit([encoder.finish()]);
    support::read_layer::<[half::f16; 4]>(gpu, &texture, 0, 0)
        .into_iter()
        .map(|t| Vec4::from_array(t.map(half::f16::to_f32)))
        .collect()
}

#[test]
fn blur_equals_its_twin_keeps_energy_and_leaves_what_is_flat_alone() {
    let Some(gpu) = support::gpu() else { return };
    let size_px = [96, 64];
    let is_object = |i: usize| (40..56).contains(&(i % 96)) && (24..40).contains(&(i / 96));
    let picture: Vec<Vec4> = (0..96 * 64)
        .map(|i| {
            let radiance = Vec3::new(spread(i, 0.1) as f32, spread(i, 0.2) as f32, 0.7);
            if is_object(i) { radiance.extend(1.0) } else { Vec4::ZERO }
        })
        .map(|v| Vec4::from_array(v.to_array().map(|x| half::f16::from_f32(x).to_f32())))
        .collect();
    for (eigenvalues, degrees) in [
        ([0.1, 0.1], 0.0),
        ([1.0, 0.3], 30.0),
        ([6.0, 0.2], 117.0),
        ([9.0, 9.0], 0.0),
    ] {
        let covariance = from_eigen(eigenvalues, DVec2::from_angle(f64::to_radians(degrees)));
        let found = blurred(&gpu, &picture, size_px, Some(covariance));
        let expected = reference::look_blur::blurred(&picture, size_px, &kernel::lines(covariance));
        let off = found.iter().zip(&expected).map(|(a, b)| (*a - *b).abs().max_element());
        let errors = Errors::of(&format!("blur of {eigenvalues:?}"), off);
        // Three stores as half floats, which may round either way: 2^-11 each.
        assert!(errors.worst < 1.5e-3, "{errors:?}");
        let [before, after] = [&picture, &found].map(|of| of.iter().sum::<Vec4>());
        // The same roundings, all in one direction.
        assert!(
            (after / before - 1.0).abs().max_element() < 1.5e-3,
            "{before} became {after}"
        );
        let reach = 4.0 * eigenvalues[0].sqrt() + 8.0;
        for (i, texel) in found.iter().enumerate() {
            let to_object = IVec2::new((i % 96) as i32 - 48, (i / 96) as i32 - 32).abs() - 8;
            if f64::from(to_object.max_element()) > 2.0 * reach {
                assert_eq!(*texel, Vec4::ZERO, "{i} is far from the object");
            }
        }
    }
    assert_eq!(blurred(&gpu, &picture, size_px, None), picture, "no blur");
    let flat = vec![Vec4::new(0.3, 0.7, 1.0, 1.0); 96 * 64];
    let held = blurred(&gpu, &flat, size_px, Some(DMat2::IDENTITY));
    assert!(held.iter().all(|texel| *texel == held[0]) && (held[0] - flat[0]).abs().max_element() < 5e-4);
}

#[test]
fn the_blur_of_a_step_is_gaussian() {
    let Some(gpu) = support::gpu() else { return };
    let size_px = [64, 32];
    // White from column 32 on: the edge lies half a pixel before it.
    let picture: Vec<Vec4> = (0..64 * 32)
        .map(|i| Vec4::splat(if i % 64 >= 32 { 1.0 } else { 0.0 }))
        .collect();
    for variance in [0.5f64, 1.0, 4.0] {
        let found = blurred(&gpu, &picture, size_px, Some(variance * DMat2::IDENTITY));
        let row = &found[16 * 64..17 * 64];
        // The mean and the variance of the step's derivative.
        let steps = (1..64).map(|x| (x as f64 - 0.5, f64::from(row[x].x - row[x - 1].x)));
        let mean: f64 = steps.clone().map(|(x, d)| x * d).sum();
        let spread: f64 = steps.map(|(x, d)| (x - mean).powi(2) * d).sum();
        assert!((mean - 31.5).abs() < 0.01, "the edge moved to {mean}");
        // Half floats of the step's bright end.
        assert!((spread / variance - 1.0).abs() < 0.02, "{spread} instead of {variance}");
    }
}

// ---- sharpness -------------------------------------------------------------------------------------------------------

/// Where the camera of the marker pictures is.
const EYE: DVec3 = DVec3::new(0.05, -0.30, 0.34);

/// Radiance of the sky, the same in every direction and channel.
const SKY: f64 = 3.0;

fn camera_from_world() -> Pose {
    support::looking_at(DVec3::new(0.03, 0.0, 0.0), EYE)
}

/// The rig of the tests with its second marker turned, so that edges have four directions, and a noisy sensor.
fn turned_rig() -> Rig {
    let mut rig = support::rig();
    rig.markers[1].world_from_marker.rotation = DMat3::from_rotation_z(35f64.to_radians());
    for camera in &mut rig.cameras {
        camera.photometry.read_noise_e = 6.0;
    }
    rig
}

/// The markers on the ground under the sky, blurred by `covariance_px2` in linear light before the pixels are taken; noisy.
fn blurred_frame(rig: &Rig, covariance_px2: DMat2) -> Frame {
    /// Points per pixel.
    const POINTS: usize = 64;
    let camera = rig.scene_camera();
    let world_from_camera = camera_from_world().inverse();
    let ([along, across], direction) = kernel::eigen(covariance_px2);
    let [along, across] = [along, across].map(|v| v.max(0.0).sqrt());
    let photometry = &camera.photometry;
    let per_radiance = DVec3::from_array(photometry.signal_per_radiance(&support::EXPOSURE));
    let mut pixels = Vec::with_capacity(3 * N);
    for index in 0..N {
        let middle = place(index);
        let mut light = 0.0;
        for i in 0..POINTS {
            // A lattice over pixel and Gaussian, another one for every pixel.
            let shift = spread(index, 0.0);
            let at = |step: f64| (shift + (i as f64 + 0.5) * step).fract();
            let in_pixel = DVec2::new((i as f64 + 0.5) / POINTS as f64, at(0.618_033_988_7)) - 0.5;
            let radius = (-2.0 * (1.0 - at(0.414_213_562_4)).max(1e-9).ln()).sqrt();
            let angle = std::f64::consts::TAU * at(0.732_050_807_6);
            let gauss = radius * DVec2::from_angle(angle);
            let offset = direction * (along * gauss.x) + direction.perp() * (across * gauss.y);
            let ray = camera.intrinsics.unproject(middle + in_pixel + offset);
            let world = ray.map(|ray| world_from_camera.transform_vector(ray));
            light += world.map_or(0.0, |d| support::ground_reflectance(rig, EYE - d * (EYE.z / d.z))) / POINTS as f64;
        }
        let vignetting = photometry.vignetting_at(middle, camera.intrinsics.size_px);
        let y = photometry.color.inverse() * DVec3::splat(SKY * light) * per_radiance * vignetting;
        let read = photometry.read_noise_e / photometry.full_well_e;
        let sigma = y.to_array().map(|y| (y / photometry.full_well_e + read * read).sqrt());
        let noisy = y + DVec3::from_array(sigma) * reference::noise::normals([index as u32, 5], 77);
        pixels.extend(noisy.to_array().map(|y| photometry.response.encode(y)));
    }
    support::frame_of(camera, 7, pixels)
}

#[test]
fn the_sharpness_of_a_picture_comes_back() {
    let rig = turned_rig();
    for (eigenvalues, degrees) in [
        ([0.0, 0.0], 0.0),
        ([0.3, 0.3], 0.0),
        ([1.0, 1.0], 0.0),
        ([1.5, 0.1], 0.0),
        ([1.2, 0.3], 60.0),
        ([1.2, 0.3], 135.0),
    ] {
        let asked = from_eigen(eigenvalues, DVec2::from_angle(f64::to_radians(degrees)));
        let frame = blurred_frame(&rig, asked);
        let found = measure(&frame, rig.scene_camera(), &rig.markers, &camera_from_world()).expect("edges are seen");
        let off = (found.covariance_px2 - asked)
            .to_cols_array()
            .iter()
            .fold(0.0f64, |w, d| w.max(d.abs()));
        println!(
            "{eigenvalues:?} at {degrees}°: {:.3}, off {off:.3}, σ {:.3}",
            found.covariance_px2, found.sigma_px2
        );
        assert!(
            off < 0.1 * eigenvalues[0] + 0.02,
            "{} instead of {asked}",
            found.covariance_px2
        );
    }
}

#[test]
fn a_picture_without_markers_tells_no_sharpness() {
    let rig = turned_rig();
    let flat = support::frame_of(rig.scene_camera(), 1, vec![120; 3 * N]);
    assert_eq!(
        measure(&flat, rig.scene_camera(), &rig.markers, &camera_from_world()),
        None
    );
    let overexposed = support::frame_of(rig.scene_camera(), 1, vec![255; 3 * N]);
    assert_eq!(
        measure(&overexposed, rig.scene_camera(), &rig.markers, &camera_from_world()),
        None
    );
    let sharp = blurred_frame(&rig, DMat2::ZERO);
    assert_eq!(measure(&sharp, rig.scene_camera(), &[], &camera_from_world()), None);
}

/// A dark virtual plate beside the markers, with edges like a marker's.
fn plate(rig: &Rig) -> (Marker, mirrorball_render::scene::Scene) {
    let side_m = 0.07;
    let mut marker = rig.markers[0];
    marker.side_m = side_m;
    marker.world_from_marker.translation = DVec3::new(-0.11, 0.02, 0.001);
    let half = Vec3::splat(0.5 * side_m as f32);
    let mut mesh = support::square(Vec3::new(-0.11, 0.02, 0.001), Vec3::X * half, Vec3::Y * half);
    mesh.materials = vec![support::diffuse(0.03)];
    (marker, support::scene([("plate", Kind::Virtual, mesh)]))
}

#[test]
fn a_virtual_edge_is_as_blurred_as_the_markers_beside_it() {
    let rig = turned_rig();
    let (edges, scene) = plate(&rig);
    for (eigenvalues, sharpness) in [
        ([0.0, 0.0], config::Sharpness::Measured),
        ([0.8, 0.8], config::Sharpness::Measured),
        ([1.5, 0.4], config::Sharpness::Measured),
        ([0.8, 0.8], config::Sharpness::Off),
    ] {
        let Some(gpu) = support::gpu() else { return };
        let asked = from_eigen(eigenvalues, DVec2::X);
        let mut config = RenderConfig::default();
        config.probe.room_distance_m = 50.0;
        config.probe.cube_size = 64;
        config.probe.scene_camera = SceneCamera::Ignored;
        config.look.sharpness = sharpness;
        let probe = support::frame(rig.probe_camera().unwrap(), 7, 1, |_| DVec3::splat(SKY));
        let mut node = RenderNode::new(gpu, rig.clone(), &scene, config).unwrap();
        let rendered = node
            .render(&FrameSet {
                frames: vec![blurred_frame(&rig, asked), probe],
            })
            .unwrap();
        let pose = *rendered.pose.camera_from_world().expect("the markers are found");
        let codes = rendered.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        let finished = support::frame_of(rig.scene_camera(), 7, codes);
        let found = measure(&finished, rig.scene_camera(), &[edges], &pose).expect("the plate's edges are seen");
        println!(
            "{eigenvalues:?}, {sharpness:?}: the virtual edges have {:.3}",
            found.covariance_px2
        );
        let expected = match sharpness {
            config::Sharpness::Measured => asked,
            config::Sharpness::Off => DMat2::ZERO,
        };
        let off = [DVec2::X, DVec2::Y].map(|n| n.dot((found.covariance_px2 - expected) * n).abs());
        // A tenth for the measurement on the markers, as much for that on the plate.
        assert!(
            off[0].max(off[1]) < 0.15 * eigenvalues[0] + 0.05,
            "{} instead of {expected}",
            found.covariance_px2
        );
    }
}
