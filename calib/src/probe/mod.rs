//! The light probe in one picture: from pixels of a mirror ball or a fisheye camera to radiance from every direction.
//!
//! [`radiance`] turns codes into radiance, [`mirror_ball`] says where on the ball a light is seen, [`mapping`] which pixel
//! shows it, [`mod@radiance_map`] asks the picture for every direction of a [`cube`], [`fill`] puts plausible light where nobody saw any, [`sh`] sums all of it
//! up in nine numbers. What happens over time, and with other cameras' help, is the render node's.

pub mod cube;
pub mod equirectangular;
pub mod fill;
pub mod fusion;
pub mod mapping;
pub mod mirror_ball;
pub mod outline;
pub mod radiance;
pub mod radiance_map;
pub mod sh;

use glam::{DVec3, Vec3};

use crate::pose::Pose;
use crate::rig::{Camera, Rig, Role};
use mirror_ball::MirrorBall;
use radiance::Picture;

/// Why a rig has no light probe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoProbe {
    /// The fisheye camera's place is not known.
    #[error("the fisheye camera has no `camera_from_world`")]
    Pose,
    /// Nothing that shows the light is described.
    #[error("there is neither a ball nor a fisheye")]
    Neither,
}

/// What looks at the light.
#[derive(Debug, Clone, PartialEq)]
pub enum ProbeOptics {
    /// A mirror ball.
    MirrorBall {
        /// Where it stands.
        ball: MirrorBall,
        /// Linear reflectance of red, green and blue.
        reflectance: Vec3,
    },
    /// A fisheye lens at this place of the world, metres.
    Fisheye {
        /// The camera's centre.
        lens_m: DVec3,
    },
}

impl ProbeOptics {
    /// The probe that a rig has: its fisheye camera, else its mirror ball.
    ///
    /// # Errors
    /// [`NoProbe`] when it has neither.
    pub fn of_rig(rig: &Rig) -> Result<Self, NoProbe> {
        if let Some(camera) = rig.probe_camera()
            && camera.role == Role::Fisheye
        {
            let camera_from_world = camera.camera_from_world.ok_or(NoProbe::Pose)?;
            return Ok(Self::Fisheye {
                lens_m: camera_from_world.inverse().translation,
            });
        }
        let ball = rig.ball.as_ref().ok_or(NoProbe::Neither)?;
        Ok(Self::MirrorBall {
            ball: MirrorBall {
                center_m: ball.center_m,
                radius_m: ball.radius_m,
            },
            reflectance: DVec3::from_array(ball.reflectance).as_vec3(),
        })
    }

    /// Ball centre or lens, world frame, metres.
    #[must_use]
    pub fn position_m(&self) -> Vec3 {
        match self {
            Self::MirrorBall { ball, .. } => ball.center_m.as_vec3(),
            Self::Fisheye { lens_m } => lens_m.as_vec3(),
        }
    }

    /// Phantoms nearer to the probe than this are the probe itself, metres.
    #[must_use]
    pub fn own_extent_m(&self) -> f32 {
        match self {
            Self::MirrorBall { ball, .. } => 1.05 * ball.radius_m as f32,
            Self::Fisheye { .. } => 1e-3,
        }
    }
}

/// A frame with the camera that took it, and where that was.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// Its picture.
    pub picture: Picture<'a>,
    /// Its lens and photometry.
    pub camera: &'a Camera,
    /// Its pose.
    pub camera_from_world: Pose,
}

/// What of a probe's picture is not trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trust {
    /// Cosine of the flattest reflection on the ball that is used, above 0, below 1.
    pub min_view_cosine: f32,
    /// Directions that pass this near to the camera that films the ball are its own image, metres.
    pub camera_radius_m: f32,
}

impl Default for Trust {
    fn default() -> Self {
        Self {
            min_view_cosine: 0.1,
            camera_radius_m: 0.05,
        }
    }
}
