//! Why nobody can watch.

use std::net::SocketAddr;
use std::path::PathBuf;

use crate::tls::TlsFault;

/// The server can't be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An address can't be listened on.
    #[error("cannot listen on {address}: {source}; give another address or port")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The system gives no thread or event queue.
    #[error("cannot start the live server: {0}")]
    Start(std::io::Error),
    /// The Foxglove server did not start.
    #[error("cannot serve Foxglove on {address}: {reason}; give another address, or turn it off")]
    Foxglove {
        /// The address.
        address: SocketAddr,
        /// What the library said.
        reason: String,
    },
    /// A certificate or its key can't be used.
    #[error("{} {fault}", file.display())]
    Tls {
        /// The file that is at fault.
        file: PathBuf,
        /// What is wrong with it.
        fault: TlsFault,
    },
    /// A token that can be guessed.
    #[error(
        "a token needs at least {least} printable characters without spaces, this one has {got}: make a longer one"
    )]
    WeakToken {
        /// Fewest characters.
        least: usize,
        /// Characters that it has, as far as they count.
        got: usize,
    },
}
