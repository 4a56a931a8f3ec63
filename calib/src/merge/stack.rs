//! Aligned pictures of different exposure become one picture of radiance.
//!
//! Pixels are taken as they lie: nothing is warped. In what moves, one exposure must rule: the *reference*, the one with the
//! most pixels that are measured to a tenth. From it outwards, to shorter and to longer exposures, each picture is compared,
//! tile by tile of 16 x 16 pixels, with what the pictures before it have measured. Where a tile has moved ([`super::motion`]),
//! that picture is left out of it and of the tiles around it, into which the moving thing may reach a little. A pixel that
//! still contradicts itself believes the exposures nearest to the reference.

use super::{
    Clipping, Consistency, Estimate, Sample, State, merge_rgb,
    motion::{Agreement, MotionTest},
    noise::VarianceTable,
};

/// Edge of a tile in pixels.
pub const TILE_PX: usize = 16;

/// One exposure of a stack.
#[derive(Debug, Clone, Copy)]
pub struct StackPicture<'a> {
    /// Red, green, blue of each pixel, row by row.
    pub codes: &'a [u8],
    /// What the codes mean.
    pub table: &'a VarianceTable,
    /// Pixels that show nothing, such as the borders of a registered picture.
    pub holes: Option<&'a [bool]>,
}

/// What decides whether something has moved.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StackRules {
    /// For a tile.
    pub motion: MotionTest,
    /// For a pixel.
    pub consistency: Consistency,
}

/// Where a merged pixel comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Origin {
    /// Index of the picture that weighs most; where all are clipped, of the one whose bound is given. `None` where no picture
    /// shows anything.
    pub picture: Option<u8>,
    /// What the radiance of red, green and blue means.
    pub states: [State; 3],
    /// Whether a picture was left out because something has moved.
    pub has_moved: bool,
}

/// Radiance of every pixel, row by row, in the unit and primaries of the tables.
#[derive(Debug, Clone, PartialEq)]
pub struct MergedPicture {
    /// Radiance of red, green and blue; 0 where no picture shows anything.
    pub radiance: Vec<[f32; 3]>,
    /// Its variance; infinite where no picture shows anything.
    pub variance: Vec<[f32; 3]>,
    /// Where it comes from.
    pub origin: Vec<Origin>,
    /// Index of the picture that rules where something has moved.
    pub reference: usize,
}

/// Why pictures are no stack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum StackError {
    /// There is nothing to merge.
    #[error("there are `{found}` pictures (allowed: 2 to 255)")]
    Count {
        /// Number of pictures.
        found: usize,
    },
    /// A picture is not as large as said.
    #[error(
        "picture `{picture}` has `{found}` values (allowed: `{expected}`, three per pixel and one mask value if any)"
    )]
    Size {
        /// Index of the picture.
        picture: usize,
        /// Number of values.
        found: usize,
        /// How many there must be.
        expected: usize,
    },
}

/// Merges aligned pictures of `size_px` (width, height).
///
/// # Errors
/// When there are fewer than two pictures or more than 255, or one has another size.
pub fn merge_stack(
    pictures: &[StackPicture<'_>],
    size_px: [usize; 2],
    rules: &StackRules,
) -> Result<MergedPicture, StackError> {
    check(pictures, size_px)?;
    let reference = reference(pictures);
    let mut stack = Stack {
        pictures,
        rules,
        tiles: [size_px[0].div_ceil(TILE_PX), size_px[1].div_ceil(TILE_PX)],
        width_px: size_px[0],
        merged: Vec::new(),
        left_out: Vec::new(),
        estimates: vec![None; size_px[0] * size_px[1]],
    };
    for index in order(pictures, reference) {
        stack.add(index);
    }
    Ok(stack.finish(reference))
}

fn check(pictures: &[StackPicture<'_>], size_px: [usize; 2]) -> Result<(), StackError> {
    if !(2..=255).contains(&pictures.len()) {
        return Err(StackError::Count { found: pictures.len() });
    }
    let n_pixels = size_px[0] * size_px[1];
    for (index, picture) in pictures.iter().enumerate() {
        let holes = picture.holes.map_or(n_pixels, <[bool]>::len);
        for (found, expected) in [(picture.codes.len(), 3 * n_pixels), (holes, n_pixels)] {
            if found != expected {
                return Err(StackError::Size {
                    picture: index,
                    found,
                    expected,
                });
            }
        }
    }
    Ok(())
}

impl StackPicture<'_> {
    fn sample(&self, pixel: usize) -> Option<[Sample; 3]> {
        if self.holes.is_some_and(|holes| holes[pixel]) {
            return None;
        }
        let codes = &self.codes[3 * pixel..3 * pixel + 3];
        Some(self.table.sample([codes[0], codes[1], codes[2]], 1.0))
    }

    /// Radiance at which the picture clips: the shorter the exposure, the higher.
    fn full_scale(&self) -> f32 {
        self.table.channels()[1].sample(255, 1.0).radiance
    }
}

/// The picture with the most pixels that are measured to a tenth in all channels.
fn reference(pictures: &[StackPicture<'_>]) -> usize {
    let is_measured = |sample: &Sample| {
        sample.clipping == Clipping::None && sample.variance_at(sample.radiance) < (0.1 * sample.radiance).powi(2)
    };
    let count = |picture: &StackPicture<'_>| {
        (0..picture.codes.len() / 3)
            .filter_map(|pixel| picture.sample(pixel))
            .filter(|rgb| rgb.iter().all(is_measured))
            .count()
    };
    let counts: Vec<usize> = pictures.iter().map(count).collect();
    (0..counts.len()).max_by_key(|&index| counts[index]).unwrap_or(0)
}

/// Indices of the pictures, the reference first, then by distance in exposure.
fn order(pictures: &[StackPicture<'_>], reference: usize) -> Vec<usize> {
    let ratio = |index: usize| pictures[index].full_scale() / pictures[reference].full_scale();
    let mut order: Vec<usize> = (0..pictures.len()).filter(|&index| index != reference).collect();
    order.sort_by(|&a, &b| ratio(a).ln().abs().total_cmp(&ratio(b).ln().abs()));
    order.insert(0, reference);
    order
}

/// A stack that is being merged.
struct Stack<'a> {
    pictures: &'a [StackPicture<'a>],
    rules: &'a StackRules,
    /// Tiles per row and per column.
    tiles: [usize; 2],
    width_px: usize,
    /// Indices of the pictures merged so far, the reference first.
    merged: Vec<usize>,
    /// For each of them the tiles that it is left out of.
    left_out: Vec<Vec<bool>>,
    /// What is known of each pixel so far.
    estimates: Vec<Option<[Estimate; 3]>>,
}

impl Stack<'_> {
    fn tile_of(&self, pixel: usize) -> usize {
        pixel / self.width_px / TILE_PX * self.tiles[0] + pixel % self.width_px / TILE_PX
    }

    fn add(&mut self, index: usize) {
        let left_out = self.with_neighbours(&self.moved(index));
        self.merged.push(index);
        self.left_out.push(left_out);
        let mut samples = Vec::with_capacity(self.pictures.len());
        let mut rgb = Vec::with_capacity(self.pictures.len());
        for pixel in 0..self.estimates.len() {
            self.samples(pixel, &mut samples);
            // Most pixels have something new; in the others nothing changes.
            if samples.first().is_some_and(|(newest, _)| usize::from(*newest) == index) {
                rgb.clear();
                rgb.extend(samples.iter().map(|(_, sample)| *sample));
                self.estimates[pixel] = merge_rgb(&rgb, &self.rules.consistency);
            }
        }
    }

    /// The tiles in which a picture shows something else than is known so far.
    fn moved(&self, index: usize) -> Vec<bool> {
        let mut agreements = vec![Agreement::default(); self.tiles[0] * self.tiles[1]];
        for (pixel, estimate) in self.estimates.iter().enumerate() {
            if let (Some(sample), Some(estimate)) = (self.pictures[index].sample(pixel), estimate) {
                agreements[self.tile_of(pixel)].add(&self.rules.motion, &sample, &estimate.map(known));
            }
        }
        agreements
            .iter()
            .map(|agreement| agreement.has_moved(&self.rules.motion))
            .collect()
    }

    fn with_neighbours(&self, tiles: &[bool]) -> Vec<bool> {
        let [columns, rows] = self.tiles;
        let around = |at: usize, n: usize| at.saturating_sub(1)..(at + 2).min(n);
        (0..tiles.len())
            .map(|tile| {
                around(tile / columns, rows)
                    .any(|row| around(tile % columns, columns).any(|column| tiles[row * columns + column]))
            })
            .collect()
    }

    /// What the merged pictures say of a pixel: index and sample, the reference last, as [`merge_rgb`] wants what is trusted
    /// most.
    fn samples(&self, pixel: usize, samples: &mut Vec<(u8, [Sample; 3])>) {
        samples.clear();
        let tile = self.tile_of(pixel);
        for (&index, left_out) in self.merged.iter().zip(&self.left_out).rev() {
            if !left_out[tile]
                && let Some(sample) = self.pictures[index].sample(pixel)
            {
                samples.push((index as u8, sample));
            }
        }
    }

    fn finish(self, reference: usize) -> MergedPicture {
        let mut samples = Vec::with_capacity(self.pictures.len());
        let origin = self.estimates.iter().enumerate().map(|(pixel, estimate)| {
            self.samples(pixel, &mut samples);
            let tile = self.tile_of(pixel);
            let Some(estimate) = estimate else {
                return Origin {
                    picture: None,
                    states: [State::AtMost; 3],
                    has_moved: false,
                };
            };
            let trusted = estimate[0].trusted;
            Origin {
                picture: heaviest(&samples[samples.len() - trusted..], estimate),
                states: estimate.map(|channel| channel.state),
                has_moved: trusted < samples.len() || self.left_out.iter().any(|left_out| left_out[tile]),
            }
        });
        let origin = origin.collect();
        let of = |value: &dyn Fn(&Estimate) -> f32, unseen: f32| {
            let rgb =
                |estimate: &Option<[Estimate; 3]>| estimate.as_ref().map_or([unseen; 3], |e| e.each_ref().map(value));
            self.estimates.iter().map(rgb).collect()
        };
        MergedPicture {
            radiance: of(&|estimate| estimate.radiance, 0.0),
            variance: of(&|estimate| estimate.variance, f32::INFINITY),
            origin,
            reference,
        }
    }
}

/// What an estimate says, as a sample.
fn known(estimate: Estimate) -> Sample {
    Sample {
        radiance: estimate.radiance,
        shot: 0.0,
        floor: estimate.variance,
        clipping: match estimate.state {
            State::Measured => Clipping::None,
            State::AtLeast => Clipping::Above,
            State::AtMost => Clipping::Below,
        },
    }
}

/// The picture with the most weight over the channels; of clipped ones the one with the highest bound.
fn heaviest(samples: &[(u8, [Sample; 3])], estimate: &[Estimate; 3]) -> Option<u8> {
    let weight = |rgb: &[Sample; 3]| -> f32 {
        rgb.iter()
            .zip(estimate)
            .filter(|(sample, _)| sample.clipping != Clipping::Above)
            .map(|(sample, estimate)| estimate.variance / sample.variance_at(estimate.radiance))
            .sum()
    };
    samples
        .iter()
        .max_by(|(_, a), (_, b)| {
            weight(a)
                .total_cmp(&weight(b))
                .then(a[1].radiance.total_cmp(&b[1].radiance))
        })
        .map(|(index, _)| *index)
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use mirrorball_capture::frame::Exposure;

    use super::*;
    use crate::{
        merge::simulate::{Random, knee},
        photometry::Photometry,
    };

    const SIZE_PX: [usize; 2] = [200, 144];

    /// What is where: a ramp from 0.5 to 60, a lamp of 200, and a square of 12 that stands elsewhere in each picture.
    fn scene(x: usize, y: usize, square_x: usize) -> f64 {
        if (square_x..square_x + 20).contains(&x) && (30..50).contains(&y) {
            12.0
        } else if (180..190).contains(&x) && (5..15).contains(&y) {
            200.0
        } else {
            0.5 * 120f64.powf(x as f64 / 199.0)
        }
    }

    /// Three exposures of it, the square at these places, merged.
    fn merged(square_x: [usize; 3]) -> MergedPicture {
        let photometry = Photometry {
            sensitivity: 40.0,
            vignetting: [0.0, 0.0],
            full_well_e: 12_000.0,
            read_noise_e: 6.0,
            response: knee(),
            color: DMat3::IDENTITY,
        };
        let mut random = Random::new(2);
        let shots: Vec<(Vec<u8>, VarianceTable)> = (0..3)
            .map(|step| {
                let exposure = Exposure {
                    time_s: 1e-4 * 4f64.powi(step),
                    gain: 1.0,
                    white_balance: [1.3, 1.0, 1.1],
                };
                let noise = photometry.channel_noise(&exposure);
                let mut codes = Vec::new();
                for y in 0..SIZE_PX[1] {
                    for x in 0..SIZE_PX[0] {
                        let radiance = scene(x, y, square_x[step as usize]);
                        codes.extend(noise.map(|noise| random.code(&photometry.response, &noise, radiance)));
                    }
                }
                (codes, VarianceTable::new(&photometry, &exposure))
            })
            .collect();
        let pictures: Vec<StackPicture<'_>> = shots
            .iter()
            .map(|(codes, table)| StackPicture {
                codes,
                table,
                holes: None,
            })
            .collect();
        merge_stack(&pictures, SIZE_PX, &StackRules::default()).unwrap()
    }

    /// Pixels that are farther from the truth than 5.5 standard deviations and 5 %, in any channel.
    fn wrong(merged: &MergedPicture, square_x: usize) -> Vec<[usize; 2]> {
        let is_wrong = |&[x, y]: &[usize; 2]| {
            let (pixel, truth) = (y * SIZE_PX[0] + x, scene(x, y, square_x));
            (0..3).any(|channel| {
                let sigma = f64::from(merged.variance[pixel][channel]).sqrt();
                let error = f64::from(merged.radiance[pixel][channel]) - truth;
                let is_bound = merged.origin[pixel].states[channel] == State::AtLeast && error < 0.0;
                !is_bound && error.abs() > 5.5 * sigma + 0.05 * truth
            })
        };
        (0..SIZE_PX[1])
            .flat_map(|y| (0..SIZE_PX[0]).map(move |x| [x, y]))
            .filter(is_wrong)
            .collect()
    }

    #[test]
    fn a_still_scene_is_merged_everywhere() {
        let merged = merged([40; 3]);
        assert_eq!(merged.reference, 1);
        assert!(merged.origin.iter().all(|origin| !origin.has_moved));
        assert_eq!(wrong(&merged, 40), [[0; 2]; 0]);
        // The lamp clips even the shortest exposure's red.
        let lamp = merged.origin[10 * SIZE_PX[0] + 185];
        assert_eq!(
            (lamp.picture, lamp.states),
            (Some(0), [State::AtLeast, State::Measured, State::Measured])
        );
        let dark = merged.origin[10 * SIZE_PX[0] + 5];
        assert_eq!((dark.picture, dark.states), (Some(2), [State::Measured; 3]));
    }

    #[test]
    fn what_moves_leaves_no_ghosts() {
        let places = [10, 40, 64];
        let merged = merged(places);
        assert_eq!(wrong(&merged, places[merged.reference]), [[0; 2]; 0]);
        let moved = merged.origin.iter().filter(|origin| origin.has_moved).count();
        assert!((1200..15_000).contains(&moved), "{moved}");
        // What stands still is merged as before.
        assert_eq!(merged.origin[10 * SIZE_PX[0] + 185].picture, Some(0));
        assert!(!merged.origin[100 * SIZE_PX[0] + 5].has_moved);
    }

    #[test]
    fn holes_are_filled_from_the_other_pictures() {
        let photometry = Photometry {
            sensitivity: 1.0,
            vignetting: [0.0, 0.0],
            full_well_e: 1e4,
            read_noise_e: 1.0,
            response: knee(),
            color: DMat3::IDENTITY,
        };
        let table = |time_s: f64| {
            let exposure = Exposure {
                time_s,
                gain: 1.0,
                white_balance: [1.0; 3],
            };
            VarianceTable::new(&photometry, &exposure)
        };
        let tables = [table(1.0), table(0.5)];
        let codes: Vec<[u8; 9]> = [1.0, 0.5]
            .map(|time| [photometry.response.encode(0.5 * time); 9])
            .to_vec();
        let holes = [[true, false, true], [false, false, true]];
        let pictures: Vec<StackPicture<'_>> = (0..2)
            .map(|i| StackPicture {
                codes: &codes[i],
                table: &tables[i],
                holes: Some(&holes[i]),
            })
            .collect();
        let merged = merge_stack(&pictures, [3, 1], &StackRules::default()).unwrap();
        let pictures_of = merged.origin.iter().map(|origin| origin.picture).collect::<Vec<_>>();
        assert_eq!(pictures_of, [Some(1), Some(0), None]);
        assert!((merged.radiance[0][0] - 0.5).abs() < 0.01 && (merged.radiance[1][0] - 0.5).abs() < 0.01);
        assert_eq!((merged.radiance[2], merged.variance[2]), ([0.0; 3], [f32::INFINITY; 3]));
        assert_eq!(
            merge_stack(&pictures[..1], [3, 1], &StackRules::default()),
            Err(StackError::Count { found: 1 })
        );
        assert_eq!(
            merge_stack(&pictures, [4, 1], &StackRules::default())
                .unwrap_err()
                .to_string(),
            "picture `0` has `9` values (allowed: `12`, three per pixel and one mask value if any)"
        );
    }
}
