//! Opens an iceoryx2 service, whatever processes that were killed have left behind.
//!
//! iceoryx2 clears away what dead processes held, but not a service whose maker was killed in the few milliseconds
//! while it made it, or whose machine has lost its power: that service blocks its name for ever. So all programs of
//! this crate open services one at a time, under a file lock that the system releases when its holder dies. Who holds
//! the lock and still finds a service half made knows that its maker is dead, and removes it. Shared memory whose maker
//! was killed before it had a size is worse, since iceoryx2 waits for it without end: [`unborn`] removes it.

use std::fs::{File, OpenOptions};
use std::io::ErrorKind;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use iceoryx2::prelude::*;
use iceoryx2::service::builder::event::{EventOpenError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError};
use iceoryx2::service::ipc_threadsafe::Service as Ipc;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use iceoryx2::service::service_hash::ServiceHash;

use super::pixels::{BORROWED_BLOCKS, BlockHeader, QUEUED_BLOCKS};
use super::unborn;
use super::{HandoverError, READERS_MAX};

/// Publishers iceoryx2 keeps places for. Only one lives at a time; in the other places may be remains of killed ones
/// that could not be cleared away because those who cleared were killed too.
const PUBLISHERS_MAX: usize = 4;

/// Sets that wait for each reader: only the newest.
const QUEUED_SETS: usize = 1;

/// Sets a reader holds at a time: the newest so far, and the next while it looks whether there is a newer one.
const BORROWED_SETS: usize = 2;

/// What the name of the service of the pixels adds.
const BLOCKS_SUFFIX: &str = "/pixels";

/// How long to try again when what is in the way may belong to a process that has just died or is just leaving.
pub(super) const PATIENCE: Duration = Duration::from_secs(3);

/// How long to wait for the lock: longer than all that its holder may be patient with.
const LOCK_PATIENCE: Duration = Duration::from_secs(10);

/// Pause between such tries.
const PAUSE: Duration = Duration::from_millis(20);

/// How long a service may be in creation. It takes a few milliseconds; nobody else makes one at the same time.
const CREATION_TIMEOUT: Duration = Duration::from_millis(250);

/// The lock file, beside the files of iceoryx2.
const LOCK_FILE: &str = "mirrorball.lock";

/// A service that is open, and the node it is open in.
pub(super) struct OpenService {
    pub(super) name: ServiceName,
    pub(super) node: Node<Ipc>,
    pub(super) sets: publish_subscribe::PortFactory<Ipc, [u8], ()>,
    pub(super) blocks: publish_subscribe::PortFactory<Ipc, [u8], BlockHeader>,
    pub(super) wakeups: event::PortFactory<Ipc>,
}

/// Opens the service, or creates it. Making the node removes what dead processes have left behind.
pub(super) fn open_service(service_name: &str) -> Result<OpenService, HandoverError> {
    // Failures come back as errors and are told once, by whoever handles them.
    set_log_level(LogLevel::Fatal);
    let name = ServiceName::new(service_name).map_err(|_| name_not_allowed(service_name))?;
    // Not the machine's configuration file: both sides must agree, whoever starts them.
    let mut config = Config::default();
    config.global.creation_timeout = CREATION_TIMEOUT;
    let lock = lock_opening(&config).map_err(|error| cannot_open(service_name, "the lock file", error))?;
    unborn::while_removing(&config, || open_locked(&config, name, &lock))
}

/// The steps of [`open_service`] that need its lock.
fn open_locked(config: &Config, name: ServiceName, lock: &OpeningLock) -> Result<OpenService, HandoverError> {
    let service_name = name.as_str();
    let node = NodeBuilder::new()
        .config(config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<Ipc>()
        .map_err(|error| cannot_open(service_name, "the node", error))?;
    let sets = open_sets(&node, &name, lock).map_err(|error| cannot_open(service_name, "the frame sets", error))?;
    let blocks_name = blocks_name(&name).map_err(|_| name_not_allowed(service_name))?;
    let blocks =
        open_blocks(&node, &blocks_name, lock).map_err(|error| cannot_open(service_name, "the pixels", error))?;
    let wakeups = open_wakeups(&node, &name, lock).map_err(|error| cannot_open(service_name, "the wake-ups", error))?;
    Ok(OpenService {
        name,
        node,
        sets,
        blocks,
        wakeups,
    })
}

fn name_not_allowed(service_name: &str) -> HandoverError {
    HandoverError::ServiceName {
        service: service_name.to_owned(),
        max_bytes: ServiceName::max_len() - BLOCKS_SUFFIX.len(),
    }
}

/// The service of the pixels has a name of its own, since two publish-subscribe patterns cannot share one.
fn blocks_name(name: &ServiceName) -> Result<ServiceName, impl std::error::Error + use<>> {
    ServiceName::new(&format!("{name}{BLOCKS_SUFFIX}"))
}

/// The right to publish on a service; given back when it is dropped, or when its holder dies.
///
/// A service has one publisher: a second one would mix its clock and counts into the first one's. The right is a socket
/// of the service's name that nobody sends to: the system binds a name only once, and leaves nothing behind.
pub(super) struct PublishingRight {
    _socket: UnixDatagram,
}

impl PublishingRight {
    /// Takes the right, waiting a while for a publisher that is just dying.
    pub(super) fn take(name: &ServiceName) -> Result<Self, HandoverError> {
        let cannot = |error| cannot_open(name.as_str(), "the right to publish", error);
        let hash = service_hash(name, MessagingPattern::PublishSubscribe);
        let address_name = format!("mirrorball-publisher-{}", hash.as_str());
        let address = SocketAddr::from_abstract_name(address_name).map_err(cannot)?;
        match with_patience(PATIENCE, || UnixDatagram::bind_addr(&address), |_| {}) {
            Ok(socket) => Ok(Self { _socket: socket }),
            Err(error) if error.kind() == ErrorKind::AddrInUse => Err(HandoverError::PublisherExists {
                service: name.to_string(),
            }),
            Err(error) => Err(cannot(error)),
        }
    }
}

/// Tries to open something again and again for as long as `patience` lasts; `clear_away` is told each error and may
/// remove its cause.
pub(super) fn with_patience<T, E>(
    patience: Duration,
    mut open: impl FnMut() -> Result<T, E>,
    mut clear_away: impl FnMut(&E),
) -> Result<T, E> {
    let deadline = Instant::now() + patience;
    loop {
        match open() {
            Ok(opened) => return Ok(opened),
            Err(error) if Instant::now() >= deadline => return Err(error),
            Err(error) => {
                clear_away(&error);
                std::thread::sleep(PAUSE);
            }
        }
    }
}

/// Makes the error for something that cannot be opened.
pub(super) fn cannot_open(
    service_name: &str,
    what: &'static str,
    error: impl std::error::Error + Send + Sync + 'static,
) -> HandoverError {
    HandoverError::OpenService {
        service: service_name.to_owned(),
        what,
        source: Box::new(error),
    }
}

/// The right to open services; given back when it is dropped, or when its holder dies.
struct OpeningLock {
    _file: File,
}

fn lock_opening(config: &Config) -> std::io::Result<OpeningLock> {
    let folder = PathBuf::from(config.global.root_path().to_string());
    std::fs::create_dir_all(&folder)?;
    let file = OpenOptions::new()
        .create(true)
        .append(true)
        .open(folder.join(LOCK_FILE))?;
    with_patience(LOCK_PATIENCE, || file.try_lock(), |_| {})?;
    Ok(OpeningLock { _file: file })
}

fn open_sets(
    node: &Node<Ipc>,
    name: &ServiceName,
    lock: &OpeningLock,
) -> Result<publish_subscribe::PortFactory<Ipc, [u8], ()>, PublishSubscribeOpenOrCreateError> {
    use PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError as OpenError;
    let open = || {
        let builder = node.service_builder(name).publish_subscribe::<[u8]>();
        let builder = builder
            .enable_safe_overflow(true)
            .history_size(0)
            .max_publishers(PUBLISHERS_MAX);
        let builder = builder
            .max_subscribers(READERS_MAX)
            .subscriber_max_buffer_size(QUEUED_SETS);
        builder.subscriber_max_borrowed_samples(BORROWED_SETS).open_or_create()
    };
    with_patience(PATIENCE, open, |error| {
        use PublishSubscribeOpenError::{HangsInCreation, ServiceInCorruptedState};
        if matches!(error, OpenError(HangsInCreation | ServiceInCorruptedState)) {
            remove_half_made(node.config(), name, MessagingPattern::PublishSubscribe, lock);
        }
    })
}

fn open_blocks(
    node: &Node<Ipc>,
    name: &ServiceName,
    lock: &OpeningLock,
) -> Result<publish_subscribe::PortFactory<Ipc, [u8], BlockHeader>, PublishSubscribeOpenOrCreateError> {
    use PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError as OpenError;
    let open = || {
        let builder = node.service_builder(name).publish_subscribe::<[u8]>();
        let builder = builder
            .user_header::<BlockHeader>()
            .enable_safe_overflow(true)
            .history_size(0)
            .max_publishers(PUBLISHERS_MAX);
        // The publishing process reads its own blocks too.
        let builder = builder
            .max_subscribers(READERS_MAX + 1)
            .subscriber_max_buffer_size(QUEUED_BLOCKS);
        builder
            .subscriber_max_borrowed_samples(BORROWED_BLOCKS)
            .open_or_create()
    };
    with_patience(PATIENCE, open, |error| {
        use PublishSubscribeOpenError::{HangsInCreation, ServiceInCorruptedState};
        if matches!(error, OpenError(HangsInCreation | ServiceInCorruptedState)) {
            remove_half_made(node.config(), name, MessagingPattern::PublishSubscribe, lock);
        }
    })
}

fn open_wakeups(
    node: &Node<Ipc>,
    name: &ServiceName,
    lock: &OpeningLock,
) -> Result<event::PortFactory<Ipc>, EventOpenOrCreateError> {
    let open = || {
        let builder = node.service_builder(name).event();
        builder
            .max_notifiers(PUBLISHERS_MAX)
            .max_listeners(READERS_MAX)
            .open_or_create()
    };
    with_patience(PATIENCE, open, |error| {
        use EventOpenError::{HangsInCreation, ServiceInCorruptedState};
        if matches!(
            error,
            EventOpenOrCreateError::EventOpenError(HangsInCreation | ServiceInCorruptedState)
        ) {
            remove_half_made(node.config(), name, MessagingPattern::Event, lock);
        }
    })
}

/// Removes a service whose maker was killed before it was complete.
///
/// Nobody has opened it, since it is incomplete, and its maker is dead, since makers hold the lock: `_lock` is the
/// proof. iceoryx2's own `force_remove_service` leaves such a service alone, so its file goes by its name, which a test
/// checks.
fn remove_half_made(config: &Config, name: &ServiceName, pattern: MessagingPattern, _lock: &OpeningLock) {
    // A failure shows when the service is opened the next time.
    let _ = std::fs::remove_file(service_file(config, name, pattern));
}

/// The file with which iceoryx2 announces a service.
fn service_file(config: &Config, name: &ServiceName, pattern: MessagingPattern) -> PathBuf {
    let hash = service_hash(name, pattern);
    let suffix = &config.global.service.static_config_storage_suffix;
    let file = format!("{}{}{suffix}", config.global.prefix, hash.as_str());
    PathBuf::from(config.global.service_dir().to_string()).join(file)
}

fn service_hash(name: &ServiceName, pattern: MessagingPattern) -> ServiceHash {
    ServiceHash::new::<<Ipc as Service>::ServiceNameHasher>(name, pattern)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::OpenOptionsExt;

    use super::*;

    #[test]
    fn a_half_made_service_is_in_nobodys_way() {
        let service_name = format!("mirrorball/half-made-{}", std::process::id());
        let name = ServiceName::new(&service_name).unwrap();
        let blocks = blocks_name(&name).unwrap();
        for (name, pattern) in [
            (&name, MessagingPattern::PublishSubscribe),
            (&blocks, MessagingPattern::PublishSubscribe),
            (&name, MessagingPattern::Event),
        ] {
            let file = service_file(&Config::default(), name, pattern);
            let service = open_service(&service_name).unwrap();
            assert!(file.exists(), "iceoryx2 names its files as this module believes");
            drop(service);
            // What is left of a maker that was killed, and of one whose machine has lost its power.
            for mode in [0o600, 0o400] {
                OpenOptions::new()
                    .write(true)
                    .create_new(true)
                    .mode(mode)
                    .open(&file)
                    .unwrap();
                open_service(&service_name).map(|_| ()).unwrap();
            }
        }
    }
}
