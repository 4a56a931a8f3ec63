//! Patches read from a picture, in linear light: response, vignetting, exposure and white balance taken out.

use glam::{DVec2, DVec3};
use mirrorball_capture::frame::Exposure;
use nalgebra::{SMatrix, SVector};

use super::patches::Patch;
use crate::{camera::Intrinsics, photometry::Photometry};

/// Share of a patch's side that is read: its edges are blurred and may be shadowed.
const READ_SHARE: f64 = 0.6;

/// Fewest pixels of a patch.
const MIN_PIXELS: usize = 9;

/// Share of the pixels that may be at an end of the scale.
const MAX_CLIPPED: f64 = 0.02;

/// Share of the pixels, at either end, that do not count: dust, glints.
const TRIMMED: f64 = 0.1;

/// A picture and everything known about it.
#[derive(Debug, Clone, Copy)]
pub struct PatchPicture<'a> {
    /// Red, green, blue of each pixel, row by row; of the size in `intrinsics`.
    pub codes: &'a [u8],
    /// Ray to pixel.
    pub intrinsics: &'a Intrinsics,
    /// Radiance to code.
    pub photometry: &'a Photometry,
    /// Exposure in force.
    pub exposure: &'a Exposure,
}

/// The light of one patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchLight {
    /// Radiance in the camera's own primaries.
    pub radiance: [f64; 3],
    /// Standard deviation of the mean.
    pub sigma: [f64; 3],
    /// Pixels read.
    pub pixels: usize,
}

/// Why a patch cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Unread {
    /// Not, or not wholly, in the picture.
    #[error("outside of the picture")]
    Outside,
    /// Too few pixels.
    #[error("too small")]
    Small,
    /// White in some channel.
    #[error("clipped")]
    Clipped,
    /// Black in some channel.
    #[error("black")]
    Black,
}

/// Where a point of a sheet is in the camera frame, up to scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SheetPlacing {
    /// Ray of sheet point (x, y): this times (x, y, 1).
    camera_from_sheet: glam::DMat3,
}

impl SheetPlacing {
    /// From the pose of the sheet's frame; the sheet is its plane z = 0.
    #[must_use]
    pub fn from_pose(camera_from_sheet: &crate::pose::Pose) -> Self {
        Self {
            camera_from_sheet: glam::DMat3::from_cols(
                camera_from_sheet.rotation.x_axis,
                camera_from_sheet.rotation.y_axis,
                camera_from_sheet.translation,
            ),
        }
    }

    /// From four points of the sheet and their pixels (direct linear transform on the rays, so that the lens counts); `None` when
    /// three of them are in line or the lens does not reach them.
    #[must_use]
    pub fn from_corners(corners_m: &[DVec2; 4], pixels: &[DVec2; 4], intrinsics: &Intrinsics) -> Option<Self> {
        // Unit: the sheet's size, so that the matrix is well scaled.
        let unit = corners_m.iter().map(|corner| corner.length()).fold(1e-9, f64::max);
        let mut rows = SMatrix::<f64, 8, 8>::zeros();
        let mut right = SVector::<f64, 8>::zeros();
        for (i, (corner, pixel)) in corners_m.iter().zip(pixels).enumerate() {
            let ray = intrinsics.unproject(*pixel)?;
            if ray.z < 1e-3 {
                return None;
            }
            let (u, v, p) = (ray.x / ray.z, ray.y / ray.z, *corner / unit);
            rows.fixed_view_mut::<1, 8>(2 * i, 0)
                .copy_from_slice(&[p.x, p.y, 1.0, 0.0, 0.0, 0.0, -u * p.x, -u * p.y]);
            rows.fixed_view_mut::<1, 8>(2 * i + 1, 0).copy_from_slice(&[
                0.0,
                0.0,
                0.0,
                p.x,
                p.y,
                1.0,
                -v * p.x,
                -v * p.y,
            ]);
            right[2 * i] = u;
            right[2 * i + 1] = v;
        }
        let h = rows.lu().solve(&right).filter(|h| h.amax() < 1e6)?;
        Some(Self {
            camera_from_sheet: glam::DMat3::from_cols(
                DVec3::new(h[0], h[3], h[6]) / unit,
                DVec3::new(h[1], h[4], h[7]) / unit,
                DVec3::new(h[2], h[5], 1.0),
            ),
        })
    }

    /// The pixel of a point of the sheet.
    #[must_use]
    pub fn pixel(&self, point_m: DVec2, intrinsics: &Intrinsics) -> Option<DVec2> {
        intrinsics
            .project(self.camera_from_sheet * point_m.extend(1.0))
            .filter(|pixel| intrinsics.contains(*pixel))
    }
}

/// Reads a patch.
///
/// # Errors
/// When it is not all in the picture, too small, clipped or black.
pub fn sample(picture: &PatchPicture<'_>, patch: &Patch, placing: &SheetPlacing) -> Result<PatchLight, Unread> {
    let [width, height] = picture.intrinsics.size_px;
    let half = 0.5 * READ_SHARE * patch.side_m;
    let mut quad = [DVec2::ZERO; 4];
    for (pixel, offset) in quad
        .iter_mut()
        .zip([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    {
        let point = patch.center_m + half * DVec2::from(offset);
        *pixel = placing.pixel(point, picture.intrinsics).ok_or(Unread::Outside)?;
    }
    let low = quad
        .iter()
        .fold(DVec2::MAX, |low, pixel| low.min(*pixel))
        .ceil()
        .max(DVec2::ZERO);
    let high = quad.iter().fold(DVec2::MIN, |high, pixel| high.max(*pixel)).floor();
    let mut values: [Vec<f64>; 3] = Default::default();
    let mut widths = [0.0; 3];
    let (mut n, mut clipped, mut black) = (0usize, [0usize; 3], [0usize; 3]);
    let response = &picture.photometry.response;
    let signal = picture.photometry.signal_per_radiance(picture.exposure);
    for y in low.y as u32..=(high.y as u32).min(height - 1) {
        for x in low.x as u32..=(high.x as u32).min(width - 1) {
            let pixel = DVec2::new(f64::from(x), f64::from(y));
            if !is_inside(&quad, pixel) {
                continue;
            }
            n += 1;
            let vignetting = picture.photometry.vignetting_at(pixel, [width, height]);
            let at = 3 * (y as usize * width as usize + x as usize);
            for channel in 0..3 {
                let code = picture.codes[at + channel];
                clipped[channel] += usize::from(code >= response.first_clipped_code());
                black[channel] += usize::from(code <= response.last_black_code());
                let per_signal = (vignetting * signal[channel]).recip();
                values[channel].push(response.linear_from_code(code) * per_signal);
                widths[channel] += response.code_width(code) * per_signal;
            }
        }
    }
    if n < MIN_PIXELS {
        return Err(Unread::Small);
    }
    let too_many = |counts: [usize; 3]| counts.iter().any(|&count| count as f64 > MAX_CLIPPED * n as f64);
    if too_many(clipped) {
        return Err(Unread::Clipped);
    }
    if too_many(black) {
        return Err(Unread::Black);
    }
    let moments = values.map(trimmed);
    Ok(PatchLight {
        radiance: moments.map(|moments| moments.mean),
        sigma: std::array::from_fn(|channel| moments[channel].sigma(widths[channel] / n as f64)),
        pixels: n,
    })
}

/// Whether a point is inside a convex quadrilateral, whichever way round it is given.
fn is_inside(quad: &[DVec2; 4], point: DVec2) -> bool {
    let sides = (0..4).map(|i| (quad[(i + 1) % 4] - quad[i]).perp_dot(point - quad[i]));
    let (mut left, mut right) = (true, true);
    for side in sides {
        left &= side >= 0.0;
        right &= side <= 0.0;
    }
    left || right
}

/// What the values of a patch's pixels have in common.
#[derive(Clone, Copy)]
struct Moments {
    mean: f64,
    /// Of one value.
    variance: f64,
    n: f64,
}

/// Mean and variance without the ends.
fn trimmed(mut values: Vec<f64>) -> Moments {
    values.sort_by(f64::total_cmp);
    let cut = (TRIMMED * values.len() as f64) as usize;
    let kept = &values[cut..values.len() - cut];
    let n = kept.len() as f64;
    let mean = kept.iter().sum::<f64>() / n;
    let variance = kept.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
    Moments { mean, variance, n }
}

impl Moments {
    /// Standard deviation of the mean, where a code is this wide. Rounding is averaged out only as far as noise moves the pixels
    /// across codes (Widrow and Kollár 2008, "Quantization Noise", ch. 4: the share that is left falls with exp(-2π²σ²)).
    fn sigma(&self, width: f64) -> f64 {
        let share = (-2.0 * std::f64::consts::PI.powi(2) * self.variance / (width * width)).exp();
        (self.variance / self.n).sqrt().hypot(share * width / 12f64.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;
    use crate::{
        camera::LensModel,
        color::patches::PatchSheet,
        pose::{Pose, Twist},
        response::ResponseCurve,
    };

    fn intrinsics() -> Intrinsics {
        Intrinsics {
            size_px: [320, 240],
            focal_px: DVec2::new(300.0, 301.0),
            principal_point_px: DVec2::new(158.0, 121.0),
            lens: LensModel::BrownConrady {
                k1: -0.05,
                k2: 0.01,
                p1: 0.001,
                p2: -0.001,
                k3: 0.0,
            },
        }
    }

    fn photometry() -> Photometry {
        Photometry {
            sensitivity: 40.0,
            vignetting: [-0.3, 0.05],
            full_well_e: 12_000.0,
            read_noise_e: 6.0,
            response: ResponseCurve::srgb(),
            color: DMat3::IDENTITY,
        }
    }

    const EXPOSURE: Exposure = Exposure {
        time_s: 0.01,
        gain: 2.0,
        white_balance: [1.3, 1.0, 1.6],
    };

    fn camera_from_sheet() -> Pose {
        // The sheet upright before the camera, tilted.
        let upright = Pose {
            rotation: DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
            translation: DVec3::new(-0.13, 0.1, 0.45),
        };
        upright
            * Pose::exp(Twist {
                rotation: DVec3::new(0.1, -0.15, 0.05),
                translation: DVec3::ZERO,
            })
    }

    #[test]
    fn patches_come_back_by_pose_and_by_corners() {
        let (intrinsics, photometry, sheet) = (intrinsics(), photometry(), PatchSheet::color_checker());
        let placing = SheetPlacing::from_pose(&camera_from_sheet());
        let light = |patch: &Patch| patch.reference.unwrap().map(|value| 0.8 * value.max(0.02));
        let sheet_from_camera = camera_from_sheet().inverse();
        let signal = photometry.signal_per_radiance(&EXPOSURE);
        let mut codes = Vec::new();
        for y in 0..240u32 {
            for x in 0..320u32 {
                let pixel = DVec2::new(f64::from(x), f64::from(y));
                let ray = sheet_from_camera.transform_vector(intrinsics.unproject(pixel).unwrap());
                let from = sheet_from_camera.translation;
                let point = (from - ray * (from.z / ray.z)).truncate();
                let patch = sheet
                    .patches
                    .iter()
                    .find(|patch| (patch.center_m - point).abs().max_element() < 0.5 * patch.side_m);
                let radiance = patch.map_or([0.02; 3], light);
                let vignetting = photometry.vignetting_at(pixel, intrinsics.size_px);
                codes.extend((0..3).map(|c| photometry.response.encode(radiance[c] * signal[c] * vignetting)));
            }
        }
        let picture = PatchPicture {
            codes: &codes,
            intrinsics: &intrinsics,
            photometry: &photometry,
            exposure: &EXPOSURE,
        };
        let corners = sheet.corners_m.unwrap();
        let pixels = corners.map(|corner| placing.pixel(corner, &intrinsics).unwrap());
        let by_hand = SheetPlacing::from_corners(&corners, &pixels, &intrinsics).unwrap();
        let mut clipped = Vec::new();
        for placing in [placing, by_hand] {
            for patch in &sheet.patches {
                match sample(&picture, patch, &placing) {
                    Ok(found) => {
                        for (found, expected) in found.radiance.into_iter().zip(light(patch)) {
                            // A code is about a hundredth of a dark patch's light.
                            assert!(
                                (found / expected - 1.0).abs() < 0.02,
                                "{} {found} {expected}",
                                patch.name
                            );
                        }
                    }
                    Err(Unread::Clipped) => clipped.push(patch.name.clone()),
                    Err(error) => panic!("{}: {error}", patch.name),
                }
            }
        }
        // 0.8 · 0.83 · 1.28 is above 1 but for vignetting; white is clipped or nearly so.
        assert!(clipped.iter().all(|name| name == "white"), "{clipped:?}");
        let in_line = [DVec2::ZERO, DVec2::X, 2.0 * DVec2::X, DVec2::Y];
        assert_eq!(SheetPlacing::from_corners(&in_line, &pixels, &intrinsics), None);
    }
}
