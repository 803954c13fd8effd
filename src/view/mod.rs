//! The live page: a picture of a running team in a browser, with the emergency stop. `team_view` makes the picture from
//! what a process hears; `server` sends it to browsers and takes their commands.
//!
//! `snapshot`, `status`, `heard`, `team_view`, `timeline`, `metrics`, `orders` and
//! `command` are pure. `server`, `request` and `session` are
//! the I/O, on threads of their own: the thread that drives the team publishes without waiting and takes commands from
//! a bounded queue. [The page on threats](https://github.com/murmurate/murmurate/blob/main/docs/watch.md) says what is
//! refused and why.

pub mod access;
pub mod command;
mod heard;
pub mod metrics;
pub mod orders;
pub mod request;
pub mod server;
mod session;
mod shared;
pub mod snapshot;
pub mod status;
pub mod team_view;
pub mod timeline;
