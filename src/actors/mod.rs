//! Actors: pure state machines without a clock and without I/O. Their random numbers come from streams passed to them.
//!
//! `runtime` executes them, and `graph` connects them.

pub mod agent;
pub mod body;
pub mod cache;
pub mod controller;
pub mod localizer;
mod lost;
mod neighbours;
pub mod network;
pub mod order;
pub mod recorder;
pub mod roster;
pub mod state_server;
pub mod status;
pub mod verdict;
pub mod wiggle;
pub mod world;
