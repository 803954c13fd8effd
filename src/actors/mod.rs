//! The actors: pure state machines without a clock, I/O, or randomness but the streams that they are given.
//!
//! `runtime` runs them, and `graph` says who talks to whom.

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
pub mod world;
