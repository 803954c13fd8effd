//! Live page: the state of a running team in a browser, with the emergency stop. `team_view` builds the state from the
//! messages that a process receives. `server` sends it to browsers and receives their commands.
//!
//! `snapshot`, `scans`, `status`, `mesh`, `team_view`, `timeline`, `metrics`, `orders` and `command` are pure. `host`,
//! `request` and `session` do I/O on one thread of their own: the thread that drives the team publishes without
//! waiting, and takes commands from a bounded queue. [The page on
//! threats](https://github.com/murmurate/murmurate/blob/main/docs/watch.md) lists the refused requests and the reasons.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod access;
pub mod command;
#[cfg(feature = "foxglove")]
mod foxglove_live;
mod host;
mod host_events;
pub mod mesh;
pub mod metrics;
pub mod orders;
mod places;
pub mod player;
mod receptions;
pub mod request;
mod revisions;
mod robot_view;
pub mod scans;
pub mod server;
mod session;
mod shared;
pub mod snapshot;
pub mod status;
pub mod team_view;
pub mod timeline;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
