//! A light that follows a bright region from frame to frame.

use glam::Vec3;

use super::KeyLight;
use super::divide::Region;
use super::gather::{Gathered, distance_m};

/// Change of direction that is motion, not noise, radians (0.2°); smaller ones are averaged.
const MOTION_RAD: f32 = 0.0035;
/// Relative change of power that is another light, not noise; smaller ones are averaged.
const CHANGE: f32 = 0.15;
/// Weight of a new measurement that looks like noise.
const MIN_GAIN: f32 = 0.1;
/// Weight of a new measurement of a light that another one crosses.
const CONTESTED_GAIN: f32 = 0.1;
/// Share of a correction of the place that corrects the velocity (alpha-beta filter).
const VELOCITY_GAIN: f32 = 0.5;
/// What is slower stands still, radians per frame (0.05°).
const STILL_RAD: f32 = 8.7e-4;
/// Share of a follower's light that may lie at a border with another one before it is a part of something larger.
const MAX_BORDER: f32 = 0.02;
/// How far the light of a still follower may lie off its seed: at least this, radians (0.25°), ...
const SLACK_RAD: f32 = 0.0044;
/// ... and this share of its spread, which has the same slack.
const SLACK_OF_SPREAD: f32 = 0.15;
/// Frames in which a new light takes every measurement as it is.
const YOUNG_FRAMES: u8 = 3;

/// A bright region over time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Follower {
    pub(super) id: u32,
    /// Where it is; between [`Follower::predict`] and [`Follower::follow`], where it is expected.
    pub(super) center: Vec3,
    /// Where it is when texels are shared out: at `center` while it moves. While it stands still the seed does too, within
    /// some slack, or the parts of a large region would push each other about for ever, by each frame's noise.
    pub(super) seed: Vec3,
    /// Radians per frame, tangent at `center`.
    pub(super) velocity: Vec3,
    /// Root mean square distance of its light from the centre, radians.
    pub(super) spread_rad: f32,
    /// The spread that its reach goes by: changes with some slack too, or a dim region without a clear edge would shrink and its
    /// reach with it, and so on.
    reach_spread_rad: f32,
    /// Averaged irradiance, linear RGB.
    pub(super) irradiance: Vec3,
    pub(super) inverse_distance: f32,
    /// Frames without enough light.
    pub(super) absent_frames: u8,
    /// Frames in which others crossed it, without a break.
    pub(super) contested_frames: u8,
    age_frames: u8,
    /// Light within this distance is its own, radians.
    pub(super) reach_rad: f32,
    /// Power of its light that lies at the border with another follower.
    pub(super) border_power: f32,
    /// Its light in this frame, offsets from `seed`.
    pub(super) gathered: Gathered,
}

impl Follower {
    /// A light that was not there before.
    pub(super) fn new(id: u32, region: &Region) -> Self {
        let mut gathered = Gathered::default();
        for ray in &region.rays {
            gathered.add(ray, 1.0, region.mean);
        }
        Self {
            id,
            center: region.mean,
            seed: region.mean,
            velocity: Vec3::ZERO,
            spread_rad: gathered.spread_rad(),
            reach_spread_rad: gathered.spread_rad(),
            irradiance: gathered.irradiance,
            inverse_distance: gathered.mean_inverse_distance(),
            absent_frames: 0,
            contested_frames: 0,
            age_frames: 0,
            reach_rad: 0.0,
            border_power: 0.0,
            gathered,
        }
    }

    /// A part of it, with a share of its power.
    pub(super) fn part(&self, id: u32, region: &Region, share: f32) -> Self {
        Self {
            velocity: self.velocity,
            irradiance: self.irradiance * share,
            ..Self::new(id, region)
        }
    }

    /// Puts it where it should be in the next frame.
    pub(super) fn predict(&mut self) {
        self.center = (self.center + self.velocity).normalize_or(self.center);
        if self.velocity != Vec3::ZERO {
            self.seed = self.center;
        }
    }

    /// Empties it, to gather the light of a map whose texels are so wide.
    ///
    /// It reaches a little further than its light: the corner of a square region of even brightness is 1.73 times its spread
    /// away, and a region may have moved.
    pub(super) fn open(&mut self, texel_rad: f32) {
        if (self.spread_rad - self.reach_spread_rad).abs() > SLACK_OF_SPREAD * self.reach_spread_rad {
            self.reach_spread_rad = self.spread_rad;
        }
        self.reach_rad = 2.2 * self.reach_spread_rad + 2.0 * texel_rad + 0.02 + 0.5 * self.velocity.length();
        self.gathered = Gathered::default();
        self.border_power = 0.0;
    }

    /// Whether it is a part of something larger. Then its middle says more of where the parts meet than of where that goes, and
    /// a part that went where its middle goes would carry its borders along and never stop.
    fn is_part(&self) -> bool {
        self.border_power > MAX_BORDER * self.gathered.power
    }

    /// Radius of a disc of even brightness with its spread, radians. (On a disc the mean square distance is r²/2.)
    pub(super) fn radius_rad(&self) -> f32 {
        std::f32::consts::SQRT_2 * self.spread_rad
    }

    /// Goes where it was seen, and takes over how bright it is: changes of the size of noise slowly, others at once.
    pub(super) fn follow(&mut self, min_power: f32) {
        if self.gathered.power < min_power {
            self.absent_frames = self.absent_frames.saturating_add(1);
            self.velocity *= 0.9;
            self.irradiance = self.gathered.irradiance;
            return;
        }
        self.absent_frames = 0;
        let is_contested = self.contested_frames > 0;
        let is_young = self.age_frames < YOUNG_FRAMES;
        self.age_frames = self.age_frames.saturating_add(1);
        let seen = self.gathered.direction(self.seed);
        let off = seen - self.center;
        let gain = match (is_contested, is_young) {
            (true, _) => CONTESTED_GAIN,
            (false, true) => 1.0,
            (false, false) => gain(off.length() / MOTION_RAD),
        };
        self.center = (self.center + off * gain).normalize_or(self.center);
        if !is_contested {
            self.velocity += off * (VELOCITY_GAIN * gain);
            self.velocity -= self.center * self.velocity.dot(self.center);
            if self.is_part() || self.velocity.length() < STILL_RAD {
                self.velocity = Vec3::ZERO;
            }
            let spread_gain = if is_young { 1.0 } else { MIN_GAIN };
            self.spread_rad += (self.gathered.spread_rad() - self.spread_rad) * spread_gain;
        }
        self.move_seed(seen, is_contested || is_young);
        self.irradiance = if is_young {
            self.gathered.irradiance
        } else {
            smoothed(self.irradiance, self.gathered.irradiance, min_power)
        };
        let (now, before) = (self.gathered.mean_inverse_distance(), self.inverse_distance);
        self.inverse_distance += (now - before) * gain_of_change(now, before, 0.0);
    }

    fn move_seed(&mut self, seen: Vec3, is_restless: bool) {
        if is_restless || self.velocity != Vec3::ZERO {
            self.seed = self.center;
            return;
        }
        if seen.distance(self.seed) > SLACK_RAD.max(SLACK_OF_SPREAD * self.spread_rad) {
            self.seed = seen;
        }
    }

    /// Jumps to light that it lost.
    pub(super) fn catch(&mut self, region: &Region) {
        for ray in &region.rays {
            self.gathered.add(ray, 1.0, self.seed);
        }
        // It goes all the way there at once.
        self.age_frames = 0;
    }

    /// The light, in a map whose texels are so wide.
    pub(super) fn light(&self, factor: Vec3, texel_rad: f32) -> KeyLight {
        // A texel's own spread is texel²/6: without it the light of a single texel would be a point.
        let spread_rad = (self.spread_rad * self.spread_rad + texel_rad * texel_rad / 6.0).sqrt();
        KeyLight {
            id: self.id,
            direction: self.center,
            distance_m: distance_m(self.inverse_distance),
            irradiance: self.irradiance * factor,
            angular_radius_rad: std::f32::consts::SQRT_2 * spread_rad,
        }
    }
}

/// Weight of a new measurement: [`MIN_GAIN`] within the noise, 1 from a change of 1 on, with the square between.
fn gain(change: f32) -> f32 {
    (change * change).clamp(MIN_GAIN, 1.0)
}

fn gain_of_change(now: f32, before: f32, floor: f32) -> f32 {
    let scale = before.abs().max(floor);
    if scale > 0.0 {
        gain((now - before).abs() / (CHANGE * scale))
    } else {
        1.0
    }
}

/// Irradiance averaged over frames, but for changes that are no noise; below `floor` everything is noise.
pub(super) fn smoothed(before: Vec3, now: Vec3, floor: f32) -> Vec3 {
    let change = (now - before).abs().max_element();
    let gain = gain_of_change(before.max_element() + change, before.max_element(), floor);
    before + (now - before) * gain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_averaged_and_a_switched_lamp_is_not() {
        let noisy = smoothed(Vec3::splat(100.0), Vec3::splat(101.0), 0.1);
        assert!((noisy.x - 100.1).abs() < 1e-3, "{noisy}");
        assert_eq!(smoothed(Vec3::splat(100.0), Vec3::ZERO, 0.1), Vec3::ZERO);
        assert_eq!(smoothed(Vec3::ZERO, Vec3::splat(100.0), 0.1), Vec3::splat(100.0));
    }
}
