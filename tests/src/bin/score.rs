//! Scores an output folder of the render node against a truth folder.

use clap::Parser;
use mirrorball_tests::{
    ToolError, cli,
    floors::{self, Floor},
    report,
    score::Score,
};
use serde::Serialize;
use std::{fs, path::PathBuf, process::ExitCode};

/// Compares poses, environment maps and composites with the truth.
///
/// Exit code 0: measured (and all floors reached); 1: a floor was not reached, or a result could not be written;
/// 2: bad input.
#[derive(Parser)]
#[command(name = "score", version)]
struct Arguments {
    /// Folder that the render node wrote: frames.jsonl, composite/, environment/
    output: PathBuf,
    /// Folder `truth` of the sequence, with `recording` beside it
    truth: PathBuf,
    /// Also write all figures as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Poses and light only, of a run with --light-only
    #[arg(long)]
    light_only: bool,
    /// Compare with the least that must be reached
    #[arg(long)]
    floors: bool,
}

/// The JSON file: the score and, when asked for, the floors.
#[derive(Serialize)]
struct ScoreFile<'a> {
    #[serde(flatten)]
    score: &'a Score,
    #[serde(skip_serializing_if = "Option::is_none")]
    floors: Option<&'a [Floor]>,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(code) => code,
        Err(error) => cli::report_failure(&error),
    }
}

fn run(arguments: &Arguments) -> Result<ExitCode, ToolError> {
    let score = if arguments.light_only {
        Score::measure_light(&arguments.output, &arguments.truth)?
    } else {
        Score::measure(&arguments.output, &arguments.truth)?
    };
    show(&report::text(&score));
    let floors = arguments.floors.then(|| floors::check(&score));
    if let Some(floors) = &floors {
        show(&report::floors_text(floors));
    }
    if let Some(path) = &arguments.json {
        write_json(
            path,
            &ScoreFile {
                score: &score,
                floors: floors.as_deref(),
            },
        )?;
    }
    let all_reached = floors.iter().flatten().all(|floor| floor.passed);
    Ok(if all_reached {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

#[expect(clippy::print_stdout, reason = "the report is what this program is for")]
fn show(text: &str) {
    print!("{text}");
}

fn write_json(path: &PathBuf, file: &ScoreFile<'_>) -> Result<(), ToolError> {
    let unwritable = |source| ToolError::Unwritable {
        path: path.clone(),
        source,
    };
    let text = serde_json::to_string_pretty(file).map_err(|error| unwritable(error.into()))?;
    fs::write(path, text + "\n").map_err(|error| unwritable(error.into()))
}
