//! The strong lights over time: the same lamp is known again in the next picture, and its distance settles.

use glam::Vec3;
use mirrorball_calib::probe::cube::Cube;

use super::clipped::StrongRegion;

/// A region this near to where a light was is that light, radians: lamps are carried about, but not across the room between
/// two pictures.
const SAME_LIGHT_RAD: f32 = 0.12;
/// Share of a new distance in the average; about four pictures.
const NEW_SHARE: f32 = 0.25;
/// Changes of a distance smaller than this share are left out, so that shadow maps can be kept.
const STEP: f32 = 0.03;

#[derive(Debug, Clone, Copy)]
struct Known {
    direction: Vec3,
    /// Average of the logarithms of the distances seen.
    log_m: f32,
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
                        used_m: distance_m,
                        is_measured,
                    };
                };
                let log_m = before.log_m + NEW_SHARE * (log_m - before.log_m);
                let has_moved = (log_m - before.used_m.ln()).abs() > STEP;
                Known {
                    direction,
                    log_m,
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
