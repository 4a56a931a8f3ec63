//! The `[[object]]` tables of a scene file, and what is allowed in them.

use std::sync::Arc;

use glam::Vec3;
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::Rig;
use serde::Deserialize;

use super::animation::ClipName;
use super::gltf_mesh::Read;
use super::skin::Playing;
use super::{Kind, Material, MeshUp, Motion, Movement, PathEnd, Placement, Puppet};

/// Seconds that an object stays where its moving marker was last seen, unless the scene says otherwise.
const HOLD_S: f64 = 0.5;

/// What is wrong with an object: the key, and a message that says what is allowed.
pub(super) type Complaint = (&'static str, String);

/// One `[[object]]`, as written.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ObjectEntry {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) mesh: String,
    #[serde(default)]
    pub(super) mesh_up: MeshUp,
    pub(super) node: Option<String>,
    pub(super) scale: Option<f32>,
    material: Option<MaterialEntry>,
    #[serde(default = "yes")]
    pub(super) visible: bool,
    world_from_object: Option<[[f64; 4]; 3]>,
    marker: Option<u32>,
    marker_from_object: Option<[[f64; 4]; 3]>,
    #[serde(default)]
    marker_moves: bool,
    hold_s: Option<f64>,
    motion: Option<Motion>,
    animation: Option<AnimationEntry>,
}

/// Which of the file's animations is played.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct AnimationEntry {
    clip: ClipName,
    #[serde(default = "one")]
    speed: f64,
    #[serde(default)]
    end: PathEnd,
}

/// What an object's materials are instead of what the file says.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct MaterialEntry {
    base_color: Option<[f32; 3]>,
    metallic: Option<f32>,
    roughness: Option<f32>,
    ior: Option<f32>,
}

fn yes() -> bool {
    true
}

fn one() -> f64 {
    1.0
}

impl ObjectEntry {
    /// Checks everything that needs no mesh.
    pub(super) fn check(&self) -> Result<(), Complaint> {
        if self.name.is_empty() || self.name.contains(['/', '\\', '\0']) {
            return Err((
                "name",
                "a name is not empty and has no `/`: it becomes a file name".into(),
            ));
        }
        if let Some(scale) = self.scale.filter(|scale| !(1e-6..=1e6).contains(scale)) {
            return Err(("scale", format!("it is `{scale}`; allowed are 1e-6 ..= 1e6")));
        }
        if let Some(animation) = self.animation.as_ref().filter(|a| !(-100.0..=100.0).contains(&a.speed)) {
            let message = format!("`speed` is `{}`; allowed are -100 ..= 100", animation.speed);
            return Err(("animation", message));
        }
        if let Some(motion) = &self.motion {
            motion.check().map_err(|message| ("motion", message))?;
        }
        self.material.map_or(Ok(()), |material| {
            material.check().map_err(|message| ("material", message))
        })
    }

    /// Where the object stands.
    pub(super) fn placement(&self, rig: &Rig) -> Result<Placement, Complaint> {
        let pose = |field: &'static str, rows: &[[f64; 4]; 3]| {
            Pose::from_rows(rows).map_err(|error| (field, error.to_string()))
        };
        match (&self.world_from_object, self.marker) {
            (Some(_), Some(_)) => Err((
                "marker",
                "an object stands either at `world_from_object` or on a `marker`, not both".into(),
            )),
            (_, None) if self.marker_from_object.is_some() => Err(("marker_from_object", "only with `marker`".into())),
            (None, None) => Ok(Placement::World(Pose::identity())),
            (Some(rows), None) => Ok(Placement::World(pose("world_from_object", rows)?)),
            (None, Some(id)) => {
                if rig.marker(id).is_none() {
                    let known = rig.markers.iter().map(|marker| marker.id);
                    return Err((
                        "marker",
                        format!("the rig has no marker `{id}`; it has {}", listed(known)),
                    ));
                }
                let marker_from_object = match &self.marker_from_object {
                    Some(rows) => pose("marker_from_object", rows)?,
                    None => Pose::identity(),
                };
                Ok(Placement::Marker { id, marker_from_object })
            }
        }
    }

    /// How the object moves.
    pub(super) fn movement(&self, rig: &Rig) -> Result<Movement, Complaint> {
        let hold_s = match (self.marker_moves, self.marker) {
            (true, None) => return Err(("marker_moves", "only with `marker`".into())),
            (true, Some(id)) if id == rig.main_marker => {
                return Err((
                    "marker_moves",
                    format!("marker `{id}` is the rig's main marker: it is the world, which does not move"),
                ));
            }
            (true, Some(_)) => Some(self.hold_s.unwrap_or(HOLD_S)),
            (false, _) if self.hold_s.is_some() => return Err(("hold_s", "only with `marker_moves`".into())),
            (false, _) => None,
        };
        if let Some(hold_s) = hold_s.filter(|hold_s| !(0.0..=3600.0).contains(hold_s)) {
            return Err(("hold_s", format!("it is `{hold_s}`; allowed are 0 ..= 3600")));
        }
        Ok(Movement {
            motion: self.motion.clone(),
            hold_s,
            puppet: None,
        })
    }

    /// The animation that is played.
    pub(super) fn playing(&self) -> Option<Playing> {
        self.animation.as_ref().map(|animation| Playing {
            clip: animation.clip.clone(),
            speed: animation.speed,
            end: animation.end,
        })
    }

    /// Makes a mesh what the scene file wants it to be, at the first frame; returns what moves it from then on.
    pub(super) fn adapt(&self, read: &mut Read) -> Result<Option<Arc<Puppet>>, Complaint> {
        let mesh = &mut read.mesh;
        if let Some(scale) = self.scale {
            if let Some(puppet) = &mut read.puppet {
                puppet.scale(scale);
            }
            for vertex in &mut mesh.vertices {
                vertex.position = (scale * Vec3::from(vertex.position)).to_array();
            }
            if mesh.vertices.iter().any(|v| !Vec3::from(v.position).is_finite()) {
                return Err((
                    "scale",
                    format!("`{scale}` takes the mesh beyond what numbers can hold"),
                ));
            }
        }
        if let Some(entry) = &self.material {
            for material in &mut mesh.materials {
                entry.apply(material);
            }
        }
        let Some(puppet) = read.puppet.take() else {
            return Ok(None);
        };
        puppet.bend_first(mesh);
        Ok(puppet.is_animated().then(|| Arc::new(puppet)))
    }
}

impl MaterialEntry {
    fn check(&self) -> Result<(), String> {
        let share = |key: &str, value: Option<f32>| match value {
            Some(value) if !(0.0..=1.0).contains(&value) => Err(format!("`{key}` is `{value}`; allowed are 0 ..= 1")),
            Some(_) | None => Ok(()),
        };
        for channel in self.base_color.iter().flatten() {
            share("base_color", Some(*channel))?;
        }
        share("metallic", self.metallic)?;
        share("roughness", self.roughness)?;
        match self.ior {
            Some(ior) if !(1.0..=10.0).contains(&ior) => Err(format!("`ior` is `{ior}`; allowed are 1 ..= 10")),
            Some(_) | None => Ok(()),
        }
    }

    fn apply(&self, material: &mut Material) {
        if let Some(base_color) = self.base_color {
            material.base_color = base_color;
            material.base_color_texture = None;
        }
        if self.metallic.is_some() || self.roughness.is_some() {
            // It holds both, multiplied with these.
            material.metallic_roughness_texture = None;
        }
        material.metallic = self.metallic.unwrap_or(material.metallic);
        material.roughness = self.roughness.unwrap_or(material.roughness);
        if let Some(ior) = self.ior {
            material.ior = ior;
            // Fresnel's equations at normal incidence, from air.
            material.dielectric_f0 = [((ior - 1.0) / (ior + 1.0)).powi(2); 3];
            material.dielectric_f90 = 1.0;
        }
    }
}

/// Names for a message, each in backticks.
pub(super) fn listed(names: impl IntoIterator<Item = impl std::fmt::Display>) -> String {
    const MAX_LISTED: usize = 12;
    let names: Vec<String> = names.into_iter().map(|name| format!("`{name}`")).collect();
    match names.len() {
        0 => "none".into(),
        n if n > MAX_LISTED => format!("{} and {} more", names[..MAX_LISTED].join(", "), n - MAX_LISTED),
        _ => names.join(", "),
    }
}
