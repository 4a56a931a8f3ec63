//! White balance: the setting at which a second camera shows grey as the first one does.
//!
//! What is compared is what the cameras give out: linear signals after their white-balance gains, of the same white or grey patches.
//! Their chromaticity (ln r/g, ln b/g) does not depend on exposure, and it does not matter whether the gains that the driver tells are
//! those in force. Between the second camera's measured settings its chromaticity is taken from a cubic through them (Hermite, slopes
//! of the parabola through three neighbours).

use glam::{DMat2, DVec2};

use super::{
    difference::{WHITE_D65, ciede2000, lab_from_xyz, xyz_from_linear_rgb},
    sample::{PatchLight, Unread},
};

/// Fewest settings of the second camera: two would hide that its chromaticity does not run along a straight line.
const MIN_SETTINGS: usize = 3;

/// Steps in which a stretch between two settings is searched before the best place is refined.
const STEPS: usize = 32;

/// Halvings, or nearly, of the refinement.
const ROUNDS: usize = 60;

/// Unread patches that a message names.
const NAMED: usize = 6;

/// A white or grey patch in one picture.
#[derive(Debug, Clone, PartialEq)]
pub struct GreyReading {
    /// What the driver was set to: kelvin, say; any scale along which the colour changes steadily.
    pub setting: f64,
    /// Gains of red, green and blue that the frame says were in force.
    pub gains: [f64; 3],
    /// The patch.
    pub patch: String,
    /// Its light with the gains taken out, or why there is none.
    pub light: Result<PatchLight, Unread>,
}

/// A camera's grey at one of its settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GreyAt {
    /// The setting.
    pub setting: f64,
    /// Mean of the gains told.
    pub gains: [f64; 3],
    /// ln r/g and ln b/g of what the camera gives out.
    pub chromaticity: DVec2,
    /// Covariance of the chromaticity.
    pub covariance: DMat2,
}

/// The second camera's setting for one of the first camera's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Setting of the first camera.
    pub first_setting: f64,
    /// Setting of the second camera at which it agrees best.
    pub second_setting: f64,
    /// Standard deviation of the second camera's setting, from the noise of the patches; infinite at the end of
    /// the range.
    pub sigma: f64,
    /// Gains that the second camera tells there.
    pub second_gains: [f64; 3],
    /// What is left: r/g and b/g of the second camera over those of the first, minus 1.
    pub left: [f64; 2],
    /// What is left as CIEDE2000, for an observer adapted to the first camera's white.
    pub delta_e: f64,
    /// Whether the best setting is the lowest or highest one measured, so that a better one may lie beyond.
    pub is_at_end: bool,
}

/// The table.
#[derive(Debug, Clone, PartialEq)]
pub struct WhiteBalanceTable {
    /// Both cameras' grey, by setting.
    pub greys: [Vec<GreyAt>; 2],
    /// For each setting of the first camera.
    pub rows: Vec<Agreement>,
    /// The patches used: those that both cameras show well at every setting.
    pub patches: Vec<String>,
}

/// Why there is no table.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WhiteBalanceError {
    /// Too few settings.
    #[error("camera `{camera}` shows the patches at `{found}` settings (allowed: `{least}` or more)")]
    FewSettings {
        /// Name of the camera.
        camera: String,
        /// Its settings.
        found: usize,
        /// Fewest.
        least: usize,
    },
    /// No patch can be read at all settings.
    #[error("no neutral patch can be read at every setting of both cameras ({unread})")]
    NoPatch {
        /// Patch, camera, setting and reason of the first few.
        unread: String,
    },
}

/// Makes the table from what each camera, named, shows of the patches.
///
/// # Errors
/// When the first camera has no setting, the second less than three, or no patch can be read at every setting of both.
pub fn white_balance_table(
    cameras: [&str; 2],
    readings: [&[GreyReading]; 2],
) -> Result<WhiteBalanceTable, WhiteBalanceError> {
    let settings = readings.map(settings_of);
    for (index, least) in [1, MIN_SETTINGS].into_iter().enumerate() {
        let found = settings[index].len();
        if found < least {
            let camera = cameras[index].to_owned();
            return Err(WhiteBalanceError::FewSettings { camera, found, least });
        }
    }
    let patches = patches_at_every_setting(cameras, readings, &settings)?;
    let greys: [Vec<GreyAt>; 2] = [0, 1].map(|index| {
        let at = |&setting: &f64| grey_at(readings[index], setting, &patches);
        settings[index].iter().map(at).collect()
    });
    let rows = greys[0].iter().map(|first| agree(first, &greys[1])).collect();
    Ok(WhiteBalanceTable { greys, rows, patches })
}

/// Settings in rising order.
fn settings_of(readings: &[GreyReading]) -> Vec<f64> {
    let mut settings: Vec<f64> = readings.iter().map(|reading| reading.setting).collect();
    settings.sort_by(f64::total_cmp);
    settings.dedup();
    settings
}

/// Names of the patches that can be read in some picture of every setting.
fn patches_at_every_setting(
    cameras: [&str; 2],
    readings: [&[GreyReading]; 2],
    settings: &[Vec<f64>; 2],
) -> Result<Vec<String>, WhiteBalanceError> {
    let mut names: Vec<&str> = Vec::new();
    for reading in readings.into_iter().flatten() {
        if !names.contains(&reading.patch.as_str()) {
            names.push(&reading.patch);
        }
    }
    let mut unread = Vec::new();
    names.retain(|name| {
        for (index, camera) in cameras.into_iter().enumerate() {
            for &setting in &settings[index] {
                let mut there = readings[index]
                    .iter()
                    .filter(|reading| reading.patch == *name && reading.setting == setting);
                if there.clone().any(|reading| chromaticity(reading).is_some()) {
                    continue;
                }
                let reason = there.find_map(|reading| reading.light.err());
                let reason = reason.map_or_else(|| Unread::Black.to_string(), |reason| reason.to_string());
                unread.push(format!("`{name}` in `{camera}` at {setting:.4}: {reason}"));
                return false;
            }
        }
        true
    });
    if names.is_empty() {
        unread.truncate(NAMED);
        let unread = unread.join("; ");
        return Err(WhiteBalanceError::NoPatch { unread });
    }
    Ok(names.into_iter().map(str::to_owned).collect())
}

/// Chromaticity with its covariance; `None` for a patch that could not be read.
fn chromaticity(reading: &GreyReading) -> Option<(DVec2, DMat2)> {
    let light = reading.light.ok()?;
    if light.radiance.iter().any(|&value| value <= 0.0) {
        return None;
    }
    let logarithm = |c: usize| (light.radiance[c] * reading.gains[c]).ln();
    let [r, g, b] = [0, 1, 2].map(|c| (light.sigma[c] / light.radiance[c]).powi(2));
    let covariance = DMat2::from_cols(DVec2::new(r + g, g), DVec2::new(g, b + g));
    Some((
        DVec2::new(logarithm(0) - logarithm(1), logarithm(2) - logarithm(1)),
        covariance,
    ))
}

/// Mean over the pictures of each patch, then over the patches, so that a patch's own tint counts alike in both cameras.
fn grey_at(readings: &[GreyReading], setting: f64, patches: &[String]) -> GreyAt {
    let here: Vec<&GreyReading> = readings.iter().filter(|reading| reading.setting == setting).collect();
    let (mut mean, mut covariance) = (DVec2::ZERO, DMat2::ZERO);
    for patch in patches {
        let of_patch = here.iter().filter(|reading| reading.patch == *patch);
        let seen: Vec<(DVec2, DMat2)> = of_patch.filter_map(|reading| chromaticity(reading)).collect();
        let n = seen.len() as f64;
        let middle = seen.iter().map(|(place, _)| *place).sum::<DVec2>() / n;
        let mut sum = DMat2::ZERO;
        for (place, own) in &seen {
            let apart = *place - middle;
            sum += *own + DMat2::from_cols(apart * apart.x, apart * apart.y);
        }
        mean += middle / patches.len() as f64;
        covariance += sum * (n * patches.len() as f64).powi(-2);
    }
    let gains = std::array::from_fn(|c| here.iter().map(|reading| reading.gains[c]).sum::<f64>() / here.len() as f64);
    GreyAt {
        setting,
        gains,
        chromaticity: mean,
        covariance,
    }
}

/// Place along a camera's settings: the stretch from one to the next, and the share of it.
#[derive(Clone, Copy)]
struct Place {
    stretch: usize,
    share: f64,
}

/// The second camera's place nearest to a chromaticity of the first.
fn nearest(first: DVec2, second: &[GreyAt]) -> Place {
    let distance = |place: Place| curve(second, place).distance_squared(first);
    let step = (STEPS as f64).recip();
    let places = (0..second.len() - 1).flat_map(|stretch| {
        (0..=STEPS).map(move |i| Place {
            stretch,
            share: i as f64 * step,
        })
    });
    let start = places
        .min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
        .expect("there are two settings or more");
    // Golden section, within the stretch.
    let at = |share: f64| Place { share, ..start };
    let (mut low, mut high) = ((start.share - step).max(0.0), (start.share + step).min(1.0));
    for _ in 0..ROUNDS {
        let inner = 0.618_033_988_75 * (high - low);
        if distance(at(high - inner)) < distance(at(low + inner)) {
            high = low + inner;
        } else {
            low = high - inner;
        }
    }
    let refined = at(0.5 * (low + high));
    if distance(refined) < distance(start) {
        refined
    } else {
        start
    }
}

/// The setting at a place.
fn setting(second: &[GreyAt], place: Place) -> f64 {
    let [from, to] = [second[place.stretch], second[place.stretch + 1]];
    from.setting + place.share * (to.setting - from.setting)
}

fn agree(first: &GreyAt, second: &[GreyAt]) -> Agreement {
    let place = nearest(first.chromaticity, second);
    let [from, to] = [second[place.stretch], second[place.stretch + 1]];
    let apart = curve(second, place) - first.chromaticity;
    let is_first = place.stretch == 0 && place.share < 1e-6;
    let is_last = place.stretch + 2 == second.len() && place.share > 1.0 - 1e-6;
    let is_at_end = is_first || is_last;
    Agreement {
        first_setting: first.setting,
        second_setting: setting(second, place),
        sigma: if is_at_end { f64::INFINITY } else { sigma(first, second) },
        second_gains: std::array::from_fn(|c| from.gains[c] + place.share * (to.gains[c] - from.gains[c])),
        left: [apart.x.exp_m1(), apart.y.exp_m1()],
        delta_e: grey_difference(apart),
        is_at_end,
    }
}

/// Standard deviation of the nearest setting: what becomes of it when each measured chromaticity is moved by its standard deviation,
/// along and across.
fn sigma(first: &GreyAt, second: &[GreyAt]) -> f64 {
    let found = |first: DVec2, second: &[GreyAt]| setting(second, nearest(first, second));
    let mut variance = 0.0;
    for way in root(first.covariance) {
        let [above, below] = [1.0, -1.0].map(|sign| found(first.chromaticity + sign * way, second));
        variance += (0.5 * (above - below)).powi(2);
    }
    for (index, grey) in second.iter().enumerate() {
        for way in root(grey.covariance) {
            let [above, below] = [1.0, -1.0].map(|sign| {
                let mut moved = second.to_vec();
                moved[index].chromaticity += sign * way;
                found(first.chromaticity, &moved)
            });
            variance += (0.5 * (above - below)).powi(2);
        }
    }
    variance.sqrt()
}

/// Columns of the lower triangular root of a covariance (Cholesky).
fn root(covariance: DMat2) -> [DVec2; 2] {
    let first = covariance.x_axis.x.max(0.0).sqrt();
    if first == 0.0 {
        return [DVec2::ZERO, DVec2::new(0.0, covariance.y_axis.y.max(0.0).sqrt())];
    }
    let shared = covariance.x_axis.y / first;
    let rest = (covariance.y_axis.y - shared * shared).max(0.0).sqrt();
    [DVec2::new(first, shared), DVec2::new(0.0, rest)]
}

/// Chromaticity at a place.
fn curve(greys: &[GreyAt], place: Place) -> DVec2 {
    let (i, u) = (place.stretch, place.share);
    let width = greys[i + 1].setting - greys[i].setting;
    let (from, to) = (greys[i].chromaticity, greys[i + 1].chromaticity);
    let (start, end) = (width * slope_at(greys, i), width * slope_at(greys, i + 1));
    from * (1.0 + u * u * (2.0 * u - 3.0))
        + to * (u * u * (3.0 - 2.0 * u))
        + start * (u * (1.0 - u).powi(2))
        + end * (u * u * (u - 1.0))
}

/// Slope, at a setting, of the parabola through it and its neighbours, or at an end through the next two.
fn slope_at(greys: &[GreyAt], index: usize) -> DVec2 {
    let middle = index.clamp(1, greys.len() - 2);
    let [a, b, c] = [greys[middle - 1], greys[middle], greys[middle + 1]];
    let left = (b.chromaticity - a.chromaticity) / (b.setting - a.setting);
    let right = (c.chromaticity - b.chromaticity) / (c.setting - b.setting);
    let bend = (right - left) / (c.setting - a.setting);
    left + bend * (2.0 * greys[index].setting - a.setting - b.setting)
}

/// CIEDE2000 between white and what has this chromaticity relative to it, both as light.
fn grey_difference(apart: DVec2) -> f64 {
    let xyz = xyz_from_linear_rgb([apart.x.exp(), 1.0, apart.y.exp()]);
    let lab = |xyz: [f64; 3]| lab_from_xyz(xyz.map(|value| value / xyz[1]), WHITE_D65);
    ciede2000(lab(WHITE_D65), lab(xyz))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::simulate::Random;

    /// Grey light before the gains, of two cameras under the same lamp.
    const RAW: [[f64; 3]; 2] = [[0.9, 1.0, 0.45], [0.75, 1.0, 0.6]];

    /// ln of the gains of red and blue, by kelvin: two drivers that agree on nothing.
    fn gains(camera: usize, kelvin: f64) -> [f64; 3] {
        let mired = 1e6 / kelvin;
        let [red, blue] = match camera {
            0 => [1.0 - 0.0026 * mired, -0.55 + 0.0031 * mired],
            _ => [1.25 - 0.0028 * mired, -0.85 + 0.0034 * mired],
        };
        [red.exp(), 1.0, blue.exp()]
    }

    fn readings(camera: usize, kelvins: &[f64], noise: f64) -> Vec<GreyReading> {
        let mut random = Random::new(7 + camera as u64);
        let mut all = Vec::new();
        for &setting in kelvins {
            for (patch, level) in [("white", 0.8), ("grey", 0.3)] {
                let radiance = RAW[camera].map(|value| level * value * (1.0 + noise * random.normal()));
                all.push(GreyReading {
                    setting,
                    gains: gains(camera, setting),
                    patch: patch.to_owned(),
                    light: Ok(PatchLight {
                        radiance,
                        sigma: radiance.map(|value| noise * value),
                        pixels: 100,
                    }),
                });
            }
        }
        all
    }

    const FIRST: [f64; 5] = [3000.0, 3500.0, 4000.0, 4500.0, 5000.0];
    const SECOND: [f64; 8] = [2500.0, 3000.0, 3500.0, 4000.0, 4500.0, 5000.0, 5500.0, 6500.0];

    /// Nearest setting of the second camera, by trying all.
    fn truth(kelvin: f64) -> (f64, f64) {
        let chromaticity = |camera: usize, kelvin: f64| {
            let [r, g, b] = std::array::from_fn(|c| (RAW[camera][c] * gains(camera, kelvin)[c]).ln());
            DVec2::new(r - g, b - g)
        };
        let wanted = chromaticity(0, kelvin);
        (0..40_001)
            .map(|i| 2500.0 + 0.1 * f64::from(i))
            .map(|setting| (setting, chromaticity(1, setting).distance(wanted)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap()
    }

    #[test]
    fn settings_are_found_between_those_measured() {
        let (first, second) = (readings(0, &FIRST, 0.0), readings(1, &SECOND, 0.0));
        let table = white_balance_table(["a", "b"], [&first, &second]).unwrap();
        assert_eq!(table.patches, ["white", "grey"]);
        for (row, kelvin) in table.rows.iter().zip(FIRST) {
            let (setting, distance) = truth(kelvin);
            println!("{row:?}, truth {setting} {distance}");
            assert_eq!(row.first_setting, kelvin);
            assert!((row.second_setting - setting).abs() < 15.0, "{row:?} {setting}");
            let left = DVec2::from(row.left.map(f64::ln_1p)).length();
            assert!((left - distance).abs() < 2e-3, "{row:?} {distance}");
            assert!(!row.is_at_end);
        }
    }

    #[test]
    fn the_error_is_as_stated() {
        // Of many measurements, about 68 of 100 are within a sigma.
        let mut within = 0;
        let rounds = 200;
        let exact =
            white_balance_table(["a", "b"], [&readings(0, &[4000.0], 0.0), &readings(1, &SECOND, 0.0)]).unwrap();
        let mut random = Random::new(3);
        for _ in 0..rounds {
            let mut noisy = [readings(0, &[4000.0], 0.0), readings(1, &SECOND, 0.0)];
            for light in noisy
                .iter_mut()
                .flatten()
                .filter_map(|reading| reading.light.as_mut().ok())
            {
                light.sigma = light.radiance.map(|value| 0.004 * value);
                light.radiance = light.radiance.map(|value| value * (1.0 + 0.004 * random.normal()));
            }
            let found = white_balance_table(["a", "b"], [&noisy[0], &noisy[1]]).unwrap().rows[0];
            within += usize::from((found.second_setting - exact.rows[0].second_setting).abs() < found.sigma);
        }
        assert!(
            (0.58..0.78).contains(&(f64::from(within as u32) / f64::from(rounds))),
            "{within}"
        );
    }

    #[test]
    fn a_best_setting_beyond_the_range_is_flagged() {
        let (first, second) = (readings(0, &FIRST, 0.0), readings(1, &[5000.0, 5500.0, 6500.0], 0.0));
        let table = white_balance_table(["a", "b"], [&first, &second]).unwrap();
        let row = table.rows[0];
        assert!(
            row.is_at_end && row.second_setting == 5000.0 && row.sigma.is_infinite() && row.delta_e > 1.0,
            "{row:?}"
        );
    }

    #[test]
    fn patches_that_clip_are_left_out_or_named() {
        let (first, mut second) = (readings(0, &FIRST, 0.0), readings(1, &SECOND, 0.0));
        // White is clipped at one setting: grey alone counts, everywhere.
        second[2].light = Err(Unread::Clipped);
        let table = white_balance_table(["a", "b"], [&first, &second]).unwrap();
        assert_eq!(table.patches, ["grey"]);
        second[5].light = Err(Unread::Black);
        let error = white_balance_table(["a", "b"], [&first, &second]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "no neutral patch can be read at every setting of both cameras (`white` in `b` at 3000.0000: clipped; \
             `grey` in `b` at 3500.0000: black)"
        );
        let error = white_balance_table(["a", "b"], [&first, &second[..4]]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "camera `b` shows the patches at `2` settings (allowed: `3` or more)"
        );
        let error = white_balance_table(["a", "b"], [&[], &second]).unwrap_err();
        assert!(matches!(error, WhiteBalanceError::FewSettings { least: 1, .. }));
    }
}
