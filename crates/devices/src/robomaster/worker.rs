//! Worker of the RoboMaster driver: has the connections with one robot, and waits on all of them in one poll. A second
//! thread receives the packets of the control thread.
//!
//! The worker itself stops the robot when a motion's validity ends without a newer packet, and when the host ends.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddrV4, TcpStream, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::eventfd::{EfdFlags, EventFd};
use socket2::{Domain, Protocol, Socket, Type};

use super::link::{FromWorker, Hold, ToWorker};
use super::protocol::{ANNOUNCEMENT_PORT, CONTROL_PORT, EVENT_PORT, Line, PUSH_PORT, decode_announcement};
use murmurate::edge::{Packet, PacketSender, Port, Worker};
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
/// Largest number of bytes read at once, from a stream or as one datagram.
const BYTES: usize = 2048;

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

    fn run(self: Box<Self>, mut port: Port) {
        let sender = port.sender();
        let wake = match EventFd::from_flags(EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC) {
            Ok(wake) => Arc::new(wake),
            Err(error) => return tracing::error!("{} cannot be driven: {error}; close other programs", self.robot),
        };
        let (tx, packets) = mpsc::channel();
        let waker = Arc::clone(&wake);
        let taker = thread::spawn(move || {
            while let Some(packet) = port.wait() {
                if tx.send(packet).is_err() {
                    break;
                }
                let _ = waker.write(1);
            }
            // The other thread finds the channel closed.
            drop(tx);
            let _ = waker.write(1);
        });
        Links::new(*self, sender).run(&packets, &wake);
        let _ = taker.join();
    }
}

/// Control connection with the robot, or the attempt to open it.
#[derive(Debug)]
enum Control {
    /// There is no connection.
    Closed,
    /// A connection is being opened, until this time.
    Opening(Socket, Instant),
    /// The connection is open.
    Open(TcpStream),
}

/// All connections with one robot.
struct Links {
    config: Tcp,
    sender: PacketSender,
    began: Instant,
    /// Number of the current connection or attempt.
    number: u32,
    control: Control,
    /// Former connection, which is closed once a new one is open.
    old: Option<TcpStream>,
    events: Option<TcpStream>,
    pushes: Option<UdpSocket>,
    announcements: Option<UdpSocket>,
    /// Time at which the robot is stopped unless a packet extends its motion; `None` if it stands.
    stop_at: Option<Instant>,
    /// Whether a motion has expired without a newer packet of the control thread, which is logged once.
    hangs: bool,
    /// Text of the last log entry about the connection, so that each change is logged once.
    logged: String,
    /// Address of another robot that has announced itself on the network; `None` if none has.
    announced: Option<Ipv4Addr>,
}

impl Links {
    fn new(config: Tcp, sender: PacketSender) -> Links {
        Links {
            config,
            sender,
            began: Instant::now(),
            number: 0,
            control: Control::Closed,
            old: None,
            events: None,
            pushes: None,
            announcements: None,
            stop_at: None,
            hangs: false,
            logged: String::new(),
            announced: None,
        }
    }

    /// Handles packets of the control thread and data of the robot until the control thread closes the channel.
    fn run(mut self, packets: &Receiver<Packet>, wake: &EventFd) {
        loop {
            self.wait(wake);
            let _ = wake.read();
            loop {
                match packets.try_recv() {
                    Ok(packet) => self.handle(&packet),
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return self.end(),
                }
            }
            self.read_datagrams();
            self.read_control();
            self.read_events();
            self.keep_time();
        }
    }

    /// Waits until a connection or the control thread has data, or a deadline is reached.
    fn wait(&self, wake: &EventFd) {
        let mut fds = vec![PollFd::new(wake.as_fd(), PollFlags::POLLIN)];
        match &self.control {
            Control::Closed => {}
            Control::Opening(socket, _) => fds.push(PollFd::new(socket.as_fd(), PollFlags::POLLOUT)),
            Control::Open(stream) => fds.push(PollFd::new(stream.as_fd(), PollFlags::POLLIN)),
        }
        let others: [Option<BorrowedFd>; 3] = [
            self.events.as_ref().map(AsFd::as_fd),
            self.pushes.as_ref().map(AsFd::as_fd),
            self.announcements.as_ref().map(AsFd::as_fd),
        ];
        fds.extend(others.into_iter().flatten().map(|fd| PollFd::new(fd, PollFlags::POLLIN)));
        let opening = if let Control::Opening(_, until) = self.control { Some(until) } else { None };
        let timeout = match opening.into_iter().chain(self.stop_at).min() {
            None => PollTimeout::NONE,
            Some(at) => {
                // Rounded up, so that the time has come when the poll returns.
                let ms = at.saturating_duration_since(Instant::now()).as_micros().div_ceil(1000);
                PollTimeout::try_from(ms.min(10_000)).unwrap_or(PollTimeout::MAX)
            }
        };
        // A signal ends it early, which does no harm.
        let _ = poll(&mut fds, timeout);
    }

    fn handle(&mut self, packet: &[u8]) {
        match ToWorker::decode(packet) {
            Some(ToWorker::Open) => self.open(),
            Some(ToWorker::Write { connection, hold, line }) if connection == self.number => {
                match hold {
                    Hold::Keep => {}
                    Hold::Standing => self.stop_at = None,
                    Hold::For(span) => {
                        let hold = Duration::from_nanos(span.as_nanos()).min(LONGEST_HOLD);
                        self.stop_at = Some(Instant::now() + hold);
                    }
                }
                self.hangs = false;
                self.write(line.as_bytes());
            }
            Some(ToWorker::Write { .. }) => {}
            None => tracing::error!("{}: the driver's packet is not understood", self.config.robot),
        }
    }

    /// Writes bytes to the control connection, if it is open; closes it if that fails. A line always fits into the
    /// send buffer of a connection that is alive.
    fn write(&mut self, line: &[u8]) {
        let Control::Open(stream) = &mut self.control else { return };
        if let Err(error) = stream.write_all(line) {
            self.close(&format!("is lost: {error}"));
        }
    }

    /// Begins to open a new connection, after a stand command on the present one.
    fn open(&mut self) {
        // A dead connection delivers this line if it comes back to life, which may be before a new one is open.
        self.write(Line::Stand.encode(0).as_bytes());
        self.number = self.number.wrapping_add(1);
        self.stop_at = None;
        self.events = None;
        if let Control::Open(stream) = std::mem::replace(&mut self.control, Control::Closed) {
            self.old = Some(stream);
        }
        if self.config.announcements && self.announcements.is_none() {
            // Several workers of a host hear each broadcast; without the port, there are no hints.
            self.announcements = listen(ANNOUNCEMENT_PORT).ok();
        }
        if self.pushes.is_none() {
            match self.listen_to_pushes() {
                Ok(socket) => self.pushes = Some(socket),
                Err(error) => {
                    let hint = "end the other program that has it (`ss -ulnp` names it)";
                    return self.close(&format!("cannot be heard: UDP port {PUSH_PORT}: {error}; {hint}"));
                }
            }
        }
        match self.connect() {
            Ok(socket) => self.control = Control::Opening(socket, Instant::now() + CONNECTING),
            Err(error) => self.failed(&error),
        }
    }

    /// Returns a UDP socket for the state datagrams (pushes) of this robot. It is bound to the port that all robots use
    /// and connected to this robot's address with port 0, so the kernel passes on only datagrams from that address.
    fn listen_to_pushes(&self) -> io::Result<UdpSocket> {
        let socket = listen(PUSH_PORT)?;
        socket.connect(SocketAddrV4::new(self.config.address, 0))?;
        Ok(socket)
    }

    fn connect(&self) -> io::Result<Socket> {
        let socket = Socket::new(Domain::IPV4, Type::STREAM, Some(Protocol::TCP))?;
        socket.set_tcp_nodelay(true)?;
        socket.set_nonblocking(true)?;
        match socket.connect(&SocketAddrV4::new(self.config.address, CONTROL_PORT).into()) {
            Err(error) if error.raw_os_error() != Some(nix::errno::Errno::EINPROGRESS as i32) => Err(error),
            _ => Ok(socket),
        }
    }

    fn read_control(&mut self) {
        match &mut self.control {
            Control::Closed => {}
            Control::Opening(socket, until) => match (socket.take_error(), socket.peer_addr()) {
                (Ok(Some(error)) | Err(error), _) => self.failed(&error),
                (Ok(None), Ok(_)) => self.opened(),
                (Ok(None), Err(_)) if *until <= Instant::now() => self.failed(&ErrorKind::TimedOut.into()),
                (Ok(None), Err(_)) => {}
            },
            Control::Open(stream) => match read(stream) {
                Ok(bytes) if bytes.is_empty() => self.close("has closed the connection"),
                Ok(bytes) => self.sender.send(FromWorker::Control(self.number, &bytes).encode()),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => self.close(&format!("is lost: {error}")),
            },
        }
    }

    fn opened(&mut self) {
        let Control::Opening(socket, _) = std::mem::replace(&mut self.control, Control::Closed) else { return };
        // The robot ends SDK mode when any connection ends. So the old one is reset before the new one says anything.
        if let Some(old) = self.old.take() {
            reset(old);
        }
        self.control = Control::Open(socket.into());
        self.report(tracing::Level::INFO, "answers");
        if self.config.events {
            let address = SocketAddrV4::new(self.config.address, EVENT_PORT).into();
            let events = TcpStream::connect_timeout(&address, ENDING).and_then(|events| {
                events.set_nonblocking(true)?;
                Ok(events)
            });
            match events {
                Ok(events) => self.events = Some(events),
                Err(error) => tracing::warn!("{} has no events on TCP port {EVENT_PORT}: {error}", self.config.robot),
            }
        }
        self.sender.send(FromWorker::Opened(self.number).encode());
    }

    fn failed(&mut self, error: &io::Error) {
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
        self.close(&text);
    }

    fn close(&mut self, why: &str) {
        self.report(tracing::Level::ERROR, why);
        (self.control, self.events, self.stop_at) = (Control::Closed, None, None);
        let why = format!("{} {why}", self.config.address);
        self.sender.send(FromWorker::Closed(self.number, why.as_bytes()).encode());
    }

    fn report(&mut self, level: tracing::Level, what: &str) {
        if self.logged != what {
            what.clone_into(&mut self.logged);
            let line = format!("{} at {} {what}", self.config.robot, self.config.address);
            if level == tracing::Level::ERROR { tracing::error!("{line}") } else { tracing::info!("{line}") }
        }
    }

    fn read_datagrams(&mut self) {
        let mut bytes = [0; BYTES];
        if let Some(pushes) = &self.pushes {
            // An ICMP error of an earlier datagram is no datagram; the next one is read at the next poll.
            while let Ok(length) = pushes.recv(&mut bytes) {
                let stamp_ns = u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX);
                self.sender.send(FromWorker::Push(stamp_ns, &bytes[..length]).encode());
            }
        }
        if let Some(announcements) = &self.announcements {
            while let Ok(length) = announcements.recv(&mut bytes) {
                let other = decode_announcement(&bytes[..length]).ok().filter(|at| *at != self.config.address);
                self.announced = other.or(self.announced);
            }
        }
    }

    fn read_events(&mut self) {
        let Some(stream) = &mut self.events else { return };
        match read(stream) {
            Ok(bytes) if bytes.is_empty() => self.events = None,
            Ok(bytes) => self.sender.send(FromWorker::Event(self.number, &bytes).encode()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => self.events = None,
        }
    }

    /// Sends a stand command if the robot's motion has expired without a newer packet, as when the control thread
    /// hangs.
    fn keep_time(&mut self) {
        let now = Instant::now();
        if self.stop_at.is_some_and(|at| at <= now) {
            if !std::mem::replace(&mut self.hangs, true) {
                tracing::error!("the control thread is silent: {} is stopped", self.config.robot);
            }
            self.stop_at = Some(now + STAND_PERIOD);
            self.write(Line::Stand.encode(0).as_bytes());
        }
    }

    /// Stops the robot, ends its SDK mode and waits up to `ENDING` for the answers.
    fn end(mut self) {
        let lines = [Line::Stand.encode(0), Line::Quit.encode(0)].concat();
        let open = if let Control::Open(stream) = std::mem::replace(&mut self.control, Control::Closed) {
            Some(stream)
        } else {
            None
        };
        for mut stream in open.into_iter().chain(self.old.take()) {
            // A connection that is dead does not take it; there is no other way to the robot.
            let _ = stream.write_all(lines.as_bytes()).and_then(|()| stream.shutdown(Shutdown::Write));
            let until = Instant::now() + ENDING;
            let _ = stream.set_nonblocking(false);
            loop {
                let left = until.saturating_duration_since(Instant::now());
                if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
                    break;
                }
                match stream.read(&mut [0; BYTES]) {
                    Ok(0) | Err(_) => break,
                    Ok(_) => {}
                }
            }
        }
    }
}

/// Returns a non-blocking UDP socket bound to `port` on all local addresses. Other programs and workers may bind the
/// port as well.
fn listen(port: u16) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, port).into())?;
    Ok(socket.into())
}

/// Reads up to `BYTES` available bytes from a stream; returns an empty vector at its end.
fn read(stream: &mut TcpStream) -> io::Result<Vec<u8>> {
    let mut bytes = [0; BYTES];
    let length = stream.read(&mut bytes)?;
    Ok(bytes[..length].to_vec())
}

/// Closes a connection with a reset: the peer is notified at once, and no written byte arrives late.
fn reset(stream: TcpStream) {
    let _ = Socket::from(stream).set_linger(Some(Duration::ZERO));
}
