//! Event loop in virtual time: runs the actors until every mailbox is empty, then advances the clock to the next event.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{self, AtomicBool};
use std::task::{Context, Wake, Waker};

use tokio::task::{LocalEnterGuard, LocalSet};

use super::clock::Clock;
use super::shell::in_system;
use crate::time::Time;

/// Reason for which a run in virtual time has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The function `done`, which the caller gave, returned true.
    Done,
    /// No event was left in the queue of the clock, so nothing would happen any more.
    Idle,
}

/// Runs actors in virtual time on the calling thread. `build` starts the actors and returns their owner. Time advances
/// from event to event; `done` is called after each, and ends the run by returning true. Returns the owner and why the
/// run has ended.
pub fn run_virtual<W>(build: impl FnOnce(&Clock) -> W, mut done: impl FnMut(&W, Time) -> bool) -> (W, End) {
    in_system(|| {
        let clock = Clock::default();
        let mut actors = Tasks::new();
        let world = {
            let _inside = actors.enter();
            build(&clock)
        };
        let end = loop {
            actors.drain(&clock);
            if done(&world, clock.now()) {
                break End::Done;
            }
            if !clock.step() {
                break End::Idle;
            }
        };
        clock.clear();
        (world, end)
    })
}

/// Tasks of the actor library, which starts and restarts actors in them, and whether they have to run.
pub(super) struct Tasks {
    tasks: LocalSet,
    signal: Arc<Signal>,
}

struct Signal(AtomicBool);

impl Wake for Signal {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }
    fn wake_by_ref(self: &Arc<Self>) {
        self.0.store(true, atomic::Ordering::Relaxed);
    }
}

impl Tasks {
    /// Creates an empty set of tasks (futures of the actor library).
    pub(super) fn new() -> Tasks {
        Tasks { tasks: LocalSet::new(), signal: Arc::new(Signal(AtomicBool::new(true))) }
    }

    /// Returns a guard; until it is dropped, actors can be started in this set of tasks.
    pub(super) fn enter(&self) -> LocalEnterGuard {
        self.tasks.enter()
    }

    /// Runs the actors until every mailbox is empty and no task is left to run.
    pub(super) fn drain(&mut self, clock: &Clock) {
        loop {
            clock.run_woken();
            if !self.signal.0.swap(false, atomic::Ordering::Relaxed) {
                return;
            }
            let waker = Waker::from(Arc::clone(&self.signal));
            let _ = Pin::new(&mut self.tasks).poll(&mut Context::from_waker(&waker));
        }
    }
}
