//! Where strong lights are: regions that are clipped or far brighter than the rest, and how likely they are lamps.

use std::collections::HashSet;
use std::f32::consts::PI;

use glam::Vec3;

use super::surroundings::NOTHING_M;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::radiance::luminance;

/// A connected region of texels that are clipped, or much brighter than the rest: a lamp, a window, a bright ceiling.
#[derive(Debug, Clone, PartialEq)]
pub struct StrongRegion {
    /// Texels of the cube.
    pub texels: Vec<usize>,
    /// Those of them whose radiance is not known; empty when nothing is clipped.
    pub core: Vec<usize>,
    /// Channels that clip anywhere in it.
    pub channels: [bool; 3],
    /// What it costs to add radiance.
    pub price: Price,
    /// Radiance that its brighter surroundings, which another view measured, have beyond its own; `None` where they are
    /// darker.
    pub beyond: Option<Vec3>,
}

/// Reluctance to add radiance to a region: `at_zero` squared standard deviations per unit for the first, less and less
/// the more is added beyond `level` (the logarithm of Candès, Wakin and Boyd 2008, "Enhancing sparsity by reweighted l1
/// minimization"): a region is either left alone or believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Price {
    /// Squared standard deviations per unit of radiance; 0 for a region with an edge.
    pub at_zero: f32,
    /// Radiance at which the price has halved, above 0.
    pub level: f32,
}

impl Price {
    /// No reluctance.
    pub const NONE: Self = Self {
        at_zero: 0.0,
        level: 1.0,
    };

    /// Price of the next unit when `radiance` is added already.
    pub(super) fn per_unit(self, radiance: f32) -> f32 {
        self.at_zero * self.level / (self.level + radiance)
    }

    /// Price of all of `radiance`.
    pub(super) fn total(self, radiance: f32) -> f32 {
        self.at_zero * self.level * (radiance / self.level).ln_1p()
    }
}

/// Texels this much brighter than the mean over everything seen are strong lights though nothing clips.
const STRONG_RATIO: f32 = 4.0;
/// Share of its brightest texel above which a texel belongs to an unclipped light; what is dimmer is its glow on a wall.
const GLOW_SHARE: f32 = 0.3;

/// Connected regions of texels that are not on a phantom and whose `clipped` is not 0 or whose radiance is far above the
/// mean; largest first.
///
/// Bits 0 to 2: the channel clips somewhere in the texel; 3 to 5: everywhere in it. A lamp far above the clipping level
/// clips every pixel that it touches, so the region of the former is half a pixel too wide all round, and at the ball's
/// rim half a pixel is degrees; the latter, where there are any, are the lamp.
#[must_use]
pub fn strong_regions(clipped: &Cube<u8>, near_m: &Cube<f32>, far: &Cube<Vec3>) -> Vec<StrongRegion> {
    let brightest = STRONG_RATIO * mean_luminance(far);
    let is_far = |i: usize| near_m.texels()[i] >= NOTHING_M;
    let is_clipped = |i: usize| is_far(i) && clipped.texels()[i] != 0;
    let mut regions = connected(far, &is_clipped);
    let is_bright = |i: usize| is_far(i) && clipped.texels()[i] == 0 && luminance(far.texels()[i]) > brightest;
    for bright in connected(far, &is_bright) {
        let level = |&i: &usize| luminance(far.texels()[i]);
        let peak = bright.iter().map(level).fold(0.0, f32::max);
        let mut is_lamp = vec![false; far.texels().len()];
        for &i in bright.iter().filter(|i| level(i) > GLOW_SHARE * peak) {
            is_lamp[i] = true;
        }
        regions.extend(connected(far, &|i| is_lamp[i]));
    }
    let mut regions: Vec<StrongRegion> = regions.into_iter().map(|texels| region(texels, clipped, far)).collect();
    regions.sort_by_key(|region| std::cmp::Reverse(region.texels.len()));
    regions
}

/// Leaves every texel to the first region that has it; regions that have none left are taken out.
///
/// Where a lamp falls apart into several regions, at the edge of what is seen, each of them is found to be the whole lamp.
pub(super) fn divide_shared(regions: &mut Vec<StrongRegion>) {
    let mut taken = HashSet::new();
    for region in &mut *regions {
        let has_core = !region.core.is_empty();
        region.texels.retain(|&texel| taken.insert(texel));
        let own: HashSet<usize> = region.texels.iter().copied().collect();
        region.core.retain(|texel| own.contains(texel));
        if has_core && region.core.is_empty() {
            region.texels.clear();
        }
    }
    regions.retain(|region| !region.texels.is_empty());
}

/// Sets of texels that are `wanted` and hang together by their edges.
fn connected(cube: &Cube<Vec3>, wanted: &dyn Fn(usize) -> bool) -> Vec<Vec<usize>> {
    let mut visited = vec![false; cube.texels().len()];
    let mut sets = Vec::new();
    for start in 0..visited.len() {
        if visited[start] || !wanted(start) {
            continue;
        }
        visited[start] = true;
        let mut texels = vec![start];
        let mut next = 0;
        while let Some(&texel) = texels.get(next) {
            next += 1;
            for neighbour in cube.neighbours(texel) {
                if !visited[neighbour] && wanted(neighbour) {
                    visited[neighbour] = true;
                    texels.push(neighbour);
                }
            }
        }
        sets.push(texels);
    }
    sets
}

fn region(texels: Vec<usize>, clipped: &Cube<u8>, far: &Cube<Vec3>) -> StrongRegion {
    let bits = texels.iter().fold(0, |bits, &i| bits | clipped.texels()[i]);
    let where_set = |mask: u8| -> Vec<usize> {
        let set = |i: &usize| clipped.texels()[*i] & mask != 0;
        texels.iter().copied().filter(set).collect()
    };
    let everywhere = where_set(0b11_1000);
    let core = if everywhere.is_empty() {
        where_set(0b111)
    } else {
        everywhere
    };
    let price = price(&texels, far);
    StrongRegion {
        beyond: beyond(&texels, &core, far),
        channels: [0, 1, 2].map(|c| bits >> c & 1 == 1),
        core,
        texels,
        price,
    }
}

fn mean_luminance(far: &Cube<Vec3>) -> f32 {
    let sum: f32 = (0..far.texels().len())
        .map(|i| luminance(far.texels()[i]) * far.solid_angle(i))
        .sum();
    sum / (4.0 * PI)
}

/// What the measured surroundings of a clipped region have beyond it: where one view clips and a darker one shows the rest
/// of the same ceiling, the ceiling goes on.
fn beyond(texels: &[usize], core: &[usize], far: &Cube<Vec3>) -> Option<Vec3> {
    /// Texels between the region, whose outermost are mixed, and the surroundings that are looked at.
    const GAP: usize = 4;
    /// Share of the surroundings that must be about as bright as the clipped region, and how bright that is: a lamp has dark
    /// surroundings, a window a bright wall on one side at most.
    const LEAST_SHARE: f32 = 0.4;
    const AS_BRIGHT: f32 = 0.85;
    if core.is_empty() {
        return None;
    }
    let mean = |texels: &[usize]| texels.iter().map(|&i| far.texels()[i]).sum::<Vec3>() / texels.len().max(1) as f32;
    let own = mean(core);
    let ring = ring(far, texels, GAP);
    let bright: Vec<usize> = ring
        .iter()
        .copied()
        .filter(|&i| luminance(far.texels()[i]) > AS_BRIGHT * luminance(own))
        .collect();
    (bright.len() as f32 > LEAST_SHARE * ring.len() as f32).then(|| (mean(&bright) - own).max(Vec3::ZERO))
}

/// Price of a unit of radiance in a region that fades into its surroundings: high where the light [`RING_RAD`] outside is
/// almost as bright as the region, nothing where it is much darker.
fn price(region: &[usize], far: &Cube<Vec3>) -> Price {
    /// Distance at which the surroundings are looked at: two pixels of a ball of 70 pixels, radians.
    const RING_RAD: f32 = 0.1;
    /// Price per multiple of the clipping level where there is no edge at all; chosen, as is `EDGE`, so that of the two
    /// clipped regions of a path-traced room the window is believed and the ceiling above it is not.
    const PRICE: f32 = 40.0;
    /// Brightness of the surroundings, relative to the region, from which on and up to which the price rises.
    const EDGE: [f32; 2] = [0.35, 0.7];
    let mean =
        |texels: &[usize]| texels.iter().map(|&i| luminance(far.texels()[i])).sum::<f32>() / texels.len().max(1) as f32;
    let steps = (RING_RAD * far.size() as f32 / (0.5 * PI)).ceil() as usize;
    let front = ring(far, region, steps);
    let level = mean(region);
    if front.is_empty() || level <= 0.0 {
        return Price::NONE;
    }
    let smoothness = ((mean(&front) / level - EDGE[0]) / (EDGE[1] - EDGE[0])).clamp(0.0, 1.0);
    Price {
        at_zero: PRICE * smoothness * smoothness / level,
        level,
    }
}

/// The texels that lie `steps` texels around a region.
fn ring<T: Copy>(cube: &Cube<T>, region: &[usize], steps: usize) -> Vec<usize> {
    let within = grown(cube, region, steps.saturating_sub(1)).len();
    grown(cube, region, steps).split_off(within)
}

/// A region with the texels up to `steps` texels around it.
pub(super) fn grown<T: Copy>(cube: &Cube<T>, region: &[usize], steps: usize) -> Vec<usize> {
    let mut seen: HashSet<usize> = region.iter().copied().collect();
    let mut all = region.to_vec();
    let mut first = 0;
    for _ in 0..steps {
        let last = all.len();
        for k in first..last {
            let fresh = cube.neighbours(all[k]).into_iter().filter(|&i| seen.insert(i));
            all.extend(fresh.collect::<Vec<_>>());
        }
        first = last;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_two_regions_share_belongs_to_the_first() {
        let region = |texels: &[usize]| StrongRegion {
            texels: texels.to_vec(),
            core: texels.to_vec(),
            channels: [true; 3],
            price: Price::NONE,
            beyond: None,
        };
        let mut regions = vec![region(&[1, 2, 3]), region(&[3, 4]), region(&[2, 3])];
        divide_shared(&mut regions);
        assert_eq!(regions, [region(&[1, 2, 3]), region(&[4])]);
    }

    #[test]
    fn a_clipped_patch_of_a_measured_ceiling_is_expected_to_go_on_as_it() {
        let mut far = Cube::filled(32, Vec3::splat(0.4));
        let mut clipped = Cube::filled(32, 0u8);
        for i in 0..far.texels().len() {
            let d = far.direction(i);
            if d.z > 0.8 {
                far.texels_mut()[i] = Vec3::new(2.4, 2.5, 2.6);
            }
            if d.dot(Vec3::new(0.3, 0.0, 1.0).normalize()) > 0.99 {
                far.texels_mut()[i] = Vec3::splat(2.0);
                clipped.texels_mut()[i] = 0b11_1111;
            }
        }
        let regions = strong_regions(&clipped, &Cube::filled(32, NOTHING_M), &far);
        let patch = regions.iter().find(|region| !region.core.is_empty()).unwrap();
        assert!((patch.beyond.unwrap() - Vec3::new(0.4, 0.5, 0.6)).length() < 0.02);
    }

    #[test]
    fn regions_join_across_edges_of_the_cube() {
        let mut clipped = Cube::filled(16, 0u8);
        for i in 0..clipped.texels().len() {
            let d = clipped.direction(i);
            if d.dot(Vec3::new(1.0, 1.0, 0.0).normalize()) > 0.95 {
                clipped.texels_mut()[i] = 1;
            }
            if d.dot(Vec3::NEG_Z) > 0.99 {
                clipped.texels_mut()[i] = 6;
            }
        }
        let regions = strong_regions(&clipped, &Cube::filled(16, NOTHING_M), &Cube::filled(16, Vec3::ONE));
        assert_eq!(regions.len(), 2);
        assert_eq!(regions[0].channels, [true, false, false]);
        assert_eq!(regions[1].channels, [false, true, true]);
    }
}
