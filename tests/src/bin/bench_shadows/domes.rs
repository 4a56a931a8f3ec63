//! Domes of 16, 64 and 256 lights and the default, beside the seeds' figures.

use crate::{
    report::{Report, seed_cells, timing_cells},
    stand::{Effort, Stand, Way},
};
use mirrorball_render::{error::RenderError, lab::scenes::MovingScene, shadow::ShadowMethod};

const METHODS: [ShadowMethod; 4] = [
    ShadowMethod::Dome16,
    ShadowMethod::Dome64,
    ShadowMethod::Dome256,
    ShadowMethod::Stable,
];

/// The seed's pictures per second, one depth map refreshed for each; of one element it does not tell the picture's size.
fn seed_fps(method: ShadowMethod, is_sixty: bool, size_px: [u32; 2]) -> Option<f64> {
    match (method, is_sixty, size_px) {
        (ShadowMethod::Dome16, true, [640, 480]) => Some(28.0),
        (ShadowMethod::Dome64, true, [640, 480]) => Some(14.0),
        (ShadowMethod::Dome16, true, [1280, 1024]) => Some(25.0),
        (ShadowMethod::Dome64, true, [1280, 1024]) => Some(12.0),
        (ShadowMethod::Dome16, false, _) => Some(53.0),
        (ShadowMethod::Dome64, false, _) => Some(26.0),
        _ => None,
    }
}

/// Prints the table.
pub(crate) fn run(effort: &Effort, report: &mut Report) -> Result<(), RenderError> {
    report.table(
        "Domes of lights",
        &[
            "elements",
            "picture",
            "method",
            "maps refreshed",
            "fps",
            "ms",
            "passes, ms",
            "seed, fps",
            "times the seed",
        ],
    );
    for is_sixty in [true, false] {
        for table_px in [[640, 480], [1280, 1024]] {
            let scene = if is_sixty {
                MovingScene::sixty_elements()
            } else {
                MovingScene::one_element()
            };
            let n_elements = scene.scene.objects.len() - 1;
            let about = format!("{n_elements} of together {} vertices", scene.n_vertices());
            let size_px = effort.picture_px(table_px);
            let mut stand = Stand::new(scene, size_px)?;
            for method in METHODS {
                for (rule, refreshes_max) in [("all", usize::MAX), ("1", 1)] {
                    let way = Way {
                        refreshes_max,
                        ..Way::new(method, effort.map_size(1024))
                    };
                    let outcome = stand.time(way, effort)?;
                    let mut cells = vec![
                        about.clone(),
                        format!("{} × {}", size_px[0], size_px[1]),
                        method.name().to_owned(),
                        rule.to_owned(),
                    ];
                    cells.extend(timing_cells(&outcome));
                    cells.extend(seed_cells(&outcome, seed_fps(method, is_sixty, table_px)));
                    report.row(&cells);
                }
            }
        }
    }
    Ok(())
}
