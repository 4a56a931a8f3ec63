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
