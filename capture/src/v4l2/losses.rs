//! Which buffers are frames, and how many frames the driver dropped between them: pure book-keeping.

/// The driver could not fill the buffer properly: `V4L2_BUF_FLAG_ERROR`.
const FLAG_ERROR: u32 = 0x40;

/// Why there is no frame where one should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LossCause {
    /// The driver flagged the buffer: data lost or torn on the way.
    ErrorFlag,
    /// Fewer bytes than a picture of an uncompressed format has.
    Short {
        /// Bytes that came.
        found: u32,
        /// Bytes of a picture.
        needed: u32,
    },
    /// More bytes than a picture of the format may have.
    Long {
        /// Bytes that came.
        found: u32,
        /// Most bytes of a picture.
        allowed: u32,
    },
    /// No bytes at all.
    Empty,
    /// A good frame, but no free buffer in the pool to take it.
    Overrun,
}

/// A buffer that came back without becoming a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Loss {
    /// Why.
    pub cause: LossCause,
    /// The driver's count; none if the driver gave the buffer none.
    pub sequence: Option<u32>,
    /// Numbers that the driver left out between the buffer before and this one: frames it dropped.
    pub dropped_before: u32,
    /// When the buffer was taken back, in nanoseconds since boot.
    pub dequeued_ns: u64,
}

/// How many bytes a picture may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Length {
    /// At least as many; the driver may pad.
    Raw(u32),
    /// From 1 to as many.
    Compressed(u32),
}

/// What a buffer turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Verdict {
    /// Why it is no frame, if it is none.
    pub(super) cause: Option<LossCause>,
    /// The driver's count, if it can be believed.
    pub(super) sequence: Option<u32>,
    /// Numbers left out before.
    pub(super) dropped_before: u32,
}

/// Follows the driver's count through one stream.
#[derive(Debug, Clone, Copy)]
pub(super) struct Accounts {
    length: Length,
    next_sequence: Option<u32>,
    losses_in_a_row: u32,
    n_empty: u32,
}

impl Accounts {
    pub(super) fn new(length: Length) -> Self {
        Self {
            length,
            next_sequence: None,
            losses_in_a_row: 0,
            n_empty: 0,
        }
    }

    /// Judges the next buffer by its flags, its length and its number, which wraps at 2³².
    pub(super) fn judge(&mut self, flags: u32, bytes_used: u32, sequence: u32) -> Verdict {
        let cause = self.cause(flags, bytes_used);
        self.losses_in_a_row = if cause.is_some() {
            self.losses_in_a_row.saturating_add(1)
        } else {
            0
        };
        self.n_empty = self.n_empty.saturating_add(u32::from(cause == Some(LossCause::Empty)));
        let ahead = self.next_sequence.map_or(0, |next| sequence.wrapping_sub(next));
        // Buffers that a failing USB transfer gives back carry no number, or that of a frame long past.
        if bytes_used == 0 && ahead != 0 {
            return Verdict {
                cause,
                sequence: None,
                dropped_before: 0,
            };
        }
        self.next_sequence = Some(sequence.wrapping_add(1));
        // A step back is a driver that counts anew; it says nothing of dropped frames.
        let dropped_before = if ahead < 1 << 31 { ahead } else { 0 };
        Verdict {
            cause,
            sequence: Some(sequence),
            dropped_before,
        }
    }

    /// Losses since the last good buffer.
    pub(super) fn losses_in_a_row(&self) -> u32 {
        self.losses_in_a_row
    }

    /// Empty buffers since the stream started. Each lot of them is a USB transfer that failed, of the few that
    /// uvcvideo keeps under way and does not replace (`uvc_video_complete`): when the last has failed, nothing comes.
    pub(super) fn n_empty(&self) -> u32 {
        self.n_empty
    }

    /// A new stream on the same device: the driver counts from wherever it likes.
    pub(super) fn restart(&mut self) {
        *self = Self::new(self.length);
    }

    fn cause(&self, flags: u32, bytes_used: u32) -> Option<LossCause> {
        if bytes_used == 0 {
            return Some(LossCause::Empty);
        }
        if flags & FLAG_ERROR != 0 {
            return Some(LossCause::ErrorFlag);
        }
        match self.length {
            Length::Raw(needed) if bytes_used < needed => Some(LossCause::Short {
                found: bytes_used,
                needed,
            }),
            Length::Compressed(allowed) if bytes_used > allowed => Some(LossCause::Long {
                found: bytes_used,
                allowed,
            }),
            Length::Raw(_) | Length::Compressed(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const NEEDED: u32 = 100;

    fn accounts() -> Accounts {
        Accounts::new(Length::Raw(NEEDED))
    }

    #[test]
    fn causes() {
        let mut accounts = accounts();
        assert_eq!(accounts.judge(0x2001, NEEDED, 0).cause, None);
        assert_eq!(accounts.judge(0x2041, NEEDED, 1).cause, Some(LossCause::ErrorFlag));
        assert_eq!(
            accounts.judge(0, 99, 2).cause,
            Some(LossCause::Short {
                found: 99,
                needed: NEEDED
            })
        );
        assert_eq!(accounts.judge(0x40, 0, 3).cause, Some(LossCause::Empty));
        assert_eq!(accounts.losses_in_a_row(), 3);
        assert_eq!(accounts.judge(0, NEEDED + 8, 4).cause, None);
        assert_eq!(accounts.losses_in_a_row(), 0);
        let mut compressed = Accounts::new(Length::Compressed(NEEDED));
        assert_eq!(compressed.judge(0, 1, 0).cause, None);
        assert_eq!(
            compressed.judge(0, 101, 1).cause,
            Some(LossCause::Long {
                found: 101,
                allowed: NEEDED
            })
        );
    }

    #[test]
    fn buffers_of_a_failed_transfer_do_not_disturb_the_count() {
        let mut accounts = accounts();
        accounts.judge(0, NEEDED, 41);
        let lost = accounts.judge(0x40, 0, 0);
        assert_eq!((lost.sequence, lost.dropped_before), (None, 0));
        assert_eq!(accounts.judge(0, NEEDED, 43).dropped_before, 1);
    }

    #[test]
    fn a_restarted_count_is_no_gap() {
        let mut accounts = accounts();
        accounts.judge(0, NEEDED, 1000);
        assert_eq!(accounts.judge(0, NEEDED, 0).dropped_before, 0);
        accounts.restart();
        assert_eq!(accounts.judge(0, NEEDED, 7).dropped_before, 0);
    }

    proptest! {
        /// Whatever the driver leaves out and flags, frames, losses and drops add up, also across the wrap at 2³².
        #[test]
        fn everything_is_counted(first: u32, fates in prop::collection::vec(0..4u8, 1..300)) {
            let mut accounts = accounts();
            let (mut n_seen, mut n_dropped, mut n_leading) = (0u32, 0u32, 0u32);
            for (number, fate) in (0u32..).zip(&fates) {
                let sequence = first.wrapping_add(number);
                match fate {
                    0 if n_seen == 0 => n_leading += 1,
                    0 => {}
                    fate => {
                        let flags = if *fate == 1 { FLAG_ERROR } else { 0 };
                        let verdict = accounts.judge(flags, NEEDED, sequence);
                        prop_assert_eq!(verdict.cause.is_some(), *fate == 1);
                        prop_assert_eq!(verdict.sequence, Some(sequence));
                        n_dropped += verdict.dropped_before;
                        n_seen += 1;
                    }
                }
            }
            let n_trailing = fates.iter().rev().take_while(|fate| **fate == 0).count() as u32;
            if n_seen > 0 {
                prop_assert_eq!(n_seen + n_dropped + n_leading + n_trailing, fates.len() as u32);
            }
        }
    }
}
