//! The scene file watched while the node runs: a changed scene is read and built beside the frames and put in between two.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use crate::error::RenderError;
use crate::node::{NodeParts, RenderNode};
use crate::scene::Scene;

/// How often the files are looked at.
const INTERVAL: Duration = Duration::from_secs(1);

/// What came of a change: a node with the new scene, or why there is none.
pub type Outcome = Result<Box<RenderNode>, RenderError>;

/// A thread that looks at the scene file, and at the files that it names, once a second.
#[derive(Debug)]
pub struct SceneWatch {
    outcome: Arc<Mutex<Option<Outcome>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// What tells a file from its next version: when it was written and how long it is; `None` when it is not there.
type Version = Option<(SystemTime, u64)>;

struct Watcher {
    file: PathBuf,
    parts: NodeParts,
    /// The files and what they were when they were last read.
    known: Vec<(PathBuf, Version)>,
}

impl SceneWatch {
    /// Watches the file that `scene` came from, for the node that shows it.
    ///
    /// # Errors
    /// [`RenderError::Watch`] when the system gives no thread.
    pub fn start(file: &Path, scene: &Scene, node: &RenderNode) -> Result<Self, RenderError> {
        let mut watcher = Watcher {
            file: file.to_owned(),
            parts: node.parts(),
            known: Vec::new(),
        };
        watcher.know(scene);
        let (outcome, stop) = (Arc::new(Mutex::new(None)), Arc::new(AtomicBool::new(false)));
        let (to, should_stop) = (outcome.clone(), stop.clone());
        let thread = std::thread::Builder::new()
            .name("scene watch".into())
            .spawn(move || watcher.run(&to, &should_stop))
            .map_err(|source| RenderError::Watch {
                file: file.to_owned(),
                source,
            })?;
        Ok(Self {
            outcome,
            stop,
            thread: Some(thread),
        })
    }

    /// What came of the last change, once.
    #[must_use]
    pub fn take(&self) -> Option<Outcome> {
        // The thread holds the lock for no longer than it takes to put a pointer in.
        self.outcome.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Drop for SceneWatch {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // A thread that has panicked has nothing more to say.
            let _ = thread.join();
        }
    }
}

impl Watcher {
    fn run(mut self, to: &Mutex<Option<Outcome>>, should_stop: &AtomicBool) {
        while !should_stop.load(Ordering::Relaxed) {
            std::thread::park_timeout(INTERVAL);
            if let Some(outcome) = self.look() {
                *to.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
            }
        }
    }

    /// Builds the scene anew if any of its files has changed since it was last read.
    fn look(&mut self) -> Option<Outcome> {
        if self.known.iter().all(|(file, known)| version(file) == *known) {
            return None;
        }
        // Before reading: a change that comes meanwhile is seen the next time.
        for (file, known) in &mut self.known {
            *known = version(file);
        }
        Some(self.build())
    }

    fn build(&mut self) -> Outcome {
        let scene = Scene::load(&self.file, &self.parts.rig)?;
        self.know(&scene);
        for warning in scene.warnings() {
            tracing::warn!("{warning}");
        }
        RenderNode::new(
            self.parts.gpu.clone(),
            self.parts.rig.clone(),
            &scene,
            self.parts.config,
        )
        .map(Box::new)
    }

    /// Watches the files of `scene`; those that were watched already keep the version that was read.
    fn know(&mut self, scene: &Scene) {
        let mut files = vec![self.file.clone()];
        files.extend(scene.files());
        let before = std::mem::take(&mut self.known);
        self.known = files
            .into_iter()
            .map(|file| {
                let read = before
                    .iter()
                    .find(|(known, _)| *known == file)
                    .map(|(_, version)| *version);
                let version = read.unwrap_or_else(|| version(&file));
                (file, version)
            })
            .collect();
    }
}

fn version(file: &Path) -> Version {
    let facts = std::fs::metadata(file).ok()?;
    Some((facts.modified().ok()?, facts.len()))
}
