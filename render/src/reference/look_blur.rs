//! A picture blurred along three lines of taps.

use glam::{IVec2, Vec4};

use crate::look::kernel::Line;

/// The picture of `size_px` after all three lines; beyond its edge it goes on as it is there.
#[must_use]
pub fn blurred(picture: &[Vec4], size_px: [u32; 2], lines: &[Line; 3]) -> Vec<Vec4> {
    let size = IVec2::from(size_px.map(|s| s as i32));
    lines.iter().fold(picture.to_vec(), |source, line| {
        (0..size.x * size.y)
            .map(|index| {
                let at = IVec2::new(index % size.x, index / size.x);
                let reach = line.weights.len() as i32 - 1;
                (-reach..=reach)
                    .map(|i| {
                        let from = (at + i * line.step_px).clamp(IVec2::ZERO, size - 1);
                        line.weights[i.unsigned_abs() as usize] as f32 * source[(from.y * size.x + from.x) as usize]
                    })
                    .sum()
            })
            .collect()
    })
}
