//! `convert`: cameras from the files of OpenCV, ROS and Kalibr, or from a rig file, to any of these.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use clap::ValueEnum;
use mirrorball_calib::{
    interchange::{ForeignCamera, Format, InterchangeError},
    pose::Pose,
    rig::{RigDraft, RigError, RigParts, Role},
};

use super::{
    CommandError,
    explain::Explain,
    output::{OutputArgs, draft, write_file},
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// File to read: a rig file, OpenCV's or ROS' YAML of one camera, or Kalibr's `camchain.yaml`; which one it is it shows
    /// itself.
    file: PathBuf,
    /// What to write.
    #[arg(long, value_enum)]
    to: Target,
    /// Take this camera only.
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Call the one camera so in what is written.
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// File to write; printed when not given. Into a rig file that is there the lenses are put, and the old file is kept as
    /// `FILE.old`.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

impl Args {
    fn output(&self) -> OutputArgs {
        OutputArgs {
            out: self.out.clone(),
            json: None,
            report: None,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Target {
    Opencv,
    Ros,
    Kalibr,
    Rig,
}

/// Why a file cannot be converted.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConvertError {
    #[error("cannot read `{}`", file.display())]
    Read {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("`{}` is neither a rig file nor one of OpenCV, ROS or Kalibr", file.display())]
    Unknown { file: PathBuf },
    #[error("rig file `{}` is not usable", file.display())]
    Rig {
        file: PathBuf,
        #[source]
        source: Box<RigError>,
    },
    #[error("cannot convert the cameras of `{}`", file.display())]
    Interchange {
        file: PathBuf,
        #[source]
        source: Box<InterchangeError>,
    },
    #[error("`{}` has no camera `{name}` with a lens (there are: {present})", file.display())]
    NoCamera {
        file: PathBuf,
        name: String,
        present: String,
    },
    #[error("`--name` names one camera, but `{}` has `{found}`", file.display())]
    Names { file: PathBuf, found: usize },
    #[error("`{}` has no camera with a lens", file.display())]
    Empty { file: PathBuf },
}

impl Explain for ConvertError {
    fn is_bad_input(&self) -> bool {
        true
    }

    fn hint(&self) -> Option<&str> {
        match self {
            Self::Unknown { .. } => Some(
                "OpenCV's and ROS' files have a line that begins with `camera_matrix:`, Kalibr's with `cam0:`, rig files with \
                 `[[camera]]`",
            ),
            Self::Rig { source, .. } => source.hint(),
            Self::Interchange { source, .. } => source.hint(),
            Self::NoCamera { .. } | Self::Names { .. } => Some("choose one of these with `--camera`"),
            Self::Empty { .. } => Some("measure the lens with `mirrorball-calib intrinsics`"),
            Self::Read { .. } => None,
        }
    }
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    args.output().check()?;
    let cameras = chosen(args)?;
    let format = match args.to {
        Target::Rig => return to_rig(args, &cameras, out),
        Target::Opencv => Format::Opencv,
        Target::Ros => Format::Ros,
        Target::Kalibr => Format::Kalibr,
    };
    let text = format.write(&cameras).map_err(|source| ConvertError::Interchange {
        file: args.file.clone(),
        source: Box::new(source),
    })?;
    match &args.out {
        Some(file) => Ok(write_file(file, text.as_bytes())?),
        None => out.write_all(text.as_bytes()).map_err(CommandError::Output),
    }
}

/// The cameras to convert, by their new name.
fn chosen(args: &Args) -> Result<Vec<ForeignCamera>, ConvertError> {
    let file = &args.file;
    let mut cameras = read(file)?;
    if cameras.is_empty() {
        return Err(ConvertError::Empty { file: file.clone() });
    }
    if let Some(name) = &args.camera {
        let Some(camera) = cameras.iter().find(|camera| camera.name == *name) else {
            return Err(ConvertError::NoCamera {
                file: file.clone(),
                name: name.clone(),
                present: cameras
                    .iter()
                    .map(|camera| format!("`{}`", camera.name))
                    .collect::<Vec<_>>()
                    .join(", "),
            });
        };
        cameras = vec![camera.clone()];
    }
    if let Some(name) = &args.name {
        let [camera] = &mut cameras[..] else {
            return Err(ConvertError::Names {
                file: file.clone(),
                found: cameras.len(),
            });
        };
        camera.name.clone_from(name);
    }
    Ok(cameras)
}

fn read(file: &Path) -> Result<Vec<ForeignCamera>, ConvertError> {
    let text = fs::read_to_string(file).map_err(|source| ConvertError::Read {
        file: file.to_owned(),
        source,
    })?;
    if let Some(format) = Format::of(&text) {
        return format.read(&text, file).map_err(|source| ConvertError::Interchange {
            file: file.to_owned(),
            source: Box::new(source),
        });
    }
    if !text.lines().any(|line| line.trim() == "[[camera]]") {
        return Err(ConvertError::Unknown { file: file.to_owned() });
    }
    let parts = RigParts::from_toml(&text, file).map_err(|source| ConvertError::Rig {
        file: file.to_owned(),
        source: Box::new(source),
    })?;
    Ok(of_rig(&parts))
}

/// The cameras of a rig that have a lens, with the pose relative to the one before where both stand still.
fn of_rig(parts: &RigParts) -> Vec<ForeignCamera> {
    let mut cameras: Vec<ForeignCamera> = Vec::new();
    let mut previous_from_world: Option<Pose> = None;
    for camera in &parts.cameras {
        let Some(intrinsics) = camera.intrinsics else { continue };
        let camera_from_world = camera.camera_from_world;
        let both = camera_from_world.zip(previous_from_world);
        cameras.push(ForeignCamera {
            name: camera.name.clone(),
            intrinsics,
            camera_from_previous: both.map(|(camera, previous)| camera * previous.inverse()),
        });
        previous_from_world = camera_from_world;
    }
    cameras
}

/// Puts the lenses into a rig file. Cameras that it does not have become `scene` cameras, since nothing says where they stand.
fn to_rig(args: &Args, cameras: &[ForeignCamera], out: &mut impl Write) -> Result<(), CommandError> {
    let none = PathBuf::from("rig.toml");
    let file = args.out.as_ref().unwrap_or(&none);
    let rig_error = |source| ConvertError::Rig {
        file: file.clone(),
        source: Box::new(source),
    };
    let mut draft = match &args.out {
        Some(file) => draft(file)?,
        None => RigDraft::new(),
    };
    let before = draft.parts(file).map_err(rig_error)?;
    for camera in cameras {
        let role = before.camera(&camera.name).map_or(Role::Scene, |camera| camera.role);
        draft.set_camera(&camera.name, role, camera.intrinsics.size_px);
        draft.set_lens(&camera.name, &camera.intrinsics);
    }
    draft.parts(file).map_err(rig_error)?;
    if cameras.iter().any(|camera| camera.camera_from_previous.is_some()) {
        tracing::warn!("the cameras' poses are left out: a rig file places cameras in the world of its markers");
    }
    if args.out.is_none() {
        return out.write_all(draft.to_toml().as_bytes()).map_err(CommandError::Output);
    }
    Ok(args.output().write_rig(&draft)?)
}
