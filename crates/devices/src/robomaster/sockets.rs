//! Sockets of the RoboMaster driver, and the streams of what they receive.

use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::rc::Weak;
use std::task::{Poll, ready};
use std::time::Duration;

use futures_util::stream::{Stream, poll_fn, unfold};
use socket2::{Domain, Protocol, Socket, Type};
use tokio::net::{TcpSocket, TcpStream, UdpSocket};
use tokio::time::timeout;

/// Largest number of bytes read at once, from a stream or as one datagram.
pub(super) const BYTES: usize = 2048;

/// Opens a TCP connection to a port of a robot within the time `longest`.
pub(super) async fn connect(address: Ipv4Addr, port: u16, longest: Duration) -> io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    socket.set_nodelay(true)?;
    let opening = socket.connect(SocketAddrV4::new(address, port).into());
    timeout(longest, opening).await.unwrap_or(Err(ErrorKind::TimedOut.into()))
}

/// Returns a UDP socket bound to `port` on all local addresses. Other programs and workers may bind the port as well.
pub(super) fn listen(port: u16) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, port).into())?;
    UdpSocket::from_std(socket.into())
}

/// Returns the bytes that a connection receives, up to `BYTES` at once, none at its end, as `of` makes an item of them.
/// The stream has no hold on the connection, which is closed as soon as its owner drops it.
pub(super) fn bytes<T>(stream: Weak<TcpStream>, of: impl Fn(io::Result<Vec<u8>>) -> T) -> impl Stream<Item = T> {
    let mut over = false;
    poll_fn(move |task| {
        let Some(stream) = stream.upgrade().filter(|_| !over) else { return Poll::Ready(None) };
        let mut bytes = [0; BYTES];
        loop {
            let read = ready!(stream.poll_read_ready(task)).and_then(|()| stream.try_read(&mut bytes));
            match read {
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                read => {
                    over = !matches!(read, Ok(1..));
                    return Poll::Ready(Some(of(read.map(|length| bytes[..length].to_vec()))));
                }
            }
        }
    })
}

/// Returns the datagrams that a socket receives, as `of` makes an item of each. An ICMP error of an earlier datagram is
/// no datagram.
pub(super) fn datagrams<T>(socket: UdpSocket, of: fn(Vec<u8>) -> T) -> impl Stream<Item = T> {
    unfold((socket, [0; BYTES]), move |(socket, mut buffer)| async move {
        loop {
            if let Ok(length) = socket.recv(&mut buffer).await {
                return Some((of(buffer[..length].to_vec()), (socket, buffer)));
            }
        }
    })
}
