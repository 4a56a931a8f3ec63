//! How much light the ball sends back: white paper seen directly, and in the ball.
//!
//! Every marker of the rig is a patch of diffuse paper whose place is known. A pixel of the ball that mirrors a place of that
//! paper shows the radiance that the same picture shows there directly, times the reflectance: exact reflection at finite
//! distances says which place ([`MirrorBall::reflect`](crate::probe::mirror_ball::MirrorBall::reflect)). As the ball shows
//! everything small, the direct radiance is spread first as the ball's picture spreads it, by pixels and by blur; which
//! blur, the pixels tell. The ratio of sums over the whole paper, black squares and white border, hardly knows the blur.
//!
//! The paper is taken to scatter alike in all directions, so that directions grazing it are left out, and so are flat
//! reflections in the ball, where Fresnel's law takes over.

use glam::{DVec2, DVec3, Vec3};

use super::BallView;
use crate::{
    pose::Pose,
    probe::{View, mirror_ball::MirrorBall},
    rig::Marker,
};

/// Flattest reflection in the ball, as the cosine between normal and view: where a metal's reflectance is still that of the
/// middle within a percent.
const MIN_VIEW_COSINE: f64 = 0.35;
/// Most grazing direction from the paper, as the cosine to its normal.
const MIN_PAPER_COSINE: f64 = 0.1;
/// Side of the paper over that of the black square: ten cells over eight.
const PAPER: f64 = 1.25;
/// How far around the paper radiance is asked for, in halves of its side: the blur's reach.
const AROUND: f64 = 1.6;
/// Samples per pixel and axis of the direct radiance.
const FINE: usize = 3;
/// Blurs of the ball's picture that are tried, pixels, the pixel's own area included.
const BLURS_PX: [f64; 5] = [0.35, 0.5, 0.7, 1.0, 1.4];
/// Fewest pixels of the ball that mirror the paper.
const MIN_PIXELS: usize = 10;
/// Least relative uncertainty of one paper in one picture: it is no perfect diffuser, and vignetting is not perfectly known.
const PAPER_SIGMA: f64 = 0.01;

/// The ball's reflectance from all papers in all pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reflectance {
    /// Linear reflectance of red, green and blue.
    pub value: DVec3,
    /// Their standard deviations.
    pub sigma: DVec3,
    /// Blur of the ball's picture that fits best, the median over papers, pixels, the pixel's own area included.
    pub blur_px: f64,
    /// Papers in pictures that count.
    pub n_patches: usize,
    /// Papers in pictures that do not agree with the others.
    pub n_rejected: usize,
}

/// Why there is no reflectance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "no marker's paper is seen both directly and in the ball (tried: `{n_tried}`; too small in the ball: `{too_small}`, \
     clipped: `{clipped}`)"
)]
pub struct NoPatch {
    /// Papers in pictures that were looked at.
    pub n_tried: usize,
    /// Those that fewer than 10 pixels of the ball show well.
    pub too_small: usize,
    /// Those that are too bright for the exposure.
    pub clipped: usize,
}

/// One paper in one picture.
#[derive(Debug, Clone, Copy)]
struct Patch {
    ratio: DVec3,
    sigma: DVec3,
    blur_px: f64,
}

enum Refused {
    TooSmall,
    Clipped,
}

/// Measures the reflectance of `ball` with the papers of `markers`.
///
/// # Errors
/// [`NoPatch`] when no paper can be used.
pub fn measure(views: &[BallView<'_>], ball: &MirrorBall, markers: &[Marker]) -> Result<Reflectance, NoPatch> {
    let mut none = NoPatch {
        n_tried: 0,
        too_small: 0,
        clipped: 0,
    };
    let mut patches = Vec::new();
    for view in views {
        for marker in markers {
            none.n_tried += 1;
            match patch(&view.view, ball, marker) {
                Ok(patch) => patches.push(patch),
                Err(Refused::TooSmall) => none.too_small += 1,
                Err(Refused::Clipped) => none.clipped += 1,
            }
        }
    }
    if patches.is_empty() {
        return Err(none);
    }
    Ok(combine(&patches))
}

/// The weighted mean of the papers that agree on green with their median.
fn combine(patches: &[Patch]) -> Reflectance {
    let middle = median(patches.iter().map(|patch| patch.ratio.y).collect());
    let spread = 1.4826 * median(patches.iter().map(|patch| (patch.ratio.y - middle).abs()).collect());
    let agrees = |patch: &&Patch| (patch.ratio.y - middle).abs() <= 3.0 * spread.max(patch.sigma.y);
    let used: Vec<&Patch> = patches.iter().filter(agrees).collect();
    let (mut weights, mut sum) = (DVec3::ZERO, DVec3::ZERO);
    for patch in &used {
        let weight = (patch.sigma * patch.sigma).recip();
        weights += weight;
        sum += weight * patch.ratio;
    }
    let value = sum / weights;
    let squares: DVec3 = used.iter().map(|p| ((p.ratio - value) / p.sigma).powf(2.0)).sum();
    let scale = (squares / (used.len() as f64 - 1.0).max(1.0)).max(DVec3::ONE);
    Reflectance {
        value,
        sigma: square_root(scale / weights),
        blur_px: median(used.iter().map(|patch| patch.blur_px).collect()),
        n_patches: used.len(),
        n_rejected: patches.len() - used.len(),
    }
}

/// The ratio of mirrored to direct radiance of one paper.
fn patch(view: &View<'_>, ball: &MirrorBall, marker: &Marker) -> Result<Patch, Refused> {
    let scene = Scene::new(view, ball, marker);
    let [low, high] = scene.bounds().ok_or(Refused::TooSmall)?;
    let margin = (3.0 * BLURS_PX[BLURS_PX.len() - 1]).ceil() as i64;
    let size = [0, 1].map(|axis| (high[axis] - low[axis] + 1 + 2 * margin) as usize * FINE);
    let origin = low.map(|edge| edge - margin);
    // Radiance that the ball would mirror at reflectance 1, on a fine grid.
    let mut direct: Vec<Option<Vec3>> = Vec::with_capacity(size[0] * size[1]);
    for index in 0..size[0] * size[1] {
        let place = DVec2::new((index % size[0]) as f64, (index / size[0]) as f64);
        let pixel = DVec2::new(origin[0] as f64, origin[1] as f64) + (place + 0.5) / FINE as f64 - 0.5;
        direct.push(scene.mirrored(pixel).and_then(|place| scene.direct(place)));
    }
    let mut pixels = Vec::new();
    let mut n_clipped = 0;
    for y in low[1]..=high[1] {
        for x in low[0]..=high[0] {
            let pixel = DVec2::new(x as f64, y as f64);
            if scene.mirrored(pixel).is_none_or(|place| !scene.is_paper(place)) {
                continue;
            }
            let Some(seen) = view.picture.sample(pixel) else {
                continue;
            };
            if seen.clipped != 0 {
                n_clipped += 1;
                continue;
            }
            let middle = [x - origin[0], y - origin[1]].map(|at| at as usize * FINE + FINE / 2);
            pixels.push((seen.radiance, middle));
        }
    }
    let fits = BLURS_PX.map(|blur_px| fit(&direct, size[0], &pixels, blur_px));
    let best = fits.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
    match best {
        Some((_, patch)) => Ok(patch),
        None if n_clipped > pixels.len() => Err(Refused::Clipped),
        None => Err(Refused::TooSmall),
    }
}

/// The ratio for one blur, and the mean squared error of green that it leaves.
fn fit(direct: &[Option<Vec3>], width: usize, pixels: &[(Vec3, [usize; 2])], blur_px: f64) -> Option<(f64, Patch)> {
    let spread: Vec<(DVec3, DVec3)> = pixels
        .iter()
        .filter_map(|(seen, middle)| Some((seen.as_dvec3(), spread(direct, width, *middle, blur_px)?)))
        .collect();
    if spread.len() < MIN_PIXELS {
        return None;
    }
    let ratio_of = |kept: &[(DVec3, DVec3)]| {
        let sums = kept.iter().fold((DVec3::ZERO, DVec3::ZERO), |sums, pair| {
            (sums.0 + pair.0, sums.1 + pair.1)
        });
        sums.0 / sums.1
    };
    let errors = |ratio: DVec3, pairs: &[(DVec3, DVec3)]| -> Vec<f64> {
        pairs
            .iter()
            .map(|(seen, direct)| (seen.y - ratio.y * direct.y).abs())
            .collect()
    };
    let first = ratio_of(&spread);
    // Something that stands between paper and ball is in some pixels only.
    let limit = 4.0 * 1.4826 * median(errors(first, &spread));
    let kept: Vec<(DVec3, DVec3)> = spread
        .into_iter()
        .filter(|(seen, direct)| (seen.y - first.y * direct.y).abs() <= limit)
        .collect();
    if kept.len() < MIN_PIXELS {
        return None;
    }
    let ratio = ratio_of(&kept);
    let n = kept.len() as f64;
    let squares = kept
        .iter()
        .map(|(seen, direct)| (*seen - ratio * *direct).powf(2.0))
        .sum::<DVec3>();
    let total: DVec3 = kept.iter().map(|(_, direct)| *direct).sum();
    // Neighbouring pixels err alike, as blur and place do: one of three counts.
    let noise = square_root(squares * 3.0) / total;
    let sigma = square_root(noise * noise + (ratio * PAPER_SIGMA) * (ratio * PAPER_SIGMA));
    Some((squares.y / n, Patch { ratio, sigma, blur_px }))
}

/// Direct radiance as a pixel of the ball's picture sees it; `None` where a part of it is not known.
fn spread(direct: &[Option<Vec3>], width: usize, [x, y]: [usize; 2], blur_px: f64) -> Option<DVec3> {
    let sigma = blur_px * FINE as f64;
    let reach = (2.5 * sigma).ceil() as i64;
    let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let weight = (-0.5 * (dx * dx + dy * dy) as f64 / (sigma * sigma)).exp();
            let index = (y as i64 + dy) * width as i64 + x as i64 + dx;
            let radiance = direct.get(usize::try_from(index).ok()?).copied()??;
            sum += weight * radiance.as_dvec3();
            weights += weight;
        }
    }
    Some(sum / weights)
}

/// Ball, camera and one paper.
struct Scene<'a> {
    view: &'a View<'a>,
    ball: &'a MirrorBall,
    camera_m: DVec3,
    world_from_camera: Pose,
    marker_from_world: Pose,
    world_from_marker: Pose,
    /// Half the paper's side, metres.
    half_m: f64,
}

impl<'a> Scene<'a> {
    fn new(view: &'a View<'a>, ball: &'a MirrorBall, marker: &Marker) -> Self {
        let world_from_camera = view.camera_from_world.inverse();
        Self {
            view,
            ball,
            camera_m: world_from_camera.translation,
            world_from_camera,
            marker_from_world: marker.world_from_marker.inverse(),
            world_from_marker: marker.world_from_marker,
            half_m: 0.5 * PAPER * marker.side_m,
        }
    }

    /// The pixels around the paper's picture in the ball: lowest and highest x and y.
    fn bounds(&self) -> Option<[[i64; 2]; 2]> {
        const ALONG: [f64; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];
        let mut bounds = [[i64::MAX; 2], [i64::MIN; 2]];
        for (x, y) in ALONG.into_iter().flat_map(|x| ALONG.map(|y| (x, y))) {
            let place = self
                .world_from_marker
                .transform_point(DVec3::new(x, y, 0.0) * self.half_m);
            let away = place - self.ball.center_m;
            let glint = self.ball.glint(self.camera_m, away.try_normalize()?, away.length())?;
            let in_camera = self.view.camera_from_world.transform_point(glint.point_m);
            let pixel = self.view.camera.intrinsics.project(in_camera)?;
            for (axis, at) in pixel.to_array().into_iter().enumerate() {
                bounds[0][axis] = bounds[0][axis].min(at.floor() as i64);
                bounds[1][axis] = bounds[1][axis].max(at.ceil() as i64);
            }
        }
        Some(bounds)
    }

    /// The place on the paper's plane (marker frame, metres), seen from its front, that a pixel of the ball mirrors, around the paper.
    fn mirrored(&self, pixel: DVec2) -> Option<DVec2> {
        let ray = self
            .world_from_camera
            .transform_vector(self.view.camera.intrinsics.unproject(pixel)?);
        let (out, point) = self.ball.reflect(self.camera_m, ray)?;
        let view_cosine = (point - self.ball.center_m).dot(-ray) / self.ball.radius_m;
        let from = self.marker_from_world.transform_point(point);
        let towards = self.marker_from_world.transform_vector(out);
        if view_cosine < MIN_VIEW_COSINE || from.z <= 0.0 || -towards.z < MIN_PAPER_COSINE {
            return None;
        }
        let place = (from + towards * (-from.z / towards.z)).truncate();
        (place.abs().max_element() <= AROUND * self.half_m).then_some(place)
    }

    fn is_paper(&self, place: DVec2) -> bool {
        place.abs().max_element() <= self.half_m
    }

    /// Radiance of a place of the paper's plane as the picture shows it directly; `None` where it is clipped, hidden by the
    /// ball, out of the picture or grazing.
    fn direct(&self, place: DVec2) -> Option<Vec3> {
        let at = self.world_from_marker.transform_point(place.extend(0.0));
        let to_camera = self.camera_m - at;
        let cosine = to_camera.normalize().dot(self.world_from_marker.rotation.z_axis);
        if cosine < MIN_PAPER_COSINE || self.ball.reflect(at, to_camera.normalize()).is_some() {
            return None;
        }
        let pixel = self
            .view
            .camera
            .intrinsics
            .project(self.view.camera_from_world.transform_point(at))?;
        self.view
            .picture
            .sample(pixel)
            .filter(|sample| sample.clipped == 0)
            .map(|sample| sample.radiance)
    }
}

fn square_root(v: DVec3) -> DVec3 {
    DVec3::new(v.x.sqrt(), v.y.sqrt(), v.z.sqrt())
}

/// The upper median of at least one value.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
