//! Lights that are stable in time: a fixed dome for the soft light, and lights that follow the bright regions.
//!
//! Every step is continuous in the map, so that camera noise changes the lights a little and never which lights there are:
//! a texel belongs to the dome or to a light by a share that rises smoothly with its brightness, and to one light or its
//! neighbour by a share that falls smoothly across the border between them. Lights are the means of a k-means clustering
//! (Lloyd 1982) of the bright texels, weighted by power, that goes on from frame to frame, one step each; what none of them
//! reaches becomes a new light. Places follow by an alpha-beta filter, whose gain rises to 1 where the change is no noise;
//! powers are averaged the same way, and then scaled together so that they add up to the light of this very frame.

use glam::Vec3;

use super::budget::{self, Limits, NARROW_RAD};
use super::contest;
use super::directions::CLOSED;
use super::divide::{Region, divided};
use super::follower::{Follower, smoothed};
use super::gather::{Gathered, Ray, distance_m};
use super::level::LevelMeter;
use super::{Extract, KeyLight, LightCounts, Map, counted};
use crate::probe::radiance::luminance;

/// Share of all power from which a region becomes a light.
const APPEAR_SHARE: f32 = 0.007;
/// Share of all power below which a light is gone.
const VANISH_SHARE: f32 = 0.002;
/// Frames for which the number of a light that is gone waits for it to come back.
const ABSENT_FRAMES: u8 = 8;
/// Half of the width of the border between two lights, in texels.
const BORDER_TEXELS: f32 = 1.5;
/// Light beyond this many times a light's reach is none of its own; between once and this, partly.
const OUTER_REACH: f32 = 1.3;
/// Steps of clustering with the first map.
const FIRST_STEPS: u32 = 24;
/// How far a lamp can jump between two frames and still be the same, radians (12°).
const JUMP_RAD: f32 = 0.21;
/// Share of its power that a light must have lost for light nearby to be what it lost.
const MIN_LOST: f32 = 0.02;
/// Square radians that a light which joins the dome is off by, with the usual number of dome lights.
const DOME_VARIANCE: f32 = 0.03;

/// The followers and the dome.
#[derive(Debug)]
pub(super) struct Stable {
    max_followers: usize,
    meter: LevelMeter,
    next_id: u32,
    followers: Vec<Follower>,
    /// Averaged irradiance of the dome's lights.
    dome: Vec<Vec3>,
    /// What the dome's lights gather in this frame.
    dome_gathered: Vec<Gathered>,
    /// Bright shares of texels.
    rays: Vec<Ray>,
    /// Number of the follower that takes most of each ray.
    owners: Vec<Option<u32>>,
    /// What no follower reaches.
    leftovers: Vec<Ray>,
    groups: Vec<usize>,
}

impl Stable {
    pub(super) fn new(counts: LightCounts) -> Self {
        Self {
            max_followers: counts.bright as usize,
            meter: LevelMeter::new(),
            next_id: counts.dome,
            followers: Vec::with_capacity(counts.bright as usize + 1),
            dome: Vec::new(),
            dome_gathered: Vec::new(),
            rays: Vec::new(),
            owners: Vec::new(),
            leftovers: Vec::new(),
            groups: Vec::new(),
        }
    }

    /// Shares the texels out between dome and `rays`; gives the power of all.
    fn sort_texels(&mut self, map: &Map<'_>) -> f32 {
        let level = self.meter.level(map);
        self.rays.clear();
        self.dome_gathered.clear();
        self.dome_gathered
            .resize(map.directions.dome.len(), Gathered::default());
        let mut power = 0.0;
        for index in map.directions.open() {
            let ray = map.ray(index);
            let bright_share = level.share(luminance(counted(map.radiance.texels()[index])));
            if bright_share < 1.0 {
                self.dome_gathered[usize::from(ray.cell)].add(&ray, 1.0 - bright_share, Vec3::ZERO);
            }
            if bright_share > 0.0 {
                self.rays.push(ray.share(bright_share));
            }
            power += ray.power();
        }
        power
    }

    /// Gives every ray to the followers that reach it; the rest becomes leftovers.
    fn assign(&mut self, texel_rad: f32) {
        let border_rad = BORDER_TEXELS * texel_rad;
        self.owners.clear();
        self.leftovers.clear();
        for follower in &mut self.followers {
            follower.open(texel_rad);
        }
        for ray in &self.rays {
            let near = Nearest::of(ray.direction, &self.followers);
            self.owners.push(near.first.map(|(index, _)| self.followers[index].id));
            let first_share = near.first_share(&self.followers, border_rad);
            let mut rest = 1.0;
            for (near, most) in [(near.first, first_share), (near.second, 1.0)] {
                let Some((index, distance_squared)) = near else { break };
                let follower = &mut self.followers[index];
                let share = most * rest * gate(distance_squared.sqrt() / follower.reach_rad);
                follower.gathered.add(ray, share, follower.seed);
                if first_share < 1.0 {
                    follower.border_power += share * ray.power();
                }
                rest -= share;
            }
            if rest > 0.0 {
                self.leftovers.push(ray.share(rest));
            }
        }
    }

    /// Makes lights of leftovers that are bright enough, or gives them to lights that lost theirs; the rest stays.
    fn take_newcomers(&mut self, total_power: f32) {
        let min_power = APPEAR_SHARE * total_power;
        if self.leftovers.iter().map(Ray::power).sum::<f32>() <= min_power {
            return;
        }
        let rays = std::mem::take(&mut self.leftovers);
        let mut regions = divided(rays, self.max_followers, NARROW_RAD);
        regions.sort_by(|a, b| b.power.total_cmp(&a.power));
        for region in regions {
            if region.power <= min_power || !self.place(&region) {
                self.leftovers.extend(region.rays);
            }
        }
    }

    /// Finds a light for a region; false when there is none to spare.
    fn place(&mut self, region: &Region) -> bool {
        if let Some(lost) = self.lost_near(region) {
            self.followers[lost].catch(region);
            return true;
        }
        if self.followers.len() >= self.max_followers {
            self.followers
                .retain(|f| f.absent_frames == 0 || f.gathered.power > 0.0);
        }
        if self.followers.len() >= self.max_followers {
            match budget::cheapest_pair(&self.followers) {
                Some((a, b, cost)) if 2.0 * cost < region.power * DOME_VARIANCE => {
                    budget::join(&mut self.followers, a, b);
                }
                Some(_) | None => return false,
            }
        }
        self.followers.push(Follower::new(self.next_id, region));
        self.next_id += 1;
        true
    }

    /// The nearest light that lost about as much as this region would give it back.
    fn lost_near(&self, region: &Region) -> Option<usize> {
        let fits = |f: &Follower| {
            let before = luminance(f.irradiance);
            let lost = before - f.gathered.power;
            lost > MIN_LOST * before && (0.3 * lost..=1.5 * lost).contains(&region.power)
        };
        let distance = |index: &usize| self.followers[*index].center.distance(region.mean);
        (0..self.followers.len())
            .filter(|&index| fits(&self.followers[index]) && distance(&index) < JUMP_RAD)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// Clusters the first map until the lights stay.
    fn settle(&mut self, texel_rad: f32) {
        for _ in 0..FIRST_STEPS {
            for follower in &mut self.followers {
                follower.center = follower.gathered.direction(follower.seed);
                follower.seed = follower.center;
                follower.spread_rad = follower.gathered.spread_rad();
            }
            self.assign(texel_rad);
        }
        for follower in &mut self.followers {
            follower.irradiance = follower.gathered.irradiance;
        }
    }

    /// Averages the dome's lights like the others.
    fn smooth_dome(&mut self, total_power: f32) {
        let n = self.dome_gathered.len();
        if self.dome.len() != n {
            self.dome.clear();
            self.dome.extend(self.dome_gathered.iter().map(|cell| cell.irradiance));
            return;
        }
        let floor = VANISH_SHARE * total_power / n as f32;
        for (before, now) in self.dome.iter_mut().zip(&self.dome_gathered) {
            *before = smoothed(*before, now.irradiance, floor);
        }
    }

    /// What averaged lights must be multiplied by to have the light of this frame, channel by channel.
    fn correct(&mut self) -> Vec3 {
        let now: Vec3 = (self.dome_gathered.iter().map(|cell| cell.irradiance))
            .chain(self.followers.iter().map(|f| f.gathered.irradiance))
            .sum();
        let averaged: Vec3 = (self.dome.iter().copied())
            .chain(self.followers.iter().map(|f| f.irradiance))
            .sum();
        let mut factor = Vec3::ONE;
        for channel in 0..3 {
            if averaged[channel] > 0.0 {
                factor[channel] = now[channel] / averaged[channel];
                continue;
            }
            // Nothing was there before: take what is there now.
            for (before, cell) in self.dome.iter_mut().zip(&self.dome_gathered) {
                before[channel] = cell.irradiance[channel];
            }
            for follower in &mut self.followers {
                follower.irradiance[channel] = follower.gathered.irradiance[channel];
            }
        }
        factor
    }
}

impl Extract for Stable {
    fn extract(&mut self, map: &Map<'_>, lights: &mut Vec<KeyLight>) {
        let texel_rad = map.directions.texel_rad();
        let is_first = self.followers.is_empty();
        let total_power = self.sort_texels(map);
        for follower in &mut self.followers {
            follower.predict();
        }
        self.assign(texel_rad);
        self.take_newcomers(total_power);
        if is_first {
            self.settle(texel_rad);
        }
        for ray in self.leftovers.drain(..) {
            debug_assert!(ray.cell != CLOSED, "closed texels are left out");
            self.dome_gathered[usize::from(ray.cell)].add(&ray, 1.0, Vec3::ZERO);
        }
        contest::share_out(&mut self.followers, &mut self.groups, texel_rad);
        for follower in &mut self.followers {
            follower.follow(VANISH_SHARE * total_power);
        }
        self.smooth_dome(total_power);

        let factor = self.correct();
        let dome = map
            .directions
            .dome
            .iter()
            .zip(self.dome.iter().zip(&self.dome_gathered));
        lights.extend(
            dome.enumerate()
                .map(|(index, (&direction, (&irradiance, cell)))| KeyLight {
                    id: index as u32,
                    direction,
                    distance_m: distance_m(cell.mean_inverse_distance()),
                    irradiance: irradiance * factor,
                    angular_radius_rad: cell.cap_radius_rad(),
                }),
        );
        let visible = self.followers.iter().filter(|f| f.irradiance != Vec3::ZERO);
        lights.extend(visible.map(|f| f.light(factor, texel_rad)));

        self.followers.retain(|f| f.absent_frames <= ABSENT_FRAMES);
        let limits = Limits {
            max_lights: self.max_followers,
            total_power,
            next_id: self.next_id,
        };
        if budget::rebalance(&mut self.followers, &self.rays, &self.owners, limits) {
            self.next_id += 1;
        }
    }
}

/// The two followers nearest to a direction among those that reach it, with the squares of their distances,
/// square radians.
struct Nearest {
    first: Option<(usize, f32)>,
    second: Option<(usize, f32)>,
}

impl Nearest {
    fn of(direction: Vec3, followers: &[Follower]) -> Self {
        let mut near = Self {
            first: None,
            second: None,
        };
        for (index, follower) in followers.iter().enumerate() {
            let squared = direction.distance_squared(follower.seed);
            let outer_rad = OUTER_REACH * follower.reach_rad;
            if squared >= outer_rad * outer_rad {
                continue;
            }
            if near.first.is_none_or(|(_, least)| squared < least) {
                near.second = near.first;
                near.first = Some((index, squared));
            } else if near.second.is_none_or(|(_, least)| squared < least) {
                near.second = Some((index, squared));
            }
        }
        near
    }

    /// Share of the nearest follower by how far the direction is from the border with the second, 0.5 to 1.
    fn first_share(&self, followers: &[Follower], border_rad: f32) -> f32 {
        let (Some((a, near)), Some((b, far))) = (self.first, self.second) else {
            return 1.0;
        };
        let between_rad = followers[a].seed.distance(followers[b].seed).max(1e-6);
        let from_border_rad = (far - near) / (2.0 * between_rad);
        let t = (0.5 + 0.5 * from_border_rad / border_rad).min(1.0);
        t * t * (3.0 - 2.0 * t)
    }
}

/// Share of the light at a distance, in units of the reach, that belongs to a light: 1 within it, 0 from [`OUTER_REACH`] on.
fn gate(distance: f32) -> f32 {
    let t = ((OUTER_REACH - distance) / (OUTER_REACH - 1.0)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
