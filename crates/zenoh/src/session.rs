//! Actor of a Zenoh session: opens it, tries again while no router answers, publishes the frames of the control thread,
//! and passes on those of others. The only file that calls the Zenoh library.
//!
//! The library blocks for a millisecond when it publishes, which only this actor's own arbiter notices. To open and to
//! close a session take longer and have a thread of their own.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use actix::{Actor, ActorContext, ActorFutureExt, AsyncContext, Context, Handler, Recipient, Supervised, WrapFuture};
use tokio::sync::oneshot;

use ::zenoh::pubsub::Subscriber;
use ::zenoh::qos::{CongestionControl, Priority, Reliability};
use ::zenoh::sample::Locality;
use ::zenoh::{Config, Session, Wait};
use nix::sys::eventfd::EventFd;

use super::route::Endpoints;
use super::{SessionConfig, check_endpoint};
use murmurate::edge::{self, Input, PacketSender, Port, Seat};
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::codec::MAX_FRAME_BYTES;
use murmurate::net::transport::Renewed;

/// Receiver number, in front of a packet from the control thread, that stands for all hosts. No host has it.
pub(super) const TO_ALL: u16 = u16::MAX;
/// Time between two attempts to open a session.
const RETRY: Duration = Duration::from_millis(200);
/// Number of attempts of a check to open a session.
const ATTEMPTS: u32 = 5;
/// Time without a frame after which a subscription is declared anew.
const REFRESH: Duration = Duration::from_secs(1);
/// The same before the first frame: an operator has little time to be heard.
const FIRST_REFRESH: Duration = Duration::from_millis(250);

/// Settings in place of Zenoh's defaults, where its own file leaves them out. There is no discovery, since a team file
/// says where everyone is. A handshake of which a packet is lost is repeated after a second and not after ten, a
/// connection that has broken is set up again within 0.2 s, and a peer that is silent for two seconds counts as gone.
/// Zenoh's default for `listen` is a stream. Its default mode is `peer`, between which a router passes nothing on.
const DEFAULTS: [(&str, &str); 6] = [
    ("scouting/multicast/enabled", "false"),
    ("transport/unicast/open_timeout", "1000"),
    ("transport/unicast/accept_timeout", "1000"),
    ("transport/link/tx/lease", "2000"),
    ("connect/retry", "{ period_init_ms: 100, period_max_ms: 200, period_increase_factor: 2 }"),
    ("listen/endpoints", "[]"),
];

/// State of a session that the control thread reads.
#[derive(Debug, Default)]
pub(super) struct Shared {
    /// Whether the session is open, so that frames can be published.
    pub open: AtomicBool,
    /// Number of frames that the session has refused.
    pub refused: AtomicU64,
    /// Whether the session has to be made again, because this machine's address or interface has changed.
    pub remake: Arc<AtomicBool>,
}

/// Returns the configuration of the Zenoh library for a session. An error says what is wrong with it, or with its file.
pub(super) fn configuration(from: &SessionConfig) -> Result<Config, String> {
    let file = |path: &Path| {
        let why = |error| format!("Zenoh's configuration {}: {}", path.display(), reason(&error));
        Config::from_file(path).map_err(why)
    };
    let mut config = from.config.as_deref().map_or_else(|| Ok(Config::default()), file)?;
    let zenoh = Config::default();
    let left_out = |config: &Config, key: &str| config.get_json(key).ok() == zenoh.get_json(key).ok();
    for (key, value) in DEFAULTS {
        if left_out(&config, key) {
            set(&mut config, key, value)?;
        }
    }
    let list = |endpoints: &[String]| serde_json::to_string(endpoints).expect("texts are JSON");
    let has_mode = from.mode.is_some() || !left_out(&config, "mode");
    if let Some(mode) = from.mode.as_deref().or((!has_mode).then_some("client")) {
        set(&mut config, "mode", &format!("\"{mode}\""))?;
    }
    if !from.connect.is_empty() {
        set(&mut config, "connect/endpoints", &list(&from.connect))?;
    }
    if !from.listen.is_empty() || from.guest {
        set(&mut config, "listen/endpoints", &list(&from.listen))?;
    }
    for key in ["connect/endpoints", "listen/endpoints"] {
        let all = config.get_json(key).unwrap_or_default();
        let all = serde_json::from_str(&all).unwrap_or(serde_json::Value::Null);
        texts(&all)
            .iter()
            .try_for_each(|one| check_endpoint(one, from.streams))
            .map_err(|why| format!("{key}: {why}"))?;
        if key == "listen/endpoints" && !has_mode && !texts(&all).is_empty() {
            return Err(format!("{key}: a session that listens needs a mode, \"peer\" or \"router\""));
        }
    }
    Ok(config)
}

/// Role of a Zenoh session: the field `mode` of Zenoh's configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// It connects to a router.
    Client,
    /// It connects to others and listens for others.
    Peer,
    /// A peer that also passes on.
    Router,
}

/// Returns the role of a session.
pub(super) fn role(config: &Config) -> Role {
    match config.get_json("mode").unwrap_or_default().trim_matches('"') {
        "peer" => Role::Peer,
        "router" => Role::Router,
        _ => Role::Client,
    }
}

/// Whether a session waits for others to connect, so that it opens without a router.
pub(super) fn awaits(config: &Config) -> bool {
    role(config) != Role::Client
}

/// Returns the reason of an error of the library without the place in its source.
fn reason(error: &::zenoh::Error) -> String {
    let text = error.to_string();
    text.split(" at /").next().unwrap_or_default().trim_end().to_owned()
}

fn set(config: &mut Config, key: &str, value: &str) -> Result<(), String> {
    config.insert_json5(key, value).map_err(|error| format!("Zenoh takes no {key} of {value}: {}", reason(&error)))
}

/// Returns all texts within a JSON value: endpoints may differ by mode, or stand in groups.
fn texts(value: &serde_json::Value) -> Vec<&str> {
    match value {
        serde_json::Value::String(text) => vec![text],
        serde_json::Value::Array(all) => all.iter().flat_map(texts).collect(),
        serde_json::Value::Object(all) => all.values().flat_map(texts).collect(),
        _ => Vec::new(),
    }
}

/// Opens a session for a check, and returns how many routers and peers it reaches. Tries again, since a packet of the
/// handshake may be lost.
pub(super) fn reach(config: &Config) -> Result<(usize, usize), String> {
    let mut last = String::new();
    let mut open = || ::zenoh::open(config.clone()).wait().map_err(|error| last = reason(&error)).ok();
    let session = (0..ATTEMPTS).find_map(|_| open());
    let Some(session) = session else { return Err(last) };
    let info = session.info();
    let reached = (info.routers_zid().wait().count(), info.peers_zid().wait().count());
    let _ = session.close().wait();
    Ok(reached)
}

/// Sender of changes of a session to the control thread.
pub(super) struct News {
    /// Changes that the control thread has not taken yet.
    pub queue: SyncSender<Renewed>,
    /// Wakes the control thread.
    pub bell: Arc<EventFd>,
}

impl News {
    /// Tells the control thread of a change; one that does not fit is left out.
    fn report(&self, change: Renewed) {
        let _ = self.queue.try_send(change);
        let _ = self.bell.write(1);
    }
}

/// Returns the endpoints of a session from its configuration.
pub(super) fn endpoints(config: &Config) -> Endpoints {
    let all = |key: &str| {
        let value = serde_json::from_str(&config.get_json(key).unwrap_or_default()).unwrap_or(serde_json::Value::Null);
        texts(&value).into_iter().map(str::to_owned).collect()
    };
    Endpoints { connect: all("connect/endpoints"), listen: all("listen/endpoints") }
}

/// Settings of the session of one host on one link, and its channels to the control thread.
pub(super) struct Worker {
    /// Configuration of the session.
    pub config: SessionConfig,
    /// The same for the library.
    pub zenoh: Config,
    /// Host that this process is.
    pub host: HostId,
    /// State that the control thread reads.
    pub shared: Arc<Shared>,
    /// Takes the result of the first attempt to open the session.
    pub opened: SyncSender<Result<(), String>>,
    /// Takes each later change of the session.
    pub news: News,
}

impl edge::Worker for Worker {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.start(move |port| Keeper { worker: *self, port, open: None, failed: 0 })
    }
}

/// Subscription to one key, which is declared anew while nothing is heard on it: on a link without retransmission, such
/// as `udp/`, a lost declaration would leave this host deaf.
struct Subscription {
    /// Expression that is subscribed to: the key with a wildcard in place of its first part. The library abbreviates
    /// what comes before a wildcard to a number, which it declares once. If that were lost, no later declaration and no
    /// frame with this key would be understood.
    expression: String,
    /// Whether a frame has arrived since the last look.
    heard: Arc<AtomicBool>,
    /// Whether a frame had arrived at any look.
    ever_heard: bool,
    subscriber: Option<Subscriber<()>>,
}

impl Subscription {
    fn new(key: &str) -> Subscription {
        let (_, rest) = key.split_once('/').expect("a key has several parts");
        Subscription { expression: format!("*/{rest}"), heard: Arc::default(), ever_heard: false, subscriber: None }
    }

    /// Declares the subscription unless a frame has arrived since the last call. Frames are passed to `sender`.
    fn refresh(&mut self, session: &Session, sender: &PacketSender) -> ::zenoh::Result<()> {
        if self.heard.swap(false, Ordering::Relaxed) {
            self.ever_heard = true;
            return Ok(());
        }
        if let Some(former) = self.subscriber.take() {
            former.undeclare().wait()?;
        }
        let (sender, heard) = (sender.clone(), Arc::clone(&self.heard));
        let hear = move |sample: ::zenoh::sample::Sample| {
            heard.store(true, Ordering::Relaxed);
            let frame = sample.payload().to_bytes();
            if frame.len() <= MAX_FRAME_BYTES {
                sender.send(frame.into());
            }
        };
        let builder = session.declare_subscriber(self.expression.clone());
        self.subscriber = Some(builder.allowed_origin(Locality::Remote).callback(hear).wait()?);
        Ok(())
    }
}

/// Actor that keeps a session open, and makes it again when the machine's address has changed.
struct Keeper {
    worker: Worker,
    port: Port,
    /// `None` while no session is open.
    open: Option<Open>,
    /// Number of attempts to open the session that have failed since one has succeeded.
    failed: u32,
}

/// Open session with its subscriptions.
struct Open {
    subscriptions: [Subscription; 2],
    session: Session,
    refreshed: Instant,
}

impl Actor for Keeper {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Context<Self>) {
        self.port.resume(Duration::ZERO, context, Keeper::begin);
    }
}

impl Supervised for Keeper {}

impl Handler<Input> for Keeper {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        match input {
            Input::Packet(packet) => self.publish(&packet, context),
            Input::Close => {
                // Flushes what was published last, and tells the router.
                let closed = self.open.take().map(Open::close);
                let closing = async move {
                    if let Some(closed) = closed {
                        let _ = closed.await;
                    }
                };
                context.spawn(closing.into_actor(self).map(|(), _, context| context.stop()));
            }
        }
    }
}

impl Keeper {
    /// Begins to open the session; tries again until that succeeds.
    fn begin(&mut self, context: &mut Context<Self>) {
        // What changed before this attempt is known to it.
        self.worker.shared.remake.store(false, Ordering::Relaxed);
        let zenoh = self.worker.zenoh.clone();
        let opening = elsewhere(move || ::zenoh::open(zenoh).wait());
        context.spawn(opening.into_actor(self).map(|opened, keeper, context| match opened {
            Some(Ok(session)) => keeper.opened(session),
            Some(Err(error)) => keeper.fail(reason(&error), context),
            None => keeper.fail("this machine has no thread left".to_owned(), context),
        }));
    }

    fn fail(&mut self, error: String, context: &mut Context<Self>) {
        self.failed += 1;
        if self.failed.is_power_of_two() {
            let key = &self.worker.config.key;
            tracing::warn!(attempts = self.failed, "no Zenoh session for '{key}' yet: {error}");
        }
        let _ = self.worker.opened.try_send(Err(error));
        context.run_later(RETRY, Keeper::begin);
    }

    fn opened(&mut self, session: Session) {
        self.failed = 0;
        let config = &self.worker.config;
        let subscriptions = [config.key_of_all(), config.key_of(self.worker.host.0)].map(|key| Subscription::new(&key));
        self.open = Some(Open { subscriptions, session, refreshed: Instant::now() });
        self.refresh();
        self.worker.shared.open.store(true, Ordering::Release);
        if self.worker.opened.try_send(Ok(())).is_err() {
            self.worker.news.report(Renewed::Open(format!("the Zenoh session of '{}'", self.worker.config.key)));
        }
    }

    /// Publishes a frame of the control thread, whose first two bytes are the number of its receiver.
    fn publish(&mut self, packet: &[u8], context: &mut Context<Self>) {
        if self.worker.shared.remake.swap(false, Ordering::Relaxed) {
            return self.remake(context);
        }
        let (Some(open), [low, high, frame @ ..]) = (&self.open, packet) else { return };
        let to = u16::from_le_bytes([*low, *high]);
        let config = &self.worker.config;
        let key = if to == TO_ALL { config.key_of_all() } else { config.key_of(to) };
        self.note(publish(&open.session, key, frame));
        // Every host sends link reports several times a second, so this is done as often as needed.
        let heard = open.subscriptions.iter().any(|one| one.ever_heard);
        if open.refreshed.elapsed() >= if heard { REFRESH } else { FIRST_REFRESH } {
            self.refresh();
        }
    }

    fn refresh(&mut self) {
        let (sender, Some(open)) = (self.port.sender(), &mut self.open) else { return };
        open.refreshed = Instant::now();
        let results = open.subscriptions.each_mut().map(|one| one.refresh(&open.session, &sender));
        results.into_iter().for_each(|result| self.note(result));
    }

    /// Closes the session, and opens another.
    fn remake(&mut self, context: &mut Context<Self>) {
        let Some(open) = self.open.take() else { return };
        self.worker.shared.open.store(false, Ordering::Release);
        self.worker.news.report(Renewed::Closed("this machine's address or interface has changed".to_owned()));
        let closed = open.close();
        // A session that listens occupies its port. The end of any other may wait for a router that is not reached any
        // more, so the next session is opened beside it.
        if awaits(&self.worker.zenoh) {
            context.spawn(closed.into_actor(self).map(|_, keeper, context| keeper.begin(context)));
        } else {
            self.begin(context);
        }
    }

    /// Counts and logs a refusal of the library.
    fn note(&self, result: ::zenoh::Result<()>) {
        let Err(error) = result else { return };
        let refused = self.worker.shared.refused.fetch_add(1, Ordering::Relaxed) + 1;
        if refused.is_power_of_two() {
            tracing::warn!(refused, "Zenoh has refused a frame: {}", reason(&error));
        }
    }
}

impl Open {
    /// Begins to close the session, and returns a future that is ready when it is closed.
    fn close(self) -> impl Future<Output = Option<()>> {
        elsewhere(move || {
            drop(self.subscriptions);
            let _ = self.session.close().wait();
        })
    }
}

/// Runs a function that may block on a thread of its own, without an asynchronous runtime, which the library refuses to
/// block in. Returns a future of its result; `None` if it has panicked or there is no thread left.
fn elsewhere<T: Send + 'static>(run: impl FnOnce() -> T + Send + 'static) -> impl Future<Output = Option<T>> {
    let (tx, rx) = oneshot::channel();
    let started = std::thread::Builder::new().name("zenoh".to_owned()).spawn(move || drop(tx.send(run())));
    async move {
        started.ok()?;
        rx.await.ok()
    }
}

/// Publishes a frame. Its key is not declared: with a declared publisher, the library keeps frames back until a router
/// has told it of receivers, which may be lost on the way.
fn publish(session: &Session, key: String, frame: &[u8]) -> ::zenoh::Result<()> {
    let publication = session.put(key, frame);
    let publication = publication.congestion_control(CongestionControl::Drop).priority(Priority::RealTime);
    let publication = publication.express(true).reliability(Reliability::BestEffort);
    publication.allowed_destination(Locality::Remote).wait()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Streams;

    fn session(file: Option<&str>) -> (Result<Config, String>, tempfile::TempDir) {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("zenoh.json5");
        file.iter().for_each(|text| std::fs::write(&path, text).unwrap());
        let from = SessionConfig {
            key: "murmurate/7/air".to_owned(),
            mode: file.is_none().then(|| "client".to_owned()),
            connect: Vec::new(),
            listen: Vec::new(),
            config: file.map(|_| path),
            streams: Streams::Refuse,
            guest: false,
        };
        (configuration(&from), folder)
    }

    fn of(config: &Config, key: &str) -> String {
        config.get_json(key).unwrap()
    }

    #[test]
    fn what_neither_file_sets_is_for_teams() {
        for file in [None, Some("{ mode: \"peer\", connect: { endpoints: [\"udp/10.0.0.1:7447\"] } }")] {
            let (config, _folder) = session(file);
            let config = config.unwrap();
            assert_eq!(of(&config, "scouting/multicast/enabled"), "false");
            assert_eq!(of(&config, "listen/endpoints"), "[]", "Zenoh's own default is a stream");
            assert_eq!(of(&config, "mode"), if file.is_some() { "\"peer\"" } else { "\"client\"" });
        }
        let (config, _folder) = session(Some("{ scouting: { multicast: { enabled: true } } }"));
        let config = config.unwrap();
        assert_eq!(of(&config, "scouting/multicast/enabled"), "true", "the file says so");
        assert_eq!(of(&config, "mode"), "\"client\"", "a router passes nothing on between peers");
    }

    #[test]
    fn streams_and_mistakes_in_a_file_of_zenoh_are_refused() {
        let (config, _folder) = session(Some("{ connect: { endpoints: { client: [\"tcp/10.0.0.1:7447\"] } } }"));
        assert!(config.unwrap_err().starts_with("connect/endpoints: 'tcp/10.0.0.1:7447' is a stream"));
        let (config, _folder) = session(Some("{ listen: { endpoints: [\"udp/10.0.0.1:7447\"] } }"));
        assert!(config.unwrap_err().starts_with("listen/endpoints: a session that listens needs a mode"));
        let (config, _folder) = session(Some("{ conect: {} }"));
        let why = config.unwrap_err();
        assert!(why.contains("zenoh.json5") && !why.contains(".rs:"), "{why}");
    }
}
