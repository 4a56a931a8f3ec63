//! The scene and the cameras' pictures as the GPU holds them.

use std::ops::Range;

use glam::{Affine3A, Vec3};
use mirrorball_calib::rig::{Camera, Rig};
use mirrorball_capture::frame::Frame;

use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::gpu::pass::TextureShape;
use crate::gpu::types::{GpuObject, MAX_ENVIRONMENTS};
use crate::passes::lamp_light::GpuLamps;
use crate::scene::material::Alpha;
use crate::scene::{Kind, MAX_LAMPS, Material, Mesh, Scene, Split, Vertex, split};
use crate::scene_materials::SceneMaterials;

/// Longest edge of a triangle before it is split for the lens, metres.
const MAX_EDGE_M: f32 = 0.04;

/// All triangles, objects and materials.
#[derive(Debug)]
pub struct SceneBuffers {
    /// Vertices of all objects.
    pub vertices: wgpu::Buffer,
    /// Triangles of phantoms.
    pub phantoms: IndexRange,
    /// Triangles of virtual objects.
    pub virtuals: IndexRange,
    /// Those of them that hide what is behind.
    pub opaque: IndexRange,
    /// Those that are blended over what is behind, by object.
    pub blended: Vec<Blended>,
    /// Placements.
    pub objects: wgpu::Buffer,
    /// Materials with their pictures.
    pub materials: SceneMaterials,
    /// Whether any material lets light through.
    pub has_glass: bool,
    /// Virtual lamps, uniform ([`GpuLamps`]).
    pub lamps: wgpu::Buffer,
    /// How many there are.
    pub n_lamps: usize,
    /// The vertices in memory.
    kept: Vec<Vertex>,
    /// Indices of every object's triangles.
    of_object: Vec<Vec<u32>>,
    /// Of every object that changes its shape, its vertices.
    bending: Vec<Option<Bending>>,
    /// Of every object, whether it moves or changes its shape.
    moves: Vec<bool>,
    /// Environment slot of every object, and 1 for a virtual one.
    slots: Vec<[u32; 2]>,
    /// The objects as they were last uploaded.
    placed: Vec<GpuObject>,
}

/// Vertices of an object that changes its shape.
#[derive(Debug)]
struct Bending {
    range: Range<usize>,
    /// As in [`Split`].
    ends: Vec<[u32; 2]>,
}

/// An object's triangles in memory.
#[derive(Debug, Clone, Copy)]
pub struct ObjectTriangles<'a> {
    /// Vertices of all objects, each in its object's frame.
    pub vertices: &'a [Vertex],
    /// The object's triangles, three indices each.
    pub indices: &'a [u32],
    /// Virtual or phantom.
    pub kind: Kind,
    /// Slot of its environment.
    pub slot: u32,
}

/// An object's triangles that are blended over what is behind them.
#[derive(Debug)]
pub struct Blended {
    /// Index of the object in the scene.
    pub object: usize,
    /// The triangles.
    pub triangles: IndexRange,
    /// Middle of their corners in the object's frame, metres.
    pub middle_m: Vec3,
    /// Their corners among the scene's vertices.
    corners: Vec<u32>,
}

/// Indices of some triangles.
#[derive(Debug)]
pub struct IndexRange {
    /// Three per triangle; at least one triangle's worth of space.
    pub buffer: wgpu::Buffer,
    /// How many count.
    pub n_indices: u32,
}

impl SceneBuffers {
    /// Uploads a scene.
    ///
    /// # Errors
    /// [`RenderError::Mesh`] for a mesh so large that it cannot be in metres, [`RenderError::TooLarge`] for more pictures of
    /// materials than the adapter takes, [`RenderError::TooManyLamps`].
    pub fn new(gpu: &Gpu, scene: &Scene, rig: &Rig) -> Result<Self, RenderError> {
        let placements: Vec<Affine3A> = scene.objects.iter().map(|o| o.world_from_object(rig)).collect();
        Self::placed(gpu, scene, &placements, MAX_EDGE_M)
    }

    /// Uploads a scene whose objects stand at `placements` (world from object), triangles split until no edge is longer
    /// than `max_edge_m`.
    ///
    /// # Errors
    /// As [`SceneBuffers::new`].
    pub fn placed(gpu: &Gpu, scene: &Scene, placements: &[Affine3A], max_edge_m: f32) -> Result<Self, RenderError> {
        check_lamps(scene)?;
        let mut vertices: Vec<Vertex> = Vec::new();
        let (mut phantoms, mut virtuals) = (Vec::new(), Vec::new());
        let mut of_object: Vec<Vec<u32>> = Vec::with_capacity(scene.objects.len());
        let mut bending = Vec::with_capacity(scene.objects.len());
        let mut slots = Vec::with_capacity(scene.objects.len());
        let (mut objects, mut materials) = (Vec::new(), Vec::new());
        let mut n_virtual = 0u32;
        for (index, object) in scene.objects.iter().enumerate() {
            let Split { mesh, ends } = split(&object.mesh, max_edge_m).ok_or_else(|| RenderError::Mesh {
                file: object.file.clone(),
                object: object.name.clone(),
                message: "it is so large that its edges cannot be split for the lens; are its units metres?".into(),
            })?;
            let (first_vertex, first_material) = (vertices.len() as u32, materials.len() as u32);
            vertices.extend(mesh.vertices.iter().map(|vertex| Vertex {
                object: index as u32,
                material: first_material + vertex.material,
                ..*vertex
            }));
            let (indices, slot, is_virtual) = match object.kind {
                Kind::Virtual => {
                    n_virtual += 1;
                    (&mut virtuals, (n_virtual - 1).min(MAX_ENVIRONMENTS as u32 - 1), 1)
                }
                Kind::Phantom => (&mut phantoms, 0, 0),
            };
            let own: Vec<u32> = finite_triangles(&mesh).map(|i| first_vertex + i).collect();
            indices.extend_from_slice(&own);
            bending.push(object.movement.puppet.is_some().then_some(Bending {
                range: first_vertex as usize..vertices.len(),
                ends,
            }));
            of_object.push(own);
            slots.push([slot, is_virtual]);
            objects.push(GpuObject::new(placements[index], slot, is_virtual));
            materials.extend_from_slice(&mesh.materials);
        }
        let or_one = |mut items: Vec<Vertex>| {
            if items.is_empty() {
                items.push(<Vertex as bytemuck::Zeroable>::zeroed());
            }
            items
        };
        // A buffer holds one object at least.
        objects.push(GpuObject::new(Affine3A::IDENTITY, 0, 0));
        let is_blended = |triangle: &[u32]| {
            let material = vertices[triangle[0] as usize].material;
            let of: Option<&Material> = materials.get(material as usize);
            of.is_some_and(|of| matches!(of.alpha, Alpha::Blend))
        };
        let (over, opaque): (Vec<&[u32]>, Vec<&[u32]>) = virtuals.chunks_exact(3).partition(|t| is_blended(t));
        let blended = Blended::by_object(gpu, &vertices, &over.concat());
        Ok(Self {
            opaque: IndexRange::new(gpu, "scene: opaque triangles", &opaque.concat()),
            blended,
            vertices: gpu.buffer("scene: vertices", &or_one(vertices.clone())),
            kept: vertices,
            phantoms: IndexRange::new(gpu, "scene: phantom triangles", &phantoms),
            virtuals: IndexRange::new(gpu, "scene: virtual triangles", &virtuals),
            of_object,
            bending,
            moves: scene.objects.iter().map(|object| object.movement.moves()).collect(),
            slots,
            has_glass: materials.iter().any(|material: &Material| material.transmission > 0.0),
            objects: gpu.buffer("scene: objects", &objects),
            placed: objects,
            materials: SceneMaterials::new(gpu, &materials)?,
            lamps: gpu.buffer("scene: lamps", &[<GpuLamps as bytemuck::Zeroable>::zeroed()]),
            n_lamps: scene.lamps.len(),
        })
    }
}

impl SceneBuffers {
    /// The triangles of some objects, by their indices in the scene.
    #[must_use]
    pub fn range(&self, gpu: &Gpu, label: &str, objects: &[usize]) -> IndexRange {
        let indices: Vec<u32> = objects
            .iter()
            .flat_map(|&i| self.of_object[i].iter().copied())
            .collect();
        IndexRange::new(gpu, label, &indices)
    }

    /// Every object's triangles, as rays take them.
    #[must_use]
    pub fn objects_of_rays(&self) -> Vec<ObjectTriangles<'_>> {
        (0..self.of_object.len())
            .map(|object| self.object_of_rays(object))
            .collect()
    }

    /// One object's triangles, as rays take them.
    #[must_use]
    pub fn object_of_rays(&self, object: usize) -> ObjectTriangles<'_> {
        let [slot, is_virtual] = self.slots[object];
        ObjectTriangles {
            vertices: &self.kept,
            indices: &self.of_object[object],
            kind: if is_virtual == 1 { Kind::Virtual } else { Kind::Phantom },
            slot,
        }
    }

    /// Whether an object may be elsewhere, or of another shape, from one frame to the next.
    #[must_use]
    pub fn moves(&self, object: usize) -> bool {
        self.moves[object]
    }

    /// Whether any object changes its shape.
    #[must_use]
    pub fn bends(&self) -> bool {
        self.bending.iter().any(Option::is_some)
    }

    /// Changes an object's shape: `moved` are the vertices of its mesh in its own frame. Other objects than those of a
    /// puppet stay as they are.
    pub fn bend(&mut self, gpu: &Gpu, object: usize, moved: &[Vertex]) {
        let Some(Bending { range, ends }) = self.bending.get(object).and_then(Option::as_ref) else {
            return;
        };
        let vertices = &mut self.kept[range.clone()];
        Split::bend(moved, ends, vertices);
        let offset = (range.start * size_of::<Vertex>()) as u64;
        gpu.queue
            .write_buffer(&self.vertices, offset, bytemuck::cast_slice(vertices));
        for blended in self.blended.iter_mut().filter(|blended| blended.object == object) {
            blended.middle_m = middle_m(&self.kept, &blended.corners);
        }
    }

    /// Moves the objects: one placement per object, world from object; [`crate::scene::GONE`] ones are not drawn.
    pub fn place(&mut self, gpu: &Gpu, placements: &[Affine3A]) {
        for ((placed, &placement), &[slot, is_virtual]) in self.placed.iter_mut().zip(placements).zip(&self.slots) {
            *placed = GpuObject::new(placement, slot, is_virtual);
        }
        gpu.write(&self.objects, &self.placed);
    }
}

impl Blended {
    /// Triangles that lie object by object, apart.
    fn by_object(gpu: &Gpu, vertices: &[Vertex], indices: &[u32]) -> Vec<Self> {
        let object = |index: u32| vertices[index as usize].object;
        indices
            .chunk_by(|&one, &next| object(one) == object(next))
            .map(|own| Self {
                object: object(own[0]) as usize,
                triangles: IndexRange::new(gpu, "scene: blended triangles", own),
                middle_m: middle_m(vertices, own),
                corners: own.to_vec(),
            })
            .collect()
    }
}

fn middle_m(vertices: &[Vertex], corners: &[u32]) -> Vec3 {
    let places = corners.iter().map(|&i| Vec3::from(vertices[i as usize].position));
    places.sum::<Vec3>() / corners.len() as f32
}

impl IndexRange {
    fn new(gpu: &Gpu, label: &str, indices: &[u32]) -> Self {
        Self {
            n_indices: indices.len() as u32,
            buffer: gpu.buffer(label, if indices.is_empty() { &[0, 0, 0] } else { indices }),
        }
    }

    /// Draws the triangles with the pipeline and bindings already set.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, vertices: &wgpu::Buffer) {
        if self.n_indices > 0 {
            pass.set_vertex_buffer(0, vertices.slice(..));
            pass.set_index_buffer(self.buffer.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..self.n_indices, 0, 0..1);
        }
    }
}

fn check_lamps(scene: &Scene) -> Result<(), RenderError> {
    let found = scene.lamps.len();
    if found > MAX_LAMPS {
        return Err(RenderError::TooManyLamps {
            found,
            limit: MAX_LAMPS,
        });
    }
    Ok(())
}

/// Indices of the triangles all of whose corners are finite numbers: what rasterisers make of others is not defined.
fn finite_triangles(mesh: &Mesh) -> impl Iterator<Item = u32> + '_ {
    let is_finite = |&i: &u32| {
        mesh.vertices
            .get(i as usize)
            .is_some_and(|vertex| vertex.position.iter().all(|x| x.is_finite()))
    };
    mesh.indices
        .chunks_exact(3)
        .filter(move |triangle| triangle.iter().all(is_finite))
        .flatten()
        .copied()
}

fn write_layer(gpu: &Gpu, texture: &wgpu::Texture, layer: u32, rgba: &[u8]) {
    let size = texture.size();
    gpu.queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
            aspect: wgpu::TextureAspect::All,
        },
        rgba,
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(4 * size.width),
            rows_per_image: Some(size.height),
        },
        wgpu::Extent3d {
            depth_or_array_layers: 1,
            ..size
        },
    );
}

/// Format of pictures.
const PICTURE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Uint;

/// A camera's latest picture with its response table.
#[derive(Debug)]
pub struct PictureBuffers {
    texture: wgpu::Texture,
    /// Codes, 8-bit RGBA.
    pub view: wgpu::TextureView,
    /// Linear signal of every code.
    pub response: wgpu::Buffer,
    rgba: Vec<u8>,
}

impl PictureBuffers {
    /// Room for pictures of one camera.
    #[must_use]
    pub fn new(gpu: &Gpu, camera: &Camera) -> Self {
        let shape = TextureShape::plain(camera.intrinsics.size_px);
        let texture = gpu.texture("picture", shape, PICTURE_FORMAT);
        let [width, height] = camera.intrinsics.size_px;
        Self {
            view: texture.create_view(&wgpu::TextureViewDescriptor::default()),
            texture,
            response: gpu.buffer("picture: response", camera.photometry.response.table()),
            rgba: vec![255; 4 * (width * height) as usize],
        }
    }

    /// Room for pictures that a pass draws as this camera would take them.
    #[must_use]
    pub fn drawn(gpu: &Gpu, camera: &Camera) -> Self {
        let shape = TextureShape::plain(camera.intrinsics.size_px);
        let texture = gpu.target("picture: drawn", shape, PICTURE_FORMAT);
        Self {
            view: texture.create_view(&wgpu::TextureViewDescriptor::default()),
            texture,
            response: gpu.buffer("picture: response", camera.photometry.response.table()),
            rgba: Vec::new(),
        }
    }

    /// Uploads a frame of the camera's size.
    pub fn upload(&mut self, gpu: &Gpu, frame: &Frame) {
        for (rgba, rgb) in self.rgba.chunks_exact_mut(4).zip(frame.pixels.chunks_exact(3)) {
            rgba[..3].copy_from_slice(rgb);
        }
        write_layer(gpu, &self.texture, 0, &self.rgba);
    }
}
