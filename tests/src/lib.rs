//! The score tools and the demo sheet: what a run of the render node is worth, in numbers and in pictures.
//!
//! `score` compares an output folder with a truth folder, `probe-table` the light of several, `sheet` lays camera,
//! composite and reference side by side, `gallery` does so for several sequences beside another way of lighting.
//! They only read; nothing here tracks or calibrates, so no error is shared with what is measured. That holds for
//! [`simulation`] as well, which makes pictures of the probe for tests. The program `bench-shadows` alone runs the
//! render node's own code: it measures that.
//!
//! Conventions are those of the file formats: world is the main marker's frame, x right and y up as printed, z out of
//! the paper; a camera looks along +z with x right and y down; metres; environment maps are equirectangular with row 0
//! at world +z and the centre column at +y.
//!
//! ```text
//! truth.rs     meta.json ----+
//!                            +--> pose_error, environment_error, composite_error --> score --> report, floors
//!                            |    lamp_distance ------------------------------------------> probe_table
//! outputs.rs   OUT folder ---+
//! ```

pub mod brightest_light;
pub mod cli;
pub mod composite_error;
pub mod environment_error;
pub mod environment_map;
pub mod error;
pub mod flip;
pub mod floors;
pub mod gallery;
pub mod irradiance;
pub mod json;
pub mod label;
pub mod lamp_distance;
pub mod outputs;
pub mod picture;
pub mod plot;
pub mod pose_error;
pub mod preview;
pub mod probe_table;
pub mod psnr;
pub mod recording;
pub mod report;
pub mod score;
pub mod sheet;
pub mod simulation;
pub mod stages;
pub mod statistics;
pub mod truth;

pub use error::ToolError;
