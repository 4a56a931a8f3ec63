//! ROS: `camera_info` YAML (`camera_calibration_parsers`; models named in `sensor_msgs/distortion_models.hpp`).

use serde_saphyr::Spanned;

use super::{
    ForeignCamera, InterchangeError, Source, list,
    matrices::{MatrixFile, camera_matrix},
};
use crate::camera::Model;

/// Names of the models. `fisheye` is what some drivers write for `equidistant`.
const MODELS: &str = "`plumb_bob`, `rational_polynomial`, `equidistant`, `fisheye`";

pub(super) fn read(source: &Source<'_>) -> Result<ForeignCamera, InterchangeError> {
    let file: MatrixFile = source.parse()?;
    // Files from before `distortion_model` was introduced hold a `plumb_bob`.
    let model = match &file.distortion_model {
        Some(name) => model(source, name)?,
        None => None,
    };
    Ok(ForeignCamera {
        intrinsics: file.intrinsics(source, model)?,
        name: file.camera_name.unwrap_or_else(|| "camera".to_owned()),
        camera_from_previous: None,
    })
}

/// The model of a name; `None` for OpenCV's family of perspective lenses.
pub(super) fn model(source: &Source<'_>, name: &Spanned<String>) -> Result<Option<Model>, InterchangeError> {
    match name.value.as_str() {
        "plumb_bob" | "rational_polynomial" => Ok(None),
        "equidistant" | "fisheye" => Ok(Some(Model::KannalaBrandt)),
        found => Err(InterchangeError::Model {
            place: source.place_of(name),
            found: found.to_owned(),
            allowed: MODELS,
        }),
    }
}

pub(super) fn write(camera: &ForeignCamera) -> String {
    let intrinsics = &camera.intrinsics;
    let [width, height] = intrinsics.size_px;
    let coefficients = intrinsics.lens.coefficients();
    let model = match intrinsics.lens.model() {
        Model::KannalaBrandt => "equidistant",
        Model::Rational => "rational_polynomial",
        Model::BrownConrady | Model::Equisolid | Model::Eucm | Model::DoubleSphere => "plumb_bob",
    };
    let matrix = camera_matrix(intrinsics);
    let [fx, _, cx, _, fy, cy, ..] = matrix;
    format!(
        "image_width: {width}\nimage_height: {height}\ncamera_name: {}\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: {}\n\
         distortion_model: {model}\ndistortion_coefficients:\n  rows: 1\n  cols: {}\n  data: {}\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: {}\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: {}\n",
        camera.name,
        list(&matrix),
        coefficients.len(),
        list(&coefficients),
        list(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        list(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    )
}
