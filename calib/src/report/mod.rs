//! What a calibration routine tells a person: a page of text, tables, plots and pictures in one HTML file.
//!
//! Routines say *what* is to be shown ([`Block`], [`Plot`]); how it looks is decided here alone. Nothing is opened and
//! nothing refers to anything outside the page.

mod base64;
mod page;
pub mod plot;
mod text;

pub use plot::Plot;

/// A page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// What was calibrated.
    pub title: String,
    /// From top to bottom.
    pub blocks: Vec<Block>,
}

/// A piece of a page.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// A heading.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// Something that should not be so, and what to do about it.
    Warning(String),
    /// A table; every row has as many cells as the head.
    Table {
        /// What it shows.
        caption: String,
        /// Names of the columns, with units.
        head: Vec<String>,
        /// Cells.
        rows: Vec<Vec<String>>,
    },
    /// A plot.
    Plot {
        /// What it shows and what to look for.
        caption: String,
        /// The data.
        plot: Plot,
    },
    /// A picture.
    Picture {
        /// What it shows and what to look for.
        caption: String,
        /// The file's bytes.
        png: Vec<u8>,
    },
}

impl Report {
    /// An empty page.
    #[must_use]
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            blocks: Vec::new(),
        }
    }

    /// Adds a piece at the end.
    pub fn push(&mut self, block: Block) -> &mut Self {
        self.blocks.push(block);
        self
    }

    /// The page as HTML, whole and by itself.
    #[must_use]
    pub fn to_html(&self) -> String {
        page::html(self)
    }
}
