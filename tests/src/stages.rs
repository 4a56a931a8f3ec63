//! Time per stage, as the run reports it.

use crate::{outputs::Outputs, statistics::median};
use serde::Serialize;
use std::collections::BTreeMap;

/// Time of one stage over the frames of a run.
#[derive(Clone, Debug, Serialize)]
pub struct StageTime {
    /// Name of the stage.
    pub name: String,
    /// Median over the frames that have it, in milliseconds.
    pub median_ms: f64,
    /// Number of frames that have it.
    pub frames: usize,
}

/// Summarises the stages, the slowest first.
pub fn measure(outputs: &Outputs) -> Vec<StageTime> {
    let mut times_ms: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (name, &time_ms) in outputs.frames.iter().flat_map(|frame| &frame.stages_ms) {
        times_ms.entry(name).or_default().push(time_ms);
    }
    let stage = |(name, times_ms): (&str, Vec<f64>)| {
        let frames = times_ms.len();
        median(times_ms).map(|median_ms| StageTime {
            name: name.to_owned(),
            median_ms,
            frames,
        })
    };
    let mut stages: Vec<_> = times_ms.into_iter().filter_map(stage).collect();
    stages.sort_by(|a, b| b.median_ms.total_cmp(&a.median_ms));
    stages
}
