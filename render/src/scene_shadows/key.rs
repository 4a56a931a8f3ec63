//! One-light methods: the strongest light with its shadow, all others without.

use bytemuck::Zeroable;
use glam::{DVec2, Mat4, Vec3};
use mirrorball_calib::lights::KeyLight;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::probe::radiance::luminance;
use mirrorball_calib::rig::Camera;

use super::dome::{FARTHEST_LIGHT_M, dome_light};
use super::{EyeSurfaces, ShadowFrame, Things};
use crate::config::ShadowConfig;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::scene_gpu::SceneBuffers;
use crate::shadow::casters::Casters;
use crate::shadow::dome::{DomeLight, GpuDomeFrame, GpuDomeLight, MAX_DOME_LIGHTS, NONE_BRIGHT, Step};
use crate::shadow::key::{Job, KeyShadow};
use crate::shadow::light::{GpuShadowLight, ShadowLight};
use crate::shadow::shadow_view::{Sphere, basis};
use crate::shadow::surface::{Surface, SurfacePass};
use crate::shadow::view::View;

/// The pinhole view has so many pixels per pixel of the camera, so that little is lost on the way back.
const OVERSAMPLING: f32 = 1.25;
/// Edge of a shadow map, texels.
const MAP_SIZE: u32 = 1024;

/// The strongest light as a rectangle, and the others.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct KeyGroup {
    pub(super) light: KeyLamp,
    pub(super) rest: Vec<KeyLight>,
}

/// A lamp that faces the probe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct KeyLamp {
    probe_m: Vec3,
    direction: Vec3,
    distance_m: f32,
    irradiance: Vec3,
    angular_radius_rad: f32,
}

impl KeyLamp {
    pub(super) fn as_dome_light(&self) -> DomeLight {
        DomeLight {
            position_m: self.probe_m + self.direction * self.distance_m,
            intensity: self.irradiance * self.distance_m * self.distance_m,
            angular_radius_rad: self.angular_radius_rad,
        }
    }

    /// A square as large as the lamp's disk.
    fn as_rect(&self) -> ShadowLight {
        let half_m = (self.distance_m * self.angular_radius_rad.clamp(1e-3, 1.2).tan() * 0.886).max(1e-4);
        let [u, v] = basis(-self.direction);
        ShadowLight::Rect {
            center_m: self.probe_m + self.direction * self.distance_m,
            half_u_m: u * half_m,
            half_v_m: v * half_m,
            radiance: self.irradiance * self.distance_m * self.distance_m / (4.0 * half_m * half_m),
        }
    }
}

/// The strongest light together with those beside it that are as bright: parts of one lamp or window.
pub(super) fn strongest(lights: &[KeyLight], probe_m: Vec3) -> KeyGroup {
    /// Lights within this angle of the strongest may be parts of it, radians.
    const BESIDE_RAD: f32 = 0.4;
    /// ... if they are at least so bright beside it.
    const AS_BRIGHT: f32 = 0.25;
    let brightness = |l: &KeyLight| luminance(l.irradiance);
    let Some(first) = lights.iter().max_by(|a, b| brightness(a).total_cmp(&brightness(b))) else {
        let light = KeyLamp {
            probe_m,
            direction: Vec3::Z,
            distance_m: FARTHEST_LIGHT_M,
            irradiance: Vec3::ZERO,
            angular_radius_rad: 0.01,
        };
        return KeyGroup {
            light,
            rest: Vec::new(),
        };
    };
    let is_part = |l: &KeyLight| {
        l.direction.angle_between(first.direction) < BESIDE_RAD
            && luminance(l.radiance()) >= AS_BRIGHT * luminance(first.radiance())
    };
    let (parts, rest): (Vec<KeyLight>, Vec<KeyLight>) = lights.iter().copied().partition(is_part);
    let total: f32 = parts.iter().map(brightness).sum::<f32>().max(1e-9);
    let share = |l: &KeyLight| brightness(l) / total;
    let direction = parts
        .iter()
        .map(|l| l.direction * share(l))
        .sum::<Vec3>()
        .normalize_or(first.direction);
    let inverse_m: f32 = parts
        .iter()
        .map(|l| share(l) / l.distance_m.min(FARTHEST_LIGHT_M))
        .sum();
    let spread = |l: &KeyLight| {
        let off = l.direction.angle_between(direction);
        share(l) * (2.0 * off * off + l.angular_radius_rad * l.angular_radius_rad)
    };
    KeyGroup {
        light: KeyLamp {
            probe_m,
            direction,
            distance_m: inverse_m.max(1.0 / FARTHEST_LIGHT_M).recip(),
            irradiance: parts.iter().map(|l| l.irradiance).sum(),
            angular_radius_rad: parts.iter().map(spread).sum::<f32>().sqrt(),
        },
        rest,
    }
}

/// One surface in a pinhole view, and the key light's shadows on it.
#[derive(Debug)]
struct PinholeSide {
    surface: Surface,
    /// Past the real things, past everything; no passes for light without shadow.
    shadows: Option<[Box<dyn KeyShadow>; 2]>,
    visibility: [wgpu::TextureView; 2],
    sum: Step,
}

/// One-light shadows on both surfaces.
#[derive(Debug)]
pub(super) struct KeyShadows {
    surface_pass: SurfacePass,
    sides: [PinholeSide; 2],
    key: wgpu::Buffer,
    lights: wgpu::Buffer,
    frame: wgpu::Buffer,
    camera: Camera,
    size_px: [u32; 2],
}

impl KeyShadows {
    pub(super) fn new(
        gpu: &Gpu,
        (buffers, camera): (&SceneBuffers, &Camera),
        surfaces: EyeSurfaces<'_>,
        config: &ShadowConfig,
    ) -> Result<Self, RenderError> {
        let size_px = surfaces.surfaces[0].views().size_px;
        let surface_pass = SurfacePass::new(gpu);
        let view = pinhole(camera, &Pose::identity(), size_px);
        let key = gpu.buffer("key light", &[GpuShadowLight::zeroed()]);
        let lights = gpu.buffer("key light: others", &[GpuDomeLight::zeroed(); MAX_DOME_LIGHTS]);
        let frame = gpu.buffer("key light: frame", &[GpuDomeFrame::zeroed()]);
        let side = |index: usize| -> Result<PinholeSide, RenderError> {
            let surface = surface_pass.surface(gpu, &view, buffers);
            let visibility = [0, 1].map(|_| {
                let texture = gpu.target(
                    "key light: visibility",
                    TextureShape::plain(view.size_px),
                    RADIANCE_FORMAT,
                );
                texture.create_view(&wgpu::TextureViewDescriptor::default())
            });
            let method = || config.method.key_shadow(gpu, MAP_SIZE);
            let shadows = match (method()?, method()?) {
                (Some(real), Some(all)) => Some([real, all]),
                _ => None,
            };
            let (views, target) = (surfaces.surfaces[index].views(), &surfaces.targets[index]);
            let texture = |view| wgpu::BindingResource::TextureView(view);
            let sum = Step::new(
                gpu,
                "key_light_pair",
                &[
                    frame.as_entire_binding(),
                    lights.as_entire_binding(),
                    key.as_entire_binding(),
                    surface.view_buffer.as_entire_binding(),
                    texture(views.place),
                    texture(views.normal),
                    texture(&surface.place),
                    texture(&visibility[0]),
                    texture(&visibility[1]),
                    texture(&target.without),
                    texture(&target.with_virtual),
                ],
            );
            Ok(PinholeSide {
                surface,
                shadows,
                visibility,
                sum,
            })
        };
        Ok(Self {
            sides: [side(0)?, side(1)?],
            surface_pass,
            key,
            lights,
            frame,
            camera: camera.clone(),
            size_px,
        })
    }

    pub(super) fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        (frame, things, camera_from_world): (&ShadowFrame<'_>, &Things, &Pose),
    ) -> Result<(), RenderError> {
        let KeyGroup { light, rest } = strongest(&frame.light.lights, frame.probe_m);
        let light = light.as_rect();
        gpu.write(&self.key, &[light.to_gpu()]);
        let somewhere = Sphere {
            center_m: frame.probe_m,
            radius_m: 1.0,
        };
        let others: Vec<GpuDomeLight> = rest
            .iter()
            .take(MAX_DOME_LIGHTS)
            .map(|l| GpuDomeLight::new(&dome_light(l, frame.probe_m), (somewhere, somewhere), 1))
            .collect();
        if !others.is_empty() {
            gpu.write(&self.lights, &others);
        }
        let [width, height] = self.size_px;
        gpu.write(
            &self.frame,
            &[GpuDomeFrame {
                counts: [others.len() as u32, 0, 0, 0],
                sizes: [0, width, height, 0],
                unshaded: Vec3::ZERO.extend(0.0),
                bright: NONE_BRIGHT,
            }],
        );
        let view = pinhole(&self.camera, camera_from_world, self.size_px);
        let receivers: [&Casters; 2] = [&things.phantoms, &things.virtuals];
        for (side, receivers) in self.sides.iter_mut().zip(receivers) {
            side.surface.set_view(gpu, &view);
            self.surface_pass
                .record(encoder, timer, (&side.surface, frame.scene, &receivers.range));
            let casters: [&Casters; 2] = [&things.phantoms, &things.everything];
            for index in 0..2 {
                match &mut side.shadows {
                    Some(shadows) => {
                        let job = Job {
                            surface: &side.surface,
                            scene: frame.scene,
                            receivers,
                            casters: casters[index],
                            light: &light,
                            light_buffer: &self.key,
                            visibility: &side.visibility[index],
                        };
                        shadows[index].record(gpu, encoder, timer, &job)?;
                    }
                    None => clear(encoder, &side.visibility[index]),
                }
            }
            side.sum
                .record(encoder, timer, [width.div_ceil(8), height.div_ceil(8), 1]);
        }
        Ok(())
    }
}

/// Everything visible.
fn clear(encoder: &mut wgpu::CommandEncoder, visibility: &wgpu::TextureView) {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("key light: no shadow"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: visibility,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load: wgpu::LoadOp::Clear(wgpu::Color::WHITE),
                store: wgpu::StoreOp::Store,
            },
        })],
        ..wgpu::RenderPassDescriptor::default()
    });
}

/// A pinhole view from where a camera stands that holds what its lens sees, up to 70 degrees off its axis.
fn pinhole(camera: &Camera, camera_from_world: &Pose, size_px: [u32; 2]) -> View {
    const WIDEST: f64 = 2.75;
    let [width, height] = size_px.map(f64::from);
    let mut tangents = DVec2::splat(0.1);
    for step in 0..=16 {
        let t = f64::from(step) / 16.0;
        let border = [
            DVec2::new(t * width, 0.0),
            DVec2::new(t * width, height),
            DVec2::new(0.0, t * height),
            DVec2::new(width, t * height),
        ];
        for pixel in border {
            if let Some(ray) = camera.intrinsics.unproject(pixel - 0.5).filter(|ray| ray.z > 1e-3) {
                tangents = tangents.max(DVec2::new(ray.x / ray.z, ray.y / ray.z).abs());
            } else {
                tangents = DVec2::splat(WIDEST);
            }
        }
    }
    let [x, y] = (1.02 * tangents.min(DVec2::splat(WIDEST))).to_array();
    // The camera's y points down and its z forward; the view's the other way.
    let view_from_camera = Mat4::from_diagonal(Vec3::new(1.0, -1.0, -1.0).extend(1.0));
    View {
        eye_m: camera_from_world.inverse().translation.as_vec3(),
        camera_from_world: view_from_camera * Mat4::from(crate::scene::affine(camera_from_world)),
        tangents: [x as f32, y as f32],
        near_m: 0.02,
        size_px: size_px.map(|s| (s as f32 * OVERSAMPLING) as u32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(direction: Vec3, irradiance: f32, angular_radius_rad: f32) -> KeyLight {
        KeyLight {
            id: 0,
            direction: direction.normalize(),
            distance_m: 2.0,
            irradiance: Vec3::splat(irradiance),
            angular_radius_rad,
        }
    }

    #[test]
    fn parts_of_a_window_are_one_light() {
        let lights = [
            light(Vec3::new(1.0, 0.1, 1.0), 5.0, 0.1),
            light(Vec3::new(1.0, -0.1, 1.0), 4.0, 0.1),
            light(Vec3::new(-1.0, 0.0, 1.0), 1.0, 0.1),
            light(Vec3::new(1.0, 0.0, 0.8), 0.1, 0.4),
        ];
        let group = strongest(&lights, Vec3::ZERO);
        assert_eq!(group.rest.len(), 2);
        assert!((group.light.irradiance.x - 9.0).abs() < 1e-5);
        assert!((group.light.distance_m - 2.0).abs() < 1e-4);
        assert!(group.light.angular_radius_rad > 0.1 && group.light.angular_radius_rad < 0.25);
        assert!(strongest(&[], Vec3::ZERO).rest.is_empty());
    }

    #[test]
    fn the_rectangle_gives_the_probe_the_lights_irradiance() {
        let group = strongest(&[light(Vec3::Z, 3.0, 0.05)], Vec3::ZERO);
        let ShadowLight::Rect {
            half_u_m,
            half_v_m,
            radiance,
            center_m,
        } = group.light.as_rect()
        else {
            panic!("a rectangle");
        };
        let across = half_u_m.cross(half_v_m);
        assert!(across.normalize().dot(-center_m.normalize()) > 0.999);
        let irradiance = radiance.x * 4.0 * across.length() / center_m.length_squared();
        assert!((irradiance - 3.0).abs() < 0.02);
    }
}
