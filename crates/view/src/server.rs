//! HTTP server of the live page: one thread accepts connections, and each connection has its own, within limits.
//!
//! The thread that drives the team never waits. It stores the newest snapshot and status with `try_lock`, without
//! waking another thread, and takes commands from a bounded queue. The serving threads poll every 20 ms.

use std::io::{self, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::Builder;
use std::time::{Duration, Instant};

use tungstenite::Bytes;
use tungstenite::Utf8Bytes;

use super::access::Access;
use super::command::Command;
use super::places::{Admission, MAX_WAITING, Places};
use super::request::{self, Response};
use super::session;
use super::shared::{LOOK, Shared, Slot};

/// Largest number of simultaneous connections to the live page's server that are no WebSockets. A page has three while
/// it loads, and then two WebSockets.
pub const MAX_CONNECTIONS: usize = MAX_WAITING;
/// Capacity of the command queue. Further commands are refused.
const MAX_COMMANDS: usize = 64;
/// Write timeout: a connection is closed if its client does not read for this long.
const WRITE_TIME: Duration = Duration::from_secs(5);
/// Longest time that the closing server waits for connections to send the last status.
const CLOSING: Duration = Duration::from_millis(500);

/// Running HTTP server of the live page.
pub struct Server {
    shared: Arc<Shared>,
    address: SocketAddr,
}

/// Interface to the live page's server for the thread that drives or watches the team: publishes snapshots, goals,
/// status and metrics, and takes commands. Only `wait` blocks.
pub struct Publisher {
    shared: Arc<Shared>,
    commands: Receiver<Command>,
}

impl Server {
    /// Opens a server at `listen` (port 0 selects any free port) and starts its thread. `scene` is the JSON text with
    /// the constant properties of the run, which every page gets first.
    pub fn open(listen: SocketAddr, access: Access, scene: String) -> io::Result<(Server, Publisher)> {
        let listener = TcpListener::bind(listen)?;
        let address = listener.local_addr()?;
        let (sender, commands) = sync_channel(MAX_COMMANDS);
        let shared = Arc::new(Shared {
            access,
            scene: scene.into(),
            snapshot: Slot::new(Bytes::new()),
            goals: Slot::new(Utf8Bytes::default()),
            status: Slot::new(Utf8Bytes::default()),
            metrics: Slot::new(String::new()),
            alive_ms: AtomicU64::new(0),
            began: Instant::now(),
            stop: AtomicBool::new(false),
            commands: sender,
            closing: AtomicBool::new(false),
            places: Mutex::new(Places::default()),
            left: Condvar::new(),
            refused: AtomicU64::new(0),
        });
        let accepting = Arc::clone(&shared);
        Builder::new().name("page".to_owned()).spawn(move || accept(&listener, &accepting))?;
        let server = Server { shared: Arc::clone(&shared), address };
        Ok((server, Publisher { shared, commands }))
    }

    /// Returns the address at which the server listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns the current number of connections.
    pub fn connections(&self) -> usize {
        places(&self.shared).len()
    }

    /// Returns the number of requests and commands that were refused so far.
    pub fn refused(&self) -> u64 {
        self.shared.refused.load(Ordering::Relaxed)
    }

    /// Closes the server. Pages still get the last status if they read it within half a second.
    pub fn close(self) {
        self.shared.closing.store(true, Ordering::Release);
        // The connection unblocks the accepting thread.
        let _ = TcpStream::connect_timeout(&self.address, CLOSING);
        drop(self.shared.left.wait_timeout_while(places(&self.shared), CLOSING, |present| present.len() > 0));
    }
}

impl Publisher {
    /// Publishes the newest encoded snapshot of the team (states of robots and links). Returns `false`, without
    /// waiting, if it was not stored because another thread is reading the previous one.
    pub fn snapshot(&self, bytes: Vec<u8>) -> bool {
        self.shared.snapshot.offer(bytes.into())
    }

    /// Publishes the robots' newest goals as JSON. Returns `false`, without waiting, if they were not stored because
    /// another thread is reading the previous ones.
    pub fn goals(&self, json: String) -> bool {
        self.shared.goals.offer(json.into())
    }

    /// Publishes the team's newest status as JSON. Returns `false`, without waiting, if it was not stored because
    /// another thread is reading the previous one.
    pub fn status(&self, json: String) -> bool {
        self.shared.note_alive();
        self.shared.status.offer(json.into())
    }

    /// Publishes the newest metrics as text. Returns `false`, without waiting, if they were not stored because another
    /// thread is reading the previous ones.
    pub fn metrics(&self, text: String) -> bool {
        self.shared.note_alive();
        self.shared.metrics.offer(text)
    }

    /// Returns the next command from a browser without waiting, an emergency stop before all others; `None` if there is
    /// none.
    pub fn command(&self) -> Option<Command> {
        self.stop().or_else(|| std::iter::from_fn(|| self.commands.try_recv().ok()).find(is_queued))
    }

    /// Waits at most `limit` for the next command from a browser and returns it; `None` if there is none. It is for a
    /// simulation at the pace of real time, which waits anyway.
    pub fn wait(&self, limit: Duration) -> Option<Command> {
        let command = match self.command() {
            None => self.commands.recv_timeout(limit).ok()?,
            command => return command,
        };
        self.stop().or(Some(command).filter(is_queued))
    }

    fn stop(&self) -> Option<Command> {
        self.shared.stop.swap(false, Ordering::AcqRel).then_some(Command::Stop)
    }
}

/// Returns whether a command from the queue is to be executed. A queued emergency stop is not: it only wakes the
/// waiting thread, and is executed because of a separate flag.
fn is_queued(command: &Command) -> bool {
    *command != Command::Stop
}

/// Accepts connections in a loop, each served by a thread of its own, until the server closes.
fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        if shared.closing.load(Ordering::Acquire) {
            return;
        }
        let Ok(stream) = stream else {
            // Probably no file descriptors are left: try again later.
            std::thread::park_timeout(LOOK);
            continue;
        };
        let Ok(peer) = stream.peer_addr() else { continue };
        let number = places(shared).enter(peer.ip(), stream.try_clone().ok());
        let taken = Taken(Arc::clone(shared), number);
        // If no thread can be started, the connection is closed and no longer counted.
        let _ = Builder::new().name("page client".to_owned()).spawn(move || serve(stream, peer.ip(), &taken));
    }
}

/// Returns the present connections, to be changed. No thread holds them for long.
fn places(shared: &Shared) -> MutexGuard<'_, Places> {
    shared.places.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Place of a connection with its number, until it is dropped.
struct Taken(Arc<Shared>, u64);

impl Drop for Taken {
    fn drop(&mut self) {
        places(&self.0).leave(self.1);
        self.0.left.notify_all();
    }
}

/// Serves one connection of a browser at `peer` until it ends.
fn serve(mut stream: TcpStream, peer: IpAddr, taken: &Taken) {
    let shared = &*taken.0;
    let Ok(local) = stream.local_addr() else { return };
    if stream.set_write_timeout(Some(WRITE_TIME)).is_err() || stream.set_nodelay(true).is_err() {
        return;
    }
    let header = match request::read_header(&mut stream) {
        Ok(read) => read,
        Err(answer) => {
            shared.refuse();
            answer.iter().for_each(|answer| finish(&mut stream, answer));
            return;
        }
    };
    match request::respond(&header.bytes, (local, peer), &shared.access) {
        Response::Whole(bytes) => {
            if !bytes.starts_with(b"HTTP/1.1 200") {
                shared.refuse();
            }
            finish(&mut stream, &bytes);
        }
        Response::Metrics => finish(&mut stream, &request::metrics(&shared.metrics.get())),
        Response::Health => finish(&mut stream, &request::health(shared.silent_for())),
        Response::Upgrade(socket, bytes) => {
            let admission = if socket.is_holder() { Admission::Holder } else { Admission::Other };
            if !places(shared).upgrade(taken.1, admission) {
                shared.refuse();
                finish(&mut stream, &request::too_many());
                return;
            }
            if stream.write_all(&bytes).is_ok() {
                session::run(stream, header.rest, socket, shared);
            }
        }
    }
}

/// Sends a complete response and ends the connection.
fn finish(stream: &mut TcpStream, bytes: &[u8]) {
    // Write errors are ignored: the client is gone.
    let _ = stream.write_all(bytes);
    let _ = stream.shutdown(Shutdown::Write);
}
