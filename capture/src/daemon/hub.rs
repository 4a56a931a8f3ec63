//! Where events become frames with exposure, sets, requests to cameras, and counts.

use std::collections::VecDeque;
use std::time::Instant;

use crossbeam_channel::Sender;

use super::event::{Captured, Event, Opened, Tally, What};
use super::meter_thread::MeterThread;
use super::report::{CameraReport, CameraStage, Report, Skew};
use super::{DaemonError, DaemonSettings};
use crate::controls::{ControlRanges, ControlValues};
use crate::frame::{Exposure, Frame, FrameMeta, FrameSet, PixelFormat};
use crate::grouping::Grouper;
use crate::handover::{HandoverError, Publisher};
use crate::lockstep::latency::LatencySource;
use crate::lockstep::tables::Tables;
use crate::lockstep::{Lockstep, LockstepCamera, LockstepSettings, Request, RequestId};
use crate::meter::{Meter, Response};
use crate::recording::mcap::{EventKind, Recorder, RecordingEvent};
use crate::source::{CameraDescription, CameraRole};

/// Sets whose skew is remembered.
const SKEWS_MAX: usize = 256;

/// Shortest time between two pictures of a camera that are measured: thirty a second are enough to decide by.
const MEASURE_INTERVAL_NS: u64 = 30_000_000;

/// Frames whose time stamps are remembered for answers that come late.
const RECENT_MAX: usize = 8;

/// Answers that may wait for the next frame: more than there are requests under way, lest a camera that sends nothing
/// fills the memory.
const ACCEPTED_MAX: usize = 32;

/// Values that a driver has accepted.
struct Accepted {
    id: RequestId,
    values: ControlValues,
    /// When, on the monotonic clock.
    accepted_ns: u64,
}

/// What the hub knows of one camera.
pub(super) struct CameraTrack {
    description: CameraDescription,
    response: Response,
    meter: Meter,
    tables: Tables,
    latency_frames: Option<u32>,
    interval_ns: u64,
    ranges: Option<ControlRanges>,
    values: ControlValues,
    mode: Option<super::device::Mode>,
    requests: Option<Sender<Request>>,
    /// What the driver has accepted after the last frame began.
    accepted: VecDeque<Accepted>,
    /// Sequence numbers and time stamps of the last frames.
    recent: VecDeque<(u64, u64)>,
    tally: Tally,
    report: CameraReport,
    frames_at_last_report: u64,
    losses_told: u64,
    last_measured_ns: Option<u64>,
}

impl CameraTrack {
    pub(super) fn new(
        description: CameraDescription,
        response: Response,
        tables: Tables,
        latency_frames: Option<u32>,
        interval_ns: u64,
    ) -> Self {
        let report = CameraReport {
            name: description.name.to_string(),
            stage: CameraStage::Waiting {
                reason: "not looked for yet".to_owned(),
            },
            mode: String::new(),
            nominal_rate_hz: 0.0,
            rate_hz: 0.0,
            frames: 0,
            losses: crate::stamps::LossCounts::default(),
            duplicates: 0,
            empty_buffers: 0,
            stamps: crate::stamps::StampCounters::default(),
            stamp_basis: None,
            opened: 0,
            restarts: 0,
            undecodable: 0,
            refused_requests: 0,
            auto_modes_found: 0,
            exposure: None,
            residual_ev: 0.0,
            flickers: false,
            latency: None,
        };
        Self {
            description,
            meter: Meter::new(response.clone()),
            response,
            tables,
            latency_frames,
            interval_ns,
            ranges: None,
            values: ControlValues::default(),
            mode: None,
            requests: None,
            accepted: VecDeque::new(),
            recent: VecDeque::with_capacity(RECENT_MAX),
            tally: Tally::default(),
            report,
            frames_at_last_report: 0,
            losses_told: 0,
            last_measured_ns: None,
        }
    }
}

pub(super) struct Hub {
    cameras: Vec<CameraTrack>,
    settings: LockstepSettings,
    lockstep: Lockstep,
    grouper: Grouper,
    publisher: Publisher,
    recorder: Option<Recorder>,
    meter_thread: MeterThread,
    skews_us: VecDeque<f64>,
    bad_sets: u64,
    last_timestamp_ns: u64,
    last_report: Instant,
}

impl Hub {
    pub(super) fn new(
        cameras: Vec<CameraTrack>,
        settings: DaemonSettings,
        publisher: Publisher,
        recorder: Option<Recorder>,
        events: Sender<Event>,
    ) -> Result<Self, DaemonError> {
        let leader = cameras
            .iter()
            .position(|camera| camera.description.role == CameraRole::Scene)
            .unwrap_or(0);
        let lockstep_settings = LockstepSettings {
            leader,
            ..settings.lockstep
        };
        let descriptions: Vec<_> = cameras.iter().map(|camera| camera.description.clone()).collect();
        let meters = cameras
            .iter()
            .map(|camera| Meter::new(camera.response.clone()))
            .collect();
        let meter_thread = MeterThread::start(meters, events).map_err(|source| DaemonError::StartThread {
            camera: descriptions[leader].name.to_string(),
            source,
        })?;
        Ok(Self {
            lockstep: lockstep_for(&cameras, &lockstep_settings)?,
            settings: lockstep_settings,
            grouper: Grouper::for_cameras(&descriptions, settings.max_skew),
            cameras,
            publisher,
            recorder,
            meter_thread,
            skews_us: VecDeque::with_capacity(SKEWS_MAX),
            bad_sets: 0,
            last_timestamp_ns: 0,
            last_report: Instant::now(),
        })
    }

    pub(super) fn take(&mut self, event: Event) -> Result<(), DaemonError> {
        let camera = event.camera;
        match event.what {
            What::Frame(captured) => return self.take_frame(camera, captured),
            What::Opened(opened) => return self.take_opened(camera, *opened),
            What::Closed { reason } => return self.take_closed(camera, reason),
            What::Restarted { reason } => self.note(camera, format!("stream restarted: {reason}")),
            What::Tally(tally) => self.take_tally(camera, *tally),
            What::AutoModeFound(mode) => {
                self.cameras[camera].report.auto_modes_found += 1;
                self.note(camera, format!("{mode} was switched on by somebody else"));
                self.lockstep.on_auto_mode_found(camera);
            }
            What::Applied {
                id,
                read_back,
                accepted_ns,
            } => self.take_accepted(
                camera,
                Accepted {
                    id,
                    values: read_back,
                    accepted_ns,
                },
            ),
            What::Refused {
                id,
                reason,
                is_automatic,
            } => {
                self.cameras[camera].report.refused_requests += 1;
                tracing::debug!(camera = %self.cameras[camera].report.name, "request refused: {reason}");
                self.lockstep.on_refused(camera, id);
                if is_automatic {
                    // The next request takes the camera back first; where that is not the reason it does no harm.
                    self.lockstep.on_auto_mode_found(camera);
                }
            }
            What::Found { values, accepted_ns } => self.take_accepted(
                camera,
                Accepted {
                    id: NOBODYS_REQUEST,
                    values,
                    accepted_ns,
                },
            ),
            What::Drifted => {
                self.cameras[camera].report.auto_modes_found += 1;
                self.note(camera, "controls have changed by themselves".to_owned());
                self.lockstep.on_auto_mode_found(camera);
            }
            What::Measured { sequence, statistics } => {
                self.lockstep.on_statistics(camera, sequence, &statistics);
            }
            What::Undecodable { sequence, reason } => {
                self.cameras[camera].report.undecodable += 1;
                tracing::debug!(camera = %self.cameras[camera].report.name, sequence, "not measured: {reason}");
            }
        }
        Ok(())
    }

    /// A driver has accepted values: they hold from the first frame on that began after that. By when frames begin
    /// that can be told better than by when they arrive, which is later by as long as they take.
    fn take_accepted(&mut self, camera: usize, accepted: Accepted) {
        let track = &mut self.cameras[camera];
        track.values.merge(&accepted.values);
        let is_later = |frame: &&(u64, u64)| frame.1 > accepted.accepted_ns;
        match track.recent.iter().find(is_later) {
            Some(&(sequence, _)) => self
                .lockstep
                .on_applied(camera, accepted.id, &accepted.values, sequence),
            None => {
                if track.accepted.len() == ACCEPTED_MAX {
                    track.accepted.pop_front();
                }
                track.accepted.push_back(accepted);
            }
        }
    }

    /// A frame is about to be judged: what was accepted before it began holds for it.
    fn settle_accepted(&mut self, camera: usize, sequence: u64, timestamp_ns: u64) {
        let track = &mut self.cameras[camera];
        while let Some(accepted) = track
            .accepted
            .pop_front_if(|accepted| accepted.accepted_ns < timestamp_ns)
        {
            self.lockstep
                .on_applied(camera, accepted.id, &accepted.values, sequence);
        }
        if track.recent.len() == RECENT_MAX {
            track.recent.pop_front();
        }
        track.recent.push_back((sequence, timestamp_ns));
    }

    /// A camera is there, for the first time or again. With controls not seen before the lockstep begins anew, with the
    /// latencies that were measured.
    fn take_opened(&mut self, camera: usize, opened: Opened) -> Result<(), DaemonError> {
        let track = &mut self.cameras[camera];
        track.report.mode.clone_from(&opened.mode.label);
        track.report.nominal_rate_hz = 1e9 / opened.mode.interval_ns as f64;
        track.report.stage = CameraStage::Streaming;
        let is_same_interval = track.interval_ns == opened.mode.interval_ns;
        track.interval_ns = opened.mode.interval_ns;
        track.mode = Some(opened.mode);
        let mut text = format!("streams: {}", track.report.mode);
        for mode in &opened.switched_off {
            text.push_str(&format!("; {mode} was on and is off now"));
        }
        if let Some(complaint) = &opened.complaint {
            text.push_str(&format!("; {complaint}"));
        }
        let (ranges, values, requests) = match opened.controls {
            Some(controls) => (controls.ranges, controls.values, Some(controls.requests)),
            None => (ControlRanges::default(), ControlValues::default(), None),
        };
        let is_known = track.ranges == Some(ranges) && is_same_interval;
        track.ranges = Some(ranges);
        track.values = values;
        track.requests = requests;
        // What was accepted before is in the values that were read just now.
        track.accepted.clear();
        track.recent.clear();
        self.note(camera, text);
        if is_known {
            self.lockstep.on_returned(camera, values);
        } else {
            self.keep_measured_latencies();
            self.lockstep = lockstep_for(&self.cameras, &self.settings)?;
        }
        Ok(())
    }

    fn keep_measured_latencies(&mut self) {
        for (camera, track) in self.cameras.iter_mut().enumerate() {
            if let Some(state) = self.lockstep.camera(camera)
                && state.latency.source != LatencySource::Assumed
                && track.ranges.is_some()
            {
                track.latency_frames.get_or_insert(state.latency.frames);
            }
        }
    }

    fn take_closed(&mut self, camera: usize, reason: String) -> Result<(), DaemonError> {
        let track = &mut self.cameras[camera];
        // Whoever holds the way to the controls holds the device open.
        track.requests = None;
        self.note(camera, format!("no camera: {reason}"));
        self.cameras[camera].report.stage = CameraStage::Waiting { reason };
        self.lockstep.on_lost(camera);
        let name = self.cameras[camera].description.name.clone();
        for set in self.grouper.lose(&name) {
            self.publish(set)?;
        }
        Ok(())
    }

    fn take_tally(&mut self, camera: usize, tally: Tally) {
        let track = &mut self.cameras[camera];
        let mut losses = Vec::new();
        for (cause, count) in tally.losses.iter() {
            let frames = count - track.tally.losses.get(cause);
            if frames > 0 {
                losses.push((cause, frames));
            }
        }
        track.tally = tally;
        if let Some(recorder) = &mut self.recorder {
            for (cause, frames) in losses {
                recorder.event(RecordingEvent {
                    timestamp_ns: self.last_timestamp_ns,
                    camera: Some(track.report.name.clone()),
                    kind: EventKind::Lost {
                        frames,
                        cause: cause.label().replace(' ', "_"),
                    },
                });
            }
        }
    }

    fn take_frame(&mut self, camera: usize, captured: Captured) -> Result<(), DaemonError> {
        self.settle_accepted(camera, captured.sequence, captured.timestamp_ns);
        let track = &mut self.cameras[camera];
        let Some(mode) = &track.mode else { return Ok(()) };
        let exposed = self.lockstep.on_frame(camera, captured.sequence, captured.timestamp_ns);
        let (exposure, residual, bracket_step) = match exposed {
            Some(exposed) => {
                track.report.flickers = exposed.flickers;
                (exposed.exposure, exposed.residual, exposed.bracket_step)
            }
            None => (UNKNOWN_EXPOSURE, [1.0; 3], 0),
        };
        track.report.exposure = Some(exposure);
        track.report.residual_ev = residual[1].log2();
        let frame = Frame {
            meta: FrameMeta {
                residual,
                bracket_step,
                lost_before: captured.lost_before,
                flags: captured.flags,
                ..FrameMeta::new(
                    track.description.name.clone(),
                    captured.sequence,
                    captured.timestamp_ns,
                    exposure,
                )
            },
            size: mode.size,
            format: mode.format,
            pixels: captured.pixels,
        };
        self.last_timestamp_ns = self.last_timestamp_ns.max(captured.timestamp_ns);
        if let Some(recorder) = &mut self.recorder {
            // What became of it is in the recorder's own count.
            let _ = recorder.record(frame.clone());
        }
        // Readers first: what is measured acts on later frames.
        for set in self.grouper.push(frame.clone()) {
            self.publish(set)?;
        }
        self.measure(camera, frame);
        self.send_request(camera);
        Ok(())
    }

    /// Measures a picture, if the last one measured is long enough ago.
    fn measure(&mut self, camera: usize, frame: Frame) {
        let track = &mut self.cameras[camera];
        let is_due = |last_ns: u64| frame.meta.timestamp_ns.saturating_sub(last_ns) >= MEASURE_INTERVAL_NS;
        if !track.last_measured_ns.is_none_or(is_due) {
            return;
        }
        track.last_measured_ns = Some(frame.meta.timestamp_ns);
        if frame.format == PixelFormat::Mjpeg {
            self.meter_thread.measure(camera, frame);
            return;
        }
        let track = &mut self.cameras[camera];
        match track.meter.measure(frame.size, frame.format, &frame.pixels) {
            Ok(statistics) => self.lockstep.on_statistics(camera, frame.meta.sequence, &statistics),
            Err(_) => track.report.undecodable += 1,
        }
    }

    fn send_request(&mut self, camera: usize) {
        let Some(request) = self.lockstep.request(camera) else {
            return;
        };
        let track = &mut self.cameras[camera];
        let is_sent = track
            .requests
            .as_ref()
            .is_some_and(|requests| requests.try_send(request).is_ok());
        if !is_sent {
            track.report.refused_requests += 1;
            self.lockstep.on_refused(camera, request.id);
        }
    }

    fn publish(&mut self, set: FrameSet) -> Result<(), DaemonError> {
        for index in 1..set.frames.len() {
            if let Some(skew_ns) = set.skew_ns(index) {
                if self.skews_us.len() == SKEWS_MAX {
                    self.skews_us.pop_front();
                }
                self.skews_us.push_back(skew_ns.unsigned_abs() as f64 / 1e3);
            }
        }
        match self.publisher.publish(set) {
            Ok(_) => Ok(()),
            Err(HandoverError::InvalidSet { source, .. }) => {
                self.bad_sets += 1;
                tracing::debug!("a set cannot be published: {source}");
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Says in the log, and in the recording, what has happened to a camera.
    fn note(&mut self, camera: usize, text: String) {
        let name = &self.cameras[camera].report.name;
        tracing::info!(camera = %name, "{text}");
        if let Some(recorder) = &mut self.recorder {
            recorder.event(RecordingEvent {
                timestamp_ns: self.last_timestamp_ns,
                camera: Some(name.clone()),
                kind: EventKind::Note { text },
            });
        }
    }

    /// How things stand; rates are over the time since the last report, so this is for once a second.
    pub(super) fn report(&mut self) -> Report {
        let seconds = self.last_report.elapsed().as_secs_f64().max(1e-3);
        self.last_report = Instant::now();
        for (camera, track) in self.cameras.iter_mut().enumerate() {
            let Tally {
                delivered, ref losses, ..
            } = track.tally;
            track.report.rate_hz = delivered.saturating_sub(track.frames_at_last_report) as f64 / seconds;
            track.frames_at_last_report = delivered;
            track.report.frames = delivered;
            track.report.losses = *losses;
            track.report.duplicates = track.tally.duplicates;
            track.report.empty_buffers = track.tally.empty_buffers;
            track.report.stamps = track.tally.stamps;
            track.report.stamp_basis = track.tally.basis;
            track.report.opened = track.tally.opened;
            track.report.restarts = track.tally.restarts;
            track.report.latency = self.lockstep.camera(camera).map(|state| state.latency);
            let total = losses.total();
            if total > track.losses_told {
                let causes: Vec<_> = losses
                    .iter()
                    .filter(|(_, count)| *count > 0)
                    .map(|(cause, count)| format!("{} {count}", cause.label()))
                    .collect();
                tracing::warn!(camera = %track.report.name, "{total} frames lost so far: {}", causes.join(", "));
                track.losses_told = total;
            }
        }
        Report {
            cameras: self.cameras.iter().map(|track| track.report.clone()).collect(),
            grouping: self.grouper.counters(),
            publisher: self.publisher.stats(),
            n_readers: self.publisher.count_readers(),
            skew: self.skew(),
            recorder: self.recorder.as_ref().map(Recorder::stats),
            bad_sets: self.bad_sets,
        }
    }

    fn skew(&self) -> Skew {
        let mut sorted: Vec<f64> = self.skews_us.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let index = (sorted.len().saturating_sub(1) as f64 * share).round() as usize;
            sorted.get(index).copied().unwrap_or(0.0)
        };
        Skew {
            p50_us: at(0.5),
            p95_us: at(0.95),
            max_us: at(1.0),
        }
    }

    /// Hands over the sets that still waited for a partner.
    pub(super) fn finish(mut self) -> Result<(Report, Option<Recorder>), DaemonError> {
        for set in self.grouper.finish() {
            self.publish(set)?;
        }
        let report = self.report();
        Ok((report, self.recorder))
    }
}

/// The number of no request: values that were not asked for.
const NOBODYS_REQUEST: RequestId = RequestId(u64::MAX);

/// Exposure of a frame of which nothing is known.
const UNKNOWN_EXPOSURE: Exposure = Exposure {
    time_s: 1.0,
    gain: 1.0,
    white_balance: [1.0; 3],
};

/// A lockstep of all cameras; those that have not been seen yet are lost to it.
fn lockstep_for(cameras: &[CameraTrack], settings: &LockstepSettings) -> Result<Lockstep, DaemonError> {
    let lockstep_cameras = cameras
        .iter()
        .map(|track| LockstepCamera {
            tables: track.tables.clone(),
            ranges: track.ranges.unwrap_or_default(),
            values: track.values,
            interval_ns: track.interval_ns,
            latency_frames: track.latency_frames,
        })
        .collect();
    let mut lockstep = Lockstep::new(settings.clone(), lockstep_cameras)?;
    for (camera, track) in cameras.iter().enumerate() {
        match track.report.stage {
            CameraStage::Waiting { .. } => lockstep.on_lost(camera),
            CameraStage::Streaming => lockstep.on_returned(camera, track.values),
        }
    }
    Ok(lockstep)
}
