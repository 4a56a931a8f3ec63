//! Frames as files: `composite/NNNNNN.png`, `frames.jsonl` and, if wanted, `environment/NNNNNN.exr`.

use std::fs::{File, create_dir_all};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use super::{Sink, environment};
use crate::error::RenderError;
use crate::measure::BlindView;
use crate::node::{LightReport, RenderNode, RenderedFrame, StrongReport, Work};
use crate::tracker::TrackedPose;

/// Whether the measured light is written as well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EnvironmentOut {
    /// Pictures only.
    No,
    /// One EXR for the probe and one for every virtual object, every frame.
    Yes,
}

/// A folder of results.
#[derive(Debug)]
pub struct FolderSink {
    folder: PathBuf,
    frames: BufWriter<File>,
    environment: EnvironmentOut,
    work: Work,
}

/// One line of `frames.jsonl`.
#[derive(Debug, Serialize)]
struct FrameLine<'a> {
    frame: u64,
    timestamp_ns: u64,
    mode: &'static str,
    camera_from_world: Option<[[f64; 4]; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'a str>,
    reprojection_error_px: Option<f64>,
    markers: usize,
    light: Option<LightLine>,
    stages_ms: Map<String, Value>,
}

/// What a line says about the light.
#[derive(Debug, Serialize)]
struct LightLine {
    age_frames: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    blind: Option<String>,
    papers: usize,
    patches: usize,
    residual: f64,
    ball_shift_mm: Option<f64>,
    strong: Vec<StrongLine>,
}

/// One strong light.
#[derive(Debug, Serialize)]
struct StrongLine {
    direction: [f64; 3],
    distance_m: f64,
    /// Null where nothing tells the distance.
    distance_sigma: Option<f64>,
    irradiance: [f64; 3],
    angular_radius_deg: f64,
}

impl LightLine {
    fn new(report: &LightReport) -> Self {
        let blind = |(camera, blind): &(String, BlindView)| format!("camera `{camera}`: {blind}");
        Self {
            age_frames: report.age_frames,
            blind: report.blind.as_ref().map(blind),
            papers: report.readings[0],
            patches: report.readings[1],
            residual: rounded(report.residual),
            ball_shift_mm: report.ball_shift_m.map(|shift_m| rounded((1e3 * shift_m) as f32)),
            strong: report.strong.iter().map(StrongLine::new).collect(),
        }
    }
}

impl StrongLine {
    fn new(light: &StrongReport) -> Self {
        // Half angle of the cone with this solid angle.
        let half_angle = (1.0 - light.area_sr / (2.0 * std::f32::consts::PI))
            .clamp(-1.0, 1.0)
            .acos();
        Self {
            direction: light.direction.to_array().map(rounded),
            distance_m: rounded(light.distance_m),
            distance_sigma: light.distance_sigma.is_finite().then(|| rounded(light.distance_sigma)),
            irradiance: light.irradiance.to_array().map(rounded),
            angular_radius_deg: rounded(half_angle.to_degrees()),
        }
    }
}

/// A number with the five digits that mean something.
fn rounded(value: f32) -> f64 {
    (f64::from(value) * 1e5).round() / 1e5
}

impl FolderSink {
    /// Makes the folder and starts `frames.jsonl` anew; a node that measures the light only leaves no composites.
    ///
    /// # Errors
    /// [`RenderError::Write`] when the folder or the file cannot be made.
    pub fn create(folder: &Path, (environment, work): (EnvironmentOut, Work)) -> Result<Self, RenderError> {
        make_folder(folder)?;
        if work == Work::Everything {
            make_folder(&folder.join("composite"))?;
        }
        if environment == EnvironmentOut::Yes {
            make_folder(&folder.join("environment"))?;
        }
        let file = folder.join("frames.jsonl");
        let frames = BufWriter::new(File::create(&file).map_err(|e| failed(&file, e))?);
        Ok(Self {
            folder: folder.to_owned(),
            frames,
            environment,
            work,
        })
    }

    fn write_environments(&self, frame: &RenderedFrame, node: &RenderNode) -> Result<(), RenderError> {
        let Some(light) = node.light() else { return Ok(()) };
        let folder = self.folder.join("environment");
        environment::write_exr(&folder.join(format!("{:06}.exr", frame.sequence)), &light.radiance)?;
        if frame.pose.camera_from_world().is_some() {
            for (name, radiance) in node.local_light()? {
                environment::write_exr(&folder.join(format!("{:06}@{name}.exr", frame.sequence)), &radiance)?;
            }
        }
        Ok(())
    }

    fn write_line(&mut self, frame: &RenderedFrame) -> Result<(), RenderError> {
        let file = self.folder.join("frames.jsonl");
        let line = serde_json::to_string(&line_of(frame)).map_err(|e| failed(&file, e))?;
        // Flushed line by line: what was rendered is there even if the next frame never comes.
        writeln!(self.frames, "{line}")
            .and_then(|()| self.frames.flush())
            .map_err(|e| failed(&file, e))
    }
}

impl Sink for FolderSink {
    fn take(&mut self, frame: &RenderedFrame, node: &RenderNode) -> Result<(), RenderError> {
        if self.work == Work::Everything {
            let file = self.folder.join("composite").join(format!("{:06}.png", frame.sequence));
            let rgb: Vec<u8> = frame.rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
            let [width, height] = frame.size_px;
            image::save_buffer(&file, &rgb, width, height, image::ColorType::Rgb8).map_err(|e| failed(&file, e))?;
        }
        if self.environment == EnvironmentOut::Yes {
            self.write_environments(frame, node)?;
        }
        self.write_line(frame)
    }
}

fn line_of(frame: &RenderedFrame) -> FrameLine<'_> {
    let round = |ms: f64| Value::from((ms * 1e3).round() / 1e3);
    let stages_ms = frame
        .stages_ms
        .iter()
        .map(|(name, ms)| ((*name).to_owned(), round(*ms)))
        .collect();
    let (camera_from_world, reason, reprojection_error_px, markers) = match &frame.pose {
        TrackedPose::Found {
            camera_from_world,
            reprojection_error_px,
            markers,
        } => (
            Some(camera_from_world.to_rows4()),
            None,
            Some(*reprojection_error_px),
            *markers,
        ),
        TrackedPose::Lost { reason, markers } => (None, Some(reason.as_str()), None, *markers),
    };
    FrameLine {
        frame: frame.sequence,
        timestamp_ns: frame.timestamp_ns,
        mode: frame.mode.name(),
        camera_from_world,
        reason,
        reprojection_error_px,
        markers,
        light: frame.light.as_ref().map(LightLine::new),
        stages_ms,
    }
}

fn make_folder(folder: &Path) -> Result<(), RenderError> {
    create_dir_all(folder).map_err(|e| failed(folder, e))
}

fn failed(file: &Path, error: impl std::error::Error + Send + Sync + 'static) -> RenderError {
    RenderError::Write {
        file: file.to_owned(),
        source: Box::new(error),
    }
}
