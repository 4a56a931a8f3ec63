//! Who gets the lights that there are: wide regions are divided, near ones joined, one step per frame.
//!
//! Both are judged by the sum of power times variance that they take away or add, the measure of Viriyothai and Debevec 2009.
//! Joining two for the sake of dividing a third must win twice what it costs, so noise does not turn a decision around.

use super::divide::Region;
use super::follower::Follower;
use super::gather::Ray;

/// A region that spreads less than this is not divided, radians (2.9°: a disc of 4° radius).
pub(super) const NARROW_RAD: f32 = 0.05;
/// Share of all power times variance that a division must be worth, square radians.
const MIN_GAIN: f32 = 2e-5;
/// By how much dividing one must win over joining two others.
const ADVANTAGE: f32 = 2.0;
/// Most of power times variance that a division takes away: from a line of even brightness, cut in the middle.
const MAX_SHARE: f32 = 0.75;

/// One step: divides the region for which that does most, if there is a light left or two others can do with one. True when
/// there is a new light, with the number `next_id`.
pub(super) fn rebalance(followers: &mut Vec<Follower>, rays: &[Ray], owners: &[Option<u32>], limits: Limits) -> bool {
    let Some(widest) = widest(followers) else { return false };
    let at_most = MAX_SHARE * spread_power(&followers[widest]);
    let is_free = followers.len() < limits.max_lights;
    let pair = if is_free { None } else { cheapest_pair(followers) };
    let needed = match pair {
        Some((_, _, cost)) => (ADVANTAGE * cost).max(MIN_GAIN * limits.total_power),
        None if is_free => MIN_GAIN * limits.total_power,
        None => return false,
    };
    if at_most < needed {
        return false;
    }
    let own = (rays.iter().zip(owners))
        .filter(|(_, owner)| **owner == Some(followers[widest].id))
        .map(|(ray, _)| *ray)
        .collect();
    let Ok((one, other)) = Region::new(own).split() else {
        return false;
    };
    if cost(one.power, other.power, one.mean.distance(other.mean)) < needed {
        return false;
    }
    let (large, small) = if one.power >= other.power {
        (one, other)
    } else {
        (other, one)
    };
    divide(followers, widest, (&large, &small), limits.next_id);
    if let Some((a, b, _)) = pair {
        join(followers, a, b);
    }
    true
}

/// What a step needs to know.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    pub(super) max_lights: usize,
    pub(super) total_power: f32,
    /// Number of the next new light.
    pub(super) next_id: u32,
}

/// The two followers that one light would stand for at the least cost, and that cost; not those that cross others
/// or wait for their lamp to come back.
pub(super) fn cheapest_pair(followers: &[Follower]) -> Option<(usize, usize, f32)> {
    let mut cheapest: Option<(usize, usize, f32)> = None;
    let is_settled = |(_, f): &(usize, &Follower)| f.contested_frames == 0 && f.absent_frames == 0;
    for (b, second) in followers.iter().enumerate().filter(is_settled) {
        for (a, first) in followers[..b].iter().enumerate().filter(is_settled) {
            let distance_rad = first.center.distance(second.center);
            let cost = cost(first.gathered.power, second.gathered.power, distance_rad);
            if cheapest.is_none_or(|(_, _, least)| cost < least) {
                cheapest = Some((a, b, cost));
            }
        }
    }
    cheapest
}

/// Makes one light of two; the brighter one stays.
pub(super) fn join(followers: &mut Vec<Follower>, a: usize, b: usize) {
    let (stays, goes) = if followers[a].gathered.power >= followers[b].gathered.power {
        (a, b)
    } else {
        (b, a)
    };
    let gone = followers[goes];
    let kept = &mut followers[stays];
    let total = (kept.gathered.power + gone.gathered.power).max(f32::MIN_POSITIVE);
    let share = gone.gathered.power / total;
    let between = cost(
        kept.gathered.power,
        gone.gathered.power,
        kept.center.distance(gone.center),
    ) / total;
    kept.spread_rad = (kept.spread_rad.powi(2) * (1.0 - share) + gone.spread_rad.powi(2) * share + between).sqrt();
    kept.center = kept.center.lerp(gone.center, share).normalize_or(kept.center);
    kept.seed = kept.center;
    kept.inverse_distance += (gone.inverse_distance - kept.inverse_distance) * share;
    kept.irradiance += gone.irradiance;
    kept.gathered
        .set_irradiance(kept.gathered.irradiance + gone.gathered.irradiance);
    followers.remove(goes);
}

/// Power times variance that joining two regions at this distance adds.
fn cost(one_power: f32, other_power: f32, distance_rad: f32) -> f32 {
    let total = one_power + other_power;
    if total > 0.0 {
        one_power * other_power / total * distance_rad * distance_rad
    } else {
        0.0
    }
}

fn spread_power(follower: &Follower) -> f32 {
    follower.gathered.power * follower.spread_rad * follower.spread_rad
}

fn widest(followers: &[Follower]) -> Option<usize> {
    (0..followers.len())
        .filter(|&i| followers[i].spread_rad > NARROW_RAD && followers[i].contested_frames == 0)
        .max_by(|&a, &b| spread_power(&followers[a]).total_cmp(&spread_power(&followers[b])))
}

/// Two lights for one; the larger part keeps its number.
fn divide(followers: &mut Vec<Follower>, index: usize, (large, small): (&Region, &Region), next_id: u32) {
    let whole = followers[index];
    let share = small.power / (large.power + small.power).max(f32::MIN_POSITIVE);
    followers[index] = whole.part(whole.id, large, 1.0 - share);
    followers.push(whole.part(next_id, small, share));
}
