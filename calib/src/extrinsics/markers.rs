//! Where markers are to each other, from pictures by a camera whose lens is known.
//!
//! Markers that are seen together are chained from the main marker along the pairs that most pictures agree on (maximum
//! spanning tree), then all of them and all stations of the camera are adjusted together. World = the main marker.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Matrix6;

use super::{
    PoseSigma, RejectedDetection, View, ViewResult,
    bundle::{Bundle, BundleError, Eye, Poses, Sighting, Square},
    start,
};
use crate::{camera::Intrinsics, pose::Pose, resection::corner_sigma_px};

/// Pictures that must show two connected markers or more.
pub const MIN_VIEWS: usize = 3;

/// What a field of markers is found from.
#[derive(Debug, Clone, Copy)]
pub struct FieldInput<'a> {
    /// The lens of the camera that took all pictures.
    pub intrinsics: &'a Intrinsics,
    /// The pictures.
    pub views: &'a [View],
    /// Side of the black square of each marker, in metres, by id. Other markers are left out and named.
    pub sides_m: &'a BTreeMap<u32, f64>,
    /// Id of the marker whose frame is the world.
    pub main_marker: u32,
}

/// Markers, and how well they are known.
#[derive(Debug, Clone)]
pub struct MarkerField {
    /// The markers, by id, the main one too.
    pub markers: Vec<FieldMarker>,
    /// Pictures that were used.
    pub views: Vec<ViewResult>,
    /// Detections that do not fit.
    pub rejected: Vec<RejectedDetection>,
    /// Root mean square distance of the corners that count from where they should be, in pixels.
    pub rms_px: f64,
    /// Markers that no chain of pictures connects with the main one.
    pub unconnected: Vec<u32>,
    /// Markers seen whose side is not known.
    pub without_side: Vec<u32>,
}

/// A marker of a field.
#[derive(Debug, Clone, Copy)]
pub struct FieldMarker {
    /// Number of its code.
    pub id: u32,
    /// Side of the black square in metres.
    pub side_m: f64,
    /// Where it is.
    pub world_from_marker: Pose,
    /// Covariance of the twist ξ in `world_from_marker * exp(ξ)`, rotation first, in rad² and m²; zero for the main marker.
    pub covariance: Matrix6<f64>,
    /// The same in two numbers.
    pub sigma: PoseSigma,
    /// Pictures that show it and were used.
    pub views: usize,
}

/// Why there is no field of markers.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// The side of the main marker is not known.
    #[error("the side of main marker `{main_marker}` is not known")]
    NoMainSide {
        /// Its id.
        main_marker: u32,
    },
    /// The main marker is in no picture.
    #[error("main marker `{main_marker}` is in none of `{views}` pictures (seen: {seen})")]
    MainUnseen {
        /// Its id.
        main_marker: u32,
        /// Pictures searched.
        views: usize,
        /// Markers seen.
        seen: String,
    },
    /// Nothing to relate it to.
    #[error(
        "`{found}` pictures show main marker `{main_marker}` or a marker connected with it beside another one (needed: `{MIN_VIEWS}`)"
    )]
    TooFewViews {
        /// Pictures found.
        found: usize,
        /// The main marker's id.
        main_marker: u32,
    },
    /// The adjustment failed.
    #[error("the adjustment of the markers failed")]
    Bundle(#[from] BundleError),
}

/// Finds where the markers are.
///
/// # Errors
/// When the main marker is not seen, is not seen beside others in [`MIN_VIEWS`] pictures, or pictures contradict each other.
pub fn solve(input: &FieldInput<'_>) -> Result<MarkerField, FieldError> {
    let main_marker = input.main_marker;
    if !input.sides_m.contains_key(&main_marker) {
        return Err(FieldError::NoMainSide { main_marker });
    }
    let seen: BTreeSet<u32> = ids(input.views);
    if !seen.contains(&main_marker) {
        let seen: Vec<String> = seen.iter().map(|id| format!("`{id}`")).collect();
        return Err(FieldError::MainUnseen {
            main_marker,
            views: input.views.len(),
            seen: if seen.is_empty() {
                "none".to_owned()
            } else {
                seen.join(", ")
            },
        });
    }
    let all = everything(input, &seen);
    let chained = chain(&all, main_marker);
    let bundle = connected(&all, &chained);
    if bundle.n_stations < MIN_VIEWS {
        return Err(FieldError::TooFewViews {
            found: bundle.n_stations,
            main_marker,
        });
    }
    let world_from_marker = bundle.squares.iter().map(|square| chained[&square.id]).collect();
    let settled = bundle.settle(first_poses(&bundle, world_from_marker))?;
    let covariances = settled.square_covariances().map_err(BundleError::Solve)?;
    let mut markers = Vec::new();
    for (index, square) in bundle.squares.iter().enumerate() {
        let covariance = covariances[index].unwrap_or_else(Matrix6::zeros);
        let views = bundle.sightings.iter().filter(|sighting| sighting.square == index);
        markers.push(FieldMarker {
            id: square.id,
            side_m: square.side_m,
            world_from_marker: settled.poses.world_from_marker[index],
            covariance,
            sigma: PoseSigma::of(&covariance),
            views: views.map(|sighting| sighting.view).collect::<BTreeSet<_>>().len(),
        });
    }
    let unconnected = all.squares.iter().filter(|square| !chained.contains_key(&square.id));
    Ok(MarkerField {
        markers,
        views: settled.views,
        rejected: settled.rejected,
        rms_px: settled.rms_px,
        unconnected: unconnected.map(|square| square.id).collect(),
        without_side: seen.into_iter().filter(|id| !input.sides_m.contains_key(id)).collect(),
    })
}

fn ids(views: &[View]) -> BTreeSet<u32> {
    let detections = views.iter().flat_map(|view| &view.detections);
    detections.map(|detection| detection.id).collect()
}

/// All markers of known side in all pictures, every picture a station.
fn everything(input: &FieldInput<'_>, seen: &BTreeSet<u32>) -> Bundle {
    let known = seen.iter().filter_map(|id| Some((*id, *input.sides_m.get(id)?)));
    let squares: Vec<Square> = known
        .map(|(id, side_m)| Square {
            id,
            side_m,
            is_free: id != input.main_marker,
        })
        .collect();
    let mut sightings = Vec::new();
    for (view, picture) in input.views.iter().enumerate() {
        for detection in &picture.detections {
            let Some(square) = squares.iter().position(|square| square.id == detection.id) else {
                continue;
            };
            sightings.push(Sighting {
                view,
                station: view,
                eye: 0,
                square,
                corners_px: detection.corners_px,
                sigma_px: corner_sigma_px(detection),
            });
        }
    }
    Bundle {
        views: input.views.iter().map(|view| view.name.clone()).collect(),
        eyes: vec![Eye {
            intrinsics: *input.intrinsics,
            is_free: false,
        }],
        squares,
        n_stations: input.views.len(),
        sightings,
    }
}

/// First places of all markers that a chain of pictures connects with the main one (Prim 1957, for the largest support).
fn chain(bundle: &Bundle, main_marker: u32) -> BTreeMap<u32, Pose> {
    let mut pairs: BTreeMap<(usize, usize), Vec<(&Sighting, &Sighting)>> = BTreeMap::new();
    for first in &bundle.sightings {
        for second in bundle.sightings.iter().filter(|second| second.station == first.station) {
            if first.square != second.square {
                pairs
                    .entry((first.square, second.square))
                    .or_default()
                    .push((first, second));
            }
        }
    }
    let edges: Vec<(usize, usize, Pose, f64)> = pairs
        .iter()
        .filter_map(|(&(first, second), pairs)| {
            let (first_from_second, support) = start::relative_marker(bundle, pairs)?;
            Some((first, second, first_from_second, support))
        })
        .collect();
    let main = bundle.squares.iter().position(|square| square.id == main_marker);
    let mut placed: BTreeMap<usize, Pose> = main.into_iter().map(|main| (main, Pose::identity())).collect();
    loop {
        let leaving = edges
            .iter()
            .filter(|(first, second, ..)| placed.contains_key(first) && !placed.contains_key(second));
        let Some((first, second, first_from_second, _)) = leaving.max_by(|a, b| a.3.total_cmp(&b.3)) else {
            break;
        };
        let pose = placed[first] * *first_from_second;
        placed.insert(*second, pose);
    }
    placed
        .into_iter()
        .map(|(square, pose)| (bundle.squares[square].id, pose))
        .collect()
}

/// The part of a bundle that has places: pictures that show two such markers or more.
fn connected(all: &Bundle, chained: &BTreeMap<u32, Pose>) -> Bundle {
    let is_placed = |square: usize| chained.contains_key(&all.squares[square].id);
    let mut seen = vec![BTreeSet::new(); all.views.len()];
    for sighting in all.sightings.iter().filter(|sighting| is_placed(sighting.square)) {
        seen[sighting.view].insert(sighting.square);
    }
    let views: Vec<usize> = (0..seen.len()).filter(|view| seen[*view].len() > 1).collect();
    let squares: Vec<usize> = (0..all.squares.len()).filter(|square| is_placed(*square)).collect();
    let sightings = all.sightings.iter().filter_map(|sighting| {
        let view = views.iter().position(|view| *view == sighting.view)?;
        Some(Sighting {
            view,
            station: view,
            square: squares.iter().position(|square| *square == sighting.square)?,
            ..sighting.clone()
        })
    });
    Bundle {
        sightings: sightings.collect(),
        views: views.iter().map(|view| all.views[*view].clone()).collect(),
        eyes: all.eyes.clone(),
        squares: squares.iter().map(|square| all.squares[*square]).collect(),
        n_stations: views.len(),
    }
}

fn first_poses(bundle: &Bundle, world_from_marker: Vec<Pose>) -> Poses {
    let station = |station: usize| {
        let sightings: Vec<&Sighting> = bundle.sightings.iter().filter(|s| s.station == station).collect();
        let poses = start::rig_poses(bundle, &[Pose::identity()], &world_from_marker, &sightings);
        poses.first().copied().unwrap_or_else(Pose::identity)
    };
    Poses {
        rig_from_world: (0..bundle.n_stations).map(station).collect(),
        camera_from_rig: vec![Pose::identity()],
        world_from_marker,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extrinsics::simulation::{Noise, field, lens, marker, pose, squared_deviations, tour};
    use crate::rig::Marker;

    fn sides(markers: &[Marker]) -> BTreeMap<u32, f64> {
        markers.iter().map(|marker| (marker.id, marker.side_m)).collect()
    }

    fn solved(markers: &[Marker], views: &[View]) -> Result<MarkerField, FieldError> {
        solve(&FieldInput {
            intrinsics: &lens(),
            views,
            sides_m: &sides(markers),
            main_marker: 0,
        })
    }

    #[test]
    fn exact_corners_give_exact_markers() {
        let markers = field();
        let found = solved(&markers, &tour(&markers, 12, &mut Noise(1), 0.0)).unwrap();
        assert_eq!(found.markers.len(), markers.len());
        assert_eq!(found.rejected, []);
        for (found, truth) in found.markers.iter().zip(&markers) {
            let off = found.world_from_marker.inverse() * truth.world_from_marker;
            assert!(off.translation.length() < 1e-8, "{off:?}");
            assert!(off.angle_to(&Pose::identity()) < 1e-7, "{off:?}");
        }
    }

    /// The set that BENCHMARKS quotes: corners good to 0.05 px, 30 pictures of 1280×960 from 0.5 to 1 m.
    #[test]
    fn sigma_is_what_errors_are() {
        let markers = field();
        let (mut sum, mut n) = (0.0, 0.0);
        for seed in 0..12 {
            let views = tour(&markers, 30, &mut Noise(100 + seed), 0.05);
            let found = solved(&markers, &views).unwrap();
            for (found, truth) in found.markers.iter().zip(&markers).skip(1) {
                let off = (found.world_from_marker.inverse() * truth.world_from_marker).log();
                assert!(off.rotation.length() < 0.1f64.to_radians(), "{off:?}");
                assert!(off.translation.length() < 0.3e-3, "{off:?}");
                sum += squared_deviations(off, &found.covariance) / 6.0;
                n += 1.0;
            }
        }
        let ratio = f64::sqrt(sum / n);
        println!("markers, {n} errors of {ratio:.2} σ");
        assert!((1.0 / 1.5..1.5).contains(&ratio), "{ratio}");
    }

    #[test]
    fn wrong_detections_are_named_and_do_not_matter() {
        let markers = field();
        let mut views = tour(&markers, 20, &mut Noise(3), 0.05);
        // A corner that something covers, and a marker that was taken for another one.
        views[4].detections[0].corners_px[2].x += 3.0;
        let stolen = views[7].detections[1].corners_px;
        views[7].detections[2].corners_px = stolen;
        let found = solved(&markers, &views).unwrap();
        let rejected: Vec<(&str, u32, usize)> = found
            .rejected
            .iter()
            .map(|r| (r.view.as_str(), r.marker, r.corners))
            .collect();
        let (covered, wrong) = (views[4].detections[0].id, views[7].detections[2].id);
        assert_eq!(rejected, [("000004.png", covered, 1), ("000007.png", wrong, 4)]);
        for (found, truth) in found.markers.iter().zip(&markers) {
            let off = found.world_from_marker.inverse() * truth.world_from_marker;
            assert!(off.translation.length() < 0.3e-3, "{off:?}");
        }
    }

    #[test]
    fn small_markers_seen_from_the_front_are_not_flipped() {
        // 15 pixels a side: either planar solution fits a single picture.
        let markers = [
            marker(0, 0.012, Pose::identity()),
            marker(7, 0.012, pose([0.0, 0.25, 0.0], [0.04, 0.01, 0.0])),
        ];
        let views = tour(&markers, 30, &mut Noise(5), 0.1);
        let found = solved(&markers, &views).unwrap();
        let off = found.markers[1].world_from_marker.inverse() * markers[1].world_from_marker;
        assert!(off.angle_to(&Pose::identity()) < 2f64.to_radians(), "{off:?}");
    }

    #[test]
    fn what_is_not_connected_or_not_known_is_named() {
        let mut markers = field();
        let mut views = tour(&markers, 12, &mut Noise(2), 0.02);
        for view in &mut views {
            view.detections.retain(|detection| detection.id != 4);
        }
        views.extend(tour(&markers[4..], 5, &mut Noise(8), 0.02));
        markers.remove(3);
        let found = solved(&markers, &views).unwrap();
        assert_eq!(found.unconnected, [4]);
        assert_eq!(found.without_side, [3]);
        assert_eq!(
            found.markers.iter().map(|marker| marker.id).collect::<Vec<_>>(),
            [0, 1, 2]
        );
    }

    #[test]
    fn too_little_is_refused() {
        let markers = field();
        let views = tour(&markers, 2, &mut Noise(2), 0.02);
        let error = solved(&markers, &views).unwrap_err();
        assert_eq!(
            error,
            FieldError::TooFewViews {
                found: 2,
                main_marker: 0
            }
        );
        let error = solved(&markers[1..], &views).unwrap_err();
        assert_eq!(error, FieldError::NoMainSide { main_marker: 0 });
        let without = tour(&markers[1..3], 4, &mut Noise(2), 0.02);
        let error = solved(&markers, &without).unwrap_err();
        assert_eq!(
            error.to_string(),
            "main marker `0` is in none of `4` pictures (seen: `1`, `2`)"
        );
    }
}
