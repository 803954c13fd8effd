//! Emulated links (network media) for hosts that run in one process. All code is pure: it reads no clock and does no
//! I/O.

pub(crate) mod emulator;
pub(crate) mod ether;
pub mod radio;
pub(crate) mod radio_link;
pub(crate) mod reach;
