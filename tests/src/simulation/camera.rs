//! The cameras of a rig file: where they stand, which ray falls on which pixel.

use crate::{ToolError, json};
use glam::{DMat3, DMat4, DVec3};
use serde::Deserialize;
use std::path::Path;

/// Steps of the inversion of a lens; both models converge to 1e-12 in fewer.
const INVERSION_STEPS: usize = 30;

/// What a rig file says, as far as pictures are simulated from it.
#[derive(Clone, Debug, Deserialize)]
pub struct SimulatedRig {
    /// All cameras.
    #[serde(rename = "camera")]
    pub cameras: Vec<Camera>,
    /// The mirror ball, if there is one.
    pub ball: Option<Ball>,
}

/// A mirror ball without roughness.
#[derive(Clone, Debug, Deserialize)]
pub struct Ball {
    /// Centre in the world, metres.
    pub center_m: [f64; 3],
    /// Radius in metres.
    pub radius_m: f64,
    /// Linear reflectance of red, green and blue, the same at all angles.
    pub reflectance: [f64; 3],
}

/// A camera.
#[derive(Clone, Debug, Deserialize)]
pub struct Camera {
    /// Name, as in `frames.csv`.
    pub name: String,
    /// `scene`, `ball` or `fisheye`.
    pub role: String,
    /// Width and height.
    pub size_px: [u32; 2],
    /// Rows of the pose; `None` for a camera that moves.
    camera_from_world: Option<[[f64; 4]; 3]>,
    /// The lens.
    pub lens: Lens,
    /// From radiance to codes.
    pub photometry: Photometry,
}

/// A lens.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "model", rename_all = "snake_case")]
pub enum Lens {
    /// Brown (1971) and Conrady (1919), as OpenCV writes them.
    BrownConrady {
        /// Focal lengths in pixels.
        focal_px: [f64; 2],
        /// Principal point in pixels.
        principal_point_px: [f64; 2],
        /// k1, k2, p1, p2, k3.
        distortion: [f64; 5],
    },
    /// Kannala and Brandt (2006), OpenCV's fisheye.
    KannalaBrandt {
        /// Focal lengths in pixels.
        focal_px: [f64; 2],
        /// Principal point in pixels.
        principal_point_px: [f64; 2],
        /// k1, k2, k3, k4.
        distortion: [f64; 4],
        /// Angle to the optical axis up to which there is a picture.
        max_angle_deg: f64,
    },
}

/// From radiance to codes.
#[derive(Clone, Debug, Deserialize)]
pub struct Photometry {
    /// Signal per second and radiance.
    pub sensitivity: f64,
    /// v1, v2 in 1 + v1 r² + v2 r⁴.
    pub vignetting: [f64; 2],
    /// Electrons at full scale and gain 1.
    pub full_well_e: f64,
    /// Standard deviation of the read noise in electrons.
    pub read_noise_e: f64,
    /// The response.
    pub response: Response,
}

/// A response curve.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// The sRGB transfer curve (IEC 61966-2-1).
    Srgb,
}

impl SimulatedRig {
    /// Reads a rig file.
    ///
    /// # Errors
    /// When the file is missing, or says what is not simulated: another lens, a response that is a table.
    pub fn load(path: &Path) -> Result<Self, ToolError> {
        toml::from_str(&json::read_text(path, "the rig of the recording")?).map_err(|source| ToolError::Toml {
            path: path.to_owned(),
            source: Box::new(source),
        })
    }

    /// Returns the camera with the role `scene`.
    pub fn scene_camera(&self) -> Option<&Camera> {
        self.cameras.iter().find(|camera| camera.role == "scene")
    }

    /// Returns the first camera that stands still.
    pub fn probe_camera(&self) -> Option<&Camera> {
        self.cameras.iter().find(|camera| camera.role != "scene")
    }
}

impl Camera {
    /// Returns the camera where it stood when it took a frame.
    #[must_use]
    pub fn placed(&self, camera_from_world: DMat4) -> Self {
        let rows = camera_from_world.transpose().to_cols_array_2d();
        Self {
            camera_from_world: Some([rows[0], rows[1], rows[2]]),
            ..self.clone()
        }
    }

    /// Returns the centre in the world, metres; the origin for a camera that moves.
    pub fn center_m(&self) -> DVec3 {
        let translation = self
            .camera_from_world
            .map_or(DVec3::ZERO, |rows| DVec3::from_array(rows.map(|row| row[3])));
        -(self.world_from_camera() * translation)
    }

    /// Returns the unit vector in the world along which a point of the picture looks; `None` outside the image circle.
    pub fn ray(&self, at_px: [f64; 2]) -> Option<DVec3> {
        Some(self.world_from_camera() * self.lens.ray(at_px)?)
    }

    /// Returns the vignetting factor of a pixel.
    pub fn vignetting(&self, column: u32, row: u32) -> f64 {
        let [width, height] = self.size_px.map(f64::from);
        let [x, y] = [
            f64::from(column) - 0.5 * (width - 1.0),
            f64::from(row) - 0.5 * (height - 1.0),
        ];
        let r2 = (x * x + y * y) / (0.25 * (width * width + height * height));
        let [v1, v2] = self.photometry.vignetting;
        1.0 + v1 * r2 + v2 * r2 * r2
    }

    fn world_from_camera(&self) -> DMat3 {
        // The rows of a rotation are the columns of its inverse.
        self.camera_from_world.map_or(DMat3::IDENTITY, |rows| {
            DMat3::from_cols_array_2d(&rows.map(|[x, y, z, _]| [x, y, z]))
        })
    }
}

impl Lens {
    /// Returns the unit vector in the camera's frame that falls on a point of the picture.
    pub fn ray(&self, at_px: [f64; 2]) -> Option<DVec3> {
        match self {
            Self::BrownConrady {
                focal_px,
                principal_point_px,
                distortion,
            } => {
                let [x, y] = undistorted(on_image_plane(at_px, *focal_px, *principal_point_px), distortion);
                Some(DVec3::new(x, y, 1.0).normalize())
            }
            Self::KannalaBrandt {
                focal_px,
                principal_point_px,
                distortion,
                max_angle_deg,
            } => {
                let [x, y] = on_image_plane(at_px, *focal_px, *principal_point_px);
                let distorted = x.hypot(y);
                let angle = angle_of(distorted, distortion);
                let is_imaged = angle <= max_angle_deg.to_radians();
                let across = if distorted > 0.0 { angle.sin() / distorted } else { 0.0 };
                is_imaged.then(|| DVec3::new(x * across, y * across, angle.cos()))
            }
        }
    }
}

fn on_image_plane(at_px: [f64; 2], focal_px: [f64; 2], principal_point_px: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|axis| (at_px[axis] - principal_point_px[axis]) / focal_px[axis])
}

/// Inverts the model by fixed-point iteration, as OpenCV does.
fn undistorted([xd, yd]: [f64; 2], &[k1, k2, p1, p2, k3]: &[f64; 5]) -> [f64; 2] {
    let (mut x, mut y) = (xd, yd);
    for _ in 0..INVERSION_STEPS {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let tangential = [
            2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ];
        (x, y) = ((xd - tangential[0]) / radial, (yd - tangential[1]) / radial);
    }
    [x, y]
}

/// Solves θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) = θd for θ by Newton's method.
fn angle_of(distorted: f64, &[k1, k2, k3, k4]: &[f64; 4]) -> f64 {
    let mut angle = distorted;
    for _ in 0..INVERSION_STEPS {
        let t2 = angle * angle;
        let value = angle * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))));
        let slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)));
        let step = (value - distorted) / slope;
        angle -= step;
        if step.abs() < 1e-12 {
            break;
        }
    }
    angle
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig(name: &str) -> SimulatedRig {
        let path = format!("{}/data/{name}/recording/rig.toml", env!("CARGO_MANIFEST_DIR"));
        SimulatedRig::load(path.as_ref()).unwrap()
    }

    #[test]
    fn rays_of_both_lenses_project_back() {
        let brown = [-0.05, 0.02, -0.0003, 0.0005, 0.001];
        for (x, y) in [(0.0, 0.0), (0.5, -0.3), (-0.4, 0.4)] {
            let [k1, k2, p1, p2, k3] = brown;
            let r2: f64 = x * x + y * y;
            let radial = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
            let distorted = [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ];
            let [found_x, found_y] = undistorted(distorted, &brown);
            assert!((found_x - x).abs() < 1e-9 && (found_y - y).abs() < 1e-9);
        }
        let kannala = [-0.0121, 0.0058, -0.0021, 0.00021];
        for angle in [0.0, 0.3, 1.0, 1.6_f64] {
            let [k1, k2, k3, k4] = kannala;
            let series = k1 * angle.powi(2) + k2 * angle.powi(4) + k3 * angle.powi(6) + k4 * angle.powi(8);
            assert!((angle_of(angle * (1.0 + series), &kannala) - angle).abs() < 1e-9);
        }
    }

    #[test]
    fn the_ball_camera_looks_at_the_ball_and_the_fisheye_up() {
        let rig = rig("two_cameras");
        let (camera, ball) = (rig.probe_camera().unwrap(), rig.ball.as_ref().unwrap());
        let towards = (DVec3::from_array(ball.center_m) - camera.center_m()).normalize();
        assert!(camera.ray([319.5, 239.5]).unwrap().dot(towards) > 0.9999);
        let fisheye = self::rig("fisheye");
        let fisheye = fisheye.probe_camera().unwrap();
        assert!(fisheye.ray([319.5, 319.5]).unwrap().z > 0.99);
        assert_eq!(fisheye.ray([0.0, 0.0]), None);
    }
}
