//! What can go wrong with a simulated webcam, at the test's command.

use std::collections::VecDeque;

/// Something that happens to one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameFault {
    /// The packets have the error bit (UVC 1.1, 2.4.3.2.2).
    ErrorBit,
    /// Half of the picture is missing, and the end of the frame comes early; for MJPEG a picture cut off.
    Short,
    /// A transfer fails with `-EPROTO`. The driver then answers with empty buffers until the stream is restarted.
    TransferError,
    /// The sensor loses the frame: nothing is sent and no number of the driver's shows a gap.
    LostInSensor,
}

/// Faults to come and faults that last.
#[derive(Clone, Debug)]
pub struct Faults {
    frames: VecDeque<FrameFault>,
    /// Whether the webcam sends nothing at all.
    pub hangs: bool,
    /// By what the frame interval is longer than agreed; 1 for none.
    pub slowness: f64,
}

impl Default for Faults {
    fn default() -> Self {
        Self {
            frames: VecDeque::new(),
            hangs: false,
            slowness: 1.0,
        }
    }
}

impl Faults {
    /// Lets a fault befall the next `n_frames` frames that have none yet.
    pub fn befall(&mut self, fault: FrameFault, n_frames: usize) {
        self.frames.extend(std::iter::repeat_n(fault, n_frames));
    }

    /// The fault of the frame that begins now.
    pub fn next_frame(&mut self) -> Option<FrameFault> {
        self.frames.pop_front()
    }
}
