//! Pixels of a picture that show nothing, marked by a colour: the borders of registered pictures.

/// Pixels around a hole that its edge may have touched.
const HOLE_EDGE_PX: usize = 3;

/// Largest difference to the masked colour, per channel: registration and compression blur it.
const HOLE_TOLERANCE: u8 = 48;

/// Three codes, separated by commas.
pub(crate) fn rgb(text: &str) -> Result<[u8; 3], String> {
    let codes: Result<Vec<u8>, _> = text.split(',').map(|code| code.trim().parse()).collect();
    codes
        .ok()
        .and_then(|codes| codes.try_into().ok())
        .ok_or_else(|| "three codes of 0 to 255, such as `0,0,255`".to_owned())
}

/// Pixels of a colour, and those around them.
pub(crate) fn holes(codes: &[u8], [width, height]: [usize; 2], color: [u8; 3]) -> Vec<bool> {
    let is_hole = |pixel: &[u8]| {
        pixel
            .iter()
            .zip(color)
            .all(|(&code, of)| code.abs_diff(of) <= HOLE_TOLERANCE)
    };
    let mut holes: Vec<bool> = codes.chunks_exact(3).map(is_hole).collect();
    // Rows, then columns.
    for (step, stride, n) in [(1, width, height), (width, 1, width)] {
        let length = width * height / n.max(1);
        for line in 0..n {
            let at = |i: usize| line * stride + i * step;
            let before: Vec<bool> = (0..length).map(|i| holes[at(i)]).collect();
            for i in 0..length {
                let around = i.saturating_sub(HOLE_EDGE_PX)..(i + HOLE_EDGE_PX + 1).min(length);
                holes[at(i)] = before[around].iter().any(|&hole| hole);
            }
        }
    }
    holes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_border_and_its_edge_are_holes_and_nothing_else() {
        let (width, height) = (12, 5);
        let codes: Vec<u8> = (0..width * height)
            .flat_map(|pixel| if pixel % width < 2 { [4, 0, 250] } else { [90, 90, 255] })
            .collect();
        let holes = holes(&codes, [width, height], [0, 0, 255]);
        for (pixel, is_hole) in holes.into_iter().enumerate() {
            assert_eq!(is_hole, pixel % width < 2 + HOLE_EDGE_PX, "{pixel}");
        }
    }

    #[test]
    fn a_color_is_three_codes() {
        assert_eq!(rgb("0, 0,255"), Ok([0, 0, 255]));
        for text in ["0,0", "0,0,256", "blue", "0,0,255,0"] {
            assert!(rgb(text).is_err(), "{text}");
        }
    }
}
