//! Materials: shaders against their twins, what keeps all light, pictures of spheres, and the path tracer as the judge.

mod coverage;
mod pictures;
mod points;
#[path = "../support/mod.rs"]
mod support;
