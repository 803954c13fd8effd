//! Transports: actors that take a frame to transmit and give the frames that arrive. One file each.
//!
//! Here are the emulated ether of one-process runs and, to come, the sockets of real hosts.

pub mod ether;
