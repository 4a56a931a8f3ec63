//! Shadow maps of three sizes with every filter, beside the seeds' figures.

use crate::{
    report::{Report, seed_cells, timing_cells},
    stand::{Effort, Stand, Way},
};
use mirrorball_render::{error::RenderError, lab::scenes::MovingScene, shadow::ShadowMethod};

/// Methods with the seed's pictures per second at 512, 1024 and 2048 texels.
const SEED_FPS: [(ShadowMethod, [f64; 3]); 5] = [
    (ShadowMethod::Map, [60.0, 59.0, 50.0]),
    (ShadowMethod::Pcf9, [59.9, 57.9, 45.0]),
    (ShadowMethod::Pcf25, [59.9, 29.9, 22.0]),
    (ShadowMethod::Pcf49, [30.0, 26.0, 14.0]),
    (ShadowMethod::Pcss, [20.0, 12.0, 8.0]),
];

/// Prints the table.
pub(crate) fn run(effort: &Effort, report: &mut Report) -> Result<(), RenderError> {
    let size_px = effort.picture_px([640, 480]);
    let mut stand = Stand::new(MovingScene::test(0), size_px)?;
    report.table(
        &format!("Shadow maps, test scene, {} × {}", size_px[0], size_px[1]),
        &[
            "map",
            "method",
            "fps",
            "ms",
            "passes, ms",
            "seed, fps",
            "times the seed",
        ],
    );
    for (column, texels) in [512, 1024, 2048].into_iter().enumerate() {
        let map_size = effort.map_size(texels);
        for (method, seed_fps) in SEED_FPS {
            let outcome = stand.time(Way::new(method, map_size), effort)?;
            let mut cells = vec![format!("{map_size}²"), method.name().to_owned()];
            cells.extend(timing_cells(&outcome));
            cells.extend(seed_cells(&outcome, Some(seed_fps[column])));
            report.row(&cells);
        }
    }
    Ok(())
}
