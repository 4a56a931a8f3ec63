//! What a spot sees past the phantoms, remembered: lights and phantoms mostly stand still.

use mirrorball_calib::probe::cube::Cube;

use super::KnownLight;
use super::shapes::RegionShape;
use super::spots::Spot;
use crate::scene::occluders::Occluders;

/// Cells per cube face that directions are remembered by: 1.9°, 2 mm of a shadow's edge under a thing 6 cm high.
const CELLS: u32 = 48;

/// Whether far light reaches a spot, direction by direction, as far as asked for.
#[derive(Debug, Clone, Default)]
pub(super) struct Sight {
    /// Nothing asked yet: no memory is spent.
    cells: Option<Cube<Known>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Known {
    Unasked,
    Open,
    Blocked,
}

impl Sight {
    /// Which samples of a region the spot sees.
    pub(super) fn of_region(
        &mut self,
        shape: &RegionShape,
        spot: &Spot,
        light: KnownLight<'_>,
        occluders: &Occluders,
    ) -> Vec<bool> {
        let cells = self.cells.get_or_insert_with(|| Cube::filled(CELLS, Known::Unasked));
        let origin = spot.origin_m();
        shape
            .samples
            .iter()
            .map(|sample| {
                let direction = light.probe_m + sample.direction * light.room_m - origin;
                if direction.dot(spot.normal) <= 0.0 {
                    return false;
                }
                let cell = cells.index_of(direction);
                let known = &mut cells.texels_mut()[cell];
                if *known == Known::Unasked {
                    *known = match occluders.distance_m(origin, direction.normalize(), 1e-3) {
                        Some(_) => Known::Blocked,
                        None => Known::Open,
                    };
                }
                *known == Known::Open
            })
            .collect()
    }
}
