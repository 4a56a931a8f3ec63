//! The sums over texels that make a light.

use glam::Vec3;

use super::cap_radius;
use crate::probe::radiance::luminance;

/// Light from one direction, or a share of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    /// Unit direction.
    pub(super) direction: Vec3,
    /// Radiance times solid angle, linear RGB.
    pub(super) irradiance: Vec3,
    /// Solid angle, steradians.
    pub(super) area_sr: f32,
    /// One over its distance.
    pub(super) inverse_distance: f32,
    /// Cell of the dome that it lies in.
    pub(super) cell: u16,
}

impl Ray {
    /// A share of the ray.
    pub(super) fn share(&self, share: f32) -> Self {
        Self {
            irradiance: self.irradiance * share,
            area_sr: self.area_sr * share,
            ..*self
        }
    }

    /// Luminance of its irradiance.
    pub(super) fn power(&self) -> f32 {
        luminance(self.irradiance)
    }
}

/// Sums over rays; offsets are from a direction near all of them, so that small spreads keep their digits.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Gathered {
    /// Irradiance of all, linear RGB.
    pub(super) irradiance: Vec3,
    /// Luminance of `irradiance`.
    pub(super) power: f32,
    /// Solid angle of all, steradians.
    pub(super) area_sr: f32,
    offset: Vec3,
    offset_squared: f32,
    distance_weight: f32,
    inverse_distance: f32,
}

impl Gathered {
    /// Adds a share of a ray; offsets count from `origin`, the same in all calls.
    pub(super) fn add(&mut self, ray: &Ray, share: f32, origin: Vec3) {
        // Dark rays have a distance too, when there are no others.
        const DARK: f32 = 1e-9;
        let power = share * luminance(ray.irradiance);
        let offset = ray.direction - origin;
        self.irradiance += ray.irradiance * share;
        self.power += power;
        self.area_sr += ray.area_sr * share;
        self.offset += offset * power;
        self.offset_squared += offset.length_squared() * power;
        let weight = power + DARK * share * ray.area_sr;
        self.distance_weight += weight;
        self.inverse_distance += ray.inverse_distance * weight;
    }

    /// Power-weighted mean direction; `origin` where there is no power.
    pub(super) fn direction(&self, origin: Vec3) -> Vec3 {
        if self.power > 0.0 {
            (origin + self.offset / self.power).normalize_or(origin)
        } else {
            origin
        }
    }

    /// Power-weighted root mean square distance from the mean, radians, of all directions together.
    pub(super) fn spread_rad(&self) -> f32 {
        if self.power > 0.0 {
            (self.offset_squared / self.power - (self.offset / self.power).length_squared())
                .max(0.0)
                .sqrt()
        } else {
            0.0
        }
    }

    /// One over the distance: the power-weighted mean of the rays' inverse distances; 0 for infinity.
    pub(super) fn mean_inverse_distance(&self) -> f32 {
        if self.distance_weight > 0.0 {
            self.inverse_distance / self.distance_weight
        } else {
            0.0
        }
    }

    /// Adds sums that were taken from the same origin.
    pub(super) fn merge(&mut self, other: &Self) {
        self.irradiance += other.irradiance;
        self.power += other.power;
        self.area_sr += other.area_sr;
        self.offset += other.offset;
        self.offset_squared += other.offset_squared;
        self.distance_weight += other.distance_weight;
        self.inverse_distance += other.inverse_distance;
    }

    /// Keeps all but how much light it is.
    pub(super) fn set_irradiance(&mut self, irradiance: Vec3) {
        let power = luminance(irradiance);
        // The sums of offsets are weighted by power, so they change with it.
        let factor = if self.power > 0.0 { power / self.power } else { 0.0 };
        self.offset *= factor;
        self.offset_squared *= factor;
        self.irradiance = irradiance;
        self.power = power;
    }

    /// Half angle of a cap as large as all rays together, radians.
    pub(super) fn cap_radius_rad(&self) -> f32 {
        cap_radius(self.area_sr)
    }
}

/// A distance from its inverse.
pub(super) fn distance_m(inverse: f32) -> f32 {
    if inverse > 0.0 { inverse.recip() } else { f32::INFINITY }
}
