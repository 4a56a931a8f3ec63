//! The page for a person, and what table, numbers and page share.

use mirrorball_calib::{
    board::Board,
    camera::Intrinsics,
    intrinsics::{Calibration, Reach, UncertaintyMap},
    report::{
        Block, Plot, Report,
        plot::{Axis, Series, Style},
    },
};

use super::Outcome;

/// Cells of the uncertainty map.
const MAP_CELLS: [usize; 2] = [32, 18];

/// Length of a typical residual in the plot, in parts of the picture's width.
const VECTOR: f64 = 0.015;

/// Edge width in pixels above which a view is called blurred.
const BLURRED_PX: f64 = 1.5;

/// Bins of the radius in the chart of residuals.
const RADIUS_BINS: usize = 24;

/// The angle beyond which a fisheye images nothing.
pub(super) fn max_angle_deg(intrinsics: &Intrinsics) -> Option<f64> {
    intrinsics.lens.max_angle_rad().map(f64::to_degrees)
}

/// How sure the lens is at infinity.
pub(super) fn uncertainty(calibration: &Calibration) -> Option<UncertaintyMap> {
    calibration.uncertainty(MAP_CELLS, Reach::Infinity)
}

/// Pictures and views that take no part, and why.
pub(super) fn rejected(outcome: &Outcome<'_>) -> Vec<(String, String)> {
    let views = outcome.calibration.rejected_views.iter();
    let views = views.map(|view| (view.name.clone(), view.reason.to_string()));
    let mut all: Vec<_> = outcome.views.not_found.iter().cloned().chain(views).collect();
    all.sort();
    all
}

/// Width of the edges in a view, in pixels.
pub(super) fn edge_width(outcome: &Outcome<'_>, name: &str) -> Option<f64> {
    let index = outcome.views.views.iter().position(|view| view.name == name)?;
    outcome.views.edge_widths_px[index]
}

/// What should not be so.
pub(super) fn warnings(outcome: &Outcome<'_>) -> Vec<String> {
    let mut warnings: Vec<String> = outcome.calibration.warnings.iter().map(ToString::to_string).collect();
    let views = outcome.calibration.views.iter();
    let blurred: Vec<&str> = views
        .filter(|view| edge_width(outcome, &view.name).is_some_and(|width| width > BLURRED_PX))
        .map(|view| view.name.as_str())
        .collect();
    if let Some(first) = blurred.first() {
        warnings.push(format!(
            "`{}` views are blurred (edges wider than {BLURRED_PX} px), `{first}` among them: hold the board still, or expose shorter",
            blurred.len()
        ));
    }
    warnings
}

/// The page.
pub(super) fn page(outcome: &Outcome<'_>) -> Report {
    let calibration = outcome.calibration;
    let mut report = Report::new(format!("Lens of camera {}", outcome.args.camera));
    let corners: usize = calibration.views.iter().map(|view| view.residuals.len()).sum();
    report.push(Block::Text(format!(
        "{} on {}: {} views, {corners} corners, residuals {:.3} px rms. {} corners and {} pictures are not used.",
        calibration.intrinsics.lens.model(),
        kind(outcome.board),
        calibration.views.len(),
        calibration.rms_px,
        calibration.rejected_corners.len(),
        rejected(outcome).len(),
    )));
    for warning in warnings(outcome) {
        report.push(Block::Warning(warning));
    }
    report.push(parameters(calibration));
    report.push(Block::Heading("Residuals".to_owned()));
    report.push(residual_vectors(calibration));
    report.push(residuals_by_radius(calibration));
    report.push(Block::Heading("What is known where".to_owned()));
    if let Some(map) = uncertainty(calibration) {
        report.push(Block::Plot {
            caption: "Standard deviation of where a direction appears, x and y together, after the camera's own rotation has been \
                      fitted away. Large values at the edges: take views there."
                .to_owned(),
            plot: Plot::HeatMap {
                size_px: calibration.intrinsics.size_px,
                columns: map.columns,
                values: map.sigma_px,
                value: Axis::linear("σ, px"),
            },
        });
    }
    coverage(&mut report, outcome);
    report.push(Block::Heading("Views".to_owned()));
    report.push(views(outcome));
    let rejected = rejected(outcome);
    if !rejected.is_empty() {
        report.push(Block::Table {
            caption: "Pictures that are not used".to_owned(),
            head: ["picture", "reason"].map(str::to_owned).to_vec(),
            rows: rejected.into_iter().map(|(name, reason)| vec![name, reason]).collect(),
        });
    }
    report.push(rejected_corners(calibration));
    report
}

fn kind(board: &Board) -> &'static str {
    match board {
        Board::AprilGrid { .. } => "an AprilGrid",
        Board::Charuco { .. } => "a ChArUco board",
        Board::Chessboard { .. } => "a chessboard",
    }
}

fn parameters(calibration: &Calibration) -> Block {
    let names = calibration
        .intrinsics
        .lens
        .model()
        .parameter_names()
        .iter()
        .map(|name| (*name).to_owned());
    let values = calibration
        .intrinsics
        .parameters()
        .into_iter()
        .zip(calibration.sigmas());
    let mut rows: Vec<Vec<String>> = names
        .zip(values)
        .map(|(name, (value, sigma))| vec![name, format!("{value:.6}"), format!("{sigma:.6}")])
        .collect();
    let warp = calibration.board_warp_m.into_iter().zip(calibration.board_warp_sigma_m);
    for (name, (value, sigma)) in ["bow along x, mm", "bow along y, mm", "twist, mm"]
        .into_iter()
        .zip(warp)
    {
        rows.push(vec![
            name.to_owned(),
            format!("{:.4}", 1e3 * value),
            format!("{:.4}", 1e3 * sigma),
        ]);
    }
    if let Some(angle) = max_angle_deg(&calibration.intrinsics) {
        rows.push(vec![
            "largest angle, degrees".to_owned(),
            format!("{angle:.3}"),
            String::new(),
        ]);
    }
    let mut caption = "The lens and the board, with standard deviations.".to_owned();
    if calibration.board_warp_m == [0.0; 3] {
        caption.push_str(
            " The corners show no bend of the board: it was taken for flat; σ says how little would have been noticed.",
        );
    }
    Block::Table {
        caption,
        head: ["parameter", "value", "σ"].map(str::to_owned).to_vec(),
        rows,
    }
}

fn residual_vectors(calibration: &Calibration) -> Block {
    let residuals = calibration.views.iter().flat_map(|view| &view.residuals);
    let vectors = residuals.map(|r| (r.pixel.to_array(), r.residual_px.to_array()));
    let width = f64::from(calibration.intrinsics.size_px[0]);
    Block::Plot {
        caption: "Seen minus expected, enlarged. They should point anywhere: a pattern means that the model does not describe the \
                  lens, or the board file the board."
            .to_owned(),
        plot: Plot::Vectors {
            size_px: calibration.intrinsics.size_px,
            vectors: vectors.collect(),
            scale: VECTOR * width / calibration.rms_px.max(1e-6),
        },
    }
}

fn residuals_by_radius(calibration: &Calibration) -> Block {
    let centre = calibration.intrinsics.principal_point_px;
    let residuals = calibration.views.iter().flat_map(|view| &view.residuals);
    // Radius, and the residual's part along it: what a wrong radial law leaves.
    let radial: Vec<[f64; 2]> = residuals
        .filter_map(|r| {
            let outwards = (r.pixel - centre).try_normalize()?;
            Some([r.pixel.distance(centre), r.residual_px.dot(outwards)])
        })
        .collect();
    let end = radial.iter().map(|[radius, _]| *radius).fold(1.0, f64::max) * (1.0 + 1e-9);
    let mut bins = [(0.0, 0usize); RADIUS_BINS];
    for [radius, along] in &radial {
        let bin = &mut bins[(radius / end * RADIUS_BINS as f64) as usize];
        *bin = (bin.0 + along, bin.1 + 1);
    }
    let means = bins
        .iter()
        .enumerate()
        .filter(|(_, (_, count))| *count > 0)
        .map(|(i, (sum, count))| [(i as f64 + 0.5) / RADIUS_BINS as f64 * end, sum / *count as f64]);
    Block::Plot {
        caption: "Part of the residual along the radius, over the distance from the principal point. The mean should lie on zero."
            .to_owned(),
        plot: Plot::Chart {
            x: Axis::linear("distance from the principal point, px"),
            y: Axis::linear("residual outwards, px"),
            series: vec![
                Series {
                    name: "mean".to_owned(),
                    points: means.collect(),
                    style: Style::Line,
                },
                Series {
                    name: "corners".to_owned(),
                    points: radial,
                    style: Style::Dots,
                },
            ],
        },
    }
}

fn coverage(report: &mut Report, outcome: &Outcome<'_>) {
    let advice = outcome.guide.advice();
    report.push(Block::Plot {
        caption: "Corners seen in each part of the picture. Empty parts are extrapolated.".to_owned(),
        plot: Plot::HeatMap {
            size_px: outcome.calibration.intrinsics.size_px,
            columns: advice.columns,
            values: advice.corners.iter().map(|count| f64::from(*count)).collect(),
            value: Axis::linear("corners"),
        },
    });
    let [straight, left, right, up, down] = advice.tilts;
    report.push(Block::Text(format!(
        "The board faced the camera straight in {straight} views, left in {left}, right in {right}, up in {up}, down in {down}."
    )));
    if advice.next.is_empty() {
        report.push(Block::Text("No pose is missing.".to_owned()));
    } else {
        report.push(Block::Warning(format!(
            "To know the lens better: {}.",
            advice.next.join("; ")
        )));
    }
}

fn views(outcome: &Outcome<'_>) -> Block {
    let rows = outcome.calibration.views.iter().map(|view| {
        let rejected = outcome
            .calibration
            .rejected_corners
            .iter()
            .filter(|corner| corner.view == view.name);
        let distance = view.camera_from_board.translation.length();
        vec![
            view.name.clone(),
            view.residuals.len().to_string(),
            format!("{:.3}", view.rms_px),
            format!("{:.3}", view.worst_px),
            rejected.count().to_string(),
            edge_width(outcome, &view.name).map_or_else(|| "–".to_owned(), |width| format!("{width:.2}")),
            format!("{distance:.3}"),
        ]
    });
    Block::Table {
        caption: "Views that took part".to_owned(),
        head: [
            "view",
            "corners",
            "rms, px",
            "worst, px",
            "corners out",
            "edge width, px",
            "distance, m",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows: rows.collect(),
    }
}

fn rejected_corners(calibration: &Calibration) -> Block {
    if calibration.rejected_corners.is_empty() {
        return Block::Text("No corner was rejected.".to_owned());
    }
    let rows = calibration.rejected_corners.iter().map(|corner| {
        vec![
            corner.view.clone(),
            corner.corner.to_string(),
            format!("{:.1}, {:.1}", corner.pixel.x, corner.pixel.y),
            format!("{:.2}, {:.2}", corner.residual_px.x, corner.residual_px.y),
        ]
    });
    Block::Table {
        caption: "Corners that do not fit".to_owned(),
        head: ["view", "corner", "seen at, px", "seen minus expected, px"]
            .map(str::to_owned)
            .to_vec(),
        rows: rows.collect(),
    }
}
