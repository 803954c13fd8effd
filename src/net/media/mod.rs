//! Emulated links for hosts that run in one process. All pure.

pub mod emulator;
pub mod ether;
pub mod radio;
pub mod radio_link;
pub mod reach;
