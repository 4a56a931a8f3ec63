//! The state machine as a whole, without pictures: modes, faults, and that nothing it is told upsets it.

use proptest::prelude::*;

use super::tables::{Tables, TablesConfig};
use super::*;
use crate::controls::{ControlKind, ControlRange, ControlRanges, PerControl};
use crate::meter::PERCENTILES;

const INTERVAL_NS: u64 = 33_000_000;

fn range(minimum: i64, maximum: i64, step: i64) -> ControlRange {
    ControlRange {
        minimum,
        maximum,
        step,
        default: minimum,
    }
}

fn values(time: i64, gain: i64, kelvin: i64) -> ControlValues {
    let mut values = ControlValues::default();
    values.set(ControlKind::ExposureTime, time);
    values.set(ControlKind::Gain, gain);
    values.set(ControlKind::WhiteBalanceTemperature, kelvin);
    values
}

fn camera(sensitivity: f64, latency_frames: u32) -> LockstepCamera {
    let config: TablesConfig = toml::from_str(&format!(
        "sensitivity = [{sensitivity}, {sensitivity}, {sensitivity}]\ngain_table.points = [[0, 1.0], [70, 8.0]]"
    ))
    .unwrap();
    let mut ranges = ControlRanges::default();
    ranges.set(ControlKind::ExposureTime, range(3, 2047, 1));
    ranges.set(ControlKind::Gain, range(0, 100, 2));
    ranges.set(ControlKind::WhiteBalanceTemperature, range(2805, 6500, 10));
    LockstepCamera {
        tables: Tables::new(&config).unwrap(),
        ranges,
        values: values(100, 0, 4005),
        interval_ns: INTERVAL_NS,
        latency_frames: Some(latency_frames),
    }
}

fn lockstep(mode: Mode) -> Lockstep {
    let settings = LockstepSettings {
        mode,
        max_exposure_s: 0.03,
        ..LockstepSettings::default()
    };
    Lockstep::new(settings, vec![camera(1.0, 2), camera(0.5, 4)]).unwrap()
}

fn statistics(log2: f64) -> Statistics {
    let luminance = log2.exp2();
    Statistics {
        mean_luminance: luminance,
        mean_log2: log2,
        mid_log2: log2,
        percentiles_log2: [log2; PERCENTILES.len()],
        mean_rgb: [luminance; 3],
        white_rgb: [luminance; 3],
        clipped_share: if log2 > -0.1 { 1.0 } else { 0.0 },
        black_share: 0.0,
        coloured_share: 1.0,
    }
}

/// Both cameras, all requests accepted: what is said of each camera's last frame.
fn run(lockstep: &mut Lockstep, frames: std::ops::Range<u64>) -> [FrameExposure; 2] {
    let mut said = [None; 2];
    for sequence in frames {
        for (camera, said) in said.iter_mut().enumerate() {
            let timestamp_ns = sequence * INTERVAL_NS + camera as u64 * 5_000_000;
            *said = lockstep.on_frame(camera, sequence, timestamp_ns);
            if let Some(request) = lockstep.request(camera) {
                lockstep.on_applied(camera, request.id, &request.values, sequence + 1);
            }
        }
    }
    said.map(|said| said.unwrap())
}

#[test]
fn a_manual_exposure_is_the_leaders_and_the_other_matches() {
    let mut lockstep = lockstep(Mode::Locked);
    run(&mut lockstep, 0..5);
    let mode = Mode::Manual {
        exposure_s: 0.008,
        gain: 2.0,
        white_balance: ManualWhiteBalance::Kelvin(5005.0),
    };
    lockstep.set_mode(mode).unwrap();
    let [leader, other] = run(&mut lockstep, 5..20);
    assert!((leader.exposure.time_s - 0.008).abs() < 1e-9 && (leader.exposure.gain - 2.0).abs() < 1e-9);
    assert!(
        leader.residual.iter().all(|factor| (factor - 1.0).abs() < 1e-3),
        "{leader:?}"
    );
    // Half as sensitive: same time, twice the gain.
    assert!((other.exposure.time_s - 0.008).abs() < 1e-9 && (other.exposure.gain - 4.0).abs() < 1e-9);
    let kelvin = lockstep
        .camera(1)
        .unwrap()
        .accepted
        .get(ControlKind::WhiteBalanceTemperature);
    assert_eq!(kelvin, Some(5005));
}

#[test]
fn a_fixed_ratio_is_kept_and_undone_by_the_residual() {
    let mut lockstep = lockstep(Mode::FixedRatio {
        offsets_ev: vec![0.0, -3.0],
    });
    let [leader, other] = run(&mut lockstep, 0..20);
    assert!((leader.residual[1] - 1.0).abs() < 1e-9);
    assert!((other.residual[1].log2() - 3.0).abs() < 0.03, "{other:?}");
}

#[test]
fn locked_stays() {
    let mut lockstep = lockstep(Mode::Locked);
    run(&mut lockstep, 0..20);
    let target = *lockstep.target();
    for sequence in 20..60 {
        lockstep.on_frame(0, sequence, sequence * INTERVAL_NS);
        lockstep.on_statistics(0, sequence, &statistics(-9.0));
        assert_eq!(lockstep.request(0), None);
    }
    assert_eq!(*lockstep.target(), target);
}

#[test]
fn changes_are_asked_for_so_that_they_show_together() {
    let mut lockstep = lockstep(Mode::Locked);
    run(&mut lockstep, 0..10);
    let manual = |exposure_s| Mode::Manual {
        exposure_s,
        gain: 1.0,
        white_balance: ManualWhiteBalance::Gains([1.0; 3]),
    };
    lockstep.set_mode(manual(0.002)).unwrap();
    let mut asked = [None; 2];
    let mut shown = [None; 2];
    for sequence in 10..30 {
        for camera in 0..2 {
            let said = lockstep
                .on_frame(camera, sequence, sequence * INTERVAL_NS + camera as u64 * 5_000_000)
                .unwrap();
            if said.exposure.time_s == 0.002 {
                shown[camera].get_or_insert(sequence);
            }
            if let Some(request) = lockstep.request(camera) {
                asked[camera].get_or_insert(sequence);
                lockstep.on_applied(camera, request.id, &request.values, sequence + 1);
            }
        }
    }
    // 2 and 4 frames of latency: asked two frames apart, shown on the same.
    assert_eq!(asked, [Some(12), Some(10)]);
    assert_eq!(shown, [Some(15), Some(15)]);
}

#[test]
fn refused_requests_are_made_again_ever_less_often() {
    let mut lockstep = lockstep(Mode::Manual {
        exposure_s: 0.001,
        gain: 1.0,
        white_balance: ManualWhiteBalance::Gains([1.0; 3]),
    });
    let mut asked_at = Vec::new();
    for sequence in 0..200 {
        let said = lockstep.on_frame(0, sequence, sequence * INTERVAL_NS).unwrap();
        assert_eq!(said.exposure.time_s, 0.01);
        if let Some(request) = lockstep.request(0) {
            asked_at.push(sequence);
            lockstep.on_refused(0, request.id);
        }
    }
    assert_eq!(asked_at, [0, 4, 12, 28, 60, 124, 188]);
    // The residual does what the camera does not.
    let said = lockstep.exposure_of(0, 199).unwrap();
    assert!((said.residual[1] - 0.1).abs() < 1e-9 * 0.1, "{said:?}");
}

#[test]
fn a_value_that_does_not_move_is_asked_for_again_and_a_rounded_one_is_not() {
    for (read_back, n_expected) in [(100, 3), (11, 1)] {
        let mut lockstep = lockstep(Mode::Manual {
            exposure_s: 0.001,
            gain: 1.0,
            white_balance: ManualWhiteBalance::Gains([1.0; 3]),
        });
        let mut n_asked = 0;
        for sequence in 0..20 {
            lockstep.on_frame(0, sequence, sequence * INTERVAL_NS);
            if let Some(request) = lockstep.request(0) {
                n_asked += 1;
                let mut found = request.values;
                found.set(ControlKind::ExposureTime, read_back);
                lockstep.on_applied(0, request.id, &found, sequence + 1);
            }
        }
        assert_eq!(n_asked, n_expected);
        let said = lockstep.exposure_of(0, 19).unwrap();
        assert!((said.exposure.time_s - read_back as f64 * 1e-4).abs() < 1e-12);
    }
}

#[test]
fn an_automatic_mode_makes_frames_doubtful_until_all_is_set_again() {
    let mut lockstep = lockstep(Mode::Locked);
    let [leader, _] = run(&mut lockstep, 0..10);
    assert!(leader.is_certain);
    lockstep.on_auto_mode_found(0);
    assert!(!lockstep.on_frame(0, 10, 10 * INTERVAL_NS).unwrap().is_certain);
    let request = lockstep.request(0).unwrap();
    assert!(request.asserts_manual && request.values.iter().count() == 3);
    assert_eq!(
        lockstep.on_frame(0, 11, 11 * INTERVAL_NS).map(|said| said.is_certain),
        Some(false)
    );
    lockstep.on_applied(0, request.id, &request.values, 12);
    let [leader, _] = run(&mut lockstep, 12..20);
    assert!(leader.is_certain);
}

#[test]
fn a_camera_comes_back_as_it_is_found() {
    let mut lockstep = lockstep(Mode::Locked);
    run(&mut lockstep, 0..10);
    let before = lockstep.camera(1).unwrap().accepted;
    lockstep.on_lost(1);
    assert!(!lockstep.camera(1).unwrap().is_online && lockstep.request(1).is_none());
    lockstep.on_returned(1, values(2000, 100, 2805));
    let said = lockstep.on_frame(1, 50, 50 * INTERVAL_NS).unwrap();
    assert!((said.exposure.time_s - 0.2).abs() < 1e-12);
    let [_, other] = run(&mut lockstep, 51..70);
    assert_eq!(lockstep.camera(1).unwrap().accepted, before);
    assert!((other.residual[1].log2()).abs() < 0.03);
}

#[test]
fn without_an_answer_a_request_is_doubtful_then_made_again() {
    let mut lockstep = lockstep(Mode::Manual {
        exposure_s: 0.001,
        gain: 1.0,
        white_balance: ManualWhiteBalance::Gains([1.0; 3]),
    });
    let mut asked_at = Vec::new();
    let mut doubtful = Vec::new();
    for sequence in 0..50 {
        let said = lockstep.on_frame(0, sequence, sequence * INTERVAL_NS).unwrap();
        if !said.is_certain {
            doubtful.push(sequence);
        }
        asked_at.extend(lockstep.request(0).map(|_| sequence));
    }
    assert_eq!(asked_at, [0, 35]);
    assert_eq!(doubtful, (3..31).chain(38..50).collect::<Vec<_>>());
}

#[test]
fn wrong_settings_are_refused() {
    let refused = |change: &dyn Fn(&mut LockstepSettings, &mut Vec<LockstepCamera>)| {
        let mut settings = LockstepSettings::default();
        let mut cameras = vec![camera(1.0, 2)];
        change(&mut settings, &mut cameras);
        let error = Lockstep::new(settings, cameras).unwrap_err();
        assert!(!error.hint().is_empty());
        error.to_string()
    };
    assert_eq!(
        refused(&|_, cameras| cameras.clear()),
        "cannot keep `0` cameras in step (allowed: 1 to 16)"
    );
    assert_eq!(
        refused(&|settings, _| settings.leader = 1),
        "`leader` is camera `1` (allowed: 0 to 0)"
    );
    assert_eq!(
        refused(&|settings, _| settings.max_exposure_s = f64::NAN),
        "`max_exposure_s` is `NaN` (allowed: 1e-4 to 10 s)"
    );
    assert_eq!(
        refused(&|settings, _| settings.mode = Mode::FixedRatio { offsets_ev: vec![] }),
        "`offsets_ev` has `0` values (allowed: 1, one per camera)"
    );
    let bracket = |n_steps| Mode::Bracket {
        camera: 0,
        n_steps,
        step_ev: 2.0,
    };
    assert_eq!(
        refused(&|settings, _| settings.mode = bracket(6)),
        "`n_steps` is `6` (allowed: 2 to 5)"
    );
    assert_eq!(
        refused(&|_, cameras| cameras[0].ranges.set(ControlKind::Gain, range(5, 4, 1))),
        "camera `0` has Gain from `5` to `4` in steps of `1` (allowed: rising, above 0)"
    );
    assert_eq!(
        refused(&|_, cameras| cameras[0].latency_frames = Some(9)),
        "`latency_frames` is `9` (allowed: 0 to 8)"
    );
    let mut good = lockstep(Mode::Locked);
    assert!(good.set_mode(bracket(1)).is_err() && *good.mode() == Mode::Locked);
}

/// Something that can happen.
#[derive(Debug, Clone)]
enum Event {
    Frame {
        camera: usize,
        skipped: u64,
        late_ns: u64,
    },
    Statistics {
        camera: usize,
        back: u64,
        log2: f64,
    },
    Answer {
        camera: usize,
        is_refused: bool,
        first_after: u64,
    },
    Elsewhere {
        camera: usize,
        value: i64,
    },
    Lost(usize),
    Returned(usize),
    Automatic(usize),
    Mode(u8, f64),
}

fn event() -> impl Strategy<Value = Event> {
    let camera = 0..3_usize;
    prop_oneof![
        12 => (camera.clone(), 0..3_u64, 0..20_000_000_u64)
            .prop_map(|(camera, skipped, late_ns)| Event::Frame { camera, skipped, late_ns }),
        8 => (camera.clone(), 0..4_u64, -12.0..0.0_f64)
            .prop_map(|(camera, back, log2)| Event::Statistics { camera, back, log2 }),
        8 => (camera.clone(), any::<bool>(), 0..4_u64)
            .prop_map(|(camera, is_refused, first_after)| Event::Answer { camera, is_refused, first_after }),
        1 => (camera.clone(), 3..2047_i64).prop_map(|(camera, value)| Event::Elsewhere { camera, value }),
        1 => camera.clone().prop_map(Event::Lost),
        1 => camera.clone().prop_map(Event::Returned),
        1 => camera.prop_map(Event::Automatic),
        1 => (0..5_u8, -6.0..6.0_f64).prop_map(|(mode, ev)| Event::Mode(mode, ev)),
    ]
}

fn mode(kind: u8, ev: f64) -> Mode {
    match kind {
        0 => Mode::Locked,
        1 => Mode::FollowLeader,
        2 => Mode::FixedRatio {
            offsets_ev: vec![0.0, ev],
        },
        3 => Mode::Bracket {
            camera: 1,
            n_steps: 4,
            step_ev: ev.abs() + 0.1,
        },
        _ => Mode::Manual {
            exposure_s: 0.01 * ev.exp2(),
            gain: 1.0,
            white_balance: ManualWhiteBalance::Gains([1.2, 1.0, 1.7]),
        },
    }
}

/// A driver that keeps what it was told.
struct Driver {
    sequence: u64,
    now_ns: u64,
    waiting: Vec<Request>,
    holds: ControlValues,
    held: Vec<ControlValues>,
}

impl Driver {
    fn new() -> Self {
        let start = values(100, 0, 4005);
        Self {
            sequence: 0,
            now_ns: 0,
            waiting: Vec::new(),
            holds: start,
            held: vec![start],
        }
    }
}

fn check_request(request: &Request) {
    let ranges: PerControl<ControlRange> = camera(1.0, 0).ranges;
    for (kind, value) in request.values.iter() {
        let range = ranges.get(kind).unwrap();
        // The gain table ends at 70, the range at 100.
        let maximum = if kind == ControlKind::Gain { 70 } else { range.maximum };
        assert!((range.minimum..=maximum).contains(&value), "{kind:?} {value}");
        assert_eq!((value - range.minimum) % range.step, 0, "{kind:?} {value}");
    }
}

/// Time and gain said of a frame are those of values that the driver once had.
fn check_said(said: &FrameExposure, held: &[ControlValues]) {
    assert!(
        said.residual.iter().all(|factor| factor.is_finite() && *factor > 0.0),
        "{said:?}"
    );
    let is_it = |values: &ControlValues| {
        let time_s = values.get(ControlKind::ExposureTime).unwrap() as f64 * 1e-4;
        let gain = 1.0 + 0.1 * values.get(ControlKind::Gain).unwrap() as f64;
        (time_s - said.exposure.time_s).abs() < 1e-9 && (gain - said.exposure.gain).abs() < 1e-9
    };
    assert!(held.iter().any(is_it), "{said:?}");
}

fn happen(lockstep: &mut Lockstep, drivers: &mut [Driver; 2], event: &Event) {
    match *event {
        Event::Frame {
            camera,
            skipped,
            late_ns,
        } => {
            let Some(driver) = drivers.get_mut(camera) else {
                assert_eq!(lockstep.on_frame(camera, 1, 1), None);
                return;
            };
            driver.sequence += 1 + skipped;
            driver.now_ns += (1 + skipped) * INTERVAL_NS + late_ns;
            let said = lockstep.on_frame(camera, driver.sequence, driver.now_ns).unwrap();
            check_said(&said, &driver.held);
            if let Some(request) = lockstep.request(camera) {
                check_request(&request);
                driver.waiting.push(request);
            }
        }
        Event::Statistics { camera, back, log2 } => {
            let sequence = drivers
                .get(camera)
                .map_or(0, |driver| driver.sequence.saturating_sub(back));
            lockstep.on_statistics(camera, sequence, &statistics(log2));
        }
        Event::Answer {
            camera,
            is_refused,
            first_after,
        } => {
            let Some(driver) = drivers.get_mut(camera).filter(|driver| !driver.waiting.is_empty()) else {
                return;
            };
            let request = driver.waiting.remove(0);
            if is_refused {
                lockstep.on_refused(camera, request.id);
                return;
            }
            for (kind, value) in request.values.iter() {
                driver.holds.set(kind, value);
            }
            driver.held.push(driver.holds);
            let first_sequence_after = (driver.sequence + 2).saturating_sub(first_after);
            lockstep.on_applied(camera, request.id, &driver.holds, first_sequence_after);
        }
        Event::Elsewhere { camera, value } => {
            let Some(driver) = drivers.get_mut(camera) else { return };
            driver.holds.set(ControlKind::ExposureTime, value);
            driver.held.push(driver.holds);
            lockstep.on_applied(camera, RequestId(u64::MAX), &driver.holds, driver.sequence + 1);
        }
        Event::Lost(camera) => lockstep.on_lost(camera),
        Event::Returned(camera) => {
            let holds = drivers.get(camera).map_or(values(3, 0, 2805), |driver| driver.holds);
            lockstep.on_returned(camera, holds);
        }
        Event::Automatic(camera) => lockstep.on_auto_mode_found(camera),
        Event::Mode(kind, ev) => {
            let _ = lockstep.set_mode(mode(kind, ev));
        }
    }
}

proptest! {
    #[test]
    fn whatever_happens_requests_are_allowed_and_frames_say_what_was_held(
        events in prop::collection::vec(event(), 1..400),
    ) {
        let mut lockstep = lockstep(Mode::FollowLeader);
        let mut drivers = [Driver::new(), Driver::new()];
        for event in events {
            happen(&mut lockstep, &mut drivers, &event);
        }
    }

    #[test]
    fn any_numbers_do_no_harm(
        calls in prop::collection::vec((0..2_usize, any::<u64>(), any::<u64>(), any::<i64>(), -1e3..1e3_f64), 1..60),
    ) {
        let mut lockstep = lockstep(Mode::FollowLeader);
        for (camera, sequence, timestamp_ns, value, log2) in calls {
            let said = lockstep.on_frame(camera, sequence, timestamp_ns).unwrap();
            prop_assert!(said.residual.iter().all(|factor| *factor > 0.0));
            lockstep.on_statistics(camera, sequence, &statistics(log2));
            if let Some(request) = lockstep.request(camera) {
                check_request(&request);
                lockstep.on_applied(camera, request.id, &values(value, value, value), timestamp_ns);
            }
        }
    }

    #[test]
    fn picture_times_residual_is_the_picture_at_the_target(
        exposure_s in 1e-6..10.0_f64,
        gain in 0.05..50.0_f64,
        gains in prop::array::uniform3(0.2..5.0_f64),
        radiance in prop::array::uniform3(0.01..1e3_f64),
    ) {
        let mut lockstep = lockstep(Mode::Manual {
            exposure_s,
            gain,
            white_balance: ManualWhiteBalance::Gains(gains),
        });
        let said = run(&mut lockstep, 0..20);
        for (said, sensitivity) in said.into_iter().zip([1.0, 0.5]) {
            for channel in 0..3 {
                let scalar = said.exposure.time_s * said.exposure.gain * sensitivity;
                let picture = radiance[channel] * scalar * said.exposure.white_balance[channel];
                // A camera with sensitivity 1 and no green gain of its own.
                let at_target = radiance[channel] * exposure_s * gain * gains[channel] / gains[1];
                let ratio = picture * said.residual[channel] / at_target;
                prop_assert!((ratio - 1.0).abs() < 1e-9, "{ratio}");
            }
        }
    }
}
