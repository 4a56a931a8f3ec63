//! Whole frames through the render node: light whose effect is known, from marker picture to composite.

mod support;

use std::f32::consts::PI;

use glam::{DVec2, DVec3, Vec3};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::probe::radiance::Picture;
use mirrorball_calib::rig::Rig;
use mirrorball_capture::frame::{Frame, FrameSet};
use mirrorball_render::config::{DiffuseMethod, Noise, RenderConfig, SceneCamera, SpecularMethod};
use mirrorball_render::error::RenderError;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::node::{RenderNode, RenderedFrame};
use mirrorball_render::scene::{Kind, Scene};
use support::Errors;

/// Radiance of the sky, the same in every direction and channel: 0.6 of full scale in both cameras.
const SKY: f64 = 3.0;

/// One frame under the uniform sky.
struct Shot {
    rig: Rig,
    scene: Scene,
    frame: Frame,
    rendered: RenderedFrame,
}

/// The room is far away, so that the sky is the same wherever an object stands.
fn config() -> RenderConfig {
    let mut config = RenderConfig::default();
    config.probe.room_distance_m = 50.0;
    config.probe.cube_size = 64;
    // The ground with its markers is to be light from nowhere: the sky goes on below.
    config.probe.scene_camera = SceneCamera::Ignored;
    // Light is compared pixel by pixel; `look.rs` is about noise.
    config.look.noise = Noise::Off;
    config
}

/// Renders `scene` into a picture of markers on the ground, lit by the sky that the fisheye sees.
fn render(gpu: Gpu, scene: Scene, config: RenderConfig) -> Shot {
    let rig = support::rig();
    let camera = rig.scene_camera();
    let from = DVec3::new(0.05, -0.30, 0.34);
    let world_from_camera = support::looking_at(DVec3::new(0.03, 0.0, 0.0), from).inverse();
    let frame = support::frame(camera, 7, 3, |ray| {
        let direction = world_from_camera.transform_vector(ray);
        let ground = from - direction * (from.z / direction.z);
        let is_below = direction.z < 0.0;
        DVec3::splat(
            SKY * if is_below {
                support::ground_reflectance(&rig, ground)
            } else {
                1.0
            },
        )
    });
    let probe = support::frame(rig.probe_camera().expect("the rig has a probe camera"), 7, 1, |_| {
        DVec3::splat(SKY)
    });
    let mut node = RenderNode::new(gpu, rig.clone(), &scene, config).expect("the rig has a probe");
    let rendered = node
        .render(&FrameSet {
            frames: vec![frame.clone(), probe],
        })
        .expect("the frames fit the rig");
    Shot {
        rig,
        scene,
        frame,
        rendered,
    }
}

impl Shot {
    fn pose(&self) -> Pose {
        *self.rendered.pose.camera_from_world().expect("the markers are found")
    }

    /// Ray through a pixel: origin and unit direction in the world.
    fn ray(&self, pixel: DVec2) -> (Vec3, Vec3) {
        let world_from_camera = self.pose().inverse();
        let ray = self
            .rig
            .scene_camera()
            .intrinsics
            .unproject(pixel)
            .expect("every pixel has a ray");
        (
            world_from_camera.translation.as_vec3(),
            world_from_camera.transform_vector(ray).as_vec3(),
        )
    }

    /// The finished picture as the camera would have taken it.
    fn finished(&self) -> Frame {
        let rgb = self
            .rendered
            .rgba
            .chunks_exact(4)
            .flat_map(|p| [p[0], p[1], p[2]])
            .collect();
        support::frame_of(self.rig.scene_camera(), 7, rgb)
    }

    fn pixels(&self) -> impl Iterator<Item = DVec2> {
        let [width, height] = self.rendered.size_px;
        (0..width * height).map(move |i| DVec2::new(f64::from(i % width), f64::from(i / width)))
    }

    /// Radiance of the finished picture, relative to the sky, at every pixel whose ray passes within `share` of the
    /// radius of a sphere's centre.
    fn radiance_on(&self, (center_m, radius_m): (Vec3, f32), share: f32) -> Vec<Vec3> {
        let finished = self.finished();
        let picture = Picture::new(&finished, self.rig.scene_camera());
        self.pixels()
            .filter(|pixel| {
                let (eye, ray) = self.ray(*pixel);
                let to_center = center_m - eye;
                (to_center - ray * to_center.dot(ray)).length() < share * radius_m
            })
            .map(|pixel| picture.sample(pixel).expect("the pixel is in the picture").radiance / SKY as f32)
            .collect()
    }
}

#[test]
fn the_markers_of_the_test_pictures_give_the_pose() {
    let Some(gpu) = support::gpu() else { return };
    let shot = render(gpu, support::scene([]), config());
    let expected = support::looking_at(DVec3::new(0.03, 0.0, 0.0), DVec3::new(0.05, -0.30, 0.34));
    let off_m = (shot.pose().inverse().translation - expected.inverse().translation).length();
    assert!(off_m < 1e-3, "the camera is {off_m} m off");
    let frame: Vec<u8> = shot
        .rendered
        .rgba
        .chunks_exact(4)
        .flat_map(|p| [p[0], p[1], p[2]])
        .collect();
    assert_eq!(
        frame,
        shot.frame.pixels.to_vec(),
        "without objects the picture is the camera's"
    );
}

#[test]
fn a_white_sphere_in_a_uniform_sky_has_the_radiance_of_its_albedo() {
    let Some(gpu) = support::gpu() else { return };
    let (center_m, radius_m, albedo) = (Vec3::new(0.03, 0.02, 0.12), 0.04, 0.8);
    let sphere = support::sphere(center_m, radius_m, 32, support::diffuse(albedo));
    let shot = render(gpu, support::scene([("sphere", Kind::Virtual, sphere)]), config());
    let radiance = shot.radiance_on((center_m, radius_m), 0.9);
    let errors = Errors::of(
        "white sphere",
        radiance.iter().map(|l| (*l / albedo - 1.0).abs().max_element()),
    );
    assert!(errors.n > 1000, "{errors:?}");
    // Half a code is 0.5 %; 48 lights of a Fibonacci lattice give a cosine integral to 1 %; at the terminator of each
    // light the shadow map, offset by two and a half texels, takes some of its small share.
    assert!(errors.mean < 0.015 && errors.worst < 0.04, "{errors:?}");
}

#[test]
fn a_mirror_in_a_uniform_sky_vanishes() {
    let Some(gpu) = support::gpu() else { return };
    let (center_m, radius_m) = (Vec3::new(0.03, 0.02, 0.12), 0.04);
    let sphere = support::sphere(center_m, radius_m, 32, support::mirror());
    let shot = render(gpu, support::scene([("sphere", Kind::Virtual, sphere)]), config());
    let radiance = shot.radiance_on((center_m, radius_m), 0.9);
    let errors = Errors::of("mirror", radiance.iter().map(|l| (*l - 1.0).abs().max_element()));
    // Half a code of each camera, and the clipping red of a camera whose colours are not the rig's.
    assert!(errors.mean < 0.01 && errors.worst < 0.02, "{errors:?}");
}

#[test]
fn every_method_of_light_shows_a_uniform_sky() {
    let (center_m, radius_m, albedo) = (Vec3::new(0.03, 0.02, 0.12), 0.04, 0.8);
    let methods = [
        (DiffuseMethod::Lights, SpecularMethod::Ggx),
        (DiffuseMethod::CosineCube, SpecularMethod::Phong),
        (DiffuseMethod::Sh9, SpecularMethod::SphereMap),
        (DiffuseMethod::SeparableBlur, SpecularMethod::Highlight),
        (DiffuseMethod::Cylindrical, SpecularMethod::Ggx),
        (DiffuseMethod::SphereMap, SpecularMethod::SphereMap),
    ];
    for (diffuse, specular) in methods {
        for (material, expected) in [
            (support::diffuse(albedo), albedo),
            // Nothing of a uniform sky is a highlight.
            (
                support::mirror(),
                if specular == SpecularMethod::Highlight {
                    0.0
                } else {
                    1.0
                },
            ),
        ] {
            let Some(gpu) = support::gpu() else { return };
            let mut config = config();
            (config.light.diffuse, config.light.specular) = (diffuse, specular);
            let sphere = support::sphere(center_m, radius_m, 32, material);
            let shot = render(gpu, support::scene([("sphere", Kind::Virtual, sphere)]), config);
            let radiance = shot.radiance_on((center_m, radius_m), 0.9);
            let errors = Errors::of(
                &format!("{diffuse:?}, {specular:?}, {expected} of the sky"),
                radiance.iter().map(|l| (*l - expected).abs().max_element()),
            );
            assert!(errors.n > 1000, "{errors:?}");
            // Half a code of each camera; shadows as with lights: the share that they take at their terminators.
            assert!(
                errors.mean < 0.015 && errors.worst < 0.04,
                "{diffuse:?}, {specular:?}: {errors:?}"
            );
        }
    }
}

const SPHERE_RADIUS_M: f32 = 0.03;
const SPHERE_HEIGHT_M: f32 = 0.06;

fn sphere_over_ground(albedo: f32) -> Scene {
    let center_m = Vec3::new(0.03, 0.02, SPHERE_HEIGHT_M);
    support::scene([
        ("ground", Kind::Phantom, support::square(Vec3::ZERO, Vec3::X, Vec3::Y)),
        (
            "sphere",
            Kind::Virtual,
            support::sphere(center_m, SPHERE_RADIUS_M, 24, support::diffuse(albedo)),
        ),
    ])
}

#[test]
fn a_sphere_darkens_the_ground_under_a_uniform_sky_by_its_solid_angle() {
    let Some(gpu) = support::gpu() else { return };
    let mut config = config();
    // All lights in the dome: there is nothing bright.
    config.shadow.dome_lights = 112;
    // Black, so that it throws no light back.
    let shot = render(gpu, sphere_over_ground(0.0), config);
    let finished = shot.finished();
    let camera = shot.rig.scene_camera();
    let (before, after) = (Picture::new(&shot.frame, camera), Picture::new(&finished, camera));
    let virtuals = support::occluders(&shot.scene, Kind::Virtual);
    let mut errors = Vec::new();
    let (mut found_loss, mut expected_loss) = (0.0f64, 0.0f64);
    for pixel in shot.pixels() {
        let (eye, ray) = shot.ray(pixel);
        let ground = eye - ray * (eye.z / ray.z);
        let to_sphere = Vec3::new(0.03, 0.02, SPHERE_HEIGHT_M) - ground;
        let distance = to_sphere.length();
        let old = before.sample(pixel).unwrap().radiance.y;
        // Dark ink has too few codes; around the sphere's outline a pixel shows both.
        let sphere_miss = {
            let to_center = Vec3::new(0.03, 0.02, SPHERE_HEIGHT_M) - eye;
            (to_center - ray * to_center.dot(ray)).length()
        };
        if ray.z >= 0.0 || old < 0.3 * SKY as f32 || sphere_miss < 1.1 * SPHERE_RADIUS_M {
            continue;
        }
        assert!(!virtuals.blocks(eye, ground));
        let found = after.sample(pixel).unwrap().radiance.y / old;
        let expected = 1.0 - (SPHERE_RADIUS_M / distance).powi(2) * (SPHERE_HEIGHT_M / distance);
        errors.push(found - expected);
        // Losses that no code shows are left out by the pass.
        if expected < 0.98 {
            found_loss += f64::from(1.0 - found);
            expected_loss += f64::from(1.0 - expected);
        }
    }
    let errors = Errors::of("sphere over ground", errors);
    println!("light lost over the ground: {found_loss:.1} of {expected_loss:.1}");
    // A light overhead is 2 % of the irradiance; the sphere's outline cuts the cells of a few of 112, either way.
    assert!(errors.mean < 0.01 && errors.worst < 0.07, "{errors:?}");
    assert!(
        (found_loss / expected_loss - 1.0).abs() < 0.05,
        "{found_loss} of {expected_loss}"
    );
}

#[test]
fn pixels_outside_every_object_are_the_cameras_bit_for_bit() {
    let Some(gpu) = support::gpu() else { return };
    let center_m = Vec3::new(0.03, 0.02, SPHERE_HEIGHT_M);
    let scene = support::scene([
        (
            "patch",
            Kind::Phantom,
            support::square(Vec3::new(0.03, 0.02, 0.0), Vec3::X * 0.06, Vec3::Y * 0.06),
        ),
        (
            "sphere",
            Kind::Virtual,
            support::sphere(center_m, SPHERE_RADIUS_M, 24, support::diffuse(0.8)),
        ),
    ]);
    let shot = render(gpu, scene, config());
    let objects = [Kind::Phantom, Kind::Virtual].map(|kind| support::occluders(&shot.scene, kind));
    let (mut outside, mut changed) = (0, 0);
    for (index, pixel) in shot.pixels().enumerate() {
        let is_same = shot.rendered.rgba[4 * index..4 * index + 3] == shot.frame.pixels[3 * index..3 * index + 3];
        // A triangle's edge stays straight in the picture, the lens's does not: a pixel of margin.
        let touches = [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
            .iter()
            .any(|(dx, dy)| {
                let (eye, ray) = shot.ray(pixel + DVec2::new(*dx, *dy));
                objects.iter().any(|o| o.distance_m(eye, ray, 0.0).is_some())
            });
        if touches {
            changed += u32::from(!is_same);
        } else {
            outside += 1;
            assert!(is_same, "the pixel at {pixel} changed");
        }
    }
    assert!(
        outside > 20_000 && changed > 2_000,
        "{outside} outside, {changed} changed"
    );
}

#[test]
fn the_measured_sky_is_the_sky() {
    let Some(gpu) = support::gpu() else { return };
    let rig = support::rig();
    let mut node = RenderNode::new(gpu, rig.clone(), &sphere_over_ground(0.8), config()).unwrap();
    let probe = support::frame(rig.probe_camera().unwrap(), 1, 1, |_| DVec3::splat(SKY));
    let scene = support::frame(rig.scene_camera(), 1, 1, |_| DVec3::splat(0.4 * SKY));
    let rendered = node
        .render(&FrameSet {
            frames: vec![scene, probe],
        })
        .unwrap();
    assert!(
        rendered.pose.camera_from_world().is_none(),
        "there is no marker to be found"
    );
    let light = node.light().expect("the fisheye stands still and needs no pose");
    // The sky of the upper half, all of it in the lights.
    let up: f32 = light
        .lights
        .iter()
        .map(|l| l.irradiance.y * l.direction.z.max(0.0))
        .sum();
    assert!((up / (PI * SKY as f32) - 1.0).abs() < 0.03, "{up}");
}

#[test]
fn a_frame_of_another_size_is_refused_and_the_next_one_rendered() {
    let Some(gpu) = support::gpu() else { return };
    let rig = support::rig();
    let mut node = RenderNode::new(gpu, rig.clone(), &sphere_over_ground(0.8), config()).unwrap();
    let set = |sequence: u64| FrameSet {
        frames: vec![
            support::frame(rig.scene_camera(), sequence, 1, |_| DVec3::splat(0.4 * SKY)),
            support::frame(rig.probe_camera().unwrap(), sequence, 1, |_| DVec3::splat(SKY)),
        ],
    };
    node.render(&set(1)).unwrap();
    for index in [0, 1] {
        let mut changed = set(2);
        let frame = &mut changed.frames[index];
        frame.size.height /= 2;
        frame.pixels = frame.pixels[..3 * frame.size.pixels()].to_vec().into();
        let expected = format!("`{}`", frame.meta.camera);
        let error = node.render(&changed).unwrap_err();
        assert!(
            matches!(error, RenderError::FrameSize { sequence: 2, .. }) && error.to_string().contains(&expected),
            "{error}"
        );
    }
    let rendered = node.render(&set(3)).unwrap();
    assert!(rendered.light.is_some() && rendered.sequence == 3);
}
