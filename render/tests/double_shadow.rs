//! Where a virtual shadow falls into a real one nothing darkens twice: composites against path-traced pictures.
//!
//! One lamp and a sky light a box and a slab over the ground; the path tracer takes the photograph and the truth.

mod support;

use glam::{Affine3A, DVec2, DVec3, Vec3};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::rig::Rig;
use mirrorball_capture::frame::{Frame, FrameSet};
use mirrorball_render::config::{Protection, RenderConfig};
use mirrorball_render::node::RenderNode;
use mirrorball_render::scene::occluders::Occluders;
use mirrorball_render::scene::{Kind, Mesh, Scene};
use mirrorball_render::shadow::path::environment::Environment;
use mirrorball_render::shadow::path::scene::TracedScene;
use mirrorball_render::shadow::path::{PathJob, PathSettings, PathTracer};
use mirrorball_render::shadow::view::View;
use std::path::Path;
use std::sync::OnceLock;

const EYE: DVec3 = DVec3::new(0.05, -0.30, 0.34);
const TARGET: DVec3 = DVec3::new(-0.02, 0.04, 0.0);
/// Radiance of the sky, and irradiance of the lamp on a surface that faces it.
const SKY: Vec3 = Vec3::new(0.9, 1.0, 1.2);
const LAMP: Vec3 = Vec3::new(13.0, 11.0, 8.0);
/// Edge of a face of the light's cube, texels; the lamp is one of them.
const CUBE: u32 = 64;

/// The rig of the tests with a lens that a pinhole view can take the place of.
fn rig() -> Rig {
    let text = include_str!("support/rig.toml")
        .replacen("focal_px = [322.0, 321.0]", "focal_px = [320.0, 320.0]", 1)
        .replacen("[161.3, 118.6]", "[159.5, 119.5]", 1)
        .replacen("[-0.05, 0.02, -0.0004, 0.0003, 0.0]", "[0.0, 0.0, 0.0, 0.0, 0.0]", 1);
    Rig::from_toml(&text, Path::new("rig.toml")).unwrap()
}

/// The light, and the direction of its lamp.
fn light() -> (Cube<Vec3>, Vec3) {
    let mut cube = Cube::filled(CUBE, SKY);
    let lamp = cube.index_of(Vec3::new(-0.5, 0.35, 0.8));
    cube.texels_mut()[lamp] = LAMP / cube.solid_angle(lamp);
    let towards = cube.direction(lamp);
    (cube, towards)
}

fn block(middle: Vec3, half: Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for sign in [-1.0f32, 1.0] {
            let (mut normal, mut u) = (Vec3::ZERO, Vec3::ZERO);
            normal[axis] = sign;
            u[(axis + 1) % 3] = 1.0;
            let side = support::square(middle + half * normal, half * u, half * normal.cross(u));
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend(side.vertices);
            mesh.indices.extend(side.indices.iter().map(|i| first + i));
            mesh.materials = side.materials;
        }
    }
    mesh
}

/// What a scene is made of.
fn ground() -> (&'static str, Kind, Mesh) {
    ("ground", Kind::Phantom, support::square(Vec3::ZERO, Vec3::X, Vec3::Y))
}

fn real_box() -> (&'static str, Kind, Mesh) {
    let mesh = block(Vec3::new(-0.125, 0.145, 0.035), Vec3::new(0.025, 0.025, 0.035));
    ("box", Kind::Phantom, mesh)
}

/// One slab over the box's shadow, one over a marker.
fn slabs() -> [(&'static str, Kind, Mesh); 2] {
    let slab = |middle| block(middle, Vec3::new(0.03, 0.03, 0.008));
    [
        ("slab", Kind::Virtual, slab(Vec3::new(-0.125, 0.145, 0.095))),
        (
            "slab over the marker",
            Kind::Virtual,
            slab(Vec3::new(-0.06, 0.06, 0.11)),
        ),
    ]
}

/// Everything there is.
fn everything() -> Scene {
    support::scene([ground(), real_box()].into_iter().chain(slabs()))
}

/// Photographs by the path tracer: without the slabs, and with them.
struct Photographs {
    before: Frame,
    truth: Frame,
}

fn photographs() -> Option<&'static Photographs> {
    static TAKEN: OnceLock<Option<Photographs>> = OnceLock::new();
    TAKEN
        .get_or_init(|| {
            let gpu = support::gpu()?;
            let tracer = PathTracer::new(&gpu);
            let take = |scene: &Scene| {
                let placements = vec![Affine3A::IDENTITY; scene.objects.len()];
                let settings = PathSettings {
                    samples: 64,
                    max_bounces: 3,
                    ..PathSettings::default()
                };
                let traced = TracedScene::new(&gpu, (scene, &placements), settings.surfaces).unwrap();
                let height_rad = 2.0 * (120.0f32 / 320.0).atan();
                let job = PathJob {
                    view: &View::looking_at(EYE.as_vec3(), TARGET.as_vec3(), height_rad, [320, 240]),
                    light: None,
                    environment: Environment::Cube(&light().0),
                    settings,
                    target: None,
                };
                let picture = tracer.render(&gpu, &traced, &job).unwrap();
                let radiance: Vec<Vec3> = picture.radiance.iter().map(|r| r.truncate()).collect();
                developed(scene, &radiance)
            };
            Some(Photographs {
                before: take(&support::scene([ground(), real_box()])),
                truth: take(&everything()),
            })
        })
        .as_ref()
}

/// A photograph of traced radiance, the markers printed on the ground.
fn developed(scene: &Scene, radiance: &[Vec3]) -> Frame {
    let rig = rig();
    let camera = rig.scene_camera();
    let world_from_camera = support::looking_at(TARGET, EYE).inverse();
    let things = Occluders::new(
        [Kind::Phantom, Kind::Virtual]
            .into_iter()
            .flat_map(|kind| triangles(scene, kind)),
    );
    let print = |ray: DVec3| {
        let direction = world_from_camera.transform_vector(ray);
        let ground = EYE - direction * (EYE.z / direction.z);
        let hit_m = things.distance_m(EYE.as_vec3(), direction.as_vec3().normalize(), 0.0);
        let is_ground = hit_m.is_some_and(|hit_m| (f64::from(hit_m) - (ground - EYE).length()).abs() < 1e-3);
        if is_ground {
            support::ground_reflectance(&rig, ground) / 0.4
        } else {
            1.0
        }
    };
    support::frame(camera, 3, 3, |ray| {
        let pixel = camera.intrinsics.project(ray).expect("the ray is the camera's");
        let [column, row] = [pixel.x.round(), pixel.y.round()].map(|place| place.max(0.0) as usize);
        radiance[row.min(239) * 320 + column.min(319)].as_dvec3() * print(ray)
    })
}

fn triangles(scene: &Scene, kind: Kind) -> Vec<[Vec3; 3]> {
    let corner = |mesh: &Mesh, i: u32| Vec3::from(mesh.vertices[i as usize].position);
    scene
        .objects
        .iter()
        .filter(|object| object.kind == kind)
        .flat_map(|object| {
            let mesh = &object.mesh;
            mesh.indices
                .chunks_exact(3)
                .map(|t| [corner(mesh, t[0]), corner(mesh, t[1]), corner(mesh, t[2])])
        })
        .collect()
}

/// The slabs in the photograph by the renderer that knows `phantoms`.
fn composite(phantoms: &[(&'static str, Kind, Mesh)], protection: Protection) -> Option<Vec<u8>> {
    let rig = rig();
    let mut config = RenderConfig::default();
    config.probe.cube_size = CUBE;
    config.shadow.protection = protection;
    let scene = support::scene(phantoms.iter().cloned().chain(slabs()));
    let mut node = RenderNode::new(support::gpu()?, rig.clone(), &scene, config)
        .unwrap()
        .with_light(light().0);
    let probe = support::frame(rig.probe_camera().unwrap(), 3, 1, |_| DVec3::splat(1.0));
    let frames = vec![photographs()?.before.clone(), probe];
    let rendered = node.render(&FrameSet { frames }).unwrap();
    let pose = rendered.pose.camera_from_world().expect("the markers are seen");
    let off_m = (pose.inverse().translation - EYE).length();
    assert!(off_m < 2e-3, "the camera is {off_m} m off");
    Some(rendered.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect())
}

/// What of the lamp a place on the ground gets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Lamp {
    All,
    Part,
    Nothing,
}

/// A pixel that shows open ground.
struct GroundPixel {
    index: usize,
    /// Past the box, past the slabs.
    lamp: [Lamp; 2],
    /// 0.4 but for print.
    reflectance: f64,
}

/// The pixels that show the ground, in all their area.
fn ground_pixels() -> Vec<GroundPixel> {
    let (rig, scene) = (rig(), everything());
    let world_from_camera = support::looking_at(TARGET, EYE).inverse();
    let without_ground = support::scene([real_box()].into_iter().chain(slabs()));
    let casters = [Kind::Phantom, Kind::Virtual].map(|kind| Occluders::new(triangles(&without_ground, kind)));
    let hides = Occluders::new(
        triangles(&without_ground, Kind::Phantom)
            .into_iter()
            .chain(triangles(&scene, Kind::Virtual)),
    );
    // Two texels around the lamp's own: nothing of the penumbra counts as lit or dark.
    let towards = light().1;
    let places: Vec<Vec3> = support::directions(24)
        .map(|offset| (towards + 0.03 * offset).normalize())
        .chain([towards])
        .collect();
    let lamp_past = |of: &Occluders, point: Vec3| {
        let n = places
            .iter()
            .filter(|&&towards| of.blocks(point, point + towards))
            .count();
        match n {
            0 => Lamp::All,
            n if n == places.len() => Lamp::Nothing,
            _ => Lamp::Part,
        }
    };
    let mut pixels = Vec::new();
    for index in 0..320 * 240usize {
        let middle = DVec2::new((index % 320) as f64, (index / 320) as f64);
        let ground_at = |dx: f64, dy: f64| {
            let ray = rig
                .scene_camera()
                .intrinsics
                .unproject(middle + DVec2::new(dx, dy))
                .unwrap();
            let direction = world_from_camera.transform_vector(ray);
            EYE - direction * (EYE.z / direction.z)
        };
        let corners = [(-1.5, -1.5), (1.5, -1.5), (-1.5, 1.5), (1.5, 1.5), (0.0, 0.0)].map(|(x, y)| ground_at(x, y));
        let reflectances = corners.map(|corner| support::ground_reflectance(&rig, corner));
        let is_even = reflectances.iter().all(|r| (r - reflectances[0]).abs() < 1e-6);
        let is_open = corners
            .iter()
            .all(|corner| !hides.blocks(EYE.as_vec3(), corner.as_vec3() + Vec3::Z * 1e-4));
        if is_even && is_open {
            let point = corners[4].as_vec3() + Vec3::Z * 1e-5;
            pixels.push(GroundPixel {
                index,
                lamp: [0, 1].map(|i: usize| lamp_past(&casters[i], point)),
                reflectance: reflectances[0],
            });
        }
    }
    pixels
}

/// Mean difference in codes per channel over pixels, as it is and without signs.
fn difference(a: &[u8], b: &[u8], pixels: &[&GroundPixel]) -> (Vec3, f32) {
    assert!(pixels.len() > 60, "only {} pixels", pixels.len());
    let (mut sum, mut absolute) = (Vec3::ZERO, 0.0);
    for pixel in pixels {
        let at = |codes: &[u8]| Vec3::from_array([0, 1, 2].map(|c| f32::from(codes[3 * pixel.index + c])));
        let difference = at(a) - at(b);
        sum += difference;
        absolute += difference.abs().element_sum() / 3.0;
    }
    (sum / pixels.len() as f32, absolute / pixels.len() as f32)
}

#[test]
fn a_virtual_shadow_in_a_real_one_is_as_dark_as_the_truth() {
    let Some(photographs) = photographs() else { return };
    for protection in [Protection::Off, Protection::Found] {
        let Some(codes) = composite(&[ground(), real_box()], protection) else {
            return;
        };
        save(&codes, &format!("exact_{protection:?}"));
        let pixels = ground_pixels();
        let select = |lamp: [Lamp; 2]| -> Vec<&GroundPixel> { pixels.iter().filter(|p| p.lamp == lamp).collect() };
        let double = select([Lamp::Nothing, Lamp::Nothing]);
        let (mean, absolute) = difference(&codes, &photographs.truth.pixels, &double);
        println!(
            "{protection:?}: both shadows, {} pixels: {mean} codes, {absolute} without sign",
            double.len()
        );
        for lamp in [
            [Lamp::Nothing, Lamp::All],
            [Lamp::All, Lamp::Nothing],
            [Lamp::All, Lamp::All],
        ] {
            let of = select(lamp);
            println!(
                "{lamp:?} {}: {:?}",
                of.len(),
                difference(&codes, &photographs.truth.pixels, &of)
            );
        }
        assert!(mean.abs().max_element() < 1.0, "{protection:?}: {mean} codes of 255");
    }
}

#[test]
fn a_real_thing_without_phantom_keeps_its_shadow_single() {
    let Some(photographs) = photographs() else { return };
    let pixels = ground_pixels();
    let double: Vec<&GroundPixel> = pixels
        .iter()
        .filter(|p| p.lamp == [Lamp::Nothing, Lamp::Nothing])
        .collect();
    let mut errors = Vec::new();
    for protection in [Protection::Off, Protection::Found] {
        let Some(codes) = composite(&[ground()], protection) else {
            return;
        };
        save(&codes, &format!("missing_{protection:?}"));
        let (mean, absolute) = difference(&codes, &photographs.truth.pixels, &double);
        println!("{protection:?}: {mean} codes, {absolute} without sign");
        errors.push(absolute);
    }
    assert!(errors[1] < 0.5 * errors[0], "{errors:?}");
}

#[test]
fn print_is_no_shadow() {
    let Some(off) = composite(&[ground(), real_box()], Protection::Off) else {
        return;
    };
    let Some(found) = composite(&[ground(), real_box()], Protection::Found) else {
        return;
    };
    let pixels = ground_pixels();
    let dark: Vec<&GroundPixel> = pixels.iter().filter(|p| p.lamp[1] == Lamp::Nothing).collect();
    let (ink, other): (Vec<_>, Vec<_>) = dark.into_iter().partition(|p| p.reflectance < 0.1);
    for (what, pixels) in [("ink", ink), ("paper and ground", other)] {
        let (mean, absolute) = difference(&found, &off, &pixels);
        println!("{what}, {} pixels: {mean} codes, {absolute} without sign", pixels.len());
        assert!(absolute < 1.0, "{what}: {absolute} codes");
    }
}
fn save(codes: &[u8], name: &str) {
    image::save_buffer(format!("/tmp/P/{name}.png"), codes, 320, 240, image::ColorType::Rgb8).unwrap();
    let p = photographs().unwrap();
    image::save_buffer(
        "/tmp/P/t_before.png",
        &p.before.pixels,
        320,
        240,
        image::ColorType::Rgb8,
    )
    .unwrap();
    image::save_buffer("/tmp/P/t_truth.png", &p.truth.pixels, 320, 240, image::ColorType::Rgb8).unwrap();
}
