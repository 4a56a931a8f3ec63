//! Soft shadow volumes against rays to 1024 samples of the light.

use glam::{Affine3A, Vec3};
use mirrorball_render::reference::shadow_wedges::Placed;
use mirrorball_render::scene::Mesh;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::wedge_light::{Coverage, WedgeLight};
use mirrorball_render::shadow::wedge_outlines::Outlines;

use crate::area_truth::{SIZE_PX, Stage, lamp, psnr_db};
use crate::blocks::{block, floor, push_quad};

/// Least agreement with rays, decibels.
const GOAL_DB: f32 = 38.0;

fn eye() -> [Vec3; 2] {
    [Vec3::new(0.5, -1.5, 1.3), Vec3::new(0.0, 0.1, 0.1)]
}

/// How well the method agrees with rays; fails below the goal.
fn check(stage: &mut Stage, light: &ShadowLight) -> f32 {
    let drawn = stage.drawn(ShadowMethod::Wedges, light);
    let truth = stage.truth(light);
    let darkest = truth.iter().flatten().copied().fold(1.0, f32::min);
    assert!(darkest < 0.5, "the scene has no shadow: {darkest}");
    let psnr = psnr_db(&drawn, &truth);
    assert!(psnr >= GOAL_DB, "{psnr} dB");
    psnr
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
    let mut stage = Stage::new(&scene, eye(), SIZE_PX);
    check(&mut stage, &lamp(Vec3::new(0.2, 0.1, 1.5), [0.2, 0.2]));
}

#[test]
fn overlapping_blocks_at_different_heights() {
    let scene = [
        ("floor", floor(4.0)),
        ("low", box_at([-0.3, -0.2, 0.2], [0.1, 0.2, 0.3])),
        ("high", box_at([-0.1, -0.1, 0.5], [0.3, 0.3, 0.6])),
    ];
    let light = lamp(Vec3::new(0.0, 0.1, 1.4), [0.25, 0.18]);
    let mut stage = Stage::new(&scene, eye(), SIZE_PX);
    let psnr = check(&mut stage, &light);
    let summed = stage.drawn(ShadowMethod::WedgesSummed, &light);
    let summed_psnr = psnr_db(&summed, &stage.truth(&light));
    assert!(summed_psnr > 20.0 && summed_psnr < psnr);
}

#[test]
fn every_pixel_is_what_its_twin_in_memory_is() {
    let scene = [
        ("floor", floor(4.0)),
        ("low", box_at([-0.3, -0.2, 0.0], [0.1, 0.2, 0.3])),
        ("high", box_at([-0.1, -0.1, 0.5], [0.3, 0.3, 0.6])),
    ];
    let placements = vec![
        Affine3A::IDENTITY,
        Affine3A::from_rotation_z(0.3),
        Affine3A::from_rotation_x(0.2),
    ];
    let light = lamp(Vec3::new(0.5, 0.13, 1.4), [0.25, 0.2]);
    let mut stage = Stage::placed(&scene, placements.clone(), eye(), [48, 36]);
    for (method, coverage) in [
        (ShadowMethod::Wedges, Coverage::Counted),
        (ShadowMethod::WedgesSummed, Coverage::Summed),
    ] {
        let drawn = stage.drawn(method, &light);
        let outlines = Outlines::new(stage.lab.casters()).unwrap();
        let wedge_light = WedgeLight::new(&light, stage.lab.casters().bounds()).unwrap();
        let twin = Placed::new(&outlines, &placements, (wedge_light, coverage));
        let expected: Vec<Option<f32>> = stage
            .receivers()
            .iter()
            .map(|receiver| receiver.as_ref().map(|receiver| twin.lit_share(receiver)))
            .collect();
        // A face seen exactly from its side may count or not.
        let n_wrong = (drawn.iter().zip(&expected))
            .filter(|(drawn, twin)| twin.is_some_and(|twin| (*drawn - twin).abs() > 0.01))
            .count();
        assert!(n_wrong <= 3, "{method:?}: {n_wrong} wrong");
        assert!(psnr_db(&drawn, &expected) > 45.0, "{method:?}");
    }
}

#[test]
fn areas_summed_are_right_for_one_caster() {
    let scene = [
        ("floor", floor(4.0)),
        ("block", box_at([-0.2, -0.2, 0.3], [0.2, 0.2, 0.301])),
    ];
    let light = lamp(Vec3::new(0.2, 0.1, 1.5), [0.1, 0.1]);
    let mut stage = Stage::new(&scene, eye(), SIZE_PX);
    let summed = stage.drawn(ShadowMethod::WedgesSummed, &light);
    let psnr = psnr_db(&summed, &stage.truth(&light));
    assert!(psnr >= GOAL_DB, "{psnr} dB");
}

#[test]
fn a_block_that_stands_on_the_floor_turned() {
    let scene = [
        ("floor", floor(4.0)),
        ("block", box_at([-0.2, -0.2, 0.0], [0.2, 0.2, 0.4])),
    ];
    let placements = vec![Affine3A::IDENTITY, Affine3A::from_rotation_z(0.5)];
    let mut stage = Stage::placed(&scene, placements, eye(), SIZE_PX);
    check(&mut stage, &lamp(Vec3::new(0.6, 0.5, 1.2), [0.15, 0.25]));
}

#[test]
fn a_light_that_lies_on_its_side_half_below_the_horizon() {
    let scene = [
        ("floor", floor(4.0)),
        ("block", box_at([-0.2, -0.2, 0.0], [0.1, 0.2, 0.3])),
    ];
    let light = ShadowLight::Rect {
        center_m: Vec3::new(1.2, 0.3, 0.1),
        half_u_m: Vec3::new(0.0, 0.0, 0.4),
        half_v_m: Vec3::new(0.0, 0.2, 0.0),
        radiance: Vec3::ONE,
    };
    let mut stage = Stage::new(&scene, eye(), SIZE_PX);
    check(&mut stage, &light);
}

#[test]
fn a_concave_caster_and_a_tilted_light() {
    let mut ell = block(Vec3::new(-0.3, -0.3, 0.2), Vec3::new(-0.1, 0.3, 0.35));
    // The other leg as a prism that shares no face: together they are one object of two solids that touch.
    let leg = block(Vec3::new(-0.1, -0.3, 0.2), Vec3::new(0.3, -0.1, 0.35));
    let first = ell.vertices.len() as u32;
    ell.vertices.extend(leg.vertices);
    ell.indices.extend(leg.indices.iter().map(|i| first + i));
    let scene = [("floor", floor(4.0)), ("ell", ell)];
    let light = ShadowLight::Rect {
        center_m: Vec3::new(-0.6, 0.5, 1.2),
        half_u_m: Vec3::new(0.0, 0.2, 0.0),
        half_v_m: Vec3::new(0.16, 0.0, 0.12),
        radiance: Vec3::ONE,
    };
    let mut stage = Stage::new(&scene, eye(), SIZE_PX);
    check(&mut stage, &light);
}

#[test]
fn an_eye_inside_the_penumbra() {
    let scene = [
        ("floor", floor(4.0)),
        ("block", box_at([-0.3, -0.3, 0.7], [0.3, 0.3, 0.8])),
    ];
    let mut stage = Stage::new(&scene, [Vec3::new(0.25, -0.3, 0.3), Vec3::new(-0.2, 0.4, 0.0)], SIZE_PX);
    check(&mut stage, &lamp(Vec3::new(0.0, 0.0, 1.5), [0.3, 0.3]));
}

#[test]
fn a_room_with_the_light_at_its_ceiling() {
    // Its walls reach past the light and past the floor's pixels.
    let mut room = block(Vec3::new(-1.6, -1.7, 0.0), Vec3::new(1.5, 1.6, 1.5));
    for triangle in room.indices.chunks_exact_mut(3) {
        triangle.swap(1, 2);
    }
    for vertex in &mut room.vertices {
        vertex.normal = vertex.normal.map(|n| -n);
    }
    let scene = [
        ("room", room),
        ("table", box_at([-0.3, -0.3, 0.5], [0.3, 0.3, 0.55])),
        ("leg", box_at([-0.05, -0.05, 0.0], [0.05, 0.05, 0.5])),
    ];
    let mut stage = Stage::new(&scene, eye(), SIZE_PX);
    check(&mut stage, &lamp(Vec3::new(0.1, 0.3, 1.45), [0.3, 0.2]));
}

#[test]
fn an_open_sheet_casts_a_shadow_from_both_sides() {
    let mut sheet = Mesh::default();
    for turned in [false, true] {
        let mut corners =
            [[-0.3, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.3, 0.2]].map(|[x, y]| Vec3::new(x, y, 0.4 + 0.3 * x));
        if turned {
            corners.reverse();
        }
        sheet = Mesh {
            materials: floor(1.0).materials,
            ..Mesh::default()
        };
        push_quad(&mut sheet, corners);
        let scene = [("floor", floor(4.0)), ("sheet", sheet.clone())];
        let mut stage = Stage::new(&scene, eye(), [64, 48]);
        check(&mut stage, &lamp(Vec3::new(0.2, 0.1, 1.5), [0.2, 0.2]));
    }
    assert_eq!(sheet.indices.len(), 6);
}

#[test]
fn a_small_light_is_a_point() {
    let scene = [
        ("floor", floor(4.0)),
        ("block", box_at([-0.2, -0.2, 0.3], [0.2, 0.2, 0.5])),
    ];
    let mut stage = Stage::new(&scene, eye(), SIZE_PX);
    let point = ShadowLight::Point {
        position_m: Vec3::new(0.5, 0.3, 4.5),
        intensity: Vec3::ONE,
    };
    let drawn = stage.drawn(ShadowMethod::Wedges, &point);
    let truth = stage.truth(&point);
    // A pixel on the shadow's line may fall to either side.
    let n_wrong = (drawn.iter().zip(&truth))
        .filter(|(drawn, truth)| truth.is_some_and(|truth| (*drawn - truth).abs() > 0.5))
        .count();
    assert!(n_wrong <= 8, "{n_wrong}");
}
