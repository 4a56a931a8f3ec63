//! Repetitions of a recording whose length is known only once it was played: what is added in each round.

use crate::frame::FrameMeta;
use crate::recording::pace::LONE_FRAME_INTERVAL_NS;
use crate::source::{CameraDescription, CameraRole};

/// How far one camera has come.
#[derive(Debug, Clone, Copy, Default)]
struct Track {
    leads: bool,
    n_frames: u64,
    first: (u64, u64),
    /// Time stamp and sequence number of the last frame of this round.
    last: Option<(u64, u64)>,
}

/// The rounds of a recording. The first one is measured while it is played; the others follow it at once.
#[derive(Debug)]
pub(super) struct Rounds {
    tracks: Vec<Track>,
    round: u64,
    /// What a round adds to every time stamp, once the first is over.
    round_ns: u64,
    /// What a round adds to the sequence numbers of each camera.
    round_sequences: Vec<u64>,
}

impl Rounds {
    /// Before the first frame.
    pub(super) fn new(cameras: &[CameraDescription]) -> Self {
        let track = |camera: &CameraDescription| Track {
            leads: camera.role == CameraRole::Scene,
            ..Track::default()
        };
        Self {
            tracks: cameras.iter().map(track).collect(),
            round: 0,
            round_ns: 0,
            round_sequences: vec![0; cameras.len()],
        }
    }

    /// Number of this round, from 0.
    pub(super) fn round(&self) -> u64 {
        self.round
    }

    /// True if this round has had a frame.
    pub(super) fn has_frames(&self) -> bool {
        self.tracks.iter().any(|track| track.last.is_some())
    }

    /// Takes note of a frame as it was recorded, which must come after the camera's frame before.
    ///
    /// # Errors
    ///
    /// What is wrong, in words.
    pub(super) fn check(&mut self, camera_index: usize, meta: &FrameMeta) -> Result<(), String> {
        let track = &mut self.tracks[camera_index];
        let place = (meta.timestamp_ns, meta.sequence);
        if let Some((timestamp_ns, sequence)) = track.last
            && (place.0 <= timestamp_ns || place.1 <= sequence)
        {
            return Err(format!(
                "its time and sequence number {place:?} do not rise above ({timestamp_ns}, {sequence}) of the frame before"
            ));
        }
        if track.last.is_none() {
            track.first = place;
            track.n_frames = 0;
        }
        track.n_frames += 1;
        track.last = Some(place);
        Ok(())
    }

    /// Moves a frame into this round; false if the numbers have run out.
    pub(super) fn shift(&self, camera_index: usize, meta: &mut FrameMeta) -> bool {
        let shifted = |value: u64, step: u64| value.checked_add(self.round.checked_mul(step)?);
        let timestamp_ns = shifted(meta.timestamp_ns, self.round_ns);
        let sequence = shifted(meta.sequence, self.round_sequences[camera_index]);
        match (timestamp_ns, sequence) {
            (Some(timestamp_ns), Some(sequence)) => {
                meta.timestamp_ns = timestamp_ns;
                meta.sequence = sequence;
                true
            }
            _ => false,
        }
    }

    /// Ends this round.
    pub(super) fn begin_next(&mut self) {
        if self.round == 0 {
            self.measure();
        }
        self.round += 1;
        for track in &mut self.tracks {
            track.last = None;
        }
    }

    /// The whole recording, and one mean interval of the leading camera.
    fn measure(&mut self) {
        let played = || self.tracks.iter().filter_map(|track| Some((track, track.last?)));
        let first_ns = played().map(|(track, _)| track.first.0).min().unwrap_or(0);
        let last_ns = played().map(|(_, last)| last.0).max().unwrap_or(0);
        let leader = played().find(|(track, _)| track.leads);
        let interval_ns = leader.and_then(|(track, last)| (last.0 - track.first.0).checked_div(track.n_frames - 1));
        self.round_ns = last_ns - first_ns + interval_ns.unwrap_or(LONE_FRAME_INTERVAL_NS);
        let round_sequence = |track: &Track| track.last.map_or(0, |last| last.1 - track.first.1 + 1);
        self.round_sequences = self.tracks.iter().map(round_sequence).collect();
    }
}
