//! Error of the distance at which a run found the lamps.

use crate::{
    brightest_light::angle_deg,
    outputs::{Outputs, StrongLight},
    truth::{SceneFrame, Truth},
};
use glam::DVec3;

/// Lamps that are farther away than this from the probe count as infinitely far, metres.
const FARTHEST_M: f64 = 2.5;
/// A strong light farther than this from a lamp's direction is not this lamp, degrees.
const SAME_LAMP_DEG: f64 = 5.0;

/// One lamp in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LampDistance {
    /// Relative error of the distance in percent; `None` when no strong light is there.
    pub error_percent: Option<f64>,
    /// Whether the run said that something told it the distance.
    pub is_told: bool,
}

/// Compares every lamp of every frame within reach; empty for a truth without lamps or without a map at the probe.
pub fn measure(outputs: &Outputs, truth: &Truth) -> Vec<LampDistance> {
    let Some(probe_m) = truth.probe_m() else {
        return Vec::new();
    };
    let of_frame = |frame: &SceneFrame| -> Vec<LampDistance> {
        let found = outputs.frame(frame.index).map_or(&[][..], |entry| &entry.strong_lights);
        let lamps = frame.lamps_m.iter().map(|&lamp_m| lamp_m - probe_m);
        lamps
            .filter(|lamp_m| lamp_m.length() < FARTHEST_M)
            .map(|lamp_m| compare(found, lamp_m))
            .collect()
    };
    truth.scene_frames.iter().flat_map(of_frame).collect()
}

/// Compares one lamp, given from the probe, with the light that is brightest of those in its direction.
fn compare(found: &[StrongLight], lamp_m: DVec3) -> LampDistance {
    let green = |light: &StrongLight| light.irradiance[1];
    let lamp = found
        .iter()
        .filter(|light| angle_deg(light.direction, lamp_m.normalize()) < SAME_LAMP_DEG)
        .max_by(|a, b| green(a).total_cmp(&green(b)));
    LampDistance {
        error_percent: lamp.map(|light| 100.0 * (light.distance_m / lamp_m.length() - 1.0).abs()),
        is_told: lamp.is_some_and(|light| light.distance_sigma.is_some()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brightest_light_in_the_direction_of_the_lamp_is_compared() {
        let light = |direction: DVec3, distance_m: f64, irradiance: f32| StrongLight {
            direction: direction.normalize(),
            distance_m,
            distance_sigma: Some(0.1),
            irradiance: [irradiance; 3],
        };
        let found = [
            light(DVec3::new(0.0, 0.01, 1.0), 1.1, 5.0),
            light(DVec3::new(0.0, 0.0, 1.0), 2.0, 0.1),
            light(DVec3::X, 1.0, 9.0),
        ];
        let lamp = compare(&found, DVec3::Z);
        assert!((lamp.error_percent.unwrap() - 10.0).abs() < 1e-9 && lamp.is_told);
        let missed = compare(&found, DVec3::NEG_Y);
        assert_eq!((missed.error_percent, missed.is_told), (None, false));
    }
}
