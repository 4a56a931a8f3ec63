//! Soft shadow volumes, one place at a time and with every edge of every caster: twin of `shadow_wedges.wgsl`.

use glam::{Affine3A, Vec2, Vec3, Vec4};

use crate::shadow::wedge_light::{CLEARANCE, Coverage, N_COLUMNS, N_LINES, WedgeLight};
use crate::shadow::wedge_outlines::{NO_FACE, Outlines};

/// Casters in a light's frame.
#[derive(Debug, Clone)]
pub struct Placed<'a> {
    outlines: &'a Outlines,
    light: WedgeLight,
    coverage: Coverage,
    light_from_world: Affine3A,
    corners: Vec<Vec3>,
    planes: Vec<Vec4>,
}

/// A lit place. World frame, metres.
#[derive(Debug, Clone, Copy)]
pub struct Receiver {
    /// Where it is.
    pub place_m: Vec3,
    /// Its unit normal, on the eye's side.
    pub normal: Vec3,
    /// Where the eye is.
    pub eye_m: Vec3,
}

/// Layers of shadow before every sample, line by line.
pub type Layers = [[i32; N_COLUMNS]; N_LINES];

/// A way on the light's plane, and how many layers of shadow are left of it.
#[derive(Debug, Clone, Copy)]
struct Span {
    ends: [Vec2; 2],
    weight: i32,
}

impl<'a> Placed<'a> {
    /// Casters at `placements` (world from object), one per shape.
    #[must_use]
    pub fn new(outlines: &'a Outlines, placements: &[Affine3A], (light, coverage): (WedgeLight, Coverage)) -> Self {
        let light_from_world = light.light_from_world(coverage);
        let corners: Vec<Vec3> = outlines
            .corners
            .iter()
            .map(|corner| (light_from_world * placements[corner.w as usize]).transform_point3(corner.truncate()))
            .collect();
        let planes = outlines
            .faces
            .iter()
            .map(|face| {
                let [a, b, c] = [face[0], face[1], face[2]].map(|i| corners[i as usize]);
                let normal = (b - a).cross(c - a);
                normal.extend(-normal.dot(a))
            })
            .collect();
        Self {
            outlines,
            light,
            coverage,
            light_from_world,
            corners,
            planes,
        }
    }

    /// The share of the light that arrives, each sample as bright as the surface sees it; 1 where the surface turns away.
    #[must_use]
    pub fn lit_share(&self, receiver: &Receiver) -> f32 {
        let height = |at| (self.light.at(at) - receiver.place_m).dot(receiver.normal);
        let place = self.in_light(receiver);
        if place.z <= 0.0
            || [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
                .iter()
                .all(|&at| height(at) <= 0.0)
        {
            return 1.0;
        }
        if self.coverage == Coverage::Summed {
            return 1.0 - self.area(place).clamp(0.0, 1.0);
        }
        let layers = self.layers(place);
        let (mut all, mut arriving) = (0.0, 0.0);
        for (line, layers) in layers.iter().enumerate() {
            for (column, &n) in layers.iter().enumerate() {
                let way = self.light.at(sample(line, column)) - receiver.place_m;
                let weight = way.dot(receiver.normal).max(0.0) / way.length_squared().powi(2);
                all += weight;
                arriving += if n == 0 { weight } else { 0.0 };
            }
        }
        if all > 0.0 { arriving / all } else { 1.0 }
    }

    /// A receiver in the light's frame, moved off its surface.
    #[must_use]
    pub fn in_light(&self, receiver: &Receiver) -> Vec3 {
        let to_eye = (receiver.eye_m - receiver.place_m).normalize_or_zero();
        self.light_from_world
            .transform_point3(receiver.place_m + self.light.lift_m * to_eye)
    }

    /// Layers before every sample as a place in the light's frame sees them.
    #[must_use]
    pub fn layers(&self, place: Vec3) -> Layers {
        let mut layers = [[0; N_COLUMNS]; N_LINES];
        for Span { ends: [a, b], weight } in self.spans(place) {
            for (line, samples) in layers.iter_mut().enumerate() {
                let y = line as f32;
                // A line through a corner meets the edges above it only.
                let sign = i32::from(a.y > y && b.y <= y) - i32::from(b.y > y && a.y <= y);
                if sign == 0 {
                    continue;
                }
                let x = (a.x + (y - a.y) * (b.x - a.x) / (b.y - a.y)).clamp(a.x.min(b.x), a.x.max(b.x));
                for (column, n) in samples.iter_mut().enumerate() {
                    if column as f32 + phase(line) >= x {
                        *n += sign * weight;
                    }
                }
            }
        }
        layers
    }

    /// Covered share of the light, every layer counted, as a place in the light's frame sees it.
    #[must_use]
    pub fn area(&self, place: Vec3) -> f32 {
        self.spans(place)
            .iter()
            .map(|span| span.weight as f32 * share_right_of(span.ends))
            .sum()
    }

    fn spans(&self, place: Vec3) -> Vec<Span> {
        let mut spans = Vec::new();
        for shape in &self.outlines.shapes {
            let [first_edge, n_edges, first_face, n_faces] = shape.ranges.map(|n| n as usize);
            let facing = |face: u32| self.facing((face, shape.is_open), place);
            for &[a, b, forward, backward] in &self.outlines.edges[first_edge..first_edge + n_edges] {
                let weight = facing(forward) - facing(backward);
                if let Some(ends) = self.between([a, b], place).filter(|_| weight != 0) {
                    spans.push(Span { ends, weight });
                }
            }
            for face in first_face..first_face + n_faces {
                let weight = facing(face as u32);
                let [a, b, c, _] = self.outlines.faces[face];
                let cuts = [1.0 - CLEARANCE, CLEARANCE].map(|share| self.cut([a, b, c], share * place.z, share > 0.5));
                for ends in cuts.into_iter().flatten().filter(|_| weight != 0) {
                    let ends = ends.map(|at| projected(place, at));
                    spans.push(Span { ends, weight });
                }
            }
        }
        spans
    }

    /// Where the viewer stands to a face: 1 before it, 0 behind it, or -1 there where faces block from both sides.
    fn facing(&self, (face, is_open): (u32, bool), place: Vec3) -> i32 {
        if face == NO_FACE {
            return 0;
        }
        let plane = self.planes[face as usize];
        let is_before = match self.coverage {
            Coverage::Counted => plane.dot(place.extend(1.0)) > 0.0,
            Coverage::Summed => plane.dot(Vec4::new(0.5, 0.5, 0.0, 1.0)) <= 0.0,
        };
        match (is_before, is_open) {
            (true, _) => 1,
            (false, true) => -1,
            (false, false) => 0,
        }
    }

    /// The part of an edge between a place and the light, on the light's plane.
    fn between(&self, ends: [u32; 2], place: Vec3) -> Option<[Vec2; 2]> {
        let (near, far) = (CLEARANCE * place.z, (1.0 - CLEARANCE) * place.z);
        let [a, b] = ends.map(|i| self.corners[i as usize]);
        if a.z.max(b.z) < near || a.z.min(b.z) > far {
            return None;
        }
        Some([a, b].map(|at| {
            let height = at.z.clamp(near, far);
            let at = if height == at.z {
                at
            } else {
                self.crossing(ends, height)
            };
            projected(place, at)
        }))
    }

    /// The cut of a face at a height, in the face's sense around what is left of it below (or above) that height.
    fn cut(&self, face: [u32; 3], height: f32, keeps_below: bool) -> Option<[Vec3; 2]> {
        let is_out = |i: u32| {
            let z = self.corners[i as usize].z;
            if keeps_below { z > height } else { z < height }
        };
        let sides = [[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]];
        let leaving = sides.iter().find(|[a, b]| !is_out(*a) && is_out(*b))?;
        let entering = sides.iter().find(|[a, b]| is_out(*a) && !is_out(*b))?;
        Some([self.crossing(*leaving, height), self.crossing(*entering, height)])
    }

    fn crossing(&self, [first, second]: [u32; 2], height: f32) -> Vec3 {
        let [a, b] = [first.min(second), first.max(second)].map(|i| self.corners[i as usize]);
        a.lerp(b, (height - a.z) / (b.z - a.z)).truncate().extend(height)
    }
}

/// How far samples of a line stand right of their column, columns.
fn phase(line: usize) -> f32 {
    let reversed = (line as u32).reverse_bits() >> (32 - N_LINES.ilog2());
    (reversed as f32 + 0.5) / N_LINES as f32
}

/// A sample's place on the light, 0 ..= 1 along both sides.
#[must_use]
pub fn sample(line: usize, column: usize) -> [f32; 2] {
    let x = (column as f32 + phase(line)) / N_COLUMNS as f32;
    [x, (line as f32 + x) / N_LINES as f32]
}

/// Where the way from a place through a point meets the light's plane.
fn projected(place: Vec3, at: Vec3) -> Vec2 {
    let (place_xy, at_xy) = (place.truncate(), at.truncate());
    place_xy + (at_xy - place_xy) * (place.z / (place.z - at.z))
}

/// Signed share of the unit square right of a way, positive for one that goes down.
fn share_right_of([a, b]: [Vec2; 2]) -> f32 {
    let [y0, y1] = [a.y, b.y].map(|y| y.clamp(0.0, 1.0));
    if y0 == y1 {
        return 0.0;
    }
    let slope = (b.x - a.x) / (b.y - a.y);
    let [x0, x1] = [y0, y1].map(|y| a.x + (y - a.y) * slope);
    // Integral of x clamped to 0 ..= 1.
    let integral = |x: f32| 0.5 * x.clamp(0.0, 1.0).powi(2) + (x - 1.0).max(0.0);
    let mean = if (x1 - x0).abs() > 1e-3 {
        (integral(x1) - integral(x0)) / (x1 - x0)
    } else {
        (0.5 * (x0 + x1)).clamp(0.0, 1.0)
    };
    (y0 - y1) * (1.0 - mean)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::scene::{Mesh, Vertex};
    use crate::shadow::light::ShadowLight;
    use crate::shadow::shadow_view::Sphere;
    use crate::shadow::silhouette::Silhouettes;

    fn light() -> WedgeLight {
        let rect = ShadowLight::Rect {
            center_m: Vec3::new(0.1, -0.2, 1.5),
            half_u_m: Vec3::new(0.0, 0.3, 0.0),
            half_v_m: Vec3::new(0.2, 0.0, 0.0),
            radiance: Vec3::ONE,
        };
        let casters = Sphere {
            center_m: Vec3::ZERO,
            radius_m: 1.0,
        };
        WedgeLight::new(&rect, casters).unwrap()
    }

    fn outlines(corners: &[Vec3], indices: &[u32]) -> Outlines {
        let vertex = |at: &Vec3| Vertex {
            position: at.to_array(),
            object: 0,
            normal: [0.0, 0.0, 1.0],
            material: 0,
            ..Vertex::PLAIN
        };
        let mesh = Mesh {
            vertices: corners.iter().map(vertex).collect(),
            indices: indices.to_vec(),
            ..Mesh::default()
        };
        let mut outlines = Outlines::default();
        outlines.push(&Silhouettes::new("test", &mesh).unwrap());
        outlines
    }

    const TETRAHEDRON: [u32; 12] = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3];

    fn receiver(x: f32, y: f32) -> Receiver {
        Receiver {
            place_m: Vec3::new(x, y, 0.0),
            normal: Vec3::Z,
            eye_m: Vec3::new(0.0, -2.0, 2.0),
        }
    }

    /// Whether the way from a place to another meets a triangle (Möller, Trumbore 1997).
    fn meets([a, b, c]: [Vec3; 3], from: Vec3, way: Vec3) -> bool {
        let (ab, ac, offset) = (b - a, c - a, from - a);
        let across = way.cross(ac);
        let determinant = ab.dot(across);
        let turned = offset.cross(ab);
        let (u, v, t) = (
            offset.dot(across) / determinant,
            way.dot(turned) / determinant,
            ac.dot(turned) / determinant,
        );
        u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < 1.0
    }

    fn corner() -> impl Strategy<Value = Vec3> {
        (-0.5f32..0.5, -0.5f32..0.5, -0.3f32..1.8).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn a_sample_has_a_layer_where_a_ray_meets_the_caster(
            a in corner(), b in corner(), c in corner(), d in corner(), x in -0.6f32..0.6, y in -0.6f32..0.6, is_open in any::<bool>(),
        ) {
            // Through the receiver's place and past the light as well: everything is cut rightly.
            let corners = [a, b, c, d];
            let indices = if is_open { &TETRAHEDRON[..9] } else { &TETRAHEDRON[..] };
            let outlines = outlines(&corners, indices);
            let placed = Placed::new(&outlines, &[Affine3A::IDENTITY], (light(), Coverage::Counted));
            let receiver = receiver(x, y);
            let layers = placed.layers(placed.in_light(&receiver));
            let from = receiver.place_m + light().lift_m * (receiver.eye_m - receiver.place_m).normalize();
            // A place inside a closed caster is lit through its wall from within: only faces seen from before block.
            let mut n_wrong = 0;
            for (line, layers) in layers.iter().enumerate() {
                for (column, &n) in layers.iter().enumerate() {
                    let way = light().at(sample(line, column)) - from;
                    let expected = outlines.faces.iter().filter(|face| {
                        let [a, b, c] = [face[0], face[1], face[2]].map(|i| corners_of(&outlines)[i as usize]);
                        meets([a, b, c], from, way) && (is_open || (b - a).cross(c - a).dot(from - a) > 0.0)
                    }).count();
                    n_wrong += usize::from(n != expected as i32);
                }
            }
            prop_assert!(n_wrong <= 6, "{n_wrong}");
        }

        #[test]
        fn areas_agree_with_samples(a in corner(), b in corner(), c in corner(), x in -0.6f32..0.6, y in -0.6f32..0.6) {
            let outlines = outlines(&[a, b, c], &[0, 1, 2]);
            prop_assume!(!outlines.faces.is_empty());
            let [counted, summed] = [Coverage::Counted, Coverage::Summed]
                .map(|coverage| Placed::new(&outlines, &[Affine3A::IDENTITY], (light(), coverage)));
            let layers = counted.layers(counted.in_light(&receiver(x, y)));
            let share = layers.as_flattened().iter().filter(|&&n| n != 0).count() as f32 / 512.0;
            let area = summed.area(summed.in_light(&receiver(x, y))).abs();
            // 512 samples on 16 lines see a thin triangle now and then as a thirtieth more or less.
            prop_assert!((share - area).abs() < 0.04, "{share} {area}");
        }

        #[test]
        fn shares_are_shares_and_move_with_the_scene(
            a in corner(), b in corner(), c in corner(), d in corner(), x in -0.6f32..0.6, y in -0.6f32..0.6, shift in corner(),
        ) {
            let outlines = outlines(&[a, b, c, d], &TETRAHEDRON);
            let shares = [Vec3::ZERO, shift].map(|shift| {
                let light = WedgeLight { center_m: light().center_m + shift, ..light() };
                let placed = Placed::new(&outlines, &[Affine3A::from_translation(shift)], (light, Coverage::Counted));
                let at = receiver(x, y);
                placed.lit_share(&Receiver { place_m: at.place_m + shift, eye_m: at.eye_m + shift, ..at })
            });
            prop_assert!(shares.iter().all(|s| (0.0..=1.0).contains(s)));
            prop_assert!((shares[0] - shares[1]).abs() < 0.01, "{shares:?}");
        }

        #[test]
        fn an_edge_in_two_pieces_is_the_same_edge(
            a in corner(), b in corner(), c in corner(), d in corner(), part in 0.1f32..0.9, x in -0.6f32..0.6, y in -0.6f32..0.6,
        ) {
            let whole = outlines(&[a, b, c, d], &TETRAHEDRON);
            let pieces = outlines(&[a, b, c, d, a.lerp(b, part)], &[0, 2, 4, 4, 2, 1, 0, 4, 3, 4, 1, 3, 0, 3, 2, 1, 2, 3]);
            prop_assume!(pieces.faces.len() == 6 && whole.faces.len() == 4);
            let [whole, pieces] = [&whole, &pieces].map(|outlines| {
                Placed::new(outlines, &[Affine3A::IDENTITY], (light(), Coverage::Counted)).lit_share(&receiver(x, y))
            });
            prop_assert!((whole - pieces).abs() < 0.01, "{whole} {pieces}");
        }
    }

    fn corners_of(outlines: &Outlines) -> Vec<Vec3> {
        outlines.corners.iter().map(|corner| corner.truncate()).collect()
    }

    #[test]
    fn samples_are_spread_evenly_over_the_light() {
        let mut columns = [0; 512];
        let mut rows = [0; 128];
        for line in 0..N_LINES {
            for column in 0..N_COLUMNS {
                let [x, y] = sample(line, column);
                columns[(x * 512.0) as usize] += 1;
                rows[(y * 128.0) as usize] += 1;
            }
        }
        assert_eq!(columns, [1; 512]);
        assert_eq!(rows, [4; 128]);
    }
}
