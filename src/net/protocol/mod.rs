//! Protocol between hosts: encoding, authentication, retransmission and routing. Pure.

pub mod acks;
pub mod bucket;
pub mod candidates;
pub mod codec;
pub mod congestion;
pub mod counts;
pub mod duplicate_id;
pub mod gaps;
pub mod incoming;
pub mod key;
pub mod lateness;
pub mod limits;
pub mod link;
pub mod offset;
pub mod outgoing;
mod refusal;
pub mod reliability;
pub mod report;
pub mod report_schedule;
pub mod retransmit;
pub mod router;
pub mod sender;
pub mod senders;
pub mod soft;
mod unpack;
pub mod window;
