use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;

use super::*;
use crate::frame::Exposure;
use crate::grouping::GroupingCounters;
use crate::handover::PublisherStats;
use crate::lockstep::latency::Latency;
use crate::recording::mcap::RecorderStats;
use crate::stamps::{CheckedStamp, LossLedger, SequenceEvent, StampCounters};

/// The counts of a camera that lost 3 frames by its driver and a faulty one.
fn losses() -> crate::stamps::LossCounts {
    let mut ledger = LossLedger::new(33_333_333);
    for sequence in [0, 4] {
        ledger.delivered(&CheckedStamp {
            sequence,
            timestamp_ns: 1 + sequence * 33_333_333,
            basis: StampBasis::Driver,
            doubt: None,
            sequence_event: SequenceEvent::Continues,
        });
    }
    ledger.lost(LossCause::ErrorFrame, Some(5));
    *ledger.counts()
}

fn camera(name: &str, stage: CameraStage) -> CameraReport {
    CameraReport {
        name: name.to_owned(),
        stage,
        mode: "1280x720 MJPEG".to_owned(),
        nominal_rate_hz: 30.0,
        rate_hz: 29.97,
        frames: 12_345,
        losses: losses(),
        duplicates: 1,
        empty_buffers: 2,
        stamps: StampCounters::default(),
        stamp_basis: Some(StampBasis::Mapped),
        opened: 3,
        restarts: 4,
        undecodable: 0,
        refused_requests: 0,
        auto_modes_found: 0,
        exposure: Some(Exposure {
            time_s: 0.0123,
            gain: 2.0,
            white_balance: [1.9, 1.0, f64::NAN],
        }),
        residual_ev: f64::NEG_INFINITY,
        flickers: true,
        latency: Some(Latency {
            frames: 2,
            source: LatencySource::Measured,
            lead: 40.0,
        }),
    }
}

fn report() -> Report {
    let gone = CameraStage::Waiting {
        reason: "no camera `HD Webcam`".to_owned(),
    };
    Report {
        cameras: vec![camera("scene", CameraStage::Streaming), camera("ball", gone)],
        grouping: GroupingCounters::default(),
        publisher: PublisherStats {
            published: 678,
            unread: 9,
        },
        n_readers: 1,
        skew: crate::daemon::Skew {
            p50_us: 4000.0,
            p95_us: 8000.0,
            max_us: 16_600.0,
        },
        recorder: Some(RecorderStats {
            frames: 100,
            bytes: 123_456_789,
            elapsed_s: 61.0,
            ..RecorderStats::default()
        }),
        bad_sets: 0,
    }
}

fn status() -> Status {
    Status::starting("mirrorball/frames").with_report(&report(), 3723.0)
}

#[test]
fn a_status_survives_json() {
    let json = serde_json::to_string(&status()).unwrap();
    assert_eq!(serde_json::from_str::<Status>(&json).unwrap(), status());
    assert!(
        json.contains("\"driver_drop\":3") && json.contains("\"waiting_for_device\""),
        "{json}"
    );
}

#[test]
fn the_table_says_it_all() {
    let text = table(&status());
    println!("{text}");
    for expected in [
        "up 1:02:03",
        "waiting for device",
        "streaming",
        "29.97 of 30.00 /s",
        "3 driver drop, 1 error frame",
        "12.30 ms, flickers",
        "2 frames",
        "678 published",
        "p95 8.00 ms",
        "123.5 MB in 0:01:01",
        "no camera `HD Webcam`",
    ] {
        assert!(text.contains(expected), "{expected} in\n{text}");
    }
    assert!(table(&Status::starting("x")).contains("recorder"));
}

#[test]
fn the_summary_counts_cameras() {
    assert_eq!(
        status().summary(),
        "1 of 2 cameras streaming, 678 sets published, 8 frames lost, 1 readers"
    );
}

#[test]
fn the_newest_status_is_served_to_the_user_and_the_group() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run/mirrorball/status.sock");
    let board = StatusBoard::new(Status::starting("a"));
    let server = StatusServer::start(&path, board.clone()).unwrap();
    assert_eq!(fetch(&path).unwrap().service, "a");
    board.put(status());
    assert_eq!(fetch(&path).unwrap(), status());
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o660);
    let parent_mode = std::fs::metadata(path.parent().unwrap()).unwrap().permissions().mode();
    assert_eq!(parent_mode & 0o027, 0);
    drop(server);
    assert!(!path.exists());
    let error = fetch(&path).unwrap_err();
    assert!(matches!(error, StatusError::Connect { .. }), "{error}");
}

#[test]
fn clients_that_hang_hold_up_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("status.sock");
    let _server = StatusServer::start(&path, StatusBoard::new(status())).unwrap();
    let mut hanging: Vec<UnixStream> = (0..50).map(|_| UnixStream::connect(&path).unwrap()).collect();
    // Some go on talking, whom nobody reads.
    for client in hanging.iter_mut().take(10) {
        let _ = client.write_all(b"GET / HTTP/1.1\r\n\r\n");
    }
    assert_eq!(fetch(&path).unwrap(), status());
    drop(hanging.drain(..25));
    assert_eq!(fetch(&path).unwrap(), status());
}

#[test]
fn a_stale_socket_is_removed_and_a_living_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("status.sock");
    // Left by a daemon that was killed.
    drop(UnixListener::bind(&path).unwrap());
    assert!(path.exists());
    let server = StatusServer::start(&path, StatusBoard::new(status())).unwrap();
    let error = StatusServer::start(&path, StatusBoard::new(status())).unwrap_err();
    assert!(matches!(error, StatusError::InUse { .. }), "{error}");
    assert_eq!(fetch(&path).unwrap(), status());
    drop(server);
    std::fs::write(&path, "precious").unwrap();
    let error = StatusServer::start(&path, StatusBoard::new(status())).unwrap_err();
    assert!(matches!(error, StatusError::NotASocket { .. }), "{error}");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
}

#[test]
fn a_socket_that_somebody_took_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("status.sock");
    let server = StatusServer::start(&path, StatusBoard::new(status())).unwrap();
    std::fs::remove_file(&path).unwrap();
    let _other = UnixListener::bind(&path).unwrap();
    drop(server);
    assert!(path.exists());
}

#[test]
fn places_that_cannot_be_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let too_long = folder.path().join("x".repeat(120));
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    for (path, expected) in [
        (too_long, "cannot serve"),
        (file.join("status.sock"), "cannot make folder"),
    ] {
        let error = StatusServer::start(&path, StatusBoard::new(status())).unwrap_err();
        assert!(
            error.to_string().contains(expected) && !error.hint().is_empty(),
            "{error}"
        );
    }
}

#[test]
fn an_answer_that_is_no_status_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("status.sock");
    let listener = UnixListener::bind(&path).unwrap();
    let server = std::thread::spawn(move || {
        for answer in ["", "{}", "not json"] {
            listener.accept().unwrap().0.write_all(answer.as_bytes()).unwrap();
        }
    });
    for _ in 0..3 {
        let error = fetch(&path).unwrap_err();
        assert!(matches!(error, StatusError::Answer { .. }), "{error}");
    }
    server.join().unwrap();
}

#[test]
fn the_socket_is_where_the_environment_says() {
    let environment = |runtime: Option<&str>, xdg: Option<&str>| SocketEnvironment {
        runtime_directory: runtime.map(Into::into),
        xdg_runtime_dir: xdg.map(Into::into),
        uid: 1000,
    };
    let cases = [
        (
            Some("/run/mirrorball:/run/other"),
            Some("/run/user/1000"),
            "/run/mirrorball/status.sock",
        ),
        (None, Some("/run/user/1000"), "/run/user/1000/mirrorball/status.sock"),
        (None, None, "/tmp/mirrorball-1000/status.sock"),
    ];
    for (runtime, xdg, expected) in cases {
        assert_eq!(default_socket(&environment(runtime, xdg)), Path::new(expected));
    }
    let folder = tempfile::tempdir().unwrap();
    let place = environment(folder.path().to_str(), None);
    let path = default_socket(&place);
    let _server = StatusServer::start(&path, StatusBoard::new(status())).unwrap();
    assert_eq!(find_socket(&place), path);
}
