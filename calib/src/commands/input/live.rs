//! Pictures from a camera as it is now.

use std::{
    io,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use mirrorball_capture::{
    Exposure, Frame, FrameMeta, HeapPool, Size,
    controls::ControlKind,
    v4l2::{
        AutoMode, Camera, CameraAddress, FormatKind, Negotiated, Raw, Stream, StreamSettings, Taken, V4l2Controls,
        Watched, Wish,
    },
};

use super::{InputError, Picture, picture};

/// How long to wait for a frame before looking whether to end.
const TURN: Duration = Duration::from_millis(100);

/// A camera that sends nothing for so long is given up; exposures are shorter.
const SILENCE: Duration = Duration::from_secs(5);

/// Buffers for pictures: those that the driver fills, and two being looked at.
const EXTRA_BUFFERS: usize = 2;

/// Restarts of a stream that has failed, one after the other.
const MAX_RESTARTS: u32 = 3;

/// How a camera (`--device`) is to be looked at, and how long.
#[derive(Debug, Clone, clap::Args)]
#[group(skip)]
pub(crate) struct LiveArgs {
    /// Size of the camera's pictures: the one that it will be used with.
    #[arg(long, value_name = "WIDTHxHEIGHT", requires = "device", value_parser = size)]
    pub(crate) size: Option<Size>,
    /// Pictures per second.
    #[arg(long, value_name = "N", requires = "device", default_value_t = 30.0, value_parser = positive)]
    pub(crate) rate: f64,
    /// End after so many pictures.
    #[arg(long, value_name = "N", requires = "device")]
    pub(crate) frames: Option<u64>,
    /// End after so many seconds.
    #[arg(long, value_name = "S", requires = "device", value_parser = positive)]
    pub(crate) seconds: Option<f64>,
    /// Folder that the pictures which were used are saved to.
    #[arg(long, value_name = "DIR", requires = "device")]
    pub(crate) keep: Option<PathBuf>,
}

/// A camera that is sending.
pub(crate) struct Live {
    address: CameraAddress,
    negotiated: Negotiated,
    controls: V4l2Controls,
    stream: Stream,
    pool: HeapPool,
    /// Time in force, unless the camera sets it by itself.
    time_s: Option<f64>,
    stop: Arc<AtomicBool>,
    until: Option<Instant>,
    /// Pictures still to come.
    left: Option<u64>,
    last_frame: Instant,
    restarts: u32,
    lost: u64,
}

fn size(text: &str) -> Result<Size, String> {
    let allowed = "allowed is WIDTHxHEIGHT in pixels, such as 1280x720";
    let (width, height) = text.split_once(['x', '×']).ok_or(allowed)?;
    let side = |text: &str| {
        text.parse::<u32>()
            .ok()
            .filter(|side| (1..=16_384).contains(side))
            .ok_or(allowed)
    };
    Ok(Size {
        width: side(width)?,
        height: side(height)?,
    })
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text
        .parse::<f64>()
        .ok()
        .filter(|number| *number > 0.0 && *number <= 1e6);
    number.ok_or_else(|| "allowed is a number above 0, at most 1000000".to_owned())
}

impl LiveArgs {
    /// Opens the camera and lets it send.
    pub(super) fn open(&self, address: &CameraAddress) -> Result<Live, InputError> {
        let failed = |source| InputError::Camera {
            address: address.to_string(),
            source: Box::new(source),
        };
        let mut camera = Camera::open(address).map_err(failed)?;
        let wish = Wish {
            size: self.size.expect("`--device` demands `--size`"),
            frames_per_s: self.rate,
            // What is not compressed measures best.
            formats: FormatKind::ALL.to_vec(),
        };
        let negotiated = camera.negotiate(&wish).map_err(failed)?;
        let settings = StreamSettings::default();
        let n_buffers = settings.n_buffers as usize + EXTRA_BUFFERS;
        let mut pool = HeapPool::new(n_buffers, negotiated.buffer_bytes());
        let stream = camera.start(&negotiated, settings, &mut pool);
        let stream = stream.map_err(|source| stream_error(address, source))?;
        let mut live = Live {
            address: address.clone(),
            negotiated,
            controls: camera.controls(),
            stream,
            pool,
            time_s: None,
            stop: stop_on_signals()?,
            until: self
                .seconds
                .map(|seconds| Instant::now() + Duration::from_secs_f64(seconds)),
            left: self.frames,
            last_frame: Instant::now(),
            restarts: 0,
            lost: 0,
        };
        live.time_s = live.exposure_time_s();
        Ok(live)
    }
}

/// A flag that Ctrl-C raises. A second Ctrl-C ends the program at once.
fn stop_on_signals() -> Result<Arc<AtomicBool>, InputError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        // In this order: the first one raises the flag that the second one looks at.
        signal_hook::flag::register_conditional_shutdown(signal, 130, stop.clone()).map_err(InputError::Signals)?;
        signal_hook::flag::register(signal, stop.clone()).map_err(InputError::Signals)?;
    }
    Ok(stop)
}

impl Live {
    /// How many pictures there will be, where that is known.
    pub(super) fn expected(&self) -> Option<usize> {
        self.left.and_then(|left| usize::try_from(left).ok())
    }

    /// The next picture; none when enough have come or a person has ended it.
    pub(super) fn next(&mut self) -> Option<Result<Picture, InputError>> {
        loop {
            // Relaxed: the flag guards no other data.
            let is_over = self.stop.load(Ordering::Relaxed)
                || self.left == Some(0)
                || self.until.is_some_and(|until| Instant::now() >= until);
            if is_over {
                self.say_losses();
                return None;
            }
            match self.stream.next(&mut self.pool, TURN) {
                Ok(Taken::Frame(raw)) => {
                    self.last_frame = Instant::now();
                    self.restarts = 0;
                    self.left = self.left.map(|left| left - 1);
                    return Some(self.picture(raw));
                }
                Ok(Taken::TimedOut) if self.last_frame.elapsed() > SILENCE => {
                    let address = self.address.to_string();
                    return Some(Err(InputError::Silent { address }));
                }
                Ok(Taken::TimedOut) => {}
                Ok(Taken::Lost(_)) => self.lost += 1,
                Ok(Taken::ControlChanged(change)) => match change.what {
                    Watched::Control(_) | Watched::Auto(_) => self.time_s = self.exposure_time_s(),
                },
                Err(error) if error.is_restartable() && self.restarts < MAX_RESTARTS => {
                    self.restarts += 1;
                    if let Err(source) = self.stream.restart() {
                        return Some(Err(stream_error(&self.address, source)));
                    }
                }
                Err(source) => return Some(Err(stream_error(&self.address, source))),
            }
        }
    }

    fn picture(&self, raw: Raw) -> Result<Picture, InputError> {
        let exposure = Exposure {
            time_s: self.time_s.unwrap_or(1.0),
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        let camera = self.address.to_string();
        let sequence = u64::from(raw.sequence);
        let frame = Frame {
            meta: FrameMeta::new(camera.as_str().into(), sequence, raw.timestamp_ns, exposure),
            size: self.negotiated.size,
            format: self.negotiated.format,
            pixels: raw.pixels,
        };
        Ok(Picture {
            name: format!("{sequence:06}"),
            // Of the gain only the driver's own number is known, so that of two exposures only the times compare.
            exposure: self.time_s.map(|_| exposure),
            ..picture(&frame)?
        })
    }

    /// The time that the driver says it exposes for; `None` when the camera changes it by itself or does not say.
    fn exposure_time_s(&self) -> Option<f64> {
        let is_automatic = self.controls.modes_on().ok()?.contains(&AutoMode::Exposure);
        let value = self.controls.read().ok()?.get(ControlKind::ExposureTime)?;
        let time_s = value as f64 * self.controls.exposure_unit_s()?;
        (!is_automatic && time_s > 0.0).then_some(time_s)
    }

    /// A lost picture is told once, at the end.
    fn say_losses(&mut self) {
        if self.lost > 0 {
            tracing::warn!("camera `{}`: {} pictures were lost", self.address, self.lost);
            self.lost = 0;
        }
    }
}

fn stream_error(address: &CameraAddress, source: mirrorball_capture::v4l2::StreamError) -> InputError {
    InputError::Stream {
        address: address.to_string(),
        source: Box::new(source),
    }
}

/// Why a picture cannot be kept.
pub(super) fn keep_error(file: PathBuf) -> impl FnOnce(image::ImageError) -> InputError {
    move |source| InputError::Keep {
        file,
        source: io::Error::other(source),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_two_numbers() {
        let found = size("1280x720");
        let expected = Size {
            width: 1280,
            height: 720,
        };
        assert_eq!(found, Ok(expected));
        for text in ["", "1280", "0x3", "1280x", "x", "-1x2", "99999x2"] {
            assert!(size(text).unwrap_err().contains("WIDTHxHEIGHT"), "{text}");
        }
        for text in ["0", "-1", "nan", "inf", "x"] {
            assert!(positive(text).is_err(), "{text}");
        }
    }
}
