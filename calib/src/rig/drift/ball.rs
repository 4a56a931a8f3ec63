//! Whether the mirror ball is where the rig has it: its outline in pictures of cameras whose places are known.

use std::fmt;

use glam::{DMat3, DVec3, Vec3};

use super::{Matters, verdict::Finding};
use crate::{
    probe::{
        View,
        mirror_ball::MirrorBall,
        outline::{OutlineFinder, OutlineSettings},
    },
    rig::Rig,
};

/// How far from its place the ball is looked for, metres; less where it is small in the picture.
const SEARCH_M: f64 = 0.01;

/// What a camera's pose and lens add to the standard deviation of a sighting, metres; of the recordings with truth.
const POSE_SIGMA_M: f64 = 2e-4;

/// Standard deviation of what no picture says, metres: along the line of sight of a single camera.
const UNKNOWN_M: f64 = 0.1;

/// Collects what the pictures of a recording show of the ball.
pub struct BallCheck {
    ball: MirrorBall,
    reflectance: Vec3,
    finder: OutlineFinder,
    sightings: Vec<Sighting>,
}

/// A shift that a picture shows, across the line of sight.
struct Sighting {
    camera: String,
    shift_m: DVec3,
    /// Inverse covariance, 1/m²; 0 along the line of sight.
    information: DMat3,
}

/// Where the ball is, against where the rig has it.
#[derive(Debug, Clone, PartialEq)]
pub struct BallPlace {
    /// Pictures in which its outline was found.
    pub pictures: usize,
    /// From its place in the rig to the one that the pictures show, world frame, metres.
    pub shift_m: DVec3,
    /// Standard deviation along the shift, metres.
    pub sigma_m: f64,
    /// The one camera that shows it, if there is but one.
    pub only_camera: Option<String>,
}

impl BallCheck {
    /// Without any picture yet; `None` when the rig has no ball.
    #[must_use]
    pub fn new(rig: &Rig) -> Option<Self> {
        let ball = rig.ball.as_ref()?;
        Some(Self {
            ball: MirrorBall {
                center_m: ball.center_m,
                radius_m: ball.radius_m,
            },
            reflectance: DVec3::from_array(ball.reflectance).as_vec3(),
            finder: OutlineFinder::new(OutlineSettings {
                search_m: SEARCH_M,
                ..OutlineSettings::default()
            }),
            sightings: Vec::new(),
        })
    }

    /// Takes in a picture; one that does not show the ball's outline says nothing.
    pub fn add(&mut self, view: &View<'_>) {
        let Ok(fit) = self.finder.find(view, &self.ball, self.reflectance) else {
            return;
        };
        let sight = (self.ball.center_m - view.camera_from_world.inverse().translation).normalize();
        let along = DMat3::from_cols(sight * sight.x, sight * sight.y, sight * sight.z);
        let variance = fit.sigma_m.powi(2) + POSE_SIGMA_M.powi(2);
        self.sightings.push(Sighting {
            camera: view.camera.name.clone(),
            shift_m: fit.shift_m,
            information: (DMat3::IDENTITY - along) * (1.0 / variance),
        });
    }

    /// Where the pictures together show the ball; `None` when none shows its outline.
    #[must_use]
    pub fn place(&self) -> Option<BallPlace> {
        let first = self.sightings.first()?;
        let mut information = DMat3::IDENTITY * (1.0 / (UNKNOWN_M * UNKNOWN_M));
        let mut weighted = DVec3::ZERO;
        for sighting in &self.sightings {
            information += sighting.information;
            weighted += sighting.information * sighting.shift_m;
        }
        let covariance = information.inverse();
        let shift_m = covariance * weighted;
        // Each picture gives two numbers; pictures that contradict each other are worth less than they claim.
        let misfits = self.sightings.iter().map(|sighting| {
            let off = sighting.shift_m - shift_m;
            off.dot(sighting.information * off)
        });
        let misfit: f64 = misfits.sum();
        let freedom = (2 * self.sightings.len()).saturating_sub(3).max(1) as f64;
        let direction = shift_m.normalize_or(DVec3::X);
        let is_only = self.sightings.iter().all(|sighting| sighting.camera == first.camera);
        Some(BallPlace {
            pictures: self.sightings.len(),
            shift_m,
            sigma_m: (direction.dot(covariance * direction) * (misfit / freedom).max(1.0)).sqrt(),
            only_camera: is_only.then(|| first.camera.clone()),
        })
    }
}

impl BallPlace {
    /// That the ball has moved, if it has by more than chance and more than matters. The cameras' places must be known: of a
    /// rig in which something else has moved, this says nothing.
    #[must_use]
    pub fn finding(&self, matters: &Matters) -> Option<Finding> {
        let exceeds = self.shift_m.length() - matters.sigmas * self.sigma_m > matters.distance_m;
        exceeds.then(|| Finding::BallMoved { place: self.clone() })
    }
}

impl fmt::Display for BallPlace {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (distance, sigma) = (1e3 * self.shift_m.length(), 1e3 * self.sigma_m);
        write!(formatter, "{distance:.2} ± {sigma:.2} mm")
    }
}
