//! glTF 2.0 files: triangles and physically based materials of an object.

use std::path::{Path, PathBuf};

use bytemuck::{Pod, Zeroable};
use glam::{Mat3, Mat4, Vec3};

use super::MeshUp;
use super::entry::listed;
use super::puppet::Puppet;
use super::skin::{self, Part, Playing, Source};
use crate::error::RenderError;

/// One corner of a triangle, as it lies in the GPU's vertex buffer.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Vertex {
    /// Position in the object's frame, metres.
    pub position: [f32; 3],
    /// Index of the object in the scene.
    pub object: u32,
    /// Unit normal in the object's frame.
    pub normal: [f32; 3],
    /// Index of the material.
    pub material: u32,
    /// First set of texture coordinates.
    pub uv: [f32; 2],
    /// Second set.
    pub uv1: [f32; 2],
    /// Unit tangent along the first set's u in the object's frame; w: 1 or -1, the bitangent's sense (glTF 2.0, 3.7.2.1).
    pub tangent: [f32; 4],
    /// Linear colour and opacity that the base colour is multiplied with.
    pub color: [f32; 4],
}

impl Vertex {
    /// A corner at the origin that faces up, white and without texture: the rest of one that is made by hand.
    pub const PLAIN: Self = Self {
        position: [0.0; 3],
        object: 0,
        normal: [0.0, 0.0, 1.0],
        material: 0,
        uv: [0.0; 2],
        uv1: [0.0; 2],
        tangent: [1.0, 0.0, 0.0, 1.0],
        color: [1.0; 4],
    };
}

/// A picture of base colours, sRGB-encoded RGBA, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseColorTexture {
    /// Columns and rows.
    pub size_px: [u32; 2],
    /// Four bytes per texel.
    pub rgba: Vec<u8>,
}

/// Metallic-roughness material of glTF 2.0 with KHR_materials_specular, KHR_materials_ior and KHR_materials_transmission.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Linear base colour factor.
    pub base_color: [f32; 3],
    /// Base colour picture; multiplied with the factor.
    pub base_color_texture: Option<BaseColorTexture>,
    /// 0 dielectric ..= 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 ..= 1; GGX alpha is its square.
    pub roughness: f32,
    /// Reflectance of a dielectric at normal incidence, linear RGB: that of its index of refraction times the extension's
    /// factors.
    pub dielectric_f0: [f32; 3],
    /// Reflectance of a dielectric at grazing incidence: the extension's factor, 1 without it.
    pub dielectric_f90: f32,
    /// Share of the light that enters a dielectric and goes through it, 0 ..= 1. Only the path tracer draws it: smooth
    /// glass, of a closed mesh.
    pub transmission: f32,
    /// Index of refraction, 1 or more.
    pub ior: f32,
}

impl Default for Material {
    /// White, matt and opaque, without any gloss.
    fn default() -> Self {
        Self {
            base_color: [1.0; 3],
            base_color_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            dielectric_f0: [0.0; 3],
            dielectric_f90: 0.0,
            transmission: 0.0,
            ior: 1.5,
        }
    }
}

/// Triangles of an object.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// Corners; `material` counts into `materials`.
    pub vertices: Vec<Vertex>,
    /// Three per triangle, counterclockwise seen from outside.
    pub indices: Vec<u32>,
    /// Materials in use.
    pub materials: Vec<Material>,
}

/// More triangles than this are refused: a typing error or a scan that wants thinning.
const MAX_TRIANGLES: usize = 2_000_000;

/// What is read of a glTF file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Choice<'a> {
    /// Which axis of the file points up.
    pub(super) up: MeshUp,
    /// The node that is read, with all below it, where it stands in the file; `None` for all nodes.
    pub(super) node: Option<&'a str>,
    /// The animation that is played.
    pub(super) playing: Option<&'a Playing>,
}

/// What was read.
#[derive(Debug)]
pub(super) struct Read {
    /// Triangles, with all nodes at rest.
    pub(super) mesh: Mesh,
    /// What moves them.
    pub(super) puppet: Option<Puppet>,
    parts: Vec<Part>,
}

/// Reads the chosen nodes of a glTF file into one mesh, in the object's frame.
pub(super) fn load(file: &Path, object: &str, choice: Choice<'_>) -> Result<Read, RenderError> {
    let place = Place {
        file: file.to_owned(),
        object: object.to_owned(),
    };
    let bytes = std::fs::read(file).map_err(|source| RenderError::Read {
        file: file.to_owned(),
        source,
    })?;
    let parsed = gltf::Gltf::from_slice(&bytes).map_err(|error| place.error(&error))?;
    let folder = file.parent();
    let buffers = gltf::import_buffers(&parsed.document, folder, parsed.blob.clone()).map_err(|e| place.error(&e))?;
    let images = gltf::import_images(&parsed.document, folder, &buffers).map_err(|e| place.error(&e))?;
    let mut read = Read {
        mesh: Mesh::default(),
        puppet: None,
        parts: Vec::new(),
    };
    let root = match choice.up {
        MeshUp::Z => Mat4::IDENTITY,
        // +y of the file becomes +z: a quarter turn about x.
        MeshUp::Y => Mat4::from_mat3(Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::NEG_Y)),
    };
    // The scene to be shown, by glTF 2.0 section 3.5.1; a file without scenes has nothing to show.
    let shown = parsed
        .document
        .default_scene()
        .or_else(|| parsed.document.scenes().next());
    for (node, object_from_parent) in chosen_nodes(shown.as_ref(), root, choice.node).map_err(|m| place.message(m))? {
        read_node(
            &node,
            object_from_parent,
            &place,
            &Payload {
                buffers: &buffers,
                images: &images,
            },
            &mut read,
        )?;
    }
    if read.mesh.indices.is_empty() {
        return Err(place.message("it holds no triangles"));
    }
    let source = Source {
        document: &parsed.document,
        buffers: &buffers,
        object_from_file: root,
        mesh: &read.mesh,
        parts: &read.parts,
    };
    read.puppet = skin::read(source, choice.playing).map_err(|message| place.message(message))?;
    Ok(read)
}

/// Buffers and pictures that a glTF file names as files of their own.
pub(super) fn files_beside(file: &Path) -> Vec<PathBuf> {
    let Some(parsed) = std::fs::read(file)
        .ok()
        .and_then(|bytes| gltf::Gltf::from_slice(&bytes).ok())
    else {
        return Vec::new();
    };
    let buffers = parsed.buffers().filter_map(|buffer| match buffer.source() {
        gltf::buffer::Source::Uri(uri) => Some(uri.to_owned()),
        gltf::buffer::Source::Bin => None,
    });
    let images = parsed.images().filter_map(|image| match image.source() {
        gltf::image::Source::Uri { uri, .. } => Some(uri.to_owned()),
        gltf::image::Source::View { .. } => None,
    });
    let folder = file.parent().unwrap_or(Path::new("."));
    buffers
        .chain(images)
        .filter(|uri| !uri.starts_with("data:"))
        .map(|uri| folder.join(uri))
        .collect()
}

/// The nodes that are read with all below them, each with the transform that it stands in.
fn chosen_nodes<'a>(
    scene: Option<&gltf::Scene<'a>>,
    root: Mat4,
    name: Option<&str>,
) -> Result<Vec<(gltf::Node<'a>, Mat4)>, String> {
    let mut waiting: Vec<(gltf::Node<'a>, Mat4)> = scene
        .into_iter()
        .flat_map(gltf::Scene::nodes)
        .map(|node| (node, root))
        .collect();
    let Some(name) = name else {
        return Ok(waiting);
    };
    let mut names = Vec::new();
    while let Some((node, object_from_parent)) = waiting.pop() {
        if node.name() == Some(name) {
            return Ok(vec![(node, object_from_parent)]);
        }
        names.extend(node.name().map(str::to_owned));
        let object_from_node = object_from_parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        waiting.extend(node.children().map(|child| (child, object_from_node)));
    }
    names.sort();
    Err(format!("it has no node `{name}`; its nodes are {}", listed(names)))
}

struct Place {
    file: PathBuf,
    object: String,
}

impl Place {
    fn message(&self, message: impl Into<String>) -> RenderError {
        RenderError::Mesh {
            file: self.file.clone(),
            object: self.object.clone(),
            message: message.into(),
        }
    }

    fn error(&self, error: &dyn std::error::Error) -> RenderError {
        self.message(error.to_string())
    }
}

struct Payload<'a> {
    buffers: &'a [gltf::buffer::Data],
    images: &'a [gltf::image::Data],
}

fn read_node(
    node: &gltf::Node<'_>,
    object_from_parent: Mat4,
    place: &Place,
    payload: &Payload<'_>,
    read: &mut Read,
) -> Result<(), RenderError> {
    let object_from_node = object_from_parent * Mat4::from_cols_array_2d(&node.transform().matrix());
    let name = node.name().unwrap_or("(unnamed)").to_owned();
    if !object_from_node.is_finite() || object_from_node.determinant().abs() < 1e-12 {
        return Err(place.message(format!(
            "node `{name}` has a transform that is not finite or flattens it"
        )));
    }
    if let Some(gltf_mesh) = node.mesh() {
        for (index, primitive) in gltf_mesh.primitives().enumerate() {
            let first_vertex = read.mesh.vertices.len();
            read_primitive(&primitive, object_from_node, payload, &mut read.mesh)
                .map_err(|message| place.message(format!("node `{name}`: {message}")))?;
            read.parts.push(Part {
                node: node.index(),
                primitive: index,
                first_vertex,
                n_vertices: read.mesh.vertices.len() - first_vertex,
            });
        }
    }
    for child in node.children() {
        read_node(&child, object_from_node, place, payload, read)?;
    }
    Ok(())
}

fn read_primitive(
    primitive: &gltf::Primitive<'_>,
    object_from_node: Mat4,
    payload: &Payload<'_>,
    mesh: &mut Mesh,
) -> Result<(), String> {
    if primitive.mode() != gltf::mesh::Mode::Triangles {
        return Err(format!(
            "a primitive is made of {:?}; only triangles are read",
            primitive.mode()
        ));
    }
    let reader = primitive.reader(|buffer| payload.buffers.get(buffer.index()).map(|data| &data.0[..]));
    let positions: Vec<Vec3> = reader
        .read_positions()
        .ok_or("a primitive has no positions")?
        .map(Vec3::from)
        .collect();
    let indices: Vec<u32> = match reader.read_indices() {
        Some(indices) => indices.into_u32().collect(),
        None => (0..positions.len() as u32).collect(),
    };
    check_triangles(&positions, &indices, mesh.indices.len())?;
    let normals: Vec<Vec3> = match reader.read_normals() {
        Some(normals) => normals.map(Vec3::from).collect(),
        None => smooth_normals(&positions, &indices),
    };
    if normals.len() != positions.len() {
        return Err(format!("{} normals for {} positions", normals.len(), positions.len()));
    }
    let uvs: Vec<[f32; 2]> = reader
        .read_tex_coords(0)
        .map(|t| t.into_f32().collect())
        .unwrap_or_default();
    let normal_matrix = Mat3::from_mat4(object_from_node).inverse().transpose();
    let first = mesh.vertices.len() as u32;
    let material = mesh.materials.len() as u32;
    for (i, (position, normal)) in positions.iter().zip(&normals).enumerate() {
        mesh.vertices.push(Vertex {
            position: object_from_node.transform_point3(*position).to_array(),
            object: 0,
            normal: (normal_matrix * *normal).try_normalize().unwrap_or(Vec3::Z).to_array(),
            material,
            uv: uvs.get(i).copied().unwrap_or_default(),
            uv1: [0.0; 2],
            tangent: [1.0, 0.0, 0.0, 1.0],
            color: [1.0; 4],
        });
    }
    mesh.indices
        .extend(indices[..indices.len() / 3 * 3].iter().map(|i| first + i));
    mesh.materials.push(read_material(&primitive.material(), payload)?);
    Ok(())
}

fn check_triangles(positions: &[Vec3], indices: &[u32], before: usize) -> Result<(), String> {
    if let Some(bad) = indices.iter().find(|&&i| i as usize >= positions.len()) {
        return Err(format!("index {bad} with only {} positions", positions.len()));
    }
    if let Some(bad) = positions.iter().position(|p| !p.is_finite()) {
        return Err(format!("position {bad} is not a finite number"));
    }
    if (before + indices.len()) / 3 > MAX_TRIANGLES {
        return Err(format!("more than {MAX_TRIANGLES} triangles"));
    }
    Ok(())
}

/// Normals of the adjoining faces, weighted by their areas.
fn smooth_normals(positions: &[Vec3], indices: &[u32]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; positions.len()];
    for triangle in indices.chunks_exact(3) {
        let [a, b, c] = [triangle[0] as usize, triangle[1] as usize, triangle[2] as usize];
        let area = (positions[b] - positions[a]).cross(positions[c] - positions[a]);
        for corner in [a, b, c] {
            normals[corner] += area;
        }
    }
    normals.iter().map(|n| n.try_normalize().unwrap_or(Vec3::Z)).collect()
}

fn read_material(material: &gltf::Material<'_>, payload: &Payload<'_>) -> Result<Material, String> {
    let pbr = material.pbr_metallic_roughness();
    let [r, g, b, _] = pbr.base_color_factor();
    let ior = material.ior().unwrap_or(1.5);
    if !(ior == 0.0 || (1.0..1e3).contains(&ior)) {
        return Err(format!("an index of refraction of {ior}; it is 1 or more"));
    }
    // 0 stands for a surface that reflects everything (KHR_materials_ior).
    let f0 = material.ior().map_or(0.04, |ior| ((ior - 1.0) / (ior + 1.0)).powi(2));
    let dielectric_f0 = material.specular().map_or([f0; 3], |specular| {
        specular
            .specular_color_factor()
            .map(|c| (f0 * c).min(1.0) * specular.specular_factor())
    });
    let base_color_texture = match pbr.base_color_texture() {
        Some(info) => Some(read_texture(&info.texture(), payload)?),
        None => None,
    };
    Ok(Material {
        base_color: [r, g, b],
        base_color_texture,
        metallic: pbr.metallic_factor(),
        roughness: pbr.roughness_factor(),
        dielectric_f0,
        dielectric_f90: material.specular().map_or(1.0, |specular| specular.specular_factor()),
        transmission: material.transmission().map_or(0.0, |t| t.transmission_factor()),
        ior: ior.max(1.0),
    })
}

fn read_texture(texture: &gltf::Texture<'_>, payload: &Payload<'_>) -> Result<BaseColorTexture, String> {
    use gltf::image::Format;
    let data = payload
        .images
        .get(texture.source().index())
        .ok_or("a texture without its picture")?;
    let rgba = match data.format {
        Format::R8G8B8A8 => data.pixels.clone(),
        Format::R8G8B8 => data
            .pixels
            .chunks_exact(3)
            .flat_map(|p| [p[0], p[1], p[2], 255])
            .collect(),
        Format::R8 => data.pixels.iter().flat_map(|&p| [p, p, p, 255]).collect(),
        other @ (Format::R8G8
        | Format::R16
        | Format::R16G16
        | Format::R16G16B16
        | Format::R16G16B16A16
        | Format::R32G32B32FLOAT
        | Format::R32G32B32A32FLOAT) => {
            return Err(format!(
                "a base colour picture is stored as {other:?}; use 8-bit RGB or RGBA"
            ));
        }
    };
    Ok(BaseColorTexture {
        size_px: [data.width, data.height],
        rgba,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_of_a_flat_triangle_point_up() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y];
        assert_eq!(smooth_normals(&positions, &[0, 1, 2]), vec![Vec3::Z; 3]);
    }

    #[test]
    fn bad_indices_and_positions_are_refused() {
        assert!(
            check_triangles(&[Vec3::ZERO], &[0, 0, 1], 0)
                .unwrap_err()
                .contains("index 1")
        );
        assert!(
            check_triangles(&[Vec3::NAN], &[0, 0, 0], 0)
                .unwrap_err()
                .contains("finite")
        );
        assert!(check_triangles(&[Vec3::ZERO], &[0, 0, 0], 3 * MAX_TRIANGLES).is_err());
    }
}
