//! Kalibr: `camchain.yaml` (its wiki, pages "yaml formats" and "supported models").

use std::{collections::BTreeMap, fmt::Write as _};

use serde::Deserialize;
use serde_saphyr::Spanned;

use super::{ForeignCamera, InterchangeError, Source, list, pinhole};
use crate::{
    camera::{LensModel, Model},
    pose::Pose,
};

/// What a camera's entry may say.
const MODELS: &str = "pinhole-radtan, pinhole-equi, pinhole-none, eucm-none, ds-none";

/// A camera; topics, overlaps and what relates to an IMU is left alone.
#[derive(Deserialize)]
struct CameraEntry {
    camera_model: Spanned<String>,
    intrinsics: Spanned<Vec<f64>>,
    distortion_model: String,
    distortion_coeffs: Spanned<Vec<f64>>,
    resolution: Spanned<[i64; 2]>,
    #[serde(rename = "T_cn_cnm1")]
    camera_from_previous: Option<Spanned<[[f64; 4]; 4]>>,
}

pub(super) fn read(source: &Source<'_>) -> Result<Vec<ForeignCamera>, InterchangeError> {
    let entries: BTreeMap<String, CameraEntry> = source.parse()?;
    let mut entries: Vec<_> = entries.into_iter().collect();
    // cam10 comes after cam9.
    entries.sort_by_key(|(name, _)| {
        name.strip_prefix("cam")
            .and_then(|number| number.parse().ok())
            .unwrap_or(u32::MAX)
    });
    entries
        .into_iter()
        .map(|(name, entry)| camera(source, name, &entry))
        .collect()
}

fn camera(source: &Source<'_>, name: String, entry: &CameraEntry) -> Result<ForeignCamera, InterchangeError> {
    let resolution = &entry.resolution;
    let side = |axis: usize| Spanned::new(resolution.value[axis], resolution.referenced, resolution.defined);
    let size_px = source.size([&side(0), &side(1)], ["resolution"; 2])?;
    let lens = (entry.camera_model.value.as_str(), entry.distortion_model.as_str());
    let (model, names) = match lens {
        ("pinhole", "radtan" | "none") => (Model::BrownConrady, "fu, fv, pu, pv"),
        ("pinhole", "equidistant") => (Model::KannalaBrandt, "fu, fv, pu, pv"),
        ("eucm", "none") => (Model::Eucm, "alpha, beta, fu, fv, pu, pv"),
        ("ds", "none") => (Model::DoubleSphere, "xi, alpha, fu, fv, pu, pv"),
        (projection, distortion) => {
            return Err(InterchangeError::Model {
                place: source.place_of(&entry.camera_model),
                found: format!("{projection}-{distortion}"),
                allowed: MODELS,
            });
        }
    };
    let refuse = |allowed: &str| source.refuse(&entry.intrinsics, "intrinsics", &entry.intrinsics.value, allowed);
    let (shape, focal_and_centre) = match entry.intrinsics.value[..] {
        [fx, fy, cx, cy] if names.starts_with("fu") => (Vec::new(), [fx, fy, cx, cy]),
        [first, second, fx, fy, cx, cy] if !names.starts_with("fu") => (vec![first, second], [fx, fy, cx, cy]),
        _ => return Err(refuse(names)),
    };
    let [fx, fy, ..] = focal_and_centre;
    if !(fx > 0.0 && fy > 0.0 && entry.intrinsics.value.iter().all(|x| x.is_finite())) {
        return Err(refuse("finite numbers, focal lengths above 0"));
    }
    let mut coefficients = entry.distortion_coeffs.value.clone();
    let expected = match lens.1 {
        "none" => 0,
        _ => 4,
    };
    if coefficients.len() != expected {
        let allowed = if expected == 0 { "an empty list" } else { "four numbers" };
        return Err(source.refuse(&entry.distortion_coeffs, "distortion_coeffs", &coefficients, allowed));
    }
    if model == Model::BrownConrady {
        coefficients.resize(5, 0.0);
    }
    let (values, key, at) = if shape.is_empty() {
        (coefficients, "distortion_coeffs", &entry.distortion_coeffs)
    } else {
        (shape, "intrinsics", &entry.intrinsics)
    };
    let values = Spanned::new(values, at.referenced, at.defined);
    let pose = entry.camera_from_previous.as_ref();
    Ok(ForeignCamera {
        name,
        intrinsics: source.with_lens(pinhole(size_px, focal_and_centre), model, &values, key)?,
        camera_from_previous: pose.map(|rows| read_pose(source, rows)).transpose()?,
    })
}

fn read_pose(source: &Source<'_>, rows: &Spanned<[[f64; 4]; 4]>) -> Result<Pose, InterchangeError> {
    const KEY: &str = "T_cn_cnm1";
    let [x, y, z, last] = rows.value;
    if last != [0.0, 0.0, 0.0, 1.0] {
        return Err(source.refuse(rows, KEY, last, "a last row 0, 0, 0, 1"));
    }
    Pose::from_rows(&[x, y, z]).map_err(|error| InterchangeError::Pose {
        place: source.place_of(rows),
        key: KEY,
        source: error,
    })
}

pub(super) fn write(cameras: &[ForeignCamera]) -> Result<String, InterchangeError> {
    let mut text = String::new();
    for (index, camera) in cameras.iter().enumerate() {
        let intrinsics = &camera.intrinsics;
        let coefficients = intrinsics.lens.coefficients();
        let (projection, distortion, shape, coefficients) = match intrinsics.lens {
            LensModel::BrownConrady { k3, .. } if k3 != 0.0 => {
                return Err(InterchangeError::NotExpressible {
                    camera: camera.name.clone(),
                    format: super::Format::Kalibr,
                    problem: format!("`k3` of `{k3}`"),
                    allowed: "`brown_conrady` with a `k3` of 0".to_owned(),
                });
            }
            LensModel::BrownConrady { .. } => ("pinhole", "radtan", &[][..], &coefficients[..4]),
            LensModel::KannalaBrandt { .. } => ("pinhole", "equidistant", &[][..], &coefficients[..]),
            LensModel::Eucm { .. } => ("eucm", "none", &coefficients[..], &[][..]),
            LensModel::DoubleSphere { .. } => ("ds", "none", &coefficients[..], &[][..]),
            LensModel::Rational { .. } | LensModel::Equisolid { .. } => {
                unreachable!("checked: a model that the format can hold")
            }
        };
        let (focal, centre) = (intrinsics.focal_px, intrinsics.principal_point_px);
        let numbers = [shape, &[focal.x, focal.y, centre.x, centre.y]].concat();
        let [width, height] = intrinsics.size_px;
        let _ = write!(
            text,
            "cam{index}:\n  camera_model: {projection}\n  intrinsics: {}\n  distortion_model: {distortion}\n  \
             distortion_coeffs: {}\n  resolution: [{width}, {height}]\n",
            list(&numbers),
            list(coefficients),
        );
        // The first camera of a chain has none before it.
        if let Some(pose) = camera.camera_from_previous.filter(|_| index > 0) {
            text.push_str("  T_cn_cnm1:\n");
            for row in pose.to_rows4() {
                let _ = writeln!(text, "  - {}", list(&row));
            }
        }
    }
    Ok(text)
}
