//! The wire and the link layer: decoding, authentication, repairs, and the cost of soft state.

mod abuse;
mod fuzz_decoders;
mod identity;
mod reliability;
mod repairs;
mod rig;
mod soft_state;
mod wire;
