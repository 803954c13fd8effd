//! Networking between hosts. It does not interpret messages, and nothing in `policy` or `scenario` depends on it.
//!
//! `protocol` defines the bytes and decisions of real hosts, `transport` moves their frames, and `media` emulates
//! cables and radios in one process.

pub mod media;
pub mod protocol;
pub mod transport;
