//! The least that a run must reach, figure by figure.
//!
//! Over frames the worst one counts, for directions and radiance too; poses are judged by median and 95th percentile.

use crate::{composite_error::CompositeError, score::Score, truth::MaterialKind, truth::Rig};
use serde::Serialize;
use std::fmt;

/// One figure beside what it must reach.
#[derive(Clone, Debug, Serialize)]
pub struct Floor {
    /// What is measured.
    pub what: String,
    /// What it must reach.
    pub bound: Bound,
    /// Unit of both.
    pub unit: &'static str,
    /// What was measured; `None` (in JSON also for an infinite figure: null) when it could not be.
    pub measured: Option<f64>,
    /// Whether it was measured and reaches the bound.
    pub passed: bool,
}

/// What a figure must reach.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Bound {
    /// It must not be greater.
    AtMost(f64),
    /// It must not be less.
    AtLeast(f64),
}

impl fmt::Display for Bound {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AtMost(bound) => write!(formatter, "<= {bound}"),
            Self::AtLeast(bound) => write!(formatter, ">= {bound}"),
        }
    }
}

impl Floor {
    fn new(what: impl Into<String>, measured: Option<f64>, unit: &'static str, bound: Bound) -> Self {
        let passed = measured.is_some_and(|measured| match bound {
            Bound::AtMost(bound) => measured <= bound,
            Bound::AtLeast(bound) => measured >= bound,
        });
        Self {
            what: what.into(),
            bound,
            unit,
            measured,
            passed,
        }
    }
}

/// Compares a score with every floor.
pub fn check(score: &Score) -> Vec<Floor> {
    let mut floors = pose_floors(score);
    floors.extend(probe_floors(score));
    floors.extend(score.composites.iter().flat_map(composite_floors));
    floors
}

fn pose_floors(score: &Score) -> Vec<Floor> {
    let (centre, rotation) = (score.pose.centre_mm, score.pose.rotation_deg);
    vec![
        Floor::new(
            "camera centre, median",
            centre.map(|s| s.median),
            "mm",
            Bound::AtMost(0.5),
        ),
        Floor::new("camera centre, p95", centre.map(|s| s.p95), "mm", Bound::AtMost(1.5)),
        Floor::new(
            "camera rotation, median",
            rotation.map(|s| s.median),
            "deg",
            Bound::AtMost(0.1),
        ),
        Floor::new(
            "camera rotation, p95",
            rotation.map(|s| s.p95),
            "deg",
            Bound::AtMost(0.3),
        ),
        Floor::new(
            "frames lost",
            Some(score.pose.lost.len() as f64),
            "",
            Bound::AtMost(0.0),
        ),
    ]
}

fn probe_floors(score: &Score) -> Vec<Floor> {
    let probe = score.environments.iter().find(|environment| environment.is_probe);
    let light_deg = probe.and_then(|probe| probe.worst(|frame| frame.light_deg));
    let unclipped_percent = probe.and_then(|probe| probe.worst(|frame| frame.unclipped_percent));
    let light_bound_deg = match score.rig {
        Rig::OneCamera => 3.0,
        Rig::TwoCamera | Rig::Fisheye => 2.0,
    };
    vec![
        Floor::new(
            "brightest light, worst frame",
            light_deg,
            "deg",
            Bound::AtMost(light_bound_deg),
        ),
        Floor::new(
            "unclipped radiance, worst frame",
            unclipped_percent,
            "%",
            Bound::AtMost(10.0),
        ),
    ]
}

/// Returns the floors of one composite; an object or shadow out of the picture has none.
fn composite_floors(composite: &CompositeError) -> Vec<Floor> {
    let frame = composite.frame;
    let mut floors = Vec::new();
    for object in composite.objects.iter().filter(|object| object.region.pixels > 0) {
        let least_db = match object.material {
            MaterialKind::Diffuse => 30.0,
            MaterialKind::Metal => 26.0,
            MaterialKind::Mirror => 22.0,
        };
        let what = format!("frame {frame}: {}", object.name);
        let psnr_db = object.region.psnr_db.map(|psnr| psnr.0);
        floors.push(Floor::new(what, psnr_db, "dB", Bound::AtLeast(least_db)));
    }
    if let (Some(psnr), Some(untouched)) = (composite.shadow.psnr_db, composite.shadow.untouched_psnr_db) {
        let what = format!("frame {frame}: shadow, gain on untouched");
        floors.push(Floor::new(what, Some(psnr.0 - untouched.0), "dB", Bound::AtLeast(4.0)));
        let what = format!("frame {frame}: shadow");
        floors.push(Floor::new(what, Some(psnr.0), "dB", Bound::AtLeast(30.0)));
    }
    let unchanged_db = composite.unchanged_against_camera.map(|psnr| psnr.0);
    let changed = Some(composite.outside_pixels_changed as f64);
    floors.extend([
        Floor::new(
            format!("frame {frame}: unchanged region"),
            unchanged_db,
            "dB",
            Bound::AtLeast(32.0),
        ),
        Floor::new(
            format!("frame {frame}: changed pixels outside"),
            changed,
            "px",
            Bound::AtMost(0.0),
        ),
    ]);
    floors
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_that_was_not_measured_does_not_pass() {
        assert!(!Floor::new("x", None, "mm", Bound::AtMost(1.0)).passed);
        assert!(!Floor::new("x", Some(f64::NAN), "mm", Bound::AtMost(1.0)).passed);
        assert!(Floor::new("x", Some(1.0), "mm", Bound::AtMost(1.0)).passed);
        assert!(Floor::new("x", Some(f64::INFINITY), "dB", Bound::AtLeast(22.0)).passed);
        assert!(!Floor::new("x", Some(21.9), "dB", Bound::AtLeast(22.0)).passed);
    }
}
