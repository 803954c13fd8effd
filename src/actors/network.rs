//! Network: passes all wire messages from and to one host. For each message it decides whether actors of this host
//! receive it, on which link it leaves, or both.
//!
//! Each published message is encoded once; the same bytes go to the links and to the Recorder. An arriving datagram is
//! checked, decoded and delivered, or counted and dropped. `net::protocol::link` handles transmission, retransmission
//! and authentication, `parts` messages that are too large for a datagram, and `rosters` the change of keys.

mod addresses;
mod mesh;
mod parts;
mod rosters;

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;

use self::addresses::Addresses;
use self::mesh::Mesh;
use self::parts::Parts;
use crate::actor::Core;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{Kind, Wire};
use crate::net::protocol::codec::{self, Flags, Frame, Header};
use crate::net::protocol::key::Key;
pub use crate::net::protocol::link::Identity;
use crate::net::protocol::link::{DuplicateId, Guest, LinkCounts, LinkState, Refusal};
use crate::net::protocol::outgoing::Outbound;
use crate::net::protocol::parts::Settings as PartSettings;
use crate::net::protocol::reliability::{Piggyback, Setup};
use crate::net::protocol::roster::Roster;
use crate::net::protocol::router::{Audience, Route, Router};
use crate::net::protocol::sender::Peer;
use crate::net::protocol::succession::Succession;
use crate::net::protocol::ways::Ways;
use crate::random::Stream;
use crate::time::{Span, Time};

/// Input message of a Network, the actor that sends and receives one host's messages on its links.
#[derive(Clone, Debug)]
pub enum In {
    /// Message that an actor of this host publishes.
    Publish(Wire),
    /// Datagram that was received on the link, with its source address unless the link is emulated.
    Frame(LinkId, Frame, Option<SocketAddr>),
    /// Number of datagrams that a transport of the link has dropped because a queue was full, since it last told.
    Dropped(LinkId, u64),
    /// Number of datagrams that were refused on the link for this cause, in a replay: they had no other effect.
    Refused(LinkId, Refusal, u64),
    /// The roster with this number, which the Network has put out, is on disk.
    Kept(u32),
}

/// Output message of a Network, the actor that sends and receives one host's messages on its links.
#[derive(Clone, Debug)]
pub enum Out {
    /// Message for those actors of this host that handle messages of its kind.
    Deliver(Wire),
    /// Datagram that the transport of the given link has to send, to all hosts or to one.
    Transmit(LinkId, Audience, Frame),
    /// Copy of the datagram of a message that this host has published, without its authentication tag, for the
    /// Recorder.
    Tap(Frame),
    /// Numbers of datagrams that were sent, received and refused since the start of the Network, summed over all links
    /// of the host, for the Recorder.
    Counts(Box<LinkCounts>),
    /// Other hosts on links with link reports, with what is known of each (incarnation, delay, loss), and by which ways
    /// this host hears and sends, for display.
    Peers(Vec<Peer>, Box<Ways>),
    /// Another live host has the id of this host and was started earlier. Sent once.
    Duplicate(DuplicateId),
    /// Datagram that was refused on the link without any effect but its count, for the record of the host.
    Refused(LinkId, Refusal, Frame),
    /// Roster with this number, as it was sent, that has to be on disk before it is in force.
    Keep(u32, Frame),
    /// Keys that are in force from now on.
    Keys(Box<Key>),
    /// Roster that is in force; said once a second, unless it is that of the key files.
    Roster(Box<Roster>),
    /// Address from which a datagram of an operator (host outside the deployment) has arrived, or of a host of the team
    /// for the first time, at another address, or half a second after the last such output. The transport of the link
    /// then sends to that address.
    Admit(LinkId, Guest),
}

/// Largest delay that a Network accepts for the timers of its links, so that several timers share one wake-up: a tenth
/// of the period of link reports.
const MAX_LATE: Span = Span::from_millis(25);
/// Period at which a Network sends the counts of its links to the Recorder.
pub(crate) const COUNTS_PERIOD: Span = Span::from_millis(1000);

/// Configuration of a Network, the actor that sends and receives one host's messages on its links.
#[derive(Clone, Debug)]
pub struct Config {
    /// Identity of this host: its id, team number and incarnation.
    pub me: Identity,
    /// Key that authenticates the team's datagrams; with `None`, datagrams are neither tagged nor authenticated.
    pub key: Option<Key>,
    /// Settings of this host's end of each link, in the order of the deployment's links; `None` for a link on which
    /// this host neither sends nor receives.
    pub links: Vec<Option<Setup>>,
    /// Routing table of this host, which says where each message goes.
    pub router: Router,
    /// Settings for messages in parts; `None` if those of the team fit into a datagram.
    pub parts: Option<PartSettings>,
}

/// Network: the actor of one host that sends the messages of the host's other actors on its links, and receives those
/// of other hosts.
#[derive(Debug)]
pub struct Network {
    router: Router,
    links: Vec<Option<LinkState>>,
    /// Time at which each link is due. Kept apart from the links, which are large, as it is read after every message.
    due: Vec<Option<Time>>,
    /// For each link: whether all datagrams on it reach every host.
    shared: Vec<bool>,
    addresses: Addresses,
    /// Header of the next datagram with a message that leaves on no link (it stays on this host). `local_counts` counts
    /// such datagrams.
    local_header: Header,
    local_counts: LinkCounts,
    stream: Stream,
    outgoing: Vec<Outbound>,
    next_counts: Time,
    /// Whether [`Out::Duplicate`] was sent: another live host with this host's id.
    duplicate_reported: bool,
    /// Whether this host is an operator, whose user waits for an answer.
    is_operator: bool,
    /// Whether the counts were sent at once because the team has another key than this operator.
    key_reported: bool,
    unauthorized: UnauthorizedPublishers,
    key: Option<Key>,
    succession: Succession,
    parts: Option<Parts>,
    mesh: Option<Mesh>,
    /// Whether the log has said that another robot runs another policy.
    mixed_reported: bool,
}

/// Counts of messages that hosts of the team sent without the right to publish them, by sender and kind.
#[derive(Debug, Default)]
struct UnauthorizedPublishers(BTreeMap<(String, Kind), u64>);

impl UnauthorizedPublishers {
    /// Largest number of pairs of sender and kind of message for which unauthorized messages are counted.
    const MAX_ENTRIES: usize = 256;

    /// Counts a message that host `name` sent without the right to publish it, and logs an error at the counts 1, 2, 4,
    /// 8, ... of this sender and kind.
    #[cold]
    fn note(&mut self, name: &str, message: &Wire) {
        let (key, full) = ((name.to_owned(), message.kind()), self.0.len() >= UnauthorizedPublishers::MAX_ENTRIES);
        if full && !self.0.contains_key(&key) {
            return;
        }
        let times = self.0.entry(key).or_default();
        *times += 1;
        if times.is_power_of_two() {
            let (kind, robot) = (message.kind(), message.robot());
            tracing::error!("{name} sent {kind:?} about {robot}, which it may not publish: refused ({times} times)");
        }
    }
}

impl Network {
    /// Creates the Network of a host that has just started. `stream` is the random stream of its links: of the
    /// waits before requests for retransmission, of the first report's time, and of the number at which stamps begin.
    pub fn new(config: Config, mut stream: Stream) -> Network {
        let Config { me, key, links, router, parts } = config;
        let shared =
            links.iter().map(|setup| setup.as_ref().is_some_and(|setup| setup.piggyback == Piggyback::Any)).collect();
        let ids = (0..=u16::MAX).map(LinkId);
        let is_mesh = |setup: &Option<Setup>| setup.as_ref().is_some_and(|setup| setup.mesh);
        let server = router.server();
        let meshes = ids.clone().zip(&links).filter(|(_, setup)| is_mesh(setup)).map(|(id, _)| id).collect();
        let mesh = Mesh::new(me, meshes, server, &mut stream);
        let hosts = router.hosts();
        // A host may run the agents of all robots.
        let more = parts.map_or(0.0, |parts| parts.datagrams_per_s(router.robots()));
        let mut state = |id, setup: Setup| {
            let rate = setup.rate.map(|rate| rate.with(more));
            LinkState::new(me, id, key.clone(), Setup { hosts, rate, ..setup }, &mut stream)
        };
        let links: Vec<Option<LinkState>> =
            ids.zip(links).map(|(id, setup)| setup.map(|setup| state(id, setup))).collect();
        let due = links.iter().map(|link| link.as_ref().and_then(LinkState::due)).collect();
        let Identity { host, team, incarnation } = me;
        let local_header = Header { flags: codec::Flags::default(), team, sender: host, incarnation, sequence: 0 };
        let local_counts = LinkCounts::default();
        let (outgoing, next_counts, duplicate_reported) = (Vec::new(), Time::ZERO, false);
        Network {
            router,
            links,
            due,
            shared,
            addresses: Addresses::default(),
            local_header,
            local_counts,
            stream,
            outgoing,
            next_counts,
            duplicate_reported,
            is_operator: host.is_operator(),
            key_reported: false,
            unauthorized: UnauthorizedPublishers::default(),
            succession: Succession::new(key.as_ref()),
            key,
            parts: parts.map(Parts::new),
            mesh,
            mixed_reported: false,
        }
    }

    /// Returns the counts of all links of this host together.
    fn counts(&self) -> LinkCounts {
        let entries = self.mesh.as_ref().map(Mesh::counts);
        self.links.iter().flatten().map(LinkState::counted).chain([self.local_counts]).chain(entries).sum()
    }

    fn link(&mut self, link: LinkId) -> Option<&mut LinkState> {
        self.links.get_mut(usize::from(link.0))?.as_mut()
    }

    /// Returns a message as it leaves: an operator signs what ends a stop or a hold, for the runs of the hosts that it
    /// hears.
    fn signed(&self, message: Wire) -> Wire {
        let (Wire::Stop(stop), Some(signatures)) = (&message, self.key.as_ref().and_then(Key::signatures)) else {
            return message;
        };
        let hosts: BTreeSet<(HostId, u32)> = self.links.iter().flatten().flat_map(LinkState::hosts).collect();
        signatures.signed(self.local_header.team, *stop, hosts.into_iter())
    }

    fn publish(&mut self, now: Time, message: Wire, out: &mut Vec<Out>) {
        let message = self.signed(message);
        let route = self.router.route(message.kind(), message.robot());
        self.note_latch(now, self.local_header.sender, &message);
        self.say_across_hops(now, &message);
        if self.send(now, route, &message, out) && route.local {
            out.push(Out::Deliver(message));
        }
    }

    /// Sends a message on the link of its route, if it has one, and gives a copy to the Recorder. Returns whether the
    /// message could be encoded.
    fn send(&mut self, now: Time, route: Route, message: &Wire, out: &mut Vec<Out>) -> bool {
        let across = message.kind().is_soft() && message.kind().crosses_hops();
        let leaves = route.leaves.filter(|(link, _)| self.link(*link).is_some());
        // On a mesh it is an entry.
        let leaves = leaves.filter(|(link, _)| !(across && self.is_mesh(*link)));
        let encoded = match leaves {
            Some((link, audience)) => {
                self.carry(now, link, message);
                let state = self.links[usize::from(link.0)].as_mut().expect("this host takes part in the link");
                let encoded = state.send(now, audience, message, &mut self.outgoing);
                self.due[usize::from(link.0)] = state.due();
                transmit(link, &mut self.outgoing, out);
                self.have_carried(now, link);
                encoded
            }
            None => codec::encode(&self.local_header, message).inspect(|_| {
                self.local_header.sequence = self.local_header.sequence.wrapping_add(1);
                self.local_counts.sent += 1;
            }),
        };
        let encoded = encoded.map(|frame| out.push(Out::Tap(frame)));
        encoded.inspect_err(|error| self.count_unencodable(leaves.map(|(link, _)| link), message, error)).is_ok()
    }

    /// Counts a message of this host that cannot be encoded, and logs the first one.
    #[cold]
    fn count_unencodable(&mut self, leaves: Option<LinkId>, message: &Wire, error: &codec::EncodeError) {
        let state = leaves.and_then(|link| self.links[usize::from(link.0)].as_mut());
        let counts = state.map_or(&mut self.local_counts, LinkState::counts);
        counts.unfit += 1;
        if counts.unfit == 1 {
            tracing::error!(robot = message.robot().0, "not sent: {error}; further ones are only counted");
        }
    }

    fn receive(&mut self, now: Time, (link, from): (LinkId, Option<SocketAddr>), frame: &Frame, out: &mut Vec<Out>) {
        if codec::roster_of(frame).is_some() {
            return self.take_roster(now, link, frame, out);
        }
        let at = usize::from(link.0);
        let Some(state) = self.links.get_mut(at).and_then(Option::as_mut) else { return };
        let admitted = state.admit(now, frame, &mut self.stream, &mut self.outgoing);
        self.due[at] = state.due();
        if let (Some(heard), Some(from), true) = (state.heard(), from, !self.shared[at] || state.chooses()) {
            out.extend(self.addresses.admit(now, (link, from), heard, state).map(|guest| Out::Admit(link, guest)));
            self.due[at] = state.due();
        }
        if let Some(cause) = state.refusal() {
            if !self.misses_roster(now, cause, frame) {
                out.push(Out::Refused(link, cause, Frame::clone(frame)));
            }
            return;
        }
        if let Some(duplicate) = state.duplicate().filter(|_| !self.duplicate_reported) {
            self.duplicate_reported = true;
            out.push(Out::Duplicate(duplicate));
        }
        transmit(link, &mut self.outgoing, out);
        if let Some(stop) = state.urgent()
            && self.router.route(Kind::Stop, RobotId(0)).local
        {
            out.push(Out::Deliver(Wire::Stop(stop)));
            self.note_latch(now, stop.by, &Wire::Stop(stop));
        }
        let state = self.links[at].as_mut().expect("the datagram has come by it");
        if admitted.is_none() && self.is_operator && !self.key_reported && state.counted().key_trouble().is_some() {
            self.key_reported = true;
            out.push(Out::Counts(Box::new(self.counts())));
            return;
        }
        let Some((header, plain)) = admitted else { return };
        if !state.lacking().is_empty() {
            self.note_lacking(now, link);
        }
        self.hear_entries(now, (link, header.sender), &plain, out);
        for (kind, body, signature) in codec::messages(&plain) {
            let state = self.links[at].as_mut().expect("the datagram has come by it");
            let message = match codec::message(kind, body) {
                Ok(message) => message,
                // The rest of a datagram is not accepted after a malformed message.
                Err(error) => return state.refuse(&error),
            };
            if let Some(name) = self.router.forbids(header.sender, &message) {
                state.counts().misrouted += 1;
                self.unauthorized.note(&name, &message);
                continue;
            }
            let robot = message.robot();
            if self.router.route(kind, robot).local {
                if !state.accept(now, &header, &message, (body, signature)) {
                    continue;
                }
                self.note_direct(now, header.sender, &message);
                match message {
                    Wire::Latent(part) if part.part.is_some() => self.take_part(now, (link, &header), part, out),
                    message => out.push(Out::Deliver(message)),
                }
            } else if self.shared[at] || !header.flags.has(Flags::DIRECT) {
                // Not for an actor of this host, but it reaches every host: counted as not addressed to it.
                state.counts().aside += 1;
            } else {
                state.counts().misrouted += 1;
            }
        }
    }
}

fn transmit(link: LinkId, outgoing: &mut Vec<Outbound>, out: &mut Vec<Out>) {
    out.extend(outgoing.drain(..).map(|(audience, frame)| Out::Transmit(link, audience, frame)));
}

impl Core for Network {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Publish(Wire::Latent(latent)) if self.is_in_parts(&latent) => self.publish_in_parts(now, latent, out),
            In::Publish(message) => self.publish(now, message, out),
            In::Frame(link, frame, from) => self.receive(now, (link, from), &frame, out),
            In::Refused(link, cause, count) => {
                if let Some(state) = self.link(link) {
                    state.counts().refuse(cause, count);
                }
            }
            In::Dropped(link, count) => {
                if let Some(state) = self.link(link) {
                    state.counts().queue += count;
                }
            }
            In::Kept(number) => self.change_roster(now, number, out),
        }
    }

    fn wake_at(&self) -> Option<Time> {
        let parts = self.parts.as_ref().and_then(Parts::due);
        let mesh = self.mesh.as_ref().and_then(Mesh::due);
        let due = self.due.iter().flatten().copied().chain(self.succession.due()).chain(parts).chain(mesh);
        Some(due.fold(self.next_counts, Time::min))
    }

    fn tolerance(&self, ahead: Span) -> Span {
        // Proportional to the wait: a retransmission due in 4 ms may be 0.5 ms late, soft state due much later 12 ms.
        Span::from_nanos(ahead.as_nanos() / 8).min(MAX_LATE)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        for (state, id) in self.links.iter_mut().zip((0..=u16::MAX).map(LinkId)) {
            let Some(state) = state else { continue };
            state.wake(now, &mut self.stream, &mut self.outgoing);
            self.due[usize::from(id.0)] = state.due();
            transmit(id, &mut self.outgoing, out);
        }
        if self.parts.as_ref().and_then(Parts::due).is_some_and(|due| due <= now) {
            self.wake_parts(now, out);
        }
        self.wake_mesh(now, out);
        if self.succession.due().is_some_and(|due| due <= now) {
            self.go_on_with_roster(now, out);
        }
        if self.next_counts <= now {
            self.tell_roster(out);
            out.push(Out::Counts(Box::new(self.counts())));
            let mut peers: Vec<Peer> = self.links.iter().flatten().flat_map(|link| link.peers(now)).collect();
            self.note_withholders(now, &mut peers);
            let ways = self.ways(now);
            if !peers.is_empty() || !ways.are_plain() {
                out.push(Out::Peers(peers, Box::new(ways)));
            }
            self.next_counts = now.next_on_grid(Span::ZERO, COUNTS_PERIOD);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::messages::wire::Reading;
    use crate::net::protocol::reliability::Reliabilities;
    use crate::random::Seed;

    const LINK: LinkId = LinkId(0);

    /// Network of a host with robot 0; robot 1 runs elsewhere.
    fn network(host: u16, team: u16) -> Network {
        let router = Router::new(2, |kind, robot| Route {
            local: kind == Kind::Reading && robot == RobotId(0),
            leaves: (robot == RobotId(1)).then_some((LINK, Audience::Host(HostId(9)))),
        });
        let me = Identity { host: HostId(host), team, incarnation: 1 };
        let links = vec![Some(Setup::emulated(Reliabilities::new()))];
        Network::new(Config { me, key: None, links, router, parts: None }, Seed::of_run(1).stream("network"))
    }

    fn reading(robot: u16) -> Wire {
        Wire::Reading(Reading::of_point(RobotId(robot), 1, Motion::default()))
    }

    fn handle(network: &mut Network, input: In) -> Vec<Out> {
        let mut out = Vec::new();
        network.handle(Time::ZERO, input, &mut out);
        out
    }

    fn frame(network: &mut Network, robot: u16) -> Frame {
        let out = handle(network, In::Publish(reading(robot)));
        let tapped = out.into_iter().find_map(|said| if let Out::Tap(frame) = said { Some(frame) } else { None });
        tapped.expect("everything that is published is tapped")
    }

    #[test]
    fn a_message_goes_where_the_table_says() {
        let mut network = network(1, 0);
        let out = handle(&mut network, In::Publish(reading(0)));
        assert!(matches!(&out[..], [Out::Tap(_), Out::Deliver(_)]), "{out:?}");
        let out = handle(&mut network, In::Publish(reading(1)));
        assert!(matches!(&out[..], [Out::Transmit(LINK, Audience::Host(HostId(9)), _), Out::Tap(_)]), "{out:?}");
        assert!(handle(&mut network, In::Publish(reading(2))).len() == 1, "nobody takes it; it is tapped all the same");
    }

    #[test]
    fn a_frame_is_let_in_once_or_counted() {
        let (mut here, mut there) = (network(1, 0), network(2, 0));
        let sound = frame(&mut there, 0);
        assert!(matches!(&handle(&mut here, In::Frame(LINK, sound.clone(), None))[..], [Out::Deliver(_)]));
        let other_team = frame(&mut network(3, 5), 0);
        let own = frame(&mut network(1, 0), 0);
        let elsewhere = frame(&mut there, 1);
        let mut version = sound.to_vec();
        version[0] += 1;
        let cut: Frame = sound[..sound.len() - 1].into();
        for refused in [sound, other_team, own, elsewhere, version.into(), cut] {
            let out = handle(&mut here, In::Frame(LINK, refused, None));
            assert!(out.iter().all(|told| matches!(told, Out::Refused(..))), "{out:?}");
        }
        let mut out = Vec::new();
        here.wake(Time::ZERO, &mut out);
        let [Out::Counts(counts)] = &out[..] else { panic!("it tells its counts: {out:?}") };
        let LinkCounts { accepted, duplicate, team, own, misrouted, version, malformed, .. } = **counts;
        assert_eq!([accepted, duplicate, team, own, misrouted, version, malformed], [1; 7]);
        assert_eq!(counts.refused(), 6);
    }
}
