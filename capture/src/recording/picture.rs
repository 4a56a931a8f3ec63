//! Reads one picture file into memory, within limits.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use image::{ColorType, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};

use crate::frame::Size;
use crate::source::{PictureError, SIDE_MAX_PX};

/// Memory a decoder may take besides the picture itself.
const DECODER_MAX_BYTES: u64 = 64 << 20;

/// Reads the PNG or JPEG picture at `path`, which must be 8-bit RGB and of size `expected`.
pub(super) fn read_picture(path: &Path, expected: Size) -> Result<Vec<u8>, PictureError> {
    let file = File::open(path).map_err(PictureError::Read)?;
    let mut reader = ImageReader::new(BufReader::new(file))
        .with_guessed_format()
        .map_err(PictureError::Read)?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        let hint = reader
            .format()
            .map_or(image::error::ImageFormatHint::Unknown, Into::into);
        return Err(PictureError::Decode(ImageError::Unsupported(hint.into())));
    }
    let picture_bytes = expected.pixels() as u64 * 3;
    let mut limits = Limits::no_limits();
    limits.max_image_width = Some(SIDE_MAX_PX);
    limits.max_image_height = Some(SIDE_MAX_PX);
    limits.max_alloc = Some(picture_bytes + DECODER_MAX_BYTES);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(decode_error)?;
    let (width, height) = decoder.dimensions();
    let found = Size { width, height };
    if found != expected {
        return Err(PictureError::WrongSize { found, expected });
    }
    if decoder.color_type() != ColorType::Rgb8 {
        return Err(PictureError::PixelKind {
            found: format!("{:?}", decoder.color_type()),
        });
    }
    let mut pixels = vec![0; expected.pixels() * 3];
    decoder.read_image(&mut pixels).map_err(decode_error)?;
    Ok(pixels)
}

fn decode_error(error: ImageError) -> PictureError {
    match error {
        ImageError::IoError(source) => PictureError::Read(source),
        other => PictureError::Decode(other),
    }
}
