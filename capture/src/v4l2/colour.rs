//! What a driver's colour space, encoding and quantization mean for luma and colour differences.
//!
//! Constants and defaults as in `linux/videodev2.h`: `V4L2_MAP_YCBCR_ENC_DEFAULT`, `V4L2_MAP_QUANTIZATION_DEFAULT`.

use v4l::v4l_sys as sys;

use super::ioctl::Layout;
use crate::frame::{Ycbcr, YcbcrMatrix, YcbcrRange};

/// Matrix and range of a layout of Y, Cb and Cr.
///
/// # Errors
///
/// The name of the encoding, if it is none of BT.601 and BT.709.
pub(super) fn ycbcr(layout: &Layout) -> Result<Ycbcr, String> {
    let matrix = match layout.ycbcr_enc {
        sys::v4l2_ycbcr_encoding_V4L2_YCBCR_ENC_DEFAULT => default_matrix(layout.colorspace)?,
        // xvYCC and sYCC differ in what lies beyond white, not in the weights.
        sys::v4l2_ycbcr_encoding_V4L2_YCBCR_ENC_601
        | sys::v4l2_ycbcr_encoding_V4L2_YCBCR_ENC_XV601
        | sys::v4l2_ycbcr_encoding_V4L2_YCBCR_ENC_SYCC => YcbcrMatrix::Bt601,
        sys::v4l2_ycbcr_encoding_V4L2_YCBCR_ENC_709 | sys::v4l2_ycbcr_encoding_V4L2_YCBCR_ENC_XV709 => {
            YcbcrMatrix::Bt709
        }
        other => return Err(format!("Y'CbCr encoding {other} of V4L2 is neither BT.601 nor BT.709")),
    };
    Ok(Ycbcr {
        matrix,
        range: range(layout),
    })
}

/// Codes of black and white.
pub(super) fn range(layout: &Layout) -> YcbcrRange {
    match layout.quantization {
        sys::v4l2_quantization_V4L2_QUANTIZATION_FULL_RANGE => YcbcrRange::Full,
        sys::v4l2_quantization_V4L2_QUANTIZATION_LIM_RANGE => YcbcrRange::Limited,
        _ if layout.colorspace == sys::v4l2_colorspace_V4L2_COLORSPACE_JPEG => YcbcrRange::Full,
        _ => YcbcrRange::Limited,
    }
}

fn default_matrix(colorspace: u32) -> Result<YcbcrMatrix, String> {
    match colorspace {
        sys::v4l2_colorspace_V4L2_COLORSPACE_REC709 | sys::v4l2_colorspace_V4L2_COLORSPACE_DCI_P3 => {
            Ok(YcbcrMatrix::Bt709)
        }
        sys::v4l2_colorspace_V4L2_COLORSPACE_BT2020 => Err("colour space BT.2020 is not supported".into()),
        sys::v4l2_colorspace_V4L2_COLORSPACE_SMPTE240M => Err("colour space SMPTE 240M is not supported".into()),
        _ => Ok(YcbcrMatrix::Bt601),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Size;

    fn meaning(colorspace: u32, ycbcr_enc: u32, quantization: u32) -> Result<(YcbcrMatrix, YcbcrRange), String> {
        let layout = Layout {
            fourcc: *b"YUYV",
            size: Size { width: 2, height: 1 },
            bytes_per_line: 4,
            image_bytes: 4,
            colorspace,
            ycbcr_enc,
            quantization,
        };
        ycbcr(&layout).map(|ycbcr| (ycbcr.matrix, ycbcr.range))
    }

    #[test]
    fn defaults_of_each_colour_space() {
        use YcbcrMatrix::{Bt601, Bt709};
        use YcbcrRange::{Full, Limited};
        // Unknown, SMPTE 170M, Rec. 709, JPEG, sRGB, DCI-P3.
        for (colorspace, expected) in [
            (0, (Bt601, Limited)),
            (1, (Bt601, Limited)),
            (3, (Bt709, Limited)),
            (7, (Bt601, Full)),
            (8, (Bt601, Limited)),
            (12, (Bt709, Limited)),
            (99, (Bt601, Limited)),
        ] {
            assert_eq!(meaning(colorspace, 0, 0), Ok(expected), "colour space {colorspace}");
        }
        assert!(meaning(10, 0, 0).is_err() && meaning(2, 0, 0).is_err());
    }

    #[test]
    fn what_the_driver_says_wins() {
        assert_eq!(meaning(8, 2, 1), Ok((YcbcrMatrix::Bt709, YcbcrRange::Full)));
        assert_eq!(meaning(7, 1, 2), Ok((YcbcrMatrix::Bt601, YcbcrRange::Limited)));
        assert!(meaning(8, 6, 0).unwrap_err().contains("encoding 6"));
    }
}
