//! Whether a cell of the picture lies in a shadow that the prediction does not know (`protect_vote`).

use glam::{Vec3, Vec4};

use crate::passes::protect::GpuCell;

/// Logarithm of the reflectance of `cell` if bright light is missing there, and in w the belief that it is, 0 to 1; zeros for
/// less than 0.05. `asked` are the cells that may speak.
#[must_use]
pub fn verdict(cell: &GpuCell, asked: &[GpuCell]) -> Vec4 {
    let share = cell.share.truncate();
    if cell.log_reflectance.w == 0.0 || share.element_sum() / 3.0 < 0.4 {
        return Vec4::ZERO;
    }
    let log_left = (1.0 - share).max(Vec3::splat(0.01)).map(f32::ln);
    let (mut as_seen, mut as_shaded, mut reference) = (0.0, 0.0, Vec3::ZERO);
    for other in asked.iter().filter(|other| is_same_plane(cell, other)) {
        let there = other.log_reflectance.truncate();
        let difference = there - cell.log_reflectance.truncate();
        as_seen += likeness(difference, 0.15);
        let support = likeness(difference + log_left, 0.35);
        as_shaded += support;
        reference += support * there;
    }
    let belief = 0.5 * as_shaded / (0.5 * as_shaded + as_seen + 1.0);
    if belief < 0.05 {
        return Vec4::ZERO;
    }
    (reference / as_shaded).extend(belief)
}

fn is_same_plane(a: &GpuCell, b: &GpuCell) -> bool {
    let (normal, across) = (a.normal.truncate(), (b.place_m - a.place_m).truncate());
    b.log_reflectance.w > 0.0 && normal.dot(b.normal.truncate()) > 0.98 && across.dot(normal).abs() < 0.001
}

fn likeness(difference: Vec3, darker_sigma: f32) -> f32 {
    let brightness = difference.element_sum() / 3.0;
    let color = difference - brightness;
    let sigmas = brightness / if brightness > 0.0 { darker_sigma } else { 0.15 };
    (-0.5 * (sigmas * sigmas + color.length_squared() / (0.07 * 0.07))).exp()
}
