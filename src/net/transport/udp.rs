//! UDP, multicast or unicast: the link of real hosts, an actor. What frames mean, and who may send them, never matters
//! here; a frame that does not get out is counted and gone, as one that is lost on the air.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV6, UdpSocket};
use std::rc::Rc;

use socket2::{Domain, Protocol, SockFilter, Socket, Type};

use super::interface::{self, Interface, InterfaceError};
use super::{Arrive, In, Transmit};
use crate::actors::Core;
use crate::deploy::team::{SocketConfig, Transport};
use crate::messages::ids::HostId;
use crate::net::codec::MAX_FRAME_BYTES;
use crate::net::router::Audience;
use crate::time::{Span, Time};

/// Datagrams that are read before the other actors have their turn.
const READ_AT_ONCE: usize = 64;
/// A link that rings again within this time is busy.
const BUSY: Span = Span::from_nanos(100_000);

/// Why a socket cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Its interface cannot be used.
    #[error(transparent)]
    Interface(#[from] InterfaceError),
    /// The address is no multicast group.
    #[error("{0} is no multicast group; choose one of 239.0.0.0/8 or ff02::/16")]
    NoGroup(SocketAddr),
    /// The kernel refuses.
    #[error("cannot {what} on '{interface}': {error}")]
    Socket {
        /// What was tried.
        what: String,
        /// The interface.
        interface: String,
        /// What the kernel says.
        error: io::Error,
    },
}

/// The sockets of one link on one host.
#[derive(Debug)]
pub struct Udp {
    host: HostId,
    /// Hears what the others send.
    ears: Rc<UdpSocket>,
    /// Sends; a socket of its own on a multicast link, so that its port tells this process's frames from those of
    /// others on the same machine.
    mouth: Rc<UdpSocket>,
    /// What comes from here is an echo.
    own: Option<SocketAddr>,
    to: To,
    /// How much the kernel keeps \[bytes\].
    granted: usize,
    buffer: Box<[u8]>,
    /// When it was last looked whether something has arrived.
    looked: Time,
    unsent: u64,
}

#[derive(Debug)]
enum To {
    Group(SocketAddr),
    Peers(BTreeMap<HostId, SocketAddr>),
}

impl Udp {
    /// Opens the sockets of a link for this host.
    pub fn open(host: HostId, config: &SocketConfig) -> Result<Udp, OpenError> {
        let address = match &config.transport {
            Transport::Multicast { group } if !group.ip().is_multicast() => return Err(OpenError::NoGroup(*group)),
            Transport::Multicast { group } => *group,
            Transport::Unicast { listen, .. } => *listen,
        };
        let interface = interface::find(&interface::interfaces()?, &config.interface, address.is_ipv6())?;
        let failed = |what: String| {
            let interface = interface.name.clone();
            move |error| OpenError::Socket { what, interface, error }
        };
        let ears = listener(&config.transport, address, &interface, config.receive_buffer_bytes)
            .map_err(failed(format!("listen to {address}")))?;
        let granted = ears.recv_buffer_size().map_err(failed("ask for the size of the buffer".to_owned()))?;
        let (mouth, own, to) = match &config.transport {
            Transport::Multicast { group } => {
                let mouth = speaker(*group, &interface).map_err(failed(format!("send to {group}")))?;
                let own = mouth.local_addr().map_err(failed("learn the own port".to_owned()))?;
                deafen(&ears, own);
                (Some(mouth), Some(own), To::Group(scoped(*group, &interface)))
            }
            Transport::Unicast { peers, .. } => {
                let peers = peers.iter().filter(|(peer, _)| **peer != host).map(|(peer, at)| (*peer, *at));
                (None, None, To::Peers(peers.collect()))
            }
        };
        let ears = Rc::new(UdpSocket::from(ears));
        let mouth = mouth.map_or_else(|| Rc::clone(&ears), Rc::new);
        // The kernel doubles what it is asked for, to keep its own books in, and halves nothing when it tells.
        if granted < 2 * config.receive_buffer_bytes {
            tracing::warn!(
                interface = interface.name,
                "the kernel keeps {granted} bytes of what has arrived, and was asked for {}: raise net.core.rmem_max",
                config.receive_buffer_bytes
            );
        }
        let buffer = vec![0; MAX_FRAME_BYTES + 1].into_boxed_slice();
        Ok(Udp { host, ears, mouth, own, to, granted, buffer, looked: Time::ZERO, unsent: 0 })
    }

    /// The socket that is to be watched: whenever it has something to read, the actor wants to know.
    pub fn ears(&self) -> Rc<UdpSocket> {
        Rc::clone(&self.ears)
    }

    /// How much the kernel keeps of what has arrived and is not read \[bytes\].
    pub fn granted_bytes(&self) -> usize {
        self.granted
    }

    fn transmit(&mut self, transmit: &Transmit) {
        let sent = match (&self.to, transmit.audience) {
            (To::Group(group), _) => self.mouth.send_to(&transmit.frame, group).map(drop),
            (To::Peers(peers), Audience::Host(host)) => match peers.get(&host) {
                Some(peer) => self.mouth.send_to(&transmit.frame, peer).map(drop),
                None => Err(io::Error::new(io::ErrorKind::AddrNotAvailable, "the host has no address")),
            },
            (To::Peers(peers), Audience::All) => {
                // One that cannot be reached keeps nobody else from hearing.
                let mut all = Ok(());
                for peer in peers.values() {
                    all = all.and(self.mouth.send_to(&transmit.frame, peer).map(drop));
                }
                all
            }
        };
        if let Err(error) = sent {
            self.unsent += 1;
            // A link that is down must not fill the log: the first, the second, the fourth, and so on.
            if self.unsent.is_power_of_two() {
                tracing::warn!(unsent = self.unsent, "a frame did not get out: {error}");
            }
        }
    }

    /// Reads what has arrived. To ask the kernel in vain costs as much as to read, so a quiet link is read once a
    /// ring, and only a busy one until nothing is left.
    fn receive(&mut self, now: Time, out: &mut Vec<Arrive>) {
        let busy = now.since(self.looked) < BUSY;
        self.looked = now;
        for _ in 0..if busy { READ_AT_ONCE } else { 1 } {
            match self.ears.recv_from(&mut self.buffer) {
                Ok((_, from)) if self.own == Some(from) => {}
                Ok((length, _)) => out.push(Arrive { to: self.host, frame: self.buffer[..length].into() }),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                // What a former datagram has met on its way (a closed port, a lost route) says nothing of the next.
                Err(error) => tracing::debug!("an error has arrived in place of a frame: {error}"),
            }
        }
    }
}

impl Core for Udp {
    type In = In;
    type Out = Arrive;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Arrive>) {
        match input {
            In::Transmit(transmit) => self.transmit(&transmit),
            In::Readable => self.receive(now, out),
            // Real waves know where they are.
            In::Truth(_) => {}
        }
    }

    fn wake_at(&self) -> Option<Time> {
        None
    }

    fn wake(&mut self, _: Time, _: &mut Vec<Arrive>) {}
}

/// A group of IPv6 is a group of one interface.
fn scoped(group: SocketAddr, interface: &Interface) -> SocketAddr {
    match group {
        SocketAddr::V6(v6) => SocketAddrV6::new(*v6.ip(), v6.port(), 0, interface.index).into(),
        v4 => v4,
    }
}

/// Lets the kernel drop what this process has said itself, so that it is not woken for it. Where the kernel does not,
/// an echo is known by its source when it is read.
fn deafen(ears: &Socket, own: SocketAddr) {
    let SocketAddr::V4(own) = own else { return };
    // Classic BPF: from the own port and the own address, none of it; anything else, all of it.
    const LOAD_HALF: u16 = 0x28;
    const LOAD_WORD: u16 = 0x20;
    const EQUAL: u16 = 0x15;
    const RETURN: u16 = 0x06;
    // Where the IP header begins, as filters name it (linux/filter.h, SKF_NET_OFF), and the source in it.
    const SOURCE_ADDRESS: u32 = 0xfff0_0000 + 12;
    let program = [
        SockFilter::new(LOAD_HALF, 0, 0, 0),
        SockFilter::new(EQUAL, 0, 3, u32::from(own.port())),
        SockFilter::new(LOAD_WORD, 0, 0, SOURCE_ADDRESS),
        SockFilter::new(EQUAL, 0, 1, u32::from(*own.ip())),
        SockFilter::new(RETURN, 0, 0, 0),
        SockFilter::new(RETURN, 0, 0, u32::MAX),
    ];
    if let Err(error) = ears.attach_filter(&program) {
        tracing::debug!("the kernel takes no filter: {error}");
    }
}

fn socket(of: SocketAddr) -> io::Result<Socket> {
    let socket = Socket::new(Domain::for_address(of), Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_nonblocking(true)?;
    if of.is_ipv6() {
        socket.set_only_v6(true)?;
    }
    Ok(socket)
}

/// Keeps a socket to one interface, where the kernel lets a program do that.
fn pin(socket: &Socket, interface: &Interface) -> io::Result<()> {
    match socket.bind_device(Some(interface.name.as_bytes())) {
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Ok(()),
        other => other,
    }
}

fn first_v4(interface: &Interface) -> Ipv4Addr {
    interface.v4.first().copied().unwrap_or(Ipv4Addr::UNSPECIFIED)
}

fn listener(
    transport: &Transport,
    address: SocketAddr,
    interface: &Interface,
    buffer_bytes: usize,
) -> io::Result<Socket> {
    let socket = socket(address)?;
    pin(&socket, interface)?;
    socket.set_recv_buffer_size(buffer_bytes)?;
    match transport {
        Transport::Multicast { .. } => {
            // Every process of the machine hears a group; all of them have to say so.
            socket.set_reuse_address(true)?;
            socket.set_reuse_port(true)?;
            socket.bind(&scoped(address, interface).into())?;
            match address.ip() {
                IpAddr::V4(group) => {
                    socket.set_multicast_all_v4(false)?;
                    socket.join_multicast_v4(&group, &first_v4(interface))?;
                }
                IpAddr::V6(group) => {
                    socket.set_multicast_all_v6(false)?;
                    socket.join_multicast_v6(&group, interface.index)?;
                }
            }
        }
        Transport::Unicast { .. } => socket.bind(&address.into())?,
    }
    Ok(socket)
}

fn speaker(group: SocketAddr, interface: &Interface) -> io::Result<UdpSocket> {
    let socket = socket(group)?;
    pin(&socket, interface)?;
    match group {
        SocketAddr::V4(_) => {
            let from = first_v4(interface);
            socket.bind(&SocketAddr::from((from, 0)).into())?;
            socket.set_multicast_if_v4(&from)?;
            socket.set_multicast_ttl_v4(1)?;
            socket.set_multicast_loop_v4(true)?;
        }
        SocketAddr::V6(_) => {
            let from = interface.v6.iter().find(|v6| v6.is_unicast_link_local()).or(interface.v6.first());
            let from = from.copied().unwrap_or(std::net::Ipv6Addr::UNSPECIFIED);
            socket.bind(&SocketAddrV6::new(from, 0, 0, interface.index).into())?;
            socket.set_multicast_if_v6(interface.index)?;
            socket.set_multicast_hops_v6(1)?;
            socket.set_multicast_loop_v6(true)?;
        }
    }
    Ok(socket.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn multicast(group: &str) -> SocketConfig {
        let transport = Transport::Multicast { group: group.parse().unwrap() };
        SocketConfig {
            transport,
            interface: "lo".to_owned(),
            receive_buffer_bytes: 1 << 16,
            reliability: BTreeMap::new(),
        }
    }

    fn hear(udp: &mut Udp) -> Vec<Vec<u8>> {
        // Loopback delivers before the sender's call returns.
        let mut out = Vec::new();
        (0..4).for_each(|_| udp.handle(Time::ZERO, In::Readable, &mut out));
        out.into_iter().map(|arrive| arrive.frame.to_vec()).collect()
    }

    fn say(udp: &mut Udp, audience: Audience, frame: &[u8]) {
        let transmit = Transmit { from: udp.host, audience, frame: frame.into() };
        udp.handle(Time::ZERO, In::Transmit(transmit), &mut Vec::new());
    }

    #[test]
    fn processes_of_one_machine_hear_each_other_and_not_themselves() {
        let config = multicast("239.255.77.77:47701");
        let open = |host| Udp::open(HostId(host), &config).unwrap();
        let (mut one, mut two, mut three) = (open(1), open(2), open(3));
        say(&mut one, Audience::All, b"all");
        assert_eq!(
            [hear(&mut one), hear(&mut two), hear(&mut three)],
            [vec![], vec![b"all".to_vec()], vec![b"all".to_vec()]]
        );
        let mut other = Udp::open(HostId(1), &multicast("239.255.77.78:47701")).unwrap();
        say(&mut other, Audience::All, b"another group");
        assert!(hear(&mut two).is_empty(), "a group is a group, whatever its port");
    }

    #[test]
    fn unicast_reaches_whom_it_is_for() {
        let at = |port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let ports = [(HostId(1), at(47_711)), (HostId(2), at(47_712)), (HostId(3), at(47_713))];
        let open = |(host, listen): (HostId, SocketAddr)| {
            let transport = Transport::Unicast { listen, peers: ports.into_iter().collect() };
            Udp::open(host, &SocketConfig { transport, ..multicast("239.0.0.1:1") }).unwrap()
        };
        let [mut one, mut two, mut three] = ports.map(open);
        say(&mut one, Audience::Host(HostId(2)), b"two");
        say(&mut one, Audience::All, b"all");
        assert_eq!(hear(&mut two), [b"two".to_vec(), b"all".to_vec()]);
        assert_eq!(hear(&mut three), [b"all".to_vec()]);
        assert!(hear(&mut one).is_empty());
    }

    #[test]
    fn wrong_interfaces_and_groups_are_refused() {
        let error = |config: SocketConfig| Udp::open(HostId(0), &config).unwrap_err().to_string();
        assert!(
            error(SocketConfig { interface: "wlan99".to_owned(), ..multicast("239.0.0.1:4770") }).contains("wlan99")
        );
        assert!(error(multicast("10.0.0.1:4770")).contains("no multicast group"));
    }
}
