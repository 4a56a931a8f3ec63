//! Blob shadows: a soft dark spot under every object, as games had them before there were others.
//!
//! The spot is the object's footprint made an ellipse: the box around the object in its own frame, taken as an ellipsoid,
//! seen along the way that the spot falls. It falls away from the light's middle, but never flatter than 45 degrees, so that it
//! stays at the object's foot; straight down for a light below the horizon. With the height of the object above the
//! receiver the spot grows wider and fades. Whatever lies lower than the object's middle and is turned upwards gets it; where
//! a thing stands between object and receiver the spot falls on both.

use bytemuck::{Pod, Zeroable};
use glam::{Mat2, Mat3, Vec2, Vec3, Vec4};

use super::casters::{Caster, Casters};
use super::key::{Job, KeyShadow};
use super::light::ShadowLight;
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::{Ends, Timer};
use crate::shadow::shadow_view::basis;

/// Objects with a spot at most.
pub const MAX_BLOBS: usize = 200;
/// Sine of the elevation below which no spot falls.
const LOWEST_SINE: f32 = std::f32::consts::FRAC_1_SQRT_2;
/// Radius of a spot's end, in footprints.
const REACH: f32 = 1.35;
/// Least half extent of a footprint, metres: a sheet on edge still has one.
const THINNEST_M: f32 = 0.002;

/// The method.
#[derive(Debug)]
pub struct BlobShadow {
    pipeline: wgpu::ComputePipeline,
}

/// All spots (`Blobs` in `shadow_blob.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuBlobs {
    /// x: number of spots.
    pub counts: [u32; 4],
    /// The spots.
    pub blobs: [GpuBlob; MAX_BLOBS],
}

/// One spot (`Blob` in `shadow_blob.wgsl`). World frame, metres.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuBlob {
    /// xyz: middle of the object; w: its index.
    pub center_m: Vec4,
    /// xyz: unit direction against which the spot falls; w: height of the object's lowest part.
    pub up: Vec4,
    /// xyz: from an offset to the first coordinate in the footprint's unit circle; w: 0.
    pub across_x: Vec4,
    /// xyz: the same for the second; w: 0.
    pub across_y: Vec4,
    /// x: height over which the spot fades; y: radius beyond which there is none, in footprints; z, w: 0.
    pub fade: Vec4,
}

impl BlobShadow {
    /// The method.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            pipeline: gpu.compute_pipeline("shadow_blob"),
        }
    }
}

impl KeyShadow for BlobShadow {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        let blobs = blobs(job.casters, job.light)?;
        let bindings = gpu.bind(
            "shadow_blob",
            &self.pipeline.get_bind_group_layout(0),
            &[
                gpu.buffer("shadow_blob: blobs", &[blobs]).as_entire_binding(),
                wgpu::BindingResource::TextureView(&job.surface.place),
                wgpu::BindingResource::TextureView(&job.surface.normal),
                wgpu::BindingResource::TextureView(job.visibility),
            ],
        );
        let span = timer.span("shadow_blob");
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("shadow_blob"),
            timestamp_writes: span.compute(Ends::Both),
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        let [width, height] = job.surface.view.size_px;
        pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
        Ok(())
    }
}

fn blobs(casters: &Casters, light: &ShadowLight) -> Result<GpuBlobs, RenderError> {
    let n = casters.objects.len();
    if n > MAX_BLOBS {
        return Err(RenderError::Shadow {
            method: "blob",
            message: format!("there are {n} objects that cast shadows, {MAX_BLOBS} are allowed"),
            hint: "join objects, or choose another method",
        });
    }
    let mut all = GpuBlobs::zeroed();
    let found = casters.objects.iter().filter_map(|caster| blob_of(caster, light));
    for (blob, found) in all.blobs.iter_mut().zip(found) {
        *blob = found;
        all.counts[0] += 1;
    }
    Ok(all)
}

/// The spot of an object; `None` for one without triangles.
fn blob_of(caster: &Caster, light: &ShadowLight) -> Option<GpuBlob> {
    let points = || caster.mesh.vertices.iter().map(|v| Vec3::from(v.position));
    let (low, high) = (points().reduce(Vec3::min)?, points().reduce(Vec3::max)?);
    let center_m = caster.world_from_object.transform_point3(0.5 * (low + high));
    let axes = Mat3::from(caster.world_from_object.matrix3) * Mat3::from_diagonal(0.5 * (high - low));
    let up = falls_against(light, center_m);
    let [right, forward] = basis(up);
    // The ellipsoid's outline seen along `up`: its shape matrix cut down to the two axes across.
    let shape = axes * axes.transpose();
    let along = |a: Vec3, b: Vec3| a.dot(shape * b);
    let least = THINNEST_M * THINNEST_M;
    let outline = Mat2::from_cols(
        Vec2::new(along(right, right) + least, along(right, forward)),
        Vec2::new(along(right, forward), along(forward, forward) + least),
    );
    // A factor of its inverse: |factor · offset| is 1 on the outline (Cholesky).
    let inverse = outline.inverse();
    let a = inverse.x_axis.x.sqrt();
    let b = inverse.x_axis.y / a;
    let c = (inverse.y_axis.y - b * b).max(0.0).sqrt();
    let half_height_m = axes.row(2).abs().element_sum();
    let footprint_m = outline.determinant().max(0.0).sqrt().sqrt();
    let finite = center_m.is_finite() && a.is_finite() && b.is_finite() && c.is_finite();
    finite.then(|| GpuBlob {
        center_m: center_m.extend(caster.index as f32),
        up: up.extend(center_m.z - half_height_m),
        across_x: (a * right + b * forward).extend(0.0),
        across_y: (c * forward).extend(0.0),
        fade: Vec4::new(2.0 * footprint_m.max(half_height_m), REACH, 0.0, 0.0),
    })
}

/// Unit direction from an object against which its spot falls.
fn falls_against(light: &ShadowLight, center_m: Vec3) -> Vec3 {
    let place = light.homogeneous();
    let towards = (place.truncate() - place.w * center_m).normalize_or(Vec3::Z);
    let flat = towards.truncate();
    if towards.z <= 0.0 {
        Vec3::Z
    } else if towards.z < LOWEST_SINE {
        (flat.normalize_or_zero() * (1.0 - LOWEST_SINE * LOWEST_SINE).sqrt()).extend(LOWEST_SINE)
    } else {
        towards
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spot_falls_away_from_the_light_but_never_flat() {
        let light = |towards: Vec3| ShadowLight::Directional {
            towards: towards.normalize(),
            irradiance: Vec3::ONE,
        };
        let steep = Vec3::new(0.2, 0.1, 1.0).normalize();
        assert!((falls_against(&light(steep), Vec3::ZERO) - steep).length() < 1e-6);
        let flat = falls_against(&light(Vec3::new(1.0, 0.0, 0.1)), Vec3::ZERO);
        assert!((flat - Vec3::new(1.0, 0.0, 1.0).normalize()).length() < 1e-6);
        assert_eq!(falls_against(&light(Vec3::new(1.0, 0.0, -0.1)), Vec3::ZERO), Vec3::Z);
    }
}
