//! What can go wrong in the render node, and what the user can do about it.

use std::path::PathBuf;

use mirrorball_capture::{HandoverError, SourceError};

/// Failure of the render node.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A file that the user named cannot be read.
    #[error("cannot read `{}`", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// A TOML file does not say what it should.
    #[error("`{}`: {message}", file.display())]
    Config {
        /// The file.
        file: PathBuf,
        /// Line, key and what is allowed.
        message: String,
    },
    /// The scene names something that is not there or not allowed.
    #[error("`{}`, object `{object}`, `{field}`: {message}", file.display())]
    Scene {
        /// The scene file.
        file: PathBuf,
        /// Name of the object.
        object: String,
        /// Key in the object's table.
        field: &'static str,
        /// What is wrong and what is allowed.
        message: String,
    },
    /// A virtual lamp of the scene is not allowed.
    #[error("`{}`, lamp `{lamp}`, `{field}`: {message}", file.display())]
    Lamp {
        /// The scene file.
        file: PathBuf,
        /// Name of the lamp.
        lamp: String,
        /// Key in the lamp's table.
        field: &'static str,
        /// What is wrong and what is allowed.
        message: String,
    },
    /// More virtual lamps than are drawn.
    #[error("the scene has {found} virtual lamps, those of its glTF files included; at most {limit} are drawn")]
    TooManyLamps {
        /// How many there are.
        found: usize,
        /// How many are drawn.
        limit: usize,
    },
    /// A glTF file cannot be used.
    #[error("cannot use the glTF file `{}` of object `{object}`: {message}", file.display())]
    Mesh {
        /// The glTF file.
        file: PathBuf,
        /// Name of the object.
        object: String,
        /// What is wrong.
        message: String,
    },
    /// The rig file is wrong.
    #[error("the rig cannot be used")]
    Rig(#[from] mirrorball_calib::rig::RigError),
    /// Something is larger than the graphics adapter takes.
    #[error("{what} of {wanted} is more than the adapter `{adapter}` takes: {limit}")]
    TooLarge {
        /// What, with its unit.
        what: &'static str,
        /// Size asked for.
        wanted: u64,
        /// Largest size.
        limit: u64,
        /// Name of the adapter.
        adapter: String,
    },
    /// The scene camera's lens is wider than the renderer can draw through.
    #[error("camera `{camera}` images {angle_deg:.0}° off its axis; the scene camera may at most 80°")]
    LensTooWide {
        /// Camera's name.
        camera: String,
        /// The largest angle in its picture, degrees.
        angle_deg: f64,
    },
    /// The pictures are not those of the rig.
    #[error("the pictures do not fit the rig")]
    RigMismatch(#[from] mirrorball_calib::rig::check::RigMismatch),
    /// The rig lacks what the light probe needs.
    #[error("the rig has no light probe")]
    NoProbe(#[from] mirrorball_calib::probe::NoProbe),
    /// A recording cannot be played.
    #[error("cannot play `{}`", folder.display())]
    Recording {
        /// Its folder.
        folder: PathBuf,
        /// Why.
        #[source]
        source: Box<SourceError>,
    },
    /// Frames do not come through.
    #[error("no frames from `{from}`")]
    Handover {
        /// Recording or service.
        from: String,
        /// Why.
        #[source]
        source: Box<HandoverError>,
    },
    /// The camera that the picture comes from gives no frames.
    #[error("there are no frames of camera `{camera}`, which the rig calls the scene camera")]
    NoSceneFrame {
        /// Camera's name.
        camera: String,
    },
    /// The program cannot listen for signals.
    #[error("cannot listen for Ctrl-C and SIGTERM")]
    Signals {
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// The scene file cannot be watched.
    #[error("cannot watch `{}` for changes", file.display())]
    Watch {
        /// The file.
        file: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// A changed scene brought the renderer to a fault of its own.
    #[error("`{}` cannot be shown; the program is at fault: {message}", file.display())]
    Fault {
        /// The scene file.
        file: PathBuf,
        /// What the panic said.
        message: String,
    },
    /// A frame's bytes are no picture.
    #[error("cannot decode frame {sequence} of camera `{camera}`")]
    Decode {
        /// Camera's name.
        camera: String,
        /// Frame's sequence number.
        sequence: u64,
        /// What is wrong.
        #[source]
        source: mirrorball_capture::DecodeError,
    },
    /// A frame is not what the rig says.
    #[error("frame {sequence} of camera `{camera}` is {found:?} pixels, the rig says {expected:?}")]
    FrameSize {
        /// Camera's name.
        camera: String,
        /// Frame's sequence number.
        sequence: u64,
        /// Width and height found.
        found: [u32; 2],
        /// Width and height of the rig file.
        expected: [u32; 2],
    },
    /// No Vulkan driver answered.
    #[error("no Vulkan adapter found")]
    NoAdapter {
        /// What wgpu said.
        #[source]
        source: wgpu::RequestAdapterError,
    },
    /// The adapter refused the device.
    #[error("the adapter `{adapter}` gives no device")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// What wgpu said.
        #[source]
        source: wgpu::RequestDeviceError,
    },
    /// A file that is no environment map.
    #[error("cannot use `{}` as the environment: {message}", file.display())]
    EnvironmentIn {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A shadow method cannot draw what it was asked to.
    #[error("shadow method `{method}`: {message}")]
    Shadow {
        /// Name of the method.
        method: &'static str,
        /// What it cannot draw, and why.
        message: String,
        /// What to do about it.
        hint: &'static str,
    },
    /// The GPU lost work or data.
    #[error("the GPU failed while `{during}`: {message}")]
    Gpu {
        /// What was being done.
        during: &'static str,
        /// What wgpu said.
        message: String,
    },
    /// A result cannot be written.
    #[error("cannot write `{}`", file.display())]
    Write {
        /// The file or folder.
        file: PathBuf,
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The window cannot be opened or drawn to.
    #[error("cannot open a window: {message}")]
    Window {
        /// What the window system said.
        message: String,
    },
}

impl RenderError {
    /// One line that says what to do, where there is something to do.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Read { file, .. } => Some(format!("check that `{}` exists and is readable", file.display())),
            Self::Config { .. } | Self::Scene { .. } | Self::Lamp { .. } => {
                Some("`configs/README.md` lists every key".into())
            }
            Self::TooManyLamps { .. } => Some("leave lamps out of the scene, or lights out of its glTF files".into()),
            Self::Mesh { .. } => Some("export the object as glTF 2.0 (.glb) with triangles".into()),
            Self::Rig(_) => Some("`configs/README.md` lists every key of a rig file".into()),
            Self::TooLarge { .. } => Some("lower it in the rig, the scene or `render.toml`".into()),
            Self::LensTooWide { .. } => Some("use a lens up to 80° off axis for the scene camera".into()),
            Self::RigMismatch(mismatch) => Some(mismatch.hint().into()),
            Self::NoProbe(_) => Some("add a `[ball]` or a camera with the role `fisheye` to the rig".into()),
            Self::Recording { source, .. } => Some(source.hint().into()),
            Self::Handover { source, .. } => Some(source.hint().into()),
            Self::NoSceneFrame { .. } => Some("give the rig file that belongs to these cameras".into()),
            Self::Signals { .. } | Self::Watch { .. } => None,
            Self::Fault { .. } => {
                Some("undo the last change of the scene, and report it with the scene's files".into())
            }
            Self::EnvironmentIn { .. } => {
                Some("give an equirectangular OpenEXR map like those of `--environment-out`".into())
            }
            Self::Shadow { hint, .. } => Some((*hint).into()),
            Self::Decode { .. } => Some("skip bad frames with `--skip-bad-frames`".into()),
            Self::FrameSize { .. } => Some("give the rig file that belongs to this camera mode".into()),
            Self::NoAdapter { .. } => {
                Some("install a Vulkan driver; `apt-get install mesa-vulkan-drivers` gives a software one".into())
            }
            Self::NoDevice { .. } | Self::Gpu { .. } => {
                Some("run with RUST_LOG=wgpu=info to see the driver's words".into())
            }
            Self::Write { .. } => Some("check permissions and free space, or choose another `--out`".into()),
            Self::Window { .. } => Some("run without `--window`; `--out DIR` writes pictures instead".into()),
        }
    }

    /// Whether the user's input is to blame (exit code 2) rather than the machine (exit code 1).
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Read { .. }
            | Self::Config { .. }
            | Self::Scene { .. }
            | Self::Lamp { .. }
            | Self::TooManyLamps { .. }
            | Self::Mesh { .. }
            | Self::Rig(_)
            | Self::TooLarge { .. }
            | Self::LensTooWide { .. }
            | Self::RigMismatch(_)
            | Self::NoProbe(_)
            | Self::Recording { .. }
            | Self::NoSceneFrame { .. }
            | Self::Decode { .. }
            | Self::FrameSize { .. }
            | Self::EnvironmentIn { .. }
            | Self::Shadow { .. }
            | Self::Write { .. } => true,
            Self::Handover { source, .. } => source.is_bad_input(),
            Self::NoAdapter { .. }
            | Self::NoDevice { .. }
            | Self::Gpu { .. }
            | Self::Window { .. }
            | Self::Signals { .. }
            | Self::Watch { .. }
            | Self::Fault { .. } => false,
        }
    }
}
