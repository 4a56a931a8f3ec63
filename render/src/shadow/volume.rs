//! Stencil shadow volumes: a pixel is in shadow when it lies inside the space behind some caster.
//!
//! Crow 1977, "Shadow algorithms for computer graphics": volumes of the outline's edges. Counting in the stencil along the
//! ray from the eye (z-pass: Heidmann 1991) or from infinity (z-fail: Everitt, Kilgard 2002, "Practical and robust stenciled
//! shadow volumes for hardware-accelerated rendering"): caps at both ends, the far one at infinity, where the view's far
//! plane is too; both sides of all polygons in one draw. Counts wrap, so that their order does not matter.
//!
//! Counting from the eye is right only while the eye's near rectangle is outside the volume. As in McGuire, Hughes, Egan,
//! Kilgard, Everitt 2003, "Fast, practical and robust shadows", each caster for which that is not sure is counted from
//! infinity instead, so both ways always give the same picture; a light between eye and near plane or inside an object is
//! nothing special then. An area light shines from its middle; the shadow is hard.
//!
//! Known limits: 256 volumes exactly around one pixel count as none. Shadows follow the faces, so on coarse meshes with
//! smooth shading the border between the lit and the dark side is jagged.

use glam::{Vec3, Vec4};

use super::key::{Job, KeyShadow};
use super::stencil::{CAP_BIAS, Count, Stencil};
use super::view::View;
use super::volume_mesh::{CAPS, CAPS_AROUND_EYE, VolumeMeshes, WALLS, WALLS_AROUND_EYE};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::timer::Timer;
use crate::shadow::shadow_view::Sphere;

/// From where the walls of volumes are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counting {
    /// From the eye to what is seen (z-pass), except for volumes that may hold the eye.
    InFront,
    /// From infinity to what is seen (z-fail).
    Behind,
}

/// The method.
#[derive(Debug)]
pub struct VolumeShadow {
    counting: Counting,
    stencil: Stencil,
    meshes: VolumeMeshes,
}

impl VolumeShadow {
    /// The method with one way of counting.
    #[must_use]
    pub fn new(gpu: &Gpu, counting: Counting) -> Self {
        use wgpu::StencilOperation::{DecrementWrap, IncrementWrap};
        let in_front = Count {
            front: Count::passing(IncrementWrap),
            back: Count::passing(DecrementWrap),
            cull: None,
            bias: wgpu::DepthBiasState::default(),
        };
        let behind = Count {
            front: Count::failing(DecrementWrap),
            back: Count::failing(IncrementWrap),
            ..in_front
        };
        let cap = |count: Count| Count {
            bias: CAP_BIAS,
            ..count
        };
        Self {
            counting,
            stencil: Stencil::new(gpu, &[in_front, cap(in_front), behind, cap(behind)]),
            meshes: VolumeMeshes::default(),
        }
    }
}

impl KeyShadow for VolumeShadow {
    fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut Timer,
        job: &Job<'_>,
    ) -> Result<(), RenderError> {
        let light = job.light.homogeneous();
        let draws = self
            .meshes
            .draws(gpu, job.casters, light, |caster| match self.counting {
                Counting::Behind => true,
                Counting::InFront => may_shade_near_plane(caster.bounds(), light, &job.surface.view),
            })?;
        let order = [(0, WALLS), (1, CAPS), (2, WALLS_AROUND_EYE), (3, CAPS_AROUND_EYE)];
        self.stencil.record_count(gpu, encoder, timer, (job, draws, &order));
        self.stencil.record_resolve(encoder, timer, job);
        Ok(())
    }
}

/// Whether a sphere may stand between a light (homogeneous) and the rectangle where the view begins.
///
/// All ways from the rectangle to the light lie within half its diagonal of the way from its middle.
fn may_shade_near_plane(caster: Sphere, light: Vec4, view: &View) -> bool {
    let middle = view.eye_m + view.near_m * view.forward();
    let half_diagonal_m = view.near_m * view.tangents[0].hypot(view.tangents[1]);
    let to_caster = caster.center_m - middle;
    let (way, most) = if light.w == 0.0 {
        (light.truncate(), f32::INFINITY)
    } else {
        (light.truncate() - middle, 1.0)
    };
    let share = (to_caster.dot(way) / way.length_squared().max(1e-30)).clamp(0.0, most);
    let nearest: Vec3 = share * way;
    to_caster.distance(nearest) <= caster.radius_m + half_diagonal_m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_caster_between_light_and_near_plane_may_shade_it() {
        let view = View::looking_at(Vec3::new(0.0, -1.0, 0.0), Vec3::ZERO, 1.0, [64, 64]);
        let caster = |x: f32, z: f32| Sphere {
            center_m: Vec3::new(x, -1.0, z),
            radius_m: 0.1,
        };
        let above = Vec4::new(0.0, -1.0, 2.0, 1.0);
        assert!(may_shade_near_plane(caster(0.0, 1.0), above, &view));
        assert!(may_shade_near_plane(caster(0.11, 1.0), above, &view));
        assert!(!may_shade_near_plane(caster(0.2, 1.0), above, &view));
        assert!(!may_shade_near_plane(caster(0.0, 2.2), above, &view));
        assert!(may_shade_near_plane(caster(0.0, 2.2), Vec4::Z, &view));
        assert!(!may_shade_near_plane(caster(0.0, -0.2), Vec4::Z, &view));
    }
}
