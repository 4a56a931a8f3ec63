//! A radiance cube as a tree of little lights, and which of them each texel of a filtered map has to look at.
//!
//! Convolving a cube with a lobe is a sum over all its texels. Far from the lobe's middle the lobe changes slowly, so many
//! texels can stand as one light at their common centre: Barnes and Hut 1986, "A hierarchical O(N log N) force-calculation
//! algorithm", for light as in Walter et al. 2005, "Lightcuts". A node keeps the light's centre and spread as well as its
//! power, so a lamp of any brightness stays where it is and nothing is sampled by chance.
//!
//! Which nodes a tile of texels looks at depends on the lobe and on geometry alone: the lists are made once.

use glam::Vec3;
use rayon::prelude::*;

use crate::passes::ENVIRONMENT_SIZE;
use mirrorball_calib::probe::cube::{Cube, FACES, face_direction, texel_direction};

/// Edge of a face of the finest level, texels; a leaf holds 2 × 2 texels of the radiance cube.
pub const LEAF_SIZE: u32 = ENVIRONMENT_SIZE / 2;
/// Levels: faces of 64, 32, 16, 8 and 4 nodes an edge.
pub const LEVELS: u32 = 5;
/// Edge of a tile of texels that share a list.
pub const TILE_SIZE: u32 = 4;

/// Light added to every texel where a node's centre is looked for, so that a black node has one.
const FAINT: f32 = 1e-6;
/// A node is taken as one light where its edge is at most this share of its distance from the tile.
const OPENING: f32 = 0.8;
/// The same share of the lobe's width, for nodes near its middle.
const WIDTH_SHARE: f32 = 0.4;

/// Light from a patch of the sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Radiance times solid angle, linear RGB.
    pub power: Vec3,
    /// Unit direction of the light's centre.
    pub direction: Vec3,
    /// Variance of the light around the centre along one axis, rad².
    pub variance: f32,
}

/// All nodes of a radiance cube, the finest level first.
#[derive(Debug, Clone, PartialEq)]
pub struct LightTree {
    /// Level after level, face after face, row after row.
    pub nodes: Vec<Node>,
}

/// Edge of a face of `level`, nodes.
#[must_use]
pub fn level_size(level: u32) -> u32 {
    LEAF_SIZE >> level
}

/// Index of the first node of `level`.
#[must_use]
pub fn level_start(level: u32) -> u32 {
    (0..level).map(|l| FACES as u32 * level_size(l).pow(2)).sum()
}

/// Number of nodes.
#[must_use]
pub fn node_count() -> u32 {
    level_start(LEVELS)
}

/// Sums that a node is made of, and that add up from level to level.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    power: Vec3,
    moment: Vec3,
    weight: f32,
}

impl Sums {
    fn node(self) -> Node {
        let mean = self.moment / self.weight;
        let length = mean.length();
        Node {
            power: self.power,
            direction: mean / length,
            // Of directions with variance v along either axis the mean is 1 - v long.
            variance: (1.0 - length).max(0.0),
        }
    }
}

impl LightTree {
    /// The tree of a cube with faces of [`ENVIRONMENT_SIZE`] texels.
    ///
    /// # Panics
    /// For cubes of another size.
    #[must_use]
    pub fn new(radiance: &Cube<Vec3>) -> Self {
        assert_eq!(
            radiance.size(),
            ENVIRONMENT_SIZE,
            "a light tree is made of one size of cube"
        );
        let leaf = |texel: Vec3, index: usize| {
            let area_sr = radiance.solid_angle(index);
            let weight = (texel.element_sum() + FAINT) * area_sr;
            Sums {
                power: texel * area_sr,
                moment: radiance.direction(index) * weight,
                weight,
            }
        };
        let texels = radiance.texels().iter().enumerate();
        let mut level: Vec<Sums> = texels.map(|(index, texel)| leaf(*texel, index)).collect();
        let mut nodes = Vec::with_capacity(node_count() as usize);
        for l in 0..LEVELS {
            level = halved(&level, level_size(l) as usize);
            nodes.extend(level.iter().map(|sums| sums.node()));
        }
        Self { nodes }
    }
}

/// Sums of 2 × 2, to faces of `size`.
fn halved(finer: &[Sums], size: usize) -> Vec<Sums> {
    let mut out = vec![Sums::default(); FACES * size * size];
    for (index, sums) in out.iter_mut().enumerate() {
        let (face, y, x) = (index / (size * size), index / size % size, index % size);
        for (dy, dx) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let part = finer[(face * 2 * size + 2 * y + dy) * 2 * size + 2 * x + dx];
            sums.power += part.power;
            sums.moment += part.moment;
            sums.weight += part.weight;
        }
    }
    out
}

/// A lobe around a direction that light is gathered with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lobe {
    /// GGX of this alpha for normal = view = direction (Karis 2013): D(h) cos θ.
    Ggx {
        /// Square of the perceptual roughness, above 0.
        alpha: f32,
    },
    /// Phong: cosⁿ θ.
    Phong {
        /// The exponent n, above 0.
        exponent: f32,
    },
    /// A matt surface: cos θ.
    Cosine,
}

impl Lobe {
    /// Weight of a node's light at `cosine` from the direction, spread by `variance` rad² along each axis; its scale is free.
    ///
    /// Spread light is what a wider lobe sees of a point: for GGX and small angles α² + v has the same peak as the lobe
    /// convolved with a Gaussian of variance v to first order; for Phong, nearly Gaussian itself, 1 / n + v has.
    #[must_use]
    pub fn weight(self, cosine: f32, variance: f32) -> f32 {
        match self {
            Self::Ggx { alpha } => {
                let sin2_half = 0.5 - 0.5 * cosine;
                let inverse = 1.0 / (sin2_half + alpha * alpha * (1.0 - sin2_half));
                let spread = 1.0 + variance * inverse * (3.0 * sin2_half * inverse - 1.0);
                above_horizon(cosine, variance) * alpha * alpha * inverse * inverse * spread
            }
            Self::Phong { exponent } => {
                let exponent = exponent / (1.0 + exponent * variance);
                exponent * cosine.max(0.0).powf(exponent)
            }
            Self::Cosine => above_horizon(cosine, variance) * (1.0 - variance),
        }
    }

    /// Angle over which the lobe hardly changes, radians.
    fn width_rad(self) -> f32 {
        match self {
            Self::Ggx { alpha } => (2.0 * alpha).min(0.7),
            Self::Phong { exponent } => 2.0 / (exponent + 2.0).sqrt(),
            Self::Cosine => 0.5,
        }
    }

    /// Edge of the largest node that is taken as one light, radians: the more of a lobe's light comes from far off its
    /// middle, the smaller. Found by trial to keep errors in smooth coloured light below 0.2 % (`benches/light_maps`).
    fn coarsest_rad(self) -> f32 {
        const OF_A_COSINE: f32 = 0.13;
        match self {
            Self::Ggx { alpha } => OF_A_COSINE / alpha.sqrt(),
            Self::Phong { exponent } => OF_A_COSINE * exponent.max(1.0).powf(0.25),
            Self::Cosine => OF_A_COSINE,
        }
    }
}

/// Mean of max(0, x) over x within √(3 v) of `cosine`: light that is spread across the horizon is partly above it.
fn above_horizon(cosine: f32, variance: f32) -> f32 {
    let reach = (3.0 * variance).sqrt();
    if cosine >= reach {
        cosine
    } else if cosine > -reach {
        (cosine + reach).powi(2) / (4.0 * reach)
    } else {
        0.0
    }
}

/// For every tile of a filtered cube the nodes that it sums.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeLists {
    /// Edge of a face of the filtered cube, texels.
    pub size: u32,
    /// The lobe.
    pub lobe: Lobe,
    /// First and one past the last of each tile's entries; tiles row by row, face after face.
    pub tiles: Vec<[u32; 2]>,
    /// Indices of nodes.
    pub entries: Vec<u32>,
    /// One over the sum of weights in uniform light of radiance 1, per texel.
    pub scale: Vec<f32>,
}

/// A cone of directions.
#[derive(Debug, Clone, Copy)]
struct Cone {
    middle: Vec3,
    radius_rad: f32,
}

impl NodeLists {
    /// Lists for faces of `size` texels, a multiple of [`TILE_SIZE`].
    #[must_use]
    pub fn new(size: u32, lobe: Lobe) -> Self {
        let mut lists = Self {
            size,
            lobe,
            tiles: Vec::new(),
            entries: Vec::new(),
            scale: Vec::new(),
        };
        let roots = level_size(LEVELS - 1);
        for face in 0..FACES as u32 {
            for y in (0..size).step_by(TILE_SIZE as usize) {
                for x in (0..size).step_by(TILE_SIZE as usize) {
                    let tile = square(size, face, [x, y], TILE_SIZE);
                    let start = lists.entries.len() as u32;
                    for root in 0..FACES as u32 * roots * roots {
                        let place = [root % roots, root / roots % roots];
                        lists.open(&tile, LEVELS - 1, root / (roots * roots), place);
                    }
                    lists.tiles.push([start, lists.entries.len() as u32]);
                }
            }
        }
        let uniform = LightTree::new(&Cube::filled(ENVIRONMENT_SIZE, Vec3::ONE));
        lists.scale = vec![1.0; (FACES as u32 * size * size) as usize];
        lists.scale = lists
            .filtered(&uniform)
            .texels()
            .iter()
            .map(|sum| 1.0 / sum.x)
            .collect();
        lists
    }

    /// Adds a node of `face` at `place`, or the smaller ones that it consists of.
    fn open(&mut self, tile: &Cone, level: u32, face: u32, place: [u32; 2]) {
        let size = level_size(level);
        let node = square(size, face, place, 1);
        let distance_rad = tile.middle.angle_between(node.middle) - tile.radius_rad - node.radius_rad;
        if distance_rad > std::f32::consts::FRAC_PI_2 {
            return;
        }
        let edge_rad = std::f32::consts::SQRT_2 * node.radius_rad;
        let wanted = (OPENING * distance_rad).max(WIDTH_SHARE * self.lobe.width_rad());
        if level == 0 || edge_rad <= wanted.min(self.lobe.coarsest_rad()) {
            self.entries
                .push(level_start(level) + (face * size + place[1]) * size + place[0]);
            return;
        }
        for [dx, dy] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
            self.open(tile, level - 1, face, [2 * place[0] + dx, 2 * place[1] + dy]);
        }
    }

    /// Tile that texel `index` of the filtered cube lies in.
    fn tile_of(&self, index: usize) -> usize {
        let (size, edge) = (self.size as usize, TILE_SIZE as usize);
        let (face, y, x) = (index / (size * size), index / size % size, index % size);
        let per_row = size / edge;
        (face * per_row + y / edge) * per_row + x / edge
    }

    /// The filtered cube: for every texel the mean of the light under the lobe around it.
    #[must_use]
    pub fn filtered(&self, tree: &LightTree) -> Cube<Vec3> {
        let texel = |index: usize| {
            let direction = texel_direction(self.size, index);
            let [start, end] = self.tiles[self.tile_of(index)].map(|entry| entry as usize);
            let mut sum = Vec3::ZERO;
            for &entry in &self.entries[start..end] {
                let node = &tree.nodes[entry as usize];
                sum += node.power * self.lobe.weight(direction.dot(node.direction), node.variance);
            }
            sum * self.scale[index]
        };
        let texels = (0..self.scale.len()).into_par_iter().map(texel).collect();
        Cube::from_texels(self.size, texels).expect("the scale has one number per texel")
    }
}

/// The cone around `edge` × `edge` texels from `place` on.
fn square(size: u32, face: u32, place: [u32; 2], edge: u32) -> Cone {
    let at = |x: u32, y: u32| {
        let to_face = |t: u32| t as f32 / size as f32 * 2.0 - 1.0;
        face_direction(face as usize, to_face(x), to_face(y)).normalize()
    };
    let [x, y] = place;
    let corners = [at(x, y), at(x + edge, y), at(x, y + edge), at(x + edge, y + edge)];
    let middle = corners.iter().sum::<Vec3>().normalize();
    let radius_rad = corners.iter().map(|c| c.angle_between(middle)).fold(0.0, f32::max);
    Cone { middle, radius_rad }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Node of `level` that a direction falls into.
    fn node_at(level: u32, direction: Vec3) -> u32 {
        let size = level_size(level);
        level_start(level) + Cube::filled(size, 0u8).index_of(direction) as u32
    }

    #[test]
    fn a_tree_keeps_all_power_at_every_level() {
        let mut radiance = Cube::filled(ENVIRONMENT_SIZE, Vec3::ONE);
        radiance.texels_mut()[12_345] = Vec3::new(1e6, 5e5, 0.0);
        let tree = LightTree::new(&radiance);
        let all: Vec3 = (0..radiance.texels().len())
            .map(|i| radiance.texels()[i] * radiance.solid_angle(i))
            .sum();
        for level in 0..LEVELS {
            let nodes = &tree.nodes[level_start(level) as usize..level_start(level + 1) as usize];
            let sum: Vec3 = nodes.iter().map(|node| node.power).sum();
            assert!(
                ((sum - all) / all).abs().max_element() < 1e-4,
                "level {level}: {sum}, not {all}"
            );
            // The lamp stays where it is.
            let lamp = &nodes[(node_at(level, radiance.direction(12_345)) - level_start(level)) as usize];
            assert!(
                lamp.direction.distance(radiance.direction(12_345)) < 2e-3,
                "level {level}"
            );
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn all_light_above_the_horizon_is_summed_once(
            x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0, texel in 0usize..384, roughness in 0.2f32..1.0,
        ) {
            let light = Vec3::new(x, y, z);
            prop_assume!(light.length() > 0.1);
            let lists = NodeLists::new(8, Lobe::Ggx { alpha: roughness * roughness });
            let [start, end] = lists.tiles[lists.tile_of(texel)].map(|entry| entry as usize);
            let nodes: Vec<u32> = (0..LEVELS).map(|level| node_at(level, light)).collect();
            let n = lists.entries[start..end].iter().filter(|entry| nodes.contains(entry)).count();
            let is_above = texel_direction(8, texel).dot(light) > 0.0;
            prop_assert!(n == 1 || (n == 0 && !is_above), "{n} nodes hold the light");
        }

        #[test]
        fn spread_light_weighs_what_its_parts_weigh(angle_rad in 0.0f32..1.2, alpha in 0.05f32..1.0) {
            // Eight points in a ring have a variance of half their radius squared along each axis.
            let lobes = [
                Lobe::Ggx { alpha },
                Lobe::Phong { exponent: 1.0 / (alpha * alpha) },
                Lobe::Cosine,
            ];
            let middle = Vec3::new(angle_rad.sin(), 0.0, angle_rad.cos());
            let (a, b) = middle.any_orthonormal_pair();
            for lobe in lobes {
                let radius_rad = 0.1 * lobe.width_rad();
                let part = |i: usize| {
                    let (sin, cos) = (i as f32 * std::f32::consts::FRAC_PI_4).sin_cos();
                    let point = middle * radius_rad.cos() + (a * cos + b * sin) * radius_rad.sin();
                    lobe.weight(point.z, 0.0)
                };
                let mean = (0..8).map(part).sum::<f32>() / 8.0;
                let spread = lobe.weight(middle.z, 0.5 * radius_rad * radius_rad);
                let peak = lobe.weight(1.0, 0.0);
                // What the Laplacian leaves out is of fourth order: for the widest lobes about 0.2 % of the peak.
                prop_assert!((spread - mean).abs() < 4e-3 * peak, "{lobe:?}: {spread}, not {mean}, peak {peak}");
            }
        }
    }
}
