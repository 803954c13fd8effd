//! Murmurate runs message-passing policies (above all graph neural networks) on teams of robots: the same actor
//! graph in one process under virtual time, in many processes, or on one host per robot.
//!
//! # The idea
//! An actor is a pure [`actor::Core`]: a state machine that takes the time and a message and returns messages. One
//! generic shell runs every core. A few kinds of [wire messages](messages::wire) may cross hosts, always through a
//! Network, which routes each by a table. So a deployment mode is data ([`deploy`]), and the same graph runs
//! everywhere. "The paper" is Blumenkamp et al., ICRA 2022 (arXiv 2111.01777); docs/glossary.md has all other words.
//!
//! # Modules in their order
//! Each module may use those before it in the table of ARCHITECTURE.md, never those after; `tests/tidy.rs` checks it.
//! Training, records, the live page, studies and the command line are packages above this one.
//!
//! # Where to start reading
//! [`messages::wire`], then [`actors`], then `graph/mod.rs`, which connects the actors. [`trial`] runs all of it from a
//! test or a program of your own.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod actor;
pub mod actors;
pub mod cells;
pub mod chassis;
pub mod config;
pub mod deploy;
pub mod drivers;
pub mod edge;
pub mod estimation;
pub mod faults;
pub mod fitness;
pub mod flight;
pub mod graph;
pub mod hearing;
pub mod live;
pub mod localization;
pub mod messages;
pub mod net;
pub mod observation;
pub mod observers;
pub mod policy;
pub mod random;
pub mod registry;
pub mod report;
pub mod results;
pub mod runtime;
pub mod safety;
pub mod scenario;
pub mod senses;
pub mod simulate;
pub mod time;
pub mod trial;
pub mod world;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

#[doc = include_str!("../README.md")]
#[cfg(doctest)]
pub struct Readme;
