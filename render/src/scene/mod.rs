//! The scene file: which objects there are, virtual and real, and where they stand.

mod animation;
mod entry;
mod gltf_check;
mod gltf_image;
mod gltf_lights;
mod gltf_material;
mod gltf_mesh;
mod gltf_vertices;
pub mod lamp;
mod lens_mesh;
pub mod material;
mod motion;
pub mod occluders;
mod puppet;
mod skin;
mod soundness;
mod tangents;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{Affine3A, Mat3, Mat3A, Mat4, Vec3, Vec3A};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Rig;
use serde::Deserialize;

pub use gltf_mesh::{Mesh, Vertex};
pub use lamp::{Carrier, Lamp, LampKind, MAX_LAMPS};
pub use lens_mesh::{Split, split, subdivided};
pub use material::Material;
pub use motion::{Motion, PathEnd, Waypoint};
pub use puppet::Puppet;

use crate::error::RenderError;
use entry::{Complaint, ObjectEntry};
use gltf_mesh::Choice;

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

/// What moves an object.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Movement {
    /// It moves by itself.
    pub motion: Option<Motion>,
    /// Its marker moves, and is looked for in every picture. When it is not seen the object stays for so many seconds,
    /// then it is gone until the marker is seen again. `None`: the marker stands where the rig says.
    pub hold_s: Option<f64>,
    /// Its mesh changes its shape.
    pub puppet: Option<Arc<Puppet>>,
}

impl Movement {
    /// Whether the object may be elsewhere from one frame to the next.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.motion.is_some() || self.hold_s.is_some() || self.puppet.is_some()
    }
}

/// Placement of an object that is not there: all its points fall together, so that nothing is drawn, and rays and shadows
/// leave it out.
pub const GONE: Affine3A = Affine3A {
    matrix3: Mat3A::ZERO,
    translation: Vec3A::ZERO,
};

/// One object of the scene.
#[derive(Debug, Clone)]
pub struct Object {
    /// Name, unique in the scene.
    pub name: String,
    /// Virtual or phantom.
    pub kind: Kind,
    /// Where it stands.
    pub placement: Placement,
    /// How it moves from there.
    pub movement: Movement,
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

/// Largest of it.
const MAX_RADIANCE_PER_NIT: f32 = 1e6;

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
    /// A file that cannot be read or parsed, an unknown key, a value out of its range, a version other than 1, a duplicate
    /// name, an object with two placements, a marker that the rig lacks, a matrix that is no rigid transform, an unusable
    /// mesh, a node that the file lacks.
    pub fn load(file: &Path, rig: &Rig) -> Result<Self, RenderError> {
        let text = std::fs::read_to_string(file).map_err(|source| RenderError::Read {
            file: file.to_owned(),
            source,
        })?;
        let config_error = |message: String| RenderError::Config {
            file: file.to_owned(),
            message,
        };
        let mut parsed: SceneFile = toml::from_str(&text).map_err(|error| config_error(error.to_string()))?;
        if parsed.version != 1 {
            return Err(config_error(format!(
                "`version` is {}; this program reads version 1",
                parsed.version
            )));
        }
        parsed.objects.retain(|entry| entry.visible);
        let mut names = HashSet::new();
        let folder = file.parent().unwrap_or(Path::new("."));
        let mut objects = Vec::with_capacity(parsed.objects.len());
        for entry in &parsed.objects {
            let scene_error = |(field, message)| RenderError::Scene {
                file: file.to_owned(),
                object: entry.name.clone(),
                field,
                message,
            };
            if !names.insert(entry.name.clone()) {
                return Err(scene_error((
                    "name",
                    "two objects have this name; names are unique".into(),
                )));
            }
            entry.check().map_err(scene_error)?;
            let placement = entry.placement(rig).map_err(scene_error)?;
            let mut movement = entry.movement(rig).map_err(scene_error)?;
            let mesh_file = folder.join(&entry.mesh);
            let playing = entry.playing();
            let choice = Choice {
                scene_file: file,
                up: entry.mesh_up,
                node: entry.node.as_deref(),
                playing: playing.as_ref(),
            };
            let mut read = gltf_mesh::load(&mesh_file, &entry.name, choice)?;
            movement.puppet = entry.adapt(&mut read).map_err(scene_error)?;
            let mesh = read.mesh;
            let object = Object {
                name: entry.name.clone(),
                kind: entry.kind,
                placement,
                movement,
                file: mesh_file,
                mesh,
            };
            check_marker(&object, &objects).map_err(scene_error)?;
            soundness::check_beside(&object, &objects).map_err(scene_error)?;
            objects.push(object);
        }
        let mut lamps = lamp::read(&parsed.lamps, (file, rig, &objects))?;
        lamps.extend(gltf_lamps(&parsed, &objects, file)?);
        if lamps.len() > MAX_LAMPS {
            let (found, limit) = (lamps.len(), MAX_LAMPS);
            return Err(config_error(RenderError::TooManyLamps { found, limit }.to_string()));
        }
        Ok(Self { objects, lamps })
    }

    /// What looks wrong in the scene and works all the same, one sentence each.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        soundness::warnings(self)
    }

    /// The mesh files that a scene file names, with those that they name in turn, each once, whether the scene can be used or
    /// not. What cannot be read names nothing.
    #[must_use]
    pub fn files(file: &Path) -> Vec<PathBuf> {
        let text = std::fs::read_to_string(file).unwrap_or_default();
        let entries = toml::from_str(&text).map_or(Vec::new(), |parsed: SceneFile| parsed.objects);
        let folder = file.parent().unwrap_or(Path::new("."));
        let mut files: Vec<PathBuf> = Vec::new();
        for entry in entries.iter().filter(|entry| entry.visible) {
            let mesh_file = folder.join(&entry.mesh);
            if !files.contains(&mesh_file) {
                let beside = gltf_mesh::files_beside(&mesh_file);
                files.push(mesh_file);
                files.extend(beside);
            }
        }
        files
    }

    /// Ids of the markers that move, each once.
    #[must_use]
    pub fn moving_markers(&self) -> Vec<u32> {
        let mut ids = Vec::new();
        for object in &self.objects {
            if let (Placement::Marker { id, .. }, Some(_)) = (object.placement, object.movement.hold_s)
                && !ids.contains(&id)
            {
                ids.push(id);
            }
        }
        ids
    }

    /// Longest time, seconds, that any object on a moving marker stays when the marker is not seen; 0 where there is none.
    #[must_use]
    pub fn longest_hold_s(&self, marker: u32) -> f64 {
        let on_it = |object: &&Object| matches!(object.placement, Placement::Marker { id, .. } if id == marker);
        let holds = self
            .objects
            .iter()
            .filter(on_it)
            .filter_map(|object| object.movement.hold_s);
        holds.fold(0.0, f64::max)
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
    /// Placement in the world at the first frame, the markers standing where the rig file says.
    #[must_use]
    pub fn world_from_object(&self, rig: &Rig) -> Affine3A {
        let start = self
            .movement
            .motion
            .as_ref()
            .map(|motion| motion.placement_from_object(0.0));
        self.world_from_placement(rig) * start.unwrap_or(Affine3A::IDENTITY)
    }

    /// The frame that the object's motion is relative to, the markers standing where the rig file says.
    #[must_use]
    pub fn world_from_placement(&self, rig: &Rig) -> Affine3A {
        let pose = match self.placement {
            Placement::World(pose) => pose,
            Placement::Marker { id, marker_from_object } => rig.marker(id).map_or(marker_from_object, |marker| {
                marker.world_from_marker * marker_from_object
            }),
        };
        affine(&pose)
    }

    /// Middle of the bounding box in the world at the first frame, and the radius of the sphere around it, in metres.
    #[must_use]
    pub fn bounding_sphere(&self, rig: &Rig) -> (Vec3, f32) {
        let positions = self.mesh.vertices.iter().map(|v| Vec3::from(v.position));
        bounding_sphere(positions, &self.world_from_object(rig))
    }
}

/// Middle of the bounding box in the world of points in an object's frame, and the radius of the sphere around it, metres.
#[must_use]
pub fn bounding_sphere(points: impl Iterator<Item = Vec3> + Clone, world_from_object: &Affine3A) -> (Vec3, f32) {
    let placed = points.map(|point| world_from_object.transform_point3(point));
    let (low, high) = placed
        .clone()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    let center = 0.5 * (low + high);
    (center, placed.map(|p| p.distance(center)).fold(0.0, f32::max))
}

/// The same rigid transform in single precision, as the GPU takes it.
#[must_use]
pub fn affine(pose: &Pose) -> Affine3A {
    let rows = pose.to_rows4();
    let row = |i: usize| glam::DVec4::from_array(rows[i]);
    let matrix = glam::DMat4::from_cols(row(0), row(1), row(2), row(3)).transpose();
    Affine3A::from_mat4(matrix.as_mat4())
}

/// Refuses an object that takes its marker to stand still where one before takes it to move, or the other way round.
fn check_marker(object: &Object, before: &[Object]) -> Result<(), Complaint> {
    let marker = |object: &Object| match object.placement {
        Placement::Marker { id, .. } => Some((id, object.movement.hold_s.is_some())),
        Placement::World(_) => None,
    };
    let Some((id, moves)) = marker(object) else {
        return Ok(());
    };
    match before.iter().find(|other| marker(other) == Some((id, !moves))) {
        Some(other) => Err((
            "marker_moves",
            format!(
                "it is `{moves}`, and `{}` for object `{}` on the same marker `{id}`; a marker moves for all its objects or for none",
                !moves, other.name
            ),
        )),
        None => Ok(()),
    }
}

/// The lights in the glTF files of the virtual objects.
fn gltf_lamps(parsed: &SceneFile, objects: &[Object], file: &Path) -> Result<Vec<Lamp>, RenderError> {
    let radiance_per_nit = parsed.radiance_per_nit.unwrap_or(RADIANCE_PER_NIT);
    if !(radiance_per_nit > 0.0 && radiance_per_nit <= MAX_RADIANCE_PER_NIT) {
        return Err(RenderError::Config {
            file: file.to_owned(),
            message: format!(
                "`radiance_per_nit` is {radiance_per_nit}; it is above 0 and at most {MAX_RADIANCE_PER_NIT}"
            ),
        });
    }
    let mut lamps = Vec::new();
    for (index, (entry, object)) in parsed.objects.iter().zip(objects).enumerate() {
        if object.kind == Kind::Virtual {
            let of = gltf_lights::LightsOf {
                object: &object.name,
                index,
                up: entry.mesh_up,
                node: entry.node.as_deref(),
                scale: entry.scale.unwrap_or(1.0),
                radiance_per_nit,
            };
            lamps.extend(gltf_lights::load(&object.file, &of)?);
        }
    }
    Ok(lamps)
}
