//! Tracked poses at any time.

use glam::DVec3;
use nalgebra::{Matrix3, Vector3};

use super::{MAX_GAP_S, TrackedPose};
use crate::pose::{Pose, Twist};

/// Least half width of the window in intervals between tracked poses: seven or eight of them count.
const MIN_INTERVALS: f64 = 4.0;

/// Least half width in seconds: heads do not shake faster, trackers do.
const MIN_HALF_WIDTH_S: f64 = 0.03;

/// Tracked poses, by time.
#[derive(Debug, Clone)]
pub(super) struct Track<'a> {
    poses: &'a [TrackedPose],
    start_ns: u64,
    half_width_s: f64,
}

impl<'a> Track<'a> {
    /// Poses in the order of time.
    pub(super) fn new(poses: &'a [TrackedPose]) -> Self {
        let intervals = poses.windows(2).map(|pair| pair[1].timestamp_ns - pair[0].timestamp_ns);
        let mut intervals: Vec<u64> = intervals.collect();
        intervals.sort_unstable();
        let median = intervals.get(intervals.len() / 2).copied().unwrap_or(0);
        Self {
            poses,
            start_ns: poses.first().map_or(0, |pose| pose.timestamp_ns),
            half_width_s: (MIN_INTERVALS * median as f64 * 1e-9).max(MIN_HALF_WIDTH_S),
        }
    }

    /// Time since the first tracked pose.
    pub(super) fn seconds(&self, timestamp_ns: u64) -> f64 {
        (i128::from(timestamp_ns) - i128::from(self.start_ns)) as f64 * 1e-9
    }

    /// The pose at a time; `None` outside and in gaps.
    ///
    /// Local regression (Cleveland 1979) of second order on the twists from the pose before. A line between two poses
    /// would be least noisy half-way: a time offset that is looked for would be drawn there.
    pub(super) fn at(&self, time_s: f64) -> Option<Pose> {
        let time_of = |pose: &TrackedPose| self.seconds(pose.timestamp_ns);
        let after = self.poses.partition_point(|pose| time_of(pose) <= time_s);
        let before = self.poses.get(after.checked_sub(1)?)?;
        if time_of(self.poses.get(after)?) - time_of(before) > MAX_GAP_S {
            return None;
        }
        let first = self
            .poses
            .partition_point(|pose| time_of(pose) <= time_s - self.half_width_s);
        let end = self
            .poses
            .partition_point(|pose| time_of(pose) < time_s + self.half_width_s);
        let window = &self.poses[first..end];
        let place = |pose: &TrackedPose| (time_of(pose) - time_s) / self.half_width_s;
        // Outside of these the curve would be extrapolated.
        if window.iter().filter(|pose| place(pose) <= 0.0).count() < 2
            || window.iter().filter(|pose| place(pose) > 0.0).count() < 2
        {
            return None;
        }
        let basis = |x: f64| Vector3::new(1.0, x, x * x);
        let tricube = |x: f64| (1.0 - x.abs().powi(3)).max(0.0).powi(3);
        let mut normal = Matrix3::zeros();
        for pose in window {
            let x = place(pose);
            normal += basis(x) * basis(x).transpose() * tricube(x);
        }
        let at_zero = normal.cholesky()?.solve(&Vector3::x());
        let (mut rotation, mut translation) = (DVec3::ZERO, DVec3::ZERO);
        for pose in window {
            let x = place(pose);
            let part = tricube(x) * basis(x).dot(&at_zero);
            let twist = (before.tracker_from_headset.inverse() * pose.tracker_from_headset).log();
            rotation += twist.rotation * part;
            translation += twist.translation * part;
        }
        Some(before.tracker_from_headset * Pose::exp(Twist { rotation, translation }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extrinsics::simulation::pose;

    fn turning(t: f64) -> Pose {
        pose([0.0, 0.4 * t, 0.1 * t * t], [t, 0.2 * t * t, 0.0])
    }

    #[test]
    fn poses_between_are_on_the_curve_and_gaps_are_not_bridged() {
        let mut poses: Vec<TrackedPose> = (0..100)
            .map(|i| TrackedPose {
                timestamp_ns: 5_000_000_000 + i * 10_000_000,
                tracker_from_headset: turning(0.01 * i as f64),
            })
            .collect();
        poses.drain(40..55);
        let track = Track::new(&poses);
        for t in [0.1, 0.1234, 0.2, 0.731] {
            let off = track.at(t).unwrap().inverse() * turning(t);
            assert!(off.translation.length() < 1e-6, "{off:?}");
            assert!(off.angle_to(&Pose::identity()) < 1e-6, "{off:?}");
        }
        for t in [-0.1, 0.0, 0.45, 1.2] {
            assert_eq!(track.at(t), None, "{t}");
        }
        assert_eq!(Track::new(&[]).at(0.0), None);
    }
}
