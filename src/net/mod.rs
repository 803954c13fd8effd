//! Between hosts. Nothing here knows what a message is good for; nothing in `policy` or `scenario` knows of this room.
//!
//! `protocol` is what real hosts say to each other, `transport` moves its frames, and `media` stands in for cables and
//! radios in one process.

pub mod media;
pub mod protocol;
pub mod transport;
