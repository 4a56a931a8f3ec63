//! Projected shadows against rays, and blobs.

use glam::{Vec3, Vec4};
use mirrorball_render::scene::Mesh;
use mirrorball_render::shadow::ShadowMethod;
use mirrorball_render::shadow::light::ShadowLight;
use mirrorball_render::shadow::view::View;

use crate::blocks::{block, floor, push_quad};
use crate::rays::{Traced, lights, point};

fn view() -> View {
    View::looking_at(Vec3::new(0.3, -1.6, 1.2), Vec3::new(0.0, 0.0, 0.1), 0.8, [160, 120])
}

fn on_floor(place: Vec4) -> bool {
    place.z.abs() < 1e-4
}

fn standing() -> Mesh {
    block(Vec3::new(-0.4, -0.2, 0.0), Vec3::new(-0.1, 0.1, 0.25))
}

fn hanging() -> Mesh {
    block(Vec3::new(0.1, 0.0, 0.3), Vec3::new(0.4, 0.25, 0.4))
}

fn assert_right(traced: &mut Traced, light: &ShadowLight, of: impl Fn(Vec4) -> bool) {
    let agreement = traced.agreement(ShadowMethod::Planar, light, of);
    assert!(agreement >= 0.995, "{agreement} under {light:?}");
}

#[test]
fn a_shadow_on_the_floor_agrees_with_rays_under_every_light() {
    let mut traced = Traced::new(
        &[("floor", floor(4.0)), ("standing", standing()), ("hanging", hanging())],
        &view(),
    );
    for light in lights() {
        assert_right(&mut traced, &light, on_floor);
    }
}

#[test]
fn a_wall_gets_the_shadow_as_the_floor_does() {
    let wall = block(Vec3::new(-1.5, 0.8, 0.0), Vec3::new(1.5, 0.9, 1.5));
    let mut traced = Traced::new(
        &[("floor", floor(4.0)), ("wall", wall), ("hanging", hanging())],
        &view(),
    );
    let light = point(Vec3::new(0.4, -0.8, 0.7));
    let is_wall = |place: Vec4| (place.y - 0.8).abs() < 1e-4;
    let truth = traced.truth(&light, 1);
    let places = traced.lab.places().unwrap();
    assert!(
        truth
            .iter()
            .zip(&places)
            .filter(|(t, p)| is_wall(**p) && **t == Some(0.0))
            .count()
            > 100
    );
    assert_right(&mut traced, &light, |place| is_wall(place) || on_floor(place));
}

#[test]
fn what_is_not_between_light_and_plane_casts_no_shadow() {
    // One above the light, one at its height, one below the floor, one through it.
    let meshes = [
        ("floor", floor(4.0)),
        ("above", block(Vec3::new(-0.3, -0.3, 0.9), Vec3::new(0.0, 0.0, 1.0))),
        ("beside", block(Vec3::new(0.3, 0.1, 0.3), Vec3::new(0.4, 0.4, 0.7))),
        ("below", block(Vec3::new(-0.4, 0.2, -0.4), Vec3::new(-0.2, 0.4, -0.2))),
        ("through", block(Vec3::new(-0.4, 0.2, -0.1), Vec3::new(-0.3, 0.3, 0.1))),
    ];
    let mut traced = Traced::new(&meshes, &view());
    assert_right(&mut traced, &point(Vec3::new(0.05, 0.1, 0.55)), on_floor);
}

#[test]
fn a_shadow_stays_on_its_plane() {
    // A table top that the floor's shadow would cross if it were not clipped, and no plane but the floor.
    let mut table = Mesh {
        materials: floor(1.0).materials,
        ..Mesh::default()
    };
    let corners =
        [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]].map(|[x, y]| Vec3::new(x - 0.25, y, 0.2));
    push_quad(&mut table, corners);
    let mut traced = Traced::new(
        &[("floor", floor(4.0)), ("table", table), ("hanging", hanging())],
        &view(),
    );
    let light = point(Vec3::new(0.9, 0.3, 0.8));
    let visibility = traced.visibility(ShadowMethod::Planar, &light);
    let places = traced.lab.places().unwrap();
    let elsewhere = visibility.iter().zip(&places).filter(|(_, place)| !on_floor(**place));
    assert!(elsewhere.clone().count() > 50);
    for (visible, place) in elsewhere {
        assert_eq!(*visible, 1.0, "at {place}");
    }
    assert_right(&mut traced, &light, on_floor);
}

#[test]
fn a_soft_shadow_is_near_the_average_of_many_rays() {
    let mut traced = Traced::new(
        &[("floor", floor(4.0)), ("standing", standing()), ("hanging", hanging())],
        &view(),
    );
    let light = ShadowLight::Rect {
        center_m: Vec3::new(0.7, 0.5, 1.3),
        half_u_m: Vec3::new(0.15, 0.0, 0.0),
        half_v_m: Vec3::new(0.0, -0.15, 0.0),
        radiance: Vec3::ONE,
    };
    let truth = traced.truth(&light, 12);
    let places = traced.lab.places().unwrap();
    let rms = [ShadowMethod::SoftPlanar, ShadowMethod::Planar].map(|method| {
        let visibility = traced.visibility(method, &light);
        let errors: Vec<f32> = (visibility.iter().zip(&truth).zip(&places))
            .filter(|(_, place)| on_floor(**place))
            .filter_map(|((v, t), _)| t.map(|t| (v - t).powi(2)))
            .collect();
        (errors.iter().sum::<f32>() / errors.len() as f32).sqrt()
    });
    assert!(rms[0] < 0.03 && rms[1] > 2.0 * rms[0], "{rms:?}");
}

#[test]
fn without_an_area_a_soft_shadow_is_the_hard_one() {
    let mut traced = Traced::new(&[("floor", floor(4.0)), ("hanging", hanging())], &view());
    for light in lights() {
        let hard = traced.visibility(ShadowMethod::Planar, &light);
        assert_eq!(traced.visibility(ShadowMethod::SoftPlanar, &light), hard);
    }
}

#[test]
fn a_blob_lies_under_its_object_and_fades_with_height() {
    let above = View::looking_at(Vec3::new(0.0, 0.0, 3.0), Vec3::ZERO, 0.5, [97, 97]);
    let light = ShadowLight::Directional {
        towards: Vec3::Z,
        irradiance: Vec3::ONE,
    };
    let darkest = [0.0f32, 0.1, 0.4].map(|height| {
        // Seen past its edge: the floor next to a plate twice as long as wide.
        let plate = block(Vec3::new(-0.2, -0.1, height), Vec3::new(0.2, 0.1, height + 0.01));
        let mut traced = Traced::new(&[("floor", floor(4.0)), ("plate", plate)], &above);
        let visibility = traced.visibility(ShadowMethod::Blob, &light);
        let places = traced.lab.places().unwrap();
        let at = |x: f32, y: f32| {
            let nearest = (0..places.len()).filter(|&i| on_floor(places[i])).min_by(|&a, &b| {
                let away = |i: usize| places[i].truncate().distance(Vec3::new(x, y, 0.0));
                away(a).total_cmp(&away(b))
            });
            visibility[nearest.unwrap()]
        };
        let object: Vec<f32> = (0..places.len())
            .filter(|&i| places[i].z > 1e-3)
            .map(|i| visibility[i])
            .collect();
        assert!(!object.is_empty() && object.iter().all(|&v| v == 1.0));
        assert_eq!(at(0.5, 0.0), 1.0);
        assert!(at(0.22, 0.0) < at(0.0, 0.22), "the spot is as long as the plate");
        at(0.0, 0.11)
    });
    assert!(
        darkest[0] < darkest[1] && darkest[1] < darkest[2] && darkest[2] < 1.0,
        "{darkest:?}"
    );
}

#[test]
fn too_many_objects_are_refused_a_blob() {
    let small = block(Vec3::ZERO, Vec3::splat(0.01));
    let meshes: Vec<(&str, Mesh)> = (0..201).map(|_| ("stone", small.clone())).collect();
    let mut traced = Traced::new(&meshes, &view());
    let error = traced
        .lab
        .draw(&crate::rays::frame(ShadowMethod::Blob, &lights()[0]))
        .unwrap_err();
    assert!(error.to_string().contains("there are 201 objects"), "{error}");
}
