//! From light to the pixel that shows it, through ball or fisheye lens, and back: exact, for lights at finite distance.

use glam::{DMat2, DVec2, DVec3};

use super::ProbeOptics;
use crate::camera::Intrinsics;
use crate::pose::Pose;

/// How directions become places in the probe's picture.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Mapping {
    /// Reflection in the ball, or refraction by the lens, as it is: [`ProbeMap`].
    #[default]
    Exact,
    /// The sphere map of 2006 (Supan, "Image based lighting in augmented reality", section 3.4): ball, camera and light
    /// infinitely far from each other. For comparison.
    Simple {
        /// Length of the vector towards the camera, 0 ..= 1: 1 where the picture shows all 360° of the surroundings, minus
        /// the cosine of half the angle where it shows less.
        wrap: f64,
    },
}

/// What a camera sees of the light around a place, by way of a mirror ball or of its own fisheye lens.
#[derive(Debug, Clone, Copy)]
pub struct ProbeMap<'a> {
    /// The camera's lens.
    pub intrinsics: &'a Intrinsics,
    /// The camera's pose.
    pub camera_from_world: Pose,
    /// What it looks at, or through.
    pub optics: &'a ProbeOptics,
}

/// Where the picture shows a light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Pixel; it may lie outside the picture.
    pub pixel: DVec2,
    /// Cosine between the ball's normal there and the view, 0 at the outline; 1 for a fisheye.
    pub view_cosine: f64,
    /// Distance to the ball's outline in the picture, pixels; infinite for a fisheye.
    pub outline_px: f64,
    /// Distance to the end of a fisheye lens's round picture, pixels; infinite for other lenses.
    pub rim_px: f64,
    /// Angle between the light and the camera that films the ball, seen from the ball's centre, radians; infinite for a
    /// fisheye, which does not see itself.
    pub from_camera_rad: f64,
}

/// The light that a pixel shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Towards the light from the place that it is measured for, unit, world frame.
    pub direction: DVec3,
    /// Solid angle that one pixel covers there, steradians.
    pub solid_angle_per_pixel: f64,
}

/// The place that light is measured for, and how far away the light is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightSphere {
    /// The place, world frame, metres.
    pub origin_m: DVec3,
    /// Distance of the light from it, metres.
    pub distance_m: f64,
}

impl ProbeMap<'_> {
    /// Finds where the picture shows a light that stands at `light_m` (world frame, metres); `None` where it does not: the
    /// ball hides it, the light is inside the ball, or the lens does not reach it.
    #[must_use]
    pub fn place(&self, light_m: DVec3) -> Option<Place> {
        match self.optics {
            ProbeOptics::Fisheye { .. } => {
                let in_camera = self.camera_from_world.transform_point(light_m);
                Some(Place {
                    pixel: self.intrinsics.project(in_camera)?,
                    view_cosine: 1.0,
                    outline_px: f64::INFINITY,
                    rim_px: self.intrinsics.distance_to_rim_px(in_camera),
                    from_camera_rad: f64::INFINITY,
                })
            }
            ProbeOptics::MirrorBall { ball, .. } => {
                let camera_m = self.camera_from_world.inverse().translation;
                let to_light = light_m - ball.center_m;
                let glint = ball.glint(camera_m, to_light.try_normalize()?, to_light.length())?;
                let in_camera = self.camera_from_world.transform_point(glint.point_m);
                let pixel = self.intrinsics.project(in_camera)?;
                let outline = self
                    .camera_from_world
                    .transform_point(ball.outline_beside(camera_m, glint.point_m));
                Some(Place {
                    pixel,
                    view_cosine: glint.view_cosine,
                    outline_px: self
                        .intrinsics
                        .project(outline)
                        .map_or(f64::INFINITY, |outline| outline.distance(pixel)),
                    rim_px: self.intrinsics.distance_to_rim_px(in_camera),
                    from_camera_rad: to_light.angle_between(camera_m - ball.center_m),
                })
            }
        }
    }

    /// Finds the light that a pixel shows; `None` where the lens images nothing or the pixel misses the ball.
    ///
    /// The solid angle is the exact Jacobian: pixel to ray by the inverse of the lens's gradient on the sphere of rays, ray
    /// to point and normal of the ball, to the reflected ray, to where that meets the sphere of lights, each differentiated
    /// in closed form.
    #[must_use]
    pub fn light(&self, pixel: DVec2, sphere: &LightSphere) -> Option<Light> {
        let ray_in_camera = self.intrinsics.unproject(pixel)?;
        let world_from_camera = self.camera_from_world.inverse();
        let camera_m = world_from_camera.translation;
        let rays_per_pixel = self.rays_per_pixel(ray_in_camera)?;
        let turn = |v: DVec3| world_from_camera.transform_vector(v);
        let beam = Beam {
            point: camera_m,
            ray: turn(ray_in_camera),
            steps: rays_per_pixel.map(|step| (DVec3::ZERO, turn(step))),
        };
        let beam = match self.optics {
            ProbeOptics::Fisheye { .. } => beam,
            ProbeOptics::MirrorBall { ball, .. } => beam.reflected(ball.center_m, ball.radius_m)?,
        };
        beam.on_sphere(sphere)
    }

    /// Pixel of a direction (unit, world frame) by the simple sphere map of 2006; `None` where the ball's corners or the lens's
    /// rim have no pixel.
    ///
    /// The half vector `H = (A + R) / |A + R|` with `A = (0, 0, wrap)` towards the viewer and R the direction, both in the
    /// camera's axes, is the place on the ball's bounding rectangle; behind the rim (`H.z < 0`) the rim is taken.
    #[must_use]
    pub fn simple_pixel(&self, direction: DVec3, wrap: f64) -> Option<DVec2> {
        let along = self.camera_from_world.transform_vector(direction);
        let (middle, half, towards_viewer) = match self.optics {
            ProbeOptics::MirrorBall { ball, .. } => {
                let center = self.camera_from_world.transform_point(ball.center_m);
                let corner = DVec3::new(ball.radius_m, ball.radius_m, 0.0);
                let low = self.intrinsics.project(center - corner)?;
                let high = self.intrinsics.project(center + corner)?;
                (0.5 * (low + high), 0.5 * (high - low), -along.z)
            }
            ProbeOptics::Fisheye { .. } => {
                let radius = self.intrinsics.distance_to_rim_px(DVec3::Z) / self.intrinsics.focal_px.x;
                (
                    self.intrinsics.principal_point_px,
                    self.intrinsics.focal_px * radius,
                    along.z,
                )
            }
        };
        let halfway = along.truncate().extend(towards_viewer + wrap);
        let on_disc = if halfway.z < 0.0 {
            halfway.truncate().try_normalize().unwrap_or(DVec2::X)
        } else {
            halfway.try_normalize().unwrap_or(DVec3::X).truncate()
        };
        let pixel = middle + half * on_disc;
        pixel.is_finite().then_some(pixel)
    }

    /// How the unit ray moves when the pixel moves by one to the right, and by one down.
    fn rays_per_pixel(&self, ray: DVec3) -> Option<[DVec3; 2]> {
        let gradient = self.intrinsics.project_with_gradient(ray)?.gradient;
        let (right, down) = ray.any_orthonormal_pair();
        let pixels_per_ray = DMat2::from_cols(
            DVec2::new(gradient[0].dot(right), gradient[1].dot(right)),
            DVec2::new(gradient[0].dot(down), gradient[1].dot(down)),
        );
        let inverse = pixels_per_ray.inverse();
        inverse
            .is_finite()
            .then(|| [inverse.x_axis, inverse.y_axis].map(|column| right * column.x + down * column.y))
    }
}

/// A ray of light traced backwards, and how its point and direction move with the pixel's x and y.
struct Beam {
    point: DVec3,
    ray: DVec3,
    steps: [(DVec3, DVec3); 2],
}

impl Beam {
    /// The beam after it has met a mirror ball.
    fn reflected(&self, center: DVec3, radius: f64) -> Option<Self> {
        let from_center = self.point - center;
        let half_b = from_center.dot(self.ray);
        let root = (half_b * half_b - from_center.length_squared() + radius * radius).sqrt();
        let along = -half_b - root;
        if along.is_nan() || along <= 0.0 {
            return None;
        }
        let point = self.point + self.ray * along;
        let normal = (point - center) / radius;
        let steps = self.steps.map(|(d_point, d_ray)| {
            // The point stays on the ball: n · (d_point + along d_ray + ray d_along) = 0.
            let moved = d_point + d_ray * along;
            let d_point = moved - self.ray * (normal.dot(moved) / normal.dot(self.ray));
            let d_normal = d_point / radius;
            let d_cosine = d_ray.dot(normal) + self.ray.dot(d_normal);
            (
                d_point,
                d_ray - 2.0 * (d_cosine * normal + self.ray.dot(normal) * d_normal),
            )
        });
        let ray = self.ray - 2.0 * self.ray.dot(normal) * normal;
        Some(Self { point, ray, steps })
    }

    /// Where the beam meets the sphere of lights, seen from the sphere's centre.
    fn on_sphere(&self, sphere: &LightSphere) -> Option<Light> {
        let from_origin = self.point - sphere.origin_m;
        let half_b = from_origin.dot(self.ray);
        let along =
            -half_b + (half_b * half_b - from_origin.length_squared() + sphere.distance_m * sphere.distance_m).sqrt();
        if along.is_nan() || along <= 0.0 {
            return None;
        }
        let direction = (from_origin + self.ray * along) / sphere.distance_m;
        let [right, down] = self.steps.map(|(d_point, d_ray)| {
            let moved = d_point + d_ray * along;
            (moved - self.ray * (direction.dot(moved) / direction.dot(self.ray))) / sphere.distance_m
        });
        Some(Light {
            direction: direction.normalize(),
            solid_angle_per_pixel: right.cross(down).dot(direction).abs(),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use glam::{DMat3, Vec3};
    use proptest::prelude::*;

    use super::*;
    use crate::camera::LensModel;
    use crate::probe::mirror_ball::MirrorBall;

    const CENTER_M: DVec3 = DVec3::new(0.2, 0.1, 0.05);

    fn ball(radius_m: f64) -> ProbeOptics {
        ProbeOptics::MirrorBall {
            ball: MirrorBall {
                center_m: CENTER_M,
                radius_m,
            },
            reflectance: Vec3::ONE,
        }
    }

    fn lens(focal_px: f64, lens: LensModel) -> Intrinsics {
        Intrinsics {
            size_px: [640, 480],
            focal_px: DVec2::new(focal_px, 0.998 * focal_px),
            principal_point_px: DVec2::new(318.2, 241.7),
            lens,
        }
    }

    const DISTORTED: LensModel = LensModel::BrownConrady {
        k1: -0.12,
        k2: 0.05,
        p1: 0.001,
        p2: -0.0007,
        k3: 0.0,
    };

    const PINHOLE: LensModel = LensModel::BrownConrady {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
    };

    /// A camera at `from` that looks at `target`.
    fn looking_at(target: DVec3, from: DVec3) -> Pose {
        let forward = (target - from).normalize();
        let right = forward.any_orthonormal_vector();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        Pose {
            rotation,
            translation: -(rotation * from),
        }
    }

    fn arrangement(which: usize) -> (Intrinsics, ProbeOptics, Pose) {
        let beside = CENTER_M + DVec3::new(0.05, -0.03, 0.02);
        let from = CENTER_M + DVec3::new(0.2, -0.3, 0.25);
        let fisheye_pose = looking_at(CENTER_M + DVec3::Z, CENTER_M);
        let fisheye = ProbeOptics::Fisheye { lens_m: CENTER_M };
        let max_angle_rad = 1.6;
        match which {
            0 => (lens(600.0, DISTORTED), ball(0.05), looking_at(beside, from)),
            1 => (
                lens(150.0, LensModel::Equisolid { max_angle_rad }),
                fisheye,
                fisheye_pose,
            ),
            _ => {
                let k = [-0.0121, 0.0058, -0.0021, 0.00021];
                let lens = lens(150.0, LensModel::KannalaBrandt { k, max_angle_rad });
                (lens, fisheye, fisheye_pose)
            }
        }
    }

    proptest! {
        #[test]
        fn light_and_place_are_inverse(
            which in 0usize..3, x in -1.0f64..1.0, y in -1.0f64..1.0, z in -1.0f64..1.0, distance_m in 0.6f64..1e4,
        ) {
            let (intrinsics, optics, camera_from_world) = arrangement(which);
            let map = ProbeMap { intrinsics: &intrinsics, camera_from_world, optics: &optics };
            let direction = DVec3::new(x, y, z);
            prop_assume!(direction.length() > 0.1);
            let direction = direction.normalize();
            // The light of a place beside the ball.
            let sphere = LightSphere { origin_m: CENTER_M + DVec3::new(-0.3, 0.2, 0.1), distance_m };
            if let Some(place) = map.place(sphere.origin_m + direction * distance_m)
                && place.view_cosine > 0.05
            {
                let light = map.light(place.pixel, &sphere).expect("a pixel on the ball or in the lens");
                prop_assert!(light.direction.distance(direction) < 1e-6, "{} {direction}", light.direction);
            }
        }

        #[test]
        fn the_solid_angle_is_that_of_finite_differences(
            which in 0usize..3, u in 0.0f64..639.0, v in 0.0f64..479.0, distance_m in 0.6f64..1e4,
        ) {
            const STEP_PX: f64 = 1e-3;
            let (intrinsics, optics, camera_from_world) = arrangement(which);
            let map = ProbeMap { intrinsics: &intrinsics, camera_from_world, optics: &optics };
            let sphere = LightSphere { origin_m: CENTER_M + DVec3::new(-0.1, 0.2, 0.1), distance_m };
            let pixel = DVec2::new(u, v);
            let at = |step: DVec2| map.light(pixel + step * STEP_PX, &sphere);
            let (Some(here), Some(left), Some(right), Some(up), Some(down)) =
                (at(DVec2::ZERO), at(DVec2::NEG_X), at(DVec2::X), at(DVec2::NEG_Y), at(DVec2::Y))
            else {
                return Ok(());
            };
            // Within a few thousandths of a pixel of the outline differences say little.
            let place = map.place(sphere.origin_m + here.direction * distance_m).expect("it was seen");
            prop_assume!(place.outline_px > 0.5);
            let across = (right.direction - left.direction) / (2.0 * STEP_PX);
            let along = (down.direction - up.direction) / (2.0 * STEP_PX);
            let expected = across.cross(along).length();
            let error = here.solid_angle_per_pixel / expected - 1.0;
            prop_assert!(error.abs() < 1e-4, "{} {expected}", here.solid_angle_per_pixel);
        }

        #[test]
        fn the_outline_is_where_rays_touch_the_ball(x in -1.0f64..1.0, y in -1.0f64..1.0, z in -1.0f64..1.0) {
            let ball = MirrorBall { center_m: CENTER_M, radius_m: 0.05 };
            let camera_m = CENTER_M + DVec3::new(0.2, -0.3, 0.25);
            let normal = DVec3::new(x, y, z);
            prop_assume!(normal.length() > 0.1);
            let outline = ball.outline_beside(camera_m, CENTER_M + 0.05 * normal.normalize());
            prop_assert!((outline.distance(CENTER_M) - 0.05).abs() < 1e-12);
            prop_assert!((outline - camera_m).dot(outline - CENTER_M).abs() < 1e-12);
        }
    }

    #[test]
    fn the_pixels_of_a_ball_sum_to_what_it_can_see() {
        const PARTS: u32 = 2;
        for radius_m in [0.05, 0.15] {
            let camera_m = CENTER_M + DVec3::new(0.2, -0.3, 0.25);
            let intrinsics = lens(400.0, DISTORTED);
            let optics = ball(radius_m);
            let map = ProbeMap {
                intrinsics: &intrinsics,
                camera_from_world: looking_at(CENTER_M, camera_m),
                optics: &optics,
            };
            let sphere = LightSphere {
                origin_m: CENTER_M,
                distance_m: 1e7,
            };
            let mut sum = 0.0;
            for index in 0..640 * 480 * PARTS * PARTS {
                let (column, row) = (index % (640 * PARTS), index / (640 * PARTS));
                let pixel = (DVec2::new(f64::from(column), f64::from(row)) + 0.5) / f64::from(PARTS) - 0.5;
                sum += map
                    .light(pixel, &sphere)
                    .map_or(0.0, |light| light.solid_angle_per_pixel);
            }
            sum /= f64::from(PARTS * PARTS);
            // Rays that touch the ball go straight on, so all is seen but a cone of the ball's own angular radius.
            let expected = 2.0 * PI * (1.0 + (radius_m / camera_m.distance(CENTER_M)).asin().cos());
            // Samples half a pixel apart along an outline of 45 and 140 pixels' radius.
            assert!((sum / expected - 1.0).abs() < 3e-3, "{sum} {expected}");
        }
    }

    #[test]
    fn every_pixel_of_a_distant_ball_covers_the_same_solid_angle() {
        let camera_m = CENTER_M + 500.0 * DVec3::new(0.2, -0.3, 0.25).normalize();
        let intrinsics = lens(1e6, PINHOLE);
        let optics = ball(0.05);
        let map = ProbeMap {
            intrinsics: &intrinsics,
            camera_from_world: looking_at(CENTER_M, camera_m),
            optics: &optics,
        };
        let sphere = LightSphere {
            origin_m: CENTER_M,
            distance_m: 1e7,
        };
        // 100 pixels across: 4π over the disc's area.
        let expected = 4.0 / (100.0 * 99.8);
        for (x, y) in [(0.0, 0.0), (50.0, 20.0), (-70.0, 10.0), (0.0, 90.0), (60.0, -70.0)] {
            let pixel = intrinsics.principal_point_px + DVec2::new(x, y);
            let light = map.light(pixel, &sphere).expect("on the ball");
            assert!(
                (light.solid_angle_per_pixel / expected - 1.0).abs() < 1e-3,
                "at {x}, {y}"
            );
        }
    }

    /// Median angle between a direction and what the picture shows at the place where the simple map looks for it.
    fn error_of_the_simple_map_deg(distance_m: f64) -> f64 {
        let intrinsics = lens(600.0, PINHOLE);
        let optics = ball(0.05);
        let map = ProbeMap {
            intrinsics: &intrinsics,
            camera_from_world: looking_at(
                CENTER_M,
                CENTER_M + DVec3::new(0.2, -0.3, 0.25).normalize() * distance_m,
            ),
            optics: &optics,
        };
        let sphere = LightSphere {
            origin_m: CENTER_M,
            distance_m: 1e7,
        };
        let mut errors: Vec<f64> = (0..4000)
            .filter_map(|i| {
                let z = 1.0 - (f64::from(i) + 0.5) / 2000.0;
                let turn = 2.399_963_229_728_653 * f64::from(i);
                let direction = DVec3::new((1.0 - z * z).sqrt() * turn.cos(), (1.0 - z * z).sqrt() * turn.sin(), z);
                let found = map.light(map.simple_pixel(direction, 1.0)?, &sphere)?;
                Some(found.direction.angle_between(direction).to_degrees())
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    }

    #[test]
    fn the_simple_map_is_degrees_off() {
        // A ball of 100 mm: in the plane of axis and light, a place at ρ of the radius shows 2 asin ρ to the simple map and
        // θ + atan2(a sin θ, a cos θ - 1) with a = distance / radius exactly; the median over the sphere is 4.5° at 0.5 m and
        // 2.1° at 1 m. (With a disc fitted to the outline instead of the bounding rectangle of 2006: 3.8° and 1.9°.)
        let (near, far) = (error_of_the_simple_map_deg(0.5), error_of_the_simple_map_deg(1.0));
        assert!((near - 4.5).abs() < 0.3 && (far - 2.1).abs() < 0.15, "{near} {far}");
        // From far away there is no difference.
        assert!(error_of_the_simple_map_deg(50.0) < 0.1);
    }

    #[test]
    fn wrap_stretches_the_simple_map_to_what_the_picture_shows() {
        let (intrinsics, optics, camera_from_world) = arrangement(1);
        let map = ProbeMap {
            intrinsics: &intrinsics,
            camera_from_world,
            optics: &optics,
        };
        let world_from_camera = camera_from_world.inverse();
        let radius_px = |angle: f64, wrap: f64| {
            let direction = world_from_camera.transform_vector(DVec3::new(angle.sin(), 0.0, angle.cos()));
            map.simple_pixel(direction, wrap).expect("a place").x - intrinsics.principal_point_px.x
        };
        let rim_px = intrinsics.focal_px.x * 2.0 * 0.8f64.sin();
        // The rim shows minus the cosine of half the angle; beyond it stays the rim.
        assert!((radius_px(FRAC_PI_2, 0.0) - rim_px).abs() < 1e-9);
        assert!((radius_px(2.6, -2.6f64.cos()) - rim_px).abs() < 1e-9);
        assert!((radius_px(2.9, -2.6f64.cos()) - rim_px).abs() < 1e-9);
        assert!(radius_px(FRAC_PI_2, 1.0) < 0.71 * rim_px);
    }
}
