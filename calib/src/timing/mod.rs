//! Time between two cameras' clocks, and between an event and its picture on a display.
//!
//! # Convention
//! A frame's **stamp** marks the start, the middle or the end of its exposure ([`Stamp`]; the two cameras may differ); from it
//! and the exposure time the *instant* of what the frame shows is found on that camera's clock. The **offset** is `t_b - t_a`
//! for one and the same event: where camera A's clock says `t_a`, camera B's says `t_a + offset`. The **drift** is how much
//! the offset grows per second of A. A rolling shutter is not modelled: rows lower in the picture are later, so keep the
//! light at the same height in both pictures or add the difference.
//!
//! - [`blink`] finds when a light went on and off: a frame that was exposed while it changed is lit for a fraction of its
//!   exposure and tells the instant to a fraction of a millisecond; where it changed between exposures only the gap is
//!   known. [`align`] combines edges of both kinds from two cameras by their likelihood.
//!   How sure that is depends on how many changes fall into exposures: the offset is good to half a millisecond where its
//!   standard deviation is below a quarter of one, and that is told. The light must blink irregularly, 6 times a second or so. In
//!   90 s, simulated (`cargo test --test timing irregular`), exposures of half of the frame interval give 0.02 ms; 2 ms at 60 Hz
//!   0.1 to 0.25 ms; 2 ms at 30 Hz, of which a camera spends 6 % exposing, 0.2 to 0.6 ms, with errors up to 0.8 ms: two
//!   cameras in step then see most changes in the same gaps, which tell nothing however they are combined. Expose for a
//!   quarter of the frame interval or more in at least one camera, and for half of it in both if that does not saturate.
//! - [`motion`] compares the paths of a marker through two pictures.
//! - [`latency`] compares an event with its picture on a display, both seen by one camera.

pub mod align;
pub mod blink;
pub mod latency;
pub mod motion;

/// What of an exposure a time stamp marks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Stamp {
    /// Its start.
    #[default]
    Start,
    /// Its middle.
    Middle,
    /// Its end.
    End,
}

/// A frame's value and when it was exposed, on its camera's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Start of the exposure, seconds.
    pub start_s: f64,
    /// Length of the exposure, seconds, above 0.
    pub exposure_s: f64,
    /// Mean linear light of a region.
    pub value: f64,
}

impl Stamp {
    /// Start of an exposure with this stamp and length, seconds.
    #[must_use]
    pub fn start_s(self, stamp_s: f64, exposure_s: f64) -> f64 {
        match self {
            Self::Start => stamp_s,
            Self::Middle => stamp_s - 0.5 * exposure_s,
            Self::End => stamp_s - exposure_s,
        }
    }
}

/// Offset and drift of a clock B against a clock A.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockOffset {
    /// `t_b - t_a` of one event at [`Self::at_s`], seconds.
    pub offset_s: f64,
    /// Its standard deviation, seconds.
    pub offset_sigma_s: f64,
    /// Growth of the offset per second.
    pub drift: f64,
    /// Its standard deviation.
    pub drift_sigma: f64,
    /// Time on A's clock for which the offset holds: the middle of what both saw, seconds.
    pub at_s: f64,
    /// Edges or pictures that were compared.
    pub n_used: usize,
    /// Share of those that could be compared and agree.
    pub agreeing: f64,
}

/// Why times cannot be told.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TimingError {
    /// The light does not change, or hardly.
    #[error(
        "nothing blinks in the pictures of `{camera}`: light and dark are `{contrast_sigmas:.1}` standard deviations apart (allowed: 8 or more)"
    )]
    NothingBlinks {
        /// The camera, or the region.
        camera: String,
        /// Contrast over noise.
        contrast_sigmas: f64,
    },
    /// The light is too bright for the exposure.
    #[error(
        "what blinks in the pictures of `{camera}` is saturated, so that a part of an exposure cannot be told from all of it"
    )]
    Saturated {
        /// The camera, or the region.
        camera: String,
    },
    /// It blinks too rarely, or too fast for the frame rate.
    #[error("the light was seen to go on or off `{n_edges}` times by `{camera}` (allowed: {MIN_EDGES} or more)")]
    TooFewEdges {
        /// The camera, or the region.
        camera: String,
        /// Edges found.
        n_edges: usize,
    },
    /// More than one offset fits.
    #[error(
        "the signal repeats: offsets of `{:.1} ms` and `{:.1} ms` fit alike, so that the offset is known only modulo `{:.1} ms`",
        1e3 * offset_s, 1e3 * other_s, 1e3 * (offset_s - other_s).abs()
    )]
    Ambiguous {
        /// An offset that fits, seconds.
        offset_s: f64,
        /// Another one.
        other_s: f64,
    },
    /// No offset fits.
    #[error("the two signals agree on no offset: at the best one `{:.0} %` of them fit (allowed: 60 % or more)", 100.0 * share)]
    NoAgreement {
        /// Share that fits.
        share: f64,
    },
    /// The solve goes on for ever.
    #[error("the solve for the offset does not converge")]
    NotConverged,
    /// The marker stands still.
    #[error("the marker moves by `{spread_px:.1}` pixels in the pictures of `{camera}` (allowed: 5 or more)")]
    NothingMoves {
        /// The camera.
        camera: String,
        /// Standard deviation of its place.
        spread_px: f64,
    },
    /// Too few pictures show the marker.
    #[error("`{n}` pictures can be compared (allowed: {MIN_PICTURES} or more)")]
    TooFewPictures {
        /// How many.
        n: usize,
    },
}

/// Fewest edges of a signal.
pub const MIN_EDGES: usize = 6;
/// Fewest pictures of a moving marker that both cameras must have.
pub const MIN_PICTURES: usize = 40;

/// The upper median; 0 of nothing.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
