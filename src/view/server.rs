//! Server of the page: a thread that accepts, and one for each connection, at most 32.
//!
//! The thread that drives the team never waits here. It leaves the newest snapshot and status in slots with `try_lock`,
//! wakes nobody, and takes commands from a bounded queue; the serving threads look every 20 ms.

use std::io::{self, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Builder;
use std::time::{Duration, Instant};

use tungstenite::Bytes;
use tungstenite::Utf8Bytes;

use super::access::Access;
use super::command::Command;
use super::request::{self, Response};
use super::session;
use super::shared::{LOOK, Shared, Slot};

/// Largest number of connections at once. A page has two, and three more while it loads.
pub const MAX_CONNECTIONS: usize = 32;
/// Number of commands that wait for the thread that drives the team; further ones are refused.
const MAX_COMMANDS: usize = 64;
/// Longest time for which a client may not read before its connection is closed.
const WRITE_TIME: Duration = Duration::from_secs(5);
/// Longest time for connections to send the last status when the server closes.
const CLOSING: Duration = Duration::from_millis(500);

/// Running server of a page.
pub struct Server {
    shared: Arc<Shared>,
    address: SocketAddr,
}

/// End of a server for the thread that drives or watches the team. No method but `wait` takes time.
pub struct Publisher {
    shared: Arc<Shared>,
    commands: Receiver<Command>,
}

impl Server {
    /// Opens a server at `listen` (port 0 for any free one) and starts its thread. `scene` is the message that every
    /// page gets first.
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
            news_ms: AtomicU64::new(0),
            began: Instant::now(),
            stop: AtomicBool::new(false),
            commands: sender,
            closing: AtomicBool::new(false),
            connections: AtomicUsize::new(0),
            refused: AtomicU64::new(0),
        });
        let accepting = Arc::clone(&shared);
        Builder::new().name("page".to_owned()).spawn(move || accept(&listener, &accepting))?;
        let server = Server { shared: Arc::clone(&shared), address };
        Ok((server, Publisher { shared, commands }))
    }

    /// Address at which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Number of connections at present.
    pub fn connections(&self) -> usize {
        self.shared.connections.load(Ordering::Relaxed)
    }

    /// Number of requests and commands that were refused.
    pub fn refused(&self) -> u64 {
        self.shared.refused.load(Ordering::Relaxed)
    }

    /// Ends the server. Pages get the last status if they take it within half a second.
    pub fn close(self) {
        self.shared.closing.store(true, Ordering::Release);
        // Wakes the thread that accepts.
        let _ = TcpStream::connect_timeout(&self.address, CLOSING);
        let until = Instant::now() + CLOSING;
        while self.connections() > 0 && Instant::now() < until {
            std::thread::park_timeout(LOOK);
        }
    }
}

impl Publisher {
    /// Leaves the newest snapshot for the pages; `false` if a page took one at this very instant.
    pub fn snapshot(&self, bytes: Vec<u8>) -> bool {
        self.shared.snapshot.offer(bytes.into())
    }

    /// Leaves the newest goals; `false` as for snapshots.
    pub fn goals(&self, json: String) -> bool {
        self.shared.goals.offer(json.into())
    }

    /// Leaves the newest status; `false` as for snapshots.
    pub fn status(&self, json: String) -> bool {
        self.shared.note_news();
        self.shared.status.offer(json.into())
    }

    /// Leaves the newest text of the metrics; `false` as for snapshots.
    pub fn metrics(&self, text: String) -> bool {
        self.shared.note_news();
        self.shared.metrics.offer(text)
    }

    /// Returns the next command; a stop comes before all others.
    pub fn command(&self) -> Option<Command> {
        self.stop().or_else(|| std::iter::from_fn(|| self.commands.try_recv().ok()).find(is_queued))
    }

    /// Waits for the next command, at most for `limit`. For a run under virtual time, which waits for real time anyway.
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

/// Whether a command of the queue is to be carried out. A stop there only wakes the thread that waits for commands.
fn is_queued(command: &Command) -> bool {
    *command != Command::Stop
}

/// Accepts connections until the server closes.
fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        if shared.closing.load(Ordering::Acquire) {
            return;
        }
        let Ok(stream) = stream else {
            // Out of descriptors, most likely: the next attempt may do better.
            std::thread::park_timeout(LOOK);
            continue;
        };
        if shared.connections.fetch_add(1, Ordering::AcqRel) >= MAX_CONNECTIONS {
            shared.connections.fetch_sub(1, Ordering::AcqRel);
            turn_away(stream, shared);
            continue;
        }
        let taken = Taken(Arc::clone(shared));
        // Without a thread the connection is dropped, and counted down.
        let _ = Builder::new().name("page client".to_owned()).spawn(move || serve(stream, &taken.0));
    }
}

/// Answers a connection beyond the limit without waiting for it.
fn turn_away(mut stream: TcpStream, shared: &Shared) {
    shared.refuse();
    if stream.set_nonblocking(true).is_ok() {
        let _ = stream.write_all(&request::too_many());
    }
}

/// Counts a connection until it is dropped.
struct Taken(Arc<Shared>);

impl Drop for Taken {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Serves one connection to its end.
fn serve(mut stream: TcpStream, shared: &Shared) {
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
    match request::respond(&header.bytes, local, &shared.access) {
        Response::Whole(bytes) => {
            if !bytes.starts_with(b"HTTP/1.1 200") {
                shared.refuse();
            }
            finish(&mut stream, &bytes);
        }
        Response::Metrics => finish(&mut stream, &request::metrics(&shared.metrics.get())),
        Response::Health => finish(&mut stream, &request::health(shared.silent_for())),
        Response::Upgrade(socket, bytes) => {
            if stream.write_all(&bytes).is_ok() {
                session::run(stream, header.rest, socket, shared);
            }
        }
    }
}

/// Sends a whole response and ends the connection.
fn finish(stream: &mut TcpStream, bytes: &[u8]) {
    // A client that has gone needs no answer.
    let _ = stream.write_all(bytes);
    let _ = stream.shutdown(Shutdown::Write);
}
