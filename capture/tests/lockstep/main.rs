//! Two simulated cameras in a simulated room, kept in step: 100 µs steps of exposure, other gains, other colours, 2 and
//! 4 frames of latency, exposure 2 % off the straight line, tables calibrated to 0.3 %, noise, 8 bits, clipping.
//!
//! **Exposure match** is log2 of the ratio of the two cameras' light on the pixels that neither shows near black or
//! clipped, after each frame's residual; a frame of the leader is compared to the other camera's nearest in time.

mod delta_e;
mod rig;
mod room;

use delta_e::{delta_e_2000, lab};
use mirrorball_capture::lockstep::latency::LatencySource;
use mirrorball_capture::lockstep::{Lockstep, LockstepCamera, LockstepSettings, Mains, Mode, Target};
use mirrorball_capture::{ControlKind, Exposure};
use rig::{Faults, Rig, Taken};
use room::{Light, Model, PATCHES, PIXELS, PROBE, Random, SCENE, srgb_decode};

/// What tables are off by after a calibration (standard deviation).
const TABLE_ERROR: f64 = 0.003;

const EVENING: Light = Light {
    level_ev: 0.0,
    kelvin: 4000.0,
};

fn settings() -> LockstepSettings {
    LockstepSettings {
        max_exposure_s: 0.03,
        ..LockstepSettings::default()
    }
}

fn cameras(models: &[Model], seed: u64, knows_latency: bool) -> Vec<LockstepCamera> {
    let mut random = Random(seed);
    let camera = |model: &Model| {
        let latency_frames = knows_latency.then_some(model.latency_frames);
        model.camera(model.tables(TABLE_ERROR, &mut random), latency_frames)
    };
    models.iter().map(camera).collect()
}

fn rig(settings: LockstepSettings, models: &[Model], seed: u64, knows_latency: bool) -> Rig {
    let lockstep = Lockstep::new(settings, cameras(models, seed, knows_latency)).expect("good settings");
    Rig::new(lockstep, models, seed)
}

/// The leader's frames, each with the other camera's nearest in time.
fn pairs(taken: &[Taken]) -> Vec<(&Taken, &Taken)> {
    let nearest = |leader: &Taken| {
        let others = taken.iter().filter(|frame| frame.camera == 1);
        others.min_by_key(|frame| frame.timestamp_ns.abs_diff(leader.timestamp_ns))
    };
    let leaders = taken.iter().filter(|frame| frame.camera == 0);
    leaders.filter_map(|leader| Some((leader, nearest(leader)?))).collect()
}

/// Linear pixels at the common target; none where a code is near black or clipped.
fn corrected(frame: &Taken, pixel: usize) -> Option<[f64; 3]> {
    let codes = &frame.pixels[3 * pixel..3 * pixel + 3];
    let is_sound = codes.iter().all(|code| (12..250).contains(code));
    is_sound.then(|| std::array::from_fn(|channel| srgb_decode(codes[channel]) * frame.said.residual[channel]))
}

/// Exposure match in steps, and on how many pixels.
fn match_ev((one, other): (&Taken, &Taken)) -> (f64, usize) {
    let both = (0..PIXELS).filter_map(|pixel| corrected(one, pixel).zip(corrected(other, pixel)));
    let luminance = |rgb: [f64; 3]| 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
    let sums = both.fold((0.0, 0.0, 0), |(sum, other_sum, n), (one, other)| {
        (sum + luminance(one), other_sum + luminance(other), n + 1)
    });
    ((sums.1 / sums.0).log2(), sums.2)
}

/// Mean CIEDE2000 over the patches between the two cameras' pictures.
fn match_delta_e((one, other): (&Taken, &Taken), patch_of: &[usize]) -> f64 {
    let mut sums = [([0.0; 3], [0.0; 3], 0.0_f64); PATCHES];
    for pixel in 0..PIXELS {
        if let Some((one, other)) = corrected(one, pixel).zip(corrected(other, pixel)) {
            let sum = &mut sums[patch_of[pixel]];
            for channel in 0..3 {
                sum.0[channel] += one[channel];
                sum.1[channel] += other[channel];
            }
            sum.2 += 1.0;
        }
    }
    let seen = sums.iter().filter(|sum| sum.2 >= 4.0);
    let differences = seen.map(|(one, other, n)| delta_e_2000(lab(one.map(|c| c / n)), lab(other.map(|c| c / n))));
    let differences: Vec<f64> = differences.collect();
    assert!(differences.len() > PATCHES / 2, "too few patches are seen by both");
    mean(&differences)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn worst(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |worst, value| worst.max(value.abs()))
}

/// log2 of the scalar exposure in force, as said.
fn exposure_log2(frame: &Taken) -> f64 {
    let Exposure { time_s, gain, .. } = frame.said.exposure;
    (time_s * gain).log2()
}

/// What is said of every frame agrees with what the simulated camera did.
fn assert_truthful(taken: &[Taken], models: &[Model]) {
    for frame in taken.iter().filter(|frame| frame.said.is_certain) {
        let model = &models[frame.camera];
        let truth = |kind| frame.truth.get(kind).expect("every control has a value");
        let time_s = model.time_s(truth(ControlKind::ExposureTime));
        let gain = model.gain(truth(ControlKind::Gain));
        let off = (exposure_log2(frame) - (time_s * gain).log2()).abs();
        assert!(
            off < 0.03,
            "camera {} at {} ns: {off} EV",
            frame.camera,
            frame.timestamp_ns
        );
    }
}

/// Mean exposure match of several set-ups under steady light, with tables that are off by `table_error`.
fn static_matches(table_error: f64, n_seeds: u64) -> Vec<f64> {
    let models = [SCENE, PROBE];
    let mut means = Vec::new();
    for seed in 0..n_seeds {
        for level_ev in [-3.0, 0.0, 3.0] {
            let light = Light { level_ev, ..EVENING };
            let mut random = Random(seed);
            let cameras = models.map(|model| {
                let tables = model.tables(table_error, &mut random);
                model.camera(tables, Some(model.latency_frames))
            });
            let mut rig = Rig::new(
                Lockstep::new(settings(), cameras.to_vec()).expect("good settings"),
                &models,
                seed,
            );
            rig.run(4.0, |_| light);
            let taken = rig.run(4.5, |_| light);
            assert_truthful(&taken, &models);
            let offs: Vec<f64> = pairs(&taken).into_iter().map(|pair| match_ev(pair).0).collect();
            assert!(worst(&offs) <= 0.05, "seed {seed}, {level_ev} EV: {offs:?}");
            means.push(mean(&offs));
        }
    }
    means
}

#[test]
fn static_light_is_matched() {
    let rms = |means: &[f64]| (means.iter().map(|off| off * off).sum::<f64>() / means.len() as f64).sqrt();
    let exact = static_matches(0.0, 4);
    println!(
        "exposure match, static light, tables exact: rms {:.4} EV, worst {:.4} EV",
        rms(&exact),
        worst(&exact)
    );
    assert!(worst(&exact) <= 0.02, "{exact:?}");
    let usual = static_matches(TABLE_ERROR, 12);
    println!(
        "exposure match, static light, tables off by 0.3 %: rms {:.4} EV, worst {:.4} EV",
        rms(&usual),
        worst(&usual)
    );
    // Three tables of each of two cameras, each off by 0.3 %, are together off by 0.011 EV.
    assert!(rms(&usual) <= 0.02, "{usual:?}");
}

/// What became of a step of light.
#[derive(Debug)]
struct StepRun {
    /// Worst exposure match from the third pair after the step on.
    match_ev: f64,
    /// Frames until the leader's exposure stays within a tenth of a step of where it ends.
    settled_frames: usize,
    /// How far past its end the leader's exposure went.
    overshoot_ev: f64,
    /// Pairs whose cameras are exposed for different targets.
    n_apart: usize,
}

fn step_run(models: &[Model], step_ev: f64, seed: u64, faults: Faults) -> StepRun {
    let mut rig = rig(settings(), models, seed, true);
    let base_ev = if step_ev > 0.0 { -2.0 } else { 2.0 };
    let step_s = 4.0 + 0.1 * Random(seed).even();
    let light = |s: f64| Light {
        level_ev: if s < step_s { base_ev } else { base_ev + step_ev },
        ..EVENING
    };
    rig.run(3.5, light);
    rig.faults = faults;
    let taken = rig.run(6.0, light);
    assert_truthful(&taken, models);
    let after = |frame: &&Taken| frame.timestamp_ns as f64 * 1e-9 >= step_s;
    let both: Vec<(&Taken, &Taken)> = pairs(&taken).into_iter().filter(|pair| after(&pair.0)).collect();
    let enough = |(ev, n): (f64, usize)| (n >= 30).then_some(ev);
    let offs: Vec<f64> = both[3..].iter().filter_map(|pair| enough(match_ev(*pair))).collect();
    assert!(
        offs.len() + 6 >= both.len(),
        "hardly anything to compare: {} of {}",
        offs.len(),
        both.len()
    );
    let leader: Vec<f64> = both.iter().map(|pair| exposure_log2(pair.0)).collect();
    let end = leader[leader.len() - 1];
    let settled = leader
        .iter()
        .rposition(|log2| (log2 - end).abs() > 0.1)
        .map_or(0, |last| last + 1);
    let overshoot = leader
        .iter()
        .map(|log2| (end - log2) * step_ev.signum())
        .fold(0.0, f64::max);
    let is_apart = |pair: &&(&Taken, &Taken)| {
        let left_over_ev = pair.0.said.residual[1].log2() - pair.1.said.residual[1].log2();
        left_over_ev.abs() > 0.2
    };
    StepRun {
        match_ev: worst(&offs),
        settled_frames: settled,
        overshoot_ev: overshoot,
        n_apart: both.iter().filter(is_apart).count(),
    }
}

#[test]
fn steps_of_four_ev_are_followed() {
    let slow = Model {
        latency_frames: 3,
        ..SCENE
    };
    let faults = Faults {
        lost: 0.02,
        lost_in_sensor: 0.005,
        refused: 0.02,
        late: 0.05,
    };
    for (name, models, faults) in [
        ("latency 2 and 4", [SCENE, PROBE], Faults::default()),
        ("latency 3 and 4", [slow, PROBE], Faults::default()),
        (
            "latency 2 and 4, frames lost, requests refused and late",
            [SCENE, PROBE],
            faults,
        ),
    ] {
        for step_ev in [4.0, -4.0] {
            let runs: Vec<_> = (0..10).map(|seed| step_run(&models, step_ev, seed, faults)).collect();
            let off = runs.iter().fold(0.0, |worst, run| f64::max(worst, run.match_ev));
            let settled = runs.iter().map(|run| run.settled_frames).max().unwrap();
            let usual = runs.iter().map(|run| run.settled_frames).sum::<usize>() as f64 / runs.len() as f64;
            let overshoot = runs.iter().fold(0.0, |worst, run| f64::max(worst, run.overshoot_ev));
            println!(
                "{step_ev:+} EV, {name}: match after 3 frames {off:.3} EV at worst, exposure settled after {usual:.1} \
                 frames ({settled} at most), overshoot {overshoot:.3} EV"
            );
            assert!(off <= 0.05 && overshoot <= 0.3, "{runs:?}");
            // Requests come into force on the same frame.
            let is_faultless = faults.lost == 0.0;
            assert!(!is_faultless || runs.iter().all(|run| run.n_apart == 0), "{runs:?}");
            // Three rounds of latency at most, then a small difference closes smoothly.
            assert!(settled <= 30, "{runs:?}");
        }
    }
}

#[test]
fn white_balance_is_matched() {
    let models = [SCENE, PROBE];
    let mut all = Vec::new();
    for kelvin in [2700.0, 3200.0, 4000.0, 5000.0, 5600.0, 6500.0] {
        let light = Light { level_ev: 0.0, kelvin };
        let mut found = Vec::new();
        for seed in 0..4 {
            let mut rig = rig(settings(), &models, seed, true);
            rig.run(8.0, |_| light);
            let taken = rig.run(8.2, |_| light);
            let patch_of = rig.room.patch.clone();
            found.extend(pairs(&taken).into_iter().map(|pair| match_delta_e(pair, &patch_of)));
        }
        println!(
            "white balance match at {kelvin} K: mean ΔE00 {:.2}, worst {:.2}",
            mean(&found),
            worst(&found)
        );
        all.extend(found);
    }
    println!("white balance match: mean ΔE00 {:.2}", mean(&all));
    assert!(mean(&all) <= 1.5);
}

#[test]
fn white_balance_makes_grey_grey_after_a_change_of_light() {
    let models = [SCENE, PROBE];
    let mut rig = rig(settings(), &models, 5, true);
    let light = |s: f64| Light {
        level_ev: 0.0,
        kelvin: if s < 6.0 { 5600.0 } else { 3000.0 },
    };
    rig.run(6.0, light);
    let taken = rig.run(12.0, light);
    let Target { white_balance, .. } = *rig.lockstep.target();
    let light = mirrorball_capture::lockstep::tables::TemperatureTable::black_body().gains(3000.0);
    for channel in [0, 2] {
        // The patches are not grey on the whole; their own colour stays in the estimate.
        let off = (white_balance[channel] / light[channel]).log2().abs();
        assert!(off < 0.25, "channel {channel}: {off}");
    }
    // From one light to the other without turning back: blue gain only rises, but for a step of the camera's control.
    let blue = |frame: &&Taken| (frame.camera == 0).then(|| frame.said.exposure.white_balance[2]);
    let blues: Vec<f64> = taken.iter().filter_map(|frame| blue(&frame)).collect();
    let mut most = 0.0;
    for blue in blues {
        assert!(blue > 0.99 * most, "{blue} after {most}");
        most = f64::max(most, blue);
    }
}

/// Changes of the target until a moment, and how often it turned by more than a code of the picture.
fn count_turns(rig: &mut Rig, until_s: f64, light: impl Fn(f64) -> Light) -> (usize, usize) {
    const CODE_EV: f64 = 0.03;
    let (mut n_changes, mut n_turns, mut is_rising) = (0, 0, None);
    let mut before = rig.lockstep.target().exposure_s.log2();
    let (mut least, mut most) = (before, before);
    let mut at_s = 0.0;
    while at_s < until_s {
        let Some(taken) = rig.step(&light) else { continue };
        at_s = taken.timestamp_ns as f64 * 1e-9;
        let now = rig.lockstep.target().exposure_s.log2();
        n_changes += usize::from(now != before);
        before = now;
        (least, most) = (least.min(now), most.max(now));
        let turn = match is_rising {
            Some(true) | None if now < most - CODE_EV => Some(false),
            Some(false) | None if now > least + CODE_EV => Some(true),
            _ => continue,
        };
        n_turns += usize::from(is_rising.is_some());
        is_rising = turn;
        (least, most) = (now, now);
    }
    (n_changes, n_turns)
}

#[test]
fn nothing_swings_under_noise_and_slow_drift() {
    let models = [Model { noise: 0.03, ..SCENE }, PROBE];
    let mut rig = rig(settings(), &models, 9, true);
    rig.run(5.0, |_| EVENING);
    let still = count_turns(&mut rig, 65.0, |_| EVENING);
    println!("a minute of steady light: {} changes of the target", still.0);
    assert!(still.0 == 0, "{still:?}");
    let drift = |s: f64| Light {
        level_ev: ((s - 65.0) * std::f64::consts::TAU / 60.0).sin(),
        ..EVENING
    };
    let drifting = count_turns(&mut rig, 65.0 + 180.0, drift);
    println!(
        "three minutes of ±1 EV a minute: {} changes, {} turns",
        drifting.0, drifting.1
    );
    // The light itself turns six times.
    assert!(drifting.1 <= 6, "{drifting:?}");
}

#[test]
fn a_window_in_the_picture_makes_nothing_swing() {
    let models = [SCENE, PROBE];
    let (mut n_changes, mut n_runs) = (0, 0);
    for share in [0.02, 0.05, 0.1, 0.2, 0.4] {
        for brighter_ev in [3.0_f64, 6.0] {
            let mut rig = rig(settings(), &models, n_runs, true);
            for pixel in 0..(share * PIXELS as f64) as usize {
                rig.room.shade[pixel] *= brighter_ev.exp2();
            }
            rig.run(6.0, |_| EVENING);
            let (changes, turns) = count_turns(&mut rig, 16.0, |_| EVENING);
            assert!(
                changes <= 2 && turns == 0,
                "{share}, {brighter_ev} EV: {changes}, {turns}"
            );
            n_changes += changes;
            n_runs += 1;
        }
    }
    println!("windows over 2 to 40 % of the picture: {n_changes} changes of the target in {n_runs} runs of 10 s");
}

#[test]
fn latency_is_found() {
    let (mut n_right, mut n_all, mut n_frames) = (0, 0, Vec::new());
    for seed in 0..100 {
        let mut random = Random(seed);
        let latencies: [u32; 2] = std::array::from_fn(|_| (random.even() * 6.0) as u32);
        let [scene, probe] = latencies;
        let models = [
            Model {
                latency_frames: scene,
                ..SCENE
            },
            Model {
                latency_frames: probe,
                ..PROBE
            },
        ];
        let mut rig = rig(settings(), &models, seed, false);
        rig.faults = Faults {
            lost: 0.01,
            late: 0.01,
            ..Faults::default()
        };
        // Lamps are switched while it measures, and flicker a little.
        let switches: [(f64, f64); 3] = std::array::from_fn(|_| (1.0 + 5.0 * random.even(), 3.0 * random.even() - 1.5));
        let light = move |s: f64| {
            let switched = switches
                .iter()
                .filter(|(at_s, _)| s >= *at_s)
                .map(|(_, ev)| ev)
                .sum::<f64>();
            Light {
                level_ev: switched + 0.03 * (s * 47.0).sin(),
                ..EVENING
            }
        };
        rig.run(1.05, light);
        let mut known_s = [f64::NAN; 2];
        while let Some(camera) = (0..2).find(|camera| known_s[*camera].is_nan()) {
            let Some(taken) = rig.step(light) else { continue };
            let at_s = taken.timestamp_ns as f64 * 1e-9;
            for (camera, known_s) in known_s.iter_mut().enumerate() {
                let is_known = rig.lockstep.camera(camera).unwrap().latency.source == LatencySource::Measured;
                if is_known && known_s.is_nan() {
                    *known_s = at_s;
                }
            }
            if at_s > 15.0 {
                known_s[camera] = at_s;
            }
        }
        rig.run(known_s[0].max(known_s[1]) + 2.0, light);
        for camera in 0..2 {
            let latency = rig.lockstep.camera(camera).unwrap().latency;
            n_all += 1;
            n_right += usize::from(latency.frames == latencies[camera] && latency.source == LatencySource::Measured);
            n_frames.push((known_s[camera] - 1.0) * 30.0);
        }
    }
    n_frames.sort_by(f64::total_cmp);
    println!(
        "latency found: {n_right} of {n_all}, after {:.0} frames (median), {:.0} at most",
        n_frames[n_frames.len() / 2],
        n_frames[n_frames.len() - 1]
    );
    assert!(n_right * 100 >= n_all * 95);
}

#[test]
fn a_bracket_goes_round_and_its_frames_match() {
    let mode = Mode::Bracket {
        camera: 1,
        n_steps: 3,
        step_ev: 2.0,
    };
    let models = [SCENE, PROBE];
    let mut rig = rig(LockstepSettings { mode, ..settings() }, &models, 2, true);
    rig.run(4.0, |_| EVENING);
    let taken = rig.run(6.0, |_| EVENING);
    assert_truthful(&taken, &models);
    let both = pairs(&taken);
    let offs: Vec<f64> = both.iter().map(|pair| match_ev(*pair).0).collect();
    println!("bracket of 3 by 2 EV: match {:.3} EV at worst", worst(&offs));
    assert!(worst(&offs) <= 0.08, "{offs:?}");
    let probes: Vec<&Taken> = taken.iter().filter(|frame| frame.camera == 1).collect();
    assert!(
        probes
            .windows(2)
            .all(|pair| pair[1].said.bracket_step == (pair[0].said.bracket_step + 1) % 3)
    );
    for frame in probes {
        let offset_ev = -frame.said.residual[1].log2();
        assert!((offset_ev - 2.0 * (f64::from(frame.said.bracket_step) - 1.0)).abs() < 0.1);
    }
}

#[test]
fn lamps_get_whole_periods() {
    let models = [SCENE, PROBE];
    let flicker = LockstepSettings {
        mains: Mains::Hz50,
        ..settings()
    };
    let mut rig = rig(flicker, &models, 3, true);
    rig.run(4.0, |_| EVENING);
    for (level_ev, flickers) in [(-1.5, false), (-3.0, false), (4.0, true), (-2.0, false)] {
        let light = Light { level_ev, ..EVENING };
        let now_s = rig.run(4.1, |_| light).len() as f64;
        assert!(now_s >= 0.0);
        let mut last = [None, None];
        for _ in 0..180 {
            if let Some(taken) = rig.step(|_| light) {
                last[taken.camera] = Some(taken.said);
            }
        }
        for said in last.into_iter().flatten() {
            assert_eq!(said.flickers, flickers, "{level_ev} EV: {said:?}");
        }
    }
}
