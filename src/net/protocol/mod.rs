//! Protocol of hosts: encoding, authentication, retransmission and routing. All pure.

pub mod bucket;
pub mod candidates;
pub mod codec;
pub mod counts;
pub mod gaps;
pub mod incoming;
pub mod key;
pub mod limits;
pub mod link;
pub mod offset;
pub mod order;
pub mod outgoing;
pub mod reliability;
pub mod report;
pub mod retransmit;
pub mod router;
pub mod sender;
pub mod senders;
pub mod telling;
pub mod twins;
mod unpack;
pub mod window;
