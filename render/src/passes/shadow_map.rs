//! Shadow maps: for every light one of the phantoms and one of the virtual objects.

use glam::{Mat4, Vec3, Vec4};

use crate::gpu::Gpu;
use crate::gpu::pass::{DEPTH_FORMAT, RasterState, TextureShape};
use crate::gpu::timer::{Ends, Timer};
use crate::scene_gpu::{IndexRange, SceneBuffers};

/// A sphere, world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Centre.
    pub center_m: Vec3,
    /// Radius.
    pub radius_m: f32,
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
    matrix: wgpu::Buffer,
    bindings: wgpu::BindGroup,
    drawn: Option<Mat4>,
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
            bias: wgpu::DepthBiasState { constant: 2, slope_scale: 2.0, clamp: 0.0 },
            cull: None,
        };
        Self { pipeline: gpu.render_pipeline("shadow_map", &state) }
    }

    /// Empty maps of `size` × `size` texels for `n_lights` lights.
    #[must_use]
    pub fn maps(&self, gpu: &Gpu, label: &'static str, scene: &SceneBuffers, [size, n_lights]: [u32; 2]) -> ShadowMaps {
        let texture = gpu.texture(label, TextureShape::layered([size; 2], n_lights), DEPTH_FORMAT);
        let layer = |index: u32| {
            let matrix = gpu.buffer(label, &[Mat4::IDENTITY]);
            let bindings = gpu.bind(
                label,
                &self.pipeline.get_bind_group_layout(0),
                &[matrix.as_entire_binding(), scene.objects.as_entire_binding()],
            );
            let view = texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer: index,
                array_layer_count: Some(1),
                ..wgpu::TextureViewDescriptor::default()
            });
            Layer { view, matrix, bindings, drawn: None }
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

    /// Draws `casters` for every light whose matrix (`None` for a dark light) changed; returns how many were drawn.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        work: (&mut ShadowMaps, &SceneBuffers, &IndexRange),
        clip_from_world: &[Option<Mat4>],
    ) -> usize {
        let (maps, scene, casters) = work;
        let changed: Vec<(usize, Mat4)> = clip_from_world
            .iter()
            .enumerate()
            .filter_map(|(i, matrix)| matrix.filter(|m| maps.layers[i].drawn != Some(*m)).map(|m| (i, m)))
            .collect();
        if changed.is_empty() {
            return 0;
        }
        let span = timer.span(maps.label);
        for (position, (index, matrix)) in changed.iter().enumerate() {
            let layer = &mut maps.layers[*index];
            gpu.write(&layer.matrix, &[*matrix]);
            layer.drawn = Some(*matrix);
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some(maps.label),
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &layer.view,
                    depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store: wgpu::StoreOp::Store }),
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

/// View of a light at `light_m` onto the `receivers`, as deep as all `casters`, and the size of a texel in metres in its
/// middle.
///
/// Depth runs 0 to 1 from the nearest caster to behind the farthest.
#[must_use]
pub fn clip_from_world(light_m: Vec3, receivers: Sphere, casters: Sphere, map_size: u32) -> (Mat4, f32) {
    let to_middle = receivers.center_m - light_m;
    // A light inside the sphere looks at it with a wide angle instead of none.
    let distance = to_middle.length().max(1.05 * receivers.radius_m);
    let forward = to_middle.normalize_or(Vec3::NEG_Z);
    let right = forward.any_orthonormal_vector();
    let up = right.cross(forward);
    let tangent = (receivers.radius_m / distance).asin().tan();
    let middle_of_casters = (casters.center_m - light_m).dot(forward);
    let near = (middle_of_casters - casters.radius_m).max(0.02 * distance);
    let far = (middle_of_casters + casters.radius_m).max(2.0 * near);
    let row = |axis: Vec3, scale: f32, offset: f32| (axis * scale).extend(offset - scale * axis.dot(light_m));
    let depth = far / (far - near);
    let rows = [
        row(right, 1.0 / tangent, 0.0),
        row(up, 1.0 / tangent, 0.0),
        row(forward, depth, -near * depth),
        row(forward, 1.0, 0.0),
    ];
    let matrix = Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose();
    (matrix, 2.0 * tangent * distance / map_size as f32)
}

/// Smallest-ish sphere around spheres: centred on the middle of their bounding box. `None` without any.
#[must_use]
pub fn enclosing(spheres: &[Sphere]) -> Option<Sphere> {
    let low = spheres.iter().map(|s| s.center_m - s.radius_m).reduce(Vec3::min)?;
    let high = spheres.iter().map(|s| s.center_m + s.radius_m).reduce(Vec3::max)?;
    let center_m = 0.5 * (low + high);
    let radius_m = spheres.iter().map(|s| s.center_m.distance(center_m) + s.radius_m).fold(0.0, f32::max);
    Some(Sphere { center_m, radius_m })
}

/// Normalised device coordinates of a world point, for tests and CPU twins.
#[must_use]
pub fn project(clip_from_world: &Mat4, point_m: Vec3) -> Vec3 {
    let clip: Vec4 = *clip_from_world * point_m.extend(1.0);
    clip.truncate() / clip.w
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_receivers_fill_the_map(
            x in -1.0f32..1.0, y in -1.0f32..1.0, z in 0.3f32..2.0, dx in -1.0f32..1.0, dy in -1.0f32..1.0, dz in -1.0f32..1.0,
        ) {
            let receivers = Sphere { center_m: Vec3::new(0.1, 0.2, 0.0), radius_m: 0.2 };
            let casters = Sphere { center_m: Vec3::ZERO, radius_m: 0.5 };
            let light = receivers.center_m + Vec3::new(x, y, z);
            let (matrix, texel_m) = clip_from_world(light, receivers, casters, 512);
            let off = Vec3::new(dx, dy, dz);
            prop_assume!(off.length() > 0.01);
            let ndc = project(&matrix, receivers.center_m + off.normalize() * receivers.radius_m);
            prop_assert!(ndc.x.abs() < 1.01 && ndc.y.abs() < 1.01, "{ndc}");
            prop_assert!(ndc.z > 0.0 && ndc.z < 1.0, "{ndc}");
            prop_assert!(texel_m > 2.0 * receivers.radius_m / 512.0 * 0.99);
        }
    }

    #[test]
    fn nearer_is_smaller_in_depth() {
        let sphere = Sphere { center_m: Vec3::ZERO, radius_m: 0.3 };
        let (matrix, _) = clip_from_world(Vec3::Z, sphere, sphere, 256);
        assert!(project(&matrix, Vec3::new(0.0, 0.0, 0.1)).z < project(&matrix, Vec3::ZERO).z);
    }

    #[test]
    fn an_enclosing_sphere_holds_all() {
        let spheres = [
            Sphere { center_m: Vec3::X, radius_m: 0.1 },
            Sphere { center_m: Vec3::NEG_X, radius_m: 0.3 },
        ];
        let all = enclosing(&spheres).unwrap();
        for s in spheres {
            assert!(s.center_m.distance(all.center_m) + s.radius_m <= all.radius_m + 1e-6);
        }
        assert_eq!(enclosing(&[]), None);
    }
}
