//! The animated preview: all composites at the pace of the recording, as a GIF.

use crate::{ToolError, outputs::composite_path, picture, recording::RecordedFrame, sheet::reduce};
use image::{Delay, DynamicImage, Frame, codecs::gif};
use std::{fs::File, io::BufWriter, path::Path, time::Duration};

/// Widest preview in pixels.
const WIDTH_PX: u32 = 480;
/// Time a single frame is shown, when nothing says how long.
const SINGLE_FRAME: Duration = Duration::from_secs(1);
/// Longest time a frame is shown; a gap in a recording is no reason to stand still.
const LONGEST: Duration = Duration::from_secs(2);
/// Colour search of the encoder: 1 is the most careful, 30 the fastest.
const QUANTISER_SPEED: i32 = 5;

/// What was written.
#[derive(Clone, Copy, Debug)]
pub struct Preview {
    /// Number of frames.
    pub frames: usize,
    /// Width and height in pixels.
    pub size_px: [u32; 2],
    /// Time of one round.
    pub duration: Duration,
}

/// Writes the composites of these frames as an endless animation.
///
/// # Errors
/// When a composite is missing or cannot be decoded, or the file cannot be written or is no `.gif`.
pub fn write(path: &Path, output_folder: &Path, frames: &[RecordedFrame]) -> Result<Preview, ToolError> {
    if path.extension().is_none_or(|extension| extension != "gif") {
        return Err(ToolError::PreviewKind { path: path.to_owned() });
    }
    let unwritable = |source| ToolError::Unwritable {
        path: path.to_owned(),
        source,
    };
    let file = File::create(path).map_err(|error| unwritable(error.into()))?;
    let mut encoder = gif::GifEncoder::new_with_speed(BufWriter::new(file), QUANTISER_SPEED);
    encoder
        .set_repeat(gif::Repeat::Infinite)
        .map_err(|error| unwritable(error.into()))?;
    let delays = delays(frames);
    let mut size_px = [0, 0];
    for (frame, delay) in frames.iter().zip(&delays) {
        let role = format!("the composite of frame {}", frame.sequence);
        let composite = reduce(
            &picture::read_any(&composite_path(output_folder, frame.sequence), &role)?,
            WIDTH_PX,
        );
        size_px = [composite.width(), composite.height()];
        let buffer = DynamicImage::ImageRgb8(composite).into_rgba8();
        let frame = Frame::from_parts(buffer, 0, 0, Delay::from_saturating_duration(*delay));
        encoder.encode_frame(frame).map_err(|error| unwritable(error.into()))?;
    }
    Ok(Preview {
        frames: frames.len(),
        size_px,
        duration: delays.iter().sum(),
    })
}

/// Returns how long each frame is shown: until the next one, the last as long as the one before.
fn delays(frames: &[RecordedFrame]) -> Vec<Duration> {
    let gap = |pair: &[RecordedFrame]| Duration::from_nanos(pair[1].timestamp_ns.saturating_sub(pair[0].timestamp_ns));
    let mut delays: Vec<_> = frames.windows(2).map(|pair| gap(pair).min(LONGEST)).collect();
    delays.push(delays.last().copied().unwrap_or(SINGLE_FRAME));
    delays
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{AnimationDecoder as _, RgbImage};

    fn frame(sequence: u32, timestamp_ms: u64) -> RecordedFrame {
        RecordedFrame {
            sequence,
            timestamp_ns: timestamp_ms * 1_000_000,
            path: "unused".into(),
        }
    }

    #[test]
    fn the_preview_keeps_the_pace_of_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("composite")).unwrap();
        for sequence in [3, 4, 6] {
            RgbImage::new(960, 720)
                .save(composite_path(folder.path(), sequence))
                .unwrap();
        }
        let path = folder.path().join("preview.gif");
        let frames = [frame(3, 1000), frame(4, 1100), frame(6, 1300)];
        let preview = write(&path, folder.path(), &frames).unwrap();
        assert_eq!((preview.frames, preview.size_px), (3, [480, 360]));
        assert_eq!(preview.duration, Duration::from_millis(500));
        let reader = std::io::BufReader::new(File::open(&path).unwrap());
        let decoded = gif::GifDecoder::new(reader)
            .unwrap()
            .into_frames()
            .collect_frames()
            .unwrap();
        let delays: Vec<_> = decoded.iter().map(|frame| frame.delay().numer_denom_ms().0).collect();
        assert_eq!(delays, [100, 200, 200]);
    }

    #[test]
    fn another_kind_of_file_is_refused_before_anything_is_written() {
        let path = Path::new("preview.webm");
        assert!(matches!(
            write(path, Path::new("out"), &[frame(0, 0)]),
            Err(ToolError::PreviewKind { .. })
        ));
        assert!(!path.exists());
    }
}
