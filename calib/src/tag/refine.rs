//! Corners of a marker to a few hundredths of a pixel: lines through the edges of its black square.
//!
//! Along each edge the picture is sampled across the edge. The step between the white and the black level is placed so
//! that the area under the profile is right, which no symmetric blur can shift. The lines are fitted where they are
//! straight: on a plane of rays, with the lens undone.

use glam::DVec2;

use super::LightPicture;
use crate::{camera::Intrinsics, view::View};

/// Cells along the side of the black square of every family that there is.
const CELLS: f64 = 8.0;

/// Least reach with which white and black can be told apart, in pixels.
const MIN_REACH_PX: f64 = 1.0;

/// Half the width of a sharp edge in the picture: half a pixel's diagonal, in pixels.
const BLUR_PX: f64 = 0.75;

/// How far from the edge a profile reaches at most, in pixels: as far as a sharp edge is blurred when it is half that
/// far from where it was expected. Whatever lies further out, shading and noise, only disturbs: with 2.0 and 3.0 px
/// corners were worse by a fifth and two fifths (rms) on path-traced pictures of markers.
const MAX_REACH_PX: f64 = 2.0 * BLUR_PX;

/// Distance of samples across the edge, in pixels.
const STEP_PX: f64 = 0.25;

/// Least contrast of a profile that counts, relative to the edge's median.
const LEAST_CONTRAST: f64 = 0.3;

/// Largest distance of the edge from where it was expected, relative to the reach: beyond, the levels are not levels.
const LARGEST_OFFSET: f64 = 0.6;

/// Profiles per edge at most.
const MAX_PROFILES: usize = 160;

/// Profiles that an edge must have.
const MIN_PROFILES: usize = 4;

/// Times the edges are sampled and fitted; each time starts closer.
const ROUNDS: usize = 3;

/// Rounds of reweighting in a line fit.
const REWEIGHTINGS: usize = 5;

/// Refits the corners of a marker in a picture that is proportional to light.
///
/// Takes corners good to about a pixel, bottom-left, bottom-right, top-right, top-left, in pixels, and returns them in
/// that order. They come back as they were when an edge cannot be fitted: the marker is too small (cells below about
/// 1.7 pixels), an edge is covered, or a corner would move by more than a cell.
#[must_use]
pub fn refine_corners(luma: &impl LightPicture, intrinsics: &Intrinsics, corners_px: [DVec2; 4]) -> [DVec2; 4] {
    let mut refined = corners_px;
    for _ in 0..ROUNDS {
        let Some(next) = refit(luma, intrinsics, refined) else {
            return corners_px;
        };
        refined = next;
    }
    let cell = corners_px[0]
        .distance(corners_px[2])
        .min(corners_px[1].distance(corners_px[3]))
        / CELLS;
    let moved_far = corners_px
        .iter()
        .zip(refined)
        .any(|(before, after)| before.distance(after) > cell.max(1.0));
    if moved_far { corners_px } else { refined }
}

/// One round: lines through all four edges, then their intersections.
fn refit(luma: &impl LightPicture, intrinsics: &Intrinsics, corners_px: [DVec2; 4]) -> Option<[DVec2; 4]> {
    let mut rays = [glam::DVec3::ZERO; 4];
    for (ray, corner) in rays.iter_mut().zip(corners_px) {
        *ray = intrinsics.unproject(corner)?;
    }
    let view = View::along(&rays)?;
    let edges = Edges {
        luma,
        intrinsics,
        view,
        corners_px,
    };
    let mut lines = [Line {
        point: DVec2::ZERO,
        direction: DVec2::X,
    }; 4];
    for (side, line) in lines.iter_mut().enumerate() {
        *line = Line::fit(&edges.points(side)?)?;
    }
    let mut refined = corners_px;
    for (corner, pixel) in refined.iter_mut().enumerate() {
        let meeting = lines[(corner + 3) % 4].intersection(&lines[corner])?;
        *pixel = intrinsics.project(view.ray_from_plane(meeting))?;
    }
    Some(refined)
}

/// The four edges of a marker; side i runs from corner i to corner i + 1.
struct Edges<'a, P> {
    luma: &'a P,
    intrinsics: &'a Intrinsics,
    view: View,
    corners_px: [DVec2; 4],
}

impl<P: LightPicture> Edges<'_, P> {
    /// Points of an edge on the view's plane.
    fn points(&self, side: usize) -> Option<Vec<DVec2>> {
        let [start, end, after, before] = std::array::from_fn(|i| self.corners_px[(side + i) % 4]);
        let length = start.distance(end);
        let along = (end - start).try_normalize()?;
        let middle = 0.5 * (after + before);
        let outward = if along.perp().dot(middle - start) < 0.0 {
            along.perp()
        } else {
            -along.perp()
        };
        let depth = (after - start).dot(-outward).min((before - start).dot(-outward));
        let cell = depth / CELLS;
        let reach = (cell - BLUR_PX).max(0.6 * cell).min(MAX_REACH_PX);
        if reach < MIN_REACH_PX || !length.is_finite() {
            return None;
        }
        // Profiles stay clear of the neighbouring edges, which may lean in.
        let lean = |next: DVec2, inward: DVec2| (next.dot(inward) / next.perp_dot(inward).abs()).max(0.0);
        let lean = lean(after - end, -along).max(lean(before - start, along));
        let margin = (2.0 * BLUR_PX + reach * lean).min(0.25 * length);
        let count = ((length - 2.0 * margin) as usize).clamp(MIN_PROFILES * 2, MAX_PROFILES);
        let (first, last) = (self.plane(start)?, self.plane(end)?);
        let profiles: Vec<Profile> = (0..count)
            .filter_map(|i| {
                let t = (margin + (length - 2.0 * margin) * (i as f64 + 0.5) / count as f64) / length;
                let centre = self.intrinsics.project(self.view.ray_from_plane(first.lerp(last, t)))?;
                Profile::take(self.luma, centre, outward, reach)
            })
            .collect();
        let mut contrasts: Vec<f64> = profiles.iter().map(|profile| profile.contrast).collect();
        let least = LEAST_CONTRAST * median(&mut contrasts)?;
        let points: Vec<DVec2> = profiles
            .iter()
            .filter(|profile| profile.contrast > least.max(0.0) && profile.offset.abs() < LARGEST_OFFSET * reach)
            .filter_map(|profile| self.plane(profile.centre + outward * profile.offset))
            .collect();
        (points.len() >= MIN_PROFILES).then_some(points)
    }

    fn plane(&self, pixel: DVec2) -> Option<DVec2> {
        self.view.plane_from_ray(self.intrinsics.unproject(pixel)?)
    }
}

/// Grey values across an edge, boiled down.
struct Profile {
    centre: DVec2,
    /// White minus black level.
    contrast: f64,
    /// Where the edge is, in pixels outward from the centre.
    offset: f64,
}

impl Profile {
    /// White and black are those of this profile alone: shadows that fall across a marker change them from one to the
    /// next.
    fn take(luma: &impl LightPicture, centre: DVec2, outward: DVec2, reach: f64) -> Option<Self> {
        let half_steps = (reach / STEP_PX).floor().max(1.0);
        let step = reach / half_steps;
        let level_from = (2.0 * BLUR_PX).min(reach - STEP_PX);
        let (mut area, mut white, mut black, mut levels) = (0.0, 0.0, 0.0, 0.0);
        // Cells of width `step` from -reach to reach, sampled in their middle; the layout is symmetric.
        for i in 0..half_steps as usize {
            let distance = step * (i as f64 + 0.5);
            let outside = sample(luma, centre + outward * distance)?;
            let inside = sample(luma, centre - outward * distance)?;
            area += step * (outside + inside);
            if distance >= level_from {
                white += outside;
                black += inside;
                levels += 1.0;
            }
        }
        let (white, black) = (white / levels, black / levels);
        let contrast = white - black;
        // Black up to the edge, white beyond: area = black (reach + offset) + white (reach - offset).
        let offset = (reach * (white + black) - area) / contrast;
        offset.is_finite().then_some(Self {
            centre,
            contrast,
            offset,
        })
    }
}

/// Bilinear interpolation; `None` outside the picture.
fn sample(luma: &impl LightPicture, pixel: DVec2) -> Option<f64> {
    let [width, height] = luma.size();
    let corner = pixel.floor();
    if !(corner.x >= 0.0 && corner.y >= 0.0) {
        return None;
    }
    let (x, y) = (corner.x as usize, corner.y as usize);
    if x + 1 >= width || y + 1 >= height {
        return None;
    }
    let part = pixel - corner;
    let value = |x: usize, y: usize| f64::from(luma.light(x, y));
    let top = value(x, y) * (1.0 - part.x) + value(x + 1, y) * part.x;
    let bottom = value(x, y + 1) * (1.0 - part.x) + value(x + 1, y + 1) * part.x;
    Some(top * (1.0 - part.y) + bottom * part.y)
}

/// A straight line on the view's plane.
#[derive(Clone, Copy)]
struct Line {
    point: DVec2,
    direction: DVec2,
}

impl Line {
    /// Total least squares with Huber weights.
    fn fit(points: &[DVec2]) -> Option<Self> {
        let mut weights = vec![1.0; points.len()];
        let mut line = Self::fit_weighted(points, &weights)?;
        for _ in 0..REWEIGHTINGS {
            let mut distances: Vec<f64> = points.iter().map(|point| line.distance(*point)).collect();
            // 1.4826 makes the median of |x| a standard deviation, 1.345 is Huber's constant (Huber 1981).
            let limit = 1.345 * 1.4826 * median(&mut distances)?;
            for (weight, point) in weights.iter_mut().zip(points) {
                let distance = line.distance(*point);
                *weight = if distance <= limit { 1.0 } else { limit / distance };
            }
            line = Self::fit_weighted(points, &weights)?;
        }
        Some(line)
    }

    fn fit_weighted(points: &[DVec2], weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        let weighted = || points.iter().zip(weights);
        let point = weighted().map(|(point, weight)| *point * *weight).sum::<DVec2>() / total;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (other, weight) in weighted() {
            let d = *other - point;
            xx += weight * d.x * d.x;
            xy += weight * d.x * d.y;
            yy += weight * d.y * d.y;
        }
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let line = Self {
            point,
            direction: DVec2::from_angle(angle),
        };
        (line.point.is_finite() && line.direction.is_finite()).then_some(line)
    }

    fn distance(&self, point: DVec2) -> f64 {
        self.direction.perp_dot(point - self.point).abs()
    }

    /// `None` for lines less than 3 degrees apart.
    fn intersection(&self, other: &Self) -> Option<DVec2> {
        let sine = self.direction.perp_dot(other.direction);
        if sine.abs() < 0.05 {
            return None;
        }
        Some(self.point + self.direction * (other.direction.perp_dot(self.point - other.point) / sine))
    }
}

/// The median, the upper one of two; `None` of nothing. Reorders the values.
fn median(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
