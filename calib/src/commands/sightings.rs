//! Pictures to markers seen, for routines that work on rigs in parts.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use glam::DMat3;
use mirrorball_calib::{
    extrinsics::View,
    photometry::Photometry,
    response::ResponseCurve,
    rig::{Camera, RigDraft, RigError, RigParts},
    tag::{Family, Finder, PictureError},
};

use super::{
    explain::Explain,
    input::{InputError, Pictures},
    output::{OutputArgs, OutputError, draft},
};

/// A picture in which markers were looked for.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    /// Index of the camera that took it.
    pub(crate) camera: usize,
    /// When, in nanoseconds on the recording's clock; `None` in a folder of pictures.
    pub(crate) timestamp_ns: Option<u64>,
    /// Its name and the markers.
    pub(crate) view: View,
}

/// Why there are no sightings.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SightingsError {
    #[error("cannot read rig file `{}`", file.display())]
    Read {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("rig file `{}` is not usable", file.display())]
    Rig {
        file: PathBuf,
        #[source]
        source: Box<RigError>,
    },
    #[error("rig file `{}` has no camera `{name}` (there are: {present})", file.display())]
    NoCamera {
        file: PathBuf,
        name: String,
        present: String,
    },
    #[error("camera `{name}` in rig file `{}` has no lens yet", file.display())]
    NoLens { file: PathBuf, name: String },
    #[error("cannot search picture `{name}`")]
    Search {
        name: String,
        #[source]
        source: PictureError,
    },
    #[error("a folder of pictures does not say which of `{cameras}` cameras took them")]
    WhoseFolder { cameras: usize },
    #[error(transparent)]
    Input(#[from] InputError),
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl Explain for SightingsError {
    fn is_bad_input(&self) -> bool {
        match self {
            Self::Output(error) => error.is_bad_input(),
            _ => true,
        }
    }

    fn hint(&self) -> Option<&str> {
        match self {
            Self::Read { .. } => Some("give the rig file with `--rig`"),
            Self::Rig { source, .. } => source.hint(),
            Self::NoCamera { .. } => Some("choose one of these with `--camera`"),
            Self::NoLens { .. } => Some("find its lens first: `mirrorball-calib intrinsics`"),
            Self::Search { .. } => Some("`size_px` in the rig file must be the size of the camera's pictures"),
            Self::WhoseFolder { .. } => Some("give a recording with `--recording`"),
            Self::Input(error) => error.hint(),
            Self::Output(error) => error.hint(),
        }
    }
}

/// A rig file, whole or in parts.
pub(crate) struct RigText {
    file: PathBuf,
    text: String,
    pub(crate) parts: RigParts,
}

impl RigText {
    pub(crate) fn read(file: &Path) -> Result<Self, SightingsError> {
        let text = fs::read_to_string(file).map_err(|source| SightingsError::Read {
            file: file.to_owned(),
            source,
        })?;
        let parts = RigParts::from_toml(&text, file).map_err(|source| unusable(file, source))?;
        Ok(Self {
            file: file.to_owned(),
            text,
            parts,
        })
    }

    /// The camera with this name, whose lens must be known; photometry that is not known is sRGB's.
    pub(crate) fn camera(&self, name: &str) -> Result<Camera, SightingsError> {
        let Some(camera) = self.parts.camera(name) else {
            let present: Vec<String> = self.parts.cameras.iter().map(|c| format!("`{}`", c.name)).collect();
            return Err(SightingsError::NoCamera {
                file: self.file.clone(),
                name: name.to_owned(),
                present: if present.is_empty() {
                    "none".to_owned()
                } else {
                    present.join(", ")
                },
            });
        };
        let Some(intrinsics) = camera.intrinsics else {
            return Err(SightingsError::NoLens {
                file: self.file.clone(),
                name: name.to_owned(),
            });
        };
        Ok(Camera {
            name: camera.name.clone(),
            role: camera.role,
            intrinsics,
            photometry: camera.photometry.clone().unwrap_or_else(plain_photometry),
            camera_from_world: camera.camera_from_world,
        })
    }

    /// What the result is written into: the file named by `--out` if there is one, else a copy of this rig.
    pub(crate) fn draft(&self, output: &OutputArgs) -> Result<RigDraft, SightingsError> {
        match &output.out {
            Some(out) if out.exists() => Ok(draft(out)?),
            Some(_) | None => RigDraft::from_toml(&self.text, &self.file).map_err(|error| unusable(&self.file, error)),
        }
    }

    /// Families of the rig's markers; all of them when it has none yet.
    pub(crate) fn families(&self) -> Vec<Family> {
        let mut families: Vec<Family> = self.parts.markers.iter().map(|marker| marker.family).collect();
        families.sort();
        families.dedup();
        if families.is_empty() {
            Family::ALL.to_vec()
        } else {
            families
        }
    }

    /// Looks for markers in all pictures of these cameras, in the order of the input.
    pub(crate) fn look(&self, pictures: Pictures, cameras: &[Camera]) -> Result<Vec<Seen>, SightingsError> {
        let mut finder = Finder::new(&self.families());
        let mut all = Vec::new();
        for picture in pictures {
            let picture = picture?;
            let camera = match &picture.camera {
                Some(name) => cameras.iter().position(|camera| camera.name == *name),
                None if cameras.len() == 1 => Some(0),
                None => return Err(SightingsError::WhoseFolder { cameras: cameras.len() }),
            };
            let Some(camera) = camera else { continue };
            let size = [picture.rgb.width() as usize, picture.rgb.height() as usize];
            let detections = finder
                .find(picture.rgb.as_raw(), size, &cameras[camera])
                .map_err(|source| SightingsError::Search {
                    name: picture.name.clone(),
                    source,
                })?;
            all.push(Seen {
                camera,
                timestamp_ns: picture.timestamp_ns,
                view: View {
                    name: picture.name,
                    detections,
                },
            });
        }
        Ok(all)
    }
}

fn unusable(file: &Path, source: RigError) -> SightingsError {
    SightingsError::Rig {
        file: file.to_owned(),
        source: Box::new(source),
    }
}

/// A camera of which nothing is known but that its pictures are sRGB.
pub(crate) fn plain_photometry() -> Photometry {
    Photometry {
        sensitivity: 1.0,
        vignetting: [0.0, 0.0],
        full_well_e: 1e4,
        read_noise_e: 0.0,
        response: ResponseCurve::srgb(),
        color: DMat3::IDENTITY,
    }
}
