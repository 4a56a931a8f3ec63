//! Frames of any format as 8-bit RGB, for whoever computes with them.
//!
//! Decoding takes milliseconds, so nobody does it who has to keep up with a camera: the render node decodes the frames
//! it uses, a worker thread of the daemon those it measures.

use std::io::Cursor;

use image::codecs::jpeg::JpegDecoder;
use image::{ColorType, ImageDecoder, ImageError, Limits};
use yuv::{YuvBiPlanarImage, YuvConversionMode, YuvError, YuvPackedImage, YuvRange, YuvStandardMatrix};

use crate::frame::{Frame, PixelFormat, Size, Ycbcr, YcbcrMatrix, YcbcrRange};
use crate::source::SIDE_MAX_PX;

/// Memory a decoder may take besides the picture itself.
const DECODER_MAX_BYTES: u64 = 64 << 20;

/// What every whole JPEG picture ends with: the marker EOI (ITU-T T.81, B.1.1.3). Cameras may pad what follows.
const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];

/// Why a frame cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The length of the pixels does not follow from format and size.
    #[error("a frame of {}×{} px in format {format:?} cannot have {found_bytes} bytes", size.width, size.height)]
    Length {
        /// Format of the frame.
        format: PixelFormat,
        /// Size of the frame.
        size: Size,
        /// Length of its pixels.
        found_bytes: usize,
    },
    /// The JPEG picture is cut off.
    #[error("the JPEG picture of {found_bytes} bytes is cut off: it has no end marker")]
    CutOff {
        /// Length of the data.
        found_bytes: usize,
    },
    /// The JPEG picture is broken.
    #[error("the frame is no valid JPEG picture")]
    Jpeg(#[source] ImageError),
    /// The JPEG picture has another size than the camera has announced.
    #[error("the JPEG picture is {}×{} px, the camera sends {}×{} px",
        found.width, found.height, expected.width, expected.height)]
    WrongSize {
        /// Size of the picture.
        found: Size,
        /// Size of the camera's frames.
        expected: Size,
    },
    /// The conversion library refuses the picture.
    #[error("cannot convert luma and colour differences to RGB")]
    Convert(#[source] YuvError),
}

/// The frame as [`PixelFormat::Rgb8`], still encoded by the camera's response; a clone if it is so already.
///
/// Grey becomes three equal channels. JPEG is taken as JFIF has it: BT.601, full range.
///
/// # Errors
///
/// [`DecodeError`] if the pixels are not what format and size say. Nothing is decoded in part.
pub fn to_rgb8(frame: &Frame) -> Result<Frame, DecodeError> {
    if !frame.format.admits(frame.size, frame.pixels.len()) {
        return Err(DecodeError::Length {
            format: frame.format,
            size: frame.size,
            found_bytes: frame.pixels.len(),
        });
    }
    let rgb = match frame.format {
        PixelFormat::Rgb8 => return Ok(frame.clone()),
        PixelFormat::Grey8 => frame.pixels.iter().flat_map(|&grey| [grey; 3]).collect(),
        PixelFormat::Yuyv(ycbcr) => from_yuyv(&frame.pixels, frame.size, ycbcr)?,
        PixelFormat::Nv12(ycbcr) => from_nv12(&frame.pixels, frame.size, ycbcr)?,
        PixelFormat::Mjpeg => from_jpeg(&frame.pixels, frame.size)?,
    };
    Ok(Frame {
        meta: frame.meta.clone(),
        size: frame.size,
        format: PixelFormat::Rgb8,
        pixels: rgb.into(),
    })
}

/// True if the bytes begin and end as a JPEG picture does: cheap enough to ask of every frame.
#[must_use]
pub fn is_whole_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xFF, 0xD8]) && without_padding(bytes).ends_with(&END_OF_IMAGE)
}

/// The bytes without the zeros that some cameras fill their buffers up with.
fn without_padding(bytes: &[u8]) -> &[u8] {
    let padding = bytes.iter().rev().take_while(|&&byte| byte == 0).count();
    &bytes[..bytes.len() - padding]
}

fn from_yuyv(pixels: &[u8], size: Size, ycbcr: Ycbcr) -> Result<Vec<u8>, DecodeError> {
    let mut rgb = vec![0; size.pixels() * 3];
    let picture = YuvPackedImage {
        yuy: pixels,
        yuy_stride: size.width * 2,
        width: size.width,
        height: size.height,
    };
    yuv::yuyv422_to_rgb(&picture, &mut rgb, size.width * 3, range_of(ycbcr), matrix_of(ycbcr))
        .map_err(DecodeError::Convert)?;
    Ok(rgb)
}

fn from_nv12(pixels: &[u8], size: Size, ycbcr: Ycbcr) -> Result<Vec<u8>, DecodeError> {
    let mut rgb = vec![0; size.pixels() * 3];
    let (luma, chroma) = pixels.split_at(size.pixels());
    let picture = YuvBiPlanarImage {
        y_plane: luma,
        y_stride: size.width,
        uv_plane: chroma,
        uv_stride: size.width,
        width: size.width,
        height: size.height,
    };
    let (range, matrix) = (range_of(ycbcr), matrix_of(ycbcr));
    yuv::yuv_nv12_to_rgb(
        &picture,
        &mut rgb,
        size.width * 3,
        range,
        matrix,
        YuvConversionMode::Balanced,
    )
    .map_err(DecodeError::Convert)?;
    Ok(rgb)
}

fn from_jpeg(bytes: &[u8], expected: Size) -> Result<Vec<u8>, DecodeError> {
    // Decoders fill up what is missing with grey, which would be light that nobody measured.
    if !is_whole_jpeg(bytes) {
        return Err(DecodeError::CutOff {
            found_bytes: bytes.len(),
        });
    }
    let mut decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(DecodeError::Jpeg)?;
    let mut limits = Limits::no_limits();
    limits.max_image_width = Some(SIDE_MAX_PX);
    limits.max_image_height = Some(SIDE_MAX_PX);
    limits.max_alloc = Some(expected.pixels() as u64 * 3 + DECODER_MAX_BYTES);
    decoder.set_limits(limits).map_err(DecodeError::Jpeg)?;
    let (width, height) = decoder.dimensions();
    let found = Size { width, height };
    if found != expected {
        return Err(DecodeError::WrongSize { found, expected });
    }
    let is_grey = decoder.color_type() == ColorType::L8;
    let mut decoded = vec![0; usize::try_from(decoder.total_bytes()).unwrap_or(0)];
    decoder.read_image(&mut decoded).map_err(DecodeError::Jpeg)?;
    Ok(if is_grey {
        decoded.iter().flat_map(|&grey| [grey; 3]).collect()
    } else {
        decoded
    })
}

fn range_of(ycbcr: Ycbcr) -> YuvRange {
    match ycbcr.range {
        YcbcrRange::Limited => YuvRange::Limited,
        YcbcrRange::Full => YuvRange::Full,
    }
}

fn matrix_of(ycbcr: Ycbcr) -> YuvStandardMatrix {
    match ycbcr.matrix {
        YcbcrMatrix::Bt601 => YuvStandardMatrix::Bt601,
        YcbcrMatrix::Bt709 => YuvStandardMatrix::Bt709,
    }
}

#[cfg(test)]
mod tests {
    use image::ExtendedColorType;
    use image::codecs::jpeg::JpegEncoder;
    use proptest::prelude::*;

    use super::*;
    use crate::frame::{Exposure, FrameMeta};

    const SIZE: Size = Size { width: 16, height: 8 };

    fn frame(format: PixelFormat, pixels: Vec<u8>) -> Frame {
        let exposure = Exposure {
            time_s: 0.01,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        Frame {
            meta: FrameMeta::new("scene".into(), 0, 0, exposure),
            size: SIZE,
            format,
            pixels: pixels.into(),
        }
    }

    fn all_ycbcr() -> Vec<Ycbcr> {
        let matrices = [YcbcrMatrix::Bt601, YcbcrMatrix::Bt709];
        let ranges = [YcbcrRange::Limited, YcbcrRange::Full];
        matrices
            .into_iter()
            .flat_map(|matrix| ranges.map(|range| Ycbcr { matrix, range }))
            .collect()
    }

    /// Codes of a colour by the definition in ITU-R BT.601 and BT.709, section 3.
    fn codes(rgb: [u8; 3], ycbcr: Ycbcr) -> [u8; 3] {
        let [red, green, blue] = rgb.map(|code| f64::from(code) / 255.0);
        let (kr, kb) = match ycbcr.matrix {
            YcbcrMatrix::Bt601 => (0.299, 0.114),
            YcbcrMatrix::Bt709 => (0.2126, 0.0722),
        };
        let luma = kr * red + (1.0 - kr - kb) * green + kb * blue;
        let (cb, cr) = ((blue - luma) / (2.0 * (1.0 - kb)), (red - luma) / (2.0 * (1.0 - kr)));
        match ycbcr.range {
            YcbcrRange::Limited => [16.0 + 219.0 * luma, 128.0 + 224.0 * cb, 128.0 + 224.0 * cr],
            YcbcrRange::Full => [255.0 * luma, 128.0 + 255.0 * cb, 128.0 + 255.0 * cr],
        }
        .map(|code| code.round() as u8)
    }

    fn worst(rgb: &[u8], expected: [u8; 3]) -> u8 {
        rgb.chunks_exact(3)
            .flat_map(|pixel| (0..3).map(|c| pixel[c].abs_diff(expected[c])))
            .max()
            .unwrap()
    }

    #[test]
    fn colours_come_out_as_the_standards_say() {
        let colours = [
            [0, 0, 0],
            [255, 255, 255],
            [128, 128, 128],
            [200, 40, 90],
            [20, 180, 220],
            [250, 230, 10],
        ];
        for ycbcr in all_ycbcr() {
            for colour in colours {
                let [luma, cb, cr] = codes(colour, ycbcr);
                let yuyv = [luma, cb, luma, cr].repeat(SIZE.pixels() / 2);
                let nv12 = [vec![luma; SIZE.pixels()], [cb, cr].repeat(SIZE.pixels() / 4)].concat();
                for frame in [
                    frame(PixelFormat::Yuyv(ycbcr), yuyv),
                    frame(PixelFormat::Nv12(ycbcr), nv12),
                ] {
                    let rgb = to_rgb8(&frame).unwrap();
                    // Rounding of three codes, seen through the steepest coefficient, 2.1.
                    assert!(worst(&rgb.pixels, colour) <= 3, "{:?} {colour:?}", frame.format);
                }
            }
        }
        let grey = to_rgb8(&frame(PixelFormat::Grey8, vec![77; SIZE.pixels()])).unwrap();
        assert_eq!(worst(&grey.pixels, [77; 3]), 0);
    }

    fn jpeg() -> Vec<u8> {
        let mut jpeg = Vec::new();
        let rgb = [90, 140, 60].repeat(SIZE.pixels());
        let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, 95);
        encoder
            .encode(&rgb, SIZE.width, SIZE.height, ExtendedColorType::Rgb8)
            .unwrap();
        jpeg
    }

    /// A camera's picture is padded to this length in these tests: more than the tiny picture takes.
    fn jpeg_frame(bytes: &[u8]) -> Frame {
        let mut frame = frame(PixelFormat::Mjpeg, bytes.to_vec());
        frame.size = SIZE;
        frame
    }

    #[test]
    fn jpeg_is_decoded_or_refused_as_a_whole() {
        let whole = jpeg();
        let decode = |bytes: &[u8], size| from_jpeg(bytes, size);
        assert!(worst(&decode(&whole, SIZE).unwrap(), [90, 140, 60]) <= 3);
        assert!(decode(&[&whole[..], &[0; 64]].concat(), SIZE).is_ok());
        for n_bytes in 0..whole.len() {
            assert!(decode(&whole[..n_bytes], SIZE).is_err(), "{n_bytes}");
        }
        let other = Size { width: 8, height: 8 };
        assert!(matches!(
            decode(&whole, other).unwrap_err(),
            DecodeError::WrongSize { .. }
        ));
        let cut = jpeg_frame(&whole[..100]);
        assert!(matches!(
            to_rgb8(&cut).unwrap_err(),
            DecodeError::CutOff { found_bytes: 100 }
        ));
    }

    #[test]
    fn wrong_lengths_are_refused() {
        let [ycbcr, ..] = all_ycbcr()[..] else { panic!() };
        for format in [
            PixelFormat::Rgb8,
            PixelFormat::Grey8,
            PixelFormat::Yuyv(ycbcr),
            PixelFormat::Nv12(ycbcr),
            PixelFormat::Mjpeg,
        ] {
            let too_long = vec![1; format.max_bytes(SIZE) + 1];
            for pixels in [vec![], too_long] {
                let error = to_rgb8(&frame(format, pixels)).unwrap_err();
                assert!(matches!(error, DecodeError::Length { .. }), "{error}");
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2048))]

        #[test]
        fn no_jpeg_panics(changes in proptest::collection::vec((0usize..600, any::<u8>()), 0..8), cut in 0usize..700) {
            let mut bytes = jpeg();
            for (place, value) in changes {
                let place = place % bytes.len();
                bytes[place] = value;
            }
            let _ = from_jpeg(&bytes, SIZE);
            bytes.truncate(cut);
            bytes.extend(END_OF_IMAGE);
            let _ = from_jpeg(&bytes, SIZE);
        }
    }
}
