//! Shadow methods against truth: what is known in closed form, and rays.

#![expect(clippy::unwrap_used, reason = "tests may; this covers their own functions too")]

mod blocks;
mod dome;
mod lab;
mod planar;
mod rays;
mod show;
mod volumes;
