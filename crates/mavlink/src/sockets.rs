//! Sockets and serial lines of the worker, and the streams of what they receive.

use std::io;
use std::net::{SocketAddr, SocketAddrV4};
use std::os::fd::OwnedFd;
use std::rc::Rc;

use futures_util::stream::{LocalBoxStream, StreamExt, unfold};
use tokio::net::UdpSocket;
use tokio::net::unix::pipe::Receiver;

use super::address::Address;
use super::frames::LARGEST;
use super::serial;

/// Largest datagram \[bytes\].
const LARGEST_DATAGRAM: usize = 2048;

/// Open link with an autopilot.
#[derive(Clone)]
pub enum Link {
    /// UDP socket.
    Udp(Rc<UdpSocket>),
    /// Both directions of a serial line.
    Serial {
        /// Bytes that are read from the line.
        reader: Rc<Receiver>,
        /// Bytes that are written to the line.
        writer: Rc<OwnedFd>,
    },
}

/// Bytes that a link has received, with their sender if they are a datagram.
pub type Received = io::Result<(Option<SocketAddr>, Vec<u8>)>;

impl Link {
    /// Opens the link with an autopilot at an address.
    pub fn open(address: &Address) -> io::Result<Link> {
        match address {
            Address::In(at) => bind(*at).map(Link::Udp),
            Address::Out(_) => any().map(Link::Udp),
            Address::Serial { device, baud } => {
                let line = serial::open(device, *baud)?;
                let writer = Rc::new(line.try_clone()?);
                // A terminal is read like a pipe; it only fails the check for one.
                let reader = Rc::new(Receiver::from_owned_fd_unchecked(line)?);
                Ok(Link::Serial { reader, writer })
            }
        }
    }

    /// Sends a frame, by UDP to the autopilot's address `to`, if that is known. A link that takes no more loses it.
    pub fn send(&self, frame: &[u8], to: Option<SocketAddr>) {
        match (self, to) {
            (Link::Udp(socket), Some(to)) => drop(socket.try_send_to(frame, to)),
            (Link::Udp(_), None) => {}
            (Link::Serial { writer, .. }, _) => drop(nix::unistd::write(writer, frame)),
        }
    }
}

/// Returns a UDP socket with an address of the system's choice.
pub fn any() -> io::Result<Rc<UdpSocket>> {
    bind(SocketAddrV4::new([0, 0, 0, 0].into(), 0))
}

fn bind(at: SocketAddrV4) -> io::Result<Rc<UdpSocket>> {
    let socket = std::net::UdpSocket::bind(at)?;
    socket.set_nonblocking(true)?;
    UdpSocket::from_std(socket).map(Rc::new)
}

/// Returns what a link receives.
pub fn received(link: Link) -> LocalBoxStream<'static, Received> {
    match link {
        Link::Udp(socket) => unfold((socket, vec![0; LARGEST_DATAGRAM]), |(socket, mut buffer)| async move {
            let read = socket.recv_from(&mut buffer).await;
            let read = read.map(|(length, from)| (Some(from), buffer[..length].to_vec()));
            Some((read, (socket, buffer)))
        })
        .boxed_local(),
        Link::Serial { reader, .. } => unfold((reader, vec![0; LARGEST]), |(line, mut buffer)| async move {
            let read = loop {
                if let Err(error) = line.readable().await {
                    break Err(error);
                }
                match line.try_read(&mut buffer) {
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                    Ok(0) => break Err(io::Error::other("the line has ended")),
                    read => break read.map(|length| (None, buffer[..length].to_vec())),
                }
            };
            Some((read, (line, buffer)))
        })
        .boxed_local(),
    }
}
