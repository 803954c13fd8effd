//! Runtime of actors: mailboxes, supervision, the clock with its queue of events, and three event loops.
//!
//! `shell` is the only file that names the actor library. The event loops are `drive` in virtual time, `real` in real
//! time, and `replay` in the time of a recorded run.

pub mod clock;
pub mod drive;
pub mod real;
pub(crate) mod replay;
pub mod shell;
