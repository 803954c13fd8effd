//! Network study: delivery, delay and airtime of a team's messages by addressing, reliability, retry limit and rate.
//!
//! Pure: `case` holds the parameters that are varied, `medium` the medium, `emulate` runs one case, `outcome` is its
//! result. Stations use the project's own link layer (`linked`) or the reliable mode of RTPS (`rtps`). Nothing here
//! reads a clock or opens a socket; measurements between real hosts produce the same outcomes.

pub mod case;
#[cfg(feature = "train")]
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
pub mod rtps;
pub mod saturation;
pub mod scale;
pub mod shaped;
pub mod table;
pub mod traffic;

pub use case::{Addressing, Case, History, NetworkKind, ReliabilityMode, Source, Sweep};
pub use medium::Medium;
pub use outcome::{Outcome, Row};
