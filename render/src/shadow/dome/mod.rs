//! Many shadow-casting lights over the sphere, the shadows of all of them in one picture.
//!
//! ```text
//! casters --dome_maps--> depth per light --dome_visibility--> one bit per pixel and light --dome_light--> irradiance
//!                        (kept while light     (kept while view,                         (every frame)      |
//!                         and casters stand)    light and casters stand)                        dome_filter (soft shadows)
//! ```
//!
//! A pixel sends one ray to every light. With soft shadows the ray goes to a random place on the light, through the
//! light's depth map taken as a relief ([`RayMode::Soft`]); pixels of a 4 × 4 tile have different places (interleaved
//! sampling: Keller and Heidrich 2001), and a filter over the tile that knows edges puts them together.

mod casters;
mod gather;
mod lights;
mod maps;
mod plan;
mod sight;
mod step;

pub use casters::DomeCasters;
pub use gather::{DomeGather, Unshaded};
pub use lights::{DomeLight, GpuDomeLight, hemisphere, stratified_cells};
pub use maps::{DomeMaps, GpuDomeFrame, MapsJob};
pub use plan::{DomePlan, Surroundings, plan};
pub use sight::{DomeSight, RayMode};
pub(crate) use step::Step;

/// Most lights of a dome.
pub const MAX_DOME_LIGHTS: usize = 256;
