//! Between hosts: bytes, link state, routing, the emulated medium and its faults. All pure, but for
//! `transport`, which holds the actors that move frames.
//!
//! Nothing here knows what a message is good for; nothing in `policy` or `scenario` knows of this room.

pub mod again;
pub mod bucket;
pub mod candidates;
pub mod codec;
pub mod counts;
pub mod fault;
mod fault_file;
pub mod gaps;
pub mod incoming;
pub mod key;
pub mod link;
pub mod medium;
pub mod offset;
pub mod order;
pub mod outgoing;
pub mod radio;
pub mod range;
pub mod reach;
pub mod reliability;
pub mod report;
pub mod router;
pub mod sender;
pub mod senders;
pub mod telling;
pub mod transport;
pub mod twins;
mod unpack;
pub mod window;
