//! From a few corners to all: what is known says where the next one must be, and the picture whether it is there.

use glam::DVec2;

use super::{
    plane::LocalPlane,
    saddle::{self, Expected, Saddle},
};
use crate::tag::LinearLuma;

/// Known corners that tell where another one is.
const NEIGHBOURS: usize = 12;

/// Largest distance to the nearest known corner, in the board's grid pitches.
const MAX_DISTANCE: f64 = 1.6;

/// Times that a corner is looked for before it is given up; each time more is known around it.
const MAX_TRIES: u32 = 4;

/// Largest distance of a corner from where its neighbours say it is, as a fraction of the distance to the next structure.
const MAX_STRAY: f64 = 0.2;

/// The same in pixels, for tiny boards.
const MAX_STRAY_PX: f64 = 0.7;

/// Largest misfit of a corner: so many times the median of all, plus so much.
const MAX_MISFIT_RATIO: f64 = 4.0;
const MAX_MISFIT_MORE: f64 = 0.05;

/// Corners that say what corners look like here.
const MIN_TO_COMPARE: usize = 4;

/// Largest blur of a corner: so many times that of its neighbours, plus so much.
const MAX_WIDTH_RATIO: f64 = 1.5;
const MAX_WIDTH_MORE_PX: f64 = 0.6;

/// Least contrast of a corner, relative to its neighbours.
const MIN_CONTRAST_RATIO: f64 = 0.35;

/// Rounds of finding all corners again, each with better known surroundings.
const POLISHING: usize = 2;

/// A corner that the board has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Target {
    /// Where, in metres on the board.
    pub(super) place_m: DVec2,
    /// How far its two edges go at least, either way, in metres.
    pub(super) edge_m: f64,
    /// How far there is nothing else to either side of them, in metres.
    pub(super) band_m: f64,
    /// Whether the squares to the top right and the bottom left are the black ones.
    pub(super) rising_black: bool,
}

/// Corners of a board, as far as they are known.
pub(super) struct Growth<'a> {
    luma: &'a LinearLuma,
    targets: &'a [Target],
    /// Distance of neighbouring corners or markers, in metres.
    pitch_m: f64,
    /// Rough places of corners that were not refined, and the corners.
    seen: Vec<Option<Seen>>,
}

/// A corner that is known.
#[derive(Debug, Clone, Copy)]
pub(super) enum Seen {
    /// Roughly: good enough to tell where others are.
    Rough(DVec2),
    /// Well.
    Found(Saddle),
}

impl Seen {
    fn pixel(&self) -> DVec2 {
        match self {
            Self::Rough(pixel) => *pixel,
            Self::Found(saddle) => saddle.pixel,
        }
    }
}

impl<'a> Growth<'a> {
    /// Nothing is known yet.
    pub(super) fn new(luma: &'a LinearLuma, targets: &'a [Target], pitch_m: f64) -> Self {
        Self {
            luma,
            targets,
            pitch_m,
            seen: vec![None; targets.len()],
        }
    }

    /// Looks for a corner where a plane says it is.
    pub(super) fn try_at(&mut self, index: usize, plane: &LocalPlane) -> bool {
        if let Some(saddle) = self.find(index, plane) {
            self.seen[index] = Some(Seen::Found(saddle));
        }
        self.seen[index].is_some()
    }

    /// Takes a rough place as known.
    pub(super) fn assume(&mut self, index: usize, pixel: DVec2) {
        self.seen[index] = Some(Seen::Rough(pixel));
    }

    /// Finds whatever can be found, and returns what is sure.
    pub(super) fn finish(mut self) -> Vec<(usize, Saddle)> {
        self.spread();
        for _ in 0..POLISHING {
            self.polish();
            self.prune();
        }
        let found = self.seen.iter().enumerate().filter_map(|(index, seen)| match seen {
            Some(Seen::Found(saddle)) => Some((index, *saddle)),
            Some(Seen::Rough(_)) | None => None,
        });
        found.collect()
    }

    /// Looks for unknown corners next to known ones until there are no more.
    fn spread(&mut self) {
        let mut tries = vec![0; self.targets.len()];
        loop {
            let mut progress = false;
            for (index, tries) in tries.iter_mut().enumerate() {
                if matches!(self.seen[index], Some(Seen::Found(_))) || *tries >= MAX_TRIES {
                    continue;
                }
                let Some(plane) = self.plane_around(index, MAX_DISTANCE * self.pitch_m) else {
                    continue;
                };
                *tries += 1;
                if let Some(saddle) = self.find(index, &plane) {
                    self.seen[index] = Some(Seen::Found(saddle));
                    progress = true;
                }
            }
            if !progress {
                return;
            }
        }
    }

    /// Finds every corner again, its window laid by its neighbours.
    fn polish(&mut self) {
        let planes: Vec<Option<LocalPlane>> = (0..self.targets.len())
            .map(|index| {
                self.seen[index]?;
                self.plane_around(index, f64::INFINITY)
            })
            .collect();
        for (index, plane) in planes.iter().enumerate() {
            let Some(Seen::Found(before)) = self.seen[index] else {
                continue;
            };
            let again = plane
                .as_ref()
                .and_then(|plane| self.expected(index, plane))
                .and_then(|expected| {
                    saddle::find(
                        self.luma,
                        &Expected {
                            pixel: before.pixel,
                            ..expected
                        },
                    )
                })
                .filter(|saddle| self.has_right_colours(index, saddle));
            self.seen[index] = again.map(Seen::Found);
        }
    }

    /// Drops corners that look different from all others, and those that are not where their neighbours say, the worst
    /// first.
    fn prune(&mut self) {
        let misfit = |seen: &Option<Seen>| match seen {
            Some(Seen::Found(saddle)) => Some(saddle.misfit),
            Some(Seen::Rough(_)) | None => None,
        };
        let mut misfits: Vec<f64> = self.seen.iter().filter_map(misfit).collect();
        misfits.sort_by(f64::total_cmp);
        if let Some(median) = misfits.get(misfits.len() / 2) {
            let limit = MAX_MISFIT_RATIO * median + MAX_MISFIT_MORE;
            for seen in &mut self.seen {
                if misfit(seen).is_some_and(|misfit| misfit > limit) {
                    *seen = None;
                }
            }
        }
        for _ in 0..self.targets.len() {
            let strays = (0..self.targets.len()).filter_map(|index| Some((index, self.stray(index)?)));
            let Some((worst, stray)) = strays.max_by(|a, b| a.1.total_cmp(&b.1)) else {
                return;
            };
            if stray < 1.0 {
                return;
            }
            self.seen[worst] = None;
        }
    }

    /// Distance of a known corner from where its neighbours say it is, as a multiple of what is allowed.
    fn stray(&self, index: usize) -> Option<f64> {
        let pixel = self.seen[index]?.pixel();
        let Some(expected) = self
            .plane_around(index, f64::INFINITY)
            .and_then(|plane| self.expected(index, &plane))
        else {
            return Some(f64::INFINITY);
        };
        let edge = expected.clear[0].length().min(expected.clear[1].length());
        Some(expected.pixel.distance(pixel) / (MAX_STRAY * edge).max(MAX_STRAY_PX))
    }

    /// The board around a corner as its nearest known neighbours, not itself, show it; the nearest no further than
    /// `reach_m`.
    fn plane_around(&self, index: usize, reach_m: f64) -> Option<LocalPlane> {
        let known = self.neighbours(index);
        let nearest = known.iter().map(|known| known.0).fold(f64::INFINITY, f64::min);
        if nearest > reach_m * reach_m {
            return None;
        }
        let pairs: Vec<(DVec2, DVec2)> = known
            .iter()
            .filter_map(|&(_, other)| Some((self.targets[other].place_m, self.seen[other]?.pixel())))
            .collect();
        LocalPlane::fit(&pairs)
    }

    /// The nearest known corners but this one, with their squared distances on the board.
    fn neighbours(&self, index: usize) -> Vec<(f64, usize)> {
        let place = self.targets[index].place_m;
        let mut known: Vec<(f64, usize)> = (0..self.targets.len())
            .filter(|&other| other != index && self.seen[other].is_some())
            .map(|other| (self.targets[other].place_m.distance_squared(place), other))
            .collect();
        if known.len() > NEIGHBOURS {
            known.select_nth_unstable_by(NEIGHBOURS, |a, b| a.partial_cmp(b).expect("distances are numbers"));
            known.truncate(NEIGHBOURS);
        }
        known
    }

    fn expected(&self, index: usize, plane: &LocalPlane) -> Option<Expected> {
        let target = &self.targets[index];
        let axes = plane.axes(target.place_m)?;
        Some(Expected {
            pixel: plane.pixel(target.place_m)?,
            clear: axes.map(|axis| axis * target.edge_m),
            band: target.band_m / target.edge_m,
        })
    }

    fn find(&self, index: usize, plane: &LocalPlane) -> Option<Saddle> {
        let saddle = saddle::find(self.luma, &self.expected(index, plane)?)?;
        (self.has_right_colours(index, &saddle) && self.is_alike(index, &saddle)).then_some(saddle)
    }

    /// Whether a corner is about as sharp and as strong as those around it.
    fn is_alike(&self, index: usize, saddle: &Saddle) -> bool {
        let around = self
            .neighbours(index)
            .into_iter()
            .filter_map(|(_, other)| match self.seen[other] {
                Some(Seen::Found(saddle)) => Some((saddle.edge_width_px, saddle.contrast.abs())),
                Some(Seen::Rough(_)) | None => None,
            });
        let (mut widths, mut contrasts): (Vec<f64>, Vec<f64>) = around.unzip();
        if widths.len() < MIN_TO_COMPARE {
            return true;
        }
        widths.sort_by(f64::total_cmp);
        contrasts.sort_by(f64::total_cmp);
        let (width, contrast) = (widths[widths.len() / 2], contrasts[contrasts.len() / 2]);
        saddle.edge_width_px < MAX_WIDTH_RATIO * width + MAX_WIDTH_MORE_PX
            && saddle.contrast.abs() > MIN_CONTRAST_RATIO * contrast
    }

    /// Pictures have y down, so on a board seen from the front the axes turn the other way, and the product of the
    /// distances to both is negative in its rising squares.
    fn has_right_colours(&self, index: usize, saddle: &Saddle) -> bool {
        (saddle.contrast > 0.0) == self.targets[index].rising_black
    }
}
