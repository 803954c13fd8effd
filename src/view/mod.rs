//! The live page: a browser shows a running team and can give the emergency stop. `team_view` builds the picture from
//! the messages that a process receives; `server` sends it to browsers and receives their commands.
//!
//! `snapshot`, `status`, `heard`, `team_view`, `orders` and `command` are pure. `server`, `request` and `session` do
//! the I/O on threads of their own. The thread that drives the team publishes without waiting and takes commands from a
//! bounded queue. [The page on threats](https://github.com/murmurate/murmurate/blob/main/docs/watch.md) lists which
//! requests are refused and why.

pub mod access;
pub mod command;
mod heard;
pub mod orders;
pub mod request;
pub mod server;
mod session;
mod shared;
pub mod snapshot;
pub mod status;
pub mod team_view;
