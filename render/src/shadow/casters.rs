//! Things that cast or receive shadows, on the GPU and in memory.

use glam::{Affine3A, Vec3};

use crate::gpu::Gpu;
use crate::scene::{GONE, Mesh, Scene, Vertex};
use crate::scene_gpu::{IndexRange, SceneBuffers};
use crate::shadow::shadow_view::{Sphere, enclosing};

/// A set of objects that cast shadows together, or receive them: the real ones, or all.
#[derive(Debug)]
pub struct Casters {
    /// Their triangles in the scene's vertex buffer.
    pub range: IndexRange,
    /// The objects one by one, those that are gone left out.
    pub objects: Vec<Caster>,
    away: Vec<Caster>,
}

/// One object that casts a shadow.
#[derive(Debug)]
pub struct Caster {
    /// Its name, for messages.
    pub name: String,
    /// Its index in the scene.
    pub index: usize,
    /// Its triangles in its own frame, as the scene file gives them.
    pub mesh: Mesh,
    /// Whether its mesh changes its shape.
    pub bends: bool,
    /// How often it has.
    pub version: u32,
    /// Where it stands.
    pub world_from_object: Affine3A,
    /// Lowest and highest corner of the box around it in its own frame.
    box_m: [Vec3; 2],
    /// Sphere around it in its own frame.
    sphere: Sphere,
}

impl Casters {
    /// The objects of a scene that `is_caster` chooses by index, placed.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        buffers: &SceneBuffers,
        (scene, placements): (&Scene, &[Affine3A]),
        is_caster: impl Fn(usize) -> bool,
    ) -> Self {
        let chosen: Vec<usize> = (0..scene.objects.len()).filter(|&i| is_caster(i)).collect();
        let objects = chosen
            .iter()
            .map(|&index| {
                let object = &scene.objects[index];
                let box_m = box_around(&object.mesh);
                Caster {
                    name: object.name.clone(),
                    index,
                    mesh: object.mesh.clone(),
                    bends: object.movement.puppet.is_some(),
                    version: 0,
                    world_from_object: placements[index],
                    box_m,
                    sphere: sphere_around(&object.mesh, box_m),
                }
            })
            .collect();
        Self {
            range: buffers.range(gpu, "casters", &chosen),
            objects,
            away: Vec::new(),
        }
    }

    /// Moves the objects: one placement per object of the scene; [`GONE`] ones cast no shadow until they are back.
    pub fn place(&mut self, placements: &[Affine3A]) {
        self.objects.append(&mut self.away);
        for caster in &mut self.objects {
            caster.world_from_object = placements[caster.index];
        }
        self.away
            .extend(self.objects.extract_if(.., |caster| caster.world_from_object == GONE));
        self.objects.sort_by_key(|caster| caster.index);
    }

    /// Changes an object's shape: the vertices of its mesh, in its own frame.
    pub fn bend(&mut self, object: usize, moved: &[Vertex]) {
        let of_object = |caster: &&mut Caster| caster.index == object;
        if let Some(caster) = self.objects.iter_mut().chain(&mut self.away).find(of_object) {
            caster.mesh.vertices.copy_from_slice(moved);
            caster.box_m = box_around(&caster.mesh);
            caster.sphere = sphere_around(&caster.mesh, caster.box_m);
            caster.version = caster.version.wrapping_add(1);
        }
    }

    /// All objects, those that are gone included.
    pub fn all(&self) -> impl Iterator<Item = &Caster> {
        self.objects.iter().chain(&self.away)
    }

    /// Sphere around all of them, world; a small one at the origin without any.
    #[must_use]
    pub fn bounds(&self) -> Sphere {
        let spheres: Vec<Sphere> = self.objects.iter().map(Caster::bounds).collect();
        enclosing(&spheres).unwrap_or(Sphere {
            center_m: Vec3::ZERO,
            radius_m: 0.1,
        })
    }

    /// All triangles in the world frame, metres, object after object.
    pub fn triangles(&self) -> impl Iterator<Item = [Vec3; 3]> + '_ {
        self.objects.iter().flat_map(Caster::triangles)
    }
}

impl Caster {
    /// Sphere around it, world frame.
    #[must_use]
    pub fn bounds(&self) -> Sphere {
        Sphere {
            center_m: self.world_from_object.transform_point3(self.sphere.center_m),
            radius_m: self.sphere.radius_m,
        }
    }

    /// Corners of a box around it, world frame.
    #[must_use]
    pub fn corners(&self) -> [Vec3; 8] {
        std::array::from_fn(|i| {
            let corner = Vec3::from_array([0, 1, 2].map(|axis| self.box_m[(i >> axis) & 1][axis]));
            self.world_from_object.transform_point3(corner)
        })
    }

    /// Its triangles in the world frame, metres.
    pub fn triangles(&self) -> impl Iterator<Item = [Vec3; 3]> + '_ {
        self.own_triangles()
            .map(|corners| corners.map(|corner| self.world_from_object.transform_point3(corner)))
    }

    /// Its triangles in its own frame, metres.
    pub fn own_triangles(&self) -> impl Iterator<Item = [Vec3; 3]> + '_ {
        let corner = |i: u32| Vec3::from(self.mesh.vertices[i as usize].position);
        self.mesh
            .indices
            .chunks_exact(3)
            .map(move |triangle| [triangle[0], triangle[1], triangle[2]].map(corner))
    }
}

/// The box around the points that are finite numbers.
fn box_around(mesh: &Mesh) -> [Vec3; 2] {
    [
        finite_points(mesh).reduce(Vec3::min).unwrap_or(Vec3::ZERO),
        finite_points(mesh).reduce(Vec3::max).unwrap_or(Vec3::ZERO),
    ]
}

fn sphere_around(mesh: &Mesh, [low, high]: [Vec3; 2]) -> Sphere {
    let center_m = 0.5 * (low + high);
    Sphere {
        center_m,
        radius_m: finite_points(mesh).map(|p| p.distance(center_m)).fold(0.0, f32::max),
    }
}

fn finite_points(mesh: &Mesh) -> impl Iterator<Item = Vec3> + '_ {
    mesh.vertices
        .iter()
        .map(|v| Vec3::from(v.position))
        .filter(|p| p.is_finite())
}
