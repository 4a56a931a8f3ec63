#[path = "../tests/support/mod.rs"]
mod support;
use glam::*;
use mirrorball_calib::{pose::Pose, *};
use support::*;
fn main() {
    let rig = rig();
    let intr = rig.scene_camera().intrinsics;
    let r = DMat3::from_cols(
        DVec3::new(0.062034505532645806, 0.4777919306017198, -0.8762799730538188),
        DVec3::new(0.9980740053339333, -0.02969678200610902, 0.05446449315986977),
        DVec3::new(0., -0.8779709404019947, -0.47871393107955085),
    );
    let pose = Pose {
        rotation: r,
        translation: DVec3::new(-0.029942220160017997, 0.0008909034601832788, 0.5491836393620203),
    };
    for wrong in 0..5 {
        for dx in [8.0, 20.0, 50.0] {
            let mut d = exact_detections(&rig, &intr, &pose);
            if wrong >= d.len() {
                continue;
            }
            let id = d[wrong].id;
            d[wrong].corners_px = d[wrong].corners_px.map(|c| c + DVec2::new(dx, -dx));
            match resection::locate(&d, &rig, &intr) {
                Ok(l) => println!(
                    "n {} wrong id {id} {dx}: {:.4}mm m{} r{} c{} rep {:.3}",
                    d.len(),
                    1e3 * l
                        .camera_from_world
                        .inverse()
                        .translation
                        .distance(pose.inverse().translation),
                    l.markers,
                    l.rejected_markers,
                    l.corners,
                    l.reprojection_error_px
                ),
                Err(e) => println!("{id} {dx} {e}"),
            }
        }
    }
}
