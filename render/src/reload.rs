//! The scene file watched while the node runs: a changed scene is read and built beside the frames and put in between two.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
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

/// A scene's files as they are at one time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Versions(Vec<(PathBuf, Version)>);

/// What tells a file from its next version: when it was written and how long it is; `None` when it is not there.
type Version = Option<(SystemTime, u64)>;

struct Watcher {
    file: PathBuf,
    parts: NodeParts,
    /// The files just before they were last read.
    read: Versions,
    /// The files at the look before, where they were not as last read.
    changing: Option<Versions>,
}

impl Versions {
    /// The files of the scene in `file`: to be taken before the scene is read, so that no change falls between.
    #[must_use]
    pub fn of(file: &Path) -> Self {
        let own = (file.to_owned(), version(file));
        let named = Scene::files(file).into_iter().map(|file| {
            let version = version(&file);
            (file, version)
        });
        Self(std::iter::once(own).chain(named).collect())
    }

    /// The same files as they are now.
    fn now(&self) -> Self {
        Self(self.0.iter().map(|(file, _)| (file.clone(), version(file))).collect())
    }
}

impl SceneWatch {
    /// Watches `file`, whose scene `node` shows; `read` are its files before they were read for that.
    ///
    /// # Errors
    /// [`RenderError::Watch`] when the system gives no thread.
    pub fn start(file: &Path, read: Versions, node: &RenderNode) -> Result<Self, RenderError> {
        let watcher = Watcher {
            file: file.to_owned(),
            parts: node.parts(),
            read,
            changing: None,
        };
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

    /// Builds the scene anew if any of its files is not as it was last read.
    fn look(&mut self) -> Option<Outcome> {
        let now = self.read.now();
        if now == self.read {
            self.changing = None;
            return None;
        }
        if self.changing.as_ref() != Some(&now) {
            // Perhaps still being written: it is read once it has been the same for a while.
            self.changing = Some(now);
            return None;
        }
        self.changing = None;
        self.read = Versions::of(&self.file);
        let built = catch_unwind(AssertUnwindSafe(|| self.build()));
        // Nothing of the watcher is changed by building, so it can go on after a panic.
        Some(built.unwrap_or_else(|panic| {
            Err(RenderError::Fault {
                file: self.file.clone(),
                message: words(&*panic),
            })
        }))
    }

    fn build(&self) -> Outcome {
        let scene = Scene::load(&self.file, &self.parts.rig)?;
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
}

/// What a panic said.
fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("it did not say why")
        .to_owned()
}

fn version(file: &Path) -> Version {
    let facts = std::fs::metadata(file).ok()?;
    Some((facts.modified().ok()?, facts.len()))
}
