//! Recordings of simulated pictures, as folders.

use super::sensor::Exposure;
use crate::ToolError;
use image::RgbImage;
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Time between frames: 30 a second.
const FRAME_NS: u64 = 33_333_333;
/// Time of the first frame.
const START_NS: u64 = 1_000_000_000;
/// The probe camera is this much later than the scene camera.
const PROBE_LATER_NS: u64 = 2_000_000;

/// A recording in the making: `rig.toml`, `frames.csv`, one folder of pictures per camera.
#[derive(Debug)]
pub struct RecordingWriter {
    folder: PathBuf,
    lines: Vec<String>,
    n_frames: u64,
}

/// A picture of the probe camera.
#[derive(Clone, Copy, Debug)]
pub struct ProbeShot<'a> {
    /// The picture.
    pub picture: &'a RgbImage,
    /// The settings that `frames.csv` names for it.
    pub exposure: Exposure,
}

impl RecordingWriter {
    /// Starts a recording of a rig in a folder, which is made.
    ///
    /// # Errors
    /// When the rig file cannot be copied.
    pub fn new(folder: &Path, rig: &Path) -> Result<Self, ToolError> {
        let target = folder.join("rig.toml");
        let unwritable = |source: std::io::Error| ToolError::Unwritable {
            path: target.clone(),
            source: source.into(),
        };
        for camera in ["scene", "probe"] {
            fs::create_dir_all(folder.join(camera)).map_err(unwritable)?;
        }
        fs::copy(rig, &target).map_err(unwritable)?;
        Ok(Self {
            folder: folder.to_owned(),
            lines: vec!["camera,sequence,timestamp_ns,file,exposure_s,gain,wb_r,wb_g,wb_b".to_owned()],
            n_frames: 0,
        })
    }

    /// Adds a frame of both cameras and returns its sequence number, which counts from 0.
    ///
    /// # Errors
    /// When a picture cannot be written.
    pub fn add(&mut self, scene: (&RgbImage, Exposure), probe: ProbeShot<'_>) -> Result<u32, ToolError> {
        let sequence = self.n_frames;
        let time_ns = START_NS + sequence * FRAME_NS;
        let shots = [
            ("scene", time_ns, scene.0, scene.1),
            ("probe", time_ns + PROBE_LATER_NS, probe.picture, probe.exposure),
        ];
        for (camera, time_ns, picture, exposure) in shots {
            let file = format!("{camera}/{sequence:06}.png");
            let path = self.folder.join(&file);
            picture.save(&path).map_err(|source| ToolError::Unwritable {
                path,
                source: source.into(),
            })?;
            let [r, g, b] = exposure.white_balance;
            let (exposure_s, gain) = (exposure.exposure_s, exposure.gain);
            self.lines.push(format!(
                "{camera},{sequence},{time_ns},{file},{exposure_s},{gain},{r},{g},{b}"
            ));
        }
        self.n_frames += 1;
        Ok(sequence as u32)
    }

    /// Writes the list of frames.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(self) -> Result<(), ToolError> {
        let path = self.folder.join("frames.csv");
        fs::write(&path, self.lines.join("\n") + "\n").map_err(|source| ToolError::Unwritable {
            path,
            source: source.into(),
        })
    }
}
