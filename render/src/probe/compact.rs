//! Lamps that a few clipped pixels show: where exactly, and how large.
//!
//! A lamp far above the clipping level clips every pixel that it touches, so what the picture shows is the lamp grown by
//! about half a pixel all round, as a set of pixels. Near a ball's rim a pixel covers many times the solid angle of one in
//! the middle, so the lamp is found in the picture, where it grew evenly, and only then turned into a direction: the middle
//! of the clipped pixels, and a disc of their area less the half pixel.

use std::collections::HashSet;
use std::f64::consts::PI;

use glam::{DVec2, DVec3, Vec3};
use mirrorball_calib::probe::View;
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::mapping::{LightSphere, ProbeMap};

/// A lamp with more clipped pixels than this has a shape of its own.
const MOST_PIXELS: usize = 60;
/// By how much the touched pixels reach beyond the lamp on all sides, pixels.
const GROWN_PX: f64 = 0.5;
/// Radius of the smallest lamp, pixels: a lamp between two pixels' centres clips both.
const LEAST_PX: f64 = 0.3;
/// Pixels around the expected place in which the lamp is looked for.
const REACH_PX: i32 = 4;

/// A small lamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CompactLamp {
    /// Unit direction from the place that light is measured for.
    pub(super) direction: Vec3,
    /// Solid angle, steradians.
    pub(super) area_sr: f32,
}

/// Finds the lamp that shows around `direction` at `sphere.distance_m`; `None` where nothing clips, or too much does.
pub(super) fn locate(
    view: &View<'_>,
    map: &ProbeMap<'_>,
    direction: DVec3,
    sphere: &LightSphere,
) -> Option<CompactLamp> {
    let expected = map.place(sphere.origin_m + direction * sphere.distance_m)?.pixel;
    let pixels = clipped_around(view, expected)?;
    let n = pixels.len() as f64;
    let middle = pixels
        .iter()
        .fold(DVec2::ZERO, |sum, &(x, y)| sum + DVec2::new(f64::from(x), f64::from(y)))
        / n;
    let light = map.light(middle, sphere)?;
    let radius_px = ((n / PI).sqrt() - GROWN_PX).max(LEAST_PX);
    Some(CompactLamp {
        direction: light.direction.as_vec3(),
        area_sr: (PI * radius_px * radius_px * light.solid_angle_per_pixel) as f32,
    })
}

/// The connected clipped pixels nearest to a place.
fn clipped_around(view: &View<'_>, place: DVec2) -> Option<Vec<(i32, i32)>> {
    let is_clipped = |&(x, y): &(i32, i32)| {
        let pixel = DVec2::new(f64::from(x), f64::from(y));
        view.picture.sample(pixel).is_some_and(|sample| sample.clipped != 0)
    };
    let middle = (place.x.round() as i32, place.y.round() as i32);
    let around = (-REACH_PX..=REACH_PX).flat_map(|dy| (-REACH_PX..=REACH_PX).map(move |dx| (dx, dy)));
    let start = around
        .map(|(dx, dy)| (middle.0 + dx, middle.1 + dy))
        .filter(is_clipped)
        .min_by_key(|(x, y)| (x - middle.0).pow(2) + (y - middle.1).pow(2))?;
    let mut pixels = vec![start];
    let mut seen = HashSet::from([start]);
    let mut next = 0;
    while let Some(&(x, y)) = pixels.get(next) {
        next += 1;
        for neighbour in [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)] {
            if seen.insert(neighbour) && is_clipped(&neighbour) {
                pixels.push(neighbour);
            }
        }
        if pixels.len() > MOST_PIXELS {
            return None;
        }
    }
    Some(pixels)
}

/// The texels that a lamp covers, nearest to its middle first: as many as have its solid angle, one at least.
pub(super) fn texels_of(lamp: &CompactLamp, cube: &Cube<Vec3>) -> Vec<usize> {
    let first = cube.index_of(lamp.direction);
    let steps = (lamp.area_sr.sqrt() * cube.size() as f32).ceil() as usize + 1;
    let mut near = super::clipped::grown(cube, &[first], steps);
    let cosine = |i: &usize| cube.direction(*i).dot(lamp.direction);
    near.sort_by(|a, b| cosine(b).total_cmp(&cosine(a)));
    let mut area_sr = 0.0;
    let n = near
        .iter()
        .take_while(|&&i| {
            let is_in = area_sr < lamp.area_sr;
            area_sr += cube.solid_angle(i);
            is_in
        })
        .count();
    near.truncate(n.max(1));
    near
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lamp_covers_texels_of_its_solid_angle_around_its_middle() {
        let cube = Cube::filled(128, Vec3::ZERO);
        let lamp = CompactLamp {
            direction: Vec3::new(0.98, 0.99, 0.3).normalize(),
            area_sr: 0.01,
        };
        let texels = texels_of(&lamp, &cube);
        let area_sr: f32 = texels.iter().map(|&i| cube.solid_angle(i)).sum();
        let middle: Vec3 = texels.iter().map(|&i| cube.direction(i) * cube.solid_angle(i)).sum();
        assert!((area_sr / 0.01 - 1.0).abs() < 0.02, "{area_sr}");
        assert!(middle.normalize().angle_between(lamp.direction) < 0.2f32.to_radians());
    }
}
