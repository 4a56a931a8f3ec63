//! Corners where four squares meet, to hundredths of a pixel.
//!
//! Where two edges cross, the picture looks the same turned by half a turn: no symmetric blur, no response curve and no
//! clipping moves the middle of that. A model of the picture is fitted to the pixels themselves: two blurred edges,
//! multiplied, after Mallon and Whelan (2007, "Which pattern? Biasing aspects of planar calibration patterns", section 4),
//! who show that such corners, unlike the centres of dots, are free of bias from perspective. What is odd under the half
//! turn would move the middle, and is therefore part of the model: shading, and edges bent by the lens.

use glam::DVec2;
use nalgebra::{SMatrix, SVector};

use crate::tag::LinearLuma;

/// Unknowns: middle (2), directions of both edges (2), their curvatures (2), logarithm of the blur, grey, contrast,
/// shading (2), plateau.
const UNKNOWNS: usize = 12;

/// Pixels that a fit needs.
const MIN_PIXELS: usize = 16;

/// Half the window along an edge at most, in pixels: beyond, pixels tell nothing more about the middle but take time.
const MAX_REACH_PX: f64 = 9.0;

/// Half the window along an edge at least, in pixels.
const MIN_REACH_PX: f64 = 1.4;

/// Share of the clear distance that is used even where the blur of the next edge already reaches in.
const MIN_SHARE: f64 = 0.6;

/// Blur of a sharp picture, in pixels: a pixel's own square (0.29) and a good lens.
const SHARP_PX: f64 = 0.55;

/// Noise of a pixel relative to the contrast, for weighing expectations against pixels.
const NOISE: f64 = 0.02;

/// Standard deviations of what is expected of the unknowns: curvatures are nearly 0 per pixel, the shading too (per pixel,
/// relative), directions are those of the grid, the blur's logarithm is that of a sharp picture, the middle between black
/// and white is where edges are.
const CURVATURE_SIGMA: f64 = 0.02;
const SHADING_SIGMA: f64 = 0.02;
const DIRECTION_SIGMA: f64 = 0.15;
const BLUR_SIGMA: f64 = 1.0;
const PLATEAU_SIGMA: f64 = 0.1;

/// Rounds: the window is placed anew around the middle found.
const ROUNDS: usize = 3;

/// Steps of a fit at most.
const STEPS: usize = 20;

/// Rms of the pixels that are not explained, relative to the contrast, above which it is no such corner.
const MAX_MISFIT: f64 = 0.3;

/// Least gap between the darker white and the lighter black quarter, relative to the difference of white and black.
const MIN_GAP: f64 = 0.4;

/// Least contrast, as a fraction of the signal's range.
const MIN_CONTRAST: f64 = 0.004;

/// Standard deviation besides noise and aliasing, in pixels: what is left of clean drawn pictures.
const LEAST_SIGMA_PX: f64 = 0.006;

/// Error of an edge's place along a row of pixels, in pixels, relative to the contrast that a blur leaves at the pixels' own
/// frequency. Fitted to drawn pictures, of known response and of another.
const ALIASING_PX: f64 = 0.4;

/// Where a corner is expected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Expected {
    /// Where, in pixels.
    pub(super) pixel: DVec2,
    /// From there along the board's x and y axes, as far as the two edges go either way, in pixels.
    pub(super) clear: [DVec2; 2],
    /// How far to either side of the edges there is nothing else, as a fraction of that.
    pub(super) band: f64,
}

/// A corner as found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Saddle {
    /// Where, in pixels.
    pub(super) pixel: DVec2,
    /// Standard deviation of either coordinate, in pixels.
    pub(super) sigma_px: f64,
    /// Half the difference of white and black, as a fraction of the signal's range; negative where the squares between
    /// the axes' positive halves and between their negative halves are the white ones.
    pub(super) contrast: f64,
    /// Blur: standard deviation of a Gaussian, in pixels.
    pub(super) edge_width_px: f64,
    /// Rms of what the model leaves of the pixels, relative to the contrast.
    pub(super) misfit: f64,
}

/// Finds the corner that is expected somewhere; it may be off by half the clear distance. `None` where the pixels do not
/// look like one.
pub(super) fn find(luma: &LinearLuma, expected: &Expected) -> Option<Saddle> {
    let mut start = *expected;
    let mut model = None;
    for round in 0..ROUNDS {
        let blur = model.map_or(SHARP_PX, |model: Model| model.blur());
        let window = Window::new(luma, &start, blur)?;
        let fit = window.fit(model.unwrap_or(Model::start(&window)))?;
        let moved = fit.model.middle - start.pixel;
        let limit = 0.5 * start.clear[0].length().min(start.clear[1].length());
        if fit.model.middle.distance(expected.pixel) > limit.max(1.0) {
            return None;
        }
        start.pixel = fit.model.middle;
        model = Some(fit.model);
        if round > 0 && (moved.length() < 0.2 || round + 1 == ROUNDS) {
            return fit.saddle(&window);
        }
    }
    None
}

/// Pixels around a corner, brightness scaled to 0 to 1.
struct Window {
    pixels: Vec<(DVec2, f64)>,
    expected: Expected,
    /// Length of either edge within it, in pixels.
    lengths_px: [f64; 2],
    scale: f64,
}

impl Window {
    fn new(luma: &LinearLuma, expected: &Expected, blur_px: f64) -> Option<Self> {
        let [x, y] = expected.clear;
        let area = x.perp_dot(y).abs();
        if !(area > 0.0 && expected.pixel.is_finite()) {
            return None;
        }
        // The window is a cross along both edges, clear of the blurred edges of whatever comes next.
        let margin = 0.5 + 1.5 * blur_px;
        let share = |part: f64, axis: DVec2, other: DVec2| {
            let distance = area / other.length();
            ((part * distance - margin) / distance)
                .max(MIN_SHARE * part)
                .min(MAX_REACH_PX / axis.length())
        };
        let half = DVec2::new(share(1.0, x, y), share(1.0, y, x));
        let band = DVec2::new(share(expected.band, x, y), share(expected.band, y, x));
        if (half.x * x.length()).min(half.y * y.length()) < MIN_REACH_PX {
            return None;
        }
        let [width, height] = luma.size();
        let reach = (x * half.x).abs() + (y * half.y).abs();
        let (low, high) = ((expected.pixel - reach).ceil(), (expected.pixel + reach).floor());
        if low.min_element() < 0.0 || high.x >= width as f64 || high.y >= height as f64 {
            return None;
        }
        let area = x.perp_dot(y);
        let mut pixels = Vec::new();
        let (mut least, mut most) = (u16::MAX, u16::MIN);
        for row in low.y as usize..=high.y as usize {
            for column in low.x as usize..=high.x as usize {
                let place = DVec2::new(column as f64, row as f64);
                let offset = place - expected.pixel;
                let along = DVec2::new(offset.perp_dot(y) / area, x.perp_dot(offset) / area).abs();
                if along.cmple(half).all() && along.cmple(band).any() {
                    let value = luma.linear()[row * width + column];
                    (least, most) = (least.min(value), most.max(value));
                    pixels.push((place, f64::from(value)));
                }
            }
        }
        let scale = f64::from(most.saturating_sub(least));
        if pixels.len() < MIN_PIXELS || scale < 2.0 * MIN_CONTRAST * f64::from(u16::MAX) {
            return None;
        }
        for (_, value) in &mut pixels {
            *value = (*value - f64::from(least)) / scale;
        }
        Some(Self {
            pixels,
            expected: *expected,
            lengths_px: [2.0 * half.x * x.length(), 2.0 * half.y * y.length()],
            scale,
        })
    }

    /// Variance of either coordinate, in square pixels, because pixels sample sharp edges too coarsely. How an edge lies
    /// among the pixels moves its apparent place to and fro once per pixel (the more, the less is known of the response);
    /// over an edge that crosses many rows or columns that averages out.
    fn aliasing(&self, model: &Model) -> f64 {
        // What a Gaussian leaves of one period per pixel.
        let left = (-2.0 * (std::f64::consts::PI * model.blur()).powi(2)).exp();
        let variance = |i: usize| {
            let crossed = self.lengths_px[i] * DVec2::from_angle(model.angles[i]).abs().min_element();
            (ALIASING_PX * left).powi(2) / (1.0 + (std::f64::consts::PI * crossed).powi(2))
        };
        0.5 * (variance(0) + variance(1))
    }

    /// Whether both white quarters around the middle are clearly brighter than both black ones: not so at the end of an
    /// edge, or at the corner of a lonely square, which a model bent enough can imitate.
    fn has_four_quarters(&self, model: &Model) -> bool {
        let directions = model.angles.map(DVec2::from_angle);
        let mut sums = [(0.0, 0.0); 4];
        for &(place, value) in &self.pixels {
            let distances = directions.map(|direction| direction.perp_dot(place - model.middle));
            if distances.iter().all(|distance| distance.abs() > 0.5 * model.blur()) {
                let quarter = usize::from(distances[0] > 0.0) + 2 * usize::from(distances[1] > 0.0);
                sums[quarter].0 += value;
                sums[quarter].1 += 1.0;
            }
        }
        let means = sums.map(|(sum, count)| sum / count);
        // Quarters 0 and 3 have distances of equal sign, so a positive product.
        let (same, other) = ([means[0], means[3]], [means[1], means[2]]);
        let (white, black) = if model.contrast > 0.0 {
            (same, other)
        } else {
            (other, same)
        };
        let gap = white[0].min(white[1]) - black[0].max(black[1]);
        let difference = 0.5 * (white[0] + white[1] - black[0] - black[1]);
        gap > MIN_GAP * difference
    }

    /// Levenberg-Marquardt.
    fn fit(&self, start: Model) -> Option<Fit> {
        let mut model = start;
        let mut equations = self.equations(&model);
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let mut normal = equations.normal;
            for i in 0..UNKNOWNS {
                normal[(i, i)] *= 1.0 + damping;
            }
            let step = -normal.cholesky()?.solve(&equations.gradient);
            let next = model.moved(&step);
            let next_equations = self.equations(&next);
            if next_equations.cost <= equations.cost {
                let small = DVec2::new(step[0], step[1]).length() < 1e-4;
                (model, equations) = (next, next_equations);
                damping = (damping * 0.1).max(1e-9);
                if small {
                    break;
                }
            } else {
                damping *= 10.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        Some(Fit { model, equations })
    }

    fn equations(&self, model: &Model) -> Equations {
        let mut equations = Equations {
            normal: SMatrix::zeros(),
            gradient: SVector::zeros(),
            cost: 0.0,
            unexplained: 0.0,
        };
        for &(place, value) in &self.pixels {
            let (modelled, derivatives) = model.value(place);
            let residual = modelled - value;
            equations.unexplained += residual * residual;
            equations.normal.ger(1.0, &derivatives, &derivatives, 1.0);
            equations.gradient += derivatives * residual;
        }
        equations.cost = equations.unexplained;
        let [x, y] = self.expected.clear;
        let turned = |angle: f64, axis: DVec2| DVec2::from_angle(angle).perp_dot(axis.normalize());
        let expectations = [
            (2, -turned(model.angles[0], x), DIRECTION_SIGMA),
            (3, -turned(model.angles[1], y), DIRECTION_SIGMA),
            (4, model.curvatures[0], CURVATURE_SIGMA),
            (5, model.curvatures[1], CURVATURE_SIGMA),
            (6, model.log_blur - SHARP_PX.ln(), BLUR_SIGMA),
            (9, model.shading.x, SHADING_SIGMA),
            (10, model.shading.y, SHADING_SIGMA),
            (11, model.plateau, PLATEAU_SIGMA),
        ];
        for (index, deviation, sigma) in expectations {
            let weight = (NOISE / sigma).powi(2);
            equations.normal[(index, index)] += weight;
            equations.gradient[index] += weight * deviation;
            equations.cost += weight * deviation * deviation;
        }
        equations
    }
}

/// A fit and the equations at its end.
struct Fit {
    model: Model,
    equations: Equations,
}

/// Normal equations of a fit.
struct Equations {
    normal: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    gradient: SVector<f64, UNKNOWNS>,
    cost: f64,
    /// Sum of the squared residuals of the pixels alone.
    unexplained: f64,
}

impl Fit {
    /// The corner, if it is one.
    fn saddle(&self, window: &Window) -> Option<Saddle> {
        let count = window.pixels.len() as f64;
        let model = &self.model;
        let misfit = (self.equations.unexplained / count).sqrt() / model.contrast.abs();
        let contrast = model.contrast * window.scale / f64::from(u16::MAX);
        let shortest = window.expected.clear[0].length().min(window.expected.clear[1].length());
        let angle = DVec2::from_angle(model.angles[0]).perp_dot(DVec2::from_angle(model.angles[1]));
        if misfit > MAX_MISFIT
            || contrast.abs() < MIN_CONTRAST
            || model.blur() > 0.5 * shortest.max(2.0 * SHARP_PX)
            || angle.abs() < 0.1
            || !window.has_four_quarters(model)
        {
            return None;
        }
        let variance = self.equations.unexplained / (count - UNKNOWNS as f64).max(4.0);
        let variance = variance.max((0.002 * model.contrast).powi(2));
        let covariance = self.equations.normal.cholesky()?.inverse() * variance;
        let noise = 0.5 * (covariance[(0, 0)] + covariance[(1, 1)]);
        let sigma = (noise + window.aliasing(model) + LEAST_SIGMA_PX.powi(2)).sqrt();
        Some(Saddle {
            pixel: model.middle,
            sigma_px: sigma,
            contrast,
            edge_width_px: model.blur(),
            misfit,
        })
    }
}

/// Brightness `(1 + shading · x) (grey + contrast p + plateau p²)` with `p = E₁ E₂`, E the blurred step from -1 to 1 across an
/// edge. The plateau is what a wrong response curve does to first order.
#[derive(Debug, Clone, Copy)]
struct Model {
    middle: DVec2,
    /// Directions of the edges, in radians.
    angles: [f64; 2],
    /// Curvatures of the edges, per pixel.
    curvatures: [f64; 2],
    log_blur: f64,
    grey: f64,
    contrast: f64,
    shading: DVec2,
    plateau: f64,
}

impl Model {
    fn start(window: &Window) -> Self {
        let [x, y] = window.expected.clear;
        let (mut grey, mut contrast) = (0.0, 0.0);
        for &(place, value) in &window.pixels {
            let offset = place - window.expected.pixel;
            grey += value;
            contrast += (value - 0.5) * (x.perp_dot(offset) * y.perp_dot(offset)).signum();
        }
        let count = window.pixels.len() as f64;
        Self {
            middle: window.expected.pixel,
            angles: [x.to_angle(), y.to_angle()],
            curvatures: [0.0; 2],
            log_blur: SHARP_PX.ln(),
            grey: grey / count,
            contrast: contrast / count,
            shading: DVec2::ZERO,
            plateau: 0.0,
        }
    }

    fn blur(&self) -> f64 {
        self.log_blur.exp()
    }

    fn moved(&self, step: &SVector<f64, UNKNOWNS>) -> Self {
        Self {
            middle: self.middle + DVec2::new(step[0], step[1]),
            angles: [self.angles[0] + step[2], self.angles[1] + step[3]],
            curvatures: [self.curvatures[0] + step[4], self.curvatures[1] + step[5]],
            log_blur: (self.log_blur + step[6]).clamp(-1.6, 3.0),
            grey: self.grey + step[7],
            contrast: self.contrast + step[8],
            shading: self.shading + DVec2::new(step[9], step[10]),
            plateau: self.plateau + step[11],
        }
    }

    /// Brightness at a pixel and its derivatives by the unknowns.
    fn value(&self, place: DVec2) -> (f64, SVector<f64, UNKNOWNS>) {
        let offset = place - self.middle;
        let blur = self.blur();
        let edges: [Edge; 2] =
            std::array::from_fn(|i| Edge::at(offset, DVec2::from_angle(self.angles[i]), self.curvatures[i], blur));
        let light = 1.0 + self.shading.dot(offset);
        let product = edges[0].step * edges[1].step;
        let pattern = self.grey + product * (self.contrast + product * self.plateau);
        let by_product = self.contrast + 2.0 * product * self.plateau;
        let mut derivatives = SVector::zeros();
        let mut by_middle = -self.shading * pattern;
        for (i, edge) in edges.iter().enumerate() {
            let by_distance = light * by_product * edge.slope * edges[1 - i].step;
            by_middle -= by_distance * edge.gradient;
            derivatives[2 + i] = by_distance * edge.by_angle;
            derivatives[4 + i] = by_distance * edge.by_curvature;
            derivatives[6] -= by_distance * edge.distance;
        }
        derivatives[0] = by_middle.x;
        derivatives[1] = by_middle.y;
        derivatives[7] = light;
        derivatives[8] = light * product;
        derivatives[9] = offset.x * pattern;
        derivatives[10] = offset.y * pattern;
        derivatives[11] = light * product * product;
        (light * pattern, derivatives)
    }
}

/// An edge as seen from a pixel.
struct Edge {
    /// Distance of the pixel from the edge, with a sign, in pixels.
    distance: f64,
    gradient: DVec2,
    by_angle: f64,
    by_curvature: f64,
    /// The blurred step, from -1 to 1.
    step: f64,
    /// Its derivative by the distance.
    slope: f64,
}

impl Edge {
    fn at(offset: DVec2, direction: DVec2, curvature: f64, blur: f64) -> Self {
        let (along, across) = (direction.dot(offset), direction.perp_dot(offset));
        let distance = across - 0.5 * curvature * along * along;
        let ratio = distance / (std::f64::consts::SQRT_2 * blur);
        Self {
            distance,
            gradient: direction.perp() - direction * (curvature * along),
            by_angle: -along - curvature * along * across,
            by_curvature: -0.5 * along * along,
            step: erf(ratio),
            slope: (2.0 / std::f64::consts::PI).sqrt() / blur * (-ratio * ratio).exp(),
        }
    }
}

/// The error function, to 1.5e-7 (Abramowitz and Stegun 1964, 7.1.26).
fn erf(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x.abs());
    let series =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    (1.0 - series * (-x * x).exp()).copysign(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::ResponseCurve;

    const SIDE: usize = 31;

    fn linear() -> ResponseCurve {
        let values: Vec<f64> = (0..256).map(|code| f64::from(code) / 255.0).collect();
        ResponseCurve::from_table(&values).unwrap()
    }

    /// A picture of numbers from 0 to 1.
    fn picture(light: impl Fn(DVec2) -> f64) -> LinearLuma {
        let places = (0..SIDE * SIDE).map(|i| DVec2::new((i % SIDE) as f64, (i / SIDE) as f64));
        let rgb: Vec<u8> = places
            .flat_map(|place| [(255.0 * light(place)).round() as u8; 3])
            .collect();
        let mut luma = LinearLuma::new();
        luma.set(&rgb, [SIDE, SIDE], &linear()).unwrap();
        luma
    }

    fn model() -> Model {
        Model {
            middle: DVec2::new(15.37, 14.81),
            angles: [0.3, -1.0],
            curvatures: [0.01, -0.006],
            log_blur: 0.8f64.ln(),
            grey: 0.45,
            contrast: 0.3,
            shading: DVec2::new(0.004, -0.006),
            plateau: 0.0,
        }
    }

    fn expected(model: &Model) -> Expected {
        Expected {
            pixel: model.middle + DVec2::new(0.9, -0.7),
            clear: model.angles.map(|angle| 9.0 * DVec2::from_angle(angle + 0.05)),
            band: 1.0,
        }
    }

    #[test]
    fn a_corner_is_found_where_it_is() {
        let model = model();
        let luma = picture(|place| model.value(place).0);
        let found = find(&luma, &expected(&model)).unwrap();
        // Rounding to 8 bits leaves this much.
        assert!(found.pixel.distance(model.middle) < 0.006, "{found:?}");
        assert!(
            (found.edge_width_px - 0.8).abs() < 0.02 && (found.contrast - 0.3).abs() < 0.01,
            "{found:?}"
        );
        assert!(found.sigma_px < 0.02, "{found:?}");
    }

    /// What a response curve that nobody knows does to a corner is the same in opposite directions.
    #[test]
    fn an_unknown_response_does_not_move_it() {
        let model = Model {
            shading: DVec2::ZERO,
            ..model()
        };
        for power in [0.45, 2.2] {
            let luma = picture(|place| model.value(place).0.max(0.0).powf(power));
            let found = find(&luma, &expected(&model)).unwrap();
            assert!(found.pixel.distance(model.middle) < 0.01, "{power}: {found:?}");
        }
    }

    #[test]
    fn what_is_no_corner_is_none() {
        let model = model();
        let expected = expected(&model);
        let line = |place: DVec2| erf(DVec2::from_angle(0.3).perp_dot(place - model.middle));
        let square = |place: DVec2| {
            let other = erf(DVec2::from_angle(-1.0).perp_dot(place - model.middle));
            0.25 * (1.0 + line(place)) * (1.0 + other)
        };
        assert_eq!(find(&picture(|_| 0.5), &expected), None);
        assert_eq!(find(&picture(|place| 0.5 + 0.3 * line(place)), &expected), None);
        assert_eq!(find(&picture(square), &expected), None);
        let beyond = Expected {
            pixel: DVec2::new(29.0, 15.0),
            ..expected
        };
        assert_eq!(find(&picture(|place| model.value(place).0), &beyond), None);
        let nowhere = Expected {
            pixel: DVec2::NAN,
            ..expected
        };
        assert_eq!(find(&picture(|place| model.value(place).0), &nowhere), None);
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let model = Model {
            plateau: 0.07,
            ..model()
        };
        let place = DVec2::new(16.1, 14.2);
        let (_, derivatives) = model.value(place);
        for index in 0..UNKNOWNS {
            let mut step = SVector::<f64, UNKNOWNS>::zeros();
            step[index] = 1e-5;
            let numeric = (model.moved(&step).value(place).0 - model.moved(&-step).value(place).0) / 2e-5;
            // The error function is good to 1.5e-7 only.
            assert!(
                (numeric - derivatives[index]).abs() < 2e-2 * (1.0 + numeric.abs()),
                "{index}: {numeric} {}",
                derivatives[index]
            );
        }
    }
}
