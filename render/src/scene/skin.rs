//! What a glTF file says about meshes that change their shape, read into a [`Puppet`].

use glam::{Mat3, Mat4, Vec3, Vec4};
use gltf::Semantic;
use gltf::accessor::{DataType, Dimensions};

use super::animation::{Clip, ClipName, Skeleton};
use super::puppet::{Binding, Joint, Morph, Puppet};
use super::{Mesh, PathEnd, gltf_check};

/// Some vertices of the mesh, and where in the file they come from.
#[derive(Debug, Clone)]
pub(super) struct Part {
    pub(super) node: usize,
    /// Its number in the node's mesh.
    pub(super) primitive: usize,
    pub(super) first_vertex: usize,
    /// Vertices that come after one per position of the file: which of those each is split from.
    pub(super) twins: Vec<u32>,
}

/// A file, and what was read of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) document: &'a gltf::Document,
    pub(super) buffers: &'a [gltf::buffer::Data],
    pub(super) object_from_file: Mat4,
    pub(super) mesh: &'a Mesh,
    pub(super) parts: &'a [Part],
}

/// Which animation is played, and how.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Playing {
    pub(super) clip: ClipName,
    /// Seconds of the animation per second.
    pub(super) speed: f64,
    pub(super) end: PathEnd,
}

/// What moves the mesh; `None` for one without skin, morph targets and animation to be played.
///
/// # Errors
/// An animation that the file lacks, skins and targets that do not fit their meshes.
pub(super) fn read(source: Source<'_>, playing: Option<&Playing>) -> Result<Option<Puppet>, String> {
    let nodes: Vec<gltf::Node<'_>> = source.document.nodes().collect();
    let bends = |part: &Part| {
        let has_targets = |mesh: gltf::Mesh<'_>| mesh.primitives().any(|p| p.morph_targets().next().is_some());
        nodes[part.node].skin().is_some() || nodes[part.node].mesh().is_some_and(has_targets)
    };
    if playing.is_none() && !source.parts.iter().any(bends) {
        return Ok(None);
    }
    let clip = playing
        .map(|playing| Clip::read(source.document, source.buffers, &playing.clip))
        .transpose()?;
    let shown = source
        .document
        .default_scene()
        .or_else(|| source.document.scenes().next());
    let skeleton = Skeleton::read(source.document, shown.as_ref());
    let file_from_nodes = skeleton.file_from_nodes(None, 0.0);
    let mut puppet = Puppet {
        skeleton,
        clip,
        speed: playing.map_or(1.0, |playing| playing.speed),
        end: playing.map_or(PathEnd::Repeat, |playing| playing.end),
        object_from_file: source.object_from_file,
        joints: Vec::new(),
        bindings: Vec::with_capacity(source.mesh.vertices.len()),
        morphs: Vec::new(),
        rest: source.mesh.vertices.clone(),
    };
    for part in source.parts {
        let node = &nodes[part.node];
        let object_from_node = source.object_from_file * file_from_nodes[part.node];
        read_part(&source, (part, node), object_from_node, &mut puppet)
            .map_err(|message| format!("node `{}`: {message}", node.name().unwrap_or("(unnamed)")))?;
    }
    Ok(Some(puppet))
}

fn read_part(
    source: &Source<'_>,
    (part, node): (&Part, &gltf::Node<'_>),
    object_from_node: Mat4,
    puppet: &mut Puppet,
) -> Result<(), String> {
    let mesh = node.mesh().ok_or("it has no mesh")?;
    let primitive = mesh.primitives().nth(part.primitive).ok_or("a primitive is missing")?;
    let positions = primitive
        .get(&Semantic::Positions)
        .ok_or("a primitive has no positions")?;
    let n_positions = positions.count();
    let twins = part.twins.iter().map(|&origin| origin as usize);
    let origins: Vec<usize> = (0..n_positions).chain(twins).collect();
    let node_from_rest = object_from_node.inverse();
    let bindings = match node.skin() {
        Some(skin) => read_bindings((&skin, &primitive), source.buffers, node_from_rest, &mut puppet.joints)?,
        None => {
            let first_joint = puppet.joints.len() as u32;
            puppet.joints.push(Joint {
                node: part.node,
                node_from_rest,
            });
            vec![binding([0; 4], [1.0, 0.0, 0.0, 0.0], first_joint); n_positions]
        }
    };
    puppet.bindings.extend(origins.iter().map(|&origin| bindings[origin]));
    let targets = read_targets(&primitive, source.buffers, &origins, object_from_node)?;
    if !targets.is_empty() {
        let weights = node.weights().or_else(|| mesh.weights()).unwrap_or_default();
        puppet.morphs.push(Morph {
            node: part.node,
            first_vertex: part.first_vertex,
            weights: (0..targets.len())
                .map(|i| weights.get(i).copied().unwrap_or(0.0))
                .collect(),
            targets,
        });
    }
    Ok(())
}

/// What the positions of a skinned primitive hang on; the skin's joints come after those that there are.
fn read_bindings(
    (skin, primitive): (&gltf::Skin<'_>, &gltf::Primitive<'_>),
    buffers: &[gltf::buffer::Data],
    node_from_rest: Mat4,
    joints: &mut Vec<Joint>,
) -> Result<Vec<Binding>, String> {
    let first_joint = joints.len() as u32;
    let inverse_binds = inverse_binds(skin, buffers)?;
    joints.extend(skin.joints().zip(inverse_binds).map(|(joint, inverse_bind)| Joint {
        node: joint.index(),
        node_from_rest: inverse_bind * node_from_rest,
    }));
    check_bindings(primitive, buffers)?;
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| &data.0[..]));
    let of_vertices = reader.read_joints(0).ok_or("a skinned primitive has no `JOINTS_0`")?;
    let weights = reader.read_weights(0).ok_or("a skinned primitive has no `WEIGHTS_0`")?;
    let bindings: Vec<Binding> = of_vertices
        .into_u16()
        .zip(weights.into_f32())
        .map(|(joints, weights)| binding(joints, weights, first_joint))
        .collect();
    let n_joints = joints.len() as u32;
    let hangs_on_nothing = |binding: &Binding| {
        let carried = binding.joints.iter().zip(binding.weights.to_array());
        carried
            .filter(|(_, weight)| *weight != 0.0)
            .any(|(&joint, _)| joint >= n_joints)
    };
    if bindings.iter().any(hangs_on_nothing) {
        return Err("a vertex hangs on a joint that its skin lacks".into());
    }
    Ok(bindings)
}

/// What the reader takes for granted (glTF 2.0, 3.7.3.3).
fn check_bindings(primitive: &gltf::Primitive<'_>, buffers: &[gltf::buffer::Data]) -> Result<(), String> {
    use DataType::{F32, U8, U16};
    let n_positions = primitive.get(&Semantic::Positions).map_or(0, |a| a.count());
    for (semantic, types) in [
        (Semantic::Joints(0), &[U8, U16][..]),
        (Semantic::Weights(0), &[F32, U8, U16]),
    ] {
        let name = semantic.to_string();
        let accessor = primitive
            .get(&semantic)
            .ok_or_else(|| format!("a skinned primitive has no `{name}`"))?;
        gltf_check::accessor(&name, &accessor, (&[Dimensions::Vec4], types), buffers)?;
        gltf_check::count(&name, &accessor, n_positions)?;
    }
    Ok(())
}

/// What the reader takes for granted. An accessor without data holds zeros, which it reads as no offsets at all.
fn check_targets(primitive: &gltf::Primitive<'_>, buffers: &[gltf::buffer::Data]) -> Result<(), String> {
    let n_positions = primitive.get(&Semantic::Positions).map_or(0, |a| a.count());
    for target in primitive.morph_targets() {
        for (name, accessor) in [
            ("POSITION of a target", target.positions()),
            ("NORMAL of a target", target.normals()),
            ("TANGENT of a target", target.tangents()),
        ] {
            let Some(accessor) = accessor.filter(|a| a.view().is_some() || a.sparse().is_some()) else {
                continue;
            };
            gltf_check::accessor(name, &accessor, (&[Dimensions::Vec3], &[DataType::F32]), buffers)?;
            gltf_check::count(name, &accessor, n_positions)?;
        }
    }
    Ok(())
}

/// What morph targets add to every vertex, in the object's frame.
fn read_targets(
    primitive: &gltf::Primitive<'_>,
    buffers: &[gltf::buffer::Data],
    origins: &[usize],
    object_from_node: Mat4,
) -> Result<Vec<Vec<[Vec3; 2]>>, String> {
    check_targets(primitive, buffers)?;
    let reader = primitive.reader(|buffer| buffers.get(buffer.index()).map(|data| &data.0[..]));
    let turn = Mat3::from_mat4(object_from_node);
    let targets: Vec<Vec<[Vec3; 2]>> = reader
        .read_morph_targets()
        .map(|(places, normals, _)| {
            let places: Vec<Vec3> = places.into_iter().flatten().map(Vec3::from).collect();
            let normals: Vec<Vec3> = normals.into_iter().flatten().map(Vec3::from).collect();
            let offset = |&origin: &usize| {
                let place = places.get(origin).copied().unwrap_or(Vec3::ZERO);
                let normal = normals.get(origin).copied().unwrap_or(Vec3::ZERO);
                // Normals keep their size: the mesh's own are of unit length in any frame.
                [turn * place, (turn * normal).normalize_or_zero() * normal.length()]
            };
            origins.iter().map(offset).collect()
        })
        .collect();
    if targets.iter().flatten().flatten().any(|offset| !offset.is_finite()) {
        return Err("a morph target has a number that is not finite".into());
    }
    Ok(targets)
}

fn inverse_binds(skin: &gltf::Skin<'_>, buffers: &[gltf::buffer::Data]) -> Result<Vec<Mat4>, String> {
    if let Some(accessor) = skin.inverse_bind_matrices() {
        let allowed = (&[Dimensions::Mat4][..], &[DataType::F32][..]);
        gltf_check::accessor("inverseBindMatrices", &accessor, allowed, buffers)?;
    }
    let reader = skin.reader(|buffer| buffers.get(buffer.index()).map(|data| &data.0[..]));
    let n_joints = skin.joints().count();
    let matrices: Vec<Mat4> = match reader.read_inverse_bind_matrices() {
        Some(matrices) => matrices.map(|m| Mat4::from_cols_array_2d(&m)).collect(),
        None => vec![Mat4::IDENTITY; n_joints],
    };
    if matrices.len() < n_joints || matrices.iter().any(|m| !m.is_finite()) {
        return Err("the inverse bind matrices of its skin are too few or not finite".into());
    }
    Ok(matrices)
}

/// Weights that do not add up to 1 are made to; a vertex without any hangs on its first joint.
fn binding(joints: [u16; 4], weights: [f32; 4], first_joint: u32) -> Binding {
    let weights = Vec4::from(weights).max(Vec4::ZERO);
    let sum = weights.element_sum();
    Binding {
        joints: joints.map(|joint| first_joint + u32::from(joint)),
        weights: if sum > 0.0 && sum.is_finite() {
            weights / sum
        } else {
            Vec4::X
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gltf::buffer::Data;

    /// A strip of four vertices at y = 0, 1, 1 and 2, hung on two bones; the second, at y = 1, is turned a quarter about z in one
    /// second. The first two hang on the first bone, the last on the second, the third half on each; a morph target moves the last vertex by 1 along z.
    fn puppet(playing: Option<&Playing>) -> Result<Option<Puppet>, String> {
        let mut bytes: Vec<u8> = Vec::new();
        let mut views = Vec::new();
        let mut put = |data: Vec<u8>| {
            views.push((bytes.len(), data.len()));
            bytes.extend(data);
            bytes.resize(bytes.len().next_multiple_of(4), 0);
        };
        let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        put(floats(&[0., 0., 0., 0., 1., 0., 0., 1., 0., 0., 2., 0.]));
        put(vec![0u8, 1, 2, 1, 2, 3]);
        put([[0u8, 0, 0, 0], [0, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]].concat());
        put(floats(&[
            1., 0., 0., 0., 1., 0., 0., 0., 0.5, 0.5, 0., 0., 1., 0., 0., 0.,
        ]));
        let identity = Mat4::IDENTITY.to_cols_array();
        let inverse_bind = Mat4::from_translation(Vec3::NEG_Y).to_cols_array();
        put(floats(&[identity, inverse_bind].concat()));
        put(floats(&[0.0, 1.0]));
        let turned = std::f32::consts::FRAC_1_SQRT_2;
        put(floats(&[0., 0., 0., 1., 0., 0., turned, turned]));
        put(floats(&[0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 0., 1.]));
        let views: Vec<String> = views
            .iter()
            .map(|(offset, length)| format!("{{\"buffer\":0,\"byteOffset\":{offset},\"byteLength\":{length}}}"))
            .collect();
        let text = format!(
            "{{\"asset\":{{\"version\":\"2.0\"}},\"scene\":0,\"scenes\":[{{\"nodes\":[0,1]}}],\
             \"nodes\":[{{\"name\":\"strip\",\"mesh\":0,\"skin\":0}},{{\"name\":\"root\",\"children\":[2]}},\
             {{\"name\":\"tip\",\"translation\":[0,1,0]}}],\
             \"skins\":[{{\"joints\":[1,2],\"inverseBindMatrices\":4}}],\
             \"meshes\":[{{\"weights\":[0.5],\"primitives\":[{{\"attributes\":{{\"POSITION\":0,\"JOINTS_0\":2,\"WEIGHTS_0\":3}},\
             \"indices\":1,\"targets\":[{{\"POSITION\":7}}]}}]}}],\
             \"animations\":[{{\"name\":\"bend\",\"samplers\":[{{\"input\":5,\"output\":6}}],\
             \"channels\":[{{\"sampler\":0,\"target\":{{\"node\":2,\"path\":\"rotation\"}}}}]}}],\
             \"accessors\":[\
             {{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[0,2,0]}},\
             {{\"bufferView\":1,\"componentType\":5121,\"count\":6,\"type\":\"SCALAR\"}},\
             {{\"bufferView\":2,\"componentType\":5121,\"count\":4,\"type\":\"VEC4\"}},\
             {{\"bufferView\":3,\"componentType\":5126,\"count\":4,\"type\":\"VEC4\"}},\
             {{\"bufferView\":4,\"componentType\":5126,\"count\":2,\"type\":\"MAT4\"}},\
             {{\"bufferView\":5,\"componentType\":5126,\"count\":2,\"type\":\"SCALAR\",\"min\":[0],\"max\":[1]}},\
             {{\"bufferView\":6,\"componentType\":5126,\"count\":2,\"type\":\"VEC4\"}},\
             {{\"bufferView\":7,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[0,0,1]}}],\
             \"bufferViews\":[{}],\"buffers\":[{{\"byteLength\":{}}}]}}",
            views.join(","),
            bytes.len()
        );
        let parsed = gltf::Gltf::from_slice(text.as_bytes()).expect("the text is valid");
        let mut mesh = Mesh::default();
        for place in [Vec3::ZERO, Vec3::Y, Vec3::Y, 2.0 * Vec3::Y] {
            mesh.vertices.push(super::super::Vertex {
                position: place.to_array(),
                ..super::super::Vertex::PLAIN
            });
        }
        let parts = [Part {
            node: 0,
            primitive: 0,
            first_vertex: 0,
            twins: Vec::new(),
        }];
        let source = Source {
            document: &parsed.document,
            buffers: &[Data(bytes)],
            object_from_file: Mat4::IDENTITY,
            mesh: &mesh,
            parts: &parts,
        };
        read(source, playing)
    }

    fn playing(clip: ClipName) -> Playing {
        Playing {
            clip,
            speed: 1.0,
            end: PathEnd::Stay,
        }
    }

    fn places(puppet: &Puppet, time_s: f64) -> Vec<Vec3> {
        let mut vertices = Vec::new();
        puppet.bend(puppet.clip_s(time_s), &mut vertices);
        vertices.iter().map(|v| Vec3::from(v.position)).collect()
    }

    fn assert_near(found: &[Vec3], expected: &[[f32; 3]]) {
        for (found, expected) in found.iter().zip(expected) {
            assert!(
                found.distance(Vec3::from(*expected)) < 1e-6,
                "{found} instead of {expected:?}"
            );
        }
    }

    #[test]
    fn two_bones_bend_a_strip_as_worked_out_by_hand() {
        let bent = puppet(Some(&playing(ClipName::Name("bend".into())))).unwrap().unwrap();
        // The target's weight of a half lifts the last vertex by a half, before the bones.
        assert_near(
            &places(&bent, 0.0),
            &[[0., 0., 0.], [0., 1., 0.], [0., 1., 0.], [0., 2., 0.5]],
        );
        // A quarter turn about (0, 1): the tip's end goes from (0, 2) to (-1, 1).
        assert_near(
            &places(&bent, 1.0),
            &[[0., 0., 0.], [0., 1., 0.], [0., 1., 0.], [-1., 1., 0.5]],
        );
        let half = std::f32::consts::FRAC_1_SQRT_2;
        assert_near(&places(&bent, 0.5)[3..], &[[-half, 1.0 + half, 0.5]]);
        // It stays at its end.
        assert_eq!(places(&bent, 7.0), places(&bent, 1.0));
    }

    #[test]
    fn a_scaled_puppet_bends_as_the_small_one_does() {
        let small = puppet(Some(&playing(ClipName::Index(0)))).unwrap().unwrap();
        let mut large = small.clone();
        large.scale(3.0);
        for (small, large) in places(&small, 0.7).iter().zip(places(&large, 0.7)) {
            assert!((3.0 * *small).distance(large) < 1e-5, "{small} and {large}");
        }
    }

    #[test]
    fn an_animation_that_is_not_there_is_named_with_those_that_are() {
        let message = puppet(Some(&playing(ClipName::Name("walk".into())))).unwrap_err();
        assert_eq!(message, "it has no animation `walk`; its animations are `bend`");
    }

    #[test]
    fn a_skin_without_an_animation_bends_once() {
        assert!(!puppet(None).unwrap().unwrap().is_animated());
    }
}
