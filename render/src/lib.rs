//! The render node: camera frames in, the same frames with virtual objects standing in them out.
//!
//! ```text
//! FrameSet -> Tracker --TrackedPose--+
//!          -> radiance_map -> LightProbe --Light--+-> shadows --irradiance--> receive --ratio----+-> composite -> Sink
//!                                               +-> local light ----------> shade --radiance--+
//! ```
//!
//! [`frame`] is one frame from top to bottom; everything else is a step of it:
//! - [`tracker`]: markers to pose; [`whereabouts`]: where objects are that move;
//! - [`probe`]: mirror ball or fisheye to light, in linear radiance, world frame;
//! - [`scene`]: virtual objects and phantoms; [`reload`]: read anew while frames are rendered;
//! - [`passes`]: the work of the GPU, each pass beside its WGSL file; [`mod@reference`] holds their CPU twins;
//! - [`near`]: light that near things throw on each other;
//! - [`shadow`]: every way to draw a shadow; [`scene_shadows`]: any of them in the camera's picture; [`lab`]: all of them on
//!   one scene without cameras, to be compared;
//! - [`look`]: what the camera does to light, so that virtual pixels look taken by it;
//! - [`output`]: files and window.
//!
//! Conventions are those of `mirrorball_calib`: world = main marker, z out of the paper; camera x right, y down, z forward;
//! pixel centres at integers; metres, seconds, radians. Radiance is linear, in the rig's common RGB, from the probe to the
//! composite pass, which encodes it once with the camera's own response.
//!
//! Invariants: nothing here reads a truth folder; only the programs, `scene`, `config` and `output` touch files; a recording
//! replayed twice gives the same poses bit for bit.

pub mod app;
pub mod ball_place;
pub mod camera_view;
pub mod cli;
pub mod codes;
pub mod config;
pub mod directional_albedo;
pub mod environment_in;
pub mod environments;
pub mod error;
pub mod eye;
pub mod eye_view;
pub mod frame;
pub mod gpu;
pub mod insets;
pub mod lab;
pub mod light_maps;
pub mod light_tree;
pub mod look;
pub mod measure;
pub mod mode;
pub mod near;
pub mod node;
pub mod output;
pub mod passes;
pub mod probe;
pub mod reference;
pub mod reload;
pub mod scene;
pub mod scene_gpu;
pub mod scene_materials;
pub mod scene_rays;
pub mod scene_shadows;
pub mod shadow;
pub mod traced;
pub mod tracker;
pub mod whereabouts;
