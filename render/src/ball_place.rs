//! Where the mirror ball really is: its outline in the pictures corrects what was measured with a ruler.
//!
//! Every picture tells the two coordinates across its line of sight (`calib::probe::outline`); pictures from different sides
//! tell all three. They are weighted by their certainty and added to what the rig file says, which counts as one measurement
//! good to a millimetre: the information form of the Kalman filter for something that stands still.

use glam::{DMat3, DVec3, Vec3};
use mirrorball_calib::probe::View;
use mirrorball_calib::probe::mirror_ball::MirrorBall;
use mirrorball_calib::probe::outline::{OutlineError, OutlineFinder, OutlineFit};

/// Standard deviation of a ball's place measured with a ruler, metres.
const RULER_SIGMA_M: f64 = 1e-3;
/// Least standard deviation of one picture's answer, metres: pose and lens err alike in all pictures.
const PICTURE_SIGMA_M: f64 = 2e-4;
/// Pictures that count at most, so that a ball that is moved is followed.
const MEMORY: f64 = 30.0;

/// The ball's place as known so far.
#[derive(Debug)]
pub struct BallPlace {
    measured_m: DVec3,
    radius_m: f64,
    reflectance: Vec3,
    /// Inverse covariance of the shift, and that times the shift.
    information: DMat3,
    weighted_m: DVec3,
    finder: OutlineFinder,
}

impl BallPlace {
    /// The ball where the rig file says that it is.
    #[must_use]
    pub fn new(ball: &MirrorBall, reflectance: Vec3) -> Self {
        Self {
            measured_m: ball.center_m,
            radius_m: ball.radius_m,
            reflectance,
            information: ruler(),
            weighted_m: DVec3::ZERO,
            finder: OutlineFinder::default(),
        }
    }

    /// The ball as known so far.
    #[must_use]
    pub fn ball(&self) -> MirrorBall {
        MirrorBall {
            center_m: self.measured_m + self.shift_m(),
            radius_m: self.radius_m,
        }
    }

    /// Linear reflectance of red, green and blue.
    #[must_use]
    pub fn reflectance(&self) -> Vec3 {
        self.reflectance
    }

    /// From the place in the rig file to the one in the pictures, world frame, metres.
    #[must_use]
    pub fn shift_m(&self) -> DVec3 {
        self.information.inverse() * self.weighted_m
    }

    /// Takes a picture of the ball in.
    ///
    /// # Errors
    /// [`OutlineError`] when the picture does not tell; nothing changes then.
    pub fn see(&mut self, view: &View<'_>) -> Result<OutlineFit, OutlineError> {
        let measured = MirrorBall {
            center_m: self.measured_m,
            radius_m: self.radius_m,
        };
        let fit = self.finder.find(view, &measured, self.reflectance)?;
        let camera_m = view.camera_from_world.inverse().translation;
        self.learn(&fit, (self.measured_m - camera_m).normalize_or(DVec3::Z));
        Ok(fit)
    }

    fn learn(&mut self, fit: &OutlineFit, line_of_sight: DVec3) {
        let along = DMat3::from_cols(
            line_of_sight * line_of_sight.x,
            line_of_sight * line_of_sight.y,
            line_of_sight * line_of_sight.z,
        );
        let across = DMat3::IDENTITY - along;
        let variance = fit.sigma_m.powi(2) + PICTURE_SIGMA_M.powi(2);
        // What was learnt fades, what the ruler said does not.
        let kept = 1.0 - 1.0 / MEMORY;
        self.information = ruler() + (self.information - ruler()) * kept + across * (1.0 / variance);
        self.weighted_m = self.weighted_m * kept + across * fit.shift_m / variance;
    }
}

fn ruler() -> DMat3 {
    DMat3::IDENTITY * (1.0 / (RULER_SIGMA_M * RULER_SIGMA_M))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    fn fit(shift_m: DVec3) -> OutlineFit {
        OutlineFit {
            center_m: shift_m,
            shift_m,
            sigma_m: 1e-4,
            shift_px: DVec2::ZERO,
            sigma_px: 0.1,
            deviation_squared: 100.0,
            growth_px: 0.0,
            n_used: 50,
            n_profiles: 100,
        }
    }

    #[test]
    fn views_from_two_sides_find_all_three_coordinates() {
        let ball = MirrorBall {
            center_m: DVec3::new(0.2, 0.1, 0.05),
            radius_m: 0.04,
        };
        let mut place = BallPlace::new(&ball, Vec3::ONE);
        let shift = DVec3::new(0.002, -0.001, 0.0015);
        for k in 0..20 {
            let sight = if k % 2 == 0 {
                DVec3::X
            } else {
                DVec3::new(0.0, 0.6, -0.8)
            };
            place.learn(&fit(shift - sight * shift.dot(sight)), sight);
        }
        assert!((place.shift_m() - shift).length() < 5e-5, "{}", place.shift_m());
        assert!((place.ball().center_m - ball.center_m - shift).length() < 5e-5);
    }

    #[test]
    fn without_pictures_the_ruler_is_believed() {
        let ball = MirrorBall {
            center_m: DVec3::X,
            radius_m: 0.04,
        };
        assert_eq!(BallPlace::new(&ball, Vec3::ONE).ball(), ball);
    }
}
