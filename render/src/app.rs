//! The render node at work: frame sets in, finished frames out.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use mirrorball_capture::playback::PlaybackThread;
use mirrorball_capture::{
    BadFramePolicy, DEFAULT_MAX_SKEW, FrameSet, Grouper, Pace, Player, Received, Repeat, Source, Subscriber, handover,
    play_in_thread, to_rgb8,
};

use crate::error::RenderError;
use crate::insets::Buffer;
use crate::node::{RenderNode, RenderedFrame};
use crate::output::Sink;
use crate::reload::SceneWatch;
use crate::shadow::ShadowMethod;

/// Frame sets decoded ahead of the renderer.
const READ_AHEAD: usize = 2;

/// Where frames come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Input {
    /// A recording, every frame in order, none dropped.
    Recording {
        /// Its folder.
        folder: PathBuf,
        /// What happens to frames that cannot be read.
        bad_frames: BadFramePolicy,
    },
    /// A capture daemon, the newest frame first.
    Live {
        /// Name of its service.
        service: String,
    },
}

/// Frames on their way in.
pub struct Frames {
    subscriber: Subscriber,
    thread: Option<PlaybackThread>,
    from: String,
    skips_bad_frames: bool,
    /// Number of frame sets to expect, when known.
    pub n_frames: Option<u64>,
}

impl Frames {
    /// Opens a recording or subscribes to a daemon.
    ///
    /// # Errors
    /// [`RenderError::Recording`] when there is none, [`RenderError::NoSceneFrame`] when the rig's scene camera took no part
    /// in it, [`RenderError::Handover`] when the hand-over cannot be set up.
    pub fn open(input: &Input, scene_camera: &str) -> Result<Self, RenderError> {
        match input {
            Input::Recording { folder, bad_frames } => {
                let from = folder.display().to_string();
                let player =
                    Player::open(folder, Pace::Max, Repeat::ONCE).map_err(|source| RenderError::Recording {
                        folder: folder.clone(),
                        source: Box::new(source),
                    })?;
                if !player.cameras().iter().any(|camera| &*camera.name == scene_camera) {
                    return Err(RenderError::NoSceneFrame {
                        camera: scene_camera.to_owned(),
                    });
                }
                // Cameras of a rig run at one rate, so this is right or nearly so; it only feeds the progress bar.
                let n_frames = player.n_frames() / player.cameras().len().max(1);
                let others: Vec<_> = player
                    .cameras()
                    .iter()
                    .map(|c| c.name.clone())
                    .filter(|name| &**name != scene_camera)
                    .collect();
                let grouper = Grouper::new(scene_camera.into(), &others, DEFAULT_MAX_SKEW);
                let (publisher, subscriber) = handover::lossless(READ_AHEAD);
                let thread = play_in_thread(Box::new(player), grouper, publisher, *bad_frames).map_err(|source| {
                    RenderError::Handover {
                        from: from.clone(),
                        source: Box::new(source),
                    }
                })?;
                Ok(Self {
                    subscriber,
                    thread: Some(thread),
                    from,
                    skips_bad_frames: *bad_frames == BadFramePolicy::Skip,
                    n_frames: Some(n_frames as u64),
                })
            }
            Input::Live { service } => {
                let subscriber = handover::subscribe_to(service).map_err(|source| RenderError::Handover {
                    from: service.clone(),
                    source: Box::new(source),
                })?;
                Ok(Self {
                    subscriber,
                    thread: None,
                    from: service.clone(),
                    skips_bad_frames: true,
                    n_frames: None,
                })
            }
        }
    }

    fn is_live(&self) -> bool {
        self.thread.is_none()
    }
}

/// What a step did.
#[derive(Debug)]
pub enum Step {
    /// A frame was rendered and stored.
    Rendered(Box<RenderedFrame>),
    /// A frame came that could not be used.
    Skipped,
    /// No frame came for a while.
    Waiting,
    /// The recording is over.
    Ended,
}

/// Counts of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Frames rendered.
    pub rendered: u64,
    /// Of these, frames without a pose.
    pub without_pose: u64,
    /// Of these, frames for which no light was known yet: they are the camera's own.
    pub without_light: u64,
    /// Frames that could not be read or did not fit the rig, skipped.
    pub skipped: u64,
    /// Frame sets that a newer one replaced before they were rendered.
    pub missed: u64,
    /// Times that a changed scene was taken over.
    pub reloads: u64,
    /// Times that a changed scene was not usable, so that the one before stayed.
    pub failed_reloads: u64,
}

/// The render node with its input and outputs.
pub struct App {
    node: RenderNode,
    frames: Frames,
    sinks: Vec<Box<dyn Sink>>,
    counts: Counts,
    last_complaint: Option<Instant>,
    watch: Option<SceneWatch>,
}

impl App {
    /// Puts the parts together.
    #[must_use]
    pub fn new(node: RenderNode, frames: Frames, sinks: Vec<Box<dyn Sink>>) -> Self {
        Self {
            node,
            frames,
            sinks,
            counts: Counts::default(),
            last_complaint: None,
            watch: None,
        }
    }

    /// Takes the scene over whenever `watch` has a new one.
    #[must_use]
    pub fn watching(self, watch: SceneWatch) -> Self {
        Self {
            watch: Some(watch),
            ..self
        }
    }

    /// The render node.
    #[must_use]
    pub fn node(&self) -> &RenderNode {
        &self.node
    }

    /// Changes the shadow method; on failure the one in use stays.
    ///
    /// # Errors
    /// As [`RenderNode::set_shadow_method`].
    pub fn set_shadow_method(&mut self, method: ShadowMethod) -> Result<(), RenderError> {
        self.node.set_shadow_method(method)
    }

    /// Shows the next buffer between the passes alone: from none to the first, and after the last none again.
    pub fn show_next_buffer(&mut self) {
        let next = match self.node.shown().first() {
            Some(buffer) => buffer.next(),
            None => Buffer::all().next(),
        };
        self.node.show(next.as_slice());
    }

    /// Number of frames to expect, when known.
    #[must_use]
    pub fn n_frames(&self) -> Option<u64> {
        self.frames.n_frames
    }

    /// Counts so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        Counts {
            missed: self.frames.subscriber.stats().missed,
            ..self.counts
        }
    }

    /// Takes the next frame set, waiting for it no longer than `patience`, renders it and hands the result to the sinks.
    ///
    /// # Errors
    /// Whatever stops the run. Live, a bad frame is counted and skipped instead.
    pub fn step(&mut self, patience: Duration) -> Result<Step, RenderError> {
        match self.frames.subscriber.receive(patience) {
            Ok(Received::Set(set)) => self.use_set(&set),
            Ok(Received::TimedOut) => {
                // A scene that cannot be used is said to be so even while no frames come.
                self.renew_scene();
                Ok(Step::Waiting)
            }
            Ok(Received::Ended) => {
                self.join_reader()?;
                Ok(Step::Ended)
            }
            Err(error) if self.frames.is_live() && error.is_skippable() => {
                self.skip(&error);
                Ok(Step::Skipped)
            }
            Err(source) => Err(RenderError::Handover {
                from: self.frames.from.clone(),
                source: Box::new(source),
            }),
        }
    }

    fn use_set(&mut self, set: &FrameSet) -> Result<Step, RenderError> {
        let set = self.decode(set)?;
        if set.frames.is_empty() {
            return Ok(Step::Skipped);
        }
        self.renew_scene();
        match self.node.render(&set) {
            Ok(frame) => self.finish(frame).map(|frame| Step::Rendered(Box::new(frame))),
            Err(error @ (RenderError::FrameSize { .. } | RenderError::NoSceneFrame { .. }))
                if self.frames.is_live() =>
            {
                self.skip(&error);
                Ok(Step::Skipped)
            }
            Err(error) => Err(error),
        }
    }

    /// Goes on with a scene that has changed; where it cannot be used the one before stays.
    fn renew_scene(&mut self) {
        let Some(outcome) = self.watch.as_ref().and_then(SceneWatch::take) else {
            return;
        };
        let renewed = outcome.and_then(|mut node| {
            node.take_over(&mut self.node)?;
            self.node = *node;
            Ok(())
        });
        match renewed {
            Ok(()) => {
                self.counts.reloads += 1;
                tracing::info!("the scene has changed; showing the new one");
            }
            Err(error) => {
                self.counts.failed_reloads += 1;
                tracing::warn!(
                    "the scene has changed and cannot be used; the one before stays: {}",
                    chain(&error)
                );
            }
        }
    }

    /// The set in 8-bit RGB. A frame that cannot be decoded is left out where frames may be skipped; if it is the leading
    /// one nothing is left.
    fn decode(&mut self, set: &FrameSet) -> Result<FrameSet, RenderError> {
        let mut frames = Vec::with_capacity(set.frames.len());
        for (index, frame) in set.frames.iter().enumerate() {
            let error = match to_rgb8(frame) {
                Ok(decoded) => {
                    frames.push(decoded);
                    continue;
                }
                Err(source) => RenderError::Decode {
                    camera: frame.meta.camera.to_string(),
                    sequence: frame.meta.sequence,
                    source,
                },
            };
            if !self.frames.skips_bad_frames {
                return Err(error);
            }
            self.skip(&error);
            if index == 0 {
                break;
            }
        }
        Ok(FrameSet { frames })
    }

    fn finish(&mut self, frame: RenderedFrame) -> Result<RenderedFrame, RenderError> {
        self.counts.rendered += 1;
        self.counts.without_pose += u64::from(frame.pose.camera_from_world().is_none());
        self.counts.without_light += u64::from(frame.light.is_none());
        for sink in &mut self.sinks {
            sink.take(&frame, &self.node)?;
        }
        Ok(frame)
    }

    /// Counts a frame that could not be used; says so once a second at most.
    fn skip(&mut self, error: &dyn std::error::Error) {
        self.counts.skipped += 1;
        if self
            .last_complaint
            .is_none_or(|last| last.elapsed() > Duration::from_secs(1))
        {
            self.last_complaint = Some(Instant::now());
            tracing::warn!(skipped = self.counts.skipped, "frame skipped: {error}");
        }
    }

    fn join_reader(&mut self) -> Result<(), RenderError> {
        if let Some(thread) = self.frames.thread.take() {
            let stats = thread.join().map_err(|source| RenderError::Handover {
                from: self.frames.from.clone(),
                source: Box::new(source),
            })?;
            self.counts.skipped += stats.skipped_frames;
        }
        Ok(())
    }
}

/// An error with what caused it, in one line.
fn chain(error: &RenderError) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}
