//! Shadow volumes beside shadow maps as objects are added.

use crate::{
    report::{Report, seed_cells, timing_cells},
    stand::{Effort, Stand, Way},
};
use mirrorball_render::{
    error::RenderError,
    lab::{lamp::LampKind, scenes::MovingScene},
    shadow::ShadowMethod,
};

/// Prints the table. All methods draw the shadow of a point light, which volumes are made for.
pub(crate) fn run(effort: &Effort, report: &mut Report) -> Result<(), RenderError> {
    let map_size = effort.map_size(2048);
    let size_px = effort.picture_px([640, 480]);
    report.table(
        &format!(
            "Shadow volumes and maps of {map_size}², point light, test scene and more objects, {} × {}",
            size_px[0], size_px[1]
        ),
        &[
            "more objects",
            "triangles",
            "method",
            "fps",
            "ms",
            "passes, ms",
            "seed, fps",
            "times the seed",
        ],
    );
    for n_more in [0, 20, 100] {
        let scene = MovingScene::test(n_more);
        let n_triangles = scene.n_triangles();
        let mut stand = Stand::new(scene, size_px)?.with_lamp(LampKind::Point);
        for method in [ShadowMethod::Pcf9, ShadowMethod::VolumeZFail, ShadowMethod::Haller] {
            let outcome = stand.time(Way::new(method, map_size), effort)?;
            let mut cells = vec![n_more.to_string(), n_triangles.to_string(), method.name().to_owned()];
            cells.extend(timing_cells(&outcome));
            cells.extend(seed_cells(&outcome, seed_fps(method, n_more)));
            report.row(&cells);
        }
    }
    Ok(())
}

fn seed_fps(method: ShadowMethod, n_more: usize) -> Option<f64> {
    match (method, n_more) {
        (ShadowMethod::Pcf9, 0) => Some(23.0),
        (ShadowMethod::Haller, 0) => Some(25.0),
        (ShadowMethod::Pcf9, 20) => Some(20.0),
        (ShadowMethod::Haller, 20) => Some(7.0),
        _ => None,
    }
}
