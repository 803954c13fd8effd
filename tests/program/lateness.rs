//! How late this machine is while a test runs, so that promises on times are not judged by how busy it is.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Period at which the machine is tried.
const PERIOD: Duration = Duration::from_millis(10);
/// Waits, one after another, that a promise spans at most: of two processes, the network between them, and the reader.
const WAITS: u32 = 4;

/// Thread that measures how late threads are woken, until it is asked.
pub struct Lateness {
    over: Sender<()>,
    thread: JoinHandle<Duration>,
}

impl Lateness {
    pub fn watch() -> Lateness {
        let (over, ended) = channel::<()>();
        let thread = thread::spawn(move || {
            let (mut worst, mut before) = (Duration::ZERO, Instant::now());
            while ended.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                let now = Instant::now();
                worst = worst.max((now - before).saturating_sub(PERIOD));
                before = now;
            }
            worst
        });
        Lateness { over, thread }
    }

    /// Returns what this machine has added to a promise on times at most: some milliseconds if it was idle.
    pub fn end(self) -> Duration {
        drop(self.over);
        WAITS * self.thread.join().expect("it only counts")
    }
}
