//! Networks on one lossy link under virtual time, shared by the tests of the link layer. Not a test.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::Arc;

use murmurate::actor::Core;
use murmurate::actors::network::{Config, Identity, In, Network, Out};
use murmurate::messages::geometry::Motion;
use murmurate::messages::ids::{HostId, LinkId, RobotId};
use murmurate::messages::latch::Latch;
use murmurate::messages::wire::{Features, Heartbeat, Kind, Latent, Phase, Round, Wire};
use murmurate::net::media::radio::{Channel, Destination};
use murmurate::net::protocol::codec::TAG_BYTES;
use murmurate::net::protocol::codec::{self, Content, Frame};
use murmurate::net::protocol::key::Key;
use murmurate::net::protocol::link::{DuplicateId, Guest, LinkCounts, Standing};
use murmurate::net::protocol::reliability::{Reliabilities, Setup};
use murmurate::net::protocol::report::Report;
use murmurate::net::protocol::router::{Audience, Route, Router};
use murmurate::net::protocol::sender::Peer;
use murmurate::net::protocol::ways::Ways;
use murmurate::random::{Seed, Stream};
use murmurate::time::{Span, Time};
use rand::RngExt;

pub const LINK: LinkId = LinkId(0);
pub const TEAM: u16 = 7;

pub fn key() -> Key {
    Key::new([42; 32])
}

/// Returns a host that runs the robot of its number: latents go to all other hosts, heartbeats to host 0.
pub fn config(host: u16, robots: usize, incarnation: u32, key: Option<Key>, setup: Setup) -> Config {
    let router = Router::new(robots, |kind, robot| {
        let own = robot.0 == host;
        match kind {
            Kind::Heartbeat => {
                Route { local: host == 0, leaves: (own && host != 0).then_some((LINK, Audience::Host(HostId(0)))) }
            }
            _ => Route { local: !own, leaves: own.then_some((LINK, Audience::All)) },
        }
    });
    Config {
        me: Identity { host: HostId(host), team: TEAM, incarnation },
        key,
        links: vec![Some(setup)],
        router,
        parts: None,
    }
}

pub fn network(config: Config) -> Network {
    network_of_run(config, 0)
}

/// Creates a Network; each run has other random numbers, even with the same incarnation.
pub fn network_of_run(config: Config, run: u64) -> Network {
    let stream = Seed::of_run(u64::from(config.me.host.0)).stream(&format!("network/{run}"));
    Network::new(config, stream)
}

/// Returns the link report of a datagram, if there is one.
pub fn report(frame: &[u8], tag: usize) -> Option<Report> {
    codec::blocks(&frame[..frame.len() - tag]).flatten().find_map(|(content, body)| match content {
        Content::Report | Content::NumberedReport => Report::read(content, body).ok(),
        _ => None,
    })
}

pub fn multicast(kinds: Reliabilities) -> Setup {
    Setup::multicast(kinds)
}

pub fn latent(robot: u16, episode: u32) -> Wire {
    Wire::Latent(Latent {
        robot: RobotId(robot),
        round: Round { term: 1, episode },
        phase: Phase::Running,
        motion: Motion::default(),
        features: Features(Arc::from(vec![0.5; 32])),
        part: None,
    })
}

pub fn heartbeat(robot: u16, episode: u32) -> Wire {
    let round = Round { term: 1, episode };
    Wire::Heartbeat(Heartbeat::new(RobotId(robot), round, Phase::Running, Latch::default()))
}

/// Two hosts, and which datagrams from the first to the second are lost.
pub type Blocked = (usize, usize, fn(&[u8]) -> bool);

/// Datagram that was sent.
#[derive(Clone)]
pub struct Flight {
    pub from: usize,
    pub at: Time,
    pub audience: Audience,
    pub frame: Frame,
    pub bytes: usize,
}

pub struct Rig {
    pub now: Time,
    pub networks: Vec<Network>,
    /// Delivered messages by host, each with its time.
    pub delivered: Vec<Vec<(Time, Wire)>>,
    pub peers: Vec<Vec<Peer>>,
    /// By which ways each host hears the others of a mesh, and sends, as it said last.
    pub ways: Vec<Ways>,
    pub counts: Vec<LinkCounts>,
    /// Host with the same id that each host has detected.
    pub duplicates: Vec<Option<DuplicateId>>,
    /// Number of the roster that each host has kept last, with the time.
    pub rosters: Vec<Option<(Time, u32)>>,
    /// Guests that each host has admitted, in order.
    pub admitted: Vec<Vec<Guest>>,
    /// Id of each host: its index, unless set otherwise.
    pub ids: Vec<HostId>,
    /// All datagrams that were sent.
    pub sent: Vec<Flight>,
    /// Arrivals, each with time and host, if they are recorded.
    pub arrived: Option<Vec<(Time, usize, Frame)>>,
    pub loss: f64,
    pub delay: Span,
    /// Largest random addition to the delay.
    pub jitter: Span,
    /// Relay without the key, which delays datagrams of this host: all of them, or those without a report.
    pub relay: Option<(usize, bool)>,
    /// Source address of each host; none without one.
    pub addresses: Vec<Option<SocketAddr>>,
    /// Addresses of the hosts in the team file. With them, datagrams go where the transport of a unicast link sends
    /// them; otherwise they reach their hosts wherever these are.
    pub configured: Option<Vec<SocketAddr>>,
    /// Which datagrams from the first of two hosts to the second are lost.
    pub blocked: Option<Blocked>,
    /// Host that does not run: nothing leaves or reaches it.
    pub down: Option<usize>,
    /// Inputs of all hosts as a record has them, each with time and host, if they are recorded; `None` is a wake-up.
    pub tape: Option<Vec<(Time, usize, Option<In>)>>,
    /// Hosts that have left a radio channel: nothing of them or for them is on it.
    pub off: BTreeSet<usize>,
    /// Radio channel that takes the place of loss, delay and jitter.
    pub radio: Option<Channel<(usize, Frame)>>,
    flying: BTreeMap<(Time, u64), (usize, usize, Frame)>,
    /// Wake-up times of the hosts.
    wakes: BTreeSet<(Time, usize)>,
    wake_of: Vec<Option<Time>>,
    count: u64,
    runs: u64,
    stream: Stream,
}

impl Rig {
    pub fn new(configs: impl IntoIterator<Item = Config>) -> Rig {
        let (mut ids, mut networks) = (Vec::new(), Vec::new());
        for config in configs {
            ids.push(config.me.host);
            networks.push(network_of_run(config, networks.len() as u64));
        }
        let count = networks.len();
        let mut rig = Rig {
            now: Time::ZERO,
            delivered: vec![Vec::new(); count],
            peers: vec![Vec::new(); count],
            ways: vec![Ways::default(); count],
            counts: vec![LinkCounts::default(); count],
            duplicates: vec![None; count],
            rosters: vec![None; count],
            admitted: vec![Vec::new(); count],
            ids,
            runs: count as u64,
            networks,
            sent: Vec::new(),
            arrived: None,
            wakes: BTreeSet::new(),
            wake_of: vec![None; count],
            loss: 0.0,
            delay: Span::from_nanos(300_000),
            jitter: Span::ZERO,
            relay: None,
            addresses: vec![None; count],
            configured: None,
            blocked: None,
            down: None,
            tape: None,
            off: BTreeSet::new(),
            radio: None,
            flying: BTreeMap::new(),
            count: 0,
            stream: Seed::of_run(5).stream("pipe"),
        };
        (0..count).for_each(|host| rig.plan(host));
        rig
    }

    /// Creates `count` hosts with a key on a multicast link.
    pub fn team(count: u16, kinds: Reliabilities) -> Rig {
        Rig::new((0..count).map(|host| config(host, count.into(), 1, Some(key()), multicast(kinds.clone()))))
    }

    fn act(&mut self, host: usize, act: impl FnOnce(&mut Network, Time, &mut Vec<Out>)) {
        let (mut out, mut kept) = (Vec::new(), Vec::new());
        act(&mut self.networks[host], self.now, &mut out);
        self.plan(host);
        for said in out {
            match said {
                Out::Deliver(message) => self.delivered[host].push((self.now, message)),
                Out::Counts(counts) => self.counts[host] = *counts,
                Out::Peers(peers, ways) => (self.peers[host], self.ways[host]) = (peers, *ways),
                Out::Duplicate(duplicate) => self.duplicates[host] = Some(duplicate),
                Out::Admit(_, guest) => self.admitted[host].push(guest),
                Out::Keep(number, _) => kept.push(number),
                Out::Refused(link, cause, _) => {
                    if let Some((.., input)) = self.tape.as_mut().and_then(|tape| tape.last_mut()) {
                        *input = Some(In::Refused(link, cause, 1));
                    }
                }
                Out::Tap(_) | Out::Keys(_) | Out::Roster(_) => {}
                Out::Transmit(_, audience, frame) => {
                    let bytes = frame.len();
                    self.sent.push(Flight { from: host, at: self.now, audience, frame: frame.clone(), bytes });
                    let held = |(from, all)| from == host && (all || is_held(&frame));
                    if self.relay.is_some_and(held) {
                        continue;
                    }
                    if self.off.contains(&host) {
                        continue;
                    }
                    if let Some(radio) = &mut self.radio {
                        let all = || (0..self.networks.len() as u16).filter(|to| usize::from(*to) != host).collect();
                        let to = match audience {
                            Audience::Host(id) => Destination::One(id.0),
                            _ => Destination::Many(all()),
                        };
                        let station = u16::try_from(host).expect("few hosts");
                        radio.offer(self.now, station, to, bytes, (host, frame));
                        continue;
                    }
                    for to in 0..self.networks.len() {
                        let meant = audience == Audience::All || audience == Audience::Host(self.ids[to]);
                        let blocked = |(from, at, lost): Blocked| (from, at) == (host, to) && lost(&frame);
                        let blocked = self.blocked.is_some_and(blocked)
                            || self.down.is_some_and(|down| down == host || down == to);
                        if to != host
                            && meant
                            && !blocked
                            && self.is_sent_to(host, to, &frame)
                            && !self.stream.random_bool(self.loss)
                        {
                            let jitter = match self.jitter.as_nanos() {
                                0 => Span::ZERO,
                                most => Span::from_nanos(self.stream.random_range(0..most)),
                            };
                            self.flying.insert((self.now + self.delay + jitter, self.count), (host, to, frame.clone()));
                            self.count += 1;
                        }
                    }
                }
            }
        }
        for number in kept {
            self.rosters[host] = Some((self.now, number));
            let kept =
                |network: &mut Network, now: Time, out: &mut Vec<Out>| network.handle(now, In::Kept(number), out);
            self.act(host, Box::new(kept) as Box<dyn FnOnce(&mut Network, Time, &mut Vec<Out>)>);
        }
    }

    /// Whether the transport of the host `from` sends a datagram to where the host `to` is: to the address from which
    /// it was last accepted, or else to that of the team file; reports also to all from which it was a candidate.
    fn is_sent_to(&self, from: usize, to: usize, frame: &[u8]) -> bool {
        let (Some(configured), Some(is)) = (&self.configured, self.addresses[to]) else { return true };
        let told = || self.admitted[from].iter().filter(|guest| guest.host == self.ids[to]);
        let accepted = told().rfind(|guest| guest.standing == Standing::Accepted);
        accepted.map_or(configured[to], |guest| guest.at) == is
            || (is_report(frame) && told().any(|guest| guest.at == is))
    }

    fn plan(&mut self, host: usize) {
        let wake = self.networks[host].wake_at();
        if let Some(before) = std::mem::replace(&mut self.wake_of[host], wake) {
            self.wakes.remove(&(before, host));
        }
        self.wakes.extend(wake.map(|at| (at, host)));
    }

    pub fn publish(&mut self, host: usize, message: Wire) {
        self.take(host, In::Publish(message));
    }

    pub fn arrive(&mut self, host: usize, frame: &[u8]) {
        self.arrive_from(host, frame, None);
    }

    /// Delivers a datagram from this address.
    pub fn arrive_from(&mut self, host: usize, frame: &[u8], from: Option<SocketAddr>) {
        self.take(host, In::Frame(LINK, frame.into(), from));
    }

    fn take(&mut self, host: usize, input: In) {
        self.note(host, Some(&input));
        self.act(host, |network, now, out| network.handle(now, input, out));
    }

    fn note(&mut self, host: usize, input: Option<&In>) {
        let now = self.now;
        self.tape.iter_mut().for_each(|tape| tape.push((now, host, input.cloned())));
    }

    /// Advances the time by this many milliseconds.
    pub fn run_ms(&mut self, ms: u64) {
        let end = self.now + Span::from_millis(ms);
        self.run_to(end);
    }

    /// Advances the time to `end`.
    pub fn run_to(&mut self, end: Time) {
        loop {
            let wake = self.wakes.first().copied();
            let flight = self.flying.keys().next().copied();
            let channel = self.radio.as_ref().and_then(Channel::wake_at);
            let next = [wake.map(|(at, _)| at), flight.map(|(at, _)| at), channel].into_iter().flatten().min();
            let Some(next) = next.filter(|next| *next <= end) else { break };
            self.now = self.now.max(next);
            if let Some(radio) = self.radio.as_mut().filter(|_| channel == Some(next)) {
                let mut deliveries = Vec::new();
                radio.wake(next, &mut deliveries);
                for delivery in deliveries {
                    let (from, frame) = delivery.token;
                    if self.off.contains(&usize::from(delivery.to)) {
                        continue;
                    }
                    self.arrive_from(usize::from(delivery.to), &frame, self.addresses[from]);
                }
            } else if let Some(flight) = flight.filter(|(at, _)| *at <= next) {
                let (from, to, frame) = self.flying.remove(&flight).expect("it flies");
                if let Some(arrived) = &mut self.arrived {
                    arrived.push((self.now, to, frame.clone()));
                }
                self.arrive_from(to, &frame, self.addresses[from]);
            } else if let Some((_, host)) = wake {
                self.note(host, None);
                self.act(host, |network, now, out| network.wake(now, out));
            }
        }
        self.now = end;
    }

    /// Returns the counts of a host at the next full second.
    pub fn counted(&mut self, host: usize) -> LinkCounts {
        let second = Time::ZERO + Span::from_secs(self.now.as_secs().floor() + 1.0);
        self.run_to(second);
        self.counts[host]
    }

    /// Makes all hosts accept each other: each sends three messages.
    pub fn meet(&mut self) {
        for _ in 0..3 {
            for host in 0..self.networks.len() {
                let robot = u16::try_from(host).expect("few hosts");
                self.publish(host, latent(robot, 0));
            }
            let next = self.now + Span::from_millis(20);
            self.run_to(next);
        }
        self.delivered.iter_mut().for_each(Vec::clear);
    }

    /// Restarts a host with this configuration.
    pub fn restart(&mut self, host: usize, config: Config) {
        self.runs += 1;
        self.ids[host] = config.me.host;
        self.networks[host] = network_of_run(config, self.runs);
        self.admitted[host].clear();
        self.plan(host);
    }

    /// Returns the newest datagram of a host.
    pub fn last_of(&self, host: usize) -> Vec<u8> {
        self.sent.iter().rev().find(|flight| flight.from == host).expect("it has sent something").frame.to_vec()
    }

    /// Returns the newest datagram of a host with data.
    pub fn last_data(&self, host: usize) -> Frame {
        let data = |flight: &&Flight| flight.from == host && is_data(&flight.frame);
        self.sent.iter().rev().find(data).expect("it has sent something").frame.clone()
    }
}

/// Whether a relay that passes reports delays this datagram: data without a report.
pub fn is_held(frame: &[u8]) -> bool {
    is_data(frame) && report(frame, TAG_BYTES).is_none()
}

/// Whether a datagram holds data, and not only soft state.
pub fn is_data(frame: &[u8]) -> bool {
    matches!(codec::first(frame), Ok(Content::Message(kind)) if !matches!(kind, Kind::Heartbeat | Kind::Mode))
}

/// Whether a datagram holds a link report and nothing before it, so that candidates get it.
pub fn is_report(frame: &[u8]) -> bool {
    matches!(codec::first(frame), Ok(Content::Report | Content::NumberedReport))
}
