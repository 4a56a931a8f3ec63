//! Cameras as other programs write them: the files of OpenCV, ROS and Kalibr, read and written.
//!
//! All three put integer coordinates at the centres of pixels, as this project does, so principal points stay as they are:
//! OpenCV's corner detectors say (0, 0) for the centre of the top-left pixel (`cornerSubPix` and `remap` sample there), and
//! both ROS' `camera_calibration` and Kalibr calibrate from corners of OpenCV. Camera frames agree too: x right, y down, z
//! forward.
//!
//! None of the formats says where a fisheye's picture ends. A Kannala-Brandt lens that is read ends where its picture's
//! farthest corner does, or before that where the polynomial stops rising; write `max_angle_deg` into the rig file when the
//! lens sees less.

mod error;
mod kalibr;
mod matrices;
mod opencv;
mod ros;

use std::{f64::consts::PI, fmt, path::Path};

use serde::de::DeserializeOwned;
use serde_saphyr::Spanned;

pub use error::InterchangeError;

use crate::{
    camera::{Intrinsics, LensModel, Model},
    pose::Pose,
    rig::Place,
};

/// Largest width or height of a picture, as in rig files.
const MAX_SIDE_PX: u32 = 16_384;

/// Steps into which half a turn is divided when the end of a fisheye's picture is looked for.
const STEPS: u32 = 3600;

/// A camera as another program's file describes it.
#[derive(Debug, Clone, PartialEq)]
pub struct ForeignCamera {
    /// Name; `camera` where the format has none.
    pub name: String,
    /// Ray to pixel.
    pub intrinsics: Intrinsics,
    /// Where the previous camera of the file stands; Kalibr's `T_cn_cnm1`.
    pub camera_from_previous: Option<Pose>,
}

/// A file format of another program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// YAML of `cv::FileStorage` with the keys of OpenCV's calibration sample: `camera_matrix`, `distortion_coefficients`,
    /// `image_width`, `image_height`, and `fisheye_model: 1` for the lens of `cv::fisheye`.
    Opencv,
    /// `camera_info` YAML of ROS' `camera_calibration_parsers`.
    Ros,
    /// `camchain.yaml` of Kalibr, with any number of cameras.
    Kalibr,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 3] = [Self::Opencv, Self::Ros, Self::Kalibr];

    /// The format of a text, by its first telling line; `None` when it is none of them.
    #[must_use]
    pub fn of(text: &str) -> Option<Self> {
        let begins = |word: &str| text.lines().any(|line| line.starts_with(word));
        if text.contains("!!opencv-matrix") || text.contains("!!opencv-nd-matrix") {
            Some(Self::Opencv)
        } else if begins("cam0:") {
            Some(Self::Kalibr)
        } else if begins("camera_matrix:") {
            let is_ros = begins("distortion_model:") || begins("camera_name:");
            Some(if is_ros { Self::Ros } else { Self::Opencv })
        } else {
            None
        }
    }

    /// The models that the format can hold.
    #[must_use]
    pub fn models(self) -> &'static [Model] {
        match self {
            Self::Opencv | Self::Ros => &[Model::BrownConrady, Model::Rational, Model::KannalaBrandt],
            Self::Kalibr => &[
                Model::BrownConrady,
                Model::KannalaBrandt,
                Model::Eucm,
                Model::DoubleSphere,
            ],
        }
    }

    /// Reads the cameras of a text, at least one. `file` is its name, for error messages only: nothing is opened.
    ///
    /// # Errors
    /// When the text is no YAML, a key is missing, or a model or value is not allowed; the error names file and line.
    pub fn read(self, text: &str, file: &Path) -> Result<Vec<ForeignCamera>, InterchangeError> {
        let source = Source { text, file };
        match self {
            Self::Opencv => opencv::read(&source).map(|camera| vec![camera]),
            Self::Ros => ros::read(&source).map(|camera| vec![camera]),
            Self::Kalibr => kalibr::read(&source),
        }
    }

    /// Writes cameras; OpenCV's and ROS' files hold exactly one.
    ///
    /// # Errors
    /// When there are too many cameras, or none, or the format has no words for a lens.
    pub fn write(self, cameras: &[ForeignCamera]) -> Result<String, InterchangeError> {
        let names = |names: Vec<String>| {
            names
                .into_iter()
                .map(|name| format!("`{name}`"))
                .collect::<Vec<_>>()
                .join(", ")
        };
        let count = |allowed| InterchangeError::Count {
            format: self,
            allowed,
            present: names(cameras.iter().map(|camera| camera.name.clone()).collect()),
        };
        let [first, rest @ ..] = cameras else {
            return Err(count("at least one camera"));
        };
        if self != Self::Kalibr && !rest.is_empty() {
            return Err(count("one camera"));
        }
        for camera in cameras {
            let model = camera.intrinsics.lens.model();
            if !self.models().contains(&model) {
                return Err(InterchangeError::NotExpressible {
                    camera: camera.name.clone(),
                    format: self,
                    problem: format!("the model `{model}`"),
                    allowed: names(self.models().iter().map(ToString::to_string).collect()),
                });
            }
        }
        match self {
            Self::Opencv => Ok(opencv::write(first)),
            Self::Ros => Ok(ros::write(first)),
            Self::Kalibr => kalibr::write(cameras),
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Opencv => "OpenCV",
            Self::Ros => "ROS",
            Self::Kalibr => "Kalibr",
        })
    }
}

/// The text being read.
struct Source<'a> {
    text: &'a str,
    file: &'a Path,
}

impl Source<'_> {
    fn parse<T: DeserializeOwned>(&self) -> Result<T, InterchangeError> {
        // OpenCV 4 writes `%YAML:1.0`, which is no directive of YAML; as a comment it keeps the lines' numbers.
        let text = match self.text.strip_prefix("%YAML") {
            Some(rest) => format!("#{rest}"),
            None => self.text.to_owned(),
        };
        serde_saphyr::from_str(&text).map_err(|error| {
            let error = error.without_snippet();
            InterchangeError::Syntax {
                place: self.place(error.location().map_or(1, |location| location.line())),
                message: error.to_string().replace('\n', " "),
            }
        })
    }

    fn place(&self, line: u64) -> Place {
        Place {
            file: self.file.to_owned(),
            line: usize::try_from(line).unwrap_or(usize::MAX),
        }
    }

    fn place_of<T>(&self, value: &Spanned<T>) -> Place {
        self.place(value.defined.line())
    }

    /// The error for a value that is not allowed.
    fn refuse<T>(
        &self,
        value: &Spanned<T>,
        key: &'static str,
        found: impl fmt::Debug,
        allowed: &str,
    ) -> InterchangeError {
        InterchangeError::Value {
            place: self.place_of(value),
            key,
            found: format!("{found:?}").replace('"', ""),
            allowed: allowed.to_owned(),
        }
    }

    fn size(&self, size: [&Spanned<i64>; 2], keys: [&'static str; 2]) -> Result<[u32; 2], InterchangeError> {
        let mut size_px = [0; 2];
        for axis in 0..2 {
            let side = u32::try_from(size[axis].value).ok();
            size_px[axis] = side
                .filter(|side| (1..=MAX_SIDE_PX).contains(side))
                .ok_or_else(|| self.refuse(size[axis], keys[axis], size[axis].value, "1 to 16384"))?;
        }
        Ok(size_px)
    }

    /// Puts a lens on a camera that has none yet.
    fn with_lens(
        &self,
        intrinsics: Intrinsics,
        model: Model,
        coefficients: &Spanned<Vec<f64>>,
        key: &'static str,
    ) -> Result<Intrinsics, InterchangeError> {
        let values = &coefficients.value;
        let max_angle_rad = match values[..] {
            [k1, k2, k3, k4] if model == Model::KannalaBrandt => end_of_picture(&intrinsics, [k1, k2, k3, k4]),
            _ => PI,
        };
        let lens = LensModel::from_coefficients(model, values, max_angle_rad);
        let lens = lens.filter(|_| values.iter().all(|value| value.is_finite()));
        let Some(lens) = lens else {
            let names = model.parameter_names()[4..].join(", ");
            return Err(self.refuse(coefficients, key, values, &format!("finite numbers: {names}")));
        };
        if !lens.is_usable() {
            let allowed = "a distortion that maps rays to pixels one to one";
            return Err(self.refuse(coefficients, key, values, allowed));
        }
        Ok(Intrinsics { lens, ..intrinsics })
    }
}

/// The angle, in radians, at which a Kannala-Brandt lens reaches the farthest corner of its picture, or before that stops
/// rising.
fn end_of_picture(intrinsics: &Intrinsics, [k1, k2, k3, k4]: [f64; 4]) -> f64 {
    let [width, height] = intrinsics.size_px.map(f64::from);
    let centre = intrinsics.principal_point_px + 0.5;
    let far = |centre: f64, side: f64| centre.abs().max((side - centre).abs());
    let corner_px = glam::DVec2::new(far(centre.x, width), far(centre.y, height));
    let corner = (corner_px / intrinsics.focal_px).length();
    let radius = |angle: f64| {
        let s = angle * angle;
        angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    };
    let step = PI / f64::from(STEPS);
    let mut end = step;
    for i in 2..=STEPS {
        let angle = step * f64::from(i);
        // The next step must rise too, so that the end is not where the polynomial turns.
        if radius(end) >= corner || radius(angle) <= radius(end) || radius(angle + step) <= radius(angle) {
            break;
        }
        end = angle;
    }
    end
}

/// A camera without distortion.
fn pinhole(size_px: [u32; 2], [fx, fy, cx, cy]: [f64; 4]) -> Intrinsics {
    Intrinsics {
        size_px,
        focal_px: glam::DVec2::new(fx, fy),
        principal_point_px: glam::DVec2::new(cx, cy),
        lens: LensModel::BrownConrady {
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        },
    }
}

/// A number that YAML 1.1 reads as one too: with a point, and with a sign before the exponent.
fn number(value: f64) -> String {
    let text = format!("{value:?}");
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text;
    };
    let point = if mantissa.contains('.') { "" } else { ".0" };
    let sign = if exponent.starts_with('-') { "" } else { "+" };
    format!("{mantissa}{point}e{sign}{exponent}")
}

/// Numbers in brackets.
fn list(values: &[f64]) -> String {
    format!(
        "[{}]",
        values.iter().map(|&value| number(value)).collect::<Vec<_>>().join(", ")
    )
}

#[cfg(test)]
mod tests;
