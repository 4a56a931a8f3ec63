//! What the daemon asks of a camera, real or simulated.

use std::time::Duration;

use crate::controls::{ControlRanges, ControlValues};
use crate::frame::{PixelFormat, Size};
use crate::pool::Pool;
use crate::v4l2::{
    AutoMode, Camera, CameraAddress, ControlError, Negotiated, PowerLine, Stream, StreamError, StreamSettings, Taken,
    V4l2Controls, V4l2Error, Wish,
};

/// A place where a camera may be. It is asked again and again while there is none.
pub trait Device: Send {
    /// Opens the camera that is there now and agrees with it on a format.
    ///
    /// # Errors
    ///
    /// There is none, or it cannot be used now.
    fn open(&mut self) -> Result<Box<dyn OpenCamera>, V4l2Error>;
}

/// What the frames of an open camera are like.
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// Layout of the frames.
    pub format: PixelFormat,
    /// Width and height.
    pub size: Size,
    /// Nominal time between frames in nanoseconds, above 0.
    pub interval_ns: u64,
    /// Least length of the buffers that frames are written into.
    pub buffer_bytes: usize,
    /// The whole agreement in words.
    pub label: String,
}

/// A camera that can stream.
pub trait OpenCamera: Send {
    /// What its frames are like.
    fn mode(&self) -> Mode;

    /// Its controls, for another thread; none if it has none. They are dropped when the camera is closed.
    fn controls(&self) -> Option<Box<dyn Controls>>;

    /// Starts to stream into buffers of `pool`.
    ///
    /// # Errors
    ///
    /// [`StreamError`] if it cannot.
    fn start(&mut self, pool: &mut dyn Pool) -> Result<(), StreamError>;

    /// Waits up to `timeout` for what happens next.
    ///
    /// # Errors
    ///
    /// [`StreamError`] if the camera is gone, or stands still until it is restarted.
    fn next(&mut self, pool: &mut dyn Pool, timeout: Duration) -> Result<Taken, StreamError>;

    /// Stops and starts the stream.
    ///
    /// # Errors
    ///
    /// [`StreamError`] if it does not start again.
    fn restart(&mut self) -> Result<(), StreamError>;
}

/// The controls of an open camera.
pub trait Controls: Send {
    /// Controls it has, with their ranges.
    fn ranges(&self) -> ControlRanges;

    /// Switches automatic modes off; returns those that were on.
    ///
    /// # Errors
    ///
    /// [`ControlError`] if one stays on.
    fn take_manual(&self) -> Result<Vec<AutoMode>, ControlError>;

    /// Values now.
    ///
    /// # Errors
    ///
    /// [`ControlError`] if the camera does not answer.
    fn read(&self) -> Result<ControlValues, ControlError>;

    /// Sets values; returns what the camera has made of them.
    ///
    /// # Errors
    ///
    /// [`ControlError`] if it refuses.
    fn set(&self, wanted: &ControlValues) -> Result<ControlValues, ControlError>;
}

/// A V4L2 camera by its address.
#[derive(Debug, Clone)]
pub struct V4l2Device {
    /// Where it is.
    pub address: CameraAddress,
    /// What is wanted of it.
    pub wish: Wish,
    /// How its pictures get into memory.
    pub stream: StreamSettings,
    /// What its own control against flicker is set to.
    pub power_line: PowerLine,
}

impl Device for V4l2Device {
    fn open(&mut self) -> Result<Box<dyn OpenCamera>, V4l2Error> {
        let mut camera = Camera::open(&self.address)?;
        let negotiated = camera.negotiate(&self.wish)?;
        Ok(Box::new(OpenV4l2 {
            camera,
            negotiated,
            frames_per_s: self.wish.frames_per_s,
            settings: self.stream,
            power_line: self.power_line,
            stream: None,
        }))
    }
}

struct OpenV4l2 {
    /// Before the camera: the stream must end first.
    stream: Option<Stream>,
    camera: Camera,
    negotiated: Negotiated,
    frames_per_s: f64,
    settings: StreamSettings,
    power_line: PowerLine,
}

impl OpenCamera for OpenV4l2 {
    fn mode(&self) -> Mode {
        let frames_per_s = self.negotiated.frames_per_s().unwrap_or(self.frames_per_s);
        Mode {
            format: self.negotiated.format,
            size: self.negotiated.size,
            interval_ns: ((1e9 / frames_per_s).round() as u64).max(1),
            buffer_bytes: self.negotiated.buffer_bytes(),
            label: format!("{}: {}", self.camera.path().display(), self.negotiated),
        }
    }

    fn controls(&self) -> Option<Box<dyn Controls>> {
        Some(Box::new(ManualControls {
            controls: self.camera.controls(),
            power_line: self.power_line,
        }))
    }

    fn start(&mut self, pool: &mut dyn Pool) -> Result<(), StreamError> {
        self.stream = Some(self.camera.start(&self.negotiated, self.settings, pool)?);
        Ok(())
    }

    fn next(&mut self, pool: &mut dyn Pool, timeout: Duration) -> Result<Taken, StreamError> {
        match &mut self.stream {
            Some(stream) => stream.next(pool, timeout),
            None => Ok(Taken::TimedOut),
        }
    }

    fn restart(&mut self) -> Result<(), StreamError> {
        self.stream.as_mut().map_or(Ok(()), Stream::restart)
    }
}

struct ManualControls {
    controls: V4l2Controls,
    power_line: PowerLine,
}

impl Controls for ManualControls {
    fn ranges(&self) -> ControlRanges {
        *self.controls.ranges()
    }

    fn take_manual(&self) -> Result<Vec<AutoMode>, ControlError> {
        self.controls.take_manual(self.power_line)
    }

    fn read(&self) -> Result<ControlValues, ControlError> {
        self.controls.read()
    }

    fn set(&self, wanted: &ControlValues) -> Result<ControlValues, ControlError> {
        self.controls.set(wanted)
    }
}
