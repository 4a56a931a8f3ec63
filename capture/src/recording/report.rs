//! What a recording holds, for people and programs: cameras, rates, losses and their causes, and how it ends.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::mcap::scan::{Seen, scan};
use super::mcap::{Ending, EventKind, RecordingEvent, format_name, role_name};
use super::{Pace, Player, Repeat};
use crate::frame::FrameMeta;
use crate::grouping::DEFAULT_MAX_SKEW;
use crate::source::{CameraDescription, Source, SourceError};

/// Most that frames of one set differ in time.
const MAX_SKEW_NS: u64 = DEFAULT_MAX_SKEW.as_nanos() as u64;

/// Most gaps, and most notes, that a report lists; all are counted.
const LISTED_MAX: usize = 1000;

/// Cause of losses while frame sets did not reach the program that recorded.
const MISSED_SETS: &str = "missed_sets";

/// Cause of losses that no event explains.
const UNEXPLAINED: &str = "unexplained";

/// What a recording holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordingReport {
    /// `mcap` or `folder`.
    pub kind: &'static str,
    /// Length of the file in bytes; none for a folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bytes: Option<u64>,
    /// Program that has recorded it, if it says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<String>,
    /// True if it has a rig file.
    pub has_rig: bool,
    /// From the first frame of any camera to the last one, in seconds.
    pub duration_s: f64,
    /// How it ends.
    pub ending: Ending,
    /// Bytes that are no records any more.
    pub damaged_bytes: u64,
    /// Frame sets that never reached the program that recorded.
    pub missed_sets: u64,
    /// What each camera has.
    pub cameras: Vec<CameraReport>,
    /// Notes and controls among the events, the first thousand.
    pub events: Vec<RecordingEvent>,
}

/// What a recording holds of one camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraReport {
    /// Name.
    pub name: String,
    /// Role, as in the rig file.
    pub role: &'static str,
    /// Width and height in pixels.
    pub size_px: [u32; 2],
    /// Pixel format, with matrix and range where it has them.
    pub format: String,
    /// Frames.
    pub frames: u64,
    /// Frames of which nothing can be known.
    pub bad_frames: u64,
    /// Time stamp of the first frame in nanoseconds; 0 without frames.
    pub first_timestamp_ns: u64,
    /// Time stamp of the last frame in nanoseconds; 0 without frames.
    pub last_timestamp_ns: u64,
    /// Mean rate in frames per second; 0 for fewer than two frames.
    pub rate_hz: f64,
    /// Longest time between two frames in milliseconds.
    pub longest_interval_ms: f64,
    /// Frames that are missing between the first and the last.
    pub lost_frames: u64,
    /// The same by cause.
    pub lost_by_cause: BTreeMap<String, u64>,
    /// Number of gaps.
    pub n_gaps: u64,
    /// The first thousand gaps.
    pub gaps: Vec<Gap>,
}

/// Frames missing between two frames of a camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Gap {
    /// Sequence number of the frame before.
    pub after_sequence: u64,
    /// Time of the frame before, since the camera's first one, in seconds.
    pub at_s: f64,
    /// Frames missing.
    pub frames: u64,
    /// Of these, how many for which cause.
    pub causes: BTreeMap<String, u64>,
    #[serde(skip)]
    bounds_ns: (u64, u64),
}

/// Looks through a recording, a folder or an MCAP file, without its pictures.
///
/// # Errors
///
/// Any [`SourceError`] that is not skippable.
pub fn report_on(path: &Path) -> Result<RecordingReport, SourceError> {
    if path.is_file() {
        return report_on_file(path);
    }
    let player = Player::open(path, Pace::Max, Repeat::ONCE)?;
    let mut tallies: Vec<_> = player.cameras().iter().map(Tally::new).collect();
    for meta in player.metas() {
        let index = player.cameras().iter().position(|camera| camera.name == meta.camera);
        tallies[index.expect("frames are of cameras in the list")].add(meta);
    }
    Ok(RecordingReport {
        kind: "folder",
        bytes: None,
        program: None,
        has_rig: true,
        duration_s: duration_s(&tallies),
        ending: Ending::Complete,
        damaged_bytes: 0,
        missed_sets: 0,
        cameras: tallies.into_iter().map(|tally| tally.finish(&[])).collect(),
        events: Vec::new(),
    })
}

fn report_on_file(path: &Path) -> Result<RecordingReport, SourceError> {
    let mut tallies: Vec<Tally> = Vec::new();
    let (mut losses, mut events, mut missed_sets) = (Vec::new(), Vec::new(), 0u64);
    let (survey, n_bytes) = scan(path, |survey, seen| {
        if tallies.is_empty() {
            tallies = survey
                .cameras
                .iter()
                .map(|camera| Tally::new(&camera.description))
                .collect();
        }
        match seen {
            Seen::Frame(index, meta) => tallies[index].add(&meta),
            Seen::BadFrame(index) => tallies[index].report.bad_frames += 1,
            Seen::Event(event) => match event.kind {
                EventKind::Lost { .. } => losses.push(event),
                EventKind::MissedSets { sets } => {
                    missed_sets = missed_sets.saturating_add(sets);
                    losses.push(event);
                }
                EventKind::Control { .. } | EventKind::Note { .. } if events.len() < LISTED_MAX => events.push(event),
                EventKind::Control { .. } | EventKind::Note { .. } => {}
            },
        }
    })?;
    Ok(RecordingReport {
        kind: "mcap",
        bytes: Some(n_bytes),
        program: survey.metadata.get("program").cloned(),
        has_rig: survey.rig.is_some(),
        duration_s: duration_s(&tallies),
        ending: survey.ending,
        damaged_bytes: survey.damaged_bytes,
        missed_sets,
        cameras: tallies.into_iter().map(|tally| tally.finish(&losses)).collect(),
        events,
    })
}

impl Gap {
    /// True if an event about this camera, or about all, lies between the frames around the gap.
    fn is_explained_by(&self, event: &RecordingEvent, slack_ns: u64, camera: &str) -> bool {
        let (from_ns, to_ns) = self.bounds_ns;
        let is_within = from_ns < event.timestamp_ns && event.timestamp_ns <= to_ns.saturating_add(slack_ns);
        is_within && event.camera.as_deref().is_none_or(|name| name == camera)
    }
}

/// A camera's report under way.
struct Tally {
    report: CameraReport,
    last: Option<FrameMeta>,
}

impl Tally {
    fn new(camera: &CameraDescription) -> Self {
        Self {
            report: CameraReport {
                name: camera.name.to_string(),
                role: role_name(camera.role),
                size_px: [camera.size.width, camera.size.height],
                format: format_name(camera.format),
                frames: 0,
                bad_frames: 0,
                first_timestamp_ns: 0,
                last_timestamp_ns: 0,
                rate_hz: 0.0,
                longest_interval_ms: 0.0,
                lost_frames: 0,
                lost_by_cause: BTreeMap::new(),
                n_gaps: 0,
                gaps: Vec::new(),
            },
            last: None,
        }
    }

    fn add(&mut self, meta: &FrameMeta) {
        let report = &mut self.report;
        report.frames += 1;
        if let Some(last) = &self.last {
            let interval_ns = meta.timestamp_ns.saturating_sub(last.timestamp_ns);
            report.longest_interval_ms = report.longest_interval_ms.max(interval_ns as f64 / 1e6);
            let skipped = meta.sequence.saturating_sub(last.sequence).saturating_sub(1);
            let missing = skipped.max(meta.lost_before.into());
            if missing > 0 {
                report.lost_frames = report.lost_frames.saturating_add(missing);
                report.n_gaps += 1;
                if report.gaps.len() < LISTED_MAX {
                    report.gaps.push(Gap {
                        after_sequence: last.sequence,
                        at_s: last.timestamp_ns.saturating_sub(report.first_timestamp_ns) as f64 / 1e9,
                        frames: missing,
                        causes: BTreeMap::new(),
                        bounds_ns: (last.timestamp_ns, meta.timestamp_ns),
                    });
                }
            }
        } else {
            report.first_timestamp_ns = meta.timestamp_ns;
        }
        report.last_timestamp_ns = meta.timestamp_ns;
        self.last = Some(meta.clone());
    }

    /// Explains the gaps by the losses that were written down between the frames around them.
    fn finish(self, losses: &[RecordingEvent]) -> CameraReport {
        let mut report = self.report;
        let span_s = report.last_timestamp_ns.saturating_sub(report.first_timestamp_ns) as f64 / 1e9;
        if span_s > 0.0 {
            report.rate_hz = (report.frames - 1) as f64 / span_s;
        }
        let mut listed = 0u64;
        for gap in &mut report.gaps {
            let mut rest = gap.frames;
            listed = listed.saturating_add(gap.frames);
            for event in losses {
                let (cause, frames) = match &event.kind {
                    EventKind::Lost { frames, cause } if gap.is_explained_by(event, 0, &report.name) => {
                        (cause.as_str(), *frames)
                    }
                    // Their time is that of the leading camera.
                    EventKind::MissedSets { .. } if gap.is_explained_by(event, MAX_SKEW_NS, &report.name) => {
                        (MISSED_SETS, rest)
                    }
                    _ => continue,
                };
                let explained = rest.min(frames);
                if explained > 0 {
                    *gap.causes.entry(cause.to_owned()).or_default() += explained;
                }
                rest -= explained;
            }
            if rest > 0 {
                gap.causes.insert(UNEXPLAINED.to_owned(), rest);
            }
            for (cause, frames) in &gap.causes {
                let sum = report.lost_by_cause.entry(cause.clone()).or_default();
                *sum = sum.saturating_add(*frames);
            }
        }
        if report.lost_frames > listed {
            report
                .lost_by_cause
                .insert("not listed".to_owned(), report.lost_frames - listed);
        }
        report
    }
}

fn duration_s(tallies: &[Tally]) -> f64 {
    let with_frames = || {
        tallies
            .iter()
            .map(|tally| &tally.report)
            .filter(|report| report.frames > 0)
    };
    let first_ns = with_frames().map(|report| report.first_timestamp_ns).min().unwrap_or(0);
    let last_ns = with_frames().map(|report| report.last_timestamp_ns).max().unwrap_or(0);
    last_ns.saturating_sub(first_ns) as f64 / 1e9
}
