//! The wire and the link layer: what is decoded, who is believed, what is repaired, and what soft state costs.

mod abuse;
mod fuzz_decoders;
mod identity;
mod reliability;
mod repairs;
mod rig;
mod soft_state;
mod wire;
