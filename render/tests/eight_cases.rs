//! All eight ways in which a shadow can fall: light real or virtual, blocker real or virtual, receiver real or virtual.
//!
//! One room shows them all. A real and a virtual block stand on real ground, a virtual slab lies before them, a real lamp
//! shines from the left and a virtual one from the right, so that either block throws a shadow of either lamp over both the
//! ground and the slab. The photograph is path traced: the real things in the real light, markers on the ground. The
//! reference is path traced with everything in it. What the node makes of the photograph is compared with it in each shadow.

mod support;

use std::sync::OnceLock;

use glam::{Affine3A, DVec2, DVec3, Vec3, Vec4};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::rig::Rig;
use mirrorball_capture::frame::{Frame, FrameSet};
use mirrorball_render::config::RenderConfig;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::node::RenderNode;
use mirrorball_render::scene::{Carrier, Kind, Lamp, LampKind, Mesh, Scene};
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::path::environment::Environment;
use mirrorball_render::shadow::path::scene::TracedScene;
use mirrorball_render::shadow::path::{PathJob, PathSettings, PathTracer, Surfaces};

const FROM: DVec3 = DVec3::new(0.03, -0.34, 0.42);
const AT: DVec3 = DVec3::new(0.03, 0.05, 0.0);
/// Radiance of the room in all directions.
const AROUND: f32 = 0.5;
/// Direction to the real lamp, and its irradiance on a surface that faces it.
const REAL_LAMP: Vec3 = Vec3::new(-1.0, 0.25, 1.1);
const REAL_IRRADIANCE: f32 = 3.0;
/// Place of the virtual lamp, and its irradiance 1 m away.
const VIRTUAL_LAMP_M: Vec3 = Vec3::new(0.6, 0.2, 0.6);
const VIRTUAL_INTENSITY: f32 = 2.0;
/// Corners of the blocks and of the slab, metres.
const REAL_BLOCK: Block = Block([-0.09, 0.08, 0.0], [-0.05, 0.17, 0.06]);
const VIRTUAL_BLOCK: Block = Block([0.10, 0.08, 0.0], [0.14, 0.17, 0.06]);
const SLAB: Block = Block([-0.20, 0.065, 0.0], [0.25, 0.12, 0.006]);

/// Corners of an upright box.
#[derive(Clone, Copy)]
struct Block([f32; 3], [f32; 3]);

impl Block {
    fn mesh(self, albedo: f32) -> Mesh {
        let (low, high) = (Vec3::from(self.0), Vec3::from(self.1));
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let mut mesh = Mesh {
            materials: vec![support::diffuse(albedo)],
            ..Mesh::default()
        };
        for axis in 0..3 {
            for sign in [-1.0f32, 1.0] {
                let mut normal = Vec3::ZERO;
                normal[axis] = sign;
                let mut u = Vec3::ZERO;
                u[(axis + 1) % 3] = 1.0;
                let face = support::square(middle + half * normal, half * u, half * normal.cross(u));
                let first = mesh.vertices.len() as u32;
                mesh.vertices.extend(face.vertices);
                mesh.indices.extend(face.indices.iter().map(|i| first + i));
            }
        }
        mesh
    }

    /// Distances at which a ray enters and leaves.
    fn span(self, from: Vec3, direction: Vec3) -> Option<(f32, f32)> {
        let one = (Vec3::from(self.0) - from) / direction;
        let other = (Vec3::from(self.1) - from) / direction;
        let (enters, leaves) = (one.min(other).max_element(), one.max(other).min_element());
        (enters <= leaves && leaves > 0.0).then_some((enters, leaves))
    }

    fn blocks(self, from: Vec3, towards: Vec3) -> bool {
        self.span(from, towards).is_some_and(|(_, leaves)| leaves > 1e-4)
    }
}

/// What a pixel's ray meets first.
#[derive(Clone, Copy, PartialEq)]
enum Met {
    Ground,
    Slab,
    Else,
}

fn ray(pixel: DVec2) -> Vec3 {
    let in_camera = ((pixel - DVec2::new(159.5, 119.5)) / support::PINHOLE_FOCAL_PX).extend(1.0);
    support::looking_at(AT, FROM)
        .inverse()
        .transform_vector(in_camera)
        .as_vec3()
}

/// What a ray meets and where, in the room with everything.
fn first(pixel: DVec2) -> (Met, Vec3) {
    let (from, ray) = (FROM.as_vec3(), ray(pixel));
    let mut found = (Met::Else, f32::INFINITY);
    if ray.z < 0.0 {
        found = (Met::Ground, -from.z / ray.z);
    }
    for (block, met) in [(SLAB, Met::Slab), (REAL_BLOCK, Met::Else), (VIRTUAL_BLOCK, Met::Else)] {
        if let Some((distance, _)) = block.span(from, ray).filter(|(enters, _)| *enters < found.1) {
            found = (met, distance);
        }
    }
    let point = from + ray * found.1;
    if found.0 == Met::Slab && (point.z - SLAB.1[2]).abs() > 1e-4 {
        found.0 = Met::Else;
    }
    (found.0, point)
}

/// The light of the room: the same from everywhere, and a lamp.
fn room() -> Cube<Vec3> {
    let cube = support::cube_of(64, |d| d.angle_between(REAL_LAMP) < 0.04);
    let area: f32 = (0..cube.texels().len())
        .filter(|&i| cube.texels()[i])
        .map(|i| cube.solid_angle(i))
        .sum();
    cube.map(|&is_lamp| {
        Vec3::splat(if is_lamp {
            AROUND + REAL_IRRADIANCE / area
        } else {
            AROUND
        })
    })
}

fn virtual_lamp() -> Lamp {
    Lamp {
        name: "lamp".into(),
        kind: LampKind::Point { radius_m: 0.0 },
        irradiance: Vec3::splat(VIRTUAL_INTENSITY),
        carrier: Carrier::World,
        position_m: VIRTUAL_LAMP_M,
        direction: Vec3::NEG_Z,
        across: Vec3::X,
    }
}

fn ground() -> Mesh {
    support::square(Vec3::ZERO, Vec3::X, Vec3::Y)
}

fn real_things() -> Vec<(&'static str, Kind, Mesh)> {
    vec![
        ("ground", Kind::Phantom, ground()),
        ("real block", Kind::Phantom, REAL_BLOCK.mesh(0.5)),
    ]
}

fn virtual_things() -> Vec<(&'static str, Kind, Mesh)> {
    vec![
        ("virtual block", Kind::Virtual, VIRTUAL_BLOCK.mesh(0.5)),
        ("slab", Kind::Virtual, SLAB.mesh(0.6)),
    ]
}

/// A path-traced photograph, markers on the ground where nothing stands on it.
fn photograph(gpu: &Gpu, rig: &Rig, scene: &Scene, light: Option<&ShadowLight>) -> Frame {
    let camera = rig.scene_camera();
    let view = support::pinhole_view(FROM, AT);
    let settings = PathSettings {
        samples: SAMPLES,
        max_bounces: 3,
        surfaces: Surfaces::AsGiven,
        ..PathSettings::default()
    };
    let placements = vec![Affine3A::IDENTITY; scene.objects.len()];
    let traced = TracedScene::new(gpu, (scene, &placements), settings.surfaces).expect("a small scene");
    let room = room();
    let job = PathJob {
        view: &view,
        light,
        environment: Environment::Cube(&room),
        settings,
        target: None,
    };
    let picture = PathTracer::new(gpu)
        .render(gpu, &traced, &job)
        .expect("the device works");
    let signal = camera.photometry.signal_per_radiance(&support::EXPOSURE);
    let blocks: Vec<Block> = match scene.objects.len() {
        2 => vec![REAL_BLOCK],
        _ => vec![REAL_BLOCK, VIRTUAL_BLOCK, SLAB],
    };
    let codes = |(index, radiance): (usize, &Vec4)| {
        let markers = marker_factor(rig, index, &blocks);
        let y = |channel: usize| f64::from(radiance[channel]) * markers * signal[channel];
        [0, 1, 2].map(|channel| camera.photometry.response.encode(y(channel)))
    };
    support::frame_of(camera, 7, picture.radiance.iter().enumerate().flat_map(codes).collect())
}

/// Paths per pixel: noise of about a code in the middle of the range.
const SAMPLES: u32 = 32;

/// What markers make of a pixel's radiance, relative to plain ground.
fn marker_factor(rig: &Rig, index: usize, blocks: &[Block]) -> f64 {
    const N: i32 = 4;
    let middle = DVec2::new((index % 320) as f64, (index / 320) as f64);
    let mut sum = 0.0;
    for i in 0..N * N {
        let offset = (DVec2::new(f64::from(i % N), f64::from(i / N)) + 0.5) / f64::from(N) - 0.5;
        let ray = ray(middle + offset);
        let is_ground = ray.z < 0.0 && !blocks.iter().any(|b| b.span(FROM.as_vec3(), ray).is_some());
        sum += if is_ground {
            let point = FROM.as_vec3() - ray * (FROM.z as f32 / ray.z);
            support::ground_reflectance(rig, point.as_dvec3()) / 0.4
        } else {
            1.0
        };
    }
    sum / f64::from(N * N)
}

/// What the node makes of a photograph.
fn composite(rig: &Rig, scene: &Scene, frame: &Frame) -> Vec<u8> {
    let gpu = support::gpu().expect("there was one");
    let mut node = RenderNode::new(gpu, rig.clone(), scene, RenderConfig::default())
        .expect("the rig has a probe")
        .with_light(room());
    let probe = support::frame(rig.probe_camera().expect("the rig has a probe camera"), 7, 1, |_| {
        DVec3::splat(f64::from(AROUND))
    });
    let set = FrameSet {
        frames: vec![frame.clone(), probe],
    };
    let rendered = node.render(&set).expect("the frames fit the rig");
    assert!(rendered.pose.camera_from_world().is_some(), "the markers are found");
    rgb(&rendered.rgba)
}

fn rgb(rgba: &[u8]) -> Vec<u8> {
    rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect()
}

/// All pictures, 8-bit RGB.
struct Pictures {
    photo: Vec<u8>,
    reference: Vec<u8>,
    whole: Vec<u8>,
    /// Without the phantom of the real block, and without the virtual block.
    unblocked: [Vec<u8>; 2],
    /// Of the real things alone, no lamp.
    nothing_virtual: Vec<u8>,
}

fn pictures() -> Option<&'static Pictures> {
    static PICTURES: OnceLock<Option<Pictures>> = OnceLock::new();
    PICTURES
        .get_or_init(|| {
            let gpu = support::gpu()?;
            let rig = support::pinhole_rig();
            let scene = |without: &str| {
                let things = real_things().into_iter().chain(virtual_things());
                let mut scene = support::scene(things.filter(|(name, ..)| *name != without));
                scene.lamps.push(virtual_lamp());
                scene
            };
            let real = support::scene(real_things());
            let light = ShadowLight::Point {
                position_m: VIRTUAL_LAMP_M,
                intensity: Vec3::splat(VIRTUAL_INTENSITY),
            };
            let photo = photograph(&gpu, &rig, &real, None);
            let reference = photograph(&gpu, &rig, &scene(""), Some(&light));
            let made = |scene: &Scene| composite(&rig, scene, &photo);
            let pictures = Pictures {
                whole: made(&scene("")),
                unblocked: [made(&scene("real block")), made(&scene("virtual block"))],
                nothing_virtual: made(&real),
                photo: photo.pixels.to_vec(),
                reference: reference.pixels.to_vec(),
            };
            write(&pictures);
            Some(pictures)
        })
        .as_ref()
}

/// Leaves the pictures to be looked at, beside the test's binaries.
fn write(pictures: &Pictures) {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"));
    for (name, pixels) in [
        ("photo", &pictures.photo),
        ("reference", &pictures.reference),
        ("whole", &pictures.whole),
        ("unblocked_real", &pictures.unblocked[0]),
        ("unblocked_virtual", &pictures.unblocked[1]),
    ] {
        let file = folder.join(format!("eight_cases_{name}.png"));
        image::save_buffer(file, pixels, 320, 240, image::ExtendedColorType::Rgb8).expect("the folder can be written");
    }
}

/// One way for a shadow to fall.
#[derive(Debug, Clone, Copy)]
struct Case {
    light: Kind,
    blocker: Kind,
    receiver: Kind,
}

impl Case {
    /// Pixels on the receiver in the shadow that the blocker, and not the other block, throws of the light.
    fn pixels(self) -> Vec<usize> {
        let receiver = match self.receiver {
            Kind::Phantom => Met::Ground,
            Kind::Virtual => Met::Slab,
        };
        let (blocker, other) = match self.blocker {
            Kind::Phantom => (REAL_BLOCK, VIRTUAL_BLOCK),
            Kind::Virtual => (VIRTUAL_BLOCK, REAL_BLOCK),
        };
        let is_shaded = |index: &usize| {
            let middle = DVec2::new((index % 320) as f64, (index / 320) as f64);
            let (_, point) = first(middle);
            let towards = match self.light {
                Kind::Phantom => REAL_LAMP,
                Kind::Virtual => VIRTUAL_LAMP_M - point,
            };
            // The pixel shows nothing but the receiver.
            let is_whole = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
                .iter()
                .all(|&(dx, dy)| first(middle + DVec2::new(dx, dy)).0 == receiver);
            is_whole && blocker.blocks(point, towards) && !other.blocks(point, towards)
        };
        (0..320 * 240).filter(is_shaded).collect()
    }
}

/// PSNR in dB over some pixels of 8-bit pictures, and mean signed difference in codes.
fn compared(one: &[u8], other: &[u8], pixels: &[usize]) -> (f64, f64) {
    let differences = || {
        pixels
            .iter()
            .flat_map(|&i| (3 * i..3 * i + 3).map(|c| f64::from(one[c]) - f64::from(other[c])))
    };
    let n = 3.0 * pixels.len() as f64;
    let square: f64 = differences().map(|d| d * d).sum::<f64>() / n;
    (
        10.0 * (255.0 * 255.0 / square.max(1e-9)).log10(),
        differences().sum::<f64>() / n,
    )
}

#[test]
fn every_shadow_is_that_of_the_path_tracer() {
    let Some(pictures) = pictures() else { return };
    let kinds = [Kind::Phantom, Kind::Virtual];
    let cases = kinds
        .into_iter()
        .flat_map(|light| {
            kinds.map(|blocker| {
                kinds.map(|receiver| Case {
                    light,
                    blocker,
                    receiver,
                })
            })
        })
        .flatten();
    let mut failed = Vec::new();
    for case in cases {
        let pixels = case.pixels();
        let unblocked = &pictures.unblocked[usize::from(case.blocker == Kind::Virtual)];
        let (found_db, bias) = compared(&pictures.whole, &pictures.reference, &pixels);
        let (without_db, _) = compared(unblocked, &pictures.reference, &pixels);
        let line = format!(
            "{case:?}: {found_db:.1} dB, mean {bias:+.2} codes over {} pixels; {without_db:.1} dB without the shadow",
            pixels.len()
        );
        println!("{line}");
        let is_all_real =
            case.light == Kind::Phantom && case.blocker == Kind::Phantom && case.receiver == Kind::Phantom;
        // A shadow in the picture is there whether or not the phantom is.
        let is_told_apart = is_all_real || without_db < found_db - 8.0;
        if pixels.len() < 150 || found_db < 30.0 || !is_told_apart {
            failed.push(line);
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn the_photograph_alone_stays_as_it_is_bit_for_bit() {
    let Some(pictures) = pictures() else { return };
    assert!(
        pictures.nothing_virtual == pictures.photo,
        "light, blocker and receiver are real: nothing is to be added"
    );
    let all_real = Case {
        light: Kind::Phantom,
        blocker: Kind::Phantom,
        receiver: Kind::Phantom,
    };
    assert!(all_real.pixels().len() > 150, "the shadow is in the picture");
}
