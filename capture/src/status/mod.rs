//! How the daemon is doing, as one JSON document on a Unix socket: for `mirrorball-capture status` and for scripts.
//!
//! ```text
//! daemon --once a second--> StatusBoard <--per connection-- StatusServer --JSON--> fetch()
//! ```
//!
//! Whoever connects gets the newest [`Status`] and the end of the stream; what they send is not read.

mod place;
mod server;
mod table;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use place::{SocketEnvironment, default_socket, find_socket};
pub use server::{StatusBoard, StatusError, StatusServer, fetch};
pub use table::table;

use crate::daemon::{CameraReport, CameraStage, Report};
use crate::lockstep::latency::LatencySource;
use crate::stamps::{LossCause, StampBasis};

/// The daemon and its cameras. What is not known is null.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Version of the program.
    pub version: String,
    /// Its process.
    pub pid: u32,
    /// Name of the service that sets are published on.
    pub service: String,
    /// Time since it started, in seconds.
    pub uptime_s: f64,
    /// Cameras in the order of the configuration.
    pub cameras: Vec<CameraStatus>,
    /// Differences in time within sets; null without a second camera.
    pub skew: Option<SkewStatus>,
    /// Frame sets.
    pub sets: SetsStatus,
    /// The recording, if there is one.
    pub recorder: Option<RecorderStatus>,
}

/// One camera.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraStatus {
    /// Its name.
    pub name: String,
    /// What it is doing.
    pub state: CameraState,
    /// Why it is not streaming, if it is not.
    pub reason: Option<String>,
    /// Format and rate agreed on, in words.
    pub format: Option<String>,
    /// Frames per second in the last second.
    pub rate_hz: f64,
    /// Frames per second agreed on.
    pub nominal_rate_hz: Option<f64>,
    /// Good frames.
    pub frames: u64,
    /// Frames lost, by cause; causes without a loss are left out.
    pub lost: BTreeMap<LossCause, u64>,
    /// Buffers that held the frame before once more.
    pub duplicates: u64,
    /// Bad buffers that stand for no frame.
    pub empty_buffers: u64,
    /// How often it was found.
    pub opened: u64,
    /// How often its stream was started anew.
    pub restarts: u64,
    /// Requests that its driver refused.
    pub refused_requests: u64,
    /// How often an automatic mode was switched on behind our back.
    pub auto_modes_found: u64,
    /// Where its time stamps come from.
    pub stamps: Option<StampSource>,
    /// Exposure time in force, in seconds.
    pub exposure_s: Option<f64>,
    /// Linear gain in force.
    pub gain: Option<f64>,
    /// Linear white-balance gains of red, green and blue in force.
    pub white_balance: Option<[f64; 3]>,
    /// What its controls leave over to the common exposure, in exposure steps.
    pub residual_ev: f64,
    /// True if the lamps flicker at its exposure time.
    pub flickers: bool,
    /// How many frames late requests show.
    pub latency_frames: Option<u32>,
    /// True if that is measured or configured, false while it is assumed.
    pub is_latency_known: bool,
}

/// What a camera is doing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraState {
    /// It is not there or cannot be used; it is looked for.
    #[default]
    WaitingForDevice,
    /// Its stream is being started, or started anew: no frame has come in the last second.
    Restarting,
    /// It sends frames.
    Streaming,
}

/// Where time stamps come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StampSource {
    /// The driver's, as they are.
    Driver,
    /// The driver's, mapped to the host's clock.
    Mapped,
    /// The time of arrival.
    Arrival,
}

/// Differences in time within the last sets, in microseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct SkewStatus {
    /// Median of the magnitude.
    pub p50_us: f64,
    /// 95 of 100 are smaller.
    pub p95_us: f64,
    /// Greatest.
    pub max_us: f64,
}

/// Frame sets since the start.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetsStatus {
    /// Sets published.
    pub published: u64,
    /// Of these, sets that went to nobody.
    pub unread: u64,
    /// Sets made that lack a camera.
    pub incomplete: u64,
    /// Sets that could not be published because a frame was bad.
    pub bad: u64,
    /// Readers now.
    pub readers: u64,
}

/// The recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct RecorderStatus {
    /// Frames written.
    pub frames: u64,
    /// Of these, frames that a power cut can no longer take.
    pub safe_frames: u64,
    /// Length of the file in bytes.
    pub bytes: u64,
    /// Frames that wait to be written.
    pub queued_frames: u64,
    /// Frames given that will not be in the recording.
    pub lost_frames: u64,
    /// Time since the recording began, in seconds.
    pub elapsed_s: f64,
}

impl Status {
    /// What there is to tell of a daemon that has just started.
    #[must_use]
    pub fn starting(service: &str) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            pid: std::process::id(),
            service: service.to_owned(),
            ..Self::default()
        }
    }

    /// The same daemon, `uptime_s` seconds after its start, with what it reports now.
    #[must_use]
    pub fn with_report(&self, report: &Report, uptime_s: f64) -> Self {
        let has_others = report.cameras.len() > 1;
        Self {
            version: self.version.clone(),
            pid: self.pid,
            service: self.service.clone(),
            uptime_s,
            cameras: report.cameras.iter().map(CameraStatus::from).collect(),
            skew: has_others.then_some(SkewStatus {
                p50_us: finite(report.skew.p50_us),
                p95_us: finite(report.skew.p95_us),
                max_us: finite(report.skew.max_us),
            }),
            sets: SetsStatus {
                published: report.publisher.published,
                unread: report.publisher.unread,
                incomplete: report.grouping.incomplete_sets,
                bad: report.bad_sets,
                readers: report.n_readers as u64,
            },
            recorder: report.recorder.map(|stats| RecorderStatus {
                frames: stats.frames,
                safe_frames: stats.safe_frames,
                bytes: stats.bytes,
                queued_frames: stats.queued_frames,
                lost_frames: stats.lost_frames,
                elapsed_s: finite(stats.elapsed_s),
            }),
        }
    }

    /// Frames lost by all cameras.
    #[must_use]
    pub fn lost_frames(&self) -> u64 {
        self.cameras.iter().map(CameraStatus::lost_frames).sum()
    }

    /// The most important in one line, for the service manager.
    #[must_use]
    pub fn summary(&self) -> String {
        let is_streaming = |camera: &&CameraStatus| camera.state == CameraState::Streaming;
        format!(
            "{} of {} cameras streaming, {} sets published, {} frames lost, {} readers",
            self.cameras.iter().filter(is_streaming).count(),
            self.cameras.len(),
            self.sets.published,
            self.lost_frames(),
            self.sets.readers
        )
    }
}

impl CameraStatus {
    /// Frames lost for whatever cause.
    #[must_use]
    pub fn lost_frames(&self) -> u64 {
        self.lost.values().sum()
    }
}

impl From<&CameraReport> for CameraStatus {
    fn from(report: &CameraReport) -> Self {
        let (state, reason) = match &report.stage {
            CameraStage::Waiting { reason } => (CameraState::WaitingForDevice, Some(reason.clone())),
            CameraStage::Streaming if report.rate_hz > 0.0 => (CameraState::Streaming, None),
            CameraStage::Streaming => (CameraState::Restarting, None),
        };
        let exposure = report.exposure;
        Self {
            name: report.name.clone(),
            state,
            reason,
            format: Some(report.mode.clone()).filter(|mode| !mode.is_empty()),
            rate_hz: finite(report.rate_hz),
            nominal_rate_hz: Some(report.nominal_rate_hz).filter(|rate| rate.is_finite() && *rate > 0.0),
            frames: report.frames,
            lost: report.losses.iter().collect(),
            duplicates: report.duplicates,
            empty_buffers: report.empty_buffers,
            opened: report.opened,
            restarts: report.restarts,
            refused_requests: report.refused_requests,
            auto_modes_found: report.auto_modes_found,
            stamps: report.stamp_basis.map(|basis| match basis {
                StampBasis::Driver => StampSource::Driver,
                StampBasis::Mapped => StampSource::Mapped,
                StampBasis::Arrival => StampSource::Arrival,
            }),
            exposure_s: exposure.map(|exposure| finite(exposure.time_s)),
            gain: exposure.map(|exposure| finite(exposure.gain)),
            white_balance: exposure.map(|exposure| exposure.white_balance.map(finite)),
            residual_ev: finite(report.residual_ev),
            flickers: report.flickers,
            latency_frames: report.latency.map(|latency| latency.frames),
            is_latency_known: report.latency.is_some_and(|latency| match latency.source {
                LatencySource::Assumed => false,
                LatencySource::Configured | LatencySource::Measured => true,
            }),
        }
    }
}

/// JSON has no infinity and no NaN.
fn finite(value: f64) -> f64 {
    if value.is_finite() { value } else { 0.0 }
}

#[cfg(test)]
mod tests;
