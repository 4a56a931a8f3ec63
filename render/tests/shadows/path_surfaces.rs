//! What surfaces are made of: the path tracer against closed forms and integrals.

use glam::{DVec3, Vec3};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_render::scene::{Material, Mesh};
use mirrorball_render::shadow::path::environment::Environment;
use mirrorball_render::shadow::path::{PathSettings, PixelRays, Surfaces};
use mirrorball_render::shadow::view::View;

use crate::blocks;
use crate::path::{job, made_of, mean, sphere, studio};

const WHITE_SKY: Environment<'static> = Environment::Uniform(Vec3::ONE);

fn metal(color: f32, roughness: f32) -> impl Fn(&mut Material) {
    move |m| {
        m.base_color = [color; 3];
        m.metallic = 1.0;
        m.roughness = roughness;
    }
}

fn glass(material: &mut Material) {
    material.base_color = [1.0; 3];
    material.transmission = 1.0;
    material.ior = 1.5;
}

fn settings(samples: u32, max_bounces: u32) -> PathSettings {
    PathSettings {
        samples,
        max_bounces,
        ..PathSettings::default()
    }
}

/// Worst and mean difference from 1 of the pixels that show a surface.
fn from_one(picture: &mirrorball_render::shadow::path::PathPicture) -> (f32, f32) {
    let on_surface: Vec<f32> = picture
        .radiance
        .iter()
        .filter(|r| r.w == 1.0)
        .map(|r| r.x - 1.0)
        .collect();
    assert!(on_surface.len() > 20, "{}", on_surface.len());
    (
        on_surface.iter().fold(0.0, |worst, d| worst.max(d.abs())),
        on_surface.iter().sum::<f32>() / on_surface.len() as f32,
    )
}

/// In light that comes from everywhere alike, nothing that keeps all light can be seen.
#[test]
fn nothing_that_keeps_all_light_shows_in_a_white_sky() {
    let view = View::looking_at(Vec3::new(0.5, -2.0, 1.3), Vec3::new(0.0, 0.0, 0.2), 0.7, [16; 2]);
    let white = |m: &mut Material| m.base_color = [1.0; 3];
    let corner: Vec<(&str, Mesh)> = vec![
        ("floor", made_of(blocks::floor(4.0), white)),
        (
            "block",
            made_of(
                blocks::block(Vec3::new(-0.3, -0.3, 0.0), Vec3::new(0.3, 0.3, 0.5)),
                white,
            ),
        ),
        (
            "mirror",
            made_of(
                blocks::block(Vec3::new(0.4, -0.3, 0.0), Vec3::new(0.6, 0.3, 0.4)),
                metal(1.0, 0.0),
            ),
        ),
        ("ball", made_of(sphere(Vec3::new(-0.6, -0.4, 0.25), 0.2, 24), glass)),
    ];
    let (worst, mean) = from_one(&studio().picture(&corner, &job(&view, WHITE_SKY, settings(64, 100))));
    assert!(worst < 0.04 && mean.abs() < 2e-3, "{worst} {mean}");
    let near = View::looking_at(Vec3::new(0.0, -1.0, 0.3), Vec3::ZERO, 0.5, [16; 2]);
    let ball = [("ball", made_of(sphere(Vec3::ZERO, 0.3, 32), glass))];
    let (worst, mean) = from_one(&studio().picture(&ball, &job(&near, WHITE_SKY, settings(64, 100))));
    assert!(worst < 0.02 && mean.abs() < 2e-3, "glass: {worst} {mean}");
}

#[test]
fn a_half_white_block_is_half_as_bright_as_the_sky() {
    let view = View::looking_at(Vec3::new(0.5, -1.0, 0.8), Vec3::ZERO, 0.5, [16; 2]);
    let block = [("block", blocks::block(Vec3::splat(-0.2), Vec3::splat(0.2)))];
    let picture = studio().picture(&block, &job(&view, WHITE_SKY, settings(16, 8)));
    let inside = picture.radiance.iter().filter(|r| r.w == 1.0);
    assert!(inside.clone().count() > 40);
    assert!(inside.clone().all(|r| (r.x - 0.5).abs() < 1e-3));
}

/// Share of light from everywhere alike that a surface reflects towards `cosine`: GGX with Smith's shadowing and Schlick's
/// Fresnel term over a diffuse base, as glTF 2.0 appendix B writes it, summed over the hemisphere.
fn reflected_share(material: &Material, cosine: f64) -> f64 {
    const N: i32 = 1200;
    let alpha2 = f64::from(material.roughness).powi(4);
    let outgoing = DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    let schlick = |f0: f64, f90: f64, c: f64| f0 + (f90 - f0) * (1.0 - c).powi(5);
    let lambda = |c: f64| 0.5 * ((1.0 + alpha2 * (1.0 / (c * c) - 1.0)).sqrt() - 1.0);
    let metallic = f64::from(material.metallic);
    let base = f64::from(material.base_color[0]);
    let mut sum = 0.0;
    for i in 0..N {
        for j in 0..N {
            // Even steps of cos² and azimuth: every direction weighs the same times the cosine.
            let c = ((f64::from(i) + 0.5) / f64::from(N)).sqrt();
            let azimuth = std::f64::consts::PI * (f64::from(j) + 0.5) / f64::from(N);
            let s = (1.0 - c * c).sqrt();
            let incoming = DVec3::new(s * azimuth.cos(), s * azimuth.sin(), c);
            let middle = (outgoing + incoming).normalize();
            let facing = outgoing.dot(middle);
            let d = middle.z * middle.z * (alpha2 - 1.0) + 1.0;
            let facets = alpha2 / (std::f64::consts::PI * d * d);
            let dielectric = schlick(
                f64::from(material.dielectric_f0[0]),
                f64::from(material.dielectric_f90),
                facing,
            );
            let fresnel = (1.0 - metallic) * dielectric + metallic * schlick(base, 1.0, facing);
            let coat = fresnel * facets / (1.0 + lambda(cosine) + lambda(c)) / (4.0 * cosine * c);
            let diffuse = (1.0 - metallic) * base * (1.0 - dielectric) / std::f64::consts::PI;
            sum += (coat + diffuse) * std::f64::consts::PI / f64::from(N * N);
        }
    }
    sum
}

#[test]
fn rough_surfaces_reflect_what_their_integral_says() {
    let coated = |m: &mut Material| {
        m.roughness = 0.6;
        m.dielectric_f0 = [0.04; 3];
        m.dielectric_f90 = 1.0;
    };
    let kinds: [(&str, Mesh); 3] = [
        ("rough metal", made_of(blocks::floor(40.0), metal(1.0, 0.7))),
        ("brushed metal", made_of(blocks::floor(40.0), metal(0.8, 0.3))),
        ("coated", made_of(blocks::floor(40.0), coated)),
    ];
    for (name, floor) in kinds {
        for cosine in [0.95f32, 0.35] {
            let eye = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
            let view = View::looking_at(eye, Vec3::ZERO, 0.002, [8; 2]);
            let settings = PathSettings {
                pixel: PixelRays::Center,
                ..settings(512, 1)
            };
            let picture = studio().picture(&[(name, floor.clone())], &job(&view, WHITE_SKY, settings));
            let (found, error) = mean(&picture);
            let expected = reflected_share(&floor.materials[0], f64::from(cosine)) as f32;
            assert!(
                (found - expected).abs() < 4e-3 + 3.0 * error,
                "{name} at {cosine}: {found} ± {error}, not {expected}"
            );
            assert!(found < 1.01);
        }
    }
}

/// A sky in which every direction has its own colour.
fn sky() -> Cube<Vec3> {
    let mut map = Cube::filled(128, Vec3::ZERO);
    for i in 0..map.texels().len() {
        let direction = map.direction(i);
        map.texels_mut()[i] = 0.5 + 0.5 * direction;
    }
    map
}

#[test]
fn a_mirror_shows_the_sky_in_the_mirrored_direction() {
    let view = View::looking_at(Vec3::new(0.4, -1.5, 1.0), Vec3::ZERO, 0.6, [12; 2]);
    let map = sky();
    let settings = PathSettings {
        pixel: PixelRays::Center,
        ..settings(4, 2)
    };
    let floor = [("floor", made_of(blocks::floor(8.0), metal(0.9, 0.0)))];
    let picture = studio().picture(&floor, &job(&view, Environment::Cube(&map), settings));
    for (i, found) in picture.radiance.iter().enumerate() {
        let seen = direction_of(&view, i);
        let x = (1.0 + seen.z).powi(5);
        let expected = (0.9 + 0.1 * x) * (0.5 + 0.5 * seen * Vec3::new(1.0, 1.0, -1.0));
        assert!(
            (found.truncate() - expected).abs().max_element() < 0.02,
            "{found}, not {expected}"
        );
    }
}

/// Direction through the centre of a pixel.
fn direction_of(view: &View, pixel: usize) -> Vec3 {
    let [width, height] = view.size_px.map(|s| s as usize);
    let at = |k: usize, n: usize| (k as f32 + 0.5) / n as f32 * 2.0 - 1.0;
    let [x, y] = view.tangents;
    let in_camera = Vec3::new(at(pixel % width, width) * x, -at(pixel / width, height) * y, -1.0);
    view.camera_from_world
        .inverse()
        .transform_vector3(in_camera)
        .normalize()
}

/// Direction past a smooth boundary, and the share that is reflected there.
fn refracted(direction: Vec3, normal: Vec3, eta: f32) -> (Vec3, f32) {
    let cosine = -direction.dot(normal);
    let inner = (1.0 - eta * eta * (1.0 - cosine * cosine)).sqrt();
    let across = (eta * cosine - inner) / (eta * cosine + inner);
    let parallel = (cosine - eta * inner) / (cosine + eta * inner);
    (
        eta * direction + (eta * cosine - inner) * normal,
        0.5 * (across * across + parallel * parallel),
    )
}

#[test]
fn a_glass_ball_turns_the_sky_upside_down() {
    const RADIUS_M: f32 = 0.3;
    let view = View::looking_at(Vec3::new(0.0, -2.0, 0.0), Vec3::ZERO, 0.25, [13; 2]);
    let map = sky();
    let settings = PathSettings {
        pixel: PixelRays::Center,
        ..settings(512, 12)
    };
    let ball = [("ball", made_of(sphere(Vec3::ZERO, RADIUS_M, 64), glass))];
    let picture = studio().picture(&ball, &job(&view, Environment::Cube(&map), settings));
    let mut n_inside = 0;
    for (i, found) in picture.radiance.iter().enumerate() {
        let seen = direction_of(&view, i);
        let along = -view.eye_m.dot(seen);
        let miss2 = view.eye_m.length_squared() - along * along;
        if miss2 > 0.7 * RADIUS_M * RADIUS_M {
            continue;
        }
        n_inside += 1;
        let enter = view.eye_m + seen * (along - (RADIUS_M * RADIUS_M - miss2).sqrt());
        let normal = enter / RADIUS_M;
        let (inside, reflected) = refracted(seen, normal, 1.0 / 1.5);
        let leave = enter - inside * 2.0 * enter.dot(inside);
        let (through, kept) = refracted(inside, -leave / RADIUS_M, 1.5);
        let mirrored = seen - 2.0 * seen.dot(normal) * normal;
        let light = |direction: Vec3| map.bilinear(direction);
        let expected = reflected * light(mirrored) + (1.0 - reflected) * (1.0 - kept) * light(through);
        // What is left has been mirrored inside, at most once in 25 times.
        let rest = (1.0 - reflected) * kept;
        let difference = found.truncate() - expected;
        assert!(
            difference.min_element() > -0.02 && difference.max_element() < rest + 0.02,
            "{found}, not {expected}"
        );
        if seen.z.abs() > 0.05 {
            let sky_there = light(seen).z;
            assert!((found.z > 0.5) != (sky_there > 0.5), "{found} is not upside down");
        }
    }
    assert!(n_inside > 60, "{n_inside}");
}

#[test]
fn matt_surfaces_forget_what_they_are_made_of() {
    let view = View::looking_at(Vec3::new(0.4, -1.5, 1.0), Vec3::ZERO, 0.6, [8; 2]);
    let settings = PathSettings {
        surfaces: Surfaces::Matt,
        ..settings(4, 1)
    };
    let floor = [("floor", made_of(blocks::floor(8.0), metal(0.25, 0.0)))];
    let picture = studio().picture(&floor, &job(&view, WHITE_SKY, settings));
    assert!(picture.radiance.iter().all(|r| (r.x - 0.25).abs() < 1e-4));
}
