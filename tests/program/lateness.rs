//! Measurement of the delay that a busy machine adds to a test, so that promises on times are not judged by it.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Period of the measurement.
const PERIOD: Duration = Duration::from_millis(10);
/// Largest number of waits, one after another, in a promised time: of two processes, their network, and the reader.
const WAITS: u32 = 4;

/// Running measurement of how late threads are woken.
pub struct Lateness {
    over: Sender<()>,
    thread: JoinHandle<Duration>,
}

impl Lateness {
    /// Starts the measurement, in a thread of its own.
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

    /// Ends the measurement. Returns the most that this machine can have added to a promised time: some milliseconds if
    /// it was idle.
    pub fn end(self) -> Duration {
        drop(self.over);
        WAITS * self.thread.join().expect("it only counts")
    }
}
