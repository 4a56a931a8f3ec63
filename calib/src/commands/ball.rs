//! `ball`: where the mirror ball is, how large, and how much it reflects.

mod report;

use std::{collections::BTreeMap, fs, io, io::Write, path::PathBuf};

use glam::{DMat3, DVec3};
use mirrorball_calib::{
    ball_fit::{
        self, Agreement, BallError, BallFit, BallPrior, BallView, Measured, ViewResult,
        direction::{DirectionFigures, DirectionMap},
        reflectance::{self, NoPatch, Reflectance},
    },
    camera::Intrinsics,
    photometry::Photometry,
    pose::Pose,
    probe::{View, radiance},
    resection::{self, NoPose},
    response::ResponseCurve,
    rig::{Ball, Camera, PartialCamera, Rig, RigError, RigParts, Role},
    tag::{Finder, PictureError},
};
use mirrorball_capture::{Exposure, Frame, FrameMeta, PixelFormat, Size};
use serde::Serialize;

use super::{
    CommandError,
    explain::Explain,
    input::{InputArgs, Picture},
    output::{OutputArgs, draft},
};

/// Views beyond which every second one is left out: more tell nothing new.
const MAX_VIEWS: usize = 48;
/// Fits in turn with measurements of the reflectance, on which the outline's look depends.
const ROUNDS: usize = 2;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Rig file with lenses and markers; by default the recording's own.
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// Camera that took the pictures of a folder; of a recording, the only one that counts.
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Radius as measured by hand, metres.
    #[arg(long, value_name = "R", requires = "radius_sigma_m")]
    radius_m: Option<f64>,
    /// Standard deviation of that, metres.
    #[arg(long, value_name = "S", requires = "radius_m")]
    radius_sigma_m: Option<f64>,
    /// About where the ball's centre is in the world, metres, to 5 mm; by default where the rig file has it.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, allow_hyphen_values = true)]
    center: Option<DVec3>,
    /// Reflectance of red, green and blue, if no marker shall tell it.
    #[arg(long, value_name = "R,G,B", value_parser = triple)]
    reflectance: Option<DVec3>,
    #[command(flatten)]
    output: OutputArgs,
}

/// Why there is no ball.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BallCommandError {
    #[error("no rig file is given, and there is no recording to take it from")]
    NoRig,
    #[error("cannot read rig file `{}`", file.display())]
    ReadRig {
        file: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("rig file `{}` is not usable", file.display())]
    Rig {
        file: PathBuf,
        #[source]
        source: Box<RigError>,
    },
    #[error("rig file `{}` has no camera `{name}` with a lens (there are: {present})", file.display())]
    NoCamera {
        file: PathBuf,
        name: String,
        present: String,
    },
    #[error("rig file `{}` has `{n_markers}` markers and main marker {main}", file.display())]
    NoMarkers {
        file: PathBuf,
        n_markers: usize,
        main: String,
    },
    #[error("it is not known where the ball is: rig file `{}` has no `[ball]`", file.display())]
    NoCenter { file: PathBuf },
    #[error("`--{option}` is `{value}` (allowed: {allowed})")]
    Option {
        option: &'static str,
        value: String,
        allowed: &'static str,
    },
    #[error("cannot search picture `{picture}`")]
    Search {
        picture: String,
        #[source]
        source: PictureError,
    },
    #[error("none of `{n_pictures}` pictures has a pose; `{picture}`")]
    NoPose {
        n_pictures: usize,
        picture: String,
        #[source]
        source: NoPose,
    },
    #[error("there is no picture of camera `{camera}`")]
    NoPicture { camera: String },
    #[error("cannot find the ball")]
    Ball(#[source] BallError),
    #[error("the ball's reflectance is not known")]
    Reflectance(#[source] NoPatch),
}

impl Explain for BallCommandError {
    fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Ball(BallError::NotConverged))
    }

    fn hint(&self) -> Option<&str> {
        Some(match self {
            Self::NoRig => "give `--rig FILE`",
            Self::ReadRig { .. } => "give a rig file with lenses and markers",
            Self::Rig { source, .. } => return source.hint(),
            Self::NoCamera { .. } => "choose one of these with `--camera`, or calibrate its lens first (`intrinsics`)",
            Self::NoMarkers { .. } => {
                "measure the markers first (`extrinsics`), or write `main_marker` and `[[marker]]`"
            }
            Self::NoCenter { .. } => "give `--center X,Y,Z`, measured with a ruler from the main marker's middle",
            Self::Option { .. } => return None,
            Self::Search { .. } => "`size_px` in the rig file must be the size of the camera's pictures",
            Self::NoPose { .. } => "at least one marker of the rig must be sharp, whole and well lit in the pictures",
            Self::NoPicture { .. } => "choose a camera of the recording with `--camera`",
            Self::Ball(error) => match error {
                BallError::NoViews | BallError::NotSeen { .. } => {
                    "the whole ball must be in the picture, and `--center` right to 5 mm"
                }
                BallError::OneView { .. } => {
                    "take pictures from several sides, or give `--radius-m` and `--radius-sigma-m`"
                }
                BallError::RadiusUnknown { .. } => {
                    "take pictures from sides 60° and more apart, or give `--radius-m` and `--radius-sigma-m`"
                }
                BallError::Disagree { .. } => {
                    "the ball and the markers must stand still; take out the picture that is furthest off"
                }
                BallError::NotConverged => "give a better `--center`, or `--radius-m` and `--radius-sigma-m`",
            },
            Self::Reflectance(_) => {
                "put a marker of the rig beside the ball, where the camera sees it and its image in the ball; or give \
                 `--reflectance R,G,B`"
            }
        })
    }
}

/// Everything that the command found.
struct Found {
    fit: BallFit,
    reflectance: DVec3,
    measured: Option<Reflectance>,
    roughness: f64,
    names: Vec<String>,
    /// The map of the picture with the largest ball, its size and name.
    map: Option<(String, [u32; 2], DirectionMap)>,
    figures: Option<DirectionFigures>,
    warnings: Vec<String>,
}

pub(crate) fn run(args: &Args, out: &mut impl Write) -> Result<(), CommandError> {
    let (file, parts) = read_parts(args)?;
    let mut prior = prior(args, &file, parts.ball.as_ref())?;
    let mut warnings = Vec::new();
    let taken = take(args, &file, &parts, &mut warnings)?;
    let views: Vec<BallView<'_>> = taken.iter().map(Taken::view).collect();
    let given = args.reflectance;
    let (mut fit, mut measured);
    let mut round = 0;
    loop {
        fit = ball_fit::fit(&views, &prior).map_err(BallCommandError::Ball)?;
        let counted: Vec<BallView<'_>> = views
            .iter()
            .zip(&fit.views)
            .filter_map(|(view, result)| matches!(result, ViewResult::Used(_)).then(|| view.clone()))
            .collect();
        measured = match given {
            Some(_) => None,
            None => Some(reflectance::measure(&counted, &fit.ball, &parts.markers)),
        };
        round += 1;
        let Some(Ok(value)) = measured.as_ref().filter(|_| round < ROUNDS) else {
            break;
        };
        prior = BallPrior {
            center_m: fit.ball.center_m,
            radius_m: Some(fit.ball.radius_m),
            reflectance: value.value.as_vec3(),
            ..prior
        };
    }
    let reflectance = match (given, &measured, parts.ball) {
        (Some(value), ..) => value,
        (None, Some(Ok(measured)), _) => measured.value.min(DVec3::ONE),
        (None, Some(Err(reason)), Some(ball)) => {
            warnings.push(format!("the rig's reflectance is kept: {reason}"));
            DVec3::from_array(ball.reflectance)
        }
        (None, Some(Err(reason)), None) => return Err(BallCommandError::Reflectance(*reason).into()),
        (None, None, _) => unreachable!("measured unless given"),
    };
    let (map, figures) = directions(&fit, &views);
    let found = Found {
        fit,
        reflectance,
        measured: measured.and_then(Result::ok),
        roughness: parts.ball.map_or(0.0, |ball| ball.roughness),
        names: views.iter().map(|view| view.name.clone()).collect(),
        map,
        figures,
        warnings,
    };
    found.print(out).map_err(CommandError::Output)?;
    if let Some(file) = &args.output.out {
        let mut draft = draft(file)?;
        draft.set_ball(&found.ball());
        args.output.write_rig(&draft)?;
    }
    args.output.write_json(&found.numbers())?;
    args.output.write_report(|| report::report(&found))?;
    Ok(())
}

fn read_parts(args: &Args) -> Result<(PathBuf, RigParts), BallCommandError> {
    let own = args.input.recording.as_ref().map(|folder| folder.join("rig.toml"));
    let file = args.rig.clone().or(own).ok_or(BallCommandError::NoRig)?;
    let text = fs::read_to_string(&file).map_err(|source| BallCommandError::ReadRig {
        file: file.clone(),
        source,
    })?;
    let parts = RigParts::from_toml(&text, &file).map_err(|source| BallCommandError::Rig {
        file: file.clone(),
        source: Box::new(source),
    })?;
    Ok((file, parts))
}

/// Three numbers with commas between them.
fn triple(text: &str) -> Result<DVec3, String> {
    let values: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match values.as_deref() {
        Ok(&[x, y, z]) if [x, y, z].into_iter().all(f64::is_finite) => Ok(DVec3::new(x, y, z)),
        _ => Err("three numbers with commas between them are needed".to_owned()),
    }
}

fn prior(args: &Args, file: &std::path::Path, ball: Option<&Ball>) -> Result<BallPrior, BallCommandError> {
    let positive = |option, value: Option<f64>| match value {
        Some(value) if !(value > 0.0 && value < 10.0) => Err(BallCommandError::Option {
            option,
            value: value.to_string(),
            allowed: "above 0, below 10",
        }),
        _ => Ok(value),
    };
    let radius = positive("radius-m", args.radius_m)?.zip(positive("radius-sigma-m", args.radius_sigma_m)?);
    let reflectance = args.reflectance;
    if let Some(value) = reflectance
        && !(value.min_element() > 0.0 && value.max_element() <= 1.0)
    {
        return Err(BallCommandError::Option {
            option: "reflectance",
            value: value.to_string(),
            allowed: "above 0, at most 1",
        });
    }
    let center = args.center.or(ball.map(|ball| ball.center_m));
    let known = ball.map(|ball| DVec3::from_array(ball.reflectance).as_vec3());
    Ok(BallPrior {
        center_m: center.ok_or_else(|| BallCommandError::NoCenter { file: file.to_owned() })?,
        radius_m: ball.map(|ball| ball.radius_m),
        measured_radius: radius.map(|(value_m, sigma_m)| Measured { value_m, sigma_m }),
        reflectance: reflectance
            .map(|value| value.as_vec3())
            .or(known)
            .unwrap_or(ball_fit::TYPICAL_REFLECTANCE),
    })
}

/// A picture with a pose.
struct Taken {
    name: String,
    frame: Frame,
    camera: Camera,
    camera_from_world: Pose,
    position_sigma_m: f64,
}

impl Taken {
    fn view(&self) -> BallView<'_> {
        BallView {
            name: self.name.clone(),
            view: View {
                picture: radiance::Picture::new(&self.frame, &self.camera),
                camera: &self.camera,
                camera_from_world: self.camera_from_world,
            },
            position_sigma_m: self.position_sigma_m,
        }
    }
}

/// All pictures that have a pose.
fn take(
    args: &Args,
    file: &std::path::Path,
    parts: &RigParts,
    warnings: &mut Vec<String>,
) -> Result<Vec<Taken>, CommandError> {
    let cameras = cameras(parts, warnings);
    let no_camera = |name: &str| BallCommandError::NoCamera {
        file: file.to_owned(),
        name: name.to_owned(),
        present: cameras
            .keys()
            .map(|name| format!("`{name}`"))
            .collect::<Vec<_>>()
            .join(", "),
    };
    if let Some(name) = args.camera.as_ref().filter(|name| !cameras.contains_key(*name)) {
        return Err(no_camera(name).into());
    }
    let (Some(main_marker), false) = (parts.main_marker, parts.markers.is_empty()) else {
        return Err(BallCommandError::NoMarkers {
            file: file.to_owned(),
            n_markers: parts.markers.len(),
            main: parts.main_marker.map_or("none".to_owned(), |id| format!("`{id}`")),
        }
        .into());
    };
    // What resection needs: the markers.
    let rig = Rig {
        main_marker,
        cameras: cameras.values().cloned().collect(),
        markers: parts.markers.clone(),
        ball: None,
    };
    let only = cameras
        .values()
        .next()
        .filter(|_| cameras.len() == 1)
        .map(|camera| camera.name.clone());
    let mut locator = Locator {
        finder: Finder::new(&super::families(&rig)),
        rig,
        lost: None,
    };
    let (mut taken, mut n_pictures) = (Vec::new(), 0);
    let mut stride = 1;
    for picture in args.input.open()? {
        let picture = picture?;
        let name = picture.camera.clone().or(args.camera.clone()).or(only.clone());
        let Some(camera) = name.as_ref().and_then(|name| cameras.get(name)) else {
            if picture.camera.is_none() {
                return Err(no_camera(name.as_deref().unwrap_or("not given")).into());
            }
            continue;
        };
        if camera.role == Role::Fisheye || args.camera.as_ref().is_some_and(|only| *only != camera.name) {
            continue;
        }
        n_pictures += 1;
        if n_pictures % stride == 0
            && let Some(found) = locator.locate(picture, camera)?
        {
            taken.push(found);
        }
        if taken.len() > MAX_VIEWS {
            let mut index = 0;
            taken.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            stride *= 2;
        }
    }
    match (taken.is_empty(), locator.lost) {
        (true, Some((picture, source))) => Err(BallCommandError::NoPose {
            n_pictures,
            picture,
            source,
        }
        .into()),
        (true, None) => Err(BallCommandError::NoPicture {
            camera: args
                .camera
                .clone()
                .unwrap_or_else(|| cameras.keys().cloned().collect::<Vec<_>>().join("`, `")),
        }
        .into()),
        (false, _) => Ok(taken),
    }
}

/// The cameras with a lens, by name; one whose photometry is not known is taken to be linear in sRGB without vignetting.
fn cameras(parts: &RigParts, warnings: &mut Vec<String>) -> BTreeMap<String, Camera> {
    let mut complete = |camera: &PartialCamera| {
        let intrinsics: Intrinsics = camera.intrinsics?;
        let photometry = camera.photometry.clone().unwrap_or_else(|| {
            warnings.push(format!(
                "the photometry of camera `{}` is not known: sRGB without vignetting is taken",
                camera.name
            ));
            Photometry {
                sensitivity: 1.0,
                vignetting: [0.0, 0.0],
                full_well_e: 1e4,
                read_noise_e: 5.0,
                response: ResponseCurve::srgb(),
                color: DMat3::IDENTITY,
            }
        });
        Some(Camera {
            name: camera.name.clone(),
            role: camera.role,
            intrinsics,
            photometry,
            camera_from_world: camera.camera_from_world,
        })
    };
    let cameras = parts.cameras.iter().filter_map(&mut complete);
    cameras.map(|camera| (camera.name.clone(), camera)).collect()
}

/// Finds the poses of pictures.
struct Locator {
    rig: Rig,
    finder: Finder,
    /// The first picture without a pose.
    lost: Option<(String, NoPose)>,
}

impl Locator {
    /// `None` for a picture without a pose.
    fn locate(&mut self, picture: Picture, camera: &Camera) -> Result<Option<Taken>, BallCommandError> {
        /// Exposure of pictures of which none is known: ratios within a picture do not depend on it.
        const UNKNOWN: Exposure = Exposure {
            time_s: 1.0,
            gain: 1.0,
            white_balance: [1.0; 3],
        };
        let [width, height] = [picture.rgb.width(), picture.rgb.height()];
        let pose = match (camera.camera_from_world, camera.role) {
            (Some(pose), Role::Ball | Role::Fisheye) => Ok((pose, 0.0)),
            _ => {
                let size = [width as usize, height as usize];
                let detections = self.finder.find(picture.rgb.as_raw(), size, camera);
                let detections = detections.map_err(|source| BallCommandError::Search {
                    picture: picture.name.clone(),
                    source,
                })?;
                resection::locate(&detections, &self.rig, &camera.intrinsics)
                    .map(|located| (located.camera_from_world, located.position_sigma_m))
            }
        };
        let (camera_from_world, position_sigma_m) = match pose {
            Ok(pose) => pose,
            Err(reason) => {
                self.lost.get_or_insert((picture.name, reason));
                return Ok(None);
            }
        };
        let name = camera.name.as_str().into();
        let exposure = picture.exposure.unwrap_or(UNKNOWN);
        Ok(Some(Taken {
            name: picture.name,
            frame: Frame {
                meta: FrameMeta::new(name, 0, picture.timestamp_ns.unwrap_or(0), exposure),
                size: Size { width, height },
                format: PixelFormat::Rgb8,
                pixels: picture.rgb.into_raw().into(),
            },
            camera: camera.clone(),
            camera_from_world,
            position_sigma_m,
        }))
    }
}

type LargestMap = Option<(String, [u32; 2], DirectionMap)>;

/// The direction map of the view with the largest ball, and the figures of all used views, the median over views.
fn directions(fit: &BallFit, views: &[BallView<'_>]) -> (LargestMap, Option<DirectionFigures>) {
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

/// `--json`; its keys are an interface.
#[derive(Serialize)]
struct Numbers<'a> {
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
    fn ball(&self) -> Ball {
        Ball {
            center_m: self.fit.ball.center_m,
            radius_m: self.fit.ball.radius_m,
            reflectance: self.reflectance.to_array(),
            roughness: self.roughness,
        }
    }

    /// Standard deviations of centre and radius, metres.
    fn sigmas_m(&self) -> [f64; 4] {
        std::array::from_fn(|i| self.fit.covariance_m2[(i, i)].sqrt())
    }

    /// Each view's name, what became of it, its figures and why not.
    fn views(&self) -> impl Iterator<Item = (&str, &'static str, Option<Agreement>, Option<String>)> {
        self.names
            .iter()
            .zip(&self.fit.views)
            .map(|(name, result)| match result {
                ViewResult::Used(agreement) => (name.as_str(), "used", Some(*agreement), None),
                ViewResult::Rejected(agreement) => (name.as_str(), "rejected", Some(*agreement), None),
                ViewResult::NoOutline(error) => (name.as_str(), "no outline", None, Some(error.to_string())),
            })
    }

    fn numbers(&self) -> Numbers<'_> {
        let sigma = self.sigmas_m();
        let covariance = &self.fit.covariance_m2;
        Numbers {
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
                min_view_cosine: ball_fit::direction::MIN_VIEW_COSINE,
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

    fn print(&self, out: &mut impl Write) -> io::Result<()> {
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
