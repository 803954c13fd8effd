//! Protocol between hosts: encoding, authentication, retransmission and routing. Pure.

mod acks;
mod bucket;
mod candidates;
pub mod codec;
mod congestion;
mod control_blocks;
pub mod counts;
mod duplicate_id;
mod gaps;
mod incoming;
pub mod key;
mod lateness;
pub(crate) mod limits;
pub mod link;
mod offset;
pub(crate) mod outgoing;
mod refusal;
pub mod reliability;
pub mod report;
mod report_schedule;
pub mod retransmit;
pub mod router;
pub mod sender;
mod senders;
mod soft;
mod unpack;
mod window;
