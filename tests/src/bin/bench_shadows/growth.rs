//! Cost as lights and as triangles grow: a table, numbers as CSV, and a plot of each.

use crate::{
    report::{Report, digits},
    stand::{Effort, Outcome, Stand, Way},
};
use mirrorball_render::{error::RenderError, lab::scenes::MovingScene, shadow::ShadowMethod};
use mirrorball_tests::plot::{self, Line, Plot};
use std::fmt::Write;

/// Domes by their number of lights.
const DOMES: [(f64, ShadowMethod); 3] = [
    (16.0, ShadowMethod::Dome16),
    (64.0, ShadowMethod::Dome64),
    (256.0, ShadowMethod::Dome256),
];
/// Methods whose cost in triangles is shown.
const METHODS: [ShadowMethod; 9] = [
    ShadowMethod::None,
    ShadowMethod::Pcf9,
    ShadowMethod::Pcss,
    ShadowMethod::VolumeZFail,
    ShadowMethod::Haller,
    ShadowMethod::Wedges,
    ShadowMethod::AttenuationMaps,
    ShadowMethod::Dome64,
    ShadowMethod::Stable,
];

/// A method that takes longer than this is not asked for more triangles, ms.
const PATIENCE_MS: f64 = 4000.0;

/// Prints and draws both.
pub(crate) fn run(effort: &Effort, report: &mut Report) -> Result<(), RenderError> {
    let size_px = effort.picture_px([640, 480]);
    let lights = over_lights(effort, size_px)?;
    let triangles = over_triangles(effort, size_px)?;
    report.table(
        &format!(
            "Cost as lights grow: 60 elements, all maps refreshed, {} × {}",
            size_px[0], size_px[1]
        ),
        &["lights", "ms", "times as long for twice the lights"],
    );
    for (index, [n_lights, ms]) in lights.points.iter().enumerate() {
        let ratio = index
            .checked_sub(1)
            .map(|last| per_doubling(lights.points[last], [*n_lights, *ms]));
        report.row(&[
            n_lights.to_string(),
            digits(*ms),
            ratio.map_or_else(|| "–".to_owned(), digits),
        ]);
    }
    report.table(
        &format!(
            "Cost as triangles grow: test scene with 24 finer and finer spheres, {} × {}",
            size_px[0], size_px[1]
        ),
        &[
            "method",
            "ms by triangles",
            "times as long for twice the triangles, last step",
        ],
    );
    for line in &triangles {
        let steps: Vec<String> = line
            .points
            .iter()
            .map(|[n, ms]| format!("{:.0}k: {}", n / 1e3, digits(*ms)))
            .collect();
        let ratio = line
            .points
            .last_chunk()
            .map(|&[before, last]| per_doubling(before, last));
        report.row(&[
            line.name.clone(),
            steps.join(", "),
            ratio.map_or_else(|| "–".to_owned(), digits),
        ]);
    }
    let mut csv = "axis,method,count,ms\n".to_owned();
    for (axis, line) in std::iter::once(("lights", &lights)).chain(triangles.iter().map(|line| ("triangles", line))) {
        for [count, ms] in &line.points {
            // Writing into a text cannot fail.
            let _ = writeln!(csv, "{axis},{},{count},{ms:.4}", line.name);
        }
    }
    report.file("growth.csv", &csv)?;
    let plot = |title: &str, across: &str, lines| {
        plot::draw(&Plot {
            title: title.to_owned(),
            across: across.to_owned(),
            upward: "ms".to_owned(),
            lines,
        })
    };
    report.picture(
        "growth_lights.png",
        &plot("Time per picture as lights grow", "lights", vec![lights]),
    )?;
    report.picture(
        "growth_triangles.png",
        &plot("Time per picture as triangles grow", "triangles", triangles),
    )
}

fn over_lights(effort: &Effort, size_px: [u32; 2]) -> Result<Line, RenderError> {
    let mut stand = Stand::new(MovingScene::sixty_elements(), size_px)?;
    let mut points = Vec::new();
    for (n_lights, method) in DOMES {
        if let Outcome::Timed(timed) = stand.time(Way::new(method, effort.map_size(1024)), effort)? {
            points.push([n_lights, timed.ms]);
        }
    }
    Ok(Line {
        name: "dome".to_owned(),
        points,
    })
}

fn over_triangles(effort: &Effort, size_px: [u32; 2]) -> Result<Vec<Line>, RenderError> {
    let counts: &[usize] = if effort.is_quick() {
        &[12_500, 25_000]
    } else {
        &[12_500, 25_000, 50_000, 100_000, 200_000]
    };
    let mut lines: Vec<Line> = METHODS
        .iter()
        .map(|method| Line {
            name: method.name().to_owned(),
            points: Vec::new(),
        })
        .collect();
    for &count in counts {
        let scene = MovingScene::with_triangles(count);
        let n_triangles = scene.n_triangles() as f64;
        let mut stand = Stand::new(scene, size_px)?;
        for (method, line) in METHODS.into_iter().zip(&mut lines) {
            if line.points.last().is_some_and(|[_, ms]| *ms > PATIENCE_MS) {
                continue;
            }
            if let Outcome::Timed(timed) = stand.time(Way::new(method, effort.map_size(1024)), effort)? {
                line.points.push([n_triangles, timed.ms]);
            }
        }
    }
    Ok(lines)
}

/// By how much the time grows for twice the count, between two points.
fn per_doubling(before: [f64; 2], after: [f64; 2]) -> f64 {
    (after[1] / before[1]).powf(1.0 / (after[0] / before[0]).log2())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_times_the_lights_in_twice_the_time_is_a_root_of_two_per_doubling() {
        assert!((per_doubling([16.0, 3.0], [64.0, 6.0]) - 2f64.sqrt()).abs() < 1e-12);
    }
}
