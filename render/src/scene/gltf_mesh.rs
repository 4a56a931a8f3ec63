//! glTF 2.0 files: triangles and physically based materials of an object.

use std::path::{Path, PathBuf};

use bytemuck::{Pod, Zeroable};
use glam::{Mat3, Mat4, Vec3};
use gltf::Document;

use super::entry::listed;
use super::gltf_image::Images;
use super::gltf_material::{KNOWN_EXTENSIONS, MaterialsFile};
use super::material::{Material, Sides};
use super::puppet::Puppet;
use super::skin::{self, Part, Playing, Source};
use super::{MeshUp, animation, gltf_check, gltf_vertices, tangents};
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

/// Nodes that are scaled by less are refused: inverses of their transforms would be beyond what numbers can hold.
const MIN_SCALE: f32 = 1e-9;

/// What is read of a glTF file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Choice<'a> {
    /// The scene file that chooses.
    pub(super) scene_file: &'a Path,
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
    let (document, blob, materials) = parse(&bytes).map_err(|message| place.message(message))?;
    let folder = file.parent();
    let wrong = |field: &'static str, message: String| RenderError::Scene {
        file: choice.scene_file.to_owned(),
        object: object.to_owned(),
        field,
        message: format!("`{}`: {message}", file.display()),
    };
    if let Some(playing) = choice.playing {
        animation::find(&document, &playing.clip).map_err(|message| wrong("animation", message))?;
    }
    let root = choice.up.object_from_file();
    let nodes = chosen_nodes(&document, root, choice.node).map_err(|message| wrong("node", message))?;
    let buffers = gltf::import_buffers(&document, folder, blob).map_err(|e| place.error(&e))?;
    let mut payload = Payload {
        buffers: &buffers,
        images: Images::new(&document, folder, &buffers),
        materials,
    };
    let mut read = Read {
        mesh: Mesh::default(),
        puppet: None,
        parts: Vec::new(),
    };
    for (node, object_from_parent) in nodes {
        read_node(&node, object_from_parent, &place, &mut payload, &mut read)?;
    }
    if read.mesh.indices.is_empty() {
        return Err(place.message("it holds no triangles"));
    }
    let source = Source {
        document: &document,
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
    let Some((document, ..)) = std::fs::read(file).ok().and_then(|bytes| parse(&bytes).ok()) else {
        return Vec::new();
    };
    let buffers = document.buffers().filter_map(|buffer| match buffer.source() {
        gltf::buffer::Source::Uri(uri) => Some(uri.to_owned()),
        gltf::buffer::Source::Bin => None,
    });
    let images = document.images().filter_map(|image| match image.source() {
        gltf::image::Source::Uri { uri, .. } => Some(uri.to_owned()),
        gltf::image::Source::View { .. } => None,
    });
    let folder = file.parent().unwrap_or(Path::new("."));
    buffers
        .chain(images)
        .filter(|uri| !uri.starts_with("data:"))
        .filter_map(|uri| match uri.strip_prefix("file:") {
            // As the `gltf` crate reads them, which decodes relative ones only.
            Some(path) => Some(PathBuf::from(path.strip_prefix("//").unwrap_or(path))),
            None => Some(folder.join(&*urlencoding::decode(&uri).ok()?)),
        })
        .collect()
}

/// The nodes that are read with all below them, each with the transform that it stands in.
pub(super) fn chosen_nodes<'a>(
    document: &'a Document,
    root: Mat4,
    name: Option<&str>,
) -> Result<Vec<(gltf::Node<'a>, Mat4)>, String> {
    // The scene to be shown, by glTF 2.0 section 3.5.1; a file without scenes has nothing to show.
    let shown = document.default_scene().or_else(|| document.scenes().next());
    let mut waiting: Vec<(gltf::Node<'a>, Mat4)> = shown
        .as_ref()
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

/// The document, its binary part, and its materials.
pub(super) fn parse(bytes: &[u8]) -> Result<(Document, Option<Vec<u8>>, MaterialsFile), String> {
    let (json, blob) = if bytes.starts_with(b"glTF") {
        let glb = gltf::Glb::from_slice(bytes).map_err(|error| error.to_string())?;
        (glb.json, glb.bin.map(std::borrow::Cow::into_owned))
    } else {
        (bytes.into(), None)
    };
    let mut root: gltf::json::Root =
        gltf::json::deserialize::from_slice(&json).map_err(|error| format!("its JSON: {error}"))?;
    let required = std::mem::take(&mut root.extensions_required);
    if let Some(unknown) = required.iter().find(|name| !KNOWN_EXTENSIONS.contains(&name.as_str())) {
        return Err(format!(
            "it requires the extension `{unknown}`; known are {}",
            KNOWN_EXTENSIONS.join(", ")
        ));
    }
    let materials = serde_json::from_slice(&json).map_err(|error| format!("its materials: {error}"))?;
    let document = Document::from_json(root).map_err(|error| error.to_string())?;
    gltf_check::document(document.as_json())?;
    Ok((document, blob, materials))
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
    images: Images<'a>,
    materials: MaterialsFile,
}

fn read_node(
    node: &gltf::Node<'_>,
    object_from_parent: Mat4,
    place: &Place,
    payload: &mut Payload<'_>,
    read: &mut Read,
) -> Result<(), RenderError> {
    let object_from_node = object_from_parent * Mat4::from_cols_array_2d(&node.transform().matrix());
    let name = node.name().unwrap_or("(unnamed)").to_owned();
    if !object_from_node.is_finite() || flattens(Mat3::from_mat4(object_from_node)) {
        return Err(place.message(format!(
            "node `{name}` has a transform that is not finite, flattens it, or scales it by less than {MIN_SCALE:e}"
        )));
    }
    if let Some(gltf_mesh) = node.mesh() {
        for (index, primitive) in gltf_mesh.primitives().enumerate() {
            let first_vertex = read.mesh.vertices.len();
            let twins = read_primitive(&primitive, object_from_node, payload, &mut read.mesh)
                .map_err(|message| place.message(format!("node `{name}`: {message}")))?;
            read.parts.push(Part {
                node: node.index(),
                primitive: index,
                first_vertex,
                twins,
            });
        }
    }
    for child in node.children() {
        read_node(&child, object_from_node, place, payload, read)?;
    }
    Ok(())
}

/// Whether all sizes along some direction are lost, as far as numbers can tell.
fn flattens(linear: Mat3) -> bool {
    let axes = [linear.x_axis, linear.y_axis, linear.z_axis];
    let [a, b, c] = axes.map(Vec3::normalize_or_zero);
    axes.iter().any(|axis| axis.length() < MIN_SCALE) || a.dot(b.cross(c)).abs() < 1e-6
}

/// Adds a primitive to the mesh; returns of every vertex after one per position which one it is split from.
fn read_primitive(
    primitive: &gltf::Primitive<'_>,
    object_from_node: Mat4,
    payload: &mut Payload<'_>,
    mesh: &mut Mesh,
) -> Result<Vec<u32>, String> {
    if primitive.mode() != gltf::mesh::Mode::Triangles {
        return Err(format!(
            "a primitive is made of {:?}; only triangles are read",
            primitive.mode()
        ));
    }
    let mut material = payload
        .materials
        .material(primitive.material().index(), &mut payload.images)?;
    let mut read = gltf_vertices::read(primitive, payload.buffers)?;
    if (mesh.indices.len() + read.indices.len()) / 3 > MAX_TRIANGLES {
        return Err(format!("more than {MAX_TRIANGLES} triangles"));
    }
    if let Some(missing) = material.uv_sets().find(|&set| !read.has_uv(set)) {
        return Err(format!(
            "a texture goes by `TEXCOORD_{}`, which a primitive lacks",
            missing.index()
        ));
    }
    if read.are_turned() {
        material.sides = Sides::Both;
    }
    read.place(object_from_node, mesh.materials.len() as u32);
    let normals = material.normal.as_ref().or(material.clearcoat.normal.as_ref());
    let twins = match normals {
        Some(map) if !read.has_tangents => tangents::fill(&mut read.vertices, &mut read.indices, |vertex| {
            map.texture.place_of(vertex)
        }),
        Some(_) | None => Vec::new(),
    };
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend(read.vertices);
    mesh.indices.extend(read.indices.iter().map(|i| first + i));
    mesh.materials.push(material);
    Ok(twins)
}
