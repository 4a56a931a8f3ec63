//! What the explanations mean for the rig.

use std::fmt;

use glam::DVec3;
use nalgebra::{Matrix3, Matrix6, Vector3};

use super::{
    super::{Camera, Rig},
    AS_GOOD, CHANCE, Matters,
    ball::BallPlace,
    problem::{Problem, Suspect},
    solve::Explanation,
};
use crate::pose::Pose;

/// How far something is from its place, and how well that is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displacement {
    /// Way in metres.
    pub distance_m: f64,
    /// Its standard deviation.
    pub distance_sigma_m: f64,
    /// Turn in radians.
    pub angle_rad: f64,
    /// Its standard deviation.
    pub angle_sigma_rad: f64,
}

/// How a lens differs from the rig file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensChange {
    /// Focal length now over the one in the file.
    pub focal_ratio: f64,
    /// Its standard deviation.
    pub focal_ratio_sigma: f64,
    /// Way of the principal point in pixels, right and down.
    pub principal_point_px: [f64; 2],
    /// Standard deviations.
    pub principal_point_sigma_px: [f64; 2],
}

/// A way along the optical axis has at least this cosine with it.
const ALONG_AXIS: f64 = 0.9;

/// How well a camera's pictures fit the rig as the file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFit {
    /// Name.
    pub name: String,
    /// Width and height of its pictures in pixels.
    pub size_px: [u32; 2],
    /// Corners seen.
    pub corners: usize,
    /// Root mean square of their residuals, in pixels.
    pub rms_px: f64,
    /// The same in units of what corners of their size should have.
    pub ratio: f64,
    /// Places and residuals (expected minus seen) in pixels.
    pub residuals_px: Vec<([f64; 2], [f64; 2])>,
}

/// How well a marker fits the others.
#[derive(Debug, Clone, PartialEq)]
pub struct MarkerFit {
    /// Id.
    pub id: u32,
    /// Corners seen.
    pub corners: usize,
    /// Root mean square of their residuals, in pixels.
    pub rms_px: f64,
    /// The same in units of what corners of their size should have.
    pub ratio: f64,
    /// Where it is when it is left out of all poses, against where the file has it; `None` when that is not determined.
    pub displacement: Option<Displacement>,
}

/// Something that no longer holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Finding {
    /// A marker is elsewhere.
    MarkerMoved {
        /// Its id.
        id: u32,
        /// How far.
        displacement: Displacement,
        /// What else would explain the pictures as well.
        or: Vec<String>,
    },
    /// A lens has changed.
    LensChanged {
        /// Name of the camera.
        camera: String,
        /// How.
        change: LensChange,
        /// What else would explain the pictures as well.
        or: Vec<String>,
    },
    /// A fixed camera stands elsewhere.
    CameraMoved {
        /// Name of the camera.
        camera: String,
        /// How far.
        displacement: Displacement,
        /// What else would explain the pictures as well.
        or: Vec<String>,
    },
    /// The mirror ball stands elsewhere.
    BallMoved {
        /// Where.
        place: BallPlace,
    },
    /// The pictures fit badly, and nothing alone is to blame.
    Unexplained {
        /// Residuals in units of what corners of their size should have.
        ratio: f64,
    },
}

/// What the pictures of a recording say about a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Drift {
    /// Pictures of the moving camera.
    pub pictures: usize,
    /// Those that show no pose.
    pub lost: usize,
    /// Every camera that sees markers, against the rig as the file has it.
    pub cameras: Vec<CameraFit>,
    /// Every marker that can be held against others.
    pub markers: Vec<MarkerFit>,
    /// What no longer holds; nothing when the rig does.
    pub findings: Vec<Finding>,
}

impl Drift {
    /// Whether the rig still holds.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.findings.is_empty()
    }
}

impl Finding {
    /// The routine of `mirrorball-calib` that measures anew what has changed.
    #[must_use]
    pub fn routine(&self) -> &'static str {
        match self {
            Self::MarkerMoved { .. } => "markers",
            Self::LensChanged { .. } | Self::Unexplained { .. } => "intrinsics",
            Self::CameraMoved { .. } => "extrinsics",
            Self::BallMoved { .. } => "ball",
        }
    }
}

impl fmt::Display for Displacement {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "{:.2} ± {:.2} mm and {:.2} ± {:.2}°",
            1e3 * self.distance_m,
            1e3 * self.distance_sigma_m,
            self.angle_rad.to_degrees(),
            self.angle_sigma_rad.to_degrees()
        )
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MarkerMoved { id, displacement, or } => {
                write!(formatter, "marker `{id}` has moved by {displacement}")?;
                or.iter().try_for_each(|other| write!(formatter, ", or {other}"))
            }
            Self::LensChanged { camera, change, or } => {
                let [x, y] = change.principal_point_px;
                write!(
                    formatter,
                    "the lens of camera `{camera}` has changed: focal length {:+.2} ± {:.2} %, principal point \
                     {x:+.1}, {y:+.1} px",
                    100.0 * (change.focal_ratio - 1.0),
                    100.0 * change.focal_ratio_sigma
                )?;
                or.iter().try_for_each(|other| write!(formatter, ", or {other}"))
            }
            Self::CameraMoved {
                camera,
                displacement,
                or,
            } => {
                write!(formatter, "fixed camera `{camera}` has moved by {displacement}")?;
                or.iter().try_for_each(|other| write!(formatter, ", or {other}"))
            }
            Self::BallMoved { place } => {
                let [x, y, z] = (1e3 * place.shift_m).to_array();
                write!(
                    formatter,
                    "the ball has moved by {place} ({x:+.2}, {y:+.2}, {z:+.2} mm in the world)"
                )?;
                match &place.only_camera {
                    Some(camera) => write!(formatter, ", or camera `{camera}` has, which alone shows it"),
                    None => Ok(()),
                }
            }
            Self::Unexplained { ratio } => write!(
                formatter,
                "corners are {ratio:.1} times as far from their places as they should be, and no single part explains it"
            ),
        }
    }
}

/// A suspicion, what it explains, and how.
pub(super) type TriedOut = (Suspect, f64, Explanation);

/// The suspicion that explains most, if it is more than chance and more than matters.
pub(super) fn judge(
    problem: &Problem<'_>,
    rig: &Rig,
    trials: &[TriedOut],
    matters: &Matters,
) -> Option<(Finding, Suspect, Explanation)> {
    let mut grave: Vec<&TriedOut> = trials
        .iter()
        .filter(|(suspect, gain, trial)| *gain > CHANCE && is_grave(problem, rig, *suspect, trial, matters))
        .collect();
    grave.sort_by(|a, b| b.1.total_cmp(&a.1));
    let (best, others) = grave.split_first()?;
    let (suspect, gain, trial) = best;
    let as_good = others.iter().filter(|(_, other, _)| *other >= AS_GOOD * gain);
    let or = as_good
        .map(|(suspect, _, trial)| in_words(rig, *suspect, trial))
        .collect();
    let finding = match *suspect {
        Suspect::Marker(marker) => Finding::MarkerMoved {
            id: rig.markers[marker].id,
            displacement: marker_displacement(rig, marker, trial),
            or,
        },
        Suspect::Lens(camera) => Finding::LensChanged {
            camera: rig.cameras[camera].name.clone(),
            change: lens_change(rig, camera, trial),
            or,
        },
    };
    Some((finding, *suspect, trial.clone()))
}

fn in_words(rig: &Rig, suspect: Suspect, trial: &Explanation) -> String {
    match suspect {
        Suspect::Marker(marker) => {
            let displacement = marker_displacement(rig, marker, trial);
            format!("marker `{}` by {displacement}", rig.markers[marker].id)
        }
        Suspect::Lens(camera) => {
            let change = lens_change(rig, camera, trial);
            let percent = 100.0 * (change.focal_ratio - 1.0);
            format!(
                "the focal length of camera `{}` by {percent:+.2} %",
                rig.cameras[camera].name
            )
        }
    }
}

fn is_grave(problem: &Problem<'_>, rig: &Rig, suspect: Suspect, trial: &Explanation, matters: &Matters) -> bool {
    match suspect {
        Suspect::Marker(marker) => {
            let displacement = marker_displacement(rig, marker, trial);
            let allowed_m = matters
                .distance_m
                .max(matters.distance_relative * distance_m(problem, marker, trial));
            displacement.exceeds(allowed_m, matters.marker_angle_rad, matters.sigmas)
        }
        Suspect::Lens(camera) => {
            let change = lens_change(rig, camera, trial);
            let exceeds = |value: f64, sigma: f64, allowed: f64| value.abs() - matters.sigmas * sigma > allowed;
            let focal_px = rig.cameras[camera].intrinsics.focal_px.x;
            exceeds(
                change.focal_ratio - 1.0,
                change.focal_ratio_sigma,
                matters.lens_relative,
            ) || (0..2).any(|axis| {
                let (way, sigma) = (change.principal_point_px[axis], change.principal_point_sigma_px[axis]);
                exceeds(way, sigma, matters.lens_relative * focal_px)
            })
        }
    }
}

impl Displacement {
    /// Of a motion with its covariance, rotation first.
    fn new(rotation: DVec3, translation: DVec3, covariance: &Matrix6<f64>) -> Self {
        let sigma = |vector: DVec3, block: Matrix3<f64>| match vector.try_normalize() {
            Some(direction) => {
                let direction = Vector3::new(direction.x, direction.y, direction.z);
                (direction.transpose() * block * direction)[0].max(0.0).sqrt()
            }
            None => (block.trace() / 3.0).max(0.0).sqrt(),
        };
        Self {
            distance_m: translation.length(),
            distance_sigma_m: sigma(translation, covariance.fixed_view::<3, 3>(3, 3).into_owned()),
            angle_rad: rotation.length(),
            angle_sigma_rad: sigma(rotation, covariance.fixed_view::<3, 3>(0, 0).into_owned()),
        }
    }

    fn exceeds(&self, distance_m: f64, angle_rad: f64, sigmas: f64) -> bool {
        self.distance_m - sigmas * self.distance_sigma_m > distance_m
            || self.angle_rad - sigmas * self.angle_sigma_rad > angle_rad
    }
}

/// Where the last suspect, a marker, is in its own frame as the file has it.
fn marker_displacement(rig: &Rig, marker: usize, trial: &Explanation) -> Displacement {
    let motion = rig.markers[marker].world_from_marker.inverse() * trial.state.world_from_marker[marker];
    let n = trial.shared.nrows();
    let covariance = Matrix6::from_fn(|row, column| trial.shared[(n - 6 + row, n - 6 + column)]);
    Displacement::new(motion.log().rotation, motion.translation, &covariance)
}

/// How the last suspect, a lens, has changed.
fn lens_change(rig: &Rig, camera: usize, trial: &Explanation) -> LensChange {
    let (now, file) = (&trial.state.intrinsics[camera], &rig.cameras[camera].intrinsics);
    let n = trial.shared.nrows();
    let sigma = |index: usize| trial.shared[(n - 3 + index, n - 3 + index)].max(0.0).sqrt();
    let focal_ratio = now.focal_px.x / file.focal_px.x;
    LensChange {
        focal_ratio,
        focal_ratio_sigma: focal_ratio * sigma(0),
        principal_point_px: (now.principal_point_px - file.principal_point_px).to_array(),
        principal_point_sigma_px: [sigma(1), sigma(2)],
    }
}

/// Mean distance of a marker from the cameras that see it, in metres.
fn distance_m(problem: &Problem<'_>, marker: usize, trial: &Explanation) -> f64 {
    let centre = trial.state.world_from_marker[marker].translation;
    let seen = problem.observations.iter().filter(|seen| seen.marker == marker);
    let distances = seen.map(|seen| trial.state.poses[seen.block].transform_point(centre).length());
    let (sum, count) = distances.fold((0.0, 0.0), |(sum, count), distance| (sum + distance, count + 1.0));
    sum / f64::max(count, 1.0)
}

/// Root mean square of residuals in pixels and in what is expected, and their number.
fn residuals(problem: &Problem<'_>, explanation: &Explanation, of: impl Fn(usize) -> bool) -> (usize, f64, f64) {
    let (mut n, mut px, mut ratio) = (0, 0.0, 0.0);
    for (index, (seen, residual)) in problem.observations.iter().zip(&explanation.residuals).enumerate() {
        if of(index) {
            n += 1;
            px += residual.length_squared();
            ratio += residual.length_squared() / (2.0 * seen.sigma_px * seen.sigma_px);
        }
    }
    let mean = |sum: f64| (sum / f64::max(n as f64, 1.0)).sqrt();
    (n, mean(px), mean(ratio))
}

/// Every camera that sees markers.
pub(super) fn cameras(problem: &Problem<'_>, rig: &Rig, explanation: &Explanation) -> Vec<CameraFit> {
    let fit = |(index, camera): (usize, &Camera)| {
        let is_its = |observation: usize| problem.observations[observation].camera == index;
        let (corners, rms_px, ratio) = residuals(problem, explanation, is_its);
        let all = problem.observations.iter().zip(&explanation.residuals);
        let own = all.filter(|(seen, _)| seen.camera == index);
        (corners > 0).then(|| CameraFit {
            name: camera.name.clone(),
            size_px: camera.intrinsics.size_px,
            corners,
            rms_px,
            ratio,
            residuals_px: own
                .map(|(seen, residual)| (seen.pixel.to_array(), residual.to_array()))
                .collect(),
        })
    };
    rig.cameras.iter().enumerate().filter_map(fit).collect()
}

/// Every marker that can be held against others; `trials` suspect one part each.
pub(super) fn markers(
    problem: &Problem<'_>,
    rig: &Rig,
    explanation: &Explanation,
    trials: &[TriedOut],
) -> Vec<MarkerFit> {
    let mut fits = Vec::new();
    for (index, marker) in rig.markers.iter().enumerate() {
        let is_its = |observation: usize| problem.observations[observation].marker == index;
        let (corners, rms_px, ratio) = residuals(problem, explanation, is_its);
        if corners == 0 {
            continue;
        }
        let trial = trials.iter().find(|(suspect, ..)| *suspect == Suspect::Marker(index));
        fits.push(MarkerFit {
            id: marker.id,
            corners,
            rms_px,
            ratio,
            displacement: trial.map(|(_, _, trial)| marker_displacement(rig, index, trial)),
        });
    }
    fits
}

/// Fixed cameras that stand elsewhere.
pub(super) fn fixed_cameras(
    problem: &Problem<'_>,
    rig: &Rig,
    explanation: &Explanation,
    matters: &Matters,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (index, block) in problem.blocks.iter().enumerate() {
        let Some(camera) = block.fixed_camera.map(|camera| &rig.cameras[camera]) else {
            continue;
        };
        let Some(file) = camera.camera_from_world else { continue };
        let found = explanation.state.poses[index];
        let displacement = camera_displacement(&file, &found, &explanation.poses[index]);
        let markers = problem.observations.iter().filter(|seen| seen.block == index);
        let nearest_m = markers
            .map(|seen| {
                found
                    .transform_point(rig.markers[seen.marker].world_from_marker.translation)
                    .length()
            })
            .fold(f64::INFINITY, f64::min);
        let allowed_m = matters.distance_m.max(matters.distance_relative * nearest_m);
        if displacement.exceeds(allowed_m, matters.camera_angle_rad, matters.sigmas) {
            findings.push(Finding::CameraMoved {
                or: longer_lens(&file, &found, nearest_m, &camera.name),
                camera: camera.name.clone(),
                displacement,
            });
        }
    }
    findings
}

/// From one place a longer lens looks like a step forward.
fn longer_lens(file: &Pose, found: &Pose, distance_m: f64, camera: &str) -> Vec<String> {
    let way = found.rotation * (found.inverse().translation - file.inverse().translation);
    if way.z.abs() < ALONG_AXIS * way.length() {
        return Vec::new();
    }
    let percent = 100.0 * way.z / distance_m;
    vec![format!(
        "its focal length by {percent:+.1} % (`intrinsics` of camera `{camera}`)"
    )]
}

/// How far the camera's centre and axes are from the file's. The covariance is of a twist on the left of the pose found.
fn camera_displacement(file: &Pose, found: &Pose, covariance: &Matrix6<f64>) -> Displacement {
    let found_from_file = *found * file.inverse();
    // The centre moves by -Rᵀ ρ with the twist, seen from the world; in the camera's frame by -ρ.
    let way = found.rotation * (found.inverse().translation - file.inverse().translation);
    Displacement::new(found_from_file.log().rotation, way, covariance)
}
