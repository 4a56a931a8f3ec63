//! The pictures that count: those of cameras with a lens, with a pose from the rig's markers.

use std::{collections::BTreeMap, path::Path};

use glam::DMat3;
use mirrorball_calib::{
    ball_fit::BallView,
    camera::Intrinsics,
    photometry::Photometry,
    pose::Pose,
    probe::{View, radiance},
    resection::{self, NoPose},
    response::ResponseCurve,
    rig::{Camera, PartialCamera, Rig, RigParts, Role},
    tag::Finder,
};
use mirrorball_capture::{Exposure, Frame, FrameMeta, PixelFormat, Size};

use super::{Args, BallCommandError};
use crate::commands::{CommandError, families, input::Picture};

/// Views beyond which every second one is left out: more tell nothing new.
const MAX_VIEWS: usize = 48;

/// A picture with a pose.
pub(super) struct Taken {
    name: String,
    frame: Frame,
    camera: Camera,
    camera_from_world: Pose,
    position_sigma_m: f64,
}

impl Taken {
    pub(super) fn view(&self) -> BallView<'_> {
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
pub(super) fn take(
    args: &Args,
    file: &Path,
    parts: &RigParts,
    warnings: &mut Vec<String>,
) -> Result<Vec<Taken>, CommandError> {
    let cameras = cameras(parts, warnings);
    if let Some(name) = args.camera.as_ref().filter(|name| !cameras.contains_key(*name)) {
        return Err(no_camera(file, name, &cameras).into());
    }
    let mut locator = Locator::new(file, parts, &cameras)?;
    let only = cameras.keys().next().filter(|_| cameras.len() == 1);
    let (mut taken, mut n_pictures) = (Vec::new(), 0);
    let mut stride = 1;
    for picture in args.input.open()? {
        let picture = picture?;
        let name = picture.camera.as_ref().or(args.camera.as_ref()).or(only);
        let Some(camera) = name.and_then(|name| cameras.get(name)) else {
            if picture.camera.is_none() {
                let name = name.map_or("not given", String::as_str);
                return Err(no_camera(file, name, &cameras).into());
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
        (true, None) => {
            let all = || cameras.keys().cloned().collect::<Vec<_>>().join("`, `");
            let camera = args.camera.clone().unwrap_or_else(all);
            Err(BallCommandError::NoPicture { camera }.into())
        }
        (false, _) => Ok(taken),
    }
}

fn no_camera(file: &Path, name: &str, cameras: &BTreeMap<String, Camera>) -> BallCommandError {
    let present: Vec<String> = cameras.keys().map(|name| format!("`{name}`")).collect();
    BallCommandError::NoCamera {
        file: file.to_owned(),
        name: name.to_owned(),
        present: present.join(", "),
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
    fn new(file: &Path, parts: &RigParts, cameras: &BTreeMap<String, Camera>) -> Result<Self, BallCommandError> {
        let (Some(main_marker), false) = (parts.main_marker, parts.markers.is_empty()) else {
            return Err(BallCommandError::NoMarkers {
                file: file.to_owned(),
                n_markers: parts.markers.len(),
                main: parts.main_marker.map_or("none".to_owned(), |id| format!("`{id}`")),
            });
        };
        // What resection needs: the markers.
        let rig = Rig {
            main_marker,
            cameras: cameras.values().cloned().collect(),
            markers: parts.markers.clone(),
            ball: None,
        };
        Ok(Self {
            finder: Finder::new(&families(&rig)),
            rig,
            lost: None,
        })
    }

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
