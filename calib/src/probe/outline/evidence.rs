//! How much each place along a line across the predicted outline looks like the edge of a mirror.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, Vec3};

use super::super::View;
use super::cone::Cone;

/// Distance of the profiles along the outline, pixels: neighbours share hardly a pixel.
const SPACING_PX: f64 = 1.5;
/// Most profiles.
const MAX_PROFILES: f64 = 192.0;
/// Distance of samples along a profile, pixels.
const STEP_PX: f64 = 0.25;
/// What a place is judged by, in strides: three inside it, six outside.
const WINDOW_STRIDES: [i32; 2] = [-3, 6];
/// Samples in that.
const WINDOW: usize = 10;
/// Free numbers of either model of a place's surroundings.
const TERMS: usize = 4;
/// Root mean square, relative to the profile's mean, that both models are allowed to be wrong by.
const TOLERANCE: f32 = 0.006;
/// Signal in which 8-bit codes are as far apart as [`TOLERANCE`] can bear, in parts of full scale; sRGB codes near it are 4 %
/// apart, so rounding is wrong by 1 % before samples are averaged.
const DARKEST: f32 = 0.01;
/// Cost below which a place is an edge at all: the mirror's edge explains two thirds of what a smooth curve leaves.
const EDGE: f32 = -1.0;

/// How far from the predicted outline edges are looked for, pixels, and what they look like.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    pub(super) radius_px: f64,
    pub(super) search_px: f64,
    /// Reflectance of the ball by channel.
    pub(super) reflectance: Vec3,
    /// Standard deviation of the picture's blur beyond a pixel's area, pixels.
    pub(super) blur_px: f64,
    /// How far outside a place its surroundings are judged, pixels; half as far inside.
    pub(super) window_px: f64,
}

impl Reach {
    fn look(&self) -> Look {
        Look {
            reflectance: self.reflectance,
            blur_px: self.blur_px,
            window_px: self.window_px,
        }
    }
}

/// What edges look like.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Look {
    reflectance: Vec3,
    blur_px: f64,
    window_px: f64,
}

/// One line across the outline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Profile {
    /// Where it meets the predicted outline: unit ray, camera frame.
    pub(super) ray: DVec3,
    /// Outwards there, in the basis of the predicted cone.
    pub(super) outwards: DVec2,
    /// Pixels per radian across the outline.
    pub(super) px_per_rad: f64,
    /// Lowest cost along it.
    least: f32,
}

/// All profiles of a picture with their costs, in memory that is used again.
#[derive(Debug, Default)]
pub(super) struct Profiles {
    profiles: Vec<Profile>,
    n_asked: usize,
    /// Costs of all profiles, one after the other.
    costs: Vec<f32>,
    /// Logarithms of what the edge of a mirror leaves unexplained, likewise.
    misfits: Vec<f32>,
    /// Places per profile.
    n_places: usize,
    samples: Vec<Vec3>,
    models: Option<Models>,
}

impl Profiles {
    /// Reads the profiles across a cone's outline.
    pub(super) fn read(&mut self, view: &View<'_>, cone: &Cone, reach: Reach) {
        if self.models.as_ref().is_none_or(|models| models.look != reach.look()) {
            self.models = Some(Models::new(reach.look()));
        }
        self.profiles.clear();
        self.costs.clear();
        self.misfits.clear();
        self.n_places = 2 * half_steps(reach.search_px) as usize + 1;
        self.n_asked = (TAU * reach.radius_px / SPACING_PX).min(MAX_PROFILES).ceil() as usize;
        for index in 0..self.n_asked {
            let outwards = DVec2::from_angle(TAU * index as f64 / self.n_asked as f64);
            if let Some(mut profile) = self.sample(view, cone, (outwards, reach.search_px)) {
                profile.least = self.judge(DARKEST / view.picture.signal_per_radiance());
                self.profiles.push(profile);
            }
        }
    }

    pub(super) fn len(&self) -> usize {
        self.profiles.len()
    }

    /// Profiles with an edge somewhere.
    pub(super) fn n_with_edge(&self) -> usize {
        self.profiles.iter().filter(|profile| profile.least < EDGE).count()
    }

    pub(super) fn share_in_picture(&self) -> f64 {
        self.profiles.len() as f64 / self.n_asked.max(1) as f64
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (&Profile, Costs<'_>)> {
        self.profiles
            .iter()
            .zip(self.costs.chunks_exact(self.n_places.max(1)))
            .zip(self.misfits.chunks_exact(self.n_places.max(1)))
            .map(|((profile, costs), misfits)| (profile, Costs { costs, misfits }))
    }

    /// Reads the radiance along one profile, as far as the search and the window go; `None` where it leaves the picture.
    fn sample(&mut self, view: &View<'_>, cone: &Cone, (outwards, search_px): (DVec2, f64)) -> Option<Profile> {
        /// Half the angle over which the lens's scale is measured, in half-angles of the cone.
        const NUDGE: f64 = 0.05;
        let intrinsics = &view.camera.intrinsics;
        let pixel_at = |stretch: f64| intrinsics.project(cone.ray(outwards, cone.half_angle * stretch));
        let (inside, on, outside) = (pixel_at(1.0 - NUDGE)?, pixel_at(1.0)?, pixel_at(1.0 + NUDGE)?);
        let across = outside - inside;
        let direction = across.try_normalize()?;
        let half = half_steps(search_px);
        let stride = self.models.as_ref().expect("made before profiles are read").stride;
        self.samples.clear();
        for step in WINDOW_STRIDES[0] * stride - half..=WINDOW_STRIDES[1] * stride + half {
            let sample = view.picture.sample(on + direction * (f64::from(step) * STEP_PX))?;
            self.samples.push(sample.radiance);
        }
        Some(Profile {
            ray: cone.ray(outwards, cone.half_angle),
            outwards,
            px_per_rad: across.length() / (2.0 * NUDGE * cone.half_angle),
            least: 0.0,
        })
    }

    /// Appends the costs of all places of the sampled profile: the logarithm of what the edge of a mirror leaves unexplained
    /// over what a smooth curve of as many terms leaves, at most 0. Returns the least. A mean radiance below `darkest` counts as
    /// that.
    fn judge(&mut self, darkest: Vec3) -> f32 {
        let models = self.models.as_ref().expect("made before profiles are read");
        let mean = self.samples.iter().sum::<Vec3>() / self.samples.len() as f32;
        // A channel that is almost black next to the others tells nothing but noise.
        let scale = mean.max(Vec3::splat(0.1 * mean.max_element())).max(darkest);
        let allowed = (3 * WINDOW) as f32 * TOLERANCE * TOLERANCE;
        let mut least = 0.0f32;
        for first in 0..self.n_places {
            let (mut edge, mut smooth) = (allowed, allowed);
            for channel in 0..3 {
                let values: [f32; WINDOW] =
                    std::array::from_fn(|i| self.samples[first + models.stride as usize * i][channel] / scale[channel]);
                let all: f32 = values.iter().map(|v| v * v).sum();
                edge += (all - explained(&models.edge[channel], &values)).max(0.0);
                smooth += (all - explained(&models.smooth, &values)).max(0.0);
            }
            let cost = (edge / smooth).ln().min(0.0);
            least = least.min(cost);
            self.costs.push(cost);
            self.misfits.push(edge.ln());
        }
        least
    }
}

/// The costs along a profile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Costs<'a> {
    costs: &'a [f32],
    misfits: &'a [f32],
}

impl Costs<'_> {
    /// Cost at a distance outside the predicted outline, pixels: a cubic through four places (Catmull and Rom 1974), 0 out
    /// of reach.
    pub(super) fn at(&self, offset_px: f64) -> f64 {
        let place = self.place(offset_px);
        let below = place.floor();
        if below < 1.0 || below + 2.0 >= self.costs.len() as f64 {
            return 0.0;
        }
        let [a, b, c, d] = std::array::from_fn(|i| f64::from(self.costs[below as usize - 1 + i]));
        let t = place - below;
        b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
    }

    /// Logarithm of what the edge of a mirror at this distance leaves unexplained; infinite out of reach.
    pub(super) fn misfit_at(&self, offset_px: f64) -> f64 {
        let place = self.place(offset_px).round();
        let misfit = (place >= 0.0).then(|| self.misfits.get(place as usize)).flatten();
        misfit.map_or(f64::INFINITY, |misfit| f64::from(*misfit))
    }

    fn place(&self, offset_px: f64) -> f64 {
        offset_px / STEP_PX + 0.5 * (self.costs.len() - 1) as f64
    }

    /// Whether the profile has an edge, and it is there: at least half of its best evidence.
    pub(super) fn agrees(&self, profile: &Profile, offset_px: f64) -> bool {
        profile.least < EDGE && self.at(offset_px) < 0.5 * f64::from(profile.least)
    }
}

fn half_steps(search_px: f64) -> i32 {
    (search_px / STEP_PX).ceil() as i32 + 3
}

/// Orthonormal functions of the place in the window.
type Basis = [[f32; WINDOW]; TERMS];

/// Sum of squares that a basis explains.
fn explained(basis: &Basis, values: &[f32; WINDOW]) -> f32 {
    basis
        .iter()
        .map(|term| term.iter().zip(values).map(|(a, b)| a * b).sum::<f32>().powi(2))
        .sum()
}

/// What the surroundings of a place can look like.
#[derive(Debug)]
struct Models {
    look: Look,
    /// Distance of samples, in steps.
    stride: i32,
    /// The mirror's edge, by channel.
    edge: [Basis; 3],
    /// No edge: a cubic.
    smooth: Basis,
}

impl Models {
    /// The edge of a mirror ball: a ray that grazes it goes straight on, so just inside its outline it shows, times its
    /// reflectance, what is seen just outside. From there the reflected ray turns by twice `sqrt(2 x / r)` at a depth of x
    /// pixels, so the radiance inside begins like a square root; outside it is linear.
    fn new(look: Look) -> Self {
        let Look {
            reflectance,
            blur_px,
            window_px,
        } = look;
        let stride = (window_px / (f64::from(WINDOW_STRIDES[1]) * STEP_PX)).round().max(1.0);
        let orthonormal = |blur_px: f64, terms: [&dyn Fn(f64) -> f64; TERMS]| orthonormal((stride, blur_px), terms);
        let edge = reflectance.to_array().map(|rho| {
            orthonormal(
                blur_px,
                [
                    &move |t| if t < 0.0 { f64::from(rho) } else { 1.0 },
                    &|t| t.max(0.0),
                    &|t| (-t).max(0.0).sqrt(),
                    &|t| (-t).max(0.0),
                ],
            )
        });
        Self {
            look,
            stride: stride as i32,
            edge,
            smooth: orthonormal(0.0, [&|_| 1.0, &|t| t, &|t| t * t, &|t| t * t * t]),
        }
    }
}

/// Functions of the distance outside the edge, in pixels, as the samples show them: averaged over a pixel's area and between
/// pixels (a quadratic B-spline), after a normal distribution of `blur_px`; made orthonormal (Gram and Schmidt).
fn orthonormal((stride, blur_px): (f64, f64), terms: [&dyn Fn(f64) -> f64; TERMS]) -> Basis {
    const PARTS: i32 = 60;
    /// Places of equal probability that stand for the normal distribution: their variance is 1.
    const BLUR: [f64; 8] = [-1.6701, -0.9516, -0.5260, -0.1691, 0.1691, 0.5260, 0.9516, 1.6701];
    let mut basis = [[0.0f64; WINDOW]; TERMS];
    for (row, term) in basis.iter_mut().zip(terms) {
        for (i, value) in row.iter_mut().enumerate() {
            let t = (f64::from(WINDOW_STRIDES[0]) + i as f64) * stride * STEP_PX;
            let (mut sum, mut weights) = (0.0, 0.0);
            for part in -PARTS..=PARTS {
                let u = 1.5 * f64::from(part) / f64::from(PARTS);
                let weight = if u.abs() < 0.5 {
                    0.75 - u * u
                } else {
                    0.5 * (1.5 - u.abs()).powi(2)
                };
                for place in BLUR {
                    sum += weight * term(t + u + blur_px * place);
                    weights += weight;
                }
            }
            *value = sum / weights;
        }
    }
    let dot = |a: &[f64; WINDOW], b: &[f64; WINDOW]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    for i in 0..TERMS {
        let (before, rest) = basis.split_at_mut(i);
        let row = &mut rest[0];
        for other in before.iter() {
            let along = dot(row, other);
            row.iter_mut().zip(other).for_each(|(a, b)| *a -= along * b);
        }
        let length = dot(row, row).sqrt();
        *row = row.map(|value| value / length);
    }
    basis.map(|row| row.map(|value| value as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_is_as_long_as_it_says() {
        assert_eq!(WINDOW, (WINDOW_STRIDES[1] - WINDOW_STRIDES[0]) as usize + 1);
    }

    #[test]
    fn the_models_are_orthonormal() {
        let models = Models::new(Look {
            reflectance: Vec3::new(0.5, 0.7, 0.9),
            blur_px: 0.5,
            window_px: 4.5,
        });
        for basis in models.edge.iter().chain([&models.smooth]) {
            for (i, a) in basis.iter().enumerate() {
                for (j, b) in basis.iter().enumerate() {
                    let dot: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                    assert!((dot - f32::from(u8::from(i == j))).abs() < 1e-5, "{i} {j}: {dot}");
                }
            }
        }
    }

    #[test]
    fn costs_are_smooth_between_places_and_nothing_out_of_reach() {
        let costs: Vec<f32> = (0..21).map(|i| (0.25 * (i as f32 - 10.0)).powi(2)).collect();
        let costs = Costs {
            costs: &costs,
            misfits: &costs,
        };
        // Catmull-Rom is exact for parabolas.
        for offset_px in [-1.9, -0.3, 0.0, 0.11, 1.77] {
            assert!((costs.at(offset_px) - offset_px * offset_px).abs() < 1e-6);
        }
        assert_eq!((costs.at(-2.6), costs.at(2.6)), (0.0, 0.0));
    }
}
