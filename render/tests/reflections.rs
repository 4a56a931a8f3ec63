//! Reflections, glass and the real mirror ball in whole frames, against rays that are followed by hand.

mod support;

use glam::{DVec2, DVec3, Vec3};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::probe::radiance::Picture;
use mirrorball_calib::rig::{Ball, Rig};
use mirrorball_capture::frame::{Frame, FrameSet};
use mirrorball_render::config::{Facets, Noise, RenderConfig, SceneCamera};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::node::RenderNode;
use mirrorball_render::scene::material::{Model, Volume};
use mirrorball_render::scene::occluders::Occluders;
use mirrorball_render::scene::{Kind, Material, Mesh, Scene};
use mirrorball_render::shadow::ShadowMethod;
use support::Errors;

/// Radiance of the sky, the same in every direction and channel: 0.6 of full scale in both cameras.
const SKY: f64 = 3.0;
/// A sphere that is in the middle of the picture.
const CENTER_M: Vec3 = Vec3::new(0.03, 0.02, 0.12);
const RADIUS_M: f32 = 0.04;

/// One frame: markers on the ground under a uniform sky, before and after.
struct Shot {
    rig: Rig,
    camera_from_world: Pose,
    before: Frame,
    after: Frame,
}

/// Renders `scene`, which casts no shadows, into a picture of the ground of which the ball, if `rig` has one in it, mirrors
/// the sky alone.
fn render(gpu: Gpu, rig: Rig, scene: &Scene) -> Shot {
    let mut config = RenderConfig::default();
    // The room is far away, so that the sky is the same wherever an object stands; it goes on below.
    config.probe.room_distance_m = 50.0;
    config.probe.cube_size = 64;
    config.probe.scene_camera = SceneCamera::Ignored;
    config.shadow.method = ShadowMethod::None;
    // Pictures are compared light by light.
    config.look.noise = Noise::Off;
    // A white metal keeps all light, however rough.
    config.light.facets = Facets::Multiple;
    let from = DVec3::new(0.05, -0.30, 0.34);
    let world_from_camera = support::looking_at(DVec3::new(0.03, 0.0, 0.0), from).inverse();
    let ball = rig.ball;
    let before = support::frame(rig.scene_camera(), 7, 3, |ray| {
        let direction = world_from_camera.transform_vector(ray);
        if let Some(ball) = &ball
            && sphere_hit(
                from.as_vec3(),
                direction.as_vec3(),
                (ball.center_m.as_vec3(), ball.radius_m as f32),
            )
            .is_some()
        {
            return SKY * DVec3::from_array(ball.reflectance);
        }
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
    let probe_camera = rig.probe_camera().expect("the rig has a probe camera");
    let probe = support::frame(probe_camera, 7, 1, |_| DVec3::splat(SKY));
    let mut node = RenderNode::new(gpu, rig.clone(), scene, config).expect("the rig has a probe");
    let set = FrameSet {
        frames: vec![before.clone(), probe],
    };
    let rendered = node.render(&set).expect("the frames fit the rig");
    let rgb = rendered.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    Shot {
        camera_from_world: *rendered.pose.camera_from_world().expect("the markers are found"),
        after: support::frame_of(rig.scene_camera(), 7, rgb),
        before,
        rig,
    }
}

/// Distance along a ray to a sphere.
fn sphere_hit(origin: Vec3, direction: Vec3, (center, radius): (Vec3, f32)) -> Option<f32> {
    let to_center = center - origin;
    let along = to_center.dot(direction);
    let inside = radius * radius - (to_center - direction * along).length_squared();
    (inside > 0.0 && along > 0.0).then(|| along - inside.sqrt())
}

/// Smooth glass (exact Fresnel): reflectance and the refracted direction, `None` where all is reflected. `eta`: index on the
/// ray's side over that on the other.
fn through(direction: Vec3, normal: Vec3, eta: f32) -> (f32, Option<Vec3>) {
    let cosine = -direction.dot(normal);
    let sine2 = eta * eta * (1.0 - cosine * cosine);
    if sine2 >= 1.0 {
        return (1.0, None);
    }
    let inner = (1.0 - sine2).sqrt();
    let parallel = (cosine - eta * inner) / (cosine + eta * inner);
    let across = (eta * cosine - inner) / (eta * cosine + inner);
    let reflected = 0.5 * (parallel * parallel + across * across);
    (reflected, Some(direction * eta + normal * (eta * cosine - inner)))
}

impl Shot {
    fn pixels(&self) -> impl Iterator<Item = DVec2> + use<> {
        let [width, height] = self.rig.scene_camera().intrinsics.size_px;
        (0..width * height).map(move |i| DVec2::new(f64::from(i % width), f64::from(i / width)))
    }

    /// Ray through a pixel: origin and unit direction in the world.
    fn ray(&self, pixel: DVec2) -> (Vec3, Vec3) {
        let world_from_camera = self.camera_from_world.inverse();
        let ray = self
            .rig
            .scene_camera()
            .intrinsics
            .unproject(pixel)
            .expect("every pixel has a ray");
        let direction = world_from_camera.transform_vector(ray).as_vec3();
        (world_from_camera.translation.as_vec3(), direction)
    }

    /// Radiance of the finished picture relative to the sky.
    fn found(&self, pixel: DVec2) -> Vec3 {
        let sample = Picture::new(&self.after, self.rig.scene_camera()).sample(pixel);
        sample.expect("the pixel is in the picture").radiance / SKY as f32
    }

    /// What arrives along a ray past all objects, relative to the sky: that or the ground as the camera took it; `None` for
    /// ground that is not in the picture or where a pixel's place decides between black and white.
    fn behind(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        if direction.z >= 0.0 {
            return Some(1.0);
        }
        let ground = (origin - direction * (origin.z / direction.z)).as_dvec3();
        let in_camera = self.camera_from_world.transform_point(ground);
        let camera = self.rig.scene_camera();
        let pixel = (in_camera.z > 0.0)
            .then(|| camera.intrinsics.project(in_camera))
            .flatten()?;
        Picture::new(&self.before, camera).sample(pixel)?;
        let around = [-0.003, 0.0, 0.003].map(|x| {
            [-0.003, 0.0, 0.003].map(|y| support::ground_reflectance(&self.rig, ground + DVec3::new(x, y, 0.0)) as f32)
        });
        let is_even = around.iter().flatten().all(|r| *r == around[1][1]);
        is_even.then_some(around[1][1])
    }
}

fn ground() -> (&'static str, Kind, Mesh) {
    ("ground", Kind::Phantom, support::square(Vec3::ZERO, Vec3::X, Vec3::Y))
}

/// The rig without its ball.
fn rig() -> Rig {
    Rig {
        ball: None,
        ..support::rig()
    }
}

fn metal(roughness: f32) -> Material {
    Material {
        roughness,
        ..support::mirror()
    }
}

fn glass() -> Material {
    Material {
        dielectric_f0: [0.04; 3],
        dielectric_f90: 1.0,
        roughness: 0.0,
        transmission: 1.0,
        ior: 1.5,
        volume: Volume {
            thickness_m: RADIUS_M,
            ..Volume::default()
        },
        ..support::diffuse(1.0)
    }
}

/// Pixels that show the inner part of the sphere in the middle.
fn on_sphere(shot: &Shot) -> Vec<DVec2> {
    shot.pixels()
        .filter(|&pixel| {
            let (eye, ray) = shot.ray(pixel);
            sphere_hit(eye, ray, (CENTER_M, 0.9 * RADIUS_M)).is_some()
        })
        .collect()
}

#[test]
fn metal_vanishes_in_a_uniform_sky() {
    for material in [metal(0.0), metal(0.2), metal(0.4)] {
        let Some(gpu) = support::gpu() else { return };
        let what = format!("roughness {}", material.roughness);
        let sphere = support::sphere(CENTER_M, RADIUS_M, 32, material);
        let shot = render(gpu, rig(), &support::scene([("sphere", Kind::Virtual, sphere)]));
        let pixels = on_sphere(&shot);
        let errors = Errors::of(&what, pixels.iter().map(|&p| (shot.found(p) - 1.0).abs().max_element()));
        assert!(errors.n > 1000, "{what}: {errors:?}");
        // Half a code of each camera, and the clipping red of a camera whose colours are not the rig's.
        assert!(errors.mean < 0.03 && errors.worst < 0.07, "{what}: {errors:?}");
    }
}

#[test]
fn a_mirror_shows_the_ground_where_geometry_says() {
    let Some(gpu) = support::gpu() else { return };
    let sphere = support::sphere(CENTER_M, RADIUS_M, 64, support::mirror());
    let shot = render(
        gpu,
        rig(),
        &support::scene([ground(), ("sphere", Kind::Virtual, sphere)]),
    );
    let (mut errors, mut contrast) = (Vec::new(), Vec::new());
    for pixel in on_sphere(&shot) {
        let (eye, ray) = shot.ray(pixel);
        let place = eye + ray * sphere_hit(eye, ray, (CENTER_M, RADIUS_M)).expect("the ray passes within the sphere");
        let normal = (place - CENTER_M) / RADIUS_M;
        let Some(expected) = shot.behind(place, ray - 2.0 * ray.dot(normal) * normal) else {
            continue;
        };
        errors.push((shot.found(pixel) - expected).abs().max_element());
        contrast.push(expected - 0.4);
    }
    let contrast = Errors::of("without reflections", contrast);
    let errors = Errors::of("ground in a mirror", errors);
    assert!(errors.n > 300 && contrast.mean > 0.1, "{errors:?}, {contrast:?}");
    // Markers seen in the sphere are as small as a few pixels, whose edges are soft.
    assert!(errors.mean < 0.03, "{errors:?}");
}

#[test]
fn a_slab_of_glass_shifts_the_ground_as_snell_says() {
    let Some(gpu) = support::gpu() else { return };
    let (low, high) = (Vec3::new(-0.07, -0.06, 0.03), Vec3::new(0.13, 0.08, 0.06));
    let slab = Mesh {
        materials: vec![glass()],
        ..cuboid(low, high)
    };
    let shot = render(gpu, rig(), &support::scene([ground(), ("slab", Kind::Virtual, slab)]));
    let (mut errors, mut unbent) = (Vec::new(), Vec::new());
    for pixel in shot.pixels() {
        let (eye, ray) = shot.ray(pixel);
        let enters = eye + ray * ((high.z - eye.z) / ray.z);
        let (first, Some(inside)) = through(ray, Vec3::Z, 1.0 / 1.5) else {
            continue;
        };
        let leaves = enters + inside * ((low.z - enters.z) / inside.z);
        let margin = Vec3::new(0.01, 0.01, 0.0);
        let is_within = |p: Vec3| p.cmpge(low + margin - Vec3::Z).all() && p.cmple(high - margin + Vec3::Z).all();
        if !is_within(enters) || !is_within(leaves) {
            continue;
        }
        let (second, _) = through(inside, Vec3::Z, 1.5);
        let passed = (1.0 - first) * (1.0 - second);
        if let (Some(bent), Some(straight)) = (shot.behind(leaves, ray), shot.behind(eye, ray)) {
            // What does not pass is the sky's, mirrored by one of the walls.
            let found = shot.found(pixel);
            errors.push((found - (passed * bent + 1.0 - passed)).abs().max_element());
            unbent.push((found - (passed * straight + 1.0 - passed)).abs().max_element());
        }
    }
    let unbent = Errors::of("slab without refraction", unbent);
    let errors = Errors::of("slab", errors);
    assert!(
        errors.n > 1000 && unbent.mean > 2.0 * errors.mean,
        "{errors:?}, {unbent:?}"
    );
    // Schlick's term and its fit in place of Fresnel's equations at the first wall.
    assert!(errors.mean < 0.03, "{errors:?}");
}

#[test]
fn a_pane_without_thickness_bends_nothing() {
    let Some(gpu) = support::gpu() else { return };
    let (middle, half_m) = (Vec3::new(0.03, 0.01, 0.05), 0.07);
    let pane = Mesh {
        materials: vec![Material {
            volume: Volume::default(),
            ..glass()
        }],
        ..support::square(middle, Vec3::X * half_m, Vec3::Y * half_m)
    };
    let shot = render(gpu, rig(), &support::scene([ground(), ("pane", Kind::Virtual, pane)]));
    let (mut errors, mut bent) = (Vec::new(), Vec::new());
    for pixel in shot.pixels() {
        let (eye, ray) = shot.ray(pixel);
        let enters = eye + ray * ((middle.z - eye.z) / ray.z);
        if (enters - middle).abs().max_element() > half_m - 0.01 {
            continue;
        }
        let (reflected, Some(inside)) = through(ray, Vec3::Z, 1.0 / 1.5) else {
            continue;
        };
        if let (Some(straight), Some(refracted)) = (shot.behind(eye, ray), shot.behind(enters, inside)) {
            // What does not pass is the sky's.
            let mixed = |behind: f32| (1.0 - reflected) * behind + reflected;
            let found = shot.found(pixel);
            errors.push((found - mixed(straight)).abs().max_element());
            bent.push((found - mixed(refracted)).abs().max_element());
        }
    }
    let bent = Errors::of("pane as a wall of solid glass", bent);
    let errors = Errors::of("pane", errors);
    assert!(errors.n > 1000 && bent.mean > 2.0 * errors.mean, "{errors:?}, {bent:?}");
    assert!(errors.mean < 0.03, "{errors:?}");
}

/// A box with normals of its own on every side.
fn cuboid(low: Vec3, high: Vec3) -> Mesh {
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let mut mesh = Mesh::default();
    for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
        for side in [axis, -axis] {
            let across = if axis == Vec3::X { Vec3::Y } else { Vec3::X };
            let along = side.cross(across);
            let square = support::square(middle + side * half, across * half, along * half);
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend(square.vertices);
            mesh.indices.extend(square.indices.iter().map(|i| first + i));
        }
    }
    mesh
}

/// A red ball that stands in for all that a mirror may show.
fn red_sphere(center_m: Vec3, radius_m: f32) -> Mesh {
    let red = Material {
        base_color: [0.8, 0.0, 0.0],
        ..support::diffuse(1.0)
    };
    support::sphere(center_m, radius_m, 32, red)
}

#[test]
fn a_mirror_shows_another_virtual_object_where_geometry_says() {
    let (center_m, radius_m) = (Vec3::new(0.03, 0.0, 0.03), 0.025);
    let black = support::diffuse(0.0);
    let shines = Material {
        emission: [0.8 * SKY as f32, 0.0, 0.0],
        ..black.clone()
    };
    let unlit = Material {
        base_color: [0.8, 0.0, 0.0],
        model: Model::Unlit,
        ..black
    };
    let mut painted = support::sphere(center_m, radius_m, 32, support::diffuse(0.8));
    for vertex in &mut painted.vertices {
        vertex.color = [1.0, 0.0, 0.0, 1.0];
    }
    for ball in [
        red_sphere(center_m, radius_m),
        painted,
        support::sphere(center_m, radius_m, 32, shines),
        support::sphere(center_m, radius_m, 32, unlit),
    ] {
        check_mirrored(ball, (center_m, radius_m));
    }
}

/// Whether an upright mirror shows a red `ball`, a sphere with this centre and radius, where it must.
fn check_mirrored(ball: Mesh, red: (Vec3, f32)) {
    let Some(gpu) = support::gpu() else { return };
    // A mirror that stands upright behind the ball and faces the camera.
    let mirror = Mesh {
        materials: vec![support::mirror()],
        ..support::square(Vec3::new(0.03, 0.08, 0.1), Vec3::X * 0.1, Vec3::Z * 0.1)
    };
    let walls = Occluders::new([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| Vec3::from(mirror.vertices[i].position))));
    let scene = support::scene([("red", Kind::Virtual, ball), ("mirror", Kind::Virtual, mirror)]);
    let shot = render(gpu, rig(), &scene);
    let (mut shown, mut wrong, mut n) = (0, 0, 0);
    for pixel in shot.pixels() {
        let (eye, ray) = shot.ray(pixel);
        let Some(distance) = walls.distance_m(eye, ray, 0.0) else {
            continue;
        };
        if sphere_hit(eye, ray, (red.0, 1.1 * red.1)).is_some() {
            continue;
        }
        let place = eye + ray * distance;
        let hit = |share: f32| sphere_hit(place, ray * Vec3::new(1.0, -1.0, 1.0), (red.0, share * red.1)).is_some();
        // At its outline a pixel shows both.
        if hit(1.1) != hit(0.9) {
            continue;
        }
        let found = shot.found(pixel);
        let is_red = found.x > 0.5 && found.y < 0.5;
        n += 1;
        shown += u32::from(hit(1.0));
        wrong += u32::from(is_red != hit(1.0));
    }
    assert!(
        shown > 300 && n > 3 * shown,
        "{shown} of {n} pixels of the mirror show the ball"
    );
    assert_eq!(wrong, 0, "of {n} pixels");
}

#[test]
fn the_real_ball_shows_a_virtual_object_and_nothing_else_changes() {
    let Some(gpu) = support::gpu() else { return };
    let (center_m, radius_m) = (DVec3::new(0.09, 0.06, 0.05), 0.045);
    let reflectance = [0.7, 0.65, 0.6];
    let rig = Rig {
        ball: Some(Ball {
            center_m,
            radius_m,
            reflectance,
            roughness: 0.0,
        }),
        ..support::rig()
    };
    let ball = (center_m.as_vec3(), radius_m as f32);
    let red = (Vec3::new(-0.04, 0.06, 0.08), 0.035);
    let scene = support::scene([
        (
            "ball",
            Kind::Phantom,
            support::sphere(ball.0, ball.1, 48, support::diffuse(0.5)),
        ),
        ("red", Kind::Virtual, red_sphere(red.0, red.1)),
    ]);
    let shot = render(gpu, rig, &scene);
    let (mut errors, mut kept) = (Vec::new(), 0);
    for (index, pixel) in shot.pixels().enumerate() {
        let (eye, ray) = shot.ray(pixel);
        let Some(distance) = sphere_hit(eye, ray, (ball.0, 0.97 * ball.1)) else {
            continue;
        };
        if sphere_hit(eye, ray, (red.0, 1.05 * red.1)).is_some() {
            continue;
        }
        let place = eye + ray * sphere_hit(eye, ray, ball).unwrap_or(distance);
        let normal = (place - ball.0) / ball.1;
        let mirrored = ray - 2.0 * ray.dot(normal) * normal;
        let hit = |share: f32| sphere_hit(place, mirrored, (red.0, share * red.1)).is_some();
        if hit(0.8) {
            let found = shot.found(pixel);
            errors.push((found.x / (0.8 * reflectance[0] as f32) - 1.0).abs().max(found.y.abs()));
        } else if !hit(1.3) {
            kept += 1;
            let at = 3 * index..3 * index + 3;
            assert_eq!(
                shot.before.pixels[at.clone()],
                shot.after.pixels[at],
                "the pixel at {pixel} changed"
            );
        }
    }
    let errors = Errors::of("red in the ball", errors);
    assert!(errors.n > 30 && kept > 300, "{} and {kept} pixels", errors.n);
    // Codes of the dark green and the light that is not quite the sky's at the object's place.
    assert!(errors.mean < 0.05, "{errors:?}");
}
