//! UDP: the open sockets of one link of one host. `socket.rs` has their configuration; `multicast.rs`,
//! `unicast.rs` and `auto.rs` are the transports. Does not interpret frames or decide who may send them.

pub mod auto;
mod batch;
mod endpoint;
#[cfg(target_os = "linux")]
mod filter;
mod fitness;
mod guests;
mod keeper;
mod loopback;
pub mod multicast;
mod open;
mod peers;
mod socket;
pub mod unicast;

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::AsFd;
use std::rc::Rc;

use socket2::SockRef;

use crate::messages::ids::HostId;
use crate::net::protocol::codec::{self, Content};
use crate::net::protocol::link::Guest;
use crate::net::protocol::router::Audience;
use crate::net::transport::flood::{Flood, REST};
use crate::net::transport::udp::auto::Hosts;
use crate::net::transport::udp::batch::Batch;
use crate::net::transport::udp::keeper::{Keeper, News, warn_elsewhere};
use crate::net::transport::udp::loopback::Loopback;
use crate::net::transport::udp::open::{Ends, OpenError, Sockets, look, open, open_guest};
use crate::net::transport::udp::peers::{PeerAddress, Peers};
use crate::net::transport::udp::socket::{Addressing, SocketConfig};
use crate::net::transport::{Counts, Filter, In, OpenError as CannotOpen, Renewed, Transmit, Transport};
use crate::time::{Span, Time};

/// Number of datagrams that are read before other actors run: a quarter of a millisecond of work.
const READ_AT_ONCE: usize = 128;
/// Interval between readiness events below which a link is busy, and is read until it is empty. It is longer than a
/// turn of the event loop and than the delay by another link's flood. A link read once per event would otherwise never
/// catch up if more than one datagram arrives between two events.
const BUSY: Span = Span::from_millis(10);

/// Open sockets of one link on one host. They are closed while their network interface is not fit.
#[derive(Debug)]
struct Udp {
    /// Socket that receives, and on a unicast link also sends; `None` while the link is closed.
    socket: Option<Rc<UdpSocket>>,
    to: To,
    /// Interface and address of the sockets; `None` for an operator on a unicast link, which uses any.
    ends: Option<Ends>,
    /// Receive buffer that the kernel has granted \[bytes\].
    granted: usize,
    /// Threads that open the sockets again and resolve names; `None` for a check.
    keeper: Option<Keeper>,
    batch: Batch,
    /// Time of the last read of the socket.
    looked: Time,
    flood: Flood,
    unsent: u64,
    /// Number of times that a host was found at another address.
    moves: u64,
    /// Group of a link that has both ways.
    both: Option<SocketAddr>,
}

#[derive(Debug)]
enum To {
    /// Multicast; `None` while the link is closed.
    Group(Option<ToGroup>),
    Peers(Peers),
}

/// Sends to a group through a separate socket, whose port distinguishes this process's frames from those of other
/// processes of the machine.
#[derive(Debug)]
struct ToGroup {
    tx: UdpSocket,
    own: SocketAddr,
    loopback: Loopback,
    /// The group, and the hosts that are sent to by themselves, if the link has both ways.
    both: Option<(SocketAddr, Hosts)>,
}

impl Udp {
    /// Opens the sockets of a link for the host `host`, as `config` says.
    fn open(host: HostId, config: &SocketConfig, filter: Filter) -> Result<Udp, OpenError> {
        let (sockets, to) = match &config.addressing {
            Addressing::Multicast(_) | Addressing::Both(_) => {
                (open(config, filter, look(config, None)?)?, To::Group(None))
            }
            Addressing::Unicast { peers, .. } => {
                (open(config, filter, look(config, None)?)?, To::peers(host, peers, true))
            }
            // At any address of the machine, to all hosts of the link.
            Addressing::Guest { peers } => (open_guest(config, filter)?, To::peers(host, peers, false)),
        };
        let mut udp = Udp {
            socket: None,
            to,
            ends: None,
            granted: 0,
            keeper: None,
            batch: Batch::new(),
            looked: Time::ZERO,
            flood: Flood::default(),
            unsent: 0,
            moves: 0,
            both: if let Addressing::Both(group) = config.addressing { Some(group) } else { None },
        };
        udp.take(sockets);
        // The kernel doubles the requested size for its own bookkeeping and reports the double.
        if udp.granted < 2 * config.receive_buffer_bytes {
            tracing::warn!(
                interface = config.interface,
                "the kernel keeps {} bytes of what has arrived, and was asked for {}: raise net.core.rmem_max",
                udp.granted,
                config.receive_buffer_bytes
            );
        }
        Ok(udp)
    }

    /// Starts the threads that open the sockets again when their interface or address has changed, and that resolve the
    /// names of hosts.
    fn keep(&mut self, config: &SocketConfig, filter: Filter) -> Result<(), CannotOpen> {
        let cannot = |error: io::Error| CannotOpen::NotNow(format!("cannot start a thread: {error}"));
        let keeper = Keeper::new().map_err(cannot)?;
        if let Some(ends) = &self.ends {
            warn_elsewhere(config, ends);
            keeper.keep_open(config, filter, ends.clone()).map_err(cannot)?;
        }
        if let (To::Peers(own), Addressing::Unicast { peers, .. } | Addressing::Guest { peers }) =
            (&self.to, &config.addressing)
        {
            let v6 = config.addressing.is_ipv6();
            for (host, at) in peers {
                let (PeerAddress::Named(name, port), Some(unknown)) = (at, own.unknown(*host)) else { continue };
                keeper.resolve(*host, (name, *port), v6, unknown).map_err(cannot)?;
            }
        }
        self.keeper = Some(keeper);
        Ok(())
    }

    /// Takes over sockets that were opened.
    fn take(&mut self, Sockets { rx, tx, ends, granted }: Sockets) {
        let loopback = ends.as_ref().is_some_and(|ends| ends.loopback);
        match &mut self.to {
            To::Group(group) => {
                let both = self.both.map(|group| (group, Hosts::default()));
                *group = tx.map(|(tx, own)| ToGroup { tx, own, loopback: Loopback::new(loopback), both });
            }
            To::Peers(peers) => peers.set_interface(ends.as_ref().map_or(0, |ends| ends.index)),
        }
        (self.socket, self.ends, self.granted) = (Some(Rc::new(rx)), ends, granted);
        tracing::info!(receive_buffer_bytes = granted, "the sockets of a link are open");
    }

    /// Closes the sockets: their interface or address has gone.
    fn close(&mut self) {
        self.socket = None;
        if let To::Group(group) = &mut self.to {
            *group = None;
        }
        self.flood = Flood::default();
    }

    /// Receive buffer that the kernel has granted \[bytes\].
    fn granted_bytes(&self) -> usize {
        self.granted
    }

    fn transmit(&mut self, now: Time, transmit: &Transmit) {
        let Some(socket) = &self.socket else {
            // It was said when the link was closed.
            self.unsent += 1;
            return;
        };
        if let Err(error) = self.to.transmit(now, socket, transmit) {
            self.unsent += 1;
            // Log only the counts 1, 2, 4, 8, ...: a link that is down must not fill the log.
            if self.unsent.is_power_of_two() {
                tracing::warn!(unsent = self.unsent, "a frame could not be sent: {error}");
            }
        }
    }

    fn admit(&mut self, now: Time, guest: Guest) {
        if let To::Group(Some(ToGroup { both: Some((_, hosts)), .. })) = &mut self.to {
            return hosts.admit(guest);
        }
        // On a multicast link, everyone receives everything anyway.
        let To::Peers(peers) = &mut self.to else { return };
        if peers.admit(now, guest) {
            self.moves += 1;
            let (moves, host, at) = (self.moves, guest.host.0, guest.at);
            let text = format!("host {host} is at another address now: data for it goes to {at}");
            if moves.is_power_of_two() {
                tracing::warn!(moves, "{text}");
            } else {
                tracing::debug!(moves, "{text}");
            }
        }
    }
}

impl To {
    fn peers<'a>(
        own: HostId,
        peers: impl IntoIterator<Item = (&'a HostId, &'a PeerAddress)>,
        takes_guests: bool,
    ) -> To {
        let others = peers.into_iter().filter(|(peer, _)| **peer != own).map(|(peer, at)| (*peer, at.clone()));
        To::Peers(Peers::new(others, takes_guests))
    }

    fn transmit(
        &mut self,
        now: Time,
        socket: &UdpSocket,
        Transmit { audience, frame, .. }: &Transmit,
    ) -> io::Result<()> {
        match (self, audience) {
            (To::Group(None), _) => Ok(()),
            (To::Group(Some(ToGroup { tx, own, both: Some((group, hosts)), .. })), Audience::Host(host)) => {
                // What comes to another host of the machine as well is sent to all.
                let to = hosts.of(*host, group.port(), own.ip()).unwrap_or(*group);
                tx.send_to(frame, to).map(drop)
            }
            (To::Group(Some(ToGroup { tx, own, loopback, both })), _) => {
                if let Some(on) = loopback.switch(now) {
                    let tx = SockRef::from(&*tx);
                    if own.is_ipv4() { tx.set_multicast_loop_v4(on) } else { tx.set_multicast_loop_v6(on) }?;
                }
                match both {
                    Some((group, _)) => tx.send_to(frame, *group),
                    None => tx.send(frame),
                }
                .map(drop)
            }
            (To::Peers(peers), Audience::Host(host)) => {
                let all = peers.of(now, *host);
                if all.is_empty() {
                    return Err(io::Error::new(io::ErrorKind::AddrNotAvailable, "the host has no address"));
                }
                all.into_iter().try_for_each(|at| socket.send_to(frame, at).map(drop))
            }
            (To::Peers(peers), Audience::All) => {
                // Sending continues after an unreachable peer.
                let mut all = Ok(());
                for at in peers.all(now) {
                    all = all.and(socket.send_to(frame, at).map(drop));
                }
                // Candidates receive only reports, for the echoes in them, and rosters.
                if matches!(codec::first(frame), Ok(Content::Report | Content::NumberedReport | Content::Roster)) {
                    for at in peers.candidates(now) {
                        all = all.and(socket.send_to(frame, at).map(drop));
                    }
                }
                all
            }
        }
    }

    /// Whether to accept a datagram from this address. Own datagrams that the kernel's filter has passed are not
    /// accepted.
    fn accepts(&mut self, now: Time, from: SocketAddr) -> bool {
        if let To::Group(Some(ToGroup { own, loopback, .. })) = self
            && own.ip() == from.ip()
        {
            if own.port() == from.port() {
                return false;
            }
            loopback.heard(now);
        }
        true
    }
}

impl Transport for Udp {
    fn descriptor(&self) -> Rc<dyn AsFd> {
        Rc::clone(self.socket.as_ref().expect("an open link is asked")) as Rc<dyn AsFd>
    }

    /// A read of an empty socket costs as much as a successful one. So a quiet link is read once per readiness event,
    /// and a busy one until it is empty or the limit is reached.
    fn receive(&mut self, now: Time, take: &mut dyn FnMut(Option<SocketAddr>, &[u8])) {
        let Some(socket) = &self.socket else { return };
        let busy = now.since(self.looked) < BUSY || self.flood.is_on();
        self.looked = now;
        let to = &mut self.to;
        let take = |from: SocketAddr, frame: &[u8]| {
            if to.accepts(now, from) {
                take(Some(from), frame);
            }
        };
        let read =
            if busy { self.batch.many(socket, READ_AT_ONCE, take) } else { self.batch.one(socket, take).map(|()| 1) };
        match read {
            Ok(count) => self.flood.read(now, count),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => self.flood.read(now, 0),
            // An error caused by an earlier datagram, such as a closed port or a lost route. It does not affect the
            // next one.
            Err(error) => tracing::debug!("an error in place of a frame: {error}"),
        }
    }

    fn paused_until(&self) -> Option<Time> {
        self.flood.is_on().then(|| self.looked + REST)
    }

    fn handle(&mut self, now: Time, input: In) {
        match input {
            In::Transmit(transmit) => self.transmit(now, &transmit),
            In::Admit(guest) => self.admit(now, guest),
        }
    }

    fn counts(&self) -> Counts {
        Counts { unsent: self.unsent, dropped: 0 }
    }

    fn changes(&self) -> Option<Rc<dyn AsFd>> {
        self.keeper.as_ref().map(|keeper| Rc::new(keeper.bell()) as Rc<dyn AsFd>)
    }

    fn renew(&mut self, tell: &mut dyn FnMut(Renewed)) {
        for news in self.keeper.as_ref().map(Keeper::take).unwrap_or_default() {
            match news {
                News::Closed(why) => {
                    self.close();
                    tell(Renewed::Closed(why));
                }
                News::Open(sockets) => {
                    let at = sockets.ends.as_ref().map(|ends| format!("{} on '{}'", ends.at.ip(), ends.name));
                    self.take(*sockets);
                    tell(Renewed::Open(at.unwrap_or_default()));
                }
                News::Resolved(host, at) => {
                    if let To::Peers(peers) = &mut self.to {
                        peers.resolved(host, at);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;
    use crate::net::protocol::codec::TAG_BYTES;
    use crate::net::protocol::codec::{HEADER_BYTES, MAX_FRAME_BYTES, VERSION};
    use crate::net::protocol::link::Standing;

    const TEAM: u16 = 0x0203;
    const FILTER: Filter = Filter::Team { number: TEAM, tagged: true };

    fn multicast(group: &str) -> SocketConfig {
        let addressing = Addressing::Multicast(group.parse().unwrap());
        SocketConfig { addressing, interface: "lo".to_owned(), receive_buffer_bytes: 1 << 16 }
    }

    fn at(port: u16) -> SocketAddr {
        SocketAddr::from((Ipv4Addr::LOCALHOST, port))
    }

    fn unicast(listen: SocketAddr, ports: &[(HostId, SocketAddr)]) -> SocketConfig {
        let peers = ports.iter().map(|(host, at)| (*host, PeerAddress::At(*at))).collect();
        let addressing = Addressing::Unicast { listen: PeerAddress::At(listen), peers };
        SocketConfig { addressing, ..multicast("239.0.0.1:1") }
    }

    type Arrived = Vec<(SocketAddr, Vec<u8>)>;

    fn read(udp: &mut Udp, now: Time, out: &mut Arrived) {
        udp.receive(now, &mut |from, frame| out.push((from.expect("it came from somewhere"), frame.to_vec())));
    }

    fn arrivals(udp: &mut Udp) -> Arrived {
        // Loopback delivers before the sender's call returns.
        let mut out = Vec::new();
        (0..4).for_each(|_| read(udp, Time::ZERO, &mut out));
        out
    }

    fn hear(udp: &mut Udp) -> Vec<Vec<u8>> {
        arrivals(udp).into_iter().map(|(_, frame)| frame).collect()
    }

    fn say(udp: &mut Udp, audience: Audience, frame: &[u8]) {
        let transmit = Transmit { from: HostId(0), audience, frame: frame.into() };
        udp.handle(Time::ZERO, In::Transmit(transmit));
    }

    /// A datagram of this length that could be of the team.
    fn frame(length: usize, last: u8) -> Vec<u8> {
        let mut bytes = vec![last; length];
        bytes[..4].copy_from_slice(&[VERSION, 1, 3, 2]);
        bytes
    }

    #[test]
    fn processes_of_one_machine_hear_each_other_and_not_themselves() {
        let config = multicast("239.255.77.77:47701");
        let open = |host| Udp::open(HostId(host), &config, FILTER).unwrap();
        let (mut one, mut two, mut three) = (open(1), open(2), open(3));
        let all = frame(40, 0);
        say(&mut one, Audience::All, &all);
        assert_eq!([hear(&mut one), hear(&mut two), hear(&mut three)], [vec![], vec![all.clone()], vec![all.clone()]]);
        let mut other = Udp::open(HostId(1), &multicast("239.255.77.78:47701"), FILTER).unwrap();
        say(&mut other, Audience::All, &all);
        assert!(hear(&mut two).is_empty(), "a group is a group, whatever its port");
    }

    #[test]
    fn processes_hear_each_other_and_not_themselves_on_ipv6() {
        let config = multicast("[ff02::4d:4d]:47702");
        let (mut one, mut two) = match (1..=2).map(|host| Udp::open(HostId(host), &config, FILTER)).collect() {
            Ok::<Vec<Udp>, _>(mut both) => (both.remove(0), both.remove(0)),
            Err(error) => {
                return tracing::warn!("skipped: no multicast of IPv6 on the loopback interface here: {error}");
            }
        };
        say(&mut one, Audience::All, &frame(40, 1));
        if one.unsent > 0 {
            return tracing::warn!("skipped: no way for multicast of IPv6 on the loopback interface here");
        }
        assert_eq!([hear(&mut one), hear(&mut two)], [vec![], vec![frame(40, 1)]]);
        let To::Group(Some(ToGroup { tx, .. })) = &one.to else { panic!("it is a group") };
        tx.send(&frame(40, 2)).unwrap();
        assert!(
            one.socket.as_ref().unwrap().recv_from(&mut [0; 64]).is_err(),
            "the kernel does not wake a process for its own echo"
        );
    }

    #[test]
    fn what_cannot_be_of_the_team_is_dropped_by_the_kernel() {
        let ports = [(HostId(1), at(47_721)), (HostId(2), at(47_722))];
        let open = |filter| Udp::open(HostId(1), &unicast(ports[0].1, &ports), filter).unwrap();
        let junk = UdpSocket::bind(at(0)).unwrap();
        let shortest = HEADER_BYTES + TAG_BYTES;
        let changed = |at: usize| {
            let mut bytes = frame(shortest, 7);
            bytes[at] ^= 1;
            bytes
        };
        let send = || {
            let wrong = [vec![], vec![2], frame(shortest - 1, 7), frame(MAX_FRAME_BYTES + 1, 7)];
            for bytes in wrong.into_iter().chain([0, 2, 3].map(changed)) {
                junk.send_to(&bytes, ports[0].1).unwrap();
            }
            for length in [shortest, MAX_FRAME_BYTES] {
                junk.send_to(&frame(length, 7), ports[0].1).unwrap();
            }
        };
        let read = |udp: &Udp| {
            let mut buffer = [0; 2048];
            std::iter::from_fn(|| udp.socket.as_ref().expect("it is open").recv(&mut buffer).ok())
                .collect::<Vec<usize>>()
        };
        let keyed = open(FILTER);
        send();
        assert_eq!(read(&keyed), [shortest, MAX_FRAME_BYTES]);
        drop(keyed);
        let open_team = open(Filter::Team { number: TEAM, tagged: false });
        send();
        assert_eq!(read(&open_team), [shortest - 1, shortest, MAX_FRAME_BYTES], "without a key there is no tag");
        drop(open_team);
        let all = open(Filter::All);
        send();
        assert_eq!(read(&all).len(), 9);
    }

    #[test]
    fn unicast_reaches_whom_it_is_for() {
        let ports = [(HostId(1), at(47_711)), (HostId(2), at(47_712)), (HostId(3), at(47_713))];
        let open = |(host, listen)| Udp::open(host, &unicast(listen, &ports), FILTER).unwrap();
        let [mut one, mut two, mut three] = ports.map(open);
        say(&mut one, Audience::Host(HostId(2)), &frame(40, 2));
        say(&mut one, Audience::All, &frame(40, 9));
        assert_eq!(hear(&mut two), [frame(40, 2), frame(40, 9)]);
        assert_eq!(hear(&mut three), [frame(40, 9)]);
        assert!(hear(&mut one).is_empty());
    }

    #[test]
    fn a_guest_that_is_admitted_takes_part_in_a_unicast_link() {
        let ports = [(HostId(1), at(47_731)), (HostId(2), at(47_732))];
        let open = |(host, listen)| Udp::open(host, &unicast(listen, &ports), FILTER).unwrap();
        let [mut one, mut two] = ports.map(open);
        let operator = HostId::operator(5);
        let peers = ports.map(|(host, at)| (host, PeerAddress::At(at))).into();
        let addressing = Addressing::Guest { peers };
        let guest = SocketConfig { addressing, ..unicast(ports[0].1, &ports) };
        let mut guest = Udp::open(operator, &guest, FILTER).unwrap();
        say(&mut guest, Audience::All, &frame(40, 1));
        assert_eq!(hear(&mut two), [frame(40, 1)]);
        let arrived = arrivals(&mut one);
        let from = arrived[0].0;
        say(&mut one, Audience::All, &frame(40, 2));
        assert!(hear(&mut guest).is_empty(), "it is not admitted yet");
        let admit = |one: &mut Udp, host, standing| {
            one.handle(Time::ZERO, In::Admit(Guest { host, at: from, standing }));
        };
        admit(&mut one, operator, Standing::Candidate);
        say(&mut one, Audience::All, &frame(40, 2));
        assert!(hear(&mut guest).is_empty(), "it is not accepted yet");
        let mut report: Vec<u8> = frame(HEADER_BYTES, 0).to_vec();
        codec::add(&mut report, Content::Report, |bytes| bytes.extend_from_slice(&[1; 6]));
        report.extend_from_slice(&[0; TAG_BYTES]);
        say(&mut one, Audience::All, &report);
        assert_eq!(hear(&mut guest), [report], "but accepts what it needs for that");
        admit(&mut one, operator, Standing::Accepted);
        say(&mut one, Audience::All, &frame(40, 3));
        say(&mut one, Audience::Host(operator), &frame(40, 4));
        assert_eq!(hear(&mut guest), [frame(40, 3), frame(40, 4)]);
        // A host that has moved is sent to where it is.
        hear(&mut two);
        admit(&mut one, HostId(2), Standing::Accepted);
        say(&mut one, Audience::Host(HostId(2)), &frame(40, 5));
        assert_eq!((hear(&mut guest), hear(&mut two)), (vec![frame(40, 5)], vec![]));
    }

    #[test]
    fn a_flooded_link_rests_after_every_reading_and_reads_it_all() {
        let ports = [(HostId(1), at(47_741))];
        let mut one = Udp::open(HostId(1), &unicast(ports[0].1, &ports), FILTER).unwrap();
        let other = UdpSocket::bind(at(0)).unwrap();
        let send = |many: usize| {
            for _ in 0..many {
                other.send_to(&frame(40, 0), ports[0].1).unwrap();
            }
        };
        let us = |us: u64| Time::from_nanos(50_000_000 + us * 1000);
        let mut out = Vec::new();
        send(40);
        read(&mut one, us(0), &mut out);
        assert_eq!((out.len(), one.paused_until()), (1, None), "a quiet link is read once a ring");
        read(&mut one, us(10), &mut out);
        assert_eq!((out.len(), one.paused_until()), (40, Some(us(1010))));
        send(30);
        read(&mut one, us(1010), &mut out);
        assert_eq!((out.len(), one.paused_until()), (70, Some(us(2010))), "it goes on");
        send(2);
        read(&mut one, us(2010), &mut out);
        assert_eq!((out.len(), one.paused_until()), (72, None), "it is over");
        send(19);
        (0..19).for_each(|n| read(&mut one, us(10_000 + 200 * n), &mut out));
        assert_eq!((out.len(), one.paused_until()), (91, None), "5000 a second are no flood");
    }

    #[test]
    fn a_link_that_is_held_up_by_the_flood_of_another_does_not_fall_behind() {
        let ports = [(HostId(1), at(47_742))];
        let mut one = Udp::open(HostId(1), &unicast(ports[0].1, &ports), FILTER).unwrap();
        let other = UdpSocket::bind(at(0)).unwrap();
        let mut out = Vec::new();
        for ring in 1..=20 {
            for _ in 0..5 {
                other.send_to(&frame(40, 0), ports[0].1).unwrap();
            }
            // A ring comes after the rest of the other link, and a little more.
            let now = Time::ZERO + (REST + Span::from_nanos(300_000)) * (20 + ring);
            read(&mut one, now, &mut out);
            assert!(out.len() as u64 + 5 >= 5 * ring, "{} of {} were read", out.len(), 5 * ring);
        }
    }

    #[test]
    fn wrong_interfaces_and_groups_are_refused() {
        let error = |config: SocketConfig| Udp::open(HostId(0), &config, FILTER).unwrap_err().to_string();
        assert!(
            error(SocketConfig { interface: "wlan99".to_owned(), ..multicast("239.0.0.1:4770") }).contains("wlan99")
        );
        assert!(error(multicast("10.0.0.1:4770")).contains("no multicast group"));
    }
}
