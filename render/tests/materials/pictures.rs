//! Shaded spheres against the twins and the path tracer.

use glam::{DVec2, DVec3, Vec2, Vec3, Vec4, Vec4Swizzles};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::rig::Rig;
use mirrorball_render::config::{DiffuseMethod, Facets, LightConfig, SpecularMethod};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::light_maps::LightMaps;
use mirrorball_render::passes::ENVIRONMENT_SIZE;
use mirrorball_render::reference::material::{MeshPoint, substance};
use mirrorball_render::reference::substance_light::{SurfaceLight, sent_radiance};
use mirrorball_render::scene::{Kind, Material, Mesh, Scene, Vertex};
use mirrorball_render::shadow::path::environment::Environment;
use mirrorball_render::shadow::path::scene::TracedScene;
use mirrorball_render::shadow::path::{PathJob, PathSettings, PathTracer, Surfaces};
use mirrorball_render::shadow::view::View;

use crate::support::maps::{Maps, smooth_room};
use crate::support::stage::Stage;
use crate::support::{self, Errors};

pub(crate) const SPHERE_M: (Vec3, f32) = (Vec3::new(0.0, 0.0, 0.1), 0.05);

pub(crate) fn pose() -> mirrorball_calib::pose::Pose {
    support::looking_at(SPHERE_M.0.as_dvec3(), DVec3::new(0.1, -0.3, 0.25))
}

/// The shaded picture of a scene in the light of `environment`, and the GPU to go on with.
pub(crate) fn shaded(gpu: Gpu, scene: &Scene, diffuse: DiffuseMethod, environment: &Cube<Vec3>) -> (Vec<Vec4>, Gpu) {
    let rig = support::rig();
    let stage = Stage::new(gpu, &rig, scene, [64, 1]);
    let config = LightConfig {
        diffuse,
        specular: SpecularMethod::Ggx,
        ..LightConfig::default()
    };
    let sampler = stage.gpu.linear_sampler();
    let maps = LightMaps::new(&stage.gpu, &stage.environments, &config, (&stage.camera, &sampler));
    let mut lit = Maps { stage, maps };
    lit.make(environment);
    let pixels = lit.stage.shaded(&rig, &pose(), config);
    (pixels, lit.stage.gpu)
}

fn sphere_of(material: Material) -> Scene {
    let sphere = support::sphere(SPHERE_M.0, SPHERE_M.1, 48, material);
    support::scene([("sphere", Kind::Virtual, sphere)])
}

/// Unit normal of the sphere in a pixel and the direction to the eye, where the pixel lies well inside its outline.
fn on_sphere(pixel: DVec2, (center_m, radius_m): (Vec3, f32), rig: &Rig) -> Option<(Vec3, Vec3)> {
    let world_from_camera = pose().inverse();
    let ray = rig.scene_camera().intrinsics.unproject(pixel)?;
    let way = world_from_camera.transform_vector(ray).as_vec3().normalize();
    let eye = world_from_camera.translation.as_vec3() - center_m;
    let half = eye.dot(way);
    let root = half * half - eye.length_squared() + radius_m * radius_m;
    let normal = ((eye + (-half - root.max(0.0).sqrt()) * way) / radius_m).normalize();
    (root > 0.0 && normal.dot(-way) > 0.25).then_some((normal, -way))
}

/// Radiance 1 from all around.
const WHITE: SurfaceLight = SurfaceLight {
    irradiance: Vec3::splat(std::f32::consts::PI),
    mirrored: Vec3::ONE,
    coat_mirrored: Vec3::ONE,
    through: Vec3::ONE,
};

/// Metallic by roughness, as Khronos' test model has them, in white light: every pixel is what the twin says.
#[test]
fn spheres_of_all_metals_and_roughnesses_are_those_of_the_twin() {
    const RADIUS_M: f32 = 0.016;
    let Some(gpu) = support::gpu() else { return };
    let forward = (SPHERE_M.0 - pose().inverse().translation.as_vec3()).normalize();
    let right = forward.cross(Vec3::Z).normalize();
    let mut mesh = Mesh::default();
    let mut centers_m = Vec::new();
    for (column, metallic) in [(-1.0, 0.0), (0.0, 0.5), (1.0, 1.0)] {
        for (row, roughness) in [(-1.0, 0.0), (0.0, 0.4), (1.0, 1.0)] {
            let center_m = SPHERE_M.0 + 2.1 * RADIUS_M * (column * right + row * right.cross(forward));
            let sphere = support::sphere(
                center_m,
                RADIUS_M,
                32,
                Material {
                    base_color: [0.8, 0.5, 0.2],
                    metallic,
                    roughness,
                    dielectric_f0: [0.04; 3],
                    dielectric_f90: 1.0,
                    ..Material::default()
                },
            );
            let (first, material) = (mesh.vertices.len() as u32, centers_m.len() as u32);
            mesh.vertices
                .extend(sphere.vertices.iter().map(|v| Vertex { material, ..*v }));
            mesh.indices.extend(sphere.indices.iter().map(|i| first + i));
            mesh.materials.extend(sphere.materials);
            centers_m.push(center_m);
        }
    }
    let materials = mesh.materials.clone();
    let scene = support::scene([("spheres", Kind::Virtual, mesh)]);
    let white = Cube::filled(ENVIRONMENT_SIZE, Vec3::ONE);
    let (pixels, _) = shaded(gpu, &scene, DiffuseMethod::Sh9, &white);
    let rig = support::rig();
    let mut errors = Vec::new();
    for (index, found) in pixels.iter().enumerate() {
        let pixel = DVec2::new((index % 320) as f64, (index / 320) as f64);
        for (material, center_m) in materials.iter().zip(&centers_m) {
            let Some((normal, to_eye)) = on_sphere(pixel, (*center_m, RADIUS_M), &rig) else {
                continue;
            };
            assert_eq!(found.w, 1.0, "pixel {index} shows no sphere");
            let point = MeshPoint {
                normal,
                tangent: Vec4::X,
                uv: [Vec2::ZERO; 2],
                color: Vec4::ONE,
            };
            let expected = sent_radiance(&substance(material, &point), to_eye, &WHITE, Facets::Single);
            errors.push((found.xyz() - expected).abs().max_element());
        }
    }
    let errors = Errors::of("spheres", errors);
    assert!(errors.n > 9 * 300, "{errors:?}");
    // Facets of the spheres and pixels that are not as sharp as the mirror bend the light by some per cent.
    assert!(errors.mean < 0.005 && errors.worst < 0.05, "{errors:?}");
}

/// Light of harmonics on a matt sphere: every pixel is what the twin says.
#[test]
fn a_matt_sphere_in_a_room_is_that_of_the_twin() {
    let Some(gpu) = support::gpu() else { return };
    let room = smooth_room();
    let harmonics = mirrorball_render::reference::harmonics::IrradianceSh::from_cube(&room);
    let material = Material {
        base_color: [0.8, 0.5, 0.2],
        ..Material::default()
    };
    let (pixels, _) = shaded(gpu, &sphere_of(material.clone()), DiffuseMethod::Sh9, &room);
    let rig = support::rig();
    let errors = pixels.iter().enumerate().filter_map(|(index, found)| {
        let (normal, _) = on_sphere(DVec2::new((index % 320) as f64, (index / 320) as f64), SPHERE_M, &rig)?;
        let expected = Vec3::from(material.base_color) * harmonics.irradiance(normal) / std::f32::consts::PI;
        Some(((found.xyz() - expected) / expected).abs().max_element())
    });
    let errors = Errors::of("matt sphere, relative", errors);
    assert!(errors.mean < 0.005 && errors.worst < 0.03, "{errors:?}");
}

/// Means over a sphere in a room, the path tracer's beside ours.
#[test]
fn the_path_tracer_sees_the_same_spheres() {
    let Some(mut gpu) = support::gpu() else { return };
    let room = smooth_room();
    let glossy = |roughness| Material {
        base_color: [0.5, 0.3, 0.1],
        roughness,
        dielectric_f0: [0.04; 3],
        dielectric_f90: 1.0,
        ..Material::default()
    };
    let metal = |roughness| Material {
        base_color: [0.9, 0.7, 0.4],
        metallic: 1.0,
        roughness,
        ..Material::default()
    };
    // What is allowed: lobes around the mirrored direction in place of real ones, which lean to the normal.
    for (name, material, allowed) in [
        ("mirror", metal(0.0), 0.02),
        ("metal 0.5", metal(0.5), 0.04),
        ("glossy 0.3", glossy(0.3), 0.03),
        ("glossy 0.6", glossy(0.6), 0.06),
    ] {
        let scene = sphere_of(material);
        let (pixels, used) = shaded(gpu, &scene, DiffuseMethod::Sh9, &room);
        gpu = used;
        let ours = mean_of(pixels.into_iter());
        let traced = TracedScene::new(&gpu, (&scene, &[glam::Affine3A::IDENTITY]), Surfaces::AsGiven).expect("it fits");
        let eye = pose().inverse().translation.as_vec3();
        let job = PathJob {
            view: &View::looking_at(eye, SPHERE_M.0, 0.35, [64; 2]),
            light: None,
            environment: Environment::Cube(&room),
            settings: PathSettings {
                samples: 128,
                max_bounces: 2,
                ..PathSettings::default()
            },
            target: None,
        };
        let picture = PathTracer::new(&gpu)
            .render(&gpu, &traced, &job)
            .expect("the device works");
        let truth = mean_of(picture.radiance.into_iter());
        let off = ((ours - truth) / truth).abs().max_element();
        Errors::of(name, [off]);
        assert!(off < allowed, "{name}: {ours}, the path tracer {truth}");
    }
}

fn mean_of(pixels: impl Iterator<Item = Vec4>) -> Vec3 {
    let inside: Vec<Vec3> = pixels.filter(|p| p.w == 1.0).map(Vec4Swizzles::xyz).collect();
    assert!(inside.len() > 500, "the sphere covers {} pixels", inside.len());
    inside.iter().sum::<Vec3>() / inside.len() as f32
}
