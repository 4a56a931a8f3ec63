//! Where a virtual shadow falls into a real one nothing darkens twice: composites against path-traced pictures.
//!
//! One lamp and a sky light a box and a slab over the ground; the path tracer takes the photograph and the truth.

mod support;

use glam::{Affine3A, DVec2, DVec3, Vec3, Vec4};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::rig::Rig;
use mirrorball_capture::frame::{Frame, FrameSet};
use mirrorball_render::config::{PhantomEdges, Protection, RenderConfig};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::readback::Readback;
use mirrorball_render::node::RenderNode;
use mirrorball_render::passes::protect::GpuCell;
use mirrorball_render::reference::protect::verdict;
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
    Rig::from_toml(&text, Path::new("rig.toml")).expect("the rig of the tests is valid")
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
type Thing = (&'static str, Kind, Mesh);

fn ground() -> Thing {
    ("ground", Kind::Phantom, support::square(Vec3::ZERO, Vec3::X, Vec3::Y))
}

fn real_box() -> Thing {
    box_at(Vec3::new(-0.125, 0.145, 0.035))
}

fn box_at(middle: Vec3) -> Thing {
    ("box", Kind::Phantom, block(middle, Vec3::new(0.025, 0.025, 0.035)))
}

/// A block that the box hides a part of.
fn block_behind() -> Thing {
    let mesh = block(Vec3::new(-0.11, 0.23, 0.045), Vec3::new(0.06, 0.02, 0.045));
    ("block", Kind::Virtual, mesh)
}

/// One slab over the box's shadow, one over a marker; black, as the light that they would scatter is another question.
fn slabs() -> [Thing; 2] {
    let slab = |middle| {
        let mut mesh = block(middle, Vec3::new(0.03, 0.03, 0.008));
        mesh.materials = vec![support::diffuse(0.02)];
        mesh
    };
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

/// Photographs by the path tracer.
struct Photographs {
    /// Without virtual objects.
    before: Frame,
    /// With the slabs.
    truth: Frame,
    /// With the block behind the box.
    block: Frame,
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
                let traced = TracedScene::new(&gpu, (scene, &placements), settings.surfaces).expect("the scene fits");
                let height_rad = 2.0 * (120.0f32 / 320.0).atan();
                let job = PathJob {
                    view: &View::looking_at(EYE.as_vec3(), TARGET.as_vec3(), height_rad, [320, 240]),
                    light: None,
                    environment: Environment::Cube(&light().0),
                    settings,
                    target: None,
                };
                let picture = tracer.render(&gpu, &traced, &job).expect("the device works");
                let radiance: Vec<Vec3> = picture.radiance.iter().map(|r| r.truncate()).collect();
                developed(scene, &radiance)
            };
            Some(Photographs {
                before: take(&support::scene([ground(), real_box()])),
                truth: take(&everything()),
                block: take(&support::scene([ground(), real_box(), block_behind()])),
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

/// Settings for the light's cube.
fn config() -> RenderConfig {
    let mut config = RenderConfig::default();
    config.probe.cube_size = CUBE;
    config
}

/// The slabs in the photograph by the renderer that knows `phantoms`.
fn composite(phantoms: &[Thing], protection: Protection) -> Option<Vec<u8>> {
    let mut config = config();
    config.shadow.protection = protection;
    let scene = support::scene(phantoms.iter().cloned().chain(slabs()));
    rendered(&scene, config)
}

/// The virtual objects of `scene` in the photograph.
fn rendered(scene: &Scene, config: RenderConfig) -> Option<Vec<u8>> {
    let rig = rig();
    let mut node = RenderNode::new(support::gpu()?, rig.clone(), scene, config)
        .expect("the rig has a probe")
        .with_light(light().0);
    let probe = support::frame(rig.probe_camera().expect("the rig has a probe camera"), 3, 1, |_| {
        DVec3::splat(1.0)
    });
    let frames = vec![photographs()?.before.clone(), probe];
    let frame = node.render(&FrameSet { frames }).expect("the frames fit the rig");
    let pose = frame.pose.camera_from_world().expect("the markers are seen");
    let off_m = (pose.inverse().translation - EYE).length();
    assert!(off_m < 2e-3, "the camera is {off_m} m off");
    Some(frame.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect())
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
                .expect("every pixel has a ray");
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
fn difference(what: &str, [a, b]: [&[u8]; 2], pixels: &[&GroundPixel]) -> (Vec3, f32) {
    assert!(pixels.len() > 60, "{what}: only {} pixels", pixels.len());
    let at = |codes: &[u8], i: usize| Vec3::from_array([0, 1, 2].map(|c| f32::from(codes[3 * i + c])));
    let differences: Vec<Vec3> = pixels.iter().map(|p| at(a, p.index) - at(b, p.index)).collect();
    let mean = differences.iter().sum::<Vec3>() / pixels.len() as f32;
    let absolute = support::Errors::of(
        &format!("{what}, {mean} codes, without signs"),
        differences.iter().map(|d| d.abs().element_sum() / 3.0),
    );
    (mean, absolute.mean)
}

/// Those of the pixels that get this much of the lamp past the box and past the slabs.
fn with_lamp(pixels: &[GroundPixel], lamp: [Lamp; 2]) -> Vec<&GroundPixel> {
    pixels.iter().filter(|p| p.lamp == lamp).collect()
}

#[test]
fn a_virtual_shadow_in_a_real_one_is_as_dark_as_the_truth() {
    let Some(photographs) = photographs() else { return };
    let Some(codes) = composite(&[ground(), real_box()], Protection::Found) else {
        return;
    };
    let pixels = ground_pixels();
    let double = with_lamp(&pixels, [Lamp::Nothing, Lamp::Nothing]);
    let (mean, _) = difference("both shadows", [&codes, &photographs.truth.pixels], &double);
    assert!(mean.abs().max_element() < 1.0, "{mean} codes of 255");
}

#[test]
fn a_real_thing_without_phantom_keeps_its_shadow_single() {
    let Some(photographs) = photographs() else { return };
    let pixels = ground_pixels();
    let double = with_lamp(&pixels, [Lamp::Nothing, Lamp::Nothing]);
    let mut errors = Vec::new();
    for protection in [Protection::Off, Protection::Found] {
        let Some(codes) = composite(&[ground()], protection) else {
            return;
        };
        let what = format!("no phantom, {protection:?}");
        errors.push(difference(&what, [&codes, &photographs.truth.pixels], &double).1);
    }
    assert!(errors[1] < 0.5 * errors[0], "{errors:?}");
}

#[test]
fn print_is_no_shadow() {
    let Some(photographs) = photographs() else { return };
    let Some(off) = composite(&[ground(), real_box()], Protection::Off) else {
        return;
    };
    let Some(found) = composite(&[ground(), real_box()], Protection::Found) else {
        return;
    };
    let pixels = ground_pixels();
    let shaded = |from: f64, to: f64| -> Vec<&GroundPixel> {
        let is_shaded = |p: &&GroundPixel| p.lamp[1] == Lamp::Nothing && (from..to).contains(&p.reflectance);
        pixels.iter().filter(is_shaded).collect()
    };
    for (what, reflectance) in [("ink", [0.0, 0.1]), ("paper", [0.7, 1.0])] {
        let (_, absolute) = difference(what, [&found, &off], &shaded(reflectance[0], reflectance[1]));
        assert!(absolute < 1.0, "{what}: {absolute} codes");
    }
    // Beside print the edges of the box's shadow become better.
    let ground = shaded(0.3, 0.5);
    let errors = [off, found].map(|codes| difference("ground", [&codes, &photographs.truth.pixels], &ground).1);
    assert!(errors[1] <= errors[0], "{errors:?}");
}

/// Pixels within three of the edge where the box hides the block.
fn edge_pixels() -> Vec<usize> {
    const REACH: i32 = 3;
    let rig = rig();
    let world_from_camera = support::looking_at(TARGET, EYE).inverse();
    let [box_mesh, block_mesh] = [real_box(), block_behind()].map(|thing| {
        let kind = thing.1;
        Occluders::new(triangles(&support::scene([thing]), kind))
    });
    // Whether the box hides the block; `None` where there is no block.
    let hidden = |x: i32, y: i32| -> Option<bool> {
        let ray = rig
            .scene_camera()
            .intrinsics
            .unproject(DVec2::new(x.into(), y.into()))?;
        let direction = world_from_camera.transform_vector(ray).as_vec3().normalize();
        let block_m = block_mesh.distance_m(EYE.as_vec3(), direction, 0.0)?;
        let box_m = box_mesh.distance_m(EYE.as_vec3(), direction, 0.0);
        Some(box_m.is_some_and(|box_m| box_m < block_m))
    };
    let mut pixels = Vec::new();
    for y in REACH..240 - REACH {
        for x in REACH..320 - REACH {
            let around: Option<Vec<bool>> = (-REACH..=REACH)
                .flat_map(|step| [hidden(x + step, y), hidden(x, y + step)])
                .collect();
            if around.is_some_and(|around| around.contains(&true) && around.contains(&false)) {
                pixels.push((320 * y + x) as usize);
            }
        }
    }
    pixels
}

#[test]
fn the_edge_of_a_phantom_that_is_off_is_where_the_picture_has_it() {
    let Some(photographs) = photographs() else { return };
    let pixels = edge_pixels();
    assert!(pixels.len() > 100, "{} pixels", pixels.len());
    let mut errors = Vec::new();
    // Right, and 1.5 pixels off.
    for off_m in [0.0, 0.0027] {
        let phantom = box_at(Vec3::new(-0.125 + off_m, 0.145, 0.035));
        let scene = support::scene([ground(), phantom, block_behind()]);
        for edges in [PhantomEdges::Mesh, PhantomEdges::Picture] {
            let mut config = config();
            config.view.phantom_edges = edges;
            let Some(codes) = rendered(&scene, config) else { return };
            let differences = pixels
                .iter()
                .flat_map(|&i| [0, 1, 2].map(|c| 3 * i + c))
                .map(|i| f32::from(codes[i]) - f32::from(photographs.block.pixels[i]));
            errors.push(support::Errors::of(&format!("{off_m} m off, {edges:?}"), differences).mean);
        }
    }
    // What is wrong with the right mesh is light and noise, not the edge.
    let [right, right_refined, off, off_refined] = [errors[0], errors[1], errors[2], errors[3]];
    assert!(off_refined - right < 0.6 * (off - right), "{errors:?}");
    assert!(right_refined < 1.05 * right, "{errors:?}");
}

/// Cells of two planes and three reflectances, some of them shaded.
fn cells(n: usize) -> Vec<GpuCell> {
    let cell = |i: usize| {
        let random = |step: usize| support::spread(step * i, 0.1) as f32;
        let share = Vec3::new(0.75, 0.7, 0.6) * (0.5 + 0.5 * random(1));
        let reflectance = [0.1, 0.4, 0.8][(3.0 * random(3)) as usize] * (1.0 + 0.1 * random(5));
        let left = if random(7) < 0.3 { 1.0 - share } else { Vec3::ONE };
        let height_m = if random(19) < 0.4 { 0.002 } else { 0.0 };
        GpuCell {
            log_reflectance: (reflectance * left).map(f32::ln).extend(f32::from(random(11) > 0.1)),
            share: share.extend(0.0),
            place_m: Vec4::new(random(13), random(17), height_m, 1.0),
            normal: Vec4::Z,
        }
    };
    (0..n).map(cell).collect()
}

/// What `protect_vote` says of a grid of cells: columns, rows, every so many-th is asked.
fn verdicts(gpu: &Gpu, grid: [u32; 4], cells: &[GpuCell]) -> Vec<Vec4> {
    let out = Readback::new(gpu, "test: verdicts", size_of_val(cells) as u64 / 4);
    let pipeline = gpu.compute_pipeline("protect_vote");
    let bindings = gpu.bind(
        "test",
        &pipeline.get_bind_group_layout(0),
        &[
            gpu.buffer("test: grid", &[grid]).as_entire_binding(),
            gpu.buffer("test: cells", cells).as_entire_binding(),
            out.buffer().as_entire_binding(),
        ],
    );
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups((cells.len() as u32).div_ceil(64), 1, 1);
    }
    out.record(&mut encoder);
    gpu.queue.submit([encoder.finish()]);
    let mut found = vec![Vec4::ZERO; cells.len()];
    out.read(gpu, &mut found).expect("the device works");
    found
}

#[test]
fn cells_are_judged_as_by_the_reference() {
    let Some(gpu) = support::gpu() else { return };
    let grid = [24u32, 18, 2, 0];
    let cells = cells((grid[0] * grid[1]) as usize);
    let is_asked = |i: usize| {
        let (x, y) = (i as u32 % grid[0], i as u32 / grid[0]);
        x % grid[2] == grid[2] / 2 && y % grid[2] == grid[2] / 2
    };
    let asked: Vec<GpuCell> = (0..cells.len()).filter(|&i| is_asked(i)).map(|i| cells[i]).collect();
    let expected: Vec<Vec4> = cells.iter().map(|cell| verdict(cell, &asked)).collect();
    let believing = expected.iter().filter(|v| v.w > 0.0).count();
    assert!(believing > 20 && believing < cells.len() / 2, "{believing}");
    let found = verdicts(&gpu, grid, &cells);
    let errors = support::Errors::of(
        "verdicts",
        found.iter().zip(&expected).map(|(f, e)| (*f - *e).abs().max_element()),
    );
    assert!(errors.worst < 1e-3, "{errors:?}");
}
