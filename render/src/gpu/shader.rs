//! WGSL sources: each pass's own file, with `#import name` lines replaced by `shaders/shared/name.wgsl`.

use std::borrow::Cow;

/// Sources that passes share, by the name they are imported with.
const SHARED: &[(&str, &str)] = &[
    ("brdf", include_str!("../../shaders/shared/brdf.wgsl")),
    ("camera", include_str!("../../shaders/shared/camera.wgsl")),
    ("cube", include_str!("../../shaders/shared/cube.wgsl")),
    ("direct", include_str!("../../shaders/shared/direct.wgsl")),
    ("dome", include_str!("../../shaders/shared/dome.wgsl")),
    ("dome_ray", include_str!("../../shaders/shared/dome_ray.wgsl")),
    ("key_light", include_str!("../../shaders/shared/key_light.wgsl")),
    ("light_tree", include_str!("../../shaders/shared/light_tree.wgsl")),
    ("lights", include_str!("../../shaders/shared/lights.wgsl")),
    ("lobe_sum", include_str!("../../shaders/shared/lobe_sum.wgsl")),
    ("picture", include_str!("../../shaders/shared/picture.wgsl")),
    ("sh", include_str!("../../shaders/shared/sh.wgsl")),
    ("shadow", include_str!("../../shaders/shared/shadow.wgsl")),
    ("view", include_str!("../../shaders/shared/view.wgsl")),
];

/// Sources of the passes, by the name of the pass.
pub const PASSES: &[(&str, &str)] = &[
    ("camera_depth", include_str!("../../shaders/camera_depth.wgsl")),
    ("composite", include_str!("../../shaders/composite.wgsl")),
    ("cylindrical", include_str!("../../shaders/cylindrical.wgsl")),
    ("downsample", include_str!("../../shaders/downsample.wgsl")),
    ("harmonics", include_str!("../../shaders/harmonics.wgsl")),
    ("highlight", include_str!("../../shaders/highlight.wgsl")),
    ("irradiance", include_str!("../../shaders/irradiance.wgsl")),
    ("irradiance_cube", include_str!("../../shaders/irradiance_cube.wgsl")),
    (
        "local_environment",
        include_str!("../../shaders/local_environment.wgsl"),
    ),
    ("present", include_str!("../../shaders/present.wgsl")),
    ("prefilter_phong", include_str!("../../shaders/prefilter_phong.wgsl")),
    (
        "prefilter_specular",
        include_str!("../../shaders/prefilter_specular.wgsl"),
    ),
    ("radiance_map", include_str!("../../shaders/radiance_map.wgsl")),
    ("receive", include_str!("../../shaders/receive.wgsl")),
    ("separable_blur", include_str!("../../shaders/separable_blur.wgsl")),
    ("shade", include_str!("../../shaders/shade.wgsl")),
    ("shadow_blob", include_str!("../../shaders/shadow_blob.wgsl")),
    ("shadow_map", include_str!("../../shaders/shadow_map.wgsl")),
    ("shadow_planar", include_str!("../../shaders/shadow_planar.wgsl")),
    ("shadow_stencil", include_str!("../../shaders/shadow_stencil.wgsl")),
    ("shadow_volume", include_str!("../../shaders/shadow_volume.wgsl")),
    ("sphere_map", include_str!("../../shaders/sphere_map.wgsl")),
    ("dome_filter", include_str!("../../shaders/dome_filter.wgsl")),
    ("dome_light", include_str!("../../shaders/dome_light.wgsl")),
    ("dome_maps", include_str!("../../shaders/dome_maps.wgsl")),
    ("dome_refine", include_str!("../../shaders/dome_refine.wgsl")),
    ("dome_visibility", include_str!("../../shaders/dome_visibility.wgsl")),
    ("surface", include_str!("../../shaders/surface.wgsl")),
    ("lab_shade", include_str!("../../shaders/lab_shade.wgsl")),
];

/// The complete WGSL of a pass; an unknown import stays in place and fails to compile, naming the line.
#[must_use]
pub fn resolve(source: &str) -> String {
    let mut out = String::with_capacity(source.len() + 4096);
    for line in source.lines() {
        match line
            .strip_prefix("#import ")
            .and_then(|name| SHARED.iter().find(|(known, _)| *known == name.trim()))
        {
            Some((_, shared)) => out.push_str(shared),
            None => out.push_str(line),
        }
        out.push('\n');
    }
    out
}

/// Compiles the shader of the pass `name`.
///
/// # Panics
/// Never for the names in [`PASSES`].
#[must_use]
pub fn module(device: &wgpu::Device, name: &'static str) -> wgpu::ShaderModule {
    let source = PASSES
        .iter()
        .find(|(known, _)| *known == name)
        .map_or("", |(_, source)| source);
    device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source: wgpu::ShaderSource::Wgsl(Cow::Owned(resolve(source))),
    })
}
