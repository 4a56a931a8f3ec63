//! The shadow scene without shadows: places, and light of known irradiance.

use glam::Vec3;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::lab::{Lab, LabFrame, LabPicture, MAP_SIZE};
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::view::View;

use crate::blocks;

fn floor_from_above() -> Lab {
    let (scene, placements) = blocks::scene_of(&[("floor", blocks::floor(4.0))]);
    let view = View::looking_at(Vec3::new(0.0, 0.0, 2.0), Vec3::ZERO, 1.0, [65, 65]);
    Lab::new(Gpu::open().unwrap(), scene, placements, &view).unwrap()
}

fn picture(light: &ShadowLight, ambient: Vec3) -> (LabPicture, Vec<glam::Vec4>) {
    let mut lab = floor_from_above();
    let frame = LabFrame {
        method: ShadowMethod::None,
        map_size: MAP_SIZE,
        light,
        ambient,
        refreshes_max: usize::MAX,
    };
    (lab.picture(&frame).unwrap(), lab.places().unwrap())
}

#[test]
fn the_middle_of_the_picture_is_what_the_view_looks_at() {
    let light = ShadowLight::Directional {
        towards: Vec3::Z,
        irradiance: Vec3::ONE,
    };
    let (picture, places) = picture(&light, Vec3::splat(0.25));
    assert!(places[32 * 65 + 32].truncate().length() < 1e-4);
    let expected = 0.5 * (1.0 / std::f32::consts::PI + 0.25);
    assert!((picture.radiance[32 * 65 + 32].x - expected).abs() < 1e-3);
}

#[test]
fn a_rectangle_gives_the_floor_what_its_sum_over_points_gives() {
    // Half of it below the floor's horizon at the picture's middle.
    let (center, half_u, half_v) = (
        Vec3::new(0.6, 0.1, 0.2),
        Vec3::new(0.0, 0.3, 0.0),
        Vec3::new(0.0, 0.0, 0.4),
    );
    let light = ShadowLight::Rect {
        center_m: center,
        half_u_m: half_v,
        half_v_m: half_u,
        radiance: Vec3::ONE,
    };
    let towards = half_v.cross(half_u).normalize();
    let (picture, places) = picture(&light, Vec3::ZERO);
    for (radiance, place) in picture.radiance.iter().zip(&places).step_by(97) {
        let mut irradiance = 0.0;
        const N: i32 = 200;
        for i in 0..N {
            for j in 0..N {
                let at = |k: i32| (k as f32 + 0.5) / N as f32 * 2.0 - 1.0;
                let offset = center + at(i) * half_u + at(j) * half_v - place.truncate();
                let (r2, area) = (
                    offset.length_squared(),
                    4.0 * half_u.length() * half_v.length() / (N * N) as f32,
                );
                irradiance += offset.z.max(0.0) * (-offset.dot(towards)).max(0.0) / (r2 * r2) * area;
            }
        }
        let expected = 0.5 * irradiance / std::f32::consts::PI;
        assert!(
            (radiance.x - expected).abs() < 2e-3 + 0.01 * expected,
            "{place}: {} {expected}",
            radiance.x
        );
    }
}
