//! Strong lights as the probe's cube shows them, and the patterns of light that clipped ones may be made of.

use glam::Vec3;
use mirrorball_calib::probe::cube::Cube;

use super::super::clipped::{Price, StrongRegion};

/// Most texels of a region that stand for it.
const REGION_SAMPLES: usize = 64;
/// Half width from which on a region's light may rise towards a side, radians.
const RAMP_RAD: f32 = 0.15;

/// A direction from the probe with what it stands for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Unit direction from the probe.
    pub(super) direction: Vec3,
    /// Solid angle that it stands for, steradians.
    pub(super) area_sr: f32,
    /// Radiance that the cube has there.
    pub(super) radiance: Vec3,
    /// Brightness in every pattern of the region, in the order of [`RegionShape::patterns`].
    pub(super) brightness: [f32; MAX_PATTERNS],
}

/// Bands that a window is divided into, from its sill to its top.
const BANDS: usize = 4;
/// Least height of a window that is divided, radians.
const BAND_RAD: f32 = 0.25;
/// Patterns of a region at most.
pub(super) const MAX_PATTERNS: usize = 1 + BANDS + 2;

/// What a pattern is to its region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PatternKind {
    /// All of it: an unknown of its own only as long as nothing finer is asked.
    Even,
    /// A part of the even pattern, as bright as the whole unless the readings say otherwise.
    Band,
    /// A rise towards a side, added to the even pattern or to the bands.
    Ramp,
}

/// Texels with the radiance that one unit of an unknown adds to them.
#[derive(Debug, Clone)]
pub(super) struct Pattern {
    pub(super) kind: PatternKind,
    pub(super) texels: Vec<(usize, f32)>,
}

/// A region, what it is known to give and what it may give more.
#[derive(Debug, Clone)]
pub(super) struct RegionShape {
    pub(super) samples: Vec<Sample>,
    /// The even pattern first, then what it is made of or changed by; none where nothing is clipped.
    pub(super) patterns: Vec<Pattern>,
    /// Channels that clip in it.
    pub(super) channels: [bool; 3],
    pub(super) price: Price,
    /// Radiance that the even pattern is expected to have, where its surroundings tell.
    pub(super) expected: Option<Vec3>,
}

impl RegionShape {
    pub(super) fn new(region: &StrongRegion, far: &Cube<Vec3>) -> Self {
        let patterns = if region.core.is_empty() {
            Vec::new()
        } else {
            patterns_of(&region.core, far)
        };
        let mut in_patterns = vec![[0.0; MAX_PATTERNS]; if patterns.is_empty() { 0 } else { far.texels().len() }];
        for (k, pattern) in patterns.iter().enumerate() {
            for &(texel, brightness) in &pattern.texels {
                in_patterns[texel][k] = brightness;
            }
        }
        let brightness = |i: usize| in_patterns.get(i).copied().unwrap_or([0.0; MAX_PATTERNS]);
        Self {
            samples: samples_of(&region.texels, far, &brightness),
            patterns,
            channels: region.channels,
            price: region.price,
            expected: region.beyond,
        }
    }
}

/// Groups of neighbouring texels, each summed up in one direction, so that nothing of the region's light is left out.
fn samples_of(texels: &[usize], far: &Cube<Vec3>, brightness: &dyn Fn(usize) -> [f32; MAX_PATTERNS]) -> Vec<Sample> {
    // Ordered along a curve over the faces, texels that follow one another lie together.
    let mut ordered = texels.to_vec();
    ordered.sort_by_key(|&i| morton(i, far.size()));
    let group = ordered.len().div_ceil(REGION_SAMPLES).max(1);
    ordered
        .chunks(group)
        .map(|texels| {
            let mut sum = Sample {
                direction: Vec3::ZERO,
                area_sr: 0.0,
                radiance: Vec3::ZERO,
                brightness: [0.0; MAX_PATTERNS],
            };
            for &i in texels {
                let area_sr = far.solid_angle(i);
                sum.direction += far.direction(i) * area_sr;
                sum.area_sr += area_sr;
                sum.radiance += far.texels()[i] * area_sr;
                for (sum, b) in sum.brightness.iter_mut().zip(brightness(i)) {
                    *sum += b * area_sr;
                }
            }
            Sample {
                direction: sum.direction.normalize_or(Vec3::Z),
                area_sr: sum.area_sr,
                radiance: sum.radiance / sum.area_sr,
                brightness: sum.brightness.map(|b| b / sum.area_sr),
            }
        })
        .collect()
}

/// Face, then the bits of row and column interleaved (Morton 1966).
fn morton(index: usize, size: u32) -> (usize, u64) {
    let n = size as usize;
    let spread = |x: usize| (0..10).fold(0u64, |bits, b| bits | ((x as u64 >> b & 1) << (2 * b)));
    (index / (n * n), spread(index % n) | spread(index / n % n) << 1)
}

/// What is expected of a large clipped region, up to scale: a window shows the CIE standard overcast sky, 1 + 2 sin of the
/// elevation (Moon and Spencer 1942); higher than 45° it is a ceiling or a roof light, as bright everywhere.
fn overcast_sky(direction: Vec3) -> f32 {
    1.0 + 2.0 * direction.z.clamp(0.0, std::f32::consts::FRAC_1_SQRT_2)
}

/// Patterns that clipped light may be made of: the sky's; for windows bands of it, as the sky ends at a horizon; for wide
/// regions ramps towards the sides.
fn patterns_of(core: &[usize], cube: &Cube<Vec3>) -> Vec<Pattern> {
    let even = normalised(core, cube, &overcast_sky);
    let middle = core
        .iter()
        .map(|&i| cube.direction(i))
        .sum::<Vec3>()
        .normalize_or(Vec3::Z);
    let bands = bands_of(&even, cube, middle);
    let mut patterns = vec![Pattern {
        kind: PatternKind::Even,
        texels: even,
    }];
    let first = Vec3::Z.cross(middle).try_normalize().unwrap_or(Vec3::X);
    let sides = [first, -first, middle.cross(first), middle.cross(-first)];
    // Bands tell the height already.
    let n_sides = if bands.is_empty() { 4 } else { 2 };
    patterns.extend(bands);
    for side in &sides[..n_sides] {
        let reach = |&i: &usize| cube.direction(i).dot(*side).abs();
        let widest = core.iter().map(reach).fold(0.0, f32::max);
        if widest > RAMP_RAD {
            let ramp = |direction: Vec3| overcast_sky(direction) * (1.0 + direction.dot(*side) / widest);
            patterns.push(Pattern {
                kind: PatternKind::Ramp,
                texels: normalised(core, cube, &ramp),
            });
        }
    }
    patterns
}

/// Texels with a brightness whose mean over their area is 1, so that the unknowns of a region mean the same.
fn normalised(core: &[usize], cube: &Cube<Vec3>, brightness: &dyn Fn(Vec3) -> f32) -> Vec<(usize, f32)> {
    let mut texels: Vec<(usize, f32)> = core.iter().map(|&i| (i, brightness(cube.direction(i)))).collect();
    let (mut lit, mut area_sr) = (0.0, 0.0);
    for &(i, b) in &texels {
        lit += b * cube.solid_angle(i);
        area_sr += cube.solid_angle(i);
    }
    let mean = (lit / area_sr).max(f32::MIN_POSITIVE);
    for (_, brightness) in &mut texels {
        *brightness /= mean;
    }
    texels
}

/// The even pattern cut by elevation; empty for what is low or stands above like a ceiling.
fn bands_of(even: &[(usize, f32)], cube: &Cube<Vec3>, middle: Vec3) -> Vec<Pattern> {
    let elevation = |i: usize| cube.direction(i).z.clamp(-1.0, 1.0).asin();
    let lowest = even.iter().map(|&(i, _)| elevation(i)).fold(f32::INFINITY, f32::min);
    let highest = even
        .iter()
        .map(|&(i, _)| elevation(i))
        .fold(f32::NEG_INFINITY, f32::max);
    if highest - lowest < BAND_RAD || middle.z > std::f32::consts::FRAC_1_SQRT_2 {
        return Vec::new();
    }
    let band_of = |i: usize| {
        let share = (elevation(i) - lowest) / (highest - lowest);
        ((share * BANDS as f32) as usize).min(BANDS - 1)
    };
    (0..BANDS)
        .map(|band| Pattern {
            kind: PatternKind::Band,
            texels: even.iter().copied().filter(|&(i, _)| band_of(i) == band).collect(),
        })
        .filter(|pattern| !pattern.texels.is_empty())
        .collect()
}
