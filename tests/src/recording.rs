//! What the demo sheet needs of an image-folder recording: the scene camera's frames and their times.

use crate::{ToolError, json};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A frame of the scene camera.
#[derive(Clone, Debug)]
pub struct RecordedFrame {
    /// Sequence number.
    pub sequence: u32,
    /// Capture time in nanoseconds on the recording's clock.
    pub timestamp_ns: u64,
    /// The picture.
    pub path: PathBuf,
}

#[derive(Deserialize)]
struct RigFile {
    camera: Vec<RigCamera>,
}

#[derive(Deserialize)]
struct RigCamera {
    name: String,
    role: String,
}

#[derive(Deserialize)]
struct Line {
    camera: String,
    sequence: u32,
    timestamp_ns: u64,
    file: PathBuf,
}

/// Lists the frames of the scene camera in the order of `frames.csv`.
///
/// # Errors
/// When `rig.toml` or `frames.csv` is missing or broken, or the rig has no scene camera.
pub fn scene_frames(folder: &Path) -> Result<Vec<RecordedFrame>, ToolError> {
    let rig_path = folder.join("rig.toml");
    let rig: RigFile =
        toml::from_str(&json::read_text(&rig_path, "the rig of the recording")?).map_err(|source| ToolError::Toml {
            path: rig_path.clone(),
            source: Box::new(source),
        })?;
    let Some(camera) = rig.camera.iter().find(|camera| camera.role == "scene") else {
        return Err(ToolError::NoSceneCamera { path: rig_path });
    };
    let frames_path = folder.join("frames.csv");
    let text = json::read_text(&frames_path, "the list of frames")?;
    let mut frames = Vec::new();
    for line in csv::Reader::from_reader(text.as_bytes()).deserialize() {
        let line: Line = line.map_err(|source| ToolError::Csv {
            path: frames_path.clone(),
            source,
        })?;
        if line.camera == camera.name {
            frames.push(RecordedFrame {
                sequence: line.sequence,
                timestamp_ns: line.timestamp_ns,
                path: folder.join(line.file),
            });
        }
    }
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scene_camera_is_chosen_by_role() {
        let frames = scene_frames(concat!(env!("CARGO_MANIFEST_DIR"), "/data/two_cameras/recording").as_ref()).unwrap();
        assert_eq!(frames.iter().map(|frame| frame.sequence).collect::<Vec<_>>(), [3, 4]);
        assert_eq!(frames[0].timestamp_ns, 1_199_873_000);
        assert!(frames.iter().all(|frame| frame.path.exists()));
    }
}
