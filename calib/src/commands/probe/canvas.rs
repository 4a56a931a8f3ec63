//! A picture to draw on: lines, circles, and letters of the bitmap font Spleen, 12 × 24 pixels.

use image::{Rgb, RgbImage};
use spleen_font::{FONT_12X24, PSF2Font};

/// Height of a line of text, pixels.
pub(crate) const LINE_PX: u32 = 24;
/// Width of a letter, pixels.
pub(crate) const LETTER_PX: u32 = 12;

/// Colours are sRGB.
pub(crate) type Ink = Rgb<u8>;

pub(crate) const WHITE: Ink = Rgb([255, 255, 255]);
pub(crate) const BLACK: Ink = Rgb([0, 0, 0]);

/// Draws one line of text with its upper left corner at a pixel, on a dark ground; what does not fit is cut off, letters that
/// the font lacks are left out.
pub(crate) fn text(picture: &mut RgbImage, text: &str, (left_px, top_px): (i64, i64), ink: Ink) {
    let Ok(mut font) = PSF2Font::new(FONT_12X24) else {
        unreachable!("the font is part of its crate, which checks it");
    };
    for (index, letter) in (0i64..).zip(text.chars()) {
        let Some(glyph) = font.glyph_for_utf8(letter.encode_utf8(&mut [0; 4]).as_bytes()) else {
            continue;
        };
        let letter_left_px = left_px + index * i64::from(LETTER_PX);
        for (y, row) in (top_px..).zip(glyph) {
            for (x, is_ink) in (letter_left_px..).zip(row) {
                put(picture, (x, y), if is_ink { ink } else { BLACK });
            }
        }
    }
}

/// Sets a pixel, if there is one.
pub(crate) fn put(picture: &mut RgbImage, (x, y): (i64, i64), ink: Ink) {
    if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
        && let Some(pixel) = picture.get_pixel_mut_checked(x, y)
    {
        *pixel = ink;
    }
}

/// Fills a rectangle.
pub(crate) fn fill(picture: &mut RgbImage, (left, top): (i64, i64), [width, height]: [u32; 2], ink: Ink) {
    for y in 0..i64::from(height) {
        for x in 0..i64::from(width) {
            put(picture, (left + x, top + y), ink);
        }
    }
}
