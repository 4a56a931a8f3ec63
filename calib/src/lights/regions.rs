//! The way of Supan 2006 ("Image based lighting in augmented reality Umgebungen", section 2.5.2): the map is made smaller with a
//! maximum filter, what is brighter than a threshold is a possible lamp, and touching or near ones are taken together.
//!
//! The thesis leaves the threshold open and works on pictures of 8 bits; here it is a multiple of the mean luminance. Light below
//! it stays in a fixed dome, which is also the thesis' other method.

use glam::Vec3;

use super::gather::{Gathered, distance_m};
use super::{Extract, KeyLight, LightCounts, Map, counted};
use crate::probe::cube::Cube;
use crate::probe::radiance::luminance;

/// Side of the square whose maximum is kept, texels.
const REDUCTION: u32 = 4;
/// What is this many times as bright as the mean over the open directions is a lamp.
const THRESHOLD: f32 = 3.0;
/// Where lamps are clipped nothing is that bright: then this share of the maximum is the threshold.
const THRESHOLD_OF_MAX: f32 = 0.75;
/// Label of what is no lamp.
const NONE: u16 = u16::MAX;

/// Region labelling of one frame after the other.
#[derive(Debug)]
pub(super) struct Regions {
    max_regions: usize,
    /// Maximum luminance of squares of texels.
    reduced: Cube<f32>,
    labels: Vec<u16>,
    stack: Vec<usize>,
    dome: Vec<Gathered>,
    regions: Vec<Gathered>,
}

impl Regions {
    pub(super) fn new(counts: LightCounts) -> Self {
        Self {
            max_regions: counts.bright as usize,
            reduced: Cube::filled(1, 0.0),
            labels: Vec::new(),
            stack: Vec::new(),
            dome: Vec::new(),
            regions: Vec::new(),
        }
    }

    /// The maximum filter, and the mean luminance.
    fn reduce(&mut self, map: &Map<'_>) -> f32 {
        let size = map.radiance.size();
        let reduced_size = size.div_ceil(REDUCTION);
        if self.reduced.size() != reduced_size {
            self.reduced = Cube::filled(reduced_size, 0.0);
        }
        self.reduced.texels_mut().fill(0.0);
        let (mut power, mut area_sr) = (0.0, 0.0);
        for index in map.directions.open() {
            let luminance = luminance(counted(map.radiance.texels()[index]));
            let texel = &mut self.reduced.texels_mut()[reduced_index(size, index)];
            *texel = texel.max(luminance);
            power += luminance * map.directions.solid_angle_sr[index];
            area_sr += map.directions.solid_angle_sr[index];
        }
        power / area_sr.max(f32::MIN_POSITIVE)
    }

    /// Numbers the connected regions above the threshold (across the edges of the cube), by flood filling; gives how many.
    fn label(&mut self, threshold: f32) -> usize {
        let n = self.reduced.texels().len();
        self.labels.clear();
        self.labels.resize(n, NONE);
        let mut found = 0;
        for start in 0..n {
            if self.labels[start] != NONE || self.reduced.texels()[start] <= threshold || found == NONE {
                continue;
            }
            self.labels[start] = found;
            self.stack.push(start);
            while let Some(index) = self.stack.pop() {
                for neighbour in self.reduced.neighbours(index) {
                    if self.labels[neighbour] == NONE && self.reduced.texels()[neighbour] > threshold {
                        self.labels[neighbour] = found;
                        self.stack.push(neighbour);
                    }
                }
            }
            found += 1;
        }
        usize::from(found)
    }

    /// Sums the light of every region, and of the dome, up.
    fn gather(&mut self, map: &Map<'_>, threshold: f32, n_regions: usize) {
        self.dome.clear();
        self.dome.resize(map.directions.dome.len(), Gathered::default());
        self.regions.clear();
        self.regions.resize(n_regions, Gathered::default());
        let size = map.radiance.size();
        for index in map.directions.open() {
            let ray = map.ray(index);
            let label = self.labels[reduced_index(size, index)];
            let is_lamp = label != NONE && luminance(counted(map.radiance.texels()[index])) > threshold;
            let sum = if is_lamp {
                &mut self.regions[usize::from(label)]
            } else {
                &mut self.dome[usize::from(ray.cell)]
            };
            sum.add(&ray, 1.0, Vec3::ZERO);
        }
    }

    /// Takes the nearest two regions together until there are few enough (agglomerative clustering by centroids).
    fn cluster(&mut self) {
        self.regions.sort_by(|a, b| b.power.total_cmp(&a.power));
        while self.regions.len() > self.max_regions {
            let Some((a, b)) = nearest_pair(&self.regions) else {
                return;
            };
            let gone = self.regions.swap_remove(b);
            self.regions[a].merge(&gone);
        }
    }
}

impl Extract for Regions {
    fn extract(&mut self, map: &Map<'_>, lights: &mut Vec<KeyLight>) {
        let mean = self.reduce(map);
        let max = self.reduced.texels().iter().copied().fold(0.0, f32::max);
        let threshold = (THRESHOLD * mean).min(THRESHOLD_OF_MAX * max);
        let n_regions = if self.max_regions > 0 {
            self.label(threshold)
        } else {
            self.label(f32::INFINITY)
        };
        self.gather(map, threshold, n_regions);
        self.cluster();
        let directions = map.directions.dome.iter().copied().map(Some);
        let sums = self
            .dome
            .iter()
            .zip(directions)
            .chain(self.regions.iter().map(|region| (region, None)));
        lights.extend(sums.enumerate().map(|(index, (sum, fixed))| KeyLight {
            id: index as u32,
            direction: fixed.unwrap_or_else(|| sum.direction(Vec3::ZERO).normalize_or(Vec3::Z)),
            distance_m: distance_m(sum.mean_inverse_distance()),
            irradiance: sum.irradiance,
            angular_radius_rad: sum.cap_radius_rad(),
        }));
    }
}

/// The texel of the reduced cube that texel `index` lies in.
fn reduced_index(size: u32, index: usize) -> usize {
    let (n, reduced) = (size as usize, size.div_ceil(REDUCTION) as usize);
    let (face, y, x) = (index / (n * n), index / n % n, index % n);
    let step = REDUCTION as usize;
    (face * reduced + y / step) * reduced + x / step
}

/// The two regions whose centroids are nearest to each other, the first of them the smaller index.
fn nearest_pair(regions: &[Gathered]) -> Option<(usize, usize)> {
    let directions: Vec<Vec3> = regions.iter().map(|region| region.direction(Vec3::ZERO)).collect();
    let mut nearest: Option<(usize, usize, f32)> = None;
    for b in 0..directions.len() {
        for a in 0..b {
            let squared = directions[a].distance_squared(directions[b]);
            if nearest.is_none_or(|(_, _, least)| squared < least) {
                nearest = Some((a, b, squared));
            }
        }
    }
    nearest.map(|(a, b, _)| (a, b))
}

#[cfg(test)]
mod tests {
    use super::super::{LightMethod, LightTracker};
    use super::*;

    /// A dim room with round lamps of 3° radius.
    fn room(size: u32, lamps: &[Vec3]) -> Cube<Vec3> {
        let mut cube = Cube::filled(size, Vec3::splat(0.2));
        for index in 0..cube.texels().len() {
            let direction = cube.direction(index);
            if lamps.iter().any(|lamp| direction.dot(*lamp) > 3f32.to_radians().cos()) {
                cube.texels_mut()[index] = Vec3::splat(100.0);
            }
        }
        cube
    }

    fn lamps_found(lamps: &[Vec3], bright: u32) -> Vec<KeyLight> {
        let counts = LightCounts { dome: 8, bright };
        let mut tracker = LightTracker::new(LightMethod::Regions, &Cube::filled(16, true), counts);
        tracker.update(&room(128, lamps), &Cube::filled(8, 2.0))[8..].to_vec()
    }

    #[test]
    fn a_lamp_on_a_corner_of_the_cube_is_one_region() {
        let lamp = Vec3::ONE.normalize();
        let found = lamps_found(&[lamp], 16);
        assert_eq!(found.len(), 1);
        assert!(found[0].direction.angle_between(lamp) < 0.5f32.to_radians());
        assert!((found[0].angular_radius_rad - 3f32.to_radians()).abs() < 0.004);
    }

    #[test]
    fn near_lamps_are_taken_together_when_lights_are_few() {
        let lamps = [Vec3::X, Vec3::new(1.0, 0.25, 0.0).normalize(), Vec3::NEG_Y];
        assert_eq!(lamps_found(&lamps, 16).len(), 3);
        let two = lamps_found(&lamps, 2);
        assert_eq!(two.len(), 2);
        let between = (lamps[0] + lamps[1]).normalize();
        assert!(two.iter().any(|l| l.direction.angle_between(between) < 0.02), "{two:?}");
    }
}
