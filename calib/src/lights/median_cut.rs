//! Median cut: regions of equal energy, a light in each.
//!
//! Debevec 2005, "A median cut algorithm for light probe sampling": the latitude-longitude map is cut in two again and again,
//! across the longer side, where the energy is halved; the longitudes count by the cosine of the latitude. Each light stands at
//! the centroid of its region and has its energy. Where to cut is found on an equirectangular raster of the cube's texels, with
//! a summed-area table; the lights are summed over the texels themselves, so nothing is lost to the raster.

use std::f32::consts::PI;

use glam::Vec3;

use super::gather::{Gathered, distance_m};
use super::{Extract, KeyLight, LightCounts, Map};

const WIDTH: usize = 512;
const HEIGHT: usize = 256;

/// Median cut of one frame after the other.
#[derive(Debug)]
pub(super) struct MedianCut {
    max_lights: usize,
    /// Pixel of the raster of every texel of the cube.
    pixels: Vec<u32>,
    /// Energy above and left of every corner of the raster.
    table: Vec<f64>,
    /// Region of every pixel.
    labels: Vec<u16>,
    regions: Vec<Rectangle>,
    gathered: Vec<Gathered>,
}

/// Part of the raster: columns and rows from, up to but without.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rectangle {
    x: [usize; 2],
    y: [usize; 2],
    energy: f64,
}

impl MedianCut {
    pub(super) fn new(counts: LightCounts) -> Self {
        Self {
            max_lights: (counts.dome + counts.bright) as usize,
            pixels: Vec::new(),
            table: vec![0.0; (WIDTH + 1) * (HEIGHT + 1)],
            labels: vec![0; WIDTH * HEIGHT],
            regions: Vec::new(),
            gathered: Vec::new(),
        }
    }

    /// Sums the energy of the open texels up.
    fn sum_up(&mut self, map: &Map<'_>) {
        let directions = &map.directions.direction;
        if self.pixels.len() != directions.len() {
            self.pixels = directions.iter().map(|&d| pixel(d)).collect();
        }
        self.table.fill(0.0);
        let corner = |pixel: u32| (pixel as usize / WIDTH + 1) * (WIDTH + 1) + pixel as usize % WIDTH + 1;
        for index in map.directions.open() {
            self.table[corner(self.pixels[index])] += f64::from(map.ray(index).power());
        }
        for y in 1..=HEIGHT {
            let mut row = 0.0;
            for x in 1..=WIDTH {
                row += self.table[y * (WIDTH + 1) + x];
                self.table[y * (WIDTH + 1) + x] = row + self.table[(y - 1) * (WIDTH + 1) + x];
            }
        }
    }

    fn rectangle(&self, x: [usize; 2], y: [usize; 2]) -> Rectangle {
        let at = |x: usize, y: usize| self.table[y * (WIDTH + 1) + x];
        Rectangle {
            x,
            y,
            energy: at(x[1], y[1]) - at(x[0], y[1]) - at(x[1], y[0]) + at(x[0], y[0]),
        }
    }

    /// Two halves of equal energy, as nearly as whole pixels allow; `None` for a single pixel.
    fn cut(&self, whole: Rectangle) -> Option<[Rectangle; 2]> {
        let (columns, rows) = (whole.x[1] - whole.x[0], whole.y[1] - whole.y[0]);
        let latitude = PI * (0.5 - 0.5 * (whole.y[0] + whole.y[1]) as f32 / HEIGHT as f32);
        // A pixel is as wide as high at the equator.
        let is_wide = columns as f32 * latitude.cos() > rows as f32;
        let is_across = (is_wide && columns > 1) || rows < 2;
        let [low, high] = if is_across { whole.x } else { whole.y };
        if high - low < 2 {
            return None;
        }
        let halves = |at: usize| {
            if is_across {
                [self.rectangle([low, at], whole.y), self.rectangle([at, high], whole.y)]
            } else {
                [self.rectangle(whole.x, [low, at]), self.rectangle(whole.x, [at, high])]
            }
        };
        let unevenness = |at: &usize| {
            let [one, other] = halves(*at);
            (one.energy - other.energy).abs()
        };
        (low + 1..high)
            .min_by(|a, b| unevenness(a).total_cmp(&unevenness(b)))
            .map(halves)
    }

    /// Cuts until there are as many regions as lights; the one with the most energy goes first, single pixels stay.
    fn divide(&mut self) {
        self.regions.clear();
        self.regions.push(self.rectangle([0, WIDTH], [0, HEIGHT]));
        while self.regions.len() < self.max_lights {
            let can_be_cut = |&index: &usize| {
                let Rectangle { x, y, energy } = self.regions[index];
                energy > 0.0 && (x[1] - x[0]) * (y[1] - y[0]) > 1
            };
            let brightest = (0..self.regions.len())
                .filter(can_be_cut)
                .max_by(|&a, &b| self.regions[a].energy.total_cmp(&self.regions[b].energy));
            let Some(brightest) = brightest else { break };
            let Some([one, other]) = self.cut(self.regions[brightest]) else {
                break;
            };
            self.regions[brightest] = one;
            self.regions.push(other);
        }
    }
}

impl Extract for MedianCut {
    fn extract(&mut self, map: &Map<'_>, lights: &mut Vec<KeyLight>) {
        self.sum_up(map);
        self.divide();
        for (label, region) in self.regions.iter().enumerate() {
            for y in region.y[0]..region.y[1] {
                self.labels[y * WIDTH + region.x[0]..y * WIDTH + region.x[1]].fill(label as u16);
            }
        }
        self.gathered.clear();
        self.gathered.resize(self.regions.len(), Gathered::default());
        for index in map.directions.open() {
            let label = self.labels[self.pixels[index] as usize];
            self.gathered[usize::from(label)].add(&map.ray(index), 1.0, Vec3::ZERO);
        }
        lights.extend(self.gathered.iter().enumerate().map(|(index, sum)| KeyLight {
            id: index as u32,
            direction: sum.direction(Vec3::ZERO).normalize_or(Vec3::Z),
            distance_m: distance_m(sum.mean_inverse_distance()),
            irradiance: sum.irradiance,
            angular_radius_rad: sum.cap_radius_rad(),
        }));
    }
}

/// Pixel of the raster that a unit direction falls into; row 0 at +z, the centre column at +y.
fn pixel(direction: Vec3) -> u32 {
    let column = (direction.x.atan2(direction.y) / (2.0 * PI) + 0.5) * WIDTH as f32;
    let row = direction.z.clamp(-1.0, 1.0).acos() / PI * HEIGHT as f32;
    (row as usize).min(HEIGHT - 1) as u32 * WIDTH as u32 + (column as usize).min(WIDTH - 1) as u32
}

#[cfg(test)]
mod tests {
    use super::super::{LightMethod, LightTracker};
    use super::*;
    use crate::probe::cube::Cube;

    #[test]
    fn a_lamp_of_one_texel_does_not_keep_the_rest_whole() {
        let mut map = Cube::filled(64, Vec3::ONE);
        map.texels_mut()[100] = Vec3::splat(1e6);
        let counts = LightCounts { dome: 48, bright: 16 };
        let mut tracker = LightTracker::new(LightMethod::MedianCut, &Cube::filled(16, true), counts);
        assert_eq!(tracker.update(&map, &Cube::filled(1, 2.0)).len(), 64);
    }

    #[test]
    fn lights_have_equal_shares_of_an_even_sky() {
        let mut tracker = LightTracker::new(
            LightMethod::MedianCut,
            &Cube::filled(16, true),
            LightCounts { dome: 48, bright: 16 },
        );
        let lights = tracker.update(&Cube::filled(64, Vec3::ONE), &Cube::filled(64, 2.0));
        assert_eq!(lights.len(), 64);
        let expected = 4.0 * PI / 64.0;
        for light in lights {
            // A region is some 40 pixels wide and cannot end inside one; a texel is up to three pixels.
            assert!((light.irradiance.x / expected - 1.0).abs() < 0.25, "{light:?}");
            assert!((light.distance_m - 2.0).abs() < 1e-4);
        }
    }
}
