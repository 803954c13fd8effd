//! Teams of real processes in real time, on loopback or between network namespaces.
//!
//! What needs root or a tool that is not there skips, and says so. A test that judges times to a few milliseconds runs
//! [`alone`]; the others run [`beside`] one another, each with ports, groups and namespaces of its own.
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

use std::sync::{RwLock, RwLockReadGuard, RwLockWriteGuard};

static PROCESSORS: RwLock<()> = RwLock::new(());

/// Waits until no other test of this program runs, and keeps all others waiting: for what would be late if other teams
/// took its processors.
fn alone() -> RwLockWriteGuard<'static, ()> {
    PROCESSORS.write().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Waits until no test runs that has to be alone: for teams that spend their time waiting, and leave the processors to
/// others.
fn beside() -> RwLockReadGuard<'static, ()> {
    PROCESSORS.read().unwrap_or_else(|poisoned| poisoned.into_inner())
}
