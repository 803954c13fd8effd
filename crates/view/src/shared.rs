//! State that the control thread and the live page's server share: the newest values for browsers, and the queue of
//! commands.

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use tokio::sync::{Notify, oneshot};

use super::access::{Access, Ends};
use super::command::Command;
use super::places::{Admission, Places};

/// Name of the server in the report of a panic.
pub(super) const PAGE: &str = "the page's server";
/// Slot for the newest value of one kind, such as the team's status, with a version number.
pub(super) struct Slot<T> {
    number: AtomicU64,
    value: Mutex<T>,
}

impl<T: Clone> Slot<T> {
    /// Returns a slot with this value; its version number is 0.
    pub fn new(value: T) -> Slot<T> {
        Slot { number: AtomicU64::new(0), value: Mutex::new(value) }
    }

    /// Stores a newer value unless another thread is reading the present one; returns whether it was stored.
    pub fn offer(&self, value: T) -> bool {
        let mut place = match self.value.try_lock() {
            Ok(place) => place,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return false,
        };
        *place = value;
        self.number.fetch_add(1, Ordering::Release);
        true
    }

    /// Returns a copy of the newest value.
    pub fn get(&self) -> T {
        self.value.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the version number of the newest value.
    pub fn number(&self) -> u64 {
        self.number.load(Ordering::Acquire)
    }

    /// Returns the value if its version is not `seen`, and sets `seen` to its version; otherwise returns `None`.
    pub fn newer(&self, seen: &mut u64) -> Option<T> {
        let number = self.number();
        if number == *seen {
            return None;
        }
        *seen = number;
        Some(self.get())
    }
}

/// State that the control thread and the tasks of the live page's server share.
pub(super) struct Shared {
    /// Access rules: which commands are accepted, and from which browsers.
    pub access: Access,
    /// Constant properties of the run as JSON, which every page gets first.
    pub scene: Utf8Bytes,
    /// Newest snapshot of the team (states of robots and links), encoded for the page.
    pub snapshot: Slot<Bytes>,
    /// Newest goals of the robots as JSON.
    pub goals: Slot<Utf8Bytes>,
    /// Newest status of the team as JSON.
    pub status: Slot<Utf8Bytes>,
    /// Metrics in the text format of Prometheus; empty if there are none.
    pub metrics: Slot<String>,
    /// Time of the last sign of life of the thread that drives the team \[ms\], since `began`.
    pub alive_ms: AtomicU64,
    /// Time at which the server was opened.
    pub began: Instant,
    /// Whether a browser has requested an emergency stop. It is a flag and not in the queue, because the queue can be
    /// full.
    pub stop: AtomicBool,
    /// Sending end of the bounded queue of browsers' commands.
    pub commands: SyncSender<Command>,
    /// Whether the server is being closed.
    pub closing: AtomicBool,
    /// Present connections, within their limits.
    pub places: Mutex<Places>,
    /// Wakes the tasks of all connections: there are newer values, or the server is being closed. Only the server's
    /// own thread uses it, so the control thread makes no system call.
    pub news: Notify,
    /// Number of requests and commands that were refused so far.
    pub refused: AtomicU64,
}

impl Shared {
    /// Returns the present connections, to be changed. No thread holds them for long.
    pub fn places(&self) -> MutexGuard<'_, Places> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the version numbers of what WebSockets send.
    pub fn numbers(&self) -> [u64; 3] {
        [self.snapshot.number(), self.goals.number(), self.status.number()]
    }

    /// Returns whether the server is being closed.
    pub fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Acquire)
    }

    /// Waits until the server is being closed.
    pub async fn closed(&self) {
        loop {
            let news = self.news.notified();
            if self.is_closing() {
                return;
            }
            news.await;
        }
    }

    /// Records a sign of life of the thread that drives the team, at the present time.
    pub fn note_alive(&self) {
        self.alive_ms.store(self.began.elapsed().as_millis() as u64, Ordering::Relaxed);
    }

    /// Returns the time since the last sign of life of the thread that drives the team.
    pub fn silent_for(&self) -> Duration {
        self.began.elapsed().saturating_sub(Duration::from_millis(self.alive_ms.load(Ordering::Relaxed)))
    }

    /// Counts a refused request or command.
    pub fn refuse(&self) {
        self.refused.fetch_add(1, Ordering::Relaxed);
    }
}

/// A connection, as its requests see it.
#[derive(Clone)]
pub(super) struct Connection {
    /// Its two ends.
    pub ends: Ends,
    /// Its place, which is released with the last reference.
    pub place: Arc<Place>,
}

/// Place of a connection with its number, until it is dropped.
pub(super) struct Place {
    shared: Arc<Shared>,
    number: u64,
}

impl Place {
    /// Takes a place for a connection from `peer`, which is to end when `end` is dropped.
    pub fn take(shared: &Arc<Shared>, peer: IpAddr, end: oneshot::Sender<()>) -> Arc<Place> {
        let number = shared.places().enter(peer, end);
        Arc::new(Place { shared: Arc::clone(shared), number })
    }

    /// Makes the connection a WebSocket of this kind. Returns whether there is a place for it.
    pub fn upgrade(&self, admission: Admission) -> bool {
        self.shared.places().upgrade(self.number, admission)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.shared.places().leave(self.number);
    }
}
