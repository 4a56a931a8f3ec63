//! The daemon on two simulated USB webcams that differ in every way: kept in step while the light of the room jumps and
//! its colour changes.

// The colour difference is the one that the state machine's own tests measure with.
#[path = "../../../../capture/tests/lockstep/delta_e.rs"]
mod delta_e;

use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use delta_e::{delta_e_2000, lab};
use image::imageops;
use mirrorball_driver_tests::webcam::scene::{Film, LinearPicture, Scene};
use mirrorball_driver_tests::webcam::truth::FrameTruth;

use super::daemon_rig::{KNOWN_LATENCY, ball_camera, scene_camera};
use super::daemon_support::{Seen, Stage, frame_of, with_daemon};
use super::daemon_truth::{Match, set_light, sets_until_still, wait_until};
use super::support::{ensure, say};

/// Most by which an exposure on its way may go past where it ends.
const OVERSHOOT_EV: f64 = 0.3;
/// An exposure, and a gain of the white balance, this near to where it ends has settled.
const SETTLED_EV: f64 = 0.05;
/// Most frames until then, after a jump of four stops or to light of another colour.
const SETTLED_FRAMES: usize = 60;
/// Most changes of exposure that a settled camera asks for within a phase.
const CHANGES_AFTER: usize = 3;
/// Mean colour difference between the cameras.
const DELTA_E_MEAN: f64 = 1.5;

/// Two webcams with 2 and 4 frames of latency, which is measured, exposures off by 2 % each its way, and other colours:
/// the room gets 4 EV brighter, darker again, and then like lamps.
pub(super) fn two_webcams_are_kept_in_step() -> Result<(), String> {
    let [scene, ball] = [scene_camera(), ball_camera()].map(|camera| super::daemon_rig::Camera { keys: "", ..camera });
    with_daemon(&[scene, ball], "max_exposure_s = 0.03", |stage| {
        let begun = Instant::now();
        wait_until(stage, "latencies that are known", |stage| {
            stage
                .status()
                .is_ok_and(|status| status.cameras.iter().filter(|camera| camera.is_latency_known).count() == 2)
        })?;
        let latencies: Vec<_> = stage
            .status()?
            .cameras
            .iter()
            .map(|camera| camera.latency_frames)
            .collect();
        println!("    latencies {latencies:?} measured after {:.1?}", begun.elapsed());
        ensure(latencies == [Some(2), Some(4)], || {
            format!("latencies of 2 and 4 frames, found {latencies:?}")
        })?;
        sets_until_still(stage)?;
        for (level_ev, temperature_k) in [(4.0, 6504.0), (0.0, 6504.0), (0.0, 3200.0)] {
            set_light(stage, level_ev, temperature_k);
            let sets = sets_until_still(stage)?;
            let figures = Figures::of(stage, &sets)?;
            println!("    light {level_ev} EV, {temperature_k} K: {figures}");
            figures.check()?;
        }
        stage.end().map(|_| ())
    })
}

/// What happened after a change of the light.
#[derive(Debug)]
struct Figures {
    /// Frames of the scene camera until its exposure had settled.
    settled_after: usize,
    overshoot_ev: f64,
    /// Changes of exposure asked for after that.
    changes_after: usize,
    /// All frames.
    all: Match,
    /// From the third frame after the change on.
    soon: Match,
    /// Once settled.
    settled: Match,
    delta_e_mean: f64,
}

impl Figures {
    fn of(stage: &Stage, sets: &[Vec<Seen>]) -> Result<Self, String> {
        let frames = stage.webcams[0].truth();
        let light = frames.last().ok_or("no frames")?.light;
        let first = frames
            .iter()
            .position(|frame| frame.light == light && frame.counter > 0);
        // The same light may have been on earlier: the last change of light is what counts.
        let last_other = frames.iter().rposition(|frame| frame.light != light);
        let after = &frames[last_other.map_or(first.unwrap_or(0), |index| index + 1)..];
        let first_counter = after.first().ok_or("the light never changed")?.counter;
        let (settled_after, overshoot_ev) = course(stage, after);
        let requested: Vec<_> = after[settled_after..]
            .iter()
            .map(|frame| (frame.requested.exposure_100us, frame.requested.gain))
            .collect();
        let from = |n_frames: u64| -> Vec<Vec<Seen>> {
            let is_later = |set: &&Vec<Seen>| {
                let counter = frame_of(set, "scene").and_then(|seen| seen.counter);
                let age = counter.map(|counter| counter.wrapping_sub((first_counter & 0xFFFF) as u16));
                age.is_some_and(|age| age < 0x8000 && u64::from(age) >= n_frames)
            };
            sets.iter().filter(is_later).cloned().collect()
        };
        // The other camera's own steps may come a few frames later.
        let settled = from(settled_after as u64 + 8);
        Ok(Self {
            settled_after,
            overshoot_ev,
            changes_after: requested.windows(2).filter(|pair| pair[0] != pair[1]).count(),
            all: Match::of(stage, sets)?,
            soon: Match::of(stage, &from(3))?,
            settled: Match::of(stage, &settled)?,
            delta_e_mean: delta_e_mean(stage, &settled)?,
        })
    }

    fn check(&self) -> Result<(), String> {
        self.settled.check()?;
        ensure(self.settled_after <= SETTLED_FRAMES, || {
            "it settles too late".to_owned()
        })?;
        ensure(self.overshoot_ev <= OVERSHOOT_EV, || "it goes past its aim".to_owned())?;
        ensure(self.changes_after <= CHANGES_AFTER, || "it swings".to_owned())?;
        ensure(self.delta_e_mean <= DELTA_E_MEAN, || "the colours differ".to_owned())?;
        ensure(self.all.tells_the_truth(), || {
            "frames do not say what they are".to_owned()
        })
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "settled after {} frames, {:.2} EV past it, {} changes after\n      all: {}\n      from the third frame: \
             {}\n      settled: {}, ΔE00 {:.2} mean",
            self.settled_after,
            self.overshoot_ev,
            self.changes_after,
            self.all,
            self.soon,
            self.settled,
            self.delta_e_mean
        )
    }
}

/// Frames until the exposure and the white balance had settled, and by how much the exposure went past where it ended,
/// in steps.
fn course(stage: &Stage, frames: &[FrameTruth]) -> (usize, f64) {
    let Some((first, last)) = frames.first().zip(frames.last()) else {
        return (0, 0.0);
    };
    let exposure_ev = |frame: &FrameTruth| f64::from(frame.exposure).log2() - f64::from(last.exposure).log2();
    let gains = |frame: &FrameTruth| stage.webcams[0].sensor().white_balance_gains(frame.settings);
    let end = gains(last);
    let white_balance_ev = |frame: &FrameTruth| {
        let gains = gains(frame);
        let off = [0, 2].map(|channel| f64::from(gains[channel] / end[channel]).log2().abs());
        off[0].max(off[1])
    };
    let is_off = |frame: &FrameTruth| exposure_ev(frame).abs() > SETTLED_EV || white_balance_ev(frame) > SETTLED_EV;
    let settled = frames.iter().rposition(is_off).map_or(0, |index| index + 1);
    let direction = -exposure_ev(first).signum();
    let past = frames
        .iter()
        .map(|frame| exposure_ev(frame) * direction)
        .fold(0.0, f64::max);
    (settled, past)
}

/// Mean colour difference of a grey card between the two cameras, as corrected.
fn delta_e_mean(stage: &Stage, sets: &[Vec<Seen>]) -> Result<f64, String> {
    let mut differences = Vec::with_capacity(sets.len());
    for set in sets {
        let (Some(scene), Some(ball)) = (frame_of(set, "scene"), frame_of(set, "ball")) else {
            continue;
        };
        let mut colours = Vec::with_capacity(2);
        for (index, seen) in [scene, ball].into_iter().enumerate() {
            let truth = stage.judge(index, seen)?.truth;
            let white = truth.white_signal.map(f64::from);
            colours.push([0, 1, 2].map(|channel| white[channel] * seen.meta.residual[channel]));
        }
        // The scene camera's green is that of a card of 36 %.
        let scale = 0.36 / colours[0][1];
        let [one, other] = [0, 1].map(|index| lab(colours[index].map(|channel| channel * scale)));
        differences.push(delta_e_2000(one, other));
    }
    Ok(differences.iter().sum::<f64>() / differences.len().max(1) as f64)
}

/// A recording is the scene, each webcam's pictures those of its camera: moving pictures, and the cameras keep in step.
pub(super) fn a_recording_is_the_scene() -> Result<(), String> {
    with_daemon(&[scene_camera(), ball_camera()], KNOWN_LATENCY, |stage| {
        let start = Instant::now();
        for (webcam, camera) in stage.webcams.iter().zip(["scene", "probe"]) {
            webcam.set_scene(Scene::Film(Film {
                pictures: Arc::new(recorded(camera)?),
                rate_hz: 2.0,
                start,
            }));
        }
        stage.reader.sets(15)?;
        let sets = stage.reader.sets(15)?;
        let found = Match::of(stage, &sets)?;
        println!("    {found}");
        let mut shown = [false; 2];
        for seen in sets.iter().filter_map(|set| frame_of(set, "scene")) {
            shown[stage.judge(0, seen)?.truth.picture_index] = true;
        }
        ensure(shown == [true; 2], || "the film does not run".to_owned())?;
        found.check()
    })
}

/// The pictures of one camera of the recording with two cameras.
fn recorded(camera: &str) -> Result<Vec<LinearPicture>, String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../data/two_cameras/recording");
    let frames = std::fs::read_to_string(folder.join("frames.csv")).map_err(say)?;
    let mut pictures = Vec::new();
    for line in frames.lines() {
        let cells: Vec<&str> = line.split(',').collect();
        let [name, _, _, file, exposure_s, gain, ..] = cells[..] else {
            return Err(format!("a line of another kind: {line}"));
        };
        if name == camera {
            let picture = image::open(folder.join(file)).map_err(say)?.to_rgb8();
            let picture = imageops::resize(&picture, 320, 240, imageops::FilterType::Nearest);
            let exposure: f32 = exposure_s.parse().map_err(say)?;
            let gain: f32 = gain.parse().map_err(say)?;
            pictures.push(LinearPicture::from_recorded(&picture, exposure * gain / 0.01));
        }
    }
    ensure(!pictures.is_empty(), || {
        format!("no pictures of `{camera}` in {}", folder.display())
    })?;
    Ok(pictures)
}
