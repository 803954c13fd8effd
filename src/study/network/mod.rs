//! The network study: which addressing and which reliability carry a team's messages over a medium, at which rates.
//!
//! Pure: `case` says what is varied, `medium` what it is sent over, `emulate` runs one case, `outcome` is what came of
//! it. Stations speak through the project's own link layer (`linked`) or as the reliable mode of RTPS does (`rtps`).
//! Nothing here reads a clock or opens a socket: a measurement between real hosts hands in the same outcomes.

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
pub mod talk;

pub use case::{Addressing, Assurance, Case, History, Network, Source, Sweep};
pub use medium::Medium;
pub use outcome::{Outcome, Row};
