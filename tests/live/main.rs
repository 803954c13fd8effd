//! Teams of real processes in real time, on loopback or between network namespaces.
//!
//! A test that needs root or a missing tool skips, and says so. A test that judges times to a few milliseconds runs
//! [`alone`]; the others run [`beside`] one another, each with ports, groups and namespaces of its own.
#![cfg(target_os = "linux")]

mod addresses;
mod captured;
mod crew;
mod flooded;
mod halted;
mod junk;
mod keys;
mod kill;
mod lab;
mod launched;
mod measured;
mod namespaces;
mod outlets;
mod placed;
#[path = "../program/mod.rs"]
mod program;
mod restarts;
mod robomaster;
mod rosters;
mod stop;

use std::sync::{Condvar, Mutex, MutexGuard};

/// Maximum number of concurrent tests.
const BESIDE: usize = 6;

/// Permits of running tests: so many beside one another, or one alone.
struct Running {
    beside: usize,
    alone: bool,
}

static RUNNING: Mutex<Running> = Mutex::new(Running { beside: 0, alone: false });
static ENDED: Condvar = Condvar::new();

fn running() -> MutexGuard<'static, Running> {
    RUNNING.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Permit of a test to run, until it is dropped.
struct Permit {
    alone: bool,
}

impl Permit {
    fn wait(alone: bool) -> Permit {
        let busy = |now: &mut Running| now.alone || now.beside >= if alone { 1 } else { BESIDE };
        let now = ENDED.wait_while(running(), busy);
        let mut now = now.unwrap_or_else(|poisoned| poisoned.into_inner());
        if alone {
            now.alone = true;
        } else {
            now.beside += 1;
        }
        Permit { alone }
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut now = running();
        if self.alone {
            now.alone = false;
        } else {
            now.beside -= 1;
        }
        ENDED.notify_all();
    }
}

/// Waits until no other test of this program runs, and blocks all others: for tests that would be late if other teams
/// used the processors.
fn alone() -> Permit {
    Permit::wait(true)
}

/// Waits until there is room for a concurrent test: for teams that are mostly idle. It does not wait for tests that
/// wait to be alone, so that those run when most others are over.
fn beside() -> Permit {
    Permit::wait(false)
}
