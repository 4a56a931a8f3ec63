//! What Rust and WGSL share: the same structs on both sides, compared member by member in a test.

use crate::light_tree::Lobe;
use crate::scene::material::N_TEXTURES;
use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, DMat3, DVec3, Mat3, Mat4, Vec4};
use mirrorball_calib::camera::LensModel;
use mirrorball_calib::merge::noise::ChannelNoise;
use mirrorball_calib::photometry::Photometry;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Camera;
use mirrorball_capture::frame::Exposure;

/// Strong lights at most; those of `shaders/local_environment.wgsl`.
pub const MAX_STRONG: usize = 6;
/// Most virtual objects with an environment of their own; further ones share the last.
pub const MAX_ENVIRONMENTS: usize = 16;

/// A camera as the shaders see it (`Camera` in `shared/camera.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuCamera {
    /// Focal lengths and principal point in pixels. First, as they stay: lavapipe writes the first number of a uniform buffer
    /// that a shader branches on into the shader, and a pose there means every such shader anew in every frame.
    pub focal_and_principal_px: Vec4,
    /// World to camera.
    pub camera_from_world: Mat4,
    /// Camera's linear RGB to the rig's common RGB, in the upper left 3×3.
    pub common_from_camera: Mat4,
    /// Its inverse.
    pub camera_from_common: Mat4,
    /// xyz: camera centre in the world, metres; w: lens model, 0 perspective, 1 Kannala-Brandt, 2 equisolid, 3 spheres (EUCM
    /// and double sphere).
    pub position_m: Vec4,
    /// k1 k2 p1 p2, or k1 k2 k3 k4, or alpha beta xi; unused for an equisolid lens.
    pub distortion: Vec4,
    /// xyz: k4 k5 k6 of a rational lens, 0 for others; w: unused.
    pub denominator: Vec4,
    /// x: k3; y: largest usable normalised radius (perspective) or angle in radians (fisheye); z, w: size in px.
    pub limits: Vec4,
    /// xyz: signal per radiance of the three channels; w: unused.
    pub signal_per_radiance: Vec4,
    /// x, y: vignetting v1 and v2; z, w: near and far plane in metres.
    pub vignetting_and_depth: Vec4,
}

impl GpuCamera {
    /// A camera at a pose, with the exposure in force and the depth range (near, far) in metres.
    #[must_use]
    pub fn new(camera: &Camera, camera_from_world: &Pose, exposure: &Exposure, depth_m: [f32; 2]) -> Self {
        let intrinsics = &camera.intrinsics;
        let (distortion, k3, denominator, model) = match intrinsics.lens {
            LensModel::BrownConrady { k1, k2, p1, p2, k3 } => ([k1, k2, p1, p2], k3, DVec3::ZERO, 0.0),
            LensModel::Rational {
                coefficients: [k1, k2, p1, p2, k3, k4, k5, k6],
            } => ([k1, k2, p1, p2], k3, DVec3::new(k4, k5, k6), 0.0),
            LensModel::KannalaBrandt { k, .. } => (k, 0.0, DVec3::ZERO, 1.0),
            LensModel::Equisolid { .. } => ([0.0; 4], 0.0, DVec3::ZERO, 2.0),
            LensModel::Eucm { alpha, beta, .. } => ([alpha, beta, 0.0, 0.0], 0.0, DVec3::ZERO, 3.0),
            LensModel::DoubleSphere { xi, alpha, .. } => ([alpha, 1.0, xi, 0.0], 0.0, DVec3::ZERO, 3.0),
        };
        let limit = intrinsics.lens.max_angle_rad().unwrap_or(intrinsics.max_radius());
        let signal = camera.photometry.signal_per_radiance(exposure).map(|s| s as f32);
        let color = camera.photometry.color;
        let vignetting = camera.photometry.vignetting.map(|v| v as f32);
        let [width, height] = intrinsics.size_px.map(|s| s as f32);
        Self {
            camera_from_world: Mat4::from(crate::scene::affine(camera_from_world)),
            common_from_camera: Mat4::from_mat3(color.as_mat3()),
            camera_from_common: Mat4::from_mat3(inverse(color)),
            position_m: camera_from_world.inverse().translation.as_vec3().extend(model),
            focal_and_principal_px: Vec4::new(
                intrinsics.focal_px.x as f32,
                intrinsics.focal_px.y as f32,
                intrinsics.principal_point_px.x as f32,
                intrinsics.principal_point_px.y as f32,
            ),
            distortion: Vec4::from_array(distortion.map(|d| d as f32)),
            denominator: denominator.as_vec3().extend(0.0),
            limits: Vec4::new(k3 as f32, limit.min(1e6) as f32, width, height),
            signal_per_radiance: Vec4::new(signal[0], signal[1], signal[2], 0.0),
            vignetting_and_depth: Vec4::new(vignetting[0], vignetting[1], depth_m[0], depth_m[1]),
        }
    }
}

fn inverse(matrix: DMat3) -> Mat3 {
    matrix.inverse().as_mat3()
}

/// Noise of a camera's pixels (`Noise` in `shared/noise.wgsl`); all zeros for none.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuNoise {
    /// xyz: variance of the signal of red, green and blue per unit of signal; w: unused.
    pub shot: Vec4,
    /// xyz: variance of the signal whatever the light; w: unused.
    pub read: Vec4,
    /// x: number of the frame; y, z, w: unused.
    pub frame: [u32; 4],
}

impl GpuNoise {
    /// The measured noise of a camera's frame `sequence`: shot noise and read noise, times gain and white balance.
    #[must_use]
    pub fn new(photometry: &Photometry, exposure: &Exposure, sequence: u64) -> Self {
        let channels = photometry.channel_noise(exposure);
        let of = |variance: fn(&ChannelNoise) -> f64| {
            let [red, green, blue] = channels.each_ref().map(|channel| variance(channel) as f32);
            Vec4::new(red, green, blue, 0.0)
        };
        Self {
            shot: of(|channel| channel.signal_per_electron),
            read: of(|channel| (channel.signal_per_electron * channel.read_noise_e).powi(2)),
            // Two frames whose numbers agree in the lower half are years apart.
            frame: [sequence as u32, 0, 0, 0],
        }
    }
}

/// A line of taps of the camera's blur (`Line` in `look_blur.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuBlurLine {
    /// x, y: from one tap to the next, pixels; z: taps on each side of the middle; w: unused.
    pub step: [i32; 4],
    /// Weights from the middle outwards.
    pub weights: [Vec4; 5],
}

/// How the probe is looked at (`Probe` in `radiance_map.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuProbe {
    /// xyz: ball centre or fisheye lens in the world, metres; w: ball radius, 0 for a fisheye.
    pub position_m: Vec4,
    /// xyz: the cube's centre, for which the light is measured, world, metres; w: distance of the room from it, metres.
    pub origin_m: Vec4,
    /// xyz: the ball's reflectance, 1 for a fisheye; w: `wrap` of the simple mapping, negative for the exact one.
    pub reflectance: Vec4,
    /// x, y: cosine of reflection at which trust begins, and at which it is whole; z: angle around the camera's own image
    /// that is left out, radians; w: cube size in texels.
    pub limits: Vec4,
    /// Pixels from the ball's outline (x, y) and from the end of a fisheye's picture (z, w) where trust begins and is whole.
    pub ramps_px: Vec4,
}

/// What all fragments of a frame share (`Frame` in `shared/lights.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuFrame {
    /// x: number of environments; y, z, w: unused.
    pub counts: [u32; 4],
    /// xyz: the mirror ball's centre, world; w: its radius, 0 when there is none.
    pub ball_m: Vec4,
}

/// Placement of one object (`Object` in `shared/lights.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuObject {
    /// Object to world.
    pub world_from_object: Mat4,
    /// x: environment slot; y: 1 for virtual objects, 0 for phantoms; z, w: unused.
    pub environment: [u32; 4],
}

impl GpuObject {
    /// An object at a placement, lit by environment `slot`.
    #[must_use]
    pub fn new(world_from_object: Affine3A, slot: u32, is_virtual: u32) -> Self {
        Self {
            world_from_object: Mat4::from(world_from_object),
            environment: [slot, is_virtual, 0, 0],
        }
    }
}

/// A picture on a surface (`Map` in `shared/lights.wgsl`); nothing is read of one that the material has not.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuMap {
    /// Columns of the matrix from the vertices' coordinates to those of the picture: x axis, y axis.
    pub matrix: Vec4,
    /// xy: translation of the same; z: its largest scale; w: unused.
    pub place: Vec4,
    /// x: layer; y: set of coordinates; z, w: wrapping along u and v, 0 repeat, 1 mirror, 2 clamp.
    pub facts: [u32; 4],
}

/// One material (`Material` in `shared/lights.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuMaterial {
    /// xyz: linear base colour; w: opacity.
    pub base_color: Vec4,
    /// xyz: dielectric reflectance at normal incidence; w: at grazing incidence.
    pub dielectric: Vec4,
    /// xyz: emitted radiance; w: strength of the occlusion.
    pub emission: Vec4,
    /// xyz: colour of white light after the distance w, metres.
    pub attenuation: Vec4,
    /// xyz: colour of the sheen; w: its perceptual roughness.
    pub sheen: Vec4,
    /// x: metallic; y: perceptual roughness; z: scale of the normal map; w: alpha below which there is no surface.
    pub surface: Vec4,
    /// Clear coat: x: share; y: perceptual roughness; z: scale of its normal map; w: unused.
    pub coat: Vec4,
    /// x: transmission; y: index of refraction; z: thickness, metres; w: unused.
    pub glass: Vec4,
    /// x: model, 0 metallic-roughness, 1 gloss in alpha, 2 unlit; y: alpha, 0 opaque, 1 mask, 2 blend; z: 1 where both
    /// sides are seen; w: the pictures that there are, one bit each in the order of `maps`.
    pub kinds: [u32; 4],
    /// Pictures, in the order of [`crate::scene::Material::textures`].
    pub maps: [GpuMap; N_TEXTURES],
}

/// Strong lights at their places.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuStrong {
    /// xyz: unit direction from the probe, world; w: distance from it, metres, 0 for no light.
    pub lights: [Vec4; MAX_STRONG],
    /// x: half the angle that holds it, seen from the probe, radians.
    pub cones: [Vec4; MAX_STRONG],
}

/// A lobe that a cube is filtered with (`Lobe` in `shared/lobe_sum.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuLobe {
    /// x: GGX alpha or Phong exponent, 0 for the cosine; y: edge of a face of the filtered cube, texels; z: factor of
    /// the result; w: unused.
    pub parameters: Vec4,
}

impl GpuLobe {
    /// A lobe for faces of `size` texels.
    #[must_use]
    pub fn new(lobe: Lobe, size: u32, factor: f32) -> Self {
        let parameter = match lobe {
            Lobe::Ggx { alpha } => alpha,
            Lobe::Phong { exponent } => exponent,
            Lobe::Cosine => 0.0,
        };
        Self {
            parameters: Vec4::new(parameter, size as f32, factor, 0.0),
        }
    }
}

/// A node of a light tree (`Node` in `shared/light_tree.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuNode {
    /// xyz: radiance times solid angle; w: variance of the light around its centre along one axis, rad².
    pub power: Vec4,
    /// xyz: unit direction of the centre; w: solid angle of the patch, steradians.
    pub direction: Vec4,
}

/// One step of the cylindrical filter (`Turn` in `cylindrical.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuTurn {
    /// xyz: unit axis; w: factor of the result.
    pub axis: Vec4,
    /// x: angle that is swept, radians; y: number of steps; z, w: unused.
    pub sweep: Vec4,
}

/// Where an object's own environment is taken (`Environment` in `shared/lights.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuEnvironment {
    /// xyz: middle of the object's bounding box, world, metres; w: distance of the room from the probe, metres.
    pub position_m: Vec4,
    /// xyz: the probe's place, world, metres; w: radius of the sphere around the object, metres.
    pub probe_m: Vec4,
}
