//! How blurred a camera's picture is, measured on the edges of the markers in it.
//!
//! Defocus, motion during the exposure, the lens and the demosaicing all show in the edges between a marker's black square
//! and its white border, and how much of each there is need not be known. Every piece of an edge tells the variance of
//! the blur across itself; pieces of several directions tell its covariance over the picture. The blur is taken to be the
//! same everywhere in the picture; where markers lie at other distances than the virtual objects, or the camera turns about
//! its axis, it is that around the markers.

use glam::{DMat2, DMat3, DVec2, DVec3};
use mirrorball_calib::camera::Intrinsics;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::{Camera, Marker};
use mirrorball_capture::frame::Frame;

use super::edge::{self, EdgeBlur, Sample};
use super::kernel;

/// Length of a piece of an edge, px: straight whatever the lens, and long enough to average over noise.
const PIECE_PX: f64 = 14.0;
/// Pieces that are looked at in a frame at most, spread over all edges.
const MAX_PIECES: usize = 64;
/// Pieces that a frame's blur must rest on.
const MIN_PIECES: usize = 6;
/// Pixels further from an edge than this tell nothing about its blur.
const MAX_REACH_PX: f64 = 6.0;
/// Pixels that an edge must have on either side.
const MIN_REACH_PX: f64 = 1.75;
/// Standard deviations of the blur, a pixel's own square included, that are tried in turn, px.
const BLURS_PX: [f64; 9] = [0.5, 0.63, 0.78, 0.98, 1.22, 1.53, 1.91, 2.38, 2.98];
/// Standard deviations that the blur of the next edge, a cell away, reaches into the cell. With 2.0 edges blurred by more than
/// a pixel came out up to a fifth too sharp (simulated, cells of 5 to 7 pixels), with 2.5 by less than 1 %.
const BLUR_ENDS: f64 = 2.5;
/// Cells along the side of the black square of every family that there is.
const CELLS: f64 = 8.0;
/// Standard deviation of the change of the blur from frame to frame, px²: of a camera that starts to move.
const CHANGE_PX2: f64 = 0.3;
/// What two pieces' blurs differ by beside noise, px²: paper that bends, ink that runs, focus that varies.
const SCATTER_PX2: f64 = 0.02;
/// Standard deviation of how far from round a blur is, before anything is measured, px²: markers whose edges have two
/// directions only do not tell the third number of a covariance.
const ROUNDNESS_PX2: f64 = 2.0;
/// Blur that shows in no 8-bit code, px².
const LEAST_BLUR_PX2: f64 = 0.03;

/// The blur of a camera's pictures from frame to frame.
#[derive(Debug, Clone, Default)]
pub struct Sharpness {
    estimate: Option<Estimate>,
}

/// A blur and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Covariance of the blur beyond a pixel's own square, symmetric, px².
    pub covariance_px2: DMat2,
    /// Standard deviation of its diagonal, px².
    pub sigma_px2: f64,
}

impl Sharpness {
    /// Takes in a frame of `camera` at a pose. A frame in which no edge can be measured leaves the blur as it is.
    pub fn update(&mut self, frame: &Frame, camera: &Camera, markers: &[Marker], camera_from_world: &Pose) {
        let Some(measured) = measure(frame, camera, markers, camera_from_world) else {
            return;
        };
        self.estimate = Some(match self.estimate {
            None => measured,
            Some(before) => blend(&before, &measured),
        });
    }

    /// The blur of the last frame that was taken in; `None` before any was measured.
    #[must_use]
    pub fn estimate(&self) -> Option<Estimate> {
        self.estimate
    }

    /// What to blur virtual pixels with, px²; `None` where that would change nothing.
    #[must_use]
    pub fn blur_px2(&self) -> Option<DMat2> {
        let ([largest, _], _) = kernel::eigen(self.estimate?.covariance_px2);
        (largest > LEAST_BLUR_PX2).then_some(self.estimate?.covariance_px2)
    }
}

/// Kalman's update: a blur that changes by [`CHANGE_PX2`] a frame.
fn blend(before: &Estimate, measured: &Estimate) -> Estimate {
    let expected = before.sigma_px2.powi(2) + CHANGE_PX2.powi(2);
    let gain = expected / (expected + measured.sigma_px2.powi(2));
    Estimate {
        covariance_px2: before.covariance_px2 + gain * (measured.covariance_px2 - before.covariance_px2),
        sigma_px2: ((1.0 - gain) * expected).sqrt(),
    }
}

/// The blur of one frame, from the edges of the markers that should be in it.
///
/// `None` where fewer than six pieces of edges can be measured: no marker in the picture, all small, hidden or overexposed.
#[must_use]
pub fn measure(frame: &Frame, camera: &Camera, markers: &[Marker], camera_from_world: &Pose) -> Option<Estimate> {
    let mut pieces: Vec<Piece> = markers
        .iter()
        .flat_map(|marker| pieces_of(marker, &camera.intrinsics, camera_from_world))
        .collect();
    let every = pieces.len().div_ceil(MAX_PIECES).max(1);
    pieces = pieces.into_iter().step_by(every).collect();
    let blurs: Vec<(DVec2, EdgeBlur)> = pieces
        .iter()
        .filter_map(|piece| {
            let samples = piece.samples(frame, camera)?;
            Some((piece.outward, piece.blur(&samples)?))
        })
        .collect();
    covariance(&blurs)
}

/// A straight piece of the edge of a marker's black square, in the picture.
#[derive(Debug, Clone, Copy)]
struct Piece {
    middle_px: DVec2,
    /// Unit normal towards the white border.
    outward: DVec2,
    half_length_px: f64,
    /// Distance of the next edges, a cell away.
    room_px: f64,
}

/// All pieces of a marker's four edges; none if the camera does not see all of its front.
fn pieces_of(marker: &Marker, intrinsics: &Intrinsics, camera_from_world: &Pose) -> Vec<Piece> {
    let camera_from_marker = *camera_from_world * marker.world_from_marker;
    let eye = camera_from_marker.inverse().translation;
    let half = 0.5 * marker.side_m;
    let cell = marker.side_m / CELLS;
    let project = |x: f64, y: f64| intrinsics.project(camera_from_marker.transform_point(DVec3::new(x, y, 0.0)));
    let border = half + cell;
    let is_whole = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
        .into_iter()
        .all(|(x, y)| project(x * border, y * border).is_some_and(|pixel| is_inside(pixel, intrinsics.size_px)));
    if eye.z <= 0.0 || !is_whole {
        return Vec::new();
    }
    // The edge y = -half and its quarter turns.
    let mut pieces = Vec::new();
    for turn in [DVec2::X, DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y] {
        let at = |along: f64, out: f64| {
            let place = turn.rotate(DVec2::new(along, -half - out));
            project(place.x, place.y)
        };
        let (Some(start), Some(end)) = (at(-half, 0.0), at(half, 0.0)) else {
            continue;
        };
        // Half a cell at either end belongs to the corner.
        let n = ((start.distance(end) * (1.0 - 1.0 / CELLS)) / PIECE_PX)
            .floor()
            .max(1.0);
        let length = (2.0 * half - cell) / n;
        pieces.extend((0..n as usize).filter_map(|i| {
            let from = -half + 0.5 * cell + length * i as f64;
            let ends = [at(from, 0.0)?, at(from + length, 0.0)?];
            let beside = [at(from + 0.5 * length, -cell)?, at(from + 0.5 * length, cell)?];
            Piece::between(ends, beside)
        }));
    }
    pieces
}

fn is_inside(pixel: DVec2, size_px: [u32; 2]) -> bool {
    let last = DVec2::new(f64::from(size_px[0]), f64::from(size_px[1])) - 1.0;
    pixel.cmpge(DVec2::ZERO).all() && pixel.cmple(last).all()
}

impl Piece {
    /// The piece with these ends, between a place one cell inside and one a cell outside; `None` if it is too small.
    fn between([start, end]: [DVec2; 2], [inside, outside]: [DVec2; 2]) -> Option<Self> {
        let along = (end - start).try_normalize()?;
        let middle_px = 0.5 * (start + end);
        let outward = if along.perp().dot(outside - middle_px) > 0.0 {
            along.perp()
        } else {
            -along.perp()
        };
        let room_px = (outside - middle_px)
            .dot(outward)
            .min((middle_px - inside).dot(outward));
        let piece = Self {
            middle_px,
            outward,
            half_length_px: 0.5 * start.distance(end),
            room_px,
        };
        (piece.reach_px(BLURS_PX[0]) >= MIN_REACH_PX).then_some(piece)
    }

    /// How far from the edge nothing but the edge is seen, if edges are blurred by `blur_px`.
    fn reach_px(&self, blur_px: f64) -> f64 {
        (self.room_px - BLUR_ENDS * blur_px).min(MAX_REACH_PX)
    }

    /// The blur that is found where nothing blurred by as much disturbs.
    fn blur(&self, samples: &[Sample]) -> Option<EdgeBlur> {
        BLURS_PX
            .iter()
            .map(|&blur_px| (blur_px, self.reach_px(blur_px)))
            .take_while(|&(_, reach_px)| reach_px >= MIN_REACH_PX)
            .find_map(|(blur_px, reach_px)| {
                let near: Vec<Sample> = samples
                    .iter()
                    .filter(|sample| sample.distance_px.abs() <= reach_px)
                    .copied()
                    .collect();
                let found = edge::fit(&near, self.outward, reach_px)?;
                (found.variance_px2 + 1.0 / 12.0 <= blur_px * blur_px).then_some(found)
            })
    }

    /// The pixels around it; `None` if some are overexposed.
    fn samples(&self, frame: &Frame, camera: &Camera) -> Option<Vec<Sample>> {
        let response = &camera.photometry.response;
        let clipped = response.first_clipped_code();
        let (table, width) = (response.table(), frame.size.width as usize);
        let size = DVec2::new(f64::from(frame.size.width), f64::from(frame.size.height));
        let reach_px = self.reach_px(BLURS_PX[0]);
        let half = DVec2::splat(self.half_length_px.hypot(reach_px));
        let low = (self.middle_px - half).ceil().max(DVec2::ZERO).as_uvec2();
        let high = (self.middle_px + half).floor().min(size - 1.0).as_uvec2();
        let mut samples = Vec::new();
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let from = DVec2::new(f64::from(x), f64::from(y)) - self.middle_px;
                let distance_px = from.dot(self.outward);
                if distance_px.abs() > reach_px || from.dot(self.outward.perp()).abs() > self.half_length_px {
                    continue;
                }
                let at = 3 * (y as usize * width + x as usize);
                let codes = frame.pixels.get(at..at + 3)?;
                if codes.iter().any(|&code| code >= clipped) {
                    return None;
                }
                // Green counts twice: sensors sample it twice as densely.
                let linear = |channel: usize| f64::from(table[usize::from(codes[channel])]);
                samples.push(Sample {
                    distance_px,
                    signal: 0.25 * (linear(0) + 2.0 * linear(1) + linear(2)),
                });
            }
        }
        Some(samples)
    }
}

/// The covariance whose variances across the edges are those measured, by least squares with Huber's weights.
fn covariance(blurs: &[(DVec2, EdgeBlur)]) -> Option<Estimate> {
    if blurs.len() < MIN_PIECES {
        return None;
    }
    let mut huber = vec![1.0; blurs.len()];
    let mut found = weighted_covariance(blurs, &huber)?;
    for _ in 0..4 {
        for (weight, (normal, blur)) in huber.iter_mut().zip(blurs) {
            let off = blur.variance_px2 - normal.dot(found.covariance_px2 * *normal);
            let in_sigmas = off.abs() / blur.sigma_px2.hypot(SCATTER_PX2);
            *weight = (1.345 / in_sigmas).min(1.0);
        }
        found = weighted_covariance(blurs, &huber)?;
    }
    let (eigenvalues, direction) = kernel::eigen(found.covariance_px2);
    Some(Estimate {
        covariance_px2: kernel::from_eigen(eigenvalues.map(|value| value.max(0.0)), direction),
        ..found
    })
}

fn weighted_covariance(blurs: &[(DVec2, EdgeBlur)], huber: &[f64]) -> Option<Estimate> {
    // Unknowns: xx, xy, yy.
    let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for ((normal, blur), factor) in blurs.iter().zip(huber) {
        let weight = factor / (blur.sigma_px2.powi(2) + SCATTER_PX2.powi(2));
        let row = DVec3::new(normal.x * normal.x, 2.0 * normal.x * normal.y, normal.y * normal.y);
        matrix += weight * DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        right += weight * blur.variance_px2 * row;
    }
    // (xx - yy)² + (2 xy)² is the same from every side: the squared difference of the eigenvalues.
    for row in [DVec3::new(1.0, 0.0, -1.0), DVec3::new(0.0, 2.0, 0.0)] {
        matrix += ROUNDNESS_PX2.powi(-2) * DMat3::from_cols(row * row.x, row * row.y, row * row.z);
    }
    let inverse = matrix.inverse();
    let solved = inverse * right;
    let sigma_px2 = (0.5 * (inverse.x_axis.x + inverse.z_axis.z)).sqrt();
    (solved.is_finite() && sigma_px2.is_finite()).then_some(Estimate {
        covariance_px2: DMat2::from_cols(DVec2::new(solved.x, solved.y), DVec2::new(solved.y, solved.z)),
        sigma_px2,
    })
}
