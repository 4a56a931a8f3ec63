//! How the daemon and its cameras are doing.

use crate::frame::Exposure;
use crate::grouping::GroupingCounters;
use crate::handover::PublisherStats;
use crate::lockstep::latency::Latency;
use crate::recording::mcap::RecorderStats;
use crate::stamps::{LossCounts, StampBasis, StampCounters};

/// What a camera is doing.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraStage {
    /// It is not there, or cannot be used, for this reason; it is looked for.
    Waiting {
        /// Why.
        reason: String,
    },
    /// It sends frames.
    Streaming,
}

/// One camera since the daemon started.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraReport {
    /// Its name.
    pub name: String,
    /// What it is doing.
    pub stage: CameraStage,
    /// Format and rate agreed on, in words; empty before it was found.
    pub mode: String,
    /// Frames per second it should send; 0 before it was found.
    pub nominal_rate_hz: f64,
    /// Frames per second since the last report.
    pub rate_hz: f64,
    /// Good frames.
    pub frames: u64,
    /// Frames lost, by cause.
    pub losses: LossCounts,
    /// Buffers that held the frame before once more.
    pub duplicates: u64,
    /// Bad buffers that stand for no frame.
    pub empty_buffers: u64,
    /// What was wrong with time stamps.
    pub stamps: StampCounters,
    /// Where time stamps come from.
    pub stamp_basis: Option<StampBasis>,
    /// How often the camera was found.
    pub opened: u64,
    /// How often its stream was started anew.
    pub restarts: u64,
    /// Pictures that could not be decoded to be measured.
    pub undecodable: u64,
    /// Requests that the driver refused.
    pub refused_requests: u64,
    /// How often an automatic mode was switched on behind our back.
    pub auto_modes_found: u64,
    /// Exposure of the last frame.
    pub exposure: Option<Exposure>,
    /// What the controls have left over in the last frame: the residual of green, in exposure steps.
    pub residual_ev: f64,
    /// True if the lamps flicker at that exposure time.
    pub flickers: bool,
    /// How many frames late requests take effect.
    pub latency: Option<Latency>,
}

/// Differences in time between the leading camera's frames and the other camera's beside them, in microseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Skew {
    /// Median of the magnitude.
    pub p50_us: f64,
    /// 95 of 100 are smaller.
    pub p95_us: f64,
    /// Greatest.
    pub max_us: f64,
}

/// Everything since the daemon started.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Cameras in the order of the configuration.
    pub cameras: Vec<CameraReport>,
    /// What became of the frames.
    pub grouping: GroupingCounters,
    /// What became of the sets.
    pub publisher: PublisherStats,
    /// Readers now.
    pub n_readers: usize,
    /// Skew of the last sets.
    pub skew: Skew,
    /// The recording, if there is one.
    pub recorder: Option<RecorderStats>,
    /// Sets that could not be published because a frame was bad.
    pub bad_sets: u64,
}
