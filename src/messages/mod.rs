//! All messages of the system: plain data, encoded with serde. Messages check only that their values are in range.
//!
//! `wire` holds messages that may cross hosts and therefore always pass through a Network; `kinds` is the table of
//! them, `exchange`, `leading`, `release` and `sensed` define them, and `body` says what each has. `local` holds
//! messages between the actors of one host. `ids`, `geometry`, `floats`, `hardware`, `latch`, `numbered`, `phase`,
//! `place`, `round`, `status` and `telemetry` are their fields. `parts` cuts what is too large for a datagram.
//! `isometry` converts poses to those of nalgebra and back.

mod aloft;
mod body;
mod exchange;
mod floats;
pub mod geometry;
pub mod hardware;
pub mod ids;
mod isometry;
pub mod kinds;
pub mod latch;
mod leading;
pub mod local;
mod numbered;
mod parts;
pub mod phase;
pub mod place;
pub mod release;
pub mod round;
mod sensed;
mod status;
pub mod telemetry;
pub mod trigger;
pub mod wire;
