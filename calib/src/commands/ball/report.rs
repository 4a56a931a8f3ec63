//! The page about the ball.

use mirrorball_calib::{
    ball_fit::direction::{CELLS, MIN_VIEW_COSINE},
    report::{Block, Plot, Report, plot::Axis},
};

use super::Found;

/// The page.
pub(super) fn report(found: &Found) -> Report {
    let mut report = Report::new("Mirror ball");
    for warning in &found.warnings {
        report.push(Block::Warning(warning.clone()));
    }
    report.push(result(found)).push(Block::Heading("Direction".to_owned()));
    report.push(Block::Text(format!(
        "How well the direction is known that a pixel of the ball shows: root mean square angle, from the covariance of \
         centre and radius, over the part of the ball that is used (cosine between normal and view of {MIN_VIEW_COSINE} or \
         more, each pixel counting alike). It grows towards the rim, where the ball is seen at a flat angle."
    )));
    if let Some(figures) = found.figures {
        report.push(Block::Table {
            caption: "Standard deviation of the direction, degrees".to_owned(),
            head: ["middle", "median", "p95", "rim"].map(str::to_owned).to_vec(),
            rows: vec![
                [figures.center, figures.median, figures.p95, figures.rim]
                    .map(|v| format!("{v:.3}"))
                    .to_vec(),
            ],
        });
    }
    if let Some((name, _, map)) = &found.map {
        let side = map.side_px.round().max(1.0) as u32;
        report.push(Block::Plot {
            caption: format!("Standard deviation of the direction over the ball's face in {name}"),
            plot: Plot::HeatMap {
                size_px: [side; 2],
                columns: CELLS,
                values: map.sigma_deg.clone(),
                value: Axis::linear("direction σ, degrees"),
            },
        });
    }
    report.push(Block::Heading("Pictures".to_owned())).push(views(found));
    report
}

fn result(found: &Found) -> Block {
    let (ball, sigma) = (&found.fit.ball, found.sigmas_m());
    let row = |name: &str, value: String, sigma: String| vec![name.to_owned(), value, sigma];
    let mm = |v: f64| format!("{:.3} mm", 1e3 * v);
    let mut rows = Vec::new();
    for (axis, name) in ["centre x", "centre y", "centre z"].into_iter().enumerate() {
        rows.push(row(name, mm(ball.center_m[axis]), mm(sigma[axis])));
    }
    rows.push(row("radius", mm(ball.radius_m), mm(sigma[3])));
    for (channel, name) in ["red", "green", "blue"].into_iter().enumerate() {
        let sigma = found
            .measured
            .map_or("not measured".to_owned(), |m| format!("{:.4}", m.sigma[channel]));
        rows.push(row(
            &format!("reflectance, {name}"),
            format!("{:.4}", found.reflectance[channel]),
            sigma,
        ));
    }
    rows.push(row(
        "roughness",
        format!("{:.3}", found.roughness),
        "as in the rig file".to_owned(),
    ));
    Block::Table {
        caption: "The ball in the world".to_owned(),
        head: ["", "value", "standard deviation"].map(str::to_owned).to_vec(),
        rows,
    }
}

fn views(found: &Found) -> Block {
    let rows = found.views().map(|(name, state, agreement, reason)| {
        let px = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.3}"));
        vec![
            name.to_owned(),
            reason.map_or(state.to_owned(), |reason| format!("{state}: {reason}")),
            px(agreement.map(|a| a.radius_px)),
            px(agreement.map(|a| a.center_error_px)),
            px(agreement.map(|a| a.radius_error_px)),
            px(agreement.map(|a| a.share)),
        ]
    });
    Block::Table {
        caption: "Each picture's outline beside the joint ball".to_owned(),
        head: [
            "picture",
            "state",
            "radius, px",
            "centre off, px",
            "radius off, px",
            "share of outline",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows: rows.collect(),
    }
}
