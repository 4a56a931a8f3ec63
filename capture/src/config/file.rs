//! The configuration file as it is written: every key, nothing checked but kinds of values.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Deserialize;

use super::LogFormat;
use crate::lockstep::tables::{ExposureTableConfig, GainTableConfig, SensitivityTableConfig, WhiteBalanceTableConfig};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ConfigFile {
    pub(super) version: i64,
    pub(super) rig: Option<PathBuf>,
    #[serde(default)]
    pub(super) service: ServiceFile,
    pub(super) camera: Vec<CameraFile>,
    #[serde(default)]
    pub(super) lockstep: LockstepFile,
    pub(super) record: Option<RecordFile>,
    #[serde(default)]
    pub(super) log: LogFile,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ServiceFile {
    pub(super) name: Option<String>,
    pub(super) max_skew_ms: Option<f64>,
    pub(super) status_socket: Option<PathBuf>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraFile {
    pub(super) name: String,
    pub(super) role: RoleFile,
    pub(super) device: Option<PathBuf>,
    pub(super) card: Option<String>,
    pub(super) usb_path: Option<String>,
    pub(super) size_px: [i64; 2],
    pub(super) rate_hz: Option<f64>,
    pub(super) formats: Option<Vec<FormatFile>>,
    pub(super) method: Option<MethodFile>,
    pub(super) buffers: Option<i64>,
    pub(super) stamps: Option<StampsFile>,
    pub(super) stamp_offset_s: Option<f64>,
    pub(super) response: Option<ResponseFile>,
    pub(super) sensitivity: Option<[f64; 3]>,
    pub(super) sensitivity_table: Option<SensitivityTableConfig>,
    pub(super) latency_frames: Option<i64>,
    pub(super) exposure_table: Option<ExposureTableConfig>,
    pub(super) gain_table: Option<GainTableConfig>,
    pub(super) white_balance_table: Option<WhiteBalanceTableConfig>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum RoleFile {
    Scene,
    Ball,
    Fisheye,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum FormatFile {
    Yuyv,
    Nv12,
    Mjpeg,
    Grey,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum MethodFile {
    Auto,
    Mmap,
    UserPtr,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum StampsFile {
    Auto,
    Driver,
    Mapped,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "expected \"srgb\" or 256 numbers")]
pub(super) enum ResponseFile {
    Name(String),
    Values(Vec<f64>),
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LockstepFile {
    pub(super) mode: Option<ModeFile>,
    pub(super) anti_flicker_hz: Option<i64>,
    pub(super) max_exposure_s: Option<f64>,
    pub(super) measure_latency: Option<bool>,
    #[serde(default)]
    pub(super) auto_exposure: AutoExposureFile,
    #[serde(default)]
    pub(super) fixed_ratio: FixedRatioFile,
    #[serde(default)]
    pub(super) bracket: BracketFile,
    #[serde(default)]
    pub(super) manual: ManualFile,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ModeFile {
    FollowLeader,
    FixedRatio,
    Bracket,
    Locked,
    Manual,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AutoExposureFile {
    pub(super) key: Option<f64>,
    pub(super) highlight_drop_max_ev: Option<f64>,
    pub(super) dead_band_ev: Option<f64>,
    pub(super) settle_s: Option<f64>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FixedRatioFile {
    #[serde(default)]
    pub(super) offsets_ev: BTreeMap<String, f64>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BracketFile {
    pub(super) camera: Option<String>,
    pub(super) steps: Option<i64>,
    pub(super) step_ev: Option<f64>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ManualFile {
    pub(super) exposure_s: Option<f64>,
    pub(super) gain: Option<f64>,
    pub(super) white_balance_k: Option<f64>,
    pub(super) white_balance_gains: Option<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RecordFile {
    pub(super) directory: PathBuf,
    pub(super) max_queue_mb: Option<i64>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LogFile {
    pub(super) format: Option<LogFormat>,
}
