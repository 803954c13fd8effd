//! Worker of the RoboMaster driver: an actor that has the connections with one robot.
//!
//! The worker itself stops the robot when a motion's validity ends without a newer packet, and when the host ends.

use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::rc::Rc;
use std::time::{Duration, Instant};

use actix::{
    Actor, ActorContext, ActorFutureExt, AsyncContext, Context, Handler, Recipient, SpawnHandle, StreamHandler,
    Supervised, WrapFuture,
};
use socket2::SockRef;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket};
use tokio::time::timeout;

use super::link::{FromWorker, Hold, ToWorker};
use super::protocol::{ANNOUNCEMENT_PORT, CONTROL_PORT, EVENT_PORT, Line, PUSH_PORT, decode_announcement};
use super::sockets::{BYTES, bytes, connect, datagrams, listen};
use murmurate::edge::{Input, Port, Seat, Worker};
use murmurate::messages::ids::RobotId;

/// Time after which an attempt to connect is given up. A new attempt then repeats a lost first segment sooner than TCP
/// would.
const CONNECTING: Duration = Duration::from_millis(400);
/// Period of stand commands that the worker itself sends after a motion has expired without a newer packet.
const STAND_PERIOD: Duration = Duration::from_millis(200);
/// Longest wait for the robot's answers to the last lines when the worker ends. A worker has one second to end.
const ENDING: Duration = Duration::from_millis(300);
/// Longest validity of a motion, equal to that of a motor command on a link.
const LONGEST_HOLD: Duration = Duration::from_millis(1000);

/// Worker of the RoboMaster driver for one robot: does its input and output over TCP and UDP.
pub(crate) struct Tcp {
    /// Robot that the worker connects with.
    pub robot: RobotId,
    /// Network address of the robot.
    pub address: Ipv4Addr,
    /// Whether the robot's event connection (hits on its armour) is opened and read.
    pub events: bool,
    /// Whether the worker receives the announcements of robots on the network, to name another robot's address in the
    /// error if this robot does not answer.
    pub announcements: bool,
}

impl Worker for Tcp {
    fn claim(&self) -> Option<String> {
        Some(format!("address {}", self.address))
    }

    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.start(move |port| Links::new(*self, port))
    }
}

/// Connection of the robot, and the task of the actor that reads it. It is closed when this is dropped and the task has
/// been cancelled, so the task has no hold on it.
struct Connection {
    stream: Rc<TcpStream>,
    reading: SpawnHandle,
}

/// Control connection with the robot, or the attempt to open it.
enum Control {
    /// There is no connection.
    Closed,
    /// A connection is being opened by this task of the actor.
    Opening(SpawnHandle),
    /// The connection is open.
    Open(Connection),
}

/// Data received on a connection or a socket of the robot.
enum Received {
    /// Bytes of the control connection with this number; none at its end.
    Control(u32, io::Result<Vec<u8>>),
    /// Bytes of the event connection that belongs to the control connection with this number; none at its end.
    Event(u32, io::Result<Vec<u8>>),
    /// State datagram (push).
    Push(Vec<u8>),
    /// Announcement of a robot on the network.
    Announcement(Vec<u8>),
}

/// Actor that has all connections with one robot.
struct Links {
    config: Tcp,
    port: Port,
    began: Instant,
    /// Number of the current connection or attempt.
    number: u32,
    control: Control,
    /// Former connection, which is closed once a new one is open.
    old: Option<Connection>,
    events: Option<Connection>,
    /// Whether state datagrams are received.
    pushes: bool,
    /// Whether announcements of robots are received.
    announcements: bool,
    /// Timer at which the robot is stopped unless a packet extends its motion; `None` if it stands.
    stop_at: Option<SpawnHandle>,
    /// Whether a motion has expired without a newer packet of the control thread, which is logged once.
    hangs: bool,
    /// Text of the last log entry about the connection, so that each change is logged once.
    logged: String,
    /// Address of another robot that has announced itself on the network; `None` if none has.
    announced: Option<Ipv4Addr>,
}

impl Actor for Links {
    type Context = Context<Self>;
}

impl Supervised for Links {
    fn restarting(&mut self, _: &mut Context<Self>) {
        // Tasks of the life before are gone, and so is what they read.
        (self.control, self.old, self.events) = (Control::Closed, None, None);
        (self.pushes, self.announcements, self.stop_at) = (false, false, None);
    }
}

impl Handler<Input> for Links {
    type Result = ();

    fn handle(&mut self, input: Input, context: &mut Context<Self>) {
        match input {
            Input::Packet(packet) => self.carry_out(&packet, context),
            Input::Close => self.end(context),
        }
    }
}

impl StreamHandler<Received> for Links {
    fn handle(&mut self, received: Received, context: &mut Context<Self>) {
        match received {
            Received::Control(number, bytes) if number == self.number => match bytes {
                Ok(bytes) if bytes.is_empty() => self.close("has closed the connection", context),
                Ok(bytes) => self.port.send(FromWorker::Control(number, &bytes).encode()),
                Err(error) => self.close(&format!("is lost: {error}"), context),
            },
            Received::Event(number, bytes) if number == self.number => match bytes {
                Ok(bytes) if !bytes.is_empty() => self.port.send(FromWorker::Event(number, &bytes).encode()),
                _ => drop_connection(&mut self.events, context),
            },
            // Of a connection before.
            Received::Control(..) | Received::Event(..) => {}
            Received::Push(datagram) => {
                let stamp_ns = u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX);
                self.port.send(FromWorker::Push(stamp_ns, &datagram).encode());
            }
            Received::Announcement(datagram) => {
                let other = decode_announcement(&datagram).ok().filter(|at| *at != self.config.address);
                self.announced = other.or(self.announced);
            }
        }
    }

    /// The end of a connection is an input of its own.
    fn finished(&mut self, _: &mut Context<Self>) {}
}

impl Links {
    fn new(config: Tcp, port: Port) -> Links {
        Links {
            config,
            port,
            began: Instant::now(),
            number: 0,
            control: Control::Closed,
            old: None,
            events: None,
            pushes: false,
            announcements: false,
            stop_at: None,
            hangs: false,
            logged: String::new(),
            announced: None,
        }
    }

    fn carry_out(&mut self, packet: &[u8], context: &mut Context<Self>) {
        match ToWorker::decode(packet) {
            Some(ToWorker::Open) => self.open(context),
            Some(ToWorker::Write { connection, hold, line }) if connection == self.number => {
                match hold {
                    Hold::Keep => {}
                    Hold::Standing => self.stand_after(None, context),
                    Hold::For(span) => {
                        let hold = Duration::from_nanos(span.as_nanos()).min(LONGEST_HOLD);
                        self.stand_after(Some(hold), context);
                    }
                }
                self.hangs = false;
                self.write(line.as_bytes(), context);
            }
            Some(ToWorker::Write { .. }) => {}
            None => tracing::error!("{}: the driver's packet is not understood", self.config.robot),
        }
    }

    /// Sets the time after which the robot is stopped without a newer packet; `None` if it stands.
    fn stand_after(&mut self, hold: Option<Duration>, context: &mut Context<Self>) {
        if let Some(timer) = self.stop_at.take() {
            context.cancel_future(timer);
        }
        self.stop_at = hold.map(|hold| context.run_later(hold, Links::expire));
    }

    /// Sends a stand command, since the robot's motion has expired without a newer packet, as when the control thread
    /// hangs.
    fn expire(&mut self, context: &mut Context<Self>) {
        if !std::mem::replace(&mut self.hangs, true) {
            tracing::error!("the control thread is silent: {} is stopped", self.config.robot);
        }
        self.stop_at = Some(context.run_later(STAND_PERIOD, Links::expire));
        self.write(Line::Stand.encode(0).as_bytes(), context);
    }

    /// Writes bytes to the control connection, if it is open; closes it if that fails. A line always fits into the
    /// send buffer of a connection that is alive.
    fn write(&mut self, line: &[u8], context: &mut Context<Self>) {
        let Control::Open(connection) = &self.control else { return };
        match connection.stream.try_write(line) {
            Ok(written) if written == line.len() => {}
            Ok(_) => self.close("is lost: it takes no more commands", context),
            Err(error) => self.close(&format!("is lost: {error}"), context),
        }
    }

    /// Begins to open a new connection, after a stand command on the present one.
    fn open(&mut self, context: &mut Context<Self>) {
        // A dead connection delivers this line if it comes back to life, which may be before a new one is open.
        self.write(Line::Stand.encode(0).as_bytes(), context);
        self.number = self.number.wrapping_add(1);
        self.stand_after(None, context);
        drop_connection(&mut self.events, context);
        match std::mem::replace(&mut self.control, Control::Closed) {
            Control::Closed => {}
            Control::Opening(attempt) => drop(context.cancel_future(attempt)),
            Control::Open(connection) => {
                drop_connection(&mut self.old, context);
                self.old = Some(connection);
            }
        }
        // Several workers of a host hear each broadcast; without the port, there are no hints.
        if self.config.announcements
            && !self.announcements
            && let Ok(socket) = listen(ANNOUNCEMENT_PORT)
        {
            context.add_stream(datagrams(socket, Received::Announcement));
            self.announcements = true;
        }
        if !self.pushes {
            match self.listen_to_pushes() {
                Ok(socket) => {
                    context.add_stream(datagrams(socket, Received::Push));
                    self.pushes = true;
                }
                Err(error) => {
                    let hint = "end the other program that has it (`ss -ulnp` names it)";
                    return self.close(&format!("cannot be heard: UDP port {PUSH_PORT}: {error}; {hint}"), context);
                }
            }
        }
        let connecting = connect(self.config.address, CONTROL_PORT, CONNECTING).into_actor(self);
        self.control = Control::Opening(context.spawn(connecting.map(|stream, links, context| match stream {
            Ok(stream) => links.opened(stream, context),
            Err(error) => links.failed(&error, context),
        })));
    }

    /// Returns a UDP socket for the state datagrams (pushes) of this robot. It is bound to the port that all robots use
    /// and connected to this robot's address with port 0, so the kernel passes on only datagrams from that address.
    fn listen_to_pushes(&self) -> io::Result<UdpSocket> {
        let socket = listen(PUSH_PORT)?;
        SockRef::from(&socket).connect(&SocketAddrV4::new(self.config.address, 0).into())?;
        Ok(socket)
    }

    fn opened(&mut self, stream: TcpStream, context: &mut Context<Self>) {
        // The robot ends SDK mode when any connection ends. So the old one is reset before the new one says anything:
        // the robot is notified at once, and no written byte arrives late.
        if let Some(old) = &self.old {
            let _ = old.stream.set_zero_linger();
        }
        drop_connection(&mut self.old, context);
        let number = self.number;
        let stream = Rc::new(stream);
        let reading = context.add_stream(bytes(Rc::downgrade(&stream), move |bytes| Received::Control(number, bytes)));
        self.control = Control::Open(Connection { stream, reading });
        self.report(tracing::Level::INFO, "answers");
        if self.config.events {
            let connecting = connect(self.config.address, EVENT_PORT, ENDING).into_actor(self);
            context
                .spawn(connecting.map(move |events, links, context| links.listen_to_events(number, events, context)));
        }
        self.port.send(FromWorker::Opened(number).encode());
    }

    fn listen_to_events(&mut self, number: u32, events: io::Result<TcpStream>, context: &mut Context<Self>) {
        match events {
            Ok(_) if number != self.number => {}
            Ok(stream) => {
                let stream = Rc::new(stream);
                let reading =
                    context.add_stream(bytes(Rc::downgrade(&stream), move |bytes| Received::Event(number, bytes)));
                self.events = Some(Connection { stream, reading });
            }
            Err(error) => tracing::warn!("{} has no events on TCP port {EVENT_PORT}: {error}", self.config.robot),
        }
    }

    fn failed(&mut self, error: &io::Error, context: &mut Context<Self>) {
        let text = if error.kind() == ErrorKind::ConnectionRefused {
            format!(
                "refuses TCP port {CONTROL_PORT}: a stock RoboMaster S1 has no SDK (use an EP, or the S1's CAN bus \
                 through the driver 'ros2'); an EP that was just switched on needs half a minute; \
                 or the address is another machine's"
            )
        } else {
            let hint = self.announced.map_or(String::new(), |at| format!("; another robot announces itself at {at}"));
            format!("does not answer ({error}): switch it on, and check address and network{hint}")
        };
        self.close(&text, context);
    }

    fn close(&mut self, why: &str, context: &mut Context<Self>) {
        self.report(tracing::Level::ERROR, why);
        if let Control::Open(connection) = std::mem::replace(&mut self.control, Control::Closed) {
            drop_connection(&mut Some(connection), context);
        }
        drop_connection(&mut self.events, context);
        self.stand_after(None, context);
        let why = format!("{} {why}", self.config.address);
        self.port.send(FromWorker::Closed(self.number, why.as_bytes()).encode());
    }

    fn report(&mut self, level: tracing::Level, what: &str) {
        if self.logged != what {
            what.clone_into(&mut self.logged);
            let line = format!("{} at {} {what}", self.config.robot, self.config.address);
            if level == tracing::Level::ERROR { tracing::error!("{line}") } else { tracing::info!("{line}") }
        }
    }

    /// Stops the robot, ends its SDK mode, waits up to `ENDING` for the answers, and stops the actor.
    fn end(&mut self, context: &mut Context<Self>) {
        let open = match std::mem::replace(&mut self.control, Control::Closed) {
            Control::Open(connection) => Some(connection),
            Control::Opening(_) | Control::Closed => None,
        };
        let mut streams = Vec::new();
        for Connection { stream, reading } in open.into_iter().chain(self.old.take()) {
            context.cancel_future(reading);
            streams.push(stream);
        }
        self.stand_after(None, context);
        let parting = async move {
            for stream in streams {
                // A connection that is dead does not take it; there is no other way to the robot.
                let Ok(stream) = Rc::try_unwrap(stream) else { unreachable!("its task has no hold on it") };
                let _ = timeout(ENDING, part(stream)).await;
            }
        };
        context.spawn(parting.into_actor(self).map(|(), _, context| context.stop()));
    }
}

/// Stops the robot by a connection, ends its SDK mode, and reads its answers until it closes the connection.
async fn part(mut stream: TcpStream) -> io::Result<()> {
    let lines = [Line::Stand.encode(0), Line::Quit.encode(0)].concat();
    stream.write_all(lines.as_bytes()).await?;
    stream.shutdown().await?;
    while stream.read(&mut [0; BYTES]).await? > 0 {}
    Ok(())
}

/// Cancels the task that reads a connection, and closes the connection.
fn drop_connection(connection: &mut Option<Connection>, context: &mut Context<Links>) {
    if let Some(Connection { stream, reading }) = connection.take() {
        context.cancel_future(reading);
        drop(stream);
    }
}
