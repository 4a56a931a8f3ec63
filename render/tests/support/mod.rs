//! What the tests of the passes share: a device, a small rig, meshes, pictures of analytic light, results read back.
#![allow(dead_code, reason = "each test program uses its part of this")]

pub(crate) mod maps;
pub(crate) mod stage;

use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DMat3, DVec2, DVec3, Vec3, Vec4};
use half::f16;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::probe::cube::{Cube, FACES};
use mirrorball_calib::rig::{Camera, Rig};
use mirrorball_capture::frame::{Exposure, Frame, FrameMeta, PixelFormat, Size};
use mirrorball_render::gpu::Gpu;
use mirrorball_render::gpu::readback::Readback;
use mirrorball_render::scene::occluders::Occluders;
use mirrorball_render::scene::{Kind, Material, Mesh, Movement, Object, Placement, Scene, Vertex};
use mirrorball_render::shadow::view::View;

/// Exposure of every picture: signal 0.2 per unit of radiance with the rig's sensitivity.
pub(crate) const EXPOSURE: Exposure = Exposure {
    time_s: 0.005,
    gain: 1.0,
    white_balance: [1.0, 1.0, 1.0],
};

/// Tests that found no adapter.
static SKIPPED: AtomicU32 = AtomicU32::new(0);

/// The GPU, or a line and a count when there is none; with `MIRRORBALL_REQUIRE_GPU=1` that is a failure.
pub(crate) fn gpu() -> Option<Gpu> {
    match Gpu::open() {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let is_required = std::env::var("MIRRORBALL_REQUIRE_GPU").is_ok_and(|value| value == "1");
            assert!(
                !is_required,
                "MIRRORBALL_REQUIRE_GPU=1, but there is no adapter: {error}"
            );
            let n = SKIPPED.fetch_add(1, Ordering::Relaxed) + 1;
            // Past the test runner, which keeps what `println!` says.
            let _ = writeln!(std::io::stderr(), "SKIPPED: no adapter ({n} so far)");
            None
        }
    }
}

/// A scene camera, a fisheye that looks up beside the markers, two markers.
pub(crate) fn rig() -> Rig {
    Rig::from_toml(include_str!("rig.toml"), Path::new("rig.toml")).expect("the rig of the tests is valid")
}

/// Focal length of [`pinhole_rig`], pixels; its principal point is the middle of the picture.
pub(crate) const PINHOLE_FOCAL_PX: f64 = 322.0;

/// The same rig with a pinhole and without vignetting or colours of its own, as the path tracer's camera.
pub(crate) fn pinhole_rig() -> Rig {
    let quirks = [
        ("focal_px = [322.0, 321.0]", "focal_px = [322.0, 322.0]"),
        (
            "principal_point_px = [161.3, 118.6]",
            "principal_point_px = [159.5, 119.5]",
        ),
        (
            "distortion = [-0.05, 0.02, -0.0004, 0.0003, 0.0]",
            "distortion = [0.0, 0.0, 0.0, 0.0, 0.0]",
        ),
        ("vignetting = [-0.1, 0.0]", "vignetting = [0.0, 0.0]"),
        ("color = [[1.1, -0.1, 0.0], [0.0, 1.0, 0.0], [0.05, 0.0, 0.95]]\n", ""),
    ];
    let text = quirks
        .iter()
        .fold(include_str!("rig.toml").to_owned(), |text, (from, to)| {
            assert!(text.contains(from), "rig.toml lacks `{from}`");
            text.replacen(from, to, 1)
        });
    Rig::from_toml(&text, Path::new("rig.toml")).expect("the rig of the tests is valid")
}

/// The pinhole rig's camera at `from_m`, looking at `at_m`, as the path tracer takes it.
pub(crate) fn pinhole_view(from_m: DVec3, at_m: DVec3) -> View {
    let height_rad = 2.0 * (120.0 / PINHOLE_FOCAL_PX as f32).atan();
    View::looking_at(from_m.as_vec3(), at_m.as_vec3(), height_rad, [320, 240])
}

/// Pose of a camera at `from` that looks at `target`.
pub(crate) fn looking_at(target: DVec3, from: DVec3) -> Pose {
    let forward = (target - from).normalize();
    let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Pose {
        rotation,
        translation: -(rotation * from),
    }
}

/// A frame of `camera` that shows `radiance` (the rig's common RGB) along each ray of the camera's own frame: the mean
/// over `samples`² rays per pixel.
pub(crate) fn frame(camera: &Camera, sequence: u64, samples: u32, radiance: impl Fn(DVec3) -> DVec3) -> Frame {
    let [width, height] = camera.intrinsics.size_px;
    let photometry = &camera.photometry;
    let camera_from_common = photometry.color.inverse();
    let mut pixels = Vec::with_capacity(3 * (width * height) as usize);
    for index in 0..width * height {
        let middle = DVec2::new(f64::from(index % width), f64::from(index / width));
        let mut light = DVec3::ZERO;
        for i in 0..samples * samples {
            let offset = (DVec2::new(f64::from(i % samples), f64::from(i / samples)) + 0.5) / f64::from(samples) - 0.5;
            light += camera
                .intrinsics
                .unproject(middle + offset)
                .map_or(DVec3::ZERO, &radiance);
        }
        let signal = DVec3::from_array(photometry.signal_per_radiance(&EXPOSURE))
            * photometry.vignetting_at(middle, camera.intrinsics.size_px);
        let y = camera_from_common * light * signal / f64::from(samples * samples);
        pixels.extend(y.to_array().map(|y| photometry.response.encode(y)));
    }
    frame_of(camera, sequence, pixels)
}

/// A frame of `camera` with the given codes.
pub(crate) fn frame_of(camera: &Camera, sequence: u64, pixels: Vec<u8>) -> Frame {
    let [width, height] = camera.intrinsics.size_px;
    Frame {
        meta: FrameMeta::new(
            Arc::from(camera.name.as_str()),
            sequence,
            40_000_000 * sequence,
            EXPOSURE,
        ),
        size: Size { width, height },
        format: PixelFormat::Rgb8,
        pixels: pixels.into(),
    }
}

/// Reflectance of the plane z = 0: the rig's upright markers (white 0.8, black 0.03) on ground of 0.4.
pub(crate) fn ground_reflectance(rig: &Rig, point_m: DVec3) -> f64 {
    /// Ids 0 and 1 as AprilRobotics print them, white border included (apriltag-imgs, tag36h11).
    const BITMAPS: [[&str; 10]; 2] = [
        [
            "..........",
            ".########.",
            ".#..#.#.#.",
            ".##...#.#.",
            ".##..####.",
            ".#.#.####.",
            ".##.#..##.",
            ".####.###.",
            ".########.",
            "..........",
        ],
        [
            "..........",
            ".########.",
            ".#..#..##.",
            ".##.#...#.",
            ".#....###.",
            ".##..####.",
            ".#.#..#.#.",
            ".###.##.#.",
            ".########.",
            "..........",
        ],
    ];
    for marker in &rig.markers {
        let on_marker = marker.world_from_marker.inverse().transform_point(point_m).truncate();
        let cell = on_marker / (marker.side_m / 8.0) + 5.0;
        if cell.cmpge(DVec2::ZERO).all() && cell.cmplt(DVec2::splat(10.0)).all() {
            let row = BITMAPS[marker.id as usize][9 - cell.y as usize];
            return if row.as_bytes()[cell.x as usize] == b'.' {
                0.8
            } else {
                0.03
            };
        }
    }
    0.4
}

/// A material without any reflection but the diffuse one.
pub(crate) fn diffuse(albedo: f32) -> Material {
    Material {
        base_color: [albedo; 3],
        ..Material::default()
    }
}

/// A smooth mirror that reflects everything.
pub(crate) fn mirror() -> Material {
    Material {
        base_color: [1.0; 3],
        metallic: 1.0,
        roughness: 0.0,
        ..diffuse(1.0)
    }
}

/// A sphere of `2 * rings` by `rings` patches.
pub(crate) fn sphere(center_m: Vec3, radius_m: f32, rings: u32, material: Material) -> Mesh {
    let columns = 2 * rings;
    let mut mesh = Mesh {
        materials: vec![material],
        ..Mesh::default()
    };
    for row in 0..=rings {
        for column in 0..=columns {
            let polar = std::f32::consts::PI * row as f32 / rings as f32;
            let azimuth = std::f32::consts::TAU * column as f32 / columns as f32;
            let normal = Vec3::new(polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos());
            mesh.vertices.push(vertex(center_m + normal * radius_m, normal));
        }
    }
    for row in 0..rings {
        for column in 0..columns {
            let a = row * (columns + 1) + column;
            let b = a + columns + 1;
            mesh.indices.extend([a, b, b + 1, a, b + 1, a + 1]);
        }
    }
    mesh
}

/// A parallelogram around `center_m`, `2 * across` by `2 * along`.
pub(crate) fn square(center_m: Vec3, across: Vec3, along: Vec3) -> Mesh {
    let normal = across.cross(along).normalize();
    let corner = |x: f32, y: f32| vertex(center_m + across * x + along * y, normal);
    Mesh {
        vertices: vec![
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ],
        indices: vec![0, 1, 2, 0, 2, 3],
        materials: vec![diffuse(0.4)],
    }
}

fn vertex(position: Vec3, normal: Vec3) -> Vertex {
    Vertex {
        position: position.to_array(),
        object: 0,
        normal: normal.to_array(),
        material: 0,
        ..Vertex::PLAIN
    }
}

/// A scene of meshes that are already where they belong.
pub(crate) fn scene(objects: impl IntoIterator<Item = (&'static str, Kind, Mesh)>) -> Scene {
    let object = |(name, kind, mesh): (&str, Kind, Mesh)| Object {
        file: std::path::PathBuf::new(),
        name: name.to_owned(),
        kind,
        placement: Placement::World(Pose::identity()),
        movement: Movement::default(),
        mesh,
    };
    Scene {
        objects: objects.into_iter().map(object).collect(),
        lamps: Vec::new(),
    }
}

/// The triangles of all objects of one kind.
pub(crate) fn occluders(scene: &Scene, kind: Kind) -> Occluders {
    let triangles = |mesh: &Mesh| -> Vec<[Vec3; 3]> {
        let corner = |i: u32| Vec3::from(mesh.vertices[i as usize].position);
        mesh.indices
            .chunks_exact(3)
            .map(|t| [corner(t[0]), corner(t[1]), corner(t[2])])
            .collect()
    };
    Occluders::new(
        scene
            .objects
            .iter()
            .filter(|o| o.kind == kind)
            .flat_map(|o| triangles(&o.mesh)),
    )
}

/// A cube whose texels are `f` of their directions.
pub(crate) fn cube_of<T: Copy + Default>(size: u32, f: impl Fn(Vec3) -> T) -> Cube<T> {
    let mut cube = Cube::filled(size, T::default());
    for index in 0..cube.texels().len() {
        let value = f(cube.direction(index));
        cube.texels_mut()[index] = value;
    }
    cube
}

/// Half floats of texels.
pub(crate) fn halves(texels: impl IntoIterator<Item = Vec4>) -> Vec<[f16; 4]> {
    texels.into_iter().map(|t| t.to_array().map(f16::from_f32)).collect()
}

/// Writes layers of an rgba16f texture's first mip, from the first layer on.
pub(crate) fn write_texture(gpu: &Gpu, texture: &wgpu::Texture, texels: &[[f16; 4]]) {
    let wgpu::Extent3d { width, height, .. } = texture.size();
    let layers = texels.len() as u32 / (width * height);
    gpu.queue.write_texture(
        texture.as_image_copy(),
        bytemuck::cast_slice(texels),
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(8 * width),
            rows_per_image: Some(height),
        },
        wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: layers,
        },
    );
}

/// The texels of one layer of one mip.
pub(crate) fn read_layer<T: bytemuck::Pod>(gpu: &Gpu, texture: &wgpu::Texture, mip: u32, layer: u32) -> Vec<T> {
    let [width, height] = [texture.width() >> mip, texture.height() >> mip];
    let row = width * size_of::<T>() as u32;
    let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let readback = Readback::new(gpu, "test: texels", u64::from(padded * height));
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        wgpu::TexelCopyTextureInfo {
            mip_level: mip,
            origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
            ..texture.as_image_copy()
        },
        wgpu::TexelCopyBufferInfo {
            buffer: readback.buffer(),
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(padded),
                rows_per_image: Some(height),
            },
        },
        wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
    );
    readback.record(&mut encoder);
    gpu.queue.submit([encoder.finish()]);
    let mut bytes = vec![0u8; (padded * height) as usize];
    readback.read(gpu, &mut bytes).expect("the device works");
    bytes
        .chunks_exact(padded as usize)
        .flat_map(|r| bytemuck::pod_collect_to_vec(&r[..row as usize]))
        .collect()
}

/// One mip of the first cube of an rgba16f texture.
pub(crate) fn read_cube(gpu: &Gpu, texture: &wgpu::Texture, mip: u32) -> Cube<Vec4> {
    let texels = (0..FACES as u32)
        .flat_map(|face| read_layer::<[f16; 4]>(gpu, texture, mip, face))
        .map(|t| Vec4::from_array(t.map(f16::to_f32)))
        .collect();
    Cube::from_texels(texture.width() >> mip, texels).expect("six faces")
}

/// Runs a compute shader over `n` items, the last binding being its results.
pub(crate) fn compute<T: bytemuck::Pod>(
    gpu: &Gpu,
    source: &str,
    resources: &[wgpu::BindingResource<'_>],
    n: usize,
) -> Vec<T> {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("test"),
        source: wgpu::ShaderSource::Wgsl(mirrorball_render::gpu::shader::resolve(source).into()),
    });
    let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("test"),
        layout: None,
        module: &module,
        entry_point: None,
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let out = Readback::new(gpu, "test: results", (n * size_of::<T>()) as u64);
    let mut resources = resources.to_vec();
    resources.push(out.buffer().as_entire_binding());
    let bindings = gpu.bind("test", &pipeline.get_bind_group_layout(0), &resources);
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups((n as u32).div_ceil(64), 1, 1);
    }
    out.record(&mut encoder);
    gpu.queue.submit([encoder.finish()]);
    let mut items = vec![T::zeroed(); n];
    out.read(gpu, &mut items).expect("the device works");
    items
}

/// Mean and worst of some errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Errors {
    pub(crate) mean: f32,
    pub(crate) worst: f32,
    pub(crate) n: usize,
}

impl Errors {
    /// Sums them up and says them, so that `--nocapture` shows how far below its bound each is.
    #[expect(clippy::print_stdout, reason = "a figure, kept by the test runner unless asked for")]
    pub(crate) fn of(what: &str, errors: impl IntoIterator<Item = f32>) -> Self {
        let (mut sum, mut worst, mut n) = (0.0f64, 0.0f32, 0);
        for error in errors {
            assert!(error.is_finite(), "{what}: an error is {error}");
            sum += f64::from(error.abs());
            worst = worst.max(error.abs());
            n += 1;
        }
        assert!(n > 0, "{what}: nothing was compared");
        let errors = Self {
            mean: (sum / n as f64) as f32,
            worst,
            n,
        };
        println!("{what}: {errors:?}");
        errors
    }
}

/// Numbers spread evenly over 0 .. 1, the same every time (Weyl's sequence of the golden ratio).
pub(crate) fn spread(index: usize, offset: f64) -> f64 {
    (offset + index as f64 * 0.618_033_988_749_894_9).fract()
}

/// `n` directions spread over the sphere.
pub(crate) fn directions(n: usize) -> impl Iterator<Item = Vec3> {
    (0..n).map(move |i| {
        let z = 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
        let (sin, cos) = (std::f64::consts::TAU * spread(i, 0.3)).sin_cos();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cos, r * sin, z).as_vec3()
    })
}
