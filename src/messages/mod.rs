//! Every message of the system: plain data, serde only. No behaviour beyond checking one's own ranges.
//!
//! `wire` holds what may cross hosts and therefore always passes through a Network; `local` holds what
//! stays between the actors of one host; `ids`, `geometry`, `floats`, `latch`, `round` and `status` are
//! their vocabulary. `nalgebra` turns points and poses into that crate's and back.

mod floats;
pub mod geometry;
pub mod ids;
pub mod latch;
pub mod local;
#[cfg(feature = "nalgebra")]
mod nalgebra;
pub mod phase;
pub mod round;
pub mod status;
pub mod telemetry;
pub mod wire;
