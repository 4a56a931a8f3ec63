//! OpenCV: YAML as `cv::FileStorage` writes it.
//!
//! The coefficients alone do not tell a fisheye's k1 k2 k3 k4 from a perspective lens' k1 k2 p1 p2. A fisheye is marked by
//! `fisheye_model: 1`, as OpenCV's calibration sample does, or by `distortion_model: fisheye` or `equidistant`; without either
//! four coefficients are k1 k2 p1 p2.

use super::{
    ForeignCamera, InterchangeError, Source, list,
    matrices::{MatrixFile, camera_matrix},
    ros,
};
use crate::camera::Model;

pub(super) fn read(source: &Source<'_>) -> Result<ForeignCamera, InterchangeError> {
    let file: MatrixFile = source.parse()?;
    let model = match &file.distortion_model {
        _ if file.fisheye_model.is_some_and(|mark| mark != 0) => Some(Model::KannalaBrandt),
        Some(model) => ros::model(source, model)?,
        None => None,
    };
    Ok(ForeignCamera {
        intrinsics: file.intrinsics(source, model)?,
        name: file.camera_name.unwrap_or_else(|| "camera".to_owned()),
        camera_from_previous: None,
    })
}

pub(super) fn write(camera: &ForeignCamera) -> String {
    let intrinsics = &camera.intrinsics;
    let [width, height] = intrinsics.size_px;
    let coefficients = intrinsics.lens.coefficients();
    format!(
        "%YAML:1.0\n---\nimage_width: {width}\nimage_height: {height}\nfisheye_model: {}\n\
         camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {}\n\
         distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: {}\n   dt: d\n   data: {}\n",
        u8::from(intrinsics.lens.model() == Model::KannalaBrandt),
        list(&camera_matrix(intrinsics)),
        coefficients.len(),
        list(&coefficients),
    )
}
