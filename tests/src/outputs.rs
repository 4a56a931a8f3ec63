//! What the render node left in its output folder.

use crate::{ToolError, json, pose_error::rigid_deviation};
use glam::{DMat4, DVec3};
use serde::Deserialize;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

/// Poses are refused when RᵀR or det R is off by more: single precision leaves about 1e-6, a wrong layout leaves 0.1.
const RIGID_TOLERANCE: f64 = 1e-3;

/// An output folder.
#[derive(Clone, Debug)]
pub struct Outputs {
    /// The entries of `frames.jsonl`, in order.
    pub frames: Vec<OutputFrame>,
    folder: PathBuf,
}

/// One entry of `frames.jsonl`.
#[derive(Clone, Debug)]
pub struct OutputFrame {
    /// Sequence number of the scene frame.
    pub frame: u32,
    /// Tracked pose; `None` when the frame was lost.
    pub camera_from_world: Option<DMat4>,
    /// Why there is no pose.
    pub reason: Option<String>,
    /// Root mean square reprojection error in pixels.
    pub reprojection_error_px: Option<f64>,
    /// Time per stage in milliseconds, by name.
    pub stages_ms: BTreeMap<String, f64>,
    /// Strong lights; empty when none is known.
    pub strong_lights: Vec<StrongLight>,
}

/// A lamp, a window, a bright ceiling, as the run found it.
#[derive(Clone, Copy, Debug)]
pub struct StrongLight {
    /// Unit vector from the probe, in the world.
    pub direction: DVec3,
    /// Distance from the probe in metres.
    pub distance_m: f64,
    /// Standard deviation of the distance's logarithm; `None` when nothing tells the distance.
    pub distance_sigma: Option<f64>,
    /// Irradiance at the probe of a surface that faces it.
    pub irradiance: [f32; 3],
}

#[derive(Deserialize)]
struct Entry {
    frame: u32,
    camera_from_world: Option<[[f64; 4]; 4]>,
    reason: Option<String>,
    reprojection_error_px: Option<f64>,
    #[serde(default)]
    stages_ms: BTreeMap<String, f64>,
    light: Option<LightEntry>,
}

#[derive(Deserialize)]
struct LightEntry {
    strong: Vec<StrongEntry>,
}

#[derive(Deserialize)]
struct StrongEntry {
    direction: [f64; 3],
    distance_m: f64,
    distance_sigma: Option<f64>,
    irradiance: [f32; 3],
}

impl StrongEntry {
    fn into_light(self) -> StrongLight {
        StrongLight {
            direction: DVec3::from_array(self.direction),
            distance_m: self.distance_m,
            distance_sigma: self.distance_sigma,
            irradiance: self.irradiance,
        }
    }
}

impl Outputs {
    /// Reads `frames.jsonl` of an output folder.
    ///
    /// # Errors
    /// When the file is missing or a line lacks a key, repeats a frame, or has a pose that is not a rigid motion.
    pub fn load(folder: &Path) -> Result<Self, ToolError> {
        let path = folder.join("frames.jsonl");
        let mut seen = BTreeSet::new();
        let mut frames = Vec::new();
        for (line, entry) in json::read_lines::<Entry>(&path, "the record of the run")? {
            if !seen.insert(entry.frame) {
                return Err(ToolError::RepeatedFrame {
                    path,
                    line,
                    frame: entry.frame,
                });
            }
            let pose = entry
                .camera_from_world
                .map(|rows| pose_from_rows(rows, entry.frame, &path));
            frames.push(OutputFrame {
                frame: entry.frame,
                camera_from_world: pose.transpose()?,
                reason: entry.reason,
                reprojection_error_px: entry.reprojection_error_px,
                stages_ms: entry.stages_ms,
                strong_lights: entry.light.map_or_else(Vec::new, |light| {
                    light.strong.into_iter().map(StrongEntry::into_light).collect()
                }),
            });
        }
        Ok(Self {
            frames,
            folder: folder.to_owned(),
        })
    }

    /// Returns the entry of a frame.
    pub fn frame(&self, frame: u32) -> Option<&OutputFrame> {
        self.frames.iter().find(|entry| entry.frame == frame)
    }

    /// Returns where the composite of a frame lies.
    pub fn composite_path(&self, frame: u32) -> PathBuf {
        composite_path(&self.folder, frame)
    }

    /// Returns where the environment map of a frame lies: at the probe, or at a virtual object.
    pub fn environment_path(&self, frame: u32, object: Option<&str>) -> PathBuf {
        let name = match object {
            None => format!("{frame:06}.exr"),
            Some(object) => format!("{frame:06}@{object}.exr"),
        };
        self.folder.join("environment").join(name)
    }
}

/// Returns where the composite of a frame lies in an output folder.
pub fn composite_path(folder: &Path, frame: u32) -> PathBuf {
    folder.join("composite").join(format!("{frame:06}.png"))
}

/// Builds a pose from row-major rows of a file.
///
/// # Errors
/// When it is not a rotation and a translation.
pub(crate) fn pose_from_rows(rows: [[f64; 4]; 4], frame: u32, path: &Path) -> Result<DMat4, ToolError> {
    let pose = DMat4::from_cols_array_2d(&rows).transpose();
    let deviation = rigid_deviation(pose);
    if deviation <= RIGID_TOLERANCE && rows[3] == [0.0, 0.0, 0.0, 1.0] {
        Ok(pose)
    } else {
        Err(ToolError::NotRigid {
            path: path.to_owned(),
            frame,
            deviation,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn load(lines: &str) -> Result<Outputs, ToolError> {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("frames.jsonl"), lines).unwrap();
        Outputs::load(folder.path())
    }

    const TRACKED: &str = r#"{"frame":4,"timestamp_ns":1,"camera_from_world":[[1,0,0,0.5],[0,1,0,0],[0,0,1,2],[0,0,0,1]],
        "reprojection_error_px":0.2,"markers":5,"stages_ms":{"shade":1.5}}"#;

    #[test]
    fn tracked_and_lost_frames_are_read() {
        let lost = r#"{"frame":5,"camera_from_world":null,"reason":"no marker seen","stages_ms":{}}"#;
        let outputs = load(&format!("{}\n\n{lost}\n", TRACKED.replace('\n', ""))).unwrap();
        let pose = outputs.frame(4).unwrap().camera_from_world.unwrap();
        assert_eq!(pose.w_axis.to_array(), [0.5, 0.0, 2.0, 1.0]);
        assert_eq!(outputs.frame(5).unwrap().reason.as_deref(), Some("no marker seen"));
        assert!(outputs.frame(6).is_none());
        assert!(
            outputs
                .environment_path(4, Some("vase"))
                .ends_with("environment/000004@vase.exr")
        );
    }

    #[test]
    fn broken_entries_are_named() {
        let tracked = TRACKED.replace('\n', "");
        let error = load(&format!("{tracked}\n{tracked}\n")).unwrap_err();
        assert!(
            matches!(error, ToolError::RepeatedFrame { line: 2, frame: 4, .. }),
            "{error}"
        );
        let error = load(&tracked.replace("[[1,0,0,0.5]", "[[2,0,0,0.5]")).unwrap_err();
        assert!(matches!(error, ToolError::NotRigid { frame: 4, .. }), "{error}");
        let error = load("{\"frame\":4}\nnonsense\n").unwrap_err();
        assert!(matches!(error, ToolError::Json { line: Some(2), .. }), "{error}");
    }
}
