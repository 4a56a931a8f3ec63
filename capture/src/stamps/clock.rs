//! How one clock runs against another, from pairs of readings of which the second comes too late by an unknown delay.
//!
//! A frame carries the device's stamp `x` and arrives at the host's time `y = x + offset + drift·x + delay`. The delay
//! is never below its least value, but often above it, and sometimes far above: an average, even a robust one, is
//! pulled up. So the map is the line that lies under all pairs and as near to them as it can: the lower envelope.
//!
//! Source: S. B. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from network delay measurements",
//! INFOCOM 1999: of all lines under the pairs, the one with the least sum of distances is the edge of their lower convex
//! hull over the mean of all `x`. That the least delay says most is Cristian's, "Probabilistic clock synchronization",
//! Distributed Computing 3, 1989. What no such method can see is the least delay itself: it stays in the offset, and a
//! calibrated constant takes it out.

use std::collections::VecDeque;

/// Length of the window: long enough for the drift, short enough to follow a quartz that warms up.
const WINDOW_NS: u64 = 20_000_000_000;

/// Most pairs in the window: 20 s at 60 frames/s; faster cameras get a shorter window.
const PAIRS_MAX: usize = 1200;

/// Steepest drift believed, 500 ppm: quartzes stay within 100, and USB 2 (7.1.11) allows 500 between host and device.
const DRIFT_MAX: f64 = 500e-6;

/// Shortest window that says something about drift: below it, jitter of 1 ms looks like 500 ppm.
const DRIFT_SPAN_NS: f64 = 2e9;

/// A pair this far above the line comes from a host that stood still, or from a device clock that did.
const FAR_ABOVE_NS: i64 = 250_000_000;

/// So many of them in a row, twice as many as a driver has buffers, and it was the device clock: begin anew.
const FAR_ABOVE_MAX: u32 = 64;

/// Offset and drift between a device's clock and the host's, from the newest 20 s of pairs.
///
/// Memory is bounded and made at the start; one pair costs one pass over the window.
///
/// ```
/// use mirrorball_capture::stamps::ClockMap;
///
/// let mut map = ClockMap::new();
/// for frame in 0..300_u64 {
///     let device_ns = frame * 33_000_000;
///     let delay_ns = (frame % 7) * 100_000;
///     map.push(device_ns, device_ns + 5_000_000_000 + delay_ns);
/// }
/// assert_eq!(map.host_ns(9_900_000_000), Some(14_900_000_000));
/// ```
#[derive(Debug, Clone)]
pub struct ClockMap {
    pairs: VecDeque<Pair>,
    hull: Vec<Point>,
    line: Option<Line>,
    far_above_in_row: u32,
}

/// Readings of both clocks for one frame.
#[derive(Debug, Clone, Copy)]
struct Pair {
    device_ns: u64,
    arrival_ns: u64,
}

/// A pair relative to the oldest of the window: device time, and by how much the difference of the clocks has grown.
#[derive(Debug, Clone, Copy)]
struct Point {
    x_ns: f64,
    difference_ns: f64,
}

/// `host - device = origin.arrival - origin.device + intercept + drift (device - origin.device)`.
#[derive(Debug, Clone, Copy)]
struct Line {
    origin: Pair,
    intercept_ns: f64,
    drift: f64,
}

impl Line {
    fn host_ns(&self, device_ns: u64) -> u64 {
        let x_ns = device_ns.wrapping_sub(self.origin.device_ns).cast_signed();
        let shift_ns = (self.intercept_ns + self.drift * x_ns as f64).round() as i64;
        self.origin
            .arrival_ns
            .saturating_add_signed(x_ns.saturating_add(shift_ns))
    }

    fn device_ns(&self, host_ns: u64) -> u64 {
        let y_ns = host_ns.wrapping_sub(self.origin.arrival_ns).cast_signed();
        let x_ns = (y_ns as f64 - self.intercept_ns) / (1.0 + self.drift);
        // In two steps, so that a device time of days keeps its nanoseconds.
        let shift_ns = (x_ns - y_ns as f64).round() as i64;
        self.origin
            .device_ns
            .saturating_add_signed(y_ns.saturating_add(shift_ns))
    }
}

impl Default for ClockMap {
    fn default() -> Self {
        Self::new()
    }
}

impl ClockMap {
    /// Makes a map that knows nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            pairs: VecDeque::with_capacity(PAIRS_MAX + 1),
            hull: Vec::with_capacity(PAIRS_MAX),
            line: None,
            far_above_in_row: 0,
        }
    }

    /// Takes a device's stamp and the host's time at which it arrived, both in nanoseconds.
    ///
    /// Device stamps must rise: a pair whose stamp does not is left out. When the device clock has stood still for a
    /// while (64 pairs in a row lie more than 250 ms above the line) the map begins anew.
    pub fn push(&mut self, device_ns: u64, arrival_ns: u64) {
        if self.pairs.back().is_some_and(|last| device_ns <= last.device_ns) {
            return;
        }
        let is_far_above = self
            .delay_ns(device_ns, arrival_ns)
            .is_some_and(|delay| delay > FAR_ABOVE_NS);
        self.far_above_in_row = if is_far_above { self.far_above_in_row + 1 } else { 0 };
        if self.far_above_in_row >= FAR_ABOVE_MAX {
            self.clear();
        }
        self.pairs.push_back(Pair { device_ns, arrival_ns });
        while self.pairs.len() > PAIRS_MAX
            || self
                .pairs
                .front()
                .is_some_and(|first| device_ns - first.device_ns > WINDOW_NS)
        {
            self.pairs.pop_front();
        }
        self.fit();
    }

    /// Forgets everything: the device's clock has begun anew.
    pub fn clear(&mut self) {
        self.pairs.clear();
        self.line = None;
        self.far_above_in_row = 0;
    }

    /// The host's time at which a frame with this stamp arrives at the earliest, in nanoseconds; None before the first
    /// pair.
    #[must_use]
    pub fn host_ns(&self, device_ns: u64) -> Option<u64> {
        Some(self.line?.host_ns(device_ns))
    }

    /// The device's time that belongs to this time of the host, in nanoseconds; None before the first pair.
    #[must_use]
    pub fn device_ns(&self, host_ns: u64) -> Option<u64> {
        Some(self.line?.device_ns(host_ns))
    }

    /// By how much an arrival is later than the earliest one for this stamp, in nanoseconds: above 0 for a delayed
    /// frame, below 0 for a pair under the line; None before the first pair.
    #[must_use]
    pub fn delay_ns(&self, device_ns: u64, arrival_ns: u64) -> Option<i64> {
        Some(arrival_ns.wrapping_sub(self.host_ns(device_ns)?).cast_signed())
    }

    /// By how much the host's clock gains on the device's, in parts per million; None before there are 2 s of pairs.
    #[must_use]
    pub fn drift_ppm(&self) -> Option<f64> {
        (self.span_s() * 1e9 >= DRIFT_SPAN_NS).then_some(self.line?.drift * 1e6)
    }

    /// Pairs in the window.
    #[must_use]
    pub fn n_pairs(&self) -> usize {
        self.pairs.len()
    }

    /// Device time between the oldest and the newest pair, in seconds.
    #[must_use]
    pub fn span_s(&self) -> f64 {
        match (self.pairs.front(), self.pairs.back()) {
            (Some(first), Some(last)) => (last.device_ns - first.device_ns) as f64 * 1e-9,
            _ => 0.0,
        }
    }

    fn fit(&mut self) {
        let Some(&origin) = self.pairs.front() else { return };
        let mut sum_ns = 0.0;
        self.hull.clear();
        for pair in &self.pairs {
            let x_ns = (pair.device_ns - origin.device_ns) as f64;
            let y_ns = pair.arrival_ns.wrapping_sub(origin.arrival_ns).cast_signed() as f64;
            sum_ns += x_ns;
            let point = Point {
                x_ns,
                difference_ns: y_ns - x_ns,
            };
            push_to_hull(&mut self.hull, point);
        }
        let drift = if self.span_s() * 1e9 < DRIFT_SPAN_NS {
            0.0
        } else {
            slope_at(&self.hull, sum_ns / self.pairs.len() as f64).clamp(-DRIFT_MAX, DRIFT_MAX)
        };
        let height = |point: &Point| point.difference_ns - drift * point.x_ns;
        self.line = Some(Line {
            origin,
            intercept_ns: self.hull.iter().map(height).fold(f64::INFINITY, f64::min),
            drift,
        });
    }
}

/// The time of camera `to` at which a frame with this stamp of camera `from` was taken, in nanoseconds; None before
/// both maps have a pair. What differs between the least delays of the cameras stays in.
#[must_use]
pub fn stamp_between(from: &ClockMap, to: &ClockMap, from_device_ns: u64) -> Option<u64> {
    to.device_ns(from.host_ns(from_device_ns)?)
}

/// Appends a point to a lower convex hull from left to right (the monotone chain of Andrew 1979).
fn push_to_hull(hull: &mut Vec<Point>, point: Point) {
    while let [.., before, last] = hull[..] {
        let rise = |from: Point, to: Point| (to.difference_ns - from.difference_ns) / (to.x_ns - from.x_ns);
        if rise(before, last) < rise(last, point) {
            break;
        }
        hull.pop();
    }
    hull.push(point);
}

/// Slope of the hull's edge over `x_ns`; 0 if it has none.
fn slope_at(hull: &[Point], x_ns: f64) -> f64 {
    let right = hull.partition_point(|point| point.x_ns < x_ns).max(1);
    match (hull.get(right - 1), hull.get(right)) {
        (Some(a), Some(b)) => (b.difference_ns - a.difference_ns) / (b.x_ns - a.x_ns),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::stamps::simulation::Delays;

    const FRAME_NS: u64 = 33_333_333;

    /// A camera whose clock runs off the host's: its stamp for a moment of the host.
    #[derive(Clone, Copy)]
    struct Clock {
        offset_ns: f64,
        drift: f64,
    }

    impl Clock {
        fn device_ns(&self, host_ns: u64) -> u64 {
            ((host_ns as f64 - self.offset_ns) * (1.0 - self.drift)).round() as u64
        }
    }

    fn clock(seed: u64) -> Clock {
        Clock {
            offset_ns: 3e9,
            drift: [-200e-6, -70e-6, 0.0, 120e-6, 200e-6][seed as usize % 5],
        }
    }

    /// Absolute errors of mapped stamps in nanoseconds over frames 300 to 900 of 40 cameras, rising.
    fn errors_ns(jitter_ns: f64) -> Vec<u64> {
        let mut errors = Vec::new();
        for seed in 0..40 {
            let mut delays = Delays::new(seed, jitter_ns);
            let (clock, mut map) = (clock(seed), ClockMap::new());
            for frame in 0..900 {
                let taken_ns = 10_000_000_000 + frame * FRAME_NS;
                map.push(clock.device_ns(taken_ns), taken_ns + delays.next_ns());
                if frame >= 300 {
                    errors.push(map.host_ns(clock.device_ns(taken_ns)).unwrap().abs_diff(taken_ns));
                }
            }
        }
        errors.sort_unstable();
        errors
    }

    #[test]
    fn offset_error_after_ten_seconds() {
        for (jitter_us, allowed_us) in [(150.0, 50), (500.0, 200)] {
            let errors = errors_ns(jitter_us * 1e3);
            let at = |share: f64| errors[(errors.len() as f64 * share) as usize] / 1000;
            println!(
                "offset error, jitter {jitter_us} us: p50 {} us, p95 {} us, max {} us",
                at(0.5),
                at(0.95),
                errors[errors.len() - 1] / 1000
            );
            assert!(at(0.95) <= allowed_us);
        }
    }

    #[test]
    fn stamps_of_two_cameras_are_compared() {
        let mut errors = Vec::new();
        for seed in 0..40 {
            let clocks = [clock(seed), clock(seed + 2)];
            let mut maps = [ClockMap::new(), ClockMap::new()];
            let mut delays = [Delays::new(seed, 150e3), Delays::new(seed + 100, 150e3)];
            for frame in 0..600 {
                let taken_ns = 10_000_000_000 + frame * FRAME_NS;
                for camera in 0..2 {
                    let stamp_ns = clocks[camera].device_ns(taken_ns);
                    maps[camera].push(stamp_ns, taken_ns + delays[camera].next_ns());
                }
                if frame >= 300 {
                    let mapped_ns = stamp_between(&maps[0], &maps[1], clocks[0].device_ns(taken_ns)).unwrap();
                    errors.push(mapped_ns.abs_diff(clocks[1].device_ns(taken_ns)));
                }
            }
        }
        errors.sort_unstable();
        let p95_us = errors[errors.len() * 95 / 100] / 1000;
        println!("error between two cameras, jitter 150 us: p95 {p95_us} us");
        assert!(p95_us <= 50);
    }

    #[test]
    fn drift_is_found() {
        let (clock, mut map) = (clock(4), ClockMap::new());
        let mut delays = Delays::new(7, 150e3);
        assert_eq!(map.drift_ppm(), None);
        for frame in 0..600 {
            let taken_ns = 10_000_000_000 + frame * FRAME_NS;
            map.push(clock.device_ns(taken_ns), taken_ns + delays.next_ns());
        }
        assert!((map.drift_ppm().unwrap() - 200.0).abs() < 5.0, "{:?}", map.drift_ppm());
        assert!(map.n_pairs() <= PAIRS_MAX && map.span_s() <= 20.0);
    }

    #[test]
    fn a_device_clock_that_stood_still_is_noticed_and_a_host_that_did_is_not() {
        for (n_late, expected_ns) in [(32, 0), (400, 10_000_000_000)] {
            let mut map = ClockMap::new();
            let last = 300 + n_late;
            for frame in 0..last {
                let late_ns = if frame >= 300 { 10_000_000_000 } else { 0 };
                map.push(frame * FRAME_NS, frame * FRAME_NS + late_ns);
            }
            let offset_ns = map.host_ns(last * FRAME_NS).unwrap() - last * FRAME_NS;
            assert_eq!(offset_ns, expected_ns);
        }
    }

    proptest! {
        #[test]
        fn the_line_lies_under_all_pairs_and_turns_back(
            steps in proptest::collection::vec((1u64..50_000_000, 0u64..20_000_000), 1..200),
            start in 0u64..1 << 61,
        ) {
            let mut map = ClockMap::new();
            let mut device_ns = start;
            let mut pairs = Vec::new();
            for (step_ns, delay_ns) in steps {
                device_ns += step_ns;
                pairs.push((device_ns, device_ns / 2 + delay_ns));
                map.push(device_ns, device_ns / 2 + delay_ns);
            }
            for (device_ns, arrival_ns) in pairs {
                prop_assert!(map.delay_ns(device_ns, arrival_ns).unwrap() >= -2);
                let there_ns = map.host_ns(device_ns).unwrap();
                prop_assert!(there_ns == 0 || map.device_ns(there_ns).unwrap().abs_diff(device_ns) <= 2);
            }
        }

        #[test]
        fn any_numbers_do(pairs in proptest::collection::vec(any::<(u64, u64)>(), 0..50)) {
            let mut map = ClockMap::new();
            for (device_ns, arrival_ns) in pairs {
                map.push(device_ns, arrival_ns);
                let host_ns = map.host_ns(device_ns).unwrap();
                let _ = (map.device_ns(host_ns), map.delay_ns(device_ns, arrival_ns), map.drift_ppm());
            }
        }
    }
}
