//! Synthetic truth, found again.

use std::f64::consts::PI;

use glam::DVec2;

use super::{synthetic::*, *};
use crate::camera::LensModel;

fn solve(scene: &Scene, views: &[BoardView]) -> Result<Calibration, IntrinsicsError> {
    let request = Request {
        board: &scene.board,
        size_px: scene.lens.size_px,
        model: scene.lens.lens.model(),
        max_angle_rad: None,
    };
    calibrate(&request, views, &mut |_| {})
}

fn off_px(scene: &Scene, found: &Calibration, up_to_deg: f64) -> f64 {
    let difference = Difference::new(&scene.lens, &found.intrinsics, [40, 30], Reach::Infinity).expect("comparable");
    difference.rms_px(up_to_deg.to_radians())
}

#[test]
fn figures() {
    for (tilt, near, far) in [
        (0.8, 0.5, 1.2),
        (0.8, 0.4, 0.8),
        (1.0, 0.5, 1.2),
        (1.0, 0.4, 0.8),
        (1.0, 0.3, 0.6),
    ] {
        for seed in 1..3 {
            let scene = Scene::at(pinhole(), 40, tilt, [near, far], seed);
            let found = solve(&scene, &scene.views(0.05, seed)).unwrap();
            let d = Difference::new(&scene.lens, &found.intrinsics, [40, 30], Reach::Distance(0.8)).unwrap();
            println!(
                "{tilt} {near} {seed}: flat {:.4} at .8 {:.4} predicted {:.4} .8: {:.4} n {}",
                off_px(&scene, &found, 180.0),
                d.rms_px(4.0),
                found.uncertainty([32, 24], Reach::Infinity).unwrap().rms_px(),
                found.uncertainty([32, 24], Reach::Distance(0.8)).unwrap().rms_px(),
                found.views.iter().map(|v| v.residuals.len()).sum::<usize>()
            );
        }
    }
    let _ = (PI, DVec2::ZERO);
}
