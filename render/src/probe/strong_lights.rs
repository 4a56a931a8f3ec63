//! The strong lights over time: the same lamp is known again in the next picture, and its distance settles.

use glam::Vec3;
use mirrorball_calib::probe::cube::Cube;

use super::clipped::StrongRegion;

/// A region this near to where a light was is that light, radians: lamps are carried about, but not across the room between
/// two pictures.
const SAME_LIGHT_RAD: f32 = 0.12;
/// Standard deviation by which the logarithm of a light's distance may change from picture to picture: a lamp that is
/// carried about.
const DRIFT: f32 = 0.015;
/// Changes of a distance smaller than this share are left out, so that shadow maps can be kept.
const STEP: f32 = 0.03;

#[derive(Debug, Clone, Copy)]
struct Known {
    direction: Vec3,
    /// Logarithm of the distance, and its variance: a Kalman filter (1960) of one number.
    log_m: f32,
    variance: f32,
    /// What the renderer uses; follows the average in steps.
    used_m: f32,
    /// Whether the readings could tell the distance.
    is_measured: bool,
}

/// What is remembered of the strong lights.
#[derive(Debug, Clone, Default)]
pub(super) struct StrongLights {
    known: Vec<Known>,
}

impl StrongLights {
    /// The distances that lights were last known at, metres; `None` for those that are new.
    pub(super) fn expected_m(&self, regions: &[StrongRegion], far: &Cube<Vec3>) -> Vec<Option<f32>> {
        let known = |region: &StrongRegion| self.measured(direction_of(region, far)).map(|k| k.log_m.exp());
        regions.iter().map(known).collect()
    }

    /// Takes the distances of this picture in and gives those to use; with no reading nothing changes.
    pub(super) fn settle(&mut self, regions: &[StrongRegion], far: &Cube<Vec3>, seen_m: &mut [(f32, f32)]) {
        let now: Vec<Known> = regions
            .iter()
            .zip(&*seen_m)
            .map(|(region, &(distance_m, sigma))| {
                let direction = direction_of(region, far);
                let log_m = distance_m.ln();
                let is_measured = sigma.is_finite();
                let Some(before) = self.measured(direction).filter(|_| is_measured) else {
                    return Known {
                        direction,
                        log_m,
                        variance: sigma * sigma,
                        used_m: distance_m,
                        is_measured,
                    };
                };
                let predicted = before.variance + DRIFT * DRIFT;
                let gain = predicted / (predicted + sigma * sigma).max(f32::MIN_POSITIVE);
                let log_m = before.log_m + gain * (log_m - before.log_m);
                let has_moved = (log_m - before.used_m.ln()).abs() > STEP;
                Known {
                    direction,
                    log_m,
                    variance: (1.0 - gain) * predicted,
                    used_m: if has_moved { log_m.exp() } else { before.used_m },
                    is_measured,
                }
            })
            .collect();
        for (seen, known) in seen_m.iter_mut().zip(&now) {
            seen.0 = known.used_m;
        }
        self.known = now;
    }

    /// The nearest light whose distance is known.
    fn measured(&self, direction: Vec3) -> Option<Known> {
        let angle = |known: &Known| known.direction.angle_between(direction);
        let measured = self.known.iter().copied().filter(|known| known.is_measured);
        let nearest = measured.min_by(|a, b| angle(a).total_cmp(&angle(b)))?;
        (angle(&nearest) < SAME_LIGHT_RAD).then_some(nearest)
    }
}

fn direction_of(region: &StrongRegion, far: &Cube<Vec3>) -> Vec3 {
    let sum: Vec3 = region
        .texels
        .iter()
        .map(|&i| far.direction(i) * far.solid_angle(i))
        .sum();
    sum.normalize_or(Vec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::clipped::Price;

    fn region(far: &Cube<Vec3>, towards: Vec3) -> StrongRegion {
        let texels = vec![far.index_of(towards)];
        StrongRegion {
            core: texels.clone(),
            texels,
            channels: [true; 3],
            price: Price::NONE,
            beyond: None,
        }
    }

    #[test]
    fn a_still_lamp_settles_and_one_that_is_not_measured_stays_unknown() {
        let far = Cube::filled(64, Vec3::ONE);
        let regions = [region(&far, Vec3::X), region(&far, Vec3::Z)];
        let mut lights = StrongLights::default();
        let mut used = Vec::new();
        for k in 0..40 {
            let noise = 1.0 + 0.05 * (k as f32 * 2.4).sin();
            let mut seen = [(1.2 * noise, 0.05), (2.0, f32::INFINITY)];
            lights.settle(&regions, &far, &mut seen);
            used.push(seen[0].0);
        }
        assert!(used[20..].iter().all(|d| (d / 1.2 - 1.0).abs() < 0.03), "{used:?}");
        let expected = lights.expected_m(&regions, &far);
        assert!(expected[0].is_some_and(|d| (d / 1.2 - 1.0).abs() < 0.03) && expected[1].is_none());
    }

    #[test]
    fn a_lamp_that_is_carried_about_is_followed() {
        let far = Cube::filled(64, Vec3::ONE);
        let mut lights = StrongLights::default();
        for k in 0..20 {
            let angle = 0.05 * k as f32;
            let regions = [region(&far, Vec3::new(angle.cos(), angle.sin(), 0.5))];
            let distance_m = 1.0 + 0.03 * k as f32;
            let mut seen = [(distance_m, 0.01)];
            lights.settle(&regions, &far, &mut seen);
            assert!((seen[0].0 / distance_m - 1.0).abs() < 0.04, "{k}: {}", seen[0].0);
        }
    }
}
