//! A scene of grey blocks on a floor, for the tests of shadow methods.

use std::path::PathBuf;

use glam::{Affine3A, Vec3};
use mirrorball_calib::pose::Pose;
use mirrorball_render::scene::{Kind, Material, Mesh, Movement, Object, Placement, Scene, Vertex};

/// A closed box with outward normals between two corners, metres.
pub(crate) fn block(low: Vec3, high: Vec3) -> Mesh {
    let mut mesh = Mesh {
        materials: vec![grey()],
        ..Mesh::default()
    };
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    for axis in 0..3 {
        for sign in [-1.0f32, 1.0] {
            let mut normal = Vec3::ZERO;
            normal[axis] = sign;
            let mut u = Vec3::ZERO;
            u[(axis + 1) % 3] = 1.0;
            let v = normal.cross(u);
            push_quad(
                &mut mesh,
                [-u - v, u - v, u + v, -u + v].map(|corner| middle + half * (normal + corner)),
            );
        }
    }
    mesh
}

/// A square floor of edge `edge_m` at z = 0, seen from above.
pub(crate) fn floor(edge_m: f32) -> Mesh {
    let h = 0.5 * edge_m;
    let mut mesh = Mesh {
        materials: vec![grey()],
        ..Mesh::default()
    };
    let corners = [[-h, -h], [h, -h], [h, h], [-h, h]].map(|[x, y]| Vec3::new(x, y, 0.0));
    push_quad(&mut mesh, corners);
    mesh
}

/// Four corners, counterclockwise seen from outside.
pub(crate) fn push_quad(mesh: &mut Mesh, corners: [Vec3; 4]) {
    let first = mesh.vertices.len() as u32;
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
    mesh.vertices.extend(corners.map(|corner| Vertex {
        position: corner.to_array(),
        object: 0,
        normal: normal.to_array(),
        material: 0,
        ..Vertex::PLAIN
    }));
    mesh.indices.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
}

/// Virtual objects of these meshes, where they are.
pub(crate) fn scene_of(meshes: &[(&str, Mesh)]) -> (Scene, Vec<Affine3A>) {
    let objects = meshes
        .iter()
        .map(|(name, mesh)| Object {
            name: (*name).into(),
            kind: Kind::Virtual,
            placement: Placement::World(Pose::identity()),
            movement: Movement::default(),
            file: PathBuf::new(),
            mesh: mesh.clone(),
        })
        .collect();
    (
        Scene {
            objects,
            lamps: Vec::new(),
        },
        vec![Affine3A::IDENTITY; meshes.len()],
    )
}

fn grey() -> Material {
    Material {
        base_color: [0.5; 3],
        ..Material::default()
    }
}
