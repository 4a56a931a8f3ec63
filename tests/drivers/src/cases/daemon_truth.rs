//! What cameras say about their frames, held against what the webcams know, and against each other.

use std::fmt;
use std::time::{Duration, Instant};

use mirrorball_capture::Exposure;
use mirrorball_driver_tests::webcam::Webcam;
use mirrorball_driver_tests::webcam::scene::Light;
use mirrorball_driver_tests::webcam::truth::FrameTruth;

use super::daemon_rig::RATE_HZ;
use super::daemon_support::{PATIENCE, Seen, Stage, frame_of};
use super::support::ensure;

/// What a description of exposure may be off by from the truth, in steps, and of white balance, likewise: the tables
/// have points every eighth of a stop and are straight between them.
pub(super) const TABLE_ERROR_EV: f64 = 0.005;

/// A frame held against the truth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Judged {
    pub(super) truth: FrameTruth,
    /// How far what the frame says about itself is from that.
    pub(super) error: Distance,
    /// Whether it is what the frame before or after had, or those after it that began before its time stamp: a request
    /// was accepted in between.
    pub(super) is_neighbours: bool,
    /// True signal for unit radiance in red, green and blue, after the correction that the frame carries.
    pub(super) factors: [f64; 3],
}

/// Distance between two exposures, in steps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Distance {
    /// Of time and gain together.
    pub(super) exposure_ev: f64,
    /// The greatest of the three gains of the white balance.
    pub(super) white_balance_ev: f64,
}

impl Distance {
    fn between(claimed: &Exposure, truth: &FrameTruth, webcam: &Webcam) -> Self {
        let gains = webcam.sensor().white_balance_gains(truth.settings).map(f64::from);
        let off = [0, 1, 2].map(|channel| (claimed.white_balance[channel] / gains[channel]).log2().abs());
        // An exposure of 1 is 10 ms.
        let exposure = claimed.time_s * claimed.gain / 0.01;
        Self {
            exposure_ev: (exposure / f64::from(truth.exposure)).log2().abs(),
            white_balance_ev: off.into_iter().fold(0.0, f64::max),
        }
    }

    fn max(self, other: Self) -> Self {
        Self {
            exposure_ev: self.exposure_ev.max(other.exposure_ev),
            white_balance_ev: self.white_balance_ev.max(other.white_balance_ev),
        }
    }
}

impl Judged {
    /// Whether what the frame says about itself is true.
    pub(super) fn is_true(&self) -> bool {
        self.error.exposure_ev < TABLE_ERROR_EV && self.error.white_balance_ev < TABLE_ERROR_EV
    }
}

impl Stage {
    /// Holds a frame against what its webcam knows about it; `index` is the camera's.
    pub(super) fn judge(&self, index: usize, seen: &Seen) -> Result<Judged, String> {
        let webcam = &self.webcams[index];
        let shown = seen.counter.ok_or("a picture without a frame counter")?;
        let truth = webcam.truth_of(shown).ok_or("a frame that no webcam has taken")?;
        let claimed = &seen.meta.exposure;
        let late_s = seen.meta.timestamp_ns.saturating_sub(truth.start_ns) as f64 * 1e-9;
        let n_after = 1 + (late_s * RATE_HZ).ceil() as u16;
        let near: Vec<Distance> = (0..=1 + n_after)
            .filter_map(|index| webcam.truth_of(shown.wrapping_sub(1).wrapping_add(index)))
            .map(|truth| Distance::between(claimed, &truth, webcam))
            .collect();
        let light = truth.light.radiance();
        Ok(Judged {
            truth,
            error: Distance::between(claimed, &truth, webcam),
            is_neighbours: near.iter().any(|distance| distance.exposure_ev < TABLE_ERROR_EV)
                && near.iter().any(|distance| distance.white_balance_ev < TABLE_ERROR_EV),
            factors: [0, 1, 2]
                .map(|channel| f64::from(truth.white_signal[channel] / light[channel]) * seen.meta.residual[channel]),
        })
    }
}

/// Sets the light of all webcams.
pub(super) fn set_light(stage: &Stage, level_ev: f32, temperature_k: f32) {
    for webcam in &stage.webcams {
        webcam.set_light(Light {
            level_ev,
            temperature_k,
        });
    }
}

/// Reads on until something is so.
pub(super) fn wait_until(stage: &mut Stage, what: &str, holds: impl Fn(&Stage) -> bool) -> Result<(), String> {
    let deadline = Instant::now() + PATIENCE;
    while !holds(stage) {
        ensure(Instant::now() < deadline, || format!("{what}: not within {PATIENCE:?}"))?;
        stage.reader.next(Duration::from_millis(100))?;
    }
    Ok(())
}

/// Frames without a change after which cameras count as settled: no two steps that measure a latency are further apart.
const STILL_FRAMES: usize = 20;

/// Reads on until no webcam has been asked for anything new for a while; returns the sets until then.
pub(super) fn sets_until_still(stage: &mut Stage) -> Result<Vec<Vec<Seen>>, String> {
    let mut sets = stage.reader.sets(STILL_FRAMES)?;
    let deadline = Instant::now() + PATIENCE;
    while stage
        .webcams
        .iter()
        .any(|webcam| still_for(&webcam.truth()) < STILL_FRAMES)
    {
        ensure(Instant::now() < deadline, || format!("not settled within {PATIENCE:?}"))?;
        sets.extend(stage.reader.sets(1)?);
    }
    Ok(sets)
}

/// Frames at the end with the same settings asked for and in force.
pub(super) fn still_for(frames: &[FrameTruth]) -> usize {
    let Some(last) = frames.last() else { return 0 };
    let is_same = |frame: &&FrameTruth| frame.requested == last.requested && frame.settings == last.requested;
    frames.iter().rev().take_while(is_same).count()
}

/// How well cameras agree with the truth and with each other.
#[derive(Debug, Default)]
pub(super) struct Match {
    pub(super) n_frames: usize,
    /// Frames that claim what the frame before or after had.
    pub(super) n_early_or_late: usize,
    /// Frames that claim what none of these had.
    pub(super) n_untrue: usize,
    /// The greatest error of the others.
    pub(super) worst_error: Distance,
    pub(super) n_pairs: usize,
    /// Greatest difference between two frames of one moment, after the correction they carry.
    pub(super) worst_mismatch_ev: f64,
}

/// Greatest difference of corrected exposures when settled.
const MISMATCH_EV: f64 = 0.02;

impl Match {
    pub(super) fn of(stage: &Stage, sets: &[Vec<Seen>]) -> Result<Self, String> {
        let mut found = Self::default();
        for set in sets {
            let mut pair = Vec::with_capacity(2);
            for (index, name) in ["scene", "ball"].into_iter().enumerate() {
                let Some(seen) = frame_of(set, name) else { continue };
                let judged = stage.judge(index, seen)?;
                found.n_frames += 1;
                if judged.is_true() {
                    found.worst_error = found.worst_error.max(judged.error);
                } else if judged.is_neighbours {
                    found.n_early_or_late += 1;
                    continue;
                } else {
                    found.n_untrue += 1;
                }
                pair.push((seen.meta.timestamp_ns, judged.factors[1]));
            }
            // Frames further apart than half an interval, as one between them was lost, may have different aims.
            if let [(scene_ns, scene), (ball_ns, ball)] = pair[..]
                && scene_ns.abs_diff(ball_ns) as f64 * 1e-9 < 0.5 / RATE_HZ
            {
                found.n_pairs += 1;
                found.worst_mismatch_ev = found.worst_mismatch_ev.max((ball / scene).log2().abs());
            }
        }
        Ok(found)
    }

    /// Fails unless every frame says what it is and cameras agree. In an emulated machine a time stamp may be late by
    /// some milliseconds, and a request fall between it and the true beginning of the frame: that is borne with in one
    /// frame of five.
    pub(super) fn check(&self) -> Result<(), String> {
        ensure(
            self.n_pairs > 3 && self.n_untrue == 0 && self.tells_the_truth() && self.worst_mismatch_ev <= MISMATCH_EV,
            || format!("every frame true and at most {MISMATCH_EV} EV apart was expected: {self}"),
        )
    }

    /// While controls change: a driver sets those of one request one after the other, and in an emulated machine under
    /// load that takes longer than a frame, which then has some of them. That is borne with in one frame of ten.
    pub(super) fn tells_the_truth(&self) -> bool {
        self.n_untrue * 10 <= self.n_frames && self.n_early_or_late * 5 <= self.n_frames
    }
}

impl fmt::Display for Match {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "{} frames ({} early or late, {} untrue, else within {:.4} EV), {} pairs within {:.4} EV",
            self.n_frames,
            self.n_early_or_late,
            self.n_untrue,
            self.worst_error.exposure_ev.max(self.worst_error.white_balance_ev),
            self.n_pairs,
            self.worst_mismatch_ev
        )
    }
}
