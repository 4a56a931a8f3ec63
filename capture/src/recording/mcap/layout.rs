//! What our MCAP files hold: names of topics and records, and the JSON of frames and events.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::frame::{BufferFlags, Exposure, FrameMeta, PixelFormat, Size, Ycbcr, YcbcrMatrix, YcbcrRange};
use crate::source::{CameraDescription, CameraRole, NAME_MAX_BYTES, SIDE_MAX_PX};

/// Version of the layout; raised when an old reader would misunderstand a new file.
pub(super) const FORMAT_VERSION: u32 = 1;

/// Name of the metadata record that makes an MCAP file ours.
pub(super) const METADATA_NAME: &str = "mirrorball";

/// Name of the attachment that is the rig file.
pub(super) const RIG_ATTACHMENT: &str = "rig.toml";

/// Name of the attachment that is the configuration of the daemon.
pub(super) const CONFIG_ATTACHMENT: &str = "capture.toml";

/// Topic of the events.
pub(super) const EVENTS_TOPIC: &str = "/events";

/// Names of our own schemas.
pub(super) const FRAME_SCHEMA_NAME: &str = "mirrorball.Frame";
pub(super) const EVENT_SCHEMA_NAME: &str = "mirrorball.Event";

/// Largest time stamp and sequence number that is played; the room above is for the shift of repetitions.
pub(super) const COUNT_MAX: u64 = 1 << 62;

/// JSON schema of [`FrameRecord`].
pub(super) const FRAME_SCHEMA: &str = include_str!("frame.schema.json");

/// JSON schema of [`RecordingEvent`].
pub(super) const EVENT_SCHEMA: &str = include_str!("event.schema.json");

/// Topic of what is known about a camera's frames.
pub(super) fn frame_topic(camera: &str) -> String {
    format!("/{camera}/frame")
}

/// Topic of a camera's pictures.
pub(super) fn image_topic(camera: &str) -> String {
    format!("/{camera}/image")
}

/// A pixel format in words.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct FormatRecord {
    format: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    matrix: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    range: Option<String>,
}

impl From<PixelFormat> for FormatRecord {
    fn from(format: PixelFormat) -> Self {
        let (name, ycbcr) = match format {
            PixelFormat::Rgb8 => ("rgb8", None),
            PixelFormat::Grey8 => ("grey8", None),
            PixelFormat::Yuyv(ycbcr) => ("yuyv", Some(ycbcr)),
            PixelFormat::Nv12(ycbcr) => ("nv12", Some(ycbcr)),
            PixelFormat::Mjpeg => ("mjpeg", None),
        };
        let matrix = |ycbcr: Ycbcr| match ycbcr.matrix {
            YcbcrMatrix::Bt601 => "bt601",
            YcbcrMatrix::Bt709 => "bt709",
        };
        let range = |ycbcr: Ycbcr| match ycbcr.range {
            YcbcrRange::Limited => "limited",
            YcbcrRange::Full => "full",
        };
        Self {
            format: name.to_owned(),
            matrix: ycbcr.map(|ycbcr| matrix(ycbcr).to_owned()),
            range: ycbcr.map(|ycbcr| range(ycbcr).to_owned()),
        }
    }
}

impl FormatRecord {
    /// The pixel format, if the words are known and complete.
    fn pixel_format(&self) -> Option<PixelFormat> {
        match self.format.as_str() {
            "rgb8" => Some(PixelFormat::Rgb8),
            "grey8" => Some(PixelFormat::Grey8),
            "mjpeg" => Some(PixelFormat::Mjpeg),
            "yuyv" => self.ycbcr().map(PixelFormat::Yuyv),
            "nv12" => self.ycbcr().map(PixelFormat::Nv12),
            _ => None,
        }
    }

    fn ycbcr(&self) -> Option<Ycbcr> {
        let matrix = match self.matrix.as_deref()? {
            "bt601" => YcbcrMatrix::Bt601,
            "bt709" => YcbcrMatrix::Bt709,
            _ => return None,
        };
        let range = match self.range.as_deref()? {
            "limited" => YcbcrRange::Limited,
            "full" => YcbcrRange::Full,
            _ => return None,
        };
        Some(Ycbcr { matrix, range })
    }
}

/// One message of a `/<camera>/frame` channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct FrameRecord {
    camera: String,
    sequence: u64,
    timestamp_ns: u64,
    exposure_s: f64,
    gain: f64,
    white_balance: [f64; 3],
    residual: [f64; 3],
    bracket_step: u32,
    lost_before: u32,
    flags: u32,
    width: u32,
    height: u32,
    #[serde(flatten)]
    format: FormatRecord,
}

impl FrameRecord {
    /// What is known about a frame.
    pub(super) fn new(meta: &FrameMeta, size: Size, format: PixelFormat) -> Self {
        Self {
            camera: meta.camera.to_string(),
            sequence: meta.sequence,
            timestamp_ns: meta.timestamp_ns,
            exposure_s: meta.exposure.time_s,
            gain: meta.exposure.gain,
            white_balance: meta.exposure.white_balance,
            residual: meta.residual,
            bracket_step: meta.bracket_step,
            lost_before: meta.lost_before,
            flags: meta.flags.0,
            width: size.width,
            height: size.height,
            format: format.into(),
        }
    }

    /// Reads a message and checks it against what the camera is known to send.
    ///
    /// # Errors
    ///
    /// What is wrong, in words.
    pub(super) fn parse(json: &[u8], camera: &CameraDescription) -> Result<FrameMeta, String> {
        let record: Self = serde_json::from_slice(json).map_err(|error| format!("its JSON is bad: {error}"))?;
        if record.camera != *camera.name {
            return Err(format!("it names camera `{}`", record.camera));
        }
        if record.sequence > COUNT_MAX || record.timestamp_ns > COUNT_MAX {
            return Err(format!("`sequence` and `timestamp_ns` must be in 0..={COUNT_MAX}"));
        }
        let is_positive = |value: &f64| value.is_finite() && *value > 0.0;
        let factors = [record.exposure_s, record.gain];
        let mut factors = factors.iter().chain(&record.white_balance).chain(&record.residual);
        if !factors.all(is_positive) {
            return Err("exposure, gain, white balance and residual must be above 0".to_owned());
        }
        let [width, height] = [camera.size.width, camera.size.height];
        let is_described =
            [record.width, record.height] == [width, height] && record.format.pixel_format() == Some(camera.format);
        if !is_described {
            return Err(format!(
                "it is {}×{} `{}`, the camera sends {width}×{height} `{}`",
                record.width,
                record.height,
                record.format.format,
                FormatRecord::from(camera.format).format
            ));
        }
        Ok(record.into_meta(camera.name.clone()))
    }

    fn into_meta(self, camera: Arc<str>) -> FrameMeta {
        FrameMeta {
            camera,
            sequence: self.sequence,
            timestamp_ns: self.timestamp_ns,
            exposure: Exposure {
                time_s: self.exposure_s,
                gain: self.gain,
                white_balance: self.white_balance,
            },
            residual: self.residual,
            bracket_step: self.bracket_step,
            lost_before: self.lost_before,
            flags: BufferFlags(self.flags),
        }
    }
}

/// Something that happened while a recording was made, other than a frame.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingEvent {
    /// When, on the cameras' clock, in nanoseconds.
    pub timestamp_ns: u64,
    /// Name of the camera it is about; none for all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// What happened.
    #[serde(flatten)]
    pub kind: EventKind,
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum EventKind {
    /// Frames of the camera are missing from here on.
    Lost {
        /// How many.
        frames: u64,
        /// Why, as one word: `recorder_full`, `driver`, ...
        cause: String,
    },
    /// Frame sets were published and never reached the program that records.
    MissedSets {
        /// How many.
        sets: u64,
    },
    /// A control of the camera was set.
    Control {
        /// Which one.
        control: String,
        /// The value, in the camera's own units.
        value: i64,
    },
    /// Anything else.
    Note {
        /// In words.
        text: String,
    },
}

/// Name of a role, as in the rig file.
pub(in crate::recording) fn role_name(role: CameraRole) -> &'static str {
    match role {
        CameraRole::Scene => "scene",
        CameraRole::Ball => "ball",
        CameraRole::Fisheye => "fisheye",
    }
}

/// Name of a pixel format.
pub(in crate::recording) fn format_name(format: PixelFormat) -> String {
    let record = FormatRecord::from(format);
    [Some(record.format), record.matrix, record.range]
        .into_iter()
        .flatten()
        .collect::<Vec<_>>()
        .join(" ")
}

/// What the channels of a camera say about it.
pub(super) fn channel_metadata(camera: &CameraDescription) -> BTreeMap<String, String> {
    let format = FormatRecord::from(camera.format);
    let mut metadata = BTreeMap::from([
        ("camera".to_owned(), camera.name.to_string()),
        ("role".to_owned(), role_name(camera.role).to_owned()),
        ("width".to_owned(), camera.size.width.to_string()),
        ("height".to_owned(), camera.size.height.to_string()),
        ("format".to_owned(), format.format),
    ]);
    metadata.extend(format.matrix.map(|matrix| ("matrix".to_owned(), matrix)));
    metadata.extend(format.range.map(|range| ("range".to_owned(), range)));
    metadata
}

/// Reads what a channel says about its camera.
///
/// # Errors
///
/// What is wrong, in words.
pub(super) fn camera_of_channel(metadata: &BTreeMap<String, String>) -> Result<CameraDescription, String> {
    let text = |key: &str| metadata.get(key).cloned().ok_or_else(|| format!("`{key}` is missing"));
    let side_px = |key: &str| {
        let side = text(key)?;
        let number = side.parse::<u32>().ok().filter(|side| (1..=SIDE_MAX_PX).contains(side));
        number.ok_or_else(|| format!("`{key}` is `{side}`, allowed is 1..={SIDE_MAX_PX}"))
    };
    let name = text("camera")?;
    if name.is_empty() || name.len() > NAME_MAX_BYTES {
        return Err(format!("`camera` is `{name}`, allowed are 1 to {NAME_MAX_BYTES} bytes"));
    }
    let role = match text("role")?.as_str() {
        "scene" => CameraRole::Scene,
        "ball" => CameraRole::Ball,
        "fisheye" => CameraRole::Fisheye,
        other => {
            return Err(format!(
                "`role` is `{other}`, allowed are `scene`, `ball` and `fisheye`"
            ));
        }
    };
    let format = FormatRecord {
        format: text("format")?,
        matrix: metadata.get("matrix").cloned(),
        range: metadata.get("range").cloned(),
    };
    let Some(pixel_format) = format.pixel_format() else {
        return Err(format!(
            "`format` is `{}`, which is unknown or incomplete",
            format.format
        ));
    };
    Ok(CameraDescription {
        name: name.into(),
        role,
        size: Size {
            width: side_px("width")?,
            height: side_px("height")?,
        },
        format: pixel_format,
    })
}

/// The metadata record of a file; `cameras` are those known when it is written.
pub(super) fn file_metadata(cameras: &[CameraDescription]) -> ::mcap::records::Metadata {
    let mut metadata = BTreeMap::from([
        ("format_version".to_owned(), FORMAT_VERSION.to_string()),
        (
            "program".to_owned(),
            concat!("mirrorball-capture ", env!("CARGO_PKG_VERSION")).to_owned(),
        ),
    ]);
    for camera in cameras {
        let words = format!(
            "{} {}x{} {}",
            role_name(camera.role),
            camera.size.width,
            camera.size.height,
            format_name(camera.format)
        );
        metadata.insert(format!("camera {}", camera.name), words);
    }
    ::mcap::records::Metadata {
        name: METADATA_NAME.to_owned(),
        metadata,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn our_schemas_are_json() {
        for schema in [FRAME_SCHEMA, EVENT_SCHEMA] {
            let schema: serde_json::Value = serde_json::from_str(schema).unwrap();
            assert_eq!(schema["type"], "object");
        }
    }

    #[test]
    fn the_frame_schema_names_every_field() {
        let exposure = Exposure {
            time_s: 0.01,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        let ycbcr = Ycbcr {
            matrix: YcbcrMatrix::Bt709,
            range: YcbcrRange::Full,
        };
        let size = Size { width: 2, height: 2 };
        let record = FrameRecord::new(
            &FrameMeta::new("a".into(), 1, 2, exposure),
            size,
            PixelFormat::Nv12(ycbcr),
        );
        let json = serde_json::to_value(record).unwrap();
        let schema: serde_json::Value = serde_json::from_str(FRAME_SCHEMA).unwrap();
        let fields: Vec<_> = json.as_object().unwrap().keys().collect();
        let described: Vec<_> = schema["properties"].as_object().unwrap().keys().collect();
        assert_eq!(fields, described);
    }

    #[test]
    fn events_are_flat_json() {
        let event = RecordingEvent {
            timestamp_ns: u64::MAX,
            camera: Some("scene".to_owned()),
            kind: EventKind::Lost {
                frames: 3,
                cause: "driver".to_owned(),
            },
        };
        let json = serde_json::to_string(&event).unwrap();
        assert_eq!(
            json,
            r#"{"timestamp_ns":18446744073709551615,"camera":"scene","kind":"lost","frames":3,"cause":"driver"}"#
        );
        assert_eq!(serde_json::from_str::<RecordingEvent>(&json).unwrap(), event);
    }
}
