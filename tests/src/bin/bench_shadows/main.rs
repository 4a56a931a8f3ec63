//! Measures every shadow method on this machine's graphics adapter: time beside the seeds' figures, error beside the
//! references, cost as lights and triangles grow, and a contact sheet.

#![expect(clippy::print_stdout, reason = "tables are what this program says")]

mod domes;
mod errors;
mod gallery;
mod growth;
mod report;
mod shadow_maps;
mod stand;
mod volumes;

use clap::{Parser, ValueEnum};
use mirrorball_render::{cli, error::RenderError, lab::lamp::LampKind};
use report::Report;
use stand::Effort;
use std::{path::PathBuf, process::ExitCode};

/// Tables of time and error of the shadow methods, in Markdown; the same as `tables.md` in the folder.
#[derive(Parser)]
#[command(name = "bench-shadows", version)]
struct Arguments {
    /// Small pictures and few of them: whether it runs, not how fast
    #[arg(long)]
    quick: bool,
    /// Folder for tables, plot and contact sheet
    #[arg(long, value_name = "DIR", default_value = "out/bench-shadows")]
    out: PathBuf,
    /// Parts to run, separated by commas
    #[arg(long, value_name = "PART,...", value_delimiter = ',')]
    only: Vec<Part>,
}

/// A part of the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Shadow maps of three sizes with every filter
    Maps,
    /// Domes of lights
    Domes,
    /// Shadow volumes beside shadow maps, with more and more objects
    Volumes,
    /// Error of every method against the references
    Errors,
    /// Cost as lights and triangles grow, with a plot
    Growth,
    /// Contact sheet of all methods
    Sheet,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::start_log();
    cli::exit_code(&run(&arguments))
}

fn run(arguments: &Arguments) -> Result<(), RenderError> {
    let effort = if arguments.quick { Effort::QUICK } else { Effort::FULL };
    let mut report = Report::create(&arguments.out)?;
    report.head(&effort)?;
    let is_wanted = |part| arguments.only.is_empty() || arguments.only.contains(&part);
    if is_wanted(Part::Maps) {
        shadow_maps::run(&effort, &mut report)?;
    }
    if is_wanted(Part::Domes) {
        domes::run(&effort, &mut report)?;
    }
    if is_wanted(Part::Volumes) {
        volumes::run(&effort, &mut report)?;
    }
    if is_wanted(Part::Growth) {
        growth::run(&effort, &mut report)?;
    }
    // Domes take all light as infinitely far away, so that they are measured under a light of that kind as well.
    let lamps = [(LampKind::Rect, is_wanted(Part::Sheet)), (LampKind::Directional, false)];
    for (lamp, is_for_sheet) in lamps {
        if is_for_sheet || is_wanted(Part::Errors) {
            let mut stand = gallery::stand(&effort, lamp)?;
            let gallery = gallery::paint(&effort, &mut stand)?;
            if is_wanted(Part::Errors) {
                let references = gallery::references(&effort, &mut stand)?;
                errors::run((&gallery, &references), lamp, &mut report)?;
            }
            if is_for_sheet {
                gallery::sheet(&gallery, &mut report)?;
            }
        }
    }
    report.finish()
}
