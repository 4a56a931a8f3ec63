//! All figures of a run.

use crate::{
    ToolError,
    composite_error::{self, CompositeError},
    environment_error::{self, EnvironmentError},
    outputs::Outputs,
    pose_error::PoseError,
    stages::{self, StageTime},
    truth::{Rig, Truth},
};
use serde::Serialize;
use std::path::Path;

/// All figures of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Score {
    /// Name of the sequence.
    pub sequence: String,
    /// Which cameras the rig has.
    pub rig: Rig,
    /// Number of scene frames the truth speaks of.
    pub scene_frames: usize,
    /// Error of the tracked poses.
    pub pose: PoseError,
    /// Error of the environment maps, the probe's first.
    pub environments: Vec<EnvironmentError>,
    /// Error of the composites that have a reference.
    pub composites: Vec<CompositeError>,
    /// Time per stage, the slowest first.
    pub stages: Vec<StageTime>,
}

impl Score {
    /// Compares an output folder with a truth folder.
    ///
    /// # Errors
    /// When a file of either is missing or broken; an environment map that was not written is not an error.
    pub fn measure(output_folder: &Path, truth_folder: &Path) -> Result<Self, ToolError> {
        let truth = Truth::load(truth_folder)?;
        let outputs = Outputs::load(output_folder)?;
        let composites = composite_error::measure(&outputs, &truth)?;
        Ok(Self {
            composites,
            ..Self::measure_light(output_folder, truth_folder)?
        })
    }

    /// Compares poses and light only, of a run that left no composites.
    ///
    /// # Errors
    /// As [`Self::measure`], composites apart.
    pub fn measure_light(output_folder: &Path, truth_folder: &Path) -> Result<Self, ToolError> {
        let truth = Truth::load(truth_folder)?;
        let outputs = Outputs::load(output_folder)?;
        Ok(Self {
            sequence: truth.name.clone(),
            rig: truth.rig,
            scene_frames: truth.scene_frames.len(),
            pose: PoseError::measure(&outputs, &truth),
            environments: environment_error::measure(&outputs, &truth)?,
            composites: Vec::new(),
            stages: stages::measure(&outputs),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{cli::failure_text, floors, outputs::composite_path, report};
    use std::{fs, path::PathBuf};

    fn data(path: &str) -> PathBuf {
        PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/data")).join(path)
    }

    /// An output folder with the true poses and, as composites, the references or the camera's own frames.
    fn output_folder(
        truth_folder: &Path,
        picture: impl Fn(&crate::truth::ReferencePaths) -> PathBuf,
    ) -> tempfile::TempDir {
        let truth = Truth::load(truth_folder).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let entries = truth.scene_frames.iter().map(|frame| {
            let rows = frame.camera_from_marker.transpose().to_cols_array_2d();
            let stages = r#"{"track":2.0,"shade":7.5}"#;
            format!(
                r#"{{"frame":{},"camera_from_world":{rows:?},"stages_ms":{stages}}}"#,
                frame.index
            )
        });
        let lines: Vec<_> = entries
            .chain([r#"{"frame":99,"camera_from_world":null,"reason":"none"}"#.to_owned()])
            .collect();
        fs::write(folder.path().join("frames.jsonl"), lines.join("\n")).unwrap();
        fs::create_dir(folder.path().join("composite")).unwrap();
        fs::create_dir(folder.path().join("environment")).unwrap();
        for reference in &truth.references {
            let composite = composite_path(folder.path(), reference.frame);
            fs::copy(picture(&truth.reference_paths(reference)), composite).unwrap();
        }
        for (environment, frame) in truth.environments.iter().zip([3, 3, 3, 10, 10, 10]) {
            let object = if environment.at == "ball" {
                String::new()
            } else {
                format!("@{}", environment.at)
            };
            let path = folder.path().join(format!("environment/{frame:06}{object}.exr"));
            fs::copy(truth.environment_path(environment), path).unwrap();
        }
        folder
    }

    #[test]
    fn the_truth_itself_reaches_every_floor_but_the_untouched_background() {
        let truth = data("moving_lamp/truth");
        let output = output_folder(&truth, |paths| paths.with.clone());
        let score = Score::measure(output.path(), &truth).unwrap();
        assert_eq!((score.pose.frames.len(), score.pose.lost.len()), (10, 0));
        assert_eq!(score.pose.without_truth, [99]);
        assert_eq!(
            score.environments.iter().map(|e| e.frames.len()).collect::<Vec<_>>(),
            [2, 2, 2]
        );
        assert!(score.environments[0].is_probe);
        assert_eq!(score.environments[0].worst(|frame| frame.light_deg), Some(0.0));
        assert_eq!(score.stages[0].name, "shade");
        // The references carry light bounced off the virtual objects into the room: some background pixels differ.
        let failed = floors::check(&score).into_iter().filter(|floor| !floor.passed);
        assert!(
            failed
                .map(|floor| floor.what)
                .all(|what| what.ends_with("changed pixels outside"))
        );
        assert!(report::text(&score).contains("vase (diffuse)"));
    }

    #[test]
    fn the_untouched_frames_score_as_measured_before() {
        let truth = data("moving_lamp/truth");
        let output = output_folder(&truth, |paths| paths.without.clone());
        let score = Score::measure(output.path(), &truth).unwrap();
        let shadow_db = score
            .composites
            .iter()
            .map(|composite| composite.shadow.psnr_db.unwrap().0.round());
        assert_eq!(shadow_db.collect::<Vec<_>>(), [18.0, 15.0]);
        assert!(
            score
                .composites
                .iter()
                .all(|composite| composite.outside_pixels_changed == 0)
        );
    }

    #[test]
    fn a_missing_composite_is_named() {
        let truth = data("moving_lamp/truth");
        let output = output_folder(&truth, |paths| paths.with.clone());
        fs::remove_file(composite_path(output.path(), 10)).unwrap();
        let error = Score::measure(output.path(), &truth).unwrap_err();
        let text = failure_text(&error);
        assert!(
            text.contains("composite/000010.png`, the composite of frame 10\n  caused by: "),
            "{text}"
        );
        assert_eq!(error.exit_code(), 2);
    }
}
