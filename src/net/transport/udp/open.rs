//! Opens UDP sockets for links: bound, restricted to an interface, joined to a group. Only makes system calls.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use socket2::{Domain, InterfaceIndexOrAddress, Protocol, Socket, Type};

#[cfg(target_os = "linux")]
use super::filter::attach;
use super::socket::{Addressing, SocketConfig};
use crate::net::transport;
use crate::net::transport::Filter;
use crate::net::transport::interface::{self, Interface, InterfaceError, within};

/// Reason why a UDP socket cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The network interface cannot be used.
    #[error(transparent)]
    Interface(#[from] InterfaceError),
    /// The address is not a multicast group.
    #[error("{0} is no multicast group; choose one of 239.0.0.0/8 or ff02::/16")]
    NoGroup(SocketAddr),
    /// The kernel refuses an operation on the socket.
    #[error("cannot {what} on '{interface}': {error}{advice}")]
    Socket {
        /// Attempted operation.
        what: String,
        /// Name of the network interface.
        interface: String,
        /// Error of the kernel.
        error: io::Error,
        /// Advice; empty if there is none.
        advice: String,
    },
}

impl From<OpenError> for transport::OpenError {
    fn from(error: OpenError) -> transport::OpenError {
        let why = error.to_string();
        let may_pass = match error {
            OpenError::Interface(error) => error.may_pass(),
            OpenError::NoGroup(_) => false,
            // An address that is not there yet, or still in use, or an interface that goes away just now; but no port
            // that only root may have.
            OpenError::Socket { error, .. } => {
                !matches!(error.kind(), io::ErrorKind::PermissionDenied | io::ErrorKind::Unsupported)
            }
        };
        if may_pass { transport::OpenError::NotNow(why) } else { transport::OpenError::Wrong(why) }
    }
}

/// Network interface of a link's sockets, and their address on it. If one of them changes, the sockets are of no use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Ends {
    /// Name of the interface.
    pub name: String,
    /// Number of the interface in the kernel: another one if it was removed and is there again.
    pub index: u32,
    /// Whether it is a loopback interface.
    pub loopback: bool,
    /// Address from which the sockets send; on a unicast link with the port at which they receive.
    pub at: SocketAddr,
    /// Addresses of the interface of the same family, for errors.
    others: Vec<IpAddr>,
}

impl Ends {
    /// Whether sockets with these ends can go on as those with the ends `now`.
    pub(super) fn is_same(&self, now: &Ends) -> bool {
        (&self.name, self.index, self.at) == (&now.name, now.index, now.at)
    }

    /// Whether a host listens at another address than the team file says: `listen`, the configured one.
    pub(super) fn is_elsewhere(&self, config: &SocketConfig) -> Option<SocketAddr> {
        let Addressing::Unicast { listen, .. } = &config.addressing else { return None };
        listen.fixed().filter(|listen| listen.ip() != self.at.ip())
    }
}

/// Looks which interface and address the sockets of a host on a link have to use now. `used` are those in use, which
/// stay if they can: an interface may have several addresses, and `auto` several interfaces after a while.
pub(super) fn look(config: &SocketConfig, used: Option<&Ends>) -> Result<Ends, OpenError> {
    let v6 = config.addressing.is_ipv6();
    let all = interface::interfaces()?;
    let found = interface::find(&all, &config.interface, v6, used.map(|ends| ends.name.as_str()))?;
    let others = found.addresses(v6);
    let kept = used.map(|ends| ends.at.ip()).filter(|at| others.contains(at));
    let is_link_local = |at: &&IpAddr| matches!(at, IpAddr::V6(v6) if v6.is_unicast_link_local());
    let first = || others.first().copied().expect("an interface that is found has an address");
    let (ip, port) = match &config.addressing {
        // A group of the link is reached from an address of the link.
        Addressing::Multicast(_) | Addressing::Both(_) => {
            let near = others.iter().find(is_link_local).copied();
            (kept.unwrap_or_else(|| near.unwrap_or_else(first)), 0)
        }
        Addressing::Unicast { listen, .. } => {
            let fixed = listen.fixed().map(|listen| listen.ip());
            let own = fixed.filter(|ip| found.loopback || others.contains(ip));
            let wide = others.iter().find(|at| !is_link_local(at)).copied();
            (own.or(kept).unwrap_or_else(|| wide.unwrap_or_else(first)), listen.port())
        }
        Addressing::Guest { .. } => unreachable!("a guest is at no address of its own"),
    };
    let at = scoped(SocketAddr::new(ip, port), &found);
    Ok(Ends { name: found.name, index: found.index, loopback: found.loopback, at, others })
}

/// Open sockets of a host on a link.
#[derive(Debug)]
pub(super) struct Sockets {
    /// Socket that receives, and on a unicast link also sends.
    pub rx: UdpSocket,
    /// Socket that sends to a group, with its own address; `None` on a unicast link.
    pub tx: Option<(UdpSocket, SocketAddr)>,
    /// Interface and address; `None` for an operator on a unicast link, which uses any.
    pub ends: Option<Ends>,
    /// Receive buffer that the kernel has granted \[bytes\].
    pub granted: usize,
}

/// Opens the sockets of a host with these ends; `filter` says which frames have to be received.
pub(super) fn open(config: &SocketConfig, filter: Filter, ends: Ends) -> Result<Sockets, OpenError> {
    let failed = |what: String| {
        let (interface, others) = (ends.name.clone(), ends.others.clone());
        move |error: io::Error| {
            let list: Vec<String> = others.iter().map(IpAddr::to_string).collect();
            let advice = match error.kind() {
                io::ErrorKind::AddrNotAvailable => {
                    format!("; '{interface}' has {}, and a new IPv6 address is not usable for a second", list.join(" "))
                }
                io::ErrorKind::AddrInUse => "; stop what listens there; is this host running already?".to_owned(),
                _ => String::new(),
            };
            OpenError::Socket { what, interface, error, advice }
        }
    };
    let group = match &config.addressing {
        Addressing::Multicast(group) | Addressing::Both(group) if !group.ip().is_multicast() => {
            return Err(OpenError::NoGroup(*group));
        }
        Addressing::Multicast(group) | Addressing::Both(group) => Some(*group),
        _ => None,
    };
    let listen = group.unwrap_or(ends.at);
    let both = matches!(config.addressing, Addressing::Both(_));
    let rx = receiving_socket(listen, &ends, config.receive_buffer_bytes, both)
        .map_err(failed(format!("listen to {listen}")))?;
    let tx = group.map(|group| {
        let tx = sending_socket(group, &ends, both).map_err(failed(format!("send to {group}")))?;
        let own = tx.local_addr().map_err(failed("learn the own port".to_owned()))?;
        Ok::<_, OpenError>((tx, own))
    });
    let tx = tx.transpose()?;
    attach(filter, &rx, tx.as_ref().map(|(_, own)| *own));
    let granted = rx.recv_buffer_size().map_err(failed("ask for the size of the buffer".to_owned()))?;
    Ok(Sockets { rx: rx.into(), tx, ends: Some(ends), granted })
}

/// Opens the socket of a guest: at any address of the machine.
pub(super) fn open_guest(config: &SocketConfig, filter: Filter) -> Result<Sockets, OpenError> {
    let failed = |error| OpenError::Socket {
        what: "open a port for an operator".to_owned(),
        interface: "any".to_owned(),
        error,
        advice: String::new(),
    };
    let rx = guest_socket(config.addressing.is_ipv6(), config.receive_buffer_bytes).map_err(failed)?;
    attach(filter, &rx, None);
    let granted = rx.recv_buffer_size().map_err(failed)?;
    Ok(Sockets { rx: rx.into(), tx: None, ends: None, granted })
}

/// Returns an address with the interface as its scope if it is one of the link, which the kernel requires.
fn scoped(at: SocketAddr, interface: &Interface) -> SocketAddr {
    within(at, interface.index)
}

fn socket(of: SocketAddr) -> io::Result<Socket> {
    let socket = Socket::new(Domain::for_address(of), Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_nonblocking(true)?;
    if of.is_ipv6() {
        socket.set_only_v6(true)?;
    }
    Ok(socket)
}

/// Without a filter of the kernel, the link layer drops the same datagrams.
#[cfg(not(target_os = "linux"))]
fn attach(_: Filter, _: &Socket, _: Option<SocketAddr>) {}

/// Refuses the link: only Linux keeps a socket to one interface and to the groups that it has joined itself.
#[cfg(not(target_os = "linux"))]
fn pin(_: &Socket, _: &Ends) -> io::Result<()> {
    let why = "links between hosts need Linux, such as that of the Windows Subsystem for Linux";
    Err(io::Error::new(io::ErrorKind::Unsupported, why))
}

/// Restricts a socket to one interface, if the process has the permission.
#[cfg(target_os = "linux")]
fn pin(socket: &Socket, ends: &Ends) -> io::Result<()> {
    match socket.bind_device(Some(ends.name.as_bytes())) {
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Ok(()),
        other => other,
    }
}

/// Send buffer that is requested for a socket that sends to single hosts \[bytes\]. What is for a host whose address
/// the kernel asks for in vain stays there for three seconds, up to 212 992 bytes (`unres_qlen_bytes`), and a full
/// buffer keeps back what others are sent: this is enough for some twenty silent hosts.
const SEND_BUFFER_BYTES: usize = 1 << 22;

/// Requests the send buffer of a socket that sends to single hosts: beyond `net.core.wmem_max` if the process has the
/// permission.
fn widen(socket: &Socket) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    if nix::sys::socket::setsockopt(socket, nix::sys::socket::sockopt::SndBufForce, &SEND_BUFFER_BYTES).is_ok() {
        return Ok(());
    }
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)
}

/// Opens a socket that receives datagrams to `address`, a multicast group or an address of this host, on one network
/// interface. `buffer_bytes` is the receive buffer requested from the kernel. With `both`, it receives what is for this
/// host at the port of the group, too.
fn receiving_socket(address: SocketAddr, ends: &Ends, buffer_bytes: usize, both: bool) -> io::Result<Socket> {
    let socket = socket(address)?;
    pin(&socket, ends)?;
    socket.set_recv_buffer_size(buffer_bytes)?;
    if !address.ip().is_multicast() {
        widen(&socket)?;
        socket.bind(&address.into())?;
        return Ok(socket);
    }
    // Every process of the machine that joins the group has to request address reuse.
    socket.set_reuse_address(true)?;
    socket.set_reuse_port(true)?;
    let any = SocketAddr::from((Ipv4Addr::UNSPECIFIED, address.port()));
    socket.bind(&if both { any } else { within(address, ends.index) }.into())?;
    match address.ip() {
        IpAddr::V4(group) => {
            #[cfg(target_os = "linux")]
            socket.set_multicast_all_v4(false)?;
            socket.join_multicast_v4_n(&group, &InterfaceIndexOrAddress::Index(ends.index))?;
        }
        IpAddr::V6(group) => {
            #[cfg(target_os = "linux")]
            socket.set_multicast_all_v6(false)?;
            socket.join_multicast_v6(&group, ends.index)?;
        }
    }
    Ok(socket)
}

/// Opens a socket that sends to a multicast group through one network interface. It is connected, so that the kernel
/// looks up the route once and not for each datagram; with `both` it is not, and sends to single hosts, too.
fn sending_socket(group: SocketAddr, ends: &Ends, both: bool) -> io::Result<UdpSocket> {
    let socket = socket(group)?;
    pin(&socket, ends)?;
    socket.bind(&within(ends.at, ends.index).into())?;
    match ends.at.ip() {
        IpAddr::V4(from) => {
            socket.set_multicast_if_v4(&from)?;
            socket.set_multicast_ttl_v4(1)?;
            socket.set_multicast_loop_v4(true)?;
        }
        IpAddr::V6(_) => {
            socket.set_multicast_if_v6(ends.index)?;
            socket.set_multicast_hops_v6(1)?;
            socket.set_multicast_loop_v6(true)?;
        }
    }
    if both {
        widen(&socket)?;
    } else {
        socket.connect(&within(group, ends.index).into())?;
    }
    Ok(socket.into())
}

/// Opens the socket of an operator on a unicast link: it sends and receives at a port that the kernel chooses, on any
/// interface with a route to the hosts. `buffer_bytes` is the receive buffer requested from the kernel.
fn guest_socket(v6: bool, buffer_bytes: usize) -> io::Result<Socket> {
    let any: IpAddr = if v6 { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() };
    let any = SocketAddr::from((any, 0));
    let socket = socket(any)?;
    socket.set_recv_buffer_size(buffer_bytes)?;
    socket.bind(&any.into())?;
    Ok(socket)
}
