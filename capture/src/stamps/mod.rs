//! When each frame was taken, and what became of those that never came.
//!
//! Three things, none of which does I/O or looks at a clock:
//! - [`ClockMap`] maps a device's stamps to the host's monotonic clock;
//! - [`StampChecker`] turns what the driver says of one camera's buffers into rising sequence numbers and time stamps;
//! - [`LossLedger`] counts every frame that is missing, with its cause.
//!
//! For every buffer of a camera the daemon does this:
//!
//! ```text
//! a good buffer  -> checker.check()  -> Frame     -> ledger.delivered()  its result is the frame's `lost_before`
//!                                    -> BadStamp  -> ledger.lost(BadStamp)
//!                                    -> Duplicate -> ledger.duplicate()
//! a bad buffer   -> checker.place()                 -> ledger.lost(its cause)
//! stream begins anew  -> checker.begin_stream()   -> ledger.interrupted(StreamRestart or Unplugged)
//! ```

mod checker;
mod clock;
mod losses;
#[cfg(test)]
mod simulation;

pub use checker::{
    BufferStamp, Checked, CheckedStamp, SequenceEvent, StampBasis, StampChecker, StampCounters, StampDoubt, StampKind,
    StampPolicy, StampSettings,
};
pub use clock::{ClockMap, stamp_between};
pub use losses::{Interruption, LossCause, LossCounts, LossLedger};
