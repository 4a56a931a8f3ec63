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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outputs::composite_path;
    use std::{fs, path::Path};

    /// A run's output folder with one composite.
    fn output(composite: &RgbImage) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        fs::write(
            folder.path().join("frames.jsonl"),
            "{\"frame\":5,\"reason\":\"made up\"}\n",
        )
        .unwrap();
        let file = composite_path(folder.path(), 5);
        fs::create_dir(file.parent().unwrap()).unwrap();
        composite.save(file).unwrap();
        folder
    }

    #[test]
    fn two_ways_stand_beside_each_other_with_their_errors() {
        let sequence = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/fisheye");
        let read = |file: &str| image::open(sequence.join(file)).unwrap().to_rgb8();
        // Ours is the camera's own picture, the other one is half as wrong everywhere: 6.0 dB better.
        let camera = read("recording/scene/000005.png");
        let reference = read("truth/ref/000005_with.png");
        let mut halfway = camera.clone();
        for (code, wanted) in halfway.iter_mut().zip(reference.iter()) {
            *code = code.midpoint(*wanted);
        }
        let (ours, other) = (output(&camera), output(&halfway));
        let entry = Entry {
            sequence,
            ours: ours.path().to_owned(),
            other: other.path().to_owned(),
        };
        let gallery = make(&[entry], "halfway").unwrap();

        let lines: Vec<&str> = gallery.table.lines().collect();
        assert!(lines[0].contains("| ours, dB | halfway, dB |"), "{}", lines[0]);
        let cells = |line: &str| -> Vec<String> { line.split('|').map(|cell| cell.trim().to_owned()).collect() };
        let regions: Vec<String> = lines[2..].iter().map(|line| cells(line)[2].clone()).collect();
        assert_eq!(regions.len(), 5, "{regions:?}");
        assert!(
            regions[0].starts_with("`torus`, ") && regions[1].starts_with("`cube`, "),
            "{regions:?}"
        );
        assert_eq!(regions[2..], ["objects", "shadow", "whole picture"]);
        let objects = cells(lines[4]);
        assert!(objects[1].ends_with(", 5"), "{objects:?}");
        let number = |index: usize| -> f64 { objects[index].parse().unwrap() };
        assert!((number(5) + 6.0).abs() <= 0.1, "{objects:?}");
        assert!(
            (number(3) - number(4) - number(5)).abs() < 0.16,
            "rounded to tenths: {objects:?}"
        );
        assert!(number(6) > number(7), "FLIP: {objects:?}");

        // Camera, both ways and the reference, reduced from 1280 x 720, with margins and a label.
        let [width, height] = [gallery.picture.width(), gallery.picture.height()];
        assert!((4 * 480..4 * 480 + 5 * 20).contains(&width), "{width}");
        assert!((270..270 + 80).contains(&height), "{height}");
    }
}
