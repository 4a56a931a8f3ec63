//! Every way to draw a shadow that the literature of 1977 to 2006 offers, and the references that they are measured
//! against: all on the same scene, view and light, so that they can be compared and switched while running.
//!
//! A one-light method ([`key::KeyShadow`]) fills a picture with the share of one light that arrives; the rest of the light
//! is ambient. Dome methods gather many lights over the sphere. [`ShadowMethod`] lists them all.

pub mod area;
pub mod atlas;
pub mod attenuation;
pub mod blob;
pub mod casters;
pub mod dome;
pub mod haller;
pub mod key;
pub mod light;
pub mod map_view;
mod methods;
pub mod nearest;
pub mod path;
pub mod pcf;
pub mod pcss;
pub mod planar;
pub mod planes;
pub mod shadow_view;
pub mod silhouette;
pub mod stencil;
pub mod surface;
pub mod view;
pub mod volume;
pub mod volume_mesh;
pub mod wedge_light;
pub mod wedge_outlines;
pub mod wedges;

pub use methods::{Family, ShadowMethod};
