//! Which format, size and rate to take: a wish against what a camera offers, and the reasons in words.

use std::fmt;

use crate::frame::{PixelFormat, Size};

/// Formats that can be asked of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FormatKind {
    /// Two bytes per pixel, colour at half the width.
    Yuyv,
    /// One and a half bytes per pixel, colour at half the width and height.
    Nv12,
    /// One byte per pixel, no colour.
    Grey,
    /// JPEG pictures.
    Mjpeg,
}

impl FormatKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Yuyv, Self::Nv12, Self::Grey, Self::Mjpeg];

    /// The kernel's code.
    #[must_use]
    pub fn fourcc(self) -> [u8; 4] {
        *match self {
            Self::Yuyv => b"YUYV",
            Self::Nv12 => b"NV12",
            Self::Grey => b"GREY",
            Self::Mjpeg => b"MJPG",
        }
    }

    /// The format with this code, if it is one of ours.
    #[must_use]
    pub fn from_fourcc(fourcc: [u8; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.fourcc() == fourcc)
    }

    /// Bytes of a picture without padding; none for JPEG.
    #[must_use]
    pub fn raw_bytes(self, size: Size) -> Option<usize> {
        let rows = self.rows(size)?;
        Some(rows * self.row_bytes(size)?)
    }

    /// Bytes of one row without padding; none for JPEG.
    pub(super) fn row_bytes(self, size: Size) -> Option<usize> {
        match self {
            Self::Yuyv => Some(size.width as usize * 2),
            Self::Nv12 | Self::Grey => Some(size.width as usize),
            Self::Mjpeg => None,
        }
    }

    /// Rows of all planes together, which have the same length; none for JPEG.
    pub(super) fn rows(self, size: Size) -> Option<usize> {
        match self {
            Self::Yuyv | Self::Grey => Some(size.height as usize),
            Self::Nv12 => Some(size.height as usize / 2 * 3),
            Self::Mjpeg => None,
        }
    }

    /// True if pictures of this format can have this size.
    fn admits(self, size: Size) -> bool {
        let is_even = |side: u32| side.is_multiple_of(2);
        match self {
            Self::Yuyv => is_even(size.width),
            Self::Nv12 => is_even(size.width) && is_even(size.height),
            Self::Grey | Self::Mjpeg => true,
        }
    }
}

impl fmt::Display for FormatKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Yuyv => "YUYV",
            Self::Nv12 => "NV12",
            Self::Grey => "GREY",
            Self::Mjpeg => "MJPEG",
        })
    }
}

/// A time between frames: `numerator / denominator` seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interval {
    /// Above the line.
    pub numerator: u32,
    /// Below the line.
    pub denominator: u32,
}

impl Interval {
    /// Length in seconds; infinite for a denominator of 0.
    #[must_use]
    pub fn seconds(self) -> f64 {
        f64::from(self.numerator) / f64::from(self.denominator)
    }

    /// Frames per second; infinite for a numerator of 0.
    #[must_use]
    pub fn frames_per_s(self) -> f64 {
        f64::from(self.denominator) / f64::from(self.numerator)
    }
}

/// Times between frames that a camera offers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Intervals {
    /// The camera does not say.
    Unknown,
    /// One of these.
    Discrete(Vec<Interval>),
    /// Any from the first to the second, or in steps between them.
    Between(Interval, Interval),
}

impl Intervals {
    /// The offered interval nearest to one of `seconds`; none if the camera does not say.
    #[must_use]
    pub fn nearest(&self, seconds: f64) -> Option<Interval> {
        match self {
            Self::Unknown => None,
            Self::Discrete(all) => all
                .iter()
                .copied()
                .filter(|interval| interval.numerator > 0 && interval.denominator > 0)
                .min_by(|a, b| (a.seconds() - seconds).abs().total_cmp(&(b.seconds() - seconds).abs())),
            Self::Between(shortest, _) if seconds <= shortest.seconds() => Some(*shortest),
            Self::Between(_, longest) if seconds >= longest.seconds() => Some(*longest),
            Self::Between(..) => Some(Interval::of_seconds(seconds)),
        }
    }
}

impl Interval {
    /// The interval of this length, to the nearest 100 ns, which is UVC's unit.
    #[must_use]
    pub fn of_seconds(seconds: f64) -> Self {
        const UNITS_PER_S: u32 = 10_000_000;
        // A saturating conversion; 0 would be no interval.
        let numerator = ((seconds * f64::from(UNITS_PER_S)).round() as u32).max(1);
        Self {
            numerator,
            denominator: UNITS_PER_S,
        }
    }
}

/// A size that a camera offers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Sizes {
    /// Exactly this one.
    Discrete(Size),
    /// From `least` to `most` in steps.
    Stepwise {
        /// Least width and height.
        least: Size,
        /// Greatest width and height.
        most: Size,
        /// Steps of width and height.
        step: Size,
    },
}

impl Sizes {
    /// True if the size is among them.
    #[must_use]
    pub fn contain(&self, size: Size) -> bool {
        match self {
            Self::Discrete(offered) => *offered == size,
            Self::Stepwise { least, most, step } => {
                let is_step = |value: u32, least: u32, most: u32, step: u32| {
                    (least..=most).contains(&value) && (value - least).is_multiple_of(step.max(1))
                };
                is_step(size.width, least.width, most.width, step.width)
                    && is_step(size.height, least.height, most.height, step.height)
            }
        }
    }
}

/// A size with the rates it comes at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SizeOffer {
    /// Sizes.
    pub sizes: Sizes,
    /// Times between frames; for a range of sizes those of the greatest.
    pub intervals: Intervals,
}

/// A format with its sizes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FormatOffer {
    /// The kernel's code.
    pub fourcc: [u8; 4],
    /// The driver's name for it.
    pub name: String,
    /// Sizes and rates.
    pub sizes: Vec<SizeOffer>,
}

impl FormatOffer {
    /// The code as text.
    #[must_use]
    pub fn code(&self) -> String {
        String::from_utf8_lossy(&self.fourcc).trim_end().to_owned()
    }
}

/// What is wanted of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Wish {
    /// Width and height, taken exactly.
    pub size: Size,
    /// Frames per second, above 0; the nearest rate is taken.
    pub frames_per_s: f64,
    /// Formats, the most wanted first.
    pub formats: Vec<FormatKind>,
}

/// What to ask of the driver, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// Format.
    pub format: FormatKind,
    /// Time between frames; none if the camera does not say which it offers.
    pub interval: Option<Interval>,
    /// Why formats that were wanted more are not taken.
    pub refusals: Vec<String>,
}

/// What the driver agreed to.
#[derive(Debug, Clone, PartialEq)]
pub struct Negotiated {
    /// Layout of the pictures.
    pub format: PixelFormat,
    /// What was asked for.
    pub kind: FormatKind,
    /// Width and height.
    pub size: Size,
    /// Time between frames; none if the driver does not say.
    pub interval: Option<Interval>,
    /// Distance between rows in the driver's memory in bytes; 0 for JPEG.
    pub bytes_per_line: u32,
    /// Most bytes of a picture in the driver's memory.
    pub image_bytes: u32,
    /// Why other formats were not taken, and other things worth knowing.
    pub remarks: Vec<String>,
}

impl Negotiated {
    /// Frames per second; none if the driver does not say.
    #[must_use]
    pub fn frames_per_s(&self) -> Option<f64> {
        self.interval.map(Interval::frames_per_s)
    }

    /// Least length of a pool's buffers for these frames.
    #[must_use]
    pub fn buffer_bytes(&self) -> usize {
        self.format.max_bytes(self.size).max(self.image_bytes as usize)
    }

    /// True if the driver's memory has rows with padding, which frames have not.
    #[must_use]
    pub fn is_padded(&self) -> bool {
        self.kind
            .row_bytes(self.size)
            .is_some_and(|row| row != self.bytes_per_line as usize)
    }
}

impl fmt::Display for Negotiated {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Size { width, height } = self.size;
        write!(formatter, "negotiated {width}x{height} {}", self.kind)?;
        match self.frames_per_s() {
            Some(rate) => write!(formatter, " at {} frames/s", rounded(rate))?,
            None => formatter.write_str(" at an unknown rate")?,
        }
        self.remarks
            .iter()
            .try_for_each(|remark| write!(formatter, "; {remark}"))
    }
}

/// Rates that differ by less than this share count as the same: 29.97 is 30.
const SAME_RATE: f64 = 0.02;

/// The first wanted format that comes in the wanted size and rate, or else the one that comes nearest to the rate.
///
/// # Errors
///
/// For each wanted format why it cannot be had, if none comes in the wanted size.
pub fn choose(wish: &Wish, offers: &[FormatOffer]) -> Result<Choice, Vec<String>> {
    let wanted_s = 1.0 / wish.frames_per_s;
    let mut refusals = Vec::new();
    let mut nearest: Option<(f64, FormatKind, Option<Interval>)> = None;
    let mut rate_refusals: Vec<(FormatKind, String)> = Vec::new();
    for kind in wish.formats.iter().copied() {
        let intervals = match intervals_for(kind, wish.size, offers) {
            Ok(intervals) => intervals,
            Err(refusal) => {
                refusals.push(format!("{kind} refused: {refusal}"));
                continue;
            }
        };
        let interval = intervals.nearest(wanted_s);
        // A camera that does not say its rates is taken by its word when asked.
        let error = interval.map_or(0.0, |interval| (interval.seconds() / wanted_s).ln().abs());
        if nearest.is_none_or(|(least, ..)| error < least) {
            nearest = Some((error, kind, interval));
        }
        if error <= SAME_RATE {
            break;
        }
        let rate = rounded(interval.map_or(0.0, Interval::frames_per_s));
        rate_refusals.push((kind, format!("{kind} refused: only {rate} frames/s")));
    }
    let Some((_, format, interval)) = nearest else {
        return Err(refusals);
    };
    let others = rate_refusals.into_iter().filter(|(kind, _)| *kind != format);
    refusals.extend(others.map(|(_, refusal)| refusal));
    Ok(Choice {
        format,
        interval,
        refusals,
    })
}

/// Rates at which a format comes in a size, or why it does not come.
fn intervals_for(kind: FormatKind, size: Size, offers: &[FormatOffer]) -> Result<&Intervals, String> {
    let Some(offer) = offers.iter().find(|offer| offer.fourcc == kind.fourcc()) else {
        return Err("the camera does not offer it".into());
    };
    if !kind.admits(size) {
        return Err(format!("no picture of {}x{} in this format", size.width, size.height));
    }
    let found = offer.sizes.iter().find(|offered| offered.sizes.contain(size));
    found
        .map(|offered| &offered.intervals)
        .ok_or_else(|| format!("not in {}x{}", size.width, size.height))
}

/// A rate as people write it: `30`, `29.97`.
fn rounded(rate: f64) -> f64 {
    (rate * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const HD: Size = Size {
        width: 1280,
        height: 720,
    };

    fn rates(rates: &[u32]) -> Intervals {
        Intervals::Discrete(
            rates
                .iter()
                .map(|rate| Interval {
                    numerator: 1,
                    denominator: *rate,
                })
                .collect(),
        )
    }

    fn offer(kind: FormatKind, size: Size, intervals: Intervals) -> FormatOffer {
        let sizes = vec![SizeOffer {
            sizes: Sizes::Discrete(size),
            intervals,
        }];
        FormatOffer {
            fourcc: kind.fourcc(),
            name: kind.to_string(),
            sizes,
        }
    }

    fn wish(frames_per_s: f64, formats: &[FormatKind]) -> Wish {
        Wish {
            size: HD,
            frames_per_s,
            formats: formats.to_vec(),
        }
    }

    fn webcam() -> Vec<FormatOffer> {
        vec![
            offer(FormatKind::Yuyv, HD, rates(&[15, 10])),
            offer(FormatKind::Mjpeg, HD, rates(&[30, 15])),
        ]
    }

    #[test]
    fn a_slow_format_gives_way_to_a_fast_one() {
        let choice = choose(&wish(30.0, &[FormatKind::Yuyv, FormatKind::Mjpeg]), &webcam()).unwrap();
        assert_eq!(choice.format, FormatKind::Mjpeg);
        assert_eq!(choice.refusals, ["YUYV refused: only 15 frames/s"]);
        let choice = choose(&wish(15.0, &[FormatKind::Yuyv, FormatKind::Mjpeg]), &webcam()).unwrap();
        assert_eq!((choice.format, choice.refusals.len()), (FormatKind::Yuyv, 0));
    }

    #[test]
    fn the_nearest_rate_is_taken_when_none_fits() {
        let choice = choose(
            &wish(60.0, &[FormatKind::Yuyv, FormatKind::Nv12, FormatKind::Mjpeg]),
            &webcam(),
        )
        .unwrap();
        assert_eq!(
            choice.interval,
            Some(Interval {
                numerator: 1,
                denominator: 30
            })
        );
        assert_eq!(
            choice.refusals,
            [
                "NV12 refused: the camera does not offer it",
                "YUYV refused: only 15 frames/s"
            ]
        );
    }

    #[test]
    fn the_size_must_be_right() {
        let small = Wish {
            size: Size {
                width: 320,
                height: 240,
            },
            ..wish(30.0, &[FormatKind::Mjpeg, FormatKind::Grey])
        };
        let refusals = choose(&small, &webcam()).unwrap_err();
        assert_eq!(
            refusals,
            [
                "MJPEG refused: not in 320x240",
                "GREY refused: the camera does not offer it"
            ]
        );
        let odd = Size { width: 3, height: 3 };
        let offers = [offer(FormatKind::Nv12, odd, Intervals::Unknown)];
        assert!(
            choose(
                &Wish {
                    size: odd,
                    ..wish(30.0, &[FormatKind::Nv12])
                },
                &offers
            )
            .is_err()
        );
        assert_eq!(choose(&wish(30.0, &[]), &webcam()), Err(vec![]));
    }

    #[test]
    fn ntsc_rates_count_as_whole_ones_and_unknown_rates_are_taken() {
        let ntsc = Intervals::Discrete(vec![Interval {
            numerator: 1001,
            denominator: 30000,
        }]);
        let offers = [
            offer(FormatKind::Yuyv, HD, ntsc),
            offer(FormatKind::Mjpeg, HD, rates(&[30])),
        ];
        assert_eq!(
            choose(&wish(30.0, &FormatKind::ALL), &offers).unwrap().format,
            FormatKind::Yuyv
        );
        let offers = [offer(FormatKind::Grey, HD, Intervals::Unknown)];
        assert_eq!(choose(&wish(30.0, &FormatKind::ALL), &offers).unwrap().interval, None);
    }

    #[test]
    fn padded_rows_are_noticed() {
        let negotiated = Negotiated {
            format: PixelFormat::Grey8,
            kind: FormatKind::Grey,
            size: Size { width: 6, height: 2 },
            interval: Some(Interval {
                numerator: 333_333,
                denominator: 10_000_000,
            }),
            bytes_per_line: 8,
            image_bytes: 16,
            remarks: vec!["YUYV refused: not in 6x2".into()],
        };
        assert!(negotiated.is_padded());
        assert_eq!(
            negotiated.to_string(),
            "negotiated 6x2 GREY at 30 frames/s; YUYV refused: not in 6x2"
        );
    }

    proptest! {
        #[test]
        fn nearest_is_nearest(rates_offered in prop::collection::vec(1u32..240, 1..8), wanted in 1.0..240.0f64) {
            let intervals = rates(&rates_offered);
            let nearest = intervals.nearest(1.0 / wanted).unwrap();
            for rate in rates_offered {
                let error = |rate: f64| (1.0 / rate - 1.0 / wanted).abs();
                prop_assert!(error(nearest.frames_per_s()) <= error(f64::from(rate)) + 1e-12);
            }
        }

        #[test]
        fn intervals_between_bounds_stay_there(shortest in 1u32..1000, more in 1u32..1000, wanted in 0.0..2.0f64) {
            let bound = |numerator| Interval { numerator, denominator: 1000 };
            let nearest = Intervals::Between(bound(shortest), bound(shortest + more)).nearest(wanted).unwrap();
            let tolerance = 1e-7;
            prop_assert!(nearest.seconds() >= bound(shortest).seconds() - tolerance);
            prop_assert!(nearest.seconds() <= bound(shortest + more).seconds() + tolerance);
        }
    }
}
