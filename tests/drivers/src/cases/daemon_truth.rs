//! What cameras say about their frames, held against what the webcams know, and against each other.

use std::fmt;
use std::time::{Duration, Instant};

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
    /// log2 of the exposure that the frame carries over the true one.
    pub(super) exposure_error_ev: f64,
    /// The greatest of the same for the three gains of the white balance, without sign.
    pub(super) white_balance_error_ev: f64,
    /// True signal for unit radiance in red, green and blue, after the correction that the frame carries.
    pub(super) factors: [f64; 3],
}

impl Judged {
    /// Whether what the frame says about itself is true.
    pub(super) fn is_true(&self) -> bool {
        self.exposure_error_ev.abs() < TABLE_ERROR_EV && self.white_balance_error_ev < TABLE_ERROR_EV
    }
}

impl Stage {
    /// Holds a frame against what its webcam knows about it; `index` is the camera's.
    pub(super) fn judge(&self, index: usize, seen: &Seen) -> Result<Judged, String> {
        let webcam = &self.webcams[index];
        let shown = seen.counter.ok_or("a picture without a frame counter")?;
        let truth = webcam.truth_of(shown).ok_or("a frame that no webcam has taken")?;
        let exposure = &seen.meta.exposure;
        let claimed = exposure.time_s * exposure.gain / 0.01;
        let gains = webcam.sensor().white_balance_gains(truth.settings).map(f64::from);
        let white_balance_error =
            [0, 1, 2].map(|channel| (exposure.white_balance[channel] / gains[channel]).log2().abs());
        let light = truth.light.radiance();
        Ok(Judged {
            truth,
            exposure_error_ev: (claimed / f64::from(truth.exposure)).log2(),
            white_balance_error_ev: white_balance_error.into_iter().fold(0.0, f64::max),
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

/// Reads on until no webcam has been asked for anything new for a while.
pub(super) fn wait_until_still(stage: &mut Stage) -> Result<(), String> {
    wait_until(stage, "settled cameras", |stage| {
        stage
            .webcams
            .iter()
            .all(|webcam| still_for(&webcam.truth()) >= STILL_FRAMES)
    })
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
    /// Frames that claim another exposure than they had.
    pub(super) n_untrue: usize,
    pub(super) worst_error_ev: f64,
    pub(super) worst_white_balance_ev: f64,
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
                found.n_untrue += usize::from(!judged.is_true());
                if !judged.is_true() {
                    println!(
                        "UNTRUE {name} {} {:?} {judged:?}",
                        seen.meta.sequence, seen.meta.exposure
                    );
                }
                found.worst_error_ev = found.worst_error_ev.max(judged.exposure_error_ev.abs());
                found.worst_white_balance_ev = found.worst_white_balance_ev.max(judged.white_balance_error_ev);
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

    pub(super) fn check(&self) -> Result<(), String> {
        ensure(
            self.n_pairs > 5 && self.n_untrue == 0 && self.worst_mismatch_ev <= MISMATCH_EV,
            || format!("every frame true and at most {MISMATCH_EV} EV apart was expected: {self}"),
        )
    }
}

impl fmt::Display for Match {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "{} of {} frames untrue (exposure by {:.4} EV, white balance by {:.4} EV at most), {} pairs at most {:.4} EV \
             apart",
            self.n_untrue,
            self.n_frames,
            self.worst_error_ev,
            self.worst_white_balance_ev,
            self.n_pairs,
            self.worst_mismatch_ev
        )
    }
}
