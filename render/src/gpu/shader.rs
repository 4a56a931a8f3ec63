//! WGSL sources: each pass's own file, with `#import name` lines replaced by `shaders/shared/name.wgsl`.

use std::borrow::Cow;

/// Sources that passes share, by the name they are imported with.
const SHARED: &[(&str, &str)] = &[
    ("attenuation", include_str!("../../shaders/shared/attenuation.wgsl")),
    ("brdf", include_str!("../../shaders/shared/brdf.wgsl")),
    ("bvh", include_str!("../../shaders/shared/bvh.wgsl")),
    ("camera", include_str!("../../shaders/shared/camera.wgsl")),
    ("cube", include_str!("../../shaders/shared/cube.wgsl")),
    ("direct", include_str!("../../shaders/shared/direct.wgsl")),
    (
        "environment_map",
        include_str!("../../shaders/shared/environment_map.wgsl"),
    ),
    ("dome", include_str!("../../shaders/shared/dome.wgsl")),
    ("dome_bright", include_str!("../../shaders/shared/dome_bright.wgsl")),
    ("dome_ray", include_str!("../../shaders/shared/dome_ray.wgsl")),
    ("far_lights", include_str!("../../shaders/shared/far_lights.wgsl")),
    ("real_memory", include_str!("../../shaders/shared/real_memory.wgsl")),
    ("scene_vertex", include_str!("../../shaders/shared/scene_vertex.wgsl")),
    ("near_path", include_str!("../../shaders/shared/near_path.wgsl")),
    ("near_scene", include_str!("../../shaders/shared/near_scene.wgsl")),
    ("key_light", include_str!("../../shaders/shared/key_light.wgsl")),
    ("lamp", include_str!("../../shaders/shared/lamp.wgsl")),
    ("lamp_ray", include_str!("../../shaders/shared/lamp_ray.wgsl")),
    ("lamp_shine", include_str!("../../shaders/shared/lamp_shine.wgsl")),
    ("light_places", include_str!("../../shaders/shared/light_places.wgsl")),
    ("light_tree", include_str!("../../shaders/shared/light_tree.wgsl")),
    ("lights", include_str!("../../shaders/shared/lights.wgsl")),
    ("lobe_sum", include_str!("../../shaders/shared/lobe_sum.wgsl")),
    ("path_material", include_str!("../../shaders/shared/path_material.wgsl")),
    ("material", include_str!("../../shaders/shared/material.wgsl")),
    ("microfacets", include_str!("../../shaders/shared/microfacets.wgsl")),
    ("map_view", include_str!("../../shaders/shared/map_view.wgsl")),
    ("noise", include_str!("../../shaders/shared/noise.wgsl")),
    ("picture", include_str!("../../shaders/shared/picture.wgsl")),
    ("response", include_str!("../../shaders/shared/response.wgsl")),
    ("pixel_spots", include_str!("../../shaders/shared/pixel_spots.wgsl")),
    ("ray_light", include_str!("../../shaders/shared/ray_light.wgsl")),
    ("sampling", include_str!("../../shaders/shared/sampling.wgsl")),
    ("protect", include_str!("../../shaders/shared/protect.wgsl")),
    ("protect_pixel", include_str!("../../shaders/shared/protect_pixel.wgsl")),
    ("hit_substance", include_str!("../../shaders/shared/hit_substance.wgsl")),
    ("virtual_hit", include_str!("../../shaders/shared/virtual_hit.wgsl")),
    ("scene_ray", include_str!("../../shaders/shared/scene_ray.wgsl")),
    ("seen", include_str!("../../shaders/shared/seen.wgsl")),
    ("sh", include_str!("../../shaders/shared/sh.wgsl")),
    ("srgb", include_str!("../../shaders/shared/srgb.wgsl")),
    (
        "substance_light",
        include_str!("../../shaders/shared/substance_light.wgsl"),
    ),
    ("view", include_str!("../../shaders/shared/view.wgsl")),
    ("wedge", include_str!("../../shaders/shared/wedge.wgsl")),
];

/// Sources of the passes, by the name of the pass.
pub const PASSES: &[(&str, &str)] = &[
    ("camera_depth", include_str!("../../shaders/camera_depth.wgsl")),
    ("composite", include_str!("../../shaders/composite.wgsl")),
    ("cylindrical", include_str!("../../shaders/cylindrical.wgsl")),
    ("display", include_str!("../../shaders/display.wgsl")),
    ("downsample", include_str!("../../shaders/downsample.wgsl")),
    ("harmonics", include_str!("../../shaders/harmonics.wgsl")),
    ("highlight", include_str!("../../shaders/highlight.wgsl")),
    ("inset", include_str!("../../shaders/inset.wgsl")),
    ("irradiance", include_str!("../../shaders/irradiance.wgsl")),
    ("irradiance_cube", include_str!("../../shaders/irradiance_cube.wgsl")),
    ("key_light_pair", include_str!("../../shaders/key_light_pair.wgsl")),
    ("path_light_pair", include_str!("../../shaders/path_light_pair.wgsl")),
    ("lamp_light", include_str!("../../shaders/lamp_light.wgsl")),
    ("lamp_receive", include_str!("../../shaders/lamp_receive.wgsl")),
    ("lamp_shares", include_str!("../../shaders/lamp_shares.wgsl")),
    ("lens_surface", include_str!("../../shaders/lens_surface.wgsl")),
    ("look_blur", include_str!("../../shaders/look_blur.wgsl")),
    (
        "local_environment",
        include_str!("../../shaders/local_environment.wgsl"),
    ),
    ("memory_mean", include_str!("../../shaders/memory_mean.wgsl")),
    ("memory_observe", include_str!("../../shaders/memory_observe.wgsl")),
    ("memory_resolve", include_str!("../../shaders/memory_resolve.wgsl")),
    ("near_change", include_str!("../../shaders/near_change.wgsl")),
    ("near_filter", include_str!("../../shaders/near_filter.wgsl")),
    ("near_light", include_str!("../../shaders/near_light.wgsl")),
    ("present", include_str!("../../shaders/present.wgsl")),
    ("phantom_edge", include_str!("../../shaders/phantom_edge.wgsl")),
    ("prefilter_phong", include_str!("../../shaders/prefilter_phong.wgsl")),
    (
        "prefilter_specular",
        include_str!("../../shaders/prefilter_specular.wgsl"),
    ),
    ("radiance_map", include_str!("../../shaders/radiance_map.wgsl")),
    ("halve", include_str!("../../shaders/halve.wgsl")),
    ("protect_cells", include_str!("../../shaders/protect_cells.wgsl")),
    ("protect_spread", include_str!("../../shaders/protect_spread.wgsl")),
    ("protect_vote", include_str!("../../shaders/protect_vote.wgsl")),
    ("real_radiance", include_str!("../../shaders/real_radiance.wgsl")),
    ("ball_mirror", include_str!("../../shaders/ball_mirror.wgsl")),
    ("refract", include_str!("../../shaders/refract.wgsl")),
    ("reflect", include_str!("../../shaders/reflect.wgsl")),
    ("reflect_filter", include_str!("../../shaders/reflect_filter.wgsl")),
    ("room_mips", include_str!("../../shaders/room_mips.wgsl")),
    ("virtual_surface", include_str!("../../shaders/virtual_surface.wgsl")),
    ("receive", include_str!("../../shaders/receive.wgsl")),
    ("reproject", include_str!("../../shaders/reproject.wgsl")),
    ("separable_blur", include_str!("../../shaders/separable_blur.wgsl")),
    ("shade", include_str!("../../shaders/shade.wgsl")),
    ("shadow_blob", include_str!("../../shaders/shadow_blob.wgsl")),
    ("shadow_path", include_str!("../../shaders/shadow_path.wgsl")),
    (
        "shadow_path_irradiance",
        include_str!("../../shaders/shadow_path_irradiance.wgsl"),
    ),
    ("shadow_planar", include_str!("../../shaders/shadow_planar.wgsl")),
    ("shadow_stencil", include_str!("../../shaders/shadow_stencil.wgsl")),
    ("shadow_volume", include_str!("../../shaders/shadow_volume.wgsl")),
    ("sphere_map", include_str!("../../shaders/sphere_map.wgsl")),
    ("dome_filter", include_str!("../../shaders/dome_filter.wgsl")),
    ("dome_light", include_str!("../../shaders/dome_light.wgsl")),
    (
        "dome_light_bright",
        include_str!("../../shaders/dome_light_bright.wgsl"),
    ),
    ("dome_light_pair", include_str!("../../shaders/dome_light_pair.wgsl")),
    ("dome_maps", include_str!("../../shaders/dome_maps.wgsl")),
    ("dome_refine", include_str!("../../shaders/dome_refine.wgsl")),
    ("dome_visibility", include_str!("../../shaders/dome_visibility.wgsl")),
    (
        "shadow_attenuation",
        include_str!("../../shaders/shadow_attenuation.wgsl"),
    ),
    (
        "shadow_attenuation_count",
        include_str!("../../shaders/shadow_attenuation_count.wgsl"),
    ),
    (
        "shadow_attenuation_depth",
        include_str!("../../shaders/shadow_attenuation_depth.wgsl"),
    ),
    (
        "shadow_attenuation_warp",
        include_str!("../../shaders/shadow_attenuation_warp.wgsl"),
    ),
    (
        "shadow_wedge_corners",
        include_str!("../../shaders/shadow_wedge_corners.wgsl"),
    ),
    ("shadow_wedges", include_str!("../../shaders/shadow_wedges.wgsl")),
    ("surroundings", include_str!("../../shaders/surroundings.wgsl")),
    ("surface", include_str!("../../shaders/surface.wgsl")),
    ("shadow_area", include_str!("../../shaders/shadow_area.wgsl")),
    ("shadow_depth", include_str!("../../shaders/shadow_depth.wgsl")),
    ("shadow_nearest", include_str!("../../shaders/shadow_nearest.wgsl")),
    ("shadow_pcf", include_str!("../../shaders/shadow_pcf.wgsl")),
    ("shadow_pcss", include_str!("../../shaders/shadow_pcss.wgsl")),
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
