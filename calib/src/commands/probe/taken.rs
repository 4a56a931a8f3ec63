//! Pictures, with what is known of how they were taken.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use mirrorball_calib::rig::{Camera, Rig};
use mirrorball_capture::{
    Pace, Player, Repeat,
    frame::{Exposure, Frame, FrameMeta, PixelFormat, Size},
};

use super::ProbeError;
use crate::commands::{CommandError, no_camera};

/// What the command line says of the pictures.
pub(super) struct Options<'a> {
    pub(super) camera: Option<&'a str>,
    /// One for all pictures, or one each.
    pub(super) exposure_s: Option<&'a [f64]>,
    pub(super) gain: Option<f64>,
    pub(super) white_balance: Option<&'a [f64]>,
}

/// A picture of the probe.
pub(super) struct Taken<'a> {
    pub(super) file: PathBuf,
    pub(super) frame: Frame,
    pub(super) camera: &'a Camera,
}

/// Reads the pictures; all must be of one camera.
pub(super) fn pictures<'a>(
    files: &[PathBuf],
    rig: &'a Rig,
    rig_file: &Path,
    options: &Options<'_>,
) -> Result<Vec<Taken<'a>>, CommandError> {
    let mut camera_name = options.camera.map(str::to_owned);
    let mut pictures = Vec::new();
    if let Some(times) = options
        .exposure_s
        .filter(|times| ![1, files.len()].contains(&times.len()))
    {
        return Err(ProbeError::ExposureTimes {
            found: times.len(),
            pictures: files.len(),
        }
        .into());
    }
    for (index, file) in files.iter().enumerate() {
        let recorded = recorded(file)?;
        if let (Some(asked), Some(recorded)) = (&camera_name, &recorded)
            && *asked != *recorded.camera
        {
            return Err(ProbeError::OtherCamera {
                file: file.clone(),
                recorded: recorded.camera.to_string(),
                asked: asked.clone(),
            }
            .into());
        }
        let name = camera_name.get_or_insert_with(|| {
            let guess = rig.probe_camera().unwrap_or_else(|| rig.scene_camera());
            recorded
                .as_ref()
                .map_or(guess.name.clone(), |meta| meta.camera.to_string())
        });
        let camera = rig.camera(name).ok_or_else(|| no_camera(rig, rig_file, name))?;
        let exposure = exposure((index, file), recorded.as_ref().map(|meta| &meta.exposure), options)?;
        let sequence = recorded.as_ref().map_or(0, |meta| meta.sequence);
        let timestamp_ns = recorded.as_ref().map_or(0, |meta| meta.timestamp_ns);
        let meta = FrameMeta::new(Arc::from(name.as_str()), sequence, timestamp_ns, exposure);
        pictures.push(Taken {
            file: file.clone(),
            frame: read(file, camera, meta)?,
            camera,
        });
    }
    Ok(pictures)
}

/// What the recording says that the picture belongs to: the one of the nearest folder above it that has a `frames.csv` with
/// it.
fn recorded(file: &Path) -> Result<Option<FrameMeta>, CommandError> {
    // A picture that is not there is reported when it is read.
    let Ok(file) = file.canonicalize() else {
        return Ok(None);
    };
    for folder in file
        .ancestors()
        .skip(1)
        .filter(|folder| folder.join("frames.csv").is_file())
    {
        let player = Player::open(folder, Pace::Max, Repeat::ONCE).map_err(|source| CommandError::Recording {
            folder: folder.to_owned(),
            source: Box::new(source),
        })?;
        if let Some(meta) = player.meta_of(&file) {
            return Ok(Some(meta.clone()));
        }
    }
    Ok(None)
}

/// The exposure by the command line, else by the recording, else nothing but defaults for gain and white balance.
fn exposure(
    (index, file): (usize, &Path),
    recorded: Option<&Exposure>,
    options: &Options<'_>,
) -> Result<Exposure, ProbeError> {
    let given_s = options.exposure_s.and_then(|times| times.get(index).or(times.first()));
    let Some(time_s) = given_s.copied().or(recorded.map(|e| e.time_s)) else {
        return Err(ProbeError::NoExposure { file: file.to_owned() });
    };
    let wrong = |what: &'static str, found: String, allowed: &'static str| ProbeError::Exposure {
        file: file.to_owned(),
        what,
        found,
        allowed,
    };
    if !(1e-7..=100.0).contains(&time_s) {
        return Err(wrong("exposure time", format!("{time_s} s"), "1e-7 to 100 s"));
    }
    let gain = options.gain.or(recorded.map(|e| e.gain)).unwrap_or(1.0);
    if !(1e-3..=1e4).contains(&gain) {
        return Err(wrong("gain", gain.to_string(), "1e-3 to 1e4"));
    }
    let given = options.white_balance.map(<[f64]>::to_vec);
    let white_balance = given.unwrap_or_else(|| recorded.map_or(vec![1.0; 3], |e| e.white_balance.to_vec()));
    match white_balance[..] {
        [r, g, b] if [r, g, b].iter().all(|w| (1e-3..=1e3).contains(w)) => Ok(Exposure {
            time_s,
            gain,
            white_balance: [r, g, b],
        }),
        _ => {
            let found: Vec<String> = white_balance.iter().map(f64::to_string).collect();
            Err(wrong("white balance", found.join(","), "three numbers of 1e-3 to 1e3"))
        }
    }
}

fn read(file: &Path, camera: &Camera, meta: FrameMeta) -> Result<Frame, CommandError> {
    let picture = image::open(file)
        .map_err(|source| CommandError::ReadPicture {
            file: file.to_owned(),
            source,
        })?
        .into_rgb8();
    let found = [picture.width(), picture.height()];
    let expected = camera.intrinsics.size_px;
    if found != expected {
        return Err(ProbeError::Size {
            file: file.to_owned(),
            camera: camera.name.clone(),
            found,
            expected,
        }
        .into());
    }
    Ok(Frame {
        meta,
        size: Size {
            width: found[0],
            height: found[1],
        },
        format: PixelFormat::Rgb8,
        pixels: picture.into_raw().into(),
    })
}
