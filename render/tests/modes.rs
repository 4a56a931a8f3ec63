//! Modes through the render node: two eyes, displays without a camera picture, buffers drawn into the picture.

mod support;

use std::f32::consts::PI;

use glam::{DVec2, DVec3, Vec3, Vec4};
use mirrorball_calib::camera::LensModel;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Rig;
use mirrorball_capture::frame::{Frame, FrameSet};
use mirrorball_render::camera_view::CameraView;
use mirrorball_render::config::{BackdropName, ModeConfig, PhantomsInVr, RenderConfig, SceneCamera};
use mirrorball_render::eye_view::{EyeView, pinhole};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::GpuCamera;
use mirrorball_render::insets::{Buffer, Insets};
use mirrorball_render::mode::Mode;
use mirrorball_render::node::{RenderNode, RenderedFrame};
use mirrorball_render::passes::direct::ShadowedLight;
use mirrorball_render::passes::display::{self, Display};
use mirrorball_render::passes::real_radiance::RealRadiance;
use mirrorball_render::passes::reproject::room_buffer;
use mirrorball_render::reference;
use mirrorball_render::reference::display::srgb;
use mirrorball_render::scene::{Carrier, Kind, Lamp, LampKind, Scene};
use mirrorball_render::scene_gpu::SceneBuffers;
use support::stage::environment_stage;
use support::{EXPOSURE, Errors, halves, spread};

/// Radiance of the sky, the same in every direction and channel.
const SKY: f64 = 3.0;
/// Signal per unit of radiance of green at [`EXPOSURE`].
const SIGNAL: f32 = 0.2;
const FROM: DVec3 = DVec3::new(0.05, -0.30, 0.34);
const TOWARDS: DVec3 = DVec3::new(0.03, 0.0, 0.0);
const SPHERE_M: Vec3 = Vec3::new(0.03, 0.02, 0.06);
const RADIUS_M: f32 = 0.03;

/// The rig of the tests with a scene camera that is a pinhole without vignetting, as eyes are.
fn pinhole_rig() -> Rig {
    let mut rig = support::rig();
    let camera = rig
        .cameras
        .iter_mut()
        .find(|camera| camera.name == "scene")
        .expect("it has a scene camera");
    camera.photometry.vignetting = [0.0; 2];
    camera.intrinsics.lens = LensModel::BrownConrady {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    };
    rig
}

fn config(mode: Mode) -> RenderConfig {
    let mut config = RenderConfig::default();
    config.probe.room_distance_m = 50.0;
    config.probe.cube_size = 64;
    config.probe.scene_camera = SceneCamera::Ignored;
    config.mode.name = mode;
    config
}

/// The markers on the ground under the sky.
fn ground_frame(rig: &Rig) -> Frame {
    let world_from_camera = support::looking_at(TOWARDS, FROM).inverse();
    support::frame(rig.scene_camera(), 7, 3, |ray| {
        let direction = world_from_camera.transform_vector(ray);
        let ground = FROM - direction * (FROM.z / direction.z);
        let reflectance = if direction.z < 0.0 {
            support::ground_reflectance(rig, ground)
        } else {
            1.0
        };
        DVec3::splat(SKY * reflectance)
    })
}

/// A picture in which no marker is, brighter to the right.
fn plain_frame(rig: &Rig) -> Frame {
    support::frame(rig.scene_camera(), 7, 1, |ray| DVec3::splat(1.0 + ray.x))
}

fn render_with(node: &mut RenderNode, rig: &Rig, frame: Frame) -> RenderedFrame {
    let probe = support::frame(rig.probe_camera().expect("it has a probe camera"), 7, 1, |_| {
        DVec3::splat(SKY)
    });
    node.render(&FrameSet {
        frames: vec![frame, probe],
    })
    .expect("the frames fit the rig")
}

fn render(gpu: Gpu, scene: &Scene, config: RenderConfig) -> RenderedFrame {
    let rig = pinhole_rig();
    let mut node = RenderNode::new(gpu, rig.clone(), scene, config).expect("the rig has a probe");
    render_with(&mut node, &rig, ground_frame(&rig))
}

fn sphere_over_ground(albedo: f32) -> Scene {
    let sphere = support::sphere(SPHERE_M, RADIUS_M, 24, support::diffuse(albedo));
    support::scene([
        ("ground", Kind::Phantom, support::square(Vec3::ZERO, Vec3::X, Vec3::Y)),
        ("sphere", Kind::Virtual, sphere),
    ])
}

/// The codes of one of two pictures side by side.
fn half(rendered: &RenderedFrame, index: usize) -> Vec<u8> {
    let row = 4 * rendered.size_px[0] as usize;
    rendered
        .rgba
        .chunks_exact(row)
        .flat_map(|line| line[index * row / 2..(index + 1) * row / 2].to_vec())
        .collect()
}

fn differences<'a>(found: &'a [u8], expected: &'a [u8]) -> impl Iterator<Item = f32> + 'a {
    assert_eq!(found.len(), expected.len());
    found.iter().zip(expected).map(|(a, b)| f32::from(*a) - f32::from(*b))
}

// ---- stereo ----------------------------------------------------------------------------------------------------------

/// The camera's and an eye's views of a scene, drawn.
struct Views {
    gpu: Gpu,
    rig: Rig,
    seen: CameraView,
    eye: EyeView,
    codes: Vec<u8>,
    poses: [Pose; 2],
}

impl Views {
    const ROOM_M: f32 = 3.0;

    /// A picture of noise through a lens with distortion and vignetting, and an eye 6 cm to the right.
    fn drawn(gpu: Gpu, config: &ModeConfig) -> Self {
        let rig = support::rig();
        let camera = rig.scene_camera();
        let scene = support::scene([
            (
                "ground",
                Kind::Phantom,
                support::square(Vec3::ZERO, Vec3::X * 0.2, Vec3::Y * 0.15),
            ),
            (
                "ball",
                Kind::Phantom,
                support::sphere(SPHERE_M, RADIUS_M, 24, support::diffuse(0.5)),
            ),
        ]);
        let buffers = SceneBuffers::new(&gpu, &scene, &rig).expect("the test scene fits");
        let mut seen = CameraView::new(&gpu, camera, &buffers);
        let room = room_buffer(&gpu, Self::ROOM_M);
        let eye = EyeView::new(&gpu, (&seen, &room), &buffers, (config, config.right_eye_m));
        let [width, height] = camera.intrinsics.size_px;
        let codes: Vec<u8> = (0..3 * (width * height) as usize)
            .map(|i| (spread(i, 0.4) * 256.0) as u8)
            .collect();
        seen.picture.upload(&gpu, &support::frame_of(camera, 1, codes.clone()));
        let camera_from_world = support::looking_at(TOWARDS, FROM);
        let poses = [camera_from_world, eye.eye_from_camera * camera_from_world];
        for (view, pose) in [&seen, &eye.view].into_iter().zip(&poses) {
            gpu.write(
                &view.camera,
                &[GpuCamera::new(&view.model, pose, &EXPOSURE, [0.02, 20.0])],
            );
        }
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut timer = Timer::new(&gpu);
        seen.phantoms
            .record(&mut encoder, &mut timer, (&buffers, &buffers.phantoms));
        eye.record(&mut encoder, &mut timer, &buffers);
        gpu.queue.submit([encoder.finish()]);
        Self {
            gpu,
            rig,
            seen,
            eye,
            codes,
            poses,
        }
    }

    fn places(&self, view: &CameraView) -> Vec<Vec4> {
        support::read_layer(&self.gpu, view.phantoms.views().place.texture(), 0, 0)
    }
}

#[test]
fn reproject_equals_its_twin() {
    let Some(gpu) = support::gpu() else { return };
    let config = ModeConfig {
        name: Mode::Stereo,
        right_eye_m: [0.06, 0.0, 0.0],
        eye_size_px: Some([200, 180]),
        field_of_view_deg: Some(70.0),
        ..ModeConfig::default()
    };
    let views = Views::drawn(gpu, &config);
    let places = [&views.seen, &views.eye.view].map(|view| views.places(view));
    let picture = reference::reproject::CameraPicture {
        camera: views.rig.scene_camera(),
        camera_from_world: views.poses[0],
        codes: &views.codes,
        places: &places[0],
    };
    let viewer = reference::reproject::Viewer {
        eye: &views.eye.view.model,
        eye_from_world: views.poses[1],
        room_m: (DVec3::ZERO, f64::from(Views::ROOM_M)),
    };
    let found: Vec<[u8; 4]> = support::read_layer(&views.gpu, views.eye.view.picture.view.texture(), 0, 0);
    let (mut errors, mut n_black) = (Vec::new(), 0);
    for (i, (found, place)) in found.iter().zip(&places[1]).enumerate() {
        let pixel = DVec2::new((i % 200) as f64, (i / 200) as f64);
        let expected = reference::reproject::pixel(&picture, &viewer, pixel, *place);
        n_black += usize::from(expected == [0; 3]);
        errors.extend((0..3).map(|c| f32::from(found[c]) - f32::from(expected[c])));
    }
    let n_off = errors.iter().filter(|error| error.abs() > 2.0).count();
    let errors = Errors::of("reproject, codes", errors);
    println!("reproject: {n_off} codes more than 2 off, {n_black} pixels out of the picture");
    // Neighbours differ by up to 255 codes, so single precision in the place (1e-4 pixels) is a code at most; where a pixel
    // is a hair's breadth from being hidden the two may decide otherwise.
    assert!(errors.mean < 0.2 && n_off * 500 < errors.n, "{errors:?}, {n_off}");
    assert!(n_black > 1000, "the eye sees more than the camera: {n_black}");
}

#[test]
fn an_eye_where_the_camera_is_sees_what_the_camera_sees() {
    let Some(gpu) = support::gpu() else { return };
    let scene = sphere_over_ground(0.8);
    let mono = render(gpu, &scene, config(Mode::SeeThrough));
    let Some(gpu) = support::gpu() else { return };
    let mut config = config(Mode::Stereo);
    config.mode.left_eye_m = [0.0; 3];
    config.mode.right_eye_m = [0.0; 3];
    let stereo = render(gpu, &scene, config);
    assert_eq!(stereo.mode, Mode::Stereo);
    assert_eq!(stereo.size_px, [2 * mono.size_px[0], mono.size_px[1]]);
    for index in [0, 1] {
        let errors = Errors::of(
            "eye at the camera, codes",
            differences(&half(&stereo, index), &mono.rgba),
        );
        // Places in single precision move the picture by 1e-4 of a pixel.
        assert!(errors.mean < 0.01 && errors.worst <= 2.0, "{errors:?}");
    }
}

/// Mean place of the pixels that are not black, in pixels.
fn centroid(rgba: &[u8], width: usize) -> DVec2 {
    let lit = rgba.chunks_exact(4).enumerate().filter(|(_, p)| p[1] > 0);
    let (mut sum, mut n) = (DVec2::ZERO, 0.0);
    for (i, _) in lit {
        sum += DVec2::new((i % width) as f64, (i / width) as f64);
        n += 1.0;
    }
    assert!(n > 500.0, "{n} pixels are lit");
    sum / n
}

#[test]
fn the_disparity_is_that_of_the_eyes_distance() {
    let Some(gpu) = support::gpu() else { return };
    let sphere = support::sphere(SPHERE_M, RADIUS_M, 24, support::diffuse(0.8));
    let mut config = config(Mode::OpticalStereo);
    config.mode.left_eye_m = [-0.02, 0.0, 0.0];
    config.mode.right_eye_m = [0.04, 0.0, 0.0];
    let rendered = render(gpu, &support::scene([("sphere", Kind::Virtual, sphere)]), config);
    let width = rendered.size_px[0] as usize / 2;
    let [left, right] = [0, 1].map(|index| centroid(&half(&rendered, index), width));
    let depth_m = support::looking_at(TOWARDS, FROM)
        .transform_point(SPHERE_M.as_dvec3())
        .z;
    let focal_px = pinhole(pinhole_rig().scene_camera(), &config.mode)
        .intrinsics
        .focal_px
        .x;
    let expected_px = focal_px * 0.06 / depth_m;
    let found_px = left.x - right.x;
    println!("disparity: {found_px:.3} px of {expected_px:.3}");
    // The outline of a sphere off the axis is an ellipse around a point a little off the centre's image: 1 %.
    assert!(
        (found_px / expected_px - 1.0).abs() < 0.015,
        "{found_px} of {expected_px}"
    );
    assert!((left.y - right.y).abs() < 0.2, "{left} and {right}");
}

// ---- displays without a camera picture -------------------------------------------------------------------------------

#[test]
fn a_display_that_one_looks_through_shows_no_shadow() {
    let Some(gpu) = support::gpu() else { return };
    // Nothing comes back from a black sphere: it only takes light away.
    let scene = sphere_over_ground(0.0);
    let picture = render(gpu, &scene, config(Mode::SeeThrough));
    let frame = ground_frame(&pinhole_rig());
    let darkened = picture.rgba.chunks_exact(4).zip(frame.pixels.chunks_exact(3));
    let n_darkened = darkened.filter(|(a, b)| a[1] < b[1]).count();
    assert!(n_darkened > 2000, "{n_darkened} pixels are darker");
    let Some(gpu) = support::gpu() else { return };
    let optical = render(gpu, &scene, config(Mode::Optical));
    assert_eq!(optical.size_px, picture.size_px);
    let n_lit = optical.rgba.chunks_exact(4).filter(|p| p[..3] != [0, 0, 0]).count();
    assert_eq!(n_lit, 0, "black everywhere, bit for bit");
}

#[test]
fn a_display_that_one_looks_through_shows_virtual_objects_and_black() {
    let Some(gpu) = support::gpu() else { return };
    let sphere = support::sphere(SPHERE_M, RADIUS_M, 24, support::diffuse(0.8));
    let optical = render(
        gpu,
        &support::scene([("sphere", Kind::Virtual, sphere)]),
        config(Mode::Optical),
    );
    let rig = pinhole_rig();
    let world_from_camera = support::looking_at(TOWARDS, FROM).inverse();
    let expected = srgb(Vec3::splat(SIGNAL * 0.8 * SKY as f32));
    let (mut errors, mut n_outside) = (Vec::new(), 0);
    for (i, pixel) in optical.rgba.chunks_exact(4).enumerate() {
        let at = DVec2::new((i % 320) as f64, (i / 320) as f64);
        let ray = world_from_camera.transform_vector(rig.scene_camera().intrinsics.unproject(at).unwrap());
        let to_center = SPHERE_M.as_dvec3() - FROM;
        let off_m = (to_center - ray * to_center.dot(ray)).length() as f32;
        if off_m > 1.05 * RADIUS_M {
            n_outside += 1;
            assert_eq!(pixel, [0, 0, 0, 255], "pixel {at} is outside");
        } else if off_m < 0.9 * RADIUS_M {
            errors.extend((0..3).map(|c| f32::from(pixel[c]) - f32::from(expected[c])));
        }
    }
    let errors = Errors::of("sphere on a display, codes", errors);
    assert!(n_outside > 50_000, "{n_outside}");
    // 4 % of the light (see frames.rs) are 1.7 % of the code.
    assert!(errors.mean < 2.0 && errors.worst < 6.0, "{errors:?}");
}

#[test]
fn a_display_that_one_looks_through_adds_light_and_takes_none_away() {
    let Some(gpu) = support::gpu() else { return };
    let rig = support::rig();
    let stage = environment_stage(gpu);
    let gpu = &stage.gpu;
    let view = CameraView::new(gpu, rig.scene_camera(), &stage.buffers);
    gpu.write(
        &view.camera,
        &[GpuCamera::new(&view.model, &Pose::identity(), &EXPOSURE, [0.02, 20.0])],
    );
    let n = 320 * 240;
    let value = |i: usize, offset: f64| spread(i, offset) as f32;
    let reals = halves((0..n).map(|i| Vec4::new(value(i, 0.1), value(i, 0.3), value(i, 0.6), 1.0) * 4.0));
    let ratios = halves((0..n).map(|i| match i % 3 {
        0 => Vec4::ZERO,
        _ => Vec4::new(2.0 * value(i, 0.2), 2.0 * value(i, 0.5), 1.0, 1.0),
    }));
    let overs = halves((0..n).map(|i| match i % 4 {
        0 => Vec4::new(0.5, 0.25, 1.0, 0.5),
        _ => Vec4::ZERO,
    }));
    let real = RealRadiance::new(gpu, &view, [stage.receive.ratio(), stage.receive.added()]);
    support::write_texture(gpu, real.radiance().texture(), &reals);
    support::write_texture(gpu, stage.receive.ratio().texture(), &ratios);
    support::write_texture(gpu, stage.shade.radiance().texture(), &overs);
    let light = ShadowedLight::new(gpu, view.phantoms.views());
    let black = stage.environments.specular.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::Cube),
        array_layer_count: Some(6),
        ..wgpu::TextureViewDescriptor::default()
    });
    let inputs = display::Inputs {
        camera: &view.camera,
        shade: &stage.shade,
        receive: &stage.receive,
        real: &real,
        light: &light,
        probe_radiance: &black,
    };
    let mode = config(Mode::Optical).mode;
    let pass = Display::new(gpu, inputs, (&mode, [320, 240]));
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    pass.record(&mut encoder, &mut Timer::new(gpu));
    pass.codes().record(&mut encoder);
    gpu.queue.submit([encoder.finish()]);
    let rgba = pass.codes().read(gpu).unwrap();
    let vector = |texel: [half::f16; 4]| Vec4::from_array(texel.map(half::f16::to_f32));
    let mut n_added = 0;
    let errors = Errors::of(
        "display, codes",
        (0..n).flat_map(|i| {
            let (real, ratio, over) = (vector(reals[i]), vector(ratios[i]), vector(overs[i]));
            let ratio = if ratio.w > 0.0 { ratio.truncate() } else { Vec3::ONE };
            let expected = reference::display::looked_through(real.truncate(), ratio, over, SIGNAL);
            n_added += usize::from(over.w == 0.0 && expected != [0; 3]);
            let found = &rgba[4 * i..4 * i + 3];
            [0, 1, 2].map(|c| f32::from(found[c]) - f32::from(expected[c]))
        }),
    );
    assert!(n_added > 10_000, "{n_added} pixels get light");
    assert!(errors.worst <= 1.0 && errors.mean < 0.01, "{errors:?}");
}

#[test]
fn vr_shows_virtual_objects_before_a_colour_or_the_light() {
    // Without a phantom below, the sky goes on there.
    let sphere = support::sphere(SPHERE_M, RADIUS_M, 24, support::diffuse(0.8));
    let scene = support::scene([("sphere", Kind::Virtual, sphere)]);
    let colour = Vec3::new(0.1, 0.3, 0.02);
    for (backdrop, expected) in [
        (BackdropName::Colour, srgb(colour)),
        (BackdropName::Environment, srgb(Vec3::splat(SIGNAL * SKY as f32))),
    ] {
        let Some(gpu) = support::gpu() else { return };
        let mut config = config(Mode::Vr);
        config.mode.backdrop = backdrop;
        config.mode.background = colour.to_array();
        let rendered = render(gpu, &scene, config);
        // The upper left corner is far from the sphere.
        let corner = (0..40).flat_map(|y| (0..40).map(move |x| (y, x)));
        let errors = Errors::of(
            &format!("backdrop {backdrop:?}, codes"),
            corner.flat_map(|(y, x)| {
                let pixel = &rendered.rgba[4 * (y * 320 + x)..][..3];
                [0, 1, 2].map(|c| f32::from(pixel[c]) - f32::from(expected[c]))
            }),
        );
        assert!(errors.worst <= 2.0, "{errors:?}");
    }
}

#[test]
fn vr_shows_phantoms_in_grey_with_the_shadows_of_virtual_objects() {
    let Some(gpu) = support::gpu() else { return };
    let mut config = config(Mode::Vr);
    config.mode.phantoms = PhantomsInVr::Grey;
    config.mode.background = [0.0, 0.0, 1.0];
    config.mode.backdrop = BackdropName::Colour;
    let rendered = render(gpu, &sphere_over_ground(0.8), config);
    let irradiance = PI * SKY as f32;
    let unshaded = srgb(Vec3::splat(SIGNAL * 0.5 * irradiance / PI));
    let codes: Vec<f32> = rendered.rgba.chunks_exact(4).map(|p| f32::from(p[1])).collect();
    let near_corner = codes[..40].iter().copied();
    let errors = Errors::of("grey ground, codes", near_corner.map(|c| c - f32::from(unshaded[1])));
    assert!(errors.worst < 5.0, "{errors:?}");
    // Below the sphere a quarter of the sky's light is gone, 11 % of the code.
    let n_shaded = codes.iter().filter(|&&c| c < 0.95 * f32::from(unshaded[1])).count();
    assert!(n_shaded > 300, "{n_shaded} pixels are in the sphere's shadow");
}

#[test]
fn without_a_pose_every_mode_shows_what_it_can() {
    let rig = pinhole_rig();
    let frame = plain_frame(&rig);
    let camera: Vec<u8> = frame
        .pixels
        .chunks_exact(3)
        .flat_map(|p| [p[0], p[1], p[2], 255])
        .collect();
    let mut scene = sphere_over_ground(0.8);
    scene.lamps.push(Lamp {
        name: "lamp".into(),
        kind: LampKind::Point { radius_m: 0.0 },
        irradiance: Vec3::splat(0.5),
        carrier: Carrier::World,
        position_m: Vec3::new(0.0, 0.0, 0.2),
        direction: Vec3::NEG_Z,
        across: Vec3::X,
    });
    for mode in Mode::ALL {
        let Some(gpu) = support::gpu() else { return };
        let mut config = config(mode);
        (config.mode.left_eye_m, config.mode.right_eye_m) = ([0.0; 3], [0.0; 3]);
        (config.mode.backdrop, config.mode.background) = (BackdropName::Colour, [1.0, 0.0, 0.0]);
        let mut node = RenderNode::new(gpu, rig.clone(), &scene, config).unwrap();
        // A frame with objects and light of a lamp first: nothing of it may stay.
        render_with(&mut node, &rig, ground_frame(&rig));
        let rendered = render_with(&mut node, &rig, frame.clone());
        assert!(rendered.pose.camera_from_world().is_none());
        assert_eq!(rendered.size_px, node.size_px());
        match mode {
            Mode::SeeThrough => assert_eq!(rendered.rgba, camera),
            Mode::Stereo => {
                for index in [0, 1] {
                    let errors = Errors::of("picture in an eye", differences(&half(&rendered, index), &camera));
                    assert!(errors.worst <= 1.0, "{errors:?}");
                }
            }
            Mode::Vr | Mode::VrStereo => {
                assert!(rendered.rgba.chunks_exact(4).all(|p| p == [255, 0, 0, 255]), "{mode}");
            }
            Mode::Optical | Mode::OpticalStereo => {
                assert!(rendered.rgba.chunks_exact(4).all(|p| p == [0, 0, 0, 255]), "{mode}");
            }
        }
    }
}

// ---- insets ----------------------------------------------------------------------------------------------------------

#[test]
fn insets_show_the_buffers_that_were_asked_for() {
    let Some(gpu) = support::gpu() else { return };
    let rig = pinhole_rig();
    let sphere = support::sphere(SPHERE_M, RADIUS_M, 24, support::diffuse(0.8));
    let scene = support::scene([("sphere", Kind::Virtual, sphere)]);
    let mut node = RenderNode::new(gpu, rig.clone(), &scene, config(Mode::SeeThrough)).unwrap();
    let plain = render_with(&mut node, &rig, ground_frame(&rig));
    let buffers = ["ratio", "coverage", "light"].map(|name| name.parse::<Buffer>().unwrap());
    node.show(&buffers);
    assert_eq!(node.shown(), buffers);
    let shown = render_with(&mut node, &rig, ground_frame(&rig));
    let pixel = |rendered: &RenderedFrame, x: usize, y: usize| -> [u8; 3] {
        let i = 4 * (y * 320 + x);
        [rendered.rgba[i], rendered.rgba[i + 1], rendered.rgba[i + 2]]
    };
    let frame = ground_frame(&rig);
    let white = srgb(Vec3::splat(SIGNAL * SKY as f32));
    let (mut n_covered, mut n_sky) = (0, 0);
    for (x, y) in (0..240).flat_map(|y| (0..320).map(move |x| (x, y))) {
        let found = pixel(&shown, x, y);
        match (x / 80, y / 60) {
            (0, 0) => assert_eq!(found, [0; 3], "there is no phantom"),
            (1, 0) => {
                // The texel in the middle of the four by four that the pixel stands for.
                let (at_x, at_y) = (4 * (x - 80) + 2, 4 * y + 2);
                let i = 3 * (at_y * 320 + at_x);
                if pixel(&plain, at_x, at_y) == frame.pixels[i..i + 3] {
                    assert!(found == [0; 3] || found == [255; 3], "{x} {y}: {found:?}");
                } else {
                    n_covered += 1;
                    assert_ne!(found, [0; 3], "{x} {y}");
                }
            }
            // Six faces of the sky; the lower half is filled in from the upper one.
            (2, 0) if found.iter().zip(white).all(|(a, b)| a.abs_diff(b) <= 2) => n_sky += 1,
            (2, 0) => {}
            _ => assert_eq!(found, pixel(&plain, x, y), "outside the insets nothing changes"),
        }
    }
    assert!(n_covered > 100, "{n_covered} pixels show the sphere");
    assert!(n_sky > 2000, "{n_sky} pixels show the sky");
    let many: Vec<Buffer> = Buffer::all().collect();
    assert!(many.len() > Insets::MOST);
    node.show(&many);
    assert_eq!(node.shown(), &many[..Insets::MOST]);
    render_with(&mut node, &rig, ground_frame(&rig));
}
