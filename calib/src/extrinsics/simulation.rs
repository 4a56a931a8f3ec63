//! Markers seen by cameras of known places, for tests.

use glam::{DMat3, DVec2, DVec3};

use super::View;
use crate::{
    camera::{Intrinsics, LensModel},
    pose::{Pose, Twist},
    rig::Marker,
    tag::{Detection, Family},
};

/// Seeded noise (SplitMix64; Steele et al. 2014).
pub(super) struct Noise(pub(super) u64);

impl Noise {
    pub(super) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Box and Muller 1958.
    pub(super) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    pub(super) fn vector(&mut self, sigma: f64) -> DVec3 {
        DVec3::new(self.normal(), self.normal(), self.normal()) * sigma
    }
}

pub(super) fn lens() -> Intrinsics {
    Intrinsics {
        size_px: [1280, 960],
        focal_px: DVec2::new(1000.0, 1002.0),
        principal_point_px: DVec2::new(642.0, 477.0),
        lens: LensModel::BrownConrady {
            k1: -0.1,
            k2: 0.03,
            p1: 1e-4,
            p2: -2e-4,
            k3: 0.0,
        },
    }
}

pub(super) fn pose(rotation: [f64; 3], translation: [f64; 3]) -> Pose {
    let turn = Pose::exp(Twist {
        rotation: DVec3::from_array(rotation),
        translation: DVec3::ZERO,
    });
    Pose {
        rotation: turn.rotation,
        translation: DVec3::from_array(translation),
    }
}

/// Looks at a point from another one, upright in the picture where world z is up.
pub(super) fn looking_at(target: DVec3, from: DVec3) -> Pose {
    let forward = (target - from).normalize();
    let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Pose {
        rotation,
        translation: -(rotation * from),
    }
}

/// A camera somewhere above the markers, `distance_m` away, looking about their middle.
pub(super) fn somewhere(noise: &mut Noise, distance_m: [f64; 2]) -> Pose {
    let (turn, tilt) = (noise.between(0.0, std::f64::consts::TAU), noise.between(0.2, 1.0));
    let direction = DVec3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos());
    let target = noise.vector(0.03);
    looking_at(target, direction * noise.between(distance_m[0], distance_m[1]))
}

pub(super) fn marker(id: u32, side_m: f64, world_from_marker: Pose) -> Marker {
    Marker {
        family: Family::Tag36h11,
        id,
        side_m,
        white_reflectance: 0.8,
        world_from_marker,
    }
}

/// Five markers on a table and on boxes, the main one in the middle.
pub(super) fn field() -> Vec<Marker> {
    vec![
        marker(0, 0.08, Pose::identity()),
        marker(1, 0.04, pose([0.0, 0.0, 0.3], [-0.11, -0.07, 0.0])),
        marker(2, 0.04, pose([0.0, 0.0, 0.0], [0.11, 0.07, 0.0])),
        marker(3, 0.05, pose([0.5, 0.1, 0.0], [-0.12, 0.09, 0.03])),
        marker(4, 0.05, pose([0.0, -0.6, 0.4], [0.13, -0.08, 0.04])),
    ]
}

/// What a camera sees of markers, with noise in every corner: those that are whole in the picture and not seen from behind.
pub(super) fn see(
    markers: &[Marker],
    intrinsics: &Intrinsics,
    camera_from_world: &Pose,
    (noise, sigma_px): (&mut Noise, f64),
) -> Vec<Detection> {
    let mut detections = Vec::new();
    for marker in markers {
        let camera_from_marker = *camera_from_world * marker.world_from_marker;
        let is_in_front = camera_from_marker.rotation.z_axis.dot(camera_from_marker.translation) < 0.0;
        let corners = marker.corners_world().map(|corner| {
            let pixel = intrinsics.project(camera_from_world.transform_point(corner));
            pixel.filter(|pixel| intrinsics.contains(*pixel))
        });
        if let (true, [Some(a), Some(b), Some(c), Some(d)]) = (is_in_front, corners) {
            detections.push(Detection {
                family: marker.family,
                id: marker.id,
                hamming: 0,
                decision_margin: 100.0,
                corners_px: [a, b, c, d].map(|pixel| pixel + noise.vector(sigma_px).truncate()),
            });
        }
    }
    detections
}

/// Pictures of markers by a camera that moves about.
pub(super) fn tour(markers: &[Marker], n: usize, noise: &mut Noise, sigma_px: f64) -> Vec<View> {
    let view = |index: usize| {
        let camera_from_world = somewhere(noise, [0.5, 1.0]);
        View {
            name: format!("{index:06}.png"),
            detections: see(markers, &lens(), &camera_from_world, (noise, sigma_px)),
        }
    };
    (0..n).map(view).collect()
}

/// The twist between two poses, in units of their covariance: squared (Mahalanobis), 6 on average.
pub(super) fn squared_deviations(twist: Twist, covariance: &nalgebra::Matrix6<f64>) -> f64 {
    let (r, t) = (twist.rotation, twist.translation);
    let error = nalgebra::Vector6::new(r.x, r.y, r.z, t.x, t.y, t.z);
    let factor = covariance.cholesky().expect("a covariance is positive definite");
    error.dot(&factor.solve(&error))
}
