//! Objects that move by themselves, without a marker and without an animation in their file.

use glam::{Affine3A, Quat, Vec3};
use serde::Deserialize;

/// How an object moves about the place that its scene file gives it (key `motion`).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Motion {
    /// Turns about its z axis.
    Turntable {
        /// Seconds for one turn, counterclockwise seen from above; below 0 the other way round.
        turn_s: f64,
    },
    /// Goes from waypoint to waypoint in straight lines.
    Path {
        /// In the order of their times; the first at 0.
        waypoints: Vec<Waypoint>,
        /// What comes after the last.
        #[serde(default)]
        end: PathEnd,
    },
}

/// Where an object is at some time, relative to its placement.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoint {
    /// Seconds after the first frame.
    pub time_s: f64,
    /// Place, metres, in the frame that the placement gives.
    pub place_m: [f32; 3],
    /// Turn about the z axis, degrees, counterclockwise seen from above. Between waypoints it changes evenly.
    #[serde(default)]
    pub turn_deg: f32,
}

/// What an object does at the end of its path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PathEnd {
    /// Starts again from the first waypoint.
    #[default]
    Repeat,
    /// Stays at the last.
    Stay,
}

impl Motion {
    /// Checks every number.
    ///
    /// # Errors
    /// What is wrong and what is allowed.
    pub(super) fn check(&self) -> Result<(), String> {
        match self {
            Self::Turntable { turn_s } => {
                if turn_s.is_finite() && turn_s.abs() >= 0.1 {
                    return Ok(());
                }
                Err(format!(
                    "`turn_s` is `{turn_s}`; a turn takes at least 0.1 s, below 0 the other way round"
                ))
            }
            Self::Path { waypoints, .. } => check_waypoints(waypoints),
        }
    }

    /// Times between which the object goes straight or turns by an eighth of a turn, once around, seconds.
    #[must_use]
    pub fn stops_s(&self) -> Vec<f64> {
        match self {
            Self::Turntable { turn_s } => (0..8).map(|i| turn_s.abs() * f64::from(i) / 8.0).collect(),
            Self::Path { waypoints, .. } => waypoints.iter().map(|waypoint| waypoint.time_s).collect(),
        }
    }

    /// The object's own frame in the one that its placement gives, `time_s` seconds after the first frame.
    #[must_use]
    pub fn placement_from_object(&self, time_s: f64) -> Affine3A {
        match self {
            Self::Turntable { turn_s } => {
                let turns = (time_s / turn_s).rem_euclid(1.0);
                Affine3A::from_quat(Quat::from_rotation_z((std::f64::consts::TAU * turns) as f32))
            }
            Self::Path { waypoints, end } => on_path(waypoints, *end, time_s),
        }
    }
}

fn check_waypoints(waypoints: &[Waypoint]) -> Result<(), String> {
    if waypoints.len() < 2 {
        return Err(format!(
            "a path has at least 2 `waypoints`; there are {}",
            waypoints.len()
        ));
    }
    if waypoints[0].time_s != 0.0 {
        return Err(format!(
            "the first waypoint's `time_s` is `{}`; a path starts at 0",
            waypoints[0].time_s
        ));
    }
    for (index, waypoint) in waypoints.iter().enumerate() {
        if !(waypoint.time_s.is_finite() && Vec3::from(waypoint.place_m).is_finite() && waypoint.turn_deg.is_finite()) {
            return Err(format!("waypoint {index} has a number that is not finite"));
        }
    }
    let late = waypoints.windows(2).position(|pair| pair[1].time_s <= pair[0].time_s);
    late.map_or(Ok(()), |index| {
        Err(format!(
            "waypoint {}'s `time_s` is `{}`; times rise from waypoint to waypoint",
            index + 1,
            waypoints[index + 1].time_s
        ))
    })
}

fn on_path(waypoints: &[Waypoint], end: PathEnd, time_s: f64) -> Affine3A {
    let Some((first, last)) = waypoints.first().zip(waypoints.last()) else {
        return Affine3A::IDENTITY;
    };
    let time_s = match end {
        PathEnd::Repeat => time_s.rem_euclid(last.time_s),
        PathEnd::Stay => time_s.clamp(first.time_s, last.time_s),
    };
    let next = waypoints
        .partition_point(|w| w.time_s <= time_s)
        .min(waypoints.len() - 1);
    let (from, to) = (&waypoints[next.saturating_sub(1)], &waypoints[next]);
    let span_s = (to.time_s - from.time_s).max(f64::MIN_POSITIVE);
    let share = ((time_s - from.time_s) / span_s).clamp(0.0, 1.0) as f32;
    let turn_deg = from.turn_deg + share * (to.turn_deg - from.turn_deg);
    Affine3A::from_rotation_translation(
        Quat::from_rotation_z(turn_deg.to_radians()),
        Vec3::from(from.place_m).lerp(Vec3::from(to.place_m), share),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(text: &str) -> Motion {
        #[derive(Deserialize)]
        struct Holder {
            motion: Motion,
        }
        toml::from_str::<Holder>(text).expect("the text is valid").motion
    }

    #[test]
    fn a_turntable_turns_counterclockwise() {
        let motion = motion("motion = { kind = \"turntable\", turn_s = 4.0 }");
        let x = motion.placement_from_object(1.0).transform_vector3(Vec3::X);
        assert!(x.distance(Vec3::Y) < 1e-6, "{x}");
        // After a day as after a second: the turn is worked out in double precision.
        let later = motion.placement_from_object(86_401.0).transform_vector3(Vec3::X);
        assert!(later.distance(Vec3::Y) < 1e-5, "{later}");
    }

    #[test]
    fn a_path_passes_its_waypoints_and_ends_as_it_says() {
        let text = |end: &str| {
            format!(
                "motion = {{ kind = \"path\", end = \"{end}\", waypoints = [\
                 {{ time_s = 0.0, place_m = [0, 0, 0] }}, \
                 {{ time_s = 2.0, place_m = [0.2, 0, 0], turn_deg = 90.0 }}] }}"
            )
        };
        let at = |end: &str, time_s: f64| motion(&text(end)).placement_from_object(time_s);
        let half_way = at("repeat", 1.0);
        assert!(half_way.translation.distance(glam::Vec3A::new(0.1, 0.0, 0.0)) < 1e-7);
        let turned = half_way.transform_vector3(Vec3::X);
        assert!(turned.distance(Vec3::new(1.0, 1.0, 0.0).normalize()) < 1e-6, "{turned}");
        assert!((at("repeat", 2.5).translation.x - 0.05).abs() < 1e-6);
        assert!((at("stay", 2.5).translation.x - 0.2).abs() < 1e-6);
    }

    #[test]
    fn bad_motions_say_what_is_allowed() {
        for (text, expected) in [
            ("motion = { kind = \"turntable\", turn_s = 0.0 }", "`turn_s` is `0`"),
            ("motion = { kind = \"turntable\", turn_s = nan }", "`turn_s` is `NaN`"),
            ("motion = { kind = \"path\", waypoints = [] }", "at least 2"),
            (
                "motion = { kind = \"path\", waypoints = [{ time_s = 1, place_m = [0, 0, 0] }, { time_s = 2, place_m = [0, 0, 0] }] }",
                "starts at 0",
            ),
            (
                "motion = { kind = \"path\", waypoints = [{ time_s = 0, place_m = [0, 0, 0] }, { time_s = 0, place_m = [0, 0, 0] }] }",
                "waypoint 1's `time_s` is `0`",
            ),
            (
                "motion = { kind = \"path\", waypoints = [{ time_s = 0, place_m = [0, nan, 0] }, { time_s = 1, place_m = [0, 0, 0] }] }",
                "waypoint 0 has a number that is not finite",
            ),
        ] {
            let message = motion(text).check().expect_err(text);
            assert!(message.contains(expected), "{message}");
        }
    }
}
