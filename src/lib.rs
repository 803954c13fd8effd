//! Murmurate runs message-passing policies (graph neural networks first) on teams of robots: the same actor
//! graph in one process under virtual time, in many processes, or on one host per robot.
//!
//! # The idea
//! An actor is a pure [`actors::Core`]: a state machine that is handed the time and a message and answers with
//! messages. One generic shell runs every core. A handful of [wire messages](messages::wire) may cross hosts,
//! always through a Network, which decides by a table where each goes. So a deployment mode is data
//! ([`deploy`]), and the same graph runs everywhere.
//!
//! # Layers
//! Each may use those before it, never those after:
//! `time`, `random`, `config`, `messages`, `cells`; then `scenario`, `world`, `policy`, `safety`, `net` (but for its
//! transports), `report`; then the cores in `actors`, and beside them [`train`], which knows no actor; then
//! `deploy`; then `actors::{shell, clock}` and `net::transport`; then `actors::graph`; then `trial`; then `study`;
//! then the program.
//! `tests/tidy.rs` checks it.
//!
//! # Where to start reading
//! [`messages::wire`], then [`actors`], then `actors/graph.rs`, which says who talks to whom; [`trial`] is the
//! way to run it all from a test or a program of your own.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod actors;
pub mod cells;
pub mod config;
pub mod deploy;
pub mod messages;
pub mod net;
pub mod policy;
pub mod random;
pub mod report;
pub mod safety;
pub mod scenario;
#[cfg(feature = "study")]
pub mod study;
pub mod time;
#[cfg(feature = "train")]
pub mod train;
pub mod trial;
pub mod world;
