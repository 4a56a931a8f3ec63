//! Error of the environment maps against the true ones, at the light probe and at the virtual objects.

use crate::{
    ToolError,
    brightest_light::{BrightestLight, angle_deg, brightest_light},
    environment_map::{EnvironmentMap, Sphere, luminance},
    irradiance::{self, IrradianceError},
    outputs::Outputs,
    statistics::median,
    truth::{Environment, Truth},
};
use glam::Vec3;
use serde::Serialize;

/// Least z of directions that count as above the table: 2.9° over the horizon, clear of the table's edge.
const ABOVE_TABLE_Z: f32 = 0.05;
/// A map and a frame belong together when their times differ by less, in seconds.
const SAME_TIME_S: f64 = 1e-6;

/// Environment error at one place.
#[derive(Clone, Debug, Serialize)]
pub struct EnvironmentError {
    /// `ball`, `fisheye` or the name of a virtual object.
    pub at: String,
    /// Whether this is the place of the light probe.
    pub is_probe: bool,
    /// Radius in degrees of the brightest light in the true map; `None` in the dark.
    pub true_light_radius_deg: Option<f64>,
    /// Every compared frame; empty when the run wrote no map of this place.
    pub frames: Vec<FrameEnvironmentError>,
}

/// Environment error at one place in one frame.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FrameEnvironmentError {
    /// Sequence number of the scene frame.
    pub frame: u32,
    /// Angle between the brightest lights in degrees; 180 when the found map has none, `None` when the true one has none.
    pub light_deg: Option<f64>,
    /// Error of the irradiance.
    pub irradiance: IrradianceError,
    /// Median relative error in percent of the luminance of directions above the table that did not clip in the probe
    /// camera; `None` when all clipped, or at an object.
    pub unclipped_percent: Option<f64>,
}

impl EnvironmentError {
    /// Returns the median over frames of a figure; `None` when it was not measured.
    pub fn median(&self, figure: impl Fn(&FrameEnvironmentError) -> Option<f64>) -> Option<f64> {
        median(self.frames.iter().filter_map(figure).collect())
    }

    /// Returns the worst frame's figure; `None` when it was not measured.
    pub fn worst(&self, figure: impl Fn(&FrameEnvironmentError) -> Option<f64>) -> Option<f64> {
        self.frames.iter().filter_map(figure).max_by(f64::total_cmp)
    }
}

/// What the comparison needs of a true map, computed once.
struct TrueEnvironment {
    map: EnvironmentMap,
    light: Option<BrightestLight>,
    irradiance: Vec<[f32; 3]>,
}

/// Compares every map the run wrote that has a true one, place by place in the order of the truth.
///
/// # Errors
/// When a map exists and cannot be read.
pub fn measure(outputs: &Outputs, truth: &Truth) -> Result<Vec<EnvironmentError>, ToolError> {
    let (sphere, normals) = (Sphere::new(), irradiance::normals());
    let mut places: Vec<EnvironmentError> = Vec::new();
    for environment in truth
        .environments
        .iter()
        .filter(|environment| has_output(environment, truth))
    {
        let map = EnvironmentMap::load(&truth.environment_path(environment))?;
        let true_environment = TrueEnvironment {
            light: brightest_light(&map, &sphere),
            irradiance: irradiance::irradiance(&map, &sphere, &normals),
            map,
        };
        let is_probe = environment.at == truth.probe_position();
        let mut frames = Vec::new();
        for (frame, timestamp_s) in frames_of(environment, truth) {
            let path = outputs.environment_path(frame, (!is_probe).then_some(&environment.at));
            if !path.exists() {
                continue;
            }
            let found = EnvironmentMap::load(&path)?;
            let clipping_radiance = is_probe.then(|| truth.clipping_radiance(timestamp_s));
            frames.push(FrameEnvironmentError {
                unclipped_percent: clipping_radiance
                    .and_then(|clipping| unclipped_error(&found, &true_environment.map, &sphere, clipping)),
                ..compare(frame, &found, &true_environment, (&sphere, &normals))
            });
        }
        match places.iter_mut().find(|place| place.at == environment.at) {
            Some(place) => place.frames.extend(frames),
            None => places.push(EnvironmentError {
                at: environment.at.clone(),
                is_probe,
                true_light_radius_deg: true_environment.light.map(|light| light.radius_deg),
                frames,
            }),
        }
    }
    // The probe first, then the objects as listed.
    places.sort_by_key(|place| !place.is_probe);
    Ok(places)
}

/// Tells whether the render node writes a map of this place: at the probe and at virtual objects, not at a ball that a
/// rig with a fisheye camera does not use.
fn has_output(environment: &Environment, truth: &Truth) -> bool {
    environment.at == truth.probe_position() || truth.virtual_objects.iter().any(|object| object.name == environment.at)
}

/// Returns sequence numbers and times of the scene frames for which a true map holds.
fn frames_of<'a>(environment: &'a Environment, truth: &'a Truth) -> impl Iterator<Item = (u32, f64)> + 'a {
    let holds = |timestamp_s: f64| {
        environment.valid_for_all_frames || (timestamp_s - environment.timestamp_s).abs() < SAME_TIME_S
    };
    truth
        .scene_frames
        .iter()
        .map(|frame| (frame.index, frame.timestamp_s))
        .filter(move |(_, time_s)| holds(*time_s))
}

/// Compares lights and irradiance of one map.
fn compare(
    frame: u32,
    found: &EnvironmentMap,
    truth: &TrueEnvironment,
    (sphere, normals): (&Sphere, &[Vec3]),
) -> FrameEnvironmentError {
    let light_deg = truth.light.map(|true_light| {
        brightest_light(found, sphere).map_or(180.0, |light| angle_deg(light.direction, true_light.direction))
    });
    FrameEnvironmentError {
        frame,
        light_deg,
        irradiance: irradiance::compare(
            &irradiance::irradiance(found, sphere, normals),
            &truth.irradiance,
            normals,
        ),
        unclipped_percent: None,
    }
}

/// Returns the median relative luminance error in percent over the directions above the table whose true radiance is
/// below the clipping radiance in every channel; `None` when there are none.
pub fn unclipped_error(
    found: &EnvironmentMap,
    truth: &EnvironmentMap,
    sphere: &Sphere,
    clipping_radiance: f64,
) -> Option<f64> {
    let texels = found.radiance.iter().zip(&truth.radiance).zip(&sphere.directions);
    let unclipped = texels.filter(|((_, truth), direction)| {
        let brightest = truth.iter().copied().fold(0.0, f32::max);
        direction.z > ABOVE_TABLE_Z && brightest > 0.0 && f64::from(brightest) < clipping_radiance
    });
    median(
        unclipped
            .map(|((&found, &truth), _)| 100.0 * (luminance(found) - luminance(truth)).abs() / luminance(truth))
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_unclipped_directions_above_the_table_count() {
        let sphere = Sphere::new();
        let truth = EnvironmentMap::from_fn(&sphere, |d| [if d.x > 0.0 { 5.0 } else { 0.5 }; 3]);
        let found = EnvironmentMap::from_fn(&sphere, |d| match (d.z > 0.05, d.x > 0.0) {
            (false, _) => [9.0; 3],
            (true, true) => [1.0; 3],
            (true, false) => [0.54; 3],
        });
        let percent = unclipped_error(&found, &truth, &sphere, 1.0).unwrap();
        assert!((percent - 8.0).abs() < 1e-3, "{percent}");
        assert_eq!(unclipped_error(&found, &truth, &sphere, 0.1), None);
    }
}
