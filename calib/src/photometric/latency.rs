//! Control latency: how many frames after a change of exposure was asked for the picture shows it.
//!
//! Every number of frames predicts a level for each frame: that of the request then in force. The prediction is right up to one
//! factor (the scene), so the number with the smallest robust scatter of `ln level − ln exposure` is taken. All numbers are
//! compared over the same frames, and only those numbers by which two changes show among these: over frames of one exposure
//! any number is right. Each change is looked at by itself too: a camera whose latency varies says so.

/// Most frames of latency that are told apart.
const MAX_FRAMES: usize = 16;

/// Smallest change of exposure, as a log ratio, that counts: a sixth of a stop.
const MIN_STEP: f64 = 0.115;

/// How many times smaller the best scatter must be than the second best.
const MIN_LEAD: f64 = 1.5;

/// A request for another exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request {
    /// Number of the first frame that the camera delivered after it was asked.
    pub frame: u64,
    /// What the picture's level is in proportion to: seconds times gain; above 0.
    pub exposure_s: f64,
}

/// A frame's mean level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Number of the frame, rising.
    pub frame: u64,
    /// Mean linear signal, above 0.
    pub signal: f64,
}

/// Latency as measured.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlLatency {
    /// Frames from a request to its effect; with 0 the first frame that comes after the request shows it.
    pub frames: usize,
    /// The same, of each change that could be judged by itself.
    pub of_changes: Vec<usize>,
    /// Scatter of the second best number of frames over that of the best.
    pub lead: f64,
}

/// Why there is no latency.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LatencyError {
    /// Nothing changes.
    #[error(
        "the requests change the exposure by 12 % or more `{found}` times within the series (allowed: at least `2`)"
    )]
    FewChanges {
        /// Changes found.
        found: usize,
    },
    /// The series ends, or the first requests follow each other, too soon to tell two numbers of frames apart.
    #[error(
        "the series is too short: over the same `{frames}` frames, two changes must show with 0 frames of latency and with 1"
    )]
    Short {
        /// Frames in the series.
        frames: usize,
    },
    /// No number of frames explains the levels.
    #[error(
        "the levels do not follow the requests: of 0 to `{most}` frames of latency, `{best}` explain them only `{lead:.2}` times better than any other number (allowed: at least 1.5)"
    )]
    Unclear {
        /// The best number.
        best: usize,
        /// The largest number that the series can tell from the others.
        most: usize,
        /// Second best scatter over the best.
        lead: f64,
    },
}

/// Measures the latency; requests and levels each by rising frame.
///
/// # Errors
/// When there are too few changes, or the levels follow no number of frames.
pub fn measure(requests: &[Request], levels: &[Level]) -> Result<ControlLatency, LatencyError> {
    let first = levels.first().map_or(u64::MAX, |level| level.frame);
    let last = levels.last().map_or(0, |level| level.frame);
    let changes: Vec<usize> = (1..requests.len())
        .filter(|&i| (requests[i].exposure_s / requests[i - 1].exposure_s).ln().abs() >= MIN_STEP)
        .filter(|&i| (first..=last).contains(&requests[i].frame))
        .collect();
    if changes.len() < 2 {
        return Err(LatencyError::FewChanges { found: changes.len() });
    }
    let Some((most, shared)) = (1..=MAX_FRAMES).rev().find_map(|most| {
        let shared = shared(requests, levels, most);
        let shows = |frames| shown_changes(requests, shared, frames) >= 2;
        (0..=most).all(shows).then_some((most, shared))
    }) else {
        return Err(LatencyError::Short { frames: levels.len() });
    };
    let scatters: Vec<f64> = (0..=most).map(|frames| scatter(requests, shared, frames)).collect();
    let best = (0..scatters.len())
        .min_by(|&a, &b| scatters[a].total_cmp(&scatters[b]))
        .expect("there are two or more");
    let second = (0..scatters.len())
        .filter(|&i| i != best)
        .map(|i| scatters[i])
        .fold(f64::INFINITY, f64::min);
    // Levels are known to a thousandth at best.
    let lead = second.max(1e-3) / scatters[best].max(1e-3);
    if lead < MIN_LEAD {
        return Err(LatencyError::Unclear { best, most, lead });
    }
    let of_changes = changes
        .iter()
        .filter_map(|&change| of_change(requests, levels, change))
        .collect();
    Ok(ControlLatency {
        frames: best,
        of_changes,
        lead,
    })
}

/// The request that a frame shows if the latency is this many frames.
fn in_force(requests: &[Request], frame: u64, latency: usize) -> Option<&Request> {
    let asked_at = frame.checked_sub(latency as u64)?;
    requests.iter().rfind(|request| request.frame <= asked_at)
}

/// The levels of frames of which every latency of up to `most` frames says what they show.
fn shared<'a>(requests: &[Request], levels: &'a [Level], most: usize) -> &'a [Level] {
    let from = levels.partition_point(|level| in_force(requests, level.frame, most).is_none());
    &levels[from..]
}

/// How often the exposure changes within these frames if the latency is `frames`.
fn shown_changes(requests: &[Request], levels: &[Level], frames: usize) -> usize {
    let exposures: Vec<f64> = levels
        .iter()
        .filter_map(|level| Some(in_force(requests, level.frame, frames)?.exposure_s))
        .collect();
    let is_change = |pair: &&[f64]| (pair[1] / pair[0]).ln().abs() >= MIN_STEP;
    exposures.windows(2).filter(is_change).count()
}

/// Root mean square of `ln level − ln exposure` about its median, large errors counting little (Geman and McClure 1987).
fn scatter(requests: &[Request], levels: &[Level], frames: usize) -> f64 {
    let mut errors: Vec<f64> = levels
        .iter()
        .filter_map(|level| {
            let request = in_force(requests, level.frame, frames)?;
            Some(level.signal.max(1e-9).ln() - request.exposure_s.ln())
        })
        .collect();
    if errors.is_empty() {
        return f64::INFINITY;
    }
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    let cost = |error: &f64| {
        let square = (error - median).powi(2);
        square / (1.0 + square)
    };
    (errors.iter().map(cost).sum::<f64>() / errors.len() as f64).sqrt()
}

/// Frames from one change until the level is nearer to the new exposure than to the old; `None` when another change comes
/// first, or the level never follows.
fn of_change(requests: &[Request], levels: &[Level], change: usize) -> Option<usize> {
    let (old, new) = (requests[change - 1], requests[change]);
    let until = requests.get(change + 1).map_or(u64::MAX, |next| next.frame);
    let before = levels.iter().rfind(|level| level.frame < new.frame)?;
    let half = 0.5 * (new.exposure_s / old.exposure_s).ln();
    let is_new = |level: &&Level| {
        let moved = (level.signal / before.signal).ln();
        if half > 0.0 { moved > half } else { moved < half }
    };
    let shown = levels
        .iter()
        .filter(|level| (new.frame..until).contains(&level.frame))
        .find(is_new)?;
    Some((shown.frame - new.frame) as usize)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::merge::simulate::Random;

    fn requests() -> Vec<Request> {
        [(0, 0.01), (12, 0.02), (31, 0.005), (47, 0.01), (70, 0.004)]
            .map(|(frame, exposure_s)| Request { frame, exposure_s })
            .to_vec()
    }

    /// Levels of a camera with a latency, under light that drifts, some frames lost: not the two about the second change, which
    /// every number of frames is compared over: without them nobody could tell neighbouring latencies apart.
    fn levels(latency: u64, seed: u64) -> Vec<Level> {
        let mut random = Random::new(seed);
        let requests = requests();
        let mut levels = Vec::new();
        for frame in 0..90u64 {
            let in_force = requests
                .iter()
                .rfind(|request| request.frame <= frame.saturating_sub(latency))
                .expect("one at 0");
            let drift = 1.0 + 0.001 * frame as f64;
            let signal = 20.0 * in_force.exposure_s * drift * (1.0 + 0.01 * random.normal());
            let is_kept = [frame, frame + 1].contains(&(requests[2].frame + latency));
            if random.uniform() > 0.1 || is_kept {
                levels.push(Level { frame, signal });
            }
        }
        levels
    }

    /// Frames from each change to the first frame that shows it and was not lost.
    fn first_shown(levels: &[Level], latency: u64) -> Vec<usize> {
        let requests = requests();
        let of_change = |pair: &[Request]| {
            let frame = pair[0].frame;
            let until = pair.get(1).map_or(u64::MAX, |next| next.frame);
            let shown = levels.iter().find(|level| level.frame >= frame + latency)?;
            (shown.frame < until).then_some((shown.frame - frame) as usize)
        };
        let mut changes: Vec<usize> = requests[1..].windows(2).filter_map(of_change).collect();
        changes.extend(of_change(&requests[requests.len() - 1..]));
        changes
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn any_latency_comes_back(latency in 0u64..12, seed in 1u64..1000) {
            let levels = levels(latency, seed);
            let found = measure(&requests(), &levels).unwrap();
            prop_assert_eq!(found.frames as u64, latency);
            prop_assert!(found.lead > 1.5);
            prop_assert_eq!(found.of_changes, first_shown(&levels, latency));
        }
    }

    #[test]
    fn levels_that_do_not_follow_are_refused() {
        let still: Vec<Level> = (0..90).map(|frame| Level { frame, signal: 0.2 }).collect();
        let error = measure(&requests(), &still).unwrap_err();
        assert!(matches!(error, LatencyError::Unclear { .. }), "{error}");
        let error = measure(&requests()[..2], &still).unwrap_err();
        assert_eq!(error, LatencyError::FewChanges { found: 1 });
    }

    /// Twelve frames, two changes, four frames apart.
    fn short_requests() -> [Request; 3] {
        [(0, 0.001), (4, 0.01), (8, 0.001)].map(|(frame, exposure_s)| Request { frame, exposure_s })
    }

    #[test]
    fn a_late_guess_does_not_win_a_short_series_by_seeing_one_level_only() {
        // Two frames of each exposure, none of which was asked for: by a latency of ten frames or so only the last level is left.
        let levels: Vec<Level> = (0..12)
            .map(|frame| Level {
                frame,
                signal: 0.01 * 2f64.powi(frame as i32 / 2),
            })
            .collect();
        let error = measure(&short_requests(), &levels).unwrap_err();
        let LatencyError::Unclear { best, most, lead } = error else {
            panic!("{error}")
        };
        assert!(best <= most && most == 3 && lead >= 1.0, "{error}");
        for latency in 0..=2u64 {
            let follows = (0..12).map(|frame| Level {
                frame,
                signal: if (4..8).contains(&(frame - latency.min(frame))) {
                    0.2
                } else {
                    0.02
                },
            });
            let found = measure(&short_requests(), &follows.collect::<Vec<_>>()).unwrap();
            assert_eq!(found.frames as u64, latency);
        }
        let few: Vec<Level> = levels[3..9].to_vec();
        let error = measure(&short_requests(), &few).unwrap_err();
        assert_eq!(error, LatencyError::Short { frames: 6 });
    }
}
