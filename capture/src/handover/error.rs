//! What can go wrong between publisher and subscriber.

use super::packet::PacketError;
use crate::source::SourceError;

/// Why frame sets cannot be handed over.
#[derive(Debug, thiserror::Error)]
pub enum HandoverError {
    /// The source has failed; only inside one process.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The thread that publishes has panicked; only inside one process.
    #[error("the thread that reads frames has panicked")]
    PublisherPanicked,
    /// The thread that reads frames cannot be started.
    #[error("cannot start the thread that reads frames")]
    StartThread(#[source] std::io::Error),
    /// The name of the service is not allowed.
    #[error("service name `{service}` is not allowed, allowed are 1 to {max_bytes} bytes not beginning with `iox2://`")]
    ServiceName {
        /// Name of the service.
        service: String,
        /// Longest name allowed.
        max_bytes: usize,
    },
    /// Shared memory, or one of its ports, cannot be opened.
    #[error("cannot open {what} of service `{service}`")]
    OpenService {
        /// Name of the service.
        service: String,
        /// What was being opened.
        what: &'static str,
        /// What iceoryx2 said.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Another living process publishes on the service.
    #[error("service `{service}` already has a publisher")]
    PublisherExists {
        /// Name of the service.
        service: String,
    },
    /// The service has as many readers as it may have.
    #[error("service `{service}` already has {n_readers} readers, the most it may have")]
    TooManyReaders {
        /// Name of the service.
        service: String,
        /// Number of readers.
        n_readers: usize,
    },
    /// A frame is larger than the blocks reserved for the frames of the cameras.
    #[error("the frame has {frame_bytes} bytes, service `{service}` was opened for frames up to {limit_bytes}")]
    FrameTooLarge {
        /// Name of the service.
        service: String,
        /// Length of the frame's pixels.
        frame_bytes: usize,
        /// Longest there is room for.
        limit_bytes: usize,
    },
    /// A set cannot be published because it breaks a promise of [`FrameSet`](crate::FrameSet).
    #[error("cannot publish a frame set on service `{service}`")]
    InvalidSet {
        /// Name of the service.
        service: String,
        /// What is wrong.
        #[source]
        source: PacketError,
    },
    /// What was received is no valid frame set; it is dropped, and receiving can go on.
    #[error("received bad data on service `{service}`")]
    BadPacket {
        /// Name of the service.
        service: String,
        /// What is wrong.
        #[source]
        source: PacketError,
    },
    /// Sending or receiving through shared memory has failed.
    #[error("cannot {action} service `{service}`")]
    Exchange {
        /// Name of the service.
        service: String,
        /// What was being done.
        action: &'static str,
        /// What iceoryx2 said.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl HandoverError {
    /// True if only one set is lost and the next call may bring a good one.
    #[must_use]
    pub fn is_skippable(&self) -> bool {
        match self {
            Self::BadPacket { source, .. } => !matches!(source, PacketError::Version { .. }),
            Self::Source(_)
            | Self::PublisherPanicked
            | Self::StartThread(_)
            | Self::ServiceName { .. }
            | Self::OpenService { .. }
            | Self::PublisherExists { .. }
            | Self::TooManyReaders { .. }
            | Self::FrameTooLarge { .. }
            | Self::InvalidSet { .. }
            | Self::Exchange { .. } => false,
        }
    }

    /// True if the user's input is to blame (exit code 2), false if the program has failed (exit code 1).
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        matches!(self, Self::Source(_) | Self::ServiceName { .. })
    }

    /// One line on what to do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Source(source) => source.hint(),
            Self::PublisherPanicked => "the message of the panic is above; please report it",
            Self::StartThread(_) => "free memory or raise the limit on threads",
            Self::ServiceName { .. } => "use a short name such as `mirrorball/frames`",
            Self::OpenService { .. } => {
                "run both programs as the same user and of the same version; when none runs, remove `/tmp/iceoryx2`"
            }
            Self::PublisherExists { .. } => "stop the other `mirrorball-capture` or choose another `--service`",
            Self::TooManyReaders { .. } => "stop one of the readers",
            Self::FrameTooLarge { .. } | Self::InvalidSet { .. } => "the source has broken a promise; please report it",
            Self::BadPacket { .. } => "install the same version of `mirrorball-capture` and of the program that reads",
            Self::Exchange { .. } => "look for room in `/dev/shm`, then restart both programs",
        }
    }
}
