//! `photometric`: what a camera does to light.

mod error;
mod measure;
mod report;
mod series;

use std::{io::Write, path::PathBuf};

use mirrorball_calib::rig::Role;

use super::{CommandError, input::InputArgs, mask, output::OutputArgs, progress::Progress};
pub(crate) use error::PhotometricError;
use measure::Measured;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    input: InputArgs,
    /// Name of the camera, in the rig and in the recording.
    #[arg(long, value_name = "NAME")]
    camera: String,
    /// What the camera is for, if the rig does not have it yet.
    #[arg(long, value_name = "ROLE", default_value = "scene", value_parser = role)]
    role: Role,
    /// Table `file,exposure_s,gain` of the pictures; without it their EXIF data is read.
    #[arg(long, value_name = "FILE.csv", conflicts_with = "recording")]
    exposures: Option<PathBuf>,
    /// Where the response comes from.
    #[arg(long, value_name = "WHAT", value_enum, default_value_t = ResponseFrom::Fit)]
    response: ResponseFrom,
    /// Folder of pictures of an evenly lit white sheet, taken with fixed exposure: vignetting.
    #[arg(long, value_name = "DIR")]
    flat: Option<PathBuf>,
    /// Folder of pictures with the lens covered: black level.
    #[arg(long, value_name = "DIR")]
    dark: Option<PathBuf>,
    /// Colour of pixels that show nothing, such as the borders of registered pictures.
    #[arg(long, value_name = "R,G,B", value_parser = mask::rgb)]
    mask_rgb: Option<[u8; 3]>,
    /// Table `frame,exposure_s,gain` of requests: from which frame on another exposure was asked for. Control latency.
    #[arg(long, value_name = "FILE.csv")]
    requests: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// Where the response comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ResponseFrom {
    /// One curve fitted to the bracket, for all channels.
    Fit,
    /// A curve fitted per channel: to look at, not for a rig.
    FitChannels,
    /// The sRGB curve.
    Srgb,
}

fn role(name: &str) -> Result<Role, String> {
    let found = Role::ALL.into_iter().find(|role| role.name() == name);
    found.ok_or_else(|| "`scene`, `ball` or `fisheye`".to_owned())
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.output.check()?;
    if args.output.out.is_some() && args.response == ResponseFrom::FitChannels {
        return Err(PhotometricError::ChannelsToRig.into());
    }
    let series = series::read(args)?;
    let measured = {
        let _progress = Progress::solve("measuring response, noise and vignetting");
        measure::measure(args, &series)?
    };
    report::write_summary(out, &series, &measured).map_err(CommandError::Output)?;
    args.output.write_json(&report::Numbers::new(&series, &measured))?;
    args.output
        .write_report(|| report::page(&args.camera, &series, &measured))?;
    // Last: what cannot go into the rig is measured all the same, and a rig that has changed has its numbers beside it.
    if let Some(file) = &args.output.out {
        let mut draft = super::output::draft(file)?;
        let parts = draft.parts(file).map_err(|source| CommandError::Rig {
            file: file.clone(),
            source: Box::new(source),
        })?;
        let known = parts.camera(&args.camera);
        if known.is_none() {
            draft.set_camera(&args.camera, args.role, series.size_px);
        }
        let photometry = measured.photometry(known.and_then(|camera| camera.photometry.as_ref()))?;
        draft.set_photometry(&args.camera, &photometry);
        args.output.write_rig(&draft)?;
    }
    Ok(())
}
