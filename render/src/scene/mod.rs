//! The scene file: which objects there are, virtual and real, and where they stand.

mod gltf_image;
mod gltf_lights;
mod gltf_material;
mod gltf_mesh;
mod gltf_vertices;
pub mod lamp;
mod lens_mesh;
pub mod material;
pub mod occluders;
mod tangents;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::{Affine3A, Mat3, Mat4, Vec3};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Rig;
use serde::Deserialize;

pub use gltf_mesh::{Mesh, Vertex};
pub use lamp::{Carrier, Lamp, LampKind, MAX_LAMPS};
pub use lens_mesh::subdivided;
pub use material::Material;

use crate::error::RenderError;

/// Whether an object is drawn or stands for a real thing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Drawn into the picture.
    Virtual,
    /// A real thing: never drawn; hides virtual objects, receives and casts shadows.
    Phantom,
}

/// Where an object stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Placement {
    /// Fixed in the world.
    World(Pose),
    /// On a marker of the rig.
    Marker {
        /// The marker's id.
        id: u32,
        /// Placement relative to the marker.
        marker_from_object: Pose,
    },
}

/// One object of the scene.
#[derive(Debug, Clone)]
pub struct Object {
    /// Name, unique in the scene.
    pub name: String,
    /// Virtual or phantom.
    pub kind: Kind,
    /// Where it stands.
    pub placement: Placement,
    /// The glTF file that it came from.
    pub file: PathBuf,
    /// Its triangles in the object's frame, z up, metres.
    pub mesh: Mesh,
}

/// All objects of a scene file.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Objects in the order of the file.
    pub objects: Vec<Object>,
    /// Virtual lamps: those of the file, then those of the objects' glTF files.
    pub lamps: Vec<Lamp>,
}

/// The rig's units of radiance per candela per square metre, where a scene does not say: paper under a desk lamp, 100 cd/m²,
/// then has radiance 1.
const RADIANCE_PER_NIT: f32 = 0.01;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    version: u32,
    radiance_per_nit: Option<f32>,
    #[serde(default, rename = "object")]
    objects: Vec<ObjectEntry>,
    #[serde(default, rename = "lamp")]
    lamps: Vec<lamp::LampEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ObjectEntry {
    name: String,
    kind: Kind,
    mesh: String,
    #[serde(default)]
    mesh_up: MeshUp,
    world_from_object: Option<[[f64; 4]; 3]>,
    marker: Option<u32>,
    marker_from_object: Option<[[f64; 4]; 3]>,
}

/// Which axis of the mesh file points up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MeshUp {
    /// glTF's own: +y of the file becomes +z of the object.
    #[default]
    Y,
    /// Axes as they are.
    Z,
}

impl MeshUp {
    /// The file's axes to the object's.
    fn object_from_file(self) -> Mat4 {
        match self {
            Self::Z => Mat4::IDENTITY,
            // +y of the file becomes +z: a quarter turn about x.
            Self::Y => Mat4::from_mat3(Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::NEG_Y)),
        }
    }
}

impl Scene {
    /// Reads a scene file and the meshes beside it.
    ///
    /// # Errors
    /// A file that cannot be read or parsed, an unknown key, a version other than 1, a duplicate name, an object with two
    /// placements, a marker that the rig lacks, a matrix that is no rigid transform, an unusable mesh.
    pub fn load(file: &Path, rig: &Rig) -> Result<Self, RenderError> {
        let text = std::fs::read_to_string(file).map_err(|source| RenderError::Read {
            file: file.to_owned(),
            source,
        })?;
        let config_error = |message: String| RenderError::Config {
            file: file.to_owned(),
            message,
        };
        let parsed: SceneFile = toml::from_str(&text).map_err(|error| config_error(error.to_string()))?;
        if parsed.version != 1 {
            return Err(config_error(format!(
                "`version` is {}; this program reads version 1",
                parsed.version
            )));
        }
        let mut names = HashSet::new();
        let folder = file.parent().unwrap_or(Path::new("."));
        let mut objects = Vec::with_capacity(parsed.objects.len());
        for entry in &parsed.objects {
            let scene_error = |field, message| RenderError::Scene {
                file: file.to_owned(),
                object: entry.name.clone(),
                field,
                message,
            };
            if !names.insert(entry.name.clone()) {
                return Err(scene_error(
                    "name",
                    "two objects have this name; names are unique".into(),
                ));
            }
            if entry.name.is_empty() || entry.name.contains(['/', '\\', '\0']) {
                return Err(scene_error(
                    "name",
                    "a name is not empty and has no `/`: it becomes a file name".into(),
                ));
            }
            let placement = placement(entry, rig).map_err(|(field, message)| scene_error(field, message))?;
            let file = folder.join(&entry.mesh);
            let mesh = gltf_mesh::load(&file, &entry.name, entry.mesh_up)?;
            objects.push(Object {
                name: entry.name.clone(),
                kind: entry.kind,
                placement,
                file,
                mesh,
            });
        }
        let mut lamps = lamp::read(&parsed.lamps, (file, rig, &objects))?;
        lamps.extend(gltf_lamps(&parsed, &objects, file)?);
        Ok(Self { objects, lamps })
    }

    /// The virtual objects with their indices in [`Scene::objects`].
    pub fn virtual_objects(&self) -> impl Iterator<Item = (usize, &Object)> {
        self.objects
            .iter()
            .enumerate()
            .filter(|(_, object)| object.kind == Kind::Virtual)
    }
}

impl Object {
    /// Placement in the world, the markers standing where the rig file says.
    #[must_use]
    pub fn world_from_object(&self, rig: &Rig) -> Affine3A {
        let pose = match self.placement {
            Placement::World(pose) => pose,
            Placement::Marker { id, marker_from_object } => rig.marker(id).map_or(marker_from_object, |marker| {
                marker.world_from_marker * marker_from_object
            }),
        };
        affine(&pose)
    }

    /// Middle of the bounding box in the world, and the radius of the sphere around it, in metres.
    #[must_use]
    pub fn bounding_sphere(&self, rig: &Rig) -> (Vec3, f32) {
        let world_from_object = self.world_from_object(rig);
        let points = self
            .mesh
            .vertices
            .iter()
            .map(|v| world_from_object.transform_point3(Vec3::from(v.position)));
        let (low, high) = points.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
        let center = 0.5 * (low + high);
        let radius = self
            .mesh
            .vertices
            .iter()
            .map(|v| {
                world_from_object
                    .transform_point3(Vec3::from(v.position))
                    .distance(center)
            })
            .fold(0.0, f32::max);
        (center, radius)
    }
}

/// The same rigid transform in single precision, as the GPU takes it.
#[must_use]
pub fn affine(pose: &Pose) -> Affine3A {
    let rows = pose.to_rows4();
    let row = |i: usize| glam::DVec4::from_array(rows[i]);
    let matrix = glam::DMat4::from_cols(row(0), row(1), row(2), row(3)).transpose();
    Affine3A::from_mat4(matrix.as_mat4())
}

/// The lights in the glTF files of the virtual objects.
fn gltf_lamps(parsed: &SceneFile, objects: &[Object], file: &Path) -> Result<Vec<Lamp>, RenderError> {
    let radiance_per_nit = parsed.radiance_per_nit.unwrap_or(RADIANCE_PER_NIT);
    if !(radiance_per_nit > 0.0 && radiance_per_nit.is_finite()) {
        return Err(RenderError::Config {
            file: file.to_owned(),
            message: format!("`radiance_per_nit` is {radiance_per_nit}; it is above 0"),
        });
    }
    let mut lamps = Vec::new();
    for (index, (entry, object)) in parsed.objects.iter().zip(objects).enumerate() {
        if object.kind == Kind::Virtual {
            let of = gltf_lights::LightsOf {
                object: &object.name,
                index,
                up: entry.mesh_up,
                radiance_per_nit,
            };
            lamps.extend(gltf_lights::load(&object.file, &of)?);
        }
    }
    Ok(lamps)
}

fn placement(entry: &ObjectEntry, rig: &Rig) -> Result<Placement, (&'static str, String)> {
    let pose =
        |field: &'static str, rows: &[[f64; 4]; 3]| Pose::from_rows(rows).map_err(|error| (field, error.to_string()));
    match (&entry.world_from_object, entry.marker) {
        (Some(_), Some(_)) => Err((
            "marker",
            "an object stands either at `world_from_object` or on a `marker`, not both".into(),
        )),
        (_, None) if entry.marker_from_object.is_some() => Err(("marker_from_object", "only with `marker`".into())),
        (None, None) => Ok(Placement::World(Pose::identity())),
        (Some(rows), None) => Ok(Placement::World(pose("world_from_object", rows)?)),
        (None, Some(id)) => {
            if rig.marker(id).is_none() {
                return Err(("marker", format!("the rig has no marker `{id}`")));
            }
            let marker_from_object = match &entry.marker_from_object {
                Some(rows) => pose("marker_from_object", rows)?,
                None => Pose::identity(),
            };
            Ok(Placement::Marker { id, marker_from_object })
        }
    }
}
