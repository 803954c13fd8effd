//! Policies of several hops (policy files of format 2): an encoder, one or more hops of message passing, a decoder.
//!
//! A hop is one exchange of messages between neighbours. Robot i broadcasts the inputs of all its hops in one message,
//! so a policy of k hops needs no more messages than one of a single hop. Each input was computed from the neighbours'
//! newest messages, and nothing waits: what comes from further away is a step older for each hop. This is the
//! asynchronous exchange of hidden layers of arXiv 2309.10164; the older inputs are the delayed aggregation of Tolstaya
//! et al., CoRL 2019 (arXiv 1903.10527).

pub mod action;
mod attention;
pub mod entry;
pub mod file;
mod folded;
pub(crate) mod gru;
pub mod hop;
mod layers;
pub mod manifest;
mod memory;
pub(crate) mod output;
pub mod perceptron;
