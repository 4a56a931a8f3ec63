//! `ball`: where the mirror ball is, how large, and how much it reflects.

mod found;
mod report;
mod views;

use std::{fs, io::Write, path::PathBuf};

use glam::DVec3;
use mirrorball_calib::{
    ball_fit::{
        self, BallError, BallFit, BallPrior, BallView, Measured, ViewResult,
        reflectance::{self, NoPatch, Reflectance},
    },
    resection::NoPose,
    rig::{Ball, RigParts},
    tag::PictureError,
};

use super::{
    CommandError,
    explain::Explain,
    input::InputArgs,
    output::{OutputArgs, draft},
    own_rig, parts,
};
use found::Found;
use views::Taken;

/// Fits in turn with measurements of the reflectance, on which the outline's look depends.
const ROUNDS: usize = 2;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Rig file with lenses and markers; by default the recording's own.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// Camera that took the pictures of a folder; of a recording, the only one that counts.
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Radius as measured by hand, metres.
    #[arg(long, value_name = "R", requires = "radius_sigma_m")]
    radius_m: Option<f64>,
    /// Standard deviation of that, metres.
    #[arg(long, value_name = "S", requires = "radius_m")]
    radius_sigma_m: Option<f64>,
    /// About where the ball's centre is in the world, metres, to 5 mm; by default where the rig file has it.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    center: Option<DVec3>,
    /// Reflectance of red, green and blue, if no marker shall tell it.
    #[arg(long, value_name = "R,G,B", value_parser = triple)]
    reflectance: Option<DVec3>,
    #[command(flatten)]
    output: OutputArgs,
}

/// Why there is no ball.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BallCommandError {
    #[error("no rig file is given, and there is none in the recording")]
    NoRig,
    #[error("rig file `{}` has no camera `{name}` with a lens (there are: {present})", file.display())]
    NoCamera {
        file: PathBuf,
        name: String,
        present: String,
    },
    #[error("rig file `{}` has `{n_markers}` markers and main marker {main}", file.display())]
    NoMarkers {
        file: PathBuf,
        n_markers: usize,
        main: String,
    },
    #[error("it is not known where the ball is: rig file `{}` has no `[ball]`", file.display())]
    NoCenter { file: PathBuf },
    #[error("`--{option}` is `{value}` (allowed: {allowed})")]
    Option {
        option: &'static str,
        value: String,
        allowed: &'static str,
    },
    #[error("cannot search picture `{picture}`")]
    Search {
        picture: String,
        #[source]
        source: PictureError,
    },
    #[error("none of `{n_pictures}` pictures has a pose; `{picture}`")]
    NoPose {
        n_pictures: usize,
        picture: String,
        #[source]
        source: NoPose,
    },
    #[error("there is no picture of camera `{camera}`")]
    NoPicture { camera: String },
    #[error("cannot find the ball")]
    Ball(#[source] BallError),
    #[error("the ball's reflectance is not known")]
    Reflectance(#[source] NoPatch),
}

impl Explain for BallCommandError {
    fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Ball(BallError::NotConverged))
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::NoRig => "give `--rig FILE`",
            Self::NoCamera { .. } => "choose one of these with `--camera`, or calibrate its lens first (`intrinsics`)",
            Self::NoMarkers { .. } => {
                "measure the markers first (`extrinsics`), or write `main_marker` and `[[marker]]`"
            }
            Self::NoCenter { .. } => "give `--center X,Y,Z`, measured with a ruler from the main marker's middle",
            Self::Option { .. } => return None,
            Self::Search { .. } => "`size_px` in the rig file must be the size of the camera's pictures",
            Self::NoPose { .. } => "at least one marker of the rig must be sharp, whole and well lit in the pictures",
            Self::NoPicture { .. } => "choose a camera of the recording with `--camera`",
            Self::Ball(error) => match error {
                BallError::NoViews | BallError::NotSeen { .. } => {
                    "the whole ball must be in the picture, and `--center` right to 5 mm"
                }
                BallError::OneView { .. } => {
                    "take pictures from several sides, or give `--radius-m` and `--radius-sigma-m`"
                }
                BallError::RadiusUnknown { .. } => {
                    "take pictures from sides 60° and more apart, or give `--radius-m` and `--radius-sigma-m`"
                }
                BallError::Disagree { .. } => {
                    "the ball and the markers must stand still; take out the picture that is furthest off"
                }
                BallError::NotConverged => "give a better `--center`, or `--radius-m` and `--radius-sigma-m`",
            },
            Self::Reflectance(_) => {
                "put a marker of the rig beside the ball, where the camera sees it and its image in the ball; or give \
                 `--reflectance R,G,B`"
            }
        })
    }
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.output.check()?;
    let (file, parts) = read_parts(args)?;
    let prior = prior(args, &file, parts.ball.as_ref())?;
    let mut warnings = Vec::new();
    let taken = views::take(args, &file, &parts, &mut warnings)?;
    let views: Vec<BallView<'_>> = taken.iter().map(Taken::view).collect();
    let (fit, measured) = fit(&views, prior, |counted, fit| match args.reflectance {
        Some(_) => None,
        None => Some(reflectance::measure(counted, &fit.ball, &parts.markers)),
    })?;
    let reflectance = match (args.reflectance, &measured, parts.ball) {
        (Some(value), ..) => value,
        (None, Some(Ok(measured)), _) => measured.value.min(DVec3::ONE),
        (None, Some(Err(reason)), Some(ball)) => {
            warnings.push(format!("the rig's reflectance is kept: {reason}"));
            DVec3::from_array(ball.reflectance)
        }
        (None, Some(Err(reason)), None) => return Err(BallCommandError::Reflectance(*reason).into()),
        (None, None, _) => unreachable!("measured unless given"),
    };
    let (map, figures) = found::directions(&fit, &views);
    let found = Found {
        fit,
        reflectance,
        measured: measured.and_then(Result::ok),
        roughness: parts.ball.map_or(0.0, |ball| ball.roughness),
        names: views.iter().map(|view| view.name.clone()).collect(),
        map,
        figures,
        warnings,
    };
    found.print(out).map_err(CommandError::Output)?;
    args.output.write_json(&found.numbers())?;
    args.output.write_report(|| report::report(&found))?;
    if let Some(file) = &args.output.out {
        let mut draft = draft(file)?;
        draft.set_ball(&found.ball());
        args.output.write_rig(&draft)?;
    }
    Ok(())
}

type MaybeMeasured = Option<Result<Reflectance, NoPatch>>;

/// Fits the ball and measures its reflectance in turn, with the views that count.
fn fit(
    views: &[BallView<'_>],
    mut prior: BallPrior,
    measure: impl Fn(&[BallView<'_>], &BallFit) -> MaybeMeasured,
) -> Result<(BallFit, MaybeMeasured), BallCommandError> {
    let mut round = 0;
    loop {
        let fit = ball_fit::fit(views, &prior).map_err(BallCommandError::Ball)?;
        let counted: Vec<BallView<'_>> = views
            .iter()
            .zip(&fit.views)
            .filter(|(_, result)| matches!(result, ViewResult::Used(_)))
            .map(|(view, _)| view.clone())
            .collect();
        let measured = measure(&counted, &fit);
        round += 1;
        let Some(Ok(value)) = measured.as_ref().filter(|_| round < ROUNDS) else {
            return Ok((fit, measured));
        };
        prior = BallPrior {
            center_m: fit.ball.center_m,
            radius_m: Some(fit.ball.radius_m),
            reflectance: value.value.as_vec3(),
            ..prior
        };
    }
}

fn read_parts(args: &Args) -> Result<(PathBuf, RigParts), CommandError> {
    let Some(file) = &args.rig else {
        let own = args.input.recording.as_deref().map(own_rig).transpose()?.flatten();
        return Ok(own.ok_or(BallCommandError::NoRig)?);
    };
    let text = fs::read_to_string(file).map_err(|source| CommandError::ReadRig {
        file: file.clone(),
        source,
    })?;
    Ok((file.clone(), parts(&text, file)?))
}

/// Three numbers with commas between them.
fn triple(text: &str) -> Result<DVec3, String> {
    let values: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match values.as_deref() {
        Ok(&[x, y, z]) if [x, y, z].into_iter().all(f64::is_finite) => Ok(DVec3::new(x, y, z)),
        _ => Err("three numbers with commas between them are needed".to_owned()),
    }
}

fn prior(args: &Args, file: &std::path::Path, ball: Option<&Ball>) -> Result<BallPrior, BallCommandError> {
    let positive = |option, value: Option<f64>| match value {
        Some(value) if !(value > 0.0 && value < 10.0) => Err(BallCommandError::Option {
            option,
            value: value.to_string(),
            allowed: "above 0, below 10",
        }),
        _ => Ok(value),
    };
    let radius = positive("radius-m", args.radius_m)?.zip(positive("radius-sigma-m", args.radius_sigma_m)?);
    let reflectance = args.reflectance;
    if let Some(value) = reflectance
        && !(value.min_element() > 0.0 && value.max_element() <= 1.0)
    {
        return Err(BallCommandError::Option {
            option: "reflectance",
            value: value.to_string(),
            allowed: "above 0, at most 1",
        });
    }
    let center = args.center.or(ball.map(|ball| ball.center_m));
    let known = ball.map(|ball| DVec3::from_array(ball.reflectance).as_vec3());
    Ok(BallPrior {
        center_m: center.ok_or_else(|| BallCommandError::NoCenter { file: file.to_owned() })?,
        radius_m: ball.map(|ball| ball.radius_m),
        measured_radius: radius.map(|(value_m, sigma_m)| Measured { value_m, sigma_m }),
        reflectance: reflectance
            .map(DVec3::as_vec3)
            .or(known)
            .unwrap_or(ball_fit::TYPICAL_REFLECTANCE),
    })
}
