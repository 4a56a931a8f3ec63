use proptest::prelude::*;

use super::*;
use crate::stamps::simulation::Delays;

const FRAME_NS: u64 = 33_333_333;
const START_NS: u64 = 50_000_000_000;

fn checker(policy: StampPolicy, offset_ns: i64) -> StampChecker {
    StampChecker::new(StampSettings {
        policy,
        offset_ns,
        interval_ns: FRAME_NS,
    })
}

fn auto() -> StampChecker {
    checker(StampPolicy::Auto, 0)
}

/// Frame `n` of a camera whose buffers arrive 20 ms after their stamp.
fn buffer(n: u64) -> BufferStamp {
    let stamp_ns = START_NS + n * FRAME_NS;
    BufferStamp {
        sequence: n as u32,
        stamp_ns,
        kind: StampKind::Monotonic,
        dequeued_ns: stamp_ns + 20_000_000,
    }
}

fn frame(checked: Checked) -> CheckedStamp {
    match checked {
        Checked::Frame(stamp) => stamp,
        Checked::BadStamp { .. } | Checked::Duplicate => panic!("expected a frame, found {checked:?}"),
    }
}

#[test]
fn monotonic_stamps_are_trusted_as_they_are() {
    let mut checker = auto();
    for n in 0..100 {
        let stamp = frame(checker.check(buffer(n)));
        assert_eq!((stamp.sequence, stamp.timestamp_ns), (n, buffer(n).stamp_ns));
        assert_eq!((stamp.basis, stamp.doubt), (StampBasis::Driver, None));
    }
    assert_eq!(checker.counters(), StampCounters::default());
}

#[test]
fn the_calibrated_offset_is_added() {
    for (policy, basis_ns) in [(StampPolicy::Auto, 0), (StampPolicy::Mapped, 20_000_000)] {
        let mut checker = checker(policy, -16_000_000);
        let stamp = frame(checker.check(buffer(3)));
        assert_eq!(stamp.timestamp_ns, buffer(3).stamp_ns + basis_ns - 16_000_000);
    }
}

#[test]
fn one_future_stamp_is_replaced_by_arrival_less_the_least_delay() {
    let mut checker = auto();
    for n in 0..30 {
        checker.check(buffer(n));
    }
    let mut future = buffer(30);
    future.stamp_ns += 25_000_000;
    let stamp = frame(checker.check(future));
    assert_eq!(stamp.timestamp_ns, buffer(30).stamp_ns);
    assert_eq!(
        (stamp.basis, stamp.doubt),
        (StampBasis::Arrival, Some(StampDoubt::Future))
    );
    let next = frame(checker.check(buffer(31)));
    assert_eq!((next.basis, next.doubt), (StampBasis::Driver, None));
    assert_eq!(checker.counters().future, 1);
}

#[test]
fn stamps_that_always_lie_in_the_future_are_mapped_from_the_first_on() {
    // As those of vivid, 35 ms ahead.
    let mut checker = auto();
    for n in 0..100 {
        let mut ahead = buffer(n);
        ahead.stamp_ns = ahead.dequeued_ns + 35_000_000;
        let stamp = frame(checker.check(ahead));
        assert_eq!(
            (stamp.basis, stamp.timestamp_ns),
            (StampBasis::Mapped, ahead.dequeued_ns)
        );
    }
    assert_eq!(checker.counters().mode_changes, 1);
}

#[test]
fn three_future_stamps_in_a_row_end_trust() {
    let mut checker = auto();
    for n in 0..100 {
        let mut future = buffer(n);
        future.stamp_ns += if n >= 50 { 3_600_000_000_000 } else { 0 };
        let stamp = frame(checker.check(future));
        let expected = match n {
            0..50 => StampBasis::Driver,
            50..52 => StampBasis::Arrival,
            _ => StampBasis::Mapped,
        };
        assert_eq!(stamp.basis, expected, "frame {n}");
        assert!(stamp.timestamp_ns <= future.dequeued_ns);
    }
    assert_eq!(checker.basis(), Some(StampBasis::Mapped));
}

#[test]
fn a_repeated_stamp_costs_no_frame_and_the_same_buffer_twice_is_none() {
    let mut checker = auto();
    checker.check(buffer(0));
    checker.check(buffer(1));
    assert_eq!(checker.check(buffer(1)), Checked::Duplicate);
    let mut repeated = buffer(2);
    repeated.stamp_ns = buffer(1).stamp_ns;
    let stamp = frame(checker.check(repeated));
    assert_eq!((stamp.timestamp_ns, stamp.sequence), (buffer(2).stamp_ns, 2));
    assert_eq!(stamp.doubt, Some(StampDoubt::Repeated));
}

#[test]
fn a_bad_stamp_in_a_burst_after_a_stall_is_lost() {
    let mut checker = auto();
    checker.check(buffer(0));
    let stalled_ns = buffer(10).dequeued_ns;
    let late = buffer(10);
    assert_eq!(frame(checker.check(late)).timestamp_ns, late.stamp_ns);
    let mut bad = buffer(11);
    (bad.stamp_ns, bad.dequeued_ns) = (late.stamp_ns - 1, stalled_ns + 1000);
    let expected = Checked::BadStamp {
        sequence: 11,
        doubt: StampDoubt::Backwards,
    };
    assert_eq!(checker.check(bad), expected);
}

#[test]
fn a_clock_that_is_set_back_or_stands_still_is_left() {
    let set_back = |n: u64| START_NS / 2 + n * FRAME_NS;
    let stands = |_: u64| START_NS;
    let cases: [(&dyn Fn(u64) -> u64, StampBasis); 2] =
        [(&set_back, StampBasis::Mapped), (&stands, StampBasis::Arrival)];
    for (stamp_ns, expected) in cases {
        let mut checker = auto();
        let mut last_ns = 0;
        for n in 0..100 {
            let mut broken = buffer(n);
            broken.stamp_ns = if n >= 20 { stamp_ns(n) } else { broken.stamp_ns };
            let stamp = frame(checker.check(broken));
            assert!(stamp.timestamp_ns > last_ns && stamp.timestamp_ns <= broken.dequeued_ns);
            assert!(broken.dequeued_ns - stamp.timestamp_ns <= 20_000_000);
            last_ns = stamp.timestamp_ns;
        }
        assert_eq!(checker.basis(), Some(expected));
    }
}

#[test]
fn a_device_clock_that_leaps_gets_a_new_map() {
    let mut checker = auto();
    for n in 0..200 {
        let mut own_clock = buffer(n);
        own_clock.kind = StampKind::Other;
        own_clock.stamp_ns = n * FRAME_NS + if n >= 100 { 5_000_000_000 } else { 0 };
        let stamp = frame(checker.check(own_clock));
        assert_eq!(stamp.timestamp_ns, own_clock.dequeued_ns, "frame {n}");
    }
    assert_eq!(checker.counters().jumped, 3);
    assert_eq!(checker.counters().mode_changes, 1);
}

#[test]
fn with_the_driver_policy_a_stamp_that_does_not_rise_costs_its_frame() {
    let mut checker = checker(StampPolicy::Driver, 0);
    for n in 0..50 {
        let mut own_clock = buffer(n);
        (own_clock.kind, own_clock.stamp_ns) = (StampKind::Other, 2 * own_clock.stamp_ns);
        if n == 20 {
            own_clock.stamp_ns = 5;
            assert!(matches!(
                checker.check(own_clock),
                Checked::BadStamp { sequence: 20, .. }
            ));
        } else {
            assert_eq!(frame(checker.check(own_clock)).timestamp_ns, own_clock.stamp_ns);
        }
    }
}

#[test]
fn sequence_numbers_go_on_over_wraps_restarts_and_replugs() {
    let mut checker = auto();
    let first = u64::from(u32::MAX) - 1;
    let mut sequences = Vec::new();
    let mut events = Vec::new();
    for n in 0..12_u64 {
        let mut wrapped = buffer(n);
        wrapped.sequence = match n {
            0..6 => (u32::MAX - 1).wrapping_add(n as u32),
            // The driver counts anew: by itself, and because the stream was started again.
            6..9 => n as u32 - 6,
            _ => n as u32 - 9,
        };
        if n == 9 {
            checker.begin_stream(FRAME_NS);
        }
        let stamp = frame(checker.check(wrapped));
        sequences.push(stamp.sequence);
        events.push(stamp.sequence_event);
    }
    assert_eq!(sequences, (first..first + 12).collect::<Vec<_>>());
    assert_eq!(events[2], SequenceEvent::Wrapped);
    assert_eq!(events[6], SequenceEvent::Restarted);
    assert_eq!((checker.counters().wrapped, checker.counters().restarted), (1, 1));
}

#[test]
fn a_sequence_number_out_of_all_time_is_no_gap() {
    let mut checker = auto();
    checker.check(buffer(0));
    let mut leapt = buffer(1);
    leapt.sequence = 1_000_000;
    let stamp = frame(checker.check(leapt));
    assert_eq!((stamp.sequence, stamp.sequence_event), (1, SequenceEvent::Restarted));
}

#[test]
fn bad_buffers_have_a_place_if_their_number_can_be_right() {
    let mut checker = auto();
    for n in 0..500 {
        checker.check(buffer(n));
    }
    assert_eq!(checker.place(0, buffer(500).dequeued_ns), None);
    assert_eq!(checker.place(501, buffer(501).dequeued_ns), Some(501));
    assert_eq!(frame(checker.check(buffer(502))).sequence, 502);
}

#[test]
fn mapped_stamps_of_a_drifting_clock_are_good_to_tens_of_microseconds() {
    for drift in [-200e-6, 200e-6] {
        let mut checker = auto();
        let mut delays = Delays::new(3, 150e3);
        let mut errors = Vec::new();
        for n in 0..900 {
            let taken_ns = START_NS + n * FRAME_NS;
            let drifting = BufferStamp {
                sequence: n as u32,
                stamp_ns: (taken_ns as f64 * (1.0 - drift)) as u64,
                kind: StampKind::Other,
                dequeued_ns: taken_ns + delays.next_ns(),
            };
            let stamp = frame(checker.check(drifting));
            if n >= 300 {
                errors.push(stamp.timestamp_ns.abs_diff(taken_ns));
            }
        }
        errors.sort_unstable();
        assert!(errors[errors.len() * 95 / 100] <= 50_000);
    }
}

fn any_buffers() -> impl Strategy<Value = Vec<(BufferStamp, u8)>> {
    let stamp_ns = prop_oneof![
        4 => (0u64..200).prop_map(|n| buffer(n).stamp_ns),
        1 => any::<u64>(),
        1 => Just(0)
    ];
    let sequence = prop_oneof![4 => 0u32..200, 1 => any::<u32>()];
    let buffer = (sequence, stamp_ns, any::<bool>(), 0u64..400).prop_map(|(sequence, stamp_ns, is_monotonic, n)| {
        let kind = if is_monotonic {
            StampKind::Monotonic
        } else {
            StampKind::Other
        };
        BufferStamp {
            sequence,
            stamp_ns,
            kind,
            dequeued_ns: START_NS + n * FRAME_NS / 2,
        }
    });
    proptest::collection::vec((buffer, 0u8..20), 0..100)
}

proptest! {
    #[test]
    fn whatever_comes_numbers_and_stamps_rise(
        mut buffers in any_buffers(),
        policy in prop_oneof![Just(StampPolicy::Auto), Just(StampPolicy::Driver), Just(StampPolicy::Mapped)],
    ) {
        buffers.sort_by_key(|(buffer, _)| buffer.dequeued_ns);
        let mut checker = checker(policy, 0);
        let (mut last_sequence, mut last_ns) = (None, None);
        for (buffer, event) in buffers {
            if event == 0 {
                checker.begin_stream(FRAME_NS);
            }
            let sequence = match checker.check(buffer) {
                Checked::Frame(stamp) => {
                    prop_assert!(last_ns < Some(stamp.timestamp_ns));
                    let is_past = stamp.timestamp_ns <= buffer.dequeued_ns;
                    prop_assert!(is_past || policy == StampPolicy::Driver);
                    last_ns = Some(stamp.timestamp_ns);
                    stamp.sequence
                }
                Checked::BadStamp { sequence, .. } => sequence,
                Checked::Duplicate => continue,
            };
            prop_assert!(last_sequence < Some(sequence));
            last_sequence = Some(sequence);
        }
    }
}
