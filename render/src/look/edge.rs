//! How blurred one straight edge between black and white is.
//!
//! A pixel is the mean over its square of a step that was blurred by a Gaussian of variance v across the edge. The square
//! across the edge is a trapezium, the sum of two boxes of the widths |nx| and |ny| for the unit normal (nx, ny); the wider
//! one is integrated exactly, the narrower one with two Gauss points, which have its variance. So v is what the lens, the
//! shutter and the demosaicing add to a pixel.

use glam::{DMat4, DVec2, DVec4};

/// Least v, px²: below, the step is sharp to every pixel.
const LEAST_VARIANCE_PX2: f64 = 0.0025;
/// Steps of the fit at most.
const STEPS: usize = 20;
/// Largest distance of the edge from where it was expected, px.
const LARGEST_OFFSET_PX: f64 = 1.0;
/// Share of the contrast that the fit may miss, root mean square: beyond, this is no edge between two levels.
const LARGEST_MISFIT: f64 = 0.1;

/// White less black that an edge must have, a share of full scale.
const LEAST_CONTRAST: f64 = 0.02;
/// Standard deviations from an edge at which its levels count as seen.
const LEVELS_BEGIN: f64 = 1.5;
/// Pixels that a fit must rest on: three for each of its numbers.
const LEAST_SAMPLES: usize = 12;

/// A pixel near an edge.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Distance from where the edge is expected, positive on the white side, px.
    pub(super) distance_px: f64,
    /// Linear signal, 0 to 1.
    pub(super) signal: f64,
}

/// An edge's blur.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EdgeBlur {
    /// Variance across the edge beyond the pixel's own square, px².
    pub(super) variance_px2: f64,
    /// Standard deviation of that number, px².
    pub(super) sigma_px2: f64,
}

/// Fits black, white, place and blur of an edge with the unit normal `normal` to pixels that lie within `reach_px` of it.
///
/// `None` where there are too few pixels, no contrast, another edge, or so much blur that the pixels do not reach the levels.
pub(super) fn fit(samples: &[Sample], normal: DVec2, reach_px: f64) -> Option<EdgeBlur> {
    if samples.len() < LEAST_SAMPLES {
        return None;
    }
    let shape = PixelShape::across(normal);
    let mut at = start(samples, reach_px)?;
    let mut equations = normal_equations(samples, &shape, at);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let diagonal = DMat4::from_diagonal(DVec4::from_array([0, 1, 2, 3].map(|i| equations.matrix.col(i)[i])));
        let mut next = at + (equations.matrix + damping * diagonal).inverse() * equations.gradient;
        next.w = next.w.max(LEAST_VARIANCE_PX2);
        let after = normal_equations(samples, &shape, next);
        let gain = equations.cost - after.cost;
        if gain > 0.0 {
            (at, equations, damping) = (next, after, 0.1 * damping);
            if gain < 1e-4 * equations.cost {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    let noise = equations.cost / (samples.len() - 4) as f64;
    let sigma_px2 = (noise * equations.matrix.inverse().w_axis.w).sqrt();
    (is_edge(at, noise, reach_px) && sigma_px2.is_finite()).then_some(EdgeBlur {
        variance_px2: at.w,
        sigma_px2,
    })
}

/// Whether a fit that leaves the mean square `noise` shows one edge between two levels, both of which are seen.
fn is_edge(fitted: DVec4, noise: f64, reach_px: f64) -> bool {
    let [black, white, offset, variance] = fitted.to_array();
    let contrast = white - black;
    contrast > LEAST_CONTRAST
        && noise.sqrt() < LARGEST_MISFIT * contrast
        && offset.abs() < LARGEST_OFFSET_PX
        && LEVELS_BEGIN * (variance + 1.0 / 12.0).sqrt() + offset.abs() <= reach_px
}

/// Black, white, offset and variance to begin with.
fn start(samples: &[Sample], reach_px: f64) -> Option<DVec4> {
    let level = |side: f64| {
        let far = samples.iter().filter(|s| s.distance_px * side > 0.5 * reach_px);
        let (sum, n) = far.fold((0.0, 0.0), |(sum, n), s| (sum + s.signal, n + 1.0));
        (n > 0.0).then(|| sum / n)
    };
    let (black, white) = (level(-1.0)?, level(1.0)?);
    (white > black).then(|| DVec4::new(black, white, 0.0, 0.3))
}

/// Normal equations of the least squares in black, white, offset and variance.
struct Equations {
    matrix: DMat4,
    gradient: DVec4,
    cost: f64,
}

fn normal_equations(samples: &[Sample], shape: &PixelShape, at: DVec4) -> Equations {
    let [black, white, offset, variance] = at.to_array();
    let mut equations = Equations {
        matrix: DMat4::ZERO,
        gradient: DVec4::ZERO,
        cost: 0.0,
    };
    for sample in samples {
        let edge = shape.edge(sample.distance_px - offset, variance);
        let contrast = white - black;
        let residual = sample.signal - (black + contrast * edge.share);
        let slope = DVec4::new(
            1.0 - edge.share,
            edge.share,
            -contrast * edge.per_px,
            contrast * edge.per_variance,
        );
        equations.matrix += DMat4::from_cols(slope * slope.x, slope * slope.y, slope * slope.z, slope * slope.w);
        equations.gradient += slope * residual;
        equations.cost += residual * residual;
    }
    equations
}

/// The square of a pixel, as an edge's normal sees it.
struct PixelShape {
    /// Half the wider box.
    half_px: f64,
    /// Gauss points of the narrower one, either side of its middle.
    point_px: f64,
}

/// White's share of a pixel and how it changes.
struct EdgeShare {
    share: f64,
    per_px: f64,
    per_variance: f64,
}

impl PixelShape {
    fn across(normal: DVec2) -> Self {
        let widths = normal.abs();
        Self {
            half_px: 0.5 * widths.max_element(),
            point_px: 0.5 * widths.min_element() / 3f64.sqrt(),
        }
    }

    /// A pixel whose middle is `distance` on the white side of a step blurred with `variance`.
    fn edge(&self, distance: f64, variance: f64) -> EdgeShare {
        let sigma = variance.sqrt();
        let mut edge = EdgeShare {
            share: 0.0,
            per_px: 0.0,
            per_variance: 0.0,
        };
        // The integral of the normal distribution's Φ(x / σ) over x is x Φ + σ φ; its derivative by the variance φ / (2 σ).
        for point in [-self.point_px, self.point_px] {
            for side in [-1.0, 1.0] {
                let x = distance + point + side * self.half_px;
                let (phi, density) = normal(x / sigma);
                edge.share += side * (x * phi + sigma * density);
                edge.per_px += side * phi;
                edge.per_variance += side * 0.5 * density / sigma;
            }
        }
        let mean = 0.5 / (2.0 * self.half_px);
        edge.share *= mean;
        edge.per_px *= mean;
        edge.per_variance *= mean;
        edge
    }
}

/// The normal distribution and its density at `x`.
fn normal(x: f64) -> (f64, f64) {
    let density_of_erf = (-0.5 * x * x).exp();
    // Abramowitz and Stegun 1964, 7.1.26: to 1.5e-7.
    let t = 1.0 / (1.0 + 0.327_591_1 * x.abs() * std::f64::consts::FRAC_1_SQRT_2);
    let polynomial =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * polynomial * density_of_erf;
    let phi = if x < 0.0 { tail } else { 1.0 - tail };
    (phi, density_of_erf / std::f64::consts::TAU.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels within `reach` of a blurred step through (0.13, 0), by brute force: many points per pixel.
    fn samples(normal: DVec2, variance: f64, reach: f64) -> Vec<Sample> {
        let offset = 0.13;
        let (n, sigma) = (24, variance.sqrt());
        let mut samples = Vec::new();
        for y in -12..=12 {
            for x in -12..=12 {
                let middle = DVec2::new(f64::from(x), f64::from(y));
                let distance_px = middle.dot(normal);
                if distance_px.abs() > reach || middle.dot(normal.perp()).abs() > 6.0 {
                    continue;
                }
                let mut share = 0.0;
                for i in 0..n * n {
                    let at = (DVec2::new(f64::from(i % n), f64::from(i / n)) + 0.5) / f64::from(n) - 0.5;
                    let d = (middle + at).dot(normal) - offset;
                    share += if sigma > 0.0 {
                        super::normal(d / sigma).0
                    } else {
                        f64::from(u8::from(d > 0.0))
                    } / f64::from(n * n);
                }
                samples.push(Sample {
                    distance_px,
                    signal: 0.03 + 0.5 * share,
                });
            }
        }
        samples
    }

    #[test]
    fn the_blur_of_an_edge_comes_back() {
        for degrees in [0.0f64, 3.0, 20.0, 45.0, 71.0] {
            let normal = DVec2::from_angle(degrees.to_radians());
            for variance in [0.0, 0.1, 0.3, 1.0, 3.0] {
                let reach = 5.0;
                let found = fit(&samples(normal, variance, reach), normal, reach).expect("an edge");
                let off = found.variance_px2 - variance;
                assert!(
                    off.abs() < 0.02 + 0.03 * variance,
                    "{} instead of {variance} at {degrees}°",
                    found.variance_px2
                );
            }
        }
    }

    #[test]
    fn what_is_no_edge_has_no_blur() {
        let normal = DVec2::from_angle(0.2);
        let flat: Vec<Sample> = samples(normal, 0.3, 4.0)
            .into_iter()
            .map(|s| Sample { signal: 0.4, ..s })
            .collect();
        assert_eq!(fit(&flat, normal, 4.0), None);
        let turned: Vec<Sample> = samples(normal, 0.3, 4.0)
            .into_iter()
            .map(|s| Sample {
                distance_px: -s.distance_px,
                ..s
            })
            .collect();
        assert_eq!(fit(&turned, normal, 4.0), None);
        // A bar: black again two pixels beyond the edge.
        let bar: Vec<Sample> = samples(normal, 0.3, 4.0)
            .into_iter()
            .map(|s| Sample {
                signal: if s.distance_px > 2.0 { 0.03 } else { s.signal },
                ..s
            })
            .collect();
        assert_eq!(fit(&bar, normal, 4.0), None);
        // So much blur that neither level is seen.
        assert_eq!(fit(&samples(normal, 9.0, 3.0), normal, 3.0), None);
    }
}
