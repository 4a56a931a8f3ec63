//! The picture of a measured map: the map with the lights on it, how it is known, and a list of the lights.

use std::f32::consts::PI;

use glam::{Mat3, Vec3};
use image::{Rgb, RgbImage};
use mirrorball_calib::{
    probe::{
        cube::Cube,
        equirectangular::{HEIGHT, WIDTH, direction},
        radiance::luminance,
    },
    response::ResponseCurve,
};

use super::canvas::{BLACK, Ink, LETTER_PX, LINE_PX, WHITE, fill, put, text};
use super::measure::Measured;
use super::report::{Figures, FoundLight, height_deg};
use mirrorball_calib::probe::radiance_map::Seen;

/// Pixels of the chart per pixel of the equirectangular map, each way.
const SCALE: u32 = 2;
const PANEL_PX: [u32; 2] = [WIDTH as u32 * SCALE, HEIGHT as u32 * SCALE];
/// Most lights in the list, and on the map.
const LISTED: usize = 32;

const GRID: Ink = Rgb([110, 110, 110]);
const FILLED: Ink = Rgb([40, 50, 110]);
const CLIPPED_PARTLY: Ink = Rgb([230, 150, 30]);
const CLIPPED: Ink = Rgb([220, 40, 40]);

/// Draws the chart: titles, the tone-mapped map with axes, horizon and lights, the panel of how it is known, the list.
pub(super) fn draw(measured: &Measured, radiance: &Cube<Vec3>, figures: &Figures) -> RgbImage {
    let n_listed = figures.bright().count().min(LISTED) as u32;
    let line = i64::from(LINE_PX);
    let panel = i64::from(PANEL_PX[1]);
    let mut picture = RgbImage::new(PANEL_PX[0], 2 * PANEL_PX[1] + (4 + n_listed) * LINE_PX);
    text(&mut picture, "radiance, tone-mapped; lights by number", (4, 0), WHITE);
    let map_top = line;
    let tone = ToneCurve::of(radiance);
    paint(&mut picture, map_top, |d| tone.ink(radiance.bilinear(d)));
    axes(&mut picture, map_top);
    for (number, light) in (1..).zip(figures.bright().take(LISTED)) {
        mark(&mut picture, map_top, number, light);
    }

    let key_top = map_top + panel;
    key(&mut picture, key_top, figures);
    let known_top = key_top + line;
    paint(&mut picture, known_top, |d| known_ink(measured.texels.nearest(d)));
    axes(&mut picture, known_top);

    let list_top = known_top + panel;
    let head = format!(
        "{:>3} {:>12} {:>6} {:>6} {:>7} {:>6} {:>9} {:>10} {:>8} {:>8}",
        "#", "direction x", "y", "z", "height", "radius", "share %", "irrad. r", "g", "b"
    );
    text(&mut picture, &head, (4, list_top), WHITE);
    for (number, light) in (1..).zip(figures.bright().take(LISTED)) {
        let top = list_top + line * number as i64;
        text(
            &mut picture,
            &list_line(number, light, figures.power()),
            (4, top),
            light_ink(number),
        );
    }
    let rest = format!(
        "dome {:.1} %; degrees; > is clipped: at least so much",
        100.0 * figures.dome_share()
    );
    text(
        &mut picture,
        &rest,
        (4, list_top + line * i64::from(n_listed + 1)),
        WHITE,
    );
    picture
}

/// Colours a panel by direction.
fn paint(picture: &mut RgbImage, top: i64, ink: impl Fn(Vec3) -> Ink) {
    for y in 0..PANEL_PX[1] {
        for x in 0..PANEL_PX[0] {
            let at = |t: u32| (t as f32 + 0.5) / SCALE as f32 - 0.5;
            put(
                picture,
                (i64::from(x), top + i64::from(y)),
                ink(direction(at(x), at(y))),
            );
        }
    }
}

/// Where a direction lies in a panel, pixels.
fn place(d: Vec3) -> (f32, f32) {
    let column = d.x.atan2(d.y) / (2.0 * PI) + 0.5;
    let row = d.z.clamp(-1.0, 1.0).acos() / PI;
    (column * PANEL_PX[0] as f32, row * PANEL_PX[1] as f32)
}

/// Horizon, the meridians of the axes, heights of 30° and 60°, and their names.
fn axes(picture: &mut RgbImage, top: i64) {
    let [width, height] = PANEL_PX.map(i64::from);
    for row in [height / 6, height / 3, height / 2, height * 2 / 3, height * 5 / 6] {
        let step = if row == height / 2 { 1 } else { 4 };
        (0..width)
            .step_by(step)
            .for_each(|x| put(picture, (x, top + row), GRID));
    }
    for column in [0, width / 4, width / 2, width * 3 / 4] {
        (0..height)
            .step_by(2)
            .for_each(|y| put(picture, (column, top + y), GRID));
    }
    let below = top + height / 2 + 4;
    for (name, column) in [("-y", 0), ("-x", width / 4), ("+y", width / 2), ("+x", width * 3 / 4)] {
        text(picture, name, (column + 4, below), WHITE);
    }
    let right = width - 4 * i64::from(LETTER_PX);
    for (name, row) in [
        ("60°", height / 6),
        ("30°", height / 3),
        ("-30°", height * 2 / 3),
        ("-60°", height * 5 / 6),
    ] {
        text(picture, name, (right, top + row - i64::from(LINE_PX) / 2), GRID);
    }
    text(picture, "horizon", (right - 3 * i64::from(LETTER_PX), below), GRID);
    text(picture, "+z up", (width / 2 + 4, top + 2), WHITE);
    text(picture, "-z", (width / 2 + 4, top + height - i64::from(LINE_PX)), WHITE);
}

/// A light's circle, as large as the light, and its number.
fn mark(picture: &mut RgbImage, top: i64, number: usize, found: &FoundLight) {
    const POINTS: usize = 720;
    let ink = light_ink(number);
    let light = &found.light;
    let across = light.direction.any_orthonormal_vector();
    let frame = Mat3::from_cols(across, light.direction.cross(across), light.direction);
    // A circle of less than three pixels could not be seen.
    let radius_rad = light.angular_radius_rad.max(3.0 * PI / PANEL_PX[1] as f32);
    let (sin, cos) = radius_rad.sin_cos();
    let at = |d: Vec3| {
        let (x, y) = place(d);
        (x as i64, top + y as i64)
    };
    for point in 0..POINTS {
        let turn = 2.0 * PI * point as f32 / POINTS as f32;
        let (x, y) = at(frame * Vec3::new(sin * turn.cos(), sin * turn.sin(), cos));
        for (dx, dy) in [(0, 0), (1, 0), (0, 1)] {
            put(picture, (x + dx, y + dy), ink);
        }
    }
    let (x, y) = at(light.direction);
    let name = number.to_string();
    let name_px = name.len() as i64 * i64::from(LETTER_PX);
    let radius_px = (radius_rad / PI * PANEL_PX[1] as f32) as i64;
    let left = if radius_px > i64::from(LINE_PX) / 2 {
        x - name_px / 2
    } else if x + radius_px + 4 + name_px < i64::from(PANEL_PX[0]) {
        x + radius_px + 4
    } else {
        x - radius_px - 4 - name_px
    };
    text(picture, &name, (left, y - i64::from(LINE_PX) / 2), ink);
}

/// Colours that differ for neighbours in the list.
fn light_ink(number: usize) -> Ink {
    const INKS: [Ink; 6] = [
        Rgb([255, 80, 80]),
        Rgb([80, 220, 100]),
        Rgb([110, 170, 255]),
        Rgb([255, 220, 60]),
        Rgb([240, 110, 255]),
        Rgb([80, 230, 230]),
    ];
    INKS[(number + INKS.len() - 1) % INKS.len()]
}

fn list_line(number: usize, found: &FoundLight, total: f32) -> String {
    let (d, e) = (found.light.direction, found.light.irradiance);
    format!(
        "{number:>3} {:>12.3} {:>6.3} {:>6.3} {:>7.1} {:>6.2} {} {:>7.2} {:>10.4} {:>8.4} {:>8.4}",
        d.x,
        d.y,
        d.z,
        height_deg(d),
        found.light.angular_radius_rad.to_degrees(),
        if found.is_clipped { ">" } else { " " },
        100.0 * found.power() / total.max(f32::MIN_POSITIVE),
        e.x,
        e.y,
        e.z,
    )
}

/// What the colours of the second panel mean, with shares.
fn key(picture: &mut RgbImage, top: i64, figures: &Figures) {
    let worst = figures.clipped.iter().copied().fold(0.0, f32::max);
    let entries = [
        (known_ink_of_quality(1.0), format!("seen {:.1} %", 100.0 * figures.seen)),
        (known_ink_of_quality(0.2), "badly".to_owned()),
        (CLIPPED_PARTLY, "partly clipped".to_owned()),
        (CLIPPED, format!("clipped {:.2} %", 100.0 * worst)),
        (FILLED, format!("filled {:.1} %", 100.0 * (1.0 - figures.seen))),
    ];
    let mut left = 4;
    for (ink, words) in entries {
        fill(picture, (left, top + 4), [LINE_PX - 8; 2], ink);
        left += i64::from(LINE_PX);
        text(picture, &words, (left, top), WHITE);
        left += (words.chars().count() as i64 + 1) * i64::from(LETTER_PX);
    }
}

fn known_ink(seen: Option<Seen>) -> Ink {
    match seen {
        None => FILLED,
        Some(seen) if seen.clipped_everywhere != 0 => CLIPPED,
        Some(seen) if seen.clipped != 0 => CLIPPED_PARTLY,
        Some(seen) => known_ink_of_quality(seen.quality),
    }
}

fn known_ink_of_quality(quality: f32) -> Ink {
    let level = 40.0 + 160.0 * quality.clamp(0.0, 1.0);
    Rgb([(0.5 * level) as u8, level as u8, (0.5 * level) as u8])
}

/// Reinhard et al. 2002, "Photographic tone reproduction for digital images", eqs. 1 to 3: the mean is the geometric one.
struct ToneCurve {
    scale: f32,
    response: ResponseCurve,
}

impl ToneCurve {
    /// Key value of eq. 2.
    const KEY: f32 = 0.18;

    fn of(radiance: &Cube<Vec3>) -> Self {
        let (mut sum, mut area_sr) = (0.0, 0.0);
        for (index, value) in radiance.texels().iter().enumerate() {
            let luminance = luminance(*value);
            if luminance > 0.0 {
                sum += luminance.ln() * radiance.solid_angle(index);
                area_sr += radiance.solid_angle(index);
            }
        }
        let mean = if area_sr > 0.0 { (sum / area_sr).exp() } else { 1.0 };
        Self {
            scale: Self::KEY / mean,
            response: ResponseCurve::srgb(),
        }
    }

    fn ink(&self, radiance: Vec3) -> Ink {
        let scaled = radiance * self.scale;
        let mapped = scaled / (1.0 + luminance(scaled));
        if !mapped.is_finite() {
            return BLACK;
        }
        Rgb(mapped.to_array().map(|y| self.response.encode(f64::from(y))))
    }
}
