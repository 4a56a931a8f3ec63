//! Radiance of scenes without camera as codes of a screen: the only place where that happens.

use glam::Vec4;
use rayon::prelude::*;

/// Exposure that shows the test scene well: radiance times this is the share of the screen's white.
pub const EXPOSURE: f32 = 0.9;

/// Linear radiance as sRGB codes with opaque alpha, four bytes per pixel; brighter than white is cut off.
#[must_use]
pub fn srgb(radiance: &[Vec4], exposure: f32) -> Vec<u8> {
    radiance
        .par_iter()
        .flat_map_iter(|texel| {
            let code = |linear: f32| (255.0 * encoded(exposure * linear) + 0.5) as u8;
            [code(texel.x), code(texel.y), code(texel.z), 255]
        })
        .collect()
}

/// IEC 61966-2-1, 0 ..= 1; NaN stays, and becomes code 0.
fn encoded(linear: f32) -> f32 {
    let linear = linear.clamp(0.0, 1.0);
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_the_standard() {
        let radiance = [0.0, 0.5, 2.0, f32::NAN].map(|value| Vec4::new(value, 0.001, -1.0, 0.0));
        let codes = srgb(&radiance, 0.428_69);
        assert_eq!(codes.len(), 16);
        // 0.5 × 0.42869 = 0.214345: half of the encoded range, 127.5.
        assert!(codes[4].abs_diff(127) <= 1);
        assert_eq!([codes[0], codes[8], codes[12]], [0, 238, 0]);
        assert_eq!([codes[1], codes[2], codes[3]], [1, 0, 255]);
    }
}
