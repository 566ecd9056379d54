//! The stream for Foxglove, Lichtblick and the Python SDK: a recording's topics, as they come.
//!
//! Its clients show no token when they connect, and their pages are others' (app.foxglove.dev): it is for this machine. Parameters are set by who has
//! shown the token to steer as a parameter of its own; where no token is asked for, by nobody: any page that this machine's browser shows could.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use foxglove::websocket::{
    AnyClient, GetParametersResponder, Parameter, ParameterHandler, ParameterValue, SetParametersResponder,
};
use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
use uw_io::recording::stream::{self, Health};
use uw_io::recording::{self, GalvoState, Shot, topics};

use crate::Error;
use crate::access::{Access, Rights};
use crate::control::{Action, Asked};
use crate::feed::{Board, Laser, Level, Phase, Shared, Stripe, now_ns};
use crate::picture::Jpegs;
use crate::server::Site;
use crate::session::WRONG_TOKEN;

/// Messages that wait for one client: a second or two of images.
const BACKLOG: usize = 64;
/// How often at most images, and how the scan is, are sent.
const EVERY: Duration = Duration::from_millis(100);
/// How often what stays the same is sent again, for clients that came since.
const AGAIN: Duration = Duration::from_secs(1);
/// How often news are looked for.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// The parameter that shows the right to set the others. It is never told.
const TOKEN: &str = "control_token";

/// A server that listens; [`Stream::publish`] fills it.
pub(crate) struct Stream {
    pub listening: SocketAddr,
    shared: Arc<Shared>,
    jpegs: Arc<Jpegs>,
    channels: BTreeMap<&'static str, Arc<RawChannel>>,
    parameters: Parameters,
    server: WebSocketServerHandle,
    /// Channels and server know it by weak references alone.
    _context: Arc<Context>,
}

/// Listens.
pub(crate) async fn start(address: SocketAddr, site: Arc<Site>) -> Result<Stream, Error> {
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
    let (shared, jpegs) = (site.shared.clone(), site.jpegs.clone());
    let parameters = Parameters(Arc::new(Settings { site, may_set: Mutex::default() }));
    let server = context
        .websocket_server()
        .name("uwscan")
        .bind(address.ip().to_string(), address.port())
        .message_backlog_size(BACKLOG)
        .parameter_handler(Arc::new(parameters.clone()))
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
    /// What stays as it is during a scan, and what can be set.
    about: Option<[u64; 2]>,
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
        let versions = [board.about.version, board.settings.version];
        if sent.about != Some(versions) {
            sent.about = Some(versions);
            sent.calibration_at = None;
            self.server.publish_parameter_values(self.parameters.0.named(&[]));
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

/// What can be read, and set by who may.
struct Settings {
    site: Arc<Site>,
    /// Clients that have shown the token to steer. Their numbers are never given again.
    may_set: Mutex<BTreeSet<u32>>,
}

impl Settings {
    /// Those of these names, or all.
    fn named(&self, names: &[String]) -> Vec<Parameter> {
        let board = self.site.shared.board();
        let all = board.about.value.parameters.iter().chain(board.settings.value.iter());
        let values = all.map(|(name, value)| Parameter::float64(name.clone(), *value));
        let token = matches!(self.site.access, Access::Tokens { .. }).then(|| Parameter::string(TOKEN, ""));
        values.chain(token).filter(|one| names.is_empty() || names.contains(&one.name)).collect()
    }

    fn may_set(&self) -> MutexGuard<'_, BTreeSet<u32>> {
        self.may_set.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does what a client asks for; why not, where it does not.
    async fn set(&self, client: u32, asked: Parameter) -> Result<(), String> {
        let Parameter { name, value, .. } = asked;
        if name == TOKEN {
            return self.shown(client, value).await;
        }
        if !self.site.shared.board().settings.value.iter().any(|(known, _)| *known == name) {
            return Err("there is no such parameter to set".to_owned());
        }
        if matches!(self.site.access, Access::Local) {
            return Err("without a token to steer nothing is set from here: start with --control-token-file"
                .to_owned());
        }
        if !self.may_set().contains(&client) {
            return Err(format!("set {TOKEN} to the token to steer first"));
        }
        if let (Some(holder), _) = self.site.seat.holder(u64::MAX) {
            return Err(format!("{holder} steers: only one can"));
        }
        let value = match value {
            Some(ParameterValue::Float64(value)) => value,
            Some(ParameterValue::Integer(value)) => value as f64,
            _ => f64::NAN,
        };
        if !value.is_finite() {
            return Err("give a number".to_owned());
        }
        let (asked, answer) =
            Asked::awaited(Action::Set { name, value }, format!("Foxglove client {client}"));
        if let Err(error) = self.site.asked.try_send(asked) {
            // Its answer says so.
            error.into_inner().refuse("too many requests wait already, or the scan has ended");
        }
        answer.await.unwrap_or_default().map_or(Ok(()), Err)
    }

    /// Looks at a token.
    async fn shown(&self, client: u32, value: Option<ParameterValue>) -> Result<(), String> {
        let Some(ParameterValue::String(token)) = value else { return Err("give a text".to_owned()) };
        let right = self.site.access.rights(Some(&token)) == Some(Rights::Control);
        if right && matches!(self.site.access, Access::Tokens { .. }) {
            self.may_set().insert(client);
            self.site.shared.note(Level::Info, format!("Foxglove client {client} may set parameters now"));
            return Ok(());
        }
        self.may_set().remove(&client);
        if token.is_empty() {
            return Ok(());
        }
        tokio::time::sleep(WRONG_TOKEN).await;
        Err("this is not the token to steer".to_owned())
    }
}

#[derive(Clone)]
struct Parameters(Arc<Settings>);

impl ParameterHandler for Parameters {
    fn get(&self, _: AnyClient, names: Vec<String>, _: Option<String>, responder: GetParametersResponder) {
        responder.respond(self.0.named(&names));
    }

    fn set(
        &self,
        client: AnyClient,
        asked: Vec<Parameter>,
        _: Option<String>,
        responder: SetParametersResponder,
    ) {
        let settings = self.0.clone();
        tokio::spawn(async move {
            let mut names = Vec::with_capacity(asked.len());
            for parameter in asked {
                let name = parameter.name.clone();
                if let Err(why) = settings.set(client.id().into(), parameter).await {
                    client.send_warning(format!("{name}: {why}"));
                }
                names.push(name);
            }
            // As they are now, set or not.
            responder.respond(if names.is_empty() { Vec::new() } else { settings.named(&names) });
        });
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
