//! The driver of virtual time: lets the actors run until every mailbox is empty, then goes to the next event.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{self, AtomicBool};
use std::task::{Context, Wake, Waker};

use tokio::task::LocalSet;

use super::clock::Clock;
use super::shell::in_system;
use crate::time::Time;

/// Why a virtual run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// `done` said so.
    Done,
    /// Nothing was left to happen.
    Idle,
}

/// Runs a virtual world on this thread: `build` starts its actors, and time advances until `done`.
pub fn run_virtual<W>(build: impl FnOnce(&Clock) -> W, mut done: impl FnMut(&W, Time) -> bool) -> (W, End) {
    in_system(|| {
        let clock = Clock::default();
        let mut actors = LocalSet::new();
        let world = {
            let _inside = actors.enter();
            build(&clock)
        };
        let end = loop {
            drain(&mut actors);
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

struct Signal(AtomicBool);

impl Wake for Signal {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }
    fn wake_by_ref(self: &Arc<Self>) {
        self.0.store(true, atomic::Ordering::Relaxed);
    }
}

/// Polls the actors until none has anything left to do.
pub(super) fn drain(actors: &mut LocalSet) {
    thread_local! {
        static SIGNAL: Arc<Signal> = Arc::new(Signal(AtomicBool::new(false)));
    }
    SIGNAL.with(|signal| {
        let waker = Waker::from(Arc::clone(signal));
        let mut context = Context::from_waker(&waker);
        loop {
            signal.0.store(false, atomic::Ordering::Relaxed);
            let _ = Pin::new(&mut *actors).poll(&mut context);
            if !signal.0.load(atomic::Ordering::Relaxed) {
                return;
            }
        }
    });
}
