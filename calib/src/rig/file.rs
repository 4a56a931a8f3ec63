//! The rig file: its keys as they are written, and how they become checked types.

use std::{f64::consts::PI, fmt::Debug, path::Path};

use glam::{DMat3, DVec2, DVec3};
use serde::Deserialize;
use toml::Spanned;

use super::{Ball, Camera, Marker, PartialCamera, Place, Rig, RigError, RigParts, Role};
use crate::{
    camera::{Intrinsics, LensModel, Model},
    photometry::Photometry,
    pose::Pose,
    response::ResponseCurve,
    tag::Family,
};

/// Version of the format that this program reads.
const VERSION: i128 = 1;

/// Reflectance of white paper when the file does not say (measured for common office paper: 0.75 to 0.85).
const DEFAULT_WHITE_REFLECTANCE: f64 = 0.8;

/// Largest width or height of a picture.
const MAX_SIDE_PX: i64 = 16_384;

/// Largest deviation from the identity, per element, that the main marker's pose may have.
const IDENTITY_TOLERANCE: f64 = 1e-6;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    version: Spanned<i128>,
    main_marker: Option<Spanned<u32>>,
    #[serde(default)]
    camera: Vec<Spanned<CameraEntry>>,
    #[serde(default)]
    marker: Vec<Spanned<MarkerEntry>>,
    ball: Option<BallEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraEntry {
    name: Spanned<String>,
    role: Spanned<String>,
    size_px: Spanned<[i64; 2]>,
    camera_from_world: Option<Spanned<[[f64; 4]; 3]>>,
    lens: Option<LensEntry>,
    photometry: Option<PhotometryEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LensEntry {
    model: Spanned<String>,
    focal_px: Spanned<[f64; 2]>,
    principal_point_px: Spanned<[f64; 2]>,
    distortion: Spanned<Vec<f64>>,
    max_angle_deg: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PhotometryEntry {
    sensitivity: Spanned<f64>,
    vignetting: Spanned<[f64; 2]>,
    full_well_e: Spanned<f64>,
    read_noise_e: Spanned<f64>,
    response: Spanned<ResponseEntry>,
    color: Option<Spanned<[[f64; 3]; 3]>>,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "`response` must be \"srgb\" or a list of 256 numbers")]
enum ResponseEntry {
    Name(String),
    Table(Vec<f64>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MarkerEntry {
    family: Spanned<String>,
    id: Spanned<u32>,
    side_m: Spanned<f64>,
    white_reflectance: Option<Spanned<f64>>,
    world_from_marker: Spanned<[[f64; 4]; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BallEntry {
    center_m: Spanned<[f64; 3]>,
    radius_m: Spanned<f64>,
    reflectance: Spanned<[f64; 3]>,
    roughness: Spanned<f64>,
}

/// Reads a rig file; see [`Rig::from_toml`].
pub(super) fn read(text: &str, file: &Path) -> Result<Rig, RigError> {
    let source = Source { text, file };
    let entries = source.parse()?;
    let parts = source.parts(&entries)?;
    let cameras = entries.camera.iter().zip(parts.cameras);
    let cameras = cameras
        .map(|(entry, camera)| source.complete(entry, camera))
        .collect::<Result<Vec<_>, _>>()?;
    source.check_scene_camera(&cameras)?;
    source.check_main_marker(&entries, &parts.markers)?;
    if parts.ball.is_none() {
        source.check_ball_is_not_needed(&entries, &cameras)?;
    }
    let main_marker = parts.main_marker.expect("checked: a marker of this id is there");
    Ok(Rig {
        main_marker,
        cameras,
        markers: parts.markers,
        ball: parts.ball,
    })
}

/// Reads what there is of a rig file; see [`RigParts::from_toml`].
pub(super) fn read_parts(text: &str, file: &Path) -> Result<RigParts, RigError> {
    let source = Source { text, file };
    let entries = source.parse()?;
    source.parts(&entries)
}

/// The text being read, to turn positions into lines.
struct Source<'a> {
    text: &'a str,
    file: &'a Path,
}

impl Source<'_> {
    fn parse(&self) -> Result<RigFile, RigError> {
        let entries: RigFile = toml::from_str(self.text).map_err(|error| RigError::Syntax {
            place: self.place(error.span().map_or(0, |span| span.start)),
            message: error.message().replace('\n', " "),
        })?;
        let version = *entries.version.get_ref();
        if version > VERSION {
            return Err(RigError::Newer {
                place: self.place_of(&entries.version),
                found: version,
                known: VERSION,
            });
        }
        self.check(&entries.version, "version", |&version| version == VERSION, "`1`")?;
        Ok(entries)
    }

    /// Everything that is there, checked by itself and for doubles.
    fn parts(&self, entries: &RigFile) -> Result<RigParts, RigError> {
        let cameras = entries
            .camera
            .iter()
            .map(|entry| self.camera(entry))
            .collect::<Result<Vec<_>, _>>()?;
        let markers = entries
            .marker
            .iter()
            .map(|entry| self.marker(entry))
            .collect::<Result<Vec<_>, _>>()?;
        self.check_doubles(entries, &cameras, &markers)?;
        Ok(RigParts {
            main_marker: entries.main_marker.as_ref().map(|id| *id.get_ref()),
            cameras,
            markers,
            ball: entries.ball.as_ref().map(|entry| self.ball(entry)).transpose()?,
        })
    }

    fn place(&self, position: usize) -> Place {
        let before = &self.text.as_bytes()[..position.min(self.text.len())];
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
        Place {
            file: self.file.to_owned(),
            line,
        }
    }

    fn place_of<T>(&self, value: &Spanned<T>) -> Place {
        self.place(value.span().start)
    }

    fn check<T: Debug>(
        &self,
        value: &Spanned<T>,
        key: &str,
        is_allowed: impl Fn(&T) -> bool,
        allowed: &str,
    ) -> Result<(), RigError> {
        if is_allowed(value.get_ref()) {
            return Ok(());
        }
        Err(RigError::Value {
            place: self.place_of(value),
            key: key.to_owned(),
            found: format!("{:?}", value.get_ref()).replace('"', ""),
            allowed: allowed.to_owned(),
        })
    }

    fn positive(&self, value: &Spanned<f64>, key: &str) -> Result<f64, RigError> {
        self.check(value, key, |x| x.is_finite() && *x > 0.0, "a finite number above 0")?;
        Ok(*value.get_ref())
    }

    fn finite<const N: usize>(&self, value: &Spanned<[f64; N]>, key: &str) -> Result<[f64; N], RigError> {
        self.check(value, key, |list| list.iter().all(|x| x.is_finite()), "finite numbers")?;
        Ok(*value.get_ref())
    }

    fn pose(&self, rows: &Spanned<[[f64; 4]; 3]>, key: &str) -> Result<Pose, RigError> {
        Pose::from_rows(rows.get_ref()).map_err(|source| RigError::Pose {
            place: self.place_of(rows),
            key: key.to_owned(),
            source,
        })
    }

    fn camera(&self, entry: &Spanned<CameraEntry>) -> Result<PartialCamera, RigError> {
        let place = self.place_of(entry);
        let entry = entry.get_ref();
        self.check(
            &entry.name,
            "camera.name",
            |name| is_file_name(name),
            "letters, digits, `-` and `_`, since a folder of the recording has this name",
        )?;
        let name = entry.name.get_ref().clone();
        let role = self.role(&entry.role)?;
        self.check(
            &entry.size_px,
            "camera.size_px",
            |size| size.iter().all(|side| (1..=MAX_SIDE_PX).contains(side)),
            "width and height of 1 to 16384",
        )?;
        let size_px = entry
            .size_px
            .get_ref()
            .map(|side| u32::try_from(side).expect("checked: 1 to 16384"));
        let pose = entry.camera_from_world.as_ref();
        let camera_from_world = pose
            .map(|rows| self.pose(rows, "camera.camera_from_world"))
            .transpose()?;
        let problem = match (role, camera_from_world) {
            (Role::Scene, Some(_)) => Some("has role `scene` and so moves: leave out `camera_from_world`"),
            (Role::Scene | Role::Ball | Role::Fisheye, None) | (Role::Ball | Role::Fisheye, Some(_)) => None,
        };
        if let Some(problem) = problem {
            return Err(RigError::Entry {
                place,
                subject: format!("camera `{name}`"),
                problem,
            });
        }
        let intrinsics = entry.lens.as_ref();
        let intrinsics = intrinsics.map(|lens| self.intrinsics(lens, size_px)).transpose()?;
        let photometry = entry.photometry.as_ref();
        let photometry = photometry.map(|entry| self.photometry(entry)).transpose()?;
        Ok(PartialCamera {
            name,
            role,
            size_px,
            intrinsics,
            photometry,
            camera_from_world,
        })
    }

    /// A camera of which everything is known.
    fn complete(&self, entry: &Spanned<CameraEntry>, camera: PartialCamera) -> Result<Camera, RigError> {
        let missing = |problem| RigError::Entry {
            place: self.place_of(entry),
            subject: format!("camera `{}`", camera.name),
            problem,
        };
        if camera.role != Role::Scene && camera.camera_from_world.is_none() {
            return Err(missing(
                "is fixed: it needs `camera_from_world` (measured by `mirrorball-calib extrinsics`)",
            ));
        }
        Ok(Camera {
            intrinsics: camera
                .intrinsics
                .ok_or_else(|| missing("needs `[camera.lens]` (measured by `mirrorball-calib intrinsics`)"))?,
            photometry: camera
                .photometry
                .clone()
                .ok_or_else(|| missing("needs `[camera.photometry]` (measured by `mirrorball-calib photometric`)"))?,
            name: camera.name,
            role: camera.role,
            camera_from_world: camera.camera_from_world,
        })
    }

    fn role(&self, role: &Spanned<String>) -> Result<Role, RigError> {
        let found = Role::ALL.into_iter().find(|known| known.name() == role.get_ref());
        self.check(role, "camera.role", |_| found.is_some(), "`scene`, `ball`, `fisheye`")?;
        Ok(found.expect("checked: a known role"))
    }

    fn intrinsics(&self, entry: &LensEntry, size_px: [u32; 2]) -> Result<Intrinsics, RigError> {
        self.check(
            &entry.focal_px,
            "camera.lens.focal_px",
            |focal| focal.iter().all(|f| f.is_finite() && *f > 0.0),
            "two finite numbers above 0",
        )?;
        let principal_point = self.finite(&entry.principal_point_px, "camera.lens.principal_point_px")?;
        let lens = self.lens(entry)?;
        Ok(Intrinsics {
            size_px,
            focal_px: DVec2::from_array(*entry.focal_px.get_ref()),
            principal_point_px: DVec2::from_array(principal_point),
            lens,
        })
    }

    fn lens(&self, entry: &LensEntry) -> Result<LensModel, RigError> {
        const KEY: &str = "camera.lens.distortion";
        let distortion = &entry.distortion;
        let model = entry.model.get_ref().parse().map_err(|error| RigError::LensModel {
            place: self.place_of(&entry.model),
            model: error,
        })?;
        let allowed = match model {
            Model::BrownConrady => "five finite numbers: k1, k2, p1, p2, k3",
            Model::Rational => "eight finite numbers: k1, k2, p1, p2, k3, k4, k5, k6",
            Model::KannalaBrandt => "four finite numbers: k1, k2, k3, k4",
            Model::Equisolid => "an empty list: the model has no coefficients",
            Model::Eucm => "two finite numbers: alpha, beta",
            Model::DoubleSphere => "two finite numbers: xi, alpha",
        };
        let max_angle_rad = self.max_angle_rad(entry, model)?;
        let lens = LensModel::from_coefficients(model, distortion.get_ref(), max_angle_rad);
        let lens = lens.filter(|lens| lens.coefficients().iter().all(|x| x.is_finite()));
        self.check(distortion, KEY, |_| lens.is_some(), allowed)?;
        let lens = lens.expect("checked: as many numbers as the model has");
        self.check(
            distortion,
            KEY,
            |_| lens.is_usable(),
            "a distortion that maps rays to pixels one to one",
        )?;
        Ok(lens)
    }

    /// The angle beyond which a fisheye images nothing; π when the file leaves it to the model.
    fn max_angle_rad(&self, entry: &LensEntry, model: Model) -> Result<f64, RigError> {
        const KEY: &str = "camera.lens.max_angle_deg";
        let (allowed, is_allowed): (_, fn(&f64) -> bool) = match model {
            Model::BrownConrady | Model::Rational => (
                "with `kannala_brandt`, `equisolid`, `eucm` and `double_sphere` only",
                |_| false,
            ),
            Model::Equisolid => ("above 0, below 180", |&angle| angle > 0.0 && angle < 180.0),
            Model::KannalaBrandt | Model::Eucm | Model::DoubleSphere => {
                ("above 0, at most 180", |&angle| angle > 0.0 && angle <= 180.0)
            }
        };
        if let Some(angle) = &entry.max_angle_deg {
            self.check(angle, KEY, is_allowed, allowed)?;
            return Ok(angle.get_ref().to_radians());
        }
        match model {
            Model::KannalaBrandt | Model::Equisolid => Err(RigError::Entry {
                place: self.place_of(&entry.model),
                subject: format!("camera model `{model}`"),
                problem: "needs `max_angle_deg`, the angle beyond which nothing is imaged",
            }),
            Model::BrownConrady | Model::Rational | Model::Eucm | Model::DoubleSphere => Ok(PI),
        }
    }

    fn photometry(&self, entry: &PhotometryEntry) -> Result<Photometry, RigError> {
        let vignetting = self.finite(&entry.vignetting, "camera.photometry.vignetting")?;
        let transmits = |r: f64| 1.0 + vignetting[0] * r.powi(2) + vignetting[1] * r.powi(4) > 0.0;
        self.check(
            &entry.vignetting,
            "camera.photometry.vignetting",
            |_| (0..=64).all(|i| transmits(f64::from(i) / 64.0)),
            "1 + v1 r² + v2 r⁴ above 0 for r of 0 to 1",
        )?;
        self.check(
            &entry.read_noise_e,
            "camera.photometry.read_noise_e",
            |noise| noise.is_finite() && *noise >= 0.0,
            "a finite number, 0 or more",
        )?;
        Ok(Photometry {
            sensitivity: self.positive(&entry.sensitivity, "camera.photometry.sensitivity")?,
            vignetting,
            full_well_e: self.positive(&entry.full_well_e, "camera.photometry.full_well_e")?,
            read_noise_e: *entry.read_noise_e.get_ref(),
            response: self.response(&entry.response)?,
            color: self.color(entry.color.as_ref())?,
        })
    }

    fn response(&self, entry: &Spanned<ResponseEntry>) -> Result<ResponseCurve, RigError> {
        match entry.get_ref() {
            ResponseEntry::Name(name) if name == "srgb" => Ok(ResponseCurve::srgb()),
            ResponseEntry::Name(name) => Err(RigError::Value {
                place: self.place_of(entry),
                key: "camera.photometry.response".to_owned(),
                found: name.clone(),
                allowed: "`srgb` or a list of 256 numbers".to_owned(),
            }),
            ResponseEntry::Table(values) => ResponseCurve::from_table(values).map_err(|source| RigError::Response {
                place: self.place_of(entry),
                source,
            }),
        }
    }

    fn color(&self, rows: Option<&Spanned<[[f64; 3]; 3]>>) -> Result<DMat3, RigError> {
        let Some(rows) = rows else { return Ok(DMat3::IDENTITY) };
        let matrix = DMat3::from_cols_array_2d(rows.get_ref()).transpose();
        self.check(
            rows,
            "camera.photometry.color",
            |_| matrix.is_finite() && matrix.determinant().abs() > 1e-6,
            "three rows of three finite numbers that can be inverted",
        )?;
        Ok(matrix)
    }

    fn marker(&self, entry: &Spanned<MarkerEntry>) -> Result<Marker, RigError> {
        let entry = entry.get_ref();
        let family = entry.family.get_ref().parse::<Family>();
        // The other families are for boards; the rig's markers are light meters, tried with this one only.
        let is_allowed = |_: &String| family == Ok(Family::Tag36h11);
        self.check(&entry.family, "marker.family", is_allowed, "`tag36h11`")?;
        let family = family.expect("checked: a known family");
        let allowed = format!("0 to {}", family.codes() - 1);
        self.check(&entry.id, "marker.id", |id| *id < family.codes(), &allowed)?;
        let white_reflectance = match &entry.white_reflectance {
            Some(value) => {
                self.check(
                    value,
                    "marker.white_reflectance",
                    |x| *x > 0.0 && *x <= 1.0,
                    "above 0, at most 1",
                )?;
                *value.get_ref()
            }
            None => DEFAULT_WHITE_REFLECTANCE,
        };
        Ok(Marker {
            family,
            id: *entry.id.get_ref(),
            side_m: self.positive(&entry.side_m, "marker.side_m")?,
            white_reflectance,
            world_from_marker: self.pose(&entry.world_from_marker, "marker.world_from_marker")?,
        })
    }

    fn ball(&self, entry: &BallEntry) -> Result<Ball, RigError> {
        self.check(
            &entry.reflectance,
            "ball.reflectance",
            |list| list.iter().all(|x| *x > 0.0 && *x <= 1.0),
            "three numbers above 0, at most 1",
        )?;
        self.check(
            &entry.roughness,
            "ball.roughness",
            |x| (0.0..=1.0).contains(x),
            "0 to 1",
        )?;
        Ok(Ball {
            center_m: DVec3::from_array(self.finite(&entry.center_m, "ball.center_m")?),
            radius_m: self.positive(&entry.radius_m, "ball.radius_m")?,
            reflectance: *entry.reflectance.get_ref(),
            roughness: *entry.roughness.get_ref(),
        })
    }

    fn check_scene_camera(&self, cameras: &[Camera]) -> Result<(), RigError> {
        let scenes = cameras.iter().filter(|camera| camera.role == Role::Scene).count();
        if scenes != 1 {
            return Err(RigError::Roles {
                file: self.file.to_owned(),
                role: "`scene`",
                found: scenes,
                allowed: "exactly 1",
            });
        }
        Ok(())
    }

    fn check_doubles(&self, entries: &RigFile, cameras: &[PartialCamera], markers: &[Marker]) -> Result<(), RigError> {
        for (index, camera) in cameras.iter().enumerate() {
            if cameras[..index].iter().any(|other| other.name == camera.name) {
                let place = self.place_of(&entries.camera[index].get_ref().name);
                return Err(RigError::Duplicate {
                    place,
                    kind: "camera",
                    found: camera.name.clone(),
                });
            }
        }
        for (index, marker) in markers.iter().enumerate() {
            if markers[..index].iter().any(|other| other.id == marker.id) {
                let place = self.place_of(&entries.marker[index].get_ref().id);
                return Err(RigError::Duplicate {
                    place,
                    kind: "marker",
                    found: marker.id.to_string(),
                });
            }
        }
        Ok(())
    }

    /// A rig without a ball needs a fisheye camera and no camera that films a ball.
    fn check_ball_is_not_needed(&self, entries: &RigFile, cameras: &[Camera]) -> Result<(), RigError> {
        if cameras.iter().all(|camera| camera.role != Role::Fisheye) {
            return Err(RigError::NoBall {
                file: self.file.to_owned(),
            });
        }
        match cameras.iter().position(|camera| camera.role == Role::Ball) {
            Some(index) => Err(RigError::Entry {
                place: self.place_of(&entries.camera[index]),
                subject: format!("camera `{}`", cameras[index].name),
                problem: "films the ball: describe it in `[ball]`",
            }),
            None => Ok(()),
        }
    }

    fn check_main_marker(&self, entries: &RigFile, markers: &[Marker]) -> Result<(), RigError> {
        if markers.is_empty() {
            return Err(RigError::NoMarkers {
                file: self.file.to_owned(),
            });
        }
        let Some(main_marker) = &entries.main_marker else {
            return Err(RigError::NoMainMarker {
                file: self.file.to_owned(),
            });
        };
        let id = *main_marker.get_ref();
        let Some(index) = markers.iter().position(|marker| marker.id == id) else {
            let present = markers
                .iter()
                .map(|marker| format!("`{}`", marker.id))
                .collect::<Vec<_>>()
                .join(", ");
            return Err(RigError::MainMarkerMissing {
                place: self.place_of(main_marker),
                found: id,
                present,
            });
        };
        let pose = markers[index].world_from_marker;
        let deviation = (pose.rotation - DMat3::IDENTITY)
            .to_cols_array()
            .into_iter()
            .chain(pose.translation.to_array());
        if deviation.into_iter().any(|x| x.abs() > IDENTITY_TOLERANCE) {
            let place = self.place_of(&entries.marker[index].get_ref().world_from_marker);
            return Err(RigError::MainMarkerMoved { place, id });
        }
        Ok(())
    }
}

/// Whether a name can be a folder's name without surprises.
fn is_file_name(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}
