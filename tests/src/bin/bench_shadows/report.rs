//! The bench's output: tables on standard output and in `tables.md`, pictures and numbers beside it.

use crate::stand::{Effort, Outcome};
use image::RgbImage;
use mirrorball_render::{error::RenderError, gpu::Gpu};
use std::path::{Path, PathBuf};

/// What has been said so far, and where it goes.
pub(crate) struct Report {
    folder: PathBuf,
    text: String,
}

impl Report {
    /// Makes the folder.
    pub(crate) fn create(folder: &Path) -> Result<Self, RenderError> {
        std::fs::create_dir_all(folder).map_err(|error| unwritable(folder, error))?;
        Ok(Self {
            folder: folder.to_owned(),
            text: String::new(),
        })
    }

    /// Says on which adapter and how the rest was measured.
    pub(crate) fn head(&mut self, effort: &Effort) -> Result<(), RenderError> {
        let gpu = Gpu::open()?;
        self.say(&format!("Adapter: {}\n", gpu.name));
        self.say(&format!(
            "Each row: median of at least {} pictures after {} to warm up (fewer of those that take seconds), by the \
             clock from recording to done; the passes by the adapter's own time stamps, median. Objects move from \
             picture to picture.",
            effort.pictures_min, effort.warm_up
        ));
        if !gpu.has_timestamps {
            self.say("The adapter has no time stamps.");
        }
        Ok(())
    }

    /// Says a line.
    pub(crate) fn say(&mut self, line: &str) {
        println!("{line}");
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// Begins a table; its rows follow with [`Report::row`].
    pub(crate) fn table(&mut self, title: &str, columns: &[&str]) {
        self.say(&format!("\n### {title}\n"));
        self.row(&columns.iter().map(ToString::to_string).collect::<Vec<_>>());
        self.row(&vec!["---".to_owned(); columns.len()]);
    }

    /// Says a row of a table.
    pub(crate) fn row(&mut self, cells: &[String]) {
        self.say(&format!("| {} |", cells.join(" | ")));
    }

    /// Writes a picture beside the tables.
    pub(crate) fn picture(&mut self, name: &str, picture: &RgbImage) -> Result<(), RenderError> {
        let file = self.folder.join(name);
        picture.save(&file).map_err(|error| unwritable(&file, error))?;
        self.say(&format!("\n`{}`", file.display()));
        Ok(())
    }

    /// Writes a text beside the tables.
    pub(crate) fn file(&self, name: &str, text: &str) -> Result<(), RenderError> {
        let file = self.folder.join(name);
        std::fs::write(&file, text).map_err(|error| unwritable(&file, error))
    }

    /// Writes the tables.
    pub(crate) fn finish(&self) -> Result<(), RenderError> {
        self.file("tables.md", &self.text)
    }
}

fn unwritable(file: &Path, source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> RenderError {
    RenderError::Write {
        file: file.to_owned(),
        source: source.into(),
    }
}

/// Pictures per second, milliseconds, milliseconds per pass; or why there are none.
pub(crate) fn timing_cells(outcome: &Outcome) -> [String; 3] {
    match outcome {
        Outcome::Timed(timed) => {
            let passes: Vec<String> = timed
                .passes_ms
                .iter()
                .map(|(name, ms)| format!("{name} {}", digits(*ms)))
                .collect();
            [digits(1e3 / timed.ms), digits(timed.ms), passes.join(", ")]
        }
        Outcome::Refused(why) => ["–".to_owned(), "–".to_owned(), why.clone()],
    }
}

/// The seed's pictures per second, and how many times as many ours are.
pub(crate) fn seed_cells(outcome: &Outcome, seed_fps: Option<f64>) -> [String; 2] {
    match (seed_fps, outcome) {
        (Some(seed), Outcome::Timed(timed)) => [format!("{seed}"), digits(1e3 / timed.ms / seed)],
        (Some(seed), Outcome::Refused(_)) => [format!("{seed}"), "–".to_owned()],
        (None, _) => ["–".to_owned(), "–".to_owned()],
    }
}

/// Three digits that count.
pub(crate) fn digits(value: f64) -> String {
    if value >= 100.0 {
        format!("{value:.0}")
    } else if value >= 10.0 {
        format!("{value:.1}")
    } else if value >= 1.0 {
        format!("{value:.2}")
    } else {
        format!("{value:.3}")
    }
}
