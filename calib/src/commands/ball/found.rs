//! What the command found: in numbers and on the screen.

use std::{io, io::Write};

use glam::DVec3;
use mirrorball_calib::{
    ball_fit::{
        Agreement, BallFit, BallView, ViewResult,
        direction::{DirectionFigures, DirectionMap, MIN_VIEW_COSINE},
        reflectance::Reflectance,
    },
    rig::Ball,
};
use serde::Serialize;

/// Everything that the command found.
pub(super) struct Found {
    pub(super) fit: BallFit,
    pub(super) reflectance: DVec3,
    pub(super) measured: Option<Reflectance>,
    pub(super) roughness: f64,
    pub(super) names: Vec<String>,
    /// The map of the picture with the largest ball, its size and name.
    pub(super) map: Option<(String, [u32; 2], DirectionMap)>,
    pub(super) figures: Option<DirectionFigures>,
    pub(super) warnings: Vec<String>,
}

/// `--json`; its keys are an interface.
#[derive(Serialize)]
pub(super) struct Numbers<'a> {
    routine: &'static str,
    center_m: [f64; 3],
    center_sigma_m: [f64; 3],
    radius_m: f64,
    radius_sigma_m: f64,
    /// Of x, y, z of the centre and of the radius.
    covariance_m2: Vec<Vec<f64>>,
    reflectance: [f64; 3],
    reflectance_sigma: Option<[f64; 3]>,
    reflectance_patches: Option<usize>,
    roughness: f64,
    direction_sigma_deg: Option<DirectionNumbers>,
    blur_px: f64,
    scale: f64,
    views: Vec<ViewNumbers<'a>>,
    warnings: &'a [String],
}

#[derive(Serialize)]
struct DirectionNumbers {
    center: f64,
    median: f64,
    p95: f64,
    rim: f64,
    min_view_cosine: f64,
}

#[derive(Serialize)]
struct ViewNumbers<'a> {
    name: &'a str,
    state: &'static str,
    center_error_px: Option<f64>,
    radius_error_px: Option<f64>,
    radius_px: Option<f64>,
    reason: Option<String>,
}

impl Found {
    pub(super) fn ball(&self) -> Ball {
        Ball {
            center_m: self.fit.ball.center_m,
            radius_m: self.fit.ball.radius_m,
            reflectance: self.reflectance.to_array(),
            roughness: self.roughness,
        }
    }

    /// Standard deviations of centre and radius, metres.
    pub(super) fn sigmas_m(&self) -> [f64; 4] {
        std::array::from_fn(|i| self.fit.covariance_m2[(i, i)].sqrt())
    }

    /// Each view's name, what became of it, its figures and why not.
    pub(super) fn views(&self) -> impl Iterator<Item = (&str, &'static str, Option<Agreement>, Option<String>)> {
        self.names
            .iter()
            .zip(&self.fit.views)
            .map(|(name, result)| match result {
                ViewResult::Used(agreement) => (name.as_str(), "used", Some(*agreement), None),
                ViewResult::Rejected(agreement) => (name.as_str(), "rejected", Some(*agreement), None),
                ViewResult::NoOutline(error) => (name.as_str(), "no outline", None, Some(error.to_string())),
            })
    }

    pub(super) fn numbers(&self) -> Numbers<'_> {
        let sigma = self.sigmas_m();
        let covariance = &self.fit.covariance_m2;
        Numbers {
            routine: "ball",
            center_m: self.fit.ball.center_m.to_array(),
            center_sigma_m: [sigma[0], sigma[1], sigma[2]],
            radius_m: self.fit.ball.radius_m,
            radius_sigma_m: sigma[3],
            covariance_m2: (0..4).map(|i| (0..4).map(|j| covariance[(i, j)]).collect()).collect(),
            reflectance: self.reflectance.to_array(),
            reflectance_sigma: self.measured.map(|measured| measured.sigma.to_array()),
            reflectance_patches: self.measured.map(|measured| measured.n_patches),
            roughness: self.roughness,
            direction_sigma_deg: self.figures.map(|figures| DirectionNumbers {
                center: figures.center,
                median: figures.median,
                p95: figures.p95,
                rim: figures.rim,
                min_view_cosine: MIN_VIEW_COSINE,
            }),
            blur_px: self.fit.blur_px,
            scale: self.fit.scale,
            views: self
                .views()
                .map(|(name, state, agreement, reason)| ViewNumbers {
                    name,
                    state,
                    center_error_px: agreement.map(|a| a.center_error_px),
                    radius_error_px: agreement.map(|a| a.radius_error_px),
                    radius_px: agreement.map(|a| a.radius_px),
                    reason,
                })
                .collect(),
            warnings: &self.warnings,
        }
    }

    pub(super) fn print(&self, out: &mut impl Write) -> io::Result<()> {
        let (center, sigma) = (1e3 * self.fit.ball.center_m, self.sigmas_m().map(|s| 1e3 * s));
        for warning in &self.warnings {
            writeln!(out, "warning: {warning}")?;
        }
        let n_used = self.views().filter(|view| view.1 == "used").count();
        writeln!(out, "{n_used} of {} views used", self.names.len())?;
        writeln!(
            out,
            "centre {:.3} {:.3} {:.3} mm (± {:.3} {:.3} {:.3}), radius {:.3} mm (± {:.3})",
            center.x,
            center.y,
            center.z,
            sigma[0],
            sigma[1],
            sigma[2],
            1e3 * self.fit.ball.radius_m,
            sigma[3]
        )?;
        if let Some(figures) = self.figures {
            writeln!(
                out,
                "direction ± {:.3}° in the middle, {:.3}° median, {:.3}° p95, {:.3}° at the rim",
                figures.center, figures.median, figures.p95, figures.rim
            )?;
        }
        let [red, green, blue] = self.reflectance.to_array();
        write!(out, "reflectance {red:.4} {green:.4} {blue:.4}")?;
        match self.measured {
            Some(Reflectance { sigma, n_patches, .. }) => {
                writeln!(
                    out,
                    " (± {:.4} {:.4} {:.4}, {n_patches} papers)",
                    sigma.x, sigma.y, sigma.z
                )
            }
            None => writeln!(out, " (not measured)"),
        }
    }
}

pub(super) type LargestMap = Option<(String, [u32; 2], DirectionMap)>;

/// The direction map of the view with the largest ball, and the figures of all used views, the median over views.
pub(super) fn directions(fit: &BallFit, views: &[BallView<'_>]) -> (LargestMap, Option<DirectionFigures>) {
    let mut largest: Option<(f64, LargestMap)> = None;
    let mut all = Vec::new();
    for (view, result) in views.iter().zip(&fit.views) {
        let ViewResult::Used(agreement) = result else { continue };
        let intrinsics = &view.view.camera.intrinsics;
        let Some(map) = DirectionMap::new(fit, intrinsics, &view.view.camera_from_world) else {
            continue;
        };
        all.extend(map.figures());
        if largest
            .as_ref()
            .is_none_or(|(radius_px, _)| agreement.radius_px > *radius_px)
        {
            largest = Some((agreement.radius_px, Some((view.name.clone(), intrinsics.size_px, map))));
        }
    }
    let median = |of: fn(&DirectionFigures) -> f64| {
        let mut values: Vec<f64> = all.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let figures = || {
        Some(DirectionFigures {
            center: median(|f| f.center)?,
            median: median(|f| f.median)?,
            p95: median(|f| f.p95)?,
            rim: median(|f| f.rim)?,
        })
    };
    (largest.and_then(|(_, map)| map), figures())
}
