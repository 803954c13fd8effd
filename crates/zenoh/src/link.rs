//! Open link of the transport `zenoh`: the control thread's side of a session, which is an actor on a thread of its own
//! behind a bounded channel.

use std::net::SocketAddr;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::Duration;

use nix::sys::eventfd::{EfdFlags, EventFd};

use super::session::{News, Role, Shared, TO_ALL, Worker, awaits, configuration, endpoints, reach, role};
use super::{SessionConfig, Streams, route};
use murmurate::edge::{self, Gate, Running};
use murmurate::fitness::{Finding, Fitness};
use murmurate::messages::ids::HostId;
use murmurate::net::protocol::router::Audience;
use murmurate::net::transport::flood::{Flood, REST};
use murmurate::net::transport::{Counts, In, OpenError, Renewed, Transmit, Transport};
use murmurate::time::Time;

/// Longest wait for a session when a link is opened. Without a router, the host starts all the same.
const OPENING: Duration = Duration::from_millis(1500);
/// Longest wait for the last frames when a link is closed.
const CLOSING: Duration = Duration::from_millis(300);
/// Longest wait of a check for a router to answer.
const CHECKING: Duration = Duration::from_millis(6000);

/// Opens the session of `host`, an actor of its own. Goes on without a router, which may come later.
pub(super) fn open(config: &SessionConfig, host: HostId) -> Result<Box<dyn Transport>, OpenError> {
    let zenoh = configuration(config).map_err(OpenError::Wrong)?;
    let shared = Arc::new(Shared::default());
    let waits = awaits(&zenoh);
    let (opened_tx, opened) = sync_channel(1);
    let not_now = |error: std::io::Error| OpenError::NotNow(error.to_string());
    let flags = EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC;
    let bell = Arc::new(EventFd::from_flags(flags).map_err(|error| not_now(error.into()))?);
    let (queue, news) = sync_channel(8);
    let closed = Arc::new(AtomicBool::new(false));
    route::watch(endpoints(&zenoh), Arc::clone(&shared.remake), Arc::clone(&closed)).map_err(not_now)?;
    let tell = News { queue, bell: Arc::clone(&bell) };
    let worker =
        Worker { config: config.clone(), zenoh, host, shared: Arc::clone(&shared), opened: opened_tx, news: tell };
    let (gate, session) = edge::start(Box::new(worker), "zenoh").map_err(not_now)?;
    let link = Link {
        open: Some((gate, session)),
        shared,
        news,
        bell,
        closed,
        looked: Time::ZERO,
        flood: Flood::default(),
        unsent: 0,
    };
    match opened.recv_timeout(OPENING) {
        Ok(Ok(())) => tracing::info!(key = config.key, "the Zenoh session of a link is open"),
        // It cannot listen: this does not get better by itself.
        Ok(Err(why)) if waits => return Err(OpenError::NotNow(format!("Zenoh: {why}"))),
        _ => tracing::warn!("no Zenoh router answers at {} yet; going on without", config.connect.join(", ")),
    }
    Ok(Box::new(link))
}

/// Checks whether a session gets through from this machine; `link` is the name of the link, for advice.
pub(super) fn check(config: &SessionConfig, link: &str) -> Vec<Finding> {
    let fail = |found: String, advice: String| Finding { fitness: Fitness::Fail, what: "Zenoh", found, advice };
    let zenoh = match configuration(config) {
        Ok(zenoh) => zenoh,
        Err(why) => return vec![fail(why, format!("mend it, or the fields of link.{link}"))],
    };
    let (tx, rx) = sync_channel(1);
    let (waits, role) = (awaits(&zenoh), role(&zenoh));
    thread::spawn(move || tx.send(reach(&zenoh)));
    let places = if config.connect.is_empty() { &config.listen } else { &config.connect }.join(", ");
    let mut found = vec![match rx.recv_timeout(CHECKING) {
        Ok(Ok((0, 0))) if waits => Finding::ok("Zenoh", format!("session open, {places}: none here yet")),
        Ok(Ok((0, 0))) | Err(_) => fail(
            format!("no router answers at {places}"),
            format!("does a Zenoh router run there, and let UDP through? See link.{link}.connect"),
        ),
        Ok(Ok((routers @ 1.., _))) if role == Role::Peer => Finding {
            fitness: Fitness::Warn,
            what: "Zenoh",
            found: format!("session by {places} as a peer of {routers} routers, which pass nothing on between peers"),
            advice: format!("choose link.{link}.mode = \"client\", unless all peers connect to each other"),
        },
        Ok(Ok((routers, peers))) => {
            Finding::ok("Zenoh", format!("session by {places}: {routers} routers, {peers} peers"))
        }
        Ok(Err(why)) if waits => fail(why, "stop what listens there; is this host running already?".to_owned()),
        Ok(Err(why)) => fail(
            format!("no session by {places}: {why}"),
            format!("does a Zenoh router run there, and let UDP through? See link.{link}.connect"),
        ),
    }];
    if config.streams == Streams::Allow {
        let advice = format!("leave out link.{link}.streams where datagrams get through");
        let said = "streams are allowed: a lost packet delays the frames after it".to_owned();
        found.push(Finding { fitness: Fitness::Warn, what: "streams", found: said, advice });
    }
    found
}

/// Open link of the transport `zenoh`.
struct Link {
    /// Channel to the session's actor, and the running actor; `None` while the link is dropped.
    open: Option<(Gate, Running)>,
    shared: Arc<Shared>,
    /// Changes of the session, and what is readable when there are some.
    news: Receiver<Renewed>,
    bell: Arc<EventFd>,
    /// Ends the thread that watches this machine's addresses.
    closed: Arc<AtomicBool>,
    /// Time of the last read.
    looked: Time,
    flood: Flood,
    /// Number of frames that were not sent because there was no session yet.
    unsent: u64,
}

impl Link {
    fn gate(&self) -> &Gate {
        &self.open.as_ref().expect("it is there until the link is dropped").0
    }

    fn gate_mut(&mut self) -> &mut Gate {
        &mut self.open.as_mut().expect("it is there until the link is dropped").0
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.closed.store(true, Ordering::Relaxed);
        let Some((gate, session)) = self.open.take() else { return };
        drop(gate);
        // The last frames may say that this host leaves.
        if self.shared.open.load(Ordering::Acquire) && !session.join(CLOSING) {
            tracing::debug!("a Zenoh session is still closing");
        }
    }
}

impl Transport for Link {
    fn descriptor(&self) -> Rc<dyn AsFd> {
        Rc::new(self.gate().bell())
    }

    fn receive(&mut self, now: Time, take: &mut dyn FnMut(Option<SocketAddr>, &[u8])) {
        let mut count = 0;
        self.looked = now;
        self.gate_mut().take(|packet| {
            count += 1;
            take(None, &packet);
        });
        self.flood.read(now, count);
    }

    fn paused_until(&self) -> Option<Time> {
        self.flood.is_on().then(|| self.looked + REST)
    }

    fn handle(&mut self, _: Time, input: In) {
        let In::Transmit(Transmit { audience, frame, .. }) = input else { return };
        // Frames that wait for a router would be stale once it answers.
        if !self.shared.open.load(Ordering::Acquire) {
            self.unsent += 1;
            return;
        }
        let to = if let Audience::Host(host) = audience { host.0 } else { TO_ALL };
        self.gate_mut().send([&to.to_le_bytes()[..], &frame].concat().into());
    }

    fn counts(&self) -> Counts {
        let (full, dropped) = self.gate().dropped();
        Counts { unsent: self.unsent + full + self.shared.refused.load(Ordering::Relaxed), dropped }
    }

    fn changes(&self) -> Option<Rc<dyn AsFd>> {
        Some(Rc::new(Arc::clone(&self.bell)))
    }

    fn renew(&mut self, tell: &mut dyn FnMut(Renewed)) {
        let _ = self.bell.read();
        self.news.try_iter().for_each(tell);
    }
}
