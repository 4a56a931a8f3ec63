//! Where a routine's pictures come from: a folder, a recording, a camera. One at a time, so that hundreds need no memory.

mod collect;
mod live;

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::Duration,
};

use image::RgbImage;
use mirrorball_capture::{
    DecodeError, Exposure, Next, Pace, Repeat, Source, SourceError,
    decode::to_rgb8,
    recording::open_recording,
    v4l2::{CameraAddress, StreamError, V4l2Error},
};

use super::{explain::Explain, progress::Progress};
pub(crate) use collect::{Verdict, collect};
use live::Live;
pub(crate) use live::LiveArgs;

/// How long to wait for a frame before asking again; a recording played as fast as possible never takes that long.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Where the pictures are: exactly one of folder, recording and camera. They name their group themselves, as `clap` puts no
/// field into the group of a struct that has others flattened into it.
#[derive(Debug, Clone, clap::Args)]
#[group(id = "input", required = true, multiple = false)]
pub(crate) struct InputArgs {
    /// Folder of pictures (PNG or JPEG), taken in the order of their names.
    #[arg(long, value_name = "DIR", group = "input")]
    pub(crate) images: Option<PathBuf>,
    /// Recording: a folder with `frames.csv`, or an MCAP file.
    #[arg(long, value_name = "PATH", group = "input")]
    pub(crate) recording: Option<PathBuf>,
    /// Camera: its device node, or its name as `mirrorball-capture devices` lists it. Ctrl-C ends the collection and goes on
    /// with what was gathered.
    #[arg(long, value_name = "ADDRESS", group = "input", requires = "size")]
    pub(crate) device: Option<CameraAddress>,
    #[command(flatten)]
    pub(crate) live: LiveArgs,
}

/// A picture and what is known about it.
#[derive(Debug, Clone)]
pub(crate) struct Picture {
    /// File name, or number of the frame, with its camera in a recording.
    pub(crate) name: String,
    /// The camera that took it; `None` in a folder of pictures.
    pub(crate) camera: Option<String>,
    /// The camera's own count; `None` in a folder of pictures.
    pub(crate) sequence: Option<u64>,
    /// When, in nanoseconds on the recording's clock.
    pub(crate) timestamp_ns: Option<u64>,
    /// Exposure time, gain and white balance that were in force. From a camera at work only the time is known, and that only
    /// while the camera does not change it by itself.
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
    #[error("cannot use camera `{address}`")]
    Camera {
        address: String,
        #[source]
        source: Box<V4l2Error>,
    },
    #[error("camera `{address}` has stopped")]
    Stream {
        address: String,
        #[source]
        source: Box<StreamError>,
    },
    #[error("camera `{address}` sends no pictures")]
    Silent { address: String },
    #[error("cannot listen for Ctrl-C")]
    Signals(#[source] io::Error),
    #[error("cannot keep picture `{}`", file.display())]
    Keep {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
}

impl Explain for InputError {
    fn is_bad_input(&self) -> bool {
        match self {
            Self::Folder { .. }
            | Self::Empty { .. }
            | Self::Picture { .. }
            | Self::Recording { .. }
            | Self::Decode { .. }
            | Self::Camera { .. } => true,
            Self::Stream { .. } | Self::Silent { .. } | Self::Signals(_) | Self::Keep { .. } => false,
        }
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::Folder { .. } | Self::Empty { .. } => "give a folder of PNG or JPEG pictures",
            Self::Picture { .. } | Self::Decode { .. } => "remove the damaged picture, or take it anew",
            Self::Recording { source, .. } => source.hint(),
            Self::Camera { source, .. } => camera_hint(source),
            Self::Stream { source, .. } => source.hint(),
            Self::Silent { .. } => "`mirrorball-capture doctor` looks for the cause",
            Self::Signals(_) => return None,
            Self::Keep { .. } => "give a folder that can be written to with `--keep`",
        })
    }
}

/// What to do about a camera that cannot be used; without the sentences that need its name.
fn camera_hint(error: &V4l2Error) -> &'static str {
    match error {
        V4l2Error::NoSuchCamera { .. } | V4l2Error::NotACamera { .. } => {
            "`mirrorball-capture devices` lists the cameras"
        }
        V4l2Error::Ambiguous { .. } => "add the USB port, as in `NAME@usb-0000:00:14.0-1`",
        V4l2Error::NoPermission { .. } => "add the user to the group that owns the camera, usually `video`",
        V4l2Error::Busy { .. } => {
            "end the other program, such as the capture daemon; one at a time can have the camera"
        }
        V4l2Error::Unplugged { .. } => "plug it in again",
        V4l2Error::FormatRefused { .. } => "choose another `--size`; `mirrorball-capture devices` lists all",
        V4l2Error::Call { .. } => "`mirrorball-capture doctor` looks for the cause; the kernel's log may say more",
    }
}

/// Pictures, one after the other. While they come, a line on the terminal says how many have.
pub(crate) struct Pictures {
    origin: Origin,
    progress: Progress,
    /// Where pictures that are used are saved.
    keep: Option<PathBuf>,
}

enum Origin {
    Files(std::vec::IntoIter<PathBuf>),
    Recording { path: PathBuf, source: Box<dyn Source> },
    Live(Box<Live>),
}

impl InputArgs {
    /// Opens the input.
    pub(crate) fn open(&self) -> Result<Pictures, InputError> {
        if let Some(address) = &self.device {
            return self.live.pictures(address);
        }
        match (&self.images, &self.recording) {
            (Some(folder), _) => Pictures::of_folder(folder),
            (None, Some(path)) => Pictures::of_recording(path),
            (None, None) => unreachable!("clap demands one of them"),
        }
    }
}

impl LiveArgs {
    /// Opens the camera.
    pub(crate) fn pictures(&self, address: &CameraAddress) -> Result<Pictures, InputError> {
        if let Some(folder) = &self.keep {
            fs::create_dir_all(folder).map_err(|source| InputError::Keep {
                file: folder.clone(),
                source,
            })?;
        }
        let live = Box::new(self.open(address)?);
        Ok(Pictures::new(Origin::Live(live), self.keep.clone()))
    }
}

impl Pictures {
    fn new(origin: Origin, keep: Option<PathBuf>) -> Self {
        // The frames of a recording are not counted before it is played.
        let expected = match &origin {
            Origin::Files(files) => Some(files.len()),
            Origin::Recording { .. } => None,
            Origin::Live(live) => live.expected(),
        };
        Self {
            origin,
            progress: Progress::pictures(expected),
            keep,
        }
    }

    /// The pictures in a folder, by name.
    pub(crate) fn of_folder(folder: &Path) -> Result<Self, InputError> {
        Ok(Self::new(Origin::Files(files(folder)?.into_iter()), None))
    }

    /// The frames of a recording, in the order of time.
    pub(crate) fn of_recording(path: &Path) -> Result<Self, InputError> {
        let source = open_recording(path, Pace::Max, Repeat::ONCE).map_err(|source| InputError::Recording {
            path: path.to_owned(),
            source: Box::new(source),
        })?;
        let origin = Origin::Recording {
            path: path.to_owned(),
            source,
        };
        Ok(Self::new(origin, None))
    }

    /// The same without the line on the terminal: for those who print one for each picture.
    pub(crate) fn without_progress(self) -> Self {
        Self {
            progress: Progress::hidden(),
            ..self
        }
    }

    /// Whether a person stands before the camera now, who can be told what to do.
    fn is_live(&self) -> bool {
        matches!(self.origin, Origin::Live(_))
    }

    /// Saves a picture that is used, if pictures are to be kept.
    pub(crate) fn keep(&self, picture: &Picture) -> Result<(), InputError> {
        let Some(folder) = &self.keep else { return Ok(()) };
        let file = folder.join(format!("{}.png", picture.name));
        picture.rgb.save(&file).map_err(live::keep_error(file))
    }
}

impl Iterator for Pictures {
    type Item = Result<Picture, InputError>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.origin.next();
        if let Some(Ok(picture)) = &next {
            self.progress.tick(&picture.name);
        }
        next
    }
}

impl Origin {
    fn next(&mut self) -> Option<Result<Picture, InputError>> {
        match self {
            Self::Files(files) => files.next().map(|file| read(&file)),
            Self::Live(live) => live.next(),
            Self::Recording { path, source } => loop {
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
    for entry in fs::read_dir(folder).map_err(failed)? {
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
