//! Pictures as Foxglove's messages: raw ones as `foxglove.RawImage`, MJPEG as `foxglove.CompressedImage`.

use bytes::Bytes;
use foxglove::messages::{CompressedImage, RawImage, Timestamp};
use foxglove::{Decode, Encode, Schema};

use crate::frame::{Frame, PixelFormat, Pixels};
use crate::source::CameraDescription;

/// Format of a JPEG picture in a `foxglove.CompressedImage`.
const JPEG: &str = "jpeg";

/// The schema that pictures of this format have.
pub(super) fn image_schema(format: PixelFormat) -> Schema {
    let schema = match format {
        PixelFormat::Mjpeg => CompressedImage::get_schema(),
        PixelFormat::Rgb8 | PixelFormat::Grey8 | PixelFormat::Yuyv(_) | PixelFormat::Nv12(_) => RawImage::get_schema(),
    };
    schema.expect("Foxglove's messages have schemas")
}

/// Writes a frame's picture as a message; `message` is emptied first.
pub(super) fn encode_image(frame: &Frame, message: &mut Vec<u8>) {
    message.clear();
    let timestamp = Some(timestamp(frame.meta.timestamp_ns));
    let frame_id = frame.meta.camera.to_string();
    let data = frame.pixels.shared_bytes();
    let written = match frame.format {
        PixelFormat::Mjpeg => {
            let format = JPEG.to_owned();
            CompressedImage {
                timestamp,
                frame_id,
                data,
                format,
            }
            .encode(message)
        }
        PixelFormat::Rgb8 | PixelFormat::Grey8 | PixelFormat::Yuyv(_) | PixelFormat::Nv12(_) => RawImage {
            timestamp,
            frame_id,
            width: frame.size.width,
            height: frame.size.height,
            encoding: encoding(frame.format).to_owned(),
            step: step_bytes(frame.format, frame.size.width),
            data,
        }
        .encode(message),
    };
    written.expect("a vector grows as needed");
}

/// Reads a message with a picture of `camera`; the pixels share the message's memory where they can.
///
/// # Errors
///
/// What is wrong, in words.
pub(super) fn decode_image(message: Bytes, camera: &CameraDescription) -> Result<Pixels, String> {
    let bad_message = |error| format!("its picture is no valid message: {error}");
    let data = if camera.format == PixelFormat::Mjpeg {
        let image = CompressedImage::decode(message).map_err(bad_message)?;
        if image.format != JPEG {
            return Err(format!("its picture is `{}`, the camera sends `{JPEG}`", image.format));
        }
        image.data
    } else {
        let image = RawImage::decode(message).map_err(bad_message)?;
        let expected = (
            camera.size.width,
            camera.size.height,
            step_bytes(camera.format, camera.size.width),
            encoding(camera.format),
        );
        let found = (image.width, image.height, image.step, image.encoding.as_str());
        if found != expected {
            return Err(format!(
                "its picture is {found:?}, the camera sends {expected:?} (width, height, step, encoding)"
            ));
        }
        image.data
    };
    if !camera.format.admits(camera.size, data.len()) {
        return Err(format!(
            "its picture has {} bytes, which does not fit its format and size",
            data.len()
        ));
    }
    Ok(Pixels::from_owner(data))
}

/// Foxglove's name of a format that is not compressed.
fn encoding(format: PixelFormat) -> &'static str {
    match format {
        PixelFormat::Rgb8 => "rgb8",
        PixelFormat::Grey8 => "mono8",
        PixelFormat::Yuyv(_) => "yuyv",
        PixelFormat::Nv12(_) => "nv12",
        PixelFormat::Mjpeg => JPEG,
    }
}

/// Bytes from one row to the next.
fn step_bytes(format: PixelFormat, width: u32) -> u32 {
    match format {
        PixelFormat::Rgb8 => width * 3,
        PixelFormat::Yuyv(_) => width * 2,
        PixelFormat::Grey8 | PixelFormat::Nv12(_) => width,
        PixelFormat::Mjpeg => 0,
    }
}

/// A time stamp for display; those beyond the year 2106 of Foxglove's clock stop there, ours stays in the frame's JSON.
fn timestamp(timestamp_ns: u64) -> Timestamp {
    let seconds = u32::try_from(timestamp_ns / 1_000_000_000).unwrap_or(u32::MAX);
    let rest_ns = u32::try_from(timestamp_ns % 1_000_000_000).expect("below a thousand million");
    Timestamp::new(seconds, rest_ns)
}
