//! Mips by solid angle; the light tree itself is plain enough to be its own twin.

use glam::Vec3;

pub use crate::light_tree::LightTree;
use mirrorball_calib::probe::cube::{Cube, FACES};

/// The next smaller mip: of 2 × 2 texels the mean by solid angle, which keeps the light that they hold.
#[must_use]
pub fn halved(radiance: &Cube<Vec3>) -> Cube<Vec3> {
    let size = radiance.size() / 2;
    let mut out = Cube::filled(size, Vec3::ZERO);
    for index in 0..FACES * (size * size) as usize {
        let n = size as usize;
        let (face, y, x) = (index / (n * n), index / n % n, index % n);
        let (mut sum, mut area_sr) = (Vec3::ZERO, 0.0);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let part = (face * 2 * n + 2 * y + dy) * 2 * n + 2 * x + dx;
            sum += radiance.texels()[part] * radiance.solid_angle(part);
            area_sr += radiance.solid_angle(part);
        }
        out.texels_mut()[index] = sum / area_sr;
    }
    out
}
