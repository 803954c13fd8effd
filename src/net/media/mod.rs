//! Emulated links (network media) for hosts that run in one process. All code is pure: it reads no clock and does no
//! I/O.

pub mod emulator;
pub mod ether;
pub mod radio;
pub mod radio_link;
pub mod reach;
