//! Percentage-closer soft shadows: the width of penumbrae against similar triangles.

use glam::Vec3;
use mirrorball_render::reference::shadow_rays::penumbra_width_m;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::view::View;

use crate::blocks::{block, floor};
use crate::maps::{crossing, profile};
use crate::truth;

/// Width from 10 % to 90 % of the penumbra on a floor, as a share of what the straight ramp of similar triangles has: the
/// light `half_m` wide to both sides of its middle 1.1 m above, a plate's straight edge in between so that distances to it
/// and on to the floor are as 1 to `ratio`.
fn measured_share(half_m: [f32; 2], ratio: f32) -> f32 {
    const RECEIVER_M: f32 = 1.1;
    let blocker_m = RECEIVER_M / (1.0 + ratio);
    let light_m = 2.0 * half_m[0];
    let width_m = penumbra_width_m(light_m, RECEIVER_M, blocker_m);
    // The light stands over the plate, so that the whole penumbra is beside it, seen from above.
    let light = ShadowLight::Rect {
        center_m: Vec3::new(-0.6 * light_m, 0.0, RECEIVER_M),
        half_u_m: Vec3::new(half_m[0], 0.0, 0.0),
        half_v_m: Vec3::new(0.0, -half_m[1], 0.0),
        radiance: Vec3::ONE,
    };
    let height_m = RECEIVER_M - blocker_m;
    let things = [
        ("floor", floor(6.0)),
        (
            "plate",
            block(Vec3::new(-3.0, -3.0, height_m - 1e-3), Vec3::new(0.0, 3.0, height_m)),
        ),
    ];
    let middle_m = 0.6 * width_m;
    let eye_m = Vec3::new(middle_m, 0.0, 3.0);
    let view = View::looking_at(
        eye_m,
        Vec3::new(middle_m, 0.0, 0.0),
        2.0 * (0.25 * width_m).atan(),
        [100, 100],
    );
    let seen = truth::draw(
        &mut truth::lab(&things, &view),
        &light,
        (ShadowMethod::Pcss, 1024),
        eye_m,
    );
    let (positions, ramp): (Vec<f32>, Vec<f32>) = profile(&seen).into_iter().unzip();
    (crossing(&positions, &ramp, 0.9) - crossing(&positions, &ramp, 0.1)) / (0.8 * width_m)
}

#[test]
fn penumbrae_are_as_wide_as_similar_triangles_say() {
    println!("receiver-blocker : blocker-light   width / analytic");
    for ratio in [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0] {
        let share = measured_share([0.1, 0.1], ratio);
        println!("{ratio:5.1} : 1   {share:.3}");
        assert!((share - 1.0).abs() < 0.1, "{ratio} : 1   {share}");
    }
}

#[test]
fn a_rectangles_penumbra_is_as_wide_as_its_side_across_the_edge() {
    for half_m in [[0.03, 0.15], [0.15, 0.03]] {
        let share = measured_share(half_m, 1.0);
        println!("{half_m:?}: {share:.3}");
        assert!((share - 1.0).abs() < 0.1, "{half_m:?}: {share}");
    }
}

#[test]
fn a_block_on_a_floor_is_close_to_rays() {
    let light = ShadowLight::Rect {
        center_m: Vec3::new(-0.3, -0.2, 1.0),
        half_u_m: Vec3::new(0.1, 0.0, 0.0),
        half_v_m: Vec3::new(0.0, -0.1, 0.0),
        radiance: Vec3::ONE,
    };
    let things = [
        ("floor", floor(2.0)),
        ("cube", block(Vec3::new(-0.1, -0.1, 0.0), Vec3::new(0.1, 0.1, 0.2))),
    ];
    let eye_m = Vec3::new(0.9, -1.0, 1.0);
    let view = View::looking_at(eye_m, Vec3::new(0.0, 0.0, 0.05), 0.7, [64, 48]);
    let seen = truth::draw(
        &mut truth::lab(&things, &view),
        &light,
        (ShadowMethod::Pcss, 1024),
        eye_m,
    );
    let psnr_db = seen.psnr_db(&seen.truth(&light, 16));
    println!("{psnr_db:.1} dB");
    assert!(psnr_db > 25.0, "{psnr_db}");
}
