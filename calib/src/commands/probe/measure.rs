//! From pictures to what they say of every direction.

use glam::{DVec3, Vec3, Vec4};
use mirrorball_calib::{
    pose::Pose,
    probe::{
        NoProbe, ProbeOptics, Trust, View,
        cube::Cube,
        fill,
        fusion::{Fusion, ViewNoise},
        mapping::Mapping,
        mirror_ball::MirrorBall,
        radiance::Picture,
        radiance_map::{self, Seen, Surroundings},
    },
    resection,
    rig::{Rig, Role},
    tag::Finder,
};

use super::{ProbeError, taken::Taken};
use crate::commands::{CommandError, families};

/// Edge of the map's faces in texels: 0.35° each, finer than the output.
pub(super) const PROBE_CUBE_SIZE: u32 = 256;
/// Relative difference up to which pictures show the same light.
const SAME_LIGHT: f32 = 0.08;
/// A picture that shows less than this share of the sphere does not show the probe.
const MIN_SEEN: f32 = 0.01;
/// Where this share of what is seen is clipped in all channels, or black, there is nothing to see.
const HOPELESS: f32 = 0.999;
/// Codes up to this are black: noise.
const BLACK_CODE: u8 = 2;

/// The light at the probe, as far as it was seen.
pub(super) struct Measured {
    pub(super) texels: Cube<Option<Seen>>,
    /// The place whose light it is, world, metres.
    pub(super) position_m: DVec3,
    /// Where the camera was.
    pub(super) camera_from_world: Pose,
    /// How well markers fit that pose; `None` for a camera that stands still.
    pub(super) reprojection_error_px: Option<f64>,
}

impl Measured {
    /// The map with plausible light where nothing was seen.
    pub(super) fn filled(&self) -> Cube<Vec3> {
        let known = |seen: &Option<Seen>| seen.map_or(Vec4::ZERO, |seen| seen.radiance.max(Vec3::ZERO).extend(1.0));
        fill::fill_unknown(&self.texels.map(known))
    }

    /// Share of the sphere, 0 to 1, weighted by what `weight` says of each texel.
    pub(super) fn share(&self, weight: impl Fn(Option<Seen>) -> f32) -> f32 {
        let texels = self.texels.texels().iter().enumerate();
        let sum: f32 = texels.map(|(i, seen)| weight(*seen) * self.texels.solid_angle(i)).sum();
        sum / (4.0 * std::f32::consts::PI)
    }
}

/// Measures the light: finds out where the camera was, asks the pictures for every direction, and refuses what says nothing.
pub(super) fn measure(pictures: &[Taken<'_>], rig: &Rig, room_m: f32) -> Result<Measured, CommandError> {
    if !(0.1..=1e6).contains(&room_m) {
        return Err(ProbeError::RoomDistance { found: room_m }.into());
    }
    let [picture, ..] = pictures else {
        return Err(ProbeError::NoPicture.into());
    };
    let optics = optics(rig, picture)?;
    let mut views = Vec::new();
    let mut reprojection_error_px = None;
    for taken in pictures {
        let located = locate(taken, rig)?;
        reprojection_error_px = located.reprojection_error_px;
        let view = View {
            picture: Picture::new(&taken.frame, taken.camera),
            camera: taken.camera,
            camera_from_world: located.camera_from_world,
        };
        let reflectance = match &optics {
            ProbeOptics::MirrorBall { reflectance, .. } => *reflectance,
            ProbeOptics::Fisheye { .. } => Vec3::ONE,
        };
        let exposure = &taken.frame.meta.exposure;
        views.push((view, ViewNoise::new(&taken.camera.photometry, exposure, reflectance)));
    }
    let measured = Measured {
        texels: seen_by(&views, &optics, room_m),
        position_m: optics.position_m().as_dvec3(),
        camera_from_world: views[0].0.camera_from_world,
        reprojection_error_px,
    };
    check(&measured, picture, &optics)?;
    Ok(measured)
}

/// Radiance, what is clipped and how far to trust it, per direction: of one picture, or of several that are merged.
fn seen_by(views: &[(View<'_>, ViewNoise)], optics: &ProbeOptics, room_m: f32) -> Cube<Option<Seen>> {
    // No scene file, no phantoms: all light comes from the room.
    let near_m = Cube::filled(PROBE_CUBE_SIZE, f32::INFINITY);
    let around = Surroundings {
        origin_m: optics.position_m(),
        near_m: &near_m,
        room_m,
    };
    let mut fusion = Fusion::new(PROBE_CUBE_SIZE, SAME_LIGHT, u32::MAX);
    for (view, noise) in views {
        let texels = radiance_map::cube(view, optics, Mapping::Exact, &Trust::default(), &around);
        fusion.take(&[(texels.texels(), noise)]);
    }
    let mut seen = near_m.map(|_| None);
    for (index, texel) in seen.texels_mut().iter_mut().enumerate() {
        *texel = fusion.seen(index);
    }
    seen
}

/// What the picture's camera sees the light through: its own lens if that is a fisheye, else the ball.
fn optics(rig: &Rig, taken: &Taken<'_>) -> Result<ProbeOptics, ProbeError> {
    let missing = |source: NoProbe| ProbeError::NoProbe {
        camera: taken.camera.name.clone(),
        source,
    };
    match taken.camera.role {
        Role::Fisheye => ProbeOptics::of_rig(rig).map_err(missing),
        Role::Scene | Role::Ball => {
            let ball = rig.ball.as_ref().ok_or_else(|| missing(NoProbe::Neither))?;
            Ok(ProbeOptics::MirrorBall {
                ball: MirrorBall {
                    center_m: ball.center_m,
                    radius_m: ball.radius_m,
                },
                reflectance: DVec3::from_array(ball.reflectance).as_vec3(),
            })
        }
    }
}

struct Located {
    camera_from_world: Pose,
    reprojection_error_px: Option<f64>,
}

/// Where the camera was: by the rig if it stands still, else by the markers in the picture.
fn locate(taken: &Taken<'_>, rig: &Rig) -> Result<Located, CommandError> {
    if let Some(camera_from_world) = taken.camera.camera_from_world {
        return Ok(Located {
            camera_from_world,
            reprojection_error_px: None,
        });
    }
    let size = [taken.frame.size.width as usize, taken.frame.size.height as usize];
    let detections = Finder::new(&families(rig))
        .find(&taken.frame.pixels, size, taken.camera)
        .map_err(|source| CommandError::Search {
            name: taken.file.display().to_string(),
            source,
        })?;
    let located = resection::locate(&detections, rig, &taken.camera.intrinsics).map_err(|source| ProbeError::Pose {
        file: taken.file.clone(),
        camera: taken.camera.name.clone(),
        source,
    })?;
    Ok(Located {
        camera_from_world: located.camera_from_world,
        reprojection_error_px: Some(located.reprojection_error_px),
    })
}

/// Refuses a map that shows nothing.
fn check(measured: &Measured, taken: &Taken<'_>, optics: &ProbeOptics) -> Result<(), ProbeError> {
    let file = taken.file.clone();
    let seen = measured.share(|seen| if seen.is_some() { 1.0 } else { 0.0 });
    if seen < MIN_SEEN {
        let place = place(measured, taken, optics);
        return Err(ProbeError::NotSeen { file, place });
    }
    let clipped = measured.share(|seen| f32::from(seen.is_some_and(|s| s.clipped_everywhere == 7)));
    if clipped > HOPELESS * seen {
        return Err(ProbeError::AllClipped { file });
    }
    let photometry = &taken.camera.photometry;
    let darkest = photometry.response.linear_from_code(BLACK_CODE)
        / photometry.signal_per_radiance(&taken.frame.meta.exposure)[1];
    let is_black = |s: Seen| f64::from(s.radiance.max_element()) <= darkest;
    let black = measured.share(|seen| f32::from(seen.is_some_and(is_black)));
    if black > HOPELESS * seen {
        return Err(ProbeError::AllBlack { file });
    }
    Ok(())
}

/// Where the probe should have been, in words.
fn place(measured: &Measured, taken: &Taken<'_>, optics: &ProbeOptics) -> String {
    let ProbeOptics::MirrorBall { ball, .. } = optics else {
        return "nothing lies inside the lens' circle".to_owned();
    };
    let in_camera = measured.camera_from_world.transform_point(ball.center_m);
    let [width, height] = taken.camera.intrinsics.size_px;
    match taken.camera.intrinsics.project(in_camera) {
        Some(pixel) => format!(
            "the ball's middle lies at pixel ({:.0}, {:.0}) of {width}×{height}",
            pixel.x, pixel.y
        ),
        None => "the ball lies beside or behind the camera".to_owned(),
    }
}
