//! Actors: pure state machines without a clock or I/O. Their only randomness is the streams that they are given.
//!
//! `runtime` runs them, and `graph` connects them.

pub mod agent;
pub mod body;
pub mod cache;
pub mod controller;
pub mod localizer;
pub mod network;
pub mod order;
pub mod recorder;
pub mod state_server;
pub mod status;
pub mod verdict;
pub mod wiggle;
pub mod world;
