//! The server: one thread with a socket, and a session for each client.

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use tokio::sync::{Semaphore, watch};

use crate::access::{Access, Scheme};
use crate::control::{Asked, Seat};
use crate::feed::{Feed, Shared};
use crate::picture::Jpegs;
use crate::tls::Tls;
use crate::{Error, foxglove, http};

/// Clients at a time.
pub const MOST_CLIENTS: usize = 64;
/// Sockets at a time that are no session yet.
const MOST_SOCKETS: usize = 256;
/// Requests that wait for whoever scans.
const MOST_ASKED: usize = 64;
/// How long sessions get to say that the server goes.
const GOODBYE: Duration = Duration::from_millis(500);

/// Where to listen, and to whom.
#[derive(Clone, Debug)]
pub struct Options {
    /// The page and its socket.
    pub listen: SocketAddr,
    /// What is asked of clients.
    pub access: Access,
    /// What the page and its socket are encrypted with; `None`: not at all.
    pub tls: Option<Tls>,
    /// The stream for Foxglove's tools; `None`: none. They show no token, so this has to be a loopback address.
    pub foxglove: Option<SocketAddr>,
}

/// What sessions share.
pub(crate) struct Site {
    pub listening: SocketAddr,
    pub access: Access,
    /// Of the page's own address.
    pub scheme: Scheme,
    pub shared: Arc<Shared>,
    pub jpegs: Arc<Jpegs>,
    pub seat: Seat,
    pub asked: Sender<Asked>,
    /// Clients that are let in.
    pub clients: AtomicUsize,
    pub next_client: AtomicU64,
    pub closing: watch::Receiver<bool>,
}

/// A server that runs. Dropped, it ends.
#[derive(Debug)]
pub struct Server {
    listening: SocketAddr,
    scheme: Scheme,
    foxglove: Option<SocketAddr>,
    closing: watch::Sender<bool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Listens. What a scan has goes to the [`Feed`]; what clients ask for comes from the channel, and is refused where that is dropped.
    ///
    /// # Errors
    /// [`Error`] where an address can't be had, or tokens are not asked for on one that others reach.
    pub fn start(options: Options) -> Result<(Self, Feed, Receiver<Asked>), Error> {
        let Options { listen, access, tls, foxglove } = options;
        let failed = |address| move |source| Error::Listen { address, source };
        if matches!(access, Access::Local) && !listen.ip().is_loopback() {
            let source = std::io::Error::other("others reach this address, and no token is asked for");
            return Err(Error::Listen { address: listen, source });
        }
        if let Some(address) = foxglove.filter(|address| !address.ip().is_loopback()) {
            let reason = "its clients show no token, so it is for loopback addresses only".to_owned();
            return Err(Error::Foxglove { address, reason });
        }
        let listener = TcpListener::bind(listen).map_err(failed(listen))?;
        listener.set_nonblocking(true).map_err(failed(listen))?;
        let listening = listener.local_addr().map_err(failed(listen))?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(1)
            .thread_name("uwscan-live-jpeg")
            .build()
            .map_err(Error::Start)?;
        let (closing, to_close) = watch::channel(false);
        let (asked, to_ask) = bounded(MOST_ASKED);
        let shared = Shared::new();
        let scheme = if tls.is_some() { Scheme::Https } else { Scheme::Http };
        let site = Arc::new(Site {
            listening,
            access,
            scheme,
            shared: shared.clone(),
            jpegs: Arc::default(),
            seat: Seat::default(),
            asked,
            clients: AtomicUsize::new(0),
            next_client: AtomicU64::new(0),
            closing: to_close,
        });
        let stream =
            foxglove.map(|address| runtime.block_on(foxglove::start(address, site.clone()))).transpose()?;
        let foxglove = stream.as_ref().map(|stream| stream.listening);
        let listener = {
            let _entered = runtime.enter();
            tokio::net::TcpListener::from_std(listener).map_err(failed(listen))?
        };
        let thread = std::thread::Builder::new().name("uwscan-live".to_owned()).spawn(move || {
            runtime.block_on(async move {
                let mut closing = site.closing.clone();
                let publishing = stream.map(|stream| tokio::spawn(stream.publish()));
                tokio::select! {
                    () = accept(&listener, tls.as_ref(), &site) => {}
                    _ = closing.wait_for(|closing| *closing) => {}
                }
                drop(listener);
                if let Some(publishing) = publishing {
                    publishing.abort();
                }
                // Sessions see it, too, and end; the rest ends with the runtime.
                tokio::time::sleep(GOODBYE).await;
            });
            runtime.shutdown_timeout(GOODBYE);
        });
        let thread = Some(thread.map_err(Error::Start)?);
        Ok((Self { listening, scheme, foxglove, closing, thread }, Feed { shared }, to_ask))
    }

    /// Where the page is.
    pub fn listening(&self) -> SocketAddr {
        self.listening
    }

    /// How the page's address begins.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Where Foxglove's tools find the stream; `None` where there is none.
    pub fn foxglove(&self) -> Option<SocketAddr> {
        self.foxglove
    }

    /// Ends, after clients have had so much time to get the last of it.
    pub fn close(self, after: Duration) {
        std::thread::sleep(after);
        drop(self);
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.closing.send_replace(true);
        if let Some(thread) = self.thread.take() {
            // A panic of the server's thread is not the scan's.
            let _ = thread.join();
        }
    }
}

async fn accept(listener: &tokio::net::TcpListener, tls: Option<&Tls>, site: &Arc<Site>) {
    let sockets = Arc::new(Semaphore::new(MOST_SOCKETS));
    loop {
        let Ok((socket, peer)) = listener.accept().await else {
            // Too many open files, most likely: others may close some.
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        let Ok(permit) = sockets.clone().try_acquire_owned() else { continue };
        let _ = socket.set_nodelay(true);
        let (site, tls) = (site.clone(), tls.map(Tls::acceptor));
        tokio::spawn(async move {
            match tls {
                None => http::serve(socket, peer, site).await,
                Some(tls) => http::serve_encrypted(socket, &tls, peer, site).await,
            }
            drop(permit);
        });
    }
}
