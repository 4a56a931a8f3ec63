//! Which views of a board are still missing, and what to do next.

use std::collections::HashMap;

use glam::{DVec2, DVec3};

use super::{
    planar_pose::PlanarPose,
    problem::{Corner, Sighting},
    start,
    warp::WarpedBoard,
};
use crate::{
    board::{Board, BoardView},
    camera::{Intrinsics, Model},
};

/// Cells of the grid over the picture that should all have seen a corner.
pub(super) const CELLS: [usize; 2] = [8, 6];

/// Views that make a good calibration.
const ENOUGH_VIEWS: usize = 20;

/// Views wanted of each tilt.
const PER_TILT: usize = 2;

/// Angle between the board's normal and the line of sight, in radians, from which on the board counts as tilted.
const TILTED_RAD: f64 = 0.26;

/// Part of the cells that may stay empty: the corners of a picture are hard to reach.
const MAY_BE_EMPTY: f64 = 0.1;

/// Part of the picture's diagonal by which a view must differ from every earlier one with the board tilted likewise to be new.
const NEW: f64 = 0.03;

/// Part of the diagonal by which a view that is selected must differ from all others: more than a hand trembles.
const MOVED: f64 = 0.005;

/// Edge width in pixels above which a picture is too blurred for good corners; a sharp one has 0.3 to 0.7.
const BLURRED_PX: f64 = 1.5;

/// Where the board faces, seen from the camera.
const TILTS: [&str; 5] = ["straight at the camera", "to the left", "to the right", "up", "down"];

/// What a view adds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Taken {
    /// Something new.
    New,
    /// The same as an earlier view.
    Known,
    /// It is too blurred.
    Blurred {
        /// Width of its edges, in pixels.
        edge_width_px: f64,
    },
    /// No pose explains it.
    NoPose,
}

/// What is there and what is missing.
#[derive(Debug, Clone, PartialEq)]
pub struct Advice {
    /// What to do next, the most useful first; empty when enough is there.
    pub next: Vec<String>,
    /// Views that count.
    pub views: usize,
    /// Corners seen per cell of the picture, row by row from the top.
    pub corners: Vec<u32>,
    /// Cells from left to right.
    pub columns: usize,
    /// Views with the board facing straight at the camera, to the left, to the right, up and down. Counted is where the normal of
    /// its printed side points, against the line from the board's middle to the camera: a board at the edge of the picture that
    /// is parallel to the sensor is tilted, as it is seen obliquely.
    pub tilts: [usize; 5],
}

/// Watches views come in, live or one after the other, and says what to take next.
#[derive(Debug, Clone)]
pub struct Guide {
    board: WarpedBoard,
    lens: Intrinsics,
    /// Views that count, and where the board faced.
    views: Vec<(BoardView, usize)>,
    corners: [u32; CELLS[0] * CELLS[1]],
    tilts: [usize; 5],
    largest: f64,
}

impl Guide {
    /// A guide that has seen nothing. The lens is not known yet: an ordinary one of this model is assumed, which is good enough
    /// to tell left from right.
    #[must_use]
    pub fn new(board: &Board, size_px: [u32; 2], model: Model) -> Self {
        Self {
            board: WarpedBoard::new(board.corners_m()),
            lens: start::ordinary(model, size_px),
            views: Vec::new(),
            corners: [0; CELLS[0] * CELLS[1]],
            tilts: [0; 5],
            largest: 0.0,
        }
    }

    /// Looks through this lens from now on.
    pub fn set_lens(&mut self, lens: &Intrinsics) {
        self.lens = *lens;
    }

    /// Takes a view in, and says what it adds. `edge_width_px` is the detector's measure of blur, where there is one.
    pub fn add(&mut self, view: &BoardView, edge_width_px: Option<f64>) -> Taken {
        if let Some(edge_width_px) = edge_width_px.filter(|width| *width > BLURRED_PX) {
            return Taken::Blurred { edge_width_px };
        }
        let diagonal = self.size().length();
        let Some(tilt) = self.tilt(view) else {
            return Taken::NoPose;
        };
        // From far away a board that faces left looks almost like one that faces right; they say different things.
        let mut alike = self.views.iter().filter(|(_, other)| *other == tilt);
        if alike.any(|(other, _)| apart(other, view, diagonal) < NEW) {
            return Taken::Known;
        }
        self.tilts[tilt] += 1;
        let size = self.size();
        for corner in &view.corners {
            if let Some(cell) = cell(corner.pixel, size) {
                self.corners[cell] += 1;
            }
        }
        self.largest = self.largest.max(extent(view) / diagonal);
        self.views.push((view.clone(), tilt));
        Taken::New
    }

    /// What is there, and what to take next.
    #[must_use]
    pub fn advice(&self) -> Advice {
        let mut next = Vec::new();
        let rarest = (1..TILTS.len())
            .min_by_key(|&i| self.tilts[i])
            .filter(|&i| self.tilts[i] < PER_TILT);
        if let Some(tilt) = rarest {
            next.push(format!(
                "turn the board by 20 to 45 degrees, so that it faces {}",
                TILTS[tilt]
            ));
        }
        if self.empty() > MAY_BE_EMPTY
            && let Some(place) = self.emptiest()
        {
            next.push(format!("hold the board {place} of the picture"));
        }
        if self.largest < 0.4 {
            next.push("bring the board closer: it should fill half of the picture".to_owned());
        }
        if self.views.len() < ENOUGH_VIEWS && next.is_empty() {
            next.push(format!(
                "take {} more views, each from elsewhere",
                ENOUGH_VIEWS - self.views.len()
            ));
        }
        Advice {
            next,
            views: self.views.len(),
            corners: self.corners.to_vec(),
            columns: CELLS[0],
            tilts: self.tilts,
        }
    }

    fn size(&self) -> DVec2 {
        DVec2::new(f64::from(self.lens.size_px[0]), f64::from(self.lens.size_px[1]))
    }

    /// Where the board faces: an index into [`TILTS`].
    fn tilt(&self, view: &BoardView) -> Option<usize> {
        let sighting = Sighting {
            view: 0,
            corners: view
                .corners
                .iter()
                .map(|corner| Corner {
                    index: corner.corner as usize,
                    pixel: corner.pixel,
                    sigma_px: corner.sigma_px,
                    used: true,
                })
                .collect(),
        };
        let (pose, _) = start::pose(&self.lens, &self.board, &sighting)?;
        Some(facing(&pose, &self.board))
    }

    /// Part of the cells without a corner, of those that the lens images.
    fn empty(&self) -> f64 {
        empty_cells(&self.lens, &self.corners)
    }

    /// The ninth of the picture with the most cells without a corner.
    fn emptiest(&self) -> Option<&'static str> {
        const PLACES: [&str; 9] = [
            "at the top left",
            "at the top",
            "at the top right",
            "at the left",
            "in the middle",
            "at the right",
            "at the bottom left",
            "at the bottom",
            "at the bottom right",
        ];
        let (mut missing, mut cells) = ([0u32; 9], [0u32; 9]);
        for (index, count) in self.corners.iter().enumerate() {
            let place = (index / CELLS[0] * 3 / CELLS[1]) * 3 + index % CELLS[0] * 3 / CELLS[0];
            cells[place] += 1;
            missing[place] += u32::from(*count == 0);
        }
        let share = |place: &usize| f64::from(missing[*place]) / f64::from(cells[*place]);
        let most = (0..9).max_by(|a, b| share(a).total_cmp(&share(b)))?;
        (missing[most] > 0).then_some(PLACES[most])
    }
}

/// At most `limit` of the views, each as different from the others as can be: a recording holds the same view many times.
/// Indices, rising.
#[must_use]
pub fn select(views: &[BoardView], size_px: [u32; 2], limit: usize) -> Vec<usize> {
    let diagonal = DVec2::new(f64::from(size_px[0]), f64::from(size_px[1])).length();
    let mut distance = vec![f64::INFINITY; views.len()];
    let mut chosen: Vec<usize> = Vec::new();
    let mut next = (0..views.len()).rev().max_by_key(|&i| views[i].corners.len());
    while let Some(index) = next.filter(|_| chosen.len() < limit) {
        chosen.push(index);
        for (i, least) in distance.iter_mut().enumerate() {
            *least = least.min(apart(&views[index], &views[i], diagonal));
        }
        distance[index] = 0.0;
        next = (0..views.len())
            .filter(|&i| distance[i] >= MOVED)
            .max_by(|&a, &b| distance[a].total_cmp(&distance[b]));
    }
    chosen.sort_unstable();
    chosen
}

/// How different two views are: the mean way of the corners that both show, in parts of the diagonal; 1 when they share less than
/// half of the smaller.
fn apart(a: &BoardView, b: &BoardView, diagonal: f64) -> f64 {
    let places: HashMap<u32, DVec2> = a.corners.iter().map(|corner| (corner.corner, corner.pixel)).collect();
    let ways = b
        .corners
        .iter()
        .filter_map(|corner| Some(places.get(&corner.corner)?.distance(corner.pixel)));
    let (sum, count) = ways.fold((0.0, 0usize), |(sum, count), way| (sum + way, count + 1));
    if 2 * count < a.corners.len().min(b.corners.len()).max(1) {
        return 1.0;
    }
    sum / count as f64 / diagonal
}

/// Where the board faces: an index into [`TILTS`].
fn facing(pose: &PlanarPose, board: &WarpedBoard) -> usize {
    let pose = pose.camera_from_board;
    let middle = (0..board.len()).map(|i| board.flat(i)).sum::<DVec3>() / board.len() as f64;
    let towards_camera = -pose.transform_point(middle).normalize();
    let normal = pose.rotation.z_axis;
    if normal.angle_between(towards_camera) < TILTED_RAD {
        return 0;
    }
    let aside = normal - towards_camera * normal.dot(towards_camera);
    match (aside.x.abs() > aside.y.abs(), aside.x > 0.0, aside.y > 0.0) {
        (true, false, _) => 1,
        (true, true, _) => 2,
        (false, _, false) => 3,
        (false, _, true) => 4,
    }
}

fn extent(view: &BoardView) -> f64 {
    let low = view.corners.iter().fold(DVec2::INFINITY, |low, c| low.min(c.pixel));
    let high = view
        .corners
        .iter()
        .fold(DVec2::NEG_INFINITY, |high, c| high.max(c.pixel));
    (high - low).max(DVec2::ZERO).length()
}

fn cell(pixel: DVec2, size: DVec2) -> Option<usize> {
    let place = (pixel + 0.5) / size * DVec2::new(CELLS[0] as f64, CELLS[1] as f64);
    let inside = place.cmpge(DVec2::ZERO).all() && place.x < CELLS[0] as f64 && place.y < CELLS[1] as f64;
    inside.then(|| place.y as usize * CELLS[0] + place.x as usize)
}

/// Part of the picture, as far as the lens images anything there, without a corner.
pub(super) fn empty_part(lens: &Intrinsics, pixels: impl Iterator<Item = DVec2>) -> f64 {
    let size = DVec2::new(f64::from(lens.size_px[0]), f64::from(lens.size_px[1]));
    let mut corners = [0; CELLS[0] * CELLS[1]];
    for index in pixels.filter_map(|pixel| cell(pixel, size)) {
        corners[index] += 1;
    }
    empty_cells(lens, &corners)
}

fn empty_cells(lens: &Intrinsics, corners: &[u32]) -> f64 {
    let size = DVec2::new(f64::from(lens.size_px[0]), f64::from(lens.size_px[1]));
    let imaged = |index: &usize| {
        let middle = DVec2::new((index % CELLS[0]) as f64 + 0.5, (index / CELLS[0]) as f64 + 0.5);
        let pixel = middle / DVec2::new(CELLS[0] as f64, CELLS[1] as f64) * size - 0.5;
        lens.unproject(pixel).is_some()
    };
    let imaged: Vec<usize> = (0..corners.len()).filter(imaged).collect();
    let empty = imaged.iter().filter(|&&index| corners[index] == 0).count();
    empty as f64 / imaged.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;
    use crate::intrinsics::synthetic::{Scene, grid, pinhole};
    use crate::pose::{Pose, Twist};

    /// A view of the whole board, its printed side turned by a rotation vector about the camera's axes.
    fn view(name: &str, turn: DVec3, place: DVec3) -> BoardView {
        let rotate = Pose::exp(Twist {
            rotation: turn,
            translation: DVec3::ZERO,
        });
        let rotation = rotate.rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let mut scene = Scene::new(pinhole(), 0, 0.0, 1);
        scene.poses = vec![Pose {
            rotation,
            translation: place - rotation * DVec3::new(0.33, 0.33, 0.0),
        }];
        let mut view = scene.views(0.0, 1).remove(0);
        view.name = name.to_owned();
        view
    }

    #[test]
    fn the_guide_asks_for_what_is_missing() {
        let mut guide = Guide::new(&grid(), [1280, 720], Model::BrownConrady);
        let straight = view("straight", DVec3::ZERO, DVec3::new(-0.2, -0.1, 1.6));
        assert_eq!(guide.add(&straight, Some(0.5)), Taken::New);
        assert_eq!(guide.add(&straight, Some(0.5)), Taken::Known);
        assert_eq!(guide.add(&straight, Some(3.0)), Taken::Blurred { edge_width_px: 3.0 });
        let advice = guide.advice();
        assert_eq!(advice.tilts, [1, 0, 0, 0, 0]);
        assert!(advice.next[0].contains("faces to the left"), "{:?}", advice.next);
        assert!(advice.next[1].contains("right of the picture"), "{:?}", advice.next);

        // The printed side turns about the vertical axis (y down): by a positive angle its normal -z swings to -x, the left.
        for (index, tilt) in [1, 2, 3, 4].into_iter().enumerate() {
            let turn = [DVec3::Y, -DVec3::Y, -DVec3::X, DVec3::X][index] * 0.5;
            for distance in [1.1, 1.7] {
                assert_eq!(guide.add(&view("tilted", turn, DVec3::Z * distance), None), Taken::New);
            }
            assert_eq!(guide.advice().tilts[tilt], 2, "{:?}", guide.advice());
        }
        let cells = guide.advice().corners;
        assert_eq!(cells.iter().map(|count| *count as usize).sum::<usize>(), {
            guide.views.iter().map(|(view, _)| view.corners.len()).sum::<usize>()
        });
    }

    #[test]
    fn views_that_are_alike_are_taken_once() {
        let scene = Scene::new(pinhole(), 6, 0.5, 3);
        let one = scene.views(0.0, 1);
        // Each view three times, hardly moved: a camera held still.
        let many: Vec<BoardView> = (0..3).flat_map(|take| scene.views(0.1, take)).collect();
        let chosen = select(&many, [1280, 720], 10);
        let mut places: Vec<usize> = chosen.iter().map(|index| index % one.len()).collect();
        places.sort_unstable();
        assert_eq!(places, [0, 1, 2, 3, 4, 5]);
        assert_eq!(select(&many, [1280, 720], 4).len(), 4);
        assert!(select(&[], [1280, 720], 4).is_empty());
    }
}
