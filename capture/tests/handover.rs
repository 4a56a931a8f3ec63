//! One contract over all transports.

#![expect(clippy::unwrap_used, reason = "tests may; this covers their own functions too")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use iceoryx2::prelude::{NodeBuilder, ServiceName, ipc_threadsafe};
use mirrorball_capture::handover::packet::{PACKET_VERSION, PacketError, encode, packet_bytes};
use mirrorball_capture::handover::{self, PublishOutcome, READERS_MAX};
use mirrorball_capture::{
    CameraDescription, CameraRole, Exposure, Frame, FrameMeta, FrameSet, HandoverError, PixelFormat, Pixels, Pool,
    Publisher, Received, Size, Subscriber,
};

/// Far beyond what anything here takes: only a hang lasts this long.
const WATCHDOG: Duration = Duration::from_secs(60);

/// Long enough to see that nothing comes.
const SHORT: Duration = Duration::from_millis(30);

#[derive(Debug, Clone, Copy, PartialEq)]
enum Transport {
    Lossless,
    Newest,
    Process,
}

const ALL: [Transport; 3] = [Transport::Lossless, Transport::Newest, Transport::Process];
const IN_PROCESS: [Transport; 2] = [Transport::Lossless, Transport::Newest];
const NEWEST_WINS: [Transport; 2] = [Transport::Newest, Transport::Process];

/// A name nobody else uses, in this process or another.
fn unique_service() -> String {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    format!(
        "mirrorball/contract-{}-{}",
        std::process::id(),
        COUNTER.fetch_add(1, Ordering::Relaxed)
    )
}

fn size() -> Size {
    Size { width: 8, height: 6 }
}

fn cameras() -> [CameraDescription; 1] {
    [CameraDescription {
        name: "scene".into(),
        role: CameraRole::Scene,
        size: size(),
        format: PixelFormat::Rgb8,
    }]
}

fn pair(transport: Transport) -> (Publisher, Subscriber) {
    match transport {
        Transport::Lossless => handover::lossless(4),
        Transport::Newest => handover::newest(),
        Transport::Process => {
            let service = unique_service();
            let subscriber = handover::subscribe_to(&service).unwrap();
            (handover::publish_on(&service, &cameras()).unwrap(), subscriber)
        }
    }
}

fn set(sequence: u64) -> FrameSet {
    let exposure = Exposure {
        time_s: 0.01,
        gain: 2.0,
        white_balance: [1.5, 1.0, 1.25],
    };
    let meta = FrameMeta::new("scene".into(), sequence, sequence * 1000, exposure);
    let pixels: Vec<u8> = (0..size().pixels() * 3)
        .map(|index| (index as u64 + sequence) as u8)
        .collect();
    FrameSet {
        frames: vec![Frame {
            meta,
            size: size(),
            format: PixelFormat::Rgb8,
            pixels: pixels.into(),
        }],
    }
}

fn sequence(received: &Received) -> Option<u64> {
    match received {
        Received::Set(set) => Some(set.frames[0].meta.sequence),
        Received::TimedOut | Received::Ended => None,
    }
}

/// Waits for the next set.
fn receive(subscriber: &mut Subscriber) -> u64 {
    let received = subscriber.receive(WATCHDOG).unwrap();
    sequence(&received).unwrap_or_else(|| panic!("expected a set, found {received:?}"))
}

fn delivered() -> PublishOutcome {
    PublishOutcome::Delivered { n_readers: 1 }
}

#[test]
fn sets_arrive_whole_and_in_order() {
    for transport in ALL {
        let (mut publisher, mut subscriber) = pair(transport);
        for index in 0..20 {
            let sent = set(index);
            assert_eq!(publisher.publish(sent.clone()).unwrap(), delivered(), "{transport:?}");
            let Received::Set(got) = subscriber.receive(WATCHDOG).unwrap() else {
                panic!("{transport:?}")
            };
            assert_eq!(got.frames[0].meta, sent.frames[0].meta);
            assert_eq!(got.frames[0].pixels[..], sent.frames[0].pixels[..]);
        }
        assert_eq!(
            (subscriber.stats().received, subscriber.stats().missed),
            (20, 0),
            "{transport:?}"
        );
        assert_eq!(
            (publisher.stats().published, publisher.stats().unread),
            (20, 0),
            "{transport:?}"
        );
        assert_eq!(publisher.count_readers(), 1, "{transport:?}");
    }
}

#[test]
fn an_idle_publisher_is_a_timeout() {
    for transport in ALL {
        let (_publisher, mut subscriber) = pair(transport);
        assert!(
            matches!(subscriber.receive(SHORT).unwrap(), Received::TimedOut),
            "{transport:?}"
        );
        assert!(
            matches!(subscriber.receive(Duration::ZERO).unwrap(), Received::TimedOut),
            "{transport:?}"
        );
    }
}

#[test]
fn a_waiting_reader_is_woken() {
    for transport in ALL {
        let (mut publisher, mut subscriber) = pair(transport);
        let reader = std::thread::spawn(move || receive(&mut subscriber));
        std::thread::sleep(SHORT);
        publisher.publish(set(5)).unwrap();
        assert_eq!(reader.join().unwrap(), 5, "{transport:?}");
    }
}

#[test]
fn the_newest_wins_and_the_overruns_are_counted() {
    for transport in NEWEST_WINS {
        let (mut publisher, mut subscriber) = pair(transport);
        publisher.publish(set(0)).unwrap();
        assert_eq!(receive(&mut subscriber), 0);
        for index in 1..=1000 {
            assert_eq!(publisher.publish(set(index)).unwrap(), delivered(), "{transport:?}");
        }
        assert_eq!(receive(&mut subscriber), 1000, "{transport:?}");
        assert_eq!(
            (subscriber.stats().received, subscriber.stats().missed),
            (2, 999),
            "{transport:?}"
        );
        assert!(
            matches!(subscriber.receive(SHORT).unwrap(), Received::TimedOut),
            "{transport:?}"
        );
    }
}

#[test]
fn newest_wins_under_load_in_rising_order() {
    for transport in NEWEST_WINS {
        let (mut publisher, mut subscriber) = pair(transport);
        let writer = std::thread::spawn(move || {
            for index in 1..=2000 {
                publisher.publish(set(index)).unwrap();
            }
            publisher
        });
        let (mut last, mut first) = (0, 0);
        while last < 2000 {
            let now = receive(&mut subscriber);
            assert!(now > last, "{transport:?}: {now} after {last}");
            first = if first == 0 { now } else { first };
            last = now;
        }
        let stats = subscriber.stats();
        // Between processes what came before the first set received is not known.
        let unknown = if transport == Transport::Process { first - 1 } else { 0 };
        assert_eq!(stats.received + stats.missed + unknown, 2000, "{transport:?}");
        drop(writer.join().unwrap());
    }
}

#[test]
fn lossless_waits_and_loses_nothing() {
    const CAPACITY: u64 = 3;
    let (mut publisher, mut subscriber) = handover::lossless(CAPACITY as usize);
    let published = Arc::new(AtomicU64::new(0));
    let counter = published.clone();
    let writer = std::thread::spawn(move || {
        for index in 0..500 {
            publisher.publish(set(index)).unwrap();
            counter.fetch_add(1, Ordering::SeqCst);
        }
    });
    for index in 0..500 {
        assert!(published.load(Ordering::SeqCst) <= index + CAPACITY);
        assert_eq!(receive(&mut subscriber), index);
    }
    writer.join().unwrap();
    assert_eq!(subscriber.stats().missed, 0);
}

#[test]
fn newest_keeps_one_set_in_memory() {
    let (mut publisher, _subscriber) = handover::newest();
    let pixels: Vec<_> = (0..50)
        .map(|index| {
            let mut set = set(index);
            let kept: Arc<[u8]> = set.frames[0].pixels.to_vec().into();
            let pixels = Arc::downgrade(&kept);
            set.frames[0].pixels = Pixels::from_owner(kept);
            publisher.publish(set).unwrap();
            pixels
        })
        .collect();
    assert_eq!(pixels.iter().filter(|pixels| pixels.strong_count() > 0).count(), 1);
}

#[test]
fn inside_a_process_the_end_comes_after_what_was_published() {
    for transport in IN_PROCESS {
        let (mut publisher, mut subscriber) = pair(transport);
        publisher.publish(set(1)).unwrap();
        drop(publisher);
        assert_eq!(receive(&mut subscriber), 1, "{transport:?}");
        for _ in 0..2 {
            assert!(
                matches!(subscriber.receive(WATCHDOG).unwrap(), Received::Ended),
                "{transport:?}"
            );
        }
    }
}

#[test]
fn inside_a_process_an_error_comes_after_what_was_published() {
    for transport in IN_PROCESS {
        let (mut publisher, mut subscriber) = pair(transport);
        publisher.publish(set(1)).unwrap();
        publisher
            .fail(HandoverError::PublisherExists {
                service: "x".to_owned(),
            })
            .unwrap();
        assert_eq!(receive(&mut subscriber), 1, "{transport:?}");
        let error = subscriber.receive(WATCHDOG).unwrap_err();
        assert!(matches!(error, HandoverError::PublisherExists { .. }), "{transport:?}");
        assert!(
            matches!(subscriber.receive(WATCHDOG).unwrap(), Received::Ended),
            "{transport:?}"
        );
    }
}

#[test]
fn an_error_nobody_hears_comes_back() {
    for transport in ALL {
        let (publisher, subscriber) = pair(transport);
        drop(subscriber);
        let error = publisher.fail(HandoverError::PublisherPanicked).unwrap_err();
        assert!(matches!(error, HandoverError::PublisherPanicked), "{transport:?}");
    }
}

#[test]
fn inside_a_process_a_panic_is_no_quiet_end() {
    for transport in IN_PROCESS {
        let (mut publisher, mut subscriber) = pair(transport);
        let writer = std::thread::spawn(move || {
            publisher.publish(set(1)).unwrap();
            panic!("on purpose");
        });
        assert!(writer.join().is_err());
        assert_eq!(receive(&mut subscriber), 1, "{transport:?}");
        let error = subscriber.receive(WATCHDOG).unwrap_err();
        assert!(matches!(error, HandoverError::PublisherPanicked), "{transport:?}");
    }
}

#[test]
fn a_publisher_is_told_that_nobody_reads() {
    for (transport, expected) in [
        (Transport::Lossless, PublishOutcome::Closed),
        (Transport::Newest, PublishOutcome::Closed),
        (Transport::Process, PublishOutcome::NoReader),
    ] {
        let (mut publisher, subscriber) = pair(transport);
        drop(subscriber);
        assert_eq!(publisher.publish(set(1)).unwrap(), expected, "{transport:?}");
        assert_eq!(
            (publisher.count_readers(), publisher.stats().unread),
            (0, 1),
            "{transport:?}"
        );
    }
}

#[test]
fn between_processes_a_reader_may_come_first_and_outlive_publishers() {
    let service = unique_service();
    let mut subscriber = handover::subscribe_to(&service).unwrap();
    assert!(matches!(subscriber.receive(SHORT).unwrap(), Received::TimedOut));
    for round in 1..=3 {
        let mut publisher = handover::publish_on(&service, &cameras()).unwrap();
        publisher.publish(set(round)).unwrap();
        assert_eq!(receive(&mut subscriber), round);
        drop(publisher);
        assert!(matches!(subscriber.receive(SHORT).unwrap(), Received::TimedOut));
    }
    assert_eq!(subscriber.stats().publisher_changes, 2);
    assert_eq!(subscriber.stats().missed, 0);
}

#[test]
fn between_processes_all_readers_get_every_set() {
    let service = unique_service();
    let mut publisher = handover::publish_on(&service, &cameras()).unwrap();
    let mut subscribers: Vec<_> = (0..READERS_MAX)
        .map(|_| handover::subscribe_to(&service).unwrap())
        .collect();
    let outcome = publisher.publish(set(1)).unwrap();
    assert_eq!(outcome, PublishOutcome::Delivered { n_readers: READERS_MAX });
    for subscriber in &mut subscribers {
        assert_eq!(receive(subscriber), 1);
    }
    let error = handover::subscribe_to(&service).map(|_| ()).unwrap_err();
    assert!(
        matches!(
            error,
            HandoverError::TooManyReaders {
                n_readers: READERS_MAX,
                ..
            }
        ),
        "{error}"
    );
}

#[test]
fn between_processes_there_is_one_publisher() {
    let service = unique_service();
    let _publisher = handover::publish_on(&service, &cameras()).unwrap();
    let error = handover::publish_on(&service, &cameras()).map(|_| ()).unwrap_err();
    assert!(matches!(error, HandoverError::PublisherExists { .. }), "{error}");
}

#[test]
fn bad_service_names_are_refused() {
    for name in ["", "iox2://mine", &"x".repeat(10_000)] {
        let error = handover::subscribe_to(name).map(|_| ()).unwrap_err();
        assert!(
            matches!(error, HandoverError::ServiceName { .. }) && error.is_bad_input(),
            "{error}"
        );
    }
}

#[test]
fn between_processes_a_bad_set_is_not_sent() {
    let (mut publisher, mut subscriber) = pair(Transport::Process);
    let mut large = set(1);
    large.frames[0].size.width *= 2;
    large.frames[0].pixels = large.frames[0].pixels.repeat(2).into();
    assert!(matches!(
        publisher.publish(large).unwrap_err(),
        HandoverError::FrameTooLarge { .. }
    ));
    let mut broken = set(2);
    broken.frames[0].meta.exposure.gain = f64::NAN;
    assert!(matches!(
        publisher.publish(broken).unwrap_err(),
        HandoverError::InvalidSet { .. }
    ));
    publisher.publish(set(3)).unwrap();
    assert_eq!(receive(&mut subscriber), 3);
}

#[test]
fn bad_data_in_shared_memory_is_an_error_and_no_more() {
    let service = unique_service();
    let mut subscriber = handover::subscribe_to(&service).unwrap();
    let node = NodeBuilder::new().create::<ipc_threadsafe::Service>().unwrap();
    let name = ServiceName::new(&service).unwrap();
    let sets = node.service_builder(&name).publish_subscribe::<[u8]>().open().unwrap();
    let stranger = sets.publisher_builder().initial_max_slice_len(4096).create().unwrap();
    let send = |bytes: &[u8]| {
        let mut sample = stranger.loan_slice(bytes.len()).unwrap();
        sample.payload_mut().copy_from_slice(bytes);
        sample.send().unwrap();
    };
    let mut good = vec![0; packet_bytes(1)];
    encode(&set(1), 1, 7, &[1], &mut good).unwrap();
    let mut other_version = good.clone();
    other_version[8] = 99;
    for (bytes, is_skippable) in [(&b"garbage"[..], true), (&good[..40], true), (&other_version, false)] {
        send(bytes);
        let error = subscriber.receive(WATCHDOG).unwrap_err();
        assert!(matches!(error, HandoverError::BadPacket { .. }), "{error}");
        assert_eq!(error.is_skippable(), is_skippable, "{error}");
    }
    send(&other_version);
    let HandoverError::BadPacket { source, .. } = subscriber.receive(WATCHDOG).unwrap_err() else {
        panic!()
    };
    assert_eq!(
        source,
        PacketError::Version {
            found: 99,
            supported: PACKET_VERSION
        }
    );
    // Its pixels are nowhere.
    send(&good);
    assert!(matches!(
        subscriber.receive(Duration::from_millis(50)).unwrap(),
        Received::TimedOut
    ));
    let mut publisher = handover::publish_on(&service, &cameras()).unwrap();
    publisher.publish(set(2)).unwrap();
    assert_eq!(receive(&mut subscriber), 2);
}

/// A set whose one frame was written into a buffer of the publisher's pool.
fn set_in(pool: &mut dyn Pool, sequence: u64) -> FrameSet {
    let mut set = set(sequence);
    let mut lease = pool.lease().expect("a free buffer");
    let n_bytes = set.frames[0].pixels.len();
    lease.bytes_mut()[..n_bytes].copy_from_slice(&set.frames[0].pixels);
    set.frames[0].pixels = lease.freeze(n_bytes);
    set
}

#[test]
fn what_is_written_into_the_pool_arrives() {
    for transport in ALL {
        let (mut publisher, mut subscriber) = pair(transport);
        let mut pool = publisher.pool(4, size().pixels() * 3).unwrap();
        for sequence in 1..200 {
            let sent = set_in(&mut *pool, sequence);
            assert_eq!(sent.frames[0].pixels[..], set(sequence).frames[0].pixels[..]);
            publisher.publish(sent).unwrap();
            let Received::Set(got) = subscriber.receive(WATCHDOG).unwrap() else {
                panic!("{transport:?}")
            };
            assert_eq!(got.frames[0].pixels[..], set(sequence).frames[0].pixels[..]);
        }
    }
}

#[test]
fn pool_and_copies_mix_between_processes() {
    let (mut publisher, mut subscriber) = pair(Transport::Process);
    let mut pool = publisher.pool(4, size().pixels() * 3).unwrap();
    for sequence in 1..60 {
        let sent = if sequence % 3 == 0 {
            set(sequence)
        } else {
            set_in(&mut *pool, sequence)
        };
        // The same frame again, as when the other camera is the slower one.
        publisher.publish(sent.clone()).unwrap();
        publisher.publish(sent).unwrap();
        let Received::Set(got) = subscriber.receive(WATCHDOG).unwrap() else {
            panic!()
        };
        assert_eq!(got.frames[0].pixels[..], set(sequence).frames[0].pixels[..]);
    }
    // Counted from the first set received, the second one.
    assert_eq!(subscriber.stats().missed, 58);
}

#[test]
fn both_sides_may_keep_frames_for_ever() {
    let (mut publisher, mut subscriber) = pair(Transport::Process);
    let mut other = handover::subscribe_to(&unique_service()).unwrap();
    let mut pool = publisher.pool(4, size().pixels() * 3).unwrap();
    let mut kept = Vec::new();
    for sequence in 1..300 {
        let sent = set_in(&mut *pool, sequence);
        kept.push((sequence, sent.clone()));
        publisher.publish(sent).unwrap();
        let Received::Set(got) = subscriber.receive(WATCHDOG).unwrap() else {
            panic!()
        };
        kept.push((sequence, got));
    }
    assert!(matches!(other.receive(Duration::ZERO).unwrap(), Received::TimedOut));
    drop(publisher);
    drop(pool);
    drop(subscriber);
    for (sequence, kept) in &kept {
        assert_eq!(kept.frames[0].pixels[..], set(*sequence).frames[0].pixels[..]);
    }
}

#[test]
fn buffers_of_a_pool_come_back() {
    let (publisher, _subscriber) = pair(Transport::Process);
    let mut pool = publisher.pool(4, size().pixels() * 3).unwrap();
    for _ in 0..1000 {
        let leases: Vec<_> = (0..32).map_while(|_| pool.lease()).collect();
        assert_eq!(leases.len(), 32);
    }
    let too_large = publisher.pool(4, size().pixels() * 3 + 1).map(|_| ()).unwrap_err();
    assert!(matches!(too_large, HandoverError::FrameTooLarge { .. }), "{too_large}");
}
