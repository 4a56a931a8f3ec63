//! Why a camera's photometry cannot be measured.

use std::{io, path::PathBuf};

use mirrorball_calib::{
    photometric::{black::BlackError, latency::LatencyError, noise::NoiseError, vignetting::VignettingError},
    response_fit::FitError,
};

use crate::commands::explain::Explain;

#[derive(Debug, thiserror::Error)]
pub(crate) enum PhotometricError {
    #[error("cannot read `{}`", file.display())]
    Read {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("line {line} of `{}` is not usable: {message}", file.display())]
    Csv { file: PathBuf, line: u64, message: String },
    #[error("picture `{picture}` has no exposure: `{}` does not list it", file.display())]
    Unlisted { picture: String, file: PathBuf },
    #[error("picture `{picture}` has no exposure: its EXIF data has no {missing}")]
    ExifMissing { picture: String, missing: &'static str },
    #[error("no picture of camera `{camera}` in the input")]
    NoPictures { camera: String },
    #[error("picture `{picture}` is `{} x {}` (allowed: `{} x {}` as the first one)", found[0], found[1], expected[0], expected[1])]
    Size {
        picture: String,
        found: [u32; 2],
        expected: [u32; 2],
    },
    #[error("there are more than `{most}` pictures of `{} x {}`, for which 4 GiB of memory are too little (allowed: 1 to {most})", size_px[0], size_px[1])]
    TooMany { size_px: [u32; 2], most: u64 },
    #[error("picture `{picture}` has other white-balance gains than the first one")]
    WhiteBalance { picture: String },
    #[error("picture `{picture}` is saturated: `{percent:.0} %` of it is white (allowed: at most 98 %)")]
    Saturated { picture: String, percent: f64 },
    #[error("picture `{picture}` is black: `{percent:.0} %` of it (allowed: at most 98 %)")]
    Black { picture: String, percent: f64 },
    #[error("cannot fit the response")]
    Fit(#[source] FitError),
    #[error("cannot measure the noise")]
    Noise(#[source] NoiseError),
    #[error("cannot measure the vignetting (flat pictures: {names})")]
    Vignetting {
        names: String,
        #[source]
        source: VignettingError,
    },
    #[error("cannot measure the black level (dark pictures: {names})")]
    BlackLevel {
        names: String,
        #[source]
        source: BlackError,
    },
    #[error("cannot measure the control latency")]
    Latency(#[source] LatencyError),
    #[error("the noise was not measured, and the rig file does not know it")]
    NoNoise,
    #[error("a rig has one response for all channels, so a curve per channel cannot be written")]
    ChannelsToRig,
}

impl Explain for PhotometricError {
    fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Latency(LatencyError::Unclear { .. }))
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::Read { .. } => return None,
            Self::Csv { .. } => {
                "exposures: `file,exposure_s,gain`; requests: `frame,exposure_s,gain`; with this line as the head"
            }
            Self::Unlisted { .. } => "add a line for it, or take the picture out of the folder",
            Self::ExifMissing { .. } => "give `--exposures FILE.csv` with `file,exposure_s,gain`",
            Self::NoPictures { .. } => "name a camera of the recording with `--camera`",
            Self::Size { .. } => "give pictures of one camera and one mode only",
            Self::TooMany { .. } => "two or three pictures of each exposure are enough: give fewer, or smaller ones",
            Self::WhiteBalance { .. } => "hold the white balance while the exposure changes",
            Self::Saturated { .. } => "leave it out, or shorten its exposure",
            Self::Black { .. } => "leave it out, or lengthen its exposure",
            Self::Fit(FitError::EqualExposures { .. } | FitError::Count { .. }) => {
                "take a bracket: three exposures or more, two or three stops apart; or give `--response srgb`"
            }
            Self::Fit(FitError::Reversed { .. }) => {
                "look whether the exposures belong to other pictures of the bracket"
            }
            Self::Fit(FitError::NothingInCommon { .. }) => {
                "a scene of many shades, and exposures two or three stops apart, show enough in common"
            }
            Self::Fit(_) => return None,
            Self::Noise(_) => "take every exposure two or three times, camera and scene still, with texture in sight",
            Self::Vignetting {
                source: VignettingError::Shape { .. },
                ..
            } => "give pictures of the camera's whole sensor",
            Self::Vignetting { .. } => "fill the picture with an evenly lit white sheet, out of focus, not clipped",
            Self::BlackLevel { .. } => "cover the lens",
            Self::Latency(_) => "change the exposure by a stop or more, twenty frames apart, under steady light",
            Self::NoNoise => {
                "take every exposure two or three times, or write into a rig that knows the camera's noise"
            }
            Self::ChannelsToRig => "use `--response fit`, or leave out `--out`",
        })
    }
}
