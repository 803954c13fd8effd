//! Laboratory of the radio channel: stations whose Ethernet frames travel over the emulated channel of 802.11 in real
//! time. All code but that of `machine` is pure: it takes frames and times and returns deliveries and times.
//!
//! `file` is the laboratory as data, `ethernet` the addresses of its stations, `medium` the channel with frames of
//! Ethernet, `path` the motion of stations. `lateness` counts deliveries that were late, `report` holds all counters,
//! and `capture` encodes transmissions as pcap. `load` makes the traffic with which real time is compared to virtual
//! time. `machine` holds the interfaces, the clock and the processes.

#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod capture;
pub mod ethernet;
pub mod file;
pub mod lateness;
pub mod load;
pub mod machine;
pub mod medium;
pub mod path;
pub mod report;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
