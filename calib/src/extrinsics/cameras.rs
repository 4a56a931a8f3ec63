//! Where cameras are: one that stands still, or one beside another.
//!
//! Both are found from markers of known places ([`super::markers`] finds those). The markers may be a field on the
//! table of which each camera sees a part of its own, or a target that is carried about before two cameras.

use nalgebra::Matrix6;

use super::{
    PoseSigma, RejectedDetection, View, ViewResult,
    bundle::{Bundle, BundleError, Eye, Poses, Settled, Sighting, Square},
    start,
};
use crate::{
    camera::Intrinsics, least_squares::arrow::SolveError, pose::Pose, resection::corner_sigma_px, rig::Marker,
    tag::Detection,
};

/// Moments at which both cameras must see markers.
pub const MIN_PAIRS: usize = 3;

/// Difference of the sums of squared deviations below which two poses explain the pictures alike: three standard deviations.
const ALIKE: f64 = 9.0;

/// Angle, in radians, from which on two solutions are two: 1 degree.
const DIFFERENT_RAD: f64 = 0.017_453;

/// A pose between cameras or of one in the world, and how well it is known.
#[derive(Debug, Clone)]
pub struct CameraPlace {
    /// `camera_from_world` of a fixed camera, `second_from_first` of two.
    pub pose: Pose,
    /// Covariance of the twist ξ in `exp(ξ) * pose`, rotation first, in rad² and m².
    pub covariance: Matrix6<f64>,
    /// The same in two numbers.
    pub sigma: PoseSigma,
    /// Root mean square distance of the corners that count from where they should be, in pixels.
    pub rms_px: f64,
    /// Pictures with markers that are known.
    pub views: Vec<ViewResult>,
    /// Detections that do not fit.
    pub rejected: Vec<RejectedDetection>,
}

/// Why a camera has no place.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// No picture shows a marker whose place is known.
    #[error("none of `{views}` pictures shows a marker of the rig")]
    NoMarkers {
        /// Pictures searched.
        views: usize,
    },
    /// Two cameras hardly see markers at the same time.
    #[error("both cameras see markers of the rig at `{found}` moments (needed: `{MIN_PAIRS}`)")]
    TooFewPairs {
        /// Moments found.
        found: usize,
    },
    /// Corners are no pictures of squares.
    #[error("no marker's corners can be the picture of a square of its side")]
    NoSquare,
    /// Two poses explain the pictures.
    #[error("two poses explain the pictures alike, `{angle_deg:.1}°` from each other")]
    Ambiguous {
        /// Angle between both, degrees.
        angle_deg: f64,
    },
    /// The adjustment failed.
    #[error("the adjustment failed")]
    Bundle(#[from] BundleError),
}

/// Finds where a camera stands that did not move, from all of its pictures together.
///
/// # Errors
/// When no known marker is seen, or what is seen leaves the place open.
pub fn fixed(intrinsics: &Intrinsics, views: &[View], markers: &[Marker]) -> Result<CameraPlace, CameraError> {
    let mut bundle = empty(&[intrinsics], markers);
    for view in views {
        add(&mut bundle, view, markers, (0, 0));
    }
    if bundle.views.is_empty() {
        return Err(CameraError::NoMarkers { views: views.len() });
    }
    bundle.n_stations = 1;
    let world_from_marker: Vec<Pose> = markers.iter().map(|marker| marker.world_from_marker).collect();
    let sightings: Vec<&Sighting> = bundle.sightings.iter().collect();
    let starts = start::rig_poses(&bundle, &[Pose::identity()], &world_from_marker, &sightings);
    let poses = |camera_from_world: Pose| Poses {
        camera_from_rig: vec![Pose::identity()],
        world_from_marker: world_from_marker.clone(),
        rig_from_world: vec![camera_from_world],
    };
    let settled = best(&bundle, starts.into_iter().map(poses), |poses| poses.rig_from_world[0])?;
    let covariance = settled.station_covariance(0);
    place(settled.poses.rig_from_world[0], covariance, settled)
}

/// Finds where a second camera is to a first one, `second_from_first`, from pictures that both took at the same moments.
/// They may both move, or both stand still before a target that moves; each must see some of the markers, not the same.
///
/// # Errors
/// When there are less than [`MIN_PAIRS`] such moments, or what is seen leaves the pose open.
pub fn pair(lenses: [&Intrinsics; 2], pairs: &[[View; 2]], markers: &[Marker]) -> Result<CameraPlace, CameraError> {
    let mut bundle = empty(&lenses, markers);
    bundle.eyes[1].is_free = true;
    for both in pairs {
        let is_known = |view: &View| !known(view, markers).is_empty();
        if both.iter().all(is_known) {
            let station = bundle.n_stations;
            for (eye, view) in both.iter().enumerate() {
                add(&mut bundle, view, markers, (station, eye));
            }
            bundle.n_stations += 1;
        }
    }
    if bundle.n_stations < MIN_PAIRS {
        return Err(CameraError::TooFewPairs {
            found: bundle.n_stations,
        });
    }
    let world_from_marker: Vec<Pose> = markers.iter().map(|marker| marker.world_from_marker).collect();
    let seen: Vec<(Vec<&Sighting>, Vec<&Sighting>)> = (0..bundle.n_stations)
        .map(|station| {
            let here = bundle.sightings.iter().filter(|sighting| sighting.station == station);
            here.partition(|sighting| sighting.eye == 0)
        })
        .collect();
    let (second_from_first, _) =
        start::relative_camera(&bundle, &world_from_marker, &seen).ok_or(CameraError::NoSquare)?;
    let camera_from_rig = vec![Pose::identity(), second_from_first];
    let stations = seen.iter().map(|(first, second)| {
        let sightings: Vec<&Sighting> = first.iter().chain(second).copied().collect();
        let poses = start::rig_poses(&bundle, &camera_from_rig, &world_from_marker, &sightings);
        poses.first().copied().unwrap_or_else(Pose::identity)
    });
    let first_poses = Poses {
        rig_from_world: stations.collect(),
        camera_from_rig: camera_from_rig.clone(),
        world_from_marker: world_from_marker.clone(),
    };
    let settled = bundle.settle(first_poses)?;
    let covariance = settled.eye_covariance(1);
    place(settled.poses.camera_from_rig[1], covariance, settled)
}

/// A bundle of these cameras and markers, all fixed, of which nothing was seen yet.
fn empty(lenses: &[&Intrinsics], markers: &[Marker]) -> Bundle {
    let eye = |intrinsics: &&Intrinsics| Eye {
        intrinsics: **intrinsics,
        is_free: false,
    };
    let square = |marker: &Marker| Square {
        id: marker.id,
        side_m: marker.side_m,
        is_free: false,
    };
    Bundle {
        views: Vec::new(),
        eyes: lenses.iter().map(eye).collect(),
        squares: markers.iter().map(square).collect(),
        n_stations: 0,
        sightings: Vec::new(),
    }
}

/// Detections of known markers: place in the list, detection.
fn known<'a>(view: &'a View, markers: &[Marker]) -> Vec<(usize, &'a Detection)> {
    let find = |detection: &'a Detection| {
        let is_it = |marker: &Marker| (marker.family, marker.id) == (detection.family, detection.id);
        Some((markers.iter().position(is_it)?, detection))
    };
    view.detections.iter().filter_map(find).collect()
}

/// Adds a picture in which there are known markers.
fn add(bundle: &mut Bundle, view: &View, markers: &[Marker], (station, eye): (usize, usize)) {
    let known = known(view, markers);
    if known.is_empty() {
        return;
    }
    let number = bundle.views.len();
    bundle.views.push(view.name.clone());
    bundle
        .sightings
        .extend(known.into_iter().map(|(square, detection)| Sighting {
            view: number,
            station,
            eye,
            square,
            corners_px: detection.corners_px,
            sigma_px: corner_sigma_px(detection),
        }));
}

/// The best of the solutions from several starts.
fn best(
    bundle: &Bundle,
    starts: impl Iterator<Item = Poses>,
    pose: impl Fn(&Poses) -> Pose,
) -> Result<Settled, CameraError> {
    let mut failure = CameraError::NoSquare;
    let mut solutions = Vec::new();
    for start in starts {
        match bundle.settle(start) {
            Ok(settled) => solutions.push(settled),
            Err(error) => failure = error.into(),
        }
    }
    // The spread of the best fit judges all.
    let Some(spread) = solutions.iter().map(|s| s.variance.sqrt()).min_by(f64::total_cmp) else {
        return Err(failure);
    };
    let mut ranked: Vec<(f64, Settled)> = solutions
        .into_iter()
        .map(|settled| (bundle.squared_deviations(&settled.poses, spread), settled))
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (least, first) = &ranked[0];
    for (deviations, other) in &ranked[1..] {
        let angle = pose(&first.poses).angle_to(&pose(&other.poses));
        if deviations - least < ALIKE && angle > DIFFERENT_RAD {
            return Err(CameraError::Ambiguous {
                angle_deg: angle.to_degrees(),
            });
        }
    }
    Ok(ranked.swap_remove(0).1)
}

fn place(pose: Pose, covariance: Option<Matrix6<f64>>, settled: Settled) -> Result<CameraPlace, CameraError> {
    let covariance = covariance.ok_or(BundleError::Solve(SolveError::Singular))?;
    Ok(CameraPlace {
        pose,
        covariance,
        sigma: PoseSigma::of(&covariance),
        rms_px: settled.rms_px,
        views: settled.views,
        rejected: settled.rejected,
    })
}

#[cfg(test)]
mod tests {
    use glam::{DVec2, DVec3};

    use super::*;
    use crate::extrinsics::simulation::{
        Noise, field, lens, looking_at, marker, pose, see, somewhere, squared_deviations,
    };

    /// Goals of the project: 0.02 degrees and 0.3 mm.
    fn assert_good(off: &Pose) {
        let angle_deg = off.angle_to(&Pose::identity()).to_degrees();
        assert!(angle_deg <= 0.02, "{angle_deg}°");
        assert!(off.translation.length() <= 0.3e-3, "{}", off.translation);
    }

    fn view(index: usize, detections: Vec<Detection>) -> View {
        View {
            name: format!("{index:06}"),
            detections,
        }
    }

    #[test]
    fn a_fixed_camera_is_as_sure_as_it_says() {
        let markers = field();
        let truth = looking_at(DVec3::ZERO, DVec3::new(0.3, -0.5, 0.6));
        let (mut sum, mut worst) = (0.0, DVec2::ZERO);
        for seed in 0..30 {
            let mut noise = Noise(seed);
            let views: Vec<View> = (0..20)
                .map(|i| view(i, see(&markers, &lens(), &truth, (&mut noise, 0.05))))
                .collect();
            let found = fixed(&lens(), &views, &markers).unwrap();
            let off = found.pose * truth.inverse();
            assert_good(&off);
            assert_eq!(found.views.len(), 20);
            worst = worst.max(
                [
                    off.angle_to(&Pose::identity()).to_degrees(),
                    1e3 * off.translation.length(),
                ]
                .into(),
            );
            sum += squared_deviations(off.log(), &found.covariance) / 6.0;
        }
        let ratio = f64::sqrt(sum / 30.0);
        println!(
            "fixed camera, 30 trials: worst {:.4}° {:.3} mm, errors {ratio:.2} σ",
            worst.x, worst.y
        );
        assert!((1.0 / 1.5..1.5).contains(&ratio), "{ratio}");
    }

    /// Two cameras and what they see of a target that moves before them.
    fn common_views(seed: u64, second_from_first: &Pose, parts: [&[Marker]; 2]) -> Vec<[View; 2]> {
        let mut noise = Noise(seed);
        let pair = |index: usize| {
            let first_from_world = somewhere(&mut noise, [0.5, 1.0]);
            let second_from_world = *second_from_first * first_from_world;
            let first = see(parts[0], &lens(), &first_from_world, (&mut noise, 0.05));
            let second = see(parts[1], &lens(), &second_from_world, (&mut noise, 0.05));
            [view(index, first), view(index, second)]
        };
        (0..30).map(pair).collect()
    }

    #[test]
    fn two_cameras_are_as_sure_as_they_say() {
        let markers = field();
        let truth = pose([0.02, -0.15, 0.01], [-0.12, 0.003, 0.01]);
        let (mut sum, mut worst) = (0.0, DVec2::ZERO);
        for seed in 0..20 {
            let pairs = common_views(seed, &truth, [&markers, &markers]);
            let found = pair([&lens(), &lens()], &pairs, &markers).unwrap();
            let off = found.pose * truth.inverse();
            assert_good(&off);
            worst = worst.max(
                [
                    off.angle_to(&Pose::identity()).to_degrees(),
                    1e3 * off.translation.length(),
                ]
                .into(),
            );
            sum += squared_deviations(off.log(), &found.covariance) / 6.0;
        }
        let ratio = f64::sqrt(sum / 20.0);
        println!(
            "two cameras, 20 trials: worst {:.4}° {:.3} mm, errors {ratio:.2} σ",
            worst.x, worst.y
        );
        assert!((1.0 / 1.5..1.5).contains(&ratio), "{ratio}");
    }

    #[test]
    fn cameras_need_not_see_the_same_markers() {
        // Two rows of markers on one table, each camera sees one.
        let row = |first_id: u32, x: f64| {
            let place = move |i: u32| pose([0.0, 0.0, 0.2 * f64::from(i)], [x, 0.14 * f64::from(i) - 0.14, 0.0]);
            (0..3).map(|i| marker(first_id + i, 0.08, place(i))).collect::<Vec<_>>()
        };
        let (left, right) = (row(0, -0.3), row(10, 0.3));
        let all = [left.clone(), right.clone()].concat();
        let mut noise = Noise(9);
        let rig_from_first = pose([0.0, 0.0, 0.0], [0.0; 3]);
        let pairs: Vec<[View; 2]> = (0..30)
            .map(|i| {
                let from = DVec3::new(0.0, -0.2, 0.6) + noise.vector(0.08);
                let first_from_world = looking_at(DVec3::new(-0.3, 0.0, 0.0), from);
                let second_from_world = truth() * rig_from_first * first_from_world;
                let first = see(&left, &lens(), &first_from_world, (&mut noise, 0.05));
                let second = see(&right, &lens(), &second_from_world, (&mut noise, 0.05));
                [view(i, first), view(i, second)]
            })
            .collect();
        let found = pair([&lens(), &lens()], &pairs, &all).unwrap();
        assert_good(&(found.pose * truth().inverse()));
    }

    /// Turned to the right by 50 degrees.
    fn truth() -> Pose {
        pose([0.0, -0.87, 0.0], [-0.05, 0.0, 0.02])
    }

    #[test]
    fn a_detection_of_another_marker_is_named() {
        let markers = field();
        let second_from_first = pose([0.0, 0.1, 0.0], [0.1, 0.0, 0.0]);
        let mut pairs = common_views(4, &second_from_first, [&markers, &markers]);
        let stolen = pairs[3][1].detections[1].corners_px;
        pairs[3][1].detections[0].corners_px = stolen;
        let found = pair([&lens(), &lens()], &pairs, &markers).unwrap();
        assert_eq!(found.rejected.len(), 1);
        assert_eq!(
            (found.rejected[0].view.as_str(), found.rejected[0].corners),
            ("000003", 4)
        );
        assert_good(&(found.pose * second_from_first.inverse()));
    }

    #[test]
    fn what_leaves_a_place_open_is_refused() {
        let markers = field();
        let error = fixed(&lens(), &[view(0, Vec::new())], &markers).unwrap_err();
        assert_eq!(error, CameraError::NoMarkers { views: 1 });
        // One marker of ten pixels: both planar solutions fit.
        let small = [marker(0, 0.012, Pose::identity())];
        let truth = looking_at(DVec3::ZERO, DVec3::new(0.4, -0.3, 1.0));
        let views = [view(0, see(&small, &lens(), &truth, (&mut Noise(1), 0.2)))];
        let error = fixed(&lens(), &views, &small).unwrap_err();
        assert!(matches!(error, CameraError::Ambiguous { .. }), "{error}");
        let pairs = common_views(4, &Pose::identity(), [&markers, &[]]);
        let error = pair([&lens(), &lens()], &pairs, &markers).unwrap_err();
        assert_eq!(error, CameraError::TooFewPairs { found: 0 });
    }
}
