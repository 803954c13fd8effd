//! Messages that may cross hosts. Each passes through a Network, within one process too.
//!
//! Positions and velocities are in the world frame, \[m\] and \[m/s\]. Integers have a fixed width. Soft state
//! (`Heartbeat`, `Mode`) is repeated and idempotent; no message asks for an answer.

pub use super::body::{MAX_BLOCK, Publisher, REVISION, Receiver, Unfit};
pub(crate) use super::exchange::all_sound;
pub use super::exchange::{Latent, MAX_VALIDITY, MotorCommand, Reading};
pub use super::floats::{Features, MAX_FEATURES};
pub use super::hardware::{Celsius, Hardware, Health, Reason};
pub use super::kinds::{KINDS, Kind, Wire};
pub use super::leading::{Heartbeat, Mode, Stop};
pub use super::phase::Phase;
pub use super::place::{Located, Place, Placed, Whereabouts};
pub use super::round::Round;
pub use super::status::{Following, Hindrance, Leading, MAX_HINDRANCES, Status};
pub use super::telemetry::{Condition, GuardReport, MAX_CONDITIONS, Observe, Seen, Telemetry};
