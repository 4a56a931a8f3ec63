//! What a truth folder says: true poses, exposures, lights' maps and references. See the folder's `meta.json`.

use crate::{ToolError, json, outputs::pose_from_rows};
use glam::{DMat4, DVec3};
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Names of the labels of things that are no phantoms, `none` being outside the image circle.
const BACKGROUND: [&str; 4] = ["none", "room", "light", "furniture"];

/// A truth folder, as far as it is compared with.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Name of the sequence.
    pub name: String,
    /// Which cameras the rig has.
    pub rig: Rig,
    /// Width and height of the scene camera's pictures.
    pub size_px: [usize; 2],
    /// Frames of the scene camera.
    pub scene_frames: Vec<SceneFrame>,
    /// Exposures of the camera that films the ball or the sky; those of the scene camera when it is the only one.
    pub probe_exposures: Vec<ProbeExposure>,
    /// Virtual objects.
    pub virtual_objects: Vec<VirtualObject>,
    /// Labels of things that the renderer knows nothing of: no room, light or furniture is a phantom.
    pub background_labels: Vec<u8>,
    /// Frames with path-traced references.
    pub references: Vec<Reference>,
    /// True environment maps.
    pub environments: Vec<Environment>,
    folder: PathBuf,
}

/// Which cameras a rig has.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rig {
    /// The scene camera sees the ball.
    OneCamera,
    /// A second camera films the ball.
    TwoCamera,
    /// A fisheye camera looks up.
    Fisheye,
}

/// A frame of the scene camera.
#[derive(Clone, Debug)]
pub struct SceneFrame {
    /// Sequence number.
    pub index: u32,
    /// Capture time in seconds on the clock of `meta.json`.
    pub timestamp_s: f64,
    /// True pose of the camera.
    pub camera_from_marker: DMat4,
    /// Lamps that are on: where their centres are in the world, metres.
    pub lamps_m: Vec<DVec3>,
}

/// Where one frame of the probe camera clips.
#[derive(Clone, Copy, Debug)]
pub struct ProbeExposure {
    /// Capture time in seconds on the clock of `meta.json`.
    pub timestamp_s: f64,
    /// Least radiance at which some channel clips: 1 / (gain · wb · S · exposure time), least over channels.
    ///
    /// Vignetting (clips later) and the ball's reflectance (clips later) are left out: a direction below this radiance
    /// was certainly measured.
    pub clipping_radiance: f64,
}

/// A virtual object of the references.
#[derive(Clone, Debug, Deserialize)]
pub struct VirtualObject {
    /// Name, also in the scene file and in the names of environment maps.
    pub name: String,
    /// What it is made of.
    pub material: Material,
    /// Its value in the label pictures.
    pub label: u8,
}

/// Material of a virtual object.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Material {
    /// Kind of reflection.
    #[serde(rename = "type")]
    pub kind: MaterialKind,
}

/// How a virtual object reflects.
#[derive(Clone, Copy, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MaterialKind {
    /// Lambert.
    Diffuse,
    /// Rough metal.
    Metal,
    /// Perfect mirror.
    Mirror,
}

/// Files of a frame with a path-traced reference, relative to the truth folder.
#[derive(Clone, Debug, Deserialize)]
pub struct Reference {
    /// Sequence number of the scene frame.
    pub frame: u32,
    with_png: PathBuf,
    without_png: PathBuf,
    mask: PathBuf,
    labels: PathBuf,
    shadow_ratio: PathBuf,
}

/// A true environment map.
#[derive(Clone, Debug, Deserialize)]
pub struct Environment {
    /// File, relative to the truth folder.
    file: PathBuf,
    /// `ball`, `fisheye` or the name of a virtual object.
    pub at: String,
    /// Time in seconds on the clock of `meta.json`.
    #[serde(rename = "timestamp")]
    pub timestamp_s: f64,
    /// Whether the light is constant.
    pub valid_for_all_frames: bool,
    /// Place in the world, metres.
    #[serde(rename = "position")]
    pub position_m: [f64; 3],
}

impl Truth {
    /// Reads `meta.json` of a truth folder.
    ///
    /// # Errors
    /// When the file is missing, lacks a key, or is of another format or version.
    pub fn load(folder: &Path) -> Result<Self, ToolError> {
        let path = folder.join("meta.json");
        let meta: Meta = json::read(&path, "the description of the truth")?;
        if meta.format != "mirrorball-truth" || meta.version != 1 {
            return Err(ToolError::TruthVersion {
                path,
                format: meta.format,
                version: meta.version,
            });
        }
        let (probe_camera, probe_frames) = match meta.rig {
            Rig::OneCamera => (&meta.cameras.scene, &meta.frames.scene),
            Rig::TwoCamera | Rig::Fisheye => (
                meta.cameras.probe.as_ref().unwrap_or(&meta.cameras.scene),
                &meta.frames.probe,
            ),
        };
        let sensitivity = probe_camera.photometry.sensitivity;
        let probe_exposures = probe_frames.iter().map(|frame| frame.clipping(sensitivity)).collect();
        let scene_frames = meta
            .frames
            .scene
            .iter()
            .map(|frame| frame.with_pose(&path))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            name: meta.name,
            rig: meta.rig,
            size_px: [
                meta.cameras.scene.intrinsics.width,
                meta.cameras.scene.intrinsics.height,
            ],
            scene_frames,
            probe_exposures,
            virtual_objects: meta.virtual_objects,
            background_labels: BACKGROUND
                .iter()
                .filter_map(|name| meta.labels.get(*name).copied())
                .collect(),
            references: meta.references,
            environments: meta.environments,
            folder: folder.to_owned(),
        })
    }

    /// Returns the frame of the scene camera with this sequence number.
    pub fn scene_frame(&self, index: u32) -> Option<&SceneFrame> {
        self.scene_frames.iter().find(|frame| frame.index == index)
    }

    /// Returns the name under which the environment at the light probe is listed.
    pub fn probe_position(&self) -> &'static str {
        match self.rig {
            Rig::OneCamera | Rig::TwoCamera => "ball",
            Rig::Fisheye => "fisheye",
        }
    }

    /// Returns where the light probe is in the world, metres; `None` when no true map was taken there.
    pub fn probe_m(&self) -> Option<DVec3> {
        let at_probe = |environment: &&Environment| environment.at == self.probe_position();
        self.environments
            .iter()
            .find(at_probe)
            .map(|environment| DVec3::from_array(environment.position_m))
    }

    /// Returns the clipping radiance of the probe frame nearest in time; infinite when there is no probe frame.
    pub fn clipping_radiance(&self, timestamp_s: f64) -> f64 {
        let distance_s = |exposure: &&ProbeExposure| (exposure.timestamp_s - timestamp_s).abs();
        let nearest = self
            .probe_exposures
            .iter()
            .min_by(|a, b| distance_s(a).total_cmp(&distance_s(b)));
        nearest.map_or(f64::INFINITY, |exposure| exposure.clipping_radiance)
    }

    /// Returns where an environment map lies.
    pub fn environment_path(&self, environment: &Environment) -> PathBuf {
        self.folder.join(&environment.file)
    }

    /// Returns where the pictures of a reference lie.
    pub fn reference_paths(&self, reference: &Reference) -> ReferencePaths {
        ReferencePaths {
            with: self.folder.join(&reference.with_png),
            // `meta.json` was written beside the frames; they have moved to the recording.
            without: self.folder.with_file_name("recording").join(&reference.without_png),
            mask: self.folder.join(&reference.mask),
            labels: self.folder.join(&reference.labels),
            shadow_ratio: self.folder.join(&reference.shadow_ratio),
        }
    }
}

/// Where the pictures of a reference lie.
#[derive(Clone, Debug)]
pub struct ReferencePaths {
    /// The scene with the virtual objects really present.
    pub with: PathBuf,
    /// The camera's own frame.
    pub without: PathBuf,
    /// Coverage of the virtual objects, 0 to 255.
    pub mask: PathBuf,
    /// What one sample of each pixel hits.
    pub labels: PathBuf,
    /// 200 · luminance with / luminance without on receivers, 0 elsewhere.
    pub shadow_ratio: PathBuf,
}

#[derive(Deserialize)]
struct Meta {
    format: String,
    version: u32,
    name: String,
    rig: Rig,
    cameras: MetaCameras,
    #[serde(rename = "virtual")]
    virtual_objects: Vec<VirtualObject>,
    labels: BTreeMap<String, u8>,
    frames: MetaFrames,
    references: Vec<Reference>,
    environments: Vec<Environment>,
}

#[derive(Deserialize)]
struct MetaCameras {
    scene: MetaCamera,
    probe: Option<MetaCamera>,
}

#[derive(Deserialize)]
struct MetaCamera {
    intrinsics: MetaIntrinsics,
    photometry: MetaPhotometry,
}

#[derive(Deserialize)]
struct MetaIntrinsics {
    width: usize,
    height: usize,
}

#[derive(Deserialize)]
struct MetaPhotometry {
    sensitivity: f64,
}

#[derive(Deserialize)]
struct MetaFrames {
    scene: Vec<MetaFrame>,
    probe: Vec<MetaFrame>,
}

#[derive(Deserialize)]
struct MetaFrame {
    index: u32,
    timestamp: f64,
    exposure_s: f64,
    gain: f64,
    wb: [f64; 3],
    #[serde(rename = "T_camera_from_marker")]
    camera_from_marker: Option<[[f64; 4]; 4]>,
    #[serde(default)]
    lights: Vec<MetaLight>,
}

#[derive(Deserialize)]
struct MetaLight {
    weight: f64,
    /// Only lamps have one.
    position: Option<[f64; 3]>,
}

impl MetaFrame {
    fn clipping(&self, sensitivity: f64) -> ProbeExposure {
        let strongest_wb = self.wb.iter().copied().fold(0.0, f64::max);
        ProbeExposure {
            timestamp_s: self.timestamp,
            clipping_radiance: 1.0 / (self.gain * strongest_wb * sensitivity * self.exposure_s),
        }
    }

    fn with_pose(&self, path: &Path) -> Result<SceneFrame, ToolError> {
        // A scene frame without pose is read as a pose of zeros and refused as not rigid, with its number.
        let rows = self.camera_from_marker.unwrap_or_default();
        Ok(SceneFrame {
            index: self.index,
            timestamp_s: self.timestamp,
            camera_from_marker: pose_from_rows(rows, self.index, path)?,
            lamps_m: self
                .lights
                .iter()
                .filter(|light| light.weight > 0.0)
                .filter_map(|light| light.position.map(DVec3::from_array))
                .collect(),
        })
    }
}
