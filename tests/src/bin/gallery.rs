//! Lays composites of several sequences beside another way of lighting and the path-traced references.

use clap::Parser;
use mirrorball_tests::{ToolError, cli, gallery};
use std::{path::PathBuf, process::ExitCode};

/// Writes a picture "camera | ours | another way | path traced" and prints a Markdown table of both ways' errors.
#[derive(Parser)]
#[command(name = "gallery", version)]
struct Arguments {
    /// A sequence (with recording/ and truth/), our output folder for it, and the other way's
    #[arg(long = "row", value_names = ["SEQUENCE", "OURS", "OTHER"], num_args = 3, required = true)]
    rows: Vec<PathBuf>,
    /// What the other way of lighting is called
    #[arg(long, default_value = "phone style")]
    other: String,
    /// The picture to write
    #[arg(long, value_name = "FILE.jpg")]
    out: PathBuf,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(table) => {
            show(&table);
            ExitCode::SUCCESS
        }
        Err(error) => cli::report_failure(&error),
    }
}

fn run(arguments: &Arguments) -> Result<String, ToolError> {
    let entries: Vec<gallery::Entry> = arguments
        .rows
        .chunks_exact(3)
        .map(|row| gallery::Entry {
            sequence: row[0].clone(),
            ours: row[1].clone(),
            other: row[2].clone(),
        })
        .collect();
    let gallery = gallery::make(&entries, &arguments.other)?;
    gallery
        .picture
        .save(&arguments.out)
        .map_err(|error| ToolError::Unwritable {
            path: arguments.out.clone(),
            source: error.into(),
        })?;
    Ok(gallery.table)
}

#[expect(clippy::print_stdout, reason = "the table is what this program is for")]
fn show(text: &str) {
    print!("{text}");
}
