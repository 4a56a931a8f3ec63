//! The reference of one light, many hard shadows, against rays.

use glam::Vec3;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::view::View;

use crate::blocks::{block, floor};
use crate::truth;

#[test]
fn a_thousand_hard_shadows_are_the_truth() {
    let eye_m = Vec3::new(0.9, -1.2, 1.0);
    let view = View::looking_at(eye_m, Vec3::new(0.0, 0.0, 0.1), 0.9, [64, 48]);
    let things = [
        ("floor", floor(2.0)),
        ("wall", block(Vec3::new(-0.9, 0.5, 0.0), Vec3::new(0.9, 0.55, 0.5))),
        ("cube", block(Vec3::new(-0.2, -0.1, 0.0), Vec3::new(0.0, 0.1, 0.2))),
        ("pole", block(Vec3::new(0.3, -0.1, 0.0), Vec3::new(0.34, -0.06, 0.5))),
    ];
    // Overhead, and upright beside the things: much of that one's map shows the floor and the wall close to it.
    let overhead = ShadowLight::Rect {
        center_m: Vec3::new(-0.3, -0.3, 1.0),
        half_u_m: Vec3::new(0.2, 0.0, 0.0),
        half_v_m: Vec3::new(0.0, -0.1, 0.0),
        radiance: Vec3::ONE,
    };
    let beside = ShadowLight::Rect {
        center_m: Vec3::new(-0.9, -0.2, 0.5),
        half_u_m: Vec3::new(0.0, 0.2, 0.0),
        half_v_m: Vec3::new(0.0, 0.0, 0.2),
        radiance: Vec3::ONE,
    };
    let mut lab = truth::lab(&things, &view);
    for (light, map_size) in [(overhead, 512), (beside, 1024)] {
        let seen = truth::draw(&mut lab, &light, (ShadowMethod::Area, map_size), eye_m);
        let psnr_db = seen.psnr_db(&seen.truth(&light, 24));
        println!("{psnr_db:.1} dB");
        assert!(psnr_db >= 40.0, "{light:?}: {psnr_db}");
    }
}

#[test]
fn a_light_without_extent_has_one_hard_shadow() {
    let eye_m = Vec3::new(0.9, -1.2, 1.0);
    let view = View::looking_at(eye_m, Vec3::ZERO, 0.7, [32, 24]);
    let things = [
        ("floor", floor(2.0)),
        ("cube", block(Vec3::new(-0.1, -0.1, 0.0), Vec3::new(0.1, 0.1, 0.2))),
    ];
    let light = ShadowLight::Point {
        position_m: Vec3::new(-0.5, 0.2, 1.0),
        intensity: Vec3::ONE,
    };
    let mut lab = truth::lab(&things, &view);
    let area = truth::draw(&mut lab, &light, (ShadowMethod::Area, 512), eye_m);
    let hard = truth::draw(&mut lab, &light, (ShadowMethod::Map, 512), eye_m);
    assert_eq!(area.visibility, hard.visibility);
}
