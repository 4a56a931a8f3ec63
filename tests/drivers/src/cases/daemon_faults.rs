//! The daemon on simulated USB webcams with every fault that webcams have: what is missing is counted with its cause,
//! what is there says the truth, and the other camera goes on.

use std::fs::File;
use std::thread;
use std::time::{Duration, Instant};

use mirrorball_driver_tests::raw_camera::{self, RawCamera};
use mirrorball_driver_tests::webcam::controls::{Control, MANUAL};
use mirrorball_driver_tests::webcam::truth::{Fate, FrameTruth};
use mirrorball_driver_tests::webcam::{FrameFault, Webcam};

use super::daemon_rig::{Camera, KNOWN_LATENCY, RATE_HZ, ball_camera, scene_camera};
use super::daemon_support::{Account, PATIENCE, Seen, Stage, frame_of, with_daemon};
use super::daemon_truth::{Match, set_light, sets_until_still, wait_until};
use super::support::{ensure, say, set_nodrop};

const SCENE: usize = 0;
const BALL: usize = 1;

/// The ball camera is unplugged, then the scene camera: the other goes on, and each is back within a moment, under
/// another node number. What was missed meanwhile is counted as such.
pub(super) fn unplug_and_replug_while_streaming() -> Result<(), String> {
    with_daemon(&[scene_camera(), ball_camera()], KNOWN_LATENCY, |stage| {
        let mut away = Vec::new();
        for (index, name) in [(BALL, "ball"), (SCENE, "scene")] {
            away.push(unplug_and_replug(stage, index, name)?);
        }
        let accounts = stage.end()?;
        for (index, away) in [BALL, SCENE].into_iter().zip(away) {
            let account = &accounts[index];
            let expected = away.as_secs_f64() * RATE_HZ;
            let found = account.lost_to("unplugged") as f64;
            println!("    away for {away:.2?}: {expected:.0} frames expected to be missed, {account:?}");
            ensure((found - expected).abs() <= 0.1 * expected + 4.0, || {
                format!("{expected:.0} frames were missed, the account is {account:?}")
            })?;
        }
        Ok(())
    })
}

/// Returns the time between the last frame before and the first frame after.
fn unplug_and_replug(stage: &mut Stage, index: usize, name: &'static str) -> Result<Duration, String> {
    let old_node = stage.webcams[index].node(PATIENCE).map_err(say)?;
    // Somebody who keeps the old node open takes its number from the new one.
    let kept = File::open(&old_node).map_err(say)?;
    let last = stage
        .reader
        .set_where("a frame before", |set| frame_of(set, name).is_some())?;
    let last_ns = frame_of(&last, name).map_or(0, |seen| seen.meta.timestamp_ns);
    stage.webcams[index].unplug();
    if index == BALL {
        // Sets go on, without it once those are out that it was in.
        stage
            .reader
            .set_where("sets without it", |set| frame_of(set, name).is_none())?;
        let ages: Vec<u64> = stage
            .reader
            .sets(8)?
            .iter()
            .filter_map(|set| Some(set.first()?.age_ns))
            .collect();
        let mean_ms = ages.iter().sum::<u64>() as f64 / ages.len().max(1) as f64 * 1e-6;
        println!("    sets without {name} come {mean_ms:.0} ms after their frames begin");
    } else {
        // Without the scene camera there are no sets.
        wait_until(stage, "a camera that is missed", |stage| {
            stage.daemon.log().contains("no camera: ")
        })?;
        thread::sleep(Duration::from_millis(500));
    }
    let unplugged_at = stage.webcams[index].truth().len();
    let begun = Instant::now();
    stage.webcams[index].replug().map_err(say)?;
    let new_node = stage.webcams[index].node(PATIENCE).map_err(say)?;
    let there = begun.elapsed();
    let first_counter = (unplugged_at & 0xFFFF) as u16;
    let is_new = |seen: &Seen| {
        seen.counter
            .is_some_and(|counter| counter.wrapping_sub(first_counter) < 0x8000)
    };
    let set = stage
        .reader
        .set_where("a frame after", |set| frame_of(set, name).is_some_and(is_new))?;
    let seen = frame_of(&set, name).ok_or("it was there")?;
    let reconnected = seen.arrived.duration_since(begun);
    println!(
        "    {name}: {} -> {}, node back after {there:.2?}, first frame published {reconnected:.2?} after the replug",
        old_node.display(),
        new_node.display()
    );
    drop(kept);
    ensure(new_node != old_node, || {
        format!("the node is {} again", new_node.display())
    })?;
    Ok(Duration::from_nanos(seen.meta.timestamp_ns.saturating_sub(last_ns)))
}

/// Each fault of a webcam, one after the other: the stream goes on or is started anew, and what the sensor took is
/// what was published plus what was lost.
pub(super) fn error_frames_short_frames_urb_errors_hang() -> Result<(), String> {
    set_nodrop(false)?;
    with_daemon(&[scene_camera(), ball_camera()], KNOWN_LATENCY, |stage| {
        for fault in [FrameFault::ErrorBit, FrameFault::Short, FrameFault::LostInSensor] {
            stage.webcams[BALL].befall(fault, 3);
            stage.reader.sets(6)?;
        }
        stage.webcams[BALL].befall(FrameFault::TransferError, 1);
        stage.reader.sets(8)?;
        // More than there are transfers: the stream gets stuck.
        stage.webcams[BALL].befall(FrameFault::TransferError, 20);
        wait_until(stage, "a new start after failed transfers", |stage| {
            stage.daemon.log().contains("stream restarted: ")
        })?;
        streams_again(stage, "after failed transfers")?;
        stage.webcams[BALL].hang(true);
        wait_until(stage, "a new start of a webcam that hangs", |stage| {
            stage.daemon.log().contains("stream restarted: no frame for ")
        })?;
        stage.webcams[BALL].hang(false);
        streams_again(stage, "after a hang")?;
        let accounts = stage.end()?;
        let ball = &accounts[BALL];
        println!("    {ball:?}");
        check_sum(&stage.webcams[BALL], ball)?;
        check_sum(&stage.webcams[SCENE], &accounts[SCENE])?;
        ensure(ball.lost_to("driver drop") >= 6, || {
            format!("six damaged frames are drops of the driver: {ball:?}")
        })?;
        ensure(ball.lost_to("sensor gap") >= 3, || {
            format!("three frames were lost in the sensor: {ball:?}")
        })?;
        ensure(ball.lost_to("stream restart") > 0, || {
            format!("the stream was started anew: {ball:?}")
        })
    })
}

/// The ball camera sends frames that the daemon takes, a while from now.
fn streams_again(stage: &mut Stage, when: &str) -> Result<(), String> {
    let last = stage.webcams[BALL].truth().len();
    let is_later = |seen: &Seen| {
        let counter = seen.counter.unwrap_or(0);
        counter.wrapping_sub((last & 0xFFFF) as u16) < 0x8000
    };
    let what = format!("the ball camera {when}");
    let wanted = |set: &[Seen]| frame_of(set, "ball").is_some_and(is_later);
    stage.reader.set_where(&what, wanted)?;
    stage.reader.sets(5).map(|_| ())
}

/// Frames and losses are the frames that the sensor took, and the time in which it took none.
fn check_sum(webcam: &Webcam, account: &Account) -> Result<(), String> {
    let frames = webcam.truth();
    let times: Vec<u64> = frames.iter().map(|frame| frame.start_ns).collect();
    let (Some(first), Some(last)) = (times.first(), times.last()) else {
        return Err("the sensor took no frames".to_owned());
    };
    let slots = ((last - first) as f64 * 1e-9 * RATE_HZ).round() + 1.0;
    let accounted = (account.frames + account.lost) as f64;
    let named: u64 = account.causes.iter().map(|(_, frames)| frames).sum();
    ensure(named == account.lost, || format!("a loss without cause: {account:?}"))?;
    println!(
        "    the sensor took {} frames in the time of {slots}; {} published, {} lost",
        frames.len(),
        account.frames,
        account.lost
    );
    let took = frames.len() as f64;
    // The last frames may be on their way still; and time that is estimated from late stamps may be a little off.
    ensure(accounted >= took - 3.0 && accounted <= slots * 1.05 + 4.0, || {
        format!("{accounted} frames accounted for, {took} taken in the time of {slots}: {account:?}")
    })
}

/// While a camera refuses what it is asked for, its frames say what they are; when it stops refusing it comes along.
pub(super) fn stalled_controls() -> Result<(), String> {
    with_daemon(&[scene_camera(), ball_camera()], KNOWN_LATENCY, |stage| {
        stage.reader.sets(5)?;
        stage.webcams[BALL].stall_control(Control::ExposureTime, Some(5));
        let before = stage.webcams[BALL].control(Control::ExposureTime);
        set_light(stage, 1.5, 6504.0);
        // Frames of one moment have one aim again when the scene camera has settled.
        stage.reader.sets(30)?;
        let sets = stage.reader.sets(10)?;
        ensure(stage.webcams[BALL].control(Control::ExposureTime) == before, || {
            "the stall does not hold".to_owned()
        })?;
        let stalled = Match::of(stage, &sets)?;
        println!("    stalled: {stalled}");
        stalled.check()?;
        stage.webcams[BALL].stall_control(Control::ExposureTime, None);
        wait_until(stage, "an exposure time that is set again", |stage| {
            stage.webcams[BALL].control(Control::ExposureTime) != before
        })?;
        sets_until_still(stage)?;
        let sets = stage.reader.sets(10)?;
        let after = Match::of(stage, &sets)?;
        println!("    after: {after}");
        after.check()?;
        let refusals = stage.daemon.log().matches("request refused").count();
        ensure(refusals > 0, || "no refusal is in the log".to_owned())
    })
}

/// Somebody else switches the automatics on, and then the webcam's firmware does, of which nobody is told: the daemon
/// takes them back, and frames carry the truth again.
pub(super) fn auto_modes_switched_on_behind_our_back() -> Result<(), String> {
    with_daemon(&[scene_camera(), ball_camera()], KNOWN_LATENCY, |stage| {
        let node = stage.webcams[BALL].node(PATIENCE).map_err(say)?;
        let other = RawCamera::open(&node).map_err(say)?;
        other.set_control(raw_camera::EXPOSURE_MODE, 3).map_err(say)?;
        other.set_control(raw_camera::WHITE_BALANCE_AUTO, 1).map_err(say)?;
        taken_back(stage, "another program")?;
        for webcam in &stage.webcams {
            webcam.switch_automatics_on();
        }
        // In other light the webcams' own automatics do something.
        set_light(stage, 1.0, 6504.0);
        taken_back(stage, "the firmware")
    })
}

fn taken_back(stage: &mut Stage, whose: &str) -> Result<(), String> {
    let begun = Instant::now();
    wait_until(stage, &format!("manual controls after {whose}"), |stage| {
        let is_manual = |webcam: &Webcam| {
            webcam.control(Control::ExposureMode) == MANUAL && webcam.control(Control::WhiteBalanceAuto) == 0
        };
        stage.webcams.iter().all(is_manual)
    })?;
    println!("    taken back from {whose} after {:.2?}", begun.elapsed());
    sets_until_still(stage)?;
    let sets = stage.reader.sets(10)?;
    let after = Match::of(stage, &sets)?;
    println!("    {after}");
    after.check()
}

/// JPEG pictures that are cut off are lost as such, each of them, and the stream goes on.
pub(super) fn truncated_mjpeg() -> Result<(), String> {
    let scene = Camera {
        keys: "latency_frames = 2\nformats = [\"mjpeg\"]\nrate_hz = 60.0",
        ..scene_camera()
    };
    with_daemon(&[scene], KNOWN_LATENCY, |stage| {
        // JPEG pictures of this size come at 60 a second only, which is too much here.
        stage.webcams[SCENE].slow_down(4.0);
        stage.reader.sets(5)?;
        stage.webcams[SCENE].befall(FrameFault::Short, 5);
        let sets = stage.reader.sets(20)?;
        let cut: Vec<FrameTruth> = stage.webcams[SCENE]
            .truth()
            .into_iter()
            .filter(|frame| frame.fate == Fate::Faulty(FrameFault::Short))
            .collect();
        let is_cut = |seen: &Seen| {
            cut.iter()
                .any(|frame| seen.counter == Some((frame.counter & 0xFFFF) as u16))
        };
        let n_published = sets.iter().flatten().filter(|seen| is_cut(seen)).count();
        ensure(n_published == 0, || {
            format!("{n_published} cut pictures were published")
        })?;
        let account = &stage.end()?[SCENE];
        println!("    {account:?}");
        ensure(cut.len() == 5 && account.lost_to("bad JPEG") == 5, || {
            format!("{} pictures were cut, the account is {account:?}", cut.len())
        })
    })
}

/// A camera that is slower than agreed: every frame of the leader has a frame of it beside it, and once its pace is
/// known no frame counts as lost.
pub(super) fn one_camera_slower_than_the_other() -> Result<(), String> {
    with_daemon(&[scene_camera(), ball_camera()], KNOWN_LATENCY, |stage| {
        stage.webcams[BALL].slow_down(1.5);
        stage.reader.sets(30)?;
        let sets = stage.reader.sets(20)?;
        let n_whole = sets.iter().filter(|set| set.len() == 2).count();
        let mut counters: Vec<_> = sets.iter().filter_map(|set| frame_of(set, "ball")?.counter).collect();
        counters.dedup();
        println!(
            "    {} sets, {n_whole} of them whole, {} frames of the ball camera",
            sets.len(),
            counters.len()
        );
        ensure(
            n_whole * 10 >= sets.len() * 9 && counters.len() * 10 <= sets.len() * 8,
            || {
                format!(
                    "{n_whole} of {} sets are whole, with {} frames",
                    sets.len(),
                    counters.len()
                )
            },
        )?;
        let match_ = Match::of(stage, &sets)?;
        println!("    {match_}");
        match_.check()?;
        // One frame of the slower camera may be in several sets.
        let mut frames: Vec<_> = sets.iter().filter_map(|set| frame_of(set, "ball")).collect();
        frames.dedup_by_key(|seen| seen.meta.sequence);
        let lost: u32 = frames.iter().map(|seen| seen.meta.lost_before).sum();
        let accounts = stage.end()?;
        println!("    {accounts:?}");
        // Until the new pace is known, which takes 16 frames, each may count for another that did not come.
        ensure(lost <= 4 && accounts[BALL].lost <= 20, || {
            format!("{lost} lost at a steady pace, in all {:?}", accounts[BALL])
        })
    })
}
