//! Teams of real processes in real time, on loopback or between network namespaces.
//!
//! What needs root or a tool that is not there skips, and says so. One test runs at a time: see [`alone`].
#![cfg(target_os = "linux")]

mod crew;
mod flooded;
mod junk;
mod kill;
mod lab;
mod launched;
mod measured;
mod namespaces;
mod outlets;
#[path = "../program/mod.rs"]
mod program;
mod stop;

use std::sync::{Mutex, MutexGuard};

/// Waits until no other test of this program runs: teams in real time would take each other's processors.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}
