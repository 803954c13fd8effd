//! Messages that may cross hosts. Each passes through a Network, within one process too.
//!
//! Positions and velocities are in the world frame, \[m\] and \[m/s\]. Integers have a fixed width. Soft state
//! (`Heartbeat`, `Mode`) is repeated and idempotent; no message asks for an answer.

pub use super::aloft::*;
pub use super::body::*;
pub use super::exchange::*;
pub use super::floats::*;
pub use super::hardware::*;
pub use super::kinds::*;
pub use super::leading::*;
pub use super::parts::*;
pub use super::phase::*;
pub use super::place::*;
pub use super::release::*;
pub use super::round::*;
pub use super::sensed::*;
pub use super::status::*;
pub use super::telemetry::*;
