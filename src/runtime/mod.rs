//! Runtime of actors: mailboxes, supervision, the event queue, and the two drivers of time.
//!
//! `shell` is the only file that names the actor library; `clock` and `drive` are virtual time, `real` is real time.

pub mod clock;
pub mod drive;
pub mod real;
pub mod replay;
pub mod shell;
