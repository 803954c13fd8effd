//! UDP: the open sockets of one link of one host. `socket.rs` has their configuration; `multicast.rs` and `unicast.rs`
//! are the two transports. Does not interpret frames or decide who may send them.

mod batch;
mod filter;
mod fitness;
pub mod guests;
mod loopback;
pub mod multicast;
mod open;
mod socket;
pub mod unicast;

use std::collections::BTreeMap;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::AsFd;
use std::rc::Rc;

use socket2::{SockRef, Socket};

use super::interface;
use crate::messages::ids::HostId;
use crate::net::protocol::codec::{self, Content};
use crate::net::protocol::link::Guest;
use crate::net::protocol::router::Audience;
use crate::net::transport::flood::{Flood, REST};
use crate::net::transport::udp::batch::Batch;
use crate::net::transport::udp::guests::Guests;
use crate::net::transport::udp::loopback::Loopback;
use crate::net::transport::udp::open::{OpenError, guest_socket, receiving_socket, sending_socket};
use crate::net::transport::udp::socket::{Addressing, SocketConfig};
use crate::net::transport::{Counts, Filter, In, Transmit, Transport};
use crate::time::{Span, Time};

/// Number of datagrams that are read before other actors run: a quarter of a millisecond of work.
const READ_AT_ONCE: usize = 128;
/// Interval between readiness events below which a link is busy, and is read until it is empty. It is longer than a
/// turn of the event loop and than the delay by another link's flood. A link read once per event would otherwise never
/// catch up if more than one datagram arrives between two events.
const BUSY: Span = Span::from_millis(10);

/// Open sockets of one link on one host.
#[derive(Debug)]
struct Udp {
    /// Socket that receives, and on a unicast link also sends.
    socket: Rc<UdpSocket>,
    to: To,
    /// Receive buffer that the kernel has granted \[bytes\].
    granted: usize,
    batch: Batch,
    /// Time of the last read of the socket.
    looked: Time,
    flood: Flood,
    unsent: u64,
}

#[derive(Debug)]
enum To {
    /// Multicast. Sends through a separate socket, whose port distinguishes this process's frames from those of other
    /// processes of the machine.
    Group { tx: UdpSocket, own: SocketAddr, loopback: Loopback },
    Peers {
        peers: BTreeMap<HostId, SocketAddr>,
        /// `None` if this process is itself a guest, which only communicates with hosts.
        guests: Option<Guests>,
    },
}

impl Udp {
    /// Opens the sockets of a link for the host `host`, as `config` says.
    pub(super) fn open(host: HostId, config: &SocketConfig, filter: Filter) -> Result<Udp, OpenError> {
        let (address, peers) = match &config.addressing {
            Addressing::Multicast(group) if !group.ip().is_multicast() => return Err(OpenError::NoGroup(*group)),
            Addressing::Multicast(group) => (*group, None),
            Addressing::Unicast { listen, peers } => (*listen, Some(peers)),
            Addressing::Guest { peers } => return Udp::open_guest((host, peers), config, filter),
        };
        let interface = interface::find(&interface::interfaces()?, &config.interface, address.is_ipv6())?;
        let failed = |what: String| {
            let interface = interface.name.clone();
            move |error| OpenError::Socket { what, interface, error }
        };
        let socket = receiving_socket(address, &interface, config.receive_buffer_bytes)
            .map_err(failed(format!("listen to {address}")))?;
        let (own, to) = match peers {
            Some(peers) => (None, To::peers(host, peers, Some(Guests::default()))),
            None => {
                let tx = sending_socket(address, &interface).map_err(failed(format!("send to {address}")))?;
                let own = tx.local_addr().map_err(failed("learn the own port".to_owned()))?;
                (Some(own), To::Group { tx, own, loopback: Loopback::new(interface.loopback) })
            }
        };
        filter::attach(filter, &socket, own);
        Udp::new(socket, to, config).map_err(failed("ask for the size of the buffer".to_owned()))
    }

    /// Opens the socket of a guest: at any address of the machine, to all hosts of the link.
    fn open_guest(
        (host, peers): (HostId, &BTreeMap<HostId, SocketAddr>),
        config: &SocketConfig,
        filter: Filter,
    ) -> Result<Udp, OpenError> {
        let failed = |error| OpenError::Socket {
            what: "open a port for an operator".to_owned(),
            interface: "any".to_owned(),
            error,
        };
        let v6 = peers.values().any(SocketAddr::is_ipv6);
        let socket = guest_socket(v6, config.receive_buffer_bytes).map_err(failed)?;
        filter::attach(filter, &socket, None);
        Udp::new(socket, To::peers(host, peers, None), config).map_err(failed)
    }

    fn new(socket: Socket, to: To, config: &SocketConfig) -> io::Result<Udp> {
        let granted = socket.recv_buffer_size()?;
        // The kernel doubles the requested size for its own bookkeeping and reports the double.
        if granted < 2 * config.receive_buffer_bytes {
            tracing::warn!(
                interface = config.interface,
                "the kernel keeps {granted} bytes of what has arrived, and was asked for {}: raise net.core.rmem_max",
                config.receive_buffer_bytes
            );
        }
        tracing::info!(interface = config.interface, receive_buffer_bytes = granted, "the sockets of a link are open");
        let (socket, batch) = (Rc::new(UdpSocket::from(socket)), Batch::new());
        Ok(Udp { socket, to, granted, batch, looked: Time::ZERO, flood: Flood::default(), unsent: 0 })
    }

    /// Receive buffer that the kernel has granted \[bytes\].
    fn granted_bytes(&self) -> usize {
        self.granted
    }

    fn transmit(&mut self, now: Time, transmit: &Transmit) {
        if let Err(error) = self.to.transmit(now, &self.socket, transmit) {
            self.unsent += 1;
            // Log only the counts 1, 2, 4, 8, ...: a link that is down must not fill the log.
            if self.unsent.is_power_of_two() {
                tracing::warn!(unsent = self.unsent, "a frame could not be sent: {error}");
            }
        }
    }
}

impl To {
    fn peers(own: HostId, peers: &BTreeMap<HostId, SocketAddr>, guests: Option<Guests>) -> To {
        let others = peers.iter().filter(|(peer, _)| **peer != own).map(|(peer, at)| (*peer, *at));
        To::Peers { peers: others.collect(), guests }
    }

    fn transmit(
        &mut self,
        now: Time,
        socket: &UdpSocket,
        Transmit { audience, frame, .. }: &Transmit,
    ) -> io::Result<()> {
        match (self, audience) {
            (To::Group { tx, own, loopback }, _) => {
                if let Some(on) = loopback.switch(now) {
                    let tx = SockRef::from(&*tx);
                    if own.is_ipv4() { tx.set_multicast_loop_v4(on) } else { tx.set_multicast_loop_v6(on) }?;
                }
                tx.send(frame).map(drop)
            }
            (To::Peers { peers, guests }, Audience::Host(host)) => {
                let at = peers.get(host).copied().or_else(|| guests.as_ref()?.find(now, *host));
                let at =
                    at.ok_or_else(|| io::Error::new(io::ErrorKind::AddrNotAvailable, "the host has no address"))?;
                socket.send_to(frame, at).map(drop)
            }
            (To::Peers { peers, guests }, Audience::All) => {
                // Sending continues after an unreachable peer.
                let mut all = Ok(());
                for at in peers.values().copied().chain(guests.iter_mut().flat_map(|guests| guests.accepted(now))) {
                    all = all.and(socket.send_to(frame, at).map(drop));
                }
                // Candidates receive only reports, for the echoes in them.
                if matches!(codec::first(frame), Ok(Content::Report | Content::NumberedReport)) {
                    for at in guests.iter_mut().flat_map(|guests| guests.candidates(now)) {
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
        if let To::Group { own, loopback, .. } = self
            && own.ip() == from.ip()
        {
            if own.port() == from.port() {
                return false;
            }
            loopback.heard(now);
        }
        true
    }

    fn admit(&mut self, now: Time, guest: Guest) {
        // Addresses in the team file take precedence. On a multicast link, guests receive everything anyway.
        if let To::Peers { peers, guests: Some(guests) } = self
            && !peers.contains_key(&guest.host)
        {
            guests.admit(now, guest);
        }
    }
}

impl Transport for Udp {
    fn descriptor(&self) -> Rc<dyn AsFd> {
        Rc::clone(&self.socket) as Rc<dyn AsFd>
    }

    /// A read of an empty socket costs as much as a successful one. So a quiet link is read once per readiness event,
    /// and a busy one until it is empty or the limit is reached.
    fn receive(&mut self, now: Time, take: &mut dyn FnMut(Option<SocketAddr>, &[u8])) {
        let busy = now.since(self.looked) < BUSY || self.flood.is_on();
        self.looked = now;
        let to = &mut self.to;
        let take = |from: SocketAddr, frame: &[u8]| {
            if to.accepts(now, from) {
                take(Some(from), frame);
            }
        };
        let read = if busy {
            self.batch.many(&self.socket, READ_AT_ONCE, take)
        } else {
            self.batch.one(&self.socket, take).map(|()| 1)
        };
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
            In::Admit(guest) => self.to.admit(now, guest),
            In::Truth(_) | In::EpisodeBegins(_) | In::Manual(_) => {}
        }
    }

    fn counts(&self) -> Counts {
        Counts { unsent: self.unsent, dropped: 0 }
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
        let addressing = Addressing::Unicast { listen, peers: ports.iter().copied().collect() };
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
        let To::Group { tx, .. } = &one.to else { panic!("it is a group") };
        tx.send(&frame(40, 2)).unwrap();
        assert!(one.socket.recv_from(&mut [0; 64]).is_err(), "the kernel does not wake a process for its own echo");
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
            std::iter::from_fn(|| udp.socket.recv(&mut buffer).ok()).collect::<Vec<usize>>()
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
        let addressing = Addressing::Guest { peers: ports.into() };
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
        // A peer stays where the file has it.
        admit(&mut one, HostId(2), Standing::Accepted);
        say(&mut one, Audience::Host(HostId(2)), &frame(40, 5));
        assert!(hear(&mut guest).is_empty());
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
