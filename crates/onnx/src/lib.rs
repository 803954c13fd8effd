//! Policies of format 3: ONNX graphs with a contract, which says what a graph takes, in which units and frames, what it
//! broadcasts and remembers, and what its action means.
//!
//! [`Contract`] reads the contract, [`structure`] what a graph says of itself, [`engine`] runs a graph, [`network`] has
//! the graphs of a policy, [`frames`] and [`joint`] the calls of one in Python, and [`policy`] makes the inputs of a
//! call from what a robot observes and hears. [`check`] runs a policy on made-up inputs before a robot moves by it. The
//! contract's fields are in docs/policy-format-3.md.

mod action;
pub mod check;
pub mod contract;
pub mod engine;
mod features;
pub mod frames;
pub mod joint;
mod memory;
mod message;
pub mod network;
mod onnx;
mod operators;
pub mod parts;
pub mod policy;
mod refusal;
mod robots;
mod role;
pub mod structure;

pub use contract::Contract;
pub use network::Network;
pub use parts::Parts;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");
