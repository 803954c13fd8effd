//! The actors: pure state machines, one shell that runs them, and the graph that wires them.
//!
//! `cache`, `agent`, `controller`, `body`, `world`, `state_server`, `network` and `recorder` are cores: no
//! clock, no I/O, no randomness but the streams they are given. `shell` is the only file that names the
//! actor library, `clock` and `drive` are virtual time, `graph` says who talks to whom.

pub mod agent;
pub mod body;
pub mod cache;
pub mod clock;
pub mod controller;
pub mod drive;
pub mod graph;
pub mod host;
mod leading;
pub mod network;
pub mod operator;
pub mod order;
pub mod process;
pub mod real;
pub mod recorder;
pub mod shell;
pub mod sockets;
pub mod state_server;
pub mod status;
pub mod world;

use crate::time::{Span, Time};

/// A state machine with a typed mailbox. No clock, no I/O, no randomness of its own.
pub trait Core {
    /// Everything that this mailbox accepts.
    type In: 'static;
    /// Everything that this actor may say.
    type Out;

    /// Takes one message.
    fn handle(&mut self, now: Time, input: Self::In, out: &mut Vec<Self::Out>);

    /// When `wake` is next due; `None` if only messages matter. A core that wants to be woken before its
    /// first message answers with a past instant.
    fn wake_at(&self) -> Option<Time>;

    /// How late a wake-up that is due in `ahead` may come, in real time, to share one with something else; a control
    /// tick takes none. Virtual time is always on time.
    fn tolerance(&self, ahead: Span) -> Span {
        let _ = ahead;
        Span::ZERO
    }

    /// Does what was due at `now`. Afterwards `wake_at` is later than `now`.
    fn wake(&mut self, now: Time, out: &mut Vec<Self::Out>);
}
