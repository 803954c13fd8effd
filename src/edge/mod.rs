//! The edge of a process: actors that do the I/O of drivers, sources and observers, and the channels between them and
//! the control thread, which drives a robot and never waits.
//!
//! A [`Worker`] starts its actor on an arbiter of its own: a thread with an asynchronous runtime, for the actor's
//! sockets, pipes and timers. The actor library starts and supervises the actor, and starts it again when it stops. The
//! control thread has the [`Gate`], the actor its mailbox and the [`Port`]. Each direction holds up to `ROOM` packets;
//! further ones are dropped and counted, so no thread blocks on sending. A packet is plain bytes, so input can be
//! recorded and replayed like a datagram. A panic in an actor ends the process.

mod bell;
mod channel;
pub(crate) mod child;
pub(crate) mod exclusive;
mod group;
pub mod hold;
mod lines;
pub(crate) mod panic;
pub mod sender_clock;
mod settings;
mod worker;

pub use bell::Bell;
pub use channel::{Gate, Input, PacketSender, Port, WorkerState};
pub use group::{Group, Pipes};
pub use panic::EndsProcess;
pub use settings::Settings;
pub(crate) use worker::join_all;
pub use worker::{Answering, Running, Seat, Worker, start};

/// One message between the control thread and a worker, as bytes.
pub type Packet = Box<[u8]>;

/// Largest number of waiting packets in each direction of a channel between the control thread and a worker: those of
/// three seconds at 20 a second.
pub const ROOM: usize = 64;
