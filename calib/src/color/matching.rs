//! The 3×3 matrix between two cameras, and how good it is.
//!
//! Two cameras whose sensitivities are not each other's mixtures have no exact matrix; the best one is found by least squares of
//! *relative* errors, so that dark patches count as they look, robustly, and pulled towards one gain per channel as far as the patches
//! leave it open (a grey card alone gives gains only).

use glam::DMat3;
use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

use super::difference::{WHITE_D65, ciede2000, lab_from_xyz, xyz_from_linear_rgb};
use crate::least_squares::loss::Loss;

/// Relative error of a patch that no averaging removes: uneven light, gloss.
const MODEL_ERROR: f64 = 0.01;

/// The same as a share of the brightest patch: stray light.
const STRAY_ERROR: f64 = 0.001;

/// Standard deviation of the matrix about one gain per channel, relative to it, before anything is seen.
const PRIOR_DEVIATION: f64 = 0.3;

/// Weight of a patch that is to be met exactly.
const FIXED: f64 = 1e6;

const ROUNDS: usize = 15;

/// A patch as both cameras see it, in linear light.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedPatch {
    /// Name.
    pub name: String,
    /// As the first camera, the common one, sees it.
    pub first: [f64; 3],
    /// As the second camera sees it.
    pub second: [f64; 3],
    /// Standard deviations of both, added up, in the first one's unit.
    pub sigma: [f64; 3],
    /// Linear Rec. 709 colour, if known.
    pub reference: Option<[f64; 3]>,
}

/// The match.
#[derive(Debug, Clone, PartialEq)]
pub struct ColorMatch {
    /// First camera's linear RGB from the second's; holds the gain.
    pub first_from_second: DMat3,
    /// The gain in it: luminance of what white (1, 1, 1) becomes.
    pub gain: f64,
    /// Per patch.
    pub patches: Vec<PatchMatch>,
    /// With one gain per channel only.
    pub before: Residuals,
    /// With the matrix.
    pub after: Residuals,
}

/// A patch after matching.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchMatch {
    /// Name.
    pub name: String,
    /// As the first camera sees it.
    pub first: [f64; 3],
    /// The second camera's, with one gain for all channels.
    pub before: [f64; 3],
    /// The second camera's, with the matrix.
    pub after: [f64; 3],
    /// Length of the difference over that of the first camera's colour, after.
    pub relative_error: f64,
    /// CIEDE2000 with one gain, and with the matrix.
    pub delta_e: [f64; 2],
    /// CIEDE2000 to the reference after its best gain: the first camera's, and the second's with the matrix.
    pub delta_e_reference: Option<[f64; 2]>,
}

/// What is left over all patches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residuals {
    /// Mean relative error.
    pub relative_mean: f64,
    /// Largest relative error.
    pub relative_worst: f64,
    /// Mean CIEDE2000.
    pub delta_e_mean: f64,
    /// Largest CIEDE2000.
    pub delta_e_worst: f64,
}

/// Why cameras cannot be matched.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MatchError {
    /// Nothing in common.
    #[error("the cameras have no patch in common that both expose well (allowed: 1 or more)")]
    None,
    /// The white patch is not among those in common.
    #[error("patch `{name}`, whose colour is to be kept, is not among those that both cameras expose well")]
    NoWhite {
        /// Its name.
        name: String,
    },
}

/// Matches the second camera to the first. `keep` names a patch that is to be met exactly, white say.
///
/// Differences are seen beside the brightest patch as white; the first camera's RGB counts as linear Rec. 709.
///
/// # Errors
/// When there is no patch, or not the one named.
pub fn match_cameras(patches: &[SharedPatch], keep: Option<&str>) -> Result<ColorMatch, MatchError> {
    if patches.is_empty() {
        return Err(MatchError::None);
    }
    let kept = match keep {
        Some(name) => Some(
            patches
                .iter()
                .position(|patch| patch.name == name)
                .ok_or_else(|| MatchError::NoWhite { name: name.to_owned() })?,
        ),
        None => None,
    };
    let matrix = solve(patches, kept);
    let gain_only = median(
        patches
            .iter()
            .map(|patch| luminance(patch.first) / luminance(patch.second))
            .collect(),
    );
    let white = patches.iter().map(|patch| luminance(patch.first)).fold(0.0, f64::max);
    let references = Reference::new(patches);
    let matched: Vec<PatchMatch> = patches
        .iter()
        .map(|patch| {
            let second = Vector3::from(patch.second);
            let (before, after) = ((second * gain_only).into(), (matrix * second).into());
            PatchMatch {
                name: patch.name.clone(),
                first: patch.first,
                before,
                after,
                relative_error: relative(patch.first, after),
                delta_e: [before, after].map(|seen| ciede2000(lab(patch.first, white), lab(seen, white))),
                delta_e_reference: references.as_ref().and_then(|all| all.differences(patch, after)),
            }
        })
        .collect();
    let rows = [0, 1, 2].map(|i| [matrix[(i, 0)], matrix[(i, 1)], matrix[(i, 2)]]);
    let residuals = |seen: fn(&PatchMatch) -> [f64; 3], index: usize| {
        let relatives: Vec<f64> = matched.iter().map(|patch| relative(patch.first, seen(patch))).collect();
        let differences: Vec<f64> = matched.iter().map(|patch| patch.delta_e[index]).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let worst = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
        Residuals {
            relative_mean: mean(&relatives),
            relative_worst: worst(&relatives),
            delta_e_mean: mean(&differences),
            delta_e_worst: worst(&differences),
        }
    };
    Ok(ColorMatch {
        first_from_second: DMat3::from_cols_array_2d(&rows).transpose(),
        gain: luminance((matrix * Vector3::repeat(1.0)).into()),
        before: residuals(|patch| patch.before, 0),
        after: residuals(|patch| patch.after, 1),
        patches: matched,
    })
}

/// Weighted least squares, row by row of the matrix, with Huber weights per patch.
fn solve(patches: &[SharedPatch], kept: Option<usize>) -> Matrix3<f64> {
    let white = patches.iter().flat_map(|patch| patch.first).fold(0.0, f64::max);
    let ratio = |channel: usize| {
        let ratios = patches.iter().map(|patch| patch.first[channel] / patch.second[channel]);
        median(ratios.filter(|ratio| ratio.is_finite()).collect())
    };
    let gains = Vector3::new(ratio(0), ratio(1), ratio(2));
    let sigma = |patch: &SharedPatch, channel: usize| {
        // Saturated colours have channels near 0 that say little by themselves: relative to the patch's light.
        let light = patch.first[channel].max(0.3 * luminance(patch.first));
        patch.sigma[channel]
            .hypot(MODEL_ERROR * light)
            .hypot(STRAY_ERROR * white)
    };
    let mut weights = vec![1.0; patches.len()];
    let mut matrix = Matrix3::from_diagonal(&gains);
    for _ in 0..ROUNDS {
        for row in 0..3 {
            let prior = (PRIOR_DEVIATION * gains[row].abs().max(1e-9)).powi(-2);
            let mut normal = Matrix3::identity() * prior;
            let mut right = Vector3::ith(row, prior * gains[row]);
            for (patch, weight) in patches.iter().zip(&weights) {
                let second = Vector3::from(patch.second);
                let weight = weight * sigma(patch, row).powi(-2);
                normal += second * second.transpose() * weight;
                right += second * (weight * patch.first[row]);
            }
            if let Some(found) = constrained(&normal, &right, kept.map(|kept| &patches[kept]), row) {
                matrix.set_row(row, &found.transpose());
            }
        }
        for (patch, weight) in patches.iter().zip(&mut weights) {
            let error = matrix * Vector3::from(patch.second) - Vector3::from(patch.first);
            let square: f64 = (0..3).map(|c| (error[c] / sigma(patch, c)).powi(2)).sum();
            *weight = Loss::Huber.cost_and_weight((square / 3.0).sqrt() / 2.0).1;
        }
    }
    matrix
}

/// The row that minimises the squares and meets the kept patch exactly, by a Lagrange multiplier.
fn constrained(
    normal: &Matrix3<f64>,
    right: &Vector3<f64>,
    kept: Option<&SharedPatch>,
    row: usize,
) -> Option<Vector3<f64>> {
    let Some(kept) = kept else {
        return normal.cholesky().map(|cholesky| cholesky.solve(right));
    };
    let scale = normal.trace() / FIXED;
    let mut system = Matrix4::zeros();
    system.fixed_view_mut::<3, 3>(0, 0).copy_from(&(normal / scale));
    let second = Vector3::from(kept.second);
    system.fixed_view_mut::<3, 1>(0, 3).copy_from(&second);
    system.fixed_view_mut::<1, 3>(3, 0).copy_from(&second.transpose());
    let wanted = Vector4::new(right[0] / scale, right[1] / scale, right[2] / scale, kept.first[row]);
    system.lu().solve(&wanted).map(|found| found.xyz())
}

/// Known colours, and the gain from the first camera's unit to theirs.
struct Reference {
    gain: f64,
}

impl Reference {
    /// `None` when no patch's colour is known.
    fn new(patches: &[SharedPatch]) -> Option<Self> {
        let ratios: Vec<f64> = patches
            .iter()
            .filter_map(|patch| Some(luminance(patch.reference?) / luminance(patch.first)))
            .collect();
        (!ratios.is_empty()).then(|| Self { gain: median(ratios) })
    }

    fn differences(&self, patch: &SharedPatch, after: [f64; 3]) -> Option<[f64; 2]> {
        let known = lab(patch.reference?, 1.0);
        Some([patch.first, after].map(|seen| ciede2000(known, lab(seen.map(|value| self.gain * value), 1.0))))
    }
}

/// L*a*b* of linear RGB beside a white of this luminance.
fn lab(rgb: [f64; 3], white: f64) -> [f64; 3] {
    lab_from_xyz(xyz_from_linear_rgb(rgb), WHITE_D65.map(|value| value * white))
}

/// Rec. 709.
fn luminance(rgb: [f64; 3]) -> f64 {
    xyz_from_linear_rgb(rgb)[1]
}

fn relative(first: [f64; 3], other: [f64; 3]) -> f64 {
    (Vector3::from(first) - Vector3::from(other)).norm() / Vector3::from(first).norm()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::simulate::Random;

    /// Rows of a table of spectra at 400, 410 ... 700 nm: name and values.
    fn spectra(table: &str) -> Vec<(String, Vec<f64>)> {
        let lines = table.lines().filter(|line| !line.starts_with('#'));
        lines
            .map(|line| {
                let (name, values) = line.split_at_checked(line.find(",0").unwrap()).unwrap();
                let values: Vec<f64> = values[1..].split(',').map(|value| value.parse().unwrap()).collect();
                assert_eq!(values.len(), 31, "{name}");
                (name.to_owned(), values)
            })
            .collect()
    }

    /// Planck's law, in any unit.
    fn black_body(kelvin: f64) -> impl Fn(usize) -> f64 {
        move |index| {
            let metres = (400.0 + 10.0 * index as f64) * 1e-9;
            metres.powi(-5) / ((1.4388e-2 / (metres * kelvin)).exp() - 1.0)
        }
    }

    /// What the camera of this name, white balanced on a perfect white, sees of the ColorChecker under a black body's light.
    fn seen(camera: &str, kelvin: f64) -> Vec<[f64; 3]> {
        let light = black_body(kelvin);
        let cameras = spectra(include_str!("spectra/cameras.csv"));
        let channels = ["red", "green", "blue"].map(|channel| {
            let name = format!("{camera},{channel}");
            let (_, values) = cameras.iter().find(|(found, _)| *found == name).unwrap();
            values.clone()
        });
        let respond = |channel: &[f64], of: &dyn Fn(usize) -> f64| -> f64 {
            (0..31).map(|i| channel[i] * light(i) * of(i)).sum()
        };
        spectra(include_str!("spectra/color_checker.csv"))
            .iter()
            .map(|(_, patch)| {
                std::array::from_fn(|c| respond(&channels[c], &|i| patch[i]) / respond(&channels[c], &|_| 1.0))
            })
            .collect()
    }

    fn chart_under(kelvin: f64, cameras: [&str; 2], noise: f64) -> Vec<SharedPatch> {
        let mut random = Random::new(6);
        let mut noisy = |color: [f64; 3], gain: f64| color.map(|value| gain * value * (1.0 + noise * random.normal()));
        let [first, second] = cameras.map(|camera| seen(camera, kelvin));
        first
            .into_iter()
            .zip(second)
            .enumerate()
            .map(|(index, (first, second))| SharedPatch {
                name: format!("{index}"),
                first: noisy(first, 1.0),
                second: noisy(second, 0.4),
                sigma: [1e-4; 3],
                reference: None,
            })
            .collect()
    }

    fn chart(noise: f64) -> Vec<SharedPatch> {
        chart_under(5000.0, ["nikon", "canon"], noise)
    }

    /// Measured sensitivities of cameras and measured reflectances, from the light of a lamp to that of the sky. What is reached
    /// depends on the cameras: two with colour filters, then one with filters and one with layers, either way.
    #[test]
    fn measured_cameras_are_matched_on_the_measured_chart() {
        // Difference (CIEDE2000) before at least; after at most mean and worst, relative and CIEDE2000.
        let pairs = [
            (["nikon", "canon"], 1.0, [0.0125, 0.045, 0.7, 2.5]),
            (["sigma", "nikon"], 7.0, [0.02, 0.09, 0.9, 2.5]),
            (["nikon", "sigma"], 7.0, [0.036, 0.125, 1.9, 5.8]),
        ];
        for (cameras, before, limits) in pairs {
            for kelvin in [2856.0, 5000.0, 6500.0] {
                let found = match_cameras(&chart_under(kelvin, cameras, 0.003), None).unwrap();
                let after = found.after;
                println!(
                    "{cameras:?} {kelvin} K: before {:.4?}\n  after {after:.4?}",
                    found.before
                );
                assert!(
                    found.before.delta_e_mean > before && found.before.relative_mean > 0.03,
                    "the cameras are too alike to test anything"
                );
                let reached = [
                    after.relative_mean,
                    after.relative_worst,
                    after.delta_e_mean,
                    after.delta_e_worst,
                ];
                assert!(
                    reached.iter().zip(limits).all(|(found, limit)| *found < limit),
                    "{after:?}"
                );
                assert!((found.gain / 2.5 - 1.0).abs() < 0.04, "{}", found.gain);
            }
        }
    }

    #[test]
    fn a_true_matrix_comes_back_in_spite_of_a_wrong_patch() {
        let truth = Matrix3::new(1.1, -0.2, 0.05, 0.1, 0.9, 0.0, -0.05, 0.1, 1.3);
        let mut patches = chart(0.0);
        for patch in &mut patches {
            patch.first = (truth * Vector3::from(patch.second)).into();
        }
        patches[7].first = [0.5, 0.1, 0.9];
        let found = match_cameras(&patches, None).unwrap().first_from_second;
        for row in 0..3 {
            for column in 0..3 {
                let error = found.row(row)[column] - truth[(row, column)];
                assert!(error.abs() < 0.02, "{row} {column}: {error}");
            }
        }
    }

    #[test]
    fn greys_alone_give_gains_and_white_can_be_kept() {
        // Perfect greys: those of a real chart have a tint, from which a matrix is read, well or badly.
        let mut random = Random::new(5);
        let mut greys = chart(0.0).split_off(18);
        for grey in &mut greys {
            let light = grey.first[1];
            grey.first = [light; 3].map(|value| value * (1.0 + 0.003 * random.normal()));
            grey.second = [0.4 * light; 3].map(|value| value * (1.0 + 0.003 * random.normal()));
        }
        let found = match_cameras(&greys, None).unwrap().first_from_second;
        for row in 0..3 {
            for column in 0..3 {
                let expected = if row == column { 2.5 } else { 0.0 };
                assert!((found.row(row)[column] - expected).abs() < 0.15, "{found}");
            }
        }
        let all = chart(0.003);
        let kept = match_cameras(&all, Some("18")).unwrap();
        assert!(kept.patches[18].relative_error < 1e-9, "{:?}", kept.patches[18]);
        assert!(kept.after.delta_e_mean < 1.5);
        assert_eq!(match_cameras(&[], None), Err(MatchError::None));
        let error = match_cameras(&greys, Some("7")).unwrap_err();
        assert_eq!(error, MatchError::NoWhite { name: "7".to_owned() });
    }
}
