//! What the cases have in common: a webcam with a reader on it, and pictures measured.

use std::fmt::Display;
use std::fs;
use std::time::Duration;

use image::RgbImage;
use mirrorball_driver_tests::raw_camera::{RawCamera, RawFrame};
use mirrorball_driver_tests::webcam::counter;
use mirrorball_driver_tests::webcam::jpeg::commented_counter;
use mirrorball_driver_tests::webcam::truth::FrameTruth;
use mirrorball_driver_tests::webcam::{Webcam, WebcamConfig};

/// How long a frame or a node may take on a busy machine before something is wrong.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);
/// How long nothing must come for a stream to count as standing still.
pub(super) const SILENCE: Duration = Duration::from_millis(400);

pub(super) const YUYV: [u8; 4] = *b"YUYV";
pub(super) const MJPEG: [u8; 4] = *b"MJPG";

/// Error numbers of Linux that the cases expect.
pub(super) mod errno {
    pub(in crate::cases) const EIO: i32 = 5;
    pub(in crate::cases) const EINVAL: i32 = 22;
    pub(in crate::cases) const ENODEV: i32 = 19;
}

/// An error as a case reports it.
pub(super) fn say(error: impl Display) -> String {
    error.to_string()
}

/// Fails with `message` unless `holds`.
pub(super) fn ensure(holds: bool, message: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(message()) }
}

/// A simulated webcam and the camera that the kernel makes of it.
pub(super) struct Bench {
    pub(super) webcam: Webcam,
    pub(super) camera: RawCamera,
    pub(super) size: (u32, u32),
    fourcc: [u8; 4],
}

/// A frame with what the webcam knows about it.
pub(super) struct Known {
    pub(super) frame: RawFrame,
    pub(super) truth: FrameTruth,
}

impl Bench {
    /// Plugs a webcam in and opens it, not streaming yet.
    pub(super) fn open(port: u8, config: WebcamConfig, size: (u32, u32), fourcc: [u8; 4]) -> Result<Self, String> {
        let webcam = Webcam::plug(port, config).map_err(say)?;
        let camera = open(&webcam, size, fourcc)?;
        Ok(Self {
            webcam,
            camera,
            size,
            fourcc,
        })
    }

    /// A webcam of 320 × 240 YUYV with default sensor, streaming at 30 frames a second.
    pub(super) fn streaming() -> Result<Self, String> {
        let mut bench = Self::open(0, WebcamConfig::named("Webcam"), (320, 240), YUYV)?;
        bench.start()?;
        Ok(bench)
    }

    /// Opens the camera anew, after a replug.
    pub(super) fn reopen(&mut self) -> Result<(), String> {
        self.camera = open(&self.webcam, self.size, self.fourcc)?;
        Ok(())
    }

    pub(super) fn start(&mut self) -> Result<(), String> {
        self.camera.start(4).map_err(say)
    }

    /// The next frame.
    pub(super) fn frame(&mut self) -> Result<RawFrame, String> {
        self.camera
            .next_frame(PATIENCE)
            .map_err(say)?
            .ok_or_else(|| format!("no frame within {PATIENCE:?}"))
    }

    /// The next frame, and the truth about it.
    pub(super) fn known(&mut self) -> Result<Known, String> {
        let frame = self.frame()?;
        let shown = self.counter_of(&frame).ok_or("the picture shows no frame counter")?;
        let truth = self
            .webcam
            .truth_of(shown)
            .ok_or_else(|| format!("no frame {shown} was taken"))?;
        Ok(Known { frame, truth })
    }

    pub(super) fn known_frames(&mut self, n_frames: usize) -> Result<Vec<Known>, String> {
        (0..n_frames).map(|_| self.known()).collect()
    }

    /// Reads on until a frame satisfies `wanted`, for at most 100 frames.
    pub(super) fn frame_where(&mut self, wanted: impl Fn(&RawFrame) -> bool) -> Result<RawFrame, String> {
        for _ in 0..100 {
            let frame = self.frame()?;
            if wanted(&frame) {
                return Ok(frame);
            }
        }
        Err("100 frames came, but none as expected".to_owned())
    }

    /// Decoding every JPEG would take longer than a frame lasts under emulation.
    fn counter_of(&self, frame: &RawFrame) -> Option<u16> {
        if self.fourcc == YUYV {
            counter::read_yuyv(&frame.bytes, self.size.0 as usize)
        } else {
            commented_counter(&frame.bytes).map(|counter| (counter & 0xFFFF) as u16)
        }
    }
}

fn open(webcam: &Webcam, size: (u32, u32), fourcc: [u8; 4]) -> Result<RawCamera, String> {
    let node = webcam.node(PATIENCE).map_err(say)?;
    let camera = RawCamera::open(&node).map_err(|error| format!("cannot open {}: {error}", node.display()))?;
    let chosen = camera.set_format(size, fourcc).map_err(say)?;
    ensure(chosen == (size, fourcc), || {
        format!("asked for {size:?} {fourcc:?}, the driver chose {chosen:?}")
    })?;
    camera.set_rate(30).map_err(say)?;
    Ok(camera)
}

/// Mean Y, U, V of the middle of the right bottom patch of the chart (grey card).
pub(super) fn grey_card_yuv(frame: &RawFrame, (width, height): (u32, u32)) -> [f64; 3] {
    let (width, height) = (width as usize, height as usize);
    let mut sums = [0.0; 3];
    let mut n_pairs = 0.0;
    for y in height * 3 / 4..height * 15 / 16 {
        for pair in width * 13 / 32..width * 15 / 32 {
            let at = (y * width + 2 * pair) * 2;
            let [y0, u, y1, v] = frame.bytes[at..at + 4] else {
                unreachable!("a slice of four bytes")
            };
            sums[0] += f64::from(y0) / 2.0 + f64::from(y1) / 2.0;
            sums[1] += f64::from(u);
            sums[2] += f64::from(v);
            n_pairs += 1.0;
        }
    }
    sums.map(|sum| sum / n_pairs)
}

/// Frames of the driver's that are missing between these, by its sequence.
pub(super) fn sequence_gaps(frames: &[Known]) -> u32 {
    frames
        .windows(2)
        .map(|pair| pair[1].frame.sequence - pair[0].frame.sequence - 1)
        .sum()
}

/// Frames of the sensor's that are missing between these, by the counter in the picture.
pub(super) fn counter_gaps(frames: &[Known]) -> u64 {
    frames
        .windows(2)
        .map(|pair| pair[1].truth.counter - pair[0].truth.counter - 1)
        .sum()
}

/// Whether the driver drops damaged frames by itself (0) or hands them out with a flag (1).
pub(super) fn set_nodrop(nodrop: bool) -> Result<(), String> {
    let value = if nodrop { "1" } else { "0" };
    fs::write("/sys/module/uvcvideo/parameters/nodrop", value).map_err(say)
}

/// A picture as from a recording, to play as a scene: red rises to the right, green downwards.
pub(super) fn test_picture() -> RgbImage {
    RgbImage::from_fn(320, 240, |x, y| {
        image::Rgb([(x * 255 / 319) as u8, (y * 255 / 239) as u8, 90])
    })
}
