//! The layout that OpenCV's and ROS' files share: a camera matrix, and coefficients as a matrix of their own.

use serde::Deserialize;
use serde_saphyr::Spanned;

use super::{InterchangeError, Source, pinhole};
use crate::camera::{Intrinsics, Model};

/// The keys that matter; rectification, projection and whatever else is there is left alone.
#[derive(Deserialize)]
pub(super) struct MatrixFile {
    #[serde(alias = "image_Width")]
    image_width: Spanned<i64>,
    #[serde(alias = "image_Height")]
    image_height: Spanned<i64>,
    pub(super) camera_name: Option<String>,
    #[serde(alias = "Camera_Matrix")]
    camera_matrix: Spanned<Matrix>,
    pub(super) distortion_model: Option<Spanned<String>>,
    /// Written by OpenCV's calibration sample.
    pub(super) fisheye_model: Option<i64>,
    #[serde(alias = "Distortion_Coefficients")]
    distortion_coefficients: Spanned<Matrix>,
}

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

impl MatrixFile {
    /// The camera, through a lens of a model; `None` stands for OpenCV's family, of which the number of coefficients tells
    /// the member.
    pub(super) fn intrinsics(&self, source: &Source<'_>, model: Option<Model>) -> Result<Intrinsics, InterchangeError> {
        let size = [&self.image_width, &self.image_height];
        let size_px = source.size(size, ["image_width", "image_height"])?;
        let matrix = &self.camera_matrix;
        let focal_and_centre = match matrix.value.data[..] {
            [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
                if fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|x| x.is_finite()) =>
            {
                [fx, fy, cx, cy]
            }
            _ => {
                let allowed = "fx 0 cx, 0 fy cy, 0 0 1 with focal lengths above 0";
                return Err(source.refuse(matrix, "camera_matrix", &matrix.value.data, allowed));
            }
        };
        let distortion = &self.distortion_coefficients;
        let mut coefficients = distortion.value.data.clone();
        let model = match model {
            Some(model) => model,
            None => source.family_member(distortion, &mut coefficients)?,
        };
        let coefficients = Spanned::new(coefficients, distortion.referenced, distortion.defined);
        let pinhole = pinhole(size_px, focal_and_centre);
        source.with_lens(pinhole, model, &coefficients, "distortion_coefficients")
    }
}

impl Source<'_> {
    /// The model of OpenCV's family that has these coefficients: 0, 4, 5, 8, 12 or 14 of k1 k2 p1 p2 k3 k4 k5 k6 s1 … s4 τx τy
    /// (`cv::calibrateCamera` gives 14 for the rational model). They are filled up or cut to the model's number.
    fn family_member(&self, value: &Spanned<Matrix>, coefficients: &mut Vec<f64>) -> Result<Model, InterchangeError> {
        let n = coefficients.len();
        let allowed = "0, 4, 5 or 8 numbers: k1, k2, p1, p2, k3, k4, k5, k6; or 12 or 14 of which the rest is 0";
        let rest_is_zero = coefficients.iter().skip(8).all(|&x| x == 0.0);
        if ![0, 4, 5, 8, 12, 14].contains(&n) || !rest_is_zero {
            return Err(self.refuse(value, "distortion_coefficients", coefficients, allowed));
        }
        let (model, count) = if n > 5 {
            (Model::Rational, 8)
        } else {
            (Model::BrownConrady, 5)
        };
        coefficients.resize(count, 0.0);
        Ok(model)
    }
}

/// The camera matrix, row by row.
pub(super) fn camera_matrix(intrinsics: &Intrinsics) -> [f64; 9] {
    let (focal, centre) = (intrinsics.focal_px, intrinsics.principal_point_px);
    [focal.x, 0.0, centre.x, 0.0, focal.y, centre.y, 0.0, 0.0, 1.0]
}
