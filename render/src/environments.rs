//! The light around the probe and around each virtual object, as the GPU holds it.

use glam::{Vec3, Vec4};
use half::f16;

use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::{RADIANCE_FORMAT, TextureShape};
use crate::gpu::readback::Readback;
use crate::gpu::types::{GpuEnvironment, GpuNode, MAX_ENVIRONMENTS};
use crate::light_tree::node_count;
use crate::passes::irradiance_cube::IRRADIANCE_SIZE;
use crate::passes::sphere_map::SPHERE_MAP_SIZE;
use crate::passes::{ENVIRONMENT_MIPS, ENVIRONMENT_SIZE};
use crate::probe::surroundings;
use crate::scene::Scene;
use crate::scene::occluders::Occluders;
use crate::whereabouts::Whereabouts;
use mirrorball_calib::probe::cube::{Cube, FACES};
use mirrorball_calib::rig::Rig;

/// Largest radiance that a half float holds with room for sums.
const MAX_RADIANCE: f32 = 60_000.0;
/// Spherical harmonics of an environment start every so many bytes (the least alignment that devices guarantee).
pub const SH_STRIDE_BYTES: u64 = 256;

/// A cube texture that the CPU fills.
#[derive(Debug)]
pub struct CubeTexture {
    texture: wgpu::Texture,
    /// All six faces as a cube.
    pub view: wgpu::TextureView,
    /// All six faces as layers.
    pub faces: wgpu::TextureView,
    texels: Vec<[f16; 4]>,
}

impl CubeTexture {
    /// An empty cube.
    #[must_use]
    pub fn new(gpu: &Gpu, label: &str, size: u32) -> Self {
        let texture = gpu.texture(label, TextureShape::layered([size; 2], FACES as u32), RADIANCE_FORMAT);
        let view = texture.create_view(&cube_view(0, 1));
        let faces = texture.create_view(&faces_view(0, 0));
        Self {
            texture,
            view,
            faces,
            texels: vec![[f16::ZERO; 4]; FACES * (size * size) as usize],
        }
    }

    /// Uploads radiance of the same size, clamped to what half floats hold, with a small number per texel in alpha.
    pub fn upload(&mut self, gpu: &Gpu, radiance: &Cube<Vec3>, numbers: &Cube<u8>) {
        for ((texel, value), &number) in self.texels.iter_mut().zip(radiance.texels()).zip(numbers.texels()) {
            let [r, g, b] = value.clamp(Vec3::ZERO, Vec3::splat(MAX_RADIANCE)).to_array();
            *texel = [r, g, b, f32::from(number)].map(f16::from_f32);
        }
        let size = self.texture.size();
        gpu.queue.write_texture(
            self.texture.as_image_copy(),
            bytemuck::cast_slice(&self.texels),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(8 * size.width),
                rows_per_image: Some(size.height),
            },
            size,
        );
    }
}

/// One virtual object's own environment.
#[derive(Debug)]
pub struct Slot {
    /// Name of the object.
    pub name: String,
    /// Middle of its bounding box, world, metres.
    pub center_m: Vec3,
    /// Radius of the sphere around it, metres.
    pub radius_m: f32,
    /// Whether any of its materials reflects.
    pub is_glossy: bool,
    /// Its parameters for the shaders.
    pub parameters: wgpu::Buffer,
    /// Distances to the first phantom, per texel, metres.
    pub hit_m: wgpu::Buffer,
}

/// Environments of all virtual objects.
#[derive(Debug)]
pub struct Environments {
    /// One per virtual object, [`MAX_ENVIRONMENTS`] at most.
    pub slots: Vec<Slot>,
    /// Radiance cubes, six layers per slot, with mips.
    pub radiance: wgpu::Texture,
    /// The same, mips filtered with wider and wider lobes.
    pub specular: wgpu::Texture,
    /// `specular` as an array of cubes.
    pub specular_view: wgpu::TextureView,
    /// The room alone, as if no real thing stood before it: radiance, in alpha the distance in metres; six layers per slot,
    /// mips the means of four texels.
    pub room: wgpu::Texture,
    /// `room` as an array of cubes.
    pub room_view: wgpu::TextureView,
    /// Irradiance cubes, six layers per slot; filled by the methods that need them.
    pub irradiance: wgpu::Texture,
    /// `irradiance` as an array of cubes.
    pub irradiance_view: wgpu::TextureView,
    /// Sphere maps in eye space, two layers per slot: radiance, irradiance; filled by the methods that need them.
    pub sphere_maps: wgpu::Texture,
    /// Light trees, [`node_count`] nodes per slot.
    pub nodes: wgpu::Buffer,
    /// Spherical harmonics of all the light, [`SH_STRIDE_BYTES`] per slot; filled by the methods that need them.
    pub harmonics: wgpu::Buffer,
    /// All parameters together.
    pub all: wgpu::Buffer,
    /// Spherical harmonics of the light from near things, [`SH_STRIDE_BYTES`] per slot.
    pub near_sh: wgpu::Buffer,
    /// Per slot, whether the distances around it are no longer right.
    stale: Vec<bool>,
    /// Middles and radii (world, metres) of the objects that share the last slot; none where every object has its own.
    sharing: Vec<(Vec3, f32)>,
    /// The slots' parameters as they were last uploaded.
    placed: Vec<GpuEnvironment>,
}

impl Environments {
    /// Finds out what stands around every virtual object.
    #[must_use]
    pub fn new(gpu: &Gpu, scene: &Scene, rig: &Rig, occluders: &Occluders) -> Self {
        let mut slots: Vec<Slot> = scene
            .virtual_objects()
            .take(MAX_ENVIRONMENTS)
            .map(|(_, object)| {
                let (center_m, radius_m) = object.bounding_sphere(rig);
                let hit_m = surroundings::distances_m(occluders, center_m, 1e-3, ENVIRONMENT_SIZE);
                Slot {
                    name: object.name.clone(),
                    center_m,
                    radius_m,
                    is_glossy: object.mesh.materials.iter().any(crate::scene::Material::is_glossy),
                    parameters: gpu.buffer(
                        "environment: parameters",
                        &[<GpuEnvironment as bytemuck::Zeroable>::zeroed()],
                    ),
                    hit_m: gpu.buffer("environment: distances", hit_m.texels()),
                }
            })
            .collect();
        // Objects without a slot of their own share the last.
        let mut sharing = Vec::new();
        if let Some(last) = slots.last_mut()
            && scene.virtual_objects().count() > MAX_ENVIRONMENTS
        {
            for (_, object) in scene.virtual_objects().skip(MAX_ENVIRONMENTS - 1) {
                last.is_glossy |= object.mesh.materials.iter().any(crate::scene::Material::is_glossy);
                sharing.push(object.bounding_sphere(rig));
            }
        }
        let mut environments = Self::with_slots(gpu, slots);
        environments.sharing = sharing;
        environments.hold_sharing();
        environments
    }

    /// Room for the light around known places.
    #[must_use]
    pub fn with_slots(gpu: &Gpu, slots: Vec<Slot>) -> Self {
        let n = slots.len().max(1) as u32;
        let shape = TextureShape {
            mips: ENVIRONMENT_MIPS,
            ..TextureShape::layered([ENVIRONMENT_SIZE; 2], FACES as u32 * n)
        };
        let specular = gpu.texture("environment: specular", shape, RADIANCE_FORMAT);
        let room = gpu.texture("environment: room", shape, RADIANCE_FORMAT);
        let cubes = wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::CubeArray),
            ..wgpu::TextureViewDescriptor::default()
        };
        let shape_of_irradiance = TextureShape::layered([IRRADIANCE_SIZE; 2], FACES as u32 * n);
        let irradiance = gpu.texture("environment: irradiance", shape_of_irradiance, RADIANCE_FORMAT);
        let sphere_shape = TextureShape::layered([SPHERE_MAP_SIZE; 2], 2 * n);
        let black = [Vec4::ZERO; MAX_ENVIRONMENTS * SH_STRIDE_BYTES as usize / 16];
        let no_light = vec![<GpuNode as bytemuck::Zeroable>::zeroed(); (n * node_count()) as usize];
        Self {
            radiance: gpu.texture("environment: radiance", shape, RADIANCE_FORMAT),
            specular_view: specular.create_view(&cubes),
            specular,
            room_view: room.create_view(&cubes),
            room,
            irradiance_view: irradiance.create_view(&cubes),
            irradiance,
            sphere_maps: gpu.texture("environment: sphere maps", sphere_shape, RADIANCE_FORMAT),
            nodes: gpu.buffer("environment: light tree", &no_light),
            harmonics: gpu.buffer("environment: harmonics", &black),
            all: gpu.buffer(
                "environment: all",
                &[<GpuEnvironment as bytemuck::Zeroable>::zeroed(); MAX_ENVIRONMENTS],
            ),
            near_sh: gpu.buffer("environment: near light", &black),
            stale: vec![false; slots.len()],
            sharing: Vec::new(),
            placed: Vec::with_capacity(slots.len()),
            slots,
        }
    }

    /// Goes where the objects have gone.
    pub fn follow(&mut self, whereabouts: &Whereabouts) {
        self.stale.fill(whereabouts.changes().phantoms);
        for (index, sphere) in whereabouts.moved_spheres().enumerate() {
            let Some((center_m, radius_m)) = sphere else { continue };
            if let Some(slot) = self.slots.get_mut(index) {
                (slot.center_m, slot.radius_m) = (center_m, radius_m);
                self.stale[index] = true;
            }
            let shared = (index + 1).checked_sub(MAX_ENVIRONMENTS);
            if let Some(sphere) = shared.and_then(|shared| self.sharing.get_mut(shared)) {
                *sphere = (center_m, radius_m);
            }
        }
        self.hold_sharing();
    }

    /// Makes the sphere of the last slot hold all objects that share it.
    fn hold_sharing(&mut self) {
        if let (Some(last), false) = (self.slots.last_mut(), self.sharing.is_empty()) {
            last.radius_m = reach_m(last.center_m, &self.sharing);
        }
    }

    /// Slots that have moved, or around which phantoms have, since the frame before.
    pub fn stale_slots(&self) -> impl Iterator<Item = usize> + '_ {
        self.stale
            .iter()
            .enumerate()
            .filter(|(_, is_stale)| **is_stale)
            .map(|(slot, _)| slot)
    }

    /// Tells the shaders where the probe stands and how far away the room is.
    pub fn place(&mut self, gpu: &Gpu, probe_m: Vec3, room_m: f32) {
        let parameters = |slot: &Slot| GpuEnvironment {
            position_m: slot.center_m.extend(room_m),
            probe_m: probe_m.extend(slot.radius_m),
        };
        self.placed.clear();
        self.placed.extend(self.slots.iter().map(parameters));
        for (slot, parameters) in self.slots.iter().zip(&self.placed) {
            gpu.write(&slot.parameters, &[*parameters]);
        }
        if !self.placed.is_empty() {
            gpu.write(&self.all, &self.placed);
        }
    }

    /// The light tree of one slot.
    #[must_use]
    pub fn nodes_of(&self, slot: u32) -> wgpu::BindingResource<'_> {
        let bytes = u64::from(node_count()) * size_of::<GpuNode>() as u64;
        wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: &self.nodes,
            offset: u64::from(slot) * bytes,
            size: std::num::NonZeroU64::new(bytes),
        })
    }

    /// Copies the first mips of `slots` from `cubes` to the specular cubes: what a mirror shows.
    pub fn copy_first_mip(&self, encoder: &mut wgpu::CommandEncoder, cubes: &wgpu::Texture, slots: &[u32]) {
        for &slot in slots {
            let face = |texture| wgpu::TexelCopyTextureInfo {
                texture,
                mip_level: 0,
                origin: wgpu::Origin3d {
                    x: 0,
                    y: 0,
                    z: FACES as u32 * slot,
                },
                aspect: wgpu::TextureAspect::All,
            };
            let extent = wgpu::Extent3d {
                width: ENVIRONMENT_SIZE,
                height: ENVIRONMENT_SIZE,
                depth_or_array_layers: FACES as u32,
            };
            encoder.copy_texture_to_texture(face(cubes), face(&self.specular), extent);
        }
    }

    /// The first mip of every environment: name of the object and radiance.
    ///
    /// # Errors
    /// [`RenderError::Gpu`] when the device is lost.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<(String, Cube<Vec3>)>, RenderError> {
        let n_texels = FACES * (ENVIRONMENT_SIZE * ENVIRONMENT_SIZE) as usize;
        let mut texels = vec![[f16::ZERO; 4]; n_texels];
        let readback = Readback::new(gpu, "environment: readback", (n_texels * size_of::<[f16; 4]>()) as u64);
        let mut out = Vec::with_capacity(self.slots.len());
        for (index, slot) in self.slots.iter().enumerate() {
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("environment"),
            });
            encoder.copy_texture_to_buffer(
                wgpu::TexelCopyTextureInfo {
                    origin: wgpu::Origin3d {
                        x: 0,
                        y: 0,
                        z: (FACES * index) as u32,
                    },
                    ..self.radiance.as_image_copy()
                },
                wgpu::TexelCopyBufferInfo {
                    buffer: readback.buffer(),
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(8 * ENVIRONMENT_SIZE),
                        rows_per_image: Some(ENVIRONMENT_SIZE),
                    },
                },
                wgpu::Extent3d {
                    width: ENVIRONMENT_SIZE,
                    height: ENVIRONMENT_SIZE,
                    depth_or_array_layers: FACES as u32,
                },
            );
            readback.record(&mut encoder);
            gpu.queue.submit([encoder.finish()]);
            readback.read(gpu, &mut texels)?;
            let radiance = texels
                .iter()
                .map(|t| Vec3::new(t[0].to_f32(), t[1].to_f32(), t[2].to_f32()))
                .collect();
            if let Some(cube) = Cube::from_texels(ENVIRONMENT_SIZE, radiance) {
                out.push((slot.name.clone(), cube));
            }
        }
        Ok(out)
    }
}

/// Radius, metres, of the sphere around `center_m` that holds all `spheres`, middles and radii.
fn reach_m(center_m: Vec3, spheres: &[(Vec3, f32)]) -> f32 {
    let reaches = spheres
        .iter()
        .map(|&(middle_m, radius_m)| center_m.distance(middle_m) + radius_m);
    reaches.fold(0.0, f32::max)
}

/// The harmonics of one slot in a buffer of all.
#[must_use]
pub fn harmonics_binding(buffer: &wgpu::Buffer, slot: u32) -> wgpu::BindingResource<'_> {
    wgpu::BindingResource::Buffer(wgpu::BufferBinding {
        buffer,
        offset: u64::from(slot) * SH_STRIDE_BYTES,
        size: std::num::NonZeroU64::new(SH_STRIDE_BYTES),
    })
}

/// A view of mips of one slot's cube.
#[must_use]
pub fn cube_view(slot: u32, n_mips: u32) -> wgpu::TextureViewDescriptor<'static> {
    wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::Cube),
        base_array_layer: FACES as u32 * slot,
        array_layer_count: Some(FACES as u32),
        mip_level_count: Some(n_mips),
        ..wgpu::TextureViewDescriptor::default()
    }
}

/// A view of one mip of one slot's cube as six layers.
#[must_use]
pub fn faces_view(slot: u32, mip: u32) -> wgpu::TextureViewDescriptor<'static> {
    wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        base_array_layer: FACES as u32 * slot,
        array_layer_count: Some(FACES as u32),
        base_mip_level: mip,
        mip_level_count: Some(1),
        ..wgpu::TextureViewDescriptor::default()
    }
}
