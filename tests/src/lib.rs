//! The score tool and the demo sheet: what a run of the render node is worth, in numbers and in pictures.
//!
//! `score` compares an output folder with a truth folder, `sheet` lays camera, composite and reference side by side.
//! Both only read; nothing here renders, tracks or calibrates, so no error is shared with what is measured.
//!
//! Conventions are those of the file formats: world is the main marker's frame, x right and y up as printed, z out of
//! the paper; a camera looks along +z with x right and y down; metres; environment maps are equirectangular with row 0
//! at world +z and the centre column at +y.
//!
//! ```text
//! truth.rs     meta.json ----+
//!                            +--> pose_error, environment_error, composite_error --> score --> report, floors
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
pub mod irradiance;
pub mod json;
pub mod label;
pub mod outputs;
pub mod picture;
pub mod pose_error;
pub mod preview;
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
