//! From the file as it is written to checked types, and all defaults.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::document::Document;
use super::error::ConfigError;
use super::file::{
    AutoExposureFile, CameraFile, ConfigFile, FormatFile, LockstepFile, ManualFile, MethodFile, ModeFile, RecordFile,
    ResponseFile, RoleFile, ServiceFile, StampsFile,
};
use super::{CameraConfig, CaptureConfig, RecordConfig, ServiceConfig};
use crate::frame::Size;
use crate::grouping::DEFAULT_MAX_SKEW;
use crate::handover::DEFAULT_SERVICE;
use crate::lockstep::auto_exposure::AutoExposureSettings;
use crate::lockstep::tables::{TableError, Tables, TablesConfig};
use crate::lockstep::{BRACKET_STEPS_MAX, LockstepSettings, Mains, ManualWhiteBalance, Mode, OFFSET_MAX_EV};
use crate::meter::Response;
use crate::source::{CameraRole, NAME_MAX_BYTES, SIDE_MAX_PX};
use crate::stamps::StampPolicy;
use crate::v4l2::{CameraAddress, FormatKind, Method};

/// Version of this format.
const VERSION: i64 = 1;

/// Most cameras the daemon drives.
const CAMERAS_MAX: usize = 2;

/// Longest service name in bytes, as iceoryx2 has it.
const SERVICE_MAX_BYTES: usize = 255;

/// Formats in order of preference: raw ones cost no decoding, and a picture without colour is of little use.
const FORMATS: [FormatKind; 4] = [FormatKind::Yuyv, FormatKind::Nv12, FormatKind::Mjpeg, FormatKind::Grey];

pub(super) fn check(document: &Document<'_>, file: ConfigFile) -> Result<CaptureConfig, ConfigError> {
    if file.version != VERSION {
        return Err(document.refuse("version", &file.version, VERSION.to_string()));
    }
    if !(1..=CAMERAS_MAX).contains(&file.camera.len()) {
        let found = format!("{} cameras", file.camera.len());
        return Err(document.refuse("camera", &found, "1 or 2 `[[camera]]`"));
    }
    let mut cameras: Vec<CameraConfig> = Vec::with_capacity(file.camera.len());
    for (index, camera) in file.camera.into_iter().enumerate() {
        let camera = check_camera(document, index, camera)?;
        if cameras.iter().any(|other| other.name == camera.name) {
            let key = format!("camera[{index}].name");
            return Err(document.refuse(&key, &camera.name, "a name used only once"));
        }
        if cameras.iter().any(|other| may_be_one(&other.address, &camera.address)) {
            let key = match camera.address {
                CameraAddress::Path(_) => format!("camera[{index}].device"),
                CameraAddress::Card { .. } => format!("camera[{index}].card"),
            };
            let allowed = "another camera than the first; two of one name each need a `usb_path`";
            return Err(document.refuse(&key, &"the first camera's", allowed));
        }
        cameras.push(camera);
    }
    Ok(CaptureConfig {
        service: check_service(document, file.service)?,
        rig: file.rig.map(|path| beside(document, path)),
        lockstep: check_lockstep(document, &file.lockstep, &cameras)?,
        cameras,
        record: file.record.map(|record| check_record(document, record)).transpose()?,
        log: file.log.format.unwrap_or_default(),
    })
}

/// True if one camera may answer to both addresses.
fn may_be_one(a: &CameraAddress, b: &CameraAddress) -> bool {
    match (a, b) {
        (CameraAddress::Path(a), CameraAddress::Path(b)) => a == b,
        (CameraAddress::Card { name: a, bus: at_a }, CameraAddress::Card { name: b, bus: at_b }) => {
            a == b && (at_a == at_b || at_a.is_none() || at_b.is_none())
        }
        // A node does not tell its name; the daemon finds out when it opens the second one.
        (CameraAddress::Path(_), CameraAddress::Card { .. }) | (CameraAddress::Card { .. }, CameraAddress::Path(_)) => {
            false
        }
    }
}

/// A path that is relative to the configuration file's folder.
fn beside(document: &Document<'_>, path: PathBuf) -> PathBuf {
    match document.path().parent() {
        Some(folder) => folder.join(path),
        None => path,
    }
}

fn check_service(document: &Document<'_>, service: ServiceFile) -> Result<ServiceConfig, ConfigError> {
    let name = service.name.unwrap_or_else(|| DEFAULT_SERVICE.to_owned());
    if !(1..=SERVICE_MAX_BYTES).contains(&name.len()) {
        return Err(document.refuse("service.name", &name, "1 to 255 bytes"));
    }
    let max_skew_ms = service.max_skew_ms.unwrap_or(DEFAULT_MAX_SKEW.as_secs_f64() * 1e3);
    let max_skew_ms = document.number("service.max_skew_ms", max_skew_ms, 1.0..=1000.0)?;
    Ok(ServiceConfig {
        name,
        max_skew: Duration::from_secs_f64(max_skew_ms * 1e-3),
        status_socket: service.status_socket.map(|path| beside(document, path)),
    })
}

fn check_camera(document: &Document<'_>, index: usize, file: CameraFile) -> Result<CameraConfig, ConfigError> {
    let key = |name: &str| format!("camera[{index}].{name}");
    let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
    if !(1..=NAME_MAX_BYTES).contains(&file.name.len()) || !file.name.bytes().all(is_allowed) {
        let allowed = "letters, digits, `-` and `_`; 1 to 64 of them";
        return Err(document.refuse(&key("name"), &file.name, allowed));
    }
    let response = check_response(document, &key("response"), &file)?;
    let tables = check_tables(document, index, &file)?;
    let [width, height] = file.size_px;
    let size = Size {
        width: document.whole(&key("size_px"), width, 1..=SIDE_MAX_PX)?,
        height: document.whole(&key("size_px"), height, 1..=SIDE_MAX_PX)?,
    };
    let stamp_offset_s = document.number(&key("stamp_offset_s"), file.stamp_offset_s.unwrap_or(0.0), -1.0..=1.0)?;
    let latency = |frames| document.whole(&key("latency_frames"), frames, 0..=8);
    Ok(CameraConfig {
        role: match file.role {
            RoleFile::Scene => CameraRole::Scene,
            RoleFile::Ball => CameraRole::Ball,
            RoleFile::Fisheye => CameraRole::Fisheye,
        },
        address: check_place(document, index, &file)?,
        size,
        rate_hz: document.number(&key("rate_hz"), file.rate_hz.unwrap_or(30.0), 1.0..=1000.0)?,
        formats: check_formats(document, &key("formats"), file.formats)?,
        method: match file.method.unwrap_or(MethodFile::Auto) {
            MethodFile::Auto => Method::Auto,
            MethodFile::Mmap => Method::Mmap,
            MethodFile::UserPtr => Method::UserPtr,
        },
        n_buffers: document.whole(&key("buffers"), file.buffers.unwrap_or(6), 3..=32)?,
        stamps: match file.stamps.unwrap_or(StampsFile::Auto) {
            StampsFile::Auto => StampPolicy::Auto,
            StampsFile::Driver => StampPolicy::Driver,
            StampsFile::Mapped => StampPolicy::Mapped,
        },
        stamp_offset_ns: (stamp_offset_s * 1e9).round() as i64,
        response,
        tables,
        latency_frames: file.latency_frames.map(latency).transpose()?,
        name: file.name.into(),
    })
}

fn check_place(document: &Document<'_>, index: usize, file: &CameraFile) -> Result<CameraAddress, ConfigError> {
    let key = |name: &str| format!("camera[{index}].{name}");
    match (&file.device, &file.card, &file.usb_path) {
        (Some(device), None, None) if device.is_absolute() => Ok(CameraAddress::Path(device.clone())),
        (Some(device), None, None) => {
            Err(document.refuse(&key("device"), &device.display(), "a path such as `/dev/video0`"))
        }
        (None, Some(card), usb_path) if !card.trim().is_empty() => Ok(CameraAddress::Card {
            name: card.trim().to_owned(),
            bus: usb_path.clone(),
        }),
        (None, Some(card), _) => Err(document.refuse(&key("card"), card, "the camera's name, not empty")),
        (Some(device), ..) => Err(document.refuse(
            &key("device"),
            &device.display(),
            "either `device`, or `card` and if needed `usb_path`",
        )),
        (None, None, _) => Err(document.refuse(
            &format!("camera[{index}]"),
            &"a camera without address",
            "`device`, or `card` and if needed `usb_path`",
        )),
    }
}

fn check_formats(
    document: &Document<'_>,
    key: &str,
    formats: Option<Vec<FormatFile>>,
) -> Result<Vec<FormatKind>, ConfigError> {
    let Some(formats) = formats else {
        return Ok(FORMATS.to_vec());
    };
    let kind = |format: FormatFile| match format {
        FormatFile::Yuyv => FormatKind::Yuyv,
        FormatFile::Nv12 => FormatKind::Nv12,
        FormatFile::Mjpeg => FormatKind::Mjpeg,
        FormatFile::Grey => FormatKind::Grey,
    };
    let formats: Vec<FormatKind> = formats.into_iter().map(kind).collect();
    let is_repeated = |index: usize| formats[..index].contains(&formats[index]);
    if formats.is_empty() || (1..formats.len()).any(is_repeated) {
        let found = format!("{} formats", formats.len());
        return Err(document.refuse(key, &found, "at least one format, none twice"));
    }
    Ok(formats)
}

fn check_response(document: &Document<'_>, key: &str, file: &CameraFile) -> Result<Response, ConfigError> {
    let values = match &file.response {
        None => return Ok(Response::srgb()),
        Some(ResponseFile::Name(name)) if name == "srgb" => return Ok(Response::srgb()),
        Some(ResponseFile::Name(name)) => return Err(document.refuse(key, name, "`srgb` or 256 numbers")),
        Some(ResponseFile::Values(values)) => values,
    };
    Response::from_values(values).map_err(|source| ConfigError::Response {
        path: document.path().to_owned(),
        line: document.line_of(key),
        camera: file.name.clone(),
        source,
    })
}

fn check_tables(document: &Document<'_>, index: usize, file: &CameraFile) -> Result<Tables, ConfigError> {
    let tables = TablesConfig {
        exposure_table: file.exposure_table.clone(),
        gain_table: file.gain_table.clone(),
        white_balance_table: file.white_balance_table.clone(),
        sensitivity: file.sensitivity,
        sensitivity_table: file.sensitivity_table.clone(),
    };
    Tables::new(&tables).map_err(|source| ConfigError::Table {
        path: document.path().to_owned(),
        line: document.line_of(&format!("camera[{index}].{}", table_key(&source))),
        camera: file.name.clone(),
        source,
    })
}

/// The table that an error is about.
fn table_key(error: &TableError) -> &'static str {
    match error {
        TableError::Points { table, .. } | TableError::Value { table, .. } | TableError::NotRising { table, .. } => {
            table
        }
        TableError::Kinds { table, .. } => table,
    }
}

fn check_lockstep(
    document: &Document<'_>,
    file: &LockstepFile,
    cameras: &[CameraConfig],
) -> Result<LockstepSettings, ConfigError> {
    let scenes: Vec<usize> = (0..cameras.len())
        .filter(|&index| cameras[index].role == CameraRole::Scene)
        .collect();
    let [leader] = scenes[..] else {
        let key = format!("camera[{}].role", cameras.len() - 1);
        let found = format!("{} cameras with the role scene", scenes.len());
        return Err(document.refuse(&key, &found, "exactly one"));
    };
    let defaults = LockstepSettings::default();
    let mains = match file.anti_flicker_hz.unwrap_or(0) {
        0 => Mains::Steady,
        50 => Mains::Hz50,
        60 => Mains::Hz60,
        other => return Err(document.refuse("lockstep.anti_flicker_hz", &other, "0, 50 or 60")),
    };
    let max_exposure_s = file.max_exposure_s.unwrap_or(defaults.max_exposure_s);
    Ok(LockstepSettings {
        leader,
        mode: check_mode(document, file, cameras, leader)?,
        max_exposure_s: document.number("lockstep.max_exposure_s", max_exposure_s, 1e-4..=10.0)?,
        mains,
        auto_exposure: check_auto_exposure(document, &file.auto_exposure)?,
        measure_latency: file.measure_latency.unwrap_or(defaults.measure_latency),
    })
}

fn check_auto_exposure(document: &Document<'_>, file: &AutoExposureFile) -> Result<AutoExposureSettings, ConfigError> {
    let defaults = AutoExposureSettings::default();
    let number = |key: &str, value: Option<f64>, default: f64, allowed| {
        document.number(
            &format!("lockstep.auto_exposure.{key}"),
            value.unwrap_or(default),
            allowed,
        )
    };
    Ok(AutoExposureSettings {
        key: number("key", file.key, defaults.key, 0.01..=0.9)?,
        highlight_drop_max_ev: number(
            "highlight_drop_max_ev",
            file.highlight_drop_max_ev,
            defaults.highlight_drop_max_ev,
            0.0..=4.0,
        )?,
        dead_band_ev: number("dead_band_ev", file.dead_band_ev, defaults.dead_band_ev, 0.02..=1.0)?,
        settle_s: number("settle_s", file.settle_s, defaults.settle_s, 0.01..=10.0)?,
    })
}

/// Checks the keys of all modes, so that a switch of `mode` meets no surprise, and returns the one chosen.
fn check_mode(
    document: &Document<'_>,
    file: &LockstepFile,
    cameras: &[CameraConfig],
    leader: usize,
) -> Result<Mode, ConfigError> {
    let fixed_ratio = check_fixed_ratio(document, file, cameras)?;
    let bracket = check_bracket(document, file, cameras, leader)?;
    let manual = check_manual(document, &file.manual)?;
    match file.mode.unwrap_or(ModeFile::FollowLeader) {
        ModeFile::FollowLeader => Ok(Mode::FollowLeader),
        ModeFile::Locked => Ok(Mode::Locked),
        ModeFile::FixedRatio => Ok(fixed_ratio),
        ModeFile::Bracket => bracket.ok_or_else(|| {
            document.refuse(
                "lockstep.mode",
                &"bracket",
                "another mode, as there is no camera besides the scene camera",
            )
        }),
        ModeFile::Manual => Ok(manual),
    }
}

fn check_fixed_ratio(
    document: &Document<'_>,
    file: &LockstepFile,
    cameras: &[CameraConfig],
) -> Result<Mode, ConfigError> {
    let mut offsets_ev = vec![0.0; cameras.len()];
    for (name, &offset_ev) in &file.fixed_ratio.offsets_ev {
        let key = format!("lockstep.fixed_ratio.offsets_ev.{name}");
        let Some(index) = camera_index(cameras, name) else {
            return Err(document.refuse(&key, &offset_ev, format!("only names of cameras: {}", names(cameras))));
        };
        offsets_ev[index] = document.number(&key, offset_ev, -OFFSET_MAX_EV..=OFFSET_MAX_EV)?;
    }
    Ok(Mode::FixedRatio { offsets_ev })
}

/// None if there is no camera to bracket.
fn check_bracket(
    document: &Document<'_>,
    file: &LockstepFile,
    cameras: &[CameraConfig],
    leader: usize,
) -> Result<Option<Mode>, ConfigError> {
    let bracket = &file.bracket;
    let n_steps = document.whole(
        "lockstep.bracket.steps",
        bracket.steps.unwrap_or(3),
        2..=BRACKET_STEPS_MAX,
    )?;
    let step_ev = document.number("lockstep.bracket.step_ev", bracket.step_ev.unwrap_or(2.0), 0.01..=5.0)?;
    let camera = match &bracket.camera {
        None => (0..cameras.len()).find(|&index| index != leader),
        Some(name) => match camera_index(cameras, name).filter(|&index| index != leader) {
            Some(index) => Some(index),
            None => {
                let allowed = "the name of the camera that is not the scene camera";
                return Err(document.refuse("lockstep.bracket.camera", name, allowed));
            }
        },
    };
    Ok(camera.map(|camera| Mode::Bracket {
        camera,
        n_steps,
        step_ev,
    }))
}

fn check_manual(document: &Document<'_>, manual: &ManualFile) -> Result<Mode, ConfigError> {
    let white_balance = match (manual.white_balance_k, manual.white_balance_gains) {
        (Some(kelvin), None) => {
            let kelvin = document.number("lockstep.manual.white_balance_k", kelvin, 1000.0..=40_000.0)?;
            ManualWhiteBalance::Kelvin(kelvin)
        }
        (None, Some(gains)) => {
            for gain in gains {
                document.number("lockstep.manual.white_balance_gains", gain, 0.01..=100.0)?;
            }
            ManualWhiteBalance::Gains(gains)
        }
        (None, None) => ManualWhiteBalance::Kelvin(5000.0),
        (Some(kelvin), Some(_)) => {
            let allowed = "either this or `white_balance_gains`";
            return Err(document.refuse("lockstep.manual.white_balance_k", &kelvin, allowed));
        }
    };
    let exposure_s = manual.exposure_s.unwrap_or(0.01);
    Ok(Mode::Manual {
        exposure_s: document.number("lockstep.manual.exposure_s", exposure_s, 1e-6..=10.0)?,
        gain: document.number("lockstep.manual.gain", manual.gain.unwrap_or(1.0), 0.01..=1000.0)?,
        white_balance,
    })
}

fn check_record(document: &Document<'_>, record: RecordFile) -> Result<RecordConfig, ConfigError> {
    let directory = record.directory;
    if directory == Path::new("") {
        return Err(document.refuse("record.directory", &"", "a folder"));
    }
    let max_queue_mb = record.max_queue_mb.unwrap_or(512);
    Ok(RecordConfig {
        directory: beside(document, directory),
        max_queue_mb: document.whole("record.max_queue_mb", max_queue_mb, 16..=65_536)?,
    })
}

fn camera_index(cameras: &[CameraConfig], name: &str) -> Option<usize> {
    cameras.iter().position(|camera| &*camera.name == name)
}

fn names(cameras: &[CameraConfig]) -> String {
    let quoted: Vec<String> = cameras.iter().map(|camera| format!("`{}`", camera.name)).collect();
    quoted.join(", ")
}
