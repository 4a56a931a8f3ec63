//! What the cases of the daemon share: programs run as processes of their own, what the daemon says about its frames,
//! and a reader of what it publishes.

use std::env;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};
use std::thread;
use std::time::{Duration, Instant};

use mirrorball_capture::handover::{self, Received, Subscriber};
use mirrorball_capture::status::{self, Status};
use mirrorball_capture::{FrameMeta, FrameSet, PixelFormat};
use mirrorball_driver_tests::webcam::jpeg::commented_counter;
use mirrorball_driver_tests::webcam::{Webcam, counter};
use rustix::process::{Pid, Signal, kill_process};
use rustix::time::{ClockId, clock_gettime};

use super::daemon_rig::{CONFIG, Camera, SERVICE, STATUS_SOCKET, write_config};
use super::support::{ensure, say};

/// How long a set, a process or a file may take on a busy machine before something is wrong.
pub(super) const PATIENCE: Duration = Duration::from_secs(20);

/// One of our programs as a process of its own. Dropping it kills it.
pub(super) struct Program {
    child: Child,
    log: PathBuf,
}

impl Program {
    /// Starts `mirrorball-capture`, which lies beside this program; its output goes to `/tmp/NAME.log`.
    pub(super) fn start(name: &str, arguments: &[&str]) -> Result<Self, String> {
        Self::start_program(&capture_program()?, name, arguments)
    }

    /// Starts `mirrorball-calib` in the same way.
    pub(super) fn start_calib(name: &str, arguments: &[&str]) -> Result<Self, String> {
        Self::start_program(&program_beside("mirrorball-calib")?, name, arguments)
    }

    fn start_program(program: &Path, name: &str, arguments: &[&str]) -> Result<Self, String> {
        let log = Path::new("/tmp").join(name).with_extension("log");
        let output = File::create(&log).map_err(say)?;
        let child = Command::new(program)
            .args(arguments)
            .env("RUST_LOG", "debug")
            .stdout(output.try_clone().map_err(say)?)
            .stderr(output)
            .spawn()
            .map_err(|error| format!("cannot start {}: {error}", program.display()))?;
        Ok(Self { child, log })
    }

    /// What it has printed.
    pub(super) fn log(&self) -> String {
        fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Asks it to end, and waits.
    pub(super) fn terminate(&mut self) -> Result<ExitStatus, String> {
        let pid = Pid::from_child(&self.child);
        kill_process(pid, Signal::TERM).map_err(say)?;
        self.wait()
    }

    /// Does what Ctrl-C does, and waits.
    pub(super) fn interrupt(&mut self) -> Result<ExitStatus, String> {
        let pid = Pid::from_child(&self.child);
        kill_process(pid, Signal::INT).map_err(say)?;
        self.wait()
    }

    /// Waits until it has ended by itself.
    pub(super) fn wait(&mut self) -> Result<ExitStatus, String> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            match self.child.try_wait().map_err(say)? {
                Some(status) => return Ok(status),
                None if Instant::now() > deadline => return Err(format!("it does not end within {PATIENCE:?}")),
                None => thread::sleep(Duration::from_millis(10)),
            }
        }
    }

    /// Kills it without a word.
    pub(super) fn kill(&mut self) -> Result<(), String> {
        self.child.kill().map_err(say)?;
        self.child.wait().map_err(say)?;
        Ok(())
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.kill();
    }
}

/// Runs the program to its end; returns its standard output.
pub(super) fn output_of(arguments: &[&str]) -> Result<String, String> {
    let output = Command::new(capture_program()?).args(arguments).output().map_err(say)?;
    ensure(output.status.success(), || {
        let errors = String::from_utf8_lossy(&output.stderr);
        format!("{arguments:?} ended with {}: {errors}", output.status)
    })?;
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

fn capture_program() -> Result<PathBuf, String> {
    program_beside("mirrorball-capture")
}

/// One of our programs, which lie beside this one.
fn program_beside(name: &str) -> Result<PathBuf, String> {
    let program = env::current_exe().map_err(say)?.with_file_name(name);
    ensure(program.exists(), || {
        format!(
            "there is no {}; build it: cargo build --release -p {name}",
            program.display()
        )
    })?;
    Ok(program)
}

/// What the daemon says about one camera's frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Account {
    pub(super) frames: u64,
    pub(super) lost: u64,
    /// Frames lost by cause, as the log names it.
    pub(super) causes: Vec<(String, u64)>,
}

impl Account {
    /// Frames lost for this cause.
    pub(super) fn lost_to(&self, cause: &str) -> u64 {
        let found = self.causes.iter().find(|(name, _)| name == cause);
        found.map_or(0, |(_, frames)| *frames)
    }
}

/// The newest account of a camera in the daemon's log.
pub(super) fn account(log: &str, camera: &str) -> Account {
    let mut account = Account::default();
    for line in log.lines() {
        if let Some((text, name)) = line.rsplit_once(" camera=")
            && name == camera
            && let Some((_, causes)) = text.split_once(" frames lost so far: ")
        {
            account.causes = causes.split(", ").filter_map(label_and_number).collect();
        }
        for part in line.split("; ") {
            let mut figures = part.split(", ");
            let is_ours = figures.next().is_some_and(|first| {
                let mut words = first.rsplit(' ');
                words.next().is_some_and(|rate| rate.ends_with("/s")) && words.next() == Some(camera)
            });
            if let (true, Some(frames), Some(lost)) = (is_ours, figures.next(), figures.next()) {
                account.frames = leading_number(frames);
                account.lost = leading_number(lost);
            }
        }
    }
    account
}

fn label_and_number(text: &str) -> Option<(String, u64)> {
    let (label, number) = text.rsplit_once(' ')?;
    Some((label.to_owned(), number.parse().ok()?))
}

fn leading_number(text: &str) -> u64 {
    let number = text.split(' ').next();
    number.and_then(|number| number.parse().ok()).unwrap_or(0)
}

/// A frame that a reader has seen.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    pub(super) meta: FrameMeta,
    /// The 16 bits in the picture, or in the comment of a JPEG picture.
    pub(super) counter: Option<u16>,
    pub(super) arrived: Instant,
    /// From its time stamp until then.
    pub(super) age_ns: u64,
}

/// A reader in this process.
pub(super) struct Reader {
    pub(super) subscriber: Subscriber,
}

impl Reader {
    pub(super) fn open() -> Result<Self, String> {
        let subscriber = handover::subscribe_to(SERVICE).map_err(say)?;
        Ok(Self { subscriber })
    }

    /// The next set; `None` if there is none in time.
    pub(super) fn next(&mut self, patience: Duration) -> Result<Option<Vec<Seen>>, String> {
        let deadline = Instant::now() + patience;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.subscriber.receive(left) {
                Ok(Received::Set(set)) => return Ok(Some(see(&set))),
                Ok(Received::TimedOut | Received::Ended) => return Ok(None),
                Err(error) if error.is_skippable() => {}
                Err(error) => return Err(say(error)),
            }
        }
    }

    /// The next sets.
    pub(super) fn sets(&mut self, n_sets: usize) -> Result<Vec<Vec<Seen>>, String> {
        let mut sets = Vec::with_capacity(n_sets);
        while sets.len() < n_sets {
            let set = self.next(PATIENCE)?;
            sets.push(set.ok_or_else(|| format!("no set within {PATIENCE:?} after {}", sets.len()))?);
        }
        Ok(sets)
    }

    /// Reads until a set is as wanted, which it returns. `what` is waited for in words.
    pub(super) fn set_where(&mut self, what: &str, wanted: impl Fn(&[Seen]) -> bool) -> Result<Vec<Seen>, String> {
        let deadline = Instant::now() + PATIENCE;
        let mut n_sets = 0;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.next(left)? {
                Some(set) if wanted(&set) => return Ok(set),
                Some(_) => n_sets += 1,
                None => return Err(format!("{what}: not within {PATIENCE:?} and {n_sets} other sets")),
            }
        }
    }
}

/// The clock of time stamps.
fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.cast_unsigned() * 1_000_000_000 + now.tv_nsec.cast_unsigned()
}

fn see(set: &FrameSet) -> Vec<Seen> {
    let (arrived, now_ns) = (Instant::now(), monotonic_ns());
    let seen = |frame: &mirrorball_capture::Frame| Seen {
        counter: match frame.format {
            PixelFormat::Mjpeg => commented_counter(&frame.pixels).map(|counter| (counter & 0xFFFF) as u16),
            _ => counter::read_yuyv(&frame.pixels, frame.size.width as usize),
        },
        meta: frame.meta.clone(),
        arrived,
        age_ns: now_ns.saturating_sub(frame.meta.timestamp_ns),
    };
    set.frames.iter().map(seen).collect()
}

/// The frame of a camera in a set.
pub(super) fn frame_of<'a>(set: &'a [Seen], camera: &str) -> Option<&'a Seen> {
    set.iter().find(|seen| &*seen.meta.camera == camera)
}

/// Webcams plugged in, the daemon at work on them, and a reader.
pub(super) struct Stage {
    pub(super) webcams: Vec<Webcam>,
    pub(super) daemon: Program,
    pub(super) reader: Reader,
}

/// Plugs webcams in, starts the daemon, waits for the first set with all of them, and plays a case. What fails is told
/// with the end of the daemon's log.
pub(super) fn with_daemon(
    cameras: &[Camera],
    lockstep: &str,
    case: impl FnOnce(&mut Stage) -> Result<(), String>,
) -> Result<(), String> {
    let mut webcams = Vec::with_capacity(cameras.len());
    for (port, camera) in (0..).zip(cameras) {
        webcams.push(Webcam::plug(port, camera.webcam.clone()).map_err(say)?);
    }
    for webcam in &webcams {
        webcam.node(PATIENCE).map_err(say)?;
    }
    write_config(cameras, lockstep)?;
    let reader = Reader::open()?;
    let mut stage = Stage {
        webcams,
        daemon: start_daemon()?,
        reader,
    };
    let all = |set: &[Seen]| set.len() == cameras.len();
    let begun = stage.reader.set_where("a set of all cameras", all);
    begun.and_then(|_| case(&mut stage)).map_err(|reason| {
        let log = stage.daemon.log();
        let lines: Vec<&str> = log.lines().collect();
        let tail = lines[lines.len().saturating_sub(30)..].join("\n      ");
        format!("{reason}\n    the daemon's log ends:\n      {tail}")
    })
}

/// Starts the daemon with the configuration written last.
pub(super) fn start_daemon() -> Result<Program, String> {
    Program::start("daemon", &["run", "--config", CONFIG])
}

impl Stage {
    /// What the daemon tells whoever asks; at most a second old.
    pub(super) fn status(&self) -> Result<Status, String> {
        status::fetch(Path::new(STATUS_SOCKET)).map_err(say)
    }

    /// Ends the daemon as the service manager does and returns its account of each camera.
    pub(super) fn end(&mut self) -> Result<Vec<Account>, String> {
        let status = self.daemon.terminate()?;
        ensure(status.success(), || format!("after SIGTERM it ended with {status}"))?;
        let log = self.daemon.log();
        Ok(["scene", "ball"].map(|camera| account(&log, camera)).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accounts_are_read_from_the_log() {
        let log = "T  WARN 5 frames lost so far: driver drop 3, bad JPEG 2 camera=ball\n\
                   T DEBUG scene 29.9/s, 120 frames, 0 lost; ball 30.0/s, 118 frames, 5 lost; 1 readers\n\
                   T  INFO no camera: gone, really camera=ball\n";
        let ball = account(log, "ball");
        assert_eq!((ball.frames, ball.lost), (118, 5));
        assert_eq!((ball.lost_to("bad JPEG"), ball.lost_to("overrun")), (2, 0));
        assert_eq!(account(log, "scene").frames, 120);
        assert_eq!(account(log, "fisheye"), Account::default());
    }
}
