//! Shaders without a GPU: every pass parses and validates, and what Rust and WGSL share has one layout.

use std::collections::BTreeMap;
use std::mem::offset_of;

use mirrorball_render::environments::SH_STRIDE_BYTES;
use mirrorball_render::gpu::shader::{PASSES, resolve};
use mirrorball_render::gpu::types::{
    GpuBlurLine, GpuCamera, GpuEnvironment, GpuFrame, GpuLobe, GpuMap, GpuMaterial, GpuNode, GpuNoise, GpuObject,
    GpuProbe, GpuTurn, MAX_ENVIRONMENTS,
};
use mirrorball_render::light_tree::LEVELS;
use mirrorball_render::near::far_lights::{GpuFarLight, GpuFarLights};
use mirrorball_render::passes::ENVIRONMENT_MIPS;
use mirrorball_render::passes::inset::GpuTile;
use mirrorball_render::passes::irradiance_cube::IRRADIANCE_SIZE;
use mirrorball_render::passes::lamp_light::{GpuLamp, GpuLamps};
use mirrorball_render::passes::protect::GpuCell;
use mirrorball_render::passes::ray_light::GpuLightProbe;
use mirrorball_render::passes::separable_blur::ITERATIONS;
use mirrorball_render::scene_rays::GpuInstance;
use mirrorball_render::shadow::attenuation::{GpuAttenuationFrame, GpuLightPlace};
use mirrorball_render::shadow::blob::{GpuBlob, GpuBlobs, MAX_BLOBS};
use mirrorball_render::shadow::dome::{GpuDomeFrame, GpuDomeLight, MAX_DOME_LIGHTS};
use mirrorball_render::shadow::light::GpuShadowLight;
use mirrorball_render::shadow::map_view::MapView;
use mirrorball_render::shadow::path::hierarchy::{GpuBvhNode, GpuBvhTriangle, MAX_DEPTH};
use mirrorball_render::shadow::path::irradiance::GpuIrradianceSettings;
use mirrorball_render::shadow::path::run::GpuPathSettings;
use mirrorball_render::shadow::path::scene::{GpuCorners, GpuPathMaterial};
use mirrorball_render::shadow::planar::GpuProjection;
use mirrorball_render::shadow::view::GpuView;
use mirrorball_render::shadow::wedges::{GpuWedgeFrame, GpuWedgeShape};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{ArraySize, Module, TypeInner};

fn source(name: &str) -> String {
    let (_, source) = PASSES
        .iter()
        .find(|(pass, _)| *pass == name)
        .unwrap_or_else(|| panic!("no pass `{name}`"));
    resolve(source)
}

fn module(name: &str) -> Module {
    let source = source(name);
    naga::front::wgsl::parse_str(&source).unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(&source)))
}

/// Offsets by name of member, and the size, of a WGSL struct.
fn layout(module: &Module, name: &str) -> (BTreeMap<String, u32>, u32) {
    let (_, found) = module
        .types
        .iter()
        .find(|(_, ty)| ty.name.as_deref() == Some(name))
        .expect("the struct is there");
    let TypeInner::Struct { members, span } = &found.inner else {
        panic!("`{name}` is no struct")
    };
    (
        members
            .iter()
            .map(|m| (m.name.clone().unwrap_or_default(), m.offset))
            .collect(),
        *span,
    )
}

/// Number of elements of a global's array and bytes from one to the next.
fn array(module: &Module, global: &str) -> (u32, u32) {
    let (_, variable) = module
        .global_variables
        .iter()
        .find(|(_, variable)| variable.name.as_deref() == Some(global))
        .unwrap_or_else(|| panic!("no global `{global}`"));
    let TypeInner::Array {
        size: ArraySize::Constant(length),
        stride,
        ..
    } = module.types[variable.ty].inner
    else {
        panic!("`{global}` is no array of fixed length")
    };
    (length.get(), stride)
}

/// Compares a WGSL struct of a pass with its Rust twin, every member by name and offset.
macro_rules! assert_same_layout {
    ($pass:expr, $wgsl:literal, $rust:ty { $($member:ident),* $(,)? }) => {{
        let (members, size) = layout(&module($pass), $wgsl);
        let rust: BTreeMap<String, u32> =
            [$((stringify!($member).to_owned(), offset_of!($rust, $member) as u32)),*].into();
        assert_eq!(members, rust, "members of `{}` in {}.wgsl and of {}", $wgsl, $pass, stringify!($rust));
        assert_eq!(size as usize, size_of::<$rust>(), "size of `{}` in {}.wgsl", $wgsl, $pass);
    }};
}

#[test]
fn every_pass_resolves_parses_and_validates() {
    for (name, _) in PASSES {
        assert!(!source(name).contains("#import"), "{name}: an import is not resolved");
        let checked = Validator::new(ValidationFlags::all(), Capabilities::default()).validate(&module(name));
        assert!(checked.is_ok(), "{name}: {:?}", checked.err());
    }
}

#[test]
fn every_shader_file_is_a_pass() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/shaders");
    let mut files: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_file())
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    files.sort();
    let mut passes: Vec<String> = PASSES.iter().map(|(name, _)| (*name).to_owned()).collect();
    passes.sort();
    assert_eq!(files, passes);
}

#[test]
fn shared_structs_have_one_layout() {
    assert_same_layout!(
        "radiance_map",
        "Camera",
        GpuCamera {
            camera_from_world,
            common_from_camera,
            camera_from_common,
            position_m,
            focal_and_principal_px,
            distortion,
            denominator,
            limits,
            signal_per_radiance,
            vignetting_and_depth,
        }
    );
    assert_same_layout!(
        "radiance_map",
        "Probe",
        GpuProbe {
            position_m,
            origin_m,
            reflectance,
            limits,
            ramps_px
        }
    );
    assert_same_layout!("receive", "Frame", GpuFrame { counts, ball_m });
    assert_same_layout!("inset", "Tile", GpuTile { place_px, parameters });
    assert_same_layout!(
        "receive",
        "Object",
        GpuObject {
            world_from_object,
            environment
        }
    );
    assert_same_layout!(
        "shade",
        "Material",
        GpuMaterial {
            base_color,
            dielectric,
            emission,
            attenuation,
            sheen,
            surface,
            coat,
            glass,
            kinds,
            maps
        }
    );
    assert_same_layout!("shade", "Map", GpuMap { matrix, place, facts });
    assert_same_layout!("receive", "Environment", GpuEnvironment { position_m, probe_m });
}

#[test]
fn structs_of_rays_have_one_layout() {
    assert_same_layout!(
        "reflect",
        "LightProbe",
        GpuLightProbe {
            position_m,
            ball_m,
            ball_reflectance
        }
    );
    assert_same_layout!(
        "reflect",
        "Instance",
        GpuInstance {
            world_from_object,
            object_from_world,
            sphere_m,
            facts
        }
    );
}

#[test]
fn structs_of_near_light_have_one_layout() {
    for pass in ["near_light", "near_change"] {
        assert_same_layout!(pass, "FarLight", GpuFarLight { position_m, intensity });
        assert_same_layout!(pass, "FarLights", GpuFarLights { position_m, lights });
    }
    let lights = format!("array<FarLight, {MAX_DOME_LIGHTS}>");
    assert!(
        source("near_light").contains(&lights),
        "far_lights.wgsl lacks `{lights}`"
    );
}

#[test]
fn views_of_shadow_maps_have_one_layout() {
    assert_same_layout!(
        "shadow_pcf",
        "MapView",
        MapView {
            position_m,
            right,
            up,
            forward,
            middle
        }
    );
}

#[test]
fn cells_of_the_protection_mask_have_one_layout() {
    for pass in ["protect_cells", "protect_vote", "protect_spread"] {
        assert_same_layout!(
            pass,
            "Cell",
            GpuCell {
                log_reflectance,
                share,
                place_m,
                normal
            }
        );
    }
}

#[test]
fn structs_of_domes_have_one_layout() {
    for pass in [
        "dome_maps",
        "dome_visibility",
        "dome_light_bright",
        "dome_light_pair",
        "key_light_pair",
    ] {
        assert_same_layout!(
            pass,
            "DomeLight",
            GpuDomeLight {
                position_m,
                intensity,
                right,
                up,
                forward,
                depth
            }
        );
        assert_same_layout!(
            pass,
            "Frame",
            GpuDomeFrame {
                counts,
                sizes,
                unshaded,
                bright
            }
        );
    }
    assert_same_layout!(
        "key_light_pair",
        "KeyLight",
        GpuShadowLight {
            position_m,
            u,
            v,
            power
        }
    );
    assert_same_layout!(
        "surface",
        "View",
        GpuView {
            clip_from_world,
            world_from_clip,
            eye_m,
            size_px
        }
    );
}

#[test]
fn structs_of_virtual_lamps_have_one_layout() {
    for pass in ["lamp_shares", "lamp_light", "shade"] {
        assert_same_layout!(
            pass,
            "Lamp",
            GpuLamp {
                position_m,
                direction,
                across,
                along,
                irradiance
            }
        );
        assert_same_layout!(pass, "Lamps", GpuLamps { counts, all });
    }
}

#[test]
fn structs_of_the_light_maps_have_one_layout() {
    assert_same_layout!("downsample", "Node", GpuNode { power, direction });
    for pass in ["prefilter_specular", "prefilter_phong", "irradiance_cube"] {
        assert_eq!(
            layout(&module(pass), "Node"),
            layout(&module("downsample"), "Node"),
            "{pass}"
        );
        assert_eq!(
            layout(&module(pass), "Lobe"),
            layout(&module("prefilter_specular"), "Lobe"),
            "{pass}"
        );
    }
    assert_same_layout!("prefilter_specular", "Lobe", GpuLobe { parameters });
    assert_same_layout!("cylindrical", "Turn", GpuTurn { axis, sweep });
}

#[test]
fn structs_of_the_cameras_look_have_one_layout() {
    assert_same_layout!("composite", "Noise", GpuNoise { shot, read, frame });
    assert_same_layout!("look_blur", "Line", GpuBlurLine { step, weights });
}

#[test]
fn structs_of_the_path_tracer_have_one_layout() {
    assert_same_layout!(
        "shadow_path",
        "Node",
        GpuBvhNode {
            low,
            link,
            high,
            unused
        }
    );
    assert_same_layout!("shadow_path", "Triangle", GpuBvhTriangle { a, b, c });
    assert_same_layout!("shadow_path", "Corners", GpuCorners { a, b, c });
    assert_same_layout!(
        "shadow_path",
        "PathMaterial",
        GpuPathMaterial {
            color,
            dielectric,
            parameters
        }
    );
    assert_same_layout!("shadow_path", "Settings", GpuPathSettings { counts, scene, choices });
    assert_same_layout!(
        "shadow_path_irradiance",
        "Settings",
        GpuIrradianceSettings { counts, roots, lengths }
    );
    let stack = format!("const STACK = {MAX_DEPTH};");
    assert!(source("shadow_path").contains(&stack), "bvh.wgsl lacks `{stack}`");
}

#[test]
fn constants_of_the_light_maps_are_those_of_the_passes() {
    let edge = format!("const SIZE: i32 = {IRRADIANCE_SIZE};");
    let iterations = format!("const ITERATIONS: i32 = {ITERATIONS};");
    let blur = source("separable_blur");
    assert!(
        blur.contains(&edge) && blur.contains(&iterations),
        "separable_blur.wgsl lacks `{edge}` or `{iterations}`"
    );
    let levels = format!("level < {LEVELS}u; level++");
    assert!(
        source("downsample").contains(&levels),
        "downsample.wgsl lacks `{levels}`"
    );
}

#[test]
fn arrays_are_as_long_as_the_constants_say() {
    for pass in ["receive", "shade"] {
        let module = module(pass);
        assert_eq!(
            array(&module, "environments"),
            (MAX_ENVIRONMENTS as u32, size_of::<GpuEnvironment>() as u32)
        );
        let (length, stride) = array(&module, "near_sh");
        assert_eq!(
            u64::from(length * stride),
            MAX_ENVIRONMENTS as u64 * SH_STRIDE_BYTES,
            "{pass}"
        );
    }
    for pass in [
        "dome_maps",
        "dome_visibility",
        "dome_refine",
        "dome_light",
        "dome_light_pair",
        "key_light_pair",
    ] {
        let expected = (MAX_DOME_LIGHTS as u32, size_of::<GpuDomeLight>() as u32);
        assert_eq!(array(&module(pass), "lights"), expected, "{pass}");
    }
    let (length, stride) = array(&module("shade"), "harmonics");
    assert_eq!(u64::from(length * stride), MAX_ENVIRONMENTS as u64 * SH_STRIDE_BYTES);
}

#[test]
fn harmonics_of_an_environment_start_where_the_irradiance_pass_writes_them() {
    let direct = source("shade");
    let per_slot = SH_STRIDE_BYTES / 16;
    assert!(
        direct.contains(&format!("near_sh[{per_slot}u * slot + i]")),
        "direct.wgsl counts another stride"
    );
    assert!(
        direct.contains(&format!("harmonics[{per_slot}u * slot + i]")),
        "shade.wgsl counts another stride"
    );
}

#[test]
fn the_last_specular_mip_is_the_roughest() {
    let line = format!("const LAST_SPECULAR_MIP: f32 = {}.0;", ENVIRONMENT_MIPS - 1);
    assert!(source("shade").contains(&line), "shade.wgsl lacks `{line}`");
}

#[test]
fn structs_of_blobs_and_planar_shadows_have_one_layout() {
    assert_same_layout!("shadow_blob", "Blobs", GpuBlobs { counts, blobs });
    assert_same_layout!(
        "shadow_blob",
        "Blob",
        GpuBlob {
            center_m,
            up,
            across_x,
            across_y,
            fade,
        }
    );
    assert!(source("shadow_blob").contains(&format!("array<Blob, {MAX_BLOBS}>")));
    assert_same_layout!("shadow_planar", "Projection", GpuProjection { plane, light });
}

#[test]
fn layouts_of_soft_shadow_volumes_and_attenuation_maps_agree() {
    assert_same_layout!(
        "shadow_wedges",
        "WedgeFrame",
        GpuWedgeFrame {
            light_from_world,
            eye_m,
            center_m,
            half_u_m,
            half_v_m,
            counts
        }
    );
    assert_same_layout!(
        "shadow_wedges",
        "WedgeShape",
        GpuWedgeShape {
            light_from_object,
            low,
            high,
            ranges
        }
    );
    assert_same_layout!(
        "shadow_attenuation",
        "AttenuationFrame",
        GpuAttenuationFrame {
            origin_m,
            right,
            up,
            forward,
            counts
        }
    );
    assert_same_layout!(
        "shadow_attenuation",
        "LightPlace",
        GpuLightPlace {
            position_m,
            clip_from_world,
            world_from_clip
        }
    );
}
