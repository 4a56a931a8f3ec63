//! Meshes that change their shape: on animated nodes, on the joints of a skin, by morph targets (glTF 2.0, sections 3.7.2.2
//! and 3.7.3).

use glam::{Mat3, Mat4, Vec3, Vec4};

use super::animation::{Clip, Skeleton};
use super::{Mesh, Vertex};

/// An object's mesh with what moves it.
#[derive(Debug, Clone, PartialEq)]
pub struct Puppet {
    pub(super) skeleton: Skeleton,
    pub(super) clip: Option<Clip>,
    /// Seconds of the animation per second.
    pub(super) speed: f64,
    pub(super) end: super::PathEnd,
    /// The object's frame, from the file's.
    pub(super) object_from_file: Mat4,
    pub(super) joints: Vec<Joint>,
    /// One per vertex of the mesh.
    pub(super) bindings: Vec<Binding>,
    pub(super) morphs: Vec<Morph>,
    /// The mesh's vertices with all nodes at rest, as its file places them without a skin.
    pub(super) rest: Vec<Vertex>,
}

/// A node that vertices hang on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Joint {
    pub(super) node: usize,
    /// From [`Puppet::rest`] to the node's own frame.
    pub(super) node_from_rest: Mat4,
}

/// Which joints carry a vertex, and by how much; the weights add up to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Binding {
    pub(super) joints: [u32; 4],
    pub(super) weights: Vec4,
}

/// Shapes that some vertices take on.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Morph {
    pub(super) node: usize,
    pub(super) first_vertex: usize,
    /// Weights without an animation of them.
    pub(super) weights: Vec<f32>,
    /// Per target and vertex what is added to position and normal, as [`Puppet::rest`] has them.
    pub(super) targets: Vec<Vec<[Vec3; 2]>>,
}

impl Puppet {
    /// Whether it changes with time; one that does not is only bent once.
    pub(super) fn is_animated(&self) -> bool {
        self.clip.is_some()
    }

    /// Seconds into the animation, `time_s` seconds after the first frame.
    #[must_use]
    pub fn clip_s(&self, time_s: f64) -> f32 {
        let duration_s = f64::from(self.clip.as_ref().map_or(0.0, Clip::duration_s));
        if duration_s <= 0.0 {
            return 0.0;
        }
        let played_s = time_s * self.speed;
        (match self.end {
            // Backwards it starts at its end.
            super::PathEnd::Repeat => played_s.rem_euclid(duration_s),
            super::PathEnd::Stay if self.speed < 0.0 => (duration_s + played_s).max(0.0),
            super::PathEnd::Stay => played_s.min(duration_s),
        }) as f32
    }

    /// The mesh's vertices `clip_s` seconds into the animation, in the object's frame; `out` keeps its memory.
    pub fn bend(&self, clip_s: f32, out: &mut Vec<Vertex>) {
        out.clone_from(&self.rest);
        for morph in &self.morphs {
            self.morph(morph, clip_s, out);
        }
        let file_from_nodes = self.skeleton.file_from_nodes(self.clip.as_ref(), clip_s);
        let object_from_rest: Vec<Mat4> = self
            .joints
            .iter()
            .map(|joint| self.object_from_file * file_from_nodes[joint.node] * joint.node_from_rest)
            .collect();
        for (vertex, binding) in out.iter_mut().zip(&self.bindings) {
            carry(vertex, binding, &object_from_rest);
        }
    }

    fn morph(&self, morph: &Morph, clip_s: f32, vertices: &mut [Vertex]) {
        let mut weights = morph.weights.clone();
        if let Some(clip) = &self.clip {
            clip.set_weights(morph.node, clip_s, &mut weights);
        }
        for (target, &weight) in morph.targets.iter().zip(&weights).filter(|(_, weight)| **weight != 0.0) {
            for (vertex, &[place, normal]) in vertices[morph.first_vertex..].iter_mut().zip(target) {
                vertex.position = (Vec3::from(vertex.position) + weight * place).to_array();
                vertex.normal = (Vec3::from(vertex.normal) + weight * normal).to_array();
            }
        }
    }

    /// The same, larger by a factor.
    pub(super) fn scale(&mut self, factor: f32) {
        let grow = Mat4::from_scale(Vec3::splat(factor));
        let shrink = Mat4::from_scale(Vec3::splat(1.0 / factor));
        self.object_from_file = grow * self.object_from_file;
        for joint in &mut self.joints {
            joint.node_from_rest *= shrink;
        }
        for vertex in &mut self.rest {
            vertex.position = vertex.position.map(|x| factor * x);
        }
        for offset in self
            .morphs
            .iter_mut()
            .flat_map(|morph| morph.targets.iter_mut().flatten())
        {
            offset[0] *= factor;
        }
    }

    /// Bends a mesh as it is at the first frame.
    pub(super) fn bend_first(&self, mesh: &mut Mesh) {
        self.bend(self.clip_s(0.0), &mut mesh.vertices);
    }
}

/// Moves a vertex by the mean of its joints' transforms.
fn carry(vertex: &mut Vertex, binding: &Binding, object_from_rest: &[Mat4]) {
    let mut mean = Mat4::ZERO;
    for (joint, weight) in binding.joints.iter().zip(binding.weights.to_array()) {
        if weight != 0.0 {
            mean += object_from_rest[*joint as usize] * weight;
        }
    }
    vertex.position = mean.transform_point3(Vec3::from(vertex.position)).to_array();
    let turn = Mat3::from_mat4(mean);
    // Normals go by the cofactors, which are the transposed inverse but for a factor and need no division.
    let [a, b, c] = [turn.x_axis, turn.y_axis, turn.z_axis];
    let cofactors = Mat3::from_cols(b.cross(c), c.cross(a), a.cross(b)) * turn.determinant().signum();
    let normal = cofactors * Vec3::from(vertex.normal);
    vertex.normal = normal.try_normalize().unwrap_or(Vec3::from(vertex.normal)).to_array();
    let tangent = turn * Vec3::from_slice(&vertex.tangent[..3]);
    if let Some(tangent) = tangent.try_normalize() {
        vertex.tangent[..3].copy_from_slice(&tangent.to_array());
    }
}
