//! What one eye's rays find: reflections in virtual objects, what is seen through them, and how the real mirror ball shows
//! them.

use crate::camera_view::CameraView;
use crate::config::SpecularMethod;
use crate::eye::EyeInputs;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::timer::Timer;
use crate::passes::ball_mirror::BallMirror;
use crate::passes::lens_surface::LensSurface;
use crate::passes::ray_light::{GpuLightProbe, Inputs};
use crate::passes::real_radiance::RealRadiance;
use crate::passes::receive::Receive;
use crate::passes::reflect::Reflect;
use crate::passes::refract::Refract;
use crate::passes::virtual_surface::VirtualSurface;
use crate::scene_gpu::SceneBuffers;

/// The passes, in their order.
#[derive(Debug)]
pub struct Traced {
    surface: VirtualSurface,
    /// With `specular = "rays"`.
    reflect: Option<Reflect>,
    /// With glass in the scene.
    refract: Option<Refract>,
    ball: BallMirror,
    has_ball: bool,
    probe: wgpu::Buffer,
    /// Black, in place of what is not traced.
    nothing: wgpu::TextureView,
}

impl Traced {
    /// Passes for the virtual objects that `virtuals` shows, before the real things in `real`; `receive` has the ratios that
    /// the ball's pixels are written to.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        inputs: EyeInputs<'_>,
        virtuals: &LensSurface,
        (real, receive): (&RealRadiance, &Receive),
    ) -> Self {
        let view: &CameraView = inputs.view;
        let surface = VirtualSurface::new(gpu, (&view.camera, inputs.scene), view.size_px());
        let probe = gpu.buffer("traced: probe", &[<GpuLightProbe as bytemuck::Zeroable>::zeroed()]);
        let of_rays = Inputs {
            view,
            rays: inputs.rays,
            scene: inputs.scene,
            environments: inputs.environments,
            real: real.radiance(),
            memory: inputs.near.memory.remembered(),
            probe: &probe,
        };
        let reflect = (inputs.light.specular == SpecularMethod::Rays)
            .then(|| Reflect::new(gpu, of_rays, (virtuals.views(), &surface)));
        let refract = inputs
            .scene
            .has_glass
            .then(|| Refract::new(gpu, of_rays, (virtuals.views(), &surface)));
        let nothing = gpu.texture("traced: nothing", TextureShape::plain([1; 2]), RADIANCE_FORMAT);
        Self {
            surface,
            reflect,
            refract,
            ball: BallMirror::new(gpu, of_rays, receive.ratio()),
            has_ball: false,
            probe,
            nothing: nothing.create_view(&wgpu::TextureViewDescriptor::default()),
        }
    }

    /// Tells the rays where the light was measured.
    pub fn write(&mut self, gpu: &Gpu, probe: &GpuLightProbe) {
        self.has_ball = probe.ball_m.w > 0.0;
        gpu.write(&self.probe, &[*probe]);
    }

    /// What [`crate::passes::shade::ShadeTarget::traced`] takes.
    #[must_use]
    pub fn views(&self) -> [&wgpu::TextureView; 2] {
        [
            self.reflect.as_ref().map_or(&self.nothing, Reflect::radiance),
            self.refract.as_ref().map_or(&self.nothing, Refract::radiance),
        ]
    }

    /// Follows the rays.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder, timer: &mut Timer, scene: &SceneBuffers) {
        if self.has_ball {
            self.ball.record(encoder, timer);
        }
        if self.reflect.is_some() || self.refract.is_some() {
            self.surface.record(encoder, timer, scene);
        }
        if let Some(reflect) = &self.reflect {
            reflect.record(encoder, timer);
        }
        if let Some(refract) = &self.refract {
            refract.record(encoder, timer);
        }
    }
}
