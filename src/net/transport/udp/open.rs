//! Opens UDP sockets for links: bound, restricted to an interface, joined to a group. Only makes system calls.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV6, UdpSocket};

use socket2::{Domain, Protocol, Socket, Type};

use crate::net::transport;
use crate::net::transport::interface::{Interface, InterfaceError};

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
    #[error("cannot {what} on '{interface}': {error}")]
    Socket {
        /// Attempted operation.
        what: String,
        /// Name of the network interface.
        interface: String,
        /// Error of the kernel.
        error: io::Error,
    },
}

impl From<OpenError> for transport::OpenError {
    fn from(error: OpenError) -> transport::OpenError {
        let why = error.to_string();
        match error {
            // The interface may come up later; a wrong name stays wrong.
            OpenError::Interface(InterfaceError::Down { .. }) => transport::OpenError::NotNow(why),
            _ => transport::OpenError::Wrong(why),
        }
    }
}

/// Returns the address `group`; an IPv6 group gets the interface as its scope, which the kernel requires.
pub(super) fn scoped(group: SocketAddr, interface: &Interface) -> SocketAddr {
    match group {
        SocketAddr::V6(v6) => SocketAddrV6::new(*v6.ip(), v6.port(), 0, interface.index).into(),
        v4 => v4,
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

/// Restricts a socket to one interface, if the process has the permission.
fn pin(socket: &Socket, interface: &Interface) -> io::Result<()> {
    match socket.bind_device(Some(interface.name.as_bytes())) {
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Ok(()),
        other => other,
    }
}

fn first_v4(interface: &Interface) -> Ipv4Addr {
    interface.v4.first().copied().unwrap_or(Ipv4Addr::UNSPECIFIED)
}

/// Opens a socket that receives datagrams to `address`, a multicast group or an address of this host, on one network
/// interface. `buffer_bytes` is the receive buffer requested from the kernel.
pub(super) fn receiving_socket(address: SocketAddr, interface: &Interface, buffer_bytes: usize) -> io::Result<Socket> {
    let socket = socket(address)?;
    pin(&socket, interface)?;
    socket.set_recv_buffer_size(buffer_bytes)?;
    if !address.ip().is_multicast() {
        socket.bind(&address.into())?;
        return Ok(socket);
    }
    // Every process of the machine that joins the group has to request address reuse.
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
    Ok(socket)
}

/// Opens a socket that sends to a multicast group through one network interface. It is connected, so that the kernel
/// looks up the route once and not for each datagram.
pub(super) fn sending_socket(group: SocketAddr, interface: &Interface) -> io::Result<UdpSocket> {
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
            let from = from.copied().unwrap_or(Ipv6Addr::UNSPECIFIED);
            socket.bind(&SocketAddrV6::new(from, 0, 0, interface.index).into())?;
            socket.set_multicast_if_v6(interface.index)?;
            socket.set_multicast_hops_v6(1)?;
            socket.set_multicast_loop_v6(true)?;
        }
    }
    socket.connect(&scoped(group, interface).into())?;
    Ok(socket.into())
}

/// Opens the socket of an operator on a unicast link: it sends and receives at a port that the kernel chooses, on any
/// interface with a route to the hosts. `buffer_bytes` is the receive buffer requested from the kernel.
pub(super) fn guest_socket(v6: bool, buffer_bytes: usize) -> io::Result<Socket> {
    let any: IpAddr = if v6 { Ipv6Addr::UNSPECIFIED.into() } else { Ipv4Addr::UNSPECIFIED.into() };
    let any = SocketAddr::from((any, 0));
    let socket = socket(any)?;
    socket.set_recv_buffer_size(buffer_bytes)?;
    socket.bind(&any.into())?;
    Ok(socket)
}
