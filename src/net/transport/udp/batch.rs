//! Reads datagrams from a socket, one or several with one system call. Does not interpret them.

use std::io;
use std::net::{SocketAddr, UdpSocket};

#[cfg(target_os = "linux")]
use nix::sys::socket::{MultiHeaders, SockaddrStorage};

use crate::net::protocol::codec::MAX_FRAME_BYTES;

/// Largest number of datagrams that one system call reads.
const MANY: usize = 32;
/// Number of datagrams that the first system call reads, where one reads several. Usually there are no more, and each
/// buffer costs time to prepare.
const FEW: usize = 2;
/// Size of the buffer for one datagram \[bytes\]: one more than the longest, so that a longer one is recognized.
const ROOM: usize = MAX_FRAME_BYTES + 1;

/// Buffers into which datagrams are read from a socket, for as many as one system call reads.
#[derive(Debug)]
pub(super) struct Batch {
    bytes: Box<[u8]>,
    #[cfg(target_os = "linux")]
    headers: MultiHeaders<SockaddrStorage>,
}

impl Batch {
    /// Returns buffers for as many datagrams as one system call reads.
    pub(super) fn new() -> Batch {
        Batch {
            bytes: vec![0; MANY * ROOM].into_boxed_slice(),
            #[cfg(target_os = "linux")]
            headers: MultiHeaders::preallocate(MANY, None),
        }
    }

    /// Reads one datagram and passes it to `take`; the error `WouldBlock` says that there is none. On a quiet socket
    /// this is cheaper than reading several.
    pub(super) fn one(&mut self, socket: &UdpSocket, mut take: impl FnMut(SocketAddr, &[u8])) -> io::Result<()> {
        let (length, from) = socket.recv_from(&mut self.bytes[..ROOM])?;
        take(from, &self.bytes[..length]);
        Ok(())
    }

    /// Reads datagrams until none is left or about `limit` were read, and passes each to `take`. Returns their number.
    pub(super) fn many(
        &mut self,
        socket: &UdpSocket,
        limit: usize,
        mut take: impl FnMut(SocketAddr, &[u8]),
    ) -> io::Result<usize> {
        let mut read = self.some::<FEW>(socket, &mut take)?;
        let mut full = read == FEW;
        while full && read < limit {
            // If the error persists, the next read returns it.
            let count = self.some::<MANY>(socket, &mut take).unwrap_or(0);
            read += count;
            full = count == MANY;
        }
        Ok(read)
    }

    /// Reads up to `MOST` datagrams with one system call. Returns their number.
    #[cfg(target_os = "linux")]
    fn some<const MOST: usize>(
        &mut self,
        socket: &UdpSocket,
        mut take: impl FnMut(SocketAddr, &[u8]),
    ) -> io::Result<usize> {
        use std::os::fd::AsRawFd;

        use nix::errno::Errno;
        use nix::sys::socket::{MsgFlags, recvmmsg};

        let mut rooms = self.bytes.chunks_exact_mut(ROOM);
        let mut slices: [_; MOST] =
            std::array::from_fn(|_| [io::IoSliceMut::new(rooms.next().expect("there is room for the most"))]);
        let got = match recvmmsg(socket.as_raw_fd(), &mut self.headers, &mut slices, MsgFlags::MSG_DONTWAIT, None) {
            Ok(got) => got,
            Err(Errno::EAGAIN) => return Ok(0),
            Err(error) => return Err(error.into()),
        };
        let mut count = 0;
        for message in got {
            count += 1;
            let bytes = message.iovs().next().unwrap_or_default();
            if let Some(from) = message.address.as_ref().and_then(address) {
                take(from, bytes);
            }
        }
        Ok(count)
    }

    /// Reads up to `MOST` datagrams from a socket that does not block. Returns their number.
    #[cfg(not(target_os = "linux"))]
    fn some<const MOST: usize>(
        &mut self,
        socket: &UdpSocket,
        mut take: impl FnMut(SocketAddr, &[u8]),
    ) -> io::Result<usize> {
        for count in 0..MOST {
            match self.one(socket, &mut take) {
                Ok(()) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(count),
                Err(error) => return Err(error),
            }
        }
        Ok(MOST)
    }
}

#[cfg(target_os = "linux")]
fn address(of: &SockaddrStorage) -> Option<SocketAddr> {
    let v4 = of.as_sockaddr_in().map(|v4| SocketAddr::V4((*v4).into()));
    v4.or_else(|| of.as_sockaddr_in6().map(|v6| SocketAddr::V6((*v6).into())))
}
