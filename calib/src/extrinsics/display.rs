//! An eye and the display in front of it (see-through), from points that a person brought to cover display pixels: SPAAM,
//! Tuceryan and Navab 2000, "Single point active alignment method".
//!
//! The person sees a cross at a known display pixel and moves the head until a known point, such as a marker's centre,
//! lies behind it. Eye and display are a pinhole camera: `pixel ~ K [R | t] point`, with the point in the frame of the
//! headset's camera. Display pixels: u right, v down, integers are centres of pixels. Eye frame: origin in the eye, z
//! through the display, x and y along u and v.
//!
//! Start: normalised direct linear transformation (Hartley and Zisserman 2004, algorithm 7.1); then the 11 numbers behind
//! it are refined on display pixels, and errors are told by leaving each alignment out in turn.

mod linear;
mod refine;

use glam::{DVec2, DVec3};
use nalgebra::{Matrix3, Matrix6};

use super::PoseSigma;
use crate::{least_squares::arrow::SolveError, pose::Pose};

/// Alignments needed: six determine the answer, the rest tell how good it is.
pub const MIN_ALIGNMENTS: usize = 8;

/// Extent of the points along their thinnest direction relative to the widest, below which they count as in one plane.
pub const MIN_THICKNESS: f64 = 0.03;

/// Farthest distance over the nearest, from the headset's camera, below which depths are too alike.
pub const MIN_DEPTH_RATIO: f64 = 1.3;

/// Spread of the crosses, in pixels, along their narrower direction below which they lie on a line.
const MIN_PIXEL_SPREAD_PX: f64 = 1.0;

/// A point brought to cover a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alignment {
    /// Number of the prompt.
    pub number: u32,
    /// The display pixel.
    pub pixel: DVec2,
    /// The point in the frame of the headset (of its camera, mostly), in metres.
    pub point: DVec3,
}

/// Pinhole numbers of the display as the eye sees it, in display pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisplayIntrinsics {
    /// Focal lengths.
    pub focal_px: DVec2,
    /// How far u moves with y over z.
    pub skew_px: f64,
    /// Where the line of sight perpendicular to the display meets it.
    pub principal_point_px: DVec2,
}

/// Eye and display.
#[derive(Debug, Clone)]
pub struct EyeDisplay {
    /// The display as the eye sees it.
    pub intrinsics: DisplayIntrinsics,
    /// Where the eye is.
    pub eye_from_headset: Pose,
    /// `K [R | t]`, rows of four; the third component of its product with a point is the point's depth in metres.
    pub projection: [[f64; 4]; 3],
    /// Covariance of the twist ξ in `exp(ξ) * eye_from_headset`, rotation first, in rad² and m².
    pub covariance: Matrix6<f64>,
    /// Standard deviations of focal lengths, skew and principal point, in pixels.
    pub intrinsics_sigma_px: [f64; 5],
    /// Root mean square distance between pixels and projected points, in pixels.
    pub rms_px: f64,
    /// Standard deviation of an alignment along u and along v, in pixels.
    pub alignment_sigma_px: f64,
    /// Each alignment.
    pub residuals: Vec<AlignmentResidual>,
}

/// How well an alignment fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignmentResidual {
    /// Number of the prompt.
    pub number: u32,
    /// The display pixel.
    pub pixel: DVec2,
    /// Where the solution shows the point, minus the pixel.
    pub residual_px: DVec2,
    /// The same for the solution from all others; infinite where there is none. Large where somebody blinked.
    pub left_out_px: f64,
}

/// Why there is no solution.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DisplayError {
    /// Too few alignments.
    #[error("there are `{found}` alignments (needed: `{MIN_ALIGNMENTS}`)")]
    TooFew {
        /// Alignments there are.
        found: usize,
    },
    /// A number is not finite.
    #[error("alignment `{number}` holds a number that is not finite")]
    NotFinite {
        /// Its number.
        number: u32,
    },
    /// Points in one plane.
    #[error("all points lie in one plane: their extents are as 1 to `{thickness:.3}` (needed: `{MIN_THICKNESS}`)")]
    Plane {
        /// Thinnest over widest extent.
        thickness: f64,
    },
    /// Points at one distance.
    #[error(
        "all points are about equally far: the farthest `{ratio:.2}` times as far as the nearest (needed: `{MIN_DEPTH_RATIO}`)"
    )]
    Depth {
        /// Farthest over nearest distance.
        ratio: f64,
    },
    /// Pixels in one place.
    #[error("all crosses lie on one line or in one place of the display")]
    Pixels,
    /// Points and pixels contradict each other.
    #[error("no eye and display could have made these alignments: points would lie behind the eye")]
    Behind,
    /// The refinement failed.
    #[error("the refinement failed")]
    Solve(#[from] SolveError),
}

/// Finds eye and display.
///
/// # Errors
/// When alignments are too few, do not determine the answer, or contradict each other.
pub fn solve(alignments: &[Alignment]) -> Result<EyeDisplay, DisplayError> {
    check(alignments)?;
    let start = linear::solve(alignments).ok_or(DisplayError::Behind)?;
    let fit = refine::refine(alignments, start)?;
    let errors = refine::errors(&fit.state, alignments).ok_or(DisplayError::Behind)?;
    let squares: f64 = errors.iter().map(|error| error.length_squared()).sum();
    let n = alignments.len() as f64;
    let variance = squares / (2.0 * n - refine::UNKNOWNS as f64);
    let covariance = fit.covariance * variance;
    let residual = |(index, alignment): (usize, &Alignment)| AlignmentResidual {
        number: alignment.number,
        pixel: alignment.pixel,
        residual_px: errors[index],
        left_out_px: left_out_px(alignments, index, &fit.state),
    };
    Ok(EyeDisplay {
        intrinsics: fit.state.intrinsics,
        eye_from_headset: fit.state.eye_from_headset,
        projection: projection(&fit.state.intrinsics, &fit.state.eye_from_headset),
        covariance: covariance.fixed_view::<6, 6>(5, 5).into_owned(),
        intrinsics_sigma_px: std::array::from_fn(|i| covariance[(i, i)].sqrt()),
        rms_px: (squares / n).sqrt(),
        alignment_sigma_px: variance.sqrt(),
        residuals: alignments.iter().enumerate().map(residual).collect(),
    })
}

/// Error at an alignment of the solution from all others.
fn left_out_px(alignments: &[Alignment], index: usize, start: &refine::State) -> f64 {
    let mut others = alignments.to_vec();
    let alignment = others.remove(index);
    let error = || {
        let fit = refine::refine(&others, *start).ok()?;
        Some(refine::errors(&fit.state, &[alignment])?[0].length())
    };
    error().unwrap_or(f64::INFINITY)
}

/// `K [R | t]`.
fn projection(intrinsics: &DisplayIntrinsics, eye_from_headset: &Pose) -> [[f64; 4]; 3] {
    let [x, y, z, _] = eye_from_headset.to_rows4();
    let (focal, centre) = (intrinsics.focal_px, intrinsics.principal_point_px);
    [
        std::array::from_fn(|i| focal.x * x[i] + intrinsics.skew_px * y[i] + centre.x * z[i]),
        std::array::from_fn(|i| focal.y * y[i] + centre.y * z[i]),
        z,
    ]
}

/// Refuses what cannot have an answer.
fn check(alignments: &[Alignment]) -> Result<(), DisplayError> {
    if alignments.len() < MIN_ALIGNMENTS {
        return Err(DisplayError::TooFew {
            found: alignments.len(),
        });
    }
    if let Some(bad) = alignments
        .iter()
        .find(|a| !(a.pixel.is_finite() && a.point.is_finite()))
    {
        return Err(DisplayError::NotFinite { number: bad.number });
    }
    let pixels = extents(alignments.iter().map(|alignment| alignment.pixel.extend(0.0)));
    if pixels[1] < MIN_PIXEL_SPREAD_PX {
        return Err(DisplayError::Pixels);
    }
    let points = extents(alignments.iter().map(|alignment| alignment.point));
    let thickness = points[2] / points[0].max(f64::MIN_POSITIVE);
    if thickness < MIN_THICKNESS {
        return Err(DisplayError::Plane { thickness });
    }
    let distances = || alignments.iter().map(|alignment| alignment.point.length());
    let ratio = distances().fold(0.0, f64::max) / distances().fold(f64::INFINITY, f64::min);
    if ratio < MIN_DEPTH_RATIO {
        return Err(DisplayError::Depth { ratio });
    }
    Ok(())
}

/// Standard deviations of points along their principal directions, largest first.
fn extents(points: impl Iterator<Item = DVec3> + Clone) -> [f64; 3] {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<DVec3>() / n;
    let mut scatter = Matrix3::zeros();
    for point in points {
        let off = nalgebra::Vector3::from((point - mean).to_array());
        scatter += off * off.transpose() / n;
    }
    let mut extents: [f64; 3] = scatter.symmetric_eigenvalues().map(|x| x.max(0.0).sqrt()).into();
    extents.sort_by(|a, b| b.total_cmp(a));
    extents
}

impl EyeDisplay {
    /// How sure the eye's pose is.
    #[must_use]
    pub fn sigma(&self) -> PoseSigma {
        PoseSigma::of(&self.covariance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extrinsics::simulation::{Noise, pose, squared_deviations};

    const TRUTH: DisplayIntrinsics = DisplayIntrinsics {
        focal_px: DVec2::new(2100.0, 2080.0),
        skew_px: 3.0,
        principal_point_px: DVec2::new(650.0, 340.0),
    };

    fn eye() -> Pose {
        pose([0.05, -0.03, 0.02], [0.035, 0.04, 0.02])
    }

    /// Crosses all over a display of 1280×720, with the point at these depths in turn.
    fn aligned(n: usize, depths_m: &[f64], noise: &mut Noise, sigma_px: f64) -> Vec<Alignment> {
        let headset_from_eye = eye().inverse();
        let alignment = |i: usize| {
            let pixel = DVec2::new(noise.between(80.0, 1200.0), noise.between(60.0, 660.0));
            let seen = pixel + noise.vector(sigma_px).truncate();
            let depth = depths_m[i % depths_m.len()];
            let y = (seen.y - TRUTH.principal_point_px.y) / TRUTH.focal_px.y;
            let x = (seen.x - TRUTH.principal_point_px.x - TRUTH.skew_px * y) / TRUTH.focal_px.x;
            Alignment {
                number: i as u32,
                pixel,
                point: headset_from_eye.transform_point(DVec3::new(x, y, 1.0) * depth),
            }
        };
        (0..n).map(alignment).collect()
    }

    const DEPTHS_M: [f64; 3] = [0.4, 0.8, 1.6];

    #[test]
    fn exact_alignments_give_the_exact_eye() {
        let found = solve(&aligned(12, &DEPTHS_M, &mut Noise(1), 0.0)).unwrap();
        assert!(
            (found.intrinsics.focal_px - TRUTH.focal_px).length() < 1e-4,
            "{found:?}"
        );
        assert!((found.intrinsics.skew_px - TRUTH.skew_px).abs() < 1e-4);
        assert!((found.intrinsics.principal_point_px - TRUTH.principal_point_px).length() < 1e-4);
        let off = found.eye_from_headset * eye().inverse();
        assert!(
            off.translation.length() < 1e-7 && off.angle_to(&Pose::identity()) < 1e-7,
            "{off:?}"
        );
        assert!(found.rms_px < 1e-6);
    }

    #[test]
    fn the_projection_is_its_parts() {
        let all = aligned(12, &DEPTHS_M, &mut Noise(2), 1.0);
        let found = solve(&all).unwrap();
        for (alignment, residual) in all.iter().zip(&found.residuals) {
            let p = alignment.point.extend(1.0);
            let [u, v, w] = found.projection.map(|row| p.dot(glam::DVec4::from_array(row)));
            let off = DVec2::new(u, v) / w - alignment.pixel;
            assert!((off - residual.residual_px).length() < 1e-8);
            assert!((w - found.eye_from_headset.transform_point(alignment.point).z).abs() < 1e-12);
        }
    }

    #[test]
    fn sigma_is_what_errors_are() {
        let (mut place, mut focal) = (0.0, 0.0);
        let n = 60;
        for seed in 0..n {
            // People align to a few pixels.
            let found = solve(&aligned(25, &DEPTHS_M, &mut Noise(seed), 2.0)).unwrap();
            let off = (found.eye_from_headset * eye().inverse()).log();
            place += squared_deviations(off, &found.covariance) / 6.0;
            focal += ((found.intrinsics.focal_px.x - TRUTH.focal_px.x) / found.intrinsics_sigma_px[0]).powi(2);
        }
        for sum in [place, focal] {
            let ratio = f64::sqrt(sum / f64::from(n as u32));
            assert!((1.0 / 1.5..1.5).contains(&ratio), "{ratio}");
        }
    }

    #[test]
    fn a_slip_shows_when_left_out() {
        let mut all = aligned(30, &DEPTHS_M, &mut Noise(5), 1.0);
        all[6].pixel.x += 60.0;
        let found = solve(&all).unwrap();
        let worst = found
            .residuals
            .iter()
            .max_by(|a, b| a.left_out_px.total_cmp(&b.left_out_px));
        assert_eq!(worst.unwrap().number, 6);
        assert!(worst.unwrap().left_out_px > 40.0);
    }

    #[test]
    fn what_leaves_the_eye_open_is_refused() {
        let mut noise = Noise(3);
        let error = solve(&aligned(7, &DEPTHS_M, &mut noise, 0.0)).unwrap_err();
        assert_eq!(error, DisplayError::TooFew { found: 7 });
        let error = solve(&aligned(20, &[0.8], &mut noise, 0.0)).unwrap_err();
        assert!(matches!(error, DisplayError::Plane { .. }), "{error}");
        let error = solve(&aligned(20, &[0.75, 0.85], &mut noise, 0.0)).unwrap_err();
        assert!(matches!(error, DisplayError::Depth { .. }), "{error}");
        let mut line = aligned(20, &DEPTHS_M, &mut noise, 0.0);
        for alignment in &mut line {
            alignment.pixel.y = 100.0;
        }
        assert_eq!(solve(&line).unwrap_err(), DisplayError::Pixels);
        line[4].point.z = f64::NAN;
        assert_eq!(solve(&line).unwrap_err(), DisplayError::NotFinite { number: 4 });
    }
}
