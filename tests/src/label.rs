//! Short texts drawn into pictures with the bitmap font Spleen, 12 × 24 pixels.
//!
//! The crate's 8 × 16 variant is a PSF1 file, whose header version 0.2.0 misreads (it swaps mode and height).

use image::{Rgb, RgbImage};
use spleen_font::{FONT_12X24, PSF2Font};

/// Width of a character in pixels.
pub const CHARACTER_WIDTH_PX: u32 = 12;
/// Height of a line in pixels.
pub const LINE_HEIGHT_PX: u32 = 24;

/// Draws one line with its upper left corner at a pixel; what does not fit is cut off, unknown characters are left out.
pub fn draw(picture: &mut RgbImage, text: &str, (left_px, top_px): (u32, u32), ink: Rgb<u8>) {
    let Ok(mut font) = PSF2Font::new(FONT_12X24) else {
        unreachable!("the font is part of its crate, which checks it");
    };
    for (index, character) in text.chars().enumerate() {
        let Some(glyph) = font.glyph_for_utf8(character.encode_utf8(&mut [0; 4]).as_bytes()) else {
            continue;
        };
        let glyph_left_px = left_px + index as u32 * CHARACTER_WIDTH_PX;
        for (y, row) in (top_px..).zip(glyph) {
            for (x, _) in (glyph_left_px..).zip(row).filter(|(_, is_ink)| *is_ink) {
                if let Some(pixel) = picture.get_pixel_mut_checked(x, y) {
                    *pixel = ink;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_leaves_ink_inside_its_box_only() {
        let mut picture = RgbImage::new(80, 40);
        draw(&mut picture, "ours", (10, 5), Rgb([255; 3]));
        let inked: Vec<_> = picture
            .enumerate_pixels()
            .filter(|(_, _, pixel)| pixel.0 == [255; 3])
            .collect();
        assert!(inked.len() > 150, "{}", inked.len());
        assert!(
            inked
                .iter()
                .all(|(x, y, _)| (10..58).contains(x) && (5..29).contains(y))
        );
        draw(&mut picture, "cut off at the edge", (70, 35), Rgb([255; 3]));
    }
}
