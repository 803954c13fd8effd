//! Network study: delivery, delay and airtime of a team's messages by addressing, reliability, retry limit and rate.
//!
//! Pure: `case` has the parameters that are varied, `medium` the medium, `emulate` runs one case, `outcome` is its
//! result. Stations use the project's link layer (`linked`) or the reliable mode of RTPS (`rtps`). Measurements between
//! real hosts give the same kind of outcomes.

pub mod case;
pub mod conditions;
pub mod emulate;
pub mod endpoint;
pub mod fit;
pub mod growth;
pub mod linked;
pub mod medium;
pub mod outcome;
pub mod pages;
pub mod peer;
pub mod places;
pub mod rtps;
mod rtps_packet;
mod rtps_reader;
mod rtps_writer;
pub mod saturation;
pub mod scale;
pub mod shaped;
pub mod table;
pub mod traffic;

pub use case::{Addressing, Case, History, NetworkKind, ReliabilityMode, Source, Sweep};
pub use medium::Medium;
pub use outcome::{Outcome, Row};
pub use places::Places;
