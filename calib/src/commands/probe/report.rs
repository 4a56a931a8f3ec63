//! The figures of a measured map, as text and as JSON.

use std::fmt::Write;

use glam::Vec3;
use mirrorball_calib::{
    lights::{KeyLight, LightMethod},
    probe::radiance::luminance,
};
use serde::Serialize;

use super::measure::Measured;
use super::taken::Taken;
use mirrorball_calib::probe::radiance_map::Seen;

/// A light of the map.
#[derive(Debug, Clone, Copy)]
pub(super) struct FoundLight {
    pub(super) light: KeyLight,
    pub(super) is_dome: bool,
    /// Whether it is at least this bright: a channel is clipped where it shines from.
    pub(super) is_clipped: bool,
}

impl FoundLight {
    pub(super) fn new(light: &KeyLight, is_dome: bool, measured: &Measured) -> Self {
        let seen = measured.texels.nearest(light.direction);
        Self {
            light: *light,
            is_dome,
            is_clipped: !is_dome && seen.is_some_and(|seen| seen.clipped_everywhere != 0),
        }
    }

    /// Luminance of its irradiance.
    pub(super) fn power(&self) -> f32 {
        luminance(self.light.irradiance)
    }
}

/// What there is to say of a map.
pub(super) struct Figures {
    /// Share of the sphere that was seen.
    pub(super) seen: f32,
    /// Share of what was seen in which red, green or blue clips.
    pub(super) clipped: [f32; 3],
    /// Mean quality of what was seen.
    pub(super) quality: f32,
    /// Those on bright regions first, from strong to weak.
    pub(super) lights: Vec<FoundLight>,
}

impl Figures {
    pub(super) fn of(measured: &Measured, lights: Vec<FoundLight>) -> Self {
        let seen = measured.share(|seen| f32::from(seen.is_some()));
        let of_seen = |weight: &dyn Fn(Seen) -> f32| {
            measured.share(|seen| seen.map_or(0.0, weight)) / seen.max(f32::MIN_POSITIVE)
        };
        Self {
            seen,
            clipped: [0, 1, 2].map(|channel| of_seen(&|s: Seen| f32::from(s.clipped >> channel & 1))),
            quality: of_seen(&|s: Seen| s.quality),
            lights,
        }
    }

    /// Luminance of the irradiance of all lights.
    pub(super) fn power(&self) -> f32 {
        self.lights.iter().map(FoundLight::power).sum()
    }

    /// Share of all light that the dome gives.
    pub(super) fn dome_share(&self) -> f32 {
        let dome: f32 = (self.lights.iter().filter(|l| l.is_dome)).map(FoundLight::power).sum();
        dome / self.power().max(f32::MIN_POSITIVE)
    }

    /// The lights on bright regions.
    pub(super) fn bright(&self) -> impl Iterator<Item = &FoundLight> {
        self.lights.iter().filter(|light| !light.is_dome)
    }
}

/// The figures as lines for people.
pub(super) fn text(pictures: &[Taken<'_>], measured: &Measured, figures: &Figures, method: LightMethod) -> String {
    let mut text = String::new();
    for taken in pictures {
        let exposure = &taken.frame.meta.exposure;
        let [r, g, b] = exposure.white_balance;
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{}: camera {}, exposure {} s, gain {}, white balance {r} {g} {b}",
            taken.file.display(),
            taken.camera.name,
            exposure.time_s,
            exposure.gain,
        );
    }
    let [red, green, blue] = figures.clipped.map(|share| 100.0 * share);
    let seen = 100.0 * figures.seen;
    let _ = writeln!(
        text,
        "seen {seen:.1} % of all directions (filled {:.1} %); of it clipped: red {red:.2} % green {green:.2} % blue \
         {blue:.2} %; mean quality {:.2}",
        100.0 - seen,
        figures.quality,
    );
    if let Some(error) = measured.reprojection_error_px {
        let _ = writeln!(text, "camera located by markers, reprojection error {error:.3} px");
    }
    if figures.clipped.iter().any(|share| *share > 0.0) {
        text += "what is clipped counts as bright as it looks: lights may be missing, a shorter exposure shows them\n";
    }
    let n_bright = figures.bright().count();
    let _ = writeln!(
        text,
        "{n_bright} lights ({}), {} in the dome with {:.1} % of the light",
        method.name(),
        figures.lights.len() - n_bright,
        100.0 * figures.dome_share(),
    );
    text += "  #   direction x      y      z   height°  radius°   share %   irradiance r          g          b\n";
    for (number, light) in (1..).zip(figures.bright()) {
        text += &line(number, light, figures.power());
    }
    text
}

fn line(number: usize, found: &FoundLight, total: f32) -> String {
    let KeyLight {
        direction: d,
        irradiance: e,
        angular_radius_rad,
        ..
    } = found.light;
    let clipped = if found.is_clipped { "  clipped: at least" } else { "" };
    format!(
        "{number:>3}   {:>11.4} {:>6.3} {:>6.3}   {:>7.2}  {:>7.2}   {:>7.2}   {:>12.5} {:>10.5} {:>10.5}{clipped}\n",
        d.x,
        d.y,
        d.z,
        height_deg(d),
        angular_radius_rad.to_degrees(),
        100.0 * found.power() / total.max(f32::MIN_POSITIVE),
        e.x,
        e.y,
        e.z,
    )
}

/// Angle above the horizon, degrees.
pub(super) fn height_deg(direction: Vec3) -> f32 {
    direction.z.clamp(-1.0, 1.0).asin().to_degrees()
}

/// The object of `--json`; its keys are an interface.
#[derive(Serialize)]
struct Report<'a> {
    pictures: Vec<PictureEntry>,
    camera: &'a str,
    camera_from_world: [[f64; 4]; 4],
    reprojection_error_px: Option<f64>,
    position_m: [f64; 3],
    seen: f32,
    filled: f32,
    clipped: [f32; 3],
    quality: f32,
    method: &'static str,
    dome_share: f32,
    lights: Vec<LightEntry>,
}

#[derive(Serialize)]
struct PictureEntry {
    file: String,
    exposure_s: f64,
    gain: f64,
    white_balance: [f64; 3],
}

#[derive(Serialize)]
struct LightEntry {
    id: u32,
    is_dome: bool,
    direction: [f32; 3],
    angular_radius_rad: f32,
    irradiance: [f32; 3],
    radiance: [f32; 3],
    share: f32,
    is_clipped: bool,
}

/// The figures as one JSON object.
pub(super) fn json(
    pictures: &[Taken<'_>],
    measured: &Measured,
    figures: &Figures,
    method: LightMethod,
) -> serde_json::Result<String> {
    let power = figures.power().max(f32::MIN_POSITIVE);
    let light = |found: &FoundLight| LightEntry {
        id: found.light.id,
        is_dome: found.is_dome,
        direction: found.light.direction.to_array(),
        angular_radius_rad: found.light.angular_radius_rad,
        irradiance: found.light.irradiance.to_array(),
        radiance: found.light.radiance().to_array(),
        share: found.power() / power,
        is_clipped: found.is_clipped,
    };
    let picture = |taken: &Taken<'_>| PictureEntry {
        file: taken.file.display().to_string(),
        exposure_s: taken.frame.meta.exposure.time_s,
        gain: taken.frame.meta.exposure.gain,
        white_balance: taken.frame.meta.exposure.white_balance,
    };
    let report = Report {
        pictures: pictures.iter().map(picture).collect(),
        camera: pictures.first().map_or("", |taken| &taken.camera.name),
        camera_from_world: measured.camera_from_world.to_rows4(),
        reprojection_error_px: measured.reprojection_error_px,
        position_m: measured.position_m.to_array(),
        seen: figures.seen,
        filled: 1.0 - figures.seen,
        clipped: figures.clipped,
        quality: figures.quality,
        method: method.name(),
        dome_share: figures.dome_share(),
        lights: figures.lights.iter().map(light).collect(),
    };
    Ok(serde_json::to_string(&report)? + "\n")
}
