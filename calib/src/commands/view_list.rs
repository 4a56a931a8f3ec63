//! What is said of every picture and of poses: entries of JSON files and pieces of pages.

use mirrorball_calib::{
    extrinsics::{PoseSigma, RejectedDetection, ViewResult},
    pose::Pose,
    report::{
        Block, Plot, Report,
        plot::{Axis, Series, Style},
    },
};
use nalgebra::SMatrix;
use serde::Serialize;

/// Three rows `[r00, r01, r02, t]`, metres.
pub(crate) type Rows = [[f64; 4]; 3];

/// A pose as the rig file has it.
pub(crate) fn rows(pose: &Pose) -> Rows {
    let [x, y, z, _] = pose.to_rows4();
    [x, y, z]
}

/// Rows of a covariance.
pub(crate) fn matrix_rows<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// How sure a pose is.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct SigmaEntry {
    pub(crate) rotation_deg: f64,
    pub(crate) place_mm: f64,
}

impl From<PoseSigma> for SigmaEntry {
    fn from(sigma: PoseSigma) -> Self {
        Self {
            rotation_deg: sigma.rotation_rad.to_degrees(),
            place_mm: 1e3 * sigma.place_m,
        }
    }
}

/// How far two poses `a_from_b` are from each other; the places compared are those of b's origin.
pub(crate) fn difference(a: &Pose, b: &Pose) -> SigmaEntry {
    SigmaEntry {
        rotation_deg: a.angle_to(b).to_degrees(),
        place_mm: 1e3 * a.translation.distance(b.translation),
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct ViewEntry<'a> {
    name: &'a str,
    markers: usize,
    rms_px: f64,
    worst_px: f64,
}

#[derive(Debug, Serialize)]
pub(crate) struct RejectedEntry<'a> {
    view: &'a str,
    marker: u32,
    corners: usize,
    worst_px: f64,
}

impl<'a> From<&'a ViewResult> for ViewEntry<'a> {
    fn from(view: &'a ViewResult) -> Self {
        Self {
            name: &view.name,
            markers: view.markers,
            rms_px: view.rms_px,
            worst_px: view.worst_px,
        }
    }
}

impl<'a> From<&'a RejectedDetection> for RejectedEntry<'a> {
    fn from(rejected: &'a RejectedDetection) -> Self {
        Self {
            view: &rejected.view,
            marker: rejected.marker,
            corners: rejected.corners,
            worst_px: rejected.worst_px,
        }
    }
}

pub(crate) fn view_entries(views: &[ViewResult]) -> Vec<ViewEntry<'_>> {
    views.iter().map(Into::into).collect()
}

pub(crate) fn rejected_entries(rejected: &[RejectedDetection]) -> Vec<RejectedEntry<'_>> {
    rejected.iter().map(Into::into).collect()
}

/// Adds what is to be said of pictures to a page.
pub(crate) fn push_views(report: &mut Report, views: &[ViewResult], rejected: &[RejectedDetection]) {
    let points = |value: fn(&ViewResult) -> f64| {
        let numbered = views.iter().enumerate();
        numbered.map(|(index, view)| [index as f64, value(view)]).collect()
    };
    let series = |name: &str, points| Series {
        name: name.to_owned(),
        points,
        style: Style::Dots,
    };
    report.push(Block::Heading("Pictures".to_owned()));
    report.push(Block::Plot {
        caption:
            "Distance of corners from where the solution puts them, per picture. A picture far above the others was \
                  blurred, or something moved."
                .to_owned(),
        plot: Plot::Chart {
            x: Axis::linear("picture"),
            y: Axis::linear("distance, px"),
            series: vec![
                series("root mean square", points(|view| view.rms_px)),
                series("largest", points(|view| view.worst_px)),
            ],
        },
    });
    if rejected.is_empty() {
        report.push(Block::Text("Every detection fits.".to_owned()));
        return;
    }
    let cells = |r: &RejectedDetection| {
        vec![
            r.view.clone(),
            r.marker.to_string(),
            r.corners.to_string(),
            format!("{:.2}", r.worst_px),
        ]
    };
    report.push(Block::Table {
        caption: "Detections that do not fit and were left out".to_owned(),
        head: ["picture", "marker", "corners left out", "worst, px"]
            .map(str::to_owned)
            .to_vec(),
        rows: rejected.iter().map(cells).collect(),
    });
}
