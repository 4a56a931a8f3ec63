//! The contact sheet: camera, ours and, where there is one, the reference, side by side.

use crate::{ToolError, label, outputs::composite_path, picture, recording::RecordedFrame, truth::Truth};
use image::{Rgb, RgbImage, imageops};
use std::path::Path;

/// Widest picture of the sheet in pixels; larger ones are reduced.
pub const CELL_WIDTH_PX: u32 = 640;
/// Space around pictures in pixels.
const MARGIN_PX: u32 = 12;
/// Height of the line of labels over a row of pictures, in pixels.
const LABEL_BAR_PX: u32 = label::LINE_HEIGHT_PX + 6;
const PAPER: Rgb<u8> = Rgb([24, 25, 28]);
const INK: Rgb<u8> = Rgb([214, 214, 208]);

/// One row of the sheet.
#[derive(Clone, Debug)]
pub struct Row {
    /// What the row shows: frame and time.
    pub title: String,
    /// Label and picture of each column.
    pub pictures: Vec<(String, RgbImage)>,
}

/// Reads the rows of a sheet: the frames with a reference when there is a truth, else first, middle and last.
///
/// `frames` are those of the recording that have a composite, at least one.
///
/// # Errors
/// When a picture is missing or cannot be decoded.
pub fn rows(output_folder: &Path, frames: &[RecordedFrame], truth: Option<&Truth>) -> Result<Vec<Row>, ToolError> {
    let first_ns = frames.first().map_or(0, |frame| frame.timestamp_ns);
    let reference_of = |frame: &RecordedFrame| {
        truth.and_then(|truth| {
            let reference = truth
                .references
                .iter()
                .find(|reference| reference.frame == frame.sequence)?;
            Some(truth.reference_paths(reference).with)
        })
    };
    let mut chosen: Vec<_> = frames.iter().filter(|frame| reference_of(frame).is_some()).collect();
    if chosen.is_empty() {
        chosen.extend(
            [0, frames.len() / 2, frames.len().saturating_sub(1)]
                .into_iter()
                .filter_map(|i| frames.get(i)),
        );
        chosen.dedup_by_key(|frame| frame.sequence);
    }
    let row = |frame: &RecordedFrame| {
        let sequence = frame.sequence;
        let mut pictures = vec![
            (
                "camera".to_owned(),
                picture::read_any(&frame.path, &format!("the camera's picture of frame {sequence}"))?,
            ),
            (
                "ours".to_owned(),
                picture::read_any(
                    &composite_path(output_folder, sequence),
                    &format!("the composite of frame {sequence}"),
                )?,
            ),
        ];
        if let Some(path) = reference_of(frame) {
            pictures.push((
                "reference".to_owned(),
                picture::read_any(&path, &format!("the reference of frame {sequence}"))?,
            ));
        }
        let time_s = frame.timestamp_ns.saturating_sub(first_ns) as f64 * 1e-9;
        Ok(Row {
            title: format!("frame {sequence}, {time_s:.3} s"),
            pictures,
        })
    };
    chosen.into_iter().map(row).collect()
}

/// Draws the sheet, its pictures no wider than [`CELL_WIDTH_PX`].
pub fn draw(rows: &[Row]) -> RgbImage {
    draw_reduced(rows, CELL_WIDTH_PX)
}

/// Draws the sheet with pictures no wider than `widest_px`.
pub fn draw_reduced(rows: &[Row], widest_px: u32) -> RgbImage {
    let rows: Vec<Row> = rows.iter().map(|row| reduced(row, widest_px)).collect();
    let width_px = rows.iter().map(row_width).max().unwrap_or(0) + MARGIN_PX;
    let height_px = rows.iter().map(row_height).sum::<u32>() + MARGIN_PX;
    let mut sheet = RgbImage::from_pixel(width_px, height_px, PAPER);
    let mut top_px = 0;
    for row in &rows {
        let mut left_px = MARGIN_PX;
        for (index, (name, picture)) in row.pictures.iter().enumerate() {
            let text = if index == 0 {
                format!("{name}  {}", row.title)
            } else {
                name.clone()
            };
            label::draw(&mut sheet, &text, (left_px, top_px + MARGIN_PX), INK);
            let picture_top_px = top_px + MARGIN_PX + LABEL_BAR_PX;
            imageops::replace(&mut sheet, picture, left_px.into(), picture_top_px.into());
            left_px += picture.width() + MARGIN_PX;
        }
        top_px += row_height(row);
    }
    sheet
}

/// Returns the row with pictures no wider than a cell.
fn reduced(row: &Row, widest_px: u32) -> Row {
    let pictures = row
        .pictures
        .iter()
        .map(|(name, picture)| (name.clone(), reduce(picture, widest_px)));
    Row {
        title: row.title.clone(),
        pictures: pictures.collect(),
    }
}

/// Returns the picture, reduced when it is wider than a limit.
pub(crate) fn reduce(picture: &RgbImage, widest_px: u32) -> RgbImage {
    if picture.width() <= widest_px {
        return picture.clone();
    }
    let height_px = (picture.height() * widest_px).div_ceil(picture.width());
    imageops::resize(picture, widest_px, height_px, imageops::FilterType::CatmullRom)
}

fn row_width(row: &Row) -> u32 {
    row.pictures
        .iter()
        .map(|(_, picture)| picture.width() + MARGIN_PX)
        .sum()
}

fn row_height(row: &Row) -> u32 {
    let tallest_px = row
        .pictures
        .iter()
        .map(|(_, picture)| picture.height())
        .max()
        .unwrap_or(0);
    MARGIN_PX + LABEL_BAR_PX + tallest_px
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_stand_side_by_side_and_large_ones_are_reduced() {
        let row = |width, height| Row {
            title: "frame 3, 0.100 s".to_owned(),
            pictures: ["camera", "ours"]
                .map(|name| (name.to_owned(), RgbImage::from_pixel(width, height, Rgb([9; 3]))))
                .to_vec(),
        };
        let sheet = draw(&[row(1280, 720), row(320, 240)]);
        assert_eq!(
            sheet.dimensions(),
            (2 * 640 + 3 * MARGIN_PX, 360 + 240 + 3 * MARGIN_PX + 2 * LABEL_BAR_PX)
        );
        assert_eq!(sheet.get_pixel(MARGIN_PX, MARGIN_PX + LABEL_BAR_PX).0, [9; 3]);
    }
}
