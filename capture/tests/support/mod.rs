//! A tiny recording, made when it is needed.

use std::fs;
use std::path::Path;

/// Frames of each of the two cameras.
pub(crate) const N_FRAMES: u64 = 4;

/// Width and height of the pictures.
pub(crate) const SIDES_PX: [u32; 2] = [8, 6];

/// Writes a good recording of a scene and a ball camera into `folder`: 100 frames/s, the ball camera 2 ms later.
pub(crate) fn write_recording(folder: &Path) {
    let camera = |name: &str, role: &str| {
        let [width, height] = SIDES_PX;
        format!("[[camera]]\nname = \"{name}\"\nrole = \"{role}\"\nsize_px = [{width}, {height}]\n")
    };
    let rig = [
        "version = 1\nmain_marker = 0\n",
        &camera("scene", "scene"),
        &camera("probe", "ball"),
    ]
    .concat();
    fs::write(folder.join("rig.toml"), rig).unwrap();
    let mut list = "camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b\n".to_owned();
    for index in 0..N_FRAMES {
        for (camera, delay_ns, shade) in [("scene", 0, 10), ("probe", 2_000_000, 100)] {
            let timestamp_ns = 1_000_000_000 + index * 10_000_000 + delay_ns;
            list += &format!("{camera},{index},{timestamp_ns},{camera}/{index:06}.png,0.004,2.0,1.0,1.25,1.5\n");
            fs::create_dir_all(folder.join(camera)).unwrap();
            let pixels = vec![shade + u8::try_from(index).unwrap(); (SIDES_PX[0] * SIDES_PX[1] * 3) as usize];
            let file = folder.join(format!("{camera}/{index:06}.png"));
            image::save_buffer(file, &pixels, SIDES_PX[0], SIDES_PX[1], image::ColorType::Rgb8).unwrap();
        }
    }
    fs::write(folder.join("frames.csv"), list).unwrap();
}
