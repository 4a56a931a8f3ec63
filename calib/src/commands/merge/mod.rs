//! `merge`: several exposures of one view become one picture of radiance, and the response that made them.

mod files;
mod report;

use std::{
    fs, io,
    io::Write,
    path::{Path, PathBuf},
};

use mirrorball_calib::{
    merge::{
        exposure_list::{self, ListError, MAX_EXPOSURE_S, MIN_EXPOSURE_S},
        motion::MotionTest,
        noise::{ChannelNoise, ChannelTable, VarianceTable},
        stack::{MergedPicture, StackError, StackPicture, StackRules, merge_stack},
    },
    photometric::debevec_malik,
    response::{ResponseCurve, ResponseError},
    response_fit::{Channels, ExposureTimes, FitError, FlatPatches, RatioErrors, Shot, fit_patches, ratio_errors},
};

use super::{CommandError, mask};

/// Electrons at full scale, and of read noise, of a camera that nobody has measured: an ordinary webcam or compact camera.
const FULL_WELL_E: f64 = 10_000.0;
const READ_NOISE_E: f64 = 8.0;

/// Noise after encoding in codes: compression, scanning.
const CODE_NOISE: f64 = 1.0;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Pictures of the same view at different exposures (PNG or JPEG). They are not aligned: use a tripod.
    #[arg(value_name = "IMAGE", required_unless_present = "list")]
    images: Vec<PathBuf>,
    /// Exposure times of the pictures in seconds, in their order; `1/40` is understood.
    #[arg(long, value_name = "T,T,...", value_delimiter = ',', conflicts_with = "list")]
    exposure_s: Vec<String>,
    /// List of pictures and exposures instead, as Debevec's image series have them: name, seconds, 1/seconds, f/stop, dB, ND.
    #[arg(long, value_name = "FILE", conflicts_with = "images")]
    list: Option<PathBuf>,
    /// `srgb`, `fit` (one curve for all channels), `fit-channels` (a curve each), or a file as this command writes it.
    #[arg(long, value_name = "WHAT", default_value = "fit")]
    response: String,
    /// Take the exposure times as nominal: correct them, and say by how much. Needs a response that is fitted.
    #[arg(long)]
    nominal_exposures: bool,
    /// The same for each channel by itself, as for film, whose layers do not all fail reciprocity alike.
    #[arg(long, conflicts_with = "nominal_exposures")]
    nominal_exposures_per_channel: bool,
    /// Colour of pixels that show nothing, such as the borders of registered pictures.
    #[arg(long, value_name = "R,G,B", value_parser = mask::rgb)]
    mask_rgb: Option<[u8; 3]>,
    /// Folder for `merged.exr`, `merged.hdr`, `merged.png` and `response.toml`.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

/// Why pictures cannot be merged.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MergeError {
    #[error("cannot read `{}`", file.display())]
    Read {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("cannot write `{}`", file.display())]
    Write {
        file: PathBuf,
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    #[error("`{}` is not a list of pictures", file.display())]
    List {
        file: PathBuf,
        #[source]
        source: ListError,
    },
    #[error("there are `{found}` exposure times for `{expected}` pictures")]
    Times { found: usize, expected: usize },
    #[error("exposure time `{found}` of picture `{}` (allowed: 1e-9 to 86400 s, as `0.025` or `1/40`)", file.display())]
    Time { file: PathBuf, found: String },
    #[error("there are `{found}` pictures (allowed: 2 to 255)")]
    Count { found: usize },
    #[error("picture `{}` is `{} x {}` (allowed: `{} x {}` as the first one)", file.display(), found[0], found[1], expected[0], expected[1])]
    Size {
        file: PathBuf,
        found: [u32; 2],
        expected: [u32; 2],
    },
    #[error("all pixels of all pictures are clipped or black")]
    NothingSeen,
    #[error("`{}` is not a response: {message}", file.display())]
    ResponseFile { file: PathBuf, message: String },
    #[error("`{key}` in `{}` is not a response curve", file.display())]
    ResponseCurve {
        file: PathBuf,
        key: &'static str,
        #[source]
        source: ResponseError,
    },
    #[error("exposure times can be corrected only where the response is fitted (found: `--response {found}`)")]
    NotFitted { found: String },
    #[error("cannot fit the response")]
    Fit(#[source] FitError),
    #[error("cannot merge the pictures")]
    Stack(#[source] StackError),
}

impl MergeError {
    /// Whether it is the input's fault.
    pub(crate) fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Write { .. })
    }

    /// What to do about it.
    pub(crate) fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Times { .. } | Self::Time { .. } => {
                Some("give one `--exposure-s` per picture, separated by commas, or `--list FILE`")
            }
            Self::Count { .. } => Some("give two pictures or more of the same view"),
            Self::NothingSeen => Some("at least one picture must show something between black and white"),
            Self::Fit(FitError::NothingInCommon { .. }) => {
                Some("exposures two or three stops apart show enough in common; or name a `--response`")
            }
            Self::Fit(FitError::Reversed { .. }) => {
                Some("look whether the exposure times are in the order of the pictures")
            }
            Self::NotFitted { .. } => Some("use `--response fit` or `fit-channels`"),
            Self::Read { .. }
            | Self::Write { .. }
            | Self::List { .. }
            | Self::Size { .. }
            | Self::ResponseFile { .. }
            | Self::ResponseCurve { .. }
            | Self::Fit(_)
            | Self::Stack(_) => None,
        }
    }
}

/// The pictures.
pub(crate) struct Series {
    files: Vec<PathBuf>,
    /// As given.
    exposures_s: Vec<f64>,
    codes: Vec<Vec<u8>>,
    holes: Option<Vec<Vec<bool>>>,
    size_px: [usize; 2],
}

/// The response that they are merged with.
pub(crate) struct Response {
    curves: [ResponseCurve; 3],
    /// As given, or corrected, of red, green and blue.
    exposures_s: Vec<[f64; 3]>,
    /// What it is: `srgb`, `fit`, `fit-channels` or a file.
    source: String,
    known_codes: Option<[u8; 2]>,
    errors: Option<RatioErrors>,
    /// Of Debevec and Malik's response, to compare with.
    debevec_malik: Option<RatioErrors>,
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    let series = read_series(args)?;
    let response = response(args, &series)?;
    let merged = merge(&series, &response)?;
    files::write(&args.out, &series, &response, &merged)?;
    let report = report::Report::new(&series, &response, &merged);
    if args.json {
        report.write_json(out)
    } else {
        report.write_table(out)
    }
    .map_err(CommandError::Output)
}

fn read_series(args: &Args) -> Result<Series, CommandError> {
    let (files, exposures_s) = match &args.list {
        Some(list) => listed(list)?,
        None => (args.images.clone(), times(args)?),
    };
    if !(2..=255).contains(&files.len()) {
        return Err(MergeError::Count { found: files.len() }.into());
    }
    let mut size = None;
    let mut codes = Vec::new();
    for file in &files {
        let picture = image::open(file)
            .map_err(|source| CommandError::ReadPicture {
                file: file.clone(),
                source,
            })?
            .into_rgb8();
        let found = [picture.width(), picture.height()];
        let expected = *size.get_or_insert(found);
        if found != expected {
            let file = file.clone();
            return Err(MergeError::Size { file, found, expected }.into());
        }
        codes.push(picture.into_raw());
    }
    if codes.iter().flatten().all(|&code| code == 0 || code == 255) {
        return Err(MergeError::NothingSeen.into());
    }
    let size_px = size.unwrap_or([0, 0]).map(|side| side as usize);
    let holes = args
        .mask_rgb
        .map(|color| codes.iter().map(|codes| mask::holes(codes, size_px, color)).collect());
    Ok(Series {
        files,
        exposures_s,
        codes,
        holes,
        size_px,
    })
}

fn listed(list: &Path) -> Result<(Vec<PathBuf>, Vec<f64>), MergeError> {
    let text = fs::read_to_string(list).map_err(|source| MergeError::Read {
        file: list.to_owned(),
        source,
    })?;
    let pictures = exposure_list::parse(&text).map_err(|source| MergeError::List {
        file: list.to_owned(),
        source,
    })?;
    let folder = list.parent().unwrap_or(Path::new(""));
    Ok(pictures
        .into_iter()
        .map(|picture| (folder.join(picture.file), picture.exposure_s))
        .unzip())
}

fn times(args: &Args) -> Result<Vec<f64>, MergeError> {
    if args.exposure_s.len() != args.images.len() {
        return Err(MergeError::Times {
            found: args.exposure_s.len(),
            expected: args.images.len(),
        });
    }
    let time = |(text, file): (&String, &PathBuf)| {
        seconds(text)
            .filter(|time| (MIN_EXPOSURE_S..=MAX_EXPOSURE_S).contains(time))
            .ok_or_else(|| MergeError::Time {
                file: file.clone(),
                found: text.clone(),
            })
    };
    args.exposure_s.iter().zip(&args.images).map(time).collect()
}

/// `0.025` or `1/40`.
fn seconds(text: &str) -> Option<f64> {
    match text.split_once('/') {
        Some((over, under)) => Some(over.trim().parse::<f64>().ok()? / under.trim().parse::<f64>().ok()?),
        None => text.trim().parse().ok(),
    }
}

fn response(args: &Args, series: &Series) -> Result<Response, MergeError> {
    let shots: Vec<Shot<'_>> = (0..series.files.len())
        .map(|i| Shot {
            codes: &series.codes[i],
            holes: series.holes.as_ref().map(|holes| holes[i].as_slice()),
            exposure_s: series.exposures_s[i],
        })
        .collect();
    let patches = FlatPatches::new(&shots, series.size_px).map_err(MergeError::Fit)?;
    let times = if args.nominal_exposures {
        ExposureTimes::Nominal
    } else if args.nominal_exposures_per_channel {
        ExposureTimes::NominalPerChannel
    } else {
        ExposureTimes::Exact
    };
    let channels = match args.response.as_str() {
        "fit" => Some(Channels::Shared),
        "fit-channels" => Some(Channels::Separate),
        _ => None,
    };
    let (curves, exposures_s, known_codes) = match channels {
        Some(channels) => {
            let fitted = fit_patches(&patches, channels, times).map_err(MergeError::Fit)?;
            (fitted.curves, fitted.exposures_s, Some(fitted.known_codes))
        }
        None if times != ExposureTimes::Exact => {
            let found = args.response.clone();
            return Err(MergeError::NotFitted { found });
        }
        None if args.response == "srgb" => {
            let srgb = ResponseCurve::srgb();
            ([srgb.clone(), srgb.clone(), srgb], patches.channel_exposures_s(), None)
        }
        None => (
            files::read_response(Path::new(&args.response))?,
            patches.channel_exposures_s(),
            None,
        ),
    };
    let rival = debevec_malik::fit(&shots, series.size_px);
    Ok(Response {
        debevec_malik: ratio_errors(&patches, &rival, &patches.channel_exposures_s()),
        errors: ratio_errors(&patches, &curves, &exposures_s),
        curves,
        exposures_s,
        source: args.response.clone(),
        known_codes,
    })
}

fn merge(series: &Series, response: &Response) -> Result<MergedPicture, MergeError> {
    let tables: Vec<VarianceTable> = response.exposures_s.iter().map(|&time| table(response, time)).collect();
    let pictures: Vec<StackPicture<'_>> = tables
        .iter()
        .enumerate()
        .map(|(i, table)| StackPicture {
            codes: &series.codes[i],
            table,
            holes: series.holes.as_ref().map(|holes| holes[i].as_slice()),
        })
        .collect();
    merge_stack(&pictures, series.size_px, &rules()).map_err(MergeError::Stack)
}

/// What one second of a signal of 1 is the unit of radiance.
fn table(response: &Response, exposures_s: [f64; 3]) -> VarianceTable {
    let noise = |exposure_s: f64| ChannelNoise {
        signal_per_radiance: exposure_s,
        signal_per_electron: 1.0 / FULL_WELL_E,
        read_noise_e: READ_NOISE_E,
        code_noise: CODE_NOISE,
    };
    VarianceTable::from_channels(std::array::from_fn(|channel| {
        ChannelTable::new(&response.curves[channel], &noise(exposures_s[channel]))
    }))
}

/// Rules for pictures of unknown cameras: their response is exact to some per cent, a tripod to a pixel.
fn rules() -> StackRules {
    StackRules {
        motion: MotionTest {
            tolerance: 0.25,
            fraction: 0.3,
            ..MotionTest::default()
        },
        consistency: mirrorball_calib::merge::Consistency::new(5.0, 0.25),
    }
}
