//! Virtual lamps: lights that are not in the room, but shine on virtual and real things alike.
//!
//! A lamp's light is given by what a white surface makes of it, in the radiance units of the rig, so that it can be compared
//! with the room: a lamp with the `white_radiance` of the room's paper is, 1 m away, as bright as the room.

use std::collections::HashSet;
use std::f32::consts::PI;
use std::path::Path;

use glam::{Affine3A, Vec3};
use mirrorball_calib::rig::Rig;
use serde::Deserialize;

use super::entry::listed;
use super::{Object, affine};
use crate::error::RenderError;

/// Most lamps of a scene; those of `shaders/shared/lamp.wgsl`.
pub const MAX_LAMPS: usize = 8;

/// A virtual lamp.
#[derive(Debug, Clone, PartialEq)]
pub struct Lamp {
    /// Name, unique among the scene's lamps.
    pub name: String,
    /// Shape and directions.
    pub kind: LampKind,
    /// Irradiance on a surface that faces the lamp from straight ahead, 1 m away, far more than the lamp is large; of a
    /// directional lamp, at any distance. Linear RGB in the rig's units of radiance times steradians; for a lamp of finite
    /// distance that is its radiant intensity per square metre.
    pub irradiance: Vec3,
    /// What it moves with.
    pub carrier: Carrier,
    /// Its middle in the carrier's frame, metres.
    pub position_m: Vec3,
    /// Unit direction in which it shines, carrier's frame.
    pub direction: Vec3,
    /// Unit direction of a rectangle's first side, perpendicular to `direction`, carrier's frame.
    pub across: Vec3,
}

/// Shape of a lamp and where it shines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LampKind {
    /// A ball that shines in all directions.
    Point {
        /// Its radius, metres; 0 for hard shadows.
        radius_m: f32,
    },
    /// A ball that shines into a cone.
    Spot {
        /// Its radius, metres; 0 for hard shadows.
        radius_m: f32,
        /// Half angle of the cone that it shines into fully, radians.
        inner_rad: f32,
        /// Half angle beyond which it does not shine at all, radians, below π/2.
        outer_rad: f32,
    },
    /// Parallel light from infinitely far away.
    Directional {
        /// Angle under which the radius of its disc is seen, radians, below π/4; 0 for hard shadows.
        angular_radius_rad: f32,
    },
    /// A rectangle, of the same radiance in all directions on the side that it shines to.
    Rectangle {
        /// Half its sides, metres.
        half_m: [f32; 2],
    },
}

/// What a lamp moves with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carrier {
    /// Nothing: it stands in the world.
    World,
    /// A marker of the rig.
    Marker(u32),
    /// An object, by its index in the scene.
    Object(usize),
}

impl LampKind {
    /// Whether its shadows have hard edges.
    #[must_use]
    pub fn is_hard(&self) -> bool {
        match *self {
            Self::Point { radius_m } | Self::Spot { radius_m, .. } => radius_m == 0.0,
            Self::Directional { angular_radius_rad } => angular_radius_rad == 0.0,
            Self::Rectangle { .. } => false,
        }
    }
}

impl Lamp {
    /// Placement of what carries it, world from carrier: markers stand where `rig` says, objects at `placements`.
    #[must_use]
    pub fn world_from_carrier(&self, rig: &Rig, placements: &[Affine3A]) -> Affine3A {
        match self.carrier {
            Carrier::World => Affine3A::IDENTITY,
            Carrier::Marker(id) => rig
                .marker(id)
                .map_or(Affine3A::IDENTITY, |marker| affine(&marker.world_from_marker)),
            Carrier::Object(index) => placements.get(index).copied().unwrap_or(Affine3A::IDENTITY),
        }
    }
}

/// A `[[lamp]]` of a scene file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LampEntry {
    name: String,
    kind: KindName,
    white_radiance: f32,
    color: Option<[f32; 3]>,
    position_m: Option<[f32; 3]>,
    direction: Option<[f32; 3]>,
    across: Option<[f32; 3]>,
    radius_m: Option<f32>,
    angular_radius_deg: Option<f32>,
    inner_deg: Option<f32>,
    outer_deg: Option<f32>,
    half_size_m: Option<[f32; 2]>,
    marker: Option<u32>,
    object: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum KindName {
    Point,
    Spot,
    Directional,
    Rectangle,
}

/// A key of a lamp with what is wrong and what is allowed.
type Wrong = (&'static str, String);

/// The lamps of a scene file.
///
/// # Errors
/// [`RenderError::Lamp`] for a name that is taken, a marker or object that is not there, a key that does not go with the kind,
/// a number out of range.
pub(super) fn read(
    entries: &[LampEntry],
    (file, rig, objects): (&Path, &Rig, &[Object]),
) -> Result<Vec<Lamp>, RenderError> {
    let mut names = HashSet::new();
    let read_one = |entry: &LampEntry| {
        let lamp = if names.insert(entry.name.clone()) {
            lamp(entry, rig, objects)
        } else {
            Err(("name", "two lamps have this name; names are unique".into()))
        };
        lamp.map_err(|(field, message)| RenderError::Lamp {
            file: file.to_owned(),
            lamp: entry.name.clone(),
            field,
            message,
        })
    };
    entries.iter().map(read_one).collect()
}

fn lamp(entry: &LampEntry, rig: &Rig, objects: &[Object]) -> Result<Lamp, Wrong> {
    let color = Vec3::from(entry.color.unwrap_or([1.0; 3]));
    for channel in color.to_array() {
        checked("color", channel, [0.0, 1000.0])?;
    }
    if color == Vec3::ZERO {
        return Err(("color", "it is black; a lamp shines in some channel".into()));
    }
    let white_radiance = checked("white_radiance", entry.white_radiance, [1e-9, 1e9])?;
    let direction = unit("direction", entry.direction.unwrap_or([0.0, 0.0, -1.0]))?;
    let position_m = Vec3::from(entry.position_m.unwrap_or_default());
    if !position_m.is_finite() || position_m.abs().max_element() > 1e3 {
        return Err(("position_m", format!("{position_m} is not within 1000 m")));
    }
    Ok(Lamp {
        name: entry.name.clone(),
        kind: kind(entry)?,
        irradiance: PI * white_radiance * color,
        carrier: carrier(entry, rig, objects)?,
        position_m,
        direction,
        across: across(entry, direction)?,
    })
}

fn kind(entry: &LampEntry) -> Result<LampKind, Wrong> {
    let given = [
        ("radius_m", entry.radius_m.is_some(), "`point` and `spot`"),
        ("inner_deg", entry.inner_deg.is_some(), "`spot`"),
        ("outer_deg", entry.outer_deg.is_some(), "`spot`"),
        (
            "angular_radius_deg",
            entry.angular_radius_deg.is_some(),
            "`directional`",
        ),
        ("half_size_m", entry.half_size_m.is_some(), "`rectangle`"),
        ("across", entry.across.is_some(), "`rectangle`"),
        (
            "position_m",
            entry.position_m.is_some(),
            "`point`, `spot` and `rectangle`",
        ),
    ];
    let allowed: &[&str] = match entry.kind {
        KindName::Point => &["position_m", "radius_m"],
        KindName::Spot => &["position_m", "radius_m", "inner_deg", "outer_deg"],
        KindName::Directional => &["angular_radius_deg"],
        KindName::Rectangle => &["position_m", "half_size_m", "across"],
    };
    for (field, is_given, kinds) in given {
        if is_given && !allowed.contains(&field) {
            return Err((field, format!("only lamps of kind {kinds} have it")));
        }
    }
    let radius_m = checked("radius_m", entry.radius_m.unwrap_or(0.0), [0.0, 100.0])?;
    match entry.kind {
        KindName::Point => Ok(LampKind::Point { radius_m }),
        KindName::Spot => {
            let outer = entry.outer_deg.unwrap_or(45.0);
            let inner = entry.inner_deg.unwrap_or(0.0);
            let outer = checked("outer_deg", outer, [0.1, 89.0])?;
            let inner = checked("inner_deg", inner, [0.0, outer])?;
            Ok(LampKind::Spot {
                radius_m,
                inner_rad: inner.to_radians(),
                outer_rad: outer.to_radians(),
            })
        }
        KindName::Directional => {
            let radius = entry.angular_radius_deg.unwrap_or(0.0);
            Ok(LampKind::Directional {
                angular_radius_rad: checked("angular_radius_deg", radius, [0.0, 45.0])?.to_radians(),
            })
        }
        KindName::Rectangle => {
            let Some([a, b]) = entry.half_size_m else {
                return Err(("half_size_m", "a rectangle needs half its two sides in metres".into()));
            };
            let half = |side| checked("half_size_m", side, [1e-4, 100.0]);
            Ok(LampKind::Rectangle {
                half_m: [half(a)?, half(b)?],
            })
        }
    }
}

fn carrier(entry: &LampEntry, rig: &Rig, objects: &[Object]) -> Result<Carrier, Wrong> {
    match (entry.marker, &entry.object) {
        (None, None) => Ok(Carrier::World),
        (Some(_), Some(_)) => Err((
            "object",
            "a lamp goes with a `marker` or with an `object`, not both".into(),
        )),
        (Some(id), None) if rig.marker(id).is_some() => Ok(Carrier::Marker(id)),
        (Some(id), None) => {
            let known = listed(rig.markers.iter().map(|marker| marker.id));
            Err(("marker", format!("the rig has no marker `{id}`; it has {known}")))
        }
        (None, Some(name)) => objects
            .iter()
            .position(|object| object.name == *name)
            .map(Carrier::Object)
            .ok_or_else(|| {
                let known = listed(objects.iter().map(|object| &object.name));
                ("object", format!("the scene has no object `{name}`; it has {known}"))
            }),
    }
}

/// The first side of a rectangle, made perpendicular to the direction in which it shines.
fn across(entry: &LampEntry, direction: Vec3) -> Result<Vec3, Wrong> {
    let Some(given) = entry.across else {
        return Ok(direction.any_orthonormal_vector());
    };
    let given = unit("across", given)?;
    let across = given - given.dot(direction) * direction;
    if across.length() < 0.05 {
        return Err((
            "across",
            format!("{given} lies along `direction`; a rectangle's side is perpendicular to it"),
        ));
    }
    Ok(across.normalize())
}

fn unit(field: &'static str, vector: [f32; 3]) -> Result<Vec3, Wrong> {
    let vector = Vec3::from(vector);
    vector
        .try_normalize()
        .ok_or_else(|| (field, format!("{vector} has no direction")))
}

fn checked(field: &'static str, value: f32, [low, high]: [f32; 2]) -> Result<f32, Wrong> {
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err((field, format!("{value} is out of range; it is {low} to {high}")))
    }
}
