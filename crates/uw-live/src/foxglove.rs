//! The stream for Foxglove, Lichtblick and the Python SDK: a recording's topics, as they come.
//!
//! Its clients show no token, and their pages are others' (app.foxglove.dev): it is for this machine, and nothing can be set through it.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use foxglove::websocket::{
    AnyClient, GetParametersResponder, Parameter, ParameterHandler, SetParametersResponder,
};
use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
use uw_io::recording::stream::{self, Health};
use uw_io::recording::{self, GalvoState, Shot, topics};

use crate::Error;
use crate::feed::{Board, Laser, Level, Phase, Shared, Stripe, now_ns};
use crate::picture::Jpegs;

/// Messages that wait for one client: a second or two of images.
const BACKLOG: usize = 64;
/// How often at most images, and how the scan is, are sent.
const EVERY: Duration = Duration::from_millis(100);
/// How often what stays the same is sent again, for clients that came since.
const AGAIN: Duration = Duration::from_secs(1);
/// How often news are looked for.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// A server that listens; [`Stream::publish`] fills it.
pub(crate) struct Stream {
    pub listening: SocketAddr,
    shared: Arc<Shared>,
    jpegs: Arc<Jpegs>,
    channels: BTreeMap<&'static str, Arc<RawChannel>>,
    parameters: Arc<Parameters>,
    server: WebSocketServerHandle,
    /// Channels and server know it by weak references alone.
    _context: Arc<Context>,
}

/// Listens.
pub(crate) async fn start(
    address: SocketAddr,
    shared: Arc<Shared>,
    jpegs: Arc<Jpegs>,
) -> Result<Stream, Error> {
    let failed = |error: foxglove::FoxgloveError| Error::Foxglove { address, reason: error.to_string() };
    let context = Context::new();
    let mut channels = BTreeMap::new();
    for topic in stream::topics() {
        let schema = Schema::new(topic.schema_name, topic.schema_encoding, topic.schema);
        let channel = ChannelBuilder::new(topic.name)
            .context(&context)
            .message_encoding(topic.message_encoding)
            .schema(schema)
            .build_raw()
            .map_err(failed)?;
        channels.insert(topic.name, channel);
    }
    let parameters = Arc::new(Parameters::default());
    let server = context
        .websocket_server()
        .name("uwscan")
        .bind(address.ip().to_string(), address.port())
        .message_backlog_size(BACKLOG)
        .parameter_handler(parameters.clone())
        .start()
        .await
        .map_err(failed)?;
    let listening = SocketAddr::new(address.ip(), server.port());
    Ok(Stream { listening, shared, jpegs, channels, parameters, server, _context: context })
}

/// What was sent already.
#[derive(Default)]
struct Sent {
    shown: u64,
    stripes: u64,
    notes: u64,
    state: u64,
    about: Option<u64>,
    image_at: Option<Instant>,
    state_at: Option<Instant>,
    calibration_at: Option<Instant>,
}

fn due(at: Option<Instant>, every: Duration) -> bool {
    at.is_none_or(|at| at.elapsed() >= every)
}

impl Stream {
    /// Sends what comes, for ever.
    pub async fn publish(self) {
        let mut news = self.shared.wake.subscribe();
        let mut sent = Sent::default();
        loop {
            news.borrow_and_update();
            self.round(&mut sent).await;
            let again = tokio::time::timeout(EVERY, news.changed());
            if let Ok(Err(_)) = again.await {
                return;
            }
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }

    async fn round(&self, sent: &mut Sent) {
        let board = self.shared.board();
        if sent.about != Some(board.about.version) {
            sent.about = Some(board.about.version);
            sent.calibration_at = None;
            self.parameters.set_all(&board.about.value.parameters);
            self.server.publish_parameter_values(self.parameters.named(&[]));
        }
        if let Some(file) = &board.about.value.calibration
            && due(sent.calibration_at, AGAIN)
        {
            sent.calibration_at = Some(Instant::now());
            let now_ns = now_ns();
            self.put(topics::CALIBRATION, now_ns, || stream::camera(file, now_ns));
            self.put(topics::TRANSFORMS, now_ns, || stream::transform(file, now_ns));
        }
        for note in self.shared.notes(sent.notes) {
            let level = match note.level {
                Level::Info => recording::Level::Info,
                Level::Warning => recording::Level::Warning,
                Level::Error => recording::Level::Error,
            };
            self.put(topics::LOG, note.stamp_ns, || stream::log(level, &note.text, note.stamp_ns));
        }
        sent.notes = board.noted;
        let (stripes, next) = self.shared.stripes(sent.stripes);
        sent.stripes = next;
        stripes.iter().for_each(|stripe| self.stripe(stripe));
        if due(sent.image_at, EVERY) && board.shown.version != sent.shown {
            (sent.image_at, sent.shown) = (Some(Instant::now()), board.shown.version);
            self.image(&board).await;
        }
        // An idle scan is told of all the same: a client may have come since.
        let every = if board.state.version == sent.state { AGAIN } else { EVERY };
        if due(sent.state_at, every) {
            (sent.state_at, sent.state) = (Some(Instant::now()), board.state.version);
            self.health(&board);
        }
    }

    fn put(&self, topic: &str, stamp_ns: u64, encode: impl FnOnce() -> Vec<u8>) {
        if let Some(channel) = self.channels.get(topic).filter(|channel| channel.has_sinks()) {
            channel.log_with_meta(&encode(), PartialMetadata { log_time: Some(stamp_ns) });
        }
    }

    fn stripe(&self, stripe: &Stripe) {
        let lines = lines(stripe);
        self.put(topics::PROFILE, stripe.stamp_ns, || stream::profile(&lines));
        self.put(topics::POINTS, stripe.stamp_ns, || stream::points(&stripe.cloud, stripe.stamp_ns));
        let state = GalvoState {
            stamp_ns: stripe.stamp_ns,
            frame: Some(stripe.frame),
            readback_v: Some(stripe.voltage_v),
            ..GalvoState::default()
        };
        self.put(topics::GALVO, stripe.stamp_ns, || stream::galvo(&state));
    }

    /// The latest image, its row and its stripe.
    async fn image(&self, board: &Board) {
        let Some(shown) = &board.shown.value else { return };
        let watched = [topics::IMAGE, topics::FRAME, topics::STRIPE];
        if !watched.iter().any(|topic| self.channels.get(topic).is_some_and(|channel| channel.has_sinks())) {
            return;
        }
        let Some(made) = self.jpegs.get(0, board.shown.version, shown).await else { return };
        let picture = &made.shown.picture;
        let stamp_ns = picture.stamp_ns;
        let (bytes, crc) = stream::image(&made.jpeg, stamp_ns);
        let shot = Shot {
            number: picture.frame,
            file: "",
            pose: None,
            laser_on: picture.laser_on,
            voltage_v: picture.voltage_v,
            stamp_ns,
            bits: picture.image.significant_bits(),
        };
        self.put(topics::FRAME, stamp_ns, || stream::frame(&shot, crc));
        self.put(topics::IMAGE, stamp_ns, || bytes);
        if let Some(stripe) = &made.shown.stripe {
            let lines = recording::Stripe { stamp_ns, ..lines(stripe) };
            self.put(topics::STRIPE, stamp_ns, || stream::annotation(&lines));
        }
    }

    fn health(&self, board: &Board) {
        let state = &board.state.value;
        let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        let stamp_ns = now_ns();
        let health = Health {
            stamp_ns,
            phase: match state.phase {
                Phase::Idle => "idle",
                Phase::Starting => "starting",
                Phase::Scanning => "scanning",
                Phase::Paused => "paused",
                Phase::Stopping => "stopping",
                Phase::Finished => "finished",
                Phase::Failed => "failed",
                Phase::Replaying => "replaying",
            },
            laser: match state.laser {
                Laser::On => "on",
                Laser::Off => "off",
                Laser::Unknown => "unknown",
            },
            voltage_v: state.voltage_v,
            frames: count(state.frames),
            planned: state.planned.map(count),
            lost: count(state.lost.values().sum()),
            points: count(state.points),
            rate_hz: state.rate_hz,
        };
        self.put(topics::HEALTH, stamp_ns, || stream::health(&health));
    }
}

/// What can be read, and nothing set: whoever reaches this port has shown no right to.
#[derive(Default)]
struct Parameters(Mutex<Vec<(String, f64)>>);

impl Parameters {
    fn set_all(&self, values: &[(String, f64)]) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = values.to_vec();
    }

    /// Those of these names, or all.
    fn named(&self, names: &[String]) -> Vec<Parameter> {
        let values = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = values.iter().filter(|(name, _)| names.is_empty() || names.contains(name));
        wanted.map(|(name, value)| Parameter::float64(name.clone(), *value)).collect()
    }
}

impl ParameterHandler for Parameters {
    fn get(&self, _: AnyClient, names: Vec<String>, _: Option<String>, responder: GetParametersResponder) {
        responder.respond(self.named(&names));
    }

    fn set(&self, _: AnyClient, asked: Vec<Parameter>, _: Option<String>, responder: SetParametersResponder) {
        let names: Vec<String> = asked.into_iter().map(|parameter| parameter.name).collect();
        responder.respond(self.named(&names));
    }
}

/// A stripe as the recording has it.
fn lines(stripe: &Stripe) -> recording::Stripe<'_> {
    recording::Stripe {
        stamp_ns: stripe.stamp_ns,
        frame: stripe.frame,
        across: stripe.across,
        lines: &stripe.lines,
        position_px: &stripe.position_px,
        sigma_px: &stripe.sigma_px,
        width_px: &stripe.width_px,
        amplitude: &stripe.amplitude,
    }
}
