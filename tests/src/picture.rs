//! Reading 8-bit pictures with file and role in the error.

use crate::ToolError;
use image::{DynamicImage, GrayImage, ImageReader, RgbImage};
use std::path::Path;

/// Reads an 8-bit RGB picture of a given size; `role` is a phrase that says what it is.
///
/// # Errors
/// When the file is missing, cannot be decoded, is not 8-bit RGB, or has another size.
pub fn read_rgb(path: &Path, role: &str, expected_px: [usize; 2]) -> Result<RgbImage, ToolError> {
    match read_sized(path, role, expected_px)? {
        DynamicImage::ImageRgb8(picture) => Ok(picture),
        other => Err(wrong_kind(path, role, &other, "Rgb8")),
    }
}

/// Reads an 8-bit greyscale picture of a given size; `role` is a phrase that says what it is.
///
/// # Errors
/// When the file is missing, cannot be decoded, is not 8-bit greyscale, or has another size.
pub fn read_grey(path: &Path, role: &str, expected_px: [usize; 2]) -> Result<GrayImage, ToolError> {
    match read_sized(path, role, expected_px)? {
        DynamicImage::ImageLuma8(picture) => Ok(picture),
        other => Err(wrong_kind(path, role, &other, "L8")),
    }
}

/// Reads a picture for showing: any size, any kind, as 8-bit RGB.
///
/// # Errors
/// When the file is missing or cannot be decoded.
pub fn read_any(path: &Path, role: &str) -> Result<RgbImage, ToolError> {
    Ok(decode(path, role)?.into_rgb8())
}

fn read_sized(path: &Path, role: &str, expected_px: [usize; 2]) -> Result<DynamicImage, ToolError> {
    let picture = decode(path, role)?;
    let found_px = [picture.width() as usize, picture.height() as usize];
    if found_px == expected_px {
        Ok(picture)
    } else {
        Err(ToolError::Size {
            path: path.to_owned(),
            role: role.to_owned(),
            found_px,
            expected_px,
        })
    }
}

fn decode(path: &Path, role: &str) -> Result<DynamicImage, ToolError> {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let reader = reader.map_err(|source| ToolError::Unreadable {
        path: path.to_owned(),
        role: role.to_owned(),
        source,
    })?;
    reader.decode().map_err(|source| ToolError::Picture {
        path: path.to_owned(),
        role: role.to_owned(),
        source,
    })
}

fn wrong_kind(path: &Path, role: &str, found: &DynamicImage, allowed: &'static str) -> ToolError {
    ToolError::PixelKind {
        path: path.to_owned(),
        role: role.to_owned(),
        found: format!("{:?}", found.color()),
        allowed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::failure_text;

    #[test]
    fn a_composite_of_wrong_size_or_kind_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("000004.png");
        RgbImage::new(8, 6).save(&path).unwrap();
        assert!(read_rgb(&path, "the composite of frame 4", [8, 6]).is_ok());
        let text = failure_text(&read_rgb(&path, "the composite of frame 4", [8, 7]).unwrap_err());
        assert!(
            text.contains("000004.png`, the composite of frame 4, is `8 x 6` pixels; expected are `8 x 7`"),
            "{text}"
        );
        let error = read_grey(&path, "the mask", [8, 6]).unwrap_err();
        assert!(matches!(error, ToolError::PixelKind { allowed: "L8", .. }), "{error}");
        std::fs::write(&path, b"not a picture").unwrap();
        let error = read_any(&path, "the composite of frame 4").unwrap_err();
        assert!(matches!(error, ToolError::Picture { .. }), "{error}");
    }
}
