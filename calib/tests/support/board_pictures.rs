//! Pictures of boards with exactly known corners: any lens, blur, noise, response.
//!
//! ```ignore
//! #[path = "support/board_pictures.rs"]
//! mod board_pictures;
//! let camera = BoardCamera::new(&intrinsics);
//! let rgb = camera.picture(&board, &camera_from_board, &Look::default());
//! let corners = camera.exact_corners(&board, &camera_from_board);
//! ```
#![allow(dead_code, reason = "each test program uses its part of this")]

use glam::{DMat3, DVec2, DVec3};
use mirrorball_calib::{
    board::{Board, CharucoPattern},
    camera::Intrinsics,
    pose::Pose,
    response::ResponseCurve,
    tag::{Family, Layout},
};
use rayon::prelude::*;

/// Linear signal of white paper, of print, and of what is around the board.
const WHITE: f64 = 0.7;
const BLACK: f64 = 0.04;
const AROUND: f64 = 0.25;

/// Samples in a pixel, a power of two.
const SAMPLES: u32 = 64;

/// How a picture is taken.
#[derive(Debug, Clone)]
pub(crate) struct Look {
    /// Blur besides that of a pixel's own square: standard deviation of a Gaussian, in pixels.
    pub(crate) blur_px: f64,
    /// Electrons of a full pixel, for shot noise; infinite for none.
    pub(crate) full_well_e: f64,
    /// Factor on the light.
    pub(crate) exposure: f64,
    /// Change of the light from the left to the right end of the picture, relative.
    pub(crate) shading: f64,
    /// What makes codes of light.
    pub(crate) response: ResponseCurve,
    /// Of the noise.
    pub(crate) seed: u64,
}

impl Default for Look {
    /// A clean picture: little blur, no noise, sRGB.
    fn default() -> Self {
        Self {
            blur_px: 0.6,
            full_well_e: f64::INFINITY,
            exposure: 1.0,
            shading: 0.0,
            response: ResponseCurve::srgb(),
            seed: 1,
        }
    }
}

/// A response proportional to light.
pub(crate) fn linear_response() -> ResponseCurve {
    let values: Vec<f64> = (0..256).map(|code| f64::from(code) / 255.0).collect();
    ResponseCurve::from_table(&values).expect("a line is a curve")
}

/// A camera that takes pictures of boards. Rays through the corners of all pixels are made once.
pub(crate) struct BoardCamera {
    pub(crate) intrinsics: Intrinsics,
    /// How far the board's middle stands out of the paper's plane, in metres: `bow_m (1 - x²)`, x from -1 to 1 over its corners.
    pub(crate) bow_m: f64,
    rays: Vec<Option<DVec3>>,
}

/// A pose that looks at the middle of a board from a distance in metres, with the board turned about its own x axis, then
/// its y axis, then its z axis, and then seen off the optical axis: `towards` is the direction of the board's middle in the
/// camera frame.
pub(crate) fn board_pose(board: &Board, distance_m: f64, turns_rad: DVec3, towards: DVec3) -> Pose {
    let corners = board.corners_m();
    let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
    // Upright and facing the camera: the board's y is up, the camera's down.
    let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let turned =
        DMat3::from_rotation_z(turns_rad.z) * DMat3::from_rotation_y(turns_rad.y) * DMat3::from_rotation_x(turns_rad.x);
    let sight = glam::DQuat::from_rotation_arc(DVec3::Z, towards.normalize());
    let rotation = DMat3::from_quat(sight) * turned * facing;
    Pose {
        rotation,
        translation: towards.normalize() * distance_m - rotation * middle,
    }
}

impl BoardCamera {
    pub(crate) fn new(intrinsics: &Intrinsics) -> Self {
        let [width, height] = intrinsics.size_px;
        let rays = (0..(width + 1) * (height + 1))
            .into_par_iter()
            .map(|i| {
                let (x, y) = (i % (width + 1), i / (width + 1));
                intrinsics.unproject(DVec2::new(f64::from(x), f64::from(y)) - 0.5)
            })
            .collect();
        Self {
            intrinsics: *intrinsics,
            bow_m: 0.0,
            rays,
        }
    }

    /// Columns and rows.
    pub(crate) fn size(&self) -> [usize; 2] {
        self.intrinsics.size_px.map(|side| side as usize)
    }

    /// Where the corners of a board are, by their index; `None` outside the picture.
    pub(crate) fn exact_corners(&self, board: &Board, camera_from_board: &Pose) -> Vec<Option<DVec2>> {
        let project = |corner: DVec3| {
            let pixel = self.intrinsics.project(camera_from_board.transform_point(corner))?;
            self.intrinsics.contains(pixel).then_some(pixel)
        };
        let bow = Bow::new(board, self.bow_m);
        let bent = |corner: DVec3| corner + DVec3::Z * bow.height_m(corner.x);
        board
            .corners_m()
            .into_iter()
            .map(|corner| project(bent(corner)))
            .collect()
    }

    /// Takes a picture: three bytes per pixel.
    pub(crate) fn picture(&self, board: &Board, camera_from_board: &Pose, look: &Look) -> Vec<u8> {
        let [width, height] = self.size();
        let print = Print::new(board);
        let bow = Bow::new(board, self.bow_m);
        let board_from_camera = camera_from_board.inverse();
        let origin = board_from_camera.translation;
        let places: Vec<Option<DVec2>> = self
            .rays
            .par_iter()
            .map(|ray| {
                let direction = board_from_camera.transform_vector((*ray)?);
                bow.hit(origin, direction)
            })
            .collect();
        let light: Vec<f64> = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let at = |x: usize, y: usize| places[y * (width + 1) + x];
                let corners = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
                let shade = 1.0 + look.shading * (x as f64 / width as f64 - 0.5);
                look.exposure * shade * print.mean(corners)
            })
            .collect();
        let light = blurred(&light, width, look.blur_px);
        let mut noise = Noise(look.seed);
        let encode = |light: f64, noise: &mut Noise| {
            let deviation = (light.max(0.0) / look.full_well_e).sqrt();
            look.response.encode(light + deviation * noise.gaussian())
        };
        light.iter().flat_map(|&light| [encode(light, &mut noise); 3]).collect()
    }
}

/// Seeded random numbers (Steele et al. 2014, SplitMix64).
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    /// Even between 0 and 1.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal (Box and Muller 1958).
    pub(crate) fn gaussian(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// The surface of a board bowed along x.
struct Bow {
    bow_m: f64,
    middle_m: f64,
    half_m: f64,
}

impl Bow {
    fn new(board: &Board, bow_m: f64) -> Self {
        let corners = board.corners_m();
        let low = corners.iter().fold(f64::INFINITY, |low, p| low.min(p.x));
        let high = corners.iter().fold(f64::NEG_INFINITY, |high, p| high.max(p.x));
        Self {
            bow_m,
            middle_m: 0.5 * (low + high),
            half_m: 0.5 * (high - low),
        }
    }

    fn height_m(&self, x: f64) -> f64 {
        self.bow_m * (1.0 - ((x - self.middle_m) / self.half_m).powi(2))
    }

    /// Where a ray meets the surface: the plane at the height of the last guess, again and again. A bow of a millimetre gets the
    /// error a hundred times smaller each time.
    fn hit(&self, origin: DVec3, direction: DVec3) -> Option<DVec2> {
        let at = |height: f64| {
            let distance = (height - origin.z) / direction.z;
            (origin.z > 0.0 && distance > 0.0).then(|| (origin + direction * distance).truncate())
        };
        let mut place = at(0.0)?;
        if self.bow_m != 0.0 {
            for _ in 0..6 {
                // Far beyond the board the parabola means nothing.
                let reach = 1.5 * self.half_m;
                place = at(self.height_m(place.x.clamp(self.middle_m - reach, self.middle_m + reach)))?;
            }
        }
        Some(place)
    }
}

/// What is printed, ready to be looked up.
struct Print<'a> {
    board: &'a Board,
    /// Codes of the markers, by their number on the board; rows from the top, true is white.
    codes: Vec<Vec<bool>>,
    low: DVec2,
    high: DVec2,
}

impl<'a> Print<'a> {
    fn new(board: &'a Board) -> Self {
        let extent = |columns: u32, rows: u32| DVec2::new(f64::from(columns), f64::from(rows));
        let markers = |family: Family, first_id: u32, count: u32| -> Vec<Vec<bool>> {
            (first_id..first_id + count)
                .map(|id| {
                    let layout = Layout::new(family, 1);
                    let picture = layout.picture(family.code(id).expect("the board's ids exist"));
                    let inner = 2..layout.quad_cells();
                    picture[inner.clone()]
                        .iter()
                        .flat_map(|row| row[inner.clone()].to_vec())
                        .collect()
                })
                .collect()
        };
        let (codes, low, high, margin) = match *board {
            Board::AprilGrid {
                family,
                columns,
                rows,
                side_m,
                spacing_m,
                first_id,
                ..
            } => (
                markers(family, first_id, columns * rows),
                DVec2::ZERO,
                extent(columns, rows) * (side_m + spacing_m) - spacing_m,
                1.6 * spacing_m,
            ),
            Board::Charuco {
                family,
                columns,
                rows,
                square_m,
                first_id,
                ..
            } => (
                markers(family, first_id, (columns * rows).div_ceil(2)),
                DVec2::ZERO,
                extent(columns, rows) * square_m,
                0.5 * square_m,
            ),
            Board::Chessboard {
                columns,
                rows,
                square_m,
            } => (
                Vec::new(),
                DVec2::splat(-square_m),
                extent(columns, rows) * square_m,
                0.5 * square_m,
            ),
        };
        Self {
            board,
            codes,
            low: low - margin,
            high: high + margin,
        }
    }

    /// Mean over a pixel whose corners show these places: top-left, top-right, bottom-left, bottom-right.
    fn mean(&self, corners: [Option<DVec2>; 4]) -> f64 {
        let [Some(a), Some(b), Some(c), Some(d)] = corners else {
            return AROUND;
        };
        let (low, high) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
        if high.cmplt(self.low).any() || low.cmpgt(self.high).any() {
            return AROUND;
        }
        if [b, c, d].into_iter().all(|place| self.same_cell(a, place)) {
            return self.light(a);
        }
        // Hammersley's points: along either axis all are apart, so an upright edge is as smooth as a slanted one.
        let sum: f64 = (0..SAMPLES)
            .map(|i| {
                let u = (f64::from(i) + 0.5) / f64::from(SAMPLES);
                let v = (f64::from(i.reverse_bits() >> (32 - SAMPLES.ilog2())) + 0.5) / f64::from(SAMPLES);
                self.light(a.lerp(b, u).lerp(c.lerp(d, u), v))
            })
            .sum();
        sum / f64::from(SAMPLES)
    }

    /// Whether two places are in one rectangle of one colour: then all of a pixel with its corners there is. Only looked up for
    /// grids of markers, which are most of the work.
    fn same_cell(&self, one: DVec2, other: DVec2) -> bool {
        let Board::AprilGrid {
            side_m,
            spacing_m,
            border_bits,
            ..
        } = *self.board
        else {
            return false;
        };
        let bits = (self.codes[0].len().isqrt() + 2 * border_bits as usize) as f64;
        let cell = |place: DVec2| {
            let marker = (place / (side_m + spacing_m)).floor();
            let within = (place - marker * (side_m + spacing_m)) / side_m;
            (marker, (within * bits).floor().min(DVec2::splat(bits)))
        };
        let inside = |place: DVec2| place.cmpge(self.low).all() && place.cmple(self.high).all();
        inside(one) && inside(other) && cell(one) == cell(other)
    }

    fn light(&self, place: DVec2) -> f64 {
        if place.cmplt(self.low).any() || place.cmpgt(self.high).any() {
            AROUND
        } else if self.is_black(place) {
            BLACK
        } else {
            WHITE
        }
    }

    fn is_black(&self, place: DVec2) -> bool {
        match *self.board {
            Board::AprilGrid {
                columns,
                rows,
                side_m,
                spacing_m,
                border_bits,
                ..
            } => {
                let pitch = side_m + spacing_m;
                // Cell of markers; what is left of it is the marker, then the gap.
                let cell = (place / pitch).floor();
                let within = place - cell * pitch;
                let in_gap = within.cmpge(DVec2::splat(side_m));
                if in_gap.x && in_gap.y {
                    return cell.cmpge(DVec2::splat(-1.0)).all()
                        && cell.x < f64::from(columns)
                        && cell.y < f64::from(rows);
                }
                let on_board = cell.cmpge(DVec2::ZERO).all() && cell.x < f64::from(columns) && cell.y < f64::from(rows);
                if in_gap.any() || !on_board {
                    return false;
                }
                let marker = cell.y as usize * columns as usize + cell.x as usize;
                self.marker_is_black(marker, within / side_m, border_bits)
            }
            Board::Charuco {
                family,
                columns,
                rows,
                square_m,
                side_m,
                pattern,
                ..
            } => {
                let cell = (place / square_m).floor();
                if cell.cmplt(DVec2::ZERO).any() || cell.x >= f64::from(columns) || cell.y >= f64::from(rows) {
                    return false;
                }
                // OpenCV counts rows from the top.
                let (column, row) = (cell.x as u32, rows - 1 - cell.y as u32);
                let offset = match pattern {
                    CharucoPattern::BlackTopLeft => 0,
                    CharucoPattern::BlackBottomLeft => (rows + 1) % 2,
                };
                let white = |column: u32, row: u32| (column + row + offset) % 2 == 1;
                if !white(column, row) {
                    return true;
                }
                let earlier = (0..row * columns + column)
                    .filter(|i| white(i % columns, i / columns))
                    .count();
                let within = (place - cell * square_m - 0.5 * (square_m - side_m)) / side_m;
                if within.cmplt(DVec2::ZERO).any() || within.cmpge(DVec2::ONE).any() {
                    return false;
                }
                // OpenCV prints AprilTags turned by half a turn.
                let turned = family == Family::Tag36h11;
                self.marker_is_black(earlier, if turned { 1.0 - within } else { within }, 1)
            }
            Board::Chessboard {
                columns,
                rows,
                square_m,
            } => {
                let cell = (place / square_m).floor();
                let on_board =
                    cell.cmpge(DVec2::splat(-1.0)).all() && cell.x < f64::from(columns) && cell.y < f64::from(rows);
                // The square at the bottom left is black.
                on_board && (cell.x + cell.y).rem_euclid(2.0) < 0.5
            }
        }
    }

    /// `within` runs from 0 to 1 to the right and up.
    fn marker_is_black(&self, marker: usize, within: DVec2, border: u32) -> bool {
        let code = &self.codes[marker];
        let side = code.len().isqrt();
        let border = border as usize;
        let total = (side + 2 * border) as f64;
        let column = (within.x * total).clamp(0.0, total - 1.0) as usize;
        let row = ((1.0 - within.y) * total).clamp(0.0, total - 1.0) as usize;
        let inside = |i: usize| (border..border + side).contains(&i);
        !(inside(column) && inside(row) && code[(row - border) * side + column - border])
    }
}

/// Gaussian blur, one direction after the other; the border is repeated.
fn blurred(light: &[f64], width: usize, sigma_px: f64) -> Vec<f64> {
    if sigma_px <= 0.0 {
        return light.to_vec();
    }
    let reach = (4.0 * sigma_px).ceil() as i64;
    let mut kernel: Vec<f64> = (-reach..=reach)
        .map(|i| (-0.5 * (i as f64 / sigma_px).powi(2)).exp())
        .collect();
    let sum: f64 = kernel.iter().sum();
    kernel.iter_mut().for_each(|weight| *weight /= sum);
    let height = light.len() / width;
    let pass = |from: &[f64], step: [i64; 2]| -> Vec<f64> {
        (0..from.len())
            .into_par_iter()
            .map(|i| {
                let (x, y) = ((i % width) as i64, (i / width) as i64);
                let at = |k: i64| {
                    let x = (x + k * step[0]).clamp(0, width as i64 - 1) as usize;
                    let y = (y + k * step[1]).clamp(0, height as i64 - 1) as usize;
                    from[y * width + x]
                };
                kernel.iter().zip(-reach..).map(|(weight, k)| weight * at(k)).sum()
            })
            .collect()
    };
    pass(&pass(light, [1, 0]), [0, 1])
}
