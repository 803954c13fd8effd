//! Runtime of actors: mailboxes, supervision, the clock with its queue of events, and three event loops.
//!
//! `shell` is the only file that names the actor library. The event loops are `drive` in virtual time, `real` in real
//! time, and `replay` in the time of a recorded run. `real` waits by `watch` on Linux and by `poll` elsewhere.

pub mod clock;
pub mod drive;
mod mailbox;
#[cfg(any(test, not(target_os = "linux")))]
mod poll;
pub mod real;
pub(crate) mod replay;
pub mod shell;
#[cfg(target_os = "linux")]
mod watch;
