//! The path tracer against truth: what it refuses, what it repeats, and what the lab makes of it.

use std::sync::OnceLock;

use glam::{Affine3A, Vec3, Vec4};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::lab::{Lab, LabFrame, LabPicture, MAP_SIZE};
use mirrorball_render::scene::{Material, Mesh, Scene, Vertex};
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::path::environment::Environment;
use mirrorball_render::shadow::path::run::PathRun;
use mirrorball_render::shadow::path::scene::TracedScene;
use mirrorball_render::shadow::path::{PathJob, PathPicture, PathSettings, PathTracer, PixelRays};
use mirrorball_render::shadow::view::View;

use crate::blocks;

/// Device and pass, made once for all tests.
pub(crate) struct Studio {
    pub(crate) gpu: Gpu,
    pub(crate) tracer: PathTracer,
}

pub(crate) fn studio() -> &'static Studio {
    static STUDIO: OnceLock<Studio> = OnceLock::new();
    STUDIO.get_or_init(|| {
        let gpu = Gpu::open().unwrap();
        Studio {
            tracer: PathTracer::new(&gpu),
            gpu,
        }
    })
}

impl Studio {
    pub(crate) fn scene(&self, meshes: &[(&str, Mesh)], settings: &PathSettings) -> TracedScene {
        let (scene, placements) = blocks::scene_of(meshes);
        TracedScene::new(&self.gpu, (&scene, &placements), settings.surfaces).unwrap()
    }

    pub(crate) fn picture(&self, meshes: &[(&str, Mesh)], job: &PathJob<'_>) -> PathPicture {
        let scene = self.scene(meshes, &job.settings);
        self.tracer.render(&self.gpu, &scene, job).unwrap()
    }
}

/// A job without light of its own.
pub(crate) fn job<'a>(view: &'a View, environment: Environment<'a>, settings: PathSettings) -> PathJob<'a> {
    PathJob {
        view,
        light: None,
        environment,
        settings,
        target: None,
    }
}

/// The mesh made of another material.
pub(crate) fn made_of(mesh: Mesh, change: impl Fn(&mut Material)) -> Mesh {
    let mut mesh = mesh;
    mesh.materials.iter_mut().for_each(change);
    mesh
}

/// A sphere with its true normals, without a seam.
pub(crate) fn sphere(center_m: Vec3, radius_m: f32, rings: u32) -> Mesh {
    let columns = 2 * rings;
    let mut mesh = Mesh {
        materials: blocks::floor(1.0).materials,
        ..Mesh::default()
    };
    for row in 0..=rings {
        let polar = std::f32::consts::PI * row as f32 / rings as f32;
        let sine = if row == rings { 0.0 } else { polar.sin() };
        for column in 0..columns {
            let azimuth = std::f32::consts::TAU * column as f32 / columns as f32;
            let normal = Vec3::new(sine * azimuth.cos(), sine * azimuth.sin(), polar.cos());
            mesh.vertices.push(Vertex {
                position: (center_m + radius_m * normal).to_array(),
                object: 0,
                normal: normal.to_array(),
                material: 0,
                ..Vertex::PLAIN
            });
        }
    }
    for row in 0..rings {
        for column in 0..columns {
            let [a, b] = [column, (column + 1) % columns].map(|c| row * columns + c);
            let [c, d] = [a + columns, b + columns];
            mesh.indices.extend([a, c, d, a, d, b]);
        }
    }
    mesh
}

/// Mean radiance of a picture and the standard error of that mean.
pub(crate) fn mean(picture: &PathPicture) -> (f32, f32) {
    let n = picture.radiance.len() as f32;
    let sum: f32 = picture.radiance.iter().map(|r| r.x).sum();
    let variance: f32 = picture.standard_error.iter().map(|e| e.x * e.x).sum();
    (sum / n, variance.sqrt() / n)
}

pub(crate) fn lamp() -> ShadowLight {
    ShadowLight::Rect {
        center_m: Vec3::new(0.4, -0.2, 1.2),
        half_u_m: Vec3::new(0.0, 0.25, 0.0),
        half_v_m: Vec3::new(0.2, 0.0, 0.1),
        radiance: Vec3::new(9.0, 8.0, 7.0),
    }
}

fn block_on_floor() -> [(&'static str, Mesh); 2] {
    [
        ("floor", blocks::floor(4.0)),
        (
            "block",
            blocks::block(Vec3::new(-0.2, -0.2, 0.0), Vec3::new(0.2, 0.2, 0.4)),
        ),
    ]
}

fn view(size: u32) -> View {
    View::looking_at(Vec3::new(0.3, -1.8, 1.4), Vec3::new(0.0, 0.0, 0.1), 0.8, [size; 2])
}

#[test]
fn without_things_there_is_sky_and_without_light_nothing() {
    let (studio, view) = (studio(), view(9));
    let sky = Vec3::new(0.25, 0.5, 0.75);
    let settings = PathSettings {
        samples: 2,
        ..PathSettings::default()
    };
    let empty = studio.picture(&[], &job(&view, Environment::Uniform(sky), settings));
    assert!(empty.radiance.iter().all(|&r| r == sky.extend(0.0)));
    assert!(empty.standard_error.iter().all(|&e| e == Vec3::ZERO));
    let dark = studio.picture(
        &block_on_floor(),
        &job(&view, Environment::Uniform(Vec3::ZERO), settings),
    );
    assert!(dark.radiance.iter().all(|r| r.truncate() == Vec3::ZERO));
    let black = Cube::filled(2, Vec3::ZERO);
    let black = studio.picture(&block_on_floor(), &job(&view, Environment::Cube(&black), settings));
    assert_eq!(black.radiance, dark.radiance);
}

#[test]
fn what_is_no_number_is_refused() {
    let (studio, view) = (studio(), view(9));
    let scene = studio.scene(&block_on_floor(), &PathSettings::default());
    let mut map = Cube::filled(4, Vec3::ONE);
    map.texels_mut()[7].y = f32::NAN;
    let mut wrong = job(&view, Environment::Cube(&map), PathSettings::default());
    let error = studio.tracer.render(&studio.gpu, &scene, &wrong).unwrap_err();
    assert!(error.to_string().contains("texel 7 of the environment"), "{error}");
    assert!(error.hint().unwrap().contains("repair the map"));
    let light = ShadowLight::Point {
        position_m: Vec3::new(f32::INFINITY, 0.0, 0.0),
        intensity: Vec3::ONE,
    };
    wrong.environment = Environment::Uniform(Vec3::ONE);
    wrong.light = Some(&light);
    let error = studio.tracer.render(&studio.gpu, &scene, &wrong).unwrap_err();
    assert!(error.to_string().contains("the light is no finite number"), "{error}");
    let flat = View {
        tangents: [0.0; 2],
        ..view
    };
    wrong.light = None;
    wrong.view = &flat;
    let error = studio.tracer.render(&studio.gpu, &scene, &wrong).unwrap_err();
    assert!(error.to_string().contains("the view"), "{error}");
    let (blocks, _) = blocks::scene_of(&block_on_floor());
    let error = TracedScene::new(&studio.gpu, (&blocks, &[]), PathSettings::default().surfaces).unwrap_err();
    assert!(error.to_string().contains("0 placements for 2 objects"), "{error}");
}

#[test]
fn broken_triangles_and_a_lamp_without_size_do_no_harm() {
    let studio = studio();
    let view = view(17);
    let mut broken = blocks::floor(1.0);
    broken.vertices[2].position = [f32::NAN; 3];
    let first = broken.vertices.len() as u32;
    let flat = broken.vertices[0];
    broken.vertices.extend([flat; 3]);
    broken.indices.extend([first, first + 1, first + 2]);
    let light = ShadowLight::Rect {
        center_m: Vec3::Z,
        half_u_m: Vec3::X,
        half_v_m: Vec3::ZERO,
        radiance: Vec3::ONE,
    };
    let settings = PathSettings {
        samples: 8,
        ..PathSettings::default()
    };
    let mut with_light = job(&view, Environment::Uniform(Vec3::ONE), settings);
    with_light.light = Some(&light);
    let mut meshes = block_on_floor().to_vec();
    let whole = studio.picture(&meshes, &with_light);
    meshes.push(("broken", broken));
    let picture = studio.picture(&meshes, &with_light);
    assert!(picture.radiance.iter().all(|r| r.is_finite()));
    let ((a, _), (b, _)) = (mean(&whole), mean(&picture));
    assert!((a - b).abs() < 1e-3, "{a} {b}");
}

#[test]
fn no_ray_slips_out_between_triangles() {
    let studio = studio();
    for middle in [Vec3::ZERO, Vec3::new(60.0, -20.0, 7.0)] {
        let black = made_of(sphere(middle, 0.5, 48), |m| m.base_color = [0.0; 3]);
        let view = View::looking_at(middle + 0.1, middle + Vec3::new(0.3, 0.4, -0.3), 2.2, [64; 2]);
        let settings = PathSettings {
            samples: 64,
            max_bounces: 1,
            ..PathSettings::default()
        };
        let inside = studio.picture(
            &[("ball", black)],
            &job(&view, Environment::Uniform(Vec3::ONE), settings),
        );
        let n_bright = inside.radiance.iter().filter(|r| **r != Vec4::W).count();
        assert_eq!(n_bright, 0, "around {middle}");
    }
}

#[test]
fn a_picture_comes_again_bit_for_bit_however_it_is_split() {
    let studio = studio();
    let view = view(24);
    let light = lamp();
    let settings = PathSettings {
        samples: 12,
        ..PathSettings::default()
    };
    let mut with_light = job(&view, Environment::Uniform(Vec3::splat(0.2)), settings);
    with_light.light = Some(&light);
    let scene = studio.scene(&block_on_floor(), &settings);
    let whole = studio.tracer.render(&studio.gpu, &scene, &with_light).unwrap();
    let mut run = PathRun::start(&studio.gpu, &studio.tracer, &scene, &with_light).unwrap();
    run.add(&studio.gpu, 5).unwrap();
    assert_eq!(run.samples(), 5);
    run.add(&studio.gpu, 7).unwrap();
    let split = run.picture(&studio.gpu).unwrap();
    assert_eq!(whole.radiance, split.radiance);
    assert_eq!(whole.standard_error, split.standard_error);
    with_light.settings.seed = 1;
    let other = studio.tracer.render(&studio.gpu, &scene, &with_light).unwrap();
    assert_ne!(whole.radiance, other.radiance);
}

#[test]
fn two_seeds_differ_by_no_more_than_their_standard_errors_say() {
    let studio = studio();
    let view = view(32);
    let light = lamp();
    let picture = |seed: u32| {
        let settings = PathSettings {
            samples: 32,
            max_bounces: 4,
            pixel: PixelRays::Center,
            seed,
            ..PathSettings::default()
        };
        let mut with_light = job(&view, Environment::Uniform(Vec3::splat(0.3)), settings);
        with_light.light = Some(&light);
        studio.picture(&block_on_floor(), &with_light)
    };
    let (one, other) = (picture(1), picture(2));
    let (mut difference, mut expected) = (0.0f64, 0.0f64);
    for i in 0..one.radiance.len() {
        difference += f64::from(one.radiance[i].x - other.radiance[i].x).powi(2);
        expected += f64::from(one.standard_error[i].x).powi(2) + f64::from(other.standard_error[i].x).powi(2);
    }
    assert!(expected > 0.0 && difference < 1.1 * expected, "{difference} {expected}");
    // The samples are spread evenly, so they do much better than independent ones.
    assert!(difference > 0.01 * expected, "{difference} {expected}");
}

fn lab_picture(lab: &mut Lab, light: &ShadowLight) -> LabPicture {
    let frame = LabFrame {
        method: ShadowMethod::PathTraced,
        map_size: MAP_SIZE,
        light,
        ambient: Vec3::splat(0.2),
        refreshes_max: usize::MAX,
    };
    lab.picture(&frame).unwrap()
}

#[test]
fn the_lab_draws_with_paths_and_follows_what_moves() {
    let (scene, placements): (Scene, Vec<Affine3A>) = blocks::scene_of(&block_on_floor());
    let view = view(24);
    let mut lab = Lab::new(Gpu::open().unwrap(), scene, placements, &view).unwrap();
    let light = lamp();
    let standing = lab_picture(&mut lab, &light);
    assert_eq!(standing.size_px, [24; 2]);
    let frame = LabFrame {
        method: ShadowMethod::PathTraced,
        map_size: MAP_SIZE,
        light: &light,
        ambient: Vec3::splat(0.2),
        refreshes_max: usize::MAX,
    };
    let traced = lab.path_traced(&frame, &PathSettings::default()).unwrap();
    for (drawn, traced) in standing.radiance.iter().zip(&traced.radiance) {
        assert!((*drawn - *traced).abs().max_element() < 2e-3 * traced.max_element() + 1e-4);
    }
    let moved = [Affine3A::IDENTITY, Affine3A::from_translation(Vec3::new(0.0, 0.0, 5.0))];
    lab.place(&moved);
    let gone = lab_picture(&mut lab, &light);
    let differences = standing.radiance.iter().zip(&gone.radiance);
    let n_changed = differences
        .filter(|&(a, b): &(&Vec4, &Vec4)| (*a - *b).abs().max_element() > 0.05)
        .count();
    assert!(n_changed > 20, "{n_changed}");
}
