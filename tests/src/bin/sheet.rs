//! Lays camera, composite and reference side by side, and makes an animated preview of all composites.

use clap::Parser;
use mirrorball_tests::{ToolError, cli, outputs::composite_path, preview, recording, sheet, truth::Truth};
use std::{fs, path::Path, path::PathBuf, process::ExitCode};

/// Writes the contact sheet "camera | ours | reference" and an animated preview.
///
/// With a truth folder the rows are the frames that have a reference; without, the first, middle and last.
#[derive(Parser)]
#[command(name = "sheet", version)]
struct Arguments {
    /// Folder that the render node wrote, with composite/
    output: PathBuf,
    /// Recording it was made from, with rig.toml and frames.csv
    recording: PathBuf,
    /// Folder `truth` of the sequence
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// The contact sheet to write
    #[arg(long, value_name = "FILE.png")]
    out: PathBuf,
    /// The animation to write
    #[arg(long, value_name = "FILE.gif")]
    preview: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(summary) => {
            show(&summary);
            ExitCode::SUCCESS
        }
        Err(error) => cli::report_failure(&error),
    }
}

/// Writes what is asked for and returns a summary.
fn run(arguments: &Arguments) -> Result<String, ToolError> {
    let truth = arguments.truth.as_deref().map(Truth::load).transpose()?;
    let mut frames = recording::scene_frames(&arguments.recording)?;
    let recorded = frames.len();
    frames.retain(|frame| composite_path(&arguments.output, frame.sequence).exists());
    if frames.is_empty() {
        return Err(ToolError::NoComposites {
            composites: arguments.output.join("composite"),
            frames: arguments.recording.join("frames.csv"),
        });
    }
    let mut summary = format!("{} of {recorded} frames have a composite\n", frames.len());
    let rows = sheet::rows(&arguments.output, &frames, truth.as_ref())?;
    let picture = sheet::draw(&rows);
    picture.save(&arguments.out).map_err(|error| ToolError::Unwritable {
        path: arguments.out.clone(),
        source: error.into(),
    })?;
    let columns = rows.iter().map(|row| row.pictures.len()).max().unwrap_or(0);
    let (width, height) = picture.dimensions();
    summary.push_str(&format!(
        "{}: {} rows of {columns} pictures, {width} x {height} px, {}\n",
        arguments.out.display(),
        rows.len(),
        size_on_disk(&arguments.out)
    ));
    if let Some(path) = &arguments.preview {
        let preview = preview::write(path, &arguments.output, &frames)?;
        let [width, height] = preview.size_px;
        summary.push_str(&format!(
            "{}: {} frames in {:.1} s, {width} x {height} px, {}\n",
            path.display(),
            preview.frames,
            preview.duration.as_secs_f64(),
            size_on_disk(path)
        ));
    }
    Ok(summary)
}

fn size_on_disk(path: &Path) -> String {
    fs::metadata(path).map_or("size unknown".to_owned(), |metadata| {
        format!("{:.1} MB", metadata.len() as f64 * 1e-6)
    })
}

#[expect(clippy::print_stdout, reason = "the summary is what this program says")]
fn show(text: &str) {
    print!("{text}");
}
