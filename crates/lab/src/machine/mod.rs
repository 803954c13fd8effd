//! The laboratory in real time, on this machine: clock, TAP interfaces, network namespaces, processes and files.
//!
//! `Running` is a laboratory as a whole. `claim` owns its name and what it makes, `namespace` makes its stations, and
//! `carrier` carries their frames. `crew` runs commands in stations, `control` queries and ends a laboratory of
//! another process, and `needs` checks what the machine provides. `accuracy` compares real with virtual time, by
//! `traffic`.

pub mod accuracy;
mod carrier;
mod claim;
pub mod control;
pub mod crew;
mod error;
mod namespace;
pub mod needs;
mod running;
mod traffic;

pub use carrier::{CaptureWriter, Carrier, Outside, Warn};
pub use claim::{Claim, path};
pub use error::{LabError, Result};
pub use namespace::{command, inside};
pub use running::Running;
