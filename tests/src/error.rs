//! What can go wrong while reading a truth folder, an output folder or a recording, and while writing results.

use std::path::PathBuf;

/// Why the score tool or the demo sheet gave up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ToolError {
    /// A file that must be there is missing or cannot be opened.
    #[error("cannot read `{}`, {role}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the file is, as a phrase: "the composite of frame 4".
        role: String,
        /// What the system said.
        #[source]
        source: std::io::Error,
    },
    /// A JSON text lacks a key or has a value of the wrong kind.
    #[error("cannot understand `{}`{}", path.display(), line.map(|line| format!(" line {line}")).unwrap_or_default())]
    Json {
        /// The file.
        path: PathBuf,
        /// The line, for files with one JSON object per line.
        line: Option<usize>,
        /// What the parser said.
        #[source]
        source: serde_json::Error,
    },
    /// A TOML text lacks a key or has a value of the wrong kind.
    #[error("cannot understand `{}`", path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        #[source]
        source: Box<toml::de::Error>,
    },
    /// A line of `frames.csv` lacks a column or has a value of the wrong kind.
    #[error("cannot understand `{}`", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        #[source]
        source: csv::Error,
    },
    /// The truth folder is of another kind or version than this tool knows.
    #[error("`{}` has format `{format}` version `{version}`; known is `mirrorball-truth` version `1`", path.display())]
    TruthVersion {
        /// The meta.json.
        path: PathBuf,
        /// The format it names.
        format: String,
        /// The version it names.
        version: u32,
    },
    /// Two entries speak of one frame.
    #[error("`{}` line {line} repeats frame `{frame}`", path.display())]
    RepeatedFrame {
        /// The frames.jsonl.
        path: PathBuf,
        /// The line of the second entry.
        line: usize,
        /// The frame.
        frame: u32,
    },
    /// A pose is not a rotation and a translation.
    #[error(
        "`camera_from_world` of frame `{frame}` in `{}` is not a rigid motion: rotation off by `{deviation}`",
        path.display()
    )]
    NotRigid {
        /// The frames.jsonl or meta.json.
        path: PathBuf,
        /// The frame.
        frame: u32,
        /// Largest entry of the deviation of RᵀR from identity, or of the determinant from 1.
        deviation: f64,
    },
    /// A picture cannot be decoded.
    #[error("cannot decode `{}`, {role}", path.display())]
    Picture {
        /// The file.
        path: PathBuf,
        /// What the file is, as a phrase.
        role: String,
        /// What the decoder said.
        #[source]
        source: image::ImageError,
    },
    /// A picture has another pixel format than the file formats say.
    #[error("`{}`, {role}, has pixels of kind `{found}`; allowed is `{allowed}`", path.display())]
    PixelKind {
        /// The file.
        path: PathBuf,
        /// What the file is, as a phrase.
        role: String,
        /// Its pixels.
        found: String,
        /// The pixels that are read.
        allowed: &'static str,
    },
    /// A picture or map has the wrong size.
    #[error(
        "`{}`, {role}, is `{} x {}` pixels; expected are `{} x {}`",
        path.display(), found_px[0], found_px[1], expected_px[0], expected_px[1]
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// What the file is, as a phrase.
        role: String,
        /// Width and height it has.
        found_px: [usize; 2],
        /// Width and height it should have.
        expected_px: [usize; 2],
    },
    /// An environment map cannot be decoded.
    #[error("cannot decode `{}`, an environment map", path.display())]
    Exr {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        #[source]
        source: exr::error::Error,
    },
    /// An environment map holds a value that is not a radiance.
    #[error("`{}` holds `{value}` in column {column}, row {row}; a radiance is finite", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The value.
        value: f32,
        /// Column of the texel, from the left.
        column: usize,
        /// Row of the texel, from the top.
        row: usize,
    },
    /// The rig has no camera of role `scene`.
    #[error("`{}` has no camera of role `scene`", path.display())]
    NoSceneCamera {
        /// The rig.toml.
        path: PathBuf,
    },
    /// The output folder holds no composite of the recording.
    #[error("`{}` holds no composite of a frame that `{}` lists", composites.display(), frames.display())]
    NoComposites {
        /// The folder of composites.
        composites: PathBuf,
        /// The frames.csv.
        frames: PathBuf,
    },
    /// The preview's name does not end as an animation does.
    #[error("cannot write `{}`: the preview is a `.gif`", path.display())]
    PreviewKind {
        /// The name.
        path: PathBuf,
    },
    /// A result cannot be written.
    #[error("cannot write `{}`", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system or the encoder said.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl ToolError {
    /// Returns the exit code of a program that ends with this error: 2 for bad input, 1 for failure.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Unwritable { .. } => 1,
            _ => 2,
        }
    }

    /// Returns what the user can do about it, where there is something to say.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Unreadable { path, .. } => Some(hint_for_missing(path)),
            Self::Json { .. } | Self::NotRigid { .. } | Self::RepeatedFrame { .. } => {
                Some("write the folder again with `mirrorball-render --recording DIR --scene FILE --out DIR`")
            }
            Self::Size { .. } => {
                Some("score an output folder only against the truth of the recording it was made from")
            }
            Self::NoComposites { .. } => Some("give the recording that the output folder was made from"),
            Self::NotFinite { .. } => Some("look for a division by zero in the pass that fills the environment"),
            _ => None,
        }
    }
}

/// Tells what to do about a file that is not there, by what the file is.
fn hint_for_missing(path: &std::path::Path) -> &'static str {
    match path.file_name().and_then(|name| name.to_str()) {
        Some("meta.json") => "give the folder `truth` of a sequence, the one that holds meta.json",
        Some("frames.jsonl") => "give the folder that `mirrorball-render --out` wrote",
        Some("rig.toml" | "frames.csv") => "give the folder `recording` of a sequence, the one that holds rig.toml",
        _ => "check that the run was complete and that the folder belongs to the same sequence",
    }
}
