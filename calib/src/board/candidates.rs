//! Places that look like the corner of four squares, wherever they are.

use std::f64::consts::{PI, TAU};

use glam::DVec2;

use crate::tag::LinearLuma;

/// Blurs at which corners are looked for, in pixels: small squares need little, blurred pictures much.
const SCALES_PX: [f64; 3] = [1.2, 2.4, 4.8];

/// Least contrast, half the difference of white and black in root light.
const MIN_CONTRAST: f64 = 0.015;

/// Candidates that are looked at further, the strongest of each scale.
const MAX_CANDIDATES: usize = 3000;

/// Samples on a ring around a candidate, and its radius as a multiple of the blur.
const RING: usize = 32;
const RING_RADIUS: f64 = 2.0;

/// Largest angle between the two ends of an edge, in radians: it goes straight through the corner.
const MAX_BEND: f64 = 0.6;

/// A place that looks like a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    /// Where, to about a pixel.
    pub(super) pixel: DVec2,
    /// Directions of the two edges, unit vectors.
    pub(super) edges: [DVec2; 2],
    /// Whether the squares between the two directions, and between their opposites, are the black ones.
    pub(super) black_between: bool,
    /// Half the difference of white and black, in root light.
    contrast: f64,
}

/// All such places, the strongest first.
pub(super) fn find(luma: &LinearLuma) -> Vec<Candidate> {
    let root = Plane {
        width: luma.size()[0],
        height: luma.size()[1],
        values: luma
            .linear()
            .iter()
            .map(|&value| (f32::from(value) / 65_535.0).sqrt())
            .collect(),
    };
    let mut found: Vec<Candidate> = Vec::new();
    for scale in SCALES_PX {
        let blurred = root.blurred(scale);
        let mut peaks = blurred.saddles(scale);
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        peaks.truncate(MAX_CANDIDATES);
        for (contrast, pixel) in peaks {
            let radius = RING_RADIUS * scale;
            let known = |other: &Candidate| other.pixel.distance(pixel) < radius;
            if !found.iter().any(known) {
                found.extend(blurred.judge(pixel, radius, contrast));
            }
        }
    }
    found.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    found
}

/// A picture of numbers.
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y * self.width + x]
    }

    /// Gaussian blur; the border is repeated.
    fn blurred(&self, sigma: f64) -> Self {
        let reach = (3.0 * sigma).ceil() as usize;
        let weight = |i: usize| (-0.5 * ((i as f64 - reach as f64) / sigma).powi(2)).exp();
        let sum: f64 = (0..=2 * reach).map(weight).sum();
        let kernel: Vec<f32> = (0..=2 * reach).map(|i| (weight(i) / sum) as f32).collect();
        let (width, height) = (self.width, self.height);
        let mut across = Vec::with_capacity(self.values.len());
        let mut padded = Vec::with_capacity(width + 2 * reach);
        for row in self.values.chunks_exact(width.max(1)) {
            padded.clear();
            padded.extend(std::iter::repeat_n(row[0], reach));
            padded.extend(row);
            padded.extend(std::iter::repeat_n(row[width - 1], reach));
            let windows = padded.windows(kernel.len());
            across.extend(windows.map(|window| {
                window
                    .iter()
                    .zip(&kernel)
                    .map(|(value, weight)| value * weight)
                    .sum::<f32>()
            }));
        }
        let mut values = vec![0.0; across.len()];
        for y in 0..height {
            let target = &mut values[y * width..(y + 1) * width];
            for (i, weight) in kernel.iter().enumerate() {
                let source = (y + i).saturating_sub(reach).min(height - 1);
                let source = &across[source * width..(source + 1) * width];
                for (value, source) in target.iter_mut().zip(source) {
                    *value += weight * source;
                }
            }
        }
        Self { width, height, values }
    }

    /// Local maxima of `-det(Hessian)`, as contrasts: for crossing edges blurred by σ it is `(2/π)² contrast² / σ⁴`.
    fn saddles(&self, scale: f64) -> Vec<(f64, DVec2)> {
        let (width, height) = (self.width, self.height);
        if width < 5 || height < 5 {
            return Vec::new();
        }
        let mut response = vec![0.0f32; self.values.len()];
        for y in 1..height - 1 {
            for x in 1..width - 1 {
                let centre = 2.0 * self.at(x, y);
                let xx = self.at(x - 1, y) + self.at(x + 1, y) - centre;
                let yy = self.at(x, y - 1) + self.at(x, y + 1) - centre;
                let xy = 0.25
                    * (self.at(x + 1, y + 1) - self.at(x + 1, y - 1) - self.at(x - 1, y + 1) + self.at(x - 1, y - 1));
                response[y * width + x] = xy * xy - xx * yy;
            }
        }
        let factor = PI / 2.0 * scale * scale;
        let least = ((MIN_CONTRAST / factor).powi(2)) as f32;
        let mut peaks = Vec::new();
        for y in 2..height - 2 {
            for x in 2..width - 2 {
                let value = response[y * width + x];
                let is_peak = value > least
                    && (y - 1..=y + 1).all(|row| {
                        (x - 1..=x + 1).all(|column| {
                            let other = response[row * width + column];
                            // Of equal neighbours the first one counts.
                            value > other || (value == other && (row, column) >= (y, x))
                        })
                    });
                if is_peak {
                    peaks.push((factor * f64::from(value).sqrt(), DVec2::new(x as f64, y as f64)));
                }
            }
        }
        peaks
    }

    /// Walks around a place: four sectors, of which opposite ones are alike, are a corner.
    fn judge(&self, pixel: DVec2, radius: f64, contrast: f64) -> Option<Candidate> {
        let mut ring = [0.0; RING];
        for (i, value) in ring.iter_mut().enumerate() {
            *value = self.sample(pixel + radius * DVec2::from_angle(i as f64 * TAU / RING as f64))?;
        }
        let (low, high) = ring
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| {
                (low.min(value), high.max(value))
            });
        let middle = 0.5 * (low + high);
        // Where brightness crosses the middle.
        let mut crossings = [0.0; 4];
        let mut count = 0;
        for i in 0..RING {
            let (here, next) = (ring[i] - middle, ring[(i + 1) % RING] - middle);
            if (here > 0.0) != (next > 0.0) {
                *crossings.get_mut(count)? = (i as f64 + here / (here - next)) * TAU / RING as f64;
                count += 1;
            }
        }
        if count != 4 {
            return None;
        }
        let edge = |a: f64, b: f64| {
            let bend = b - a - PI;
            (bend.abs() < MAX_BEND).then(|| DVec2::from_angle(a + 0.5 * bend))
        };
        let edges = [edge(crossings[0], crossings[2])?, edge(crossings[1], crossings[3])?];
        // Just before the first crossing lies a sector between the opposite of the second edge and the first.
        let black_before_first = ring[0] < middle;
        Some(Candidate {
            pixel,
            edges,
            black_between: !black_before_first,
            contrast,
        })
    }

    /// Bilinear interpolation; `None` outside the picture.
    fn sample(&self, pixel: DVec2) -> Option<f64> {
        let corner = pixel.floor();
        if corner.min_element() < 0.0 || corner.x + 1.0 >= self.width as f64 || corner.y + 1.0 >= self.height as f64 {
            return None;
        }
        let (x, y) = (corner.x as usize, corner.y as usize);
        let part = pixel - corner;
        let row = |y: usize| f64::from(self.at(x, y)) * (1.0 - part.x) + f64::from(self.at(x + 1, y)) * part.x;
        Some(row(y) * (1.0 - part.y) + row(y + 1) * part.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::ResponseCurve;

    #[test]
    fn a_corner_is_a_candidate_with_its_edges() {
        let middle = DVec2::new(30.3, 29.6);
        for angles in [[0.4, 1.7], [-0.5, 0.6], [2.0, 3.1]] {
            let directions = angles.map(DVec2::from_angle);
            let light = |place: DVec2| {
                let steps = directions.map(|direction| direction.perp_dot(place - middle).clamp(-1.0, 1.0));
                0.4 + 0.3 * steps[0] * steps[1]
            };
            let places = (0..61 * 61).map(|i| DVec2::new(f64::from(i % 61), f64::from(i / 61)));
            let rgb: Vec<u8> = places.flat_map(|place| [(255.0 * light(place)) as u8; 3]).collect();
            let mut luma = LinearLuma::new();
            luma.set(&rgb, [61, 61], &ResponseCurve::srgb()).unwrap();
            let best = find(&luma)[0];
            assert!(best.pixel.distance(middle) < 1.5, "{best:?}");
            for direction in directions {
                let sine = best.edges.map(|edge| edge.perp_dot(direction).abs());
                // Half a pixel off on a ring of a few pixels turns an edge by so much.
                assert!(sine[0].min(sine[1]) < 0.25, "{direction} {best:?}");
            }
            let between = middle + 6.0 * (best.edges[0] + best.edges[1]);
            assert_eq!(best.black_between, light(between) < 0.4, "{best:?}");
        }
    }

    #[test]
    fn flat_and_tiny_pictures_have_none() {
        for size in [[0, 0], [1, 1], [4, 9], [40, 40]] {
            let mut luma = LinearLuma::new();
            luma.set(&vec![99; 3 * size[0] * size[1]], size, &ResponseCurve::srgb())
                .unwrap();
            assert_eq!(find(&luma), []);
        }
    }
}
