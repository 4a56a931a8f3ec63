//! Chessboards: from any four corners of a square, square by square, until there are no more.

use glam::DVec2;

use super::{
    candidates::{self, Candidate},
    growth::{Growth, Target},
    saddle::Saddle,
};
use crate::tag::LinearLuma;

/// Squares from which a board is grown at most.
const MAX_SEEDS: usize = 15;

/// Candidates that are asked whether they are the corner of such a square.
const MAX_ASKED: usize = 1500;

/// Largest sine of the angle between the way to a neighbour and the edges at either end.
const MAX_SINE: f64 = 0.4;

/// Largest distance of a square's fourth corner from where three say it is, relative to its shorter side.
const MAX_SKEW: f64 = 0.45;

/// A row or column counts if so much of it was found.
const MIN_FILL: f64 = 0.5;

/// A chessboard that is not the right one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct OtherGrid {
    /// Inner corners along the longer and the shorter side of the best grid found; 0 when there is none.
    pub(super) found: [u32; 2],
    /// How many of those corners were found.
    pub(super) corners: usize,
}

/// The inner corners of a whole chessboard of `columns` by `rows` inner corners, row by row from the bottom left.
///
/// # Errors
/// The largest grid of corners that was found instead.
pub(super) fn corners(luma: &LinearLuma, [columns, rows]: [u32; 2]) -> Result<Vec<(usize, Saddle)>, OtherGrid> {
    let candidates = candidates::find(luma);
    let targets = field(columns.max(rows));
    let mut used: Vec<DVec2> = Vec::new();
    let mut best = OtherGrid {
        found: [0, 0],
        corners: 0,
    };
    let mut seeds = 0;
    for candidate in candidates.iter().take(MAX_ASKED) {
        if used.iter().any(|pixel| pixel.distance(candidate.pixel) < 2.0) {
            continue;
        }
        let Some(square) = Square::at(candidate, &candidates) else {
            continue;
        };
        seeds += 1;
        if seeds > MAX_SEEDS {
            break;
        }
        let grid = square.grow(luma, &targets, columns.max(rows));
        used.extend(grid.cells.iter().flatten().map(|saddle| saddle.pixel));
        match grid.board([columns, rows]) {
            Ok(corners) => return Ok(corners),
            Err(other) if other.corners > best.corners => best = other,
            Err(_) => {}
        }
    }
    Err(best)
}

/// Corners all around a seed, which is in the middle: a field that a board fits into wherever the seed lies on it, with one
/// more row around, so that a larger board is noticed. The unit is a square. The seed's top right is black.
fn field(longest: u32) -> Vec<Target> {
    let reach = i64::from(longest);
    let side = (-reach..=reach).collect::<Vec<i64>>();
    let places = side.iter().flat_map(|&y| side.iter().map(move |&x| (x, y)));
    places
        .map(|(x, y)| Target {
            place_m: DVec2::new(x as f64, y as f64),
            edge_m: 1.0,
            band_m: 1.0,
            rising_black: (x + y) % 2 == 0,
        })
        .collect()
}

/// Four corners of a square in the picture: one, the next along its x and y axis, and the opposite one. Its inside is black,
/// and y is to the left of x where x points right and y down: it is seen from the front.
struct Square {
    corners: [DVec2; 4],
}

impl Square {
    fn at(first: &Candidate, candidates: &[Candidate]) -> Option<Self> {
        let [a, b] = first.edges;
        let (x, y) = match (first.black_between, a.perp_dot(b) < 0.0) {
            (true, true) => (a, b),
            (true, false) => (b, a),
            (false, true) => (b, -a),
            (false, false) => (a, -b),
        };
        let along_x = next(first, x, y, candidates)?;
        let along_y = next(first, y, x, candidates)?;
        let ways = [along_x.pixel - first.pixel, along_y.pixel - first.pixel];
        let expected = first.pixel + ways[0] + ways[1];
        let reach = MAX_SKEW * ways[0].length().min(ways[1].length());
        let opposite = candidates
            .iter()
            .filter(|other| other.pixel.distance(expected) < reach)
            .min_by(|a, b| a.pixel.distance(expected).total_cmp(&b.pixel.distance(expected)))?;
        (ways[0].perp_dot(ways[1]) < 0.0).then_some(Self {
            corners: [first.pixel, along_x.pixel, along_y.pixel, opposite.pixel],
        })
    }

    fn grow(&self, luma: &LinearLuma, targets: &[Target], reach: u32) -> Grid {
        let side = 2 * reach as usize + 1;
        let centre = side * reach as usize + reach as usize;
        let mut growth = Growth::new(luma, targets, 1.0);
        for (index, pixel) in [centre, centre + 1, centre + side, centre + side + 1]
            .into_iter()
            .zip(self.corners)
        {
            growth.assume(index, pixel);
        }
        let mut cells = vec![None; targets.len()];
        for (index, saddle) in growth.finish() {
            cells[index] = Some(saddle);
        }
        Grid {
            side,
            cells,
            parity: (2 * reach as usize) % 2,
        }
    }
}

/// The nearest corner in a direction, `other` being the direction of the corner's other edge: an edge leads to it, and black
/// and white have changed sides there.
fn next<'a>(from: &Candidate, towards: DVec2, other: DVec2, candidates: &'a [Candidate]) -> Option<&'a Candidate> {
    // Whether the square between the two directions is black.
    let black = |corner: &Candidate, way: DVec2| -> Option<bool> {
        let along = usize::from(corner.edges[1].dot(way).abs() > corner.edges[0].dot(way).abs());
        let (edge, across) = (corner.edges[along], corner.edges[1 - along]);
        if edge.perp_dot(way).abs() > MAX_SINE {
            return None;
        }
        Some(corner.black_between == ((edge.dot(way) > 0.0) == (across.dot(other) > 0.0)))
    };
    let is_next = |corner: &&Candidate| {
        let way = corner.pixel - from.pixel;
        let Some(way) = way.try_normalize().filter(|way| way.dot(towards) > 0.0) else {
            return false;
        };
        way.perp_dot(towards).abs() < MAX_SINE
            && match (black(from, way), black(corner, way)) {
                (Some(here), Some(there)) => here != there,
                (None, _) | (_, None) => false,
            }
    };
    let distance = |corner: &&Candidate| corner.pixel.distance_squared(from.pixel);
    candidates
        .iter()
        .filter(is_next)
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// Corners in rows and columns.
struct Grid {
    side: usize,
    cells: Vec<Option<Saddle>>,
    parity: usize,
}

impl Grid {
    fn at(&self, x: usize, y: usize) -> Option<&Saddle> {
        self.cells[y * self.side + x].as_ref()
    }

    /// Low and high columns and rows of what was found, without rows and columns that are mostly empty.
    fn bounds(&self) -> Option<[usize; 4]> {
        let filled = (0..self.cells.len()).filter(|&i| self.cells[i].is_some());
        let places: Vec<(usize, usize)> = filled.map(|i| (i % self.side, i / self.side)).collect();
        let (mut x0, mut x1) = (places.iter().map(|p| p.0).min()?, places.iter().map(|p| p.0).max()?);
        let (mut y0, mut y1) = (places.iter().map(|p| p.1).min()?, places.iter().map(|p| p.1).max()?);
        loop {
            let column =
                |x: usize| (y0..=y1).filter(|&y| self.at(x, y).is_some()).count() as f64 / (y1 - y0 + 1) as f64;
            let row = |y: usize| (x0..=x1).filter(|&x| self.at(x, y).is_some()).count() as f64 / (x1 - x0 + 1) as f64;
            let fills = [column(x0), column(x1), row(y0), row(y1)];
            let (worst, fill) = fills.into_iter().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
            if fill >= MIN_FILL || x0 == x1 || y0 == y1 {
                return Some([x0, x1, y0, y1]);
            }
            match worst {
                0 => x0 += 1,
                1 => x1 -= 1,
                2 => y0 += 1,
                _ => y1 -= 1,
            }
        }
    }

    /// The only place of a whole board of this size, either way round, within bounds. What is beyond it, corners of the
    /// surroundings that happen to fit, must not make up whole rows or columns: then the board is another one.
    fn place(&self, [x0, x1, y0, y1]: [usize; 4], [columns, rows]: [usize; 2]) -> Option<[usize; 4]> {
        let is_whole = |[x0, x1, y0, y1]: [usize; 4]| (y0..=y1).all(|y| (x0..=x1).all(|x| self.at(x, y).is_some()));
        let ways: &[[usize; 2]] = if columns == rows {
            &[[columns, rows]]
        } else {
            &[[columns, rows], [rows, columns]]
        };
        let mut places = Vec::new();
        for &[width, height] in ways {
            for top in (y0..=y1).take_while(|top| top + height <= y1 + 1) {
                let lefts = (x0..=x1).take_while(|left| left + width <= x1 + 1);
                places.extend(lefts.map(|left| [left, left + width - 1, top, top + height - 1]));
            }
        }
        places.retain(|&place| is_whole(place));
        match places[..] {
            [place] => Some(place),
            _ => None,
        }
    }

    /// The corners as those of a board of this size.
    fn board(&self, [columns, rows]: [u32; 2]) -> Result<Vec<(usize, Saddle)>, OtherGrid> {
        let Some([x0, x1, y0, y1]) = self.bounds() else {
            return Err(OtherGrid {
                found: [0, 0],
                corners: 0,
            });
        };
        let (width, height) = (x1 - x0 + 1, y1 - y0 + 1);
        let corners = (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (x, y)));
        let corners = corners.filter(|&(x, y)| self.at(x, y).is_some()).count();
        let other = OtherGrid {
            found: [width.max(height) as u32, width.min(height) as u32],
            corners,
        };
        let (columns, rows) = (columns as usize, rows as usize);
        let [x0, x1, y0, y1] = self.place([x0, x1, y0, y1], [columns, rows]).ok_or(other)?;
        let (width, height) = (x1 - x0 + 1, y1 - y0 + 1);
        // The four ways to turn it, as corner of the grid by column and row of the board.
        let turned = |turn: usize, column: usize, row: usize| match turn {
            0 => (x0 + column, y0 + row),
            1 => (x1 - row, y0 + column),
            2 => (x1 - column, y1 - row),
            _ => (x0 + row, y1 - column),
        };
        let is_upright = |turn: usize| turn.is_multiple_of(2);
        let fits = |&turn: &usize| {
            let shape = if is_upright(turn) {
                (width, height)
            } else {
                (height, width)
            };
            shape == (columns, rows)
        };
        let pixel = |turn: usize, column: usize, row: usize| {
            let (x, y) = turned(turn, column, row);
            self.at(x, y).map_or(DVec2::ZERO, |saddle| saddle.pixel)
        };
        let is_black = |turn: usize| {
            // A quarter turn swaps the squares that rise and those that fall.
            let (x, y) = turned(turn, 0, 0);
            (x + y + turn) % 2 == self.parity
        };
        let rightwards = |turn: usize| {
            let way: DVec2 = (0..rows)
                .map(|row| pixel(turn, columns - 1, row) - pixel(turn, 0, row))
                .sum();
            way.normalize_or_zero().x
        };
        let best = (0..4).filter(fits).max_by(|&a, &b| {
            is_black(a)
                .cmp(&is_black(b))
                .then(rightwards(a).total_cmp(&rightwards(b)))
        });
        let turn = best.ok_or(other)?;
        let cells = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
        let corners = cells.enumerate().filter_map(|(index, (column, row))| {
            let (x, y) = turned(turn, column, row);
            Some((index, *self.at(x, y)?))
        });
        Ok(corners.collect())
    }
}
