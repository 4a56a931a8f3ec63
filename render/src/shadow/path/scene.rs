//! A scene as the path tracer takes it: triangles with their normals and materials.

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Mat3, Vec3, Vec4};

use super::hierarchy::{Hierarchies, HierarchyBuffers, within_binding};
use super::{Surfaces, refused};
use crate::error::RenderError;
use crate::gpu::Gpu;
use crate::scene::{Material, Scene};

/// Normals at the corners of a triangle (`Corners` in `shadow_path.wgsl`), world.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuCorners {
    /// At the first corner; w: the material's index.
    pub a: Vec4,
    /// At the second; w unused.
    pub b: Vec4,
    /// At the third; w unused.
    pub c: Vec4,
}

/// A material (`PathMaterial` in `shared/path_material.wgsl`).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GpuPathMaterial {
    /// Linear base colour; w: metallic.
    pub color: Vec4,
    /// Dielectric reflectance at normal incidence; w: at grazing incidence.
    pub dielectric: Vec4,
    /// x: GGX alpha; y: transmission; z: index of refraction; w: unused.
    pub parameters: Vec4,
}

/// A scene on the GPU, for rays.
#[derive(Debug)]
pub struct TracedScene {
    pub(super) hierarchy: HierarchyBuffers,
    pub(super) root: u32,
    pub(super) corners: wgpu::Buffer,
    pub(super) materials: wgpu::Buffer,
}

impl TracedScene {
    /// Uploads a scene whose objects stand at `placements` (world from object). Phantoms are traced as all others.
    ///
    /// # Errors
    /// [`RenderError::Shadow`] where placements are missing, [`RenderError::TooLarge`] for more triangles than the adapter
    /// has room for.
    pub fn new(gpu: &Gpu, (scene, placements): (&Scene, &[Affine3A]), surfaces: Surfaces) -> Result<Self, RenderError> {
        if placements.len() != scene.objects.len() {
            return Err(refused(
                format!("{} placements for {} objects", placements.len(), scene.objects.len()),
                "give one placement per object",
            ));
        }
        let (mut triangles, mut normals) = (Vec::new(), Vec::new());
        let mut materials: Vec<GpuPathMaterial> = Vec::new();
        for (object, placement) in scene.objects.iter().zip(placements) {
            let first_material = materials.len() as u32;
            materials.extend(object.mesh.materials.iter().map(|m| gpu_material(m, surfaces)));
            let world_from_normal = Mat3::from(placement.matrix3).inverse().transpose();
            for corners in object.mesh.indices.chunks_exact(3) {
                let vertices = [0, 1, 2].map(|i| &object.mesh.vertices[corners[i] as usize]);
                triangles.push(vertices.map(|v| placement.transform_point3(Vec3::from(v.position))));
                let [a, b, c] = vertices.map(|v| (world_from_normal * Vec3::from(v.normal)).normalize_or(Vec3::Z));
                normals.push(GpuCorners {
                    a: a.extend((first_material + vertices[0].material) as f32),
                    b: b.extend(0.0),
                    c: c.extend(0.0),
                });
            }
        }
        let mut hierarchies = Hierarchies::default();
        let root = hierarchies.add(gpu, &triangles)?;
        let mut ordered: Vec<GpuCorners> = root.order.iter().map(|&i| normals[i as usize]).collect();
        if ordered.is_empty() {
            ordered.push(GpuCorners::zeroed());
        }
        if materials.is_empty() {
            materials.push(GpuPathMaterial::zeroed());
        }
        within_binding(gpu, "a number of bytes of normals", size_of_val(&ordered[..]))?;
        Ok(Self {
            hierarchy: hierarchies.upload(gpu)?,
            root: root.link,
            corners: gpu.buffer("path: corners", &ordered),
            materials: gpu.buffer("path: materials", &materials),
        })
    }
}

fn gpu_material(material: &Material, surfaces: Surfaces) -> GpuPathMaterial {
    let color = Vec3::from(material.base_color);
    match surfaces {
        Surfaces::Matt => GpuPathMaterial {
            color: color.extend(0.0),
            dielectric: Vec4::ZERO,
            parameters: Vec4::new(1.0, 0.0, 1.5, 0.0),
        },
        Surfaces::AsGiven => GpuPathMaterial {
            color: color.extend(material.metallic.clamp(0.0, 1.0)),
            dielectric: Vec3::from(material.dielectric_f0).extend(material.dielectric_f90),
            parameters: Vec4::new(
                material.roughness.clamp(0.0, 1.0).powi(2),
                material.transmission.clamp(0.0, 1.0),
                material.ior.max(1.0),
                0.0,
            ),
        },
    }
}
