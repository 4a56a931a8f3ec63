//! Why two cameras' colours cannot be matched.

use std::{io, path::PathBuf};

use mirrorball_calib::color::{matching::MatchError, patches::SheetError, white_balance::WhiteBalanceError};

use crate::commands::{csv::TableError, explain::Explain};

#[derive(Debug, thiserror::Error)]
pub(crate) enum ColorError {
    #[error("cannot read `{}`", file.display())]
    Read {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("`{}` is not a sheet of patches", file.display())]
    Sheet {
        file: PathBuf,
        #[source]
        source: SheetError,
    },
    #[error("the sheet lies beside marker `{id}`, which the rig does not have")]
    NoMarker { id: u32 },
    #[error("`--cameras` names camera `{camera}` twice (allowed: two different ones)")]
    OneCamera { camera: String },
    #[error("it is not known where the chart is in the pictures of camera `{camera}`")]
    NoChartCorners { camera: String },
    #[error(
        "the colours of camera `{second}` do not go with those of camera `{first}`: after matching they are off by          `{percent:.0}` % in the mean (allowed: `{allowed:.0}` %)"
    )]
    Unlike {
        first: String,
        second: String,
        percent: f64,
        allowed: f64,
    },
    #[error("`--chart-corners` needs a sheet with `corners_m`")]
    NoCorners,
    #[error("the chart's corners in `{name}` are not those of a rectangle seen from its front")]
    Corners { name: String },
    #[error("no picture of camera `{camera}` in the recording")]
    NoPictures { camera: String },
    #[error("in none of the `{pictures}` pictures of camera `{camera}` it is known where the sheet is")]
    NotPlaced { camera: String, pictures: usize },
    #[error("picture `{picture}` has `{found}` values (allowed: as `size_px` of its camera says, `{expected}`)")]
    Size {
        picture: String,
        found: usize,
        expected: usize,
    },
    #[error("cannot match camera `{second}` to camera `{first}` (left out: {left_out})")]
    Match {
        first: String,
        second: String,
        left_out: String,
        #[source]
        source: MatchError,
    },
    #[error("there is no marker `{id}` (allowed: `0` to `586`)")]
    NoSuchMarker { id: u32 },
    #[error("the sheet has no neutral patch, by which white balance can be compared")]
    NoNeutral,
    #[error(transparent)]
    Settings(#[from] TableError),
    #[error("white balance cannot be compared")]
    WhiteBalance(#[from] WhiteBalanceError),
}

impl Explain for ColorError {
    fn is_bad_input(&self) -> bool {
        true
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::Read { .. } => return None,
            Self::OneCamera { .. } => "give `--cameras A,B`",
            Self::NoChartCorners { .. } => "give `--chart-corners CAMERA=x,y,x,y,x,y,x,y` for each of the two cameras",
            Self::Unlike { .. } => {
                "both must see the same patches under the same light; are the sheet and its corners where you say?"
            }
            Self::Sheet { .. } => {
                "`marker = ID`, then `[[patch]]` with `name`, `x_m`, `y_m`, `side_m`; or name `colorchecker`"
            }
            Self::NoMarker { .. } => "name a marker of the rig in the patch file",
            Self::NoCorners => "give `corners_m` in the patch file: bottom-left, bottom-right, top-right, top-left",
            Self::Corners { .. } => {
                "give bottom-left, bottom-right, top-right, top-left of the upright chart, in pixels"
            }
            Self::NoPictures { .. } => "`--cameras` names two cameras of the recording",
            Self::NotPlaced { .. } => "markers of the rig must be in sight, or give `--chart-corners CAMERA=x,y,...`",
            Self::Size { .. } => "the rig must be that of this recording",
            Self::NoSuchMarker { .. } => "give another id with `--marker`",
            Self::NoNeutral => "mark white and grey patches with `neutral = true` in the patch file",
            Self::Settings(source) => return source.hint(),
            Self::WhiteBalance(WhiteBalanceError::FewSettings { .. }) => {
                "record the sheet at more settings, and say in `--settings` which frame was taken at which"
            }
            Self::WhiteBalance(WhiteBalanceError::NoPatch { .. }) => {
                "expose so that at every setting one grey is neither clipped nor black in any channel"
            }
            Self::Match { .. } => "light the sheet evenly, expose it so that white is below clipping, fill the picture",
        })
    }
}
