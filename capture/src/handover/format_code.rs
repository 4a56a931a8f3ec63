//! Pixel formats as numbers, for packets.

use crate::frame::{PixelFormat, Ycbcr, YcbcrMatrix, YcbcrRange};

// To the codes of Y'CbCr formats those of matrix and range are added.
const RGB8: u32 = 1;
const GREY8: u32 = 2;
const MJPEG: u32 = 3;
const YUYV: u32 = 16;
const NV12: u32 = 32;
const BT709: u32 = 1;
const FULL_RANGE: u32 = 2;

/// The code of a format.
pub(super) fn code_of(format: PixelFormat) -> u32 {
    match format {
        PixelFormat::Rgb8 => RGB8,
        PixelFormat::Grey8 => GREY8,
        PixelFormat::Mjpeg => MJPEG,
        PixelFormat::Yuyv(ycbcr) => YUYV + code_of_ycbcr(ycbcr),
        PixelFormat::Nv12(ycbcr) => NV12 + code_of_ycbcr(ycbcr),
    }
}

fn code_of_ycbcr(ycbcr: Ycbcr) -> u32 {
    let matrix = match ycbcr.matrix {
        YcbcrMatrix::Bt601 => 0,
        YcbcrMatrix::Bt709 => BT709,
    };
    let range = match ycbcr.range {
        YcbcrRange::Limited => 0,
        YcbcrRange::Full => FULL_RANGE,
    };
    matrix + range
}

/// The format with this code.
pub(super) fn format_of(code: u32) -> Option<PixelFormat> {
    let ycbcr = Ycbcr {
        matrix: if code & BT709 == 0 {
            YcbcrMatrix::Bt601
        } else {
            YcbcrMatrix::Bt709
        },
        range: if code & FULL_RANGE == 0 {
            YcbcrRange::Limited
        } else {
            YcbcrRange::Full
        },
    };
    match code {
        RGB8 => Some(PixelFormat::Rgb8),
        GREY8 => Some(PixelFormat::Grey8),
        MJPEG => Some(PixelFormat::Mjpeg),
        _ if code & !3 == YUYV => Some(PixelFormat::Yuyv(ycbcr)),
        _ if code & !3 == NV12 => Some(PixelFormat::Nv12(ycbcr)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_stands_for_one_format() {
        let formats: Vec<_> = (0..1000).filter_map(|code| Some((code, format_of(code)?))).collect();
        assert_eq!(formats.len(), 3 + 4 + 4);
        assert!(formats.iter().all(|(code, format)| code_of(*format) == *code));
    }
}
