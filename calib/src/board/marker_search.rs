//! The markers of a board in a picture; and if there are none, what is there instead.

use super::{
    Board, Reason,
    markers::{PlacedMarker, consistent},
};
use crate::tag::{Detection, Detector, LinearLuma, LumaView};

/// Exponent from light to the grey values in which markers are looked for.
const BRIGHT_POWER: f64 = 0.35;

/// Values of the 16-bit picture that share a grey value, as a power of two.
const BRIGHT_SHIFT: u32 = 4;

/// Neighbouring markers that are no accident.
const MIN_GROUP: usize = 2;

/// Wrong bits per marker, the mean, above which the border is suspected to be another one.
const MAX_MEAN_HAMMING: f64 = 0.5;

/// Markers from which on their arrangement is judged.
const MIN_TO_JUDGE: usize = 5;

/// Markers that fit those in use but are not on the board: so many are no accident.
const MIN_UNUSED: usize = 3;

/// Most columns that a board of another arrangement is thought to have.
const MAX_COLUMNS: u32 = 40;

/// Finds the markers of a board. Keeps its buffers.
#[derive(Debug)]
pub(super) struct MarkerSearch {
    board: Board,
    detector: Detector,
    /// Made when it is needed: markers with the other width of border.
    other_border: Option<Detector>,
    bright: Vec<u8>,
}

impl MarkerSearch {
    /// `None` for a chessboard.
    pub(super) fn new(board: &Board) -> Option<Self> {
        let detector = match *board {
            Board::AprilGrid {
                family, border_bits, ..
            } => Detector::with_border(&[family], border_bits),
            Board::Charuco { family, .. } => Detector::new(&[family]),
            Board::Chessboard { .. } => return None,
        };
        Some(Self {
            board: *board,
            detector,
            other_border: None,
            bright: Vec::new(),
        })
    }

    /// The board's markers, as far as they agree with each other.
    ///
    /// # Errors
    /// When something else than the board was found.
    pub(super) fn find(&mut self, luma: &LinearLuma) -> Result<Vec<PlacedMarker>, Reason> {
        self.bright = brightened(luma);
        let size = luma.size();
        let all = self.board.markers_m().len();
        let detections = detect(&mut self.detector, &self.bright, size, all);
        let found = group(&self.board, &detections);
        let is_suspect = found.len() < MIN_GROUP || mean_hamming(&detections) > MAX_MEAN_HAMMING;
        if is_suspect {
            self.look_for_other_border(size, found.len())?;
        }
        if found.len() < MIN_GROUP {
            self.look_for_mirrored(size)?;
        }
        self.judge_arrangement(&detections, &found)?;
        Ok(found)
    }

    /// Whether the board is there mirrored, with whichever border.
    fn look_for_mirrored(&mut self, size: [usize; 2]) -> Result<(), Reason> {
        let mirrored: Vec<u8> = self
            .bright
            .chunks_exact(size[0].max(1))
            .flat_map(|row| row.iter().rev().copied())
            .collect();
        let all = self.board.markers_m().len();
        for detector in [Some(&mut self.detector), self.other_border.as_mut()]
            .into_iter()
            .flatten()
        {
            let markers = group(&self.board, &detect(detector, &mirrored, size, all)).len();
            if markers >= MIN_GROUP {
                return Err(Reason::Mirrored { markers });
            }
        }
        Ok(())
    }

    /// Whether the board is there with another border, and at least as much of it. Codes are often read all the same, with
    /// wrong bits.
    fn look_for_other_border(&mut self, size: [usize; 2], in_group: usize) -> Result<(), Reason> {
        let Board::AprilGrid {
            family,
            border_bits: expected,
            ..
        } = self.board
        else {
            return Ok(());
        };
        let found = if expected == 1 { 2 } else { 1 };
        let detector = self
            .other_border
            .get_or_insert_with(|| Detector::with_border(&[family], found));
        let detections = detect(detector, &self.bright, size, self.board.markers_m().len());
        let group = group(&self.board, &detections).len();
        if group >= MIN_GROUP.max(in_group) && mean_hamming(&detections) <= MAX_MEAN_HAMMING {
            return Err(Reason::OtherBorder { found, expected });
        }
        Ok(())
    }

    /// Whether the markers belong together in another way than on the board.
    fn judge_arrangement(&self, detections: &[Detection], found: &[PlacedMarker]) -> Result<(), Reason> {
        let mut ids: Vec<u32> = detections.iter().map(|detection| detection.id).collect();
        ids.sort_unstable();
        ids.dedup();
        if ids.len() < MIN_TO_JUDGE {
            return Ok(());
        }
        let expected = columns(&self.board);
        if 2 * found.len() < ids.len() {
            let all = with_all_ids(&self.board, self.board.first_id());
            let fitting = (1..=MAX_COLUMNS)
                .map(|columns| (group(&with_columns(&all, columns), detections).len(), columns))
                .max_by(|a, b| a.0.cmp(&b.0).then(b.1.cmp(&a.1)));
            if let Some((size, found)) = fitting
                && found != expected
                && 4 * size >= 3 * ids.len()
            {
                return Err(Reason::OtherColumns { found, expected });
            }
        }
        self.judge_ids(detections, found)
    }

    /// Whether more markers belong together, with the board's columns but counted from another id or further.
    fn judge_ids(&self, detections: &[Detection], found: &[PlacedMarker]) -> Result<(), Reason> {
        // Ids run on in the same way every `columns` markers.
        let groups = (0..columns(&self.board)).map(|start| {
            let markers = group(&with_all_ids(&self.board, start), detections);
            markers.iter().map(|marker| start + marker.number).collect::<Vec<u32>>()
        });
        let Some(seen) = groups.max_by_key(Vec::len) else {
            return Ok(());
        };
        let (first, last) = self.ids();
        // Another board beside this one does no harm.
        let is_this_board = found.iter().any(|marker| seen.contains(&(first + marker.number)));
        match seen[..] {
            [lowest, .., highest]
                if seen.len() >= found.len() + MIN_UNUSED && (is_this_board || found.len() < MIN_GROUP) =>
            {
                Err(Reason::OtherIds {
                    lowest,
                    highest,
                    first,
                    last,
                })
            }
            _ => Ok(()),
        }
    }

    /// Lowest and highest id of the board.
    fn ids(&self) -> (u32, u32) {
        let first = self.board.first_id();
        let count = u32::try_from(self.board.markers_m().len()).expect("boards have less than 2³² markers");
        (first, first + count.saturating_sub(1))
    }
}

/// The markers in a picture; where not all of the board's are seen, looked for harder.
fn detect(detector: &mut Detector, pixels: &[u8], size: [usize; 2], all: usize) -> Vec<Detection> {
    let mut detections = detector.detect(view(pixels, size));
    if detections.len() < all {
        // Ink spreads, and black squares that should only touch grow together: white grown by a pixel parts them.
        let grown = lightest_of_nine(pixels, size);
        detections.extend(detector.detect(view(&grown, size)));
    }
    detections
}

/// The markers at their places on a board, as far as they agree.
fn group(board: &Board, detections: &[Detection]) -> Vec<PlacedMarker> {
    consistent(&board.place(detections), board.pitch_m())
}

fn mean_hamming(detections: &[Detection]) -> f64 {
    let sum: u32 = detections.iter().map(|detection| detection.hamming).sum();
    f64::from(sum) / detections.len().max(1) as f64
}

fn columns(board: &Board) -> u32 {
    match *board {
        Board::AprilGrid { columns, .. } | Board::Charuco { columns, .. } | Board::Chessboard { columns, .. } => {
            columns
        }
    }
}

/// The board with another number of columns, and so many rows that every id of the family is on it.
fn with_columns(board: &Board, new: u32) -> Board {
    let mut board = *board;
    match &mut board {
        Board::AprilGrid {
            family, columns, rows, ..
        } => {
            *columns = new;
            *rows = family.codes().div_ceil(new);
        }
        Board::Charuco { columns, .. } => *columns = new,
        Board::Chessboard { .. } => {}
    }
    board
}

/// The board with ids counted from another one, and so many more rows that all higher ids have a place.
fn with_all_ids(board: &Board, start: u32) -> Board {
    let mut board = with_columns(board, columns(board));
    match &mut board {
        Board::AprilGrid { first_id, .. } => *first_id = start,
        Board::Charuco {
            family,
            columns,
            rows,
            first_id,
            ..
        } => {
            *first_id = start;
            // Two rows have as many markers as columns; an even number of new rows leaves the colours as they are.
            *rows += 2 * family.codes().div_ceil((*columns).max(1));
        }
        Board::Chessboard { .. } => {}
    }
    board
}

/// Grey values in which the middle between white and black in linear light is nearer to white: where the corners of black
/// squares touch, they count as apart, and each marker has an outline of its own.
fn brightened(luma: &LinearLuma) -> Vec<u8> {
    let most = luma.linear().iter().max().map_or(1.0, |&most| f64::from(most).max(1.0));
    let table: Vec<u8> = (0..=u16::MAX >> BRIGHT_SHIFT)
        .map(|bin| {
            let value = (f64::from(bin) + 0.5) * f64::from(1 << BRIGHT_SHIFT);
            (255.0 * (value / most).min(1.0).powf(BRIGHT_POWER)).round() as u8
        })
        .collect();
    let grey = |&value: &u16| table[usize::from(value >> BRIGHT_SHIFT)];
    luma.linear().iter().map(grey).collect()
}

fn view(pixels: &[u8], size: [usize; 2]) -> LumaView<'_> {
    LumaView::new(size, size[0], pixels).expect("`LinearLuma` has checked the size")
}

/// The lightest of every pixel and its eight neighbours.
fn lightest_of_nine(pixels: &[u8], [width, height]: [usize; 2]) -> Vec<u8> {
    let mut across = pixels.to_vec();
    for (row, source) in across
        .chunks_exact_mut(width.max(1))
        .zip(pixels.chunks_exact(width.max(1)))
    {
        for (target, three) in row.iter_mut().skip(1).zip(source.windows(3)) {
            *target = three[0].max(three[1]).max(three[2]);
        }
    }
    let mut result = across.clone();
    for y in 1..height.saturating_sub(1) {
        for x in 0..width {
            let i = y * width + x;
            result[i] = across[i - width].max(across[i]).max(across[i + width]);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_grows_by_a_pixel() {
        let mut pixels = vec![0; 7 * 5];
        pixels[2 * 7 + 3] = 9;
        let grown = lightest_of_nine(&pixels, [7, 5]);
        for (i, &value) in grown.iter().enumerate() {
            let near = (2..=4).contains(&(i % 7)) && (1..=3).contains(&(i / 7));
            assert_eq!(value, if near { 9 } else { 0 }, "{i}");
        }
        for size in [[0, 0], [1, 1], [2, 3], [3, 1]] {
            let pixels = vec![7; size[0] * size[1]];
            assert_eq!(lightest_of_nine(&pixels, size), pixels);
        }
    }
}
