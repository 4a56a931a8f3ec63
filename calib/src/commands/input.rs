//! Where a routine's pictures come from: a folder, a recording, a camera. One at a time, so that hundreds need no memory.

use std::{
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use image::RgbImage;
use mirrorball_capture::{
    DecodeError, Exposure, Next, Pace, Repeat, Source, SourceError, decode::to_rgb8, recording::open_recording,
};

use super::explain::Explain;

/// How long to wait for a frame before asking again; a recording played as fast as possible never takes that long.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Where the pictures are.
#[derive(Debug, Clone, clap::Args)]
#[group(id = "input", required = true, multiple = false)]
pub(crate) struct InputArgs {
    /// Folder of pictures (PNG or JPEG), taken in the order of their names.
    #[arg(long, value_name = "DIR")]
    pub(crate) images: Option<PathBuf>,
    /// Recording: a folder with `frames.csv`, or an MCAP file.
    #[arg(long, value_name = "PATH")]
    pub(crate) recording: Option<PathBuf>,
}

/// A picture and what is known about it.
#[derive(Debug, Clone)]
pub(crate) struct Picture {
    /// File name, or number of the frame.
    pub(crate) name: String,
    /// The camera that took it; `None` in a folder of pictures.
    pub(crate) camera: Option<String>,
    /// The camera's own count; `None` in a folder of pictures.
    pub(crate) sequence: Option<u64>,
    /// When, in nanoseconds on the recording's clock.
    pub(crate) timestamp_ns: Option<u64>,
    /// Exposure time, gain and white balance that were in force.
    pub(crate) exposure: Option<Exposure>,
    /// Encoded pixels.
    pub(crate) rgb: RgbImage,
}

/// Why pictures cannot be had.
#[derive(Debug, thiserror::Error)]
pub(crate) enum InputError {
    #[error("cannot read folder `{}`", folder.display())]
    Folder {
        folder: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("folder `{}` holds no picture (allowed: `.png`, `.jpg`, `.jpeg`)", folder.display())]
    Empty { folder: PathBuf },
    #[error("cannot read picture `{}`", file.display())]
    Picture {
        file: PathBuf,
        #[source]
        source: image::ImageError,
    },
    #[error("cannot play recording `{}`", path.display())]
    Recording {
        path: PathBuf,
        #[source]
        source: Box<SourceError>,
    },
    #[error("cannot decode frame `{name}`")]
    Decode {
        name: String,
        #[source]
        source: DecodeError,
    },
}

impl Explain for InputError {
    fn is_bad_input(&self) -> bool {
        true
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::Folder { .. } | Self::Empty { .. } => "give a folder of PNG or JPEG pictures",
            Self::Picture { .. } | Self::Decode { .. } => "remove the damaged picture, or take it anew",
            Self::Recording { source, .. } => source.hint(),
        })
    }
}

/// Pictures, one after the other.
pub(crate) struct Pictures {
    origin: Origin,
}

enum Origin {
    Files(std::vec::IntoIter<PathBuf>),
    Recording { path: PathBuf, source: Box<dyn Source> },
}

impl InputArgs {
    /// Opens the input.
    pub(crate) fn open(&self) -> Result<Pictures, InputError> {
        let origin = match (&self.images, &self.recording) {
            (Some(folder), _) => Origin::Files(files(folder)?.into_iter()),
            (None, Some(path)) => Origin::Recording {
                path: path.clone(),
                source: open_recording(path, Pace::Max, Repeat::ONCE).map_err(|source| InputError::Recording {
                    path: path.clone(),
                    source: Box::new(source),
                })?,
            },
            (None, None) => unreachable!("clap demands one of them"),
        };
        Ok(Pictures { origin })
    }
}

impl Pictures {
    /// How many pictures there will be, where that is known: for a progress bar.
    pub(crate) fn expected(&self) -> Option<usize> {
        match &self.origin {
            Origin::Files(files) => Some(files.len()),
            Origin::Recording { .. } => None,
        }
    }
}

impl Iterator for Pictures {
    type Item = Result<Picture, InputError>;

    fn next(&mut self) -> Option<Self::Item> {
        match &mut self.origin {
            Origin::Files(files) => files.next().map(|file| read(&file)),
            Origin::Recording { path, source } => loop {
                match source.next_frame(TIMEOUT) {
                    Ok(Next::Frame(frame)) => return Some(picture(&frame)),
                    Ok(Next::TimedOut) => {}
                    Ok(Next::End) => return None,
                    Err(source) => {
                        return Some(Err(InputError::Recording {
                            path: path.clone(),
                            source: Box::new(source),
                        }));
                    }
                }
            },
        }
    }
}

/// The pictures in a folder, by name.
fn files(folder: &Path) -> Result<Vec<PathBuf>, InputError> {
    let failed = |source| InputError::Folder {
        folder: folder.to_owned(),
        source,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let extension = file.extension().and_then(|extension| extension.to_str());
        if extension.is_some_and(|e| ["png", "jpg", "jpeg"].contains(&e.to_ascii_lowercase().as_str())) {
            files.push(file);
        }
    }
    if files.is_empty() {
        return Err(InputError::Empty {
            folder: folder.to_owned(),
        });
    }
    files.sort();
    Ok(files)
}

fn read(file: &Path) -> Result<Picture, InputError> {
    let rgb = image::open(file).map_err(|source| InputError::Picture {
        file: file.to_owned(),
        source,
    })?;
    Ok(Picture {
        name: file
            .file_name()
            .unwrap_or(file.as_os_str())
            .to_string_lossy()
            .into_owned(),
        camera: None,
        sequence: None,
        timestamp_ns: None,
        exposure: None,
        rgb: rgb.into_rgb8(),
    })
}

fn picture(frame: &mirrorball_capture::Frame) -> Result<Picture, InputError> {
    let name = format!("{} {}", frame.meta.camera, frame.meta.sequence);
    let decoded = to_rgb8(frame).map_err(|source| InputError::Decode {
        name: name.clone(),
        source,
    })?;
    let rgb = RgbImage::from_raw(decoded.size.width, decoded.size.height, decoded.pixels.to_vec());
    Ok(Picture {
        name,
        camera: Some(frame.meta.camera.to_string()),
        sequence: Some(frame.meta.sequence),
        timestamp_ns: Some(frame.meta.timestamp_ns),
        exposure: Some(frame.meta.exposure),
        rgb: rgb.expect("a decoded frame has three bytes per pixel"),
    })
}
