//! What stands around the probe and the virtual objects and does not change with the light.

use glam::Vec3;
use rayon::prelude::*;

use crate::scene::occluders::Occluders;
use mirrorball_calib::probe::cube::Cube;

/// Distance that stands for "nothing there", metres.
pub const NOTHING_M: f32 = 1e9;

/// Distances from a point to the first phantom in every direction, metres; [`NOTHING_M`] where there is none.
///
/// Phantoms nearer than `from_m` are left out: the mirror ball around its own centre, an object's own footprint.
#[must_use]
pub fn distances_m(occluders: &Occluders, position_m: Vec3, from_m: f32, cube_size: u32) -> Cube<f32> {
    let mut cube = Cube::filled(cube_size, NOTHING_M);
    cube.texels_mut()
        .par_iter_mut()
        .enumerate()
        .for_each(|(index, distance)| {
            let direction = mirrorball_calib::probe::cube::texel_direction(cube_size, index);
            *distance = occluders.distance_m(position_m, direction, from_m).unwrap_or(NOTHING_M);
        });
    cube
}

/// Directions from which far light reaches any of `points`; the others are always behind a phantom (below the table).
#[must_use]
pub fn open_directions(occluders: &Occluders, points: &[Vec3], cube_size: u32) -> Cube<bool> {
    let mut cube = Cube::filled(cube_size, true);
    if points.is_empty() {
        return cube;
    }
    cube.texels_mut().par_iter_mut().enumerate().for_each(|(index, open)| {
        let direction = mirrorball_calib::probe::cube::texel_direction(cube_size, index);
        *open = points
            .iter()
            .any(|&point| occluders.distance_m(point, direction, 1e-3).is_none());
    });
    cube
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Occluders {
        let corner = |x: f32, y: f32| Vec3::new(x, y, 0.0);
        Occluders::new([
            [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0)],
            [corner(-1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        ])
    }

    #[test]
    fn a_table_is_met_below_and_not_above() {
        let distances = distances_m(&table(), Vec3::new(0.0, 0.0, 0.1), 0.0, 16);
        assert!((distances.nearest(Vec3::new(0.01, 0.01, -1.0)) - 0.1).abs() < 0.01);
        assert!(distances.nearest(Vec3::Z) >= NOTHING_M);
        let beyond = distances_m(&table(), Vec3::new(0.0, 0.0, 0.1), 0.5, 16);
        assert!(beyond.nearest(Vec3::NEG_Z) >= NOTHING_M);
    }

    #[test]
    fn no_light_comes_from_below_a_table() {
        let open = open_directions(&table(), &[Vec3::new(0.0, 0.0, 0.05)], 16);
        assert!(open.nearest(Vec3::new(0.3, 0.2, 1.0)));
        assert!(!open.nearest(Vec3::new(0.3, 0.2, -1.0)));
    }
}
