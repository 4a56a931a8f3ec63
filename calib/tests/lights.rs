//! Lights of a map: energy, flicker, what happens when lamps are switched, move and cross, and how the methods compare.

mod rooms;

use std::collections::BTreeMap;

use glam::Vec3;
use mirrorball_calib::lights::{KeyLight, LightCounts, LightMethod, LightTracker};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_calib::probe::radiance::luminance;
use proptest::prelude::*;
use rooms::{Camera, Lamp, Room, SIZE};

const COUNTS: LightCounts = LightCounts { dome: 48, bright: 16 };
/// Frames in which lights may still settle.
const SKIPPED: usize = 5;
/// Number of the first light that is no dome light.
const FIRST_FOLLOWER: u32 = COUNTS.dome;

fn tracker(method: LightMethod) -> LightTracker {
    LightTracker::new(method, &Cube::filled(32, true), COUNTS)
}

fn update(tracker: &mut LightTracker, map: &Cube<Vec3>) -> Vec<KeyLight> {
    tracker.update(map, &Cube::filled(SIZE, 2.0)).to_vec()
}

/// The light that follows something, and is nearest to a direction.
fn nearest(lights: &[KeyLight], direction: Vec3) -> &KeyLight {
    lights
        .iter()
        .filter(|light| light.id >= FIRST_FOLLOWER)
        .min_by(|a, b| {
            let off = |l: &KeyLight| l.direction.angle_between(direction);
            off(a).total_cmp(&off(b))
        })
        .expect("a light")
}

fn power(lights: &[KeyLight]) -> f32 {
    lights.iter().map(|light| luminance(light.irradiance)).sum()
}

/// Root mean square deviation over frames of a light's power, relative, and of its direction, in degrees.
fn flicker(frames: &[KeyLight]) -> (f32, f32) {
    let n = frames.len() as f32;
    let mean_power = power(frames) / n;
    let mean_direction = frames.iter().map(|l| l.direction).sum::<Vec3>().normalize();
    let squares = |f: &dyn Fn(&KeyLight) -> f32| (frames.iter().map(|l| f(l).powi(2)).sum::<f32>() / n).sqrt();
    let relative_power = squares(&|l| luminance(l.irradiance) / mean_power - 1.0);
    // A chord of unit vectors: the angle between is lost to rounding below 0.03°.
    let direction_rad = squares(&|l| (l.direction - mean_direction).length());
    (relative_power, direction_rad.to_degrees())
}

/// Follows a still room through frames, the first few left out; gives the lights by number.
fn still(method: LightMethod, frames: &[Cube<Vec3>]) -> BTreeMap<u32, Vec<KeyLight>> {
    let mut tracker = tracker(method);
    let mut lights: BTreeMap<u32, Vec<KeyLight>> = BTreeMap::new();
    for (number, frame) in frames.iter().enumerate() {
        for light in update(&mut tracker, frame) {
            if number >= SKIPPED {
                lights.entry(light.id).or_default().push(light);
            }
        }
    }
    lights
}

/// What the camera sees of a still room.
fn frames(room: &Room, n: usize) -> Vec<Cube<Vec3>> {
    let (camera, truth) = (Camera::default(), room.map());
    (0..n + SKIPPED)
        .map(|frame| camera.sees(&truth, room.put_back, frame as u64))
        .collect()
}

/// Worst flicker of lights that have at least a thousandth of the power.
fn worst_flicker(lights: &BTreeMap<u32, Vec<KeyLight>>) -> (f32, f32) {
    let total: f32 = lights.values().map(|frames| power(frames)).sum();
    lights
        .values()
        .filter(|frames| power(frames) > 1e-3 * total)
        .map(|frames| flicker(frames))
        .fold((0.0, 0.0), |worst, one| (worst.0.max(one.0), worst.1.max(one.1)))
}

#[test]
fn camera_noise_makes_no_light_flicker() {
    const FRAMES: usize = 60;
    for room in Room::all() {
        let seen = frames(&room, FRAMES);
        if room.name == "window" {
            let flipped = |(a, b): &(&Vec3, &Vec3)| a.y > 2.0 * b.y || b.y > 2.0 * a.y;
            let n_flipped = seen[0].texels().iter().zip(seen[1].texels()).filter(flipped).count();
            assert!(n_flipped > 20, "only {n_flipped} texels flip");
        }
        let lights = still(LightMethod::Stable, &seen);
        let changing: Vec<u32> = (lights.iter().filter(|(_, frames)| frames.len() != FRAMES))
            .map(|(id, _)| *id)
            .collect();
        assert!(changing.is_empty(), "{}: lights {changing:?} came or went", room.name);
        let (power, direction_deg) = worst_flicker(&lights);
        println!(
            "{}: {} lights, {:.2} % {direction_deg:.3}°",
            room.name,
            lights.len(),
            100.0 * power
        );
        assert!(power <= 0.01, "{}: power flickers by {:.2} %", room.name, 100.0 * power);
        assert!(
            direction_deg <= 0.2,
            "{}: direction flickers by {direction_deg}°",
            room.name
        );
    }
}

#[test]
fn a_lamp_switched_off_and_on_shows_within_two_frames_and_keeps_its_number() {
    let lamp = Vec3::new(0.3, -0.5, 0.8).normalize();
    let lit = Room::window().with(Lamp::round(lamp, 2.0, 400.0));
    let (on, off) = (lit.map(), Room::window().map());
    let camera = Camera::default();
    let mut tracker = tracker(LightMethod::Stable);
    let mut frame = 0;
    let mut see = |map: &Cube<Vec3>| {
        frame += 1;
        update(&mut tracker, &camera.sees(map, lit.put_back, frame))
    };
    let before = (0..10).map(|_| see(&on)).last().expect("frames");
    let id = nearest(&before, lamp).id;
    let lamp_power = luminance(nearest(&before, lamp).irradiance);
    let is_lit = |lights: &[KeyLight]| {
        lights.iter().any(|l| {
            l.direction.angle_between(lamp) < 0.5f32.to_radians() && luminance(l.irradiance) > 0.9 * lamp_power
        })
    };
    assert!(is_lit(&before));
    for _ in 0..3 {
        see(&off);
        let dark = see(&off);
        let left: f32 = (dark.iter().filter(|l| l.direction.angle_between(lamp) < 0.1))
            .map(|l| luminance(l.irradiance))
            .sum();
        assert!(left < 0.01 * lamp_power, "{left} of {lamp_power} left");
        see(&on);
        let back = see(&on);
        assert!(is_lit(&back));
        assert_eq!(nearest(&back, lamp).id, id);
    }
    // The others are untouched by the lamp.
    for light in before.iter().filter(|l| l.id >= FIRST_FOLLOWER && l.id != id) {
        let dark = see(&off);
        let same = dark.iter().find(|l| l.id == light.id).expect("still there");
        assert!((luminance(same.irradiance) / luminance(light.irradiance) - 1.0).abs() < 0.05);
    }
}

/// Direction after turning by `degrees` about z from +x, at some height.
fn around(degrees: f32, height: f32) -> Vec3 {
    let (sin, cos) = degrees.to_radians().sin_cos();
    Vec3::new(cos, sin, height).normalize()
}

#[test]
fn a_moving_lamp_is_followed_under_its_number() {
    for (speed_deg, radius_deg) in [(0.5, 3.0), (1.5, 2.0), (3.0, 3.0), (6.0, 2.0)] {
        let camera = Camera::default();
        let mut tracker = tracker(LightMethod::Stable);
        let place = |frame: u64| around(-60.0 + speed_deg * frame.saturating_sub(5) as f32, 0.5);
        let mut id = None;
        for frame in 0..35 {
            let room = Room::dim().with(Lamp::round(place(frame), radius_deg, 300.0));
            let lights = update(&mut tracker, &camera.sees(&room.map(), room.put_back, frame));
            let light = nearest(&lights, place(frame));
            let behind_deg = light.direction.angle_between(place(frame)).to_degrees();
            // The height makes the step a little smaller than the turn.
            let allowed_deg = (0.95 * speed_deg).max(0.3);
            assert!(
                behind_deg < allowed_deg,
                "{speed_deg}°: frame {frame}: {behind_deg}° behind"
            );
            assert_eq!(*id.get_or_insert(light.id), light.id, "{speed_deg}°: frame {frame}");
            let followers = lights.iter().filter(|l| l.id >= FIRST_FOLLOWER).count();
            assert_eq!(followers, 1, "{speed_deg}°: frame {frame}");
        }
    }
}

#[test]
fn crossing_lamps_keep_their_numbers_and_colours() {
    for (red, blue) in [(300.0, 300.0), (300.0, 150.0)] {
        for height in [0.5, 0.52] {
            // Nothing clips: the colours are seen.
            let camera = Camera {
                clips_at: 400.0,
                ..Camera::default()
            };
            let mut tracker = tracker(LightMethod::Stable);
            let places = |frame: u64| {
                let turn = frame.saturating_sub(3) as f32 * 1.2;
                [around(-20.0 + turn, 0.5), around(20.0 - turn, height)]
            };
            let mut ids = None;
            for frame in 0..38 {
                let [one, other] = places(frame);
                let room = Room::dim()
                    .with(Lamp::round(one, 2.0, red).tinted(Vec3::new(1.0, 0.3, 0.1)))
                    .with(Lamp::round(other, 2.0, blue).tinted(Vec3::new(0.1, 0.3, 1.0)));
                let lights = update(&mut tracker, &camera.sees(&room.map(), room.put_back, frame));
                let found = [nearest(&lights, one).id, nearest(&lights, other).id];
                let apart_deg = one.angle_between(other).to_degrees();
                if apart_deg > 6.0 {
                    assert_eq!(*ids.get_or_insert(found), found, "frame {frame}");
                    let tint = nearest(&lights, one).irradiance;
                    assert!(tint.x > 2.0 * tint.z, "frame {frame}: {tint}");
                }
            }
        }
    }
}

#[test]
fn a_light_stands_where_its_texels_stand() {
    let lamp = Vec3::new(0.5, 0.1, 0.8).normalize();
    let room = Room::dim().with(Lamp::round(lamp, 3.0, 200.0));
    let mut distance_m = Cube::filled(SIZE, 4.0);
    for index in 0..distance_m.texels().len() {
        if distance_m.direction(index).angle_between(lamp) < 5f32.to_radians() {
            distance_m.texels_mut()[index] = 1.5;
        }
    }
    for method in [LightMethod::Stable, LightMethod::Regions] {
        let mut tracker = tracker(method);
        let lights = tracker.update(&room.map(), &distance_m);
        let light = nearest(lights, lamp);
        assert!((light.distance_m - 1.5).abs() < 0.02, "{light:?}");
        // Half a texel more, where the size is that of all texels that the lamp touches.
        assert!(
            (light.angular_radius_rad - 3f32.to_radians()).abs() < 0.009,
            "{light:?}"
        );
        assert!(
            (luminance(light.radiance()) / 200.0 - 1.0).abs() < 0.3,
            "{}",
            light.radiance()
        );
        let far = lights.iter().filter(|l| l.direction.angle_between(lamp) > 1.0);
        assert!(far.into_iter().all(|l| (l.distance_m - 4.0).abs() < 1e-3));
        let infinite = tracker.update(&room.map(), &Cube::filled(8, f32::INFINITY));
        assert!(infinite.iter().all(|l| l.distance_m > 4.0));
    }
}

#[test]
fn black_closed_and_broken_maps_give_dark_lights() {
    for method in LightMethod::ALL {
        for value in [Vec3::ZERO, Vec3::NAN, Vec3::NEG_ONE, Vec3::INFINITY] {
            let lights = update(&mut tracker(method), &Cube::filled(32, value));
            assert!(
                lights
                    .iter()
                    .all(|l| l.irradiance == Vec3::ZERO && l.direction.is_normalized()),
                "{method:?}"
            );
        }
        let mut closed = LightTracker::new(method, &Cube::filled(8, false), COUNTS);
        assert!(
            closed
                .update(&Cube::filled(32, Vec3::ONE), &Cube::filled(8, 1.0))
                .is_empty()
        );
    }
}

/// Irradiance on surfaces with normals all around.
fn irradiances(normals: &[Vec3], lights: impl Iterator<Item = (Vec3, f32)>) -> Vec<f32> {
    let mut sums = vec![0.0; normals.len()];
    for (direction, power) in lights {
        for (sum, normal) in sums.iter_mut().zip(normals) {
            *sum += power * direction.dot(*normal).max(0.0);
        }
    }
    sums
}

/// Mean over normals of the error of the lights' irradiance against the map's, over the mean irradiance.
fn irradiance_error(map: &Cube<Vec3>, lights: &[KeyLight]) -> f32 {
    let shape = Cube::filled(4, ());
    let normals: Vec<Vec3> = (0..shape.texels().len()).map(|index| shape.direction(index)).collect();
    let texels = map.texels().iter().enumerate();
    let texels = texels.map(|(i, value)| (map.direction(i), luminance(*value) * map.solid_angle(i)));
    let expected = irradiances(&normals, texels);
    let found = irradiances(&normals, lights.iter().map(|l| (l.direction, luminance(l.irradiance))));
    let error: f32 = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).sum();
    error / expected.iter().sum::<f32>()
}

/// Prints what the documents quote: `cargo test -p mirrorball-calib --test lights -- --nocapture compared`.
#[test]
fn the_methods_compared() {
    println!("room      method       lights  irradiance %  flicker power %  direction deg");
    for room in Room::all() {
        let map = room.map();
        let frames = frames(&room, 20);
        for method in LightMethod::ALL {
            let lights = update(&mut tracker(method), &map);
            let error = irradiance_error(&map, &lights);
            let (power, direction_deg) = worst_flicker(&still(method, &frames));
            println!(
                "{:<8}  {:<11}  {:>6}  {:>12.2}  {:>15.2}  {direction_deg:>13.3}",
                room.name,
                method.name(),
                lights.len(),
                100.0 * error,
                100.0 * power,
            );
            // One light for a whole overcast sky is what the regions' way gives.
            let allowed = match method {
                LightMethod::Stable | LightMethod::MedianCut => 0.015,
                LightMethod::Regions => 0.2,
            };
            assert!(error < allowed, "{} {method:?}: {error}", room.name);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn all_energy_is_in_the_lights(
        lamps in prop::collection::vec(
            (-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0, 0.3f32..25.0, 0.5f32..3000.0), 0..7,
        ),
        speed in -8.0f32..8.0,
        dome in 0u32..60,
        bright in 0u32..20,
        floor in -1.2f32..1.0,
        size in 3u32..40,
    ) {
        let mut open = Cube::filled(24, true);
        for index in 0..open.texels().len() {
            open.texels_mut()[index] = open.direction(index).z > floor;
        }
        for method in LightMethod::ALL {
            let mut tracker = LightTracker::new(method, &open, LightCounts { dome, bright });
            for frame in 0..6 {
                let mut map = Cube::filled(size, Vec3::new(0.1, 0.2, 0.0));
                for (number, &(x, y, z, radius_deg, radiance)) in lamps.iter().enumerate() {
                    // Every other lamp is off in every other frame.
                    if (number + frame) % 2 == 0 || number % 2 == 0 {
                        let turn = glam::Quat::from_rotation_z((speed * frame as f32).to_radians());
                        let lamp = turn * Vec3::new(x, y, z).normalize_or(Vec3::X);
                        for index in 0..map.texels().len() {
                            if map.direction(index).angle_between(lamp) < radius_deg.to_radians() {
                                map.texels_mut()[index] += radiance * Vec3::new(1.0, x.abs(), 0.0);
                            }
                        }
                    }
                }
                let expected: Vec3 = (0..map.texels().len())
                    .filter(|&index| open.nearest(map.direction(index)))
                    .map(|index| map.texels()[index] * map.solid_angle(index))
                    .sum();
                let lights = tracker.update(&map, &Cube::filled(2, 1.0));
                let found: Vec3 = lights.iter().map(|l| l.irradiance).sum();
                prop_assert!(
                    (found - expected).abs().max_element() <= 2e-4 * expected.max_element(),
                    "{method:?} frame {frame}: {found} of {expected}"
                );
                let mut ids: Vec<u32> = lights.iter().map(|l| l.id).collect();
                ids.sort_unstable();
                ids.dedup();
                prop_assert_eq!(ids.len(), lights.len());
                prop_assert!(lights.len() <= (dome.max(1) + bright) as usize);
                prop_assert!(lights.iter().all(|l| l.direction.is_normalized() && l.distance_m > 0.0));
            }
        }
    }
}
