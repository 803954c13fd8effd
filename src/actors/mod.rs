//! Actors: pure state machines without a clock and without I/O. Their random numbers come from streams passed to them.
//!
//! `runtime` executes them, and `graph` connects them.

mod absent;
pub(crate) mod agent;
pub(crate) mod body;
pub mod cache;
pub(crate) mod controller;
pub mod drive_check;
pub(crate) mod listener;
pub mod localizer;
mod lost;
mod neighbours;
pub mod network;
pub mod order;
mod perceived;
pub(crate) mod presence;
pub mod recorder;
pub mod senses;
pub(crate) mod state_server;
pub(crate) mod status;
pub mod wiggle;
pub(crate) mod witness;
pub(crate) mod world;
