//! Composites of several sequences beside another way of lighting and the path-traced reference: a picture, and a table.

use crate::{
    ToolError,
    composite_error::{self, CompositeError, RegionError},
    outputs::Outputs,
    picture, sheet,
    truth::{MaterialKind, Truth},
};
use image::RgbImage;
use std::{fmt::Write, path::PathBuf};

/// Widest picture of the gallery in pixels.
const CELL_WIDTH_PX: u32 = 480;

/// One sequence and what two runs made of it.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Folder with `recording` and `truth`.
    pub sequence: PathBuf,
    /// What our run wrote.
    pub ours: PathBuf,
    /// What the other way of lighting wrote.
    pub other: PathBuf,
}

/// The gallery.
#[derive(Clone, Debug)]
pub struct Gallery {
    /// Camera, ours, the other way and the reference side by side; of every sequence the first frame with a reference.
    pub picture: RgbImage,
    /// A Markdown table of PSNR and FLIP, every frame with a reference.
    pub table: String,
}

/// Reads and compares everything; `other_name` is what the other way of lighting is called.
///
/// # Errors
/// When a file is missing, cannot be decoded, or does not fit the sequence.
pub fn make(entries: &[Entry], other_name: &str) -> Result<Gallery, ToolError> {
    let mut rows = Vec::with_capacity(entries.len());
    let mut table = format!(
        "| sequence, frame | region | ours, dB | {other_name}, dB | ours better by, dB | FLIP, ours | FLIP, {other_name} |\n\
         | --- | --- | --- | --- | --- | --- | --- |\n"
    );
    for entry in entries {
        let truth = Truth::load(&entry.sequence.join("truth"))?;
        let (ours, other) = (Outputs::load(&entry.ours)?, Outputs::load(&entry.other)?);
        let errors = composite_error::measure(&ours, &truth)?;
        let other_errors = composite_error::measure(&other, &truth)?;
        for (own, others) in errors.iter().zip(&other_errors) {
            add_lines(&mut table, &truth.name, (own, others));
        }
        if let (Some(own), Some(others)) = (errors.first(), other_errors.first()) {
            rows.push(row(&truth, (&ours, own), (&other, others, other_name))?);
        }
    }
    Ok(Gallery {
        picture: sheet::draw_reduced(&rows, CELL_WIDTH_PX),
        table,
    })
}

/// The pictures of one frame.
fn row(
    truth: &Truth,
    (ours, own): (&Outputs, &CompositeError),
    (other, others, other_name): (&Outputs, &CompositeError, &str),
) -> Result<sheet::Row, ToolError> {
    let frame = own.frame;
    let text = |name: &str, error: &CompositeError| {
        format!("{name}: object {}, shadow {}", db(&error.object), db(&error.shadow))
    };
    let mut pictures = Vec::with_capacity(4);
    if let Some(reference) = truth.references.iter().find(|reference| reference.frame == frame) {
        let paths = truth.reference_paths(reference);
        let read =
            |path: &std::path::Path, what: &str| picture::read_any(path, &format!("the {what} of frame {frame}"));
        pictures.push(("camera".to_owned(), read(&paths.without, "camera's picture")?));
        pictures.push((text("ours", own), read(&ours.composite_path(frame), "composite")?));
        pictures.push((
            text(other_name, others),
            read(&other.composite_path(frame), "composite")?,
        ));
        pictures.push(("path traced".to_owned(), read(&paths.with, "reference")?));
    }
    Ok(sheet::Row {
        title: format!("{}, frame {frame}", truth.name),
        pictures,
    })
}

fn db(region: &RegionError) -> String {
    region
        .psnr_db
        .map_or("-".to_owned(), |psnr| format!("{:.1} dB", psnr.0))
}

fn add_lines(table: &mut String, name: &str, (own, others): (&CompositeError, &CompositeError)) {
    let kind = |kind: MaterialKind| match kind {
        MaterialKind::Diffuse => "diffuse",
        MaterialKind::Metal => "metal",
        MaterialKind::Mirror => "mirror",
    };
    let mut regions: Vec<(String, &RegionError, &RegionError)> = own
        .objects
        .iter()
        .zip(&others.objects)
        .map(|(a, b)| (format!("`{}`, {}", a.name, kind(a.material)), &a.region, &b.region))
        .collect();
    regions.push(("objects".to_owned(), &own.object, &others.object));
    regions.push(("shadow".to_owned(), &own.shadow, &others.shadow));
    regions.push(("whole picture".to_owned(), &own.whole, &others.whole));
    for (region, a, b) in regions {
        let (Some(ours), Some(theirs), Some(flip), Some(their_flip)) = (a.psnr_db, b.psnr_db, a.flip, b.flip) else {
            continue;
        };
        let better = ours.0 - theirs.0;
        // Writing to a string cannot fail.
        let _ = writeln!(
            table,
            "| {name}, {} | {region} | {:.1} | {:.1} | {better:+.1} | {flip:.3} | {their_flip:.3} |",
            own.frame, ours.0, theirs.0
        );
    }
}
