//! Lamps of glTF files: the lights of KHR_lights_punctual at the nodes of virtual objects.

use std::path::Path;

use glam::{Mat4, Vec3};
use gltf::khr_lights_punctual::Kind as LightKind;

use super::lamp::{Carrier, Lamp, LampKind};
use super::{MeshUp, gltf_mesh};
use crate::error::RenderError;

/// Which object a glTF file belongs to, and what its candelas are worth.
#[derive(Debug, Clone, Copy)]
pub(super) struct LightsOf<'a> {
    /// The object's name.
    pub(super) object: &'a str,
    /// Its index in the scene.
    pub(super) index: usize,
    /// Which axis of the file points up.
    pub(super) up: MeshUp,
    /// The node that is read, with all below it; `None` for all nodes.
    pub(super) node: Option<&'a str>,
    /// What the object is scaled by: it moves a light and does not change it.
    pub(super) scale: f32,
    /// The rig's units of radiance per candela per square metre.
    pub(super) radiance_per_nit: f32,
}

/// The lights at the nodes of a glTF file that are read, as lamps that move with the object. A lamp is named `object/node`.
///
/// Candelas become radiant intensities, lux irradiances, both by `radiance_per_nit`. `range`, a hint to renderers that cut
/// light off, is not read: light falls with the square of the distance.
///
/// # Errors
/// [`RenderError::Mesh`] for a light that is no finite number or shines along a flattened axis.
pub(super) fn load(file: &Path, of: &LightsOf<'_>) -> Result<Vec<Lamp>, RenderError> {
    let error = |message: String| RenderError::Mesh {
        file: file.to_owned(),
        object: of.object.to_owned(),
        message,
    };
    let bytes = std::fs::read(file).map_err(|source| RenderError::Read {
        file: file.to_owned(),
        source,
    })?;
    let (document, ..) = gltf_mesh::parse(&bytes).map_err(error)?;
    let mut lamps = Vec::new();
    let nodes = gltf_mesh::chosen_nodes(&document, of.up.object_from_file(), of.node).map_err(error)?;
    for (node, object_from_parent) in nodes {
        read_node(&node, object_from_parent, of, &mut lamps).map_err(error)?;
    }
    Ok(lamps)
}

fn read_node(
    node: &gltf::Node<'_>,
    object_from_parent: Mat4,
    of: &LightsOf<'_>,
    lamps: &mut Vec<Lamp>,
) -> Result<(), String> {
    let object_from_node = object_from_parent * Mat4::from_cols_array_2d(&node.transform().matrix());
    if let Some(light) = node.light() {
        let lamp = lamp(node, &light, object_from_node, of)?;
        lamps.extend((lamp.irradiance != Vec3::ZERO).then_some(lamp));
    }
    for child in node.children() {
        read_node(&child, object_from_node, of, lamps)?;
    }
    Ok(())
}

fn lamp(
    node: &gltf::Node<'_>,
    light: &gltf::khr_lights_punctual::Light<'_>,
    object_from_node: Mat4,
    of: &LightsOf<'_>,
) -> Result<Lamp, String> {
    let name = node.name().or_else(|| light.name()).unwrap_or("(unnamed)");
    let irradiance = Vec3::from(light.color()) * light.intensity() * of.radiance_per_nit;
    if !irradiance.is_finite() || irradiance.min_element() < 0.0 {
        return Err(format!(
            "the light of node `{name}` has colour times intensity {irradiance}; it is finite and 0 or more"
        ));
    }
    let direction = object_from_node
        .transform_vector3(Vec3::NEG_Z)
        .try_normalize()
        .ok_or_else(|| format!("the light of node `{name}` shines along an axis that its transform flattens"))?;
    let kind = match light.kind() {
        LightKind::Directional => LampKind::Directional {
            angular_radius_rad: 0.0,
        },
        LightKind::Point => LampKind::Point { radius_m: 0.0 },
        LightKind::Spot {
            inner_cone_angle,
            outer_cone_angle,
        } => LampKind::Spot {
            radius_m: 0.0,
            inner_rad: inner_cone_angle.clamp(0.0, outer_cone_angle.max(0.0)),
            // A cone of half a circle has no edge that could be drawn.
            outer_rad: outer_cone_angle.clamp(1e-3, 1.55),
        },
    };
    Ok(Lamp {
        name: format!("{}/{name}", of.object),
        kind,
        irradiance,
        carrier: Carrier::Object(of.index),
        position_m: of.scale * object_from_node.transform_point3(Vec3::ZERO),
        direction,
        across: direction.any_orthonormal_vector(),
    })
}
