//! Layered attenuation maps against rays to 1024 samples of the light.

use glam::Vec3;
use mirrorball_render::scene::Mesh;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;

use crate::area_truth::{SIZE_PX, Stage, lamp, psnr_db};
use crate::blocks::{block, floor};

fn eye() -> [Vec3; 2] {
    [Vec3::new(0.5, -1.5, 1.3), Vec3::new(0.0, 0.1, 0.1)]
}

fn stage(meshes: &[(&str, Mesh)]) -> Stage {
    let mut stage = Stage::new(meshes, eye(), SIZE_PX);
    stage.map_size = 512;
    stage
}

fn check(meshes: &[(&str, Mesh)], light: &ShadowLight, least_db: f32) {
    let mut stage = stage(meshes);
    let drawn = stage.drawn(ShadowMethod::AttenuationMaps, light);
    let psnr = psnr_db(&drawn, &stage.truth(light));
    assert!(psnr >= least_db, "{psnr} dB");
    // The maps are kept, so nothing may change.
    assert_eq!(stage.drawn(ShadowMethod::AttenuationMaps, light), drawn);
}

fn box_at(low: [f32; 3], high: [f32; 3]) -> Mesh {
    block(low.into(), high.into())
}

#[test]
fn a_floating_block() {
    let scene = [
        ("floor", floor(4.0)),
        ("block", box_at([-0.2, -0.2, 0.3], [0.2, 0.2, 0.5])),
    ];
    check(&scene, &lamp(Vec3::new(0.2, 0.1, 1.5), [0.2, 0.2]), 32.0);
}

#[test]
fn overlapping_blocks_one_on_the_floor() {
    let scene = [
        ("floor", floor(4.0)),
        ("low", box_at([-0.3, -0.2, 0.0], [0.1, 0.2, 0.3])),
        ("high", box_at([-0.1, -0.1, 0.5], [0.3, 0.3, 0.6])),
    ];
    check(&scene, &lamp(Vec3::new(0.3, 0.1, 1.4), [0.25, 0.2]), 31.0);
}

#[test]
fn a_stack_of_sheets_with_more_layers_than_there_is_room_for() {
    let mut scene = vec![("floor", floor(4.0))];
    for i in 0..12 {
        let at = 0.1 + 0.05 * i as f32;
        scene.push(("slat", box_at([at - 0.4, -0.3, at], [at - 0.38, 0.3, at + 0.02])));
    }
    check(&scene, &lamp(Vec3::new(0.2, 0.1, 1.6), [0.3, 0.3]), 24.0);
}

#[test]
fn a_moved_light_is_drawn_anew() {
    let scene = [
        ("floor", floor(4.0)),
        ("block", box_at([-0.2, -0.2, 0.3], [0.2, 0.2, 0.5])),
    ];
    let mut stage = stage(&scene);
    let first = stage.drawn(
        ShadowMethod::AttenuationMaps,
        &lamp(Vec3::new(0.2, 0.1, 1.5), [0.2, 0.2]),
    );
    let light = lamp(Vec3::new(-0.4, 0.1, 1.5), [0.2, 0.2]);
    let second = stage.drawn(ShadowMethod::AttenuationMaps, &light);
    let truth = stage.truth(&light);
    assert!(psnr_db(&first, &truth) < 20.0);
    assert!(psnr_db(&second, &truth) > 30.0);
}

#[test]
fn a_point_light_has_one_place() {
    let scene = [
        ("floor", floor(4.0)),
        ("block", box_at([-0.2, -0.2, 0.3], [0.2, 0.2, 0.5])),
    ];
    let mut stage = stage(&scene);
    let point = ShadowLight::Point {
        position_m: Vec3::new(0.5, 0.3, 2.5),
        intensity: Vec3::ONE,
    };
    let drawn = stage.drawn(ShadowMethod::AttenuationMaps, &point);
    let truth = stage.truth(&point);
    let n_wrong = (drawn.iter().zip(&truth))
        .filter(|(drawn, truth)| truth.is_some_and(|truth| (*drawn - truth).abs() > 0.6))
        .count();
    // As far off as a texel is wide.
    assert!(n_wrong <= 48, "{n_wrong}");
}
