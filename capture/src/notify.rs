//! Tells the service manager how the daemon is: ready, alive, stopping.
//!
//! The protocol of `sd_notify(3)`: one datagram of `KEY=value` lines to the socket named in `NOTIFY_SOCKET`, by its path
//! or, after `@`, in the abstract name space. Without a service manager nothing is sent.

use std::env;
use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// A line to the service manager, or to nobody.
#[derive(Debug)]
pub struct Notifier {
    manager: Option<(UnixDatagram, SocketAddr)>,
    /// Half of the time after which the manager takes a silent daemon for dead.
    beat_interval: Option<Duration>,
    last_beat: Option<Instant>,
}

/// What the service manager says in the environment of those it starts.
#[derive(Debug, Clone, Copy, Default)]
pub struct NotifyEnvironment<'a> {
    /// `NOTIFY_SOCKET`.
    pub socket: Option<&'a OsStr>,
    /// `WATCHDOG_USEC`.
    pub watchdog_us: Option<&'a str>,
    /// `WATCHDOG_PID`: who is watched, if not everybody.
    pub watchdog_pid: Option<&'a str>,
}

impl Notifier {
    /// A line to whoever started this process.
    ///
    /// # Errors
    ///
    /// `NOTIFY_SOCKET` is set but cannot be the name of a socket, or there is no socket to be had.
    pub fn from_process() -> io::Result<Self> {
        let socket = env::var_os("NOTIFY_SOCKET");
        let watchdog_us = env::var("WATCHDOG_USEC").ok();
        let watchdog_pid = env::var("WATCHDOG_PID").ok();
        Self::new(NotifyEnvironment {
            socket: socket.as_deref(),
            watchdog_us: watchdog_us.as_deref(),
            watchdog_pid: watchdog_pid.as_deref(),
        })
    }

    /// A line to the manager that this environment names.
    ///
    /// # Errors
    ///
    /// As [`Self::from_process`].
    pub fn new(environment: NotifyEnvironment<'_>) -> io::Result<Self> {
        let socket = environment.socket.filter(|socket| !socket.is_empty());
        let manager = socket.map(open).transpose()?;
        let is_ours = environment
            .watchdog_pid
            .is_none_or(|pid| pid.parse() == Ok(std::process::id()));
        let watchdog_us = environment.watchdog_us.and_then(|text| text.parse::<u64>().ok());
        let watchdog_us = watchdog_us.filter(|&us| us > 0 && is_ours && manager.is_some());
        Ok(Self {
            manager,
            beat_interval: watchdog_us.map(|us| Duration::from_micros(us / 2)),
            last_beat: None,
        })
    }

    /// Says that the daemon has started.
    pub fn ready(&self) {
        self.send("READY=1");
    }

    /// Says that the daemon is about to end.
    pub fn stopping(&self) {
        self.send("STOPPING=1");
    }

    /// Says in one line how the daemon is; `systemctl status` shows it.
    pub fn status(&self, line: &str) {
        let line: String = line.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        self.send(&format!("STATUS={line}"));
    }

    /// Says that the daemon is alive, if a watchdog wants to know and half its patience has passed since the last time.
    /// To be called by whatever must not stand still, as often as it turns.
    pub fn beat(&mut self) {
        let Some(interval) = self.beat_interval else { return };
        if self.last_beat.is_none_or(|last| last.elapsed() >= interval) {
            self.last_beat = Some(Instant::now());
            self.send("WATCHDOG=1");
        }
    }

    /// How often [`Self::beat`] must be called at least; None without a watchdog.
    #[must_use]
    pub fn beat_interval(&self) -> Option<Duration> {
        self.beat_interval
    }

    fn send(&self, message: &str) {
        let Some((socket, manager)) = &self.manager else { return };
        // A manager that does not listen is no reason to stop: frames matter more.
        if let Err(error) = socket.send_to_addr(message.as_bytes(), manager) {
            tracing::debug!("cannot tell the service manager `{message}`: {error}");
        }
    }
}

fn open(name: &OsStr) -> io::Result<(UnixDatagram, SocketAddr)> {
    let manager = match name.as_bytes().strip_prefix(b"@") {
        Some(abstract_name) => SocketAddr::from_abstract_name(abstract_name)?,
        None => SocketAddr::from_pathname(name)?,
    };
    let socket = UnixDatagram::unbound()?;
    // A manager that is behind must not hold up the daemon.
    socket.set_nonblocking(true)?;
    Ok((socket, manager))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn received(socket: &UnixDatagram) -> String {
        let mut buffer = [0; 256];
        let n_bytes = socket.recv(&mut buffer).unwrap();
        String::from_utf8(buffer[..n_bytes].to_vec()).unwrap()
    }

    fn exchange(manager: &UnixDatagram, name: &OsStr) {
        let environment = NotifyEnvironment {
            socket: Some(name),
            watchdog_us: Some("20000"),
            watchdog_pid: None,
        };
        let mut notifier = Notifier::new(environment).unwrap();
        notifier.ready();
        assert_eq!(received(manager), "READY=1");
        notifier.status("2 cameras\nREADY=0");
        assert_eq!(received(manager), "STATUS=2 cameras READY=0");
        assert_eq!(notifier.beat_interval(), Some(Duration::from_millis(10)));
        notifier.beat();
        notifier.beat();
        std::thread::sleep(Duration::from_millis(11));
        notifier.beat();
        notifier.stopping();
        let beats: Vec<String> = (0..3).map(|_| received(manager)).collect();
        // The second beat of the three came too soon to be sent, unless this machine was slow.
        assert_eq!(beats[..2], ["WATCHDOG=1", "WATCHDOG=1"]);
        assert!(["STOPPING=1", "WATCHDOG=1"].contains(&beats[2].as_str()));
    }

    #[test]
    fn a_socket_with_a_path_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let manager = UnixDatagram::bind(&path).unwrap();
        exchange(&manager, path.as_os_str());
    }

    #[test]
    fn an_abstract_socket_is_told() {
        let name = format!("mirrorball-notify-test-{}", std::process::id());
        let address = SocketAddr::from_abstract_name(&name).unwrap();
        let manager = UnixDatagram::bind_addr(&address).unwrap();
        exchange(&manager, OsStr::new(&format!("@{name}")));
    }

    #[test]
    fn without_a_manager_or_with_a_dead_one_nothing_happens() {
        for socket in [None, Some(OsStr::new("")), Some(OsStr::new("/nowhere/notify"))] {
            let environment = NotifyEnvironment {
                socket,
                ..NotifyEnvironment::default()
            };
            let mut notifier = Notifier::new(environment).unwrap();
            notifier.ready();
            notifier.beat();
            assert_eq!(notifier.beat_interval(), None);
        }
    }

    #[test]
    fn a_watchdog_for_others_or_without_sense_is_none() {
        let own_pid = std::process::id().to_string();
        let cases = [
            ("1", Some("1000000"), false),
            (&own_pid, Some("1000000"), true),
            (&own_pid, Some("x"), false),
        ];
        for (pid, watchdog_us, expected) in cases {
            let environment = NotifyEnvironment {
                socket: Some(OsStr::new("/nowhere/notify")),
                watchdog_us,
                watchdog_pid: Some(pid),
            };
            assert_eq!(Notifier::new(environment).unwrap().beat_interval().is_some(), expected);
        }
    }

    #[test]
    fn a_name_that_is_none_is_an_error() {
        const TOO_LONG: &str = concat!(
            "/0123456789012345678901234567890123456789012345678901234567890123456789",
            "/0123456789012345678901234567890123456789012345678901234567890123456789"
        );
        let environment = NotifyEnvironment {
            socket: Some(OsStr::new(TOO_LONG)),
            ..NotifyEnvironment::default()
        };
        assert!(Notifier::new(environment).is_err());
    }
}
