//! One pixel of an eye's picture, from the camera models' own functions.

use glam::{DVec2, DVec3, IVec2, Vec4};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Camera;

/// Farthest pixel that the colour of something hidden is fetched from.
const REACH_PX: i32 = 48;

/// What the scene camera sees, and from where.
#[derive(Debug, Clone, Copy)]
pub struct CameraPicture<'a> {
    /// The scene camera.
    pub camera: &'a Camera,
    /// Where it is.
    pub camera_from_world: Pose,
    /// Its codes, three per pixel.
    pub codes: &'a [u8],
    /// Places of the phantoms that it sees, world, metres; w: 0 where there is none.
    pub places: &'a [Vec4],
}

/// An eye beside it.
#[derive(Debug, Clone, Copy)]
pub struct Viewer<'a> {
    /// Its camera, a pinhole.
    pub eye: &'a Camera,
    /// Where it is.
    pub eye_from_world: Pose,
    /// The room's centre in the world and its radius, metres.
    pub room_m: (DVec3, f64),
}

/// The codes of the eye's `pixel`, which shows the phantom at `place` (w: 0 for none).
#[must_use]
pub fn pixel(picture: &CameraPicture<'_>, viewer: &Viewer<'_>, pixel: DVec2, place: Vec4) -> [u8; 3] {
    let point = if place.w > 0.0 {
        place.truncate().as_dvec3()
    } else {
        let Some(ray) = viewer.eye.intrinsics.unproject(pixel) else {
            return [0; 3];
        };
        room_point(viewer, viewer.eye_from_world.inverse().transform_vector(ray))
    };
    let in_camera = picture.camera_from_world.transform_point(point);
    let Some(at) = picture.camera.intrinsics.project(in_camera) else {
        return [0; 3];
    };
    let [width, height] = picture.camera.intrinsics.size_px.map(f64::from);
    if at.min_element() < -0.5 || at.x > width - 0.5 || at.y > height - 0.5 {
        return [0; 3];
    }
    let response = &picture.camera.photometry.response;
    visible_signal(picture, at, in_camera.z)
        .to_array()
        .map(|y| response.encode(y))
}

/// Where the eye's ray leaves the room's sphere; from without, a point as far away as the sphere is wide.
fn room_point(viewer: &Viewer<'_>, direction: DVec3) -> DVec3 {
    let origin = viewer.eye_from_world.inverse().translation;
    let (center, radius) = viewer.room_m;
    let from_center = origin - center;
    let along = from_center.dot(direction);
    let rest = radius * radius - from_center.length_squared();
    let distance = if rest > 0.0 {
        (along * along + rest).sqrt() - along
    } else {
        radius
    };
    origin + direction * distance
}

fn index(picture: &CameraPicture<'_>, at: IVec2) -> usize {
    at.y as usize * picture.camera.intrinsics.size_px[0] as usize + at.x as usize
}

/// Whether a pixel or one beside it shows something before a point `depth_m` away.
fn is_before(picture: &CameraPicture<'_>, at: IVec2, depth_m: f64) -> bool {
    let width = picture.camera.intrinsics.size_px[0] as i32;
    (at.x - 1..=at.x + 1)
        .filter(|x| (0..width).contains(x))
        .any(|x| shows_before(picture, IVec2::new(x, at.y), depth_m))
}

fn shows_before(picture: &CameraPicture<'_>, at: IVec2, depth_m: f64) -> bool {
    let found = picture.places[index(picture, at)];
    let found_m = picture.camera_from_world.transform_point(found.truncate().as_dvec3()).z;
    found.w > 0.0 && found_m < 0.99 * depth_m - 0.004
}

fn signal(picture: &CameraPicture<'_>, at: IVec2) -> DVec3 {
    let photometry = &picture.camera.photometry;
    let i = 3 * index(picture, at);
    let linear = [0, 1, 2].map(|c| photometry.response.linear_from_code(picture.codes[i + c]));
    DVec3::from_array(linear) / photometry.vignetting_at(at.as_dvec2(), picture.camera.intrinsics.size_px)
}

fn visible_signal(picture: &CameraPicture<'_>, pixel: DVec2, depth_m: f64) -> DVec3 {
    let size = glam::UVec2::from_array(picture.camera.intrinsics.size_px).as_ivec2();
    let (corner, part) = (pixel.floor(), pixel - pixel.floor());
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for offset in [IVec2::ZERO, IVec2::X, IVec2::Y, IVec2::ONE] {
        let at = (corner.as_ivec2() + offset).clamp(IVec2::ZERO, size - 1);
        let weight = |offset: i32, part: f64| if offset == 1 { part } else { 1.0 - part };
        let weight = weight(offset.x, part.x) * weight(offset.y, part.y);
        if weight > 0.0 && !is_before(picture, at, depth_m) {
            sum += weight * signal(picture, at);
            total += weight;
        }
    }
    if total > 0.0 {
        return sum / total;
    }
    let middle = pixel.round().as_ivec2().clamp(IVec2::ZERO, size - 1);
    for r in 1..=REACH_PX {
        for i in 0..9 {
            let at = middle + r * IVec2::new(i % 3 - 1, i / 3 - 1);
            if at.cmpge(IVec2::ZERO).all() && at.cmplt(size).all() && !is_before(picture, at, depth_m) {
                return signal(picture, at);
            }
        }
    }
    signal(picture, middle)
}
