//! Time and error of every map of light, beside others that are made for the same purpose; prints tables.
//!
//! `cargo bench -p mirrorball-render --bench light_maps`, with `-- --dump FOLDER` to write the maps as pictures as well,
//! `-- --times` or `-- --errors` for one half alone.

#![allow(clippy::print_stdout, reason = "tables are what this program is for")]

mod dump;
mod errors;
mod peers;
mod rooms;
mod stage;
#[path = "../../tests/support/mod.rs"]
mod support;
mod times;

use std::error::Error;
use std::path::PathBuf;

use mirrorball_render::gpu::Gpu;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |flag: &str| arguments.iter().any(|a| a == flag);
    let folder = arguments
        .iter()
        .position(|a| a == "--dump")
        .and_then(|at| arguments.get(at + 1))
        .map(PathBuf::from);
    println!("adapter: {}", Gpu::open()?.name);
    if !has("--errors") {
        times::print()?;
    }
    if !has("--times") {
        errors::print()?;
    }
    if let Some(folder) = folder {
        dump::write(&folder)?;
    }
    Ok(())
}
