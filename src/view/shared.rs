//! State shared by the threads of the live page's server: the newest values for browsers, and the queue of commands.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Mutex, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use tungstenite::{Bytes, Utf8Bytes};

use super::access::Access;
use super::command::Command;

/// Period at which serving threads poll for new values.
pub(super) const LOOK: Duration = Duration::from_millis(20);

/// Slot for the newest value of one kind, with a version number.
pub(super) struct Slot<T> {
    number: AtomicU64,
    value: Mutex<T>,
}

impl<T: Clone> Slot<T> {
    pub fn new(value: T) -> Slot<T> {
        Slot { number: AtomicU64::new(0), value: Mutex::new(value) }
    }

    /// Stores a newer value unless a reader holds the lock; returns whether it was stored.
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

    /// Returns the value if its version is not `seen`, and updates `seen`.
    pub fn newer(&self, seen: &mut u64) -> Option<T> {
        let number = self.number.load(Ordering::Acquire);
        if number == *seen {
            return None;
        }
        *seen = number;
        Some(self.get())
    }
}

/// State shared by all threads of the live page's server.
pub(super) struct Shared {
    pub access: Access,
    pub scene: Utf8Bytes,
    pub snapshot: Slot<Bytes>,
    pub goals: Slot<Utf8Bytes>,
    pub status: Slot<Utf8Bytes>,
    /// Metrics in the text format of Prometheus; empty if there are none.
    pub metrics: Slot<String>,
    /// Time of the last sign of life of the thread that drives the team, since `began` \[ms\].
    pub news_ms: AtomicU64,
    pub began: Instant,
    /// A requested stop. It is a flag and not in the queue, because the queue can be full.
    pub stop: AtomicBool,
    pub commands: SyncSender<Command>,
    pub closing: AtomicBool,
    pub connections: AtomicUsize,
    pub refused: AtomicU64,
}

impl Shared {
    /// Records a sign of life of the thread that drives the team.
    pub fn note_news(&self) {
        self.news_ms.store(self.began.elapsed().as_millis() as u64, Ordering::Relaxed);
    }

    /// Returns the time since the last sign of life of the thread that drives the team.
    pub fn silent_for(&self) -> Duration {
        self.began.elapsed().saturating_sub(Duration::from_millis(self.news_ms.load(Ordering::Relaxed)))
    }

    /// Counts a refused request or command.
    pub fn refuse(&self) {
        self.refused.fetch_add(1, Ordering::Relaxed);
    }
}
