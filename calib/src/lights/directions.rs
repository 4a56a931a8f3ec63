//! What does not change from frame to frame: where the texels of a cube look, and the dome's fixed lights.

use std::f32::consts::PI;

use glam::Vec3;

use crate::probe::cube::Cube;

/// Cell of a texel that light cannot come from.
pub(super) const CLOSED: u16 = u16::MAX;

/// Tables over the texels of a cube, and the dome.
#[derive(Debug)]
pub(super) struct Directions {
    size: u32,
    /// Unit direction of every texel.
    pub(super) direction: Vec<Vec3>,
    /// Solid angle of every texel, steradians.
    pub(super) solid_angle_sr: Vec<f32>,
    /// The dome light nearest to every texel, or [`CLOSED`].
    pub(super) cell: Vec<u16>,
    /// Directions of the dome's lights; empty when nothing is open.
    pub(super) dome: Vec<Vec3>,
}

impl Directions {
    /// Tables for cubes with faces of `size` texels, and about `n_dome` lights over the `open` directions, at least one.
    pub(super) fn new(open: &Cube<bool>, n_dome: u32, size: u32) -> Self {
        let dome = dome(open, n_dome);
        let shape = Cube::filled(size, ());
        let n = shape.texels().len();
        let direction: Vec<Vec3> = (0..n).map(|index| shape.direction(index)).collect();
        let nearest = |direction: Vec3| {
            (0..dome.len())
                .max_by(|&a, &b| dome[a].dot(direction).total_cmp(&dome[b].dot(direction)))
                .map_or(CLOSED, |cell| cell as u16)
        };
        Self {
            size,
            solid_angle_sr: (0..n).map(|index| shape.solid_angle(index)).collect(),
            cell: direction
                .iter()
                .map(|&d| if open.nearest(d) { nearest(d) } else { CLOSED })
                .collect(),
            direction,
            dome,
        }
    }

    /// Edge of a face in texels.
    pub(super) fn size(&self) -> u32 {
        self.size
    }

    /// Angle between neighbouring texels in the middle of a face, radians.
    pub(super) fn texel_rad(&self) -> f32 {
        2.0 / self.size as f32
    }

    /// Indices of the texels that light can come from.
    pub(super) fn open(&self) -> impl Iterator<Item = usize> {
        let is_open = |&(_, &cell): &(usize, &u16)| cell != CLOSED;
        self.cell.iter().enumerate().filter(is_open).map(|(index, _)| index)
    }
}

/// Fixed directions over the open part of the sphere.
fn dome(open: &Cube<bool>, n_dome: u32) -> Vec<Vec3> {
    let is_open = |index: &usize| open.texels()[*index];
    let open_texels = || (0..open.texels().len()).filter(is_open);
    let open_share = open_texels().map(|index| open.solid_angle(index)).sum::<f32>() / (4.0 * PI);
    if open_share <= 0.0 {
        return Vec::new();
    }
    // Below a thousandth of the sphere one light does.
    let n_sphere = (n_dome as f32 / open_share.max(1e-3)).round() as usize;
    let dome: Vec<Vec3> = fibonacci_sphere(n_sphere)
        .filter(|&direction| open.nearest(direction))
        .take(n_dome as usize)
        .collect();
    if !dome.is_empty() {
        return dome;
    }
    open_texels().take(1).map(|index| open.direction(index)).collect()
}

/// `n` directions spread evenly over the sphere (González 2010, "Measurement of areas on a sphere using Fibonacci and
/// latitude-longitude lattices").
fn fibonacci_sphere(n: usize) -> impl Iterator<Item = Vec3> {
    let golden_angle = PI * (3.0 - 5.0f32.sqrt());
    (0..n).map(move |i| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / n as f32;
        let (sin, cos) = (golden_angle * i as f32).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * cos, r * sin, z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_dome_stays_in_the_open_half() {
        let mut open = Cube::filled(16, true);
        for i in 0..open.texels().len() {
            open.texels_mut()[i] = open.direction(i).z > 0.0;
        }
        let directions = Directions::new(&open, 48, 32);
        assert!((44..=48).contains(&directions.dome.len()), "{}", directions.dome.len());
        assert!(directions.dome.iter().all(|d| d.z > -0.1));
        let open_sr: f32 = directions.open().map(|i| directions.solid_angle_sr[i]).sum();
        assert!((open_sr - 2.0 * PI).abs() < 1e-3, "{open_sr}");
    }

    #[test]
    fn a_single_open_texel_has_a_light_and_no_open_texel_has_none() {
        let mut open = Cube::filled(16, false);
        assert!(Directions::new(&open, 48, 16).dome.is_empty());
        open.texels_mut()[700] = true;
        assert!(!Directions::new(&open, 48, 16).dome.is_empty());
    }
}
