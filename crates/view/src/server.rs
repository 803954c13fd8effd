//! HTTP server of the live page, as the thread that drives the team sees it: opened and closed, given the newest
//! values, and asked for commands.
//!
//! That thread never waits. It stores the newest snapshot and status with `try_lock`, without waking another thread,
//! and takes commands from a bounded queue. The server runs on a thread of its own: see `host`.

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use tokio::sync::Notify;

use murmurate::edge::{self, Gate, Running};

use super::access::Access;
use super::command::Command;
use super::host::Listening;
use super::places::{MAX_WAITING, Places};
use super::shared::{Shared, Slot};

/// Largest number of simultaneous connections to the live page's server that are no WebSockets. A page has three while
/// it loads, and then two WebSockets.
pub const MAX_CONNECTIONS: usize = MAX_WAITING;
/// Capacity of the command queue. Further commands are refused.
const MAX_COMMANDS: usize = 64;
/// Longest time that closing the server takes: twice what it gives to its connections.
const CLOSE: Duration = Duration::from_secs(1);

/// Running HTTP server of the live page.
pub struct Server {
    shared: Arc<Shared>,
    address: SocketAddr,
    gate: Gate,
    running: Running,
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
        listener.set_nonblocking(true)?;
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
            news: Notify::new(),
            refused: AtomicU64::new(0),
        });
        let (gate, running) = edge::start(Box::new(Listening { listener, shared: Arc::clone(&shared) }), "page")?;
        let server = Server { shared: Arc::clone(&shared), address, gate, running };
        Ok((server, Publisher { shared, commands }))
    }

    /// Returns the address at which the server listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns the current number of connections.
    pub fn connections(&self) -> usize {
        self.shared.places().len()
    }

    /// Returns the number of requests and commands that were refused so far.
    pub fn refused(&self) -> u64 {
        self.shared.refused.load(Ordering::Relaxed)
    }

    /// Closes the server. Pages still get the last status if they read it within half a second.
    pub fn close(self) {
        drop(self.gate);
        self.running.join(CLOSE);
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
