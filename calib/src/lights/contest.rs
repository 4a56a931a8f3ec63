//! Lights that cross: while two regions are one blob in the picture, each goes on as it went, and what shines there is shared
//! out as it was before.

use glam::Vec3;

use super::follower::Follower;

/// Difference of velocities above which two lights that touch are on their way past each other, radians per frame (0.25°).
const CROSSING_RAD: f32 = 0.0044;
/// Frames after which lights that still touch did not cross but met.
const MAX_FRAMES: u8 = 20;
/// A blob whose light changed by more than this share is not the sum of what was before: something went on or off.
const MAX_CHANGE: f32 = 0.3;

/// Marks followers that cross, and shares out the light that they gathered.
pub(super) fn share_out(followers: &mut [Follower], groups: &mut Vec<usize>, texel_rad: f32) {
    group(followers, groups, texel_rad);
    for first in 0..followers.len() {
        let members = |groups: &[usize]| (0..groups.len()).filter(|&i| groups[i] == first).count();
        if groups[first] == first && members(groups) > 1 {
            share_out_group(followers, groups, first);
        } else if groups[first] == first {
            followers[first].contested_frames = 0;
        }
    }
}

/// Number of the first follower of each follower's group; alone in it when it crosses nobody.
fn group(followers: &[Follower], groups: &mut Vec<usize>, texel_rad: f32) {
    groups.clear();
    groups.extend(0..followers.len());
    for b in 0..followers.len() {
        for a in 0..b {
            if do_cross(&followers[a], &followers[b], texel_rad) && groups[a] != groups[b] {
                let (low, high) = (groups[a].min(groups[b]), groups[a].max(groups[b]));
                groups.iter_mut().filter(|g| **g == high).for_each(|g| *g = low);
            }
        }
    }
}

fn do_cross(a: &Follower, b: &Follower, texel_rad: f32) -> bool {
    let touch_rad = a.radius_rad() + b.radius_rad() + 2.5 * texel_rad;
    let is_long = a.contested_frames >= MAX_FRAMES || b.contested_frames >= MAX_FRAMES;
    !is_long
        && a.absent_frames == 0
        && b.absent_frames == 0
        && (a.velocity - b.velocity).length() > CROSSING_RAD
        && (a.center - b.center).length() < touch_rad
}

/// Shares the light of a group out as its members had it before, channel by channel.
fn share_out_group(followers: &mut [Follower], groups: &[usize], group: usize) {
    let is_member = |&(index, _): &(usize, &mut Follower)| groups[index] == group;
    let (mut now, mut before) = (Vec3::ZERO, Vec3::ZERO);
    for (_, follower) in followers.iter_mut().enumerate().filter(is_member) {
        follower.contested_frames += 1;
        now += follower.gathered.irradiance;
        before += follower.irradiance;
    }
    if (now - before).abs().max_element() > MAX_CHANGE * before.max_element() {
        return;
    }
    for (_, follower) in followers.iter_mut().enumerate().filter(is_member) {
        let mut irradiance = follower.gathered.irradiance;
        for channel in 0..3 {
            if before[channel] > 0.0 {
                irradiance[channel] = now[channel] * (follower.irradiance[channel] / before[channel]);
            }
        }
        follower.gathered.set_irradiance(irradiance);
    }
}
