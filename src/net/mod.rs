//! Between hosts: bytes, link state, routing, the emulated medium and its faults. All pure, but for
//! `transport`, which holds the actors that move frames.
//!
//! Nothing here knows what a message is good for; nothing in `policy` or `scenario` knows of this room.

pub mod codec;
pub mod fault;
mod fault_file;
pub mod link;
pub mod medium;
pub mod range;
pub mod router;
pub mod transport;
