//! Cells of a family's markers.

use super::Family;

/// What a cell of a marker is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cell {
    /// Always black.
    Black,
    /// Always white.
    White,
    /// Part of the code; white where its bit is 1.
    Code,
}

/// The cells of a family's markers: what is always black or white, and where the code is.
///
/// The *quad* is the square whose outline is found in pictures, and whose corners are a marker's: black inside and white
/// around it for most families, white inside and black around it for tagStandard41h12 (Krogius et al. 2019). Cells are counted
/// from the quad's top-left cell of the upright marker, columns to the right, rows down; code cells outside of it have
/// negative numbers, or some beyond its width.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    rows: Vec<Vec<Cell>>,
    /// Cells from the edge of `rows` to the quad.
    margin: usize,
    code: Vec<[i32; 2]>,
    turned: Vec<usize>,
}

impl Layout {
    /// Layout of a family whose border, black for most, is `border_bits` cells wide: 1 as published, 2 for Kalibr's grids, 0
    /// is taken as 1. A family whose quad is white inside has one border only.
    #[must_use]
    pub fn new(family: Family, border_bits: u32) -> Self {
        let mut rows = family.table().rows;
        let is_white_inside = rows[0][0] == Cell::Code;
        if !is_white_inside {
            for _ in 1..border_bits {
                widen(&mut rows);
            }
        }
        let margin = if is_white_inside { 2 } else { 1 };
        let width = rows.len();
        let code: Vec<[i32; 2]> = (0..width)
            .flat_map(|y| (0..width).map(move |x| [x, y]))
            .filter(|&[x, y]| rows[y][x] == Cell::Code)
            .map(|[x, y]| [x as i32 - margin as i32, y as i32 - margin as i32])
            .collect();
        let last = (width - 2 * margin) as i32 - 1;
        let turned = code
            .iter()
            .map(|&[x, y]| {
                let from = [y, last - x];
                let place = code.iter().position(|&cell| cell == from);
                place.expect("tested: the layouts of all families can be turned")
            })
            .collect();
        Self {
            rows,
            margin,
            code,
            turned,
        }
    }

    /// Cells along the side of the quad.
    #[must_use]
    pub fn quad_cells(&self) -> usize {
        self.rows.len() - 2 * self.margin
    }

    /// Cells from the quad's outline to the edge of what belongs to the marker, white ring or code.
    #[must_use]
    pub fn margin_cells(&self) -> usize {
        self.margin
    }

    /// Whether the quad is white along the inside of its outline and black along the outside.
    #[must_use]
    pub fn is_white_inside(&self) -> bool {
        self.margin == 2
    }

    /// Column and row of every bit of a code, the most significant first.
    #[must_use]
    pub fn code_cells(&self) -> &[[i32; 2]] {
        &self.code
    }

    /// What the cell is in a column and row; white outside of the marker.
    #[must_use]
    pub fn cell(&self, [x, y]: [i32; 2]) -> Cell {
        let at = |i: i32| usize::try_from(i + self.margin as i32).ok();
        let cell = at(y).zip(at(x)).and_then(|(y, x)| self.rows.get(y)?.get(x).copied());
        cell.unwrap_or(Cell::White)
    }

    /// The code that is read where `code` is printed and the marker stands turned a quarter clockwise in the picture.
    #[must_use]
    pub fn turned(&self, code: u64) -> u64 {
        let n = self.code.len();
        let bit = |place: usize| code >> (n - 1 - place) & 1;
        self.turned.iter().fold(0, |turned, &from| turned << 1 | bit(from))
    }

    /// The whole upright marker with a code, its ring of white or code included, row by row from the top-left; true is white.
    #[must_use]
    pub fn picture(&self, code: u64) -> Vec<Vec<bool>> {
        let mut bits = (0..self.code.len()).rev().map(|bit| code >> bit & 1 == 1);
        let mut shown = |cell: &Cell| match cell {
            Cell::Black => false,
            Cell::White => true,
            Cell::Code => bits.next().unwrap_or(true),
        };
        self.rows
            .iter()
            .map(|row| row.iter().map(&mut shown).collect())
            .collect()
    }
}

/// Doubles the ring of cells that is second from outside: the border.
fn widen(rows: &mut Vec<Vec<Cell>>) {
    let n = rows.len();
    for row in rows.iter_mut() {
        row.insert(n - 2, row[n - 2]);
        row.insert(1, row[1]);
    }
    rows.insert(n - 2, rows[n - 2].clone());
    rows.insert(1, rows[1].clone());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_are_those_of_the_published_families() {
        let expected = [
            (Family::Tag36h11, 8, 36, false),
            (Family::Tag25h9, 7, 25, false),
            (Family::Tag16h5, 6, 16, false),
            (Family::TagStandard41h12, 5, 41, true),
        ];
        for (family, quad, bits, is_white_inside) in expected {
            let layout = Layout::new(family, 1);
            assert_eq!(layout.quad_cells(), quad, "{family}");
            assert_eq!(layout.code_cells().len(), bits, "{family}");
            assert_eq!(layout.is_white_inside(), is_white_inside, "{family}");
        }
        let standard = Layout::new(Family::TagStandard41h12, 1);
        assert_eq!(standard.code_cells()[0], [-2, -2]);
        assert_eq!(standard.cell([0, 0]), Cell::White);
        assert_eq!(standard.cell([-1, 0]), Cell::Black);
    }

    #[test]
    fn a_wider_border_moves_the_code_inwards() {
        let layout = Layout::new(Family::Tag36h11, 2);
        assert_eq!(layout.quad_cells(), 10);
        assert_eq!(layout.code_cells()[0], [2, 2]);
        assert_eq!(layout.cell([1, 1]), Cell::Black);
        assert_eq!(layout.cell([-1, 4]), Cell::White);
        assert_eq!(layout.cell([30, 4]), Cell::White);
    }

    #[test]
    fn four_quarter_turns_are_none_and_one_turns_the_picture() {
        for family in Family::ALL {
            for border in [1, 2] {
                let layout = Layout::new(family, border);
                let code = family.code(3).unwrap();
                let turn = |code| layout.turned(code);
                assert_eq!(turn(turn(turn(turn(code)))), code, "{family}");
                let (upright, turned) = (layout.picture(code), layout.picture(turn(code)));
                let last = upright.len() - 1;
                for (y, row) in turned.iter().enumerate() {
                    for (x, &white) in row.iter().enumerate() {
                        assert_eq!(white, upright[last - x][y], "{family}");
                    }
                }
            }
        }
    }
}
