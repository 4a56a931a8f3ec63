//! Prints the errors of the light of several sequences as one table.

use clap::Parser;
use mirrorball_tests::{
    ToolError, cli,
    probe_table::{SequenceLight, folder_name, text},
};
use std::{path::PathBuf, process::ExitCode};

/// Compares the light that `mirrorball-render --light-only` measured in several sequences with their truth.
///
/// Exit code 0: measured; 2: bad input.
#[derive(Parser)]
#[command(name = "probe-table", version)]
struct Arguments {
    /// Folders with recording, scene and truth
    #[arg(required = true, value_name = "SEQUENCE")]
    sequences: Vec<PathBuf>,
    /// Folder with one output folder per sequence, of the same name as the sequence's
    #[arg(long, value_name = "DIR")]
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
    let measure = |sequence: &PathBuf| SequenceLight::measure(sequence, &arguments.out.join(folder_name(sequence)));
    let sequences: Vec<SequenceLight> = arguments.sequences.iter().map(measure).collect::<Result<_, _>>()?;
    Ok(text(&sequences))
}

#[expect(clippy::print_stdout, reason = "the table is what this program is for")]
fn show(text: &str) {
    print!("{text}");
}
