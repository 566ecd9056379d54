//! One client: it is let in, then reading and writing go on beside each other, so that what a client asks for is heard while its link
//! is busy.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::TrySendError;
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use serde_json::json;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::error::CapacityError;
use tokio_tungstenite::tungstenite::protocol::CloseFrame;
use tokio_tungstenite::tungstenite::{Error as WsError, Message};

use crate::access::Rights;
use crate::cloud::COARSEST;
use crate::control::{Action, Asked, Outbox, Word};
use crate::feed::Level;
use crate::pace::Pace;
use crate::server::{MOST_CLIENTS, Site};
use crate::wire::{self, FromClient};

mod writer;

/// How long a client may take to say who it is.
const HELLO_WITHIN: Duration = Duration::from_secs(5);
/// What a wrong token costs, so that many can't be tried.
pub(crate) const WRONG_TOKEN: Duration = Duration::from_millis(500);
/// How often a client is asked whether it is there, and how long it may be silent.
const PING_EVERY: Duration = Duration::from_secs(5);
const SILENT: Duration = Duration::from_secs(20);
/// How long a client's socket may take nothing.
const WRITE_WITHIN: Duration = Duration::from_secs(10);
/// Messages a second, those aside that acknowledge something.
const MOST_MESSAGES: u32 = 50;
/// Characters of a client's name.
const NAME: usize = 40;

/// Why a session ends, as the close frame has it.
type Close = (u16, &'static str);

const MALFORMED: Close = (4400, "this is no message of the protocol");
const NO_TOKEN: Close = (4401, "no token, or a wrong one");
const ORIGIN: Close = (4403, "this page is not this server's");
const NO_HELLO: Close = (4408, "no hello in time");
const TOO_LARGE: Close = (4413, "this message is too large");
const TOO_MANY_CLIENTS: Close = (4429, "too many clients");
const TOO_MANY_MESSAGES: Close = (4429, "too many messages");
const GOING: Close = (1001, "the server ends");
const GONE: Close = (1000, "");

/// A client that is let in.
struct Client {
    id: u64,
    /// Name and address.
    who: String,
    name: String,
    rights: Rights,
    outbox: Arc<Outbox>,
    state: Mutex<View>,
    /// Number of the next binary message.
    sequence: AtomicU32,
}

/// What a client wants and has.
struct View {
    pace: Pace,
    image: bool,
    points: bool,
    /// It wants only every 2ⁿth point.
    thinnest: u32,
    /// What it said it has.
    have: Option<(u32, u64)>,
    heard: Instant,
}

impl Client {
    fn view(&self) -> MutexGuard<'_, View> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Goes through a session.
pub(crate) async fn run<S>(mut socket: WebSocketStream<S>, site: Arc<Site>, peer: SocketAddr, allowed: bool)
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    if !allowed {
        close(&mut socket, ORIGIN).await;
        return;
    }
    let client = match admit(&mut socket, &site, peer).await {
        Ok(client) => client,
        Err(why) => {
            close(&mut socket, why).await;
            return;
        }
    };
    site.shared.urge();
    let (mut sink, mut stream) = socket.split();
    let mut closing = site.closing.clone();
    let why = tokio::select! {
        why = read(&mut stream, &client, &site) => why,
        why = writer::write(&mut sink, &client, &site) => why,
        _ = closing.wait_for(|closing| *closing) => GOING,
    };
    site.clients.fetch_sub(1, Ordering::AcqRel);
    if site.seat.release(client.id) {
        site.shared.note(Level::Warning, format!("{} is gone, and steers no more", client.who));
    }
    site.shared.urge();
    // What was half written has to go out first; a client that is stuck is not waited for.
    let _ = tokio::time::timeout(Duration::from_secs(1), say_goodbye(&mut sink, why)).await;
}

async fn say_goodbye<S>(sink: &mut SplitSink<WebSocketStream<S>, Message>, why: Close)
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let _ = sink.send(Message::Close(Some(frame(why)))).await;
}

async fn close<S: AsyncRead + AsyncWrite + Unpin>(socket: &mut WebSocketStream<S>, why: Close) {
    let closed = async {
        let _ = socket.close(Some(frame(why))).await;
        // Until the client has seen it: data that nobody read would reset the connection before.
        while let Some(Ok(_)) = socket.next().await {}
    };
    let _ = tokio::time::timeout(Duration::from_secs(1), closed).await;
}

fn frame((code, reason): Close) -> CloseFrame {
    CloseFrame { code: code.into(), reason: reason.into() }
}

/// Lets a client in that says hello.
async fn admit<S: AsyncRead + AsyncWrite + Unpin>(
    socket: &mut WebSocketStream<S>,
    site: &Site,
    peer: SocketAddr,
) -> Result<Client, Close> {
    let deadline = tokio::time::Instant::now() + HELLO_WITHIN;
    let text = loop {
        let Ok(message) = tokio::time::timeout_at(deadline, socket.next()).await else {
            return Err(NO_HELLO);
        };
        match message.ok_or(GONE)? {
            Ok(Message::Text(text)) => break text,
            Ok(Message::Ping(_) | Message::Pong(_)) => {}
            Ok(_) => return Err(MALFORMED),
            Err(error) => return Err(fault(&error)),
        }
    };
    let hello = serde_json::from_str(&text).map_err(|_| MALFORMED)?;
    let FromClient::Hello { token, client: name, bandwidth_kbps } = hello else { return Err(NO_TOKEN) };
    let Some(rights) = site.access.rights(token.as_deref()) else {
        tokio::time::sleep(WRONG_TOKEN).await;
        return Err(NO_TOKEN);
    };
    let room = |clients| (clients < MOST_CLIENTS).then_some(clients + 1);
    site.clients.fetch_update(Ordering::AcqRel, Ordering::Acquire, room).map_err(|_| TOO_MANY_CLIENTS)?;
    let name: String = name.unwrap_or_default().chars().filter(|c| !c.is_control()).take(NAME).collect();
    let name = if name.trim().is_empty() { peer.ip().to_string() } else { name.trim().to_owned() };
    let view = View {
        pace: Pace::new(bandwidth_kbps),
        image: true,
        points: true,
        thinnest: 0,
        have: None,
        heard: Instant::now(),
    };
    Ok(Client {
        id: site.next_client.fetch_add(1, Ordering::Relaxed),
        who: format!("{name} ({peer})"),
        name,
        rights,
        outbox: Arc::default(),
        state: Mutex::new(view),
        sequence: AtomicU32::new(0),
    })
}

/// What an error of the socket means for its client.
fn fault(error: &WsError) -> Close {
    match error {
        WsError::Capacity(CapacityError::MessageTooLong { .. }) => TOO_LARGE,
        WsError::Protocol(_) | WsError::Utf8(_) => MALFORMED,
        _ => GONE,
    }
}

/// Counts messages in each second.
struct Budget {
    since: Instant,
    spent: u32,
}

impl Budget {
    fn spend(&mut self) -> Result<(), Close> {
        if self.since.elapsed() >= Duration::from_secs(1) {
            (self.since, self.spent) = (Instant::now(), 0);
        }
        self.spent += 1;
        if self.spent > MOST_MESSAGES { Err(TOO_MANY_MESSAGES) } else { Ok(()) }
    }
}

/// Hears a client until it goes.
async fn read<S: AsyncRead + AsyncWrite + Unpin>(
    stream: &mut SplitStream<WebSocketStream<S>>,
    client: &Client,
    site: &Site,
) -> Close {
    let mut budget = Budget { since: Instant::now(), spent: 0 };
    loop {
        let message = match stream.next().await {
            None | Some(Ok(Message::Close(_))) => return GONE,
            Some(Err(error)) => return fault(&error),
            Some(Ok(message)) => message,
        };
        client.view().heard = Instant::now();
        let heard = match message {
            Message::Text(text) => match serde_json::from_str(&text) {
                Ok(message) => hear(message, client, site, &mut budget),
                Err(_) => Err(MALFORMED),
            },
            Message::Ping(_) | Message::Pong(_) => budget.spend(),
            _ => Err(MALFORMED),
        };
        if let Err(why) = heard {
            return why;
        }
    }
}

fn hear(message: FromClient, client: &Client, site: &Site, budget: &mut Budget) -> Result<(), Close> {
    if let FromClient::Ack { sequence } = message {
        let sent = client.sequence.load(Ordering::Acquire);
        // What was not sent yet can't have come.
        let known = sent.wrapping_sub(sequence).wrapping_sub(1) < u32::MAX / 2;
        if known && client.view().pace.acknowledged(sequence, Instant::now()) {
            client.outbox.wake.notify_one();
            return Ok(());
        }
        return budget.spend();
    }
    budget.spend()?;
    match message {
        FromClient::View { bandwidth_kbps, image, points, density } => {
            let mut view = client.view();
            view.pace.tell(bandwidth_kbps);
            view.thinnest = density.filter(|share| *share > 0.0).map_or(0, thinned);
            (view.image, view.points) = (image.unwrap_or(view.image), points.unwrap_or(view.points));
            drop(view);
            client.outbox.wake.notify_one();
        }
        FromClient::Have { epoch, points } => {
            client.view().have = Some((epoch, points));
            client.outbox.wake.notify_one();
        }
        FromClient::Captures => {
            let names = &site.shared.board().about.value.captures;
            client.outbox.put(&json!({"type": "captures", "names": names}));
        }
        FromClient::Command { id, word } => command(id, word, client, site),
        FromClient::Replay { id, word, capture, frame, rate } => {
            match wire::replay(word, capture, frame, rate) {
                Some(replay) => ask(id, Action::Replay(replay), client, site),
                None => client.outbox.answer(id, Some("this needs a value that is missing, or out of range")),
            }
        }
        FromClient::Ack { .. } | FromClient::Hello { .. } => return Err(MALFORMED),
    }
    Ok(())
}

/// The density that leaves no more than a share of the points.
fn thinned(share: f64) -> u32 {
    (1.0 / share).log2().ceil().clamp(0.0, f64::from(COARSEST)) as u32
}

fn command(id: u64, word: Word, client: &Client, site: &Site) {
    let outbox = &client.outbox;
    match word {
        _ if client.rights < Rights::Control => outbox.answer(id, Some("this client may only watch")),
        Word::TakeControl => match site.seat.take(client.id, &client.name) {
            Ok(()) => {
                outbox.answer(id, None);
                site.shared.note(Level::Info, format!("{} steers now", client.who));
                site.shared.urge();
            }
            Err(holder) => outbox.answer(id, Some(&format!("{holder} steers: only one can"))),
        },
        Word::ReleaseControl => {
            let had = site.seat.release(client.id);
            outbox.answer(id, (!had).then_some("this client does not steer"));
            site.shared.urge();
        }
        Word::Start => ask(id, Action::Start, client, site),
        Word::Pause => ask(id, Action::Pause, client, site),
        Word::Resume => ask(id, Action::Resume, client, site),
        Word::Stop => ask(id, Action::Stop, client, site),
        Word::LaserOff => ask(id, Action::LaserOff, client, site),
    }
}

/// Hands a request on to whoever scans.
fn ask(id: u64, action: Action, client: &Client, site: &Site) {
    if client.rights < Rights::Control {
        return client.outbox.answer(id, Some("this client may only watch"));
    }
    if !action.at_any_time() && !site.seat.holder(client.id).1 {
        return client.outbox.answer(id, Some("take control first"));
    }
    let asked = Asked::new(action, client.who.clone(), client.outbox.clone(), id);
    match site.asked.try_send(asked) {
        Ok(()) => {}
        Err(TrySendError::Full(asked)) => asked.refuse("too many requests wait already"),
        // Dropped, it says so itself.
        Err(TrySendError::Disconnected(_)) => {}
    }
}
