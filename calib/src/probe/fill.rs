//! Plausible light where the probe saw nothing: holes take the light of the nearest seen region, smoothly.
//!
//! Push and pull over a mip pyramid (Gortler et al. 1996, "The Lumigraph", section 3.4): coarse levels average what is
//! known, finer ones take it where they know nothing.

use glam::{Vec3, Vec4};

use super::cube::Cube;

/// The cube with every texel filled whose alpha is below 1; alpha is the share that is known, colour is not premultiplied.
///
/// A cube without anything known comes back black.
#[must_use]
pub fn fill_unknown(known: &Cube<Vec4>) -> Cube<Vec3> {
    let mut pyramid = vec![known.map(|texel| (texel.truncate() * texel.w).extend(texel.w))];
    while let Some(finest) = pyramid.last().filter(|level| level.size() > 1) {
        pyramid.push(finest.halved());
    }
    // The coarsest level: whatever is known anywhere stands in for faces on which nothing is.
    let coarsest = pyramid.pop().unwrap_or_else(|| Cube::filled(1, Vec4::ZERO));
    let total: Vec4 = coarsest.texels().iter().copied().sum();
    let mean = if total.w > 0.0 {
        total.truncate() / total.w
    } else {
        Vec3::ZERO
    };
    let mut filled = coarsest.map(|texel| over(*texel, mean));
    for level in pyramid.iter().rev() {
        let mut finer = Cube::filled(level.size(), Vec3::ZERO);
        for (index, texel) in level.texels().iter().enumerate() {
            let behind = if texel.w < 1.0 {
                filled.bilinear(level.direction(index))
            } else {
                Vec3::ZERO
            };
            finer.texels_mut()[index] = over(*texel, behind);
        }
        filled = finer;
    }
    filled
}

/// Premultiplied colour over a background, its coverage first stretched so that a little knowledge already counts.
fn over(premultiplied: Vec4, behind: Vec3) -> Vec3 {
    if premultiplied.w <= 0.0 {
        return behind;
    }
    let color = premultiplied.truncate() / premultiplied.w;
    color.lerp(behind, (1.0 - 4.0 * premultiplied.w).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_texels_stay_and_holes_take_their_neighbours() {
        let mut cube = Cube::filled(16, Vec4::ZERO);
        for i in 0..cube.texels().len() {
            let d = cube.direction(i);
            if d.z > 0.0 {
                cube.texels_mut()[i] = if d.x > 0.0 {
                    Vec4::new(2.0, 2.0, 2.0, 1.0)
                } else {
                    Vec4::ONE
                };
            }
        }
        let filled = fill_unknown(&cube);
        assert_eq!(filled.nearest(Vec3::new(0.5, 0.1, 1.0)), Vec3::splat(2.0));
        let below_bright = filled.nearest(Vec3::new(1.0, 0.0, -0.2)).x;
        let below_dim = filled.nearest(Vec3::new(-1.0, 0.0, -0.2)).x;
        assert!(below_bright > 1.6 && below_dim < 1.4, "{below_bright} {below_dim}");
        assert!(filled.texels().iter().all(|t| t.x >= 0.99 && t.x <= 2.01));
    }

    #[test]
    fn nothing_known_is_black() {
        assert!(
            fill_unknown(&Cube::filled(8, Vec4::ZERO))
                .texels()
                .iter()
                .all(|t| *t == Vec3::ZERO)
        );
    }
}
