//! Frames as files: `composite/NNNNNN.png`, `frames.jsonl` and, if wanted, `environment/NNNNNN.exr`.

use std::fs::{File, create_dir_all};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value};

use super::{Sink, environment};
use crate::error::RenderError;
use crate::node::{RenderNode, RenderedFrame, Work};
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
    camera_from_world: Option<[[f64; 4]; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'a str>,
    reprojection_error_px: Option<f64>,
    markers: usize,
    stages_ms: Map<String, Value>,
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
        camera_from_world,
        reason,
        reprojection_error_px,
        markers,
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
