//! What is known of the phantoms' vertices before the first frame: which hang together, and which the probe sees.

use std::collections::HashMap;

use glam::{Affine3A, Vec3};
use mirrorball_calib::probe::ProbeOptics;

use crate::scene::Kind;
use crate::scene::occluders::Occluders;
use crate::scene_gpu::SceneBuffers;

/// No part of the real things: a virtual object's vertex (`NO_PART` in `shared/scene_vertex.wgsl`).
pub const NO_PART: u32 = u32::MAX;

/// Parts of the real things: vertices of phantoms that triangles or shared places connect.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// Part of every vertex of the scene, [`NO_PART`] for those of virtual objects, and 1 where the probe sees it; never for
    /// objects that move, whose vertices it sees now and then.
    pub facts: Vec<[u32; 2]>,
    /// Vertices, part after part.
    pub members: Vec<u32>,
    /// First and number of every part's vertices in `members`.
    pub ranges: Vec<[u32; 2]>,
}

impl Parts {
    /// The parts of a scene whose objects stand at `placements` (world from object); `occluders` are its phantoms.
    #[must_use]
    pub fn new(scene: &SceneBuffers, placements: &[Affine3A], (occluders, optics): (&Occluders, &ProbeOptics)) -> Self {
        let objects = scene.objects_of_rays();
        let n_vertices = objects.first().map_or(0, |object| object.vertices.len());
        let mut leaders: Vec<u32> = (0..n_vertices as u32).collect();
        let mut is_phantom = vec![false; n_vertices];
        for object in objects.iter().filter(|object| object.kind == Kind::Phantom) {
            let mut at_place: HashMap<[u32; 3], u32> = HashMap::with_capacity(object.indices.len());
            for triangle in object.indices.chunks_exact(3) {
                for &vertex in triangle {
                    is_phantom[vertex as usize] = true;
                    let place = object.vertices[vertex as usize].position.map(f32::to_bits);
                    let welded = *at_place.entry(place).or_insert(vertex);
                    join(&mut leaders, vertex, welded);
                    join(&mut leaders, vertex, triangle[0]);
                }
            }
        }
        let mut parts: HashMap<u32, u32> = HashMap::new();
        let mut facts = vec![[NO_PART, 0]; n_vertices.max(1)];
        let mut members: Vec<Vec<u32>> = Vec::new();
        for vertex in (0..n_vertices as u32).filter(|&v| is_phantom[v as usize]) {
            let part = *parts.entry(leader(&mut leaders, vertex)).or_insert_with(|| {
                members.push(Vec::new());
                members.len() as u32 - 1
            });
            members[part as usize].push(vertex);
            let kept = &objects[0].vertices[vertex as usize];
            let world_from_object = placements.get(kept.object as usize).copied().unwrap_or_default();
            let place = world_from_object.transform_point3(Vec3::from(kept.position));
            let normal = world_from_object.transform_vector3(Vec3::from(kept.normal));
            let is_seen = !scene.moves(kept.object as usize) && is_seen(optics, occluders, (place, normal));
            facts[vertex as usize] = [part, u32::from(is_seen)];
        }
        let mut first = 0;
        let ranges = members
            .iter()
            .map(|of_part| {
                first += of_part.len() as u32;
                [first - of_part.len() as u32, of_part.len() as u32]
            })
            .collect();
        Self {
            facts,
            members: members.concat(),
            ranges,
        }
    }
}

/// Whether the probe sees a place with a normal (world, metres) past the phantoms; its own body is no obstacle.
fn is_seen(optics: &ProbeOptics, occluders: &Occluders, (place, normal): (Vec3, Vec3)) -> bool {
    /// A fisheye's housing is taken to reach so far around its lens, metres.
    const HOUSING_M: f32 = 0.05;
    /// Share of the ball's radius that is the ball, its phantom being a mesh.
    const BALL: f32 = 1.05;
    let radius_m = match optics {
        ProbeOptics::MirrorBall { ball, .. } => BALL * ball.radius_m as f32,
        ProbeOptics::Fisheye { .. } => HOUSING_M,
    };
    let to_probe = optics.position_m() - place;
    let distance_m = to_probe.length();
    if distance_m <= radius_m || normal.dot(to_probe) <= 0.0 {
        return false;
    }
    occluders
        .distance_m(place, to_probe / distance_m, 1e-3)
        .is_none_or(|hit_m| hit_m >= distance_m - radius_m)
}

fn leader(leaders: &mut [u32], vertex: u32) -> u32 {
    let mut at = vertex;
    while leaders[at as usize] != at {
        // Halves the way for whoever comes next (Tarjan and van Leeuwen 1984).
        leaders[at as usize] = leaders[leaders[at as usize] as usize];
        at = leaders[at as usize];
    }
    at
}

fn join(leaders: &mut [u32], a: u32, b: u32) {
    let (a, b) = (leader(leaders, a), leader(leaders, b));
    leaders[a.max(b) as usize] = a.min(b);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joined_vertices_have_one_leader() {
        let mut leaders: Vec<u32> = (0..6).collect();
        join(&mut leaders, 4, 2);
        join(&mut leaders, 5, 4);
        join(&mut leaders, 0, 1);
        let found: Vec<u32> = (0..6).map(|v| leader(&mut leaders, v)).collect();
        assert_eq!(found, [0, 0, 2, 3, 2, 2]);
    }
}
