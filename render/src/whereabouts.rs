//! Where every object is, frame by frame: on markers that move, on motions of its own.

use std::sync::Arc;

use glam::{Affine3A, Vec3};
use mirrorball_calib::pose::Pose;
use mirrorball_calib::rig::{Marker, Rig};
use mirrorball_capture::frame::Frame;

use crate::node::RenderNode;
use crate::scene::{Carrier, GONE, Kind, Lamp, Motion, Placement, Puppet, Scene, Vertex, affine, bounding_sphere};
use crate::tracker::Tracker;

/// The objects of a scene over time.
#[derive(Debug)]
pub struct Whereabouts {
    actors: Vec<Actor>,
    markers: Vec<MovingMarker>,
    /// Time stamps of the first frame and of the last one, nanoseconds.
    first_and_last_ns: Option<[u64; 2]>,
    placements: Vec<Affine3A>,
    changes: Changes,
}

/// What is not where it was at the frame before.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Changes {
    /// For every object of the scene whether it moved.
    pub moved: Vec<bool>,
    /// Whether any phantom did.
    pub phantoms: bool,
}

#[derive(Debug)]
struct Actor {
    kind: Kind,
    base: Base,
    motion: Option<Motion>,
    /// Vertices of the object's mesh in its own frame; its middle follows from them. None of a phantom that keeps its
    /// shape.
    vertices: Vec<Vertex>,
    puppet: Option<Arc<Puppet>>,
    /// Seconds into the puppet's animation that the vertices show.
    clip_s: f32,
    is_bent: bool,
}

/// What an object's motion is relative to.
#[derive(Debug)]
enum Base {
    Still(Affine3A),
    Marker {
        index: usize,
        marker_from_placement: Affine3A,
        hold_s: f64,
    },
}

/// A marker that carries objects about.
#[derive(Debug)]
struct MovingMarker {
    marker: Marker,
    world_from_marker: Pose,
    seen_s: Option<f64>,
    /// Longest time that any of its objects stays where it was last seen, seconds: so long its lamps shine.
    hold_s: f64,
    is_held: bool,
}

impl Changes {
    /// Whether anything moved.
    #[must_use]
    pub fn any(&self) -> bool {
        self.moved.contains(&true)
    }
}

impl Whereabouts {
    /// The objects of `scene` as they stand at first: moving markers are where `rig` says until the first frame.
    #[must_use]
    pub fn new(scene: &Scene, rig: &Rig) -> Self {
        let ids = scene.moving_markers();
        let markers: Vec<MovingMarker> = (ids.iter().filter_map(|&id| rig.marker(id)))
            .map(|marker| MovingMarker {
                marker: *marker,
                world_from_marker: marker.world_from_marker,
                seen_s: None,
                hold_s: scene.longest_hold_s(marker.id),
                is_held: false,
            })
            .collect();
        let actor = |object: &crate::scene::Object| Actor {
            kind: object.kind,
            base: match (object.placement, object.movement.hold_s) {
                (Placement::Marker { id, marker_from_object }, Some(hold_s)) => markers
                    .iter()
                    .position(|moving| moving.marker.id == id)
                    .map_or(Base::Still(object.world_from_placement(rig)), |index| Base::Marker {
                        index,
                        marker_from_placement: affine(&marker_from_object),
                        hold_s,
                    }),
                (Placement::Marker { .. } | Placement::World(_), _) => Base::Still(object.world_from_placement(rig)),
            },
            motion: object.movement.motion.clone(),
            vertices: match (object.kind, &object.movement.puppet) {
                (Kind::Virtual, _) | (Kind::Phantom, Some(_)) => object.mesh.vertices.clone(),
                (Kind::Phantom, None) => Vec::new(),
            },
            puppet: object.movement.puppet.clone(),
            clip_s: object.movement.puppet.as_ref().map_or(0.0, |puppet| puppet.clip_s(0.0)),
            is_bent: false,
        };
        Self {
            actors: scene.objects.iter().map(actor).collect(),
            markers,
            first_and_last_ns: None,
            placements: scene
                .objects
                .iter()
                .map(|object| object.world_from_object(rig))
                .collect(),
            changes: Changes {
                moved: vec![false; scene.objects.len()],
                phantoms: false,
            },
        }
    }

    /// World from object, in the order of the scene; [`GONE`] for an object whose marker is not to be seen.
    #[must_use]
    pub fn placements(&self) -> &[Affine3A] {
        &self.placements
    }

    /// Where a moving marker is, world from marker; [`GONE`] when it has not been seen for longer than all its objects stay.
    /// `None` for a marker that stands still.
    #[must_use]
    pub fn world_from_marker(&self, id: u32) -> Option<Affine3A> {
        let moving = self.markers.iter().find(|moving| moving.marker.id == id)?;
        Some(if moving.is_held {
            affine(&moving.world_from_marker)
        } else {
            GONE
        })
    }

    /// Placement of what carries a lamp, world from carrier; [`GONE`] when that is not to be seen. Markers that stand still are
    /// where `rig` says.
    #[must_use]
    pub fn world_from_carrier(&self, lamp: &Lamp, rig: &Rig) -> Affine3A {
        let moving = match lamp.carrier {
            Carrier::Marker(id) => self.world_from_marker(id),
            Carrier::World | Carrier::Object(_) => None,
        };
        moving.unwrap_or_else(|| lamp.world_from_carrier(rig, &self.placements))
    }

    /// What the last step changed.
    #[must_use]
    pub fn changes(&self) -> &Changes {
        &self.changes
    }

    /// Seconds from the first frame that was asked about to the one taken at `timestamp_ns`. Where time stamps go back, as
    /// when a recording begins anew, this starts from 0 again.
    pub fn time_s(&mut self, timestamp_ns: u64) -> f64 {
        let first_ns = match self.first_and_last_ns {
            Some([first, last]) if last <= timestamp_ns => first,
            Some(_) => {
                for moving in &mut self.markers {
                    moving.seen_s = moving.seen_s.and(Some(0.0));
                }
                timestamp_ns
            }
            None => timestamp_ns,
        };
        self.first_and_last_ns = Some([first_ns, timestamp_ns]);
        (timestamp_ns - first_ns) as f64 * 1e-9
    }

    /// Goes on to `time_s`; `find` looks for a marker, world from marker, near where it was.
    pub fn advance(&mut self, time_s: f64, mut find: impl FnMut(&Marker, &Pose) -> Option<Pose>) {
        for moving in &mut self.markers {
            if let Some(found) = find(&moving.marker, &moving.world_from_marker) {
                moving.world_from_marker = found;
                moving.seen_s = Some(time_s);
            }
            moving.is_held = moving.is_held_for(moving.hold_s, time_s);
        }
        self.changes.phantoms = false;
        for (index, actor) in self.actors.iter_mut().enumerate() {
            actor.bend(time_s);
            let placement = actor.placement(&self.markers, time_s);
            let is_moved = placement != self.placements[index] || actor.is_bent;
            self.changes.moved[index] = is_moved;
            self.changes.phantoms |= is_moved && actor.kind == Kind::Phantom;
            self.placements[index] = placement;
        }
    }

    /// Middle and radius (world, metres) of every virtual object, in the order of the scene; `None` for one that has not
    /// moved or is gone.
    pub fn moved_spheres(&self) -> impl Iterator<Item = Option<(Vec3, f32)>> + '_ {
        let all = self.actors.iter().zip(&self.placements).zip(&self.changes.moved);
        all.filter(|((actor, _), _)| actor.kind == Kind::Virtual)
            .map(|((actor, placement), &moved)| {
                (moved && *placement != GONE)
                    .then(|| bounding_sphere(actor.vertices.iter().map(|v| Vec3::from(v.position)), placement))
            })
    }

    /// Objects that have changed their shape since the step before, with the vertices of their meshes in their own frames.
    pub fn bent(&self) -> impl Iterator<Item = (usize, &[Vertex])> {
        let all = self.actors.iter().enumerate();
        all.filter(|(_, actor)| actor.is_bent)
            .map(|(index, actor)| (index, &actor.vertices[..]))
    }

    /// Goes on from where `before` was: the clock and the places of markers that both have.
    pub fn take_over(&mut self, before: &Self) {
        self.first_and_last_ns = before.first_and_last_ns;
        for moving in &mut self.markers {
            let known = before.markers.iter().find(|other| other.marker.id == moving.marker.id);
            if let Some(known) = known {
                (moving.world_from_marker, moving.seen_s) = (known.world_from_marker, known.seen_s);
            }
        }
    }
}

impl MovingMarker {
    /// Whether it was seen in the last `hold_s` seconds.
    fn is_held_for(&self, hold_s: f64, time_s: f64) -> bool {
        self.seen_s.is_some_and(|seen_s| time_s - seen_s <= hold_s)
    }
}

impl Actor {
    /// Plays the puppet's animation up to a time.
    fn bend(&mut self, time_s: f64) {
        self.is_bent = false;
        if let Some(puppet) = &self.puppet {
            let clip_s = puppet.clip_s(time_s);
            self.is_bent = clip_s != self.clip_s;
            if self.is_bent {
                puppet.bend(clip_s, &mut self.vertices);
                self.clip_s = clip_s;
            }
        }
    }

    fn placement(&self, markers: &[MovingMarker], time_s: f64) -> Affine3A {
        let world_from_placement = match &self.base {
            Base::Still(world_from_placement) => *world_from_placement,
            Base::Marker {
                index,
                marker_from_placement,
                hold_s,
            } => {
                let moving = &markers[*index];
                if !moving.is_held_for(*hold_s, time_s) {
                    return GONE;
                }
                affine(&moving.world_from_marker) * *marker_from_placement
            }
        };
        match &self.motion {
            Some(motion) => world_from_placement * motion.placement_from_object(time_s),
            None => world_from_placement,
        }
    }
}

impl RenderNode {
    /// Moves every object to where it is at this frame.
    pub(crate) fn move_objects(&mut self, frame: &Frame, camera_from_world: &Pose) {
        let time_s = self.whereabouts.time_s(frame.meta.timestamp_ns);
        let (tracker, camera): (&Tracker, _) = (&self.tracker, self.rig.scene_camera());
        let world_from_camera = camera_from_world.inverse();
        self.whereabouts.advance(time_s, |marker, expected| {
            let near = *camera_from_world * *expected;
            Some(world_from_camera * tracker.locate_marker(marker, camera, &near)?)
        });
        self.environments.follow(&self.whereabouts);
        if !self.whereabouts.changes().any() {
            return;
        }
        for (object, vertices) in self.whereabouts.bent() {
            self.scene.bend(&self.gpu, object, vertices);
            self.rays.bend(&self.gpu, &self.scene, object);
            self.shadows.bend(&self.gpu, object, vertices);
        }
        self.placements.copy_from_slice(self.whereabouts.placements());
        self.scene.place(&self.gpu, &self.placements);
        self.rays.place(&self.gpu, &self.placements);
        self.shadows.place(&self.placements);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::passes::lamp_light::GpuLamps;
    use crate::scene::{LampKind, Mesh, Movement, Object};
    use glam::DVec3;
    use std::path::{Path, PathBuf};

    fn rig() -> Rig {
        let text = include_str!("../tests/support/rig.toml");
        Rig::from_toml(text, Path::new("rig.toml")).expect("the rig of the tests is valid")
    }

    fn on_marker(hold_s: f64) -> Scene {
        Scene {
            objects: vec![Object {
                name: "cup".into(),
                kind: Kind::Phantom,
                placement: Placement::Marker {
                    id: 1,
                    marker_from_object: Pose::identity(),
                },
                movement: Movement {
                    hold_s: Some(hold_s),
                    ..Movement::default()
                },
                file: PathBuf::new(),
                mesh: Mesh::default(),
            }],
            lamps: Vec::new(),
        }
    }

    #[test]
    fn an_object_stays_for_a_while_where_its_marker_was_and_is_then_gone() {
        let mut whereabouts = Whereabouts::new(&on_marker(0.5), &rig());
        let at = Pose {
            translation: DVec3::new(0.3, 0.1, 0.0),
            ..Pose::identity()
        };
        whereabouts.advance(0.0, |_, _| None);
        assert_eq!(whereabouts.placements(), [GONE], "nobody has seen the marker yet");
        whereabouts.advance(1.0, |_, _| Some(at));
        assert_eq!(whereabouts.placements(), [affine(&at)]);
        assert!(whereabouts.changes().phantoms);
        whereabouts.advance(1.4, |_, _| None);
        assert_eq!(whereabouts.placements(), [affine(&at)]);
        assert!(!whereabouts.changes().any());
        whereabouts.advance(1.6, |_, expected| {
            assert_eq!(*expected, at, "it is looked for where it was");
            None
        });
        assert_eq!(whereabouts.placements(), [GONE]);
    }

    #[test]
    fn time_counts_from_the_first_frame() {
        let mut whereabouts = Whereabouts::new(&on_marker(0.5), &rig());
        assert_eq!(whereabouts.time_s(5_000_000_000), 0.0);
        assert_eq!(whereabouts.time_s(5_250_000_000), 0.25);
    }

    #[test]
    fn a_recording_that_begins_anew_starts_the_time_anew() {
        let mut whereabouts = Whereabouts::new(&on_marker(0.5), &rig());
        let seen = Pose::identity();
        for timestamp_ns in [5_000_000_000, 9_000_000_000] {
            let time_s = whereabouts.time_s(timestamp_ns);
            whereabouts.advance(time_s, |_, _| Some(seen));
        }
        let begun_s = whereabouts.time_s(5_000_000_000);
        assert_eq!(begun_s, 0.0);
        whereabouts.advance(begun_s, |_, _| None);
        assert_eq!(whereabouts.placements(), [affine(&seen)], "it has just been seen");
        let later_s = whereabouts.time_s(6_000_000_000);
        assert_eq!(later_s, 1.0);
        whereabouts.advance(later_s, |_, _| None);
        assert_eq!(whereabouts.placements(), [GONE]);
    }

    #[test]
    fn a_lamp_goes_with_the_marker_of_an_object_that_moves() {
        let rig = rig();
        let lamp = Lamp {
            name: "torch".into(),
            kind: LampKind::Point { radius_m: 0.0 },
            irradiance: Vec3::ONE,
            carrier: Carrier::Marker(1),
            position_m: Vec3::Z,
            direction: Vec3::NEG_Z,
            across: Vec3::X,
        };
        let mut whereabouts = Whereabouts::new(&on_marker(0.5), &rig);
        let at = Pose {
            translation: DVec3::new(0.3, 0.1, 0.0),
            ..Pose::identity()
        };
        whereabouts.advance(1.0, |_, _| Some(at));
        let n_shining = |whereabouts: &Whereabouts| {
            let gpu = GpuLamps::new(std::slice::from_ref(&lamp), |lamp| {
                whereabouts.world_from_carrier(lamp, &rig)
            });
            (gpu.counts[0], gpu.all[0].position_m.truncate())
        };
        assert_eq!(n_shining(&whereabouts), (1, Vec3::new(0.3, 0.1, 1.0)));
        whereabouts.advance(1.6, |_, _| None);
        assert_eq!(
            n_shining(&whereabouts),
            (0, Vec3::ZERO),
            "the marker is gone, the lamp with it"
        );
        let standing = Lamp {
            carrier: Carrier::Marker(0),
            ..lamp.clone()
        };
        let expected = standing.world_from_carrier(&rig, &[]);
        assert_eq!(whereabouts.world_from_carrier(&standing, &rig), expected);
    }
}
