//! Thread of a Zenoh session: opens it, tries again while no router answers, publishes the frames of the control
//! thread, and passes on those of others. The only file that calls the Zenoh library.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use ::zenoh::pubsub::Subscriber;
use ::zenoh::qos::{CongestionControl, Priority, Reliability};
use ::zenoh::sample::Locality;
use ::zenoh::{Config, Session, Wait};
use nix::sys::eventfd::EventFd;

use super::route::Endpoints;
use super::{SessionConfig, check_endpoint};
use murmurate::edge::{PacketSender, Port};
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

/// End of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// The control thread has closed the channel.
    Closed,
    /// The session is to be made again.
    Remade,
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

/// Session of one host on one link, on its own thread.
pub(super) struct Worker {
    /// Configuration of the session.
    pub config: SessionConfig,
    /// The same for the library.
    pub zenoh: Config,
    /// Host that this process is.
    pub host: HostId,
    /// State that the control thread reads.
    pub shared: Arc<Shared>,
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

impl Worker {
    /// Runs the session until the control thread closes `port`, and makes it again when the machine's address has
    /// changed. The first attempt's result goes to `opened`, and each later change of the session to `news`.
    pub fn run(self, mut port: Port, opened: &SyncSender<Result<(), String>>, news: &News) {
        let sender = port.sender();
        while let Some(session) = self.open(&sender, opened) {
            let keys = [self.config.key_of_all(), self.config.key_of(self.host.0)];
            let mut subscriptions = keys.map(|key| Subscription::new(&key));
            self.refresh(&mut subscriptions, &session, &sender);
            self.shared.open.store(true, Ordering::Release);
            if opened.try_send(Ok(())).is_err() {
                news.report(Renewed::Open(format!("the Zenoh session of '{}'", self.config.key)));
            }
            let end = self.publish_all(&session, &mut subscriptions, &mut port);
            if end == End::Closed {
                // Flushes what was published last, and tells the router.
                let _ = session.close().wait();
                return;
            }
            self.shared.open.store(false, Ordering::Release);
            news.report(Renewed::Closed("this machine's address or interface has changed".to_owned()));
            // A session that listens occupies its port. The end of any other may wait for a router that is not reached
            // any more, so nobody waits for it.
            if awaits(&self.zenoh) {
                drop(subscriptions);
                let _ = session.close().wait();
            } else {
                std::thread::spawn(move || {
                    drop(subscriptions);
                    let _ = session.close().wait();
                });
            }
        }
    }

    /// Publishes the frames of the control thread until it closes the channel, or until the session has to be made
    /// again.
    fn publish_all(&self, session: &Session, subscriptions: &mut [Subscription], port: &mut Port) -> End {
        let sender = port.sender();
        let mut refreshed = Instant::now();
        while let Some(packet) = port.wait() {
            if self.shared.remake.swap(false, Ordering::Relaxed) {
                return End::Remade;
            }
            let to = u16::from_le_bytes([packet[0], packet[1]]);
            self.note(self.publish(session, to, &packet[2..]));
            // Every host sends link reports several times a second, so this is done as often as needed.
            let period = if subscriptions.iter().any(|one| one.ever_heard) { REFRESH } else { FIRST_REFRESH };
            if refreshed.elapsed() >= period {
                refreshed = Instant::now();
                self.refresh(subscriptions, session, &sender);
            }
        }
        End::Closed
    }

    fn refresh(&self, subscriptions: &mut [Subscription], session: &Session, sender: &PacketSender) {
        subscriptions.iter_mut().for_each(|one| self.note(one.refresh(session, sender)));
    }

    /// Counts and logs a refusal of the library.
    fn note(&self, result: ::zenoh::Result<()>) {
        let Err(error) = result else { return };
        let refused = self.shared.refused.fetch_add(1, Ordering::Relaxed) + 1;
        if refused.is_power_of_two() {
            tracing::warn!(refused, "Zenoh has refused a frame: {}", reason(&error));
        }
    }

    /// Opens the session; tries again until that succeeds. Returns `None` once the control thread has closed the
    /// channel.
    fn open(&self, sender: &PacketSender, opened: &SyncSender<Result<(), String>>) -> Option<Session> {
        let mut failed: u32 = 0;
        while !sender.is_closed() {
            // What changed before this attempt is known to it.
            self.shared.remake.store(false, Ordering::Relaxed);
            let error = match ::zenoh::open(self.zenoh.clone()).wait() {
                Ok(session) => return Some(session),
                Err(error) => reason(&error),
            };
            failed += 1;
            if failed.is_power_of_two() {
                tracing::warn!(attempts = failed, "no Zenoh session for '{}' yet: {error}", self.config.key);
            }
            let _ = opened.try_send(Err(error));
            std::thread::park_timeout(RETRY);
        }
        None
    }

    /// Publishes a frame. Its key is not declared: with a declared publisher, the library keeps frames back until a
    /// router has told it of receivers, which may be lost on the way.
    fn publish(&self, session: &Session, to: u16, frame: &[u8]) -> ::zenoh::Result<()> {
        let key = if to == TO_ALL { self.config.key_of_all() } else { self.config.key_of(to) };
        let publication = session.put(key, frame);
        let publication = publication.congestion_control(CongestionControl::Drop).priority(Priority::RealTime);
        let publication = publication.express(true).reliability(Reliability::BestEffort);
        publication.allowed_destination(Locality::Remote).wait()
    }
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
