//! Writes an image-folder recording.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError};

use super::format::COLUMNS;
use super::rig::parse_cameras;
use crate::decode::{DecodeError, to_rgb8};
use crate::frame::{Frame, FrameMeta, PixelFormat};
use crate::source::{CameraDescription, SourceError};

/// Why an image folder cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The folder has something in it.
    #[error("cannot write a recording to `{}`: it is no empty folder", path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// A file or folder cannot be written.
    #[error("cannot write `{}`", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        #[source]
        source: io::Error,
    },
    /// A picture cannot be written.
    #[error("cannot write picture `{}`", path.display())]
    Picture {
        /// The file.
        path: PathBuf,
        /// What the encoder said.
        #[source]
        source: ImageError,
    },
    /// A frame cannot be decoded; the others can.
    #[error("cannot decode frame {sequence} of camera `{camera}`")]
    Decode {
        /// Name of the camera.
        camera: String,
        /// Sequence number of the frame.
        sequence: u64,
        /// What is wrong.
        #[source]
        source: DecodeError,
    },
    /// The rig file is bad.
    #[error(transparent)]
    Rig(#[from] Box<SourceError>),
    /// The rig file does not go with a camera.
    #[error("the rig file does not have camera `{camera}` with role `{role}` and size {width}×{height} px")]
    OtherRig {
        /// Name of the camera.
        camera: String,
        /// Its role.
        role: &'static str,
        /// Width of its frames.
        width: u32,
        /// Height of its frames.
        height: u32,
    },
}

impl FolderError {
    /// True if only one frame is lost and writing can go on.
    #[must_use]
    pub fn is_skippable(&self) -> bool {
        matches!(self, Self::Decode { .. })
    }

    /// True if the user's input is to blame.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Write { .. } | Self::Picture { .. })
    }

    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::NotEmpty { .. } => "give a folder that does not exist yet",
            Self::Write { .. } | Self::Picture { .. } => "look for room and permissions on the disk",
            Self::Decode { .. } => "the camera has sent a broken picture; the others can be used",
            Self::Rig(error) => error.hint(),
            Self::OtherRig { .. } => "give the rig file of these cameras with `--rig`",
        }
    }
}

/// An image-folder recording being written: PNG, or JPEG as the camera sent it.
#[derive(Debug)]
pub struct FolderWriter {
    folder: PathBuf,
    cameras: Vec<CameraDescription>,
    /// For each camera the folder of its pictures.
    picture_folders: Vec<String>,
    lines: Vec<(FrameMeta, String)>,
}

impl FolderWriter {
    /// Makes the folder, which must not exist or be empty, and writes the rig file into it.
    ///
    /// # Errors
    ///
    /// [`FolderError`] if the folder is in use or cannot be made, or the rig file is not that of the cameras.
    pub fn create(folder: &Path, cameras: &[CameraDescription], rig: &str) -> Result<Self, FolderError> {
        check_rig(folder, cameras, rig)?;
        let write_error = |path: &Path| {
            let path = path.to_path_buf();
            |source| FolderError::Write { path, source }
        };
        fs::create_dir_all(folder).map_err(write_error(folder))?;
        if fs::read_dir(folder).map_err(write_error(folder))?.next().is_some() {
            return Err(FolderError::NotEmpty {
                path: folder.to_path_buf(),
            });
        }
        let picture_folders = picture_folders(cameras);
        for name in &picture_folders {
            let path = folder.join(name);
            fs::create_dir(&path).map_err(write_error(&path))?;
        }
        let path = folder.join("rig.toml");
        fs::write(&path, rig).map_err(write_error(&path))?;
        Ok(Self {
            folder: folder.to_path_buf(),
            cameras: cameras.to_vec(),
            picture_folders,
            lines: Vec::new(),
        })
    }

    /// Writes a frame of one of the cameras.
    ///
    /// # Errors
    ///
    /// [`FolderError`]; after one that is skippable the frame is left out.
    pub fn write(&mut self, frame: &Frame) -> Result<(), FolderError> {
        let index = self.cameras.iter().position(|camera| camera.name == frame.meta.camera);
        let picture_folder = &self.picture_folders[index.unwrap_or(0)];
        let ending = if frame.format == PixelFormat::Mjpeg {
            "jpg"
        } else {
            "png"
        };
        let file = format!("{picture_folder}/{:06}.{ending}", frame.meta.sequence);
        let path = self.folder.join(&file);
        if frame.format == PixelFormat::Mjpeg {
            fs::write(&path, &*frame.pixels).map_err(|source| FolderError::Write { path, source })?;
        } else {
            write_png(&path, frame)?;
        }
        self.lines.push((frame.meta.clone(), file));
        Ok(())
    }

    /// Writes the frame list and returns the number of frames in it.
    ///
    /// # Errors
    ///
    /// [`FolderError::Write`].
    pub fn finish(mut self) -> Result<usize, FolderError> {
        // Cameras' frames may have come in any order; the list is in that of time.
        self.lines.sort_by_key(|(meta, _)| meta.timestamp_ns);
        let path = self.folder.join("frames.csv");
        self.write_list(&path)
            .map_err(|source| FolderError::Write { path, source })?;
        Ok(self.lines.len())
    }

    fn write_list(&self, path: &Path) -> io::Result<()> {
        let mut list = csv::Writer::from_writer(BufWriter::new(File::create(path)?));
        list.write_record(COLUMNS)?;
        for (meta, file) in &self.lines {
            let exposure = &meta.exposure;
            // As Rust prints them for people who look closely: what is read again is the same number.
            let text = |value: f64| format!("{value:?}");
            let [r, g, b] = exposure.white_balance.map(text);
            list.write_record([
                meta.camera.to_string(),
                meta.sequence.to_string(),
                meta.timestamp_ns.to_string(),
                file.clone(),
                text(exposure.time_s),
                text(exposure.gain),
                r,
                g,
                b,
            ])?;
        }
        list.flush()
    }
}

fn check_rig(folder: &Path, cameras: &[CameraDescription], rig: &str) -> Result<(), FolderError> {
    let rig_cameras = parse_cameras(&folder.join("rig.toml"), rig).map_err(Box::new)?;
    for camera in cameras {
        let is_same = |other: &CameraDescription| {
            (&other.name, other.role, other.size) == (&camera.name, camera.role, camera.size)
        };
        if !rig_cameras.iter().any(is_same) {
            return Err(FolderError::OtherRig {
                camera: camera.name.to_string(),
                role: super::mcap::role_name(camera.role),
                width: camera.size.width,
                height: camera.size.height,
            });
        }
    }
    Ok(())
}

/// Names of folders for the cameras' pictures: their own where a folder may be called so.
fn picture_folders(cameras: &[CameraDescription]) -> Vec<String> {
    let is_plain = |name: &str| name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_');
    let mut taken = HashSet::new();
    let folder = |(index, camera): (usize, &CameraDescription)| {
        // On some file systems capitals are not told apart.
        if is_plain(&camera.name) && taken.insert(camera.name.to_lowercase()) {
            camera.name.to_string()
        } else {
            format!("camera.{index}")
        }
    };
    cameras.iter().enumerate().map(folder).collect()
}

fn write_png(path: &Path, frame: &Frame) -> Result<(), FolderError> {
    let rgb = to_rgb8(frame).map_err(|source| FolderError::Decode {
        camera: frame.meta.camera.to_string(),
        sequence: frame.meta.sequence,
        source,
    })?;
    let write_error = |source| FolderError::Write {
        path: path.to_path_buf(),
        source,
    };
    let mut file = BufWriter::new(File::create(path).map_err(write_error)?);
    let encoder = PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Adaptive);
    encoder
        .write_image(&rgb.pixels, rgb.size.width, rgb.size.height, ExtendedColorType::Rgb8)
        .map_err(|source| FolderError::Picture {
            path: path.to_path_buf(),
            source,
        })?;
    file.flush().map_err(write_error)
}
