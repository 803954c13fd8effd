//! The wire and the link layer: decoding, acceptance of senders, retransmission, and the cost of soft state.

mod abuse;
mod auto;
mod confidential;
mod fuzz_decoders;
mod fuzz_members;
mod hops;
mod identity;
mod mesh;
mod moved;
mod parts;
mod reliability;
mod repairs;
mod rig;
mod rosters;
mod signed;
mod soft_state;
mod wire;
