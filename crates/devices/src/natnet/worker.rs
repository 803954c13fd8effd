//! Worker of the source `natnet`: sockets for frames and commands. It passes the server's datagrams on unchanged.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::rc::Rc;
use std::time::{Duration, Instant};

use actix::{Actor, ActorContext, AsyncContext, Context, Handler, Recipient, StreamHandler, Supervised};
use futures_util::stream::{Stream, unfold};
use murmurate::edge::{Input, Packet, Port, Seat, Worker};
use murmurate::time::{Span, Time};
use nix::net::if_::if_nametoindex;
use socket2::{Domain, InterfaceIndexOrAddress, Protocol, SockAddr, SockRef, Socket, Type};
use tokio::net::UdpSocket;

use super::client::{Change, Client};
use super::packet::Version;
use super::settings::{Addresses, Transmission};

/// Period at which requests and reminders that are due are sent.
const TICK: Duration = Duration::from_millis(50);
/// Pause after an error of a socket, before both are opened again.
const PAUSE: Duration = Duration::from_secs(1);
/// Oldest bitstream (version of the NatNet format) that the source decodes.
const OLDEST: Version = Version { major: 3, minor: 0 };
/// Time after which the sockets of a silent server are closed and opened again.
const REOPEN: Span = Span::from_millis(5000);
/// Size of the receive buffer \[bytes\], that of the largest datagram.
const LARGEST: usize = 1 << 16;

/// Worker of the source `natnet`: requests the server's data and receives its datagrams.
pub(crate) struct Listener {
    /// Network addresses of the server and of its frames.
    pub config: Addresses,
}

impl Worker for Listener {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.start(move |port| {
            let unicast = self.config.transmission == Transmission::Unicast;
            Receiver {
                config: self.config,
                port,
                begun: Instant::now(),
                client: Client::new(Time::ZERO, unicast),
                failures: 0,
                sockets: None,
                opened: Time::ZERO,
                pause: Duration::ZERO,
            }
        })
    }
}

/// Open UDP sockets of the worker of the source `natnet`.
struct Sockets {
    /// Socket for requests and answers; in unicast also for frames.
    command: Rc<UdpSocket>,
    /// Socket for multicast frames; `None` in unicast.
    data: Option<Rc<UdpSocket>>,
}

/// Actor that receives the server's datagrams. Its life ends with an error of a socket or when the server is silent;
/// then the actor is started again, with new sockets.
struct Receiver {
    config: Addresses,
    port: Port,
    begun: Instant,
    client: Client,
    /// Number of socket errors so far.
    failures: u64,
    /// `None` until they are opened in this life.
    sockets: Option<Sockets>,
    /// Time at which the sockets were opened.
    opened: Time,
    /// Pause before the sockets are opened again.
    pause: Duration,
}

impl Actor for Receiver {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Context<Self>) {
        self.port.resume(std::mem::take(&mut self.pause), context, Receiver::open);
    }
}

impl Supervised for Receiver {
    fn restarting(&mut self, _: &mut Context<Self>) {
        self.sockets = None;
    }
}

impl Handler<Input> for Receiver {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        if input == Input::Close {
            context.stop();
        }
    }
}

impl StreamHandler<io::Result<(SocketAddr, Packet)>> for Receiver {
    fn handle(&mut self, received: io::Result<(SocketAddr, Packet)>, context: &mut Context<Self>) {
        match received {
            // Datagrams of other senders are skipped.
            Ok((from, datagram)) if from.ip() == self.config.server => {
                let change = self.client.take(self.now(), &datagram);
                self.report(change);
                self.port.send(datagram);
            }
            Ok(_) => {}
            Err(error) => self.lose(&error, context),
        }
    }

    /// A stream of datagrams has no end of its own.
    fn finished(&mut self, _: &mut Context<Self>) {}
}

impl Receiver {
    fn now(&self) -> Time {
        Time::from_nanos(self.begun.elapsed().as_nanos() as u64)
    }

    /// Opens the sockets and begins to receive.
    fn open(&mut self, context: &mut Context<Self>) {
        let sockets = match self.config.open() {
            Ok(sockets) => sockets,
            Err(error) => return self.lose(&error, context),
        };
        for socket in [Some(&sockets.command), sockets.data.as_ref()].into_iter().flatten() {
            context.add_stream(datagrams(Rc::clone(socket)));
        }
        self.sockets = Some(sockets);
        self.opened = self.now();
        self.tick(context);
        context.run_interval(TICK, Receiver::tick);
    }

    /// Ends this life of the actor after an error of a socket.
    fn lose(&mut self, error: &io::Error, context: &mut Context<Self>) {
        self.fail(error);
        self.pause = PAUSE;
        context.stop();
    }

    /// Sends the requests and reminders that are due. Ends this life if the server has been silent for 5 s: a network
    /// interface that was removed and added again has left the multicast group.
    fn tick(&mut self, context: &mut Context<Self>) {
        let now = self.now();
        let change = self.client.listen(now);
        self.report(change);
        if self.client.is_silent() && now.since(self.opened) >= REOPEN {
            return context.stop();
        }
        let to = SockAddr::from(SocketAddrV4::new(self.config.server, self.config.command_port));
        for request in self.client.requests(now) {
            // At once, and not when the runtime knows that there is room.
            let sent = self.sockets.as_ref().map(|open| SockRef::from(&*open.command).send_to(&request, &to));
            // Continues after an error, because frames may still arrive.
            if let Some(Err(error)) = sent {
                self.fail(&error);
            }
        }
        self.client.reminders(now).into_iter().for_each(|datagram| self.port.send(datagram));
    }

    /// Counts a socket error, and logs it if its number is 1, 2, 4, 8 and so on.
    fn fail(&mut self, error: &io::Error) {
        self.failures += 1;
        if self.failures.is_power_of_two() {
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

impl Addresses {
    /// Opens the sockets for frames and commands.
    fn open(&self) -> io::Result<Sockets> {
        let bind = |address: SocketAddrV4| {
            let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
            socket.set_nonblocking(true)?;
            // Several hosts on one machine can receive the group's frames.
            socket.set_reuse_address(true)?;
            socket.bind(&address.into())?;
            Ok::<_, io::Error>(Rc::new(UdpSocket::from_std(socket.into())?))
        };
        let command = bind(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0))?;
        let data = match self.transmission {
            Transmission::Unicast => None,
            Transmission::Multicast => {
                let socket = bind(SocketAddrV4::new(self.group, self.data_port))?;
                SockRef::from(&*socket).join_multicast_v4_n(&self.group, &self.interface()?)?;
                Some(socket)
            }
        };
        Ok(Sockets { command, data })
    }

    /// Returns the network interface on which to join the multicast group.
    fn interface(&self) -> io::Result<InterfaceIndexOrAddress> {
        if let Some(name) = &self.interface {
            return Ok(InterfaceIndexOrAddress::Index(if_nametoindex(name.as_str())?));
        }
        let route = std::net::UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        route.connect((self.server, self.command_port))?;
        match route.local_addr()? {
            SocketAddr::V4(local) => Ok(InterfaceIndexOrAddress::Address(*local.ip())),
            SocketAddr::V6(_) => Err(io::Error::other("the way to the tracker is not IPv4")),
        }
    }
}

/// Returns the datagrams that a socket receives, with their senders.
fn datagrams(socket: Rc<UdpSocket>) -> impl Stream<Item = io::Result<(SocketAddr, Packet)>> {
    unfold((socket, vec![0; LARGEST]), |(socket, mut buffer)| async move {
        let received = socket.recv_from(&mut buffer).await.map(|(length, from)| (from, buffer[..length].into()));
        Some((received, (socket, buffer)))
    })
}
