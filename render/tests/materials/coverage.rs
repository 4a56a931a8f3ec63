//! Holes, sides, half transparent things, normals and mips in pictures.

use std::sync::Arc;

use glam::{Vec3, Vec4, Vec4Swizzles};
use mirrorball_calib::probe::cube::Cube;
use mirrorball_render::config::DiffuseMethod;
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::timer::Timer;
use mirrorball_render::gpu::types::GpuCamera;
use mirrorball_render::passes::ENVIRONMENT_SIZE;
use mirrorball_render::passes::lens_surface::LensSurface;
use mirrorball_render::scene::material::{Alpha, Image, Model, NormalMap, Sides, Texture, Wrap};
use mirrorball_render::scene::{Kind, Material, Mesh, Scene};
use mirrorball_render::scene_gpu::SceneBuffers;

use crate::pictures::{SPHERE_M, pose, shaded};
use crate::support::{self, Errors};

/// A square that faces the eye, `off_m` nearer to it than the sphere's middle, with texture coordinates over it.
fn screen(off_m: f32, material: Material) -> Mesh {
    let to_eye = (pose().inverse().translation.as_vec3() - SPHERE_M.0).normalize();
    let across = Vec3::Z.cross(to_eye).normalize() * SPHERE_M.1;
    let mut mesh = support::square(SPHERE_M.0 + off_m * to_eye, across, to_eye.cross(across));
    for (vertex, uv) in mesh
        .vertices
        .iter_mut()
        .zip([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    {
        vertex.uv = uv;
    }
    mesh.materials = vec![material];
    mesh
}

fn unlit(color: [f32; 3], opacity: f32) -> Material {
    Material {
        model: Model::Unlit,
        base_color: color,
        opacity,
        ..Material::default()
    }
}

/// The radiance and coverage in the middle of the picture, and the share of the picture that is covered.
fn middle(gpu: Gpu, scene: &Scene) -> (Vec4, f32, Gpu) {
    let (pixels, gpu) = shaded(
        gpu,
        scene,
        DiffuseMethod::Sh9,
        &Cube::filled(ENVIRONMENT_SIZE, Vec3::ONE),
    );
    let camera = support::rig();
    let middle = camera.scene_camera().intrinsics.principal_point_px;
    let index = 320 * middle.y.round() as usize + middle.x.round() as usize;
    let covered = pixels.iter().map(|p| p.w).sum::<f32>() / pixels.len() as f32;
    (pixels[index], covered, gpu)
}

/// Radiance whose signal is full.
fn full_signal() -> f32 {
    let rig = support::rig();
    1.0 / rig.scene_camera().photometry.signal_per_radiance(&support::EXPOSURE)[1] as f32
}

#[test]
fn a_mask_cuts_holes_and_sides_count() {
    let Some(gpu) = support::gpu() else { return };
    // The left half is a hole.
    let mut image = Image {
        name: "mask".into(),
        size_px: [32, 32],
        rgba: vec![255; 4 * 32 * 32],
    };
    for (i, texel) in image.rgba.chunks_exact_mut(4).enumerate() {
        texel[3] = if i % 32 < 16 { 0 } else { 255 };
    }
    let mut texture = Texture::plain(Arc::new(image));
    texture.wrap = [Wrap::Clamp; 2];
    let masked = Material {
        base_color_texture: Some(texture),
        alpha: Alpha::Mask { cutoff: 0.5 },
        ..unlit([1.0; 3], 1.0)
    };
    let one = |mesh: Mesh| support::scene([("screen", Kind::Virtual, mesh)]);
    let (_, whole, gpu) = middle(gpu, &one(screen(0.0, unlit([1.0; 3], 1.0))));
    let (_, half, gpu) = middle(gpu, &one(screen(0.0, masked)));
    assert!((half / whole - 0.5).abs() < 0.02, "{half} of {whole}");
    let single = |sides| Material {
        sides,
        ..unlit([1.0; 3], 1.0)
    };
    let (_, front, gpu) = middle(gpu, &one(screen(0.0, single(Sides::Front))));
    assert!((front - whole).abs() < 1e-4, "{front} of {whole}");
    let turned = |sides| {
        let mut mesh = screen(0.0, single(sides));
        for triangle in mesh.indices.chunks_exact_mut(3) {
            triangle.swap(1, 2);
        }
        one(mesh)
    };
    let (_, back, gpu) = middle(gpu, &turned(Sides::Front));
    let (_, both, _) = middle(gpu, &turned(Sides::Both));
    assert!(back == 0.0 && (both - whole).abs() < 1e-4, "{back}, {both} of {whole}");
}

/// Light from afar is gathered for the normals that the map gives: those of the surface that shadows are cast on.
#[test]
fn surfaces_have_the_normals_of_their_maps() {
    let Some(gpu) = support::gpu() else { return };
    // Leaning by 45 degrees along the tangent.
    let lean = (127.5 + 127.5 * std::f32::consts::FRAC_1_SQRT_2).round() as u8;
    let image = Image {
        name: "lean".into(),
        size_px: [4, 4],
        rgba: [lean, 128, lean, 255].repeat(16),
    };
    let mut mesh = screen(
        0.0,
        Material {
            normal: Some(NormalMap {
                texture: Texture::plain(Arc::new(image)),
                scale: 1.0,
            }),
            ..Material::default()
        },
    );
    let along = (Vec3::from(mesh.vertices[1].position) - Vec3::from(mesh.vertices[0].position)).normalize();
    let normal = Vec3::from(mesh.vertices[0].normal);
    for vertex in &mut mesh.vertices {
        vertex.tangent = along.extend(1.0).to_array();
    }
    let scene = support::scene([("screen", Kind::Virtual, mesh)]);
    let rig = support::rig();
    let buffers = SceneBuffers::new(&gpu, &scene, &rig).expect("it fits");
    let camera = GpuCamera::new(rig.scene_camera(), &pose(), &support::EXPOSURE, [0.02, 20.0]);
    let camera = gpu.buffer("test: camera", &[camera]);
    let pass = LensSurface::new(&gpu, "test", (&camera, &buffers), [320, 240]);
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    pass.record(&mut encoder, &mut Timer::new(&gpu), (&buffers, &buffers.virtuals));
    gpu.queue.submit([encoder.finish()]);
    let normals: Vec<[half::f16; 4]> = support::read_layer(&gpu, pass.views().normal.texture(), 0, 0);
    let expected = (along + normal).normalize();
    let found = normals.iter().map(|n| Vec4::from_array(n.map(half::f16::to_f32)).xyz());
    let errors = Errors::of(
        "leaning normals, radians",
        found.filter(|n| *n != Vec3::ZERO).map(|n| n.angle_between(expected)),
    );
    assert!(errors.n > 1000 && errors.worst < 0.01, "{errors:?}");
}

/// Panes are drawn over what is behind them, the farthest first, whatever their order in the file.
#[test]
fn half_transparent_things_cover_each_other_in_their_order() {
    let Some(mut gpu) = support::gpu() else { return };
    let pane = |color, off_m| {
        let blended = Material {
            alpha: Alpha::Blend,
            ..unlit(color, 0.5)
        };
        screen(off_m, blended)
    };
    let (red, green) = (|| pane([1.0, 0.0, 0.0], 0.02), || pane([0.0, 1.0, 0.0], 0.04));
    let wall = || screen(0.0, unlit([0.0, 0.0, 1.0], 1.0));
    let expected = Vec3::new(0.25, 0.5, 0.25) * full_signal();
    let orders = [
        [("red", red()), ("green", green()), ("wall", wall())],
        [("green", green()), ("wall", wall()), ("red", red())],
    ];
    for order in orders {
        let scene = support::scene(order.map(|(name, mesh)| (name, Kind::Virtual, mesh)));
        let (found, _, used) = middle(gpu, &scene);
        gpu = used;
        assert!(
            (found.xyz() - expected).abs().max_element() < 0.01 * full_signal(),
            "{found}, not {expected}"
        );
        assert!((found.w - 1.0).abs() < 1e-3, "{found}");
    }
    let lonely = support::scene([("red", Kind::Virtual, red())]);
    let (found, _, _) = middle(gpu, &lonely);
    assert!((found.w - 0.5).abs() < 1e-3, "{found}");
}

/// A picture far away is the mean of its texels, not some of them.
#[test]
fn small_pictures_are_averaged() {
    let Some(gpu) = support::gpu() else { return };
    let edge = 1024u32;
    let mut image = Image {
        name: "stripes".into(),
        size_px: [edge; 2],
        rgba: vec![255; 4 * (edge * edge) as usize],
    };
    for (i, texel) in image.rgba.chunks_exact_mut(4).enumerate() {
        if i % 2 == 0 {
            texel[..3].fill(0);
        }
    }
    let striped = Material {
        base_color_texture: Some(Texture::plain(Arc::new(image))),
        ..unlit([1.0; 3], 1.0)
    };
    let scene = support::scene([("screen", Kind::Virtual, screen(0.0, striped))]);
    let (pixels, _) = shaded(
        gpu,
        &scene,
        DiffuseMethod::Sh9,
        &Cube::filled(ENVIRONMENT_SIZE, Vec3::ONE),
    );
    let inside = pixels.iter().filter(|p| p.w == 1.0);
    let errors = Errors::of("stripes", inside.map(|p| p.x / full_signal() - 0.5));
    assert!(errors.n > 1000 && errors.worst < 0.02, "{errors:?}");
}
