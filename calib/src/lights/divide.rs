//! Regions of rays divided in two where that leaves the least spread.
//!
//! Viriyothai and Debevec 2009, "Variance minimization light probe sampling": a cut at half the energy goes through the
//! brighter of two lamps and leaves a light between them; a cut at the least variance goes between them.

use glam::{Mat3, Vec3};

use super::gather::Ray;

/// Some rays, and how they spread.
#[derive(Debug)]
pub(super) struct Region {
    pub(super) rays: Vec<Ray>,
    pub(super) mean: Vec3,
    /// Luminance of the irradiance.
    pub(super) power: f32,
    axis: Vec3,
    /// Standard deviation along `axis`, radians.
    spread_rad: f32,
}

impl Region {
    pub(super) fn new(rays: Vec<Ray>) -> Self {
        let power: f32 = rays.iter().map(Ray::power).sum();
        let mean = rays
            .iter()
            .map(|r| r.direction * r.power())
            .sum::<Vec3>()
            .normalize_or(rays.first().map_or(Vec3::Z, |r| r.direction));
        let mut covariance = Mat3::ZERO;
        for ray in &rays {
            let off = ray.direction - mean;
            covariance += Mat3::from_cols(off * off.x, off * off.y, off * off.z) * ray.power();
        }
        covariance *= 1.0 / power.max(f32::MIN_POSITIVE);
        let (axis, variance) = longest_axis(covariance);
        Self {
            rays,
            mean,
            power,
            axis,
            spread_rad: variance.max(0.0).sqrt(),
        }
    }

    /// Two parts that spread least along the longest axis; the whole region when one would be empty.
    pub(super) fn split(mut self) -> Result<(Self, Self), Self> {
        self.rays
            .sort_by(|a, b| a.direction.dot(self.axis).total_cmp(&b.direction.dot(self.axis)));
        let moments = |r: &Ray| {
            let weight = f64::from(r.power());
            (weight, weight * f64::from(r.direction.dot(self.axis)))
        };
        let (all, all_moment) = self
            .rays
            .iter()
            .map(moments)
            .fold((0.0, 0.0), |(w, m), (weight, moment)| (w + weight, m + moment));
        let (mut sum, mut moment) = (0.0, 0.0);
        let (mut most, mut middle) = (f64::NEG_INFINITY, 0);
        for (i, ray) in self.rays.iter().enumerate().take(self.rays.len().saturating_sub(1)) {
            let (weight, weighted) = moments(ray);
            sum += weight;
            moment += weighted;
            // The spread within the parts is least where that between their means is largest.
            let between = moment * moment / sum + (all_moment - moment).powi(2) / (all - sum);
            if between > most {
                (most, middle) = (between, i + 1);
            }
        }
        if middle == 0 {
            return Err(self);
        }
        let second = self.rays.split_off(middle);
        Ok((Self::new(self.rays), Self::new(second)))
    }
}

/// Divides the rays into at most `max` regions until none spreads more than `narrow_rad` along its longest axis; the one with
/// the most power times spread goes first.
pub(super) fn divided(rays: Vec<Ray>, max: usize, narrow_rad: f32) -> Vec<Region> {
    if rays.is_empty() || max == 0 {
        return Vec::new();
    }
    let mut regions = vec![Region::new(rays)];
    while regions.len() < max {
        let Some(widest) = (0..regions.len())
            .filter(|&i| regions[i].spread_rad > narrow_rad)
            .max_by(|&a, &b| {
                (regions[a].power * regions[a].spread_rad).total_cmp(&(regions[b].power * regions[b].spread_rad))
            })
        else {
            break;
        };
        match regions.swap_remove(widest).split() {
            Ok((first, second)) => regions.extend([first, second]),
            Err(mut whole) => {
                whole.spread_rad = 0.0;
                regions.push(whole);
            }
        }
    }
    regions
}

/// Eigenvector and eigenvalue of the largest eigenvalue, by power iteration; good enough to divide along.
fn longest_axis(covariance: Mat3) -> (Vec3, f32) {
    let start = [covariance.x_axis, covariance.y_axis, covariance.z_axis]
        .into_iter()
        .max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))
        .unwrap_or(Vec3::X);
    let mut axis = start.normalize_or(Vec3::X);
    for _ in 0..16 {
        axis = (covariance * axis).normalize_or(axis);
    }
    (axis, axis.dot(covariance * axis))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(direction: Vec3, power: f32) -> Ray {
        Ray {
            direction: direction.normalize(),
            irradiance: Vec3::splat(power),
            area_sr: 1e-4,
            inverse_distance: 0.0,
            cell: 0,
        }
    }

    #[test]
    fn the_cut_goes_between_two_lamps_however_unequal() {
        let mut rays: Vec<Ray> = (0..20)
            .map(|i| ray(Vec3::new(1.0, 0.001 * i as f32, 0.0), 9.0))
            .collect();
        rays.extend((0..20).map(|i| ray(Vec3::new(1.0, 0.4 + 0.001 * i as f32, 0.0), 1.0)));
        let regions = divided(rays, 2, 0.02);
        let mut counts: Vec<(usize, i32)> = regions.iter().map(|r| (r.rays.len(), r.power.round() as i32)).collect();
        counts.sort_unstable();
        assert_eq!(counts, [(20, 20), (20, 180)]);
    }

    #[test]
    fn what_is_narrow_stays_whole() {
        let rays = (0..9)
            .map(|i| ray(Vec3::new(1.0, 0.005 * i as f32, 0.0), 1.0))
            .collect();
        assert_eq!(divided(rays, 8, 0.05).len(), 1);
        assert!(divided(Vec::new(), 8, 0.05).is_empty());
    }
}
