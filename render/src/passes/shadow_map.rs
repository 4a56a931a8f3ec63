//! Shadow maps: for every light one of the phantoms and one of the virtual objects.

use glam::{Vec3, Vec4};

use crate::gpu::Gpu;
use crate::gpu::pass::{DEPTH_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::gpu::types::GpuAim;
use crate::scene_gpu::{IndexRange, SceneBuffers};

/// A sphere, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Centre.
    pub center_m: Vec3,
    /// Radius.
    pub radius_m: f32,
}

impl Sphere {
    /// Centre and radius as the shaders take them.
    #[must_use]
    pub fn to_vec4(self) -> Vec4 {
        self.center_m.extend(self.radius_m)
    }
}

/// Maps of one set of casters, a layer per light. A layer whose light stands where it stood is kept.
#[derive(Debug)]
pub struct ShadowMaps {
    label: &'static str,
    layers: Vec<Layer>,
    /// All layers, for the shading pass.
    pub view: wgpu::TextureView,
}

#[derive(Debug)]
struct Layer {
    view: wgpu::TextureView,
    aim: wgpu::Buffer,
    bindings: wgpu::BindGroup,
    drawn: Option<GpuAim>,
}

/// What is drawn into which maps.
#[derive(Debug)]
pub struct ShadowWork<'a> {
    /// The maps.
    pub maps: &'a mut ShadowMaps,
    /// The scene.
    pub scene: &'a SceneBuffers,
    /// The triangles that cast shadows.
    pub casters: &'a IndexRange,
    /// What each light's map shows; `None` for a dark light.
    pub aims: &'a [Option<GpuAim>],
}

/// The pass.
#[derive(Debug)]
pub struct ShadowMapPass {
    pipeline: wgpu::RenderPipeline,
}

impl ShadowMapPass {
    /// The pass for any number of maps. Depth is biased by two steps plus twice the slope.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        let state = RasterState {
            targets: &[],
            samples: 1,
            bias: wgpu::DepthBiasState {
                constant: 2,
                slope_scale: 2.0,
                clamp: 0.0,
            },
            cull: None,
        };
        Self {
            pipeline: gpu.render_pipeline("shadow_map", &state),
        }
    }

    /// Empty maps of `size` × `size` texels for `n_lights` lights.
    #[must_use]
    pub fn maps(&self, gpu: &Gpu, label: &'static str, scene: &SceneBuffers, [size, n_lights]: [u32; 2]) -> ShadowMaps {
        let texture = gpu.texture(label, TextureShape::layered([size; 2], n_lights), DEPTH_FORMAT);
        let layer = |index: u32| {
            let aim = gpu.buffer(label, &[<GpuAim as bytemuck::Zeroable>::zeroed()]);
            let bindings = gpu.bind(
                label,
                &self.pipeline.get_bind_group_layout(0),
                &[aim.as_entire_binding(), scene.objects.as_entire_binding()],
            );
            let view = texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer: index,
                array_layer_count: Some(1),
                ..wgpu::TextureViewDescriptor::default()
            });
            Layer {
                view,
                aim,
                bindings,
                drawn: None,
            }
        };
        ShadowMaps {
            label,
            layers: (0..n_lights).map(layer).collect(),
            view: texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..wgpu::TextureViewDescriptor::default()
            }),
        }
    }

    /// Draws the casters for every light whose aim changed; returns how many were drawn.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        work: ShadowWork<'_>,
    ) -> usize {
        let ShadowWork {
            maps,
            scene,
            casters,
            aims,
        } = work;
        let changed: Vec<(usize, GpuAim)> = aims
            .iter()
            .enumerate()
            .filter_map(|(i, aim)| aim.filter(|aim| maps.layers[i].drawn != Some(*aim)).map(|aim| (i, aim)))
            .collect();
        if changed.is_empty() {
            return 0;
        }
        let span = timer.span(maps.label);
        for (position, (index, aim)) in changed.iter().enumerate() {
            let layer = &mut maps.layers[*index];
            gpu.write(&layer.aim, &[*aim]);
            layer.drawn = Some(*aim);
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some(maps.label),
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &layer.view,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(1.0),
                        store: wgpu::StoreOp::Store,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: span.render(Ends::of(position, changed.len())),
                ..wgpu::RenderPassDescriptor::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &layer.bindings, &[]);
            casters.draw(&mut pass, &scene.vertices);
        }
        changed.len()
    }
}

/// A light's view of the receivers: the CPU twin of `shadow_view` in `shared/shadow.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShadowView {
    /// The light, world, metres.
    pub position_m: Vec3,
    /// The map's axes and the direction of view, unit, world.
    pub axes: [Vec3; 3],
    /// Tangent of half the opening angle.
    pub tangent: f32,
    /// Near and far plane, metres.
    pub depth_m: [f32; 2],
    /// Size of a texel in the middle of the receivers, metres.
    pub texel_m: f32,
}

impl ShadowView {
    /// The view that an aim describes: it just holds the receivers and is as deep as the casters.
    #[must_use]
    pub fn new(aim: &GpuAim) -> Self {
        let position_m = aim.position_m.truncate();
        let to_middle = aim.receivers_m.truncate() - position_m;
        // A light inside the sphere looks at it with a wide angle instead of none.
        let distance = to_middle.length().max(1.05 * aim.receivers_m.w);
        let forward = to_middle.normalize_or(Vec3::NEG_Z);
        let [right, up] = basis(forward);
        let ratio = aim.receivers_m.w / distance;
        let tangent = ratio / (1.0 - ratio * ratio).sqrt();
        let middle = (aim.casters_m.truncate() - position_m).dot(forward);
        let near_m = (middle - aim.casters_m.w).max(0.02 * distance);
        let far_m = (middle + aim.casters_m.w).max(2.0 * near_m);
        Self {
            position_m,
            axes: [right, up, forward],
            tangent,
            depth_m: [near_m, far_m],
            texel_m: 2.0 * tangent * distance / aim.position_m.w,
        }
    }

    /// Normalised device coordinates of a world point: x, y in -1 ..= 1 inside the map, z in 0 ..= 1.
    #[must_use]
    pub fn project(&self, point_m: Vec3) -> Vec3 {
        let [x, y, z] = self.axes.map(|axis| axis.dot(point_m - self.position_m));
        let [near, far] = self.depth_m;
        Vec3::new(
            x / (self.tangent * z),
            y / (self.tangent * z),
            far * (z - near) / ((far - near) * z),
        )
    }
}

/// Two unit vectors that make a right-handed frame with `forward` (Duff et al. 2017, "Building an orthonormal basis,
/// revisited").
pub(crate) fn basis(forward: Vec3) -> [Vec3; 2] {
    let sign = if forward.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + forward.z);
    let b = forward.x * forward.y * a;
    [
        Vec3::new(1.0 + sign * forward.x * forward.x * a, sign * b, -sign * forward.x),
        Vec3::new(b, sign + forward.y * forward.y * a, -forward.y),
    ]
}

/// Smallest-ish sphere around spheres: centred on the middle of their bounding box. `None` without any.
#[must_use]
pub fn enclosing(spheres: &[Sphere]) -> Option<Sphere> {
    let low = spheres.iter().map(|s| s.center_m - s.radius_m).reduce(Vec3::min)?;
    let high = spheres.iter().map(|s| s.center_m + s.radius_m).reduce(Vec3::max)?;
    let center_m = 0.5 * (low + high);
    let radius_m = spheres
        .iter()
        .map(|s| s.center_m.distance(center_m) + s.radius_m)
        .fold(0.0, f32::max);
    Some(Sphere { center_m, radius_m })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn aim(light_m: Vec3, receivers: Sphere, casters: Sphere) -> GpuAim {
        GpuAim {
            position_m: light_m.extend(512.0),
            receivers_m: receivers.to_vec4(),
            casters_m: casters.to_vec4(),
        }
    }

    proptest! {
        #[test]
        fn the_receivers_fill_the_map(
            x in -1.0f32..1.0, y in -1.0f32..1.0, z in 0.3f32..2.0, dx in -1.0f32..1.0, dy in -1.0f32..1.0, dz in -1.0f32..1.0,
        ) {
            let receivers = Sphere { center_m: Vec3::new(0.1, 0.2, 0.0), radius_m: 0.2 };
            let casters = Sphere { center_m: Vec3::ZERO, radius_m: 0.5 };
            let view = ShadowView::new(&aim(receivers.center_m + Vec3::new(x, y, z), receivers, casters));
            let off = Vec3::new(dx, dy, dz);
            prop_assume!(off.length() > 0.01);
            let ndc = view.project(receivers.center_m + off.normalize() * receivers.radius_m);
            prop_assert!(ndc.x.abs() < 1.01 && ndc.y.abs() < 1.01, "{ndc}");
            prop_assert!(ndc.z > 0.0 && ndc.z < 1.0, "{ndc}");
            prop_assert!(view.texel_m > 2.0 * receivers.radius_m / 512.0 * 0.99);
        }
    }

    #[test]
    fn nearer_is_smaller_in_depth() {
        let sphere = Sphere {
            center_m: Vec3::ZERO,
            radius_m: 0.3,
        };
        let view = ShadowView::new(&aim(Vec3::Z, sphere, sphere));
        assert!(view.project(Vec3::new(0.0, 0.0, 0.1)).z < view.project(Vec3::ZERO).z);
    }

    #[test]
    fn an_enclosing_sphere_holds_all() {
        let spheres = [
            Sphere {
                center_m: Vec3::X,
                radius_m: 0.1,
            },
            Sphere {
                center_m: Vec3::NEG_X,
                radius_m: 0.3,
            },
        ];
        let all = enclosing(&spheres).unwrap();
        for s in spheres {
            assert!(s.center_m.distance(all.center_m) + s.radius_m <= all.radius_m + 1e-6);
        }
        assert_eq!(enclosing(&[]), None);
    }
}
