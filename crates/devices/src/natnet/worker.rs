//! Worker of the source `natnet`: sockets for frames and commands. It passes the server's datagrams on unchanged.

use std::io;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::os::fd::AsFd;
use std::thread;
use std::time::{Duration, Instant};

use murmurate::edge::{PacketSender, Port, Worker};
use murmurate::time::{Span, Time};
use nix::errno::Errno;
use nix::net::if_::if_nametoindex;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use socket2::{Domain, InterfaceIndexOrAddress, Protocol, Socket, Type};

use super::client::{Change, Client};
use super::packet::Version;
use super::settings::{Addresses, Transmission};

/// Longest wait for a datagram \[ms\]. The worker notices the end of the host after at most this time.
const WAIT_MS: u16 = 50;
/// Pause after an error of a socket, as a number of waits: 1 s in total.
const PAUSE: u32 = 20;
/// Oldest bitstream (version of the NatNet format) that the source decodes.
const OLDEST: Version = Version { major: 3, minor: 0 };
/// Time after which the sockets of a silent server are closed and opened again.
const REOPEN: Span = Span::from_millis(5000);
/// Largest number of datagrams that are read from a socket before other work is done.
const BURST: usize = 64;
/// Size of the receive buffer \[bytes\], that of the largest datagram.
const LARGEST: usize = 1 << 16;

/// Worker of the source `natnet`: requests the server's data and receives its datagrams.
pub(crate) struct Listener {
    /// Network addresses of the server and of its frames.
    pub config: Addresses,
}

/// Open UDP sockets of the worker of the source `natnet`.
struct Sockets {
    /// Socket for requests and answers; in unicast also for frames.
    command: UdpSocket,
    /// Socket for multicast frames; `None` in unicast.
    data: Option<UdpSocket>,
}

/// State of the worker of the source `natnet` that is kept when its sockets are opened again.
struct State {
    begun: Instant,
    client: Client,
    /// Number of socket errors so far.
    failures: u64,
}

impl State {
    fn now(&self) -> Time {
        Time::from_nanos(self.begun.elapsed().as_nanos() as u64)
    }
}

impl Worker for Listener {
    fn run(self: Box<Self>, port: Port) {
        let (unicast, sender) = (self.config.transmission == Transmission::Unicast, port.sender());
        let mut state = State { begun: Instant::now(), client: Client::new(Time::ZERO, unicast), failures: 0 };
        while !sender.is_closed() {
            let end = self.open().and_then(|sockets| self.listen(&sockets, &mut state, &sender));
            let Err(error) = end else { continue };
            self.fail(&mut state, &error);
            (0..PAUSE).take_while(|_| !sender.is_closed()).for_each(|_| {
                thread::park_timeout(Duration::from_millis(WAIT_MS.into()));
            });
        }
    }
}

impl Listener {
    fn open(&self) -> io::Result<Sockets> {
        let bind = |address: SocketAddrV4| {
            let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
            socket.set_nonblocking(true)?;
            // Several hosts on one machine can receive the group's frames.
            socket.set_reuse_address(true)?;
            socket.bind(&address.into())?;
            Ok::<_, io::Error>(socket)
        };
        let command = bind(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0))?;
        let data = match self.config.transmission {
            Transmission::Unicast => None,
            Transmission::Multicast => {
                let socket = bind(SocketAddrV4::new(self.config.group, self.config.data_port))?;
                socket.join_multicast_v4_n(&self.config.group, &self.interface()?)?;
                Some(socket.into())
            }
        };
        Ok(Sockets { command: command.into(), data })
    }

    /// Returns the network interface on which to join the multicast group.
    fn interface(&self) -> io::Result<InterfaceIndexOrAddress> {
        if let Some(name) = &self.config.interface {
            return Ok(InterfaceIndexOrAddress::Index(if_nametoindex(name.as_str())?));
        }
        let route = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        route.connect((self.config.server, self.config.command_port))?;
        match route.local_addr()? {
            std::net::SocketAddr::V4(local) => Ok(InterfaceIndexOrAddress::Address(*local.ip())),
            std::net::SocketAddr::V6(_) => Err(io::Error::other("the way to the tracker is not IPv4")),
        }
    }

    /// Sends requests and receives datagrams until the host ends, or until the server has been silent for 5 s. Then the
    /// sockets must be opened again, since a network interface that was removed and added again has left the multicast
    /// group. An error is that of a socket.
    fn listen(&self, sockets: &Sockets, state: &mut State, sender: &PacketSender) -> io::Result<()> {
        let opened = state.now();
        let to = SocketAddrV4::new(self.config.server, self.config.command_port);
        let mut buffer = vec![0; LARGEST];
        let is_stale = |state: &State| state.client.is_silent() && state.now().since(opened) >= REOPEN;
        while !sender.is_closed() && !is_stale(state) {
            for request in state.client.requests(state.now()) {
                // Continues after an error, because frames may still arrive.
                if let Err(error) = sockets.command.send_to(&request, to) {
                    self.fail(state, &error);
                }
            }
            let all = [Some(&sockets.command), sockets.data.as_ref()];
            let mut watched: Vec<PollFd> =
                all.iter().flatten().map(|socket| PollFd::new(socket.as_fd(), PollFlags::POLLIN)).collect();
            match poll(&mut watched, PollTimeout::from(WAIT_MS)) {
                Err(errno) if errno != Errno::EINTR => return Err(errno.into()),
                _ => {}
            }
            for socket in all.into_iter().flatten() {
                for _ in 0..BURST {
                    let Some(datagram) = self.receive(socket, &mut buffer)? else { break };
                    self.report(state.client.take(state.now(), &datagram));
                    sender.send(datagram);
                }
            }
            self.report(state.client.listen(state.now()));
            state.client.reminders(state.now()).into_iter().for_each(|datagram| sender.send(datagram));
        }
        Ok(())
    }

    /// Receives the next datagram of the server without waiting, and skips those of other senders. Returns `None` if no
    /// datagram of the server has arrived, or after 64 datagrams of other senders.
    fn receive(&self, socket: &UdpSocket, buffer: &mut [u8]) -> io::Result<Option<Box<[u8]>>> {
        for _ in 0..BURST {
            match socket.recv_from(buffer) {
                Ok((length, from)) if from.ip() == self.config.server => return Ok(Some(buffer[..length].into())),
                Ok(_) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Counts a socket error, and logs it if its number is 1, 2, 4, 8 and so on.
    fn fail(&self, state: &mut State, error: &io::Error) {
        state.failures += 1;
        if state.failures.is_power_of_two() {
            let Addresses { server, interface, .. } = &self.config;
            let interface = interface.as_deref().unwrap_or("the way to it");
            tracing::warn!("no connection to the tracker {server} by {interface}: {error}; is the network up?");
        }
    }

    fn report(&self, event: Option<Change>) {
        let Addresses { server, transmission, .. } = &self.config;
        match event {
            None => {}
            Some(Change::Server(info)) => {
                tracing::info!("the tracker {server} is {} {}, NatNet {}", info.name, info.version, info.natnet);
                if info.natnet < OLDEST {
                    tracing::warn!(
                        "the tracker {server} sends a bitstream before {OLDEST}, which is not read: update it"
                    );
                }
                let multicast = *transmission == Transmission::Multicast;
                if info.multicast.is_some_and(|other| other != multicast) {
                    let other = if multicast { "unicast" } else { "multicast" };
                    tracing::warn!("the tracker {server} sends by {other}: set `transmission`, or change it there");
                }
            }
            Some(Change::Unanswered) => {
                let port = self.config.command_port;
                tracing::warn!(
                    "the tracker {server} does not answer on port {port} with names: is it behind a firewall?"
                );
            }
            Some(Change::Frames) => tracing::info!("the tracker {server} sends frames"),
            Some(Change::Silent) => {
                tracing::warn!("no frames of the tracker {server} for a second: does it stream, and on this network?");
            }
        }
    }
}
