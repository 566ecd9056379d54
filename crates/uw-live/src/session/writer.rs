//! What a client gets, in which order: answers, state and notes first; then images, the profile and points, as far as its link has room.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use futures_util::SinkExt;
use futures_util::stream::SplitSink;
use serde_json::{Value, json};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;

use super::{Client, Close, GONE, PING_EVERY, SILENT, WRITE_WITHIN};
use crate::cloud::{COARSEST, Cloud};
use crate::feed::{About, Board, Phase, now_ns};
use crate::picture::{self, Made};
use crate::server::Site;
use crate::wire;

/// How often at most what changes all the time is told; on a thin link, and what that is, bytes/s.
const TELL_EVERY: Duration = Duration::from_millis(100);
const TELL_RARELY: Duration = Duration::from_millis(300);
const THIN: f64 = 50e3;
/// How often at most a session looks for news of the scan.
const LOOK_EVERY: Duration = Duration::from_millis(15);
/// Shares of a link: images, the latest points, the cloud.
const IMAGE_SHARE: f64 = 0.35;
const PROFILE_SHARE: f64 = 0.1;
const CLOUD_SHARE: f64 = 0.5;
/// How long one image, and one message of points, may take on the link, s.
const IMAGE_S: f64 = 0.12;
const POINTS_S: f64 = 0.05;
/// Points of a message.
const POINTS: (usize, usize) = (512, 32 << 10);
/// A cloud that is longer under way than this is sent thinner, s; one that would be shorter under way than these, during a scan and
/// after it, denser.
const BEHIND_S: f64 = 1.5;
const DENSER_S: (f64, f64) = (0.75, 4.0);

/// How often the state is told at least: an idle link is told from a dead one by that.
const TELL_AT_LEAST: Duration = Duration::from_secs(1);

/// What was told already.
#[derive(Default)]
struct Told {
    about: Option<u64>,
    state: u64,
    urgent: Option<u64>,
    stripe: u64,
    notes: u64,
    timeline: u64,
    image: u64,
    profile: u64,
    epoch: Option<u32>,
    density: u32,
    points: u64,
}

/// When the next of a kind may go.
struct Due {
    state: Instant,
    signal: Instant,
    timeline: Instant,
    image: Instant,
    profile: Instant,
    ping: Instant,
}

type Sink<S> = SplitSink<WebSocketStream<S>, Message>;

/// Writes until the client is gone, or stuck.
pub(super) async fn write<S>(sink: &mut Sink<S>, client: &Client, site: &Site) -> Close
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let now = Instant::now();
    let mut writer = Writer {
        sink,
        client,
        site,
        told: Told::default(),
        emptied: None,
        due: Due { state: now, signal: now, timeline: now, image: now, profile: now, ping: now + PING_EVERY },
    };
    let mut news = site.shared.wake.subscribe();
    loop {
        news.borrow_and_update();
        let next = match writer.round().await {
            Ok(next) => next,
            Err(Gone) => return GONE,
        };
        let looked = Instant::now();
        tokio::select! {
            () = client.outbox.wake.notified() => {}
            // Not each time that something changes, but soon.
            _ = async {
                let _ = news.changed().await;
                tokio::time::sleep_until((looked + LOOK_EVERY).into()).await;
            } => {}
            () = tokio::time::sleep_until(next.into()) => {}
        }
        if client.view().heard.elapsed() > SILENT {
            return GONE;
        }
    }
}

/// The socket is closed, or takes nothing.
struct Gone;

struct Writer<'w, S> {
    sink: &'w mut Sink<S>,
    client: &'w Client,
    site: &'w Site,
    told: Told,
    /// The epoch of the last points that were sent.
    emptied: Option<u32>,
    due: Due,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Writer<'_, S> {
    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        match tokio::time::timeout(WRITE_WITHIN, self.sink.send(message)).await {
            Ok(Ok(())) => Ok(()),
            _ => Err(Gone),
        }
    }

    async fn text(&mut self, value: Value) -> Result<(), Gone> {
        self.send(Message::text(value.to_string())).await
    }

    /// Sends what there is and there is room for; when to look again at the latest.
    async fn round(&mut self) -> Result<Instant, Gone> {
        loop {
            self.texts().await?;
            let now = Instant::now();
            let wait = self.client.view().pace.may_send(now);
            let next = match wait {
                Ok(()) => self.bulk().await?,
                Err(until) => Some(until.unwrap_or(self.due.ping)),
            };
            if let Some(next) = next {
                return Ok(next.min(self.due.ping).min(self.due.state + TELL_AT_LEAST).max(now));
            }
        }
    }

    /// All that is text.
    async fn texts(&mut self) -> Result<(), Gone> {
        let board = self.site.shared.board();
        let now = Instant::now();
        if self.told.about != Some(board.about.version) {
            let welcome = welcome(&board.about.value, self.client.rights.name());
            self.told.about = Some(board.about.version);
            self.text(welcome).await?;
        }
        while let Some(answer) = self.client.outbox.take() {
            self.send(Message::text(answer)).await?;
        }
        let every = if self.client.view().pace.rate() < THIN { TELL_RARELY } else { TELL_EVERY };
        let urgent = self.told.urgent != Some(board.urgent);
        let changed = self.told.state != board.state.version && now >= self.due.state;
        if urgent || changed || now >= self.due.state + TELL_AT_LEAST {
            (self.told.urgent, self.told.state) = (Some(board.urgent), board.state.version);
            self.due.state = now + every;
            let state = self.state(&board);
            self.text(state).await?;
        }
        if self.told.notes != board.noted {
            for note in self.site.shared.notes(self.told.notes) {
                let mut note = json!(*note);
                note["type"] = "note".into();
                self.text(note).await?;
            }
            self.told.notes = board.noted;
        }
        if let Some(timeline) = &board.timeline.value
            && self.told.timeline != board.timeline.version
            && now >= self.due.timeline
        {
            self.told.timeline = board.timeline.version;
            self.due.timeline = now + every;
            let mut timeline = json!(timeline);
            timeline["type"] = "timeline".into();
            self.text(timeline).await?;
        }
        if let Some(stripe) = &board.stripe.value
            && self.told.stripe != board.stripe.version
            && now >= self.due.signal
        {
            self.told.stripe = board.stripe.version;
            self.due.signal = now + every;
            self.text(wire::signal(stripe)).await?;
        }
        if now >= self.due.ping {
            self.due.ping = now + PING_EVERY;
            self.send(Message::Ping(Vec::new().into())).await?;
        }
        Ok(())
    }

    fn state(&self, board: &Board) -> Value {
        let mut state = json!(*board.state.value);
        let (controller, you_control) = self.site.seat.holder(self.client.id);
        state["type"] = "state".into();
        state["controller"] = controller.into();
        state["you_control"] = you_control.into();
        state["viewers"] = self.site.clients.load(Ordering::Acquire).into();
        state
    }

    /// One binary message, if one is due; else when one may be.
    async fn bulk(&mut self) -> Result<Option<Instant>, Gone> {
        let (rate, image, points) = {
            let view = self.client.view();
            (view.pace.rate(), view.image, view.points)
        };
        let board = self.site.shared.board();
        let now = Instant::now();
        let mut next = self.due.ping;
        if let Some(shown) = board.shown.value.as_ref().filter(|_| image)
            && self.told.image != board.shown.version
        {
            if now >= self.due.image {
                let size = [shown.picture.image.width(), shown.picture.image.height()];
                let tier = picture::tier(size, rate * IMAGE_S);
                let made = self.site.jpegs.get(tier, board.shown.version, shown).await;
                self.due.image = now + TELL_EVERY;
                self.told.image = board.shown.version;
                if let Some(made) = made {
                    self.told.image = made.version();
                    let bytes = self.picture(&made).await?;
                    self.due.image = now + spaced(bytes, rate * IMAGE_SHARE);
                    return Ok(None);
                }
            }
            next = next.min(self.due.image);
        }
        if let Some(stripe) = board.stripe.value.as_ref().filter(|_| points)
            && self.told.profile != board.stripe.version
        {
            if now >= self.due.profile {
                self.told.profile = board.stripe.version;
                let bytes = self.binary(|sequence| wire::profile(sequence, stripe)).await?;
                self.due.profile = now + spaced(bytes, rate * PROFILE_SHARE);
                return Ok(None);
            }
            next = next.min(self.due.profile);
        }
        if points && self.cloud(rate, board.state.value.phase).await? {
            return Ok(None);
        }
        Ok(Some(next))
    }

    async fn picture(&mut self, made: &Made) -> Result<usize, Gone> {
        let picture = &made.shown.picture;
        let size = [picture.image.width(), picture.image.height()];
        let stripe = made.shown.stripe.as_deref();
        let stamp = (picture.stamp_ns, picture.frame);
        self.binary(|sequence| wire::image(sequence, stamp, size, stripe, &made.jpeg)).await
    }

    /// The next points, if there are any.
    async fn cloud(&mut self, rate: f64, phase: Phase) -> Result<bool, Gone> {
        let share = rate * CLOUD_SHARE;
        let (have, thinnest) = {
            let mut view = self.client.view();
            (view.have.take(), view.thinnest)
        };
        let most = ((rate * POINTS_S) as usize / wire::POINT_BYTES).clamp(POINTS.0, POINTS.1);
        let told = &mut self.told;
        let part = {
            let cloud = self.site.shared.cloud();
            aim(told, &cloud, have, Wish { share, thinnest, phase });
            cloud.part(told.density, told.points, most)
        };
        let (epoch, first) = (told.epoch.unwrap_or_default(), told.points);
        // An emptied cloud is told of at once, by a message without points.
        let emptied = first == 0 && self.emptied.is_some_and(|told| told != epoch);
        if part.is_empty() && !emptied {
            return Ok(false);
        }
        self.emptied = Some(epoch);
        self.told.points += part.len() as u64;
        self.binary(|sequence| wire::points(sequence, epoch, first, &part)).await?;
        Ok(true)
    }

    async fn binary(&mut self, encode: impl FnOnce(u32) -> Vec<u8>) -> Result<usize, Gone> {
        let sequence = self.client.sequence.fetch_add(1, Ordering::AcqRel);
        let bytes = encode(sequence);
        let count = bytes.len();
        self.client.view().pace.sent(sequence, count, Instant::now());
        self.send(Message::binary(bytes)).await?;
        Ok(count)
    }
}

/// How long until the next message of a kind, after one of so many bytes.
fn spaced(bytes: usize, share: f64) -> Duration {
    Duration::from_secs_f64((bytes as f64 / share.max(1.0)).min(5.0)).max(TELL_EVERY)
}

/// What bounds a client's points.
#[derive(Clone, Copy)]
struct Wish {
    /// Bytes a second.
    share: f64,
    /// Every 2ⁿth point at most.
    thinnest: u32,
    phase: Phase,
}

/// Which points a client gets next, at which density.
fn aim(told: &mut Told, cloud: &Cloud, have: Option<(u32, u64)>, wish: Wish) {
    let Wish { share, thinnest, phase } = wish;
    let seconds = |points: u64| points as f64 * wire::POINT_BYTES as f64 / share;
    let finest = |most_s: f64| (thinnest..COARSEST).find(|density| seconds(cloud.count(*density)) <= most_s);
    let begin = |told: &mut Told, density: u32| {
        (told.epoch, told.density, told.points) = (Some(cloud.epoch(density)), density, 0);
    };
    // It is back, and has some of this very cloud.
    if let Some((epoch, points)) = have
        && let Some(density) = cloud.density_of(epoch)
        && points <= cloud.count(density)
        && told.points == 0
    {
        (told.epoch, told.density, told.points) = (Some(epoch), density, points);
    }
    let known = told.epoch.is_some_and(|epoch| cloud.density_of(epoch).is_some());
    if !known || told.density < thinnest {
        return begin(told, finest(BEHIND_S).unwrap_or(COARSEST));
    }
    let moving = matches!(phase, Phase::Scanning | Phase::Replaying);
    let left = cloud.count(told.density).saturating_sub(told.points);
    if moving && seconds(left) > BEHIND_S && told.density < COARSEST {
        let wanted = finest(BEHIND_S / 2.0).unwrap_or(COARSEST);
        return begin(told, wanted.max(told.density + 1));
    }
    if left == 0 && told.density > 0 {
        let most_s = if moving { DENSER_S.0 } else { DENSER_S.1 };
        if let Some(wanted) = finest(most_s).filter(|wanted| *wanted < told.density) {
            begin(told, wanted);
        }
    }
}

fn welcome(about: &Arc<About>, rights: &str) -> Value {
    let [width, height] = about.image_size;
    json!({
        "type": "welcome",
        "version": env!("CARGO_PKG_VERSION"),
        "mode": about.mode,
        "rights": rights,
        "server_ns": now_ns(),
        "camera": {"width": width, "height": height},
        "volts": about.volts.map(|[from, to]| json!({"from": from, "to": to})),
        "across": match about.across {
            uw_calib::Across::U => "row",
            uw_calib::Across::V => "column",
        },
    })
}
