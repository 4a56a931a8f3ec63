//! The scenes without camera: the test scene with its toy cars, and scenes of given size for measuring time.

use std::f32::consts::{FRAC_PI_2, PI, TAU};
use std::path::PathBuf;

use glam::{Affine3A, Quat, Vec2, Vec3};
use mirrorball_calib::pose::Pose;

use super::meshes::{BoxSteps, Solid, mesh};
use super::toys::{self, HALF_GROUND_M, ROAD_RADIUS_M};
use crate::scene::{Kind, Mesh, Movement, Object, Placement, Scene};
use crate::shadow::shadow_view::Sphere;
use crate::shadow::view::View;

/// How long a car takes around the circle, seconds.
const LAP_S: f32 = 8.0;
/// Height of the walls, metres.
const WALL_M: f32 = 0.55;
/// Colours of elements, one after the other.
const COLORS: [[f32; 3]; 6] = [
    [0.62, 0.2, 0.12],
    [0.18, 0.38, 0.55],
    [0.66, 0.52, 0.2],
    [0.25, 0.45, 0.24],
    [0.45, 0.28, 0.5],
    [0.62, 0.6, 0.55],
];

/// A scene of virtual objects that move by themselves. World: z up, ground at 0, metres.
#[derive(Debug, Clone)]
pub struct MovingScene {
    /// The objects.
    pub scene: Scene,
    motions: Vec<Motion>,
}

/// How an object moves.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Motion {
    /// Not at all.
    Still(Affine3A),
    /// Along the road, ahead of the first car by this share of the circle.
    Drives(f32),
    /// Turns around its own z axis, once in [`LAP_S`].
    Turns(Affine3A),
}

impl MovingScene {
    /// Two toy cars that drive in a circle around a street sign, before two walls; `n_more` small bodies beside the road.
    #[must_use]
    pub fn test(n_more: usize) -> Self {
        let mut out = Self::empty();
        let wall_m = HALF_GROUND_M - 0.06;
        let sideways =
            Affine3A::from_rotation_translation(Quat::from_rotation_z(FRAC_PI_2), Vec3::new(-wall_m, 0.0, 0.0));
        let sign = Affine3A::from_rotation_translation(Quat::from_rotation_z(-0.15), Vec3::new(0.03, 0.06, 0.0));
        out.push("ground", toys::ground(), Motion::Still(Affine3A::IDENTITY));
        out.push(
            "back wall",
            toys::wall(WALL_M, [0.62, 0.58, 0.5]),
            Motion::Still(Affine3A::from_translation(Vec3::new(0.0, wall_m, 0.0))),
        );
        out.push(
            "side wall",
            toys::wall(WALL_M, [0.34, 0.45, 0.56]),
            Motion::Still(sideways),
        );
        out.push("street sign", toys::street_sign(), Motion::Still(sign));
        out.push("red car", toys::car([0.62, 0.05, 0.04]), Motion::Drives(0.0));
        out.push("yellow car", toys::car([0.74, 0.47, 0.05]), Motion::Drives(0.43));
        let near_m = 0.035..ROAD_RADIUS_M - 0.17;
        let far_m = ROAD_RADIUS_M + 0.17..HALF_GROUND_M - 0.12;
        let places = spread(HALF_GROUND_M - 0.12)
            .filter(|at| near_m.contains(&at.length()) || far_m.contains(&at.length()))
            .filter(|at| at.distance(Vec2::new(0.03, 0.06)) > 0.09);
        for (index, at) in places.take(n_more).enumerate() {
            let mesh = element(index, 0.032, Fineness::Coarse);
            let place = Affine3A::from_translation(at.extend(0.034));
            out.push(&format!("body {index}"), mesh, Motion::Still(place));
        }
        out
    }

    /// 60 bodies of together 40,000 corners on a plain ground, all turning.
    #[must_use]
    pub fn sixty_elements() -> Self {
        let mut out = Self::on_plain_ground();
        for (index, at) in spread(HALF_GROUND_M - 0.1).take(60).enumerate() {
            let height_m = 0.08 + 0.3 * (index as f32 * 0.618_034).fract();
            let place = Affine3A::from_rotation_translation(
                Quat::from_rotation_x(0.3 * (index % 5) as f32),
                at.extend(height_m),
            );
            out.push(
                &format!("element {index}"),
                element(index, 0.07, Fineness::Fine),
                Motion::Turns(place),
            );
        }
        out
    }

    /// One body of 1,000 corners on a plain ground, turning.
    #[must_use]
    pub fn one_element() -> Self {
        let mut out = Self::on_plain_ground();
        let torus = mesh(&[
            Solid::torus([0.3, 0.1], [40, 25], COLORS[1]).moved(Affine3A::from_rotation_translation(
                Quat::from_rotation_x(1.1),
                Vec3::new(0.0, 0.0, 0.4),
            )),
        ]);
        out.push("element", torus, Motion::Turns(Affine3A::IDENTITY));
        out
    }

    /// The test scene with bodies so fine that it has at least `n_triangles` triangles, where that is more than it has
    /// anyway.
    #[must_use]
    pub fn with_triangles(n_triangles: usize) -> Self {
        let mut out = Self::test(24);
        let missing = n_triangles.saturating_sub(out.n_triangles());
        let first = out.scene.objects.len() - 24;
        for object in &mut out.scene.objects[first..] {
            let own = object.mesh.indices.len() / 3;
            let wanted = own + missing.div_ceil(24);
            // A sphere of n corners around and m rings has 2 n m triangles.
            let n_around = (wanted as f32).sqrt().ceil() as u32;
            let n_rings = (wanted as u32).div_ceil(2 * n_around);
            object.mesh = mesh(&[Solid::sphere(0.032, [n_around, n_rings], COLORS[1])]);
        }
        out
    }

    /// Where the objects stand at a time, one placement each, world from object.
    #[must_use]
    pub fn placements(&self, time_s: f32) -> Vec<Affine3A> {
        let turn_rad = TAU * (time_s / LAP_S).fract();
        let place = |motion: &Motion| match *motion {
            Motion::Still(place) => place,
            Motion::Turns(place) => place * Affine3A::from_rotation_z(turn_rad),
            Motion::Drives(ahead) => {
                let angle_rad = turn_rad + TAU * ahead - 0.56 * PI;
                let (sine, cosine) = angle_rad.sin_cos();
                Affine3A::from_rotation_translation(
                    Quat::from_rotation_z(angle_rad + FRAC_PI_2),
                    ROAD_RADIUS_M * Vec3::new(cosine, sine, 0.0),
                )
            }
        };
        self.motions.iter().map(place).collect()
    }

    /// Number of corners of all objects.
    #[must_use]
    pub fn n_vertices(&self) -> usize {
        self.scene.objects.iter().map(|object| object.mesh.vertices.len()).sum()
    }

    /// Number of triangles of all objects.
    #[must_use]
    pub fn n_triangles(&self) -> usize {
        self.scene
            .objects
            .iter()
            .map(|object| object.mesh.indices.len() / 3)
            .sum()
    }

    /// Objects of a scene file, standing still.
    #[must_use]
    pub fn still(scene: Scene, placements: &[Affine3A]) -> Self {
        Self {
            scene,
            motions: placements.iter().map(|&place| Motion::Still(place)).collect(),
        }
    }

    /// Sphere around all objects as they stand at first.
    #[must_use]
    pub fn bounds(&self) -> Sphere {
        let placements = self.placements(0.0);
        let places = || {
            self.scene.objects.iter().zip(&placements).flat_map(|(object, place)| {
                let points = object.mesh.vertices.iter().map(|v| Vec3::from(v.position));
                points.map(|point| place.transform_point3(point))
            })
        };
        let low = places().reduce(Vec3::min).unwrap_or(Vec3::NEG_ONE);
        let high = places().reduce(Vec3::max).unwrap_or(Vec3::ONE);
        let center_m = 0.5 * (low + high);
        Sphere {
            center_m,
            radius_m: places().map(|place| place.distance(center_m)).fold(1e-3, f32::max),
        }
    }

    fn empty() -> Self {
        Self {
            scene: Scene {
                objects: Vec::new(),
                lamps: Vec::new(),
            },
            motions: Vec::new(),
        }
    }

    fn on_plain_ground() -> Self {
        let mut out = Self::empty();
        let half_m = Vec3::new(HALF_GROUND_M, HALF_GROUND_M, 0.015);
        let ground = mesh(&[Solid::block(half_m, [0.5, 0.5, 0.48]).at(Vec3::new(0.0, 0.0, -0.015))]);
        out.push("ground", ground, Motion::Still(Affine3A::IDENTITY));
        out
    }

    fn push(&mut self, name: &str, mesh: Mesh, motion: Motion) {
        self.scene.objects.push(Object {
            name: name.to_owned(),
            kind: Kind::Virtual,
            placement: Placement::World(Pose::identity()),
            movement: Movement::default(),
            file: PathBuf::new(),
            mesh,
        });
        self.motions.push(motion);
    }
}

/// The picture's view of the test scene and of the scenes made for measuring.
#[must_use]
pub fn view(size_px: [u32; 2]) -> View {
    View::looking_at(
        Vec3::new(0.72, -1.52, 1.12),
        Vec3::new(-0.02, -0.01, 0.06),
        0.65,
        size_px,
    )
}

/// A view of anything: from the front, a little from the right and above.
#[must_use]
pub fn view_of(bounds: Sphere, size_px: [u32; 2]) -> View {
    const HEIGHT_RAD: f32 = 0.74;
    let distance_m = bounds.radius_m / (0.5 * HEIGHT_RAD).sin();
    let from = Vec3::new(0.42, -0.76, 0.5).normalize();
    let eye_m = bounds.center_m + distance_m * from;
    View {
        near_m: 0.01 * distance_m,
        ..View::looking_at(eye_m, bounds.center_m, HEIGHT_RAD, size_px)
    }
}

/// How many corners a body has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fineness {
    /// About 130.
    Coarse,
    /// 602 to 728, on average 666.
    Fine,
}

/// A sphere, a torus or a cube with rounded edges in turn, of about `radius_m`.
fn element(index: usize, radius_m: f32, fineness: Fineness) -> Mesh {
    let color = COLORS[index % COLORS.len()];
    let half_m = Vec3::splat(0.8 * radius_m);
    let solid = match (index % 3, fineness) {
        (0, Fineness::Coarse) => Solid::sphere(radius_m, [16, 8], color),
        (0, Fineness::Fine) => Solid::sphere(radius_m, [35, 19], color),
        (1, Fineness::Coarse) => Solid::torus([0.7 * radius_m, 0.3 * radius_m], [16, 8], color),
        (1, Fineness::Fine) => Solid::torus([0.7 * radius_m, 0.3 * radius_m], [29, 23], color),
        (_, Fineness::Coarse) => Solid::rounded_box((half_m, 0.3 * radius_m), BoxSteps { flat: 1, round: 2 }, color),
        (_, Fineness::Fine) => {
            let flat = if index.is_multiple_of(2) { 4 } else { 5 };
            Solid::rounded_box((half_m, 0.3 * radius_m), BoxSteps { flat, round: 3 }, color)
        }
    };
    mesh(&[solid])
}

/// Places that fill a square evenly, however many are taken (Roberts 2018, "The unreasonable effectiveness of
/// quasirandom sequences").
fn spread(half_m: f32) -> impl Iterator<Item = Vec2> {
    const STEP: Vec2 = Vec2::new(0.754_877_7, 0.569_840_3);
    (1u32..).map(move |i| half_m * (2.0 * (0.5 + i as f32 * STEP).fract() - 1.0))
}

#[cfg(test)]
mod tests {
    use super::super::meshes::check::{assert_closed, assert_outward};
    use super::*;

    #[test]
    fn scenes_have_the_sizes_they_are_named_after() {
        let sixty = MovingScene::sixty_elements();
        assert_eq!(sixty.scene.objects.len(), 61);
        let of_elements = sixty.n_vertices() - 24;
        assert!(of_elements.abs_diff(40_000) < 200, "{of_elements}");
        assert_eq!(MovingScene::one_element().n_vertices(), 1_024);
        assert_eq!(MovingScene::test(100).scene.objects.len(), 106);
        for wanted in [20_000, 80_000] {
            let found = MovingScene::with_triangles(wanted).n_triangles();
            assert!((wanted..wanted * 11 / 10).contains(&found), "{found} for {wanted}");
        }
    }

    #[test]
    fn every_object_is_closed_and_stands_on_the_ground_within_the_walls() {
        for scene in [
            MovingScene::test(20),
            MovingScene::sixty_elements(),
            MovingScene::one_element(),
        ] {
            for time_s in [0.0, 3.3] {
                for (object, place) in scene.scene.objects.iter().zip(scene.placements(time_s)) {
                    assert_closed(&object.name, &object.mesh);
                    assert_outward(&object.name, &object.mesh);
                    for vertex in &object.mesh.vertices {
                        let at = place.transform_point3(Vec3::from(vertex.position));
                        assert!(
                            at.truncate().abs().max_element() < HALF_GROUND_M + 1e-4,
                            "{}: {at}",
                            object.name
                        );
                        assert!(at.z > -0.031 && at.z < 0.8, "{}: {at}", object.name);
                    }
                }
            }
            let bounds = scene.bounds();
            assert!((1.0..1.6).contains(&bounds.radius_m), "{bounds:?}");
        }
    }

    #[test]
    fn cars_drive_forward_along_the_road_and_keep_their_distance() {
        let scene = MovingScene::test(0);
        let cars: Vec<usize> = (0..scene.scene.objects.len())
            .filter(|&i| scene.scene.objects[i].name.ends_with("car"))
            .collect();
        assert_eq!(cars.len(), 2);
        for time_s in [0.0, 1.7, 5.0, 123.4] {
            let (now, soon) = (scene.placements(time_s), scene.placements(time_s + 0.01));
            for &car in &cars {
                let place = Vec3::from(now[car].translation);
                assert!((place.length() - ROAD_RADIUS_M).abs() < 1e-5);
                let step = Vec3::from(soon[car].translation) - place;
                assert!(step.normalize().dot(now[car].transform_vector3(Vec3::X)) > 0.999);
            }
            assert!(now[cars[0]].translation.distance(now[cars[1]].translation) > 0.7);
        }
    }
}
