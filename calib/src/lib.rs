//! Camera models, poses, the rig and its markers: what the rig is, and where its camera stands.
//!
//! # Conventions
//!
//! They hold in every crate of the project.
//!
//! ```text
//!     world = main marker, seen upright          camera                  pixels
//!
//!              y                                     z (forward)          (-0.5, -0.5)
//!              ^                                    /                       +-----+-----+-- u
//!        3 ----+---- 2                             /                        |     |     |
//!        |  #######  |                            +-----> x (right)         | 0,0 | 1,0 |
//!        |  #  |  #  |                            |                         |     |     |
//!        |  #  z--#--+--> x                       |                         +-----+-----+--
//!        |  #######  |                            v                         |     |     |
//!        0 --------- 1                            y (down)                  v
//!     z comes out of the paper
//! ```
//!
//! - **Units**: metres, seconds, radians; anything else has its unit in its name.
//! - **World**: the frame of the rig's main marker. Right-handed; origin at the marker's centre, x to the right and y
//!   to the top of the marker as printed, z out of the paper. A marker on a table makes z point up.
//! - **Marker frame**: the same, of any marker.
//! - **Corners** of a marker are those of its black square: bottom-left, bottom-right, top-right, top-left of the
//!   upright marker (0 to 3 above; AprilRobotics' order). OpenCV prints its AprilTag dictionaries turned by 180
//!   degrees.
//! - **Camera frame**: x right, y down, z forward (OpenCV).
//! - **Pixels**: u right, v down; integer coordinates are the *centres* of pixels, so (0, 0) is the centre of the
//!   top-left one and the picture covers -0.5 to width - 0.5. AprilRobotics' library puts that centre at (0.5, 0.5);
//!   OpenCV agrees with us.
//! - **Poses** are named `a_from_b`: `p_a = a_from_b * p_b`, and `a_from_c = a_from_b * b_from_c`.
//! - **Light**: a pixel's *code* is 8-bit and encoded; the *signal* y is linear, 0 to 1; *radiance* is what y is
//!   proportional to once exposure, gain, white balance and vignetting are taken out ([`photometry`]).
//!
//! # What is in here
//!
//! [`rig`] reads `rig.toml` into checked types, [`tag`] finds markers in pictures, [`resection`] turns them into a
//! pose; [`board`] finds calibration boards, [`intrinsics`] turns them into a lens, [`interchange`] speaks other programs'
//! files; [`extrinsics`], [`ball_fit`], [`photometric`], [`color`] and [`timing`] measure the rest of a rig, with
//! [`least_squares`] under them and [`report`] to tell a person; [`probe`] turns a picture of a mirror ball or of a fisheye camera into radiance from every direction, [`lights`]
//! that into a few lights; [`merge`] makes one radiance of several exposures, [`response_fit`] finds
//! the response of the camera that took them; [`camera`], [`pose`], [`response`] and [`photometry`] are what they stand on.
//!
//! ```no_run
//! use std::path::Path;
//!
//! use mirrorball_calib::{resection, rig::Rig, tag::{Family, Finder}};
//!
//! # fn frame() -> Vec<u8> { Vec::new() }
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let file = Path::new("rig.toml");
//! let rig = Rig::from_toml(&std::fs::read_to_string(file)?, file)?;
//! let camera = rig.scene_camera();
//! let mut finder = Finder::new(&[Family::Tag36h11]);
//! let detections = finder.find(&frame(), [640, 480], camera)?;
//! let located = resection::locate(&detections, &rig, &camera.intrinsics)?;
//! println!("the camera is at {}", located.camera_from_world.inverse().translation);
//! # Ok(())
//! # }
//! ```
//!
//! # What is not in here
//!
//! No input or output: the library opens no file (the program of the same name does). No GPU. No global state. No
//! clock: equal input gives equal output, bit for bit. `unsafe` stands in `tag::apriltag` only, around the C detector.

pub mod ball_fit;
pub mod board;
pub mod camera;
pub mod color;
pub mod extrinsics;
pub mod interchange;
pub mod intrinsics;
pub mod least_squares;
pub mod lights;
pub mod merge;
pub mod photometric;
pub mod photometry;
pub mod pose;
pub mod probe;
pub mod report;
pub mod resection;
pub mod response;
pub mod response_fit;
pub mod rig;
pub mod tag;
pub mod timing;
mod view;
