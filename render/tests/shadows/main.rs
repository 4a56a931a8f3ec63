//! Shadow methods against truth: what is known in closed form, and rays.

#![expect(clippy::unwrap_used, reason = "tests may; this covers their own functions too")]

mod area;
mod area_truth;
mod attenuation;
mod blocks;
mod dome;
mod lab;
mod maps;
mod path;
mod path_lights;
mod path_surfaces;
mod penumbra;
mod planar;
mod rays;
mod show;
mod truth;
mod volumes;
mod wedges;
