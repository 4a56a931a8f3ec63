use proptest::prelude::*;

use super::*;
use crate::stamps::checker::{BufferStamp, Checked, StampChecker, StampKind, StampPolicy, StampSettings};
use crate::stamps::simulation::{Chance, Delays};

const FRAME_NS: u64 = 33_333_333;
const START_NS: u64 = 50_000_000_000;

/// What happens to one frame of the simulated sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    /// The driver counts it and throws it away.
    DriverDrop,
    /// The driver hands it over, but it is bad.
    Bad(LossCause),
    /// The sensor loses it: no number, no buffer.
    SensorGap,
    /// It comes with a stamp in the future, and later than it should.
    FutureStamp,
    /// It comes with the stamp of the one before.
    RepeatedStamp,
    /// It comes twice.
    Twice,
    /// The driver hands back buffers with number 0 beside it.
    EmptyBuffers(u8),
    /// The stream is started anew while this frame and the next so many are taken.
    Outage(Interruption, u8),
}

/// A camera, its checker and its ledger.
struct Simulation {
    checker: StampChecker,
    ledger: LossLedger,
    delays: Delays,
    chance: Chance,
    driver_sequence: u32,
    last_stamp_ns: u64,
    /// What the ledger should say.
    expected: LossCounts,
}

impl Simulation {
    fn new(seed: u64, first_sequence: u32, kind_policy: StampPolicy) -> Self {
        let settings = StampSettings {
            policy: kind_policy,
            offset_ns: 0,
            interval_ns: FRAME_NS,
        };
        Self {
            checker: StampChecker::new(settings),
            ledger: LossLedger::new(FRAME_NS),
            delays: Delays::new(seed, 150e3),
            chance: Chance::new(seed),
            driver_sequence: first_sequence,
            last_stamp_ns: 0,
            expected: LossCounts::default(),
        }
    }

    fn buffer(&mut self, frame: u64) -> BufferStamp {
        // Stamps jitter by up to a twentieth of an interval, and the camera is half a percent slower than it says.
        let jitter_ns = (self.chance.fraction() * 0.05 * FRAME_NS as f64) as u64;
        let stamp_ns = START_NS + frame * FRAME_NS * 201 / 200 + jitter_ns;
        BufferStamp {
            sequence: self.driver_sequence,
            stamp_ns,
            kind: StampKind::Monotonic,
            dequeued_ns: stamp_ns + 5_000_000 + self.delays.next_ns(),
        }
    }

    /// Takes a frame; true if what the ledger says must now be exact.
    fn take(&mut self, frame: u64, fault: Fault) -> bool {
        let mut buffer = self.buffer(frame);
        match fault {
            Fault::DriverDrop => self.expected.add(LossCause::DriverDrop, 1),
            Fault::SensorGap => {
                self.expected.add(LossCause::SensorGap, 1);
                return false;
            }
            Fault::Bad(cause) => {
                self.expected.add(cause, 1);
                let place = self.checker.place(buffer.sequence, buffer.dequeued_ns);
                self.ledger.lost(cause, place);
            }
            Fault::EmptyBuffers(n_buffers) => {
                for _ in 0..n_buffers {
                    let place = self.checker.place(0, buffer.dequeued_ns);
                    self.ledger.lost(LossCause::ErrorFrame, place);
                }
                self.give(buffer);
            }
            Fault::FutureStamp => {
                buffer.stamp_ns = buffer.dequeued_ns + 1;
                self.give(buffer);
            }
            Fault::RepeatedStamp => {
                buffer.stamp_ns = self.last_stamp_ns;
                self.give(buffer);
            }
            Fault::Twice => {
                self.give(buffer);
                self.give(buffer);
            }
            Fault::None | Fault::Outage(..) => self.give(buffer),
        }
        self.driver_sequence = self.driver_sequence.wrapping_add(1);
        matches!(fault, Fault::None | Fault::Twice)
    }

    fn give(&mut self, buffer: BufferStamp) {
        self.last_stamp_ns = buffer.stamp_ns;
        match self.checker.check(buffer) {
            Checked::Frame(stamp) => {
                let total_before = self.ledger.total_at_last_frame;
                let lost_before = self.ledger.delivered(&stamp);
                assert_eq!(self.ledger.counts().total() - total_before, u64::from(lost_before));
            }
            Checked::BadStamp { sequence, .. } => {
                self.expected.add(LossCause::BadStamp, 1);
                self.ledger.lost(LossCause::BadStamp, Some(sequence));
            }
            Checked::Duplicate => self.ledger.duplicate(),
        }
    }

    fn interrupt(&mut self, interruption: Interruption, n_frames: u8) {
        let cause = match interruption {
            Interruption::StreamRestart => LossCause::StreamRestart,
            Interruption::Unplugged => LossCause::Unplugged,
        };
        self.expected.add(cause, n_frames.into());
        self.checker.begin_stream(FRAME_NS);
        self.ledger.interrupted(interruption, FRAME_NS);
        self.driver_sequence = 0;
    }
}

fn any_fault() -> impl Strategy<Value = Fault> {
    use LossCause::{BadJpeg, ErrorFrame, Overrun, ShortFrame, ZeroLength};
    let bad = proptest::sample::select(vec![BadJpeg, ErrorFrame, Overrun, ShortFrame, ZeroLength]);
    prop_oneof![
        60 => Just(Fault::None),
        3 => Just(Fault::DriverDrop),
        5 => bad.prop_map(Fault::Bad),
        3 => Just(Fault::SensorGap),
        1 => Just(Fault::FutureStamp),
        1 => Just(Fault::RepeatedStamp),
        2 => Just(Fault::Twice),
        1 => (1u8..20).prop_map(|n| Fault::Outage(Interruption::StreamRestart, n)),
        1 => (1u8..20).prop_map(|n| Fault::Outage(Interruption::Unplugged, n)),
    ]
}

/// Runs the faults over a stream that begins with 20 good frames and checks the account at every good frame. No fault
/// that only time can tell stands next to another one: time tells that they are missing, but not which is which.
fn run(simulation: &mut Simulation, faults: &[Fault]) -> Result<(), TestCaseError> {
    let mut frame = 0;
    for _ in 0..20 {
        simulation.take(frame, Fault::None);
        frame += 1;
    }
    for &fault in faults {
        let mut must_be_exact = false;
        if let Fault::Outage(interruption, n_frames) = fault {
            // What was lost just before an outage cannot be told from what was lost in it.
            simulation.take(frame, Fault::None);
            frame += 1;
            simulation.interrupt(interruption, n_frames);
            frame += u64::from(n_frames);
        } else {
            if fault == Fault::SensorGap {
                // Stamps that were wrong just before it make it look shorter or longer.
                simulation.take(frame, Fault::None);
                frame += 1;
            }
            // Stamps that stood still too often are not believed any more, and what only they tell is not known.
            let is_seen = simulation.checker.basis() != Some(StampBasis::Arrival) || fault != Fault::SensorGap;
            must_be_exact = simulation.take(frame, if is_seen { fault } else { Fault::None });
            frame += 1;
        }
        if must_be_exact || matches!(fault, Fault::SensorGap | Fault::Outage(..)) {
            for _ in 0..2 {
                simulation.take(frame, Fault::None);
                frame += 1;
            }
            let ledger = &simulation.ledger;
            prop_assert_eq!(ledger.delivered_frames() + ledger.counts().total(), frame);
        }
    }
    simulation.take(frame, Fault::None);
    let ledger = &simulation.ledger;
    prop_assert_eq!(ledger.delivered_frames() + ledger.counts().total(), frame + 1);
    Ok(())
}

proptest! {
    #[test]
    fn frames_delivered_and_lost_are_frames_made(
        faults in proptest::collection::vec(any_fault(), 0..150),
        seed in any::<u64>(),
        first_sequence in prop_oneof![Just(0), Just(u32::MAX - 40), any::<u32>()],
    ) {
        let mut simulation = Simulation::new(seed, first_sequence, StampPolicy::Auto);
        run(&mut simulation, &faults)?;
        prop_assert_eq!(simulation.ledger.counts(), &simulation.expected);
        let twice = faults.iter().filter(|&&fault| fault == Fault::Twice).count() as u64;
        prop_assert_eq!(simulation.ledger.duplicates(), twice);
    }

    #[test]
    fn mapped_stamps_keep_the_account_too(
        faults in proptest::collection::vec(any_fault(), 0..150), seed in any::<u64>(),
    ) {
        let mut simulation = Simulation::new(seed, 0, StampPolicy::Mapped);
        run(&mut simulation, &faults)?;
    }

    #[test]
    fn empty_buffers_are_no_frames_unless_frames_are_missing(
        faults in proptest::collection::vec(
            prop_oneof![4 => any_fault(), 1 => (1u8..6).prop_map(Fault::EmptyBuffers)], 0..100),
        seed in any::<u64>(),
    ) {
        let mut simulation = Simulation::new(seed, 1000, StampPolicy::Auto);
        run(&mut simulation, &faults)?;
    }
}

/// The stamp of a good frame.
fn stamp(sequence: u64, frame: u64) -> CheckedStamp {
    CheckedStamp {
        sequence,
        timestamp_ns: START_NS + frame * FRAME_NS,
        basis: StampBasis::Driver,
        doubt: None,
        sequence_event: SequenceEvent::Continues,
    }
}

#[test]
fn a_bad_buffer_without_a_number_explains_the_gap_it_left() {
    let mut ledger = LossLedger::new(FRAME_NS);
    ledger.delivered(&stamp(0, 0));
    for _ in 0..3 {
        ledger.lost(LossCause::ErrorFrame, None);
    }
    assert_eq!(ledger.empty_buffers(), 3);
    assert_eq!(ledger.delivered(&stamp(3, 3)), 2);
    assert_eq!(ledger.counts().get(LossCause::ErrorFrame), 2);
    assert_eq!((ledger.counts().total(), ledger.empty_buffers()), (2, 1));
}

#[test]
fn a_camera_at_half_its_rate_is_believed_in_the_end() {
    let mut ledger = LossLedger::new(FRAME_NS);
    for n in 0..100 {
        ledger.delivered(&stamp(n, n * 2));
    }
    assert_eq!(ledger.counts().get(LossCause::SensorGap), u64::from(NEW_RATE_FRAMES));
    assert_eq!(ledger.interval_ns(), 2 * FRAME_NS);
    for n in 100..200 {
        ledger.delivered(&stamp(n, n + 98));
    }
    assert_eq!(ledger.interval_ns(), FRAME_NS);
    assert_eq!(ledger.counts().get(LossCause::SensorGap), u64::from(NEW_RATE_FRAMES));
}

#[test]
fn unplugged_outweighs_the_restart_that_follows() {
    let mut ledger = LossLedger::new(FRAME_NS);
    ledger.delivered(&stamp(0, 0));
    ledger.interrupted(Interruption::Unplugged, FRAME_NS);
    ledger.interrupted(Interruption::StreamRestart, FRAME_NS);
    assert_eq!(ledger.delivered(&stamp(1, 31)), 30);
    assert_eq!(ledger.counts().iter().collect::<Vec<_>>(), [(LossCause::Unplugged, 30)]);
}
