//! Worker of the driver: an actor with the UDP socket of one robot, each datagram a packet of CRTP, as simulators of
//! the firmware speak it.
//!
//! It makes the robot land when the time for which it may fly is over without a newer packet, as when the control
//! thread hangs, and when the host ends.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::rc::Rc;
use std::time::Duration;

use actix::{Actor, ActorContext, AsyncContext, Context, Handler, Recipient, SpawnHandle, StreamHandler, Supervised};
use futures_util::stream::{Stream, unfold};
use murmurate::edge::{Input, Port, Seat, Worker};
use murmurate::messages::ids::RobotId;
use murmurate::time::Span;
use tokio::net::UdpSocket;

use crate::link::{FromWorker, ToWorker};
use crate::packet::MOST_DATA;
use crate::requests;

/// Longest time for which a robot may fly without a newer packet, whatever the driver says: half of the one after which
/// the firmware itself switches the motors off.
const LONGEST_HOLD: Duration = Duration::from_millis(1000);
/// Period of the orders to land that the worker itself sends, and their number in a row.
const LANDING_PERIOD: Duration = Duration::from_millis(100);
const LANDINGS: u32 = 30;
/// Pause before a socket is opened again.
const AGAIN: Duration = Duration::from_millis(500);
/// Time for which the last orders to a robot in the air are repeated when the worker ends. It has one second.
const ENDING: Duration = Duration::from_millis(400);

/// Worker of the driver for one robot.
pub struct Wire {
    /// Robot of the worker.
    pub robot: RobotId,
    /// Address of the robot.
    pub address: SocketAddr,
}

impl Worker for Wire {
    fn claim(&self) -> Option<String> {
        Some(format!("address {}", self.address))
    }

    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.start(move |port| Carrier { wire: *self, port, socket: None, guard: None, landing: 0.0, left: 0 })
    }
}

/// Datagram of the robot, or the error of a socket.
struct Received(io::Result<Vec<u8>>);

/// Actor with the socket of one robot.
struct Carrier {
    wire: Wire,
    port: Port,
    socket: Option<Rc<UdpSocket>>,
    /// Timer at which the robot is made to land; `None` if it is on the ground.
    guard: Option<SpawnHandle>,
    /// Time that a landing takes \[s\].
    landing: f32,
    /// Number of orders to land that are left.
    left: u32,
}

impl Actor for Carrier {
    type Context = Context<Self>;

    fn started(&mut self, context: &mut Context<Self>) {
        (self.socket, self.guard) = (None, None);
        self.port.resume(Duration::ZERO, context, Carrier::open);
    }
}

impl Supervised for Carrier {}

impl Handler<Input> for Carrier {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        match input {
            Input::Packet(packet) => match ToWorker::decode(&packet) {
                Some(packet) => self.carry(&packet, context),
                None => tracing::error!("{}: the driver's packet is not understood", self.wire.robot),
            },
            Input::Close if self.guard.is_some() => {
                self.left = LANDINGS;
                self.land(context);
                context.run_later(ENDING, |_, context| context.stop());
            }
            Input::Close => context.stop(),
        }
    }
}

impl StreamHandler<Received> for Carrier {
    fn handle(&mut self, Received(datagram): Received, context: &mut Context<Self>) {
        match datagram {
            Ok(bytes) => self.port.send(FromWorker::Crtp(&bytes).encode()),
            Err(error) => self.fail(&error, context),
        }
    }

    fn finished(&mut self, _: &mut Context<Self>) {}
}

impl Carrier {
    fn open(&mut self, context: &mut Context<Self>) {
        let opened = socket(self.wire.address);
        match opened {
            Ok(socket) => {
                let socket = Rc::new(socket);
                context.add_stream(datagrams(Rc::clone(&socket)));
                self.socket = Some(socket);
            }
            Err(error) => self.fail(&error, context),
        }
    }

    /// Reports an error of the socket, which may be over soon: no program listens at the address, or the network is
    /// down.
    fn fail(&mut self, error: &io::Error, context: &mut Context<Self>) {
        let why = match error.kind() {
            io::ErrorKind::ConnectionRefused => format!("nothing listens at udp://{}", self.wire.address),
            _ => format!("udp://{}: {error}", self.wire.address),
        };
        self.port.send(FromWorker::Failed(why.as_bytes()).encode());
        if self.socket.is_none() {
            context.run_later(AGAIN, Carrier::open);
        }
    }

    fn carry(&mut self, packet: &ToWorker<'_>, context: &mut Context<Self>) {
        if let Some(timer) = self.guard.take() {
            context.cancel_future(timer);
        }
        (self.landing, self.left) = (packet.landing.as_secs() as f32, LANDINGS);
        if packet.hold > Span::ZERO {
            let hold = Duration::from_nanos(packet.hold.as_nanos()).min(LONGEST_HOLD);
            self.guard = Some(context.run_later(hold, |carrier, context| {
                tracing::error!("the control thread is silent: {} lands", carrier.wire.robot);
                carrier.land(context);
            }));
        }
        if !packet.crtp.is_empty() {
            self.send(packet.crtp);
        }
    }

    /// Orders the robot to land, and again until the driver is heard or the orders are used up.
    fn land(&mut self, context: &mut Context<Self>) {
        self.send(&requests::end_setpoints().encode());
        self.send(&requests::land(self.landing).encode());
        self.left = self.left.saturating_sub(1);
        self.guard = (self.left > 0).then(|| context.run_later(LANDING_PERIOD, Carrier::land));
    }

    fn send(&self, bytes: &[u8]) {
        // A datagram without room, or after an ICMP error of an earlier one, is lost, as others are on their way.
        let _ = self.socket.as_ref().map(|socket| socket.try_send(bytes));
    }
}

/// Returns a socket that carries datagrams to and from one address alone.
fn socket(to: SocketAddr) -> io::Result<UdpSocket> {
    let any = match to {
        SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0)),
        SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
    };
    let socket = std::net::UdpSocket::bind(any)?;
    socket.connect(to)?;
    socket.set_nonblocking(true)?;
    UdpSocket::from_std(socket)
}

/// Returns the datagrams that a socket receives, and its errors, which end nothing.
fn datagrams(socket: Rc<UdpSocket>) -> impl Stream<Item = Received> {
    unfold((socket, [0; 2 + MOST_DATA]), |(socket, mut buffer)| async move {
        let received = socket.recv(&mut buffer).await.map(|length| buffer[..length].to_vec());
        Some((Received(received), (socket, buffer)))
    })
}
