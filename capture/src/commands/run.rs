//! `run`: the daemon itself, on the cameras of a configuration file.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use clap::Args;
use mirrorball_capture::config::{CameraConfig, CaptureConfig, RecordConfig};
use mirrorball_capture::daemon::{CameraSetup, Daemon, DaemonSettings, Report, V4l2Device};
use mirrorball_capture::handover;
use mirrorball_capture::lockstep::Mains;
use mirrorball_capture::notify::Notifier;
use mirrorball_capture::recording::mcap::{Recorder, RecorderOptions};
use mirrorball_capture::stamps::StampSettings;
use mirrorball_capture::status::{SocketEnvironment, Status, StatusBoard, StatusServer, default_socket};
use mirrorball_capture::v4l2::{PowerLine, StreamSettings, Wish};
use mirrorball_capture::{CameraDescription, PixelFormat};

use super::{CommandError, read_rig_text};

#[derive(Debug, Args)]
pub(crate) struct RunArgs {
    /// Configuration file; `configs/README.md` describes it.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: PathBuf,
    /// Only check the configuration and say what it means.
    #[arg(long)]
    pub(crate) check_config: bool,
}

/// Frames that may wait for partners, for the recorder and for readers in this process, besides the driver's.
const BUFFERS_IN_USE: usize = 40;

/// Drives the cameras of `config` until `stop` is raised.
pub(crate) fn run(config: &CaptureConfig, config_path: &Path, stop: &AtomicBool) -> Result<(), CommandError> {
    let cameras: Vec<_> = config
        .cameras
        .iter()
        .map(|camera| setup(camera, config.lockstep.mains))
        .collect();
    let descriptions: Vec<_> = cameras.iter().map(|setup| setup.description.clone()).collect();
    let publisher = handover::publish_on(&config.service.name, &descriptions)?;
    let recorder = match &config.record {
        Some(record) => Some(recorder(record, config, config_path, &descriptions)?),
        None => None,
    };
    let settings = DaemonSettings {
        lockstep: config.lockstep.clone(),
        max_skew: config.service.max_skew,
    };
    let mut notifier = Notifier::from_process().map_err(CommandError::Notify)?;
    let started = Instant::now();
    let first = Status::starting(&config.service.name);
    let board = StatusBoard::new(first.clone());
    let _server = serve_status(config, &board);
    let mut daemon = Daemon::start(cameras, settings, publisher, recorder)?;
    tracing::info!("publishing on service `{}`", config.service.name);
    notifier.ready();
    let result = daemon.run(stop, &mut |report| {
        let status = first.with_report(report, started.elapsed().as_secs_f64());
        notifier.status(&status.summary());
        // From the hub, once a second: if that stands still, so does the daemon.
        notifier.beat();
        board.put(status);
        tracing::debug!("{}", in_one_line(report));
    });
    notifier.stopping();
    let (report, recorder) = daemon.finish()?;
    tracing::info!("{}", in_one_line(&report));
    if let Some(recorder) = recorder {
        let stats = recorder.finish()?;
        tracing::info!("recorded {} frames, {} lost", stats.frames, stats.lost_frames);
    }
    Ok(result?)
}

/// Serves the status, if that can be: frames matter more.
fn serve_status(config: &CaptureConfig, board: &StatusBoard) -> Option<StatusServer> {
    let path = match (&config.service.status_socket, SocketEnvironment::from_process()) {
        (Some(path), _) => path.clone(),
        (None, Ok(environment)) => default_socket(&environment),
        (None, Err(error)) => {
            tracing::warn!("the status is not served, as it is not known which user this is: {error}");
            return None;
        }
    };
    match StatusServer::start(&path, board.clone()) {
        Ok(server) => {
            tracing::info!("status on `{}`", path.display());
            Some(server)
        }
        Err(error) => {
            let reason = error.source().map_or_else(String::new, |reason| format!(": {reason}"));
            tracing::warn!("the status is not served: {error}{reason}; {}", error.hint());
            None
        }
    }
}

fn setup(camera: &CameraConfig, mains: Mains) -> CameraSetup {
    let interval_ns = ((1e9 / camera.rate_hz).round() as u64).max(1);
    CameraSetup {
        description: CameraDescription {
            name: camera.name.clone(),
            role: camera.role,
            size: camera.size,
            // Whatever is agreed on, no other format takes more room.
            format: PixelFormat::Mjpeg,
        },
        device: Box::new(V4l2Device {
            address: camera.address.clone(),
            wish: Wish {
                size: camera.size,
                frames_per_s: camera.rate_hz,
                formats: camera.formats.clone(),
            },
            stream: StreamSettings {
                method: camera.method,
                n_buffers: camera.n_buffers,
            },
            power_line: match mains {
                Mains::Steady => PowerLine::Off,
                Mains::Hz50 => PowerLine::Hz50,
                Mains::Hz60 => PowerLine::Hz60,
            },
        }),
        stamps: StampSettings {
            policy: camera.stamps,
            offset_ns: camera.stamp_offset_ns,
            interval_ns,
        },
        response: camera.response.clone(),
        tables: camera.tables.clone(),
        latency_frames: camera.latency_frames,
        n_buffers: camera.n_buffers as usize + BUFFERS_IN_USE,
    }
}

fn recorder(
    record: &RecordConfig,
    config: &CaptureConfig,
    config_path: &Path,
    cameras: &[CameraDescription],
) -> Result<Recorder, CommandError> {
    let name = jiff::Zoned::now().strftime("%Y-%m-%dT%H-%M-%S.mcap").to_string();
    let path = record.directory.join(name);
    let options = RecorderOptions {
        rig: config.rig.as_deref().map(read_rig_text).transpose()?,
        config: std::fs::read_to_string(config_path).ok(),
        queue_bytes: u64::from(record.max_queue_mb) * 1_000_000,
        ..RecorderOptions::default()
    };
    tracing::info!("recording into `{}`", path.display());
    Ok(Recorder::create(&path, cameras, options)?)
}

fn in_one_line(report: &Report) -> String {
    let cameras: Vec<_> = report
        .cameras
        .iter()
        .map(|camera| {
            format!(
                "{} {:.1}/s, {} frames, {} lost",
                camera.name,
                camera.rate_hz,
                camera.frames,
                camera.losses.total()
            )
        })
        .collect();
    format!("{}; {} readers", cameras.join("; "), report.n_readers)
}
