//! The numbers, as JSON.

use mirrorball_calib::pose::Pose;
use serde::Serialize;

use super::{Outcome, page};

/// What `--json` writes. Lengths in metres where a key does not say pixels.
#[derive(Serialize)]
pub(super) struct Numbers {
    routine: &'static str,
    camera: String,
    model: &'static str,
    size_px: [u32; 2],
    parameter_names: Vec<&'static str>,
    parameters: Vec<f64>,
    sigmas: Vec<f64>,
    covariance: Vec<Vec<f64>>,
    max_angle_deg: Option<f64>,
    rms_px: f64,
    views: Vec<View>,
    rejected_corners: Vec<Corner>,
    rejected_views: Vec<Rejected>,
    board_warp_m: [f64; 3],
    board_warp_sigma_m: [f64; 3],
    uncertainty: Option<Uncertainty>,
    warnings: Vec<String>,
    next: Vec<String>,
}

#[derive(Serialize)]
struct View {
    name: String,
    corners: usize,
    rms_px: f64,
    worst_px: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    blur_px: Option<f64>,
    camera_from_board: [[f64; 4]; 3],
}

#[derive(Serialize)]
struct Corner {
    view: String,
    corner: u32,
    pixel: [f64; 2],
    residual_px: [f64; 2],
}

#[derive(Serialize)]
struct Rejected {
    view: String,
    reason: String,
}

#[derive(Serialize)]
struct Uncertainty {
    columns: usize,
    rows: usize,
    sigma_px: Vec<f64>,
}

pub(super) fn numbers(outcome: &Outcome<'_>) -> Numbers {
    let calibration = outcome.calibration;
    let intrinsics = &calibration.intrinsics;
    let model = intrinsics.lens.model();
    let rejected = page::rejected(outcome)
        .into_iter()
        .map(|(view, reason)| Rejected { view, reason });
    let corners = calibration.rejected_corners.iter().map(|corner| Corner {
        view: corner.view.clone(),
        corner: corner.corner,
        pixel: corner.pixel.to_array(),
        residual_px: corner.residual_px.to_array(),
    });
    let views = calibration.views.iter().map(|view| View {
        name: view.name.clone(),
        corners: view.residuals.len(),
        rms_px: view.rms_px,
        worst_px: view.worst_px,
        blur_px: page::edge_width(outcome, &view.name),
        camera_from_board: rows(&view.camera_from_board),
    });
    Numbers {
        routine: "intrinsics",
        camera: outcome.args.camera.clone(),
        model: model.name(),
        size_px: intrinsics.size_px,
        parameter_names: model.parameter_names().to_vec(),
        parameters: intrinsics.parameters(),
        sigmas: calibration.sigmas(),
        covariance: calibration
            .covariance
            .row_iter()
            .map(|row| row.iter().copied().collect())
            .collect(),
        max_angle_deg: page::max_angle_deg(intrinsics),
        rms_px: calibration.rms_px,
        views: views.collect(),
        rejected_corners: corners.collect(),
        rejected_views: rejected.collect(),
        board_warp_m: calibration.board_warp_m,
        board_warp_sigma_m: calibration.board_warp_sigma_m,
        uncertainty: page::uncertainty(calibration).map(|map| Uncertainty {
            columns: map.columns,
            rows: map.rows,
            sigma_px: map.sigma_px,
        }),
        warnings: page::warnings(outcome),
        next: outcome.guide.advice().next,
    }
}

fn rows(pose: &Pose) -> [[f64; 4]; 3] {
    let [x, y, z, _] = pose.to_rows4();
    [x, y, z]
}
