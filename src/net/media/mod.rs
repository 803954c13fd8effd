//! The emulation of media: what becomes of frames in one process. All pure.

pub mod air;
pub mod ether;
pub mod medium;
pub mod radio;
pub mod reach;
