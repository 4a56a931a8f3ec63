//! Plots of few lines on two logarithmic axes, as pictures.

use crate::label;
use image::{Rgb, RgbImage};

/// What a plot shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// What stands over it.
    pub title: String,
    /// What the axis to the right counts.
    pub across: String,
    /// What the upward axis counts.
    pub upward: String,
    /// The lines.
    pub lines: Vec<Line>,
}

/// One line of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its name in the legend.
    pub name: String,
    /// Its points; those that are not positive and finite are left out.
    pub points: Vec<[f64; 2]>,
}

const WIDTH_PX: u32 = 1000;
const HEIGHT_PX: u32 = 560;
/// Left, right, upper and lower edge of the area with the lines, in pixels.
const AREA_PX: [f64; 4] = [90.0, 740.0, 60.0, 490.0];
const PAPER: Rgb<u8> = Rgb([250, 250, 248]);
const INK: Rgb<u8> = Rgb([40, 40, 44]);
const GRID: Rgb<u8> = Rgb([222, 222, 218]);
/// Colours of lines, to be told apart with any colour vision (Okabe, Ito 2008); more lines begin again, dotted.
const COLORS: [Rgb<u8>; 8] = [
    Rgb([0, 114, 178]),
    Rgb([213, 94, 0]),
    Rgb([0, 158, 115]),
    Rgb([204, 121, 167]),
    Rgb([230, 159, 0]),
    Rgb([86, 180, 233]),
    Rgb([120, 94, 60]),
    Rgb([20, 20, 20]),
];

/// Draws a plot.
#[must_use]
pub fn draw(plot: &Plot) -> RgbImage {
    let mut picture = RgbImage::from_pixel(WIDTH_PX, HEIGHT_PX, PAPER);
    let [left, right, top, bottom] = AREA_PX;
    label::draw(&mut picture, &plot.title, (left as u32, 20), INK);
    label::draw(&mut picture, &plot.across, (left as u32, bottom as u32 + 36), INK);
    label::draw(&mut picture, &plot.upward, (12, 40), INK);
    let axes = [Axis::of(plot, 0, [left, right]), Axis::of(plot, 1, [bottom, top])];
    for value in axes[0].ticks() {
        let x = axes[0].place(value);
        segment(&mut picture, [[x, top], [x, bottom]], (GRID, 1, false));
        label::draw(&mut picture, &short(value), (x as u32 - 12, bottom as u32 + 8), INK);
    }
    for value in axes[1].ticks() {
        let y = axes[1].place(value);
        segment(&mut picture, [[left, y], [right, y]], (GRID, 1, false));
        label::draw(&mut picture, &short(value), (20, y as u32 - 12), INK);
    }
    for (index, line) in plot.lines.iter().enumerate() {
        let style = (COLORS[index % COLORS.len()], 3, index >= COLORS.len());
        let points: Vec<[f64; 2]> = usable(line)
            .map(|[x, y]| [axes[0].place(x), axes[1].place(y)])
            .collect();
        for pair in points.windows(2) {
            segment(&mut picture, [pair[0], pair[1]], style);
        }
        for &point in &points {
            segment(&mut picture, [point, point], (style.0, 7, false));
        }
        let y = top + 28.0 * index as f64 + 12.0;
        segment(&mut picture, [[right + 16.0, y], [right + 44.0, y]], style);
        label::draw(&mut picture, &line.name, (right as u32 + 52, y as u32 - 12), INK);
    }
    picture
}

fn usable(line: &Line) -> impl Iterator<Item = [f64; 2]> + '_ {
    let is_usable = |value: &f64| value.is_finite() && *value > 0.0;
    line.points
        .iter()
        .copied()
        .filter(move |point| point.iter().all(is_usable))
}

/// A logarithmic axis.
struct Axis {
    /// Least and largest value.
    range: [f64; 2],
    /// Their pixels.
    px: [f64; 2],
}

impl Axis {
    /// The axis that holds coordinate `which` of all points, with a little room at both ends.
    fn of(plot: &Plot, which: usize, px: [f64; 2]) -> Self {
        let values = || plot.lines.iter().flat_map(usable).map(|point| point[which]);
        let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
        let range = if high > 0.0 {
            [low / 1.25, high * 1.25]
        } else {
            [1.0, 10.0]
        };
        Self { range, px }
    }

    fn place(&self, value: f64) -> f64 {
        let share = (value / self.range[0]).ln() / (self.range[1] / self.range[0]).ln();
        self.px[0] + share * (self.px[1] - self.px[0])
    }

    /// 1, 2 and 5 times powers of ten, or of these only the powers where there are many.
    fn ticks(&self) -> Vec<f64> {
        let [low, high] = self.range;
        let factors: &[f64] = if high / low > 2e3 { &[1.0] } else { &[1.0, 2.0, 5.0] };
        (low.log10().floor() as i32..=high.log10().ceil() as i32)
            .flat_map(|power| factors.iter().map(move |factor| factor * 10f64.powi(power)))
            .filter(|value| (low..=high).contains(value))
            .collect()
    }
}

/// A number in at most five characters.
fn short(value: f64) -> String {
    if value >= 1e6 {
        format!("{}M", value / 1e6)
    } else if value >= 1e3 {
        format!("{}k", value / 1e3)
    } else {
        format!("{value}")
    }
}

/// Draws a straight line of a colour and width, or dots along it.
fn segment(picture: &mut RgbImage, [from, to]: [[f64; 2]; 2], (color, width_px, is_dotted): (Rgb<u8>, i64, bool)) {
    let n = (to[0] - from[0]).hypot(to[1] - from[1]).ceil().max(1.0) as u32;
    for i in (0..=n).filter(|i| !is_dotted || i % 9 < 4) {
        let share = f64::from(i) / f64::from(n);
        let at = [0, 1].map(|axis| (from[axis] + share * (to[axis] - from[axis])).round() as i64 - width_px / 2);
        for (dx, dy) in (0..width_px).flat_map(|dx| (0..width_px).map(move |dy| (dx, dy))) {
            if let (Ok(x), Ok(y)) = (u32::try_from(at[0] + dx), u32::try_from(at[1] + dy))
                && let Some(pixel) = picture.get_pixel_mut_checked(x, y)
            {
                *pixel = color;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_slope_one_goes_through_its_points_and_nonsense_is_left_out() {
        let line = |points: &[[f64; 2]]| Line {
            name: "map".to_owned(),
            points: points.to_vec(),
        };
        let mut plot = Plot {
            title: "cost".to_owned(),
            across: "triangles".to_owned(),
            upward: "ms".to_owned(),
            lines: vec![line(&[
                [10.0, 1.0],
                [100.0, 10.0],
                [1000.0, 100.0],
                [f64::NAN, 1.0],
                [0.0, 5.0],
            ])],
        };
        let picture = draw(&plot);
        let [left, right, top, bottom] = AREA_PX.map(|px| px as u32);
        assert_eq!(
            *picture.get_pixel(u32::midpoint(left, right), u32::midpoint(top, bottom)),
            COLORS[0]
        );
        plot.lines = vec![line(&[]); 9];
        assert_eq!(draw(&plot).dimensions(), (WIDTH_PX, HEIGHT_PX));
    }

    #[test]
    fn ticks_are_round_and_within_the_axis() {
        let axis = Axis {
            range: [0.9, 70.0],
            px: [0.0, 100.0],
        };
        assert_eq!(axis.ticks(), [1.0, 2.0, 5.0, 10.0, 20.0, 50.0]);
        assert_eq!(
            ["20k", "0.5", "2M"],
            [20e3, 0.5, 2e6].map(short).each_ref().map(String::as_str)
        );
    }
}
